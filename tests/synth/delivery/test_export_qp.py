"""The exported program, solved by somebody else, gives the controller's command."""

import json

import clarabel
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from literature import cubesat_model

from synth.__main__ import main
from synth.delivery.qp import document, load_mpc, save_mpc
from synth.errors import ModelError
from synth.files import sealed_by_parts
from synth.predictive.horizon import mpc


@pytest.fixture(scope="module")
def controller():
    weights = {"Q": 1e3 * np.eye(6), "R": 1e3 * np.eye(3)}
    return mpc(cubesat_model(), **weights, Np=10, Nc=7, umin=-1e-3, umax=1e-3, form="position", hmax=10.8e-3)


def test_the_program_in_the_json_file_reproduces_the_command(controller, tmp_path):
    data = json.loads(save_mpc(controller, tmp_path / "mpc.json").read_text())
    y, r = np.array([0.05, -0.1, 0.02, 0.0, 1e-3, -1e-3]), np.zeros(6)
    state = controller.init()
    phi = controller.parameters(state, y, r)
    _, u = controller.step(state, y, r)

    qp = data["qp"]
    P, A, slope = (np.array(qp[name], float) for name in ("P", "A", "slope"))
    offset = np.array([np.inf if v is None else v for v in qp["offset"]])
    lower = np.array([-np.inf if v is None else v for v in qp["lower"]])
    both = offset + slope @ phi
    f, upper = both[: len(P)], both[len(P) :]
    rows = np.vstack([np.eye(len(P)), A])
    G, h = np.vstack([rows, -rows]), np.concatenate([upper, -lower])
    held = np.abs(h) < 1e20
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    cones = [clarabel.NonnegativeConeT(int(held.sum()))]
    solution = clarabel.DefaultSolver(sp.csc_matrix(np.triu(P)), f, sp.csc_matrix(G[held]), h[held], cones, settings)
    v = np.array(solution.solve().x)
    np.testing.assert_allclose(v[:3] * np.array(data["unit"]), u, atol=1e-7)


def test_matlab_file_and_unknown_endings(controller, tmp_path):
    save_mpc(controller, tmp_path / "mpc.mat")
    found = scipy.io.loadmat(tmp_path / "mpc.mat", squeeze_me=True, struct_as_record=False)["mpc"]
    np.testing.assert_array_equal(found.qp.P, controller.qp.P)
    assert found.settings.Np == 10
    with pytest.raises(ModelError, match=r"path ends with '\.txt'"):
        save_mpc(controller, tmp_path / "mpc.txt")


def test_the_file_is_read_back_as_it_was_written(controller, tmp_path):
    path = save_mpc(controller, tmp_path / "mpc.json")
    found, written = load_mpc(path), document(controller)
    assert found.keys() == written.keys()
    for table in ("settings", "model", "parameters", "qp"):
        assert found[table].keys() == written[table].keys()
        for name, value in written[table].items():
            value = np.asarray(value, float)
            free = np.where(value >= 1e20, np.inf, np.where(value <= -1e20, -np.inf, value))
            np.testing.assert_array_equal(found[table][name], free, err_msg=name)
    np.testing.assert_array_equal(found["unit"], written["unit"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="x"), "is no convex-synth mpc"),
        (lambda d: d.update(format_version=3), "is no convex-synth mpc of format version 1 or 2"),
        (lambda d: d.update(dt=0.0, form="x"), "form is 'x'; one of velocity or position.*dt is 0.0; a number above 0"),
        (lambda d: d["qp"].update(P=[[1.0], [1.0, 2.0]]), "it is damaged"),
        (lambda d: d["qp"].pop("slope"), r"qp\.slope: missing"),
        (lambda d: d["model"]["A"][0].__setitem__(0, 2.0), "model_sha256 does not belong to the model"),
    ],
)
def test_what_was_changed_in_a_program_is_named(controller, tmp_path, change, message):
    path = save_mpc(controller, tmp_path / "mpc.json")
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"was changed after|is no convex-synth mpc"):
        load_mpc(path)
    path.write_text(json.dumps(sealed_by_parts(data)))
    with pytest.raises(ModelError, match=message):
        load_mpc(path)


def test_info_of_a_program(controller, tmp_path, capsys):
    path = save_mpc(controller, tmp_path / "mpc.json")
    assert main(["info", str(path), "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)
    assert (told["kind"], told["form"], told["states"], told["umax"]) == (
        "predictive controller", "position", 6, [1e-3] * 3,
    )  # fmt: skip
