"""Reaction wheels: distribution, limits, and what they do to a body."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest

from plants.dynamics.rigidbody import BodyState, RigidBody
from plants.errors import ScenarioError
from plants.hardware.actuators import ReactionWheels
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings.environment import FreeSpace

PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)


@dataclass(frozen=True, kw_only=True)
class Held:
    """A controller that always asks for the same."""

    dt: float
    command: np.ndarray

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, self.command


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def state(wheels):
    return BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), np.asarray(wheels, float))


@pytest.mark.parametrize("axes", [np.eye(3), PYRAMID])
def test_ideal_wheels_give_the_body_the_torque_asked_for(axes):
    wheels, command = ReactionWheels.create(axes), np.array([1e-3, -2e-3, 5.0])
    s, u = wheels.apply(wheels.init(), command, state(np.full(axes.shape[1], 1e4)))
    assert s == wheels.init()
    np.testing.assert_allclose(-axes @ u, command, rtol=0, atol=1e-14)


def test_torque_on_the_body_is_the_command_to_first_order_in_the_rotors():
    """At rest, I dw = command (I + O(Js))."""
    spin = 1e-9
    body = RigidBody.create(np.diag([0.05, 0.06, 0.07]), wheel_axes=PYRAMID, wheel_inertia=np.full(4, spin))
    command = np.array([1e-3, -2e-3, 5e-4])
    _, u = ReactionWheels.create(PYRAMID).apply((), command, state(np.zeros(4)))
    rate = body.derivative(state(np.zeros(4)), u, FreeSpace().at(0.0))
    np.testing.assert_allclose(np.diag([0.05, 0.06, 0.07]) @ rate.w, command, rtol=1e-6)


def test_every_motor_saturates_by_itself():
    wheels = ReactionWheels.create(np.eye(3), torque_limit=1e-3)
    _, u = wheels.apply((), np.array([5e-3, -2e-4, -1.0]), state([0, 0, 0]))
    np.testing.assert_allclose(u, [-1e-3, 2e-4, 1e-3], rtol=1e-12)


def test_at_the_speed_limit_only_the_torque_that_slows_down_is_left():
    wheels = ReactionWheels.create(np.eye(3), speed_limit=600.0)
    ask = np.array([1.0, 1.0, 1.0])  # on the body: -1 on every wheel
    for speeds, expected in (
        ([599.0, -599.0, 0.0], [-1, -1, -1]),
        ([600.0, -600.0, -700.0], [-1, 0, 0]),
        ([-600.0, 600.0, 700.0], [0, -1, -1]),
    ):
        _, u = wheels.apply((), ask, state(speeds))
        np.testing.assert_array_equal(u, expected)


def test_speeds_of_other_wheels_are_named_before_the_flight():
    """Through the simulator: four speeds for three wheels, and wheels that the plant has not."""
    body = RigidBody.create([0.05, 0.06, 0.07], wheel_axes=np.eye(3), wheel_inertia=np.full(3, 1e-5))
    for axes, speeds, message in (
        (np.eye(3), np.zeros(4), r"wheels.* has shape \(4,\).* give \(3,\)"),
        (PYRAMID, np.zeros(4), r"wheels.* has shape \(4,\).* give \(3,\)"),
        (PYRAMID, np.zeros(3), r"wheels.* has shape \(3,\).* give \(4,\)"),
    ):
        loop = Loop(plant=body, actuator=ReactionWheels.create(axes), controller=Held(dt=1.0, command=np.zeros(3)))
        with pytest.raises(ScenarioError, match=message):
            simulate(loop, Scenario(initial=state(speeds), dt=1.0, periods=1, environment=FreeSpace()))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"torque_limit": -1.0}, "torque_limit must be positive"),
        ({"torque_limit": 0.0}, "torque_limit must be positive"),
        ({"speed_limit": np.nan}, "speed_limit must be finite"),
        ({"speed_limit": [1.0, 2.0]}, "speed_limit must have shape"),
        ({"axes": np.eye(3)[:, :2]}, "axes must span space"),
        ({"axes": np.ones(3)}, "axes must have shape"),
    ],
)
def test_bad_numbers_are_refused(arguments, message):
    with pytest.raises(ScenarioError, match=message):
        ReactionWheels.create(**{"axes": np.eye(3)} | arguments)
