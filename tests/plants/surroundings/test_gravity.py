"""Earth's shape, third bodies, sunlight: closed forms of others, potential theory, geometry of the shadow."""

import erfa
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import lpmv

from plants.errors import ScenarioError
from plants.surroundings import gravity, orbit
from plants.surroundings.gravity import EGM96, OBLATE, SPHERE

POINTS = np.array([[4.2e7, 1e6, -2e6], [-1.1e7, 3e7, 2.5e7], [0.3e7, -0.2e7, -4e7]])  # m


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def test_oblateness_is_that_of_the_orbit_module():
    assert -EGM96.cosine[0] == pytest.approx(orbit.J2, rel=1e-8)
    for r in POINTS:
        np.testing.assert_allclose(jax.jit(gravity.earth)(r, OBLATE), orbit.acceleration(r), rtol=1e-11, atol=1e-15)


def test_potential_by_legendre_functions():
    """Equation 2.3 with normalised coefficients and the Legendre functions of SciPy."""
    for r in POINTS:
        distance, longitude = np.linalg.norm(r), np.arctan2(r[1], r[0])
        expected = 0.0
        for degree, m, c, s in zip(gravity.DEGREES, gravity.ORDERS, gravity.COSINES, gravity.SINES, strict=True):
            factor = np.prod([1.0 / k for k in range(degree - m + 1, degree + m + 1)]) * (2 * degree + 1)
            P = (-1) ** m * lpmv(m, degree, r[2] / distance) * np.sqrt(factor * (2 if m else 1))
            wave = c * np.cos(m * longitude) + s * np.sin(m * longitude)
            expected += orbit.MU / distance * (orbit.EARTH_RADIUS / distance) ** degree * P * wave
        assert EGM96.potential(r) == pytest.approx(expected, rel=1e-13)


def test_potential_is_harmonic():
    for r in POINTS:
        hessian = jax.jit(jax.hessian(EGM96.potential))(r)
        assert abs(jnp.trace(hessian)) < 1e-12 * jnp.abs(hessian).max()


def test_coefficients_turn_with_the_axes():
    longitude = 1.3
    c, s = np.cos(longitude), np.sin(longitude)
    to_greenwich = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for r in POINTS:
        assert EGM96.seen_from(longitude).potential(r) == pytest.approx(float(EGM96.potential(to_greenwich @ r)))


def test_radius_of_the_station():
    """42164.695 km under J2; Kepler's 42164.17 km around a sphere."""
    rate = erfa.D2PI * 1.00273781191135448 / erfa.DAYSEC
    r = gravity.station_radius(rate, OBLATE)
    assert r == pytest.approx(42164695, abs=1)
    np.testing.assert_allclose(gravity.earth([r, 0, 0], OBLATE), [-(rate**2) * r, 0, 0], rtol=1e-13)
    assert gravity.station_radius(rate, SPHERE) == pytest.approx((orbit.MU / rate**2) ** (1 / 3), rel=1e-14)
    with pytest.raises(ScenarioError, match="rate"):
        gravity.station_radius(np.nan, SPHERE)


def test_acceleration_along_the_equator():
    """-2.1e-8 m/s^2 at 0, 6.5e-8 at 120 E, none near 75 E: what is slowed falls and gets ahead, so 75 E is stable."""
    r = gravity.station_radius(7.2921151e-5, OBLATE)
    along = [float(gravity.earth([r, 0, 0], EGM96.seen_from(np.radians(deg)))[1]) for deg in (0, 75, 120)]
    np.testing.assert_allclose(along, [-2.1e-8, 0, 6.5e-8], rtol=0, atol=1e-9)


def test_third_body_is_a_tide():
    r, moon = np.array([4.2e4, 1e3, -2e3]), np.array([1e8, 3e8, 2e8])
    d = np.linalg.norm(moon)
    tide = gravity.MU_MOON / d**3 * (3 * (r @ moon) * moon / d**2 - r)
    np.testing.assert_allclose(gravity.third_body(r, moon, gravity.MU_MOON), tide, rtol=1e-3)
    np.testing.assert_array_equal(gravity.third_body(np.zeros(3), moon, gravity.MU_MOON), np.zeros(3))


def test_third_body_does_not_point_at_it():
    """The thesis's 2.22 has it do so: across the line to the Moon it pulls towards the Earth."""
    r, moon = np.array([4.2e7, 0, 0]), np.array([0, 3.8e8, 0])
    assert gravity.third_body(r, moon, gravity.MU_MOON)[0] < 0
    assert abs(gravity.third_body(r, moon, gravity.MU_MOON)[1]) < 0.02 * gravity.MU_MOON / 3.8e8**2


def test_sunlight_pushes_away_with_the_pressure_at_the_distance():
    sun, r = np.array([1.02 * gravity.AU, 0, 0]), np.array([4.2e7, 1e7, 0])
    push = gravity.sunlight(r, sun, 0.026)
    assert push[0] == pytest.approx(-0.026 * 1361 / erfa.CMPS / 1.02**2, rel=2e-3)
    assert jnp.abs(push[1:] / push[0]).max() < 1e-3


def test_shadow_at_the_equinox():
    """A cylinder of the Earth's radius covers 2 arcsin(Re / r) of the circle: 69.4 minutes."""
    r, sun = 42164695.0, np.array([gravity.AU, 0, 0])
    angles = np.linspace(0, 2 * np.pi, 86165)
    circle = r * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    light = np.asarray(jax.vmap(lambda p: gravity.sunlit(p, sun))(circle))
    assert 0 <= light.min() <= light.max() <= 1
    assert light[43082] == 0
    assert light[0] == light[21541] == 1
    assert (light < 0.5).sum() == pytest.approx(2 * np.arcsin(orbit.EARTH_RADIUS / r) / (2 * np.pi) * 86164, rel=1e-3)
    assert ((light > 0) & (light < 1)).sum() == pytest.approx(
        2 * 2 * 6.957e8 / gravity.AU * 86164 / 2 / np.pi, rel=0.05
    )
