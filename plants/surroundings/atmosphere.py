"""Density of the air over altitude.

The layers are those of Vallado (2013), Fundamentals of Astrodynamics and Applications, table 8-4 (after Wertz, 1978):
in each the density falls exponentially. Where two of them meet above 100 km the density jumps by 0.008 % at most.
It is the air of a mean Sun, the same by day and night. Against the mean over the Earth by NRLMSISE-00 at 500 km, which
is 0.13, 1.0 and 3.2 times as dense at F10.7 = 70, 140 and 220, it is right in a mean year; there day and night differ
by seven to nine times. `factor` disperses it.
"""

from datetime import datetime
from typing import NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import positive
from plants.errors import ScenarioError
from plants.simulation.programs import Program
from plants.surroundings.orbit import altitude

# altitude km, density kg/m^3, scale height km
LAYERS = np.array([
    [0, 1.225, 7.249], [25, 3.899e-2, 6.349], [30, 1.774e-2, 6.682], [40, 3.972e-3, 7.554], [50, 1.057e-3, 8.382],
    [60, 3.206e-4, 7.714], [70, 8.770e-5, 6.549], [80, 1.905e-5, 5.799], [90, 3.396e-6, 5.382],
    [100, 5.297e-7, 5.877], [110, 9.661e-8, 7.263], [120, 2.438e-8, 9.473], [130, 8.484e-9, 12.636],
    [140, 3.845e-9, 16.149], [150, 2.070e-9, 22.523], [180, 5.464e-10, 29.740], [200, 2.789e-10, 37.105],
    [250, 7.248e-11, 45.546], [300, 2.418e-11, 53.628], [350, 9.518e-12, 53.298], [400, 3.725e-12, 58.515],
    [450, 1.585e-12, 60.828], [500, 6.967e-13, 63.822], [600, 1.454e-13, 71.835], [700, 3.614e-14, 88.667],
    [800, 1.170e-14, 124.64], [900, 5.245e-15, 181.05], [1000, 3.019e-15, 268.00],
]) * [1e3, 1.0, 1e3]  # fmt: skip


class Air(Protocol):
    """Density of the air along an orbit; a user's own model is any class with this method."""

    def along(self, r: np.ndarray, epoch: datetime | None, times: np.ndarray, /) -> np.ndarray:
        """Density (..., n) kg/m^3 at r (..., n, 3) m, frame N, at the times (n,) s after `epoch`.

        Raises
        ------
        ScenarioError
            A place or time that the model does not know.
        """
        ...


class Atmosphere(NamedTuple):
    """Exponential atmosphere at every altitude; the default is the 450 to 500 km layer of Vallado (2013), table 8-4."""

    density: float = 1.585e-12  # () kg/m^3 at `altitude`
    altitude: float = 450e3  # () m above the ellipsoid
    scale_height: float = 60.828e3  # () m

    def at(self, r: ArrayLike) -> Array:
        """Density (...) kg/m^3 at r (..., 3) m; height above the ellipsoid along the radius."""
        return self.density * jnp.exp((self.altitude - altitude(r)) / self.scale_height)

    def along(self, r: np.ndarray, epoch: datetime | None, times: np.ndarray) -> np.ndarray:
        """Density (..., n) kg/m^3; ScenarioError for a density or scale height that is not positive."""
        del epoch, times
        positive("density", self.density)
        positive("scale_height", self.scale_height)
        with jax.enable_x64(True):
            return np.asarray(self.at(r))


class LayeredAtmosphere(NamedTuple):
    """The layers of Vallado (2013), table 8-4, times `factor`, between the altitudes `lowest` and `highest`.

    `highest=np.inf` lets the last layer, from 1000 km, go on for ever, as an orbit that only dips into the air needs.
    """

    factor: float = 1.0  # ()
    lowest: float = 100e3  # () m above the ellipsoid; the table begins at 0
    highest: float = 1000e3  # () m above the ellipsoid

    def at(self, r: ArrayLike) -> Array:
        """Density (...) kg/m^3 at r (..., 3) m; height above the ellipsoid along the radius."""
        height = altitude(r)
        layer = jnp.clip(jnp.searchsorted(LAYERS[:, 0], height, side="right") - 1, 0)
        base, density, scale_height = jnp.moveaxis(jnp.asarray(LAYERS)[layer], -1, 0)
        return self.factor * density * jnp.exp((base - height) / scale_height)

    def along(self, r: np.ndarray, epoch: datetime | None, times: np.ndarray) -> np.ndarray:
        """Density (..., n) kg/m^3.

        Raises
        ------
        ScenarioError
            An altitude below `lowest` or above `highest`; a factor that is not positive, a `lowest` below the ground.
        """
        del epoch
        positive("factor", self.factor)
        if not 0 <= self.lowest < self.highest:
            raise ScenarioError(f"lowest = {self.lowest} m must lie between 0 and highest = {self.highest} m")
        stay_between(self.lowest, self.highest, r, times)
        with jax.enable_x64(True):
            return np.asarray(_density(self, r))


@Program
def _density(air: LayeredAtmosphere, r: ArrayLike) -> Array:
    """As `LayeredAtmosphere.at`, compiled once."""
    return air.at(r)


def stay_between(lowest: float, highest: float, r: np.ndarray, times: np.ndarray) -> None:
    """ScenarioError if r (..., n, 3) m at the times (n,) s leaves the altitudes that a model knows; says when first."""
    with jax.enable_x64(True):
        height = np.asarray(altitude(r))
    wrong = np.argwhere(~((height >= lowest) & (height <= highest)))  # NaN is wrong
    if len(wrong):
        place = tuple(wrong[np.argmin(wrong[:, -1])])
        raise ScenarioError(
            f"atmosphere: the orbit is {height[place] / 1e3:.1f} km high at {times[place[-1]]:g} s, and the air is "
            f"known from {lowest / 1e3:g} to {highest / 1e3:g} km: change the orbit, or give "
            "LayeredAtmosphere(highest=np.inf), where the last layer goes on, an Atmosphere(...) of your own, or "
            "None for no air"
        )
