"""Gyro: Allan deviations of theory, no accuracy from sampling faster, counts that lose nothing; tachometers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware import sensors
from plants.hardware.ratesensors import IntegratingGyro, Tachometers

LANES = 6  # independent gyros of three axes


@jax.jit
def _readings(gyro, noise, h, w):
    def step(s, turn):
        k, n = turn
        x = BodyState(attitude.from_vector(w * h * k), w, jnp.zeros(0))
        return gyro.measure(s, x, None, n, jnp.where(k > 0, h, 0.0))

    return jax.vmap(lambda n: jax.lax.scan(step, gyro.init(), (jnp.arange(n.shape[0]), n))[1])(noise)


def readings(gyro, samples, h, w=(0.0, 0.0, 0.0), seed=0, lanes=LANES):
    """Readings of a body that turns at w, (lanes, samples, ...)."""
    with jax.enable_x64(True):
        noise = jnp.asarray(np.random.default_rng(seed).normal(size=(lanes, samples, 9)))
        return jax.tree.map(np.asarray, _readings(gyro, noise, h, jnp.asarray(w, float)))


def allan(turns, h, m):
    """Allan deviation at m h s, of all lanes and axes together. IEEE Std 952-1997, annex C."""
    angle = np.cumsum(turns, axis=1)
    second = angle[:, 2 * m :] - 2 * angle[:, m:-m] + angle[:, : -2 * m]
    return np.sqrt(np.mean(second**2) / (2 * (m * h) ** 2))


SAMPLES, H = 20_000, 0.5


@pytest.mark.parametrize("m", [1, 10, 100])
def test_angle_random_walk_has_slope_minus_one_half(m):
    y = readings(IntegratingGyro.create(random_walk=3e-5), SAMPLES, H)
    assert allan(y.turn, H, m) == pytest.approx(3e-5 / np.sqrt(m * H), rel=0.05)


@pytest.mark.parametrize("m", [10, 100, 300])
def test_rate_random_walk_has_slope_one_half(m):
    y = readings(IntegratingGyro.create(random_walk=0.0, rate_random_walk=2e-7), SAMPLES, H)
    assert allan(y.turn, H, m) == pytest.approx(2e-7 * np.sqrt(m * H / 3), rel=0.1)


def test_bias_instability_is_the_flat_part():
    level, T = 3e-6, 25.0
    gyro = IntegratingGyro.create(random_walk=0.0, bias_instability=level, correlation_time=T)
    y = readings(gyro, SAMPLES, H)
    curve = {m: allan(y.turn, H, m) for m in (10, 95, 1000)}
    assert curve[95] == pytest.approx(level, rel=0.05)  # 1.89 T
    assert max(curve[10], curve[1000]) < 0.85 * level
    assert y.turn[:, 1].std() / H == pytest.approx(level / 0.617, rel=0.5)  # stationary from the first sample on


def test_a_start_has_a_bias_of_its_own_that_stays():
    gyro = IntegratingGyro.create(random_walk=0.0, turn_on_bias=1e-4, bias=[1e-3, 0.0, 0.0])
    y = readings(gyro, 3, H, lanes=500)
    np.testing.assert_allclose(y.turn[:, 1], y.turn[:, 2], rtol=1e-9)
    drawn = y.turn[:, 1] / H - [1e-3, 0, 0]
    assert drawn.std() == pytest.approx(1e-4, rel=0.1)
    np.testing.assert_array_equal(y.turn[:, 0], 0)


@pytest.mark.parametrize("h", [2.0, 0.5, 0.1])
def test_sampling_faster_does_not_tell_more_of_an_angle(h):
    """The error of the angle after 20 s is the same whatever the rate: v^2 t + u^2 t^3 / 3."""
    v, u, t = 3e-5, 1e-6, 20.0
    y = readings(IntegratingGyro.create(random_walk=v, rate_random_walk=u), round(t / h) + 1, h, lanes=3000)
    assert y.turn.sum(axis=1).std() == pytest.approx(np.sqrt(v**2 * t + u**2 * t**3 / 3), rel=0.03)


@pytest.mark.parametrize("h", [0.02, 0.5])
def test_the_suite_with_a_random_walk_does_not_either(h):
    """Mean rate over 10 s: 1 / sqrt(10 s), of whatever many samples."""
    sheet = {"sun_noise": 0.0, "magnetometer_noise": 0.0}
    suite = sensors.attitude_suite(**sheet, gyro_random_walk=3e-5)
    noise = np.random.default_rng(0).normal(size=(2000, round(10 / h)))
    with jax.enable_x64(True):
        mean = np.asarray(suite.gyro.deviation(h)) * noise.mean(axis=1)
        assert float(suite.gyro.deviation(0.0)) == 0
        assert float(sensors.attitude_suite(**sheet, gyro_noise=2e-4).gyro.deviation(h)) == 2e-4
    assert mean.std() == pytest.approx(3e-5 / np.sqrt(10), rel=0.05)


@pytest.mark.parametrize("both", [{}, {"gyro_noise": 1e-4, "gyro_random_walk": 1e-5}])
def test_the_suite_takes_exactly_one_noise(both):
    with pytest.raises(ScenarioError, match="gyro_noise and gyro_random_walk"):
        sensors.attitude_suite(sun_noise=0.0, magnetometer_noise=0.0, **both)


def test_counts_are_whole_and_lose_nothing():
    quantum = 1e-4
    y = readings(IntegratingGyro.create(random_walk=1e-6, quantum=quantum), 400, H, w=(1e-5, -3e-5, 0.02), lanes=2)
    counts = y.turn / quantum
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    free = readings(IntegratingGyro.create(random_walk=1e-6), 400, H, w=(1e-5, -3e-5, 0.02), lanes=2)
    assert np.abs(np.cumsum(y.turn - free.turn, axis=1)).max() <= quantum / 2 * (1 + 1e-6)
    assert np.abs(y.rate - free.rate).max() <= quantum / H * (1 + 1e-6)


def test_the_angle_is_the_rotation_and_the_rate_is_the_rate():
    w = np.array([0.3, -0.2, 0.5])
    y = readings(IntegratingGyro.create(random_walk=0.0), 20, H, w=w, lanes=1)
    np.testing.assert_allclose(y.turn[0, 1:], np.tile(w * H, (19, 1)), atol=1e-12)
    np.testing.assert_allclose(y.rate[0], np.tile(w, (20, 1)), atol=1e-15)
    assert (y.valid == 1).all()


def test_scale_factor_and_misalignment():
    gyro = IntegratingGyro.create(random_walk=0.0, scale_factor=[1e-3, 0, 0], misalignment=[0, 0, 1e-3])
    y = readings(gyro, 3, H, w=(0.1, 0.0, 0.0), lanes=1)
    np.testing.assert_allclose(y.rate[0, 1], [0.1 * 1.001 * np.cos(1e-3), -0.1 * np.sin(1e-3), 0], rtol=1e-12)


def test_an_axis_saturates_and_says_so():
    y = readings(IntegratingGyro.create(random_walk=0.0, fastest=0.1), 4, H, w=(0.0, 0.2, 0.05), lanes=1)
    np.testing.assert_allclose(y.turn[0, 1], [0, 0.1 * H, 0.05 * H], atol=1e-12)
    assert (y.valid == 0).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("random_walk", -1.0), ("rate_random_walk", np.nan), ("bias_instability", -1e-6), ("correlation_time", 0.0),
        ("bias", np.zeros(2)), ("turn_on_bias", -1.0), ("scale_factor", np.zeros(2)), ("misalignment", [np.nan] * 3),
        ("nonorthogonality", 0.0), ("quantum", -1.0), ("fastest", 0.0),
    ],
)  # fmt: skip
def test_bad_numbers_are_named(field, value):
    with pytest.raises(ScenarioError, match=field):
        IntegratingGyro.create(**{"random_walk": 1e-5, field: value})


def test_tachometers_count():
    meter = Tachometers.create(quantum=0.5)
    with jax.enable_x64(True):
        x = BodyState(np.zeros(4), np.zeros(3), np.array([100.2, -3.4, 0.0]))
        y = meter.measure((), x, None, jnp.zeros(0), 0.1)[1]
        np.testing.assert_array_equal(y.wheels, [100.0, -3.5, 0.0])
        np.testing.assert_array_equal(Tachometers.create().measure((), x, None, jnp.zeros(0), 0.1)[1].wheels, x.wheels)
    assert meter.channels == 0
    with pytest.raises(ScenarioError, match="quantum"):
        Tachometers.create(quantum=-1.0)
