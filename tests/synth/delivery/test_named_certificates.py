"""Every exported file names the certificate of its design by its sha256, and `synth verify` tells it from others."""

import html
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

import synth
from synth.__main__ import main
from synth.command.certificates import named_in
from synth.errors import ExportError, VerificationError

P = synth.c2d(synth.gang_of_four(synth.system([1.0], [1.0, 1.0])), 0.2)


@pytest.fixture(scope="module")
def design():
    return synth.hinfsyn(P)


@pytest.fixture(scope="module")
def certificate(design):
    return design.certify()


@pytest.fixture(scope="module")
def another(design):
    """Of the same design."""
    return design.certify(upper=1.01 * design.gamma)


def written(file):
    if file.suffix == ".fmu":
        with zipfile.ZipFile(file) as unit:
            return html.unescape(unit.read("documentation/index.html").decode())
    return " ".join(file.read_text(errors="replace").replace("*", " ").split())


@pytest.mark.parametrize(
    ("format", "options"),
    [
        ("c", {}), ("c", {"dtype": "float"}), ("c", {"dtype": "q31", "inputs": 1.0}), ("fmu2", {}), ("fmu3", {}),
        ("json", {}), ("json", {"umin": -1, "umax": 1}), ("mat", {}), ("mat", {"umin": -1, "umax": 1}),
    ],
)  # fmt: skip
def test_every_format_says_what_is_proved(format, options, design, certificate, another, tmp_path, capsys):
    files = synth.export(design, format, tmp_path, certificate=certificate, **options)
    words = f"sha256 {certificate.sha256}. {certificate.statement}"
    assert format == "mat" or words in written(files[0])
    assert named_in(str(files[0])) == {certificate.sha256}
    if format == "c" and options.get("dtype") == "float":
        assert all(text in written(files[0]) for text in ("|u - exact u| <=", "between the samples", "sha256"))
    if format in ("json", "mat"):
        synth.read(files[0])
    proof, other = (tmp_path / f"{name}.certificate.json" for name in ("of", "other"))
    certificate.save(proof)
    if not (options and format in ("json", "mat")):  # a controller alone is no design
        assert main(["verify", str(proof), "--design", str(files[0])]) == 0
        assert "named in" in capsys.readouterr().out
        another.save(other)
        assert main(["verify", str(other), "--design", str(files[0])]) == 1
        assert "names: the sha256 differs" in capsys.readouterr().err


def test_a_file_that_names_none(design, certificate, tmp_path, capsys):
    header = synth.export(design, "c", tmp_path)[0]
    certificate.save(tmp_path / "proof.json")
    assert main(["verify", str(tmp_path / "proof.json"), "--design", str(header)]) == 2
    assert "names no certificate" in capsys.readouterr().err
    design.save(tmp_path / "design.json")
    assert main(["verify", str(tmp_path / "proof.json"), "--design", str(tmp_path / "design.json")]) == 0


def test_the_command_names_it(design, certificate, tmp_path):
    design.save(tmp_path / "design.json")
    certificate.save(tmp_path / "proof.json")
    options = ["--certificate", str(tmp_path / "proof.json"), "-o", str(tmp_path)]
    assert main(["export", str(tmp_path / "design.json"), "--format", "c", *options]) == 0
    assert named_in(str(tmp_path / "controller.h")) == {certificate.sha256}
    assert json.loads((tmp_path / "proof.json").read_text())["sha256"] == certificate.sha256


def test_only_a_certificate_of_this_design_that_holds_is_named(design, certificate, tmp_path):
    changed = replace(certificate, upper=certificate.upper / 2)
    with pytest.raises(VerificationError, match="does not prove"):
        synth.export(design, "c", tmp_path, certificate=changed)
    other = synth.hinfsyn(synth.c2d(synth.gang_of_four(synth.system([2.0], [1.0, 1.0])), 0.2))
    with pytest.raises(ExportError, match="certificate is of another plant"):
        synth.export(other, "c", tmp_path, certificate=certificate)
    K = design.controller
    moved = replace(design, controller=replace(K, C=np.nextafter(K.C, np.inf)))
    with pytest.raises(ExportError, match="certificate is of another controller"):
        synth.export(moved, "c", tmp_path, certificate=certificate)
    with pytest.raises(ExportError, match="comes without one"):
        synth.export(K, "c", tmp_path, certificate=certificate)
    with pytest.raises(ExportError, match="pass what certify returned"):
        synth.export(design, "c", tmp_path, certificate="proof.json")
    assert not [*tmp_path.iterdir()]


def test_what_the_gate_proved_over_a_box_is_named_too(design, certificate, tmp_path, capsys):
    k = synth.ureal("k", 1.0, percentage=20)
    found = synth.accept(design, synth.UncertainSystem(None, [[-1.0]], [[k]], [[1.0]]))
    proofs = found.certificates
    assert "stability over the box" in proofs
    header, _ = synth.export(design, "c", tmp_path, acceptance=found, certificate=certificate)
    assert named_in(str(header)) == {certificate.sha256, *(c.sha256 for c in proofs.values())}
    saved = proofs["stability over the box"].save(tmp_path / "box.json")
    assert main(["verify", str(saved), "--design", str(header)]) == 0
    other = synth.accept(design, synth.UncertainSystem(None, [[-1.1]], [[k]], [[1.0]])).certificates
    other["stability over the box"].save(tmp_path / "other.json")
    assert main(["verify", str(tmp_path / "other.json"), "--design", str(header)]) == 1
    assert "names: the sha256 differs" in capsys.readouterr().err
