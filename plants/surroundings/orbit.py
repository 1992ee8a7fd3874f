"""Orbits around the Earth: two-body motion with J2, the orbital frame and its rate.

The inertial frame N has its z axis along the Earth's axis. Frame O of the nadir-pointing studies has z to nadir,
y opposite to the orbit normal and x = y x z (along the velocity of a circular orbit).
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation.programs import Program

MU = 3.986004418e14  # () m^3/s^2  Earth's gravitational parameter, IERS Conventions (2010) without the last digits
EARTH_RADIUS = 6378137.0  # () m  equatorial, WGS 84
J2 = 0.00108262668  # ()  EGM96

LONGEST_STEP = 1.0  # () s  of the RK4 propagation: 1e-7 m after 1000 s in low orbit


class Orbit(NamedTuple):
    """State of an orbit at its epoch, in frame N; leading axes are several orbits."""

    r: np.ndarray  # (..., 3) m
    v: np.ndarray  # (..., 3) m/s


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
        NaN, or an altitude that is not positive.
    """
    if not altitude > 0:
        raise ScenarioError(f"altitude must be positive, got {altitude}: it is counted in m from the Earth's surface")
    real("inclination", inclination)
    raan, u = np.broadcast_arrays(np.asarray(raan, float), np.asarray(argument_of_latitude, float))
    real("raan", raan, raan.shape)
    real("argument_of_latitude", u, u.shape)
    radius = EARTH_RADIUS + altitude
    node = np.stack([np.cos(raan), np.sin(raan), np.zeros_like(u)], axis=-1)
    c, s = np.cos(inclination), np.sin(inclination)
    north = np.stack([-c * np.sin(raan), c * np.cos(raan), np.full_like(u, s)], axis=-1)
    cosine, sine = np.cos(u)[..., None], np.sin(u)[..., None]
    return Orbit(
        r=radius * (cosine * node + sine * north),
        v=np.sqrt(MU / radius) * (cosine * north - sine * node),
    )


def rate(r: ArrayLike) -> Array:
    """Orbital rate sqrt(mu / r^3) of the circular orbit through r (..., 3) m: (...) rad/s. Pecorilla (2024), eq. 5."""
    r = jnp.asarray(r)
    return jnp.sqrt(MU / attitude.dot(r, r) ** 1.5)


def acceleration(r: ArrayLike) -> Array:
    """Two-body and J2 acceleration at r (..., 3) m in frame N: (..., 3) m/s^2. Vallado (2013), eq. 8-30."""
    r = jnp.asarray(r)
    square = attitude.dot(r, r)[..., None]
    sine = r[..., 2:] ** 2 / square
    oblate = 1.5 * J2 * EARTH_RADIUS**2 / square
    axis = jnp.asarray([0.0, 0.0, 2.0])
    return -MU / square**1.5 * r * (1 + oblate * (1 - 5 * sine + axis))


def propagate(orbit: Orbit, times: ArrayLike) -> Orbit:
    """Position and velocity on a uniform grid of times.

    Parameters
    ----------
    orbit : leading axes (...)
    times : (n,) s, uniform, from 0

    Returns
    -------
    Orbit with r (..., n, 3) m and v (..., n, 3) m/s, NumPy

    Raises
    ------
    ScenarioError
        A grid that does not start at 0 or is not uniform; NaN; an orbit that starts inside the Earth.

    Notes
    -----
    RK4 with steps of at most `LONGEST_STEP`; the global JAX precision flag is left as it is.
    """
    times = np.asarray(real("times", times, (None,)))
    steps = np.diff(times)
    if len(times) < 2 or times[0] != 0 or not np.allclose(steps, steps[0], rtol=1e-9, atol=0) or steps[0] <= 0:
        raise ScenarioError("times must be a uniform grid that starts at 0 and has two points at least")
    for name, value in zip(Orbit._fields, orbit, strict=True):
        real(name, value, (*np.shape(value)[:-1], 3))
    if (np.linalg.norm(orbit.r, axis=-1) < EARTH_RADIUS).any():
        raise ScenarioError("r lies inside the Earth: positions are in m from its centre")
    substeps = int(np.ceil(steps[0] / LONGEST_STEP))
    with jax.enable_x64(True):
        r, v = _propagate(*orbit, times[-1] / (len(times) - 1) / substeps, len(times) - 1, substeps)
        return Orbit(*(np.moveaxis(np.asarray(x), 0, -2) for x in (r, v)))


@Program
def orbital_frame(r: ArrayLike, v: ArrayLike) -> Array:
    """Attitude q_ON of frame O relative to N at r (..., 3) m, v (..., 3) m/s: (..., 4)."""
    z = -attitude.normalise(r)
    y = -attitude.normalise(attitude.cross(r, v))
    return attitude.from_dcm(jnp.stack([attitude.cross(y, z), y, z], axis=-2))


@Program
def orbital_frame_rate(r: ArrayLike, v: ArrayLike) -> Array:
    """Inertial rate of frame O in its own axes under J2: (..., 3) rad/s.

    y turns with the position, -h/r^2; z with the orbit plane, -r (a.n)/h, n the orbit normal: the plane is
    turned about the position vector by the acceleration that stands on it.
    """
    r, v = jnp.asarray(r), jnp.asarray(v)
    momentum = attitude.cross(r, v)
    h = jnp.sqrt(attitude.dot(momentum, momentum))
    square = attitude.dot(r, r)
    across = attitude.dot(acceleration(r), momentum) / h
    return jnp.stack([jnp.zeros_like(h), -h / square, -jnp.sqrt(square) * across / h], axis=-1)


@partial(Program, static=("points", "substeps"))
def _propagate(r: Array, v: Array, h: ArrayLike, points: int, substeps: int) -> tuple[Array, Array]:
    """States (points + 1, ..., 3) after every `substeps` steps of RK4."""

    def step(state, _):
        r, v = state
        a1 = acceleration(r)
        a2 = acceleration(r + h / 2 * v)
        a3 = acceleration(r + h / 2 * v + h**2 / 4 * a1)
        a4 = acceleration(r + h * v + h**2 / 2 * a2)
        return (r + h * v + h**2 / 6 * (a1 + a2 + a3), v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)), None

    def point(state, _):
        return jax.lax.scan(step, state, None, length=substeps)[0], state

    last, states = jax.lax.scan(point, (r, v), None, length=points)
    r, v = (jnp.concatenate([many, one[None]]) for many, one in zip(states, last, strict=True))
    return r, v
