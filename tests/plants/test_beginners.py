"""Mistakes of a beginner, one by one: each is told with its field and a remedy, and none in the compiler's language."""

from dataclasses import dataclass
from datetime import datetime
from functools import cache

import jax
import numpy as np
import pytest

import plants
import synth
from plants import Loop, RigidBody, Scenario
from plants.dynamics.rigidbody import BodyState
from synth import LinearController

AXES, JS = np.eye(3), np.full(3, 2.5e-5)
INERTIA = np.diag([0.12, 0.11, 0.05])
FOREIGN = ("Tracer", "jax", "pytree", "leaves[", "eval_shape", "float64[", "broadcast")


@cache
def environment(duration=60.0):
    return plants.Environment.along(plants.circular(500e3, 1.7, 1.0, 0.5), datetime(2026, 3, 20), duration)


def start():
    with jax.enable_x64(True):
        state = plants.state_from(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3), environment().at(0.0))
    return BodyState(*(np.asarray(part) for part in state))


def body():
    return RigidBody.create(INERTIA, wheel_axes=AXES, wheel_inertia=JS)


def control(ny=6, nu=3, dt=1.0):
    return LinearController(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), np.zeros((nu, ny)), dt)


def suite():
    return plants.attitude_suite(sun_noise=1e-3, magnetometer_noise=1e-8, gyro_noise=1e-5)


def loop(**more):
    return Loop(**{"plant": body(), "controller": control(), "actuator": plants.ReactionWheels.create(AXES), **more})


def scenario(**more):
    return Scenario(**{"initial": start(), "dt": 1.0, "periods": 10, "environment": environment(), **more})


def fly(changes=None, compiled=None, **more):
    return plants.simulate(loop(**more), scenario(**(changes or {})), compiled=compiled)


def with_state(**more):
    return {"initial": start()._replace(**more)}


@dataclass(frozen=True)
class NumPySensors:
    channels: int = 3

    def init(self):
        return ()

    def measure(self, s, x, env, noise, h):
        return s, np.array(x.w, float) + np.asarray(noise)


@dataclass(frozen=True)
class Choosing:
    def init(self):
        return ()

    def apply(self, s, command, x):
        return (s, command) if command[0] > 0 else (s, -command)


@dataclass
class Loose:
    gain: float = 1.0

    def init(self):
        return ()

    def apply(self, s, command, x):
        return s, command


@dataclass(frozen=True)
class Forgetful:
    """Sensors that forget to return their state."""

    channels: int = 0

    def init(self):
        return ()

    def measure(self, s, x, env, noise, h):
        return x.w


@dataclass(frozen=True)
class Short:
    """A navigator that estimates three numbers of six."""

    def init(self):
        return ()

    def update(self, s, y, u, env, h):
        return s, y.rate


def design():
    G = synth.c2d(synth.system([[-0.1]], [[1.0]], [[1.0]], [[0.0]]), 1.0)
    return synth.mixsyn(G, synth.system([[0.9]], [[1.0]], [[1.0]], [[0.5]], 1.0), 0.1)


def far(start_at):
    return plants.circular(start_at, 1.7, 1.0, 0.5)


