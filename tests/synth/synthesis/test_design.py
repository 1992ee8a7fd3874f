"""Design files: exact, checked when read, and readable elsewhere."""

import json

import numpy as np
import pytest
import scipy.io
from literature import cubesat_pecorilla2024

from synth.errors import ModelError, VerificationError
from synth.files import sealed_by_parts
from synth.synthesis.design import Design, to_dict
from synth.synthesis.hinfinity import hinfsyn


@pytest.fixture(scope="module")
def design() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


def test_json_keeps_every_bit(design, tmp_path):
    path = design.save(tmp_path / "cubesat.json")
    again = Design.load(path)
    assert again.controller.digest() == design.controller.digest()
    assert again.plant.system.digest() == design.plant.system.digest()
    assert (again.gamma, again.verified_norm, again.info) == (design.gamma, design.verified_norm, design.info)
    assert again.plant.y == design.plant.y
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cubesat.json"]


def test_provenance_is_in_the_file(design, tmp_path):
    text = design.save(tmp_path / "d.json").read_text()
    data = json.loads(text)
    assert data["info"]["versions"].keys() == {"convex-synth", "numpy", "scipy"}
    assert data["info"]["date"].endswith("+00:00")
    assert data["info"]["solver"] == "doubling"
    lmi = json.loads(hinfsyn(cubesat_pecorilla2024(), method="lmi").save(tmp_path / "lmi.json").read_text())["info"]
    assert lmi["versions"].keys() == {"convex-synth", "numpy", "scipy", "cvxpy", "clarabel"}
    assert lmi["solver"] == "clarabel"
    assert str(tmp_path) not in text


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda d: d.update(format="other"), ModelError, "the data is no design"),
        (lambda d: d.update(format_version=99), ModelError, "format_version is 99"),
        (lambda d: d.pop("gamma"), ModelError, "incomplete or damaged"),
        (lambda d: d["plant"]["A"][0].__setitem__(0, 0.5), ModelError, "plant_sha256"),
        (lambda d: d["controller"]["A"][0].pop(), ModelError, "incomplete or damaged"),
        (lambda d: d["controller"]["D"][0].__setitem__(0, -1e3), VerificationError, "unstable"),
        (lambda d: d.update(verified_norm=1e-6), VerificationError, "the file claims a norm"),
        (lambda d: d.update(verified_norm=float("nan")), ModelError, "it holds NaN"),
        (lambda d: d.update(gamma=float("inf")), ModelError, "it holds Infinity"),
        (lambda d: d.update(gamma=True), ModelError, "gamma is True"),
        (lambda d: d.update(gamma="0.5"), ModelError, "gamma is '0.5'"),
        (lambda d: d.update(gamma=-5.0), VerificationError, "the file claims a norm of -5"),
        (lambda d: d["info"].update(spectral_radius=0.0), VerificationError, r"info\.spectral_radius is 0, measured"),
        (lambda d: d["info"].update(optimum=-1.0), ModelError, r"info\.optimum is -1\.0"),
        (lambda d: d["info"].update(frequency="fast"), ModelError, r"info\.frequency is 'fast'"),
        (lambda d: d["controller"].update(A="x"), ModelError, r"controller\.A is 'x'"),
        (lambda d: d["controller"]["A"][0].__setitem__(0, True), ModelError, r"controller\.A\[0\]\[0\] is True"),
        (lambda d: d["info"].pop("method"), ModelError, "incomplete or damaged"),
    ],
)
def test_a_file_that_was_changed_is_refused(design, tmp_path, change, error, message):
    """Also where the seal was renewed; where it was not, it is a ModelError in any case."""
    data = json.loads(json.dumps(to_dict(design)))
    change(data)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(sealed_by_parts(data)))
    with pytest.raises(error, match=message):
        Design.load(path)
    path.write_text(json.dumps(data))
    with pytest.raises(ModelError):
        Design.load(path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d["controller"]["B"][1].__setitem__(0, 1.01 * d["controller"]["B"][1][0]), r"controller\.B"),
        (lambda d: d["plant"]["D22"][0].__setitem__(0, 1e-16), r"plant\.D22"),
        (lambda d: d["plant"].update(y=d["plant"]["y"][::-1]), r"plant\.y"),
        (lambda d: d["info"].update(date="1969-07-20"), r"info\.date"),
        (lambda d: d.update(gamma=1.0, verified_norm=1.0), "gamma, verified_norm"),
        (lambda d: d.pop("convention"), "convention"),
        (lambda d: d.update(remark="sound"), "remark"),
        (lambda d: d.update(sha256="0"), "sha256 itself"),
        (lambda d: d.pop("sha256"), "sha256 itself"),
        (lambda d: d.pop("parts_sha256"), "something in it"),
    ],
)
def test_the_changed_field_is_named(design, tmp_path, change, named):
    data = json.loads(json.dumps(to_dict(design)))
    change(data)
    (tmp_path / "changed.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=rf"^{named}.* was changed after the file was written"):
        Design.load(tmp_path / "changed.json")


def test_files_without_a_seal_are_read_with_a_remark(design, tmp_path):
    data = {key: value for key, value in to_dict(design).items() if key not in ("sha256", "parts_sha256")}
    path = tmp_path / "old.json"
    path.write_text(json.dumps(data | {"format_version": 2}))
    assert "format version 2, which has no sha256" in Design.load(path).warnings[0]
    path.write_text(json.dumps(to_dict(design) | {"format_version": 2}))
    with pytest.raises(ModelError, match="parts_sha256, sha256, which no design of format version 2 has"):
        Design.load(path)


def test_not_json_and_unknown_endings(design, tmp_path):
    path = tmp_path / "x.json"
    path.write_text("{")
    with pytest.raises(ModelError, match="it is no JSON"):
        Design.load(path)
    with pytest.raises(ModelError, match=r"path ends with '\.txt'"):
        design.save(tmp_path / "x.txt")
    assert [p.name for p in tmp_path.iterdir()] == ["x.json"]


def test_matlab_file_holds_controller_plant_and_names(design, tmp_path):
    design.save(tmp_path / "d.mat")
    found = scipy.io.loadmat(tmp_path / "d.mat", squeeze_me=True, struct_as_record=False)["design"]
    np.testing.assert_array_equal(found.K.A, design.controller.A)
    np.testing.assert_array_equal(found.P.D21, design.plant.D21)
    assert found.dt == 0.5
    assert list(found.names.u) == list(design.plant.u)
    assert found.plant_sha256 == design.plant.system.digest()


def test_a_design_unpacks_and_counts_like_the_tuple_it_stands_for(design):
    _, _, gamma, info = design
    assert len(design) == 4
    assert (design[2], design[3]) == (gamma, info)
    assert design[-1] is info
