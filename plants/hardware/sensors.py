"""Sensors of attitude and rate: sun sensor, magnetometer, gyro, wheel tachometers; Euler angles and rates at once.

Each is the true quantity in body axes plus white noise, the same on the three axes and independent from sample
to sample; the gyro adds a bias that walks. Sensors are aligned with the body and see in every direction. Those that
are sold, with fields of view, misalignments and rates of their own, are in the other files of this room and form a
`plants.hardware.instruments.SensorSuite`.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Numbers

from plants.checks import real
from plants.errors import ScenarioError
from plants.geometry import attitude

DUSK = 0.5  # () visible fraction of the Sun below which the sun sensor gives no direction


class Measurement(NamedTuple):
    """One sample of the attitude suite, body axes."""

    sun: Array  # (3,) direction to the Sun, not normalised; zero when it is not seen
    sun_seen: Array  # () 1 or 0
    field: Array  # (3,) T
    rate: Array  # (3,) rad/s, inertial
    wheels: Array  # (n,) rad/s, wheel speeds, exact


@dataclass(frozen=True, kw_only=True)
class SunSensor:
    """Direction to the Sun."""

    noise: ArrayLike  # () rad, 1 sigma per axis

    def measure(self, direction: Array, fraction: Array, noise: Array) -> tuple[Array, Array]:
        """Direction (3,) in body axes, and whether the Sun is seen; a zero vector says that it is not."""
        seen = (fraction >= DUSK).astype(float)
        return seen * (direction + self.noise * noise), seen


@dataclass(frozen=True, kw_only=True)
class Magnetometer:
    """Magnetic field."""

    noise: ArrayLike  # () T, 1 sigma per axis

    def measure(self, field: Array, noise: Array) -> Array:
        """Field (3,) T in body axes."""
        return field + self.noise * noise


@dataclass(frozen=True, kw_only=True)
class Gyro:
    """Inertial rate with a bias that walks."""

    noise: ArrayLike  # () rad/s, 1 sigma per axis and sample, whatever the sampling rate
    bias: ArrayLike  # (3,) rad/s, at the start
    bias_walk: ArrayLike  # () rad/s/sqrt(s)
    random_walk: ArrayLike = 0.0  # () rad/sqrt(s), of the angle: more noise in shorter samples

    def measure(self, rate: Array, bias: Array, noise: Array, h: ArrayLike) -> Array:
        """Rate (3,) rad/s in body axes, read every h s."""
        return rate + bias + self.deviation(h) * noise

    def deviation(self, h: ArrayLike) -> Array:
        """1 sigma per axis of a sample, () rad/s; a random walk of the angle has none before time has passed."""
        return deviation(self.noise, self.random_walk, h)


def deviation(noise: ArrayLike, random_walk: ArrayLike, h: ArrayLike) -> Array:
    """1 sigma () rad/s of a rate read every h s: `noise` rad/s, or `random_walk` rad/sqrt(s) over sqrt(h)."""
    passed = jnp.asarray(h) > 0
    return jnp.asarray(noise) + jnp.where(passed, random_walk / jnp.sqrt(jnp.where(passed, h, 1.0)), 0.0)


@dataclass(frozen=True, kw_only=True)
class AttitudeSuite:
    """Sun sensor, magnetometer, gyro and tachometers, sampled together; its state is the gyro's bias (3,) rad/s.

    The environment must give `B`, `sun`, `sunlit`, and the plant state `q`, `w`, `wheels`.
    """

    sun: SunSensor
    magnetometer: Magnetometer
    gyro: Gyro

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 12

    def init(self) -> Array:
        """The gyro's bias at the start, (3,) rad/s."""
        return jnp.asarray(self.gyro.bias)

    def measure(self, s: Array, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Array, Measurement]:
        """Measure the state x; the bias has walked for h s."""
        bias = s + self.gyro.bias_walk * jnp.sqrt(h) * noise[9:12]
        sun, seen = self.sun.measure(attitude.rotate(x.q, env.sun), env.sunlit, noise[0:3])
        return bias, Measurement(
            sun=sun,
            sun_seen=seen,
            field=self.magnetometer.measure(attitude.rotate(x.q, env.B), noise[3:6]),
            rate=self.gyro.measure(x.w, bias, noise[6:9], h),
            wheels=x.wheels,
        )


def attitude_suite(
    *,
    sun_noise: float,
    magnetometer_noise: float,
    gyro_noise: float | None = None,
    gyro_random_walk: float | None = None,
    gyro_bias: Numbers = (0.0, 0.0, 0.0),
    gyro_bias_walk: float = 0.0,
) -> AttitudeSuite:
    """The suite from its data sheet.

    Parameters
    ----------
    sun_noise : () rad, 1 sigma per axis
    magnetometer_noise : () T, 1 sigma per axis
    gyro_noise : () rad/s, 1 sigma per axis at the sampling rate of the scenario: another rate needs another number
    gyro_random_walk : () rad/sqrt(s), angle random walk, instead: right at every sampling rate
    gyro_bias : (3,) rad/s
    gyro_bias_walk : () rad/s/sqrt(s)

    Raises
    ------
    ScenarioError
        Wrong shape, NaN or a negative deviation; both or neither of `gyro_noise` and `gyro_random_walk`.
    """
    if (gyro_noise is None) == (gyro_random_walk is None):
        raise ScenarioError(
            "gyro_noise and gyro_random_walk: give exactly one, of a sample (rad/s) or of the angle (rad/sqrt(s))"
        )
    return AttitudeSuite(
        sun=SunSensor(noise=real("sun_noise", sun_noise, low=0)),
        magnetometer=Magnetometer(noise=real("magnetometer_noise", magnetometer_noise, low=0)),
        gyro=Gyro(
            noise=real("gyro_noise", 0.0 if gyro_noise is None else gyro_noise, low=0),
            random_walk=real("gyro_random_walk", 0.0 if gyro_random_walk is None else gyro_random_walk, low=0),
            bias=real("gyro_bias", gyro_bias, (3,)),
            bias_walk=real("gyro_bias_walk", gyro_bias_walk, low=0),
        ),
    )


class AngleRate(NamedTuple):
    """One sample of `AngleRateSuite`."""

    angles: Array  # (3,) rad, 3-2-1 Euler angles
    rate: Array  # (3,) rad/s, body axes
    wheels: Array  # (3,) rad/s, wheel speeds, exact


@dataclass(frozen=True, kw_only=True)
class AngleRateSuite:
    """Euler angles and body rates with white noise, tachometers without, for a plant state `angles`, `w`, `wheels`."""

    angle_noise: ArrayLike  # () rad, 1 sigma per angle
    rate_noise: ArrayLike  # () rad/s, 1 sigma per axis

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 6

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def measure(self, s: tuple[()], x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[tuple[()], AngleRate]:
        """Measure the state x."""
        del env, h
        return s, AngleRate(x.angles + self.angle_noise * noise[:3], x.w + self.rate_noise * noise[3:], x.wheels)
