"""Loops with hold equivalents: polynomials of low degree in the parameters, and what they are off at most.

The polynomial of a hold equivalent (`systems.polynomialholds`) gives minors of the pencil whose degrees, as ranks
bound them, are far above what they need. Here p and the minors p det G_IJ are interpolated in Chebyshev's nodes of a
few degrees instead, and two bounds are added to the errors of what is built from them. For every piece of the unit
circle and every function f of the loop

    interpolation   in one parameter after the other 4 M r^-d / (r - 1), M a bound of |f| on an ellipse
    remainders      |f(Delta) - f(0)| <= M / (R - 1), M a bound of |f| for all remainders R times as large as theirs:
                    f(tau Delta) is a polynomial in tau (Cauchy's estimate of its coefficients)

and M comes from Hadamard's inequality, each piece of the parameters in coordinates V that make the loop's matrix nearly
diagonal in its middle. With f_d the interpolants, ||f|^2 - |f_d|^2| <= e (2 M + e), and by Cauchy and Binet

    h = sum_j (-1)^j g^2(k-j) sum |p det G_IJ|^2     over all minors of order j = 0 ... k = min(nw, nz).

Reference: Trefethen (2013), Approximation Theory and Approximation Practice, theorems 8.1, 8.2 and 15.2.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, ctx, fmpq, fmpq_mat

from synth.errors import ModelError
from synth.proof.pencils import Pencil

BITS = 128  # of bounds
MOST_MINORS = 70
ARCS, PIECES = 16, 4  # of half an ellipse, and of every other range
RATIOS = (1.5, 2.2, 3.0, 4.2, 6.5, 12.0, 25.0)  # r
LARGER = 10.0 ** np.arange(1, 13)  # R
SHAKEN = (0.0, 1e-2)
COLUMNS = (1.0, 10.0, 100.0, 1e3)  # times the largest entry of an input, for Hadamard's inequality
NEAR = 10.0 ** np.arange(-7.0, -1.0, 0.5)  # relative to what is typical, what an interpolant may be off
DEEPEST = 24  # degree
SIZE = 60_000  # of coefficients on a box
ROOM = 1 + 1e-9  # for rounding of what is computed in doubles from bounds above

Minor = tuple[tuple[int, ...], tuple[int, ...]]
Terms = dict[tuple[int, ...], list[tuple[tuple[int, int], fmpq]]]


class Off(NamedTuple):
    """Bounds on arcs of the unit circle, (functions, arcs)."""

    size: np.ndarray  # of |f| on the box, with remainders
    error: np.ndarray  # of |f - f_d|

    @property
    def squared(self) -> np.ndarray:
        """Of ||f|^2 - |f_d|^2|."""
        return self.error * (2 * self.size + self.error) * ROOM


def minors(pencil: Pencil, *, bordered: bool) -> list[Minor]:
    """Rows and columns of G: none first, which is p."""
    _, nw, nz = pencil.sizes
    found: list[Minor] = [((), ())]
    for k in range(1, min(nw, nz) + 1 if bordered else 1):
        found += itertools.product(itertools.combinations(range(nz), k), itertools.combinations(range(nw), k))
    return found


def is_within_reach(pencil: Pencil, *, bordered: bool) -> bool:
    """Whether there are few enough minors."""
    _, nw, nz = pencil.sizes
    return not bordered or math.comb(nw + nz, nw) <= MOST_MINORS


def degrees_for(pencil: Pencil, edges: Sequence[float], *, bordered: bool) -> tuple[int, ...]:
    """Degrees in the parameters with which interpolants are as near as fits."""
    table = _table(pencil, tuple(edges), bordered)
    for near in NEAR:
        found, lebesgue = [], 1.0
        for bounds in table.ellipses:
            fits = (d for d in range(1, DEEPEST) if (_interpolated(bounds, d) * lebesgue <= near * table.typical).all())
            found.append(next(fits, DEEPEST))
            lebesgue *= _lebesgue(found[-1])
        size = (pencil.order + 1) * math.prod(2 * d + 1 for d in found)
        if size <= SIZE and max(found) < DEEPEST:
            break
    return tuple(found)


def off(pencil: Pencil, edges: Sequence[float], degrees: Sequence[int], *, bordered: bool) -> Off:
    """What interpolants of these degrees are off on every piece between the edges.

    Raises
    ------
    ModelError : nothing bounds them.
    """
    table = _table(pencil, tuple(edges), bordered)
    error, lebesgue = table.remainders, 1.0
    for bounds, d in zip(table.ellipses, degrees, strict=True):
        error = error + lebesgue * _interpolated(bounds, d)
        lebesgue *= _lebesgue(d)
    if not (np.isfinite(error).all() and np.isfinite(table.size).all()):
        raise ModelError(
            "the loop's hold equivalents cannot be bounded around this box, near which something is singular; "
            "give the plant smaller ranges before c2d (split the box)"
        )
    return Off(table.size, error * ROOM)


def sampled(pencil: Pencil, nodes: Sequence[fmpq], degrees: Sequence[int], *, bordered: bool) -> np.ndarray:
    """The functions at Chebyshev's nodes and frequencies, (functions, *degrees + 1, nodes) acb.

    Raises
    ------
    ZeroDivisionError : a node could be a pole.
    """
    loop, wanted, found = _Loop(pencil), minors(pencil, bordered=bordered), []
    for t in itertools.product(*([acb(x) for x in _nodes(d)] for d in degrees)):
        G, B, C, D, factor = loop.reduced(t)
        I, at_t = acb_mat(fmpq_mat(pencil.order, pencil.order, _eye(pencil.order))), []
        for w in nodes:
            s = acb(0, arb(w))
            M = I * ((1 + s) / (1 - s)) - G
            p = M.det() * factor * (1 - s) ** pencil.order
            H = C * M.solve(B) + D if bordered else D
            at_t.append([p * _minor(H, *which) for which in wanted])
        found.append(np.array(at_t, object).T)
    shape = len(wanted), *(d + 1 for d in degrees), len(nodes)
    return np.moveaxis(np.array(found, object), 0, 1).reshape(shape)


def onto(degree: int, points: Sequence[fmpq]) -> arb_mat:
    """Values of an interpolant at points of [0, 1] from those at Chebyshev's nodes."""
    m, nodes = degree + 1, _nodes(degree)
    rows = []
    for x in points:
        T = _chebyshev(arb(2 * x - 1), degree)
        rows.append([
            sum((T[k] * _chebyshev(node, degree)[k] * (2 if k else 1) for k in range(m)), arb(0)) / m for node in nodes
        ])  # fmt: skip
    return arb_mat(rows)


