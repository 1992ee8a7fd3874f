"""Orbits around the Earth: their start, their motion under any forces, the orbital frame and its rate.

The inertial frame N has its z axis along the Earth's axis. Frame O of the nadir-pointing studies has z to nadir,
y opposite to the orbit normal and x = y x z (along the velocity of a circular orbit).

Two-body gravity always acts; what acts besides is a tuple of forces: `Oblateness` alone by default, the others are in
`plants.surroundings.forces`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.simulation.programs import Program
from plants.surroundings.ephemeris import Ephemeris, Heavens

MU = 3.986004418e14  # () m^3/s^2  Earth's gravitational parameter, IERS Conventions (2010) without the last digits
EARTH_RADIUS = 6378137.0  # () m  equatorial, WGS 84
FLATTENING = 1 / 298.257223563  # ()  WGS 84
J2 = 0.00108262668  # ()  EGM96

LONGEST_STEP = 1.0  # () s  of the RK4 propagation: 1e-7 m after 1000 s in low orbit


class Orbit(NamedTuple):
    """State of an orbit at its epoch, in frame N; leading axes are several orbits."""

    r: np.ndarray  # (..., 3) m
    v: np.ndarray  # (..., 3) m/s


class Elements(NamedTuple):
    """Keplerian elements of the ellipse that touches an orbit, angles in [-pi, pi]; leading axes are several orbits.

    On the equator the node is taken to lie on the x axis, on a circle the perigee in the node.
    """

    semi_major_axis: np.ndarray  # (...) m
    eccentricity: np.ndarray  # (...)
    inclination: np.ndarray  # (...) rad, in [0, pi]
    raan: np.ndarray  # (...) rad
    argument_of_perigee: np.ndarray  # (...) rad
    true_anomaly: np.ndarray  # (...) rad


class Force(Protocol):
    """What acts on a satellite besides a spherical Earth; a frozen dataclass of numbers, the user's own too.

    One that is not known everywhere also has `check(r, times)`, which raises ScenarioError where a flight has left what
    is known: r (..., n, 3) m at the times (n,) s.
    """

    def acceleration(self, r: Array, v: Array, heavens: Heavens, /) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m and v (3,) m/s, frame N."""
        ...


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class Oblateness:
    """J2 about the z axis of frame N, as if the Earth's axis stood where it did in 2000. Vallado (2013), eq. 8-30."""

    kind = "the Earth's shape"

    def acceleration(self, r: Array, v: Array, heavens: Heavens | None = None) -> Array:
        """Acceleration (..., 3) m/s^2 at r (..., 3) m."""
        del v, heavens
        square = attitude.dot(r, r)[..., None]
        sine = r[..., 2:] ** 2 / square
        return -MU / square**1.5 * r * (1.5 * J2 * EARTH_RADIUS**2 / square * (1 - 5 * sine + jnp.asarray([0, 0, 2.0])))


def circular(
    altitude: float, inclination: float, raan: ArrayLike = 0.0, argument_of_latitude: ArrayLike = 0.0
) -> Orbit:
    """Orbit whose velocity is that of a circular one without J2.

    Parameters
    ----------
    altitude : () m above the equatorial radius
    inclination : () rad
    raan, argument_of_latitude : (...) rad, broadcast against each other: one orbit for each

    Raises
    ------
    ScenarioError
        NaN, an altitude that is not positive, an inclination beyond pi (degrees?).
    """
    real("altitude", altitude)
    if not altitude > 0:
        raise ScenarioError(f"altitude must be positive, got {altitude}: it is counted in m from the Earth's surface")
    real("inclination", inclination)
    _in_radians(inclination)
    for name, angle in (("raan", raan), ("argument_of_latitude", argument_of_latitude)):
        real(name, angle, np.shape(angle))
    return _start(EARTH_RADIUS + altitude, 0.0, inclination, raan, 0.0, argument_of_latitude)


