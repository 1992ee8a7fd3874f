"""Controllers by descent: one norm of the closed loop is lowered while others stay below their levels.

An interior-point method over all controllers of an order. Every specification has a barrier, see `barriers.py`; the
level t of the lowered norm is an unknown as well:

    log t + mu (barrier of the norm below t + sum of those of the bounds)

is smooth, and is minimised by BFGS for ever smaller mu. Where a start does not meet the bounds, they are all relaxed
by one factor, which takes the place of t until it is below one. What is found is a local minimum.

References: Fiacco and McCormick (1968), Nonlinear Programming; Apkarian, Noll and Rondepierre (2008), SIAM J. Control
and Optimization 47, 1516 (mixed H2 and H-infinity without LMIs).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from synth.errors import SynthError
from synth.synthesis.affineloop import AffineLoop
from synth.synthesis.descent import Descent
from synth.systems.statespace import StateSpace

WEIGHTS = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 3e-4, 1e-4)  # mu
CALLS = 300  # loops, for every weight
LOOK = 20  # of them between two looks at the level
TRIALS = 40  # of a line search
ENOUGH = 2  # descents that led to a controller: others lead to the same as a rule
GAIN = 0.02  # of the weight, in eight steps: what gains less has ended
ROOM = 1.25  # factor of a level that a start meets at which it has room
ROOMS = tuple(ROOM**k for k in range(-60, 60))  # levels tried; in the coordinates of the plant norms are about one
MET = 0.999  # factor of the bounds at which all are met
LARGEST = 100.0  # logarithm of a level
FAILS = (SynthError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Goal:
    """A specification: its barrier at a level, with the derivatives by [A B; C D] and by the level's logarithm."""

    barrier: Callable[[StateSpace, float], tuple[float, np.ndarray, float]]
    level: float | None = None  # None: to be lowered


@dataclass(frozen=True)
class Inside:
    """The function that descends, of a controller and the logarithm of the level of the goals that are lowered."""

    loop: AffineLoop
    lowered: Sequence[Goal]  # at their level, 1 where they have none, times the unknown one
    bounds: Sequence[Goal]
    weight: float  # mu

    def __call__(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Value and slope; inf outside."""
        slope, outside = np.zeros(len(x)), (np.inf, np.zeros(len(x)))
        if not -LARGEST < x[-1] < LARGEST:
            return outside
        value, slope[-1] = x[-1], 1.0
        with np.errstate(all="ignore"):
            return self._at(x, float(value), slope)

    def _at(self, x: np.ndarray, value: float, slope: np.ndarray) -> tuple[float, np.ndarray]:
        """The same, `slope` being filled."""
        outside = np.inf, np.zeros(len(x))
        try:
            closed = self.loop.closed(x[:-1])
            for goal in (*self.lowered, *self.bounds):
                own = goal in self.lowered
                height, found, by_level = goal.barrier(closed, (goal.level or 1.0) * (np.exp(x[-1]) if own else 1.0))
                if not np.isfinite(height):
                    return outside
                value += self.weight * height
                slope[:-1] += self.weight * self.loop.slope(found)
                slope[-1] += self.weight * by_level * own
        except FAILS:
            return outside
        return (float(value), slope) if np.isfinite(slope).all() else outside

    def entered(self, theta: np.ndarray) -> np.ndarray | None:
        """A controller with a level at which it is inside; None where there is none."""
        for room in ROOMS:
            if np.isfinite(self(np.append(theta, np.log(room)))[0]):
                return np.append(theta, np.log(ROOM * room))
        return None


def descents(
    loop: Callable[[int], AffineLoop],
    starts: Iterable[StateSpace],
    lowered: Goal,
    bounds: Sequence[Goal],
    reached: list[float],
) -> Iterator[StateSpace]:
    """Controllers that meet all bounds, from the first starts that lead to one.

    Parameters
    ----------
    loop : of an order
    starts : stabilising ones; others are left out
    reached : takes the factor by which all bounds had to be relaxed at least, of every start that did not meet them
    """
    found = 0
    for K in starts:
        affine = loop(K.n)
        try:
            theta = met(affine, affine.vector(K), bounds, reached)
        except FAILS:  # a loop so near instability that its Gramians are no numbers
            continue
        x = None if theta is None else Inside(affine, (lowered,), bounds, WEIGHTS[0]).entered(theta)
        if x is None:
            continue
        path = Path(x)
        for weight in WEIGHTS:
            path.follow(Inside(affine, (lowered,), bounds, weight))
        yield affine.controller(path.x[:-1])
        found += 1
        if found == ENOUGH:
            return


def met(affine: AffineLoop, theta: np.ndarray, bounds: Sequence[Goal], reached: list[float]) -> np.ndarray | None:
    """A controller that meets all bounds, reached from one that may not; None where none is found."""
    if not bounds or np.isfinite(Inside(affine, (), bounds, 1.0)(np.append(theta, 0.0))[0]):
        return theta
    x = Inside(affine, bounds, (), WEIGHTS[0]).entered(theta)
    if x is None:
        return None
    path = Path(x)
    for weight in WEIGHTS:
        path.follow(Inside(affine, bounds, (), weight), until=float(np.log(MET)))
        if path.x[-1] < np.log(MET):
            return path.x[:-1]
    reached.append(float(np.exp(path.x[-1])))
    return None


class Path:
    """Minima for ever smaller weights; the inverse Hessian of one is the first guess of the next one's."""

    def __init__(self, x: np.ndarray):
        self.x, self.H = x, None

    def follow(self, function: Inside, until: float = -np.inf) -> None:
        """To the minimum, or where the level is below `until`."""
        descent = Descent(function, self.x, H=self.H, trials=TRIALS)
        while descent.calls < CALLS and descent.x[-1] >= until:
            before = descent.value
            if descent.run(LOOK, GAIN * function.weight):
                continue
            if descent.H is None or before - descent.value > GAIN * function.weight:
                break
            descent.H = None  # what was learnt leads nowhere any more
        self.x, self.H = descent.x, descent.H
