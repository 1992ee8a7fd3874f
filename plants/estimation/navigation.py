"""Attitude determination: smoothing filter, Wahba's problem, and an extended Kalman filter.

References: Markley and Crassidis (2014), Fundamentals of Spacecraft Attitude Determination and Control, chapters 5
and 6; Pecorilla and Stesina (2024), section 2.2, whose eq. 8 are the nine states of the filter.

Frame O is the frame of reference (orbital, see `plants.surroundings.environment`), B the body. Every navigator returns
the estimate [vector part of q_OB with scalar part >= 0; w_OB in body axes (rad/s)], (6,).
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Numbers

from plants.checks import real
from plants.dynamics.rigidbody import BodyState, RigidBody
from plants.errors import ScenarioError
from plants.estimation.updates import tested_updates
from plants.estimation.wahba import wahba_covariance, wahba_pair
from plants.geometry import attitude
from plants.hardware.sensors import AttitudeSuite, Measurement, deviation

DEVIATION = (0.3, 0.3, 0.3, 1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3)  # (9,) of a first guess that is known to be rough


class Smoothing(NamedTuple):
    """Moving average of the vector measurements: the last N, zeros where there was none."""

    sun: Array  # (N, 3) directions
    field: Array  # (N, 3) T


def smooth(s: Smoothing, y: Measurement) -> Smoothing:
    """The newest measurement in, the oldest out."""
    return Smoothing(jnp.concatenate([s.sun[1:], y.sun[None]]), jnp.concatenate([s.field[1:], y.field[None]]))


def vector_attitude(s: Smoothing, sun_noise: Any, field_noise: Any, env: Any) -> tuple[Array, Array]:
    """Quaternion q_OB (4,) from the smoothed vectors, weighted by their variances, and whether there is one."""
    sun, B = _in_orbital_frame(env)
    weights = jnp.stack([1 / sun_noise**2, attitude.dot(B, B) / field_noise**2])
    body = jnp.stack([s.sun.sum(axis=0), s.field.sum(axis=0)])
    A, determined = wahba_pair(body, jnp.stack([sun, B]), weights)
    A = jnp.where(determined, A, jnp.eye(3))
    return attitude.from_dcm(A), determined


class SvdState(NamedTuple):
    """State of `SvdNavigator`."""

    smoothing: Smoothing
    q: Array  # (4,) last attitude


@dataclass(frozen=True, kw_only=True)
class SvdNavigator:
    """Deterministic attitude and raw gyro: the estimate of the SVD configuration of Pecorilla and Stesina.

    q_OB solves Wahba's problem for the smoothed Sun and field vectors; w_OB is the measured rate less the rate
    of frame O, bias and noise included. Without the Sun there is no attitude: the last one is held.
    """

    sun_noise: ArrayLike  # () rad, 1 sigma per axis
    field_noise: ArrayLike  # () T, 1 sigma per axis
    window: int = 5  # samples of the moving average

    def init(self) -> SvdState:
        """No measurements yet."""
        return SvdState(_no_measurements(self.window), jnp.array([1.0, 0.0, 0.0, 0.0]))

    def update(self, s: SvdState, y: Measurement, u: Any, env: Any, h: Any) -> tuple[SvdState, Array]:
        """New state and estimate (6,); what acted does not matter."""
        del u, h
        smoothing = smooth(s.smoothing, y)
        q, determined = vector_attitude(smoothing, self.sun_noise, self.field_noise, env)
        q = jnp.where(determined & (y.sun_seen > 0), q, s.q)
        return SvdState(smoothing, q), _estimate(q, y.rate, env)


class Innovation(NamedTuple):
    """What m scalars tell of an attitude, to first order; the error is the vector part of a quaternion."""

    z: Array  # (m,) measured less expected
    H: Array  # (m, 3) its slope
    R: Array  # (m,) variances
    known: Array  # (m,) 1 for a row that carries information, 0 for none


@dataclass(frozen=True, kw_only=True)
class VectorsThemselves:
    """Correction by the vectors to the Sun and of the field, of which the field remains in eclipse."""

    sun_noise: ArrayLike  # () rad
    field_noise: ArrayLike  # () T

    def innovation(self, s: "EkfState", y: Measurement, env: Any) -> Innovation:
        """Vectors measured less expected, (6,)."""
        ones = jnp.ones(3)
        sun, B = (attitude.rotate(s.q, v) for v in _in_orbital_frame(env))

        def expected(a: Array) -> Array:
            q = _error_quaternion(a)
            return jnp.concatenate([attitude.rotate(q, sun), attitude.rotate(q, B)])

        return Innovation(
            z=jnp.concatenate([y.sun - sun, y.field - B]),
            H=jax.jacfwd(expected)(jnp.zeros(3)),
            R=jnp.concatenate([self.sun_noise**2 * ones, self.field_noise**2 * ones]),
            known=jnp.concatenate([y.sun_seen * ones, ones]),
        )


@dataclass(frozen=True, kw_only=True)
class WahbaSolution:
    """Correction by the solution of Wahba's problem, the scheme of the reference; nothing in eclipse."""

    sun_noise: ArrayLike  # () rad
    field_noise: ArrayLike  # () T
    attitude_noise: ArrayLike | None  # () vector part of a quaternion; None for the covariance of the solution

    def innovation(self, s: "EkfState", y: Measurement, env: Any) -> Innovation:
        """Vector part (3,) from the estimate to the solution, in units of its deviation where that is computed."""
        q, determined = vector_attitude(s.smoothing, self.sun_noise, self.field_noise, env)
        z = attitude.positive(attitude.compose(q, attitude.conjugate(s.q)))[1:]
        ones, known = jnp.ones(3), determined * y.sun_seen * jnp.ones(3)
        if self.attitude_noise is not None:
            return Innovation(z, jnp.eye(3), jnp.asarray(self.attitude_noise) ** 2 * ones, known)
        sun, B = _in_orbital_frame(env)
        deviations = jnp.stack([jnp.asarray(self.sun_noise), self.field_noise / jnp.sqrt(attitude.dot(B, B))])
        P = wahba_covariance(attitude.rotate(q[None], jnp.stack([sun, B])), deviations) / 4
        W = jnp.linalg.inv(jnp.linalg.cholesky(jnp.where(determined, P, jnp.eye(3))))
        return Innovation(W @ z, W, ones, known)


