"""Directions in space that an axis of a body may be asked to follow, with their rates of change, in frame N.

`at(t, env)` gives a vector (3,) of any length and unit, and its derivative per second; t () s counts from the epoch of
the environment.
"""

from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.surroundings.ephemeris import EARTH_RATE, to_earth
from plants.surroundings.ground import target_position


class Direction(Protocol):
    """Where an axis may point."""

    def at(self, t: ArrayLike, env: Any, /) -> tuple[Array, Array]: ...  # noqa: D102


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class ToEarth:
    """From the spacecraft to the centre of the Earth, m."""

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """Vector (3,) m and its derivative."""
        del t
        return -env.r, -env.v


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class ToSun:
    """From the spacecraft to the Sun. Its own motion, 2e-7 rad/s as seen from the Earth, is left out of the rate."""

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """Unit vector (3,) and its derivative."""
        del t
        return env.sun, jnp.zeros(3)


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class OrbitNormal:
    """Along the angular momentum of the orbit: against the y axis of frame O."""

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """Unit vector (3,) and its derivative."""
        del t
        return _carried(jnp.array([0.0, -1.0, 0.0]), env)


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class Forward:
    """The horizontal axis of frame O in the plane of the orbit: forward, for a circular orbit the velocity."""

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """Unit vector (3,) and its derivative."""
        del t
        return _carried(jnp.array([1.0, 0.0, 0.0]), env)


@partial(blocks.node, data_fields=["vector"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Fixed:
    """A direction among the stars; build it with `Fixed.create`."""

    vector: Numbers  # (3,) any length, N

    @classmethod
    def create(cls, vector: ArrayLike) -> "Fixed":
        """A direction (3,) of any length in frame N; ScenarioError if it is none."""
        v = real("vector", vector, (3,))
        if not np.linalg.norm(v) > 0:
            raise ScenarioError(f"vector = {v.tolist()} has no direction: give a vector that is not zero")
        return cls(vector=v)

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """The vector (3,) and its derivative."""
        del t, env
        return jnp.asarray(self.vector), jnp.zeros(3)


@partial(blocks.node, data_fields=["position", "pole"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class ToTarget:
    """From the spacecraft to a place that turns with the Earth, m; build it with `ToTarget.create`.

    The place turns about the Earth's axis of the epoch: within a day the axis moves by less than 1e-6 rad.
    """

    position: Numbers  # (3,) m, N, at the epoch
    pole: Numbers  # (3,) unit vector, N, about which the Earth turns

    @classmethod
    def create(cls, *, latitude: float, longitude: float, altitude: float = 0.0, epoch: datetime) -> "ToTarget":
        """A place on or above the ellipsoid WGS 84.

        Parameters
        ----------
        latitude, longitude : () rad, geodetic, north and east positive
        altitude : () m above the ellipsoid
        epoch : UTC, that of the environment

        Raises
        ------
        ScenarioError
            NaN, a latitude beyond the poles, an epoch that `Environment.along` would not take.
        """
        start = np.zeros(1)
        return cls(
            position=target_position(latitude, longitude, altitude, epoch, start)[0],
            pole=to_earth(epoch, start)[0, 2],
        )

    def at(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """Vector (3,) m and its derivative."""
        pole = jnp.asarray(self.pole)
        back = attitude.conjugate(attitude.from_vector(EARTH_RATE * jnp.asarray(t) * pole))
        place = attitude.rotate(back, self.position)
        return place - env.r, EARTH_RATE * attitude.cross(pole, place) - env.v


def _carried(v: Array, env: Any) -> tuple[Array, Array]:
    """A vector (3,) that stands still in frame O, and its derivative, in frame N."""
    back = attitude.conjugate(env.q_ON)
    return attitude.rotate(back, v), attitude.rotate(back, attitude.cross(env.w_ON, v))
