"""Tables of cubic splines over time: built by NumPy and SciPy, evaluated inside the compiled loop."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.interpolate import CubicSpline

from plants.checks import Numbers


def splines(columns: np.ndarray) -> np.ndarray:
    """Cubics between the points of a uniform table (..., n, k): (..., n - 1, 4, k), lowest power first.

    The variable of a cubic runs from 0 to 1 in its interval; n is at least 4.
    """
    powers = CubicSpline(np.arange(columns.shape[-2]), columns, axis=-2).c[::-1]
    return np.moveaxis(powers, (0, 1), (-2, -3))


def piece(table: Numbers, step: float, duration: float, t: ArrayLike) -> tuple[Array, Array]:
    """Where t () s lies in a table of cubics (n, 4, k): s () in [0, 1] of its interval, whose cubic is c (4, k).

    Outside [0, duration] s is NaN, so that all that follows is.
    """
    table, t = jnp.asarray(table), jnp.asarray(t)
    place = t / step
    i = jnp.clip(jnp.floor(place).astype(int), 0, table.shape[0] - 1)
    known = (t >= 0) & (t <= duration * (1 + 1e-12))
    return jnp.where(known, place - i, jnp.nan), table[i]


def value(s: Array, c: Array) -> Array:
    """Value (k,) of the cubic c (4, k) at s ()."""
    return c[0] + s * (c[1] + s * (c[2] + s * c[3]))


def slope(s: Array, c: Array) -> Array:
    """Derivative (k,) by s of the cubic c (4, k) at s ()."""
    return c[1] + s * (2 * c[2] + s * 3 * c[3])
