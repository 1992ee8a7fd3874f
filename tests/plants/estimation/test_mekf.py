"""Multiplicative filter: slopes, theory's steady state, NEES and NIS, first and late fixes, calibration, invariance."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation

from plants.dynamics.rigidbody import BodyState, RigidBody
from plants.errors import ScenarioError
from plants.estimation.mekf import mekf, mekf_record
from plants.geometry import attitude
from plants.hardware.instruments import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, Innovation, SensorSuite
from plants.hardware.magnetometer import ThreeAxisMagnetometer
from plants.hardware.orbitsensors import GpsReceiver, HorizonSensor
from plants.hardware.ratesensors import IntegratingGyro
from plants.hardware.startracker import StarTracker
from plants.hardware.sunsensors import CoarseSunSensors, FineSunSensor
from plants.outcome.consistency import consistency, consistency_table, nees, nis
from plants.simulation import blocks
from plants.simulation.simulate import Loop, Scenario, simulate_many
from plants.surroundings.environment import FreeSpace

SPIN = np.array([0.02, -0.05, 0.03])  # rad/s
GYRO = IntegratingGyro.create(random_walk=0.15 * DEG_PER_SQRT_H, rate_random_walk=1e-6, turn_on_bias=1e-4)
TRACKER = StarTracker.create(cross_noise=10 * ARCSEC, boresight=[0.6, 0.0, 0.8])


def surroundings():
    return (
        FreeSpace()
        .at(0.0)
        ._replace(
            r=jnp.array([6.9e6, 0.0, 0.0]), v=jnp.array([0.0, 7.6e3, 0.0]), B=jnp.array([1e-5, 2e-5, -3e-5]),
            sun=jnp.array([0.6, 0.0, 0.8]), sunlit=jnp.ones(()), q_ON=jnp.array([0.6, 0.0, 0.8, 0.0]),
            w_ON=jnp.array([0.0, -1.1e-3, 0.0]),
        )
    )  # fmt: skip


@jax.jit
def _follow(suite, navigator, h, noise, first, spin):
    """A body that turns at a constant rate, with sensors and filter: what the filter makes of it."""
    env = surroundings()

    def one(noise, q0):
        def step(carry, turn):
            k, n = turn
            x = BodyState(attitude.compose(attitude.from_vector(spin * h * k), q0), spin, jnp.zeros(0))
            passed = jnp.where(k > 0, h, 0.0)
            sensors, y = suite.measure(carry[0], x, env, n, passed)
            state, estimate = navigator.update(carry[1], y, None, env, passed)
            miss = estimate - RigidBody.output(None, x, env)  # pyright: ignore[reportArgumentType]
            return (sensors, state), (mekf_record(x, env, sensors, state), miss, state.own, estimate)

        return jax.lax.scan(step, (suite.init(), navigator.init()), (jnp.arange(noise.shape[0]), noise))[1]

    return jax.vmap(one)(noise, first)


def follow(suite, navigator=None, *, h=0.5, samples=300, runs=60, seed=0, spin=SPIN):
    """Records, misses of the estimate (runs, samples, 6), own parameters, estimates."""
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        noise = rng.normal(size=(runs, samples, suite.channels))
        first = Rotation.random(runs, random_state=rng).as_quat()
        out = _follow(suite, navigator or mekf(suite), h, noise, first, np.asarray(spin))
        return jax.tree.map(np.asarray, out)


def levels(record, skip=0):
    """Mean NEES of attitude and bias per degree of freedom, and mean NIS, after the first samples."""
    e, P = record.error[:, skip:], record.covariance[:, skip:]
    return nees(e, P).mean, nees(e[..., :3], P[..., :3, :3]).mean, nis(record.nis[:, skip:], record.rows[:, skip:]).mean


INSTRUMENTS = [
    StarTracker.create(cross_noise=1e-5, boresight=[0.0, 0.6, 0.8]),
    FineSunSensor.create(noise=1e-3),
    HorizonSensor.create(noise=1e-3),
    ThreeAxisMagnetometer.create(noise=1e-7),
    CoarseSunSensors.create(noise=1e-2, albedo=0.3),
]


@pytest.mark.parametrize("instrument", INSTRUMENTS, ids=lambda known: type(known).__name__)
def test_slopes_against_differences(instrument):
    """What the instrument reads of a body turned by a, less what is expected of the unturned one, is H a."""
    with jax.enable_x64(True):
        env, q = surroundings(), attitude.from_euler(jnp.array([0.3, -0.4, 1.1]))
        own = 1e-4 * jnp.array([1.0, -2.0, 0.5]) * (1.0 if not isinstance(instrument, ThreeAxisMagnetometer) else 1e-3)
        own = own[: 3 if hasattr(instrument, "parameters") else 0]

        @jax.jit
        def told(a, d):
            x = BodyState(attitude.compose(attitude.from_vector(a), q), jnp.zeros(3), jnp.zeros(0))
            y = instrument.measure(instrument.init(), x, env, jnp.zeros(instrument.channels), 0.0)[1]
            return instrument.innovation(y, q, own + d, env)

        zero, none = jnp.zeros(3), jnp.zeros(own.shape)
        at, still = told(zero, none), told(zero, -own)
        np.testing.assert_allclose(still.z, 0, atol=1e-14)
        assert (np.asarray(at.valid) == 1).all()
        step = 1e-5
        turned = np.stack([(told(d, none).z - told(-d, none).z) / (2 * step) for d in step * jnp.eye(3)], axis=1)
        scale = np.abs(np.asarray(at.attitude)).max()
        np.testing.assert_allclose(turned, at.attitude, atol=1e-3 * scale)
        if own.shape[0]:
            moved = np.stack([(told(zero, -d).z - told(zero, d).z) / (2 * step) for d in step * jnp.eye(3)], axis=1)
            np.testing.assert_allclose(moved, at.own, atol=1e-3)


def farrenkopf(T, noise, v, u):
    """Steady state deviations of attitude (rad) before and after an update, and of the bias (rad/s) after it.

    Farrenkopf (1978); Markley and Reynolds (2000), Analytic steady-state accuracy of a spacecraft attitude estimator.
    """
    Su, Sv = T**1.5 * u / noise, T**0.5 * v / noise
    gamma = np.sqrt(1 + Sv**2 / 4 + Su**2 / 48)
    zeta = gamma + Su / 4 + np.sqrt(2 * gamma * Su + Sv**2 + Su**2 / 3) / 2
    before, after = noise * np.sqrt(zeta**2 - 1), noise * np.sqrt(1 - 1 / zeta**2)
    Q = np.array([[v**2 * T + u**2 * T**3 / 3, -(u**2) * T**2 / 2], [-(u**2) * T**2 / 2, u**2 * T]])
    F, H = np.array([[1.0, -T], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    P = solve_discrete_are(F.T, H.T, Q, np.array([[noise**2]]))  # the equation that the closed form solves
    assert before == pytest.approx(np.sqrt(P[0, 0]), rel=1e-9)
    bias = P[1, 1] - P[0, 1] ** 2 / (P[0, 0] + noise**2)
    return before, after, np.sqrt(bias)


@pytest.mark.parametrize("within", [1, 4])
def test_steady_state_is_that_of_theory_however_fast_the_gyro_is_sampled(within):
    """Covariance of the filter within 0.5 %, errors of 400 runs within 5 %, at 1 and 4 samples of the gyro per fix."""
    T, noise, v, u = 1.0, 5e-5, 3e-5, 3e-6
    gyro = IntegratingGyro.create(random_walk=v, rate_random_walk=u, turn_on_bias=2e-5)
    tracker = StarTracker.create(cross_noise=noise, boresight_noise=noise, period=T)
    suite = SensorSuite.create([gyro, tracker])
    record, *_ = follow(suite, h=T / within, samples=481, runs=400)
    _, after, bias = farrenkopf(T, noise, v, u)
    P = record.covariance[0, -1]
    np.testing.assert_allclose(np.sqrt(P.diagonal()), np.repeat([after, bias], 3), rtol=0.005)
    last = record.error[:, [-1 - 40 * within, -1]]
    np.testing.assert_allclose(last[..., :3].std(), after, rtol=0.05)
    np.testing.assert_allclose(last[..., 3:].std(), bias, rtol=0.05)


@pytest.mark.parametrize(
    "instruments",
    [
        [StarTracker.create(cross_noise=10 * ARCSEC, period=1.0, delay=1.7, boresight=[0.6, 0.0, 0.8])],
        [
            FineSunSensor.create(noise=2e-3), ThreeAxisMagnetometer.create(noise=2e-7),
            GpsReceiver.create(position_noise=5.0, velocity_noise=0.1),
        ],
        [
            HorizonSensor.create(noise=2e-3, period=1.0), CoarseSunSensors.create(noise=0.01),
            FineSunSensor.create(noise=1e-2), TRACKER,
        ],
    ],
    ids=["late tracker", "Sun and field", "many"],
)  # fmt: skip
def test_any_set_of_instruments_is_consistent_from_the_first_fix_on(instruments):
    """Mean NEES and NIS of 60 runs: attitudes drawn from all, nothing known at the start."""
    suite = SensorSuite.create([GYRO, *instruments])
    record, miss, _, estimate = follow(suite)
    assert (record.known[:, -1] == 1).all()
    both, turn, innovation = levels(record, skip=int(np.argmax(record.known[0])) + 1)
    assert 0.8 < both < 1.2
    assert 0.85 < turn < 1.15
    assert 0.95 < innovation < 1.05
    small = np.linalg.norm(record.error[:, -1, :3], axis=1) / 2
    assert np.mean(np.linalg.norm(miss[:, -1, :3], axis=1) <= 1.01 * small) > 0.9  # but for signs at half a turn
    assert np.abs(miss[:, -1, 3:]).max() < 10 * np.abs(record.error[..., 3:]).max() + 1e-3
    waiting = record.known[0] == 0
    assert waiting.sum() == (4 if getattr(instruments[0], "depth", 0) else 0)
    assert (estimate[:, waiting, :3] == 0).all()


def test_a_saturated_gyro_loses_the_attitude_until_the_next_fix():
    """Far from the guess, the filter takes the fix for what it is; with the gyro in its range it trusts the guess."""
    tracker = StarTracker.create(cross_noise=5e-5, boresight_noise=5e-5)
    for fastest, lost in ((0.04, True), (0.4, False)):
        suite = SensorSuite.create([replace(GYRO, fastest=np.asarray(fastest)), tracker])
        record, *_ = follow(suite, mekf(suite, q=[1.0, 0, 0, 0], deviation=1e-4), samples=481, runs=400)
        assert (record.known == 1).all()
        assert (np.abs(record.error[:, 1:, :3]).max() < 1e-3) == lost


@pytest.mark.slow
def test_misalignment_of_a_second_tracker_and_bias_of_a_magnetometer_are_found():
    turned, bias = np.array([1e-3, -2e-3, 5e-4]), np.array([2e-6, -1e-6, 3e-6])
    other = StarTracker.create(cross_noise=10 * ARCSEC, boresight=[0.0, -1.0, 0.0], misalignment=turned)
    field = ThreeAxisMagnetometer.create(noise=1e-7, bias=bias)
    suite = SensorSuite.create([GYRO, TRACKER, other, field])
    navigator = mekf(suite, calibrate={2: 5e-3, 3: 1e-5})
    record, _, own, _ = follow(suite, navigator)
    np.testing.assert_allclose(own[:, -1, 0].mean(axis=0), turned, atol=2e-5)
    np.testing.assert_allclose(own[:, -1, 1].mean(axis=0), bias, atol=1e-8)
    assert levels(record, skip=50)[2] == pytest.approx(1, abs=0.05)


@dataclass(frozen=True)
class Plumb:
    """A user's instrument: how far the x axis leans to nadir, a single number."""

    deviation: float = 1e-3
    channels: int = 1

    def init(self):
        return ()

    def measure(self, s, x, env, noise, h):
        return s, attitude.rotate(x.q, -env.r / 6.9e6)[0] + self.deviation * noise[0]

    def innovation(self, reading, q, own, env):
        seen = attitude.rotate(q, -env.r / 6.9e6)
        slope = attitude.cross_matrix(seen)[:1]
        return Innovation(
            (reading - seen[0])[None], slope, jnp.zeros((1, 0)), jnp.full(1, self.deviation**2), jnp.ones(1)
        )


