"""Where a geostationary satellite is: measurements of its radius, radial rate, latitude and longitude.

The thesis's measurements (3.13), scaled to be lengths and speeds, with r1 the radius of the ideal point:

    (2 r1 x + x^2 + y^2 + z^2) / (2 r1),   ((r1 + x) x' + y y' + z z') / r1,   z,   r1 atan2(y, r1 + x)

The last, the longitude, is not the thesis's: without it y cannot be known.
"""

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants import blocks
from plants.checks import Numbers, real
from plants.relative import StationState


@partial(blocks.node, data_fields=["noise"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class StateSensor:
    """Position and velocity as they are, plus white noise."""

    noise: Numbers  # (6,) m, m/s, one sigma of each sample

    @classmethod
    def create(cls, noise: ArrayLike) -> "StateSensor":
        """Checked sensor; ScenarioError for a wrong shape, NaN or a negative deviation."""
        return cls(noise=real("noise", noise, (6,), low=0))

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 6

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def measure(
        self, s: tuple[()], x: StationState, env: object, noise: Array, h: ArrayLike
    ) -> tuple[tuple[()], Array]:
        """Position and velocity (6,)."""
        del env, h
        return s, jnp.concatenate([jnp.asarray(x.position), jnp.asarray(x.velocity)]) + self.noise * noise


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Unfiltered:
    """The measurement is the estimate."""

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def update(self, s: tuple[()], y: Array, u: Array, env: object, h: ArrayLike) -> tuple[tuple[()], Array]:
        """The measurement."""
        del u, env, h
        return s, y
