"""How several devices share a torque: linear maps from the torque to the devices, made once.

The least largest and the least total share are linear programs in the torque. The optimum of such a program is one of
its basic solutions, each a linear map of the torque, so these maps are listed once and the best is taken at every call:
exact, traceable, without a solver.
"""

from itertools import combinations, product

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.optimize import nnls

from plants.errors import ScenarioError

MOST = 2000  # maps in a list
ROUNDING = 1e-9  # () relative, of shares that are the same
SINGULAR = 1e-9  # () of the least to the largest singular value, below which a basis is none


def least_squares(effects: np.ndarray) -> np.ndarray:
    """The one map (1, n, 3) whose shares v have the least sum of squares; effects (3, n) @ v is the torque."""
    return np.linalg.pinv(effects)[None]


def least_largest(effects: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Maps (k, n, 3) of which, for any torque, one has the least largest |v_i| / limit_i: the minimax distribution.

    At the optimum n - 2 devices work at the same part of their limits (Markley et al. 2010, doi 10.2514/1.47188).

    Raises
    ------
    ScenarioError
        More devices than can be listed.
    """
    n = effects.shape[1]
    free = n - 3  # degrees of freedom that the torque leaves
    scaled = effects * limits
    maps = []
    _check_number(n, len(list(combinations(range(n), free + 1))) * 2**free)
    for equal in combinations(range(n), free + 1):
        for signs in product((1.0, -1.0), repeat=free):
            system = np.zeros((n + 1, n + 1))  # of [v / limits; their common size]
            system[:3, :n] = scaled
            for row, (device, sign) in enumerate(zip(equal, (1.0, *signs), strict=True), start=3):
                system[row, device], system[row, n] = 1.0, -sign
            if _regular(system / np.maximum(np.linalg.norm(system, axis=1, keepdims=True), 1e-300)):
                maps.append(np.linalg.solve(system, np.eye(n + 1)[:, :3])[:n] * limits[:, None])
    return np.array(maps)


def least_total(effects: np.ndarray) -> np.ndarray:
    """Maps (k, n, 3) of which, for any torque, one has no negative share and the least total: three devices work.

    Raises
    ------
    ScenarioError
        More devices than can be listed, or some torque that no shares without sign give.
    """
    n = effects.shape[1]
    balanced = n > 3 and nnls(effects, -effects.sum(axis=1))[1] < 1e-9 * np.abs(effects).max()
    if np.linalg.matrix_rank(effects) < 3 or not balanced:
        raise ScenarioError(
            f"torques of the thrusters {effects.T.tolist()} N m do not add up to a torque about every axis in both "
            "senses: move them, or give more"
        )
    _check_number(n, len(list(combinations(range(n), 3))))
    maps = []
    for few in combinations(range(n), 3):
        basis = effects[:, few]
        if _regular(basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-300)):
            share = np.zeros((n, 3))
            share[list(few)] = np.linalg.inv(basis)
            maps.append(share)
    return np.array(maps)


def smallest(maps: ArrayLike, torque: ArrayLike, limits: ArrayLike) -> Array:
    """Shares (n,) of a torque (3,) by the map with the least largest |share| / limit."""
    shares = jnp.asarray(maps) @ torque
    if shares.shape[0] == 1:
        return shares[0]
    return shares[jnp.argmin(jnp.max(jnp.abs(shares) / limits, axis=1))]


def cheapest(maps: ArrayLike, torque: ArrayLike) -> Array:
    """Shares (n,) >= 0 of a torque (3,) of least total: the mean of the maps that have it, so that couples work."""
    shares = jnp.asarray(maps) @ torque
    size = jnp.max(jnp.abs(shares), axis=1)
    total = jnp.where(jnp.min(shares, axis=1) >= -ROUNDING * size, jnp.sum(shares, axis=1), jnp.inf)
    best = jnp.where(total <= jnp.min(total) * (1 + ROUNDING), 1.0, 0.0)
    return jnp.maximum(best @ shares / jnp.sum(best), 0.0)


def _regular(matrix: np.ndarray) -> bool:
    values = np.linalg.svd(matrix, compute_uv=False)
    return bool(values[-1] > SINGULAR * values[0])


def _check_number(n: int, count: int) -> None:
    if count > MOST:
        raise ScenarioError(f"{n} devices share a torque in {count} ways, more than {MOST}: give fewer")
