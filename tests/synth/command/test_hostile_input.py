"""Studies that were damaged, names that would steer a terminal, and errors that nobody foresaw."""

import io
import json
import os
import sys

import numpy as np
import pytest
from literature import cubesat_pecorilla2024
from studyfiles import MIXED, SHAPING
from tampering import mutated

from synth.__main__ import main
from synth.command import commands, specification
from synth.command.specification import read_study
from synth.command.terminal import say
from synth.delivery.modelfiles import save_system
from synth.errors import SpecificationError, SynthError
from synth.files import sealed_by_parts
from synth.synthesis.design import from_dict, to_dict
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff", "it is no TOML"),
        (b"a = " + b"[" * 10_000 + b"]" * 10_000, "it is no TOML .it is nested deeper than 50 levels"),
        (b"a = " + b"[" * 60 + b"]" * 60, "nested deeper than 50 levels"),
        (b"a" + b".a" * 1_000_000 + b" = 1", "nested deeper than 50 levels"),
        (b"plant = {" + b"a ." * 10_000 + b"a = 1}", "nested deeper than 50 levels"),
        (b"a = 1" + b"0" * 5000, "it is no TOML"),
        (b"plant.dt = 1" + b"0" * 400, r"plant\.dt is a number that no double holds"),
        (b"plant.A = [[1" + b"0" * 400 + b"]]", r"plant\.A\[0\]\[0\] is a number that no double holds"),
        (b"plant.dt = 1\nplant.dt = 2", "it is no TOML"),
    ],
)
def test_studies_that_are_none(tmp_path, content, message):
    (tmp_path / "x.toml").write_bytes(content)
    with pytest.raises(SpecificationError, match=message):
        read_study(tmp_path / "x.toml")


def test_studies_that_are_no_files(tmp_path):
    with open(tmp_path / "large.toml", "wb") as file:
        file.truncate(specification.LARGEST + 1)
    with pytest.raises(SpecificationError, match="larger than 8 MiB"):
        read_study(tmp_path / "large.toml")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.toml")
        for path in (tmp_path / "pipe.toml", "/dev/zero"):
            with pytest.raises(SpecificationError, match="a device or a pipe"):
                read_study(path)
        (tmp_path / "x.toml").write_text(SHAPING.replace("dt = 0\n", 'file = "/dev/zero"\n'))
        with pytest.raises(SpecificationError, match=r"plant\.file: /dev/zero: it is a device"):
            read_study(tmp_path / "x.toml")


def test_a_delay_of_a_thousand_million_samples_is_refused(tmp_path):
    (tmp_path / "x.toml").write_text(MIXED.replace("delay = 2", "delay = 1e9"))
    with pytest.raises(SpecificationError, match=r"1e\+09 samples in all; at most 5000"):
        read_study(tmp_path / "x.toml")


@pytest.mark.parametrize("den", ["[1e-320, 1e300, 1]", "[1e-300, 0.2, 1e300]"])
def test_coefficients_that_no_double_brings_together_are_refused(tmp_path, den):
    (tmp_path / "x.toml").write_text(MIXED.replace("[1, 0.2, 0.1]", den))
    with pytest.raises(SpecificationError, match="too far apart for doubles"):
        read_study(tmp_path / "x.toml")


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers such as 1e300, which the checks after them refuse
@pytest.mark.parametrize("text", [SHAPING, MIXED], ids=["shaping", "mixed"])
@pytest.mark.parametrize("count", [150, pytest.param(2500, marks=pytest.mark.slow)])
def test_damaged_studies_never_end_bare(tmp_path, text, count):
    (tmp_path / "x.toml").write_text(text)
    read_study(tmp_path / "x.toml")
    rng = np.random.default_rng(count)
    for _ in range(count):
        content = text.encode()
        for _ in range(int(rng.integers(1, 3))):
            content = mutated(content, rng)
        (tmp_path / "x.toml").write_bytes(content)
        try:
            read_study(tmp_path / "x.toml")
        except SynthError:
            pass


HOSTILE = "\x1b]0;owned\x07\x1b[2J<script>alert(1)</script>\u202e\x9b\r"


def test_names_do_not_steer_the_terminal(tmp_path, capsys):
    """Of channels, units, statuses, keys and files: what is printed has no control character but the end of a line."""
    P = cubesat_pecorilla2024()
    names = {key: tuple(f"{HOSTILE}{name}" for name in getattr(P, key)) for key in "wuzy"}
    nine = {key: getattr(P, key) for key in ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22", "dt")}
    hostile = GeneralizedPlant(**nine, **names, units={names["u"][0]: f"{HOSTILE}\nN"})
    save_system(tmp_path / "plant.json", hostile)
    data = to_dict(hinfsyn(hostile))
    data["info"]["status"] = data["info"]["warnings"] = HOSTILE
    data["info"]["warnings"] = [HOSTILE]
    (tmp_path / "design.json").write_text(json.dumps(sealed_by_parts(data)))
    (tmp_path / "other.json").write_text(json.dumps({"format": HOSTILE}))
    (tmp_path / "unknown.json").write_text(json.dumps(sealed_by_parts(data | {HOSTILE: 1})))
    (tmp_path / f"{HOSTILE.replace('/', '')}.json").write_text("{")
    (tmp_path / "x.toml").write_text('"a\\u001b[2J" = 1\n' + SHAPING.replace("0.02", '"\\u001b[2J"'))
    for file in sorted(tmp_path.iterdir()):
        for command in ["design"] if file.suffix == ".toml" else ["info", "verify", "compare"]:
            main([command, str(file)])
            told = "".join(capsys.readouterr())
            assert told
            assert all(letter.isprintable() or letter == "\n" for letter in told), told
    with pytest.raises(SystemExit):
        main(["info", "a", HOSTILE, f"--{HOSTILE}"])
    assert "\x1b" not in capsys.readouterr().err


def test_names_with_scripts_do_not_reach_html():
    P = cubesat_pecorilla2024()
    data = to_dict(hinfsyn(P))
    data["info"]["warnings"] = [HOSTILE]
    shown = from_dict(sealed_by_parts(data))._repr_html_()
    assert "<script" not in shown
    assert "\x1b" not in shown


def test_a_screen_without_the_sign_shows_its_number():
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    say("µN \ud800", stream)
    stream.flush()
    assert stream.buffer.getvalue() == b"\\xb5N \\ud800\n"


class Panic(BaseException):
    """As a library that is not written in Python raises it."""


@pytest.mark.parametrize(
    ("error", "code", "message"),
    [
        (ZeroDivisionError("division\nby \x1b zero"), 70, "a bug of synth (ZeroDivisionError: division by \\x1b zero)"),
        (RecursionError("deep"), 70, "a bug of synth (RecursionError: deep)"),
        (Panic("unwrap"), 70, "a bug of synth (Panic: unwrap)"),
        (MemoryError(), 4, "there is not enough memory"),
        (OSError(28, "No space left on device", "x.json"), 2, "x.json: No space left on device"),
    ],
)
def test_errors_that_nobody_foresaw_have_their_code(monkeypatch, capsys, error, code, message):
    def broken(options):
        raise error

    monkeypatch.setattr(commands, "info", broken)
    assert main(["info", "x.json"]) == code
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert message in err
    assert main(["info", "x.json", "--debug"]) == code
    assert code != 70 or "Traceback" in capsys.readouterr().err
    assert f"  {code} " in sys.modules["synth.__main__"].EPILOG
