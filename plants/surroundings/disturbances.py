"""Disturbance torques on a rigid body, one dataclass each; a body adds up those it is given.

`torque(seen, inertia)` takes the surroundings in body axes and returns (3,) N m in body axes. To switch one
off leave it out of the body's list or set its strength to zero. Build them with `create`, which checks the numbers.
Formulas: Markley and Crassidis (2014), sections 3.3.6.1 to 3.3.6.4.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, Self

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, real
from plants.geometry.attitude import cross, dot, rotate
from plants.simulation import blocks
from plants.surroundings.environment import OrbitEnv
from plants.surroundings.ephemeris import EARTH_RATE
from plants.surroundings.orbit import MU

SOLAR_PRESSURE = 4.54e-6  # () N/m^2 at 1 au: 1361 W/m^2 over the speed of light


class Seen(NamedTuple):
    """Surroundings in body axes."""

    r: Array  # (3,) m, position
    wind: Array  # (3,) m/s, velocity relative to air that turns with the Earth
    B: Array  # (3,) T, magnetic field
    sun: Array  # (3,) unit vector to the Sun
    sunlit: Array  # () visible fraction of the solar disc
    density: Array  # () kg/m^3, air


def wind(r: Array, v: Array) -> Array:
    """Velocity (3,) m/s relative to air that turns with the Earth, at r (3,) m with v (3,) m/s, frame N."""
    return v - EARTH_RATE * jnp.stack([-r[1], r[0], jnp.zeros_like(r[2])])


def seen_from(q: ArrayLike, env: OrbitEnv) -> Seen:
    """Surroundings in the axes of a body with attitude q (4,) relative to frame N."""
    # one rotation of four compiles to less than four of one
    vectors = jnp.stack([env.r, wind(env.r, env.v), env.B, env.sun])
    return Seen(*rotate(jnp.asarray(q)[None], vectors), sunlit=env.sunlit, density=env.density)


class Disturbance(Protocol):
    """A torque that depends on the surroundings."""

    def torque(self, seen: Seen, inertia: Array, /) -> Array: ...  # noqa: D102


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class GravityGradient:
    """3 mu / r^5 (r x I r), for a spherical Earth."""

    def torque(self, seen: Seen, inertia: Array) -> Array:
        """Torque (3,) N m."""
        square = dot(seen.r, seen.r)
        return 3 * MU / (square * square * jnp.sqrt(square)) * cross(seen.r, inertia @ seen.r)


@partial(blocks.node, data_fields=["moment"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class ResidualDipole:
    """m x B of a magnetic moment fixed in the body."""

    moment: Numbers  # (3,) A m^2

    @classmethod
    def create(cls, moment: ArrayLike) -> "ResidualDipole":
        """Checked dipole; ScenarioError for a wrong shape or NaN."""
        return cls(moment=real("moment", moment, (3,)))

    def torque(self, seen: Seen, inertia: Array) -> Array:
        """Torque (3,) N m."""
        del inertia
        return cross(self.moment, seen.B)


@dataclass(frozen=True, kw_only=True)
class _Box:
    """A box on which something presses from one direction; the force acts at the centre of the box.

    At the centre, because face i of half-depth d_i and area A_i is hit in proportion to its direction cosine,
    and A_i d_i is the same for all three.
    """

    size: Numbers  # (3,) m, edges along the body axes
    mass_centre: Numbers  # (3,) m, centre of mass from the centre of the box
    coefficient: Numbers  # ()

    @classmethod
    def create(cls, size: ArrayLike, mass_centre: ArrayLike, coefficient: ArrayLike) -> Self:
        """Checked box; ScenarioError for wrong shapes, NaN, negative edges or coefficient."""
        return cls(
            size=real("size", size, (3,), low=0),
            mass_centre=real("mass_centre", mass_centre, (3,)),
            coefficient=real("coefficient", coefficient, low=0),
        )

    def area(self, direction: Array) -> Array:
        """Area () m^2 that a direction (3,) sees, times the length of `direction`."""
        a = jnp.asarray(self.size)
        return dot(jnp.stack([a[1] * a[2], a[2] * a[0], a[0] * a[1]]), jnp.abs(direction))


@partial(blocks.node, data_fields=["size", "mass_centre", "coefficient"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Drag(_Box):
    """Drag of a box: the force acts along the flow, on the projected area, at the centre of the box."""

    def torque(self, seen: Seen, inertia: Array) -> Array:
        """Torque (3,) N m."""
        del inertia
        pressure = 0.5 * seen.density * self.coefficient * self.area(seen.wind)
        return cross(pressure * self.mass_centre, seen.wind)


@partial(blocks.node, data_fields=["size", "mass_centre", "coefficient"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class SolarPressure(_Box):
    """Radiation pressure on a box, along the rays and at its centre as for `Drag`; nothing in the Earth's shadow.

    The coefficient is 1 for a black box and grows with reflection. The pressure is that at 1 au (true within
    3.4 % over the year).
    """

    def torque(self, seen: Seen, inertia: Array) -> Array:
        """Torque (3,) N m."""
        del inertia
        # against the direction to the Sun
        force = SOLAR_PRESSURE * self.coefficient * (seen.sunlit * self.area(seen.sun))
        return cross(force * self.mass_centre, seen.sun)


@partial(blocks.node, data_fields=["vector"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class ConstantTorque:
    """A torque that is constant in body axes, such as a leak."""

    vector: Numbers  # (3,) N m

    @classmethod
    def create(cls, vector: ArrayLike) -> "ConstantTorque":
        """Checked torque; ScenarioError for a wrong shape or NaN."""
        return cls(vector=real("vector", vector, (3,)))

    def torque(self, seen: Seen, inertia: Array) -> Array:
        """Torque (3,) N m."""
        del seen, inertia
        return jnp.asarray(self.vector)