def keplerian(
    semi_major_axis: ArrayLike,
    eccentricity: ArrayLike,
    inclination: ArrayLike,
    raan: ArrayLike = 0.0,
    argument_of_perigee: ArrayLike = 0.0,
    true_anomaly: ArrayLike = 0.0,
) -> Orbit:
    """Orbit with the Keplerian elements given, without J2. Vallado (2013), algorithm 10.

    Parameters
    ----------
    semi_major_axis : (...) m
    eccentricity : (...), from 0 to below 1
    inclination, raan, argument_of_perigee, true_anomaly : (...) rad
        All are broadcast against each other: one orbit for each.

    Raises
    ------
    ScenarioError
        NaN, an orbit that is no ellipse, a perigee inside the Earth (equatorial radius), an inclination beyond pi
        (degrees?), shapes that do not fit.
    """
    given = (semi_major_axis, eccentricity, inclination, raan, argument_of_perigee, true_anomaly)
    for name, number in zip(Elements._fields, given, strict=True):
        real(name, number, np.shape(number))
    try:
        a, e, *angles = np.broadcast_arrays(*(np.asarray(number, float) for number in given))
    except ValueError as error:
        shapes = ", ".join(f"{name} {np.shape(n)}" for name, n in zip(Elements._fields, given, strict=True))
        raise ScenarioError(f"the elements must have shapes that broadcast, got {shapes}") from error
    if not ((e >= 0) & (e < 1)).all():
        raise ScenarioError(f"eccentricity must lie in [0, 1), got {e.tolist()}: only ellipses come back")
    _in_radians(angles[0])
    perigee = a * (1 - e)
    if not (perigee > EARTH_RADIUS).all():
        raise ScenarioError(
            f"semi_major_axis {a.tolist()} m with eccentricity {e.tolist()} has its perigee at {perigee.min():.6g} m, "
            f"inside the Earth ({EARTH_RADIUS:g} m): both are counted from its centre"
        )
    return _start(a, e, *angles)


def _in_radians(inclination: ArrayLike) -> None:
    """ScenarioError for an inclination (...) rad that is none."""
    if not ((np.asarray(inclination) >= 0) & (np.asarray(inclination) <= np.pi)).all():
        raise ScenarioError(
            f"inclination must lie in [0, pi] rad, got {inclination}: np.deg2rad turns degrees into rad"
        )


def _start(a: ArrayLike, e: ArrayLike, i: ArrayLike, raan: ArrayLike, perigee: ArrayLike, anomaly: ArrayLike) -> Orbit:
    """State of checked elements."""
    given = (np.asarray(x, float) for x in (a, e, i, raan, perigee, anomaly))
    a, e, i, raan, perigee, anomaly = np.broadcast_arrays(*given)
    u = perigee + anomaly
    node = np.stack([np.cos(raan), np.sin(raan), np.zeros_like(u)], axis=-1)
    c, s = np.cos(i), np.sin(i)
    north = np.stack([-c * np.sin(raan), c * np.cos(raan), s], axis=-1)
    parameter = a * (1 - e**2)
    radius, speed = parameter / (1 + e * np.cos(anomaly)), np.sqrt(MU / parameter)
    cosine, sine = np.cos(u)[..., None], np.sin(u)[..., None]
    ahead = cosine + (e * np.cos(perigee))[..., None]
    back = sine + (e * np.sin(perigee))[..., None]
    return Orbit(
        r=radius[..., None] * (cosine * node + sine * north),
        v=speed[..., None] * (ahead * north - back * node),
    )


def elements(orbit: Orbit) -> Elements:
    """Keplerian elements of states (..., 3), the inverse of `keplerian`. Vallado (2013), algorithm 9.

    Raises
    ------
    ScenarioError
        NaN, a state that does not come back (its speed is that of escape or more) or falls straight down.
    """
    r, v = state(orbit)
    distance = np.linalg.norm(r, axis=-1)
    momentum = np.cross(r, v)
    h = np.linalg.norm(momentum, axis=-1)
    energy = np.sum(v * v, axis=-1) / 2 - MU / distance
    if not ((energy < 0) & (h > 0)).all():
        raise ScenarioError(f"r {r.tolist()}, v {v.tolist()} is no ellipse: v is in m/s, below that of escape")
    normal = momentum / h[..., None]
    towards_perigee = np.cross(v, momentum) / MU - r / distance[..., None]  # of length e
    flat = np.hypot(normal[..., 0], normal[..., 1])
    raan = np.where(flat > 0, np.arctan2(normal[..., 0], -normal[..., 1]), 0.0)
    node = np.stack([np.cos(raan), np.sin(raan), np.zeros_like(raan)], axis=-1)
    north = np.cross(normal, node)
    latitude, perigee = (
        np.arctan2(np.sum(x * north, axis=-1), np.sum(x * node, axis=-1)) for x in (r, towards_perigee)
    )
    anomaly = latitude - perigee
    return Elements(
        semi_major_axis=-MU / (2 * energy),
        eccentricity=np.linalg.norm(towards_perigee, axis=-1),
        inclination=np.arctan2(flat, normal[..., 2]),
        raan=raan,
        argument_of_perigee=perigee,
        true_anomaly=np.arctan2(np.sin(anomaly), np.cos(anomaly)),
    )


