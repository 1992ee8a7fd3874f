"""The simulator: a user's plant, both modes, both rates, failures as values, one compilation, bad input."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plants.errors import ScenarioError
from plants.missions import cubesat3u
from plants.simulation import blocks, simulate
from plants.simulation.simulate import Loop, Scenario
from plants.surroundings.disturbances import Drag, SolarPressure

ROUNDING = 1e-12  # compiled against stepped: the same arithmetic in another order, contracted by the loop


class Swing(NamedTuple):
    angle: float
    rate: float


@dataclass(frozen=True)
class Pendulum:
    length: float = 1.0

    def derivative(self, x, u, env):
        return Swing(x.rate, -9.81 / self.length * jnp.sin(x.angle) + u[0])

    def output(self, x, env):
        return jnp.stack([x.angle, x.rate])

    def project(self, x):
        return x


@dataclass
class Loose:
    """A plant that could change under way."""

    length: float = 1.0


@dataclass(frozen=True)
class Linear:
    """A linear controller without JAX, as `synth` hands it over."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float

    def init(self):
        return np.zeros(len(self.A))

    def step(self, x, y, r):
        e = r - y
        return self.A @ x + self.B @ e, self.C @ x + self.D @ e


@dataclass(frozen=True)
class Opaque:
    """A controller that JAX cannot trace."""

    gain: float
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, np.array([self.gain * float(r[0] - y[0])])


@dataclass(frozen=True)
class NotANumber:
    """Gives NaN from a given angle on."""

    limit: float
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, jnp.where(y[:1] > self.limit, jnp.nan, 0.0 * y[:1])


def pd(kp, kd, dt=0.05):
    return Linear(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[kp, kd]]), dt)


def scenario(**changes):
    return replace(Scenario(initial=Swing(1.0, 0.0), dt=0.05, periods=100, samples=2, steps=2), **changes)


def cubesat_pd(dt=cubesat3u.CONTROL_PERIOD, wn=0.17, zeta=0.8):
    """Two states of roll-off on top of the PD law, so that the controller has a memory."""
    I = np.diag(cubesat3u.INERTIA)
    D = np.hstack([2 * wn**2 * I, 2 * zeta * wn * I])
    return Linear(0.5 * np.eye(3), 0.5 * D, np.eye(3) * 0.5, 0.5 * D, dt)


@pytest.fixture(scope="module")
def surroundings():
    return cubesat3u.environment(30.0)


def cubesat(surroundings, controller=None, **changes):
    loop = Loop(
        plant=cubesat3u.body(),
        controller=controller or cubesat_pd(),
        sensors=cubesat3u.suite(),
        navigator=cubesat3u.ekf(),
        actuator=cubesat3u.wheels(),
    )
    scn = Scenario(
        initial=cubesat3u.initial_state(surroundings),
        dt=0.5,
        periods=60,
        samples=5,
        environment=surroundings,
    )
    return loop, replace(scn, **changes)


def test_pendulum_against_an_independent_integrator():
    run = simulate.simulate(Loop(plant=Pendulum(), controller=pd(0.0, 0.0)), scenario(steps=20))
    exact = solve_ivp(
        lambda t, x: [x[1], -9.81 * np.sin(x[0])], (0, 5), [1.0, 0.0], t_eval=run.time, rtol=1e-12, atol=1e-12
    )
    assert run.ok
    assert run.compiled
    np.testing.assert_allclose(run.outputs, exact.y.T, atol=2e-10)
    np.testing.assert_array_equal(run.states.angle, run.outputs[:, 0])


def test_zero_order_hold_against_the_discrete_model():
    """A double integrator under a held command moves by the exact formula; rows are what acted from `time` on."""

    @dataclass(frozen=True)
    class Cart:
        def derivative(self, x, u, env):
            return Swing(x.rate, u[0])

        def output(self, x, env):
            return jnp.stack([x.angle, x.rate])

        def project(self, x):
            return x

    controller = pd(1.0, 1.0, 0.5)
    run = simulate.simulate(Loop(plant=Cart(), controller=controller), scenario(dt=0.5, periods=8, samples=5, steps=1))
    p, v, rows = 1.0, 0.0, []
    for _ in range(8):
        u = -p - v
        for _ in range(5):
            rows.append([p, v, u])
            p, v = p + 0.1 * v + 0.005 * u, v + 0.1 * u
    np.testing.assert_allclose(np.column_stack([run.outputs, run.inputs]), rows, atol=1e-14)
    np.testing.assert_allclose(run.time, 0.1 * np.arange(40), atol=1e-14)


