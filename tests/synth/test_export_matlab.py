"""The .mat file as Octave reads it."""

import shutil
import subprocess

import numpy as np
import pytest
from literature import cubesat_pecorilla2024

from synth.hinfinity import hinfsyn


@pytest.mark.slow
def test_octave_reads_controller_names_and_provenance(tmp_path):
    octave = shutil.which("octave-cli")
    if octave is None:
        pytest.skip("Octave is the oracle of this test and is not installed")
    design = hinfsyn(cubesat_pecorilla2024())
    design.save(tmp_path / "d.mat")
    script = (
        "load('d.mat'); K = design.K; x = zeros(size(K.A, 1), 1); for k = 1:50; e = sin(k * (1:size(K.B, 2))');"
        "u = K.C * x + K.D * e; x = K.A * x + K.B * e; end; printf('%.17g\\n', u, design.dt, design.gamma);"
        "printf('%s\\n', design.names.u{1}, design.plant_sha256);"
    )
    found = subprocess.run(
        [octave, "--quiet", "--no-init-file", "--eval", script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split("\n")
    K = design.controller
    x = np.zeros(K.n)
    for k in range(1, 51):
        e = np.sin(k * np.arange(1, K.nu + 1))
        u, x = K.C @ x + K.D @ e, K.A @ x + K.B @ e
    np.testing.assert_allclose([float(v) for v in found[:5]], [*u, 0.5, design.gamma], rtol=1e-10)
    assert found[5:7] == [design.plant.u[0], design.plant.system.digest()]
