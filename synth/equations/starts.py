"""First solutions of algebraic Riccati equations, from nothing, for Newton's method to refine.

Doubling takes many equations at once and any signature of Q; the ordered Schur form of the Hamiltonian matrix is the
quickest for one continuous equation; SciPy's extended pencil never inverts R. All return X, or None.

References: Chu, Fan and Lin (2005), Linear Algebra and its Applications 396, 55 (structure-preserving doubling);
Laub (1979), IEEE TAC 24, 913 (Schur method); Van Dooren (1981), SIAM J. Sci. Stat. Comput. 2, 121 (extended pencil).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.equations.refinement import Equation, gees, gesv, size, solved

DOUBLINGS = 50  # 2^50 samples: slower convergence than that is a mode on the stability boundary
NEAR = 1e-5  # size of the doubled closed loop at which the solution is right to its square
DIVERGED = 1e100
OFF_POLE = 1.17  # keeps the rate of the Cayley map from the mirror images of closed-loop poles, which A may have


class Folded(NamedTuple):
    """The equation of X_E = E'X E without cross weight: A'X + X A - X G X + Q = 0, or X = Q + A'X (I + G X)^-1 A."""

    A: np.ndarray  # (..., n, n)
    G: np.ndarray
    Q: np.ndarray


def folded(e: Equation, inverse_E: np.ndarray | None) -> Folded:
    """E and N taken into A, B, Q.

    Raises
    ------
    numpy.linalg.LinAlgError : R is singular.
    """
    A, B = (e.A, e.B) if inverse_E is None else (inverse_E @ e.A, inverse_E @ e.B)
    if not np.count_nonzero(e.N):
        return Folded(A, B @ solved(e.R, B.mT), e.Q)
    F = solved(e.R, np.concatenate([np.broadcast_to(B.mT, e.N.mT.shape), e.N.mT], -1))
    G, N = F[..., : A.shape[-1]], F[..., A.shape[-1] :]
    return Folded(A - B @ N, B @ G, e.Q - e.N @ N)


def schur(H: np.ndarray) -> np.ndarray | None:
    """X of the stable invariant subspace [I; X] of a Hamiltonian matrix (2n, 2n)."""
    n = len(H) // 2
    _, stable, _, _, U, *_ = gees(_left, H, sort_t=1)
    if stable != n:
        return None
    *_, X, info = gesv(U[:n, :n].T, U[n:, :n].T)
    return (X + X.T) / 2 if info == 0 else None


def hamiltonian(f: Folded) -> np.ndarray:
    """[[A, -G], [-Q, -A']], (2n, 2n).

    Raises
    ------
    numpy.linalg.LinAlgError : a number is not finite.
    """
    n = len(f.A)
    H = np.empty((2 * n, 2 * n))
    H[:n, :n], H[:n, n:], H[n:, :n], H[n:, n:] = f.A, -f.G, -f.Q, -f.A.T
    if not math.isfinite(size(H)):
        raise np.linalg.LinAlgError("the equation has no finite standard form")
    return H


def _left(real: float, imag: float) -> bool:
    """Whether an eigenvalue belongs to the stable subspace."""
    return real < 0


def doubling(f: Folded, *, discrete: bool) -> np.ndarray:
    """The limit of doubling, (b, n, n); not finite where there is none. Lanes do not touch one another."""
    A, G, H = f if discrete else _cayley(f)
    X = np.full(A.shape, np.nan)
    lanes, n = np.arange(len(A)), A.shape[-1]
    I = np.eye(n)
    for _ in range(DOUBLINGS):
        if not len(lanes):
            break
        V = solved(I + G @ H, np.concatenate([A, G], -1))
        V1, At = V[..., :n], A.mT
        H, G, A = _symmetric(H + At @ (H @ V1)), _symmetric(G + A @ V[..., n:] @ At), A @ V1
        left = size(A)
        done = left < NEAR
        if done.any():
            X[lanes[done]] = H[done]
        going = ~done & (left < DIVERGED)
        if not going.all():
            lanes, A, G, H = lanes[going], A[going], G[going], H[going]
    return X


def _cayley(f: Folded) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The discrete equation with the same X (Chu, Fan and Lin 2005, section 2)."""
    n = f.A.shape[-1]
    H = np.concatenate([np.concatenate([f.A, -f.G], -1), np.concatenate([-f.Q, -f.A.mT], -1)], -2)
    logarithm = np.linalg.slogdet(H)[1] / (2 * n)
    s = OFF_POLE * np.exp(np.where(np.isfinite(logarithm), logarithm, 0.0))[:, None, None]
    I = np.eye(n)
    V = solved(f.A - s * I, np.concatenate([np.broadcast_to(I, f.A.shape), f.G], -1))
    V, VG = V[..., :n], V[..., n:]
    W = solved(f.A.mT - s * I + f.Q @ VG, np.concatenate([np.broadcast_to(I, f.A.shape), f.Q @ V], -1))
    return I + 2 * s * W[..., :n].mT, _symmetric(2 * s * VG @ W[..., :n]), _symmetric(2 * s * W[..., n:])


def pencil(e: Equation) -> np.ndarray | None:
    """SciPy's solution of one equation in balanced states, by the ordered QZ form of the extended pencil."""
    solve = sla.solve_discrete_are if e.discrete else sla.solve_continuous_are
    try:
        return solve(e.A, e.B, e.Q, e.R, e=e.E, s=e.N, balanced=False)
    except (np.linalg.LinAlgError, ValueError):
        return None


def _symmetric(M: np.ndarray) -> np.ndarray:
    return (M + M.mT) / 2
