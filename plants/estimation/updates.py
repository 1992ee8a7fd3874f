"""Corrections of a Kalman filter by independent scalars, one after the other."""

import jax.numpy as jnp
from jax import Array


def scalar_updates(P: Array, z: Array, H: Array, R: Array, known: Array) -> tuple[Array, Array]:
    """Kalman correction by m independent scalar measurements: `tested_updates` without the test."""
    e, P, _ = tested_updates(P, z, H, R, known)
    return e, P


def tested_updates(P: Array, z: Array, H: Array, R: Array, known: Array) -> tuple[Array, Array, Array]:
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
    nis : () normalised innovation squared z' (H P H' + R)^-1 z of the valid rows
    """
    e, nis = jnp.zeros(P.shape[0]), jnp.zeros(())
    for i in range(H.shape[0]):
        h = H[i]
        p = jnp.sum(P * h, axis=1)  # a sum of products compiles to half the time of P @ h
        s = jnp.sum(h * p) + R[i]
        g = known[i] * p / s
        left = z[i] - jnp.sum(h * e)
        nis = nis + known[i] * left**2 / s
        e = e + g * left
        gp = g[:, None] * p[None]
        P = P - gp - gp.T + s * g[:, None] * g[None]
    return e, P, nis