def test_delay_shifts_the_command_by_whole_periods():
    loop = Loop(plant=Pendulum(), controller=pd(5.0, 2.0), delay=3)
    run = simulate.simulate(loop, scenario())
    acted, issued = run.inputs[::2, 0], run.commands[::2, 0]
    np.testing.assert_array_equal(acted[:3], 0)
    np.testing.assert_array_equal(acted[3:], issued[:-3])


def test_reference_per_period():
    reference = np.column_stack([np.linspace(0, 0.3, 100), np.zeros(100)])
    run = simulate.simulate(Loop(plant=Pendulum(), controller=pd(5.0, 2.0)), scenario(reference=reference))
    np.testing.assert_array_equal(run.references, np.repeat(reference, 2, axis=0))
    expected = (reference - run.outputs[::2]) @ np.array([5.0, 2.0])
    np.testing.assert_allclose(run.commands[::2, 0], expected, atol=1e-13)


@pytest.mark.parametrize("compiled", [True, False])
def test_keep_every_thins_the_rows_and_changes_nothing_else(compiled):
    loop = Loop(plant=Pendulum(), controller=pd(5.0, 2.0))
    reference = np.column_stack([np.linspace(0, 0.3, 100), np.zeros(100)])
    full = simulate.simulate(loop, scenario(reference=reference), compiled=compiled)
    thin = simulate.simulate(loop, scenario(reference=reference, keep_every=10), compiled=compiled)
    np.testing.assert_allclose(thin.time, full.time[::20], rtol=0, atol=ROUNDING)
    for name in ("outputs", "estimates", "references", "commands", "inputs"):
        np.testing.assert_allclose(getattr(thin, name), getattr(full, name)[::20], rtol=0, atol=ROUNDING)
    assert simulate.row_bytes(loop, scenario(keep_every=10)) * 20 == simulate.row_bytes(loop, scenario())
    with pytest.raises(ScenarioError, match="keep_every = 7"):
        simulate.simulate(loop, scenario(keep_every=7))


@pytest.mark.parametrize("compiled", [True, False])
def test_keep_every_and_a_failure_between_rows(compiled):
    loop = Loop(plant=Pendulum(), controller=NotANumber(limit=0.5))
    start = Swing(0.0, 3.0)
    full = simulate.simulate(loop, scenario(initial=start), compiled=compiled)
    thin = simulate.simulate(loop, scenario(initial=start, keep_every=20), compiled=compiled)
    assert 0 < full.failed_at < 1
    assert (thin.failed_at, thin.culprit, len(thin.time)) == (full.failed_at, "controller", 1)


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


@pytest.mark.parametrize("compiled", [True, False])
def test_the_controllers_last_state_comes_back(compiled):
    """A counter, as of solves that failed."""

    @dataclass(frozen=True)
    class Counter:
        limit: float = 0.0
        dt: float = 0.05

        def init(self):
            return 0

        def step(self, count, y, r):
            return count + (y[0] > self.limit), 0.0 * y[:1]

    run = simulate.simulate(Loop(plant=Pendulum(), controller=Counter()), scenario(), compiled=compiled)
    assert run.memory == (run.estimates[::2, 0] > 0).sum()
    assert 0 < run.memory < 100


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0, 1])
def test_compiled_equals_stepped_over_the_full_loop(surroundings, delay):
    loop, scn = cubesat(surroundings)
    loop = replace(loop, delay=delay)
    fast = simulate.simulate(loop, scn, compiled=True)
    slow = simulate.simulate(loop, scn, compiled=False)
    assert fast.compiled
    assert not slow.compiled
    for a, b in zip(jax.tree.leaves(fast.states), jax.tree.leaves(slow.states), strict=True):
        np.testing.assert_allclose(a, b, rtol=ROUNDING, atol=ROUNDING)
    for name in ("estimates", "commands", "inputs", "outputs", "references", "time"):
        np.testing.assert_allclose(getattr(fast, name), getattr(slow, name), rtol=0, atol=ROUNDING)


