"""What is known of an `EulerBody`: raw measurements, rates from differences of angles, or a Kalman filter.

Predict and correct every h s, with the pseudo-linear model frozen at the estimate:

    x- = F x + G u,   P- = F P F' + G S G',          F = exp(A(x) h), G = (integral of exp(A(x) t) over h) B
    K = P- C' (C P- C' + R)^-1,   x = x- + K (y - C x-),   P = (I - K C) P-

u is the torque on the body, S the covariance of an unknown torque that is held for a sample. Reference: the paper of
`plants.missions.airbearing`, equations 15 to 17.

Every navigator returns the estimate [angles; w; h], (9,) as `EulerBody.output`; wheel speeds are exact.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Guess

from plants.checks import Numbers, real
from plants.dynamics.eulerbody import EulerBody, kinematics
from plants.errors import ScenarioError
from plants.estimation.updates import scalar_updates
from plants.hardware.sensors import AngleRate, AngleRateSuite


class Last(NamedTuple):
    """State of `RawAngles`."""

    angles: Array  # (3,) rad, of the last sample
    first: Array  # () 1 before the first sample


@dataclass(frozen=True, kw_only=True)
class RawAngles:
    """The angles as measured, and the rate `measured` y.rate + `differenced` E^-1 (angles - last) / h.

    (1, 0) feeds the rate sensor through, (0, 1) is the backward difference, (0, 0) knows no rate.
    """

    body: EulerBody
    measured: ArrayLike  # () weight of the rate sensor
    differenced: ArrayLike  # () weight of the backward difference, which is zero at the first sample

    def init(self) -> Last:
        """No sample yet."""
        return Last(jnp.zeros(3), jnp.ones(()))

    def update(self, s: Last, y: AngleRate, u: Any, env: Any, h: Any) -> tuple[Last, Array]:
        """New state and estimate (9,); what acted does not matter."""
        del u, env
        slope = (y.angles - s.angles) / jnp.where(s.first > 0, 1.0, h) * (1 - s.first)
        rate = self.measured * y.rate + self.differenced * jnp.linalg.solve(kinematics(y.angles), slope)
        estimate = jnp.concatenate([y.angles, rate, self.body.wheel_inertia * y.wheels])
        return Last(y.angles, jnp.zeros(())), estimate


class KalmanState(NamedTuple):
    """State of `Kalman`."""

    x: Array  # (6,) [angles; w], rad and rad/s
    P: Array  # (6, 6) its covariance


@dataclass(frozen=True, kw_only=True)
class Kalman:
    """The filter, of angles and rates or of angles alone. Build it with `kalman`, which checks."""

    body: EulerBody
    torque_noise: Numbers  # () N m, 1 sigma per axis of an unknown torque, held for a sample
    noise: Numbers  # (6,) rad and rad/s, 1 sigma of the sensors
    known: Numbers  # (6,) 1 for a measurement that is used, 0 for none
    x: Numbers  # (6,) first guess
    deviation: Numbers  # (6,) its standard deviation

    def init(self) -> KalmanState:
        """The first guess."""
        return KalmanState(jnp.asarray(self.x), jnp.diag(jnp.asarray(self.deviation) ** 2))

    def update(self, s: KalmanState, y: AngleRate, u: Any, env: Any, h: Any) -> tuple[KalmanState, Array]:
        """New state and estimate (9,); u (3,) N m turned the wheels for the h s since the last sample."""
        del env
        before = y.wheels - u * h / self.body.wheel_inertia  # the speeds at the last sample
        A, B = self.body.pseudolinear(s.x[:3], s.x[3:], before)
        M = jnp.concatenate([jnp.concatenate([A, B], 1), jnp.zeros((3, 9))])
        step = jax.scipy.linalg.expm(h * M)
        F, G = step[:6, :6], step[:6, 6:]
        x = F @ s.x - G @ u
        P = F @ s.P @ F.T + self.torque_noise**2 * G @ G.T
        z = jnp.concatenate([y.angles, y.rate]) - x
        e, P = scalar_updates(P, z, jnp.eye(6), jnp.asarray(self.noise) ** 2, jnp.asarray(self.known))
        x = x + e
        return KalmanState(x, P), jnp.concatenate([x, self.body.wheel_inertia * y.wheels])


def kalman(
    body: EulerBody,
    suite: AngleRateSuite,
    *,
    torque_noise: float,
    rates: bool = True,
    x: Guess = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    deviation: Guess | None = None,
) -> Kalman:
    """Kalman filter for the given body and sensors.

    Parameters
    ----------
    body : model of the body
    suite : the sensors, of which the filter takes the noise
    torque_noise : () N m, 1 sigma per axis
    rates : whether the rate sensor is used; without it the filter finds the rate from the angles
    x : (6,) rad and rad/s, first guess of [angles; w]
    deviation : (6,) its standard deviation; by default that of the sensors

    Raises
    ------
    ScenarioError
        Wrong shape, NaN, a negative deviation, sensors without noise (their correction would be singular).
    """
    noise = [real(name, getattr(suite, name), low=0) for name in ("angle_noise", "rate_noise")]
    if not all(value > 0 for value in noise):
        raise ScenarioError(
            f"angle_noise and rate_noise are {[float(v) for v in noise]}: a Kalman filter needs both positive; "
            "feed perfect measurements back without one (`RawAngles`)"
        )
    sigma = np.repeat(noise, 3)
    return Kalman(
        body=body,
        torque_noise=real("torque_noise", torque_noise, low=0),
        noise=real("noise", sigma, (6,)),
        known=real("known", [1.0] * 3 + [float(rates)] * 3, (6,)),
        x=real("x", x, (6,)),
        deviation=real("deviation", sigma if deviation is None else deviation, (6,), low=0),
    )
