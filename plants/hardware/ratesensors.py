"""Rate sensors: the gyro in the units in which it is sold, and the tachometers of the wheels.

A rate-integrating gyro counts the angle by which it has turned. Its errors, per axis, with independent normal n:

    turn  = M (true turn) + h (b + b') / 2 + h g + sqrt(h v^2 + h^3 u^2 / 12) n1     v  angle random walk
    b'    = b + u sqrt(h) n2                                                         u  rate random walk
    g'    = exp(-h / T) g + s sqrt(1 - exp(-2 h / T)) n3                             s  of the bias instability

so that the noise of a rate is v / sqrt(h): sampling faster adds nothing to what is known of an angle. Farrenkopf
(1978), Analytic steady-state accuracy solutions for two common spacecraft attitude estimators; Markley and Crassidis
(2014), section 4.7. The flicker noise of the bias is that of a first-order Markov process, whose Allan deviation has a
maximum of 0.618 s at 1.89 T (IEEE Std 952-1997, annex C).
"""

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
from plants.hardware.instruments import distortion
from plants.hardware.magnetometer import rounded
from plants.simulation import blocks

FLICKER = 0.61736  # () largest Allan deviation of a first-order Markov process over its standard deviation


class Turn(NamedTuple):
    """Reading of a gyro."""

    turn: Array  # (3,) rad, by which the body has turned since the last sample, whole quanta
    rate: Array  # (3,) rad/s, now
    valid: Array  # () 1, or 0 if it turned faster than it can measure


class GyroState(NamedTuple):
    """State of `Gyro`."""

    q: Array  # (4,) attitude at the last sample
    bias: Array  # (3,) rad/s, that walks
    flicker: Array  # (3,) rad/s, that comes and goes
    rest: Array  # (3,) rad, turned but not yet counted
    started: Array  # () 1 after the first sample


