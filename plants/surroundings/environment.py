"""What surrounds a spacecraft: orbit, geomagnetic field, Sun, eclipse and air density as functions of time.

None of it depends on attitude. It is computed once on a grid by NumPy, ppigrf (IGRF) and pyerfa, turned into cubic
splines, and evaluated inside the compiled loop: at 10 s in low orbit the splines are within 1e-12 rad (attitude
of frame O), 3 mm, 0.001 nT and 1e-8 of the solar disc of their sources, and as near with the shorter step that an
eccentric orbit gets. The spline of the density is that of its logarithm: within 1 % where an eccentric orbit passes
from one layer of air into the next, 1e-9 inside them.

Frame N is the GCRS; its z axis also serves as the Earth's axis for J2 (`Oblateness`, the only force on the orbit by
default) and for the air that turns with the Earth (precession since 2000 is 0.13 deg in 2024), while the field is
evaluated in the true terrestrial frame with UT1 = UTC and no polar motion. The Sun is geometric (no aberration), seen
from the spacecraft. The shadow is the cone of a spherical Earth whose limb is taken as straight across a solar disc
that darkens towards its edge.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import partial
from typing import NamedTuple

import erfa
import jax
import jax.numpy as jnp
import numpy as np
import ppigrf
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.surroundings import orbit, table
from plants.surroundings.atmosphere import Air, LayeredAtmosphere
from plants.surroundings.ephemeris import sun_position, to_earth, utc_of
from plants.surroundings.orbit import EARTH_RADIUS, Force, Oblateness, Orbit

FINE = 0.012  # () rad, of a turn about the Earth in an interval: 10 s in low orbit
COARSE = 0.1  # () rad, likewise: positions within 20 m, field within 4 nT, frame O within 3e-7 rad
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


@partial(blocks.node, data_fields=["splines"], meta_fields=["step", "duration"])
@dataclass(frozen=True, kw_only=True)
class Environment:
    """Surroundings along an orbit, from splines; build it with `Environment.along`.

    A batch of environments (leading axes of `splines`) is used through `vmap`.
    """

    splines: Numbers  # (..., n, 4, 21) cubic coefficients of every interval, lowest power first
    step: float  # () s, length of an interval
    duration: float  # () s, from the epoch; a flight must not be longer

    @classmethod
    def along(
        cls,
        start: Orbit,
        epoch: datetime,
        duration: float,
        *,
        step: float | None = None,
        atmosphere: Air | None = LayeredAtmosphere(),  # noqa: B008 (immutable)
        forces: Sequence[Force] = (Oblateness(),),
    ) -> "Environment":
        """Environment of a spacecraft that flies the orbit from `start` at `epoch` for `duration`.

        Parameters
        ----------
        start : (..., 3) m, (..., 3) m/s in frame N; leading axes give a batch of environments
        epoch : UTC (a datetime without time zone is taken as UTC)
        duration : () s, the last time at which `at` may be called
        step : () s, between two points of the table; 10 by default, and less where a perigee is passed faster than
            in low orbit
        atmosphere : density of the air; None is "not modelled" (NaN)
        forces : what moves the orbit besides a spherical Earth (`plants.surroundings.forces`)

        Raises
        ------
        ScenarioError
            NaN, negative or zero duration or step, a step with which the splines would miss the perigee, an epoch
            before 1972 or after 2029, an orbit that is or comes inside the Earth, an altitude that the atmosphere does
            not know, forces that `orbit.propagate` refuses.
        """
        positive("duration", duration)
        fastest = _fastest(start)
        step = min(10.0, FINE / fastest) if step is None else float(positive("step", step))
        if step * fastest > COARSE:
            raise ScenarioError(
                f"step = {step:g} s is too long for splines where the orbit turns at {fastest:.3g} rad/s: "
                f"at most {COARSE / fastest:.3g} s"
            )
        intervals = max(int(np.ceil(duration / step)) + 1, 4)  # one more than needed: t = duration falls inside
        times = step * np.arange(intervals + 1)
        r, v = orbit.propagate(start, times, forces, epoch)
        sun = sun_position(epoch, times) - r
        heavens = orbit.ephemeris(forces, epoch, float(times[-1]))
        with jax.enable_x64(True):
            q_ON = np.asarray(orbit.orbital_frame(r, v))
            w_ON = np.asarray(orbit.orbital_frame_rate(r, v, times, tuple(forces), heavens))
        columns = [
            r, v, magnetic_field(r, epoch, times), sun / np.linalg.norm(sun, axis=-1, keepdims=True),
            limb_angle(r, sun)[..., None], _logarithm(atmosphere, r, epoch, times)[..., None], _without_jumps(q_ON),
            w_ON,
        ]  # fmt: skip
        cubics = table.splines(np.concatenate(columns, axis=-1))
        if atmosphere is None:
            cubics[..., 13] = np.nan
        return cls(splines=cubics, step=step, duration=float(duration))

    def sun_field_angle(self) -> np.ndarray:
        """Angle between the lines of Sun and field at the points of the table, (..., n) rad in [0, pi/2].

        An attitude from these two directions has an error of about 1 / sin of it about the bisecting axis.
        """
        B, sun = self.splines[..., 0, 6:9], self.splines[..., 0, 9:12]
        return np.arcsin(np.linalg.norm(np.cross(B, sun), axis=-1) / np.linalg.norm(B, axis=-1))

    def at(self, t: ArrayLike) -> OrbitEnv:
        """Surroundings at t () s; all NaN outside [0, duration]."""
        row = table.value(*table.piece(self.splines, self.step, self.duration, t))
        return OrbitEnv(
            r=row[0:3], v=row[3:6], B=row[6:9], sun=row[9:12], sunlit=visible_fraction(row[12]),
            density=jnp.exp(row[13]), q_ON=row[14:18], w_ON=row[18:21],
        )  # fmt: skip


@partial(blocks.node, data_fields=["r", "v", "q_ON"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class CircularEnvironment:
    """Ideal circular two-body orbit and its frame O; field, Sun and air are not modelled (NaN)."""

    r: Numbers  # (3,) m, N, at t = 0
    v: Numbers  # (3,) m/s, N, at t = 0
    q_ON: Numbers  # (4,) attitude of frame O at t = 0
    duration = float("inf")  # () s

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

    duration = float("inf")  # () s

    def at(self, t: ArrayLike) -> OrbitEnv:
        """Surroundings at any t () s."""
        del t
        return _without_field()._replace(q_ON=jnp.array([1.0, 0.0, 0.0, 0.0]), w_ON=jnp.zeros(3))


def magnetic_field(r: np.ndarray, epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Geomagnetic field in T along r (..., n, 3) m at the times (n,) s after `epoch`, both in frame N.

    IGRF of degree 13, with the coefficients of the middle of the interval (they drift by less than 1 nT in
    three days).
    """
    middle = utc_of(epoch, float(times[-1])) + timedelta(seconds=float(times[-1]) / 2)
    turn = to_earth(epoch, times)
    x, y, z = np.moveaxis((turn @ r[..., None])[..., 0], -1, 0)
    distance = np.linalg.norm(r, axis=-1)
    colatitude, longitude = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    up, south, east = (
        nanotesla[0] * 1e-9
        for nanotesla in ppigrf.igrf_gc(distance / 1e3, np.degrees(colatitude), np.degrees(longitude), middle)
    )
    out = up * np.sin(colatitude) + south * np.cos(colatitude)
    c, s = np.cos(longitude), np.sin(longitude)
    field = np.stack([out * c - east * s, out * s + east * c, up * np.cos(colatitude) - south * np.sin(colatitude)], -1)
    return (np.swapaxes(turn, -1, -2) @ field[..., None])[..., 0]


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