def test_coarse_cells_a_magnetometer_and_an_instrument_of_ones_own():
    """Found from photocells that the Earth lights, corrected by a class that the filter does not know."""
    cells = CoarseSunSensors.create(noise=0.02, albedo=0.3)
    suite = SensorSuite.create([GYRO, cells, ThreeAxisMagnetometer.create(noise=1e-6), Plumb()])
    blocks.register(suite)
    record, *_ = follow(suite)
    late = record.known.sum(axis=0) == 60
    assert late[20:].all()
    both, turn, innovation = levels(record, skip=100)
    assert 0.75 < both < 1.25
    assert 0.8 < turn < 1.2
    assert 0.95 < innovation < 1.05


def test_the_first_fix_of_a_very_good_tracker_does_not_drown_in_rounding():
    """0.002 arcsec: after the first fix the covariance is the tracker's, and stays positive."""
    sigma = 0.002 * ARCSEC
    suite = SensorSuite.create([GYRO, StarTracker.create(cross_noise=sigma, boresight_noise=sigma)])
    record, *_ = follow(suite, samples=481, runs=400)
    np.testing.assert_allclose(np.sqrt(record.covariance[0, 0].diagonal()[:3]), sigma, rtol=1e-3)
    assert (np.linalg.eigvalsh(record.covariance[0]) > 0).all()
    assert levels(record, skip=50)[1] == pytest.approx(1, abs=0.05)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10_000))
