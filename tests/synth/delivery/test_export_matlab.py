"""The .mat and .json files as others read them: Octave's control package simulates the controller."""

import json
import shutil
import subprocess

import numpy as np
import pytest
import scipy.io
from literature import cubesat_pecorilla2024

from synth.delivery.formats import export
from synth.errors import ExportError
from synth.regulators.controller import state_feedback
from synth.regulators.sequential import SequentialController
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.statespace import StateSpace

CONTINUOUS = StateSpace([[-1, 2], [0, -3]], [[0], [1]], [[1, 0]], [[0.5]])


@pytest.fixture(scope="module")
def design() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


@pytest.fixture(scope="module")
def octave():
    """Runs a script in a folder; skips where Octave or its control package is missing."""
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("Octave is the oracle of this test and is not installed")

    def run(script: str, folder) -> list[str]:
        command = [program, "--quiet", "--no-init-file", "--eval", script]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.split("\n")

    if run("disp(isempty(pkg('list', 'control')))", None)[0].strip() == "1":
        pytest.skip("Octave's control package is the oracle of this test and is not installed")
    return run


def test_octave_simulates_the_same_controller(octave, design, tmp_path):
    """ss and lsim agree with the exported sums to 1e-10; names, units, level and hash are there."""
    (path,) = export(design, "mat", tmp_path, name="attitude")
    samples = 400
    inputs = np.sin(np.outer(np.arange(samples), 0.1 * np.arange(1, 7)))
    script = (
        "pkg load control; load('attitude.mat'); K = design.K; K = ss(K.A, K.B, K.C, K.D, design.dt);"
        f"t = (0:{samples - 1})' * design.dt; e = sin((0:{samples - 1})' * 0.1 * (1:6)); u = lsim(K, e, t);"
        "printf('%.17g\\n', u', design.gamma); printf('%s\\n', design.names.u{1}, design.plant_sha256);"
    )
    found = octave(script, path.parent)
    controller = SequentialController.of(design)
    state, expected = controller.init(), []
    for e in inputs:
        state, u = controller.update(state, e)
        expected.append(u)
    numbers = np.array([float(v) for v in found[: 3 * samples]]).reshape(samples, 3)
    assert np.abs(numbers - expected).max() <= 1e-10 * np.abs(expected).max()
    assert float(found[3 * samples]) == design.gamma
    assert found[3 * samples + 1 : 3 * samples + 3] == [design.plant.u[0], design.plant.system.digest()]


def test_octave_rebuilds_a_controller_without_a_plant(octave, tmp_path):
    """Continuous controllers leave as data: ss has the same frequency response."""
    export(CONTINUOUS, "mat", tmp_path)
    script = (
        "pkg load control; load('controller.mat'); c = controller; K = ss(c.A, c.B, c.C, c.D);"
        "H = freqresp(K, 2); printf('%.17g\\n', real(H), imag(H)); printf('%s\\n', c.plant);"
    )
    found = octave(script, tmp_path)
    H = CONTINUOUS.frequency_response(2.0)[0, 0]
    np.testing.assert_allclose([float(v) for v in found[:2]], [H.real, H.imag], rtol=1e-10)
    assert "without a plant" in found[2]


def test_json_is_the_design_and_reads_back(design, tmp_path):
    (path,) = export(design, "json", tmp_path, name="attitude")
    assert path.read_bytes() == design.save(tmp_path / "saved.json").read_bytes()
    assert Design.load(path).controller.digest() == design.controller.digest()
    with pytest.raises(ExportError, match=r"attitude\.json exists"):
        export(design, "json", tmp_path, name="attitude")


def test_a_controller_without_a_plant_says_so(tmp_path):
    K = state_feedback([[1.5, -0.1]], 0.25)
    (path,) = export(K, "json", tmp_path)
    data = json.loads(path.read_text())
    assert data["D"] == [[1.5, -0.1]]
    assert data["dt"] == 0.25
    assert "nothing was verified in a loop" in data["plant"]
    assert data["input"] == "the error e = r - y"
    (path,) = export(K, "mat", tmp_path)
    found = scipy.io.loadmat(path, squeeze_me=True, struct_as_record=False)["controller"]
    np.testing.assert_array_equal(found.D, [1.5, -0.1])
    assert found.plant == data["plant"]