class _Table(NamedTuple):
    """Bounds on arcs, (functions, arcs), all of them."""

    typical: np.ndarray  # no bound: the least |p| of some points, times the largest |f / p|
    size: np.ndarray
    remainders: np.ndarray
    ellipses: list[list[tuple[float, np.ndarray]]]  # of every parameter ratios and bounds


@lru_cache(maxsize=8)
def _table(pencil: Pencil, edges: tuple[float, ...], bordered: bool) -> _Table:
    with ctx.workprec(BITS):
        loop, wanted = _Loop(pencil), minors(pencil, bordered=bordered)
        angles = 2 * np.arctan(np.concatenate([[0.0], edges, [np.inf]]))
        z, radius = np.exp(0.5j * (angles[1:] + angles[:-1])), (angles[1:] - angles[:-1]) / 2 + 1e-12
        box = len(pencil.names)

        def bound(pieces: Iterator[list[acb]], larger: float) -> np.ndarray:
            found = np.zeros((len(wanted), len(z)))
            for t in pieces:
                try:
                    found = np.maximum(found, _hadamard(loop.reduced(t, larger), wanted, z, radius))
                except ZeroDivisionError:
                    return np.full_like(found, np.inf)
            return found

        size = bound(_pieces(box), 1.0)
        remainders = np.full_like(size, np.inf)
        for larger in LARGER:
            moved = bound(_pieces(box), float(larger)) / (larger - 1)
            better = moved < remainders
            remainders = np.minimum(remainders, moved)
            if not better.any():
                break
        ellipses = []
        for axis in range(box):
            found = []
            for r in RATIOS:
                M = bound(_pieces(box, axis, _arcs(r)), 0.0)
                if not np.isfinite(M).all():
                    break
                found.append((r, M))
            ellipses.append(found)
        points = itertools.product(*([acb(-1), acb(0), acb(1)] for _ in range(box)))
        values = np.array([_values(loop.reduced(t), wanted, z) for t in points])
        gain = (values[:, 1:] / values[:, :1]).max(axis=(0, 2), initial=0.0)
        typical = values[:, 0].min(axis=0) * np.append(1.0, gain)[:, None]
    return _Table(typical, size * ROOM, remainders * ROOM, ellipses)


