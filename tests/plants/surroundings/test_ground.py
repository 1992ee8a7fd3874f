"""Places on the ground: there and back, the sky above a station, and a satellite that stands still."""

from datetime import datetime

import erfa
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plants.errors import ScenarioError
from plants.surroundings import orbit
from plants.surroundings.environment import CircularEnvironment, Environment
from plants.surroundings.ephemeris import EARTH_RATE
from plants.surroundings.ground import ground_track, look, target_position

EPOCH = datetime(2024, 3, 20, 9)
TIMES = np.arange(0.0, 86400.0, 7200.0)


@given(
    st.floats(-np.pi / 2, np.pi / 2), st.floats(-3.14, 3.14), st.floats(-400.0, 3.6e7),
    st.datetimes(datetime(1972, 1, 2), datetime(2028, 1, 1)),
)  # fmt: skip
def test_a_place_is_found_again(latitude, longitude, altitude, epoch):
    r = target_position(latitude, longitude, altitude, epoch, TIMES)
    track = ground_track(r, epoch, TIMES)
    np.testing.assert_allclose(track.latitude, latitude, rtol=0, atol=4e-11)  # erfa.gc2gd: 0.3 mm
    np.testing.assert_allclose(track.altitude, altitude, rtol=0, atol=1e-6)
    if abs(latitude) < 1.57:
        turn = np.exp(1j * (track.longitude - longitude))
        np.testing.assert_allclose(turn, 1.0, rtol=0, atol=1e-11 / np.cos(latitude))


@given(st.floats(-1.5, 1.5), st.floats(-3.14, 3.14), st.floats(1e5, 4e7))
def test_above_the_station_is_at_the_zenith(latitude, longitude, altitude):
    seen = look(latitude, longitude, 0.0, target_position(latitude, longitude, altitude, EPOCH, TIMES), EPOCH, TIMES)
    np.testing.assert_allclose(seen.elevation, np.pi / 2, rtol=0, atol=1e-7)
    np.testing.assert_allclose(seen.distance, altitude, rtol=1e-9)


def test_azimuth_is_from_north_over_east():
    """Neighbours of a station, a kilometre away; all lie below the horizon by half the angle between them."""
    small = 1e3 / 6371e3
    for dn, de, azimuth in ((1, 0, 0.0), (0, 1, np.pi / 2), (0, -1, -np.pi / 2), (1, 1, np.pi / 4)):
        r = target_position(0.5 + small * dn, 1.0 + small * de / np.cos(0.5), 0.0, EPOCH, TIMES[:1])
        seen = look(0.5, 1.0, 0.0, r, EPOCH, TIMES[:1])
        assert seen.azimuth[0] == pytest.approx(azimuth, abs=0.01)
        assert seen.elevation[0] == pytest.approx(-small * np.hypot(dn, de) / 2, rel=0.02)


def test_a_place_turns_with_the_earth():
    """By Greenwich sidereal time and precession alone: nutation and the equinoxes cancel to some arc seconds."""
    r = target_position(0.0, 0.0, 0.0, EPOCH, TIMES)
    day = sum(erfa.dtf2d("UTC", 2024, 3, 20, 9, 0, 0.0)) + TIMES / 86400
    angle = erfa.gmst06(day, 0.0, day, 69.184 / 86400)
    of_date = orbit.EARTH_RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    expected = (np.swapaxes(erfa.pmat06(day, 0.0), -1, -2) @ of_date[..., None])[..., 0]
    assert np.linalg.norm(r - expected, axis=-1).max() < 2e-4 * orbit.EARTH_RADIUS
    speed = np.linalg.norm(np.diff(target_position(0.0, 0.0, 0.0, EPOCH, [0.0, 1.0]), axis=0))
    assert speed == pytest.approx(EARTH_RATE * orbit.EARTH_RADIUS, rel=1e-8)


def test_a_geostationary_satellite_stands_still():
    radius = (orbit.MU / EARTH_RATE**2) ** (1 / 3)
    times = np.arange(0.0, 86401.0, 600.0)
    track = ground_track(orbit.propagate(orbit.keplerian(radius, 0.0, 0.0), times, ()).r, EPOCH, times)
    assert np.ptp(np.unwrap(track.longitude)) < 1e-5
    assert np.abs(track.latitude).max() < 0.0024  # precession since 2000
    np.testing.assert_allclose(track.altitude, radius - orbit.EARTH_RADIUS, rtol=0, atol=1.0)


def test_environments_and_positions_give_the_same_track():
    start, times = orbit.circular(500e3, 0.9, 0.3), np.arange(0.0, 601.0, 10.0)
    by_table = ground_track(Environment.along(start, EPOCH, 600.0), EPOCH, times)
    many = orbit.propagate(orbit.circular(500e3, 0.9, [0.3, 1.3]), times)
    by_position = ground_track(many.r, EPOCH, times)
    for one, two in zip(by_table, by_position, strict=True):
        np.testing.assert_allclose(one, two[0], rtol=1e-9, atol=1e-9)
    assert by_position.latitude.shape == (2, len(times))
    ideal = ground_track(CircularEnvironment.along(start), EPOCH, [0.0, 1e5])
    assert np.isfinite(ideal.altitude).all()
    assert np.abs(by_table.latitude).max() <= 0.9 + 0.004
    seen = look(0.1, 0.1, 0.0, many.r, EPOCH, times)
    assert seen.elevation.shape == (2, len(times))


def test_mistakes_are_named():
    r = np.ones((3, 3)) * 7e6
    with pytest.raises(ScenarioError, match="latitude 45, longitude 0: angles are in rad"):
        target_position(45.0, 0.0, 0.0, EPOCH, [0.0])
    with pytest.raises(ScenarioError, match="altitude must be finite"):
        target_position(0.1, 0.0, np.nan, EPOCH, [0.0])
    with pytest.raises(ScenarioError, match="times are empty"):
        target_position(0.1, 0.0, 0.0, EPOCH, [])
    with pytest.raises(ScenarioError, match=r"orbit must have shape \(2, 3\)"):
        ground_track(r, EPOCH, [0.0, 1.0])
    with pytest.raises(ScenarioError, match="epoch"):
        ground_track(r, datetime(2035, 1, 1), [0.0, 1.0, 2.0])
    with pytest.raises(ScenarioError, match="duration of the environment"):
        ground_track(Environment.along(orbit.circular(500e3, 0.9), EPOCH, 600.0), EPOCH, [0.0, 601.0])
