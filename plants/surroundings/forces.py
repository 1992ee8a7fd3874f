"""What moves an orbit besides a spherical Earth; a tuple of these goes into `orbit.propagate` and `Environment.along`.

    EarthShape(harmonics)        gravity of the Earth to degree 3, turning with it, in place of `orbit.Oblateness`
    MoonGravity(), SunGravity()  third bodies
    DragForce(ballistic)         air that turns with the Earth
    PressureForce(coefficient)   sunlight on a sphere, with the Earth's shadow

The formulas are those of `plants.surroundings.gravity`. Montenbruck and Gill (2000), Satellite Orbits, chapter 3.
"""

from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, real
from plants.errors import ScenarioError
from plants.geometry.attitude import dot
from plants.simulation import blocks
from plants.surroundings import gravity
from plants.surroundings.atmosphere import Atmosphere, LayeredAtmosphere
from plants.surroundings.disturbances import wind
from plants.surroundings.ephemeris import Heavens
from plants.surroundings.gravity import EGM96, Harmonics


@partial(blocks.node, data_fields=["harmonics"], meta_fields=[])
@dataclass(frozen=True)
class EarthShape:
    """Zonal and tesseral harmonics about the true pole, which precesses and nutates; J2 is one of them.

    To degree 3: in low orbit what is left out moves a satellite by some hundred metres in a day.
    """

    harmonics: Harmonics = field(default_factory=lambda: EGM96)
    kind = "the Earth's shape"

    def acceleration(self, r: Array, v: Array, heavens: Heavens) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m, frame N."""
        del v
        return jax.grad(self.harmonics.potential)(heavens.to_earth @ r) @ heavens.to_earth


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class MoonGravity:
    """The Moon as a third body."""

    def acceleration(self, r: Array, v: Array, heavens: Heavens) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m, frame N."""
        del v
        return gravity.third_body(r, heavens.moon, gravity.MU_MOON)


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class SunGravity:
    """The Sun as a third body."""

    def acceleration(self, r: Array, v: Array, heavens: Heavens) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m, frame N."""
        del v
        return gravity.third_body(r, heavens.sun, gravity.MU_SUN)


@partial(blocks.node, data_fields=["coefficient"], meta_fields=[])
@dataclass(frozen=True)
class PressureForce:
    """Radiation pressure on a sphere, nothing in the Earth's shadow; build it with `create`."""

    coefficient: Numbers  # () m^2/kg, reflection coefficient (1 is black, 2 a mirror) times area over mass

    @classmethod
    def create(cls, coefficient: ArrayLike) -> "PressureForce":
        """Checked pressure; ScenarioError for NaN or a negative coefficient () m^2/kg."""
        return cls(real("coefficient", coefficient, low=0))

    def acceleration(self, r: Array, v: Array, heavens: Heavens) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m, frame N."""
        del v
        return gravity.sunlight(r, heavens.sun, self.coefficient)


@partial(blocks.node, data_fields=["ballistic", "atmosphere"], meta_fields=[])
@dataclass(frozen=True)
class DragForce:
    """Drag of a sphere in air that turns with the Earth; build it with `create`. Vallado (2013), eq. 8-28."""

    ballistic: Numbers  # () m^2/kg, drag coefficient times area over mass
    atmosphere: Atmosphere | LayeredAtmosphere

    @classmethod
    def create(
        cls,
        ballistic: ArrayLike,
        atmosphere: Atmosphere | LayeredAtmosphere = LayeredAtmosphere(),  # noqa: B008 (immutable)
    ) -> "DragForce":
        """Checked drag.

        Parameters
        ----------
        ballistic : () m^2/kg, drag coefficient (2.2 is usual) times area over mass; the inverse of what is also called
            the ballistic coefficient
        atmosphere : one that can be compiled, with `at(r)`

        Raises
        ------
        ScenarioError
            NaN, a negative number, an atmosphere that is only known along a finished orbit.
        """
        if not hasattr(atmosphere, "at"):
            raise ScenarioError(
                f"atmosphere {atmosphere!r} has no `at(r)` that can be compiled: give LayeredAtmosphere or Atmosphere"
            )
        return cls(real("ballistic", ballistic, low=0), atmosphere)

    def acceleration(self, r: Array, v: Array, heavens: Heavens | None = None) -> Array:
        """Acceleration (3,) m/s^2 at r (3,) m and v (3,) m/s, frame N."""
        del heavens
        flow = wind(r, v)
        return -0.5 * self.atmosphere.at(r) * self.ballistic * jnp.sqrt(dot(flow, flow)) * flow

    def check(self, r: np.ndarray, times: np.ndarray) -> None:
        """ScenarioError where the atmosphere is not known."""
        self.atmosphere.along(r, None, times)