def state(orbit: Orbit) -> Orbit:
    """The orbit with its arrays checked: ScenarioError for NaN, wrong shapes, or what is no Orbit."""
    try:
        r, v = orbit
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"the orbit must be an Orbit(r, v), such as `circular` makes, got {orbit!r}") from error
    r, v = (real(name, x, (*np.shape(x)[:-1], 3)) for name, x in (("r", r), ("v", v)))
    if r.shape != v.shape:
        raise ScenarioError(f"r and v must have one shape, got {r.shape} and {v.shape}")
    return Orbit(r, v)


@Program
def altitude(r: ArrayLike) -> Array:
    """Height (...) m of r (..., 3) m above the ellipsoid of WGS 84, along the radius: within 30 m of the geodetic."""
    r = jnp.asarray(r)
    distance = jnp.sqrt(attitude.dot(r, r))
    return distance - EARTH_RADIUS * (1 - FLATTENING * (r[..., 2] / distance) ** 2)


def rate(r: ArrayLike) -> Array:
    """Orbital rate sqrt(mu / r^3) of the circular orbit through r (..., 3) m: (...) rad/s. Pecorilla (2024), eq. 5."""
    r = jnp.asarray(r)
    return jnp.sqrt(MU / attitude.dot(r, r) ** 1.5)


def acceleration(r: ArrayLike) -> Array:
    """Two-body and J2 acceleration at r (..., 3) m in frame N: (..., 3) m/s^2."""
    r = jnp.asarray(r)
    return _sphere(r) + Oblateness().acceleration(r, r)


def propagate(
    orbit: Orbit, times: ArrayLike, forces: Sequence[Force] = (Oblateness(),), epoch: datetime | None = None
) -> Orbit:
    """Position and velocity on a uniform grid of times.

    Parameters
    ----------
    orbit : leading axes (...)
    times : (n,) s, uniform, from 0
    forces : what acts besides a spherical Earth; () is Kepler's motion
    epoch : UTC of time 0 (a datetime without time zone is taken as UTC); `Oblateness` does without

    Returns
    -------
    Orbit with r (..., n, 3) m and v (..., n, 3) m/s, NumPy

    Raises
    ------
    ScenarioError
        A grid that does not start at 0 or is not uniform; NaN; an orbit that starts inside the Earth or comes there;
        forces that act twice, or that need an epoch where there is none; an orbit that leaves what a force knows.

    Notes
    -----
    RK4 with steps of at most `LONGEST_STEP`, whatever the forces: within 1 mm after three days in low orbit, where
    each of these steps also resolves the edge of the shadow (8 s). The global JAX precision flag is left as it is.
    """
    times = np.asarray(real("times", times, (None,)))
    steps = np.diff(times)
    if len(times) < 2 or times[0] != 0 or not np.allclose(steps, steps[0], rtol=1e-9, atol=0) or steps[0] <= 0:
        raise ScenarioError("times must be a uniform grid that starts at 0 and has two points at least")
    r, v = state(orbit)
    if (np.linalg.norm(r, axis=-1) < EARTH_RADIUS).any():
        raise ScenarioError("r lies inside the Earth: positions are in m from its centre")
    substeps = int(np.ceil(steps[0] / LONGEST_STEP))
    heavens = ephemeris(forces, epoch, float(times[-1]))
    with jax.enable_x64(True):
        h = times[-1] / (len(times) - 1) / substeps
        r, v = _propagate(r, v, h, tuple(forces), heavens, len(times) - 1, substeps)
        r, v = (np.moveaxis(np.asarray(x), 0, -2) for x in (r, v))
        height = np.asarray(altitude(r))
    for force in forces:
        if hasattr(force, "check"):
            force.check(r, times)  # pyright: ignore[reportAttributeAccessIssue]
    if not (height > 0).all():
        first = times[np.argwhere(~(height > 0))[:, -1].min()]
        raise ScenarioError(f"orbit: it is on the ground at {first:g} s: raise it, or end the flight earlier")
    return Orbit(r, v)