def _fastest(start: Orbit) -> float:
    """Greatest angular rate () rad/s about the Earth of the ellipses from `start`, that of their perigees."""
    start = orbit.state(start)
    h = np.linalg.norm(np.cross(start.r, start.v), axis=-1)
    perigee = h**2 / orbit.MU / (1 + orbit.elements(start).eccentricity)
    return float((h / perigee**2).max())


def _logarithm(atmosphere: Air | None, r: np.ndarray, epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Logarithm of the density (..., n): splines of it fall as the air does, and never below zero."""
    if atmosphere is None:
        return np.zeros(r.shape[:-1])
    if not hasattr(atmosphere, "along"):
        raise ScenarioError(f"atmosphere must be an object such as LayeredAtmosphere(), or None, got {atmosphere!r}")
    density = real("density", atmosphere.along(r, epoch, times), r.shape[:-1])
    return np.log(positive("density", density, r.shape[:-1]))


def _without_jumps(q: np.ndarray) -> np.ndarray:
    """The same q (..., n, 4) with signs such that neighbours along n are close."""
    same = np.sum(q[..., 1:, :] * q[..., :-1, :], axis=-1) > 0
    signs = np.cumprod(np.where(same, 1.0, -1.0), axis=-1)
    return np.concatenate([q[..., :1, :], signs[..., None] * q[..., 1:, :]], axis=-2)


def _without_field() -> OrbitEnv:
    """Nothing modelled."""
    unknown, vector = jnp.asarray(jnp.nan), jnp.full(3, jnp.nan)
    return OrbitEnv(vector, vector, vector, vector, unknown, unknown, jnp.full(4, jnp.nan), vector)