@partial(
    blocks.node,
    data_fields=[
        "random_walk", "rate_random_walk", "instability", "correlation_time", "bias", "turn_on", "matrix", "quantum",
        "fastest",
    ],
    meta_fields=[],
)  # fmt: skip
@dataclass(frozen=True, kw_only=True)
class IntegratingGyro:
    """A gyro of three axes. Build it with `IntegratingGyro.create`, which checks the numbers."""

    random_walk: ArrayLike  # () rad/sqrt(s), angle random walk
    rate_random_walk: ArrayLike  # () rad/s/sqrt(s)
    instability: ArrayLike  # () rad/s, flat part of the Allan deviation
    correlation_time: ArrayLike  # () s, of the bias instability
    bias: Numbers  # (3,) rad/s, mean of many starts
    turn_on: ArrayLike  # () rad/s, 1 sigma of what differs from start to start
    matrix: Numbers  # (3, 3) from the true rate to what the axes give
    quantum: ArrayLike  # () rad, one count, 0 for none
    fastest: ArrayLike  # () rad/s, largest rate of an axis

    @classmethod
    def create(
        cls,
        *,
        random_walk: float,
        rate_random_walk: float = 0.0,
        bias_instability: float = 0.0,
        correlation_time: float = 1000.0,
        bias: Given = (0.0, 0.0, 0.0),
        turn_on_bias: float = 0.0,
        scale_factor: Given = 0.0,
        misalignment: Given = (0.0, 0.0, 0.0),
        nonorthogonality: Given = (0.0, 0.0, 0.0),
        quantum: float = 0.0,
        fastest: float = np.inf,
    ) -> "IntegratingGyro":
        """A gyro from its data sheet; usual units are numbers times `DEG_PER_SQRT_H` and `DEG_PER_H`.

        Parameters
        ----------
        random_walk : () rad/sqrt(s), angle random walk; as a density of rate, rad/s/sqrt(Hz), it is the same number
        rate_random_walk : () rad/s/sqrt(s)
        bias_instability : () rad/s, flat part of the Allan deviation
        correlation_time : () s, of the bias instability: the flat part lies at 1.89 times of it
        bias : (3,) rad/s, the same in every run
        turn_on_bias : () rad/s, 1 sigma per axis of a constant bias that is drawn for every run
        scale_factor, misalignment, nonorthogonality : see `instruments.distortion`
        quantum : () rad, one count of the angle; 0 for none
        fastest : () rad/s, at which an axis saturates

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, negative numbers, a correlation time or largest rate that is not positive.
        """
        return cls(
            random_walk=real("random_walk", random_walk, low=0),
            rate_random_walk=real("rate_random_walk", rate_random_walk, low=0),
            instability=real("bias_instability", bias_instability, low=0),
            correlation_time=positive("correlation_time", correlation_time),
            bias=real("bias", bias, (3,)),
            turn_on=real("turn_on_bias", turn_on_bias, low=0),
            matrix=distortion(scale_factor, misalignment, nonorthogonality),
            quantum=real("quantum", quantum, low=0),
            fastest=positive("fastest", fastest, infinite=True),
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 9

    def init(self) -> GyroState:
        """Not started: the biases of a run are drawn at its first sample."""
        return GyroState(jnp.array([1.0, 0, 0, 0]), jnp.asarray(self.bias), jnp.zeros(3), jnp.zeros(3), jnp.zeros(()))

    def measure(self, s: GyroState, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[GyroState, Turn]:
        """The angle turned in h s and the rate at the end, from x.q and x.w; at the first sample no angle."""
        del env
        n1, n2, n3 = noise[:3], noise[3:6], noise[6:9]
        going, moved = s.started > 0, jnp.asarray(h) > 0
        period = jnp.where(moved, h, 1.0)
        bias = s.bias + jnp.where(going, self.rate_random_walk * jnp.sqrt(h), self.turn_on) * n2
        kept = jnp.where(going, jnp.exp(-jnp.asarray(h) / self.correlation_time), 0.0)
        flicker = kept * s.flicker + self.instability / FLICKER * jnp.sqrt(1 - kept**2) * n3
        offset = jnp.where(going, (s.bias + bias) / 2, bias) + flicker
        v, u = jnp.asarray(self.random_walk), jnp.asarray(self.rate_random_walk)
        offset = offset + jnp.where(moved, jnp.sqrt(v**2 / period + u**2 * period / 12), 0.0) * n1
        turned = attitude.to_vector(attitude.compose(x.q, attitude.conjugate(jnp.where(going, s.q, x.q))))
        most = jnp.asarray(self.fastest)
        mean = jnp.asarray(self.matrix) @ (turned / period) + offset
        rate = jnp.asarray(self.matrix) @ x.w + offset
        asked = s.rest + h * jnp.clip(mean, -most, most)
        counted = rounded(asked, self.quantum)
        rest = asked - counted
        rate = jnp.clip(rate - jnp.where(moved, (rest - s.rest) / period, 0.0), -most, most)
        valid = jnp.all(jnp.maximum(jnp.abs(mean), jnp.abs(rate)) < most).astype(float)
        return GyroState(x.q, bias, flicker, rest, jnp.ones(())), Turn(counted, rate, valid)


class WheelSpeeds(NamedTuple):
    """Reading of tachometers."""

    wheels: Array  # (n,) rad/s
    valid: Array  # () 1


@partial(blocks.node, data_fields=["quantum"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Tachometers:
    """Speeds of the wheels, in whole quanta. Build them with `Tachometers.create`."""

    quantum: ArrayLike  # () rad/s, 0 for none

    @classmethod
    def create(cls, *, quantum: float = 0.0) -> "Tachometers":
        """Tachometers with steps of `quantum` rad/s; ScenarioError for NaN or a negative number."""
        return cls(quantum=real("quantum", quantum, low=0))

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 0

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, s: tuple[()], x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[tuple[()], WheelSpeeds]:
        """Speeds of x.wheels."""
        del env, noise, h
        return s, WheelSpeeds(rounded(jnp.asarray(x.wheels), self.quantum), jnp.ones(()))
