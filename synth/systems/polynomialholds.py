"""Hold equivalents of uncertain plants whose exponential is no polynomial in their parameters.

    x+ = x + Phi(p) v,    E(p) v = A(p) x + B(p) u,    Phi(p) = int_0^dt exp(E^-1 A s) ds

is exact; E, A and B stay as they are and only Phi is replaced, by a polynomial with dyadic coefficients. What it is off
is bounded in balls (Arb) for every point of the box, entry by entry:

1. In one parameter after the other the interpolant of degree d in Chebyshev's nodes is off by at most
   4 M r^-d / (r - 1), M a bound of Phi on the ellipse with foci at the ends of the range and half axes of sum r, the
   others in their ranges; from one to the next comes the Lebesgue constant 1 + (2/pi) log(d + 1).
2. Ellipse and ranges are cut in pieces. On each |exp(G s)| <= exp(s mu) in the largest row sum, G = V^-1 E^-1 A V, mu
   the largest of Re G_ii plus the sum of the other |G_ij| of a row; V are eigenvectors in the middle. E has no singular
   point in the ellipse, which pieces of it tell.
3. The interpolant's Chebyshev coefficients are enclosed, and how far those of the polynomial are from them adds up.

References: Trefethen (2013), Approximation Theory and Approximation Practice, theorems 8.1, 8.2 and 15.2; Soederlind
(2006), BIT 46, 631 (logarithmic norms).
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, arb_mat, ctx, fmpq

from synth.errors import ModelError
from synth.systems.parameters import MOST_POWERS, Expression, Hold, Parameter, Remainder, as_expression, joined
from synth.systems.realization import Matrices, state_scales

BITS = 128
ARCS, PIECES, CELLS = 8, 4, 8  # of half an ellipse, of every other range, of an ellipse in each direction
RATIOS = (1.2, 1.5, 2.0, 2.8, 4.0, 6.0, 10.0, 20.0, 50.0)  # r
DEEPEST = 40  # degree of an interpolant
INDEPENDENT = 1e3  # condition of eigenvectors below which none are looked for beside
SHAKEN = (0.0, 1e-3, 1e-2, 1e-1)  # of E^-1 A dt, where eigenvectors are dependent
MOST_NODES = 20_000
WIDEST = 1e3  # times what is allowed, of an interpolant from which on it is not tried
SLACK = 1 + 1e-6  # of what is claimed, so that it is proved again
ROOM = 1 + 1e-9  # for rounding of what is computed in doubles from bounds above

Powers = tuple[int, ...]


class Plant:
    """E and A of a plant on the box of their parameters, for values and balls of t in [-1, 1]."""

    def __init__(self, hold: Hold):
        self.box, self.n, self.dt = hold.box, len(hold.A), float(hold.dt)
        self.E, self.A = (_by_powers(M, [p.name for p in hold.box]) for M in (hold.E, hold.A))
        self.ends = [(_exact(p.low), _exact(p.high)) for p in hold.box]
        self.in_mass = [any(k[i] for k in self.E) for i in range(len(hold.box))]
        self.scales = self._scales()

    def at(self, t: Sequence[Any]) -> tuple[acb_mat, acb_mat]:
        """E and A."""
        p = [acb((a + b) / 2) + x * acb((b - a) / 2) for (a, b), x in zip(self.ends, t, strict=True)]
        return _valued(self.E, p, self.n), _valued(self.A, p, self.n)

    def slope(self, t: Sequence[Any]) -> acb_mat:
        """E^-1 A in coordinates that balance it, times dt."""
        E, A = self.at(t)
        F = E.solve(A) * acb(arb(self.dt))
        s = self.scales
        return acb_mat(self.n, self.n, [F[i, j] * (s[j] / s[i]) for i in range(self.n) for j in range(self.n)])

    def held(self, t: Sequence[Any]) -> np.ndarray:
        """Phi / dt in those coordinates, (n, n) arb."""
        n, F = self.n, self.slope(t)
        M = acb_mat(2 * n, 2 * n)
        for i in range(n):
            M[i, n + i] = 1
            for j in range(n):
                M[i, j] = F[i, j]
        X = M.exp()
        return np.array([[X[i, n + j].real for j in range(n)] for i in range(n)], object)

    def _scales(self) -> np.ndarray:
        """Powers of two."""
        E, A = (_middle(M) for M in self.at([acb(0)] * len(self.box)))
        F, I = np.linalg.solve(E, A).real, np.eye(self.n)
        return state_scales(Matrices(F, I * 0, I * 0, I * 0)) if F.any() else np.ones(self.n)


def polynomial_hold(E: np.ndarray, A: np.ndarray, dt: float, tol: float) -> np.ndarray:
    """Phi as polynomials with remainders, (n, n) expressions; each entry is off by about `tol` of its size at most.

    Raises
    ------
    ModelError : no polynomial that fits is so near.
    """
    hold = as_hold(E, A, dt, tol)
    plant = Plant(hold)
    with ctx.workprec(BITS):
        degrees, off = _degrees(plant, tol)
        found = _coefficients(plant, degrees)
        middle = np.array([float(c.mid()) for c in found.flat]).reshape(found.shape)
        kept = _without_small(middle, tol / 2)
        error = (_farthest(found, kept) + off) * SLACK
    used = [int(k.max(initial=0)) for k in np.nonzero(kept.any(axis=(-1, -2)))]
    if max(used) > MOST_POWERS:
        raise _refused(hold, f"degree {max(used)} in {hold.box[int(np.argmax(used))].name!r}", tol)
    kept = kept[tuple(slice(k + 1) for k in used)]
    s, n = plant.scales.tolist(), plant.n
    Phi = np.empty((n, n), object)
    polynomials = _polynomials(kept, hold.box)
    for i, j in np.ndindex(n, n):
        unit = Fraction(dt) * Fraction(s[i] / s[j])
        size = float(np.nextafter(float(Fraction(float(error[i, j])) * unit), np.inf))
        off_by = Remainder(f"{hold.name}[{i},{j}]", 0.0, -size, size, hold, (i, j))
        Phi[i, j] = polynomials[i, j] * as_expression("unit", unit) + _symbol(off_by)
    return Phi


def errors(hold: Hold, Phi: Mapping[tuple[int, int], Expression]) -> np.ndarray:
    """Proved bounds of |Phi - polynomial| on the box of a hold, (n, n), inf where nothing is proved."""
    plant, names = Plant(hold), [p.name for p in hold.box]
    s, n = plant.scales.tolist(), plant.n
    highest = [max((dict(m).get(name, 0) for x in Phi.values() for m in x.terms), default=0) for name in names]
    scaled = np.zeros((*(k + 1 for k in highest), n, n), object)
    for (i, j), x in Phi.items():
        unit = Fraction(hold.dt) * Fraction(s[i] / s[j])
        for m, c in x.terms.items():
            scaled[(*(dict(m).get(name, 0) for name in names), i, j)] = _exact(c / unit)
    with ctx.workprec(BITS):
        for axis, p in enumerate(hold.box):
            scaled = _along(_chebyshev_of_powers(p, highest[axis]), scaled, axis)
        degrees, off = _degrees(plant, hold.tol, highest)
        found = _coefficients(plant, degrees)
        wanted = np.full(found.shape, fmpq(0), object)
        wanted[tuple(slice(k + 1) for k in highest)] = scaled
        error = _farthest(found, wanted) + off
    return error * float(hold.dt) * (plant.scales[:, None] / plant.scales) * ROOM


def as_hold(E: np.ndarray, A: np.ndarray, dt: float, tol: float) -> Hold:
    """The plant of a hold equivalent, with a name that is made of all of it."""
    found = joined(*(entry.parameters for M in (E, A) for entry in M.flat))
    box = tuple(found[name] for name in sorted(found))
    told = repr([sorted(x.terms.items()) for M in (E, A) for x in M.flat] + [float(dt), float(tol)] + [*map(repr, box)])
    return Hold(f"hold {hashlib.sha256(told.encode()).hexdigest()[:12]}", E, A, float(dt), float(tol), box)


def _degrees(plant: Plant, tol: float, least: Sequence[int] = ()) -> tuple[list[int], np.ndarray]:
    """Degrees of an interpolant, and what it is off at most, (n, n); a hundredth of `tol` where that can be had."""
    p = len(plant.box)
    bounds = [_on_ellipses(plant, axis) for axis in range(p)]
    allowed = max(tol, 1e-12) / (100 * p)
    chosen, off, lebesgue = [], np.zeros((plant.n, plant.n)), 1.0
    for axis, by_ratio in enumerate(bounds):
        d, error = 0, np.full_like(off, np.inf)
        for d in range(least[axis] if least else 1, DEEPEST + 1):
            error = np.min([4 * M * r**-d / (r - 1) for r, M in by_ratio], axis=0, initial=np.inf) * ROOM
            if (error * lebesgue <= allowed).all():
                break
        off, lebesgue = off + lebesgue * error, lebesgue * (1 + 2 / math.pi * math.log(d + 1)) * ROOM
        chosen.append(d)
    nodes = math.prod(d + 1 for d in chosen)
    if nodes > MOST_NODES or not (off <= max(tol, 1e-9) * WIDEST).all():
        name = plant.box[int(np.argmax(chosen))].name
        raise _refused(plant, f"degrees {chosen}, and {DEEPEST} at most, {MOST_NODES} nodes in all ({name!r})", tol)
    return chosen, off * ROOM


def _refused(hold: Any, what: str, tol: float) -> ModelError:
    ranges = ", ".join(f"{p.name} in [{p.low:g}, {p.high:g}]" for p in hold.box)
    return ModelError(
        f"method is 'zoh' and dt is {hold.dt:g} s; "
        f"a polynomial of the hold equivalent within {tol:g} for all {ranges} would need {what}; pass smaller ranges "
        "(split the box), a shorter dt, a larger tol, or method='tustin'"
    )


def _on_ellipses(plant: Plant, axis: int) -> list[tuple[float, np.ndarray]]:
    """Ratios r with bounds of the entries of Phi / dt on their ellipses, others in their ranges."""
    found = []
    for r in RATIOS:
        a, b = (r + 1 / r) / 2, (r - 1 / r) / 2
        if plant.in_mass[axis] and not _regular(plant, axis, a, b):
            break
        M = np.zeros((plant.n, plant.n))
        for t in _pieces(plant, axis, _arcs(a, b)):
            bound = _bound(plant, t)
            if bound is None:
                return found
            M = np.maximum(M, bound)
        found.append((r, M * ROOM))
    return found


def _arcs(a: float, b: float) -> list[acb]:
    """Rectangles that hold the upper half of an ellipse; the lower one has the conjugate values."""
    ends = [k * math.pi / ARCS for k in range(ARCS + 1)]
    found = []
    for low, high in itertools.pairwise(ends):
        angle = _between(low * (1 - 1e-9) - 1e-9, high * (1 + 1e-9) + 1e-9)
        found.append(acb(a * angle.cos(), b * angle.sin()))
    return found


def _regular(plant: Plant, axis: int, a: float, b: float) -> bool:
    """Whether E is proved to have no singular point in an ellipse, the others in their ranges."""
    a, b = a * ROOM, b * ROOM
    x, y = np.linspace(-a, a, CELLS + 1), np.linspace(0, b, CELLS // 2 + 1)
    cells = [
        acb(_between(*i), _between(*j))
        for i in itertools.pairwise(x)
        for j in itertools.pairwise(y)
        if min(abs(i[0]), abs(i[1]), key=lambda v: 0.0 if i[0] * i[1] <= 0 else v) ** 2 / a**2 + j[0] ** 2 / b**2
        <= 1.01
    ]
    for t in _pieces(plant, axis, cells, mass_only=True):
        E, _ = plant.at(t)
        near = _middle(E)
        if not np.isfinite(near).all() or np.linalg.matrix_rank(near) < plant.n:
            return False
        if (_exactly(np.linalg.inv(near)) * E).det().contains(0):
            return False
    return True


def _pieces(plant: Plant, axis: int, own: Sequence[acb], *, mass_only: bool = False) -> Iterator[list[acb]]:
    """Values of all parameters: those of one given, of the others pieces of their ranges."""
    ends = np.linspace(-1, 1, PIECES + 1)
    cut = [acb(_between(*pair)) for pair in itertools.pairwise(ends)]
    choices = [
        own if k == axis else [acb(_between(-1, 1))] if mass_only and not plant.in_mass[k] else cut
        for k in range(len(plant.box))
    ]
    yield from (list(t) for t in itertools.product(*choices))


def _bound(plant: Plant, t: Sequence[acb]) -> np.ndarray | None:
    """A bound of |Phi / dt| on a piece, (n, n); None where E could be singular."""
    try:
        F = plant.slope(t)
    except ZeroDivisionError:
        return None
    near, best = _middle(F), None
    if not np.isfinite(near).all():
        return None
    rng = np.random.default_rng(0)
    noise = rng.normal(size=near.shape) / plant.n
    for shaken in SHAKEN:
        V = np.linalg.eig(near + shaken * noise)[1]
        dependent = np.linalg.cond(V)
        if dependent > 1e10:
            continue
        W = _exactly(V)
        try:
            back = W.inv()
        except ZeroDivisionError:
            continue
        G = back * F * W
        size = _upper(G)
        middle = np.array([float(G[i, i].real.upper()) for i in range(plant.n)])
        mu = (middle + size.sum(axis=1) - np.diag(size)).max() * ROOM
        if mu < 600:
            M = _upper(W).sum(axis=1)[:, None] * _upper(back).max(axis=0) * max(1.0, math.exp(mu)) * ROOM
            best = M if best is None else np.minimum(best, M)
        if dependent < INDEPENDENT:
            break
    return best


def _coefficients(plant: Plant, degrees: Sequence[int]) -> np.ndarray:
    """Chebyshev coefficients of the interpolant of Phi / dt, (*degrees + 1, n, n) arb."""
    nodes = [[((arb(2 * k + 1) / (2 * (d + 1))) * arb.pi()).cos() for k in range(d + 1)] for d in degrees]
    values = [plant.held([acb(x) for x in t]) for t in itertools.product(*nodes)]
    found = np.array(values, object).reshape(*(d + 1 for d in degrees), plant.n, plant.n)
    for axis, d in enumerate(degrees):
        m = d + 1
        angle = [[(arb(i * (2 * k + 1)) / (2 * m) * arb.pi()).cos() * arb(2 if i else 1) / m for k in range(m)]
                 for i in range(m)]  # fmt: skip
        moved = np.moveaxis(found, axis, 0)
        flat = arb_mat(m, moved[0].size, moved.ravel().tolist())
        Y = np.array((arb_mat(angle) * flat).entries(), object).reshape(moved.shape)
        found = np.moveaxis(Y, 0, axis)
    return found


def _without_small(c: np.ndarray, allowed: float) -> np.ndarray:
    """Coefficients of which the smallest of every entry are zero, whose sizes add up to `allowed` at most."""
    flat = c.reshape(-1, *c.shape[-2:]).copy()
    order = np.argsort(np.abs(flat), axis=0)
    sums = np.cumsum(np.take_along_axis(np.abs(flat), order, axis=0), axis=0)
    small = np.zeros(flat.shape, bool)
    np.put_along_axis(small, order, sums <= allowed, axis=0)
    flat[small] = 0.0
    return flat.reshape(c.shape)


def _farthest(found: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The sum of |c - c'| over all coefficients of an entry, from above."""
    off = np.array([float(abs(c - _ball(d)).upper()) for c, d in zip(found.flat, wanted.flat, strict=True)])
    return off.reshape(-1, *found.shape[-2:]).sum(axis=0) * ROOM + 1e-300


