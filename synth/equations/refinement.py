"""Algebraic Riccati equations on the data given: gain, residual, Newton's correction, and what rounding may do to all.

    continuous   A'X E + E'X A - (E'X B + N) R^-1 (E'X B + N)' + Q = 0
    discrete     A'X A - E'X E - (A'X B + N) (R + B'X B)^-1 (A'X B + N)' + Q = 0

Q of any signature; E invertible, the identity where it is None. Every function takes one equation, or many with a
leading axis. The residual is that of the gain K = R^-1 (E'X B + N)' in the loop which it closes,

    (A - B K)'X E + E'X (A - B K) + Q + K'R K - N K - K'N',

which an error of K changes in second order only. It is told beside its terms M, the same sum of moduli: entry (i, j)
in parts of the larger of M_ij and sqrt(M_ii M_jj), which units of states and commands do not change.

References: Kleinman (1968), IEEE TAC 13, 114, and Hewer (1971), IEEE TAC 16, 382 (Newton's method); Byers (1985), in
Datta (ed.), Linear Algebra and its Role in Systems Theory, and Kenney and Hewer (1990), SIAM J. Control Optim. 28, 50
(the condition, by the inverse of the closed loop's Lyapunov operator, which keeps the order of symmetric matrices);
Smith (1968), SIAM J. Applied Math. 16, 198 (Lyapunov equations by squaring).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

ROUNDED = 1e-14  # relative error of data and terms that rounding explains
CERTAIN = 0.03  # doubt up to which a solution is certain
UNSEEN = 1e-6  # part of the unit of a driven state, squared a relative cost that rounding explains
DARK = 0.5  # least doubt where the weight of a state is not to be told from none
SQUARINGS = 50  # 2^50 samples: slower decay than that is a mode on the stability boundary
VANISHED = 1e-9  # size of a squared closed loop that counts as zero; the next square is lost in rounding
DIVERGED = 1e100
TINY = 1e-150  # keeps 0 / 0 from being one, and has a square

gees, gesv, posv, potrf, trsyl = get_lapack_funcs(("gees", "gesv", "posv", "potrf", "trsyl"), dtype=np.float64)


class Equation(NamedTuple):
    """The data of an equation of either kind, (n, n) and (n, m), all with the same leading axes or with none."""

    A: np.ndarray
    B: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    N: np.ndarray
    E: np.ndarray | None
    discrete: bool

    def each(self, change: Callable[[np.ndarray], np.ndarray]) -> Equation:
        """The equation with every matrix changed."""
        A, B, Q, R, N = (change(M) for M in self[:5])
        return Equation(A, B, Q, R, N, None if self.E is None else change(self.E), self.discrete)


class Evaluated(NamedTuple):
    """What an X means."""

    X: np.ndarray  # (n, n)
    K: np.ndarray  # (m, n) u = -K x
    weight: np.ndarray  # (m, m) of a change of the command: R, in discrete time R + B'X B
    closed: np.ndarray  # (n, n) E^-1 (A - B K)
    off: np.ndarray  # (n, n) residual, the right side of Newton's equation


class Judged(NamedTuple):
    """How good an X is; the numbers do not depend on the units of states and commands."""

    residual: Any  # largest entry of the residual beside its terms
    condition: Any  # relative change of X for the worst change of the data by as much, entry by entry
    doubt: Any  # parts of its stability, and of Newton's convergence, that rounding may take; below CERTAIN it is sure


Inverse = Callable[[np.ndarray], np.ndarray]  # W -> the solution Z of C'Z + Z C + W = 0, or of C'Z C - Z + W = 0


def evaluate(e: Equation, X: np.ndarray, inverse_E: np.ndarray | None) -> Evaluated:
    """Gain, closed loop and residual of X.

    Raises
    ------
    numpy.linalg.LinAlgError : R, in discrete time R + B'X B, is singular.
    """
    A, B, Q, R, N, E, discrete = e
    Bt, Nt = B.mT, N.mT
    if discrete:
        XA = X @ A
        weight = R + Bt @ X @ B
        K = weighed(weight, Bt @ XA + Nt)
        closed = A - B @ K
        half = closed.mT @ (X @ closed) - (X if E is None else E.mT @ X @ E)
        off = (half + half.mT + Q + Q.mT) / 2
        cost = K.mT @ (R @ K / 2 - Nt)
    else:
        weight = R
        XE = X if E is None else X @ E
        K = weighed(R, Bt @ XE + Nt)
        closed = A - B @ K
        off, cost = Q, XE.mT @ closed + K.mT @ (R @ K / 2 - Nt)
    return Evaluated(X, K, weight, closed if inverse_E is None else inverse_E @ closed, off + cost + cost.mT)


def weighed(weight: np.ndarray, right: np.ndarray) -> np.ndarray:
    """weight^-1 right of a symmetric weight, mostly a definite one; its rounding does not depend on units."""
    if weight.ndim == 2:
        *_, X, info = posv(weight, right)
        return X if info == 0 else solved(weight, right)
    d = np.sqrt(np.abs(np.diagonal(weight, axis1=-2, axis2=-1)))[..., None]
    return solved(weight / (d * d.mT), right / d) / d


def judged(e: Equation, v: Evaluated, inverse: Inverse, inverse_E: np.ndarray | None) -> Judged:
    """Residual, condition and doubt of a solution whose closed loop is stable.

    With W the diagonal of the terms M, Ac'P + P Ac + W = 0 bounds what relative errors r of the data do to X: r P. They
    leave the loop stable while r (P |A - B K| + its transpose) stays below W, moduli added as above, and Newton's
    quadratic rest r^2 P B R^-1 B'P below r W.
    """
    with np.errstate(all="ignore"):
        return _judged(e, v, inverse, inverse_E)


def _judged(e: Equation, v: Evaluated, inverse: Inverse, inverse_E: np.ndarray | None) -> Judged:
    """`judged`, which divides by what may be zero."""
    X, K, A, E = np.abs(v.X), np.abs(v.K), np.abs(e.A) + np.abs(e.B) @ np.abs(v.K), None if e.E is None else np.abs(e.E)
    M = np.abs(e.Q) + K.mT @ (np.abs(e.R) @ K + 2 * np.abs(e.N).mT)
    if e.discrete:
        M = M + A.mT @ X @ A + (X if E is None else E.mT @ X @ E)
    else:
        H = (X if E is None else X @ E).mT @ A
        M = M + H + H.mT
    w, dark = _units(M, A, e, v)
    scale = w[..., None] * w[..., None, :]
    residual = largest(v.off / np.maximum(M, scale))
    P = inverse(w[..., None] ** 2 * np.eye(w.shape[-1]))
    PE = P if inverse_E is None else P @ inverse_E
    B = (PE @ e.B).mT
    if e.discrete:
        PE, B = np.abs(v.closed).mT @ np.abs(PE), B @ v.closed
    moved = largest(np.abs(PE) @ A / scale)
    B = B / w[..., None, :]
    rest = size(B.mT @ weighed(v.weight, B))
    condition = size(P) / np.maximum(size(v.X), TINY)
    doubt = np.maximum(residual, ROUNDED) * np.maximum(moved, rest)
    return Judged(residual, condition, np.where(dark.any(-1), np.maximum(doubt, DARK), doubt))


def _units(M: np.ndarray, A: np.ndarray, e: Equation, v: Evaluated) -> tuple[np.ndarray, np.ndarray]:
    """W (..., n), w_i^2 = M_ii, and the states (..., n) bool that the cost does not see, whose M_ii is rounding.

    Such a state gets the size that others drive it to: x_j, of amplitude 1 / w_j, at the rate A_ij leads to
    |A_ij / rate| / w_j. One that nothing drives has no unit of its own and takes the largest. Their own weight is not
    to be told from none, so that nothing is sure.
    """
    w = np.sqrt(np.diagonal(M, axis1=-2, axis2=-1)) + TINY
    most = w.max(-1, keepdims=True)
    dark = w < UNSEEN * most
    if not dark.any():
        return w, dark
    rate = 1.0 if e.discrete else np.abs(np.trace(v.closed, axis1=-2, axis2=-1)[..., None]) / w.shape[-1]
    own = np.sqrt(np.abs(np.diagonal(v.weight, axis1=-2, axis2=-1)))
    commanded = (np.abs(e.B) / own[..., None, :]).max(-1) / rate
    amplitude = np.where(dark, 0.0, 1 / w)
    for _ in range(w.shape[-1]):
        driven = np.maximum((A * amplitude[..., None, :]).max(-1) / rate, commanded)
        reached = dark & (amplitude == 0) & (driven > 0)
        if not reached.any():
            break
        amplitude = np.where(reached, driven, amplitude)
    dark = dark & (w * amplitude < UNSEEN)
    return np.where(dark, np.minimum(1 / amplitude, most), w), dark


def size(M: np.ndarray) -> Any:
    """Frobenius norm."""
    return math.sqrt(np.vdot(M, M)) if M.ndim == 2 else np.sqrt(np.einsum("bij,bij->b", M, M))


def largest(M: np.ndarray) -> Any:
    """The largest modulus."""
    return np.abs(M).max() if M.ndim == 2 else np.maximum(M.max((-2, -1)), -M.min((-2, -1)))


def by_schur(C: np.ndarray) -> tuple[np.ndarray, Inverse]:
    """Eigenvalues of C, (n,) complex, and the inverse of its continuous Lyapunov operator; one matrix."""
    T, _, real, imag, U, *_ = gees(_any, C)

    def inverse(W: np.ndarray) -> np.ndarray:
        Y, scale, _ = trsyl(T, T, U.T @ W @ U, trana="T")
        return U @ (Y / -scale) @ U.T

    return real + 1j * imag, inverse


def by_squaring(C: np.ndarray, discrete: bool) -> tuple[np.ndarray, Inverse]:
    """Whether C is stable, (...) bool, and the inverse of its Lyapunov operator; one matrix or many.

    A continuous one is mapped to the circle by (C + s I)(C - s I)^-1, with s the geometric mean of its eigenvalues.
    """
    I = np.eye(C.shape[-1])
    V, s = I, np.float64(0.5)
    if not discrete:
        s = np.exp(np.linalg.slogdet(C)[1] / C.shape[-1])[..., None, None]
        V = solved(C - s * I, np.broadcast_to(I, C.shape))
        C = I + 2 * s * V
    powers, stable = [C], np.zeros(C.shape[:-2], bool)
    for _ in range(SQUARINGS):
        left = size(C)
        stable = stable | (left < VANISHED)
        going = ~stable & (left < DIVERGED)
        if not np.any(going):
            break
        C = C @ C
        if not np.all(going):
            C = np.where(going[..., None, None], C, 0.0)
        powers.append(C)

    def inverse(W: np.ndarray) -> np.ndarray:
        Z = 2 * s * V.mT @ W @ V
        for P in powers:
            Z = Z + P.mT @ Z @ P
        return (Z + Z.mT) / 2

    return stable, inverse


def solved(M: np.ndarray, right: np.ndarray) -> np.ndarray:
    """M^-1 right; of many, not a number where M is singular."""
    if M.ndim > 2:
        return _by_lane(np.linalg.solve, M, right)
    *_, X, info = gesv(M, right)
    if info:
        raise np.linalg.LinAlgError("Singular matrix")
    return X


def rooted(M: np.ndarray) -> np.ndarray:
    """Lower triangular roots; of many, not a number where M is not positive definite."""
    if M.ndim > 2:
        return _by_lane(np.linalg.cholesky, M)
    L, info = potrf(M, lower=1)
    if info:
        raise np.linalg.LinAlgError("Matrix is not positive definite")
    return L


def _by_lane(function: Callable, *operands: np.ndarray) -> np.ndarray:
    """A function of many matrices that is not defined for each of them."""
    with contextlib.suppress(np.linalg.LinAlgError):
        return function(*operands)
    out = np.full(operands[-1].shape, np.nan)
    for k, lane in enumerate(zip(*operands, strict=True)):
        with contextlib.suppress(np.linalg.LinAlgError):
            out[k] = function(*lane)
    return out


def _any(*_: float) -> bool:
    """No order of the eigenvalues."""
    return True