class EkfState(NamedTuple):
    """State of `Ekf`: eq. 8 with the quaternion whole."""

    smoothing: Smoothing
    q: Array  # (4,) q_OB
    w: Array  # (3,) rad/s, inertial rate of the body
    bias: Array  # (3,) rad/s, of the gyro
    P: Array  # (9, 9) covariance of (vector part of the error quaternion, rate, bias)
    nis: Array  # () normalised innovation squared of this sample, chi-square with `rows` degrees of freedom
    rows: Array  # () scalars that have corrected in this sample


@dataclass(frozen=True, kw_only=True)
class Ekf:
    """Extended Kalman filter for attitude, rate and gyro bias; build it with `ekf` or `direct_ekf`.

    The states are those of eq. 8. The quaternion is carried whole and corrected by multiplication, and P is the
    covariance of the vector part of the error quaternion (half angles): near nadir this is eq. 8 to first order,
    and it has neither a sign to choose nor a singularity at large angles (Markley and Crassidis, section 6.2).
    The rate is propagated by Euler's equation with the measured wheel speeds and the torques that acted. All
    Jacobians are derived by `jax.jacfwd`.

    Attitude enters through `vectors`: as the solution of Wahba's problem, or as the Sun and field vectors themselves.
    """

    body: RigidBody  # what the filter believes of the spacecraft; its disturbances, if any, are predicted too
    vectors: WahbaSolution | VectorsThemselves
    gyro_noise: ArrayLike  # () rad/s, of a sample
    torque_noise: ArrayLike  # () N m sqrt(s), root of the spectral density of unknown torques
    bias_walk: ArrayLike  # () rad/s/sqrt(s)
    q: ArrayLike  # (4,) first guess of q_OB
    w: ArrayLike  # (3,) rad/s, first guess
    bias: ArrayLike  # (3,) rad/s, first guess
    deviation: ArrayLike  # (9,) of the first guess, as the diagonal of P^1/2
    window: int = 1  # samples of the moving average, for `WahbaSolution`
    gyro_random_walk: ArrayLike = 0.0  # () rad/sqrt(s), of the angle

    def init(self) -> EkfState:
        """The first guess."""
        P = jnp.diag(jnp.asarray(self.deviation) ** 2)
        q, w, bias = (jnp.asarray(a) for a in (self.q, self.w, self.bias))
        return EkfState(_no_measurements(self.window), q, w, bias, P, jnp.zeros(()), jnp.zeros(()))

    def update(self, s: EkfState, y: Measurement, u: Any, env: Any, h: Any) -> tuple[EkfState, Array]:
        """Predict over the h s during which u acted, then correct by the measurement: new state, estimate (6,)."""
        s = self.predict(s, y.wheels, u, env, h)._replace(smoothing=smooth(s.smoothing, y))
        # the barrier keeps XLA from predicting again in every one of the scalar updates
        P, z, H, R, known = jax.lax.optimization_barrier((s.P, *self.innovation(s, y, env, h)))
        e, P, nis = tested_updates(P, z, H, R, known)
        q = attitude.normalise(attitude.compose(_error_quaternion(e[:3]), s.q))
        s = s._replace(q=q, w=s.w + e[3:6], bias=s.bias + e[6:9], P=P, nis=nis, rows=jnp.sum(known))
        return s, _estimate(s.q, s.w, env)

    def predict(self, s: EkfState, wheels: Array, u: Array, env: Any, h: Any) -> EkfState:
        """State and covariance h s later."""
        A = h * self.error_dynamics(s, wheels, u, env)
        F = jnp.eye(9).at[:6, :6].add(A + A @ A / 2)
        accelerate = jnp.asarray(self.torque_noise) * jnp.asarray(self.body.inverse)
        Q = jnp.zeros((9, 9)).at[3:6, 3:6].set(h * accelerate @ accelerate.T)
        Q = Q.at[6:9, 6:9].set(h * jnp.asarray(self.bias_walk) ** 2 * jnp.eye(3))
        q, w = self._propagate(s.q, s.w, wheels, u, env, h)
        return s._replace(q=attitude.normalise(q), w=w, P=F @ s.P @ F.T + Q)

    def error_dynamics(self, s: EkfState, wheels: Array, u: Array, env: Any) -> Array:
        """Jacobian (6, 6) of the rates of (vector part of the error quaternion, error of the rate) at no error.

        The true body turns relative to the estimated one at w + dw - A(error) w, whatever frame O does.
        """

        def rates(e: Array) -> Array:
            error, w = _error_quaternion(e[:3]), s.w + e[3:]
            turn = attitude.kinematics(error, w - attitude.rotate(error, s.w))
            return jnp.concatenate([turn[1:], self._acceleration(attitude.compose(error, s.q), w, wheels, u, env)])

        return jax.jacfwd(rates)(jnp.zeros(6))

    def innovation(
        self, s: EkfState, y: Measurement, env: Any, h: ArrayLike = 1.0
    ) -> tuple[Array, Array, Array, Array]:
        """Innovation z (m,), its Jacobian H (m, 9), variances R (m,), and which rows carry information (m,).

        The gyro is read every h s; what walks by angle only tells nothing before time has passed.
        """
        turn = self.vectors.innovation(s, y, env)
        rate = jnp.hstack([jnp.zeros((3, 3)), jnp.eye(3), jnp.eye(3)])
        read = jnp.where((jnp.asarray(self.gyro_random_walk) > 0) & (jnp.asarray(h) <= 0), 0.0, jnp.ones(3))
        noise = deviation(self.gyro_noise, self.gyro_random_walk, h)
        return (
            jnp.concatenate([turn.z, y.rate - s.w - s.bias]),
            jnp.vstack([jnp.hstack([turn.H, jnp.zeros((turn.z.shape[0], 6))]), rate]),
            jnp.concatenate([turn.R, noise**2 * jnp.ones(3)]),
            jnp.concatenate([turn.known, read]),
        )

    def _propagate(self, q: Array, w: Array, wheels: Array, u: Array, env: Any, h: Any) -> tuple[Array, Array]:
        """Attitude and rate h s later, by the midpoint rule."""

        def rates(q: Array, w: Array) -> tuple[Array, Array]:
            dq = attitude.kinematics(q, w - attitude.rotate(q, env.w_ON))
            return dq, self._acceleration(q, w, wheels, u, env)

        dq, dw = rates(q, w)
        dq, dw = rates(q + 0.5 * h * dq, w + 0.5 * h * dw)
        return q + h * dq, w + h * dw

    def _acceleration(self, q: Array, w: Array, wheels: Array, u: Array, env: Any) -> Array:
        """Angular acceleration (3,) rad/s^2 by the body's own equation."""
        x = BodyState(attitude.compose(q, env.q_ON), w, wheels)
        return jnp.asarray(self.body.derivative(x, u, env).w)


