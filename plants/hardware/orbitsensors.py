"""Sensors of where the Earth is: a horizon sensor (direction to nadir) and a GPS receiver (position and velocity)."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.checks import real
from plants.geometry import attitude
from plants.hardware.directionsensors import FIELDS, DirectionSensor
from plants.hardware.instruments import tick
from plants.simulation import blocks


@partial(blocks.node, data_fields=FIELDS, meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class HorizonSensor(DirectionSensor):
    """Direction to the Earth's centre. Build it with `create`, which checks the numbers."""

    def target(self, env: Any) -> Array:
        """Direction to the Earth's centre (3,), frame N."""
        return -env.r / jnp.sqrt(attitude.dot(env.r, env.r))


class Fix(NamedTuple):
    """Reading of a GPS receiver, frame N."""

    position: Array  # (3,) m; zero if there is none
    velocity: Array  # (3,) m/s
    valid: Array  # () 1 or 0


@partial(blocks.node, data_fields=["position_noise", "velocity_noise", "period"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class GpsReceiver:
    """Position and velocity of the spacecraft. Build it with `GpsReceiver.create`, which checks the numbers."""

    position_noise: ArrayLike  # () m, 1 sigma per axis
    velocity_noise: ArrayLike  # () m/s, 1 sigma per axis
    period: ArrayLike  # () s between two readings, 0 for one at every sample

    @classmethod
    def create(cls, *, position_noise: float, velocity_noise: float, period: float = 0.0) -> "GpsReceiver":
        """A receiver with so many m and m/s of noise per axis, 1 sigma; ScenarioError for NaN or a negative number."""
        return cls(
            position_noise=real("position_noise", position_noise, low=0),
            velocity_noise=real("velocity_noise", velocity_noise, low=0),
            period=real("period", period, low=0),
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 6

    def init(self) -> Array:
        """Time to the next reading, () s."""
        return jnp.zeros(())

    def measure(self, s: Array, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Array, Fix]:
        """Where the environment says that the spacecraft is, if it is time."""
        del x
        wait, due = tick(s, self.period, h)
        valid = due.astype(float)
        position, velocity = env.r + self.position_noise * noise[:3], env.v + self.velocity_noise * noise[3:]
        return wait, Fix(valid * position, valid * velocity, valid)
