"""The simulator: failures as values, and what is refused."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest
from flown import NotANumber, Pendulum, Swing, cubesat, pd, scenario

from plants.errors import ScenarioError
from plants.simulation import blocks, simulate
from plants.simulation.simulate import Loop
from plants.surroundings.disturbances import Drag, SolarPressure


@dataclass
class Loose:
    """A plant that could change under way."""

    length: float = 1.0


def test_nan_ends_one_lane_and_leaves_the_neighbour_alone():
    loop = Loop(plant=Pendulum(), controller=NotANumber(limit=10.0))
    sound = simulate.simulate(loop, scenario())
    swung = simulate.simulate(replace(loop, controller=NotANumber(limit=0.5)), scenario(initial=Swing(0.0, 3.0)))
    runs = simulate.simulate_many(
        [
            (loop, scenario()),
            (replace(loop, controller=NotANumber(limit=0.5)), scenario(initial=Swing(0.0, 3.0))),
        ]
    )
    assert [run.ok for run in runs] == [True, False]
    assert [run.culprit for run in runs] == ["", "controller"]
    first = np.argmax(3.0 / np.sqrt(9.81) * np.sin(np.sqrt(9.81) * 0.05 * np.arange(9)) > 0.5)
    assert runs[1].failed_at == pytest.approx(0.05 * first)
    np.testing.assert_allclose(runs[0].outputs, sound.outputs, rtol=0, atol=1e-14)
    for run in (runs[1], swung):
        assert run.failed_at is not None
        assert run.time[-1] < run.failed_at <= run.time[-1] + 0.026
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((run.outputs, run.states, run.inputs)))


@pytest.mark.parametrize("compiled", [True, False])
def test_finite_divergence_meets_the_bound(compiled):
    loop = Loop(plant=Pendulum(), controller=pd(-1e3, 0.0))
    run = simulate.simulate(loop, scenario(bound=100.0), compiled=compiled)
    assert not run.ok
    assert run.culprit == "plant"
    assert run.failed_at is not None
    assert len(run.time) == round(run.failed_at / 0.025)
    assert np.abs(run.outputs).max() <= 100


@pytest.mark.parametrize("compiled", [True, False])
def test_keep_every_and_a_failure_between_rows(compiled):
    loop = Loop(plant=Pendulum(), controller=NotANumber(limit=0.5))
    start = Swing(0.0, 3.0)
    full = simulate.simulate(loop, scenario(initial=start), compiled=compiled)
    thin = simulate.simulate(loop, scenario(initial=start, keep_every=20), compiled=compiled)
    assert 0 < full.failed_at < 1
    assert (thin.failed_at, thin.culprit, len(thin.time)) == (full.failed_at, "controller", 1)


def test_navigator_is_named_when_it_fails_first(surroundings):
    loop, scn = cubesat(surroundings, periods=2)
    broken = replace(loop.navigator, gyro_noise=0.0, deviation=np.zeros(9), torque_noise=0.0, bias_walk=0.0)
    run = simulate.simulate(replace(loop, navigator=broken), scn)
    assert (run.ok, run.culprit, run.failed_at, len(run.time)) == (False, "navigator", 0.0, 0)


def test_classes_with_the_same_fields_are_different_programs():
    """Otherwise `jit` flies one controller for another; it takes luck to see it, so the structures are compared."""

    @dataclass(frozen=True)
    class Other(NotANumber):
        def step(self, s, y, r):
            return s, 0.0 * y[:1]

    blocks.register((NotANumber(1.0), Other(1.0)))
    assert jax.tree.structure(NotANumber(1.0)) == jax.tree.structure(NotANumber(2.0))
    assert jax.tree.structure(NotANumber(1.0)) != jax.tree.structure(Other(1.0))
    sides = np.ones(3), np.zeros(3), 1.0
    assert jax.tree.structure(Drag.create(*sides)) != jax.tree.structure(SolarPressure.create(*sides))
    loop = Loop(plant=Pendulum(), controller=NotANumber(1.0))
    with pytest.raises(ScenarioError, match="run 1 differs from run 0"):
        simulate.simulate_many([(loop, scenario()), (replace(loop, controller=Other(1.0)), scenario())])


BAD = {
    "dt = -0.05": {"dt": -0.05},
    "dt = nan": {"dt": np.nan},
    "dt = 0.0": {"dt": 0.0},
    "periods = 0": {"periods": 0},
    "periods = 2.5": {"periods": 2.5},
    "samples = 0": {"samples": 0},
    "steps = -1": {"steps": -1},
    "bound = 0": {"bound": 0},
    "scenario.initial.rate": {"initial": Swing(1.0, np.nan)},
    "scenario.initial.angle": {"initial": Swing(np.inf, 0.0)},
    "controller.dt = 0.05 differs": {"dt": 0.1},
    r"reference has shape \(3,\)": {"reference": np.zeros(3)},
    "float32": {"initial": Swing(np.float32(1.0), 0.0)},
}


@pytest.mark.parametrize("message", BAD)
def test_bad_scenario_names_the_field(message):
    with pytest.raises(ScenarioError, match=message):
        simulate.simulate(Loop(plant=Pendulum(), controller=pd(1.0, 1.0)), scenario(**BAD[message]))


def test_bad_loop_names_the_field(surroundings):
    with pytest.raises(ScenarioError, match="cases: got none"):
        simulate.simulate_many([])
    with pytest.raises(ScenarioError, match="delay = -1"):
        simulate.simulate(Loop(plant=Pendulum(), controller=pd(1.0, 1.0), delay=-1), scenario())
    with pytest.raises(ScenarioError, match=r"loop\.plant\.length"):
        simulate.simulate(Loop(plant=Pendulum(np.nan), controller=pd(1.0, 1.0)), scenario())
    loop, scn = cubesat(surroundings)
    with pytest.raises(ScenarioError, match="sensors = None"):
        simulate.simulate(replace(loop, sensors=None), scn)
    with pytest.raises(ScenarioError, match="run 1 differs"):
        simulate.simulate_many([(loop, scn), (loop, replace(scn, periods=3))])
    with pytest.raises(ScenarioError, match="frozen"):
        simulate.simulate(Loop(plant=Loose(), controller=pd(1.0, 1.0)), scenario())
