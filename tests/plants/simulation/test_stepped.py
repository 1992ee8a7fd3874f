"""Flights one step after the other: the compiled flight's numbers, and blocks that JAX cannot trace."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest
from flown import Pendulum, Swing, cubesat, pd, scenario

from plants.errors import OpaqueError, ScenarioError
from plants.simulation import simulate
from plants.simulation.campaign import campaign
from plants.simulation.loop import Loop


class Wrapped:
    """Any block in an ordinary class."""

    def __init__(self, block):
        self._block = block

    def __getattr__(self, name):
        if name.startswith("__") or name == "_block":
            raise AttributeError(name)
        return getattr(self._block, name)


class NumPyPendulum:
    """A plant without JAX that writes into its arguments."""

    def __init__(self, length=1.0):
        self.length = length

    def derivative(self, x, u, env):
        rates = np.empty(2)
        rates[0] = x[1]
        rates[1] = -9.81 / self.length * np.sin(x[0]) + u[0]
        x[:] = 0.0
        return rates

    def output(self, x, env):
        return x


def told(x, env, sensors, navigator):
    return x.w


@pytest.fixture(scope="module")
def flown(surroundings):
    """The CubeSat with two samples in a period, two steps in a sample, one period of delay and another reference."""
    loop, scn = cubesat(surroundings, periods=6)
    loop, scn = replace(loop, delay=1), replace(scn, samples=2, steps=2, reference=np.full(6, 1e-3), seed=5, run=3)
    return loop, scn, simulate.simulate(loop, scn, record=told)


def same(a, b, tolerance=1e-9):
    for name in ("time", "states", "outputs", "estimates", "references", "commands", "inputs", "extra"):
        for one, other in zip(*(jax.tree.leaves(getattr(run, name)) for run in (a, b)), strict=True):
            np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance, err_msg=name)
    assert (a.ok, a.failed_at, a.culprit, a.duration) == (b.ok, b.failed_at, b.culprit, b.duration)


@pytest.mark.parametrize("names", [["plant"], ["sensors"], ["navigator"], ["actuator"]])
def test_stepped_flight_is_the_compiled_one(flown, names):
    loop, scn, run = flown
    opaque = replace(loop, **{name: Wrapped(getattr(loop, name)) for name in names if getattr(loop, name) is not None})
    found = simulate.simulate(opaque, scn, record=told)
    same(found, run)
    assert (run.compiled, found.compiled) == (True, False)
    with pytest.raises(OpaqueError, match=f"loop.{names[0]} has type Wrapped"):
        simulate.simulate(opaque, scn, compiled=True)


def test_rows_are_thinned_alike(flown):
    loop, scn, run = flown
    found = simulate.simulate(replace(loop, plant=Wrapped(loop.plant)), replace(scn, keep_every=3))
    np.testing.assert_allclose(found.outputs, run.outputs[::6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.time, run.time[::6])
    assert found.commands.shape == (2, 3)


@dataclass(frozen=True)
class NumPyPd:
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, np.array([3.0 * (r[0] - y[0]) - 1.0 * y[1]])


class Failing:
    """Gives NaN, something beyond the bound, or a mistake, after a while."""

    def __init__(self, what):
        self.what = what

    def advance(self, x, u, t, h):
        if t < 0.3:
            return x + h
        return {"nan": x * np.nan, "far": x + 1e12, "shape": np.zeros(3)}[self.what] if self.what else x.missing

    def output(self, x, env):
        return x


def test_a_plant_in_numpy_may_write_into_what_it_is_given():
    run = simulate.simulate(Loop(plant=Pendulum(), controller=pd(3.0, 1.0)), scenario(initial=Swing(0.4, 0.0)))
    found = simulate.simulate(
        Loop(plant=NumPyPendulum(), controller=pd(3.0, 1.0)), scenario(initial=np.array([0.4, 0.0]))
    )
    np.testing.assert_allclose(found.outputs, run.outputs, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.commands, run.commands, rtol=0, atol=1e-12)


@pytest.mark.parametrize("what", ["nan", "far"])
def test_a_plant_that_fails_is_the_culprit(what):
    run = simulate.simulate(Loop(plant=Failing(what), controller=NumPyPd()), scenario(initial=np.zeros(2)))
    assert (run.ok, run.culprit) == (False, "plant")
    assert run.failed_at == pytest.approx(0.3)
    assert len(run.time) == round(0.3 / 0.025)
    assert np.isfinite(run.outputs).all()


@pytest.mark.parametrize(("what", "told"), [
    ("", "plant: Failing.advance raised AttributeError: .*'missing' at t = 0.3"),
    ("shape", r"plant: Failing.advance returned ndarray of shapes \[\(3,\)\]; the state is ndarray"),
])  # fmt: skip
def test_a_mistake_is_told_with_its_block_and_time(what, told):
    with pytest.raises(ScenarioError, match=told):
        simulate.simulate(Loop(plant=Failing(what), controller=NumPyPd()), scenario(initial=np.zeros(2)))


def case(d, shared):
    return Loop(plant=NumPyPendulum(d), controller=NumPyPd()), scenario(initial=np.array([0.1, 0.0]), periods=4)


def test_campaigns_of_opaque_plants_fly_one_after_the_other():
    lengths = np.linspace(0.8, 1.2, 5)
    flown = campaign(case, lengths, measure=lambda run: run.outputs[-1, 0], progress=False)
    assert not flown.errors
    wanted = [simulate.simulate(*case(length, None)).outputs[-1, 0] for length in lengths]
    np.testing.assert_array_equal(flown.results, wanted)
