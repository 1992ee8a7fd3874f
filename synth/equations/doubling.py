"""Discrete Riccati equations by structure-preserving doubling.

    X = Q + A'X A - (A'X B + S) (R + B'X B)^-1 (A'X B + S)',    R symmetric of any signature

One doubling step turns the k-step value function into the 2k-step one, so the stabilising solution is reached in
about ten steps of one linear solve each. A start near the solution is used exactly: the equation is shifted by it
and the correction is computed, which also refines a solution to full precision.

References: Chu, Fan, Lin, Wang (2004), Structure-preserving algorithms for periodic discrete-time algebraic Riccati
equations, Int. J. Control 77; Stoorvogel (1992), The H-infinity control problem, chapters 9 and 10.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.errors import NumericalError
from synth.systems.statespace import StateSpace

MAX_STEPS = 50  # 2^50 samples: slower convergence than that is a mode on the unit circle
CONVERGED = 1e-8  # the next step squares it
REGULARISATIONS = (1e-4, 1e-3, 1e-2, 1e-1)  # of LQR and Kalman, relative to the size of the cost
FINAL_RESIDUAL = 1e-7  # relative; a solution worse than this is no solution


class Riccati(NamedTuple):
    """Stabilising solution of a discrete Riccati equation."""

    X: np.ndarray  # (n, n)
    R: np.ndarray  # (m, m) R + B'X B
    F: np.ndarray  # (m, n) feedback u = F x that goes with it
    residual: float  # relative


def double(A: np.ndarray, G: np.ndarray, H: np.ndarray) -> np.ndarray | None:
    """Stabilising solution of X = H + A'X (I + G X)^-1 A, or None when the doubling does not converge.

    Parameters
    ----------
    A : (n, n)
    G, H : (n, n) symmetric, of any signature
    """
    I = np.eye(len(A))
    with np.errstate(all="ignore"):
        for _ in range(MAX_STEPS):
            try:
                V = np.linalg.solve(I + G @ H, np.hstack([A, G]))
            except np.linalg.LinAlgError:
                return None
            V1, V2 = V[:, : len(A)], V[:, len(A) :]
            H = _symmetric(H + A.T @ H @ V1)
            G = _symmetric(G + A @ V2 @ A.T)
            A = A @ V1
            size = np.linalg.norm(A)
            if not (np.isfinite(size) and np.isfinite(H).all() and np.isfinite(G).all()):
                return None
            if size < CONVERGED:
                return H
    return None


def solve_riccati(
    A: np.ndarray,
    B: np.ndarray,
    Q: np.ndarray,
    R: np.ndarray,
    S: np.ndarray | None = None,
    start: np.ndarray | None = None,
) -> Riccati | None:
    """Stabilising solution of the discrete Riccati equation in the file header, or None when none is found.

    Parameters
    ----------
    A : (n, n); B : (n, m); Q : (n, n); R : (m, m); S : (n, m), zero when left out
    start : (n, n) a symmetric matrix near the solution, with R + B' start B invertible; zero when left out
    """
    S = np.zeros_like(B) if S is None else S
    X = np.zeros_like(A) if start is None else start
    best = None
    for _ in range(3):  # the first pass solves, the others refine
        step = _shifted(A, B, Q, R, S, X)
        if step is None:
            break
        X = _symmetric(X + step)
        solution = evaluate(A, B, Q, R, S, X)
        if solution is None or (best is not None and solution.residual > 0.5 * best.residual):
            break
        best = solution
        if best.residual < 1e-14:
            break
    return best if best is not None and best.residual < FINAL_RESIDUAL else None


def regularised_lqr(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, assumption: str) -> Riccati:
    """LQR of |C x + D u|^2 with the smallest regularisation of x and u for which a stabilising gain is found.

    Parameters
    ----------
    A : (n, n); B : (n, m); C : (p, n); D : (p, m)
    assumption : what the error names

    Raises
    ------
    NumericalError : none of the regularisations led to one.
    """
    n, m = B.shape
    size = float(np.hypot(np.linalg.norm(C), np.linalg.norm(D))) or 1.0
    Q, R, S = C.T @ C, D.T @ D, C.T @ D
    for epsilon in REGULARISATIONS:
        e = (epsilon * size) ** 2
        Qe, Re = Q + e * np.eye(n), R + e * np.eye(m)
        solution = solve_riccati(A, B, Qe, Re, S)
        if solution is None:
            try:
                X = sla.solve_discrete_are(A, B, Qe, Re, s=S)
            except (np.linalg.LinAlgError, ValueError):
                continue
            solution = solve_riccati(A, B, Qe, Re, S, start=X)
        if solution and is_positive(solution.R) and is_nonnegative(solution.X):
            if np.abs(np.linalg.eigvals(A + B @ solution.F)).max(initial=0.0) < 1:
                return solution
    raise NumericalError(
        f"no stabilising gain was found: {assumption} holds so weakly that double precision cannot use it; "
        "rescale the model or strengthen the weakest actuator or sensor"
    )


def bounded_real(G: StateSpace, gamma: float, *, stable: bool = False) -> np.ndarray | None:
    """Witness, in floating point, that a discrete system is stable with H-infinity norm below `gamma`, or None.

    Parameters
    ----------
    stable : True where the caller knows that it is stable

    Returns
    -------
    X : (n, n) positive semidefinite stabilising solution of
        X = A'X A + C'C + (A'X B + C'D) (gamma^2 I - D'D - B'X B)^-1 (A'X B + C'D)'

    It exists exactly when the norm is below `gamma`; near the norm rounding decides. Use a balanced realisation.

    Reference: de Souza and Xie (1992), Systems and Control Letters 18, on the discrete bounded real lemma.
    """
    B, C, D = G.B / np.sqrt(gamma), G.C / np.sqrt(gamma), G.D / gamma
    if G.n == 0:
        return np.zeros((0, 0)) if np.linalg.norm(D, 2) < 1 else None
    if not stable and np.abs(G.poles()).max() >= 1:
        return None
    R = D.T @ D - np.eye(D.shape[1])
    if not is_positive(-R):
        return None
    solution = solve_riccati(G.A, B, C.T @ C, R, C.T @ D)
    if solution is None or not is_positive(-solution.R) or not is_nonnegative(solution.X):
        return None
    return gamma * solution.X


def is_positive(M: np.ndarray) -> bool:
    """True when every eigenvalue of a symmetric matrix is positive beyond rounding."""
    e = np.linalg.eigvalsh(M)
    return bool(e[0] > len(e) * np.finfo(float).eps * abs(e[-1]))


def is_nonnegative(M: np.ndarray, tolerance: float = 1e-9) -> bool:
    """True when no eigenvalue of a symmetric matrix lies below -tolerance times its norm."""
    e = np.linalg.eigvalsh(M)
    return bool(e[0] >= -tolerance * max(abs(e[0]), abs(e[-1])))


def _symmetric(M: np.ndarray) -> np.ndarray:
    return (M + M.T) / 2


def _shifted(A, B, Q, R, S, Xs) -> np.ndarray | None:
    """The correction X - Xs, from the equation shifted by Xs."""
    with np.errstate(all="ignore"):
        Rs, Ss, Qs = R + B.T @ Xs @ B, S + A.T @ Xs @ B, Q + A.T @ Xs @ A - Xs
        try:
            W = np.linalg.solve(Rs, np.hstack([B.T, Ss.T]))
        except np.linalg.LinAlgError:
            return None
        n = len(A)
        G, F = B @ W[:, :n], W[:, n:]
        if not np.isfinite(W).all():
            return None
        return double(A - B @ F, _symmetric(G), _symmetric(Qs - Ss @ F))


def evaluate(A, B, Q, R, S, X) -> Riccati | None:
    """Feedback and relative residual of a candidate X; None where R + B'X B is singular."""
    RX, SX = R + B.T @ X @ B, S + A.T @ X @ B
    try:
        F = -np.linalg.solve(RX, SX.T)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(F).all():
        return None
    AXA, K = A.T @ X @ A, SX @ F
    size = np.linalg.norm(Q) + np.linalg.norm(AXA) + np.linalg.norm(X) + np.linalg.norm(K)
    residual = np.linalg.norm(Q + AXA - X + K) / size if size else 0.0
    return Riccati(X, _symmetric(RX), F, float(residual))
