"""Laws for magnetorquers: what their torque does in a field at rest, along an orbit, and against Basilisk."""

from datetime import datetime

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.guidance.magnetic import (
    CrossProductDumping,
    LqrDumping,
    bdot,
    bdot_gain,
    cross_product,
    field_rate,
)
from plants.surroundings import orbit
from plants.surroundings.environment import Environment, FreeSpace

vectors = st.tuples(*3 * [st.floats(-1, 1)]).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)
units = st.sampled_from([1e-9, 1e-3, 1.0, 1e4])


@pytest.fixture(scope="module")
def flown():
    """Field over two orbits, (n, 3) T in frame O, its times, the rate of O, and the environment."""
    with jax.enable_x64(True):
        start = orbit.circular(500e3, np.radians(97.4), 1.0)
        period = 2 * np.pi / float(orbit.rate(start.r))
        environment = Environment.along(start, datetime(2024, 3, 20, 9), 2 * period + 1)
        times = np.linspace(0, 2 * period, 1201)
        env = jax.jit(jax.vmap(environment.at))(times)
        field = np.asarray(attitude.rotate(env.q_ON, env.B))
        return (period, times, field, np.asarray(env.w_ON).mean(axis=0)), environment


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, units, units)
def test_torques_are_the_part_across_the_field(wanted, B, momentum_unit, field_unit):
    dh, B = momentum_unit * wanted, field_unit * B
    torque = np.cross(cross_product(dh, B, gain=0.01), B)
    direction = B / np.linalg.norm(B)
    across = dh - direction * (direction @ dh)
    np.testing.assert_allclose(torque, 0.01 * across, rtol=0, atol=1e-14 * np.linalg.norm(dh))
    torque = np.cross(bdot(field_rate(dh, B), B, gain=3.0), B)
    np.testing.assert_allclose(torque, -3 * across, rtol=0, atol=3e-14 * np.linalg.norm(dh))


@settings(max_examples=50, deadline=None)
@given(vectors, vectors, st.tuples(*3 * [st.floats(1e-4, 1e-1)]))
def test_limits_keep_the_direction(dh, B, limit):
    free, bounded = (cross_product(dh, 1e-5 * B, gain=1.0, limit=m) for m in (np.inf, np.array(limit)))
    assert (np.abs(bounded) <= np.array(limit) * (1 + 1e-12)).all()
    np.testing.assert_allclose(np.cross(bounded, free), 0, atol=1e-12 * np.linalg.norm(free) * np.linalg.norm(bounded))
    assert bounded @ free >= 0


def test_momentum_across_a_field_at_rest_decays_exponentially():
    k, B, start = 2e-3, np.array([1e-5, -2e-5, 3e-5]), np.array([0.01, 0.02, -0.005])
    law = CrossProductDumping.create(k)
    flown = solve_ivp(lambda _, h: np.cross(law.dipole(h, B), B), (0, 1000), start, rtol=1e-11, atol=1e-16)
    b = B / np.linalg.norm(B)
    along = b * (b @ start)
    np.testing.assert_allclose(flown.y[:, -1], along + np.exp(-k * 1000) * (start - along), rtol=0, atol=1e-11)


def test_bdot_damps_the_rate_across_the_field_and_finite_differences_agree():
    B, w, h = np.array([1e-5, -2e-5, 3e-5]), np.array([0.02, -0.01, 0.03]), 1e-3
    turned = np.asarray(jax.device_get(attitude.rotate(np.array([1, *(0.5 * h * w)]), B)))
    difference = bdot((turned - B) / h, B, gain=1.0)
    np.testing.assert_allclose(difference, bdot(field_rate(w, B), B, gain=1.0), rtol=0.01)
    assert bdot_gain(1.1e-3, np.pi / 2, 0.05) == pytest.approx(4 * 1.1e-3 * 0.05)


