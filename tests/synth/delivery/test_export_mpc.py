"""The predictive controller's program as C: compiled, it gives the command of the controller that was verified."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
from exported import gcc
from literature import cubesat_model

from synth.delivery.solver import export_mpc
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


def test_without_the_generator_the_error_says_what_to_install(controller, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cvxpygen", None)
    with pytest.raises(ExportError, match=r"needs CVXPYgen .*: pip install cvxpygen, or save the program as JSON"):
        export_mpc(controller, tmp_path)
    assert not list(tmp_path.iterdir())
