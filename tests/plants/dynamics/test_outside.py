"""Plants from outside: callables against closed forms, FMUs against the linear system that they were made of."""

import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from plants.dynamics.outside import callable_plant, fmu_plant
from plants.errors import ScenarioError
from plants.simulation.loop import Loop, Scenario
from plants.simulation.simulate import simulate

A, B, C = np.array([[0.9, 0.1], [-0.2, 0.8]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.5]])
OSCILLATOR = np.array([[0.0, 1.0], [-4.0, -0.1]])


@dataclass(frozen=True)
class Gain:
    K: np.ndarray
    dt: float = 0.1

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.K @ (r - y)


def fly(plant, initial, K, **more):
    scn = Scenario(**{"initial": initial, "dt": 0.1, "periods": 40, **more})
    return simulate(Loop(plant=plant, controller=Gain(np.atleast_2d(K))), scn)


@pytest.mark.parametrize(("rule", "steps", "tolerance"), [("rk4", 8, 1e-7), ("adaptive", 1, 1e-7), ("step", 1, 1e-12)])
def test_callable_plant_is_the_closed_form(rule, steps, tolerance):
    exact = expm(0.1 * OSCILLATOR)
    f = (lambda t, x, u: exact @ x) if rule == "step" else (lambda t, x, u: OSCILLATOR @ x)
    run = fly(callable_plant(f, rule=rule), np.array([1.0, 0.0]), np.zeros((1, 2)), steps=steps)
    wanted = [np.linalg.matrix_power(exact, k) @ [1.0, 0.0] for k in range(40)]
    np.testing.assert_allclose(run.outputs, wanted, rtol=0, atol=tolerance)


def test_callable_plant_gets_the_time_and_its_output_counts():
    run = fly(callable_plant(lambda t, x, u: [2 * t], lambda x: [x[0], 1.0]), np.zeros(1), np.zeros((1, 2)))
    np.testing.assert_allclose(run.outputs, np.column_stack([run.time**2, np.ones(40)]), atol=1e-12)


def test_mistakes_in_a_callable_are_told_with_the_time():
    with pytest.raises(ScenarioError, match=r"CallablePlant.advance raised IndexError: .* at t = 0.2 s"):
        fly(callable_plant(lambda t, x, u: x if t < 0.2 else x[[7]], rule="step"), np.ones(2), np.zeros((1, 2)))
    with pytest.raises(ScenarioError, match="rule = 'euler'"):
        callable_plant(lambda t, x, u: x, rule="euler")


@pytest.fixture(scope="module", params=[2, 3])
def unit(request):
    """The file of (A, B, C A, C B): what it tells after a step is C x at its end."""
    pytest.importorskip("fmpy", reason="fmpy flies FMUs and is not installed")
    if shutil.which("gcc") is None:
        pytest.skip("an FMU holds a binary: gcc is not installed")
    from synth.delivery.formats import export
    from synth.systems.statespace import StateSpace

    with tempfile.TemporaryDirectory() as folder:
        yield export(StateSpace(A, B, C @ A, C @ B, 0.1), f"fmu{request.param}", folder, name="linear")[0]


def test_fmu_flies_like_its_linear_system_twice(unit):
    plant = fmu_plant(unit)
    native = callable_plant(lambda t, x, u: A @ x + B @ u, lambda x: C @ x, rule="step")
    wanted = fly(native, np.zeros(2), [[0.3]], reference=np.ones(1))
    for _ in range(2):
        run = fly(plant, plant.initial, [[0.3]], reference=np.ones(1))
        np.testing.assert_allclose(run.outputs, wanted.outputs, rtol=0, atol=1e-12)
        np.testing.assert_allclose(run.inputs, wanted.inputs, rtol=0, atol=1e-12)
        assert (plant._unit, plant._folder) == (None, "")


def test_mistakes_about_an_fmu_are_named(unit, tmp_path):
    broken = tmp_path / "broken.fmu"
    broken.write_text("no archive")
    plant = fmu_plant(unit)
    for make, told in {
        (lambda: fmu_plant(tmp_path / "none.fmu"), "there is no such file"),
        (lambda: fmu_plant(broken), "is no FMU that can be read: it is no zip archive"),
        (lambda: fmu_plant(unit, inputs=["y00"]), "no variable 'y00'; did you mean 'y0'"),
        (lambda: fmu_plant(unit, outputs=["y0"]), "'y0' is of causality input"),
        (lambda: fmu_plant(unit, start={"u0": 1.0}), "'u0' is of causality output"),
        (lambda: fly(plant, plant.initial, np.zeros((2, 1))), "2 numbers come for 1"),
    }:
        with pytest.raises(ScenarioError, match=told):
            make()
    assert not Path(plant._folder or "/nowhere").exists()
