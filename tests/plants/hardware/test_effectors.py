"""Magnetorquers, moment gyroscopes, and everything at once: from a command to what the satellite feels."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.dynamics.cmgs import Cmgs
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.attitudethrusters import AttitudeThrusters, Pwm
from plants.hardware.cmgsteering import CmgSteering
from plants.hardware.effectors import equip
from plants.hardware.magnetorquers import Magnetorquers
from plants.hardware.wheels import Wheel
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings.environment import FreeSpace

PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)
REST = np.array([1.0, 0, 0, 0])


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@dataclass(frozen=True, kw_only=True)
class Held:
    """A controller that always asks for the same."""

    dt: float
    command: np.ndarray

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, self.command


@dataclass(frozen=True)
class Field:
    """Free space with a magnetic field."""

    def at(self, t):
        return FreeSpace().at(t)._replace(B=jnp.array([2e-5, -1e-5, 3e-5]))


def wheels(**changes):
    sheet = {"max_torque": 2e-3, "max_momentum": 15e-3, "max_speed_rpm": 6000.0} | changes
    return [Wheel.create(axis, **sheet) for axis in PYRAMID.T]


def pairs(modulator=None, force=0.1):
    """Twelve thrusters in couples about the three axes, levers of 0.5 m."""
    positions, directions = [], []
    for axis in range(3):
        arm, push = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sense in (1, -1):
            positions += [0.5 * arm, -0.5 * arm]
            directions += [sense * push, -sense * push]
    return AttitudeThrusters.create(
        np.array(positions).T, np.array(directions).T, force=force, modulator=modulator or Pwm.create(shortest=0.01)
    )


vectors = st.tuples(*3 * [st.floats(-1, 1)]).map(np.array)


@settings(max_examples=40, deadline=None)
@given(vectors, vectors, st.sampled_from([1e-3, 1.0, 100.0]), st.booleans())
def test_dipole_within_limits_keeps_its_direction_and_its_torque_is_across_the_field(ask, B, unit, coarse):
    coils = Magnetorquers.create(max_dipole=0.4 * unit, step=0.05 * unit if coarse else 0.0)
    with jax.enable_x64(True):
        m = np.asarray(coils.apply((), unit * ask, None)[1])
    assert (np.abs(m) <= 0.4 * unit * (1 + 1e-12)).all()
    expected = unit * ask * min(1.0, 0.4 / max(np.abs(ask).max(), 1e-12))
    np.testing.assert_allclose(m, expected, rtol=0, atol=(0.025 if coarse else 1e-12) * unit * (1 + 1e-9))
    torque = np.cross(m, B)
    assert abs(torque @ B) <= 1e-12 * np.linalg.norm(m) * (B @ B)


def test_remanence_is_along_the_rods_and_what_they_do_not_span_is_lost():
    coils = Magnetorquers.create(np.eye(3)[:, :2], max_dipole=1.0, residual=[0.01, -0.02])
    np.testing.assert_allclose(coils.apply((), np.array([0.5, 0.2, 0.9]), None)[1], [0.51, 0.18, 0.0])
    four = Magnetorquers.create(PYRAMID, max_dipole=[1.0, 2, 3, 4])
    m = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(four.apply((), m, None)[1], m, rtol=1e-12)


def at(gimbals):
    return type("State", (), {"gimbals": np.asarray(gimbals, float)})()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1.0, 500.0]))
def test_steering_is_exact_away_from_singularities_and_bounded_everywhere(seed, momentum):
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        cluster = Cmgs.pyramid(momentum=momentum)
        steering = CmgSteering.create(cluster, max_rate=np.inf)
        d, torque = rng.uniform(-np.pi, np.pi, 4), momentum * rng.normal(size=3)
        rates = np.asarray(steering.apply((), torque, at(d))[1])
        J, w = np.asarray(cluster.jacobian(d)), float(cluster.singularity(d)) / momentum**3
    given_torque = -J @ rates
    if w >= 0.3:
        np.testing.assert_allclose(given_torque, torque, rtol=0, atol=1e-10 * np.linalg.norm(torque))
    lack = max(1 - w / 0.3, 0.0)  # rates of J'(J J' + a)^-1 are at most 1 / (2 sqrt a), the exact ones 1 / s
    least = np.linalg.svd(J / momentum, compute_uv=False)[-1]
    most = min(1 / max(least, 1e-300), 1 / max(2 * lack * np.sqrt(0.1), 1e-300))
    assert np.linalg.norm(rates) <= most * np.linalg.norm(torque) / momentum * (1 + 1e-9)


def test_rates_are_bounded_exactly_at_a_singularity_and_within_the_limit():
    """All momenta as far as they go along x: no torque about x; rates stay those of the damped inverse."""
    cluster = Cmgs.pyramid(momentum=1.0)
    d = np.arctan2(*(np.asarray(part)[0] for part in (cluster._sides(), jnp.asarray(cluster.spins))))
    assert float(cluster.singularity(d)) < 1e-12
    free, limited = CmgSteering.create(cluster, max_rate=np.inf), CmgSteering.create(cluster, max_rate=0.2)
    rates = np.asarray(free.apply((), np.array([0.1, 0.5, -0.2]), at(d))[1])
    assert np.linalg.norm(rates) < np.linalg.norm([0.1, 0.5, -0.2]) / (2 * np.sqrt(0.1))
    bounded = np.asarray(limited.apply((), np.array([1.0, 5, -2]), at(d))[1])
    assert np.abs(bounded).max() == pytest.approx(0.2, rel=1e-12)
    np.testing.assert_allclose(bounded / np.linalg.norm(bounded), rates / np.linalg.norm(rates), rtol=1e-9, atol=1e-12)


def test_gyroscopes_turn_the_body_and_the_momentum_is_kept():
    """A slew at rest to rest: the torque is what is asked for, less the gyroscopic one."""
    cluster = Cmgs.pyramid(momentum=1.0)
    plant, actuator = equip([10.0, 12, 8], cmgs=CmgSteering.create(cluster, max_rate=1.0))
    loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=0.1, command=np.array([0.02, -0.01, 0.01])))
    start = plant.state(REST, np.zeros(3), FreeSpace())
    run = simulate(loop, Scenario(initial=start, dt=0.1, periods=300, steps=2, environment=FreeSpace()))
    x = run.states
    total = np.asarray(jax.vmap(lambda x: attitude.rotate(attitude.conjugate(x.q), plant.momentum(x)))(x))
    assert np.abs(total - total[0]).max() < 1e-9
    np.testing.assert_allclose(run.states.w[10], [0.002, -0.01 / 12, 0.01 / 8], rtol=0.02)
    assert np.linalg.norm(run.states.w[-1]) > 0.05


def test_everything_at_once():
    """Wheels take the torque, coils the dipole moment, thrusters what the wheels cannot give."""
    thrusters = pairs()
    plant, actuator = equip(
        [0.1, 0.12, 0.05], wheels=wheels(), magnetorquers=Magnetorquers.create(max_dipole=0.5), thrusters=thrusters
    )
    assert (actuator.sizes, plant.sizes) == ((3, 3), (4, 0, 3, 3))
    x = plant.state(REST, np.zeros(3), FreeSpace())
    small, large, dipole = np.array([1e-3, 0, 0]), np.array([30e-3, 0, 0]), np.array([0.1, 0.2, -0.3])
    for torque in (small, large):
        s, u = actuator.apply(actuator.init(), np.concatenate([torque, dipole]), x, np.zeros(actuator.channels), 1.0)
        parts = plant.split(u)
        body = -PYRAMID @ parts.motors + parts.torque
        np.testing.assert_allclose(body, torque, rtol=0, atol=1e-15)
        np.testing.assert_allclose(parts.dipole, dipole, rtol=1e-12)
        assert (np.linalg.norm(parts.torque) > 0) == (torque is large)
    spent = np.linalg.norm(parts.torque) / 0.5  # N s in a second, levers of 0.5 m
    assert float(np.sum(s.thrusters.impulse)) == pytest.approx(spent, rel=1e-12)
    dw = plant.derivative(x, u, Field().at(0.0)).w
    np.testing.assert_allclose(dw, plant.body.inverse @ (body + np.cross(dipole, Field().at(0.0).B)), rtol=1e-12)


def test_everything_flies():
    plant, actuator = equip(
        [0.1, 0.12, 0.05],
        wheels=wheels(torque_noise=1e-8, torque_step=1e-7, viscous=1e-9, coulomb=1e-6, dynamic_imbalance_g_cm2=0.1),
        magnetorquers=Magnetorquers.create(max_dipole=0.5),
        thrusters=pairs(),
        wanted_speeds=[100, 100, -100, -100],
        null_rate=0.05,
    )
    command = np.concatenate([[1e-5, 0, 2e-5], [0.1, 0.2, -0.3]])
    loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=1.0, command=command))
    start = plant.state(REST, np.zeros(3), Field())
    run = simulate(loop, Scenario(initial=start, dt=1.0, periods=2, samples=2000, environment=Field()))
    assert run.ok
    assert run.compiled
    assert np.abs(run.inputs[:, :4]).min() > 0
    np.testing.assert_array_equal(run.inputs[:, 7:], 0)


def test_only_coils():
    plant, actuator = equip([0.1, 0.12, 0.05], magnetorquers=Magnetorquers.create(max_dipole=0.5))
    dipole = np.array([0.1, 0.2, -0.3])
    _, u = actuator.apply(actuator.init(), np.concatenate([np.zeros(3), dipole]), None, np.zeros(1), 1.0)
    np.testing.assert_allclose(u, dipole)
    assert plant.sizes == (0, 0, 3, 0)


STEERING = CmgSteering.create(Cmgs.pyramid(momentum=1.0), max_rate=1.0)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: equip(np.eye(3)), "nothing turns the satellite"),
        (lambda: equip(np.eye(3), wheels=wheels(), cmgs=STEERING), "wheels and cmgs are both given"),
        (lambda: equip(np.eye(3), cmgs=STEERING.cmgs), "cmgs is Cmgs: give CmgSteering"),
        (lambda: equip(np.eye(3), cmgs=STEERING, minimax=True), "there are none: leave them out"),
        (lambda: equip([1.0, 0.1, 0.1], wheels=wheels()), "which no body has"),
        (lambda: equip(np.eye(3), wheels=wheels(), wanted_speeds=[1.0, 2], null_rate=0.1), "wanted_speeds must have"),
        (lambda: Magnetorquers.create(max_dipole=0.0), "max_dipole must be positive"),
        (lambda: Magnetorquers.create(max_dipole=[1.0, 2]), "max_dipole must have shape"),
        (lambda: Magnetorquers.create(2 * np.eye(3), max_dipole=1.0), "axes must be unit columns"),
        (lambda: Magnetorquers.create(max_dipole=1.0, step=-0.1), "step must be at least 0"),
        (lambda: CmgSteering.create(STEERING.cmgs, max_rate=-1.0), "max_rate must be positive"),
        (lambda: CmgSteering.create(STEERING.cmgs, max_rate=1.0, damping=0.0), "damping must be positive"),
        (lambda: CmgSteering.create(Cmgs.create([[1], [0], [0]], [[0], [1], [0]], momentum=1), max_rate=1), "1 gyro"),
    ],
)
def test_mistakes_are_named(act, message):
    with pytest.raises(ScenarioError, match=message):
        act()


def test_a_command_of_another_length_is_refused_before_the_flight():
    plant, actuator = equip(np.eye(3), wheels=wheels(), magnetorquers=Magnetorquers.create(max_dipole=0.5))
    loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=1.0, command=np.zeros(3)))
    scenario = Scenario(initial=plant.state(REST, np.zeros(3), Field()), dt=1.0, periods=2, environment=Field())
    with pytest.raises(ScenarioError, match=r"shape \(3,\): give 3 of a torque and 3 of a dipole moment"):
        simulate(loop, scenario)