def test_neither_the_mounting_nor_the_inertial_frame_matters(seed):
    """Same body, same noise about body axes: same estimate, whatever the axes of tracker and of frame N."""
    rng = np.random.default_rng(seed)
    with jax.enable_x64(True):
        mounting, turn = (q[[3, 0, 1, 2]] for q in Rotation.random(2, random_state=rng).as_quat())
        got = _one_fix(jnp.array([1.0, 0, 0, 0]), jnp.array([1.0, 0, 0, 0]))
        other = _one_fix(jnp.asarray(mounting), jnp.asarray(turn))
    for a, b in zip(got, other, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-12)


SUITE = SensorSuite.create([
    GYRO, StarTracker.create(cross_noise=1e-3, boresight_noise=1e-3, mounting=[1.0, 0, 0, 0]),
    FineSunSensor.create(noise=1e-3),
])  # fmt: skip


@jax.jit
def _one_fix(mounting, turn):
    """Error of attitude, bias and covariance after a fix and a turn, N turned by `turn` and the tracker mounted so."""
    suite = replace(SUITE, instruments=(GYRO, replace(SUITE.instruments[1], mounting=mounting), SUITE.instruments[2]))
    navigator = replace(mekf(SUITE), instruments=suite.instruments)
    env = surroundings()
    env = env._replace(sun=attitude.rotate(turn, env.sun), q_ON=attitude.compose(env.q_ON, attitude.conjugate(turn)))
    noise = 1e-3 * jnp.array([1.0, -2.0, 0.5])
    s, f, e = suite.init(), navigator.init(), jnp.zeros(6)
    for k in range(3):
        q0 = attitude.compose(attitude.from_euler(jnp.array([0.3, 0.2, 1.0])), attitude.conjugate(turn))
        x = BodyState(attitude.compose(attitude.from_vector(SPIN * k), q0), SPIN, jnp.zeros(0))
        h = 1.0 if k else 0.0
        s, y = suite.measure(s, x, env, jnp.zeros(suite.channels), h)
        read = attitude.compose(mounting, attitude.compose(attitude.from_vector(noise * k), x.q))
        y = (y[0], y[1]._replace(q=read), y[2])
        f, e = navigator.update(f, y, None, env, h)
    return attitude.to_vector(attitude.compose(x.q, attitude.conjugate(f.q))), f.bias, f.P, e


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"q": [1.0, 1.0, 0, 0]}, "q must be of length one"),
        ({"q": [1.0, 0, 0, 0], "deviation": 0.0}, "deviation"),
        ({"bias": np.zeros(2)}, "bias"),
        ({"bias_deviation": -1.0}, "bias_deviation"),
        ({"calibrate": {0: 1e-3}}, "nothing to estimate"),
        ({"calibrate": {1: -1e-3}}, "calibrate"),
    ],
)
def test_bad_numbers_are_named(given, match):
    with pytest.raises(ScenarioError, match=match):
        mekf(SUITE, **given)


