"""Files of `synth` appear whole or not at all, under names in places that are usable, and say so before the work."""

import os
import signal
import stat
import subprocess
import sys

import pytest
from studyfiles import SHAPING

from synth.__main__ import main
from synth.command import specification
from synth.command.specification import read_study
from synth.delivery.files import check_name
from synth.delivery.formats import export
from synth.errors import ExportError, SpecificationError
from synth.files import UNFINISHED, is_device, write_atomically
from synth.systems.statespace import StateSpace

K = StateSpace.gain([[0.5]], 0.1)
DEVICES = ["CON", "con", "Nul", "AUX", "prn", "COM1", "lpt9", "COM0"]


@pytest.mark.skipif(os.name != "posix", reason="modes of files are POSIX's")
@pytest.mark.parametrize("mask", [0o077, 0o022, 0o002])
def test_the_umask_is_respected(tmp_path, mask):
    before = os.umask(mask)
    try:
        (path,) = export(K, "json", tmp_path)
    finally:
        os.umask(before)
    assert stat.S_IMODE(path.stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("broken", ["fsync", "replace"])
def test_after_an_exception_the_old_file_is_there_alone(tmp_path, monkeypatch, broken):
    write_atomically(tmp_path / "a", b"old")

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, broken, fails)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "a", b"new")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"old")]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
def test_a_killed_writer_leaves_the_old_file_and_a_name_that_tells(tmp_path):
    write_atomically(tmp_path / "a", b"old")
    code = (
        "import os, pathlib, signal\nfrom synth import files\n"
        "files.os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"files.write_atomically(pathlib.Path({str(tmp_path / 'a')!r}), b'new')"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    assert (tmp_path / "a").read_bytes() == b"old"
    (left,) = (p.name for p in tmp_path.iterdir() if p.name != "a")
    assert left.startswith(".a.")
    assert left.endswith(UNFINISHED)


@pytest.mark.parametrize("ending", ["", ".json", ".tar.gz", " ", ".", " .txt"])
@pytest.mark.parametrize("name", DEVICES)
def test_devices_of_windows_are_known_by_their_stem(name, ending):
    assert is_device(name + ending)
    assert not is_device(f"{name}trol{ending}")
    assert not is_device(f"a.{name}{ending}")


@pytest.mark.parametrize("name", DEVICES)
def test_devices_of_windows_are_no_names_of_exports_designs_and_plants(tmp_path, name, capsys):
    with pytest.raises(ExportError, match="Windows takes for a device"):
        check_name(name)
    (tmp_path / "x.toml").write_text(SHAPING.replace("dt = 0\n", f'file = "sub/{name}.json"\n'))
    with pytest.raises(SpecificationError, match=r"plant\.file: .*Windows takes this name for a device"):
        read_study(tmp_path / "x.toml")
    (tmp_path / "x.toml").write_text(SHAPING)
    assert main(["design", str(tmp_path / "x.toml"), "-o", str(tmp_path / f"{name}.json")]) == 2
    assert "Windows takes this name for a device" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["../plant.json", "a/../../plant.json", "..", "./../plant.json"])
def test_a_study_reads_nothing_outside_its_folder_unless_it_says_the_whole_path(tmp_path, name):
    from synth.delivery.modelfiles import save_system

    (tmp_path / "a" / "a").mkdir(parents=True)
    G = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    for folder in (tmp_path, tmp_path / "a"):
        save_system(folder / "plant.json", G)
    study = 'plant.file = "{}"\nsynthesis.problem = "loopshaping"\n'
    path = tmp_path / "a" / "x.toml"
    path.write_text(study.format(name))
    with pytest.raises(SpecificationError, match=r"plant\.file: .*put the file beside the study, or write its whole"):
        read_study(path)
    for inside in ("plant.json", "a/../plant.json", "./plant.json", (tmp_path / "plant.json").as_posix()):
        path.write_text(study.format(inside))
        assert read_study(path).plant.digest() == G.digest()


@pytest.fixture
def unwritable(monkeypatch):
    """Every folder; root writes into those that nobody may write into."""

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.write_bytes", refused)


def test_what_cannot_be_written_is_told_before_the_work(tmp_path, monkeypatch, capsys, unwritable):
    def worked(*_, **__):
        raise AssertionError("this took minutes")

    monkeypatch.setattr(specification, "read_study", worked)
    monkeypatch.setattr("synth.command.certificates.prove", worked)
    monkeypatch.setattr("synth.delivery.acceptance.accept", worked)
    monkeypatch.setattr("synth.command.commands.load", lambda _: K)
    for command in (
        ["design", "x.toml", "-o", str(tmp_path / "d.json")],
        ["certify", "d.json", "-o", str(tmp_path / "c.json")],
        ["export", "d.json", "--accept", "--format", "c", "-o", str(tmp_path / "new")],
    ):
        assert main(command) == 2
        told = capsys.readouterr().err
        assert "cannot be written" in told
        assert "Permission denied" in told


@pytest.mark.parametrize("encoding", ["ascii", "ascii:strict", "latin-1", "cp1252"])
def test_no_screen_ends_a_command(tmp_path, encoding):
    from synth.delivery.modelfiles import Model, save_system

    save_system(tmp_path / "µ\u4e2d.json", Model(K, ("θ",), ("ħ",), {"θ": "µN"}))
    done = subprocess.run(
        [sys.executable, "-m", "synth", "info", "µ\u4e2d.json"],
        cwd=tmp_path, capture_output=True, env={**os.environ, "PYTHONIOENCODING": encoding},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    assert rb"\u03b8" in done.stdout
    assert (rb"[\xb5N]" if encoding.startswith("ascii") else b"[\xb5N]") in done.stdout
