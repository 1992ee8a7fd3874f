"""The exported program, solved by somebody else, gives the controller's command."""

import json

import clarabel
import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp
from literature import cubesat_model

from synth.delivery.qp import save_mpc
from synth.errors import ModelError
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