def svd_navigator(suite: AttitudeSuite, *, window: int = 5) -> SvdNavigator:
    """`SvdNavigator` that weights the vectors by the noise of the given sensors."""
    return SvdNavigator(sun_noise=suite.sun.noise, field_noise=suite.magnetometer.noise, window=_checked_window(window))


def ekf(
    body: RigidBody,
    suite: AttitudeSuite,
    *,
    attitude_noise: float | None,
    torque_noise: float,
    bias_walk: float,
    q: Numbers = (1.0, 0.0, 0.0, 0.0),
    w: Numbers = (0.0, 0.0, 0.0),
    bias: Numbers = (0.0, 0.0, 0.0),
    deviation: Numbers = DEVIATION,
    window: int = 5,
) -> Ekf:
    """Extended Kalman filter for a rigid body that is corrected by the solution of Wahba's problem.

    Parameters
    ----------
    body : the model of the spacecraft; leave its disturbances out to have them estimated as unknown torques
    suite : the sensors, of which the filter takes the noise
    torque_noise, bias_walk, q, w, bias, deviation : as of `direct_ekf`
    attitude_noise : () vector part of a quaternion, 1 sigma per axis of the solution of Wahba's problem; None for the
        covariance that the solution has at each sample, which is right for a window of 1
    window : samples of the moving average over the vectors; with more than one, consecutive solutions depend on each
        other, which the filter does not know

    Raises
    ------
    ScenarioError
        As `direct_ekf`.
    """
    solution = None if attitude_noise is None else real("attitude_noise", attitude_noise, low=0)
    vectors = WahbaSolution(sun_noise=suite.sun.noise, field_noise=suite.magnetometer.noise, attitude_noise=solution)
    direct = direct_ekf(
        body, suite, torque_noise=torque_noise, bias_walk=bias_walk, q=q, w=w, bias=bias, deviation=deviation
    )
    return replace(direct, vectors=vectors, window=_checked_window(window))


