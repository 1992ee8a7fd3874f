"""Least norm under inequalities in long arithmetic, for programs that doubles do not carry.

    minimise  z'z/2   subject to   G z <= b

The dual active-set method: from the optimum for some rows, a violated row is driven to its limit while the multipliers
stay positive; a row whose multiplier vanishes on the way is let go. Every step increases the optimum. Of the violated
rows the one that promises the largest increase is taken, e^2 / (2 s) with the excess e and the square s of what the
row has beyond the span of the working set W. The pseudoinverse of G_W is kept and bordered.

References: Goldfarb and Idnani (1983), Mathematical Programming 27, 1; Forrest and Goldfarb (1992), Mathematical
Programming 57, 341 (the steepest edge); Johansson (2017), IEEE Trans. Computers 66, 1281 (Arb).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from synth.errors import NumericalError

BITS = 512  # of the arithmetic
DEPENDENT = 2.0**-160  # a row with a smaller part of its square beyond the working set lies in its span
MET = 2.0**-60  # how far a row may exceed its limit, relative to the size of both or 1
EFFORT = 32e6  # numbers that may be gone through in exchanges of rows, about three seconds
LEAST = 20  # exchanges that are allowed in any case


class Optimum(NamedTuple):
    """For the rows of a working set."""

    z: arb_mat  # (N, 1)
    W: list[int]  # the working set
    y: list[arb]  # its multipliers
    inverse: arb_mat  # (|W|, N) transposed pseudoinverse of its rows
    beyond: np.ndarray  # (M,) square of what each row has beyond the span of the working set, roughly


class LeastNorm:
    """The program with rows G, to be solved for many limits b. It keeps midpoints and adds no error bounds."""

    def __init__(self, G: arb_mat):
        with ctx.workprec(BITS):
            table = G.tolist()
            self.units = [_unit(row) for row in table]  # makes the rows of similar length; exact
            self.G = arb_mat([[e * u for e in row] for row, u in zip(table, self.units, strict=True)]).mid()
            self.rows = self.G.tolist()
            self.squares = np.array([float(sum((e * e for e in row), arb(0))) for row in self.rows])
        self.exchanges = LEAST + int(EFFORT / (G.nrows() * G.ncols() + 8 * G.ncols() ** 2))

    def solve(self, b: list[arb], start: Sequence[int] = ()) -> tuple[arb_mat, list[int], list[arb]]:
        """(z, working set, its multipliers) at the optimum.

        Parameters
        ----------
        b : limits
        start : rows that are tried as the working set; the optimum does not depend on them, the time does

        Raises
        ------
        NumericalError : the rows contradict each other, or precision or time do not suffice.
        """
        with ctx.workprec(BITS):
            limit = arb_mat([[e * u] for e, u in zip(b, self.units, strict=True)]).mid()
            met = MET * np.array([float((1 + abs(e.mid())) * u) for e, u in zip(b, self.units, strict=True)])
            found, left = self._started(limit, list(start)), self.exchanges
            while True:
                excess = _floats(self.G * found.z - limit)
                if not (np.abs(excess) <= met)[found.W].all():  # rounding has piled up
                    found, left = self._started(limit, found.W), left - 1
                    continue
                excess[found.W] = 0
                violated = excess > met
                if not violated.any():
                    return found.z, found.W, [y * self.units[i] for i, y in zip(found.W, found.y, strict=True)]
                promise = np.where(violated, excess, 0) ** 2 / np.maximum(found.beyond, DEPENDENT)
                found, left = self._entered(int(np.argmax(promise)), limit, found, left)

    def _started(self, limit: arb_mat, W: list[int]) -> Optimum:
        """The optimum for those rows of `W` that keep positive multipliers."""
        none = Optimum(arb_mat(self.G.ncols(), 1), [], [], arb_mat(0, self.G.ncols()), self.squares)
        while W:
            M = arb_mat([self.rows[i] for i in W])
            try:
                inverse = ((M * M.transpose()).inv() * M).mid()
            except ZeroDivisionError:  # they depend on each other
                return none
            z = (inverse.transpose() * arb_mat([[limit[i, 0]] for i in W])).mid()
            y = [-e.mid() for e in (inverse * z).entries()]
            positive = [i for i, e in zip(W, y, strict=True) if e > 0]
            if len(positive) == len(W):
                pairs = zip((self.G * M.transpose()).tolist(), (self.G * inverse.transpose()).tolist(), strict=True)
                within = [float((arb_mat([a]) * arb_mat([b]).transpose())[0, 0]) for a, b in pairs]
                return Optimum(z, W, y, inverse, self.squares - within)
            W = positive
        return none

    def _entered(self, p: int, limit: arb_mat, found: Optimum, left: int) -> tuple[Optimum, int]:
        """The optimum with row `p` at its limit and in the working set, and how many exchanges are left."""
        row, multiplier = arb_mat([self.rows[p]]), arb(0)
        square = (row * row.transpose())[0, 0]
        for spent in range(1, left + 1):
            z, W, y, inverse, beyond = found
            share, step = (inverse * row.transpose()).mid(), row
            if W:
                step = (row - share.transpose() * arb_mat([self.rows[i] for i in W])).mid()
            gain = (step * step.transpose())[0, 0].mid()
            full = None if gain <= DEPENDENT * square else (((row * z)[0, 0] - limit[p, 0]) / gain).mid()
            shares = share.entries()
            blocking = [((m / s).mid(), i) for i, (m, s) in enumerate(zip(y, shares, strict=True)) if s > 0]
            short, leaving = min(blocking, default=(None, -1))
            length = full if short is None or (full is not None and full <= short) else short
            if length is None:
                raise NumericalError("the rows contradict each other")
            if full is not None:
                z = (z - step.transpose() * length).mid()
            y = [(m - length * s).mid() for m, s in zip(y, shares, strict=True)]
            multiplier = (multiplier + length).mid()
            if length is full:
                new = step * (1 / gain)
                beyond = beyond - _floats(self.G * step.transpose()) ** 2 / float(gain)
                inverse = arb_mat((inverse - share * new).tolist() + new.tolist()).mid()
                return Optimum(z, [*W, p], [*y, multiplier], inverse, beyond), left - spent
            found = self._without(leaving, Optimum(z, W, y, inverse, beyond))
        raise NumericalError(f"the active-set method did not come to an end in {self.exchanges} exchanges")

    def _without(self, i: int, found: Optimum) -> Optimum:
        """The same with one row less in the working set."""
        z, W, y, inverse, beyond = found
        rest = inverse.tolist()
        row = arb_mat([rest.pop(i)])
        square = (row * row.transpose())[0, 0]
        beyond = beyond + _floats(self.G * row.transpose()) ** 2 / float(square)
        inverse = arb_mat(0, row.ncols())
        if rest:
            inverse = (arb_mat(rest) - (arb_mat(rest) * row.transpose()) * (row * (1 / square))).mid()
        return Optimum(z, W[:i] + W[i + 1 :], y[:i] + y[i + 1 :], inverse, beyond)


def _unit(row: list[arb]) -> arb:
    """A power of two that brings the length of `row` near 1."""
    square = sum((e * e for e in row), arb(0)).mid()
    return arb(2) ** -round(float(square.log()) / np.log(4)) if square > 0 else arb(1)


def _floats(column: arb_mat) -> np.ndarray:
    return np.array([float(e) for e in column.entries()])
