"""Flights one step after the other: the compiled flight's numbers, and blocks that JAX cannot trace."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from flown import cubesat

from plants.errors import OpaqueError
from plants.simulation import simulate


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
