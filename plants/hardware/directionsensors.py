"""What a fine Sun sensor and a horizon sensor have in common: a direction seen in a cone about a boresight."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Self

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, positive, real
from plants.geometry import attitude
from plants.hardware.instruments import Direction, Innovation, Pair, direction_innovation, tick, unit, within

FIELDS = ["noise", "boresight", "half_angle", "misalignment", "period"]


@dataclass(frozen=True, kw_only=True)
class DirectionSensor(ABC):
    """Direction to something in a field of view. Build one with `create`, which checks the numbers.

    A kind of it says where the thing is and whether it can be seen.
    """

    noise: ArrayLike  # () rad, 1 sigma per axis
    boresight: Numbers  # (3,) unit vector, body axes
    half_angle: ArrayLike  # () rad, of the field of view, a cone about the boresight
    misalignment: Numbers  # (3,) rad, rotation of the true axes from the believed ones
    period: ArrayLike  # () s between two readings, 0 for one at every sample

    @classmethod
    def create(
        cls,
        *,
        noise: float,
        boresight: Given = (0.0, 0.0, 1.0),
        half_angle: float = np.pi,
        misalignment: Given = (0.0, 0.0, 0.0),
        period: float = 0.0,
    ) -> Self:
        """A sensor from its data sheet; without `half_angle` (rad) it sees in every direction.

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, negative numbers, a boresight that is not of length one, a half angle that is not
            positive.
        """
        return cls(
            noise=real("noise", noise, low=0),
            boresight=unit("boresight", boresight),
            half_angle=positive("half_angle", half_angle),
            misalignment=real("misalignment", misalignment, (3,)),
            period=real("period", period, low=0),
        )

    @abstractmethod
    def target(self, env: Any) -> Array:
        """Direction to what it looks for (3,), frame N."""

    def light(self, env: Any) -> ArrayLike:
        """Whether that can be seen from anywhere on the body, () 1 or 0."""
        del env
        return 1.0

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 3

    @property
    def parameters(self) -> str:
        """What a filter may estimate of it, (3,)."""
        return "misalignment, rad"

    @property
    def deviation(self) -> ArrayLike:
        """1 sigma per axis, () rad."""
        return self.noise

    def init(self) -> Array:
        """Time to the next reading, () s."""
        return jnp.zeros(())

    def measure(self, s: Array, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Array, Direction]:
        """The direction if it is time and the thing is in view."""
        wait, due = tick(s, self.period, h)
        there = attitude.rotate(x.q, self.target(env))
        cosine = jnp.cos(jnp.minimum(self.half_angle, jnp.pi))
        seen = due * self.light(env) * within(attitude.dot(there, self.boresight), cosine - 1e-12)
        read = attitude.rotate(attitude.from_vector(self.misalignment), there) + self.noise * noise
        return wait, Direction(seen * read, seen)

    def innovation(self, y: Direction, q: Array, own: Array, env: Any) -> Innovation:
        """See `instruments.direction_innovation`."""
        return direction_innovation(y, self.target(env), q, own, self.noise)

    def pair(self, y: Direction, env: Any) -> Pair:
        """The direction in both frames."""
        return Pair(y.vector, self.target(env), jnp.asarray(self.noise), y.valid)
