"""Attitude determination: smoothing filter, Wahba's problem, and an extended Kalman filter.

References: Markley and Crassidis (2014), Fundamentals of Spacecraft Attitude Determination and Control,
chapters 5 and 6; Markley (2002), Fast quaternion attitude estimation from two vector measurements;
Pecorilla and Stesina (2024), section 2.2, whose eq. 8 are the nine states of the filter.

Frame O is the frame of reference (orbital, see `plants.surroundings.environment`), B the body. Every navigator returns
the estimate [vector part of q_OB with scalar part >= 0; w_OB in body axes (rad/s)], (6,).
"""

from dataclasses import dataclass, field
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
from plants.geometry import attitude
from plants.hardware.sensors import AttitudeSuite, Measurement

PARALLEL = 1e-6  # () sine of the angle between two directions below which they fix no attitude


def wahba_svd(body: ArrayLike, reference: ArrayLike, weights: ArrayLike) -> Array:
    """Least-squares attitude from n >= 2 directions, by singular value decomposition.

    Minimises sum w_i |b_i - A r_i|^2 over rotations A. Markley and Crassidis (2014), eq. 5.21 to 5.26.

    Parameters
    ----------
    body, reference : (n, 3) directions in the two frames
    weights : (n,) positive, such as inverse variances

    Returns
    -------
    Array
        (3, 3) direction cosine matrix, from the frame of reference to the body.
    """
    b, r, w = jnp.asarray(body), jnp.asarray(reference), jnp.asarray(weights)
    U, _, Vt = jnp.linalg.svd((w[:, None] * b).T @ r)
    last = jnp.linalg.det(U) * jnp.linalg.det(Vt)
    return (U * jnp.array([1.0, 1.0, 0.0]) + U * jnp.array([0.0, 0.0, 1.0]) * last) @ Vt


def wahba_pair(body: ArrayLike, reference: ArrayLike, weights: ArrayLike) -> tuple[Array, Array]:
    """Least-squares attitude from two directions in closed form: the same optimum as `wahba_svd`.

    Markley (2002): the optimal rotation turns r1 x r2 into b1 x b2 exactly, and blends the two triads with
    a_i / lambda, lambda^2 = a1^2 + a2^2 + 2 a1 a2 [(b1.b2)(r1.r2) + |b1 x b2| |r1 x r2|].

    Parameters
    ----------
    body, reference : (2, 3) directions of any length in the two frames
    weights : (2,) positive

    Returns
    -------
    matrix : (3, 3) from the frame of reference to the body, finite in any case
    determined : () bool, False where a vector is zero or the two are parallel: the matrix then means nothing
    """
    b, r, a = _unit(body), _unit(reference), jnp.asarray(weights)
    b3, r3 = attitude.cross(b[0], b[1]), attitude.cross(r[0], r[1])
    sine_b, sine_r = _length(b3), _length(r3)
    determined = (sine_b > PARALLEL) & (sine_r > PARALLEL)
    b3, r3 = b3 / jnp.where(determined, sine_b, 1.0), r3 / jnp.where(determined, sine_r, 1.0)
    cosines = attitude.dot(b[0], b[1]) * attitude.dot(r[0], r[1]) + sine_b * sine_r
    scale = a / jnp.sqrt(a[0] ** 2 + a[1] ** 2 + 2 * a[0] * a[1] * cosines)
    across_b, across_r = attitude.cross(b, b3), attitude.cross(r, r3)
    A = scale[0] * (jnp.outer(b[0], r[0]) + jnp.outer(across_b[0], across_r[0]))
    A += scale[1] * (jnp.outer(b[1], r[1]) + jnp.outer(across_b[1], across_r[1]))
    return A + jnp.outer(b3, r3), determined


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


class EkfState(NamedTuple):
    """State of `Ekf`: eq. 8 with the quaternion whole."""

    smoothing: Smoothing
    q: Array  # (4,) q_OB
    w: Array  # (3,) rad/s, inertial rate of the body
    bias: Array  # (3,) rad/s, of the gyro
    P: Array  # (9, 9) covariance of (vector part of the error quaternion, rate, bias)


