"""Modes in one flight: what ends them, whom they trust, and no bump between them."""

from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.guidance.conditions import After, Pointed, Slow
from plants.guidance.directions import ToEarth, ToSun
from plants.guidance.frames import Nadir, Offset, Pointing
from plants.guidance.guided import Guided
from plants.guidance.laws import AttitudeControl
from plants.guidance.modes import mode
from plants.guidance.sequences import commanded_record, sequence
from plants.hardware.actuators import ReactionWheels
from plants.simulation.loop import Loop, Scenario
from plants.simulation.simulate import simulate
from plants.surroundings.environment import Environment
from plants.surroundings.orbit import circular

DEG = np.pi / 180
INERTIA = np.diag([0.12, 0.11, 0.05])
JS = np.full(3, 2.5e-5)


class Reading(NamedTuple):
    q: Any
    w: Any
    field: Any
    wheels: Any


@dataclass(frozen=True)
class Truth:
    """Sensors without an error."""

    channels: int = 0

    def init(self):
        return ()

    def measure(self, s, x, env, noise, h):
        return s, Reading(x.q, x.w, attitude.rotate(x.q, env.B), x.wheels)


@dataclass(frozen=True)
class Straight:
    """The output from what is measured, turned about x by an angle to tell two navigators apart."""

    tilt: float = 0.0

    def init(self):
        return ()

    def update(self, s, y, u, env, h):
        tilted = attitude.compose(attitude.from_vector(jnp.array([self.tilt, 0.0, 0.0])), y.q)
        off = attitude.compose(tilted, attitude.conjugate(env.q_ON))
        return s, jnp.concatenate([attitude.positive(off)[1:], y.w - attitude.rotate(off, env.w_ON)])


@dataclass(frozen=True)
class Pd:
    """Torque -J (w0^2 2 q + 2 z w0 w)."""

    bandwidth: float = 0.1  # rad/s
    dt: float = 1.0

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, -INERTIA @ (2 * self.bandwidth**2 * y[:3] + 1.6 * self.bandwidth * y[3:])


@dataclass(frozen=True)
class Opaque:
    """As `Pd`, in NumPy only, so that it must be stepped."""

    dt: float = 1.0

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, Pd().step(s, np.array(y.tolist()), r)[1]


EPOCH = datetime(2026, 3, 20, 6)
LIMITS = {"max_rate": 0.5 * DEG, "max_acceleration": 0.005 * DEG}


@pytest.fixture(scope="module")
def environment():
    return Environment.along(circular(500e3, 97.4 * DEG, 1.0, 0.5), EPOCH, 3000.0)


def modes(law):
    sun = Pointing.create([0, 0, -1.0], ToSun(), second_axis=[1.0, 0, 0], second_to=ToEarth())
    return [
        mode("damp", law, until=Slow.create(0.1 * DEG, hold=20.0), navigator=1, guidance=Nadir(), **LIMITS),
        mode("nadir", law, until=Pointed.create(0.5 * DEG, rate=0.02 * DEG), **LIMITS),
        mode("wait", law, until=After.create(200.0)),
        mode("sun", law, guidance=sun, **LIMITS),
    ]


def flown(environment, law, **options):
    made = sequence(
        modes(law), dt=1.0, navigators=[Straight(), Straight(0.3 * DEG)], wheel_axes=np.eye(3), wheel_inertia=JS,
        magnetorquers=False,
    )  # fmt: skip
    loop = Loop(
        plant=RigidBody.create(INERTIA, wheel_axes=np.eye(3), wheel_inertia=JS),
        sensors=Truth(),
        navigator=made.navigator,
        controller=made.controller,
        actuator=ReactionWheels.create(np.eye(3), torque_limit=3e-3),
    )
    q = np.array([0.5, -0.5, 0.5, 0.5])
    start = BodyState(q=q, w=np.array([1.0, -0.8, 0.5]) * DEG, wheels=np.zeros(3))
    scenario = Scenario(initial=start, dt=1.0, periods=2000, samples=1, environment=environment)
    return made, simulate(loop, scenario, record=commanded_record, **options)


@pytest.fixture(scope="module")
def flight(environment):
    return flown(environment, AttitudeControl(controller=Pd()))


def test_the_modes_follow_each_other(flight):
    made, run = flight
    assert run.ok
    assert run.compiled
    order = run.extra.mode[np.flatnonzero(np.diff(run.extra.mode, prepend=-1))]
    assert [made.names[i] for i in order] == ["damp", "nadir", "wait", "sun"]
    changes = run.time[np.flatnonzero(np.diff(run.extra.mode)) + 1]
    assert changes[2] - changes[1] == 200.0  # After
    spin = np.linalg.norm(run.states.w, axis=1)
    slow = run.time <= changes[0]
    assert (spin[slow][-21:] < 0.1 * DEG).all()
    assert spin[slow][-22] >= 0.1 * DEG  # not later than its condition says


def left(w):
    """Error (rad) that a PD controller leaves where the body has to turn the momentum of this flight at the rate w."""
    momentum = np.linalg.norm(INERTIA @ [1.0, -0.8, 0.5]) * DEG
    return np.linalg.norm(w) * momentum / (INERTIA.diagonal().min() * Pd().bandwidth ** 2)


