"""Paired comparisons: two configurations flown from the same seeds, by their differences and not by two medians."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from plants.errors import ScenarioError
from plants.outcome.claims import Reading


class Paired(NamedTuple):
    """How a quantity differs between two configurations over the same runs: first - second, or first / second."""

    runs: int  # pairs
    median: float  # of the differences
    low: float  # its 95 % interval, distribution free, by order statistics; infinite ends if there are too few runs
    high: float
    sign: float  # p of the sign test
    wilcoxon: float  # p of the signed-rank test
    effect: float  # rank-biserial correlation, -1 (first smaller in every pair) .. 1
    smaller: int  # pairs in which the first is smaller
    larger: int

    def reading(self, what: str = "") -> Reading:
        """For the rule of a claim."""
        text = f"{self.smaller} of {self.runs} smaller, Wilcoxon p = {self.wilcoxon:.2g}, effect {self.effect:+.2f}"
        return Reading(what, self.median, self.low, self.high, text)


def paired(first: Any, second: Any, *, ratio: bool = False, confidence: float = 0.95) -> Paired:
    """Compare two configurations over the same runs.

    Parameters
    ----------
    first, second : (runs,) of the same seeds in the same order; infinite where a run never got there, which counts as
        larger than any number
    ratio : compare first / second with 1 instead of first - second with 0; both positive
    confidence : of the interval of the median

    Raises
    ------
    ScenarioError
        Different shapes, no runs, a NaN, or with `ratio` a value that is not positive.

    Notes
    -----
    The interval of the median and the sign test are exact and assume nothing but independent runs (Conover, Practical
    Nonparametric Statistics, sections 3.2 and 3.4). The signed-rank test assumes differences that are symmetric about
    their median (section 5.7); zeros share their ranks (Pratt). The effect is Kerby's simple difference of the rank
    sums. A ratio is compared by its logarithm.
    """
    a, b = np.asarray(first, float), np.asarray(second, float)
    for name, x in (("first", a), ("second", b)):
        if x.ndim != 1 or not len(x):
            raise ScenarioError(f"{name}: shape {x.shape}; give (runs,) with at least one run")
        if np.isnan(x).any():
            raise ScenarioError(f"{name}: run {int(np.isnan(x).argmax())} is NaN; leave the pair out in both")
        if ratio and (x <= 0).any():
            raise ScenarioError(f"{name}: {x.min():g} is not positive; compare differences (ratio=False)")
    if len(a) != len(b):
        raise ScenarioError(f"{len(a)} runs of the first, {len(b)} of the second: give the same runs of both")
    if ratio:
        a, b = np.log(a), np.log(b)
    difference = np.where(a == b, 0.0, a - np.where(a == b, 0.0, b))  # also if neither got there
    n, smaller, larger = len(a), int((difference < 0).sum()), int((difference > 0).sum())
    order, k = np.sort(difference), int(stats.binom.ppf((1 - confidence) / 2, n, 0.5))
    low, high = (order[k - 1], order[n - k]) if k else (-np.inf, np.inf)
    median = np.nan_to_num(order[[(n - 1) // 2, n // 2]].mean(), nan=0.0, posinf=np.inf, neginf=-np.inf)
    if ratio:
        median, low, high = np.exp([median, low, high])
    sign, wilcoxon, effect = _tests(difference, smaller, larger)
    return Paired(n, float(median), float(low), float(high), sign, wilcoxon, effect, smaller, larger)


def _tests(difference: np.ndarray, smaller: int, larger: int) -> tuple[float, float, float]:
    """P of the sign test, p of the signed-rank test, rank-biserial correlation."""
    if not smaller + larger:
        return 1.0, 1.0, 0.0
    sign = float(stats.binomtest(smaller, smaller + larger).pvalue)
    ranks = stats.rankdata(np.abs(difference))
    signed = np.sign(difference) * ranks
    of = signed / np.abs(signed).max()  # ranks stand for differences that may be infinite
    exact = len(difference) <= 50 and len(np.unique(ranks)) == len(ranks) and not (difference == 0).any()
    found: Any = stats.wilcoxon(of, zero_method="pratt", method="exact" if exact else "asymptotic")
    return sign, float(found.pvalue), float(signed.sum() / ranks[difference != 0].sum())