def _ball(x: Any) -> arb:
    return arb(x) if isinstance(x, fmpq) else arb(float(x))


def _polynomials(c: np.ndarray, box: Sequence[Parameter]) -> np.ndarray:
    """Polynomials in the parameters of dyadic Chebyshev coefficients, (n, n) expressions."""
    exact = np.array([_exact(x) for x in c.flat], object).reshape(c.shape)
    for axis, p in enumerate(box):
        exact = _along(_powers_of_chebyshev(p, c.shape[axis] - 1), exact, axis)
    found, known = np.empty(c.shape[-2:], object), {p.name: p for p in box}
    for i, j in np.ndindex(found.shape):
        terms = {}
        for k in np.ndindex(exact.shape[:-2]):
            if (x := exact[(*k, i, j)]) != 0:
                monomial = tuple((p.name, m) for p, m in zip(box, k, strict=True) if m)
                terms[tuple(sorted(monomial))] = Fraction(int(x.p), int(x.q))  # pyright: ignore[reportAttributeAccessIssue]
        found[i, j] = Expression(terms, known)
    return found


def _along(Q: list[list[fmpq]], X: np.ndarray, axis: int) -> np.ndarray:
    """Q times an array along an axis, exactly."""
    from flint import fmpq_mat

    moved = np.moveaxis(X, axis, 0)
    flat = fmpq_mat(len(moved), moved[0].size, [fmpq(0) + x for x in moved.ravel().tolist()])
    Y = np.array((fmpq_mat(Q) * flat).entries(), object).reshape(len(Q), *moved.shape[1:])
    return np.moveaxis(Y, 0, axis)