def test_each_mode_ends_up_where_it_should(flight):
    _, run = flight
    for index, angle in ((1, 0.5 * DEG), (3, left(run.extra.w[-1]))):  # the first leaves as soon as it is `Pointed`
        last = np.flatnonzero(run.extra.mode == index)[-1]
        assert 2 * np.linalg.norm(run.extra.error[last, :3]) < angle
    tilted = np.flatnonzero(run.extra.mode == 0)[-1]  # the first mode trusts the navigator that is off about x
    np.testing.assert_allclose(2 * run.extra.error[tilted, 0] / DEG, -0.3, atol=0.1)


def test_the_estimate_of_a_run_is_that_of_its_output(flight):
    _, run = flight
    assert run.estimates.shape == run.outputs.shape
    later = run.extra.mode > 0
    np.testing.assert_allclose(run.estimates[later], run.outputs[later], atol=1e-12)


def test_no_bump_when_modes_change(flight):
    _, run = flight
    jumps = np.abs(np.diff(run.commands, axis=0)).max(axis=1)
    at = np.flatnonzero(np.diff(run.extra.mode))
    slewing = [k for k in at if run.extra.mode[k + 1] in (1, 3)]
    # a law of its own would answer the error of 80 deg to the Sun with 4 mN m at once
    assert jumps[slewing].max() < 1e-4
    assert jumps.max() < 2e-4


def test_the_commanded_frame_moves_within_its_limits(flight):
    _, run = flight
    sun = run.extra.mode == 3
    orbital = 1.3e-3  # rad/s, what the frame itself turns by
    assert np.linalg.norm(run.extra.w[sun], axis=1).max() < 0.5 * DEG + orbital
    lag = LIMITS["max_acceleration"] / Pd().bandwidth ** 2  # of a controller that is not told the acceleration
    following = 2 * np.linalg.norm(run.extra.error[sun, :3], axis=1).max()
    assert following < left(np.array([0.5 * DEG + orbital])) + lag


def test_stepped_from_python_it_is_the_same_flight(environment, flight):
    _, stepped = flown(environment, AttitudeControl(controller=Opaque()))
    assert not stepped.compiled
    np.testing.assert_array_equal(stepped.extra.mode, flight[1].extra.mode)
    np.testing.assert_allclose(stepped.states.q, flight[1].states.q, atol=1e-9)


def test_an_offset_of_170_deg_is_tracked(environment):
    """Finding of the physics review: with vector parts subtracted this never settled, in silence."""
    turn = np.array([np.cos(85 * DEG), np.sin(85 * DEG), 0.0, 0.0])
    loop = Loop(
        plant=RigidBody.create(INERTIA, wheel_axes=np.eye(3), wheel_inertia=JS), controller=Pd(),
        actuator=ReactionWheels.create(np.eye(3), torque_limit=3e-3),
    )  # fmt: skip
    with_reference = simulate(loop, start_at_nadir(environment, reference=np.concatenate([turn[1:], np.zeros(3)])))
    guided = Guided(environment=environment, guidance=Offset.create(turn, Nadir()))
    scenario = start_at_nadir(environment)
    in_frame = simulate(loop, Scenario(**{**vars(scenario), "environment": guided}))
    end = with_reference.outputs[-1]
    assert 2 * np.linalg.norm(np.cross(end[:3], [1, 0, 0])) < 0.1 * DEG
    np.testing.assert_allclose(end[0], np.sin(85 * DEG), atol=1e-3)
    assert 2 * np.linalg.norm(in_frame.outputs[-1, :3]) < 0.1 * DEG
    np.testing.assert_allclose(in_frame.states.q, with_reference.states.q, atol=1e-9)


def start_at_nadir(environment, **more):
    with jax.enable_x64(True):
        start = state_from(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3), environment.at(0.0))
    start = BodyState(*(np.asarray(part) for part in start))
    return Scenario(initial=start, dt=1.0, periods=600, environment=environment, **more)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda law: sequence([], dt=1.0, navigators=[], wheel_axes=np.eye(3), wheel_inertia=JS), "modes = .*at least"),
        (lambda law: several([mode("a", law), mode("a", law)]), "a name of its own"),
        (lambda law: several([mode("a", law, then="b")]), "then = 'b' of mode 'a' is no mode"),
        (lambda law: several([mode("a", law, navigator=1)]), "navigator = 1 of mode 'a': there are 1"),
        (lambda law: several([mode("a", law)], wheel_inertia=np.ones(4)), "wheel_inertia must have shape"),
        (lambda law: several([mode("a", law)], dt=0.5), "law of mode 'a' has dt = 1.0, the sequence 0.5"),
        (lambda law: mode("a", law, max_rate=1.0), "max_rate and max_acceleration of mode 'a'"),
        (lambda law: mode("a", law, max_rate=-1.0, max_acceleration=1.0), "max_rate must be positive"),
    ],
)
def test_mistakes_are_named(make, told):
    with pytest.raises(ScenarioError, match=told):
        make(AttitudeControl(controller=Pd()))


def several(given, **more):
    options = {"dt": 1.0, "navigators": [Straight()], "wheel_axes": np.eye(3), "wheel_inertia": JS, **more}
    return sequence(given, **options)
