"""Bernstein polynomials on boxes in doubles: halved until every coefficient tells, with a proved bound on rounding.

A polynomial on a box lies between its least and its largest Bernstein coefficient. Coefficients on a half are convex
combinations of those on the whole with dyadic weights, which doubles hold exactly up to degree 53, so that one
matrix product of m + 1 terms is wrong by at most (m + 2) 2^-53 of the largest coefficient, in any order of summation.

What becomes of the boxes is a script: for every batch from the top of a stack one letter a box, "." where it is done
and a letter for the axis along which it is halved. Lower halves come before upper ones, axis by axis. A script that
was found is followed again without any choice.

References: Garloff (1986), Interval Computations of Bernstein form; Zettler and Garloff (1998), IEEE TAC 43, 425, on
robust stability; Higham (2002), Accuracy and Stability of Numerical Algorithms, section 3.1.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

ROUNDING = 2.0**-53
AXES = "abcdefghijklmnopqrstuvwxyz"
DONE = "."
HIGHEST = 50  # degree of a polynomial whose weights are exact
BATCH = 2**21  # doubles that are worked on at once


class Boxes(NamedTuple):
    """Polynomials on boxes, several components on each."""

    coefficients: np.ndarray  # (boxes, components, m1 + 1, m2 + 1, ...)
    errors: np.ndarray  # (boxes, components) of any coefficient
    low: np.ndarray  # (boxes, axes) in the unit cube
    width: np.ndarray  # (boxes, axes)
    piece: np.ndarray  # (boxes,) on which of the first boxes

    def some(self, which: np.ndarray | slice) -> Boxes:
        """A part of them."""
        return Boxes(*(part[which] for part in self))

    @property
    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Values at the corners, (boxes, components, 2^axes), and the corners in {0, 1}, (2^axes, axes)."""
        which = np.array(list(itertools.product((0, 1), repeat=self.low.shape[1])))
        values = [self.coefficients[(slice(None), slice(None), *(-k for k in corner))] for corner in which]
        return np.stack(values, axis=2), which


@dataclass(frozen=True)
class Outcome:
    """What became of all boxes."""

    proved: bool
    script: list[str]
    boxes: int
    refuted: tuple[int, np.ndarray] | None = None  # first box and the point of its unit cube
    left: Boxes | None = None  # undecided ones


Test = Callable[[Boxes], np.ndarray]  # (boxes,) bool


def explored(start: Boxes, holds: Test, most: int, refutes: Callable[[Boxes], tuple[int, int] | None]) -> Outcome:
    """Halve boxes until `holds` is true of all, `refutes` finds a box and its corner, or there are more than `most`."""
    script: list[str] = []
    stack, total = list(_batches(start)), 0
    while stack:
        batch = stack.pop()
        total += len(batch.low)
        if (found := refutes(batch)) is not None:
            box, corner = found
            return Outcome(
                False, script, total,
                refuted=(int(batch.piece[box]), batch.low[box] + batch.width[box] * batch.corners[1][corner]),
            )  # fmt: skip
        open_ = ~holds(batch)
        axes = np.full(len(open_), -1)
        axes[open_] = _dearest(batch.some(open_))
        if open_.any() and (total > most or (axes[open_] < 0).any() or batch.width.min() < 2.0**-45):
            return Outcome(False, script, total, left=batch.some(open_))
        script.append("".join(AXES[a] if a >= 0 else DONE for a in axes))
        stack.extend(_batches(_halves(batch, axes)))
    return Outcome(True, script, total)


def follows(start: Boxes, holds: Test, script: Sequence[str]) -> bool:
    """Whether a script leads from the first boxes to boxes of which `holds` is true, with none left."""
    stack = list(_batches(start))
    for line in script:
        if not stack or len(line) != len(stack[-1].low):
            return False
        batch = stack.pop()
        axes = np.array([AXES.find(letter) for letter in line])
        done = axes < 0
        if set(line) - {DONE, *AXES[: batch.low.shape[1]]} or (done.any() and not holds(batch.some(done)).all()):
            return False
        stack.extend(_batches(_halves(batch, axes)))
    return not stack


def _batches(boxes: Boxes) -> Iterator[Boxes]:
    """Pieces that fit in memory, the last one first."""
    size = max(1, BATCH // max(1, boxes.coefficients[:1].size))
    for at in reversed(range(0, len(boxes.low), size)):
        yield boxes.some(slice(at, at + size))


def _dearest(boxes: Boxes) -> np.ndarray:
    """The axis whose halving should help most; -1 where none would.

    One component is least at a corner along straight lines: what counts is how far it is from one. Two may enclose zero
    along straight lines too: what changes their angle counts as well.
    """
    V, count, axes = boxes.coefficients, len(boxes.low), boxes.low.shape[1]
    if not count:
        return np.zeros(0, int)
    cost = _changes(V, 2)
    if V.shape[1] == 2:
        mean = V.reshape(count, 2, -1).mean(axis=2)
        mean = (mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-300)).reshape(count, 2, *[1] * axes)
        cost += _changes((mean[:, 0] * V[:, 1] - mean[:, 1] * V[:, 0])[:, None], 1)
    return np.where(cost.max(axis=1) > 0, cost.argmax(axis=1), -1)


def _changes(V: np.ndarray, order: int) -> np.ndarray:
    """Largest differences along every axis, as many times as a derivative has them, (boxes, axes)."""
    found = np.zeros((len(V), V.ndim - 2))
    for axis in range(V.ndim - 2):
        m = V.shape[axis + 2] - 1
        if m >= order:
            differences = np.abs(np.diff(V, order, axis=axis + 2)).reshape(len(V), -1).max(axis=1)
            found[:, axis] = differences * (m if order == 1 else m * (m - 1) / 8)
    return found


def _halves(boxes: Boxes, axes: np.ndarray) -> Boxes:
    """The halves of all boxes with an axis."""
    found = [boxes.some(slice(0, 0))]
    for axis in range(boxes.low.shape[1]):
        if (which := axes == axis).any():
            found += _halved(boxes.some(which), axis)
    return Boxes(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def _halved(boxes: Boxes, axis: int) -> tuple[Boxes, Boxes]:
    V = boxes.coefficients
    m = V.shape[axis + 2] - 1
    size = np.abs(V).reshape(*V.shape[:2], -1).max(axis=2)
    errors = (boxes.errors + (m + 2) * ROUNDING * size) * (1 + 8 * ROUNDING)
    flat = V.reshape(math.prod(V.shape[: axis + 2]), m + 1, -1)
    width = boxes.width.copy()
    width[:, axis] /= 2
    upper = boxes.low.copy()
    upper[:, axis] += width[:, axis]
    first, second = ((W @ flat).reshape(V.shape) for W in _weights(m))
    return Boxes(first, errors, boxes.low, width, boxes.piece), Boxes(second, errors, upper, width, boxes.piece)


def _weights(m: int) -> tuple[np.ndarray, np.ndarray]:
    """What coefficients on the lower and the upper half are made of: binomials over powers of two."""
    lower = np.array([[math.comb(i, j) / 2.0**i for j in range(m + 1)] for i in range(m + 1)])
    return lower, lower[::-1, ::-1]