def direct_ekf(
    body: RigidBody,
    suite: AttitudeSuite,
    *,
    torque_noise: float,
    bias_walk: float,
    q: Numbers = (1.0, 0.0, 0.0, 0.0),
    w: Numbers = (0.0, 0.0, 0.0),
    bias: Numbers = (0.0, 0.0, 0.0),
    deviation: Numbers = DEVIATION,
) -> Ekf:
    """Extended Kalman filter for a rigid body that is corrected by the Sun and field vectors themselves.

    Parameters
    ----------
    body, suite : as of `ekf`
    torque_noise : () N m sqrt(s), root of the spectral density of unknown torques, per axis
    bias_walk : () rad/s/sqrt(s), of the gyro
    q, w, bias : (4,), (3,) rad/s, (3,) rad/s, first guess of q_OB, inertial rate and gyro bias; zero by default
    deviation : (9,) standard deviation of the first guess: vector part of a quaternion, rad/s, rad/s

    Raises
    ------
    ScenarioError
        Wrong shape, NaN, a negative deviation, a quaternion that is not of unit length.
    """
    first = real("q", q, (4,))
    if abs(np.linalg.norm(first) - 1) > 1e-6:
        raise ScenarioError(f"q must be a unit quaternion, got {first.tolist()} of length {np.linalg.norm(first)}")
    return Ekf(
        body=body,
        vectors=VectorsThemselves(sun_noise=suite.sun.noise, field_noise=suite.magnetometer.noise),
        gyro_noise=suite.gyro.noise,
        gyro_random_walk=suite.gyro.random_walk,
        torque_noise=real("torque_noise", torque_noise, low=0),
        bias_walk=real("bias_walk", bias_walk, low=0),
        q=first,
        w=real("w", w, (3,)),
        bias=real("bias", bias, (3,)),
        deviation=real("deviation", deviation, (9,), low=0),
    )


