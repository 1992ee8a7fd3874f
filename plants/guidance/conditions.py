"""When a mode has done its work: conditions on what is known on board, held for a while."""

from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax.numpy as jnp
from jax import Array

from plants.checks import Numbers, positive, real
from plants.geometry import attitude
from plants.simulation import blocks


class Condition(Protocol):
    """A condition that ends a mode once it has been met for `hold` s without a break."""

    @property
    def hold(self) -> Any: ...  # noqa: D102

    def met(self, error: Array, rate: Array, elapsed: Array, /) -> Array: ...  # noqa: D102


@partial(blocks.node, data_fields=["seconds", "hold"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class After:
    """So long after the mode was entered."""

    seconds: Numbers  # () s
    hold: Numbers  # () s

    @classmethod
    def create(cls, seconds: float) -> "After":
        """`seconds` () s after the mode was entered; ScenarioError if not positive."""
        return cls(seconds=positive("seconds", seconds), hold=real("hold", 0.0))

    def met(self, error: Array, rate: Array, elapsed: Array) -> Array:
        """Whether the time is over, ()."""
        del error, rate
        return elapsed >= jnp.asarray(self.seconds) * (1 - 1e-12)


@partial(blocks.node, data_fields=["rate", "hold"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Slow:
    """The body turns slowly: detumbled."""

    rate: Numbers  # () rad/s
    hold: Numbers  # () s

    @classmethod
    def create(cls, rate: float, *, hold: float = 60.0) -> "Slow":
        """The length of the inertial rate is below `rate` () rad/s for `hold` () s; ScenarioError if not positive."""
        return cls(rate=positive("rate", rate), hold=real("hold", hold, low=0))

    def met(self, error: Array, rate: Array, elapsed: Array) -> Array:
        """Whether it is slow, ()."""
        del error, elapsed
        return attitude.dot(rate, rate) < jnp.asarray(self.rate) ** 2


@partial(blocks.node, data_fields=["angle", "rate", "hold"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Pointed:
    """The body has the commanded attitude and rate: acquired."""

    angle: Numbers  # () rad
    rate: Numbers  # () rad/s, relative to the commanded frame
    hold: Numbers  # () s

    @classmethod
    def create(cls, angle: float, *, rate: float, hold: float = 30.0) -> "Pointed":
        """The error is below `angle` () rad and `rate` () rad/s for `hold` () s; ScenarioError if not positive."""
        return cls(angle=positive("angle", angle), rate=positive("rate", rate), hold=real("hold", hold, low=0))

    def met(self, error: Array, rate: Array, elapsed: Array) -> Array:
        """Whether it points, ()."""
        del rate, elapsed
        vector, turn = error[:3], error[3:]
        near = attitude.dot(vector, vector) < jnp.sin(jnp.asarray(self.angle) / 2) ** 2
        return near & (attitude.dot(turn, turn) < jnp.asarray(self.rate) ** 2)
