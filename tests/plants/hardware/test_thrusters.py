"""Thrusters: limits, whole pulses, and no impulse lost."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.errors import ScenarioError
from plants.hardware.thrusters import PulsedThrusters, Thrusters

PULSED = PulsedThrusters.create(1000.0, 1.0, shortest=0.1, period=60.0)
BIT = 1e-3 / 600  # m/s^2: 0.1 N s on 1000 kg, spread over 60 s


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def fire(thrusters, commands):
    state, fired = thrusters.init(), []
    for command in commands:
        state, u = thrusters.apply(state, command, None)
        fired.append(np.asarray(u))
    return np.array(fired), np.asarray(state)


def test_saturation_axis_by_axis():
    fired, _ = fire(Thrusters.create(1000.0, 100.0), [np.array([0.05, -0.3, 0.2])])
    np.testing.assert_allclose(fired[0], [0.05, -0.1, 0.1])
    fired, _ = fire(Thrusters.create(1000.0, np.inf), [np.array([5.0, -3.0, 0.2])])
    np.testing.assert_array_equal(fired[0], [5.0, -3.0, 0.2])


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(*3 * [st.floats(-3e-3, 3e-3)]), min_size=1, max_size=8))
def test_pulses_are_whole_limited_and_lose_nothing(commands):
    with jax.enable_x64(True):
        fired, _ = fire(PULSED, np.array(commands))
    pulses = fired / BIT
    np.testing.assert_allclose(pulses, np.round(pulses), atol=1e-9)
    assert np.abs(fired).max() <= 1e-3 * (1 + 1e-12)
    asked = np.cumsum(np.clip(commands, -1e-3, 1e-3), axis=0)
    assert np.abs(np.cumsum(fired, axis=0) - asked).max() <= BIT / 2 * (1 + 1e-9)


def test_a_command_below_the_bit_is_given_in_the_mean():
    fired, _ = fire(PULSED, np.full((200, 3), 0.03 * BIT))
    assert (fired == 0).mean() == pytest.approx(0.97)
    np.testing.assert_allclose(fired.sum(axis=0), 6 * BIT)


@pytest.mark.parametrize(
    ("kind", "numbers", "field"),
    [
        (Thrusters.create, {"mass": 0.0, "force": 1.0}, "mass"),
        (Thrusters.create, {"mass": 1.0, "force": -1.0}, "force"),
        (PulsedThrusters.create, {"mass": 1.0, "force": np.inf, "shortest": 0.1, "period": 1.0}, "force"),
        (PulsedThrusters.create, {"mass": 1.0, "force": 1.0, "shortest": 0.0, "period": 1.0}, "shortest"),
        (PulsedThrusters.create, {"mass": 1.0, "force": 1.0, "shortest": 0.7, "period": 1.0}, "whole number"),
        (PulsedThrusters.create, {"mass": 1.0, "force": 1.0, "shortest": 2.0, "period": 1.0}, "whole number"),
    ],
)
def test_bad_numbers(kind, numbers, field):
    with pytest.raises(ScenarioError, match=field):
        kind(**numbers)
