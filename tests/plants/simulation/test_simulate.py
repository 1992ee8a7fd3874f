"""The simulator: a user's plant, both modes, both rates, one compilation."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flown import Opaque, Pendulum, Swing, cubesat, pd, scenario
from scipy.integrate import solve_ivp

from plants.errors import ScenarioError
from plants.simulation import programs, simulate
from plants.simulation.simulate import Loop

ROUNDING = 1e-12  # compiled against stepped: the same arithmetic in another order, contracted by the loop


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


def test_a_long_session_keeps_some_programs_and_flies_the_same_again(monkeypatch):
    """All of them would end the process: a flight with a filter takes 850 of the 65530 memory maps of Linux."""
    monkeypatch.setattr(programs, "KEPT", 4)
    loop = Loop(plant=Pendulum(), controller=pd(3.0, 1.0))
    kept, first = [], simulate.simulate(loop, scenario(periods=4))
    for periods in range(5, 12):
        simulate.simulate(loop, scenario(periods=periods))
        simulate.simulate(replace(loop, controller=Opaque(3.0)), scenario(periods=periods))
        kept.append(sum(f._cache_size() for f in (simulate._fly, simulate._launch, simulate._advance)))
    assert max(kept) <= 5  # a stepped flight has two
    again = simulate.simulate(loop, scenario(periods=4))
    np.testing.assert_array_equal(again.outputs, first.outputs)


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
