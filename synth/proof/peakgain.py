"""Peak gains, proved: how large a signal of a stable discrete system can become when its inputs are bounded.

From rest, x+ = A x + B d with |d_j| <= d_j* gives |C x + D d| <= (|D| + sum over k of |C A^k B|) d*, entry by entry,
and some d reaches it: the l1 norm, or worst-case peak gain.

The first N terms are computed in doubles, Z_k for A^k B, and what they miss is bounded. With R = Z_(j+i) - A^i Z_j, a
rounding error of which |R| <= g |A^i| |Z_j| is known, Z_k - A^k B is the sum of A^(k-j) R over the products that led
to Z_k, and no product leads to one k on two ways. Hence

    sum |C A^k B|  <=  sum over k < N of |C Z_k|  +  S(Z_N)  +  S(sum of all |R|),   S(V) >= sum over k of |C A^k V|,

where S comes from coordinates T in which M >= |T^-1 A T| is a nonnegative matrix that contracts, M v < v for some
v > 0 (then the sum of M^k is (I - M)^-1):

    S(V) = |C T| (I - M)^-1 |T^-1 V|.

Eigenvectors and Schur vectors are tried for T; each that contracts gives an S, and the least counts. T^-1, M, v and
(I - M)^-1 are proved in balls. What is then left to doubles are sums of products of nonnegative numbers, which are
right to n units in the last place for n terms and are made larger by far more than that.

References: Boyd and Doyle (1987), Comparison of peak and RMS gains for discrete-time systems, Systems & Control Letters
9, 1; Volkova, Hilaire and Lauter (2015), Reliable evaluation of the worst-case peak gain matrix in multiple precision,
ARITH 22; Higham (2002), Accuracy and Stability of Numerical Algorithms, 2nd ed., section 3.5, on g.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import scipy.linalg
from flint import acb, acb_mat, arb, arb_mat, ctx

from synth.errors import NumericalError
from synth.proof.balls import Balls
from synth.proof.matrices import exact, identity, rounded

BITS = 192  # of the balls
UNIT = 2.0**-53  # rounding unit of doubles
UP = 1 + 2.0**-30  # makes what doubles found an upper bound: no sum below has as many as 2^20 terms in sequence
TINY = 1e-290  # above what underflow takes from all sums together
COLUMNS = 2048  # of powers of A, made in one product
WORK = 1e9  # multiplications at most
FEW = 1e-2  # of a gain may be left to doubt about the tail
HUGE = 1e150  # coordinates with larger numbers tell nothing


class Coordinates(NamedTuple):
    """What the sum over k of |A^k V| is read from: |T| G |T^-1 V|."""

    T: acb_mat  # (n, n)
    inverse: acb_mat  # (n, n)
    G: np.ndarray  # (n, n) at least (I - M)^-1


def peak_gains(system: Balls, *, first: int = 0, work: float = WORK, few: float = FEW) -> np.ndarray:
    """Upper bounds (outputs, inputs) of the peak gains of a discrete system in balls, from rest.

    Parameters
    ----------
    first : states of a system in front of the others, which they do not act upon: its vectors are then its own, so
        that two systems that hardly differ are not taken for one with double poles
    work : multiplications at most; where they do not suffice the tail is larger, and the bound still one
    few : part of a gain that its tail's bound may be above what is known of the tail, |C (I - A)^-1 A^N B| at least

    Raises
    ------
    NumericalError : the system was not proved to be stable.
    """
    A, B, C, D = system
    gains = above(D)
    if not A.nrows() or not B.ncols() or not C.nrows():
        return gains * UP
    with ctx.workprec(BITS):
        ways = coordinates(A, first)
        if not ways:
            raise NumericalError("the system was not proved stable, and only of a stable one the peaks have a bound")
        return (gains + _sums(A, B, C, ways, work, few)) * UP


def is_proved_stable(A: arb_mat) -> bool:
    """True when A^k is proved to vanish."""
    with ctx.workprec(BITS):
        return not A.nrows() or bool(coordinates(A))


def coordinates(A: arb_mat, first: int = 0) -> list[Coordinates]:
    """Those in which one step of x+ = A x contracts."""
    midpoint = rounded(A)
    blocks = [M for M in (midpoint[:first, :first], midpoint[first:, first:]) if len(M)]
    eigen, schur = (_complex(np.asarray(scipy.linalg.block_diag(*T))) for T in zip(*map(_vectors, blocks), strict=True))
    found = [_contracting(A, T) for T in (eigen, schur)]
    if found[0] is None:
        try:
            found.append(_contracting(A, acb_mat(A).mid().eig(right=True, algorithm="approx")[1].mid()))
        except (ValueError, ZeroDivisionError, ArithmeticError):
            pass
    return [way for way in found if way is not None]


def _vectors(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvectors and Schur vectors, found in units in which rows and columns are alike."""
    _, balanced = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    scale = balanced[0]
    scaled = A / scale[:, None] * scale
    schur = scipy.linalg.schur(scaled, output="complex")
    return scale[:, None] * np.linalg.eig(scaled)[1], scale[:, None] * schur[1]