def _powers_of_chebyshev(p: Parameter, degree: int) -> list[list[fmpq]]:
    """Row k: what T_0, T_1, ... of (2 p - low - high) / (high - low) have of p^k."""
    a, b = _exact(p.low), _exact(p.high)
    shift, slope = -(a + b) / (b - a), 2 / (b - a)
    T = [[fmpq(1)], [shift, slope]]
    while len(T) <= degree:
        last, before = T[-1], T[-2]
        new = [fmpq(0)] * (len(last) + 1)
        for k, x in enumerate(last):
            new[k] += 2 * shift * x
            new[k + 1] += 2 * slope * x
        for k, x in enumerate(before):
            new[k] -= x
        T.append(new)
    return [[T[m][k] if k < len(T[m]) else fmpq(0) for m in range(degree + 1)] for k in range(degree + 1)]


def _chebyshev_of_powers(p: Parameter, degree: int) -> list[list[fmpq]]:
    from flint import fmpq_mat

    return fmpq_mat(_powers_of_chebyshev(p, degree)).inv().tolist()


def _symbol(p: Parameter) -> Expression:
    return Expression({((p.name, 1),): Fraction(1)}, {p.name: p})


def _by_powers(M: np.ndarray, names: Sequence[str]) -> dict[Powers, dict[tuple[int, int], fmpq]]:
    found: dict[Powers, dict[tuple[int, int], fmpq]] = {}
    for at, entry in np.ndenumerate(M):
        for monomial, c in entry.terms.items():
            powers = tuple(dict(monomial).get(name, 0) for name in names)
            found.setdefault(powers, {})[at] = _exact(c)
    return found


def _valued(parts: Mapping[Powers, dict[tuple[int, int], fmpq]], p: Sequence[acb], n: int) -> acb_mat:
    M = acb_mat(n, n)
    for powers, entries in parts.items():
        factor = math.prod((x**k for x, k in zip(p, powers, strict=True) if k), start=acb(1))
        for (i, j), c in entries.items():
            M[i, j] = M[i, j] + factor * acb(c)
    return M


def _exact(x: Any) -> fmpq:
    x = Fraction(x)
    return fmpq(x.numerator, x.denominator)


def _between(low: float, high: float) -> arb:
    return arb(float(low)).union(arb(float(high)))


def _exactly(M: np.ndarray) -> acb_mat:
    return acb_mat(M.shape[0], M.shape[1], [acb(float(x.real), float(x.imag)) for x in M.astype(complex).flat])


def _middle(M: acb_mat) -> np.ndarray:
    found = [complex(float(x.real.mid()), float(x.imag.mid())) for x in M.entries()]
    return np.array(found).reshape(M.nrows(), M.ncols())


def _upper(M: acb_mat) -> np.ndarray:
    return np.array([float(x.abs_upper()) for x in M.entries()]).reshape(M.nrows(), M.ncols()) * ROOM
