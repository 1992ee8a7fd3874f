"""Balanced truncation: a stable system without the states that hardly matter, and what leaving them out costs.

In coordinates in which both Gramians are diagonal and equal (the Hankel singular values), states that are hardly
reached or hardly seen come last. Without them the response differs by at most twice the sum of their values.

References: Moore (1981), IEEE TAC 26, 17; Al-Saggaf and Franklin (1987), IEEE TAC 32, 687 (the bound, in discrete
time); Smith (1968), SIAM J. Applied Mathematics 16, 198 (doubling).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from synth.systems.statespace import StateSpace

MAX_DOUBLINGS = 64  # 2^64 samples: no stable double is slower
SETTLED = 1e-17  # norm of a power of A that adds nothing any more


def balanced_truncation(G: StateSpace, error: float) -> tuple[StateSpace, float]:
    """The stable discrete system with the fewest states within `error` (absolute, H-infinity), and the error it has.

    Nothing is inverted: the transformation is made of factors of the Gramians, so that states that are not reached
    or not seen at all do no harm.
    """
    A, Z = sla.schur(G.A, output="real")[:2]  # whose powers are triangular, so that no rounding makes them grow
    B, C = Z.T @ G.B, G.C @ Z
    reached, seen = gramian_factor(A, B), gramian_factor(A.T, C.T)
    if not (np.isfinite(reached).all() and np.isfinite(seen).all()):  # so near the boundary that rounding crosses it
        return G, 0.0
    U, sigma, Vt = np.linalg.svd(seen.T @ reached)
    tails = 2 * np.append(np.cumsum(sigma[::-1])[::-1], 0.0)  # of what is left out when k are kept
    k = int(np.argmax(tails <= error))
    root = np.sqrt(sigma[:k])
    T, Ti = reached @ Vt[:k].T / root, (seen @ U[:, :k] / root).T
    return StateSpace(Ti @ A @ T, Ti @ B, C @ T, G.D, G.dt), float(tails[k])


def rounding(G: StateSpace) -> float:
    """What rounding alone may leave of the H-infinity norm of a stable discrete system in which everything cancels."""
    A, Z = sla.schur(G.A, output="real")[:2]
    reached, seen = gramian_factor(A, Z.T @ G.B), gramian_factor(A.T, Z.T @ G.C.T)
    if not (np.isfinite(reached).all() and np.isfinite(seen).all()):
        return np.inf
    largest = np.linalg.norm(reached, 2) * np.linalg.norm(seen, 2) + np.linalg.norm(G.D, 2)
    return float(2 * max(G.n, 1) * np.finfo(float).eps * largest)


def gramian_factor(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """L with L L' = sum of A^k B B' A'^k, at most as wide as A; not finite where the sum is not."""
    L = B
    with np.errstate(all="ignore"):
        for _ in range(MAX_DOUBLINGS):
            L = np.hstack([L, A @ L])
            if L.shape[1] > len(A):
                L = np.asarray(np.linalg.qr(L.T, mode="r")).T
            A = A @ A
            if not np.linalg.norm(A) > SETTLED:
                break
    return L