def _contracting(A: arb_mat, T: acb_mat) -> Coordinates | None:
    """These coordinates, if M is proved to contract in them."""
    n = A.nrows()
    try:
        inverse = T.inv()
        M = above(inverse * acb_mat(A) * T)
        if not max(np.max(above(T)), np.max(above(inverse)), np.max(M)) < HUGE:
            return None
        v = np.linalg.solve(np.eye(n) - M, np.ones(n))
        if not (np.isfinite(v).all() and (v > 0).all()):
            return None
        ball, I = exact(v[:, None]), identity(n)
        if not all(bool(e > 0) for e in (ball - exact(M) * ball).entries()):
            return None
        return Coordinates(T, inverse, above((I - exact(M)).solve(I)))
    except (ZeroDivisionError, np.linalg.LinAlgError, ValueError):
        return None


def _sums(A: arb_mat, B: arb_mat, C: arb_mat, ways: list[Coordinates], work: float, few: float) -> np.ndarray:
    """Sum over k of |C A^k B|, entry by entry."""
    n, p = B.nrows(), B.ncols()
    a, c = rounded(A), rounded(C)
    gamma = 4 * (n + 2) * UNIT  # twice what a dot product of n terms needs, and the rounding of its factors
    loose = gamma * np.abs(c) + _radius(C)
    readers = [(way, above(acb_mat(C) * way.T) @ way.G * UP) for way in ways]
    reached, sizes, missed = np.zeros((len(c), p)), np.zeros((n, p)), _radius(B) + above(B) * UNIT + TINY
    for terms, total, lost, following in _powers(A, rounded(B), gamma):
        for column in range(p):
            reached[:, column] += np.abs(c @ terms[:, column]).sum(axis=1)
        sizes, missed = sizes + total, missed + lost
        work -= terms.size * (n + len(c))
        tail = _read(readers, exact(following))
        known = np.abs([c @ np.linalg.solve(z * np.eye(n) - a, following) for z in (1, -1)]).max(axis=0)
        if (tail - known <= few * (reached + known + FEW * np.abs(c) @ sizes)).all() or work < 0:
            break
    return reached + loose @ sizes + tail + np.min([_read([r], exact(missed)) for r in readers], axis=0)


def _read(readers: list[tuple[Coordinates, np.ndarray]], V: arb_mat) -> np.ndarray:
    """S(V), the least of all coordinates."""
    return np.min([reader @ above(way.inverse * acb_mat(V)) for way, reader in readers], axis=0) * UP


def _powers(A: arb_mat, b: np.ndarray, gamma: float) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Without end, blocks of Z_k (n, p, length), the sum of |Z_k|, that of |R| made on the way, and the next Z_k."""
    n, p = b.shape
    power, block, lost = A, b[:, :, None], np.zeros((n, p))
    while block.shape[2] * p < COLUMNS:
        following, made = _advanced(power, block, gamma)
        block, lost, power = np.concatenate([block, following], axis=2), lost + made, power * power
    while True:
        following, made = _advanced(power, block, gamma)
        lost += made
        yield block, np.abs(block).sum(axis=2) * UP, lost, following[:, :, 0]
        block, lost = following, np.zeros((n, p))


def _advanced(power: arb_mat, block: np.ndarray, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    """Z_(k+i) = A^i Z_k for a block, and the sum of the |R| of this."""
    P = rounded(power)
    following = np.einsum("ij,jpk->ipk", P, block, optimize=True)
    made = (gamma * np.abs(P) + _radius(power)) @ np.abs(block).sum(axis=2) * UP
    return following, made + TINY


def _radius(M: arb_mat) -> np.ndarray:
    """Upper bounds of the radii, and of what the midpoints lost when they became doubles."""
    middle = rounded(M)
    return above(M - exact(middle))


def _complex(T: np.ndarray) -> acb_mat:
    p, q = T.shape
    return acb_mat(p, q, [acb(float(e.real), float(e.imag)) for e in T.ravel()])


def above(M: arb_mat | acb_mat) -> np.ndarray:
    """Doubles that are at least the absolute values of the entries."""
    values = [_up(abs(e).abs_upper()) for e in M.entries()]
    return np.array(values, dtype=float).reshape(M.nrows(), M.ncols())


def _up(x: arb) -> float:
    value = float(x)
    return float(np.nextafter(value, np.inf)) if value else 0.0 if x == 0 else TINY