def ephemeris(forces: Sequence[Force], epoch: datetime | None, duration: float) -> Ephemeris | None:
    """Table of Moon, Sun and the Earth's axes where one of the forces needs it.

    Raises
    ------
    ScenarioError
        Forces of one kind twice (also the Earth's shape: `Oblateness` and `EarthShape`); a missing epoch.
    """
    if isinstance(forces, str) or not isinstance(forces, Sequence):
        raise ScenarioError(f"forces must be a tuple such as (Oblateness(),), got {forces!r}")
    kinds = [getattr(force, "kind", type(force).__name__) for force in forces]
    twice = sorted({kind for kind in kinds if kinds.count(kind) > 1})
    if twice:
        raise ScenarioError(f"forces hold {twice[0]} more than once: leave one of them away")
    for force in forces:
        if isinstance(force, type) or not hasattr(force, "acceleration"):
            raise ScenarioError(f"forces must be objects such as Oblateness(), got {force!r}")
        blocks.register(force)
    if all(isinstance(force, Oblateness) for force in forces):
        return None
    if epoch is None:
        raise ScenarioError(f"epoch is missing: {', '.join(kinds)} depend on where Sun, Moon and the Earth's axes are")
    return Ephemeris.over(epoch, duration)


def _sphere(r: Array) -> Array:
    """Acceleration (..., 3) m/s^2 by a spherical Earth."""
    return -MU / attitude.dot(r, r)[..., None] ** 1.5 * r


def _acceleration(t: ArrayLike, r: Array, v: Array, forces: tuple[Force, ...], table: Ephemeris | None) -> Array:
    """Acceleration (..., 3) m/s^2 by all that acts."""
    heavens: Any = None if table is None else table.at(t)
    total = _sphere(r)
    for force in forces:
        act = jnp.vectorize(lambda r, v, force=force: force.acceleration(r, v, heavens), signature="(k),(k)->(k)")
        total += act(r, v)
    return total


@Program
def orbital_frame(r: ArrayLike, v: ArrayLike) -> Array:
    """Attitude q_ON of frame O relative to N at r (..., 3) m, v (..., 3) m/s: (..., 4)."""
    z = -attitude.normalise(r)
    y = -attitude.normalise(attitude.cross(r, v))
    return attitude.from_dcm(jnp.stack([attitude.cross(y, z), y, z], axis=-2))


@Program
def orbital_frame_rate(
    r: ArrayLike,
    v: ArrayLike,
    times: ArrayLike = 0.0,
    forces: tuple[Force, ...] = (Oblateness(),),
    table: Ephemeris | None = None,
) -> Array:
    """Inertial rate of frame O in its own axes under the forces: (..., 3) rad/s.

    y turns with the position, -h/r^2; z with the orbit plane, -r (a.n)/h, n the orbit normal: the plane is
    turned about the position vector by the acceleration that stands on it. `times` (...) s are those of r and v,
    `table` is that of `ephemeris`.
    """
    r, v = jnp.asarray(r), jnp.asarray(v)
    momentum = attitude.cross(r, v)
    h = jnp.sqrt(attitude.dot(momentum, momentum))
    square = attitude.dot(r, r)
    act = jnp.vectorize(lambda t, r, v: _acceleration(t, r, v, forces, table), signature="(),(k),(k)->(k)")
    across = attitude.dot(act(times, r, v), momentum) / h
    return jnp.stack([jnp.zeros_like(h), -h / square, -jnp.sqrt(square) * across / h], axis=-1)


@partial(Program, static=("points", "substeps"))
def _propagate(
    r: Array, v: Array, h: Array, forces: tuple[Force, ...], table: Ephemeris | None, points: int, substeps: int
) -> tuple[Array, Array]:
    """States (points + 1, ..., 3) after every `substeps` steps of RK4 (Runge-Kutta-Nystrom where no force feels v)."""

    def derivative(t, r, v):
        return v, _acceleration(t, r, v, forces, table)

    def step(state, k):
        r, v = state
        t = k * h
        v1, a1 = derivative(t, r, v)
        v2, a2 = derivative(t + h / 2, r + h / 2 * v1, v + h / 2 * a1)
        v3, a3 = derivative(t + h / 2, r + h / 2 * v2, v + h / 2 * a2)
        v4, a4 = derivative(t + h, r + h * v3, v + h * a3)
        return (r + h / 6 * (v1 + 2 * v2 + 2 * v3 + v4), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)), None

    def point(state, first):
        return jax.lax.scan(step, state, first + jnp.arange(substeps))[0], state

    last, states = jax.lax.scan(point, (r, v), substeps * jnp.arange(points))
    r, v = (jnp.concatenate([many, one[None]]) for many, one in zip(states, last, strict=True))
    return r, v