class _Loop:
    """The pencil in t in [-1, 1], algebraic states and E solved for, in coordinates that balance it."""

    def __init__(self, pencil: Pencil):
        self.pencil, (n, nw, nz) = pencil, pencil.sizes
        self.mass, self.system = (_in_t(part, pencil) for part in (pencil.mass, pencil.system))
        used = np.zeros(n, bool)
        for M in pencil.mass.values():
            full = np.array([x != 0 for x in M.entries()]).reshape(n, n)
            used |= full.any(axis=0) | full.any(axis=1)
        self.x, self.a = np.flatnonzero(used).tolist(), np.flatnonzero(~used).tolist()
        if len(self.x) != pencil.order:
            raise ZeroDivisionError("the loop has states whose E has no full rank")
        self.w, self.z = list(range(n, n + nw)), list(range(n, n + nz))

    def reduced(self, t: Sequence[acb], larger: float = 0.0) -> tuple[acb_mat, acb_mat, acb_mat, acb_mat, acb]:
        """Matrices (G, B, C, D) of x+ = G x + B w, z = C x + D w, and det(z E - A) / det(z I - G).

        `larger` is how many times as large as they are remainders may be.

        Raises
        ------
        ZeroDivisionError : what is solved for could be singular.
        """
        n, nw, nz = self.pencil.sizes
        E, S = _valued(self.mass, t, n, n), _valued(self.system, t, n + nz, n + nw)
        if larger:
            for (i, j), off_by in self.pencil.off.items():
                S[i, j] = S[i, j] + acb(arb(0, off_by * larger), arb(0, off_by * larger))
        x, a, rows, columns = self.x, self.a, self.x + self.z, self.x + self.w
        M, factor = _part(S, rows, columns), acb(1)
        if a:
            own = _part(S, a, a)
            M = M - _part(S, rows, a) * own.solve(_part(S, a, columns))
            factor = own.det() * (-1) ** len(a)
        k, m = len(x), len(columns)
        top = _part(M, range(k), range(m))
        if not self._is_identity:
            own = _part(E, x, x)
            factor, top = factor * own.det(), own.solve(top)
        C, D = (_part(M, range(k, len(rows)), part) for part in (range(k), range(k, m)))
        return _part(top, range(k), range(k)), _part(top, range(k), range(k, m)), C, D, factor

    @cached_property
    def _is_identity(self) -> bool:
        (entries, *others) = self.mass.values()
        return not others and sorted(entries) == [((i, i), fmpq(1)) for i in self.x]