def test_numpy_stays_numpy_and_jax_is_the_same():
    dh, B = np.array([1e-3, 2e-3, -1e-3]), np.array([1e-5, -2e-5, 3e-5])
    m = cross_product(dh, B, gain=0.1, limit=1.0)
    assert isinstance(m, np.ndarray)
    with jax.enable_x64(True):
        traced = jax.jit(lambda a, b: cross_product(a, b, gain=0.1, limit=1.0))(jnp.asarray(dh), jnp.asarray(B))
    np.testing.assert_allclose(traced, m, rtol=1e-14)
    np.testing.assert_array_equal(cross_product(dh, np.zeros(3), gain=0.1, limit=1.0), 0)


def dumped(law, flown, start):
    """Momentum along two orbits of a body at rest in frame O."""
    _, times, field, rate = flown
    field_at = lambda t: np.array([np.interp(t, times, column) for column in field.T])  # noqa: E731

    def slope(t, h):
        B = field_at(t)
        return np.cross(law.dipole(h, B), B) - np.cross(rate, h)

    return solve_ivp(slope, (0, times[-1]), start, t_eval=times, rtol=1e-6, atol=1e-10, max_step=60).y.T


START = np.array([6e-3, -8e-3, 5e-3])  # N m s


def test_cross_product_dumps_over_an_orbit(flown):
    left = np.linalg.norm(dumped(CrossProductDumping.create(1e-3, limit=0.2), flown[0], START), axis=1)
    assert (np.diff(left) < 1e-9).all()  # a torque towards zero never adds to it
    assert left[600] < 0.1 * left[0]
    assert left[-1] < 0.02 * left[0]


def test_lqr_dumps_and_costs_less_than_the_cross_product(flown):
    """Its spectral radius is that of the simulated orbit, and no cross-product gain is cheaper by its criterion."""
    orbits, environment = flown
    period, times, field, rate = orbits
    law = LqrDumping.along(environment, period, dipole=0.05, momentum=5e-3)
    same = LqrDumping.create(field[:600], period, dipole=0.05, momentum=5e-3, rate=rate)
    np.testing.assert_allclose(law.gain, same.gain, rtol=0, atol=1e-3 * np.abs(same.gain).max())

    def cost(law, h):
        m = np.array([law.dipole(*row) for row in zip(h, field, strict=True)])
        rows = (h**2).sum(axis=1) / 5e-3**2 + (m**2).sum(axis=1) / 0.05**2
        return np.trapezoid(rows, times)

    transition = np.stack([dumped(law, (period, times[:601], field[:601], rate), e)[-1] for e in np.eye(3)], axis=1)
    assert np.abs(np.linalg.eigvals(transition)).max() == pytest.approx(float(law.radius), rel=0.05)
    others = [CrossProductDumping.create(k) for k in (3e-4, 5e-4, 8e-4)]
    assert cost(law, dumped(law, orbits, START)) < min(cost(other, dumped(other, orbits, START)) for other in others)


@settings(max_examples=20, deadline=None)
@given(units, st.floats(0.1, 10))
def test_lqr_does_not_depend_on_units(unit, period_factor):
    turn = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    field = 3e-5 * np.stack([np.cos(turn), 0.2 + 0 * turn, 2 * np.sin(turn)], axis=1)
    period, rate = 5400.0, np.array([0, -2 * np.pi / 5400, 0])
    law = LqrDumping.create(field, period, dipole=0.1, momentum=1e-2, rate=rate)
    same = LqrDumping.create(field, period, dipole=0.1 * unit, momentum=1e-2 * unit, rate=rate)
    np.testing.assert_allclose(same.gain, law.gain, rtol=1e-6)
    c = period_factor  # time in other units: torque per dipole and field scales alike
    slow = LqrDumping.create(field / c, c * period, dipole=0.1, momentum=1e-2, rate=rate / c)
    np.testing.assert_allclose(slow.gain, c * law.gain, rtol=1e-6, atol=1e-6 * np.abs(law.gain).max())
    assert float(slow.radius) == pytest.approx(float(law.radius), rel=1e-6)


