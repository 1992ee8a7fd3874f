"""What surrounds a spacecraft: orbit, geomagnetic field, Sun, eclipse and air density as functions of time.

None of it depends on attitude. It is computed once on a grid by NumPy, ppigrf (IGRF) and pyerfa, turned into cubic
splines, and evaluated inside the compiled loop: at 10 s in low orbit the splines are within 1e-12 rad (attitude
of frame O), 3 mm, 0.001 nT and 1e-8 of the solar disc of their sources.

Frame N is the GCRS; its z axis also serves as the Earth's axis for J2 and for the air that turns with the Earth
(precession since 2000 is 0.13 deg in 2024), while the field is evaluated in the true terrestrial frame with
UT1 = UTC and no polar motion. The Sun is geometric (no aberration), seen from the spacecraft. The shadow is the
cone of a spherical Earth whose limb is taken as straight across a solar disc that darkens towards its edge.
"""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import NamedTuple

import erfa
import jax
import jax.numpy as jnp
import numpy as np
import ppigrf
from jax import Array
from jax.typing import ArrayLike
from scipy.interpolate import CubicSpline

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.surroundings import orbit
from plants.surroundings.orbit import EARTH_RADIUS, Orbit

DAY = 86400.0  # () s
EARLIEST, LATEST = datetime(1972, 1, 1), datetime(2030, 1, 1)  # UTC with leap seconds; IGRF-14
FLATTENING = 1 / 298.257223563  # ()  WGS 84
SUN_ANGULAR_RADIUS = 6.957e8 / erfa.DAU  # () rad  nominal solar radius (IAU 2015 resolution B3) at 1 au


class OrbitEnv(NamedTuple):
    """The surroundings at one time; N is the inertial frame, O the orbital frame. NaN is "not modelled"."""

    r: Array  # (3,) m, N
    v: Array  # (3,) m/s, N
    B: Array  # (3,) T, N, magnetic field
    sun: Array  # (3,) unit vector to the Sun, N
    sunlit: Array  # () visible fraction of the solar disc
    density: Array  # () kg/m^3, air
    q_ON: Array  # (4,) attitude of frame O relative to N
    w_ON: Array  # (3,) rad/s, inertial rate of frame O in the axes of O


class Atmosphere(NamedTuple):
    """Exponential atmosphere; the default is the 450 to 500 km layer of Vallado (2013), table 8-4."""

    density: float = 1.585e-12  # () kg/m^3 at `altitude`
    altitude: float = 450e3  # () m above the ellipsoid
    scale_height: float = 60.828e3  # () m

    def at(self, r: np.ndarray) -> np.ndarray:
        """Density (...) kg/m^3 at r (..., 3) m; height above the ellipsoid along the radius."""
        distance = np.linalg.norm(r, axis=-1)
        ground = EARTH_RADIUS * (1 - FLATTENING * (r[..., 2] / distance) ** 2)
        return self.density * np.exp((self.altitude - (distance - ground)) / self.scale_height)


@partial(blocks.node, data_fields=["splines"], meta_fields=["step", "duration"])
@dataclass(frozen=True, kw_only=True)
class Environment:
    """Surroundings along an orbit, from splines; build it with `Environment.along`.

    A batch of environments (leading axes of `splines`) is used through `vmap`.
    """

    splines: Numbers  # (..., n, 4, 21) cubic coefficients of every interval, lowest power first
    step: float  # () s, length of an interval
    duration: float  # () s, from the epoch

    @classmethod
    def along(
        cls,
        start: Orbit,
        epoch: datetime,
        duration: float,
        *,
        step: float = 10.0,
        atmosphere: Atmosphere = Atmosphere(),  # noqa: B008 (immutable)
    ) -> "Environment":
        """Environment of a spacecraft that flies the orbit from `start` at `epoch` for `duration`.

        Parameters
        ----------
        start : (..., 3) m, (..., 3) m/s in frame N; leading axes give a batch of environments
        epoch : UTC (a datetime without time zone is taken as UTC)
        duration : () s, the last time at which `at` may be called
        step : () s, between two points of the table
        atmosphere : density of the air

        Raises
        ------
        ScenarioError
            NaN, negative or zero duration or step, an epoch before 1972 or after 2029, an orbit inside the Earth.
        """
        for name, value in (("duration", duration), ("step", step)):
            positive(name, value)
        intervals = max(int(np.ceil(duration / step)) + 1, 4)  # one more than needed: t = duration falls inside
        times = step * np.arange(intervals + 1)
        r, v = orbit.propagate(start, times)
        sun = sun_position(epoch, times) - r
        with jax.enable_x64(True):
            q_ON, w_ON = (np.asarray(f(r, v)) for f in (orbit.orbital_frame, orbit.orbital_frame_rate))
        columns = [
            r, v, magnetic_field(r, epoch, times), sun / np.linalg.norm(sun, axis=-1, keepdims=True),
            limb_angle(r, sun)[..., None], atmosphere.at(r)[..., None], _without_jumps(q_ON), w_ON,
        ]  # fmt: skip
        powers = CubicSpline(times / step, np.concatenate(columns, axis=-1), axis=-2).c[::-1]
        return cls(splines=np.moveaxis(powers, (0, 1), (-2, -3)), step=float(step), duration=float(duration))

    def sun_field_angle(self) -> np.ndarray:
        """Angle between the lines of Sun and field at the points of the table, (..., n) rad in [0, pi/2].

        An attitude from these two directions has an error of about 1 / sin of it about the bisecting axis.
        """
        B, sun = self.splines[..., 0, 6:9], self.splines[..., 0, 9:12]
        return np.arcsin(np.linalg.norm(np.cross(B, sun), axis=-1) / np.linalg.norm(B, axis=-1))

    def at(self, t: ArrayLike) -> OrbitEnv:
        """Surroundings at t () s; all NaN outside [0, duration]."""
        s, c = piece(self.splines, self.step, self.duration, t)
        row = c[0] + s * (c[1] + s * (c[2] + s * c[3]))
        return OrbitEnv(
            r=row[0:3], v=row[3:6], B=row[6:9], sun=row[9:12], sunlit=visible_fraction(row[12]),
            density=row[13], q_ON=row[14:18], w_ON=row[18:21],
        )  # fmt: skip


