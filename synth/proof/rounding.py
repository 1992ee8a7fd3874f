"""What rounding does to a controller over any time, proved: sums in a given order against exact arithmetic.

The controller as its code steps it, hatted, makes an error in every row of

    v^ = C^ x^ + D^ y + e_v,    x^+ = A^ x^ + B^ y + e_x,

and so the difference from exact arithmetic with the same matrices is the response to e of a linear system, the
controller or the loop that it closes, whose peak gains (`peakgain`) bound it for all samples. The errors themselves are
bounded by the sizes of what is added: a product of a coefficient with a signal of size X misses at most u ufp(|m| X)
and what underflow takes, and a sum s_j of the first j products u ufp(s_j), where ufp(s) is the largest power of two
that is not above s and u = 2^-24 or 2^-53. Sizes are peak gains again, of the row cut off after j terms, so that terms
that cancel count for what they leave. As the sizes are those of the hatted signals, errors included, a bound E on the
errors is tried and kept if errors within E make no error above E: by induction over the samples none ever is.

Sizes follow from assumed bounds on the inputs y. Where A^ is not stable, as with an integrator, they follow from those
of y and of the command u, while u = v, by an observer: x^+ = (A^ - L C^) x^ + (B^ - L D^) y + L u for any L.

Where the matrices were rounded, too, the exact controller (A, B, C, D) is compared: e_x = (A^ - A) x + (B^ - B) y and
so on, of the same order in every sample, is one linear system more from y, and its peak gain is exact.

References: Higham (2002), Accuracy and Stability of Numerical Algorithms, 2nd ed., chapters 2 to 4; Rump, Ogita and
Oishi (2008), Accurate floating-point summation I, SIAM J. Sci. Comput. 31, 189, on ufp; Hilaire and Lopez (2013),
Reliable implementation of linear filters with fixed-point arithmetic, IEEE SiPS, on peak gains of rounding errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from flint import arb_mat, ctx

from synth.errors import NumericalError
from synth.proof.balls import Balls
from synth.proof.matrices import block, exact, identity
from synth.proof.peakgain import BITS, UP, above, peak_gains

ROUNDS = 30  # until errors within the bound make none above it
ROOM = 1 + 1e-3  # by which a bound that is tried is made larger


class Law(NamedTuple):
    """A controller's matrices: doubles, or numbers that are doubles as well."""

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, p)
    C: np.ndarray  # (m, n)
    D: np.ndarray  # (m, p)


class Row(NamedTuple):
    """One sum of the code, in the order in which it is made."""

    coefficients: np.ndarray  # (k) those that are not zero
    signals: np.ndarray  # (k) sizes of what they are multiplied by
    sums: np.ndarray  # (k) sizes of the first one, two, ... products together, without errors of this row


class Arithmetic(Protocol):
    """How numbers are rounded."""

    @property
    def largest(self) -> float:
        """Size that no signal, product or sum may reach."""
        ...

    def errors(self, rows: Sequence[Row]) -> np.ndarray:
        """Bounds of what the rows miss in one sample, those of the states and then those of the commands."""
        ...

    def conversion(self, inputs: np.ndarray) -> np.ndarray:
        """Bound (p,) of what the inputs lose when they become numbers of this kind."""
        ...


@dataclass(frozen=True)
class Floating:
    """IEEE 754 binary arithmetic, rounded to nearest, with gradual underflow."""

    unit: float  # u, half a unit in the last place of 1
    tiny: float  # half the smallest number, or above
    largest: float

    def errors(self, rows: Sequence[Row]) -> np.ndarray:
        """Of rounded products, added one after another."""
        return np.array([self._error(row) for row in rows])

    def _error(self, row: Row) -> float:
        """A power of two times a number is exact, as is 0 + a number; no sum misses more than its smaller part."""
        missed = 0.0
        for k, (m, signal, total) in enumerate(zip(*row, strict=True)):
            product = abs(m) * signal * UP
            if np.frexp(abs(m))[0] != 0.5:
                missed += self.unit * _ufp(product)
            missed += self.tiny
            if k:
                missed += min(self.unit * _ufp((total + missed) * UP), product + missed)
        return missed * UP

    def conversion(self, inputs: np.ndarray) -> np.ndarray:
        """Half a unit in the last place."""
        return np.array([self.unit * _ufp(y) + self.tiny for y in inputs])