def _hadamard(loop: Any, wanted: Sequence[Minor], z: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Bounds of |f| on discs around z, (functions, arcs)."""
    G, B, C, D, factor = loop
    n = G.nrows()
    near, best = _middle(G), np.full((len(wanted), len(z)), np.inf)
    if not np.isfinite(near).all():
        return best
    noise = np.random.default_rng(0).normal(size=near.shape) / max(n, 1)
    size = np.abs(near).sum(axis=0) + np.abs(near).sum(axis=1)
    balanced = _balance(near)
    for shaken in SHAKEN if size.any() else ():
        V = balanced[:, None] * np.linalg.eig(near / balanced[:, None] * balanced + shaken * noise)[1]
        W = _exactly(V)
        try:
            back = W.inv()
        except ZeroDivisionError:
            continue
        G_, B_, C_, D_ = back * G * W, back * B, C * W, D
        own = np.array([complex(G_[i, i].real.mid(), G_[i, i].imag.mid()) for i in range(n)])
        reach = np.array([float((G_[i, i] - acb(own[i].real, own[i].imag)).abs_upper()) for i in range(n)])
        across, b, c, d = (_upper(M) for M in (G_, B_, C_, D_))
        rows = ((across - np.diag(np.diag(across))) ** 2).sum(axis=1)
        diagonal = np.abs(z[:, None] - own) + radius[:, None] + reach + 1e-14 * (1 + np.abs(own))  # (arcs, n)
        squares = diagonal**2 + rows
        unit = float(factor.abs_upper())
        for k, (I, J) in enumerate(wanted):
            if not I:
                found = np.sqrt(squares).prod(axis=1)
            else:
                found = np.full(len(z), np.inf)
                widths = np.maximum(b[:, J].max(axis=0), 1e-100)
                for times in COLUMNS:
                    beta = widths * times
                    inner = np.sqrt(squares + ((b[:, J] / beta) ** 2).sum(axis=1)).prod(axis=1)
                    outer = np.sqrt((c[list(I)] ** 2).sum(axis=1) + ((d[np.ix_(I, J)] / beta) ** 2).sum(axis=1)).prod()
                    found = np.minimum(found, inner * outer * beta.prod())
            best[k] = np.minimum(best[k], found * unit * ROOM)
    return np.where(np.isnan(best), np.inf, best)


def _values(loop: Any, wanted: Sequence[Minor], z: np.ndarray) -> np.ndarray:
    """|f| in doubles."""
    G, B, C, D = (_middle(M) for M in loop[:4])
    M = z[:, None, None] * np.eye(len(G)) - G
    p = np.linalg.det(M) * complex(loop[4].real.mid(), loop[4].imag.mid())
    H = C @ np.linalg.solve(M, np.broadcast_to(B, (len(z), *B.shape))) + D
    return np.abs([p * (np.linalg.det(H[:, I][:, :, J]) if I else 1.0) for I, J in wanted])


def _balance(M: np.ndarray) -> np.ndarray:
    """Powers of two that make rows and columns about as large as each other."""
    s, size = np.ones(len(M)), np.abs(M) - np.diag(np.abs(np.diag(M)))
    for _ in range(10):
        scaled = size / s[:, None] * s
        r, c = scaled.sum(axis=1), scaled.sum(axis=0)
        ratio = np.sqrt(np.divide(r, c, out=np.ones_like(r), where=(r > 0) & (c > 0)))
        s *= 2.0 ** np.round(np.log2(ratio))
    return s


def _interpolated(bounds: list[tuple[float, np.ndarray]], d: int) -> np.ndarray:
    """What an interpolant of degree d in one parameter is off, inf where no ellipse tells."""
    return np.min([4 * M * r**-d / (r - 1) for r, M in bounds], axis=0) * ROOM if bounds else np.array(np.inf)


def _lebesgue(d: int) -> float:
    return (1 + 2 / math.pi * math.log(d + 1)) * ROOM


def _nodes(d: int) -> list[arb]:
    """Chebyshev's, d + 1 of them in (-1, 1)."""
    return [(arb(2 * k + 1) / (2 * (d + 1)) * arb.pi()).cos() for k in range(d + 1)]


def _chebyshev(x: arb, degree: int) -> list[arb]:
    T = [arb(1), x]
    while len(T) <= degree:
        T.append(2 * x * T[-1] - T[-2])
    return T


def _arcs(r: float) -> list[acb]:
    """Rectangles that hold the upper half of an ellipse; the lower one has the conjugate values."""
    a, b = (r + 1 / r) / 2, (r - 1 / r) / 2
    ends = [k * math.pi / ARCS for k in range(ARCS + 1)]
    angles = [_between(low - 1e-9, high + 1e-9) for low, high in itertools.pairwise(ends)]
    return [acb(angle.cos() * a, angle.sin() * b) for angle in angles]


def _pieces(box: int, axis: int = -1, own: Sequence[acb] = ()) -> Iterator[list[acb]]:
    """Values of all parameters: pieces of their ranges, or those of one given."""
    cut = [acb(_between(*pair)) for pair in itertools.pairwise(np.linspace(-1, 1, PIECES + 1))]
    yield from (list(t) for t in itertools.product(*(own if k == axis else cut for k in range(box))))


def _in_t(parts: Mapping[tuple[int, ...], fmpq_mat], pencil: Pencil) -> Terms:
    """Coefficients of the powers of t, p = (low + high) / 2 + t (high - low) / 2, exactly."""
    terms: dict[tuple[int, ...], dict[tuple[int, int], fmpq]] = {}
    for powers, M in parts.items():
        places = itertools.product(range(M.nrows()), range(M.ncols()))
        terms[powers] = {at: M[at] for at in places if M[at] != 0}
    for axis, (low, high) in enumerate(zip(pencil.low, pencil.high, strict=True)):
        middle, half, found = (low + high) / 2, (high - low) / 2, {}
        for powers, entries in terms.items():
            for k in range(powers[axis] + 1):
                factor = math.comb(powers[axis], k) * middle ** (powers[axis] - k) * half**k
                to = found.setdefault((*powers[:axis], k, *powers[axis + 1 :]), {})
                for at, c in entries.items():
                    to[at] = to.get(at, fmpq(0)) + c * factor
        terms = found
    return {powers: [(at, c) for at, c in entries.items() if c != 0] for powers, entries in terms.items()}


def _valued(terms: Terms, t: Sequence[acb], rows: int, columns: int) -> acb_mat:
    powers: list[dict[int, acb]] = [{} for _ in t]
    M = acb_mat(rows, columns)
    for exponents, entries in terms.items():
        factor = acb(1)
        for known, x, k in zip(powers, t, exponents, strict=True):
            if k and k not in known:
                known[k] = x**k
            factor = factor * known[k] if k else factor
        for at, c in entries:
            M[at] = M[at] + factor * c
    return M


def _minor(H: acb_mat, rows: Sequence[int], columns: Sequence[int]) -> acb:
    return _part(H, rows, columns).det() if rows else acb(1)


def _part(M: acb_mat, rows: Sequence[int], columns: Sequence[int]) -> acb_mat:
    return acb_mat(len(rows), len(columns), [M[i, j] for i in rows for j in columns])


def _eye(n: int) -> list[fmpq]:
    return [fmpq(int(i == j)) for i in range(n) for j in range(n)]


def _between(low: float, high: float) -> arb:
    return arb(float(low)).union(arb(float(high)))


def _exactly(M: np.ndarray) -> acb_mat:
    return acb_mat(M.shape[0], M.shape[1], [acb(float(x.real), float(x.imag)) for x in M.astype(complex).flat])


def _middle(M: acb_mat) -> np.ndarray:
    found = [complex(float(x.real.mid()), float(x.imag.mid())) for x in M.entries()]
    return np.array(found, complex).reshape(M.nrows(), M.ncols())


def _upper(M: acb_mat) -> np.ndarray:
    return np.array([float(x.abs_upper()) for x in M.entries()]).reshape(M.nrows(), M.ncols()) * ROOM
