"""The predictive controller's program as C: compiled, it gives the command of the controller that was verified."""

import ctypes
import shutil
import subprocess
import sys

import numpy as np
import pytest
from exported import gcc
from literature import cubesat_model

from synth.delivery.solver import _wrapper, export_mpc
from synth.errors import ExportError
from synth.predictive.horizon import mpc


@pytest.fixture(scope="module")
def controller():
    weights = {"Q": 1e3 * np.eye(6), "R": 1e3 * np.eye(3)}
    return mpc(cubesat_model(), **weights, Np=10, Nc=7, umin=-1e-3, umax=1e-3, form="position", hmax=10.8e-3)


def test_the_compiled_program_gives_the_command(controller, tmp_path):
    """Twenty states, some with saturated commands: QOCO in C agrees with DAQP."""
    pytest.importorskip("cvxpygen", reason="CVXPYgen generates the C of this test and is not installed")
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    paths = export_mpc(controller, tmp_path / "mpc", name="attitude")
    folder = tmp_path / "mpc"
    main = tmp_path / "main.c"
    main.write_text(
        '#include <stdio.h>\n#include "attitude.h"\n'
        "int main(void) {\n"
        "    double phi[ATTITUDE_PARAMETERS], u[ATTITUDE_OUTPUTS];\n"
        "    for (;;) {\n"
        '        for (int i = 0; i < ATTITUDE_PARAMETERS; ++i) if (scanf("%lf", &phi[i]) != 1) return 0;\n'
        "        if (attitude_solve(phi, u)) return 1;\n"
        '        printf("%.17g %.17g %.17g\\n", u[0], u[1], u[2]);\n'
        "    }\n}\n"
    )
    sources = [main, folder / "attitude.c", *sorted((folder / "src").glob("*.c"))]
    gcc("-O2", "-w", "-I", folder, "-I", folder / "include", *sources, "-lm", "-o", tmp_path / "main")
    rng = np.random.default_rng(0)
    states = rng.normal(size=(20, 6)) * [0.05, 0.05, 0.05, 1e-3, 1e-3, 1e-3]
    parameters = [controller.parameters(controller.init(), y, np.zeros(6)) for y in states]
    text = "\n".join(" ".join(repr(float(v)) for v in phi) for phi in parameters)
    done = subprocess.run([str(tmp_path / "main")], input=text, capture_output=True, text=True, check=True)
    found = np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])
    expected = np.array([controller.step(controller.init(), y, np.zeros(6))[1] for y in states])
    assert np.abs(found - expected).max() < 2e-5 * 1e-3  # of the limit; measured 8e-6
    assert (np.abs(expected) > 0.999e-3).any()
    assert not any(str(tmp_path).encode() in path.read_bytes() for path in paths)
    with pytest.raises(ExportError, match="exists; pass force=True"):
        export_mpc(controller, folder, name="attitude")


STUB = """
#include <math.h>
typedef struct { double *v; } prim_t;
typedef struct { int status; } info_t;
static double solution[64];
static prim_t prim = { solution };
static info_t information = { 1 };
static struct { prim_t *prim; info_t *info; } CPG_Result = { &prim, &information };
static void cpg_set_solver_default_settings(void) {}
static void cpg_set_solver_abstol(double t) { (void)t; }
static void cpg_set_solver_reltol(double t) { (void)t; }
static void cpg_update_phi(int i, double value) { solution[i % 64] = value > 1e100 ? NAN : 0.5; }
static void cpg_solve(void) {}
"""


def test_what_is_no_number_leaves_the_command_as_it_was(controller, tmp_path):
    """The wrapper beside a solver that gives half a unit, or NaN where a parameter is huge."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc is not installed")
    for name, content in _wrapper(controller, "attitude").items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / "cpg_solve.h").write_text(STUB)
    (tmp_path / "cpg_workspace.h").write_text("")
    gcc("-std=c99", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", tmp_path / "attitude.c", "-o", tmp_path / "a.so")
    solve = ctypes.CDLL(str(tmp_path / "a.so")).attitude_solve
    size = controller.problem.parameters["inputs"].stop
    u = (ctypes.c_double * 3)(7.0, 8.0, 9.0)
    for value in (np.nan, np.inf, -np.inf, 1e200):
        phi = (ctypes.c_double * size)(*np.zeros(size))
        phi[1] = value
        assert solve(phi, u) == 1
        assert list(u) == [7.0, 8.0, 9.0]
    assert solve((ctypes.c_double * size)(*np.zeros(size)), u) == 0
    np.testing.assert_allclose(u, 0.5 * controller.problem.unit)


def test_without_the_generator_the_error_says_what_to_install(controller, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpygen", None)
    with pytest.raises(ExportError, match=r"needs CVXPYgen .*: pip install cvxpygen, or save the program as JSON"):
        export_mpc(controller, tmp_path)
    assert not list(tmp_path.iterdir())