MISTAKES = {
    "sensors without a navigator": (lambda: fly(sensors=suite()), "navigator = None: without it the sensors"),
    "a navigator without sensors": (lambda: fly(navigator=plants.svd_navigator(suite())), "sensors = None: without"),
    "a quaternion of length two": (lambda: fly(with_state(q=np.array([2.0, 0, 0, 0]))), "initial.q has length 2:"),
    "a quaternion of three": (lambda: fly(with_state(q=np.zeros(3))), r"initial.q has shape \(3,\); give \(4,\)"),
    "four speeds for three wheels": (lambda: fly(with_state(wheels=np.zeros(4))), "initial.wheels .*body has 3 wheels"),
    "a rate that is NaN": (lambda: fly(with_state(w=np.full(3, np.nan))), "scenario.initial.w = .* not finite"),
    "an array for a state": (lambda: fly({"initial": np.zeros(10)}), r"initial is a ndarray: .* BodyState\(q, w"),
    "no initial state": (lambda: fly({"initial": None}), "initial is a NoneType"),
    "a flight longer than its environment": (lambda: fly({"periods": 90}), "environment lasts 60 s, the flight 90 s"),
    "no environment": (lambda: fly({"environment": None}), "environment = None: RigidBody needs surroundings"),
    "an orbit for an environment": (lambda: fly({"environment": far(500e3)}), "scenario.environment = Orbit has no at"),
    "no controller": (lambda: fly(controller=None), "controller = NoneType has no init and no step"),
    "a gain for a controller": (lambda: fly(controller=np.eye(3)), "controller = ndarray has no init.*synth"),
    "a class for a controller": (lambda: fly(controller=LinearController), "controller = LinearController is a class"),
    "a controller of another period": (lambda: fly(controller=control(dt=0.5)), "controller.dt = 0.5 differs"),
    "a controller of three inputs": (lambda: fly(controller=control(ny=3)), "LinearController.step raised"),
    "a controller of two outputs": (lambda: fly(controller=control(nu=2)), "ReactionWheels does not take a command of"),
    "a design that fits nothing here": (lambda: fly(controller=design()), "LinearController.step raised"),
    "NumPy inside sensors": (
        lambda: fly(sensors=NumPySensors(), navigator=plants.svd_navigator(suite()), compiled=True),
        "sensors: NumPySensors.measure line .* of test_beginners.py needs plain numbers .*jax.numpy",
    ),
    "if inside an actuator": (
        lambda: fly(actuator=Choosing(), compiled=True), "Choosing.apply: line .* of test_beginners.py .*where"
    ),
    "a mutable dataclass": (
        lambda: fly(actuator=Loose(), compiled=True), "Loose is a mutable dataclass: declare it with frozen=True"
    ),
    "an object for an actuator": (lambda: fly(actuator=object()), "loop.actuator has type object: make it a frozen"),
    "sensors that forget their state": (
        lambda: fly(sensors=Forgetful(), navigator=plants.svd_navigator(suite())),
        "sensors: Forgetful.measure .* return \\(state,",
    ),
    "a navigator of three numbers": (
        lambda: fly(sensors=suite(), navigator=Short()), r"Short.update returns an estimate of shape \(3,\)"
    ),
    "a navigator for other sensors": (
        lambda: fly(sensors=plants.AngleRateSuite(angle_noise=0.0, rate_noise=0.0), navigator=Short()),
        "sensors: AngleRateSuite.measure AttributeError: .*angles",
    ),
    "a reference of three numbers": (lambda: fly({"reference": np.zeros(3)}), "reference has shape .* as many columns"),
    "half a period": (lambda: fly({"periods": 1.5}), "periods = 1.5: give a whole number"),
    "no samples": (lambda: fly({"samples": 0}), "samples = 0"),
    "a period in words": (lambda: fly({"dt": "1 s"}), "dt = '1 s': give a positive finite number"),
    "a body of one moment too many": (lambda: RigidBody.create(np.eye(4)), "inertia must have shape"),
    "an inertia that is not symmetric": (lambda: RigidBody.create(INERTIA + np.eye(3, k=1)), "inertia must be sym"),
    "wheels without an inertia": (lambda: RigidBody.create(INERTIA, wheel_axes=AXES), "come together"),
    "axes of length two": (
        lambda: RigidBody.create(INERTIA, wheel_axes=2 * AXES, wheel_inertia=JS), "wheel_axes must be unit columns"
    ),
    "a negative torque limit": (lambda: plants.ReactionWheels.create(AXES, torque_limit=-1.0), "torque_limit must"),
    "two wheels in a plane": (lambda: plants.ReactionWheels.create(np.eye(3)[:, :2]), "axes must span space"),
    "a noise below zero": (
        lambda: plants.attitude_suite(sun_noise=-1.0, magnetometer_noise=0.0, gyro_noise=0.0), "sun_noise must"
    ),
    "an orbit inside the Earth": (
        lambda: plants.Environment.along(far(-1e6), datetime(2026, 3, 20), 60.0), "altitude|inside the Earth|below"
    ),
    "an epoch in words": (lambda: plants.Environment.along(far(5e5), "2026-03-20", 60.0), "epoch = .*give a datetime"),
    "a date before the leap seconds": (lambda: plants.Environment.along(far(5e5), datetime(1960, 1, 1), 60.0), "1960"),
    "a negative duration": (lambda: plants.Environment.along(far(5e5), datetime(2026, 3, 20), -1.0), "duration"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_told_with_its_field_and_a_remedy(mistake):
    make, told = MISTAKES[mistake]
    with pytest.raises(plants.PlantError, match=told) as caught:
        make()
    text = str(caught.value)
    assert not [word for word in FOREIGN if word in text.replace("jax.numpy", "").replace("jnp", "")]
    assert len(text) < 400
    assert "\n" not in text


def test_what_looks_like_a_mistake_and_is_none():
    """Lists in a state, a design as a controller, wheels as integers."""
    x = start()
    listed = {"initial": x._replace(w=x.w.tolist(), wheels=[0, 0, 0])}
    run = fly(listed)
    assert run.ok
    np.testing.assert_array_equal(run.states.q, fly().states.q)
    for actuator in (Choosing(), Loose()):  # stepped
        flown = fly(actuator=actuator)
        assert flown.ok
        assert not flown.compiled
    K = design()
    assert isinstance(Loop(plant=body(), controller=K).controller, LinearController)
