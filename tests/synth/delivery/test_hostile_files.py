"""Files that were damaged, forged or never were files: a typed error that says so, and nothing forged is taken."""

import io
import json
import os
import subprocess

import numpy as np
import pytest
import scipy.io
from literature import cubesat_pecorilla2024
from tampering import mutated, tampered

from synth.delivery import matfiles
from synth.delivery.formats import export
from synth.delivery.modelfiles import read, save_system
from synth.errors import ModelError, SynthError
from synth.files import DEEPEST, LARGEST, check_seal, read_json, sealed, sealed_by_parts
from synth.proof.certify import Certificate
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.statespace import StateSpace

READERS = (read, Design.load, Certificate.load)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One file of each kind."""
    folder = tmp_path_factory.mktemp("files")
    G = StateSpace([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], [[1.0, 0.0]], 0, 1.0)
    plant, shaped = cubesat_pecorilla2024(), ncfsyn(G)
    design = hinfsyn(plant)
    design.save(folder / "design.json")
    shaped.save(folder / "shaped.json")
    export(design.controller, "json", folder, name="controller")
    export(AntiWindup.of(shaped, -1.0, np.inf), "json", folder, name="limited")
    save_system(folder / "plant.json", plant)
    return folder


@pytest.mark.parametrize("name", ["design", "shaped", "controller", "limited"])
@pytest.mark.parametrize("count", [15, pytest.param(125, marks=pytest.mark.slow)])
def test_nothing_tampered_with_is_read(folder, tmp_path, name, count):
    """Every number, text, structure and name counts: none may change in the last bit."""
    data, rng, path = (
        json.loads((folder / f"{name}.json").read_text()),
        np.random.default_rng(count),
        tmp_path / "x.json",
    )
    read(folder / f"{name}.json")
    for _ in range(count):
        changed = tampered(data, rng)
        if json.dumps(changed) == json.dumps(data):
            changed["A" if "A" in data else "controller"] = []
        path.write_text(json.dumps(changed))
        with pytest.raises(ModelError):
            read(path)


def test_a_controller_whose_seal_was_renewed_still_tells_the_sha256_of_its_matrices(folder, tmp_path):
    data = json.loads((folder / "controller.json").read_text())
    data["A"][0][0] *= 1.1
    (tmp_path / "x.json").write_text(json.dumps(sealed_by_parts(data)))
    with pytest.raises(ModelError, match="its matrices are not those"):
        read(tmp_path / "x.json")


def test_a_controller_without_a_seal_is_read_with_a_remark(folder, tmp_path):
    data = json.loads((folder / "controller.json").read_text())
    old = {key: value for key, value in data.items() if "sha256" not in key} | {"format_version": 1.0}
    (tmp_path / "x.json").write_text(json.dumps(old))
    found = read(tmp_path / "x.json")
    assert "format version 1, which has no sha256" in found.warnings[0]
    assert found.system.digest() == read(folder / "controller.json").system.digest()
    assert read(folder / "controller.json").warnings == ()


def test_a_seal_survives_another_layout_and_no_change():
    data = {"a": [1.0, 0.1, 1e300], "b": {"c": "µ", "d": True, "e": None}, "f": {}}
    for seal in (sealed, sealed_by_parts):
        again = json.loads(json.dumps(seal(data), indent=3, ensure_ascii=False))
        check_seal(again)
        assert seal(again) == again
        for change in ({"a": [1.0, 0.1]}, {"b": {"c": "µ", "d": 1, "e": None}}, {"g": 0}, {"f": []}):
            with pytest.raises(ModelError, match="was changed after the file was written"):
                check_seal(again | change)


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "it is no JSON"),
        (b"", "it is no JSON"),
        (b"\xff\xfe\x00", "it is no JSON"),
        (b'{"a": NaN}', "it holds NaN"),
        (b'{"a": [1, [-Infinity]]}', "it holds -Infinity"),
        (b'{"a": [[0, 1e999]]}', r"a\[0\]\[1\] is a number that no double holds"),
        (b'{"a": 1' + b"0" * 400 + b"}", "a is a number that no double holds"),
        (b"1" * 5000, "it is no JSON"),
        (b'{"a": 1, "b": 2, "a": 1}', "the key 'a' is given twice"),
        (b'{"a": "\\ud800"}', r"a is '\\ud800', which is no text"),
        (b"[" * 10_000 + b"]" * 10_000, "deeper"),
        (b"[" * 100_000, "deeper|it is no JSON"),
        (b"[" * (DEEPEST + 2) + b"]" * (DEEPEST + 2), "deeper"),
        (b'{"a":' * 10_000 + b"1" + b"}" * 10_000, "deeper"),
    ],
)  # fmt: skip
def test_what_no_reader_takes(tmp_path, reader, content, message):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(ModelError, match=message):
        reader(tmp_path / "x.json")


@pytest.mark.parametrize("reader", READERS)
def test_what_is_no_file(tmp_path, reader):
    with pytest.raises(ModelError, match="there is no such file"):
        reader(tmp_path / "no.json")
    with pytest.raises(ModelError, match="this is a folder"):
        reader(tmp_path)
    with pytest.raises(ModelError, match="its name is none"):
        reader(tmp_path / "a\0b.json")
    with pytest.raises(ModelError, match="it cannot be read"):
        reader(tmp_path / ("a" * 5000))
    with open(tmp_path / "large.json", "wb") as file:
        file.truncate(LARGEST + 1)
    with pytest.raises(ModelError, match="larger than 64 MiB"):
        reader(tmp_path / "large.json")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names here")
@pytest.mark.parametrize("reader", READERS)
def test_devices_and_pipes_are_not_read(tmp_path, reader):
    os.mkfifo(tmp_path / "pipe.json")
    for path in (tmp_path / "pipe.json", "/dev/zero"):
        with pytest.raises(ModelError, match="a device or a pipe"):
            reader(path)


def resealed(content: bytes) -> bytes:
    """With a seal that fits, so that what comes after it is tried."""
    try:
        data = json.loads(content)
        return json.dumps(sealed_by_parts(data) if "parts_sha256" in data else data).encode()
    except (ValueError, TypeError, AttributeError):
        return content


@pytest.mark.parametrize("name", ["design", "shaped", "controller", "limited", "plant"])
@pytest.mark.parametrize("count", [10, pytest.param(1500, marks=pytest.mark.slow)])
def test_damaged_json_never_ends_bare(folder, tmp_path, name, count):
    """What is read is printed too, as `synth info` does."""
    text, rng, path = (folder / f"{name}.json").read_bytes(), np.random.default_rng(count), tmp_path / "x.json"
    for _ in range(count):
        content = text
        for _ in range(int(rng.integers(1, 3))):
            content = mutated(content, rng)
        path.write_bytes(resealed(content))
        for reader in (read, Design.load):
            try:
                repr(reader(path))
            except SynthError:
                pass


def test_json_of_the_largest_size_is_refused_by_its_depth_or_read(tmp_path):
    (tmp_path / "x.json").write_bytes(b"[" + b"0," * 500_000 + b"0]")
    assert len(read_json(tmp_path / "x.json")) == 500_001


def mat(**changed) -> bytes:
    """A double integrator as a .mat file."""
    system = {"A": [[1, 0.5], [0, 1.0]], "B": [[0.0], [1]], "C": np.eye(2), "D": [[0.0], [0]], "dt": 0.5} | changed
    scipy.io.savemat(content := io.BytesIO(), system)
    return content.getvalue()


def test_a_mat_file_that_kills_scipy_does_not_kill_us(tmp_path):
    """Byte 425 from 0 of these 512 ends the interpreter inside SciPy 1.17.1: a segmentation fault."""
    content = bytearray(mat())
    (tmp_path / "x.mat").write_bytes(content)
    assert read(tmp_path / "x.mat").system.C.tolist() == [[1.0, 0.0], [0.0, 1.0]]
    content[425] = 0x5C
    (tmp_path / "x.mat").write_bytes(content)
    with pytest.raises(ModelError, match=r"no \.mat file of version 7 or older"):
        read(tmp_path / "x.mat")


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"A": [[1j, 0], [0, 1]]}, "A is no real matrix but complex"),
        ({"A": "text"}, "A is no real matrix but text"),
        ({"A": np.array([[1, "x"]], dtype=object)}, "A is no real matrix but a cell"),
        ({"dt": [0.5, 0.5]}, "dt has 2 entries"),
        ({"dt": {"a": 1}}, "dt is no real matrix but"),
        ({"A": np.full((2, 2), np.nan)}, "every entry must be finite"),
        ({"design": 1.0}, "it is a design for MATLAB"),
    ],
)
def test_what_is_wrong_in_a_mat_file_is_named(tmp_path, changed, message):
    (tmp_path / "x.mat").write_bytes(mat(**changed))
    with pytest.raises(ModelError, match=message):
        read(tmp_path / "x.mat")


def test_a_reader_of_mat_files_that_hangs_dies_or_talks_nonsense(tmp_path, monkeypatch):
    (tmp_path / "x.mat").write_bytes(mat())

    def child(text: str) -> None:
        (tmp_path / "child.py").write_text(text)
        monkeypatch.setattr(matfiles, "CHILD", tmp_path / "child.py")

    monkeypatch.setattr(matfiles, "PATIENCE", 0.5)
    child("while True: pass")
    with pytest.raises(ModelError, match=r"it was not read in 0\.5 s"):
        read(tmp_path / "x.mat")
    monkeypatch.undo()
    for text, message in (
        ("import os; os.abort()", "ended the process"),
        ("print('nonsense')", "it is a damaged .mat file"),
        ("raise OSError('no room')", "no room"),
    ):
        child(text)
        with pytest.raises(ModelError, match=message):
            read(tmp_path / "x.mat")

    def nothing(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(subprocess, "run", nothing)
    with pytest.raises(ModelError, match=r"no process to read a \.mat file could be started"):
        read(tmp_path / "x.mat")


@pytest.mark.parametrize("count", [2, pytest.param(80, marks=pytest.mark.slow)])
def test_damaged_mat_files_never_end_bare(tmp_path, count):
    rng, content = np.random.default_rng(count), mat()
    for _ in range(count):
        changed = bytearray(content)
        for at in rng.integers(116, len(content), size=int(rng.integers(1, 3))):
            changed[at] = rng.integers(256)
        (tmp_path / "x.mat").write_bytes(changed)
        try:
            read(tmp_path / "x.mat")
        except SynthError:
            pass
