"""Surroundings: field against ppigrf, Sun against erfa, shadow, splines, and the two ideal environments."""

from datetime import UTC, datetime, timedelta, timezone

import erfa
import jax
import numpy as np
import ppigrf
import pytest

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.surroundings import environment, orbit
from plants.surroundings.atmosphere import Atmosphere
from plants.surroundings.environment import CircularEnvironment, Environment, FreeSpace

EPOCH = datetime(2024, 3, 20, 9)
LOW = orbit.circular(470e3, np.deg2rad(51.6), 2.0, 0.4)
ANGLE = np.deg2rad(51.6)


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def surroundings():
    return Environment.along(LOW, EPOCH, 6000.0)


def sample(surroundings, times):
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, jax.jit(jax.vmap(surroundings.at))(np.asarray(times)))


BETWEEN = np.array([3.3, 15.0, 555.5, 1234.5, 2777.7, 4321.0, 5999.9])  # s, not on the 10 s grid


def test_field_is_that_of_ppigrf(surroundings):
    """Through another door: geodetic coordinates, and Earth rotation matrices built one by one."""
    got = sample(surroundings, BETWEEN)
    for t, r, B in zip(BETWEEN, got.r, got.B, strict=True):
        utc = erfa.dtf2d("UTC", 2024, 3, 20, 9, 0, 0.0)
        tt = erfa.taitt(*erfa.utctai(*utc))
        day = t / 86400
        M = erfa.rz(erfa.era00(utc[0], utc[1] + day), erfa.c2i06a(tt[0], tt[1] + day))
        longitude, latitude, height = erfa.gc2gd(1, M @ r)
        east, north, up = ppigrf.igrf(np.degrees(longitude), np.degrees(latitude), height / 1e3, EPOCH)
        cl, sl, cp, sp = np.cos(longitude), np.sin(longitude), np.cos(latitude), np.sin(latitude)
        axes = np.array([[-sl, cl, 0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
        expected = M.T @ axes.T @ np.array([east[0], north[0], up[0]])
        np.testing.assert_allclose(B * 1e9, expected, rtol=0, atol=0.05)  # nT


def test_sun_is_that_of_erfa_seen_from_the_spacecraft(surroundings):
    got = sample(surroundings, BETWEEN)
    tai = erfa.utctai(*erfa.dtf2d("UTC", 2024, 3, 20, 9, 0, 0.0))
    for t, r, sun in zip(BETWEEN, got.r, got.sun, strict=True):
        earth, _ = erfa.epv00(*erfa.taitt(tai[0], tai[1] + t / 86400))
        expected = -earth["p"] * erfa.DAU - r
        np.testing.assert_allclose(sun, expected / np.linalg.norm(expected), rtol=0, atol=1e-12)


def test_sun_follows_the_low_precision_almanac():
    """Formula of the Astronomical Almanac (0.01 deg), mean equinox of date: 6 hours after the equinox of 2024."""
    n = sum(erfa.dtf2d("UTC", 2024, 3, 20, 9, 0, 0.0)) - 2451545.0
    mean, anomaly = np.deg2rad(280.460 + 0.9856474 * n), np.deg2rad(357.528 + 0.9856003 * n)
    longitude = mean + np.deg2rad(1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    obliquity = np.deg2rad(23.439)
    of_date = [np.cos(longitude), np.cos(obliquity) * np.sin(longitude), np.sin(obliquity) * np.sin(longitude)]
    expected = erfa.pmat06(2451545.0, n).T @ of_date
    sun = environment.sun_position(EPOCH, np.zeros(1))[0]
    assert np.arccos(expected @ sun / np.linalg.norm(sun)) < np.deg2rad(0.02)


def test_splines_hit_their_sources_between_the_points(surroundings):
    """At 10 s; the source is a table that has its points at the times asked for."""
    times = np.arange(0, 6000.0, 2.0)
    got, exact = sample(surroundings, times), sample(Environment.along(LOW, EPOCH, 6000.0, step=2.0), times)
    bounds = {
        "r": 5e-3, "v": 5e-6, "B": 1e-12, "sun": 1e-13, "sunlit": 1e-8, "density": 2e-21,
        "q_ON": 5e-11, "w_ON": 1e-15,
    }  # fmt: skip
    for name, bound in bounds.items():
        error = np.abs(getattr(got, name) - getattr(exact, name)).max()
        assert error < bound, (name, error)
    turn = attitude.angle(attitude.compose(got.q_ON, attitude.conjugate(exact.q_ON)))
    assert turn.max() < 5e-12


def test_orbit_and_frame_in_the_table_are_those_of_the_orbit_module(surroundings):
    times = np.arange(0, 1000.0, 10.0)
    got, (r, v) = sample(surroundings, times), orbit.propagate(LOW, times)
    np.testing.assert_allclose(got.r, r, rtol=1e-14)
    np.testing.assert_allclose(got.v, v, rtol=1e-14)
    frame = orbit.orbital_frame(r, v)
    np.testing.assert_allclose(attitude.angle(attitude.compose(got.q_ON, attitude.conjugate(frame))), 0, atol=1e-14)
    np.testing.assert_allclose(got.w_ON, orbit.orbital_frame_rate(r, v), rtol=0, atol=1e-17)


def test_frame_attitude_has_no_jumps_over_a_revolution(surroundings):
    q = sample(surroundings, np.arange(0, 6000.0, 5.0)).q_ON
    assert np.abs(np.diff(q, axis=0)).max() < 5 * 0.0012
    assert q.min(axis=0)[0] < 0 < q.max(axis=0)[0]  # the scalar part does change sign


def test_shadow_against_the_overlap_of_two_discs(surroundings):
    """Both discs as seen from the spacecraft, summed on a grid of points over the Sun's darkened disc."""
    period = 2 * np.pi / float(orbit.rate(LOW.r))
    got = sample(surroundings, np.arange(0, period, 1.0))
    cosine = -np.sum(got.r * got.sun, axis=1) / np.linalg.norm(got.r, axis=1)
    separation = np.arccos(cosine)
    earth = np.arcsin(orbit.EARTH_RADIUS / np.linalg.norm(got.r, axis=1))
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 201)])
    inside = x**2 + y**2 < 1
    brightness = np.sqrt(1 - (x**2 + y**2)[inside])
    radius = environment.SUN_ANGULAR_RADIUS
    seen = [np.average(np.hypot(s + radius * x[inside], radius * y[inside]) > e, weights=brightness)
            for s, e in zip(separation, earth, strict=True)]  # fmt: skip
    partly = (got.sunlit > 0) & (got.sunlit < 1)
    assert 10 < partly.sum() < 40  # two passages of about 8 s
    normal = np.cross(*LOW) / np.linalg.norm(LOW.r) / np.linalg.norm(LOW.v)
    height = np.sqrt(1 - (normal @ got.sun[0]) ** 2)  # cosine of the Sun's elevation above the orbit plane
    cylinder = np.arccos(np.cos(np.median(earth)) / height) / np.pi * period
    assert (got.sunlit < 0.5).sum() == pytest.approx(cylinder, rel=0.01)
    np.testing.assert_allclose(got.sunlit, seen, rtol=0, atol=0.01)


def test_visible_fraction_is_exact_at_its_ends_and_has_slopes():
    radius = environment.SUN_ANGULAR_RADIUS
    for angle, fraction in ((-1.2, 0.0), (-radius, 0.0), (0.0, 0.5), (radius, 1.0), (1.2, 1.0)):
        assert environment.visible_fraction(angle) == fraction
    slopes = jax.vmap(jax.grad(environment.visible_fraction))(np.array([-1.0, -radius, 0.0, radius, 1.0]))
    np.testing.assert_allclose(slopes, [0, 0, 0.75 / radius, 0, 0], atol=1e-12)


def test_density_is_the_tabulated_one_at_the_reference_altitude():
    r = np.array([[orbit.EARTH_RADIUS + 450e3, 0, 0], [0, 0, 6356752.3142 + 510.828e3]])
    np.testing.assert_allclose(Atmosphere().at(r), [1.585e-12, 1.585e-12 / np.e], rtol=1e-6)


def test_outside_its_duration_the_table_knows_nothing():
    surroundings = Environment.along(LOW, EPOCH, 95.0)
    inside, outside = sample(surroundings, [0.0, 94.0, 95.0]), sample(surroundings, [-1e-9, 95.001, 1e6])
    assert all(np.isfinite(field).all() for field in inside)
    assert np.isnan(outside.r).all()
    assert np.isnan(outside.q_ON).all()


def test_batch_of_orbits_equals_single_ones():
    nodes = np.array([2.0, 4.5])
    batch = Environment.along(orbit.circular(470e3, ANGLE, nodes, 0.4), EPOCH, 100.0)
    at = jax.jit(lambda e: e.at(33.0))
    got = jax.jit(jax.vmap(at))(batch)
    for i, node in enumerate(nodes):
        single = at(Environment.along(orbit.circular(470e3, ANGLE, node, 0.4), EPOCH, 100.0))
        jax.tree.map(lambda a, b, i=i: np.testing.assert_allclose(a[i], b, rtol=1e-12, atol=1e-25), got, single)


def test_time_zones_mean_the_same_instant():
    summer = timezone(timedelta(hours=2))
    times = np.array([0.0])
    expected = environment.sun_position(EPOCH, times)
    np.testing.assert_array_equal(environment.sun_position(EPOCH.replace(tzinfo=UTC), times), expected)
    np.testing.assert_array_equal(environment.sun_position(datetime(2024, 3, 20, 11, tzinfo=summer), times), expected)


def test_the_precision_flag_of_the_user_stays():
    with jax.enable_x64(False):
        surroundings = Environment.along(LOW, EPOCH, 50.0)
        assert np.asarray(surroundings.splines).dtype == np.float64
        assert jax.numpy.zeros(1).dtype == np.float32


@pytest.fixture(scope="module")
def eccentric():
    """A transfer ellipse, from an hour before its perigee of 230 km."""
    start = orbit.keplerian(24500e3, 0.73, 0.4, 1.0, 2.0, -2.4)
    return Environment.along(start, EPOCH, 8000.0, atmosphere=None)


@pytest.mark.parametrize("t", [500.0, 2000.0, 3600.0, 7000.0])
def test_frame_of_an_eccentric_orbit_turns_unevenly(eccentric, t):
    """Rate and acceleration: w_y = -h / r^2, whose derivative is 2 h (r.v) / r^4; z to nadir, y against the normal."""
    env, slope = jax.jit(lambda t: jax.jvp(eccentric.at, (t,), (1.0,)))(t)
    r, h = np.linalg.norm(env.r), np.linalg.norm(np.cross(env.r, env.v))
    assert env.w_ON[1] == pytest.approx(-h / r**2, rel=1e-9)
    assert slope.w_ON[1] == pytest.approx(2 * h * np.dot(env.r, env.v) / r**4, rel=2e-3, abs=1e-12)  # J2 changes h
    np.testing.assert_allclose(slope.q_ON, attitude.kinematics(env.q_ON, env.w_ON), rtol=0, atol=3e-10)
    turn = attitude.compose(env.q_ON, attitude.conjugate(orbit.orbital_frame(env.r, env.v)))
    assert attitude.angle(turn) < 1e-10


def test_a_step_too_long_for_the_perigee_is_refused(eccentric):
    assert 7.0 < eccentric.step < 9.0  # chosen
    with pytest.raises(ScenarioError, match=r"step = 120 s is too long .* at most 6"):
        Environment.along(orbit.keplerian(24500e3, 0.73, 0.4), EPOCH, 8000.0, step=120.0)


def test_worlds_say_how_long_they_last(surroundings):
    assert (surroundings.duration, surroundings.step) == (6000.0, 10.0)
    assert CircularEnvironment.along(LOW).duration == FreeSpace().duration == np.inf


@pytest.mark.parametrize("kind", ["table", "circular"])
def test_frame_rate_and_velocity_are_the_derivatives_along_time(surroundings, kind):
    world = surroundings if kind == "table" else CircularEnvironment.along(LOW)
    along = jax.jit(lambda t: jax.jvp(world.at, (t,), (1.0,)))
    for t in (0.5, 777.0):
        env, slope = along(t)
        np.testing.assert_allclose(slope.r, env.v, rtol=0, atol=3e-3)  # h^3 d4r/dt4 / 24, times 3 at the ends
        np.testing.assert_allclose(slope.q_ON, attitude.kinematics(env.q_ON, env.w_ON), rtol=0, atol=1e-10)
        turn = attitude.compose(env.q_ON, attitude.conjugate(orbit.orbital_frame(env.r, env.v)))
        assert attitude.angle(turn) < 1e-11


def test_circular_environment_turns_at_the_orbital_rate_and_keeps_its_radius():
    world = CircularEnvironment.along(LOW)
    env = world.at(1234.0)
    assert np.linalg.norm(env.r) == pytest.approx(np.linalg.norm(LOW.r), rel=1e-14)
    np.testing.assert_allclose(env.w_ON, [0, -float(orbit.rate(LOW.r)), 0], rtol=0, atol=0)
    assert np.isnan(env.B).all()
    with pytest.raises(ScenarioError, match="circular"):
        CircularEnvironment.along(orbit.Orbit(LOW.r, 1.01 * LOW.v))


def test_free_space_has_a_frame_and_nothing_else():
    env = FreeSpace().at(7.0)
    np.testing.assert_array_equal(env.q_ON, [1, 0, 0, 0])
    np.testing.assert_array_equal(env.w_ON, [0, 0, 0])
    assert all(np.isnan(part).all() for part in (env.r, env.v, env.B, env.sun, env.sunlit, env.density))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 0.0}, "duration"), ({"duration": np.nan}, "duration"), ({"step": -1.0}, "step"),
        ({"epoch": "2024-03-20"}, "epoch = .*give a datetime"), ({"atmosphere": 1e-12}, "atmosphere must be"),
        ({"forces": ("J2",)}, "forces"), ({"start": 7e6}, "must be an Orbit"),
        ({"start": orbit.Orbit(LOW.r, 2 * LOW.v)}, "no ellipse"),
        ({"epoch": datetime(2031, 1, 1)}, "epoch"), ({"epoch": datetime(1850, 1, 1)}, "epoch"),
    ],
)  # fmt: skip
def test_bad_scenarios_are_refused(change, message):
    arguments = {"start": LOW, "epoch": EPOCH, "duration": 100.0, "step": 10.0} | change
    with pytest.raises(ScenarioError, match=message):
        Environment.along(**arguments)
