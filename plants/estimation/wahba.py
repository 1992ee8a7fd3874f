"""Wahba's problem: the attitude that fits two or more directions best, and its covariance.

Minimise sum w_i |b_i - A r_i|^2 over rotations A. References: Markley and Crassidis (2014), chapter 5; Markley (2002),
Fast quaternion attitude estimation from two vector measurements; Shuster and Oh (1981), Three-axis attitude
determination from vector observations, for the covariance.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.checks import real
from plants.geometry import attitude

PARALLEL = 1e-6  # () sine of the angle between two directions below which they fix no attitude


def wahba_svd(body: ArrayLike, reference: ArrayLike, weights: ArrayLike) -> Array:
    """Least-squares attitude from n >= 2 directions, by singular value decomposition.

    Markley and Crassidis (2014), eq. 5.21 to 5.26.

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
    b, r, a = direction(body), direction(reference), jnp.asarray(weights)
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


def wahba_covariance(directions: ArrayLike, deviations: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Covariance (3, 3) rad^2 of the optimal attitude's error, a small rotation about the axes of the body.

    F^-1 [sum w_i^2 s_i^2 (I - b_i b_i')] F^-1 with F = sum w_i (I - b_i b_i'), to first order, which for the best
    weights 1 / s_i^2 is F^-1 (Shuster and Oh 1981, eq. 99). Vector parts of quaternions have a quarter of it.

    Parameters
    ----------
    directions : (n, 3) of any length, body axes, not all parallel: else infinite or not a number
    deviations : (n,) rad, 1 sigma per axis
    weights : (n,) positive; the inverse variances if absent

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, negative deviations or weights.
    """
    given = real("directions", directions, (None, 3))
    sigma = real("deviations", deviations, given.shape[:1], low=0)
    b, variance = direction(given), jnp.asarray(sigma) ** 2
    w = 1 / variance if weights is None else jnp.asarray(real("weights", weights, given.shape[:1], low=0))
    across = jnp.eye(3) - b[:, :, None] * b[:, None, :]
    inverse = jnp.linalg.inv(jnp.sum(w[:, None, None] * across, axis=0))
    return inverse @ jnp.sum((w**2 * variance)[:, None, None] * across, axis=0) @ inverse


def direction(v: ArrayLike) -> Array:
    """Unit vectors along the last axis; a zero stays zero."""
    v = jnp.asarray(v)
    length = _length(v)[..., None]
    return v / jnp.where(length > 0, length, 1.0)


def _length(v: Array) -> Array:
    """Length along the last axis, with a gradient of zero at zero."""
    square = attitude.dot(v, v)
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0)