@dataclass(frozen=True)
class Fixed:
    """Whole multiples of a step for each signal: exact sums, each rounded once to the step of its result."""

    steps: np.ndarray  # (n + m,) of the states and the commands
    read: np.ndarray  # (p,) of the inputs
    largest: float = np.inf  # its maker sees to it

    def errors(self, rows: Sequence[Row]) -> np.ndarray:
        """Half a step."""
        return np.where([len(row.sums) > 0 for row in rows], self.steps / 2, 0.0)

    def conversion(self, inputs: np.ndarray) -> np.ndarray:
        """Half a step."""
        return self.read / 2


FLOATING = {
    "double": Floating(2.0**-53, 5e-324, float(np.finfo(float).max)),
    "float32": Floating(2.0**-24, 2.0**-150, float(np.finfo(np.float32).max)),
}


@dataclass(frozen=True, eq=False)
class Bound:
    """Proved bounds over any time from reset; those of `command` and `output` in the units of the signals."""

    command: np.ndarray  # (m,) |u - exact u|, coefficients and arithmetic together
    coefficients: np.ndarray  # (m,) what of it the rounded matrices do
    arithmetic: np.ndarray  # (m,) what of it the rounded sums and inputs do
    state: np.ndarray  # (n,) |x - exact x|
    output: np.ndarray | None  # (p,) of the plant in the loop: |y - exact y|; None for the controller alone
    states: np.ndarray  # (n,) size of x as the code steps it
    commands: np.ndarray  # (m,) size of v as the code steps it


def bounded(
    exported: Law,
    designed: Law,
    arithmetic: Arithmetic,
    inputs: np.ndarray,
    *,
    commands: np.ndarray | None = None,
    observer: np.ndarray | None = None,
    plant: Law | None = None,
) -> Bound:
    """The exported law in this arithmetic against the designed one in exact arithmetic, from rest, over any time.

    Parameters
    ----------
    inputs : (p,) bound of |y| in every sample
    commands : (m,) bound of |u|; only with an observer
    observer : (n, m) L; None where A is stable
    plant : what u and y are fed back through, u = K y; None for the same y in both

    Raises
    ------
    NumericalError : the controller, with its observer, or the loop is not proved stable; the rounding errors are as
        large as the signals; numbers could overflow.
    """
    with ctx.workprec(BITS):
        n, m = len(exported.A), len(exported.D)
        L = np.zeros((n, m)) if observer is None else observer
        U = np.zeros(m) if commands is None else commands
        conversion = arithmetic.conversion(inputs)
        sizes = _sizes(exported, L, inputs + conversion, U)
        errors, rows = _kept(exported, sizes, arithmetic)
        largest = max(
            max((*row.sums, *row.signals, *np.abs(row.coefficients) * row.signals), default=0.0) for row in rows
        )
        if not largest < arithmetic.largest:
            raise NumericalError(f"numbers reach {largest:.3g} within these bounds of the inputs; scale the signals")
        loop = _loop(exported, plant)
        made = peak_gains(loop) @ np.concatenate([errors, conversion]) * UP
        moved = _moved(exported, designed, loop, L, np.concatenate([inputs, U]))
        total, off = (made + moved) * UP, sizes.off(errors)
        v = [(row.sums[-1] if len(row.sums) else 0.0) + error for row, error in zip(rows[n:], errors[n:], strict=True)]
        return Bound(
            command=total[:m], coefficients=moved[:m], arithmetic=made[:m], state=total[m : m + n],
            output=None if plant is None else total[m + n :], states=(sizes.states + off) * UP,
            commands=np.array(v) * UP,
        )  # fmt: skip


