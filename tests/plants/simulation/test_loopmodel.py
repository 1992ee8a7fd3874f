"""Linear models of whole loops: against the simulator itself, noise by noise."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from flown import Linear, Opaque

from plants.errors import ScenarioError
from plants.simulation.loop import Loop, Scenario
from plants.simulation.loopmodel import linear_loop
from plants.simulation.simulate import simulate


@dataclass(frozen=True)
class Pendulum:
    """With a torque of its surroundings, and a clock that no error depends on."""

    stiffness: float

    def derivative(self, x, u, env):
        return Wheel(x.rate, -jnp.sin(self.stiffness * x.angle) + u[0] + env.torque, jnp.ones(()))

    def output(self, x, env):
        return jnp.stack([x.angle, x.rate])

    def project(self, x):
        return x


class Wheel(NamedTuple):
    angle: Any
    rate: Any
    clock: Any


class Air(NamedTuple):
    torque: Any


@dataclass(frozen=True)
class Wind:
    strength: float

    def at(self, t):
        return Air(self.strength * jnp.cos(t))


class Seen(NamedTuple):
    bias: Any
    noise: Any


@dataclass(frozen=True)
class Sensor:
    """Keeps its last noise, so that a record can show it; its bias wanders."""

    noise: float
    walk: float
    channels: int = 3

    def init(self):
        return Seen(jnp.zeros(()), jnp.zeros(3))

    def measure(self, s, x, env, noise, h):
        bias = s.bias + self.walk * jnp.sqrt(h) * noise[2]
        return Seen(bias, noise), jnp.stack([x.angle, x.rate + bias]) + self.noise * noise[:2]


class Filtered(NamedTuple):
    x: Any
    bias: Any
    gain: Any  # that changes with time


@dataclass(frozen=True)
class Observer:
    def init(self):
        return Filtered(jnp.zeros(2), jnp.zeros(()), jnp.ones(()))

    def update(self, s, y, u, env, h):
        x = s.x + h * jnp.stack([s.x[1], -s.x[0] + u[0]])
        gain = 0.2 + 0.8 * (s.gain - 0.2) * jnp.cos(1e-3 * x[0])
        e = y - x - jnp.stack([0.0, s.bias])
        return Filtered(x + gain * e, s.bias + 0.05 * gain * (e[1] - e[0]), gain), x + gain * e


def loop(**changes):
    controller = Linear(np.array([[0.9]]), np.array([[0.1, 0.0]]), np.array([[0.2]]), np.array([[0.5, 1.0]]), 0.2)
    return Loop(**{
        "plant": Pendulum(1.0), "controller": controller, "sensors": Sensor(1e-6, 1e-7), "navigator": Observer(),
        **changes,
    })  # fmt: skip


def scenario(**changes):
    return Scenario(**{
        "initial": Wheel(0.3, 0.0, 0.0), "dt": 0.2, "periods": 60, "samples": 2, "environment": Wind(0.1), **changes
    })  # fmt: skip


def errors(output, estimate, reference):
    return jnp.concatenate([output - reference, (output - estimate)[:1]])


def coordinates(flight, memory, env):
    n = flight.navigator
    moving = [flight.x.angle, flight.x.rate, *n.x, n.bias - flight.sensors.bias, *flight.estimate, *memory]
    return jnp.stack(moving), jnp.stack([flight.x.clock, flight.sensors.bias])


def delayed(flight, memory, env):
    moving, held = coordinates(flight, memory, env)
    return jnp.concatenate([moving, flight.pending.ravel()]), held


def gust(scn, v, k):
    return replace(scn, environment=replace(scn.environment, strength=scn.environment.strength + v[0]))


def seen_noise(x, env, sensors, navigator):
    return sensors.noise


def test_a_flight_with_little_noise_is_the_flight_without_it_and_the_linear_model():
    ours = loop(delay=2)
    still, run = (
        simulate(replace(ours, sensors=sensor), scenario(), record=seen_noise)
        for sensor in (Sensor(0.0, 0.0), ours.sensors)
    )
    model = linear_loop(ours, scenario(), range(60), errors=errors, coordinates=delayed)
    quiet, flown = (np.concatenate([r.outputs, (r.outputs - r.estimates)[:, :1]], axis=1) for r in (still, run))
    np.testing.assert_allclose(model.mean.reshape(-1, 3), quiet, atol=1e-14)
    noise = np.concatenate([run.extra[1:], np.zeros((1, 3))]).reshape(60, 6)  # that of the end of each sample
    a, b, _ = 1e-6 * run.extra[0]  # the first measurement comes before the first period; its gain is 0.84
    z = np.array([0, 0, 0.84 * a, 0.84 * b, 0.05 * 0.84 * (b - a), 0.84 * a, 0.84 * b, 0, 0, 0])
    told = []
    for k in range(60):
        w = np.concatenate([np.zeros(2), noise[k]])
        told.append(model.C[k] @ z + model.D[k] @ w)
        z = model.A[k] @ z + model.B[k] @ w
    size = np.abs(flown - quiet).max()
    assert size > 1e-7
    np.testing.assert_allclose(np.reshape(told, (-1, 3)), flown - quiet, atol=1e-4 * size)


def test_pushes_and_held_numbers_are_inputs():
    pushed = linear_loop(
        loop(), scenario(), [3, 7], errors=errors, coordinates=coordinates, push=gust, pushes=1
    )  # fmt: skip
    assert pushed.A.shape == (2, 8, 8)
    assert pushed.B.shape == (2, 8, 2 + 1 + 6)
    np.testing.assert_allclose(pushed.B[:, :, :2], 0.0, atol=1e-15)  # neither the clock nor a bias that is known shows
    np.testing.assert_allclose(pushed.time, [0.6, 1.4])
    impulse = np.sin(pushed.time + 0.2) - np.sin(pushed.time)
    np.testing.assert_allclose(pushed.B[:, 1, 2], impulse, rtol=0.02)  # of the rate by a push in the cosine of the wind


@pytest.mark.parametrize(("change", "message"), [
    ({"loop": {"sensors": None, "navigator": None}}, "without both"),
    ({"loop": {"controller": Opaque(1.0, 0.2)}}, "cannot be traced"),
    ({"periods": [60]}, "whole numbers from 0 to 59"),
    ({"periods": []}, "whole numbers"),
    ({"periods": [0.5]}, "whole numbers"),
    ({"coordinates": lambda w, memory, env: (jnp.stack([w.x.angle, 2 * w.x.angle]), jnp.zeros(0))}, "depend on each"),
])  # fmt: skip
def test_unusable_cases_are_refused(change, message):
    given = {"periods": [0], "coordinates": coordinates} | {k: v for k, v in change.items() if k != "loop"}
    with pytest.raises(ScenarioError, match=message):
        linear_loop(
            loop(**change.get("loop", {})),
            scenario(),
            given["periods"],
            errors=errors,
            coordinates=given["coordinates"],
        )
