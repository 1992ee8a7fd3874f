"""Fine and coarse Sun sensors, the Earth's light, magnetometer, horizon sensor and GPS receiver."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import dblquad

from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.magnetometer import ThreeAxisMagnetometer
from plants.hardware.orbitsensors import GpsReceiver, HorizonSensor
from plants.hardware.sunsensors import CoarseSunSensors, FineSunSensor, earth_light
from plants.surroundings.environment import FreeSpace
from plants.surroundings.orbit import EARTH_RADIUS

RADIUS = 6878e3


@pytest.fixture(scope="module")
def env():
    with jax.enable_x64(True):
        return (
            FreeSpace()
            .at(0.0)
            ._replace(
                r=jnp.array([RADIUS, 0.0, 0.0]), v=jnp.array([0.0, 7.6e3, 0.0]), B=jnp.array([1e-5, 2e-5, -3e-5]),
                sun=jnp.array([0.6, 0.0, 0.8]), sunlit=jnp.ones(()),
            )
        )  # fmt: skip


def state(angles):
    with jax.enable_x64(True):
        return BodyState(np.asarray(attitude.from_euler(np.array(angles))), np.zeros(3), np.zeros(0))


def once(instrument, x, env, noise=None):
    with jax.enable_x64(True):
        n = jnp.zeros(instrument.channels) if noise is None else jnp.asarray(noise)
        return jax.tree.map(np.asarray, instrument.measure(instrument.init(), x, env, n, 0.0)[1])


X = state([0.3, -0.5, 1.1])


def directions(env):
    """The instruments that read a vector, and the vector in body axes."""
    with jax.enable_x64(True):
        return [
            (FineSunSensor, np.asarray(attitude.rotate(X.q, env.sun))),
            (HorizonSensor, np.asarray(attitude.rotate(X.q, jnp.array([-1.0, 0.0, 0.0])))),
        ]


def test_directions_are_seen_inside_the_field_of_view_only(env):
    for kind, true in directions(env):
        aside = np.cross(true, [0.0, 0.0, 1.0])
        aside /= np.linalg.norm(aside)
        for angle, seen in ((0.49, 1), (0.51, 0)):
            boresight = np.cos(angle) * true + np.sin(angle) * aside
            y = once(kind.create(noise=1e-3, boresight=boresight, half_angle=0.5), X, env, [1.0, -1.0, 2.0])
            assert y.valid == seen
            np.testing.assert_allclose(y.vector, seen * (true + np.array([1e-3, -1e-3, 2e-3])), atol=1e-15)
        y = once(kind.create(noise=1e-3, boresight=-true), X, env)
        assert y.valid == 1


def test_misaligned_direction(env):
    turn = np.array([1e-3, 2e-3, -3e-3])
    for kind, true in directions(env):
        y = once(kind.create(noise=0.0, misalignment=turn), X, env)
        np.testing.assert_allclose(y.vector, true - np.cross(turn, true), atol=1e-5)


def test_no_sun_in_eclipse_and_no_numbers_where_it_is_not_modelled(env):
    dark = env._replace(sunlit=np.zeros(()))
    assert once(FineSunSensor.create(noise=1e-3), X, dark).valid == 0
    assert np.isnan(once(FineSunSensor.create(noise=1e-3), X, env._replace(sun=np.full(3, np.nan))).vector).all()
    np.testing.assert_array_equal(once(CoarseSunSensors.create(noise=0.0), X, dark).currents, 0)


@pytest.mark.parametrize("zenith", [0.0, 0.7, np.pi / 2])
def test_earth_light_on_a_plate_against_quadrature(zenith):
    """On a plate that faces the Earth, by an integral over the visible cap."""
    sun, ratio = np.array([np.cos(zenith), np.sin(zenith), 0.0]), EARTH_RADIUS / RADIUS

    def patch(around, angle):
        n = np.array([np.cos(angle), np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around)])
        way = np.array([1.0, 0, 0]) - ratio * n
        d = np.linalg.norm(way)
        return max(n @ sun, 0) * max(n @ way / d, 0) * way[0] / d * ratio**2 / d**2 / np.pi * np.sin(angle)

    expected = dblquad(patch, 0, np.arccos(ratio), 0, 2 * np.pi, epsabs=1e-6)[0]
    with jax.enable_x64(True):
        towards, strength = (np.asarray(a) for a in earth_light(jnp.array([RADIUS, 0.0, 0.0]), sun))
    assert strength @ np.maximum(towards @ [-1.0, 0, 0], 0) == pytest.approx(expected, abs=0.01 * ratio**2)


def test_earth_light_is_bounded_and_needs_the_day():
    rng = np.random.default_rng(0)
    with jax.enable_x64(True):
        light = jax.jit(earth_light)
        for _ in range(100):
            r, sun, plate = (v / np.linalg.norm(v) for v in rng.normal(size=(3, 3)))
            distance = rng.uniform(1.02, 8) * EARTH_RADIUS
            towards, strength = (np.asarray(a) for a in light(distance * r, sun))
            assert (strength >= 0).all()
            assert strength @ np.maximum(towards @ plate, 0) <= (EARTH_RADIUS / distance) ** 2
        towards, strength = light(RADIUS * np.array([1.0, 0, 0]), np.array([-1.0, 0, 0]))
        assert float(jnp.sum(strength)) == 0


def test_coarse_sensors_are_cosines_and_the_earth_adds_at_most_its_albedo(env):
    with jax.enable_x64(True):
        sun = np.asarray(attitude.rotate(X.q, env.sun))
    plain = once(CoarseSunSensors.create(noise=0.0), X, env).currents
    np.testing.assert_allclose(plain, np.maximum(np.kron(sun, [1, -1]), 0), atol=1e-12)
    lit = once(CoarseSunSensors.create(noise=0.0, albedo=0.3), X, env).currents
    assert ((lit >= plain) & (lit <= plain + 0.3)).all()
    assert (lit > plain + 0.01).any()
    np.testing.assert_array_equal(once(CoarseSunSensors.create(noise=0.0, scale=[2.0] * 6), X, env).currents, 2 * plain)
    narrow = once(CoarseSunSensors.create(noise=0.0, half_angle=0.3), X, env).currents
    np.testing.assert_allclose(narrow, np.where(plain > np.cos(0.3), plain, 0))


def test_magnetometer_distorts_and_counts(env):
    with jax.enable_x64(True):
        B = np.asarray(attitude.rotate(X.q, env.B))
    sheet = {"noise": 1e-7, "bias": [1e-6, 0, 0], "scale_factor": [0.01, 0, 0], "nonorthogonality": [0.02, 0, 0]}
    y = once(ThreeAxisMagnetometer.create(**sheet), X, env, [0.0, 1.0, 0.0])
    expected = [1.01 * B[0] + 1e-6, np.sin(0.02) * B[0] + np.cos(0.02) * B[1] + 1e-7, B[2]]
    np.testing.assert_allclose(y.vector, expected, rtol=1e-12)
    y = once(ThreeAxisMagnetometer.create(noise=0.0, quantum=1e-6), X, env)
    np.testing.assert_allclose(y.vector, np.round(B / 1e-6) * 1e-6, rtol=1e-12)


def test_gps_reads_where_it_is(env):
    y = once(GpsReceiver.create(position_noise=5.0, velocity_noise=0.1), X, env, np.arange(6.0))
    np.testing.assert_allclose(y.position, np.asarray(env.r) + np.array([0, 5, 10]))
    np.testing.assert_allclose(y.velocity, np.asarray(env.v) + np.array([0.3, 0.4, 0.5]))


@pytest.mark.parametrize("kind", [FineSunSensor, HorizonSensor, ThreeAxisMagnetometer, CoarseSunSensors, GpsReceiver])
def test_readings_come_at_the_rate_of_the_sensor(env, kind):
    sheet = {"position_noise": 1.0, "velocity_noise": 1.0} if kind is GpsReceiver else {"noise": 1e-3}
    sensor = kind.create(**sheet, period=0.5)
    with jax.enable_x64(True):

        def step(s, k):
            return sensor.measure(s, X, env, jnp.ones(sensor.channels), jnp.where(k > 0, 0.2, 0.0))

        y = jax.tree.map(np.asarray, jax.lax.scan(step, sensor.init(), jnp.arange(50))[1])
    assert y.valid.sum() == 20
    np.testing.assert_array_equal(y[0][y.valid == 0], 0)


@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        (FineSunSensor, "noise", -1.0), (FineSunSensor, "boresight", [1.0, 1.0, 0.0]),
        (FineSunSensor, "half_angle", 0.0),
        (HorizonSensor, "misalignment", np.zeros(2)), (HorizonSensor, "period", np.nan),
        (CoarseSunSensors, "normals", np.ones((4, 3))), (CoarseSunSensors, "albedo", 1.5),
        (CoarseSunSensors, "scale", np.ones(3)), (ThreeAxisMagnetometer, "bias", 0.0),
        (ThreeAxisMagnetometer, "quantum", -1.0), (ThreeAxisMagnetometer, "scale_factor", -2.0),
    ],
)  # fmt: skip
def test_bad_numbers_are_named(kind, field, value):
    with pytest.raises(ScenarioError, match=field):
        kind.create(**{"noise": 1e-3, field: value})
