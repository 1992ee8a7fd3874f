"""Air: the published table, its borders and its range, and what an environment makes of it."""

import sys
from datetime import datetime
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from plants.errors import ScenarioError
from plants.surroundings import orbit
from plants.surroundings.atmosphere import LAYERS, Atmosphere, LayeredAtmosphere
from plants.surroundings.environment import Environment
from plants.surroundings.msis import Msis

EPOCH = datetime(2024, 3, 20, 9)
AIR = LayeredAtmosphere()
TIMES = np.arange(0.0, 600.0, 7.0)  # s


def over_the_equator(altitude):
    return (orbit.EARTH_RADIUS + np.asarray(altitude, float))[..., None] * np.array([0.6, 0.8, 0.0])


def along(model, altitude):
    altitude = np.atleast_1d(altitude)
    return model.along(over_the_equator(altitude), EPOCH, np.arange(len(altitude)) * 1.0)


def flown(environment, times):
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, jax.jit(jax.vmap(environment.at))(np.asarray(times)))


@pytest.mark.parametrize(
    ("altitude", "density"),
    [
        (100, 5.297e-7), (110, 9.661e-8), (150, 2.070e-9), (200, 2.789e-10), (300, 2.418e-11), (400, 3.725e-12),
        (500, 6.967e-13), (600, 1.454e-13), (700, 3.614e-14), (800, 1.170e-14), (900, 5.245e-15), (1000, 3.019e-15),
    ],
)  # fmt: skip
def test_density_is_the_published_one(altitude, density):
    """Vallado (2013), table 8-4; the file's own table is read nowhere here."""
    inside = altitude * 1e3 + (0.1 if altitude == 100 else -0.1)  # m, of the range
    assert along(AIR, inside)[0] == pytest.approx(density, rel=1.1e-4)
    assert along(LayeredAtmosphere(factor=3.0), inside)[0] == pytest.approx(3 * density, rel=1.1e-4)


def test_layers_nearly_meet():
    """The claim of the header: 0.008 % above 100 km; and a factor of e from one scale height to the next."""
    assert len(LAYERS) == 28
    base, density, scale_height = LAYERS[LAYERS[:, 0] >= 100e3].T
    jumps = density[:-1] * np.exp(-np.diff(base) / scale_height[:-1]) / density[1:] - 1
    assert np.abs(jumps).max() < 8.5e-5
    heights = np.arange(100e3, 1000e3, 250.0)
    falls = np.diff(np.log(along(AIR, heights)))
    assert falls.max() < 0
    assert along(AIR, 450e3)[0] / along(AIR, 450e3 + 0.1 * 60.828e3)[0] == pytest.approx(np.exp(0.1), rel=1e-9)


def test_default_is_the_old_one_in_the_layer_of_the_studies():
    heights = np.linspace(450e3 + 1, 500e3 - 1, 200)
    np.testing.assert_allclose(along(AIR, heights), along(Atmosphere(), heights), rtol=1e-14)


@pytest.mark.parametrize(
    ("altitude", "told"), [(99e3, "99.0 km high at 0 s"), (1001e3, "1001.0 km high"), (np.nan, "nan km high")]
)
def test_beyond_its_range_the_table_raises(altitude, told):
    with pytest.raises(ScenarioError, match=f"{told}.*100 to 1000 km.*highest=np.inf"):
        along(AIR, altitude)
    if altitude > 1000e3:
        wide = along(LayeredAtmosphere(highest=np.inf), [altitude, 36e6])
        assert wide[0] == pytest.approx(3.019e-15, rel=0.01)
        assert 0 < wide[1] < 1e-60


def test_the_first_place_beyond_the_range_is_named():
    with pytest.raises(ScenarioError, match=r"1200.0 km high at 2 s"):
        along(AIR, [500e3, 900e3, 1200e3, 1100e3])


@pytest.mark.parametrize(
    ("model", "named"),
    [
        (LayeredAtmosphere(factor=-1.0), "factor"), (LayeredAtmosphere(factor=np.nan), "factor"),
        (LayeredAtmosphere(lowest=-5.0), "lowest"), (LayeredAtmosphere(lowest=600e3, highest=500e3), "highest"),
        (Atmosphere(density=0.0), "density"), (Atmosphere(scale_height=-1.0), "scale_height"),
    ],
)  # fmt: skip
def test_impossible_airs_are_refused(model, named):
    with pytest.raises(ScenarioError, match=named):
        along(model, 550e3)


@pytest.mark.parametrize("altitude", [200e3, 300e3, 600e3, 900e3])
def test_environment_holds_the_table_along_its_orbit(altitude):
    """Where the old default was wrong: 0.35 of the table at 200 km, 0.43 at 800 km, 0.062 at 1000 km."""
    got = flown(Environment.along(orbit.circular(altitude, 0.9), EPOCH, 600.0), TIMES)
    np.testing.assert_allclose(got.density, AIR.along(got.r, EPOCH, np.arange(len(got.r))), rtol=1e-3)


@pytest.mark.parametrize("altitude", [95e3, 998e3, 1500e3])
def test_environment_of_an_orbit_beyond_the_table_is_refused(altitude):
    start = orbit.circular(altitude, 1.5)  # over a pole the ground is 21 km lower
    with pytest.raises(ScenarioError, match=r"atmosphere: the orbit is .* km high at"):
        Environment.along(start, EPOCH, 600.0)
    nothing = flown(Environment.along(start, EPOCH, 600.0, atmosphere=None), TIMES)
    assert np.isnan(nothing.density).all()
    assert all(np.isfinite(getattr(nothing, name)).all() for name in nothing._fields if name != "density")


def test_air_of_an_eccentric_orbit_stays_positive_and_near_the_table():
    """Through eighteen layers in half an hour; a spline of the density itself would fall below zero."""
    start = orbit.keplerian(24500e3, 0.73, 0.4, 1.0, 2.0, -1.5)
    air = LayeredAtmosphere(highest=np.inf)
    got = flown(Environment.along(start, EPOCH, 3000.0, atmosphere=air), np.arange(0.0, 3000.0, 1.0))
    expected = air.along(got.r, EPOCH, np.arange(len(got.r)))
    assert expected.max() / expected.min() > 1e6
    np.testing.assert_allclose(got.density, expected, rtol=0.01)


def test_a_model_of_the_users_own_is_enough():
    """Any class with `along` serves, and what it returns is checked."""
    night = SimpleNamespace(along=lambda r, epoch, times: 1e-13 * (2 + np.sin(2e-3 * times)))
    start = orbit.circular(500e3, 0.3)
    got = flown(Environment.along(start, EPOCH, 600.0, atmosphere=night), TIMES)
    np.testing.assert_allclose(got.density, 1e-13 * (2 + np.sin(2e-3 * TIMES)), rtol=1e-8)
    for wrong in (0.0, -1e-13, np.nan):
        broken = SimpleNamespace(along=lambda r, epoch, times, wrong=wrong: np.full(len(times), wrong))
        with pytest.raises(ScenarioError, match="density"):
            Environment.along(start, EPOCH, 600.0, atmosphere=broken)
    with pytest.raises(ScenarioError, match="density must have shape"):
        Environment.along(start, EPOCH, 600.0, atmosphere=SimpleNamespace(along=lambda r, epoch, times: 1e-13))


def test_without_its_package_msis_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pymsis", None)
    with pytest.raises(ScenarioError, match=r"pip install 'convex-synth\[msis\]'"):
        Msis.create()
