"""Three-axis magnetometer: bias, scale factors, axes that are neither aligned nor square, noise and quantisation.

Reading = M (A(q) B) + bias + noise, rounded to the quantum. Markley and Crassidis (2014), section 4.7 (errors), with
M of `instruments.distortion`.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, real
from plants.geometry import attitude
from plants.hardware.instruments import Direction, Innovation, Pair, distortion, tick
from plants.simulation import blocks


@partial(blocks.node, data_fields=["noise", "bias", "matrix", "quantum", "period"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class ThreeAxisMagnetometer:
    """Magnetic field in body axes. Build it with `ThreeAxisMagnetometer.create`, which checks the numbers."""

    noise: ArrayLike  # () T, 1 sigma per axis
    bias: Numbers  # (3,) T, the spacecraft's own field included
    matrix: Numbers  # (3, 3) from the true field to what the axes give
    quantum: ArrayLike  # () T, 0 for none
    period: ArrayLike  # () s between two readings, 0 for one at every sample

    @classmethod
    def create(
        cls,
        *,
        noise: float,
        bias: Given = (0.0, 0.0, 0.0),
        scale_factor: Given = 0.0,
        misalignment: Given = (0.0, 0.0, 0.0),
        nonorthogonality: Given = (0.0, 0.0, 0.0),
        quantum: float = 0.0,
        period: float = 0.0,
    ) -> "ThreeAxisMagnetometer":
        """A magnetometer from its data sheet.

        Parameters
        ----------
        noise : () T, 1 sigma per axis of a reading
        bias : (3,) T
        scale_factor, misalignment, nonorthogonality : see `instruments.distortion`
        quantum : () T, least step of a reading; 0 for none
        period : () s between two readings; 0 for one at every sample

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, negative numbers.
        """
        return cls(
            noise=real("noise", noise, low=0),
            bias=real("bias", bias, (3,)),
            matrix=distortion(scale_factor, misalignment, nonorthogonality),
            quantum=real("quantum", quantum, low=0),
            period=real("period", period, low=0),
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 3

    @property
    def parameters(self) -> str:
        """What a filter may estimate of it, (3,)."""
        return "bias, T"

    @property
    def deviation(self) -> Array:
        """1 sigma per axis, () T, with that of rounding."""
        return jnp.sqrt(jnp.asarray(self.noise) ** 2 + jnp.asarray(self.quantum) ** 2 / 12)

    def init(self) -> Array:
        """Time to the next reading, () s."""
        return jnp.zeros(())

    def measure(self, s: Array, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Array, Direction]:
        """The field (3,) T in body axes, if it is time."""
        wait, due = tick(s, self.period, h)
        field = jnp.asarray(self.matrix) @ attitude.rotate(x.q, env.B) + self.bias + self.noise * noise
        valid = due.astype(float)
        return wait, Direction(valid * rounded(field, self.quantum), valid)

    def innovation(self, y: Direction, q: Array, own: Array, env: Any) -> Innovation:
        """Field read less the one expected, T. Its own parameters, if a filter estimates them, are its bias (3,) T."""
        field = attitude.rotate(q, env.B)
        ones = jnp.ones(3)
        return Innovation(
            z=jnp.where(y.valid > 0, y.vector - field - (own if own.shape[0] else 0.0), 0.0),
            attitude=attitude.cross_matrix(field),
            own=jnp.eye(3)[:, : own.shape[0]],
            variance=self.deviation**2 * ones,
            valid=y.valid * ones,
        )

    def pair(self, y: Direction, env: Any) -> Pair:
        """The field in both frames."""
        strength = jnp.sqrt(attitude.dot(env.B, env.B))
        return Pair(y.vector, env.B, self.deviation / strength, y.valid)


def rounded(value: Array, quantum: ArrayLike) -> Array:
    """Value to the nearest multiple of a quantum; as it is for a quantum of zero."""
    quantum = jnp.asarray(quantum)
    step = jnp.where(quantum > 0, quantum, 1.0)
    return jnp.where(quantum > 0, step * jnp.round(value / step), value)