def test_a_controller_that_cannot_be_traced_is_stepped():
    loop = Loop(plant=Pendulum(), controller=Opaque(gain=5.0))
    run = simulate.simulate(loop, scenario())
    assert not run.compiled
    same = simulate.simulate(replace(loop, controller=pd(5.0, 0.0)), scenario())
    np.testing.assert_allclose(run.outputs, same.outputs, atol=ROUNDING)


def test_a_controller_that_insists_on_double_precision_is_compiled():
    @dataclass(frozen=True)
    class Strict:
        gain: float = 5.0
        dt: float = 0.05

        def init(self):
            return ()

        def step(self, s, y, r):
            if jnp.asarray(y, float).dtype != jnp.float64:
                raise TypeError("float32")
            return s, self.gain * (r - y)[:1]

    loop = Loop(plant=Pendulum(), controller=Strict())
    with jax.enable_x64(False):  # as the user's configuration is
        assert simulate.can_compile(loop, scenario())
        assert simulate.simulate(loop, scenario()).compiled


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


def test_navigator_is_named_when_it_fails_first(surroundings):
    loop, scn = cubesat(surroundings, periods=2)
    broken = replace(loop.navigator, gyro_noise=0.0, deviation=np.zeros(9), torque_noise=0.0, bias_walk=0.0)
    run = simulate.simulate(replace(loop, navigator=broken), scn)
    assert (run.ok, run.culprit, run.failed_at, len(run.time)) == (False, "navigator", 0.0, 0)


def test_repeated_calls_compile_once():
    loop = Loop(plant=Pendulum(), controller=pd(3.0, 1.0))
    scn = scenario(periods=7)
    before = simulate._fly._cache_size()
    for kp in (3.0, 4.0, 5.0):
        simulate.simulate(replace(loop, controller=pd(kp, 1.0)), replace(scn, run=int(kp)))
    assert simulate._fly._cache_size() == before + 1
    stepped = simulate._advance._cache_size()
    for kp in (3.0, 4.0):
        simulate.simulate(replace(loop, controller=Opaque(kp)), scn)
    assert simulate._advance._cache_size() == stepped + 1


def test_float64_without_touching_the_flag():
    assert not jax.config.jax_enable_x64
    run = simulate.simulate(Loop(plant=Pendulum(), controller=pd(3.0, 1.0)), scenario())
    assert not jax.config.jax_enable_x64
    assert {leaf.dtype for leaf in jax.tree.leaves((run.states, run.outputs, run.inputs))} == {np.dtype(float)}
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves((run.states, run.outputs)))


@pytest.mark.slow
def test_noise_is_named_by_seed_and_run_alone(surroundings):
    loop, scn = cubesat(surroundings, periods=10)
    alone = simulate.simulate(loop, replace(scn, run=2))
    batch = simulate.simulate_many([(loop, replace(scn, run=i)) for i in range(4)])
    np.testing.assert_allclose(batch[2].estimates, alone.estimates, rtol=0, atol=ROUNDING)
    assert np.abs(batch[1].estimates - alone.estimates).max() > 1e-4
    other = simulate.simulate(loop, replace(scn, run=2, seed=1))
    assert np.abs(other.estimates - alone.estimates).max() > 1e-4


def record_bias(x, env, sensors, navigator):
    return {"bias": sensors, "field": env.B}


@pytest.mark.slow
def test_record_returns_what_it_is_asked_for(surroundings):
    loop, scn = cubesat(surroundings, periods=4)
    run = simulate.simulate(loop, scn, record=record_bias)
    assert run.extra["bias"].shape == run.extra["field"].shape == (20, 3)
    with jax.enable_x64(True):
        np.testing.assert_allclose(run.extra["field"][7], surroundings.at(0.7).B, rtol=1e-12)


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
