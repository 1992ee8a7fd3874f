"""Design files: exact, checked when read, and readable elsewhere."""

import json

import numpy as np
import pytest
import scipy.io
from literature import cubesat_pecorilla2024

from synth.errors import ModelError, VerificationError
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
        (lambda d: d.update(verified_norm=float("nan")), ModelError, "verified_norm nan"),
        (lambda d: d.update(gamma=float("inf")), ModelError, "gamma is inf"),
        (lambda d: d["info"].pop("method"), ModelError, "incomplete or damaged"),
    ],
)
def test_a_file_that_was_changed_is_refused(design, tmp_path, change, error, message):
    data = json.loads(json.dumps(to_dict(design)))
    change(data)
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(data))
    with pytest.raises(error, match=message):
        Design.load(path)


def test_not_json_and_unknown_endings(design, tmp_path):
    path = tmp_path / "x.json"
    path.write_text("{")
    with pytest.raises(ModelError, match="is not JSON"):
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