ALONG = np.tile([0.0, 3e-5, 0.0], (20, 1))


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: CrossProductDumping.create(-1.0), "gain must be positive"),
        (lambda: CrossProductDumping.create(1.0, limit=[1.0, 2.0]), "limit must have shape"),
        (lambda: CrossProductDumping.create(1.0, wanted=1.0), "wanted must have shape"),
        (lambda: LqrDumping.create(ALONG, 5400.0, dipole=0.1, momentum=0.1), "field keeps its direction"),
        (lambda: LqrDumping.create(ALONG[:3], 5400.0, dipole=0.1, momentum=0.1), "at least 8 points"),
        (lambda: LqrDumping.create(0 * ALONG, 5400.0, dipole=0.1, momentum=0.1), "field must be positive"),
        (lambda: LqrDumping.create(ALONG, 5400.0, dipole=0.0, momentum=0.1), "dipole must be positive"),
        (lambda: LqrDumping.along(FreeSpace(), 5400.0, dipole=0.1, momentum=0.1), "gives no magnetic field"),
        (lambda: bdot_gain(1e-3, 1.0, 0.0), "least_inertia must be positive"),
    ],
)
def test_mistakes_are_named(act, message):
    with pytest.raises(ScenarioError, match=message):
        act()


PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)
BIASES, SPEEDS, JS, BASILISK_FIELD = [5.0, 10, 0, -3], [100.0, -50, 20, 70], 1e-4, [1e-5, -2e-5, 3e-5]


def test_dipole_of_basilisk():
    """mtbMomentumManagement of Basilisk 2.12.1 (bsk on PyPI), rods on the body axes, gain 0.003 1/s, no limit."""
    error = JS * PYRAMID @ (np.array(BIASES) - SPEEDS)
    got = cross_product(error, np.array(BASILISK_FIELD), gain=0.003)
    np.testing.assert_allclose(got, [0.1469772, -0.51063211, -0.38941381], rtol=0, atol=1e-8)


def test_dipole_of_basilisk_as_it_is_here():
    module = pytest.importorskip("Basilisk.fswAlgorithms.mtbMomentumManagement", reason="needs Basilisk (pip: bsk)")
    from Basilisk.architecture import messaging
    from Basilisk.utilities import SimulationBaseClass

    sim, law = SimulationBaseClass.SimBaseClass(), module.mtbMomentumManagement()
    process = sim.CreateNewProcess("process")
    process.addTask(sim.CreateNewTask("task", int(1e9)))
    sim.AddModelToTask("task", law)
    law.wheelSpeedBiases, law.cGain = BIASES, 0.003
    wheels, rods = messaging.RWArrayConfigMsgPayload(), messaging.MTBArrayConfigMsgPayload()
    wheels.numRW, wheels.JsList, wheels.uMax, wheels.GsMatrix_B = 4, 4 * [JS], 4 * [1.0], list(PYRAMID.T.flatten())
    rods.numMTB, rods.maxMtbDipoles, rods.GtMatrix_B = 3, 3 * [1e6], list(np.eye(3).flatten())
    field, speeds = messaging.TAMSensorBodyMsgPayload(), messaging.RWSpeedMsgPayload()
    torques = messaging.ArrayMotorTorqueMsgPayload()
    field.tam_B, speeds.wheelSpeeds, torques.motorTorque = BASILISK_FIELD, SPEEDS, 4 * [0.0]
    sent = [
        (law.rwParamsInMsg, messaging.RWArrayConfigMsg().write(wheels)),
        (law.mtbParamsInMsg, messaging.MTBArrayConfigMsg().write(rods)),
        (law.tamSensorBodyInMsg, messaging.TAMSensorBodyMsg().write(field)),
        (law.rwSpeedsInMsg, messaging.RWSpeedMsg().write(speeds)),
        (law.rwMotorTorqueInMsg, messaging.ArrayMotorTorqueMsg().write(torques)),
    ]
    for reader, message in sent:
        reader.subscribeTo(message)
    recorder = law.mtbCmdOutMsg.recorder()
    sim.AddModelToTask("task", recorder)
    sim.InitializeSimulation()
    sim.ConfigureStopTime(0)
    sim.ExecuteSimulation()
    error = JS * PYRAMID @ (np.array(BIASES) - SPEEDS)
    got = cross_product(error, np.array(BASILISK_FIELD), gain=0.003)
    np.testing.assert_allclose(got, np.array(recorder.mtbDipoleCmds)[0][:3], rtol=1e-10)
