"""Balanced truncation: a stable system without the states that hardly matter, and what leaving them out costs.

In coordinates in which both Gramians are diagonal and equal (the Hankel singular values), states that are hardly
reached or hardly seen come last. Without them the response differs by at most twice the sum of their values.

References: Moore (1981), IEEE TAC 26, 17; Al-Saggaf and Franklin (1987), IEEE TAC 32, 687 (the bound, in discrete
time); Smith (1968), SIAM J. Applied Mathematics 16, 198 (doubling).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.systems.sampled import cayley, pole_rate
from synth.systems.statespace import StateSpace

MAX_DOUBLINGS = 64  # 2^64 samples: no stable double is slower
SETTLED = 1e-17  # norm of a power of A that adds nothing any more


class Balancing(NamedTuple):
    """Factors of two Gramians and the singular values of their product, the Hankel singular values."""

    reached: np.ndarray  # (n, r) L with L L' = reachability Gramian
    seen: np.ndarray  # (n, q) M with M M' = observability Gramian
    U: np.ndarray  # (q, q) of the singular value decomposition of M'L
    sigma: np.ndarray  # (min(n, q, r)) largest first
    Vt: np.ndarray  # (r, r)

    @classmethod
    def of(cls, reached: np.ndarray, seen: np.ndarray) -> Balancing:
        """From the two factors, which may have more columns than there are states."""
        U, sigma, Vt = np.linalg.svd(seen.T @ reached)
        return cls(reached, seen, U, sigma[: len(reached)], Vt)

    def projection(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """T (n, k) and Ti (k, n) with Ti T = I on the first k balanced states, x = T x_new.

        Nothing is inverted but singular values that are kept (Tombs and Postlethwaite 1987, Int. J. Control 46, 1319).
        """
        root = np.sqrt(self.sigma[:k])
        return self.reached @ self.Vt[:k].T / root, (self.seen @ self.U[:, :k] / root).T


def gramian_factors(G: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """L and M, (n, <= n), with L L' and M M' the Gramians of a stable system; the Cayley map keeps both."""
    if not G.n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    H = G if G.discrete else cayley(G, pole_rate(G.poles()))
    A, Z = sla.schur(H.A, output="real")[:2]
    return Z @ gramian_factor(A, Z.T @ H.B), Z @ gramian_factor(A.T, Z.T @ H.C.T)


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
    balancing = Balancing.of(reached, seen)
    tails = bounds(balancing.sigma)
    k = int(np.argmax(tails <= error))
    T, Ti = balancing.projection(k)
    return StateSpace(Ti @ A @ T, Ti @ B, C @ T, G.D, G.dt), float(tails[k])


def bounds(sigma: np.ndarray) -> np.ndarray:
    """Twice the sum of the values left out, (len(sigma) + 1), when 0, 1, ... are kept."""
    return 2 * np.append(np.cumsum(sigma[::-1])[::-1], 0.0)


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
