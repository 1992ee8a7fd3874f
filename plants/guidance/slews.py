"""From one attitude to a commanded frame: about the eigenaxis, within a rate and an acceleration, without a bump.

At the start of a slew the commanded attitude and rate are those that the body has; in the end they are those of the
frame R that is to be reached, which may move meanwhile. Between them lies the rotation exp(p(tau)) that turns R into
the commanded frame, with two parts of p after each other:

    p = p0 + v0 tau (1 - tau / T0)^2       for T0: the relative rate v0 is brought to zero
    p = p0 (1 - s(tau - T0))               about the eigenaxis p0: acceleration, coast, deceleration

Both keep the limit of the acceleration, the second that of the rate as well. See Wie (2008), Space Vehicle Dynamics and
Control, section 7.3, for eigenaxis slews.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.geometry import attitude
from plants.guidance.frames import moving


class Path(NamedTuple):
    """A slew that has begun: where it began relative to the frame that is to be reached, and how fast it may go."""

    turn: Any  # (3,) rad, rotation from R to the attitude at the start
    rate: Any  # (3,) rad/s, of the body relative to R at the start, body axes
    max_rate: Any  # () rad/s
    max_acceleration: Any  # () rad/s^2


def path_from(
    q: ArrayLike, w: ArrayLike, frame: tuple[Array, Array], max_rate: ArrayLike, max_acceleration: ArrayLike
) -> Path:
    """The slew from attitude q_BN (4,) and inertial rate w (3,) rad/s to the frame (q_RN, w_R) of the same time."""
    off = attitude.compose(q, attitude.conjugate(frame[0]))
    relative = jnp.asarray(w) - attitude.rotate(off, frame[1])
    turn = attitude.to_vector(off)
    # the derivative of `turn` is the rate only along it; exp is inverted to first order in the rate
    slope = jax.jacfwd(lambda p: moving(attitude.from_vector, (turn, p))[1])(jnp.zeros(3))
    return Path(turn, jnp.linalg.solve(slope, relative), jnp.asarray(max_rate), jnp.asarray(max_acceleration))


def duration(path: Path) -> Array:
    """How long the slew takes, () s."""
    return _matching(path) + _times(path)[2]


def commanded(path: Path, tau: ArrayLike, frame: tuple[Array, Array]) -> tuple[Array, Array]:
    """Commanded attitude (4,) and inertial rate (3,) rad/s, tau () s after the start, when R is `frame`."""
    tau, q, w = jnp.asarray(tau), *frame
    T0 = _matching(path)
    early = jnp.clip(tau, 0.0, T0) / jnp.where(T0 > 0, T0, 1.0)
    s, ds = _progress(path, tau - T0)
    p = path.turn * (1 - s) + path.rate * T0 * early * (1 - early) ** 2
    dp = -path.turn * ds + jnp.where(tau < T0, 1.0, 0.0) * path.rate * (1 - early) * (1 - 3 * early)
    off, relative = moving(attitude.from_vector, (p, dp))
    return attitude.compose(off, q), relative + attitude.rotate(off, w)


def _matching(path: Path) -> Array:
    """T0 () s: the steepest change of v0 tau (1 - tau / T0)^2 is 4 v0 / T0."""
    return 4 * _length(path.rate) / path.max_acceleration


def _times(path: Path) -> tuple[Array, Array, Array]:
    """Ends of acceleration, coast and deceleration, () s each, for the angle at rest to rest."""
    angle = _length(path.turn)
    peak = jnp.minimum(path.max_rate, jnp.sqrt(angle * path.max_acceleration))
    ramp = peak / path.max_acceleration
    coast = jnp.where(peak > 0, angle / jnp.where(peak > 0, peak, 1.0) - ramp, 0.0)
    return ramp, ramp + coast, 2 * ramp + coast


def _progress(path: Path, tau: Array) -> tuple[Array, Array]:
    """Part of the angle that is done, () from 0 to 1, and its derivative, () 1/s."""
    angle, a = _length(path.turn), path.max_acceleration
    one, two, end = _times(path)
    peak = a * one
    left = jnp.clip(end - tau, 0.0, end)
    done = jnp.where(
        tau < one, 0.5 * a * tau**2, jnp.where(tau < two, peak * (tau - 0.5 * one), angle - 0.5 * a * left**2)
    )
    rate = jnp.where(tau < one, a * tau, jnp.where(tau < two, peak, a * left))
    some = angle > 0
    whole = jnp.where(some, angle, 1.0)
    under_way = (tau > 0) & (tau < end) & some
    return (
        jnp.where(under_way, done / whole, jnp.where((tau >= end) | ~some, 1.0, 0.0)),
        jnp.where(under_way, rate / whole, 0.0),
    )


def _length(v: Array) -> Array:
    """Length of a vector, with a slope of zero at zero."""
    square = attitude.dot(v, v)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
