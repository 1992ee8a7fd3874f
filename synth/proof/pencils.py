"""Polynomials of an uncertain closed loop in u = omega^2 and its parameters, in balls from exact data.

The loop E x+ = A x + B w, z = C x + D w has the bordered pencil [[s E - A, -B], [C, D]]; its minors are polynomials in
s and in the parameters, and those that hold all of s E - A are

    p   = det(s E - A)        and        N_ij = p G_ij,    G = C (s E - A)^-1 B + D.

In discrete time s = (z - 1)/(z + 1), as everywhere in this package, and everything is multiplied by (1 - s)^n.

Degrees are bounded by ranks, exactly: let V_k be the space that the columns of all coefficients of the k-th and higher
powers of a variable span. In coordinates adapted to V_1 > V_2 > ... the rows have the degrees by which they are in
these spaces, so no minor has a degree above dim V_1 + dim V_2 + ...; and the same of the rows' spaces. An inertia of a
body counts once, then, however many entries of the mass matrix it is in.

Polynomials are evaluated at rational nodes, as many as their degrees need, where nothing is rounded but in balls.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, fmpq, fmpq_mat, fmpq_poly

from synth.errors import ModelError
from synth.systems.parameters import Expression, Parameter, Remainder
from synth.systems.uncertain import UncertainSystem

Exponents = tuple[int, ...]
Point = Sequence[fmpq]  # a value for each parameter


@dataclass(frozen=True, eq=False)
class Pencil:
    """A loop in exact rationals, by monomials of its parameters."""

    names: tuple[str, ...]
    low: tuple[fmpq, ...]
    high: tuple[fmpq, ...]
    nominal: tuple[fmpq, ...]
    mass: Mapping[Exponents, fmpq_mat]  # (n, n) coefficients of E
    system: Mapping[Exponents, fmpq_mat]  # (n + nz, n + nw) coefficients of [A, B; C, D]
    sizes: tuple[int, int, int]  # n, nw, nz
    discrete: bool
    off: Mapping[tuple[int, int], float] = field(default_factory=dict)  # what entries of [A, B; C, D] may be off

    @classmethod
    def of(cls, G: UncertainSystem, box: Sequence[Parameter], scale: Fraction = Fraction(1)) -> Pencil:
        """Of a loop and the box of its parameters, made larger about the nominal ones by `scale`."""
        names = [p.name for p in box]
        nominal = [Fraction(p.nominal) for p in box]
        low, high = (
            [_rational(x + scale * (Fraction(end) - x)) for x, end in zip(nominal, values, strict=True)]
            for values in ([p.low for p in box], [p.high for p in box])
        )
        S = np.block([[G.A, G.B], [G.C, G.D]])
        parts = _by_monomial(G.E, names), _by_monomial(S, names)
        sizes = (G.n, G.nu, G.ny)
        ends = dict(zip(names, zip(low, high, strict=True), strict=True))
        off = {at: size for at, entry in np.ndenumerate(S) if (size := _off(entry, ends))}
        if any(_off(entry, ends) for entry in G.E.flat):
            raise ModelError("E has the remainder of a hold equivalent, which belongs to A; connect systems")
        return cls(tuple(names), tuple(low), tuple(high), tuple(map(_rational, nominal)), *parts, sizes, G.discrete,
                   off)  # fmt: skip

    @cached_property
    def order(self) -> int:
        """A bound on the degree in s of every minor: the number of states that move."""
        return _filtered(list(self.mass.values())) if self.mass else 0

    def degrees(self, *, bordered: bool) -> tuple[int, ...]:
        """Bounds on the degrees in each parameter, of p alone or of N too."""
        n = self.sizes[0]
        wide = {m: M if bordered else _block(M, n, n) for m, M in self.system.items()}
        tall = {m: _padded(M, *_shape(wide, n)) for m, M in self.mass.items()}
        both = [(m, M) for part in (wide, tall) for m, M in part.items()]
        found = []
        for i in range(len(self.names)):
            highest = max((m[i] for m, _ in both), default=0)
            powers = ([M for m, M in both if m[i] >= k] for k in range(1, highest + 1))
            ranks = [(_rank(Ms), _rank([M.transpose() for M in Ms])) for Ms in powers]
            found.append(min(sum(r[0] for r in ranks), sum(r[1] for r in ranks)))
        return tuple(found)

    def at(self, point: Point) -> tuple[fmpq_mat, fmpq_mat]:
        """E and [A, B; C, D] at a point, exactly."""
        n, nw, nz = self.sizes
        return _valued(self.mass, point, n, n), _valued(self.system, point, n + nz, n + nw)

    def place(self, fractions: Sequence[fmpq]) -> list[fmpq]:
        """The point of the box at these fractions of its ranges."""
        return [a + t * (b - a) for a, b, t in zip(self.low, self.high, fractions, strict=True)]

    def is_stable_at(self, point: Point) -> bool:
        """Whether every pole is in the open left half plane or unit disk, exactly (Routh's scheme)."""
        coefficients = self.characteristic(point)
        return coefficients is not None and is_hurwitz(coefficients)

    def characteristic(self, point: Point) -> list[fmpq] | None:
        """Coefficients of p in s, the highest first; None where the highest is zero."""
        E, S = self.at(point)
        n, A = self.order, _block(S, self.sizes[0], self.sizes[0])
        nodes = [fmpq(-k) for k in range(n + 1)]
        values = []
        for s in nodes:
            z, factor = ((1 + s) / (1 - s), (1 - s) ** n) if self.discrete else (s, fmpq(1))
            values.append((z * E - A).det() * factor)
        powers = fmpq_mat(n + 1, n + 1, [s**k for s in nodes for k in range(n, -1, -1)])
        found = powers.solve(fmpq_mat(n + 1, 1, values)).entries()
        return found if found[0] != 0 else None

    def worst_pole(self, point: Point) -> complex:
        """The pole that is farthest right, or farthest out in discrete time, enclosed and then rounded."""
        coefficients = self.characteristic(point)
        if coefficients is None:
            return complex(np.inf)
        found: Any = fmpq_poly(coefficients[::-1]).complex_roots()
        roots = [complex(root) for root, _ in found]
        poles = [(1 + s) / (1 - s) if s != 1 else complex(np.inf) for s in roots] if self.discrete else roots
        return max(poles, key=abs if self.discrete else lambda pole: pole.real)

    def is_below_at_rest(self, point: Point, level: fmpq) -> bool:
        """Whether the gain at s = 0 is below the level at a stable point, exactly."""
        n, nw, nz = self.sizes
        E, S = self.at(point)
        A, B = _block(S, n, n), _block(S, n, nw, 0, n)
        M = E - A if self.discrete else -1 * A
        G = _block(S, nz, nw, n, n) + (_block(S, nz, n, n) * M.solve(B) if n else fmpq_mat(nz, nw))
        left = fmpq_mat(nw, nw, [level**2 * (i == j) for i in range(nw) for j in range(nw)]) - G.transpose() * G
        return all(_block(left, k, k).det() > 0 for k in range(1, nw + 1))

    def response(self, point: Point, w: fmpq) -> tuple[acb, acb_mat]:
        """P and N at s = j w in balls.

        Raises
        ------
        ZeroDivisionError : the point could be a pole.
        """
        E, S = self.at(point)
        balls = arb_mat(S)
        for at, size in self.off.items():
            balls[at] = balls[at] + arb(0, size)
        return self._response(arb_mat(E), balls, w)

    def _response(self, E: arb_mat, S: arb_mat, w: fmpq) -> tuple[acb, acb_mat]:
        n, nw, nz = self.sizes
        z, factor = acb(0, arb(w)), acb(1)
        if self.discrete:
            z, factor = (1 + z) / (1 - z), (1 - z) ** self.order
        A, B, C, D = (acb_mat(_block(S, *place)) for place in ((n, n), (n, nw, 0, n), (nz, n, n), (nz, nw, n, n)))
        M = acb_mat(E) * z - A
        p = M.det() * factor if n else acb(1)
        return p, ((C * M.solve(B) if n else acb_mat(nz, nw)) + D) * p

    def sampled(self, nodes: Sequence[fmpq], degrees: Sequence[int], *, bordered: bool) -> np.ndarray:
        """p, and the entries of N, on the grid of parameters and frequencies: (functions, *degrees + 1, nodes) acb."""
        grid = [[fmpq(i, k) if k else fmpq(0) for i in range(k + 1)] for k in degrees]
        rows = []
        for fractions in itertools.product(*grid):
            E, S = (arb_mat(M) for M in self.at(self.place(fractions)))
            if bordered:
                values = [self._response(E, S, w) for w in nodes]
                rows.append([[p, *N.entries()] for p, N in values])
            else:
                rows.append([[self._determinant(E, S, w)] for w in nodes])
        functions = len(rows[0][0])
        found = np.empty((len(rows), len(nodes), functions), object)
        for i, j in np.ndindex(found.shape[:2]):
            found[i, j] = rows[i][j]
        return np.moveaxis(found, -1, 0).reshape(functions, *(k + 1 for k in degrees), len(nodes))

    def _determinant(self, E: arb_mat, S: arb_mat, w: fmpq) -> acb:
        n = self.sizes[0]
        z, factor = acb(0, arb(w)), acb(1)
        if self.discrete:
            z, factor = (1 + z) / (1 - z), (1 - z) ** self.order
        return (acb_mat(E) * z - acb_mat(_block(S, n, n))).det() * factor if n else acb(1)


def is_hurwitz(coefficients: Sequence[fmpq]) -> bool:
    """Whether all roots of a polynomial, the highest coefficient first, are in the open left half plane."""
    upper, lower = list(coefficients[0::2]), list(coefficients[1::2])
    while lower:
        if not lower[0] * upper[0] > 0:
            return False
        ratio = upper[0] / lower[0]
        padded = [*lower[1:], *([fmpq(0)] * (len(upper) - len(lower)))]
        upper, lower = lower, [a - ratio * b for a, b in zip(upper[1:], padded, strict=True)]
    return True


def along(values: np.ndarray, axis: int, Q: fmpq_mat | arb_mat) -> np.ndarray:
    """An array of balls multiplied by a matrix along one of its axes."""
    moved = np.moveaxis(values, axis, 0)
    X = arb_mat(len(moved), moved[0].size, moved.ravel().tolist())
    Y = np.array((arb_mat(Q) * X).entries(), object)
    return np.moveaxis(Y.reshape(Q.nrows(), *moved.shape[1:]), 0, axis)


def bernstein_of(nodes: Sequence[tuple[fmpq, fmpq]], degree: int) -> fmpq_mat:
    """Values of the Bernstein polynomials at nodes (a, b), in the homogeneous form C(m, j) a^(m-j) b^j."""
    return fmpq_mat(
        len(nodes), degree + 1,
        [math.comb(degree, j) * a ** (degree - j) * b**j for a, b in nodes for j in range(degree + 1)],
    )  # fmt: skip


def on_unit(degree: int) -> list[tuple[fmpq, fmpq]]:
    """Equidistant nodes of [0, 1] for a degree, in homogeneous form."""
    return [(1 - fmpq(i, degree), fmpq(i, degree)) for i in range(degree + 1)] if degree else [(fmpq(1), fmpq(0))]


def _fraction(x: fmpq) -> Any:
    return Fraction(int(x.p), int(x.q))


def _rational(x: Fraction) -> fmpq:
    return fmpq(x.numerator, x.denominator)


def rational(x: float) -> fmpq:
    """A double, exactly."""
    return fmpq(*float(x).as_integer_ratio())


def _by_monomial(M: np.ndarray, names: Sequence[str]) -> dict[Exponents, fmpq_mat]:
    """Coefficient matrices by exponents."""
    found: dict[Exponents, fmpq_mat] = {}
    at = {name: k for k, name in enumerate(names)}
    for (i, j), entry in np.ndenumerate(M):
        for monomial, c in entry.terms.items():
            if any(isinstance(entry.parameters[name], Remainder) for name, _ in monomial):  # see `_off`
                continue
            exponents = [0] * len(names)
            for name, k in monomial:
                exponents[at[name]] = k
            part = found.setdefault(tuple(exponents), fmpq_mat(*M.shape))
            part[i, j] = _rational(c)
    return found


def _off(entry: Expression, box: Mapping[str, tuple[fmpq, fmpq]]) -> float:
    """A bound of the terms that have remainders, over the box.

    Raises
    ------
    ModelError : a term has a name that is neither in the box nor a remainder, or the box is wider than a hold's.
    """
    held = {name: p for name, p in entry.parameters.items() if isinstance(p, Remainder)}
    ends = {**{name: (rational(p.low), rational(p.high)) for name, p in held.items()}, **box}
    for hold in {p.hold for p in held.values()}:
        hold.check("the range", {n: (_fraction(a), _fraction(b)) for n, (a, b) in box.items()})
    total = fmpq(0)
    for monomial, c in entry.terms.items():
        if any(name in held for name, _ in monomial):
            total += math.prod((max(abs(x) for x in ends[name]) ** k for name, k in monomial), start=abs(_rational(c)))
    return float(np.nextafter(float(arb(total).upper()), np.inf)) if total else 0.0


def _valued(parts: Mapping[Exponents, fmpq_mat], point: Point, p: int, q: int) -> fmpq_mat:
    total = fmpq_mat(p, q)
    for exponents, M in parts.items():
        total = total + M * math.prod((x**k for x, k in zip(point, exponents, strict=True) if k), start=fmpq(1))
    return total


def _block(M: Any, p: int, q: int, row: int = 0, column: int = 0) -> Any:
    """A block of a matrix of flint."""
    return type(M)(p, q, [M[row + i, column + j] for i in range(p) for j in range(q)])


def _shape(parts: Mapping[Exponents, fmpq_mat], n: int) -> tuple[int, int]:
    return next(((M.nrows(), M.ncols()) for M in parts.values()), (n, n))


def _padded(M: fmpq_mat, p: int, q: int) -> fmpq_mat:
    found = fmpq_mat(p, q)
    for i in range(M.nrows()):
        for j in range(M.ncols()):
            found[i, j] = M[i, j]
    return found


def _rank(Ms: Sequence[fmpq_mat]) -> int:
    """Dimension of the space that all columns of all matrices span."""
    if not Ms or not Ms[0].nrows():
        return 0
    rows = [[e for M in Ms for e in M.tolist()[i]] for i in range(Ms[0].nrows())]
    return fmpq_mat(len(rows), len(rows[0]), [e for row in rows for e in row]).rank()


def _filtered(Ms: Sequence[fmpq_mat]) -> int:
    return min(_rank(Ms), _rank([M.transpose() for M in Ms]))
