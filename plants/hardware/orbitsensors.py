"""Sensors of where the Earth is: a horizon sensor (direction to nadir) and a GPS receiver (position and velocity)."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, positive, real
from plants.geometry import attitude
from plants.hardware.instruments import Direction, Innovation, Pair, direction_innovation, tick, unit, within
from plants.simulation import blocks


@partial(blocks.node, data_fields=["noise", "boresight", "half_angle", "misalignment", "period"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class HorizonSensor:
    """Direction to the Earth's centre. Build it with `HorizonSensor.create`, which checks the numbers."""

    noise: ArrayLike  # () rad, 1 sigma per axis
    boresight: Numbers  # (3,) unit vector, body axes
    half_angle: ArrayLike  # () rad from the boresight to nadir, beyond which there is no reading
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
    ) -> "HorizonSensor":
        """A horizon sensor from its data sheet; without `half_angle` (rad) it sees the Earth in every direction.

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
        """Direction to nadir if it is time and the Earth is in view."""
        wait, due = tick(s, self.period, h)
        nadir = attitude.rotate(x.q, _nadir(env))
        cosine = jnp.cos(jnp.minimum(self.half_angle, jnp.pi))
        seen = due * within(attitude.dot(nadir, self.boresight), cosine - 1e-12)
        read = attitude.rotate(attitude.from_vector(self.misalignment), nadir) + self.noise * noise
        return wait, Direction(seen * read, seen)

    def innovation(self, y: Direction, q: Array, own: Array, env: Any) -> Innovation:
        """See `instruments.direction_innovation`."""
        return direction_innovation(y, _nadir(env), q, own, self.noise)

    def pair(self, y: Direction, env: Any) -> Pair:
        """The direction in both frames."""
        return Pair(y.vector, _nadir(env), jnp.asarray(self.noise), y.valid)


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


def _nadir(env: Any) -> Array:
    """Direction to the Earth's centre (3,), frame N."""
    return -env.r / jnp.sqrt(attitude.dot(env.r, env.r))