def piece(splines: Numbers, step: float, duration: float, t: ArrayLike) -> tuple[Array, Array]:
    """Where t () s lies in a table of cubic splines (n, 4, k): s () in [0, 1] of its interval, whose cubic is c (4, k).

    The value is c[0] + s c[1] + s^2 c[2] + s^3 c[3]. Outside [0, duration] s is NaN, so that all that follows is.
    """
    table, t = jnp.asarray(splines), jnp.asarray(t)
    place = t / step
    i = jnp.clip(jnp.floor(place).astype(int), 0, table.shape[0] - 1)
    known = (t >= 0) & (t <= duration * (1 + 1e-12))
    return jnp.where(known, place - i, jnp.nan), table[i]


@partial(blocks.node, data_fields=["r", "v", "q_ON"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class CircularEnvironment:
    """Ideal circular two-body orbit and its frame O; field, Sun and air are not modelled (NaN)."""

    r: Numbers  # (3,) m, N, at t = 0
    v: Numbers  # (3,) m/s, N, at t = 0
    q_ON: Numbers  # (4,) attitude of frame O at t = 0

    @classmethod
    def along(cls, start: Orbit) -> "CircularEnvironment":
        """Environment of the orbit through `start`; ScenarioError if that orbit is not circular."""
        r, v = real("r", start.r, (3,)), real("v", start.v, (3,))
        with jax.enable_x64(True):
            speed = np.linalg.norm(r) * float(orbit.rate(r))
            if abs(np.linalg.norm(v) / speed - 1) > 1e-12 or abs(r @ v) > 1e-12 * np.linalg.norm(r) * speed:
                raise ScenarioError(f"start must be a circular orbit, got r {r.tolist()}, v {v.tolist()}")
            return cls(r=r, v=v, q_ON=np.asarray(orbit.orbital_frame(r, v)))

    def at(self, t: ArrayLike) -> OrbitEnv:
        """Surroundings at any t () s."""
        r, v = jnp.asarray(self.r), jnp.asarray(self.v)
        w = orbit.rate(r)
        c, s = jnp.cos(w * t), jnp.sin(w * t)
        half = 0.5 * w * t
        turn = jnp.stack([jnp.cos(half), 0 * half, -jnp.sin(half), 0 * half])
        return _without_field()._replace(
            r=c * r + s / w * v, v=c * v - s * w * r,
            q_ON=attitude.compose(turn, self.q_ON), w_ON=jnp.stack([0 * w, -w, 0 * w]),
        )  # fmt: skip


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class FreeSpace:
    """No orbit: frame O is frame N and nothing else is modelled (NaN). For inertial pointing."""

    def at(self, t: ArrayLike) -> OrbitEnv:
        """Surroundings at any t () s."""
        del t
        return _without_field()._replace(q_ON=jnp.array([1.0, 0.0, 0.0, 0.0]), w_ON=jnp.zeros(3))


def magnetic_field(r: np.ndarray, epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Geomagnetic field in T along r (..., n, 3) m at the times (n,) s after `epoch`, both in frame N.

    IGRF of degree 13, with the coefficients of the middle of the interval (they drift by less than 1 nT in
    three days).
    """
    middle = _utc(epoch, float(times[-1])) + timedelta(seconds=float(times[-1]) / 2)
    utc1, utc2, tt1, tt2 = julian(epoch, times)
    to_earth = erfa.c2t06a(tt1, tt2, utc1, utc2, 0.0, 0.0)  # (n, 3, 3) GCRS to ITRS
    x, y, z = np.moveaxis((to_earth @ r[..., None])[..., 0], -1, 0)
    distance = np.linalg.norm(r, axis=-1)
    colatitude, longitude = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    up, south, east = (
        nanotesla[0] * 1e-9
        for nanotesla in ppigrf.igrf_gc(distance / 1e3, np.degrees(colatitude), np.degrees(longitude), middle)
    )
    out = up * np.sin(colatitude) + south * np.cos(colatitude)
    c, s = np.cos(longitude), np.sin(longitude)
    field = np.stack([out * c - east * s, out * s + east * c, up * np.cos(colatitude) - south * np.sin(colatitude)], -1)
    return (np.swapaxes(to_earth, -1, -2) @ field[..., None])[..., 0]


def sun_position(epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Geocentric position of the Sun in m, frame N, at the times (n,) s after `epoch`: (n, 3). erfa.epv00."""
    _, _, tt1, tt2 = julian(epoch, times)
    heliocentric, _ = erfa.epv00(tt1, tt2)
    return -erfa.DAU * heliocentric["p"]


def limb_angle(r: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Angle of the Sun's centre above the Earth's limb: r (..., 3) m, sun (..., 3) any length -> (...) rad."""
    distance = np.linalg.norm(r, axis=-1)
    cosine = -np.sum(r * sun, axis=-1) / distance / np.linalg.norm(sun, axis=-1)
    return np.arccos(np.clip(cosine, -1, 1)) - np.arcsin(EARTH_RADIUS / distance)


def visible_fraction(angle: ArrayLike) -> Array:
    """Fraction of sunlight that passes a straight limb when the Sun's centre is `angle` (...) rad above it: (...).

    For a disc as bright as sqrt(1 - (distance from its centre)^2): with a uniform disc, of which an arcsine would
    be the price, this brackets the true limb darkening, within 0.02 either way.
    """
    x = jnp.clip(jnp.asarray(angle) / SUN_ANGULAR_RADIUS, -1, 1)
    return 0.5 + 0.25 * x * (3 - x**2)


def _without_jumps(q: np.ndarray) -> np.ndarray:
    """The same q (..., n, 4) with signs such that neighbours along n are close."""
    same = np.sum(q[..., 1:, :] * q[..., :-1, :], axis=-1) > 0
    signs = np.cumprod(np.where(same, 1.0, -1.0), axis=-1)
    return np.concatenate([q[..., :1, :], signs[..., None] * q[..., 1:, :]], axis=-2)


def julian(epoch: datetime, times: np.ndarray) -> tuple[np.ndarray, ...]:
    """Two-part Julian dates, UTC and TT, at times (n,) s after the epoch."""
    utc = _utc(epoch, float(times[-1]))
    seconds = utc.second + utc.microsecond * 1e-6
    utc1, utc2 = erfa.dtf2d("UTC", utc.year, utc.month, utc.day, utc.hour, utc.minute, seconds)
    tt1, tt2 = erfa.taitt(*erfa.utctai(utc1, utc2))
    return utc1, utc2 + times / DAY, tt1, tt2 + times / DAY


def _utc(epoch: datetime, duration: float) -> datetime:
    """The epoch in UTC without time zone; ScenarioError if it, or the end of the run, is out of range."""
    if not isinstance(epoch, datetime):
        raise ScenarioError(f"epoch = {epoch!r}: give a datetime in UTC, such as datetime(2026, 3, 20, 12)")
    utc = epoch.astimezone(UTC).replace(tzinfo=None) if epoch.tzinfo else epoch
    if not EARLIEST <= utc <= LATEST - timedelta(seconds=duration):
        raise ScenarioError(
            f"epoch {epoch} with {duration:g} s to go must lie between {EARLIEST:%Y} (leap seconds) "
            f"and {LATEST:%Y} (IGRF-14): move it"
        )
    return utc


def _without_field() -> OrbitEnv:
    """Nothing modelled."""
    unknown, vector = jnp.asarray(jnp.nan), jnp.full(3, jnp.nan)
    return OrbitEnv(vector, vector, vector, vector, unknown, unknown, jnp.full(4, jnp.nan), vector)