@pytest.mark.parametrize(
    ("suite", "match"),
    [
        (SensorSuite.create([TRACKER]), "0 gyros"),
        (SensorSuite.create([GYRO, GYRO, TRACKER]), "2 gyros"),
        (SensorSuite.create([GYRO]), "nothing that corrects"),
        (SensorSuite.create([GYRO, StarTracker.create(cross_noise=0.0)]), "no noise"),
        (TRACKER, "SensorSuite"),
    ],
)
def test_a_suite_that_makes_no_filter_is_refused(suite, match):
    with pytest.raises(ScenarioError, match=match):
        mekf(suite)


@dataclass(frozen=True)
class ProportionalDerivative:
    gain: np.ndarray  # (3, 6)
    dt: float = 1.0

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.gain @ (r - y)


@pytest.mark.slow
def test_nees_of_a_hundred_flights_lies_in_its_band():
    """Closed loop, star tracker that answers 0.2 s late, gyro at 5 Hz, no first guess."""
    I = np.diag([0.12, 0.11, 0.05])
    damped = ProportionalDerivative(np.hstack([2 * 0.1**2 * I, 2 * 0.8 * 0.1 * I]))
    tracker = StarTracker.create(cross_noise=8 * ARCSEC, period=0.6, delay=0.2, boresight=[0.6, 0.0, 0.8])
    gyro = IntegratingGyro.create(
        random_walk=0.15 * DEG_PER_SQRT_H, rate_random_walk=1e-6, turn_on_bias=20 * DEG_PER_H,
        bias_instability=1 * DEG_PER_H, correlation_time=500.0,
    )  # fmt: skip
    suite = SensorSuite.create([gyro, tracker])
    rng, cases = np.random.default_rng(5), []
    for run in range(100):
        q = Rotation.random(random_state=rng).as_quat()[[3, 0, 1, 2]]
        loop = Loop(plant=RigidBody.create(I), controller=damped, sensors=suite, navigator=mekf(suite))
        start = BodyState(q, 0.02 * rng.normal(size=3), np.zeros(0))
        cases.append((loop, Scenario(initial=start, dt=1.0, periods=200, samples=5, environment=FreeSpace(), run=run)))
    flown = simulate_many(cases, record=mekf_record)
    assert all(run.ok for run in flown)
    found = consistency(flown, start=2.0, confidence=0.999)["state"]
    for time in (0, 50, 200, 500, 985):  # far apart: five tests at 1e-3
        assert found.low[time] < found.average[time] < found.high[time]
    told = consistency(flown, start=2.0)
    assert told["state"].inside > 0.85  # neighbouring times are not independent
    assert told["innovations"].inside > 0.93
    assert told["innovations"].mean == pytest.approx(1, abs=0.01)
    page = consistency_table(told)
    assert page.count("consistent") >= 3
    for wrong, match in (
        ([], "runs"),
        ([replace(flown[0], ok=False)], "failed"),
        ([replace(flown[0], extra=None)], "record"),
    ):
        with pytest.raises(ScenarioError, match=match):
            consistency(wrong)
