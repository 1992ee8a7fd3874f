"""NRLMSISE-00: day and night, quiet and active Sun, and the table, which is a mean of them."""

from datetime import datetime

import jax
import numpy as np
import pytest

from plants.errors import ScenarioError
from plants.surroundings import orbit
from plants.surroundings.atmosphere import LayeredAtmosphere
from plants.surroundings.environment import Environment
from plants.surroundings.forces import DragForce
from plants.surroundings.msis import Msis

pytest.importorskip("pymsis", reason="NRLMSISE-00 is an extra: pip install 'convex-synth[msis]'")

EPOCH = datetime(2024, 3, 20, 9)
TIMES = np.arange(0.0, 6000.0, 100.0)


def around(altitude):
    return orbit.propagate(orbit.circular(altitude, 0.9), TIMES, ()).r


@pytest.mark.parametrize("altitude", [200e3, 400e3, 500e3])
def test_a_mean_sun_has_the_air_of_the_table(altitude):
    r = around(altitude)
    mean = Msis.create().along(r, EPOCH, TIMES).mean()
    assert 0.4 < mean / LayeredAtmosphere().along(r, EPOCH, TIMES).mean() < 2.5


def test_day_and_activity_swell_the_air():
    r = around(500e3)
    quiet, active = (Msis.create(flux).along(r, EPOCH, TIMES) for flux in (70.0, 220.0))
    assert active.mean() > 10 * quiet.mean()
    assert active.max() > 2 * active.min()
    np.testing.assert_allclose(Msis.create(70.0).along(np.stack([r, r]), EPOCH, TIMES)[1], quiet, rtol=1e-6)


def test_environment_takes_it():
    air = Msis.create(150.0, 140.0, ap=4.0)
    surroundings = Environment.along(orbit.circular(500e3, 0.9), EPOCH, 600.0, atmosphere=air)
    with jax.enable_x64(True):
        got = jax.tree.map(np.asarray, jax.jit(jax.vmap(surroundings.at))(np.array([0.0, 15.0, 600.0])))
    np.testing.assert_allclose(got.density, air.along(got.r, EPOCH, np.array([0.0, 15.0, 600.0])), rtol=1e-4)


def test_mistakes_are_named():
    for wrong in ({"f107": 0.0}, {"f107_average": np.nan}, {"ap": -1.0}):
        with pytest.raises(ScenarioError, match=next(iter(wrong))):
            Msis.create(**wrong)
    with pytest.raises(ScenarioError, match=r"1200\.0 km high.*100 to 1000 km"):
        Msis.create().along(around(1200e3), EPOCH, TIMES)
    with pytest.raises(ScenarioError, match="epoch is missing"):
        Msis.create().along(around(500e3), None, TIMES)
    with pytest.raises(ScenarioError, match="can be compiled"):
        DragForce.create(0.01, Msis.create())
