"""The worst pointing budget over a box of parameters: every corner, then a search within the box. A search, no proof.

Levels of a budget are seldom convex in the parameters, so that the worst corner need not be the worst point. From the
worst corners and the centre a pattern search goes on: a step up and down in every parameter, the best of them taken,
half the step when none is better (Hooke and Jeeves 1961, J. ACM 8). What it returns is a point where the level is
attained; that no other exceeds it is not known.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.outcome.budgets import Budget, Levels, budget, spectral_radius

CORNERS = 12  # parameters at most, 4096 corners
FIRST = 1 / 4  # step of the search, part of the box

Loops = Callable[[np.ndarray], tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]]


class WorstBudget(NamedTuple):
    """Where in the box the worst level was found."""

    parameters: np.ndarray  # (k,)
    level: float  # the largest of the errors looked at, infinite if the loop is not stable there
    nominal: float  # the same at the centre of the box
    budget: Budget | None  # at that point, with a leading axis of 1; None if the loop is not stable there
    evaluated: int  # points looked at


def worst_budget(
    loops: Loops,
    low: ArrayLike,
    high: ArrayLike,
    dt: float,
    *,
    index: str = "ape",
    share: float = 0.95,
    axes: Sequence[int] = (),
    starts: int = 3,
    smallest: float = 1 / 256,
    **options: Any,
) -> WorstBudget:
    """The largest level of one error that a search finds in a box.

    Parameters
    ----------
    loops : ``loops(points (b, k)) -> (A, B, C, D)`` with leading axes (b, ...); all but the first are pooled, as
        instants of one loop
    low, high : (k,) corners of the box, 12 parameters at most
    dt : () s
    index : "ape", "mpe", "rpe" or "pse"
    share : () of the level
    axes : errors to look at, of which the largest counts; all by default
    starts : points from which the search goes on
    smallest : last step of the search, part of the box, positive; 1 leaves it at corners and centre
    options : further ones of `budget`

    Raises
    ------
    ScenarioError
        A box that is empty or has too many parameters, an unknown index, what `budget` refuses; not a loop that is
        unstable somewhere, which is then the worst.
    """
    least, most = real("low", low, (None,)), real("high", high, (None,))
    if least.shape != most.shape or not least.size or (least > most).any():
        raise ScenarioError(f"low = {low}, high = {high}: give low <= high, one for each parameter")
    if least.size > CORNERS:
        raise ScenarioError(f"low has {least.size} parameters: at most {CORNERS} have few enough corners")
    if index not in Levels._fields:
        raise ScenarioError(f"index = {index!r}: give one of {', '.join(Levels._fields)}")
    if not isinstance(starts, int) or starts < 1:
        raise ScenarioError(f"starts = {starts!r}: give a whole number of at least 1")

    if not smallest > 0:
        raise ScenarioError(f"smallest = {smallest!r}: give a positive part of the box")

    def at_points(points: np.ndarray) -> tuple[np.ndarray, Budget | None]:
        """Which of the loops are stable (b,), and the budget of those, with one leading axis."""
        matrices = [np.moveaxis(np.asarray(M, float), 0, -3) for M in loops(points)]
        sound = spectral_radius(matrices[0]).reshape(-1, len(points)).max(axis=0) < 1
        if not sound.any():
            return sound, None
        A, B, C, D = (M[..., sound, :, :] for M in matrices)
        found = budget(A, B, C, D, dt, **options)
        while found.ape.mean.ndim > 3:
            found = found.pooled()
        return sound, found

    def scores(points: np.ndarray) -> np.ndarray:
        """The largest level at each point, (b,)."""
        sound, found = at_points(points)
        score = np.full(len(points), np.inf)
        if found is not None:
            levels = getattr(found, index).level(share)
            score[sound] = (levels[:, list(axes)] if len(axes) else levels).max(axis=1)
        return score

    width = most - least
    points = np.array([(least + most) / 2, *product(*zip(least, most, strict=True))])
    score = scores(points)
    nominal, evaluated = score[0], len(points)
    order = np.argsort(-score, kind="stable")[:starts]
    at, top, step = points[order], score[order], FIRST
    while step >= smallest and np.isfinite(top).all():
        moves = step * width * np.concatenate([np.eye(least.size), -np.eye(least.size)])
        tried = np.clip(at[:, None] + moves, least, most)
        score = scores(tried.reshape(-1, least.size)).reshape(tried.shape[:2])
        evaluated += score.size
        best, rows = score.argmax(axis=1), np.arange(len(at))
        better = score[rows, best] > top
        at[better], top[better] = tried[rows, best][better], score[rows, best][better]
        if not better.any():
            step /= 2
    worst = int(np.argmax(top))
    _, found = at_points(at[worst : worst + 1])
    return WorstBudget(at[worst], float(top[worst]), float(nominal), found, evaluated)
