"""Barriers of specifications: smooth functions of a closed loop that grow without bound where a norm reaches one.

Every function takes a system and returns the value, inf where the norm is not below one or the system not stable, and
the derivative by [A B; C D]. They lead descents over controllers; nothing here judges.

References: Mustafa and Glover (1990), Minimum Entropy H-infinity Control (the barrier of the H-infinity norm, the
mean of -log det(I - G* G) over the circle); Rautert and Sachs (1997), SIAM J. Optimization 7, 1079 (derivatives by two
Gramians).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from synth.analysis.norms import is_stable
from synth.equations.doubling import CONVERGED, MAX_STEPS, bounded_real
from synth.systems.sampled import cayley
from synth.systems.statespace import StateSpace

TAIL = 1e-10  # of a response: what is less is left away
SAMPLES = 5000  # of a response at most
Sloped = tuple[float, np.ndarray]


def entropy(G: StateSpace, rate: float = 1.0) -> Sloped:
    """Of the H-infinity norm: -log det(R), R = I - D'D - B'X B, where X solves the bounded-real equation.

    In continuous time that of the system which the Cayley map makes of it: the frequencies about `rate` (rad/s) count.
    """
    if not is_stable(G):
        return _outside(G)
    H = G if G.dt else cayley(G, rate)
    A, B, C, D = H.matrices
    X = bounded_real(H, 1.0, stable=True)
    if X is None:
        return _outside(G)
    XB = X @ B
    R = np.eye(G.nu) - D.T @ D - B.T @ XB
    sign, logdet = np.linalg.slogdet(R)
    if sign <= 0:
        return _outside(G)
    F = np.linalg.solve(R, XB.T @ A + D.T @ C)
    IF = np.vstack([np.eye(G.n), F])
    BR = np.linalg.solve(R, B.T).T
    W = gramian(A + B @ F, B @ BR.T, H.dt)
    XM = np.vstack([X @ np.hstack([A, B]), np.hstack([C, D])])
    found = 2 * XM @ IF @ W @ IF.T
    found[:, G.n :] += 2 * np.linalg.solve(R, XM[:, G.n :].T).T
    if G.dt:
        return -float(logdet), found
    E, root = np.linalg.inv(rate * np.eye(G.n) - G.A), np.sqrt(2 * rate)
    left = np.block([[root * E, np.zeros((G.n, G.ny))], [G.C @ E, np.eye(G.ny)]])
    right = np.block([[root * E, E @ G.B], [np.zeros((G.nu, G.n)), np.eye(G.nu)]])
    return -float(logdet), left.T @ found @ right.T


def covariance(G: StateSpace, *, trace: bool) -> Sloped:
    """Of the H2 norm -log(1 - trace V), V = C W C' + D D' the covariance of z; -log det(I - V) of the generalised."""
    if not is_stable(G):
        return _outside(G)
    W = gramian(G.A, G.B @ G.B.T, G.dt)
    V = G.C @ W @ G.C.T + G.D @ G.D.T
    room = np.eye(G.ny) - V
    if trace:
        left = 1 - np.trace(V)
        if not left > 0:
            return _outside(G)
        value, weight = -np.log(left), np.eye(G.ny) / left
    else:
        values, vectors = np.linalg.eigh(room)
        if not values[0] > 0:
            return _outside(G)
        value, weight = -float(np.log(values).sum()), (vectors / values) @ vectors.T
    Z = gramian(G.A.T, G.C.T @ weight @ G.C, G.dt)
    by_states = Z @ np.hstack([G.A @ W if G.dt else W, G.B])
    return float(value), 2 * np.vstack([by_states, weight @ np.hstack([G.C @ W, G.D])])


def peak(G: StateSpace) -> Sloped:
    """Of the peak gain of a discrete system, -log(1 - the largest sum of |h| of an output), which has kinks."""
    radius = float(np.abs(np.linalg.eigvals(G.A)).max(initial=0.0))
    if not radius < 1:
        return _outside(G)
    samples = int(min(max(np.log(TAIL) / np.log(max(radius, 1e-3)), 2), SAMPLES))
    x = np.empty((samples, G.n, G.nu))  # A^k B
    x[0] = G.B
    for k in range(1, samples):
        x[k] = G.A @ x[k - 1]
    h = np.concatenate([G.D[None], G.C @ x])
    sums = np.abs(h).sum(axis=(0, 2))
    worst = int(np.argmax(sums)) if len(sums) else 0
    if not len(sums) or not sums[worst] < 1:
        return (0.0, np.zeros((G.n, G.n + G.nu))) if not len(sums) else _outside(G)
    signs = np.sign(h[:, worst])  # (samples + 1, nu)
    found, c = np.zeros((G.n + G.ny, G.n + G.nu)), G.C[worst][:, None]
    adjoint = c @ signs[-1:]
    for k in range(samples - 1, 0, -1):
        found[: G.n, : G.n] += adjoint @ x[k - 1].T
        adjoint = c @ signs[k : k + 1] + G.A.T @ adjoint
    found[: G.n, G.n :] = adjoint
    found[G.n + worst, : G.n] = np.einsum("kij,kj->i", x, signs[1:])
    found[G.n + worst, G.n :] = signs[0]
    return -float(np.log(1 - sums[worst])), found / (1 - sums[worst])


def within(G: StateSpace, centre: float, radius: float) -> tuple[float, np.ndarray, float]:
    """Of a disc for the poles: -log det(I - A x A) / 2 of A = (A - centre) / radius, in any coordinates the same.

    The third is the derivative by the logarithm of the radius.
    """
    A = (G.A - centre * np.eye(G.n)) / radius
    poles = np.linalg.eigvals(A)
    found = np.zeros((G.n + G.ny, G.n + G.nu))
    if not np.abs(poles).max(initial=0.0) < 1:
        return np.inf, found, 0.0
    value = -np.real(np.log(1 - np.outer(poles, poles))).sum() / 2
    each = poles[:, None, None]
    slope = np.real(np.sum(each * np.linalg.inv(np.eye(G.n) - each * A), axis=0)).T
    found[: G.n, : G.n] = slope / radius
    return float(value), found, -float(np.sum(slope * A))


def gramian(A: np.ndarray, Q: np.ndarray, dt: float) -> np.ndarray:
    """W = A W A' + Q in discrete time, A W + W A' + Q = 0 in continuous time (dt = 0), of a stable A."""
    if not dt:
        return np.asarray(sla.solve_continuous_lyapunov(A, -Q))
    with np.errstate(all="ignore"):  # not finite next to instability
        for _ in range(MAX_STEPS):
            Q, A = Q + A @ Q @ A.T, A @ A
            if not np.linalg.norm(A) >= CONVERGED:
                break
    return Q


def _outside(G: StateSpace) -> Sloped:
    return np.inf, np.zeros((G.n + G.ny, G.n + G.nu))
