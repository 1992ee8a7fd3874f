"""Places on the ground: below a satellite, as a target in frame N, and what a station there sees.

Geodetic latitude (within 4e-11 rad) and altitude, WGS 84, by erfa.gc2gd; the Earth turns as in
`plants.surroundings.ephemeris`.
"""

from datetime import datetime
from typing import Any, NamedTuple

import erfa
import jax
import numpy as np
from jax.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.surroundings.ephemeris import to_earth

WGS84 = 1  # as erfa numbers the ellipsoids


class GroundTrack(NamedTuple):
    """Where a satellite stands over the Earth."""

    latitude: np.ndarray  # (..., n) rad, geodetic, north
    longitude: np.ndarray  # (..., n) rad, east, in (-pi, pi]
    altitude: np.ndarray  # (..., n) m above the ellipsoid


class Look(NamedTuple):
    """Where a station on the ground sees a satellite."""

    azimuth: np.ndarray  # (..., n) rad, from north over east, in (-pi, pi]
    elevation: np.ndarray  # (..., n) rad above the horizon, below it negative; no refraction
    distance: np.ndarray  # (..., n) m


def ground_track(orbit: Any, epoch: datetime, times: ArrayLike) -> GroundTrack:
    """Geodetic latitude, longitude and altitude below a satellite.

    Parameters
    ----------
    orbit : positions (..., n, 3) m in frame N at the times, or an environment with `at(t)` such as `Environment`
    epoch : UTC of time 0 (a datetime without time zone is taken as UTC)
    times : (n,) s

    Raises
    ------
    ScenarioError
        Shapes that do not fit, NaN (times after the end of an environment), an epoch before 1972 or after 2029.
    """
    times = _times(times)
    r = _to_earth(_positions(orbit, times), epoch, times)
    longitude, latitude, altitude = erfa.gc2gd(WGS84, r)
    return GroundTrack(latitude, longitude, altitude)


def target_position(
    latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike, epoch: datetime, times: ArrayLike
) -> np.ndarray:
    """Position (n, 3) m in frame N of a place on the ground at the times (n,) s after `epoch`.

    Parameters
    ----------
    latitude : () rad, geodetic, north
    longitude : () rad, east
    altitude : () m above the ellipsoid
    epoch : UTC of time 0 (a datetime without time zone is taken as UTC)
    times : (n,) s

    Raises
    ------
    ScenarioError
        NaN, a latitude beyond a pole (degrees?), an epoch before 1972 or after 2029.
    """
    times = _times(times)
    place = _place(latitude, longitude, altitude)
    return np.swapaxes(to_earth(epoch, times), -1, -2) @ place


def look(
    latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike, orbit: Any, epoch: datetime, times: ArrayLike
) -> Look:
    """Azimuth, elevation and distance of a satellite as seen from a place on the ground; visible where elevation > 0.

    The place is given as for `target_position`, the satellite as for `ground_track`; the errors are theirs.
    """
    times = _times(times)
    place = _place(latitude, longitude, altitude)
    line = _to_earth(_positions(orbit, times), epoch, times) - place
    cl, sl, cp, sp = np.cos(longitude), np.sin(longitude), np.cos(latitude), np.sin(latitude)
    axes = np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])
    east, north, up = np.moveaxis(line @ axes.T, -1, 0)
    return Look(np.arctan2(east, north), np.arctan2(up, np.hypot(east, north)), np.linalg.norm(line, axis=-1))


def _times(times: ArrayLike) -> np.ndarray:
    """Checked times (n,) s."""
    checked = np.asarray(real("times", times, (None,)))
    if not checked.size:
        raise ScenarioError("times are empty: give one at least")
    return checked


def _positions(orbit: Any, times: np.ndarray) -> np.ndarray:
    """Positions (..., n, 3) m of an array or of an environment."""
    if hasattr(orbit, "at"):
        duration = getattr(orbit, "duration", np.inf)
        if times.min() < 0 or times.max() > duration * (1 + 1e-12):
            raise ScenarioError(f"times must lie in [0, {duration:g}] s, the duration of the environment")
        with jax.enable_x64(True):
            orbit = np.asarray(jax.jit(jax.vmap(lambda t: orbit.at(t).r))(times))
    shape = np.shape(orbit)
    return real("orbit", orbit, (*shape[:-2], len(times), 3))


def _to_earth(r: np.ndarray, epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Positions r (..., n, 3) of frame N in axes fixed to the Earth."""
    return (to_earth(epoch, times) @ r[..., None])[..., 0]


def _place(latitude: ArrayLike, longitude: ArrayLike, altitude: ArrayLike) -> np.ndarray:
    """Position (3,) m of a checked place in axes fixed to the Earth."""
    latitude, longitude, altitude = (
        float(real(name, x)) for name, x in (("latitude", latitude), ("longitude", longitude), ("altitude", altitude))
    )
    if abs(latitude) > np.pi / 2 or abs(longitude) > 2 * np.pi:
        raise ScenarioError(
            f"latitude {latitude:g}, longitude {longitude:g}: angles are in rad, and a latitude ends at pi/2"
        )
    return erfa.gd2gc(WGS84, longitude, latitude, altitude)
