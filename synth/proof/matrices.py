"""Matrices of balls: what doubles become, what they are made of, and when one is positive definite.

For a symmetric M and any K: an inverse Cholesky factor that came out of floating-point arithmetic will do:

    |K M K' - I| < 1  in the largest row sum  =>  M > 0.

Reference: Rump (2006), BIT 46, 433.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from flint import arb, arb_mat

FACTORED = 4  # times at most
NEARLY = 0.1  # row sum from which on a factored matrix is the identity
ADDED = 1e-12  # to its diagonal of ones where doubles find none


def is_small(E: arb_mat) -> bool:
    """True when the largest row sum of a symmetric E is proved to be below one, so that I + E > 0."""
    return all(bool(sum((abs(e) for e in row), arb(0)) < 1) for row in E.table())


def is_positive_definite(M: arb_mat, factor: np.ndarray) -> bool:
    """True when a symmetric M is proved positive definite by congruence with `factor`."""
    n = M.nrows()
    if factor.shape != (n, n):
        return False
    K = exact(factor)
    return is_small(K * M * K.transpose() - identity(n))


def inverse_factor(M: arb_mat) -> np.ndarray | None:
    """Floating inverse Cholesky factor of a positive definite M, or None.

    Where M is too ill-conditioned for doubles it is factored once more, in the coordinates of a factor of M + small.
    """
    factor, I = identity(M.nrows()), np.eye(M.nrows())
    for _ in range(FACTORED):
        F = rounded(factor * M * factor.transpose())
        d = np.sqrt(np.maximum(np.diag(F), 0))
        if not (np.isfinite(F).all() and d.all()):
            return None
        if np.abs(F - I).sum(axis=1).max() < NEARLY:
            return rounded(factor)
        F = (F + F.T) / 2 / d / d[:, None]
        for added in (0.0, ADDED):
            try:
                factor = exact(np.linalg.inv(np.linalg.cholesky(F + added * I)) / d) * factor
            except np.linalg.LinAlgError:
                continue
            break
        else:
            return None
    return None


def exact(M: np.ndarray) -> arb_mat:
    """A matrix of doubles, exactly."""
    p, q = M.shape
    return arb_mat(p, q, M.ravel().tolist())


def rounded(M: arb_mat) -> np.ndarray:
    """The midpoints as doubles."""
    return np.array([float(e.mid()) for e in M.entries()]).reshape(M.nrows(), M.ncols())


def symmetric(M: np.ndarray) -> arb_mat:
    """The symmetric part of a matrix of doubles, exactly."""
    return (exact(M) + exact(M.T)) * arb(0.5)


def identity(n: int) -> arb_mat:
    """I of size n."""
    return exact(np.eye(n))


def block(parts: Sequence[Sequence[arb_mat]]) -> arb_mat:
    """A matrix from rows of blocks."""
    lines = [list(chain(*row)) for band in parts for row in zip(*(M.table() for M in band), strict=True)]
    return arb_mat(len(lines), sum(M.ncols() for M in parts[0]), list(chain(*lines)))


def rows(M: arb_mat, which: Sequence[int]) -> arb_mat:
    """Some rows of M."""
    return arb_mat(len(which), M.ncols(), [M[i, j] for i in which for j in range(M.ncols())])


def columns(M: arb_mat, which: Sequence[int]) -> arb_mat:
    """Some columns of M."""
    return arb_mat(M.nrows(), len(which), [M[i, j] for i in range(M.nrows()) for j in which])


def square(M: arb_mat) -> arb:
    """Sum of the squares of all entries."""
    return sum((e * e for e in M.entries()), arb(0))


def reduced(M: arb_mat, n: int) -> tuple[np.ndarray, np.ndarray]:
    """What M, a quadratic form in (x, u), is with the u = K x of its stationary point, and this K."""
    m = rounded(M)
    K = -np.linalg.solve(m[n:, n:], m[n:, :n])
    I = exact(np.vstack([np.eye(n), K]))
    return rounded(I.transpose() * M * I), K


def cholesky(M: arb_mat) -> arb_mat:
    """Lower triangular L with L L' = M, which proves M positive definite; by halves.

    Raises
    ------
    ValueError, ZeroDivisionError : that is not proved.
    """
    n = M.nrows()
    if n < 2:
        if n and not M[0, 0] > 0:
            raise ValueError("the matrix is not proved positive definite")
        return arb_mat(n, n, [e.sqrt() for e in M.entries()])
    first, second = range(n // 2), range(n // 2, n)
    A, B, C = (
        cholesky(rows(columns(M, first), first)),
        rows(columns(M, first), second),
        rows(columns(M, second), second),
    )
    L = A.solve(B.transpose()).transpose()
    return block([[A, arb_mat(n // 2, n - n // 2)], [L, cholesky(C - L * L.transpose())]])


def row_sum(M: arb_mat) -> arb:
    """The largest row sum, a norm."""
    sums = [sum((abs(e) for e in row), arb(0)).abs_upper() for row in M.table()]
    return max(sums, default=arb(0))