class EkfRecord(NamedTuple):
    """What `ekf_record` keeps of a sample."""

    error: (
        Array  # (9,) of the states in units of what the filter believes: independent, of variance one; attitude first
    )
    nis: Array  # ()
    rows: Array  # ()


def ekf_record(x: BodyState, env: Any, sensors: Array, navigator: EkfState) -> EkfRecord:
    """For ``simulate(..., record=ekf_record)``: how large the errors of an `Ekf` are beside what it believes of them.

    The error is L^-1 e with L L' = P, so that the squares of the first three sum up to the NEES of the attitude, of all
    nine to that of the states.
    """
    turn = attitude.compose(attitude.compose(x.q, attitude.conjugate(env.q_ON)), attitude.conjugate(navigator.q))
    e = jnp.concatenate([attitude.positive(turn)[1:], x.w - navigator.w, sensors - navigator.bias])
    white = jax.scipy.linalg.solve_triangular(jnp.linalg.cholesky(navigator.P), e, lower=True)
    return EkfRecord(white, navigator.nis, navigator.rows)


def _checked_window(window: int) -> int:
    """The window, or ScenarioError."""
    if not isinstance(window, int) or window < 1:
        raise ScenarioError(f"window = {window!r}: give a whole number of samples, at least 1")
    return window


def _no_measurements(window: int) -> Smoothing:
    """An empty moving average."""
    return Smoothing(jnp.zeros((window, 3)), jnp.zeros((window, 3)))


def _in_orbital_frame(env: Any) -> tuple[Array, Array]:
    """Direction to the Sun and field (T) in frame O."""
    return attitude.rotate(env.q_ON, env.sun), attitude.rotate(env.q_ON, env.B)


def _estimate(q: Array, w: Array, env: Any) -> Array:
    """The estimate (6,) from q_OB and the inertial rate in body axes. Equation 4."""
    return jnp.concatenate([attitude.positive(q)[1:], w - attitude.rotate(q, env.w_ON)])


def _error_quaternion(a: Array) -> Array:
    """The quaternion whose vector part is a (3,); half a turn at most."""
    square = attitude.dot(a, a)
    scalar = jnp.sqrt(jnp.where(square < 1, 1 - square, 0.0))
    return attitude.normalise(jnp.concatenate([scalar[None], a]))