def reached(law: Law, plant: Law, B1: np.ndarray, D21: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of |y| (p,) and |u| (m,) in the exact loop u = K y, from rest, while |w| <= 1.

    Parameters
    ----------
    B1, D21 : (k, nw), (p, nw) how w acts on the plant's states and on y

    Raises
    ------
    NumericalError : the loop is not proved stable.
    """
    with ctx.workprec(BITS):
        (A, B, C, D), (Ap, Bp, Cp, Dp) = ([exact(M) for M in matrices] for matrices in (law, plant))
        n, k, (p, nw), E = len(law.A), len(plant.A), D21.shape, identity(len(law.D)) - D * Dp
        # in xp, x and w
        u = [E.solve(M) for M in (D * Cp, C, D * exact(D21))]
        y = [M + Dp * v for M, v in zip((Cp, _zeros(p, n), exact(D21)), u, strict=True)]
        after = [M + Bp * v for M, v in zip((Ap, _zeros(k, n), exact(B1)), u, strict=True)]
        x = [M + B * v for M, v in zip((_zeros(n, k), A, _zeros(n, nw)), y, strict=True)]
        loop = Balls(block([after[:2], x[:2]]), block([after[2:], x[2:]]), block([y[:2], u[:2]]), block([y[2:], u[2:]]))
        peaks = peak_gains(loop).sum(axis=1) * UP
    return peaks[:p], peaks[p:]


class Sizes(NamedTuple):
    """Peaks without the errors, and what errors add to them."""

    L: np.ndarray  # (n, m) observer
    read: np.ndarray  # (p,) of the inputs
    states: np.ndarray  # (n,) of x
    places: tuple[np.ndarray, ...]  # n + m rows: the columns of [A B; C D] that are not zero
    sums: tuple[np.ndarray, ...]  # n + m rows: of the partial sums
    spread: np.ndarray  # (n, n) from e_x to x

    def off(self, errors: np.ndarray) -> np.ndarray:
        """What errors (n + m,) of the rows make of the states (n,) at most."""
        n = len(self.spread)
        return self.spread @ (errors[:n] + np.abs(self.L) @ errors[n:]) * UP


def _sizes(law: Law, L: np.ndarray, read: np.ndarray, U: np.ndarray) -> Sizes:
    """Sizes with inputs within `read` and commands within U, which only an observer sees."""
    n, (m, p) = len(law.A), law.D.shape
    M = np.block([[law.A, law.B], [law.C, law.D]])
    places = tuple(np.flatnonzero(row) for row in M)
    parts = [np.eye(n, n + p)]
    for row, columns in zip(M, places, strict=True):
        part = np.zeros((len(columns), n + p))
        for k, column in enumerate(columns):
            part[k:, column] = row[column]
        parts.append(part)
    W, scaled = np.vstack(parts), exact(np.diag(np.concatenate([read, U])))
    A, B, C, D = (exact(N) for N in law)
    l = exact(L)
    G = Balls(A - l * C, block([[B - l * D, l]]), exact(W[:, :n]), block([[exact(W[:, n:]), _zeros(len(W), m)]]))
    peaks = peak_gains(G._replace(B=G.B * scaled, D=G.D * scaled)).sum(axis=1) * UP
    spread = peak_gains(Balls(G.A, identity(n), identity(n), _zeros(n, n)))
    ends = n + np.cumsum([len(columns) for columns in places])
    return Sizes(L, read, peaks[:n], places, tuple(np.split(peaks[n:], ends[:-1] - n)), spread)


def _kept(law: Law, sizes: Sizes, arithmetic: Arithmetic) -> tuple[np.ndarray, list[Row]]:
    """Errors (n + m,) of the rows that signals with such errors do not exceed, and the rows with these signals.

    Raises
    ------
    NumericalError : errors make errors that are larger than they are.
    """
    n, M = len(law.A), np.block([[law.A, law.B], [law.C, law.D]])
    errors = np.zeros(len(M))
    for _ in range(ROUNDS):
        off = np.concatenate([sizes.off(errors), np.zeros(len(sizes.read))])
        factors = (np.concatenate([sizes.states, sizes.read]) + off) * UP
        rows = [
            Row(row[columns], factors[columns], (sums + np.cumsum(np.abs(row) * off)[columns]) * UP)
            for row, columns, sums in zip(M, sizes.places, sizes.sums, strict=True)
        ]
        found = arithmetic.errors(rows)
        if (found <= errors).all():
            return errors, rows
        if not np.isfinite(found).all():
            break
        errors = found * ROOM
    raise NumericalError(
        f"rounding errors of {n} states grow with the states that they make: no bound; take a longer type of number, "
        "or a controller without slow states"
    )


def _loop(law: Law, plant: Law | None) -> Balls:
    """From the errors e_x, e_v and those of y to the differences of u and x; with a plant of its y, too."""
    A, B, C, D = (exact(M) for M in law)
    n, (m, p) = len(law.A), law.D.shape
    I, Im = identity(n), identity(m)
    if plant is None:
        return Balls(
            A, block([[I, _zeros(n, m), B]]), block([[C], [I]]),
            block([[_zeros(m, n), Im, D], [_zeros(n, n), _zeros(n, m), _zeros(n, p)]]),
        )  # fmt: skip
    Ap, Bp, Cp, Dp = (exact(M) for M in plant)
    k, E = len(plant.A), identity(m) - D * Dp
    # in xp, x, e_x, e_v and the errors of y:  u = E^-1 (D Cp xp + C x + e_v + D e_y),  y = Cp xp + Dp u
    u = [E.solve(M) for M in (D * Cp, C, _zeros(m, n), Im, D)]
    y = [M + Dp * v for M, v in zip((Cp, *(_zeros(p, j) for j in (n, n, m, p))), u, strict=True)]
    after = [M + Bp * v for M, v in zip((Ap, *(_zeros(k, j) for j in (n, n, m, p))), u, strict=True)]
    x = [M + B * v for M, v in zip((_zeros(n, k), A, I, _zeros(n, m), B), y, strict=True)]
    same = [_zeros(n, k), I, _zeros(n, n), _zeros(n, m), _zeros(n, p)]
    return Balls(
        block([after[:2], x[:2]]), block([after[2:], x[2:]]),
        block([u[:2], same[:2], y[:2]]), block([u[2:], same[2:], y[2:]]),
    )  # fmt: skip


def _moved(exported: Law, designed: Law, loop: Balls, L: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """What the difference of the matrices makes of the loop's outputs at most, with (y, u) within bounds (p + m,)."""
    n, (m, p) = len(exported.A), exported.D.shape
    dA, dB, dC, dD = (exact(new) - exact(old) for new, old in zip(exported, designed, strict=True))
    if not any(above(M).any() for M in (dA, dB, dC, dD)):
        return np.zeros(loop.C.nrows())
    A, B, C, D = (exact(M) for M in designed)
    l, scaled = exact(L), exact(np.diag(bounds))
    errors = Balls(
        A - l * C, block([[B - l * D, l]]) * scaled, block([[dA], [dC], [_zeros(p, n)]]),
        block([[dB, _zeros(n, m)], [dD, _zeros(m, m)], [_zeros(p, p), _zeros(p, m)]]) * scaled,
    )  # fmt: skip
    return peak_gains(_series(errors, loop), first=n).sum(axis=1) * UP


def _series(first: Balls, second: Balls) -> Balls:
    """The second system, with the outputs of the first as its inputs."""
    O = _zeros(first.A.nrows(), second.A.nrows())
    A, B = block([[first.A, O], [second.B * first.C, second.A]]), block([[first.B], [second.B * first.D]])
    return Balls(A, B, block([[second.D * first.C, second.C]]), second.D * first.D)


def _zeros(p: int, q: int) -> arb_mat:
    return exact(np.zeros((p, q)))


def _ufp(x: float) -> float:
    """The largest power of two that is not above x, 0 for 0."""
    return float(np.ldexp(0.5, int(np.frexp(x)[1]))) if x else 0.0
