"""`synth certify` and `synth verify` of certificates, and that nothing tampered with is proved again."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from literature import compleib, cubesat_pecorilla2024
from tampering import tampered

from synth.__main__ import main
from synth.proof.certify import Certificate
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, system

DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Two designs: of a double integrator, which both bounds can be proved of, and of one with a zero at rest."""
    folder = tmp_path_factory.mktemp("certificates")
    G = StateSpace([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    hinfsyn(GeneralizedPlant.four_block(G, Wdist=1, Wnoise=1, Wout=1, Wact=1)).save(folder / "design.json")
    hinfsyn(cubesat_pecorilla2024(), method="riccati").save(folder / "cubesat.json")
    hinfsyn(compleib()["ac2"][0], method="riccati").save(folder / "ac2.json")
    assert main(["certify", str(folder / "design.json"), "-o", str(folder / "proof.json")]) == 0
    return folder


@pytest.fixture
def synth(folder, monkeypatch, capsys):
    """Run the command in the folder: (exit code, what it printed, its errors)."""
    monkeypatch.chdir(folder)

    def run(*arguments: str):
        try:
            code = main(list(arguments))
        except SystemExit as stop:
            code = stop.code
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_a_certificate_is_written_and_proved_again_from_its_file_alone(synth, folder, tmp_path):
    code, out, _ = synth("certify", "design.json", "-o", str(tmp_path / "c.json"))
    assert code == 0
    assert "no controller of any order reaches a norm below" in out
    (tmp_path / "elsewhere").mkdir()
    moved = (tmp_path / "c.json").rename(tmp_path / "elsewhere" / "moved.json")
    code, out, _ = synth("verify", str(moved))
    certificate = Certificate.load(moved)
    assert code == 0
    assert out.rstrip().endswith("proved again")
    for said in (certificate.upper, certificate.lower, certificate.plant_sha256, certificate.controller_sha256):
        assert str(said) in out


def test_what_is_between_the_samples_is_proved_too(synth, folder, tmp_path):
    P = GeneralizedPlant.four_block(system([1.0], [1.0, 0.2, 1.0]), Wdist=1, Wnoise=1, Wout=1, Wact=1)
    hinfsyn(c2d(P, 0.3)).save(folder / "sampled.json")
    target = str(tmp_path / "c.json")
    code, out, _ = synth("certify", "sampled.json", "-o", target, "--delay", "0.1")
    level = Certificate.load(target).intersample.upper
    assert code == 0
    assert f"below {level!r} between the samples too" in out
    assert "u 0.1 s after the sample" in out
    assert synth("verify", target)[0] == 0
    assert synth("verify", target, "--design", "sampled.json")[0] == 0
    code, out, _ = synth("info", target, "--json")
    assert json.loads(out)[0]["intersample"] == level
    lower = ["--delay", "0.1", "--intersample", str(level * (1 - 1e-5))]
    code, _, error = synth("certify", "sampled.json", "-o", target, "--force", *lower)
    assert code == 1
    assert "between the samples" in error
    code, _, error = synth("certify", "design.json", "-o", target, "--force", "--delay", "0.1")
    assert code == 2
    assert "remembers what c2d sampled" in error


def test_what_is_asked_for_is_proved_or_refused(synth, tmp_path):
    target = str(tmp_path / "c.json")
    code, out, _ = synth(
        "certify", "design.json", "-o", target, "--lower", "2", "--upper", "3", "--bits", "200", "--json"
    )
    assert code == 0
    assert {key: json.loads(out)[key] for key in ("lower", "upper", "bits")} == {
        "lower": 2.0,
        "upper": 3.0,
        "bits": 200,
    }
    code, _, error = synth("certify", "design.json", "-o", str(tmp_path / "d.json"), "--lower", "3")
    assert (code, "no controller reaches 3" in error) == (1, True)
    assert not (tmp_path / "d.json").exists()
    assert synth("certify", "design.json", "-o", target)[0] == 2
    assert synth("certify", "design.json", "-o", target, "--force")[0] == 0
    assert synth("certify", "design.json", "-o", target, "--force", "--bits", "5")[0] == 2
    assert synth("certify", "proof.json")[0] == 2
    assert synth("certify", "design.json", "-o", "c.mat")[0] == 2


def test_of_which_design_a_certificate_is(synth):
    code, out, _ = synth("verify", "proof.json", "--design", "design.json")
    assert (code, "proved again, of design.json" in out) == (0, True)
    code, out, error = synth("verify", "proof.json", "--design", "cubesat.json")
    assert (code, out, "another plant" in error) == (1, "", True)


def test_the_reason_is_told_where_there_is_no_lower_bound(synth, tmp_path):
    code, out, _ = synth("certify", "ac2.json", "-o", str(tmp_path / "c.json"))
    assert code == 0
    assert "from u to z a zero at 0 rad/s" in out
    code, out, _ = synth("verify", str(tmp_path / "c.json"), "--json")
    assert (code, json.loads(out)[0]["lower"]) == (0, None)


def test_info_says_that_it_proves_nothing(synth):
    assert "not here; synth verify proves it again" in synth("info", "proof.json")[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["proof.json", "--plant", "design.json"], "--plant means nothing for a certificate"),
        (["proof.json", "--disk-margin", "1"], "--disk-margin means nothing"),
        (["design.json", "proof.json"], "design.json: this is no certificate"),
        (["cubesat.json", "--design", "design.json"], "--design is about certificates"),
        (["proof.json", "--design", "proof.json"], "certificate"),
        (["missing.json"], "missing.json: there is no such file"),
    ],
)
def test_bad_input_is_one_line_and_code_2(synth, arguments, message):
    code, out, error = synth("verify", *arguments)
    assert (code, out, error.count("\n")) == (2, "", 1)
    assert message in error