@dataclass(frozen=True, kw_only=True)
class Ekf:
    """Extended Kalman filter for attitude, rate and gyro bias; build it with `ekf`.

    The states are those of eq. 8. The quaternion is carried whole and corrected by multiplication, and P is the
    covariance of the vector part of the error quaternion (half angles): near nadir this is eq. 8 to first order,
    and it has neither a sign to choose nor a singularity at large angles (Markley and Crassidis, section 6.2).
    The rate is propagated by Euler's equation with the measured wheel speeds and the torques that acted. All
    Jacobians are derived by `jax.jacfwd`.

    Attitude enters as the vector solution of Wahba's problem (the scheme of the reference; nothing in eclipse),
    or, with `direct`, as the Sun and field vectors themselves, of which the field remains in eclipse.
    """

    body: RigidBody  # what the filter believes of the spacecraft; its disturbances, if any, are predicted too
    sun_noise: ArrayLike  # () rad
    field_noise: ArrayLike  # () T
    gyro_noise: ArrayLike  # () rad/s
    attitude_noise: ArrayLike  # () vector part of a quaternion, of the solution of Wahba's problem
    torque_noise: ArrayLike  # () N m sqrt(s), root of the spectral density of unknown torques
    bias_walk: ArrayLike  # () rad/s/sqrt(s)
    q: ArrayLike  # (4,) first guess of q_OB
    w: ArrayLike  # (3,) rad/s, first guess
    bias: ArrayLike  # (3,) rad/s, first guess
    deviation: ArrayLike  # (9,) of the first guess, as the diagonal of P^1/2
    window: int = 5  # samples of the moving average
    direct: bool = field(default=False, metadata={"static": True})

    def init(self) -> EkfState:
        """The first guess."""
        P = jnp.diag(jnp.asarray(self.deviation) ** 2)
        q, w, bias = (jnp.asarray(a) for a in (self.q, self.w, self.bias))
        return EkfState(_no_measurements(self.window), q, w, bias, P)

    def update(self, s: EkfState, y: Measurement, u: Any, env: Any, h: Any) -> tuple[EkfState, Array]:
        """Predict over the h s during which u acted, then correct by the measurement: new state, estimate (6,)."""
        s = self.predict(s, y.wheels, u, env, h)._replace(smoothing=smooth(s.smoothing, y))
        # the barrier keeps XLA from predicting again in every one of the scalar updates
        P, z, H, R, known = jax.lax.optimization_barrier((s.P, *self.innovation(s, y, env)))
        e, P = scalar_updates(P, z, H, R, known)
        q = attitude.normalise(attitude.compose(_error_quaternion(e[:3]), s.q))
        s = s._replace(q=q, w=s.w + e[3:6], bias=s.bias + e[6:9], P=P)
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

    def innovation(self, s: EkfState, y: Measurement, env: Any) -> tuple[Array, Array, Array, Array]:
        """Innovation z (m,), its Jacobian H (m, 9), variances R (m,), and which rows carry information (m,)."""
        rate = jnp.hstack([jnp.zeros((3, 3)), jnp.eye(3), jnp.eye(3)])
        ones = jnp.ones(3)
        if self.direct:
            sun, B = (attitude.rotate(s.q, v) for v in _in_orbital_frame(env))

            def expected(a: Array) -> Array:
                q = _error_quaternion(a)
                return jnp.concatenate([attitude.rotate(q, sun), attitude.rotate(q, B)])

            turn = jax.jacfwd(expected)(jnp.zeros(3))
            z = jnp.concatenate([y.sun - sun, y.field - B])
            H = jnp.hstack([turn, jnp.zeros((6, 6))])
            R = jnp.concatenate([self.sun_noise**2 * ones, self.field_noise**2 * ones])
            known = jnp.concatenate([y.sun_seen * ones, ones])
        else:
            q, determined = vector_attitude(s.smoothing, self.sun_noise, self.field_noise, env)
            z = attitude.positive(attitude.compose(q, attitude.conjugate(s.q)))[1:]
            H, R = jnp.eye(3, 9), self.attitude_noise**2 * ones
            known = determined * y.sun_seen * ones
        return (
            jnp.concatenate([z, y.rate - s.w - s.bias]),
            jnp.vstack([H, rate]),
            jnp.concatenate([R, self.gyro_noise**2 * ones]),
            jnp.concatenate([known, ones]),
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


def scalar_updates(P: Array, z: Array, H: Array, R: Array, known: Array) -> tuple[Array, Array]:
    """Kalman correction by m independent scalar measurements, one after the other.

    Equal to the batch update with diagonal R. The covariance is updated by P - g p' - p g' + s g g' with p = P h
    and s = h'p + r, which holds for every gain g: so "no information" is g = 0.

    Parameters
    ----------
    P : (n, n) covariance
    z, R, known : (m,) innovations at the prediction, variances, 1 for a valid row and 0 for none
    H : (m, n)

    Returns
    -------
    e : (n,) correction
    P : (n, n)
    """
    e = jnp.zeros(P.shape[0])
    for i in range(H.shape[0]):
        h = H[i]
        p = jnp.sum(P * h, axis=1)  # a sum of products compiles to half the time of P @ h
        s = jnp.sum(h * p) + R[i]
        g = known[i] * p / s
        e = e + g * (z[i] - jnp.sum(h * e))
        gp = g[:, None] * p[None]
        P = P - gp - gp.T + s * g[:, None] * g[None]
    return e, P


def svd_navigator(suite: AttitudeSuite, *, window: int = 5) -> SvdNavigator:
    """`SvdNavigator` that weights the vectors by the noise of the given sensors."""
    return SvdNavigator(sun_noise=suite.sun.noise, field_noise=suite.magnetometer.noise, window=_checked_window(window))


def ekf(
    body: RigidBody,
    suite: AttitudeSuite,
    *,
    attitude_noise: float,
    torque_noise: float,
    bias_walk: float,
    q: Numbers = (1.0, 0.0, 0.0, 0.0),
    w: Numbers = (0.0, 0.0, 0.0),
    bias: Numbers = (0.0, 0.0, 0.0),
    deviation: Numbers = (0.3, 0.3, 0.3, 1e-2, 1e-2, 1e-2, 1e-3, 1e-3, 1e-3),
    window: int = 5,
    direct: bool = False,
) -> Ekf:
    """Extended Kalman filter for a rigid body with the given sensors; the first guess is zero by default.

    Parameters
    ----------
    body : the model of the spacecraft; leave its disturbances out to have them estimated as unknown torques
    suite : the sensors, of which the filter takes the noise
    attitude_noise : () vector part of a quaternion, 1 sigma per axis of the solution of Wahba's problem
    torque_noise : () N m sqrt(s), root of the spectral density of unknown torques, per axis
    bias_walk : () rad/s/sqrt(s), of the gyro
    q, w, bias : (4,), (3,) rad/s, (3,) rad/s, first guess of q_OB, inertial rate and gyro bias
    deviation : (9,) standard deviation of the first guess: vector part of a quaternion, rad/s, rad/s
    window : samples of the moving average over the vectors; not used by `direct`
    direct : correct by the Sun and field vectors themselves instead of the solution of Wahba's problem

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
        sun_noise=suite.sun.noise,
        field_noise=suite.magnetometer.noise,
        gyro_noise=suite.gyro.noise,
        attitude_noise=real("attitude_noise", attitude_noise, low=0),
        torque_noise=real("torque_noise", torque_noise, low=0),
        bias_walk=real("bias_walk", bias_walk, low=0),
        q=first,
        w=real("w", w, (3,)),
        bias=real("bias", bias, (3,)),
        deviation=real("deviation", deviation, (9,), low=0),
        window=_checked_window(window),
        direct=direct,
    )


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


def _length(v: Array) -> Array:
    """Length along the last axis, with a gradient of zero at zero."""
    square = attitude.dot(v, v)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)


def _unit(v: ArrayLike) -> Array:
    """Unit vectors along the last axis; a zero stays zero."""
    v = jnp.asarray(v)
    length = _length(v)[..., None]
    return v / jnp.where(length > 0, length, 1.0)
