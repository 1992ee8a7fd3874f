"""Small Delta of a structure that make I - M Delta singular: lower bounds of the structured singular value.

1 / |Delta| is one whatever the search does, and whoever doubts it can put Delta in and see.

Complex structures: the power iteration of Packard, Fan and Doyle, from several starts; at its end Delta is divided by
an eigenvalue of M Delta, so that one of them is 1. Structures with real numbers: from there, and from corners of the
box, the size k is minimised (SLSQP) over the parameters of Delta, and over frequency where the matrix has one, under
the condition that an eigenvalue of M Delta is 1; steps of Gauss and Newton end on it. Of a real matrix with different
real parameters det(I - M Delta) is affine in each of them, so that one of the corners is a smallest one.

References: Packard and Doyle (1993), Automatica 29, 71; Young and Doyle (1997), Int. J. Robust and Nonlinear Control 7,
1143 (real numbers in the power iteration); de Gaston and Safonov (1988), IEEE TAC 33, 156 (corners).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla
from scipy.optimize import minimize

from synth.analysis.blocks import Structure
from synth.analysis.scalings import Scalings

POWERS = 100  # steps of a power iteration
STARTS = 6  # of it
CORNERS = 10  # real parameters up to which all corners are tried
RANDOM = 8  # corners that are tried otherwise
SETTLED = 1e-9  # relative change of a power iteration that has ended
STEPS = 60  # of the minimisation
NEWTON = 20  # steps that end on the condition
SINGULAR = 1e-9  # of I - M Delta, relative to the size of M Delta: what counts as singular
HUGE = 1e7
ENOUGH = 1 + 1e-6  # of size times bound
REAL = 1e-12  # relative size of an imaginary part that is none

Family = Callable[[float], tuple[np.ndarray, np.ndarray]]  # t -> M (p, m) and dM/dt


class Perturbation(NamedTuple):
    """A Delta that makes I - M Delta singular."""

    Delta: np.ndarray  # (m, p)
    size: float  # its norm
    residual: float  # smallest singular value of I - M Delta, over 1 + |M Delta|
    at: float = 0.0  # where in a family of matrices


def residual(M: np.ndarray, Delta: np.ndarray) -> float:
    """How far I - M Delta is from singular: its smallest singular value over 1 + |M Delta|."""
    L = M @ Delta
    return float(np.linalg.svd(np.eye(len(M)) - L, compute_uv=False)[-1] / (1 + np.linalg.norm(L, 2)))


def smallest(M: np.ndarray, blocks: Structure, scalings: Scalings) -> Perturbation | None:
    """The smallest one found at a matrix, looked for until its size is 1 / the bound. None where none was found."""
    if scalings.bound == 0:
        return None
    N, _, _ = scaled(M, scalings.left, scalings.right)
    found = [checked(M, blocks, Delta, scalings) for Delta in _candidates(N, blocks)]
    best = least(*found)
    if (best and best.size * scalings.bound <= ENOUGH) or (_is_real(M, blocks) and _has_all_corners(blocks)):
        return best
    for start in starts(N, blocks):
        best = least(best, polished(lambda _: (M, np.zeros_like(M)), blocks, scalings, start))
        if best and best.size * scalings.bound <= ENOUGH:
            break
    return best


def least(*found: Perturbation | None) -> Perturbation | None:
    """The smallest of some."""
    return min((f for f in found if f), key=lambda f: f.size, default=None)


def scaled(M: np.ndarray, left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """N = L M R^-1 with L*L and R*R the scalings, L and R; Delta is the same for both matrices."""
    L, R = (np.linalg.cholesky(D).conj().T for D in (left, right))
    return sla.solve_triangular(R.T, (L @ M).T, lower=True).T, L, R


def polished(
    family: Family, blocks: Structure, scalings: Scalings, start: np.ndarray, *, moving: bool = False
) -> Perturbation | None:
    """The smallest Delta near a start that need not be singular; `moving` looks along the family of matrices too."""
    parameters = Parameters(blocks, moving)

    def at(t: float) -> tuple[np.ndarray, np.ndarray]:
        M, slope = (scaled(X, scalings.left, scalings.right)[0] for X in family(t))
        return M, slope

    values = np.linalg.eigvals(at(0.0)[0] @ start)
    scale = float(values.real.max(initial=0.0))
    if not scale > 0:
        return None
    x = parameters.of(start)

    def condition(x: np.ndarray) -> np.ndarray:
        return parameters.eigenvalue(at, x, scale)[0]

    def slope(x: np.ndarray) -> np.ndarray:
        return parameters.eigenvalue(at, x, scale)[1]

    with np.errstate(all="ignore"):
        try:
            found = minimize(
                lambda x: x[-1],
                x,
                jac=lambda x: np.eye(len(x))[-1],
                method="SLSQP",
                constraints=[
                    {"type": "eq", "fun": condition, "jac": slope},
                    {"type": "ineq", "fun": parameters.room, "jac": parameters.room_slope},
                ],
                options={"maxiter": STEPS, "ftol": 1e-10},
            ).x
            for _ in range(NEWTON):
                value, rows = parameters.eigenvalue(at, found, scale)
                rows[:, -1] = 0.0
                found = found - np.linalg.lstsq(rows, value, rcond=1e-10)[0]
                if np.abs(value).max() < REAL:
                    break
        except (np.linalg.LinAlgError, ValueError):
            return None
    if not np.isfinite(found).all():
        return None
    t = float(found[0]) if moving else 0.0
    return checked(family(t)[0], blocks, parameters.matrix(found) / scale, scalings, t)


class Parameters:
    """Delta by real numbers x.

    Where in the family (if that may change), one for a real block, two for a complex number, two vectors u, v of u v*
    for a full block, and at the end the size k.
    """

    def __init__(self, blocks: Structure, moving: bool):
        self.blocks, self.shift = blocks, int(moving)
        self.parts, at = [], self.shift
        for block in blocks.blocks:
            r, c = block.size
            count = 1 if block.kind == "real" else 2 if block.repeated or r == c == 1 else 2 * (r + c)
            self.parts.append(slice(at, at + count))
            at += count
        self.count = at + 1

    def of(self, Delta: np.ndarray) -> np.ndarray:
        """The parameters of a matrix of size one."""
        x = np.zeros(self.count)
        x[-1] = 1.0
        for block, part in zip(self.blocks.blocks, self.parts, strict=True):
            D = Delta[block.rows, block.columns]
            if part.stop - part.start <= 2:
                x[part] = [D[0, 0].real, D[0, 0].imag][: part.stop - part.start]
            else:
                U, s, Vh = np.linalg.svd(D)
                u, v = np.sqrt(s[0]) * U[:, 0], np.sqrt(s[0]) * Vh[0].conj()
                x[part] = np.concatenate([u.real, u.imag, v.real, v.imag])
        return x

    def vectors(self, x: np.ndarray, i: int) -> tuple[np.ndarray, np.ndarray]:
        """U and v of a full block."""
        r, c = self.blocks.blocks[i].size
        y = x[self.parts[i]]
        return y[:r] + 1j * y[r : 2 * r], y[2 * r : 2 * r + c] + 1j * y[2 * r + c :]

    def matrix(self, x: np.ndarray) -> np.ndarray:
        """Delta, (m, p)."""
        Delta = np.zeros(self.blocks.shape, complex)
        for i, (block, part) in enumerate(zip(self.blocks.blocks, self.parts, strict=True)):
            if part.stop - part.start <= 2:
                y = x[part]
                Delta[block.rows, block.columns] = (y[0] + 1j * sum(y[1:])) * np.eye(block.size[0])
            else:
                u, v = self.vectors(x, i)
                Delta[block.rows, block.columns] = np.outer(u, v.conj())
        return Delta

    def eigenvalue(self, at: Family, x: np.ndarray, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """The eigenvalue of M Delta / scale next to 1, less 1, as two real numbers, and its derivatives, (2, k)."""
        M, slope = at(float(x[0]) if self.shift else 0.0)
        Delta = self.matrix(x)
        found: Any = sla.eig(M @ Delta / scale, left=True, right=True)
        values, left, right = found
        k = int(np.argmin(np.abs(values - 1)))
        r, l = right[:, k], left[:, k].conj()
        l = l / (l @ r) / scale
        lM, rows = l @ M, np.zeros(self.count, complex)
        if self.shift:
            rows[0] = l @ slope @ Delta @ r
        for i, (block, part) in enumerate(zip(self.blocks.blocks, self.parts, strict=True)):
            a, b = lM[block.rows], r[block.columns]
            if part.stop - part.start <= 2:
                rows[part] = (a @ b) * np.array([1, 1j])[: part.stop - part.start]
            else:
                u, v = self.vectors(x, i)
                rows[part] = np.concatenate([np.kron([1, 1j], a) * (v.conj() @ b), np.kron([1, -1j], b) * (a @ u)])
        value = values[k] - 1
        return np.array([value.real, value.imag]), np.array([np.real(rows), np.imag(rows)])

    def room(self, x: np.ndarray) -> np.ndarray:
        """What is not negative for a Delta of size k."""
        k, room = x[-1], []
        for i, part in enumerate(self.parts):
            y = x[part]
            if len(y) == 1:
                room += [k - y[0], k + y[0]]
            elif len(y) == 2:
                room.append(k - y @ y / max(k, 1e-12))
            else:
                u, v = self.vectors(x, i)
                room += [k - np.vdot(u, u).real, k - np.vdot(v, v).real]
        return np.array(room)

    def room_slope(self, x: np.ndarray) -> np.ndarray:
        """Its derivatives."""
        k, rows = max(x[-1], 1e-12), []
        for i, part in enumerate(self.parts):
            y = x[part]
            if len(y) == 1:
                for sign in (-1.0, 1.0):
                    row = np.zeros(self.count)
                    row[part], row[-1] = sign, 1.0
                    rows.append(row)
            elif len(y) == 2:
                row = np.zeros(self.count)
                row[part], row[-1] = -2 * y / k, 1 + y @ y / k**2
                rows.append(row)
            else:
                ru = 2 * self.blocks.blocks[i].size[0]
                for some in (slice(0, ru), slice(ru, None)):
                    row, z = np.zeros(self.count), np.zeros(len(y))
                    z[some] = -2 * y[some]
                    row[part], row[-1] = z, 1.0
                    rows.append(row)
        return np.array(rows)


def checked(
    M: np.ndarray, blocks: Structure, Delta: np.ndarray, scalings: Scalings, at: float = 0.0
) -> Perturbation | None:
    """The perturbation, if it has the structure and makes I - M Delta singular by more than rounding.

    Beside a Delta that is `HUGE` times 1 / |D M D^-1| rounding errors of M alone make something singular.
    """
    if not np.isfinite(Delta).all():
        return None
    N = scaled(M, scalings.left, scalings.right)[0]
    size, off = float(np.linalg.norm(Delta, 2)), residual(N, Delta)
    good = 0 < size * np.linalg.norm(N, 2) < HUGE and off <= SINGULAR and blocks.misfit(Delta) <= REAL * size
    return Perturbation(Delta, size, residual(M, Delta), at) if good else None


def _candidates(N: np.ndarray, blocks: Structure) -> list[np.ndarray]:
    """Matrices of the structure that make I - N Delta singular, found without a minimisation."""
    found = []
    for Delta in starts(N, blocks):
        values = np.linalg.eigvals(N @ Delta)
        if blocks.is_complex:
            value = values[np.argmax(np.abs(values))]
        else:
            real = values[(np.abs(values.imag) <= REAL * np.abs(values).max())]
            value = real[np.argmax(np.abs(real))].real if real.size else 0.0
        if abs(value) > 0:
            found.append(Delta / value)
    return found


def _is_real(M: np.ndarray, blocks: Structure) -> bool:
    return not np.any(np.imag(M)) and all(block.kind == "real" for block in blocks.blocks)


def _has_all_corners(blocks: Structure) -> bool:
    return len(blocks.blocks) <= CORNERS and all(block.size == (1, 1) for block in blocks.blocks)


def starts(N: np.ndarray, blocks: Structure) -> list[np.ndarray]:
    """Matrices of size one: ends of power iterations, and for real numbers corners."""
    rng = np.random.default_rng(0)
    first = np.linalg.svd(N)[2][0].conj()
    m = N.shape[1]
    starts = [first] + [rng.normal(size=m) + 1j * rng.normal(size=m) for _ in range(STARTS - 1)]
    found = [_power(N, blocks, b) for b in starts]
    real = [i for i, block in enumerate(blocks.blocks) if block.kind == "real"]
    if not real:
        return found
    if len(real) <= (CORNERS if _is_real(N, blocks) else 4):
        corners = [(1.0, *rest) for rest in itertools.product((1.0, -1.0), repeat=len(real) - 1)]
    else:
        corners = np.sign(rng.normal(size=(RANDOM, len(real)))).tolist()
    if _is_real(N, blocks) or len(real) == len(blocks.blocks):
        corners = [*corners, *([-x for x in corner] for corner in corners)]
    base, more = found[0], []
    for corner in corners:
        Delta = base.copy()
        for i, q in zip(real, corner, strict=True):
            block = blocks.blocks[i]
            Delta[block.rows, block.columns] = q * np.eye(block.size[0])
        more.append(Delta)
    return found + more


def _power(N: np.ndarray, blocks: Structure, b: np.ndarray) -> np.ndarray:
    """The Delta of size one at which a power iteration ends or is stopped."""
    b = b / (np.linalg.norm(b) or 1.0)
    w, q = b, np.ones(len(blocks.blocks))
    Delta = np.zeros(blocks.shape, complex)
    last = 0.0
    for _ in range(POWERS):
        a = N @ b
        size = float(np.linalg.norm(a))
        a = a / (size or 1.0)
        w = N.conj().T @ _turned(blocks, q, w, a, ahead=False)
        w = w / (np.linalg.norm(w) or 1.0)
        for i, block in enumerate(blocks.blocks):
            if block.kind == "real":
                x, y = a[block.columns], w[block.rows]
                alpha = np.sign(q[i]) * np.linalg.norm(b[block.rows]) / (np.linalg.norm(x) or 1.0)
                q[i] = np.clip(alpha + np.vdot(x, y).real, -1, 1)
        b = _turned(blocks, q, a, w, ahead=True)
        b = b / (np.linalg.norm(b) or 1.0)
        if abs(size - last) <= SETTLED * size:
            break
        last = size
    for i, block in enumerate(blocks.blocks):
        x, y = a[block.columns], w[block.rows]
        if block.kind == "real":
            part = q[i] * np.eye(len(x))
        elif block.repeated:
            part = _phase(np.vdot(x, y)) * np.eye(len(x))
        else:
            norms = np.linalg.norm(x) * np.linalg.norm(y)
            part = np.outer(y, x.conj()) / norms if norms > 0 else np.eye(*block.size)
        Delta[block.rows, block.columns] = part
    return Delta


def _turned(blocks: Structure, q: np.ndarray, kept: np.ndarray, other: np.ndarray, *, ahead: bool) -> np.ndarray:
    """`kept` with every part as the block turns it towards `other`, on the other side of the block."""
    found = []
    for i, block in enumerate(blocks.blocks):
        here, there = (block.columns, block.rows) if ahead else (block.rows, block.columns)
        x, y = kept[here], other[there]
        if block.kind == "real":
            found.append(q[i] * x)
        elif block.repeated:
            found.append(_phase(np.vdot(x, y)) * x)
        else:
            found.append(np.linalg.norm(x) * y / (np.linalg.norm(y) or 1.0))
    return np.concatenate(found)


def _phase(a: Any) -> Any:
    return a / abs(a) if a != 0 else 1.0