def test_certificates_of_version_1_are_proved_of_their_design(synth):
    """Written by the release before, of 1/s^2 with unit weights."""
    old, design = str(DATA / "certificate_version1.json"), str(DATA / "certificate_version1_design.json")
    code, out, _ = synth("verify", old, "--design", design)
    assert (code, "proved again" in out) == (0, True)
    code, _, error = synth("verify", old)
    assert (code, "holds no plant and controller" in error) == (2, True)


@pytest.mark.parametrize("count", [40, pytest.param(500, marks=pytest.mark.slow)])
def test_nothing_tampered_with_is_accepted(synth, folder, tmp_path, count):
    """Random changes of every part of the file."""
    data, accepted, rng = json.loads((folder / "proof.json").read_text()), [], np.random.default_rng(count)
    told = set()
    for k in range(count):
        changed = tampered(data, rng)
        if json.dumps(changed) == json.dumps(data):
            changed["lower"] *= 1.01
        file = tmp_path / "tampered.json"
        file.write_text(json.dumps(changed))
        code, out, error = synth("verify", str(file))
        told.add(code)
        if code == 0:
            accepted.append((k, out))
        else:
            assert (out, error.count("\n")) == ("", 1), error
    assert not accepted
    assert told <= {1, 2}


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(lower=d["lower"] * (1 + 1e-4)),
        lambda d: d.update(upper=d["upper"] * (1 - 1e-4)),
        lambda d: d.update(lower_witness=None),
        lambda d: d["plant"]["B1"][1].__setitem__(0, 1.1),
        lambda d: d["controller"]["C"][0].__setitem__(0, 0.0),
        lambda d: d["upper_witness"].update(T=[[1.0, 0], [0, 1]]),
        lambda d: d["lower_witness"]["end"].update(factor=[[9.0, 0.0], [0.0, 9.0]]),
        lambda d: d.update(statement=d["statement"].replace("below", "above")),
    ],
)
@pytest.mark.parametrize("rehashed", ["as found", "plant and controller too"])
def test_a_seal_that_was_renewed_does_not_help(synth, folder, tmp_path, change, rehashed):
    """Whoever changes a claim and knows how the sha256 is made still has to prove it."""
    data = json.loads((folder / "proof.json").read_text())
    change(data)
    if rehashed != "as found":
        P, K = data["plant"], data["controller"]
        data["plant_sha256"] = GeneralizedPlant(**P).system.digest()
        data["controller_sha256"] = StateSpace(**K).digest()
    del data["sha256"]
    data["sha256"] = hashlib.sha256(json.dumps(data).encode()).hexdigest()
    (tmp_path / "forged.json").write_text(json.dumps(data))
    code, out, _ = synth("verify", str(tmp_path / "forged.json"))
    assert (code in (1, 2), out) == (True, "")


def test_a_key_that_is_given_twice_is_refused(synth, folder, tmp_path):
    text = (folder / "proof.json").read_text()
    (tmp_path / "twice.json").write_text(text.replace('"lower":', '"lower": 1e9, "lower":', 1))
    code, _, error = synth("verify", str(tmp_path / "twice.json"))
    assert (code, "given twice" in error) == (2, True)
