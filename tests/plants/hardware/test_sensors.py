"""Sensors: the statistics of the data sheet, the Sun in eclipse, bad numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware import sensors
from plants.surroundings.environment import FreeSpace

SHEET = {
    "sun_noise": 5e-3,
    "magnetometer_noise": 120e-9,
    "gyro_noise": 5e-4,
    "gyro_bias": np.array([1e-3, -2e-3, 3e-3]),
    "gyro_bias_walk": 1e-4,
}


@pytest.fixture(scope="module")
def flown():
    """20 000 samples at rest, 0.1 s apart."""
    with jax.enable_x64(True):
        q = attitude.from_euler(np.array([0.3, -0.2, 1.0]))
        x = BodyState(q=q, w=jnp.array([0.01, 0.02, -0.03]), wheels=jnp.array([1.0, 2.0, 3.0]))
        env = (
            FreeSpace()
            .at(0.0)
            ._replace(sun=jnp.array([0.6, 0.0, 0.8]), B=jnp.array([1e-5, 2e-5, 3e-5]), sunlit=jnp.ones(()))
        )
        suite = sensors.attitude_suite(**SHEET)
        noise = jnp.asarray(np.random.default_rng(0).normal(size=(20_000, suite.channels)))
        step = jax.jit(lambda s, n: suite.measure(s, x, env, n, 0.1))
        walked, y = jax.lax.scan(lambda s, n: ((new := step(s, n))[0], (new[0], new[1])), suite.init(), noise)[1]
        return x, env, np.asarray(walked), jax.tree.map(np.asarray, y)


def test_means_and_deviations_are_those_of_the_sheet(flown):
    x, env, walked, y = flown
    with jax.enable_x64(True):
        sun, field = (np.asarray(attitude.rotate(x.q, v)) for v in (env.sun, env.B))
    n = len(walked)
    for got, true, sigma in (
        (y.sun, sun, SHEET["sun_noise"]),
        (y.field, field, SHEET["magnetometer_noise"]),
        (y.rate - walked, np.asarray(x.w), SHEET["gyro_noise"]),
    ):
        np.testing.assert_allclose(got.mean(axis=0), true, rtol=0, atol=4 * sigma / np.sqrt(n))
        np.testing.assert_allclose(got.std(axis=0) / sigma, 1, atol=4 / np.sqrt(2 * n))
        np.testing.assert_allclose(np.corrcoef(got.T), np.eye(3), atol=4 / np.sqrt(n))
    np.testing.assert_array_equal(y.wheels, np.tile([1.0, 2.0, 3.0], (n, 1)))


def test_bias_starts_at_the_sheet_and_walks_with_the_root_of_time(flown):
    *_, walked, _ = flown
    steps = np.diff(walked, axis=0)
    np.testing.assert_allclose(steps.std(axis=0), 1e-4 * np.sqrt(0.1), rtol=4 / np.sqrt(2 * len(steps)))
    np.testing.assert_allclose(walked[0], SHEET["gyro_bias"], rtol=0, atol=4 * 1e-4 * np.sqrt(0.1))
    np.testing.assert_array_equal(sensors.attitude_suite(**SHEET).init(), np.float32(SHEET["gyro_bias"]))


@pytest.mark.parametrize(("fraction", "seen"), [(0.0, 0), (0.49, 0), (0.5, 1), (1.0, 1)])
def test_no_direction_without_the_sun(fraction, seen):
    sensor = sensors.SunSensor(noise=0.1)
    y, flag = sensor.measure(jnp.array([0.0, 0.6, 0.8]), jnp.asarray(fraction), jnp.ones(3))
    assert float(flag) == seen
    np.testing.assert_allclose(y, seen * np.array([0.1, 0.7, 0.9]), atol=1e-6)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("sun_noise", -1e-3),
        ("magnetometer_noise", np.nan),
        ("gyro_noise", -1.0),
        ("gyro_bias", np.zeros(2)),
        ("gyro_bias_walk", np.inf),
    ],
)
def test_bad_number_is_named(field, value):
    with pytest.raises(ScenarioError, match=field):
        sensors.attitude_suite(**{**SHEET, field: value})
