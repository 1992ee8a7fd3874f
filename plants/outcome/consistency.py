"""Consistency of filters: whether their errors are as large as they believe.

NEES e' P^-1 e of an error e with the believed covariance P, and NIS of an innovation, are chi-square if the filter is
right: their sum over independent runs lies in a band that theory gives. Above the band a filter is too sure of itself,
below it wastes information. Bar-Shalom, Li and Kirubarajan (2001), Estimation with applications to tracking and
navigation, section 5.4.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from plants.checks import real
from plants.errors import ScenarioError
from plants.outcome.report import table


class Consistency(NamedTuple):
    """Averages over runs at each of T times, per degree of freedom: 1 is expected."""

    average: np.ndarray  # (T,) NaN where there was nothing to average
    low: np.ndarray  # (T,) the band that holds the average of a right filter with the given confidence
    high: np.ndarray  # (T,)
    inside: float  # () fraction of the times inside the band: the confidence, if the filter is right
    mean: float  # () over all times and runs

    @property
    def verdict(self) -> str:
        """What the mean says, in words."""
        low, high = np.nanmean(self.low), np.nanmean(self.high)
        return "consistent" if low <= self.mean <= high else "too sure" if self.mean > high else "too cautious"


def nees(errors: ArrayLike, covariances: ArrayLike, confidence: float = 0.95) -> Consistency:
    """Normalised estimation error squared of R independent runs.

    Parameters
    ----------
    errors : (R, T, n) true less estimated
    covariances : (R, T, n, n) what the filter believed, positive definite
    confidence : () of the band, between 0 and 1

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, a covariance that is not positive definite.
    """
    e = real("errors", errors, (None, None, None))
    P = real("covariances", covariances, (*e.shape, e.shape[-1]))
    try:
        half = np.linalg.solve(np.linalg.cholesky(P), e[..., None])[..., 0]
    except np.linalg.LinAlgError as error:
        raise ScenarioError("covariances must be positive definite: leave out what the filter is sure of") from error
    return _band(np.sum(half**2, axis=-1), np.full(e.shape[:2], float(e.shape[-1])), confidence)


def nis(values: ArrayLike, rows: ArrayLike, confidence: float = 0.95) -> Consistency:
    """Normalised innovation squared of R independent runs.

    Parameters
    ----------
    values : (R, T) z' S^-1 z of the innovations z of a sample with the believed covariance S
    rows : (R, T) how many scalars z had, 0 for none
    confidence : () of the band, between 0 and 1

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, negative numbers.
    """
    z = real("values", values, (None, None), low=0)
    return _band(z, real("rows", rows, z.shape, low=0), confidence)


def consistency(runs: Sequence[Any], start: float = 0.0, confidence: float = 0.95) -> dict[str, Consistency]:
    """What R flights with ``record=mekf_record`` say of their filter, from `start` () s on.

    "state" and "attitude" are NEES of all states and of the attitude alone, "innovations" is NIS.

    Raises
    ------
    ScenarioError
        No run; one that failed, or was recorded otherwise; nothing after `start`, or no attitude yet.
    """
    if not runs or not all(run.ok for run in runs):
        raise ScenarioError(f"runs: {sum(not run.ok for run in runs)} of {len(runs)} failed; give whole flights")
    if not all(hasattr(run.extra, "covariance") for run in runs):
        raise ScenarioError("runs hold no record of a filter: fly them with record=plants.mekf_record")
    late = runs[0].time >= start
    error, covariance, known, values, rows = (
        np.stack([getattr(run.extra, name)[late] for run in runs])
        for name in ("error", "covariance", "known", "nis", "rows")
    )
    if not (known > 0).all():
        raise ScenarioError(f"start = {start} s: some filter has no attitude yet; give a later one")
    return {
        "state": nees(error, covariance, confidence),
        "attitude": nees(error[..., :3], covariance[..., :3, :3], confidence),
        "innovations": nis(values, rows, confidence),
    }


def consistency_table(found: Mapping[str, Consistency]) -> str:
    """HTML of one row for each entry: the mean, where it should lie, how often it does, and the verdict."""
    rows = [
        (
            name,
            f"{c.mean:.3f}",
            f"{np.nanmean(c.low):.3f} to {np.nanmean(c.high):.3f}",
            f"{100 * c.inside:.0f} %",
            c.verdict,
        )
        for name, c in found.items()
    ]
    return table(("filter", "mean", "band of one sample", "inside", "verdict"), rows)


def _band(squares: np.ndarray, freedom: np.ndarray, confidence: float) -> Consistency:
    """Averages over the first axis against those of chi-square numbers with so many degrees of freedom."""
    level = float(real("confidence", confidence))
    if not 0 < level < 1:
        raise ScenarioError(f"confidence = {confidence}: give a number between 0 and 1, such as 0.95")
    total = freedom.sum(axis=0)
    some = total > 0
    if not some.any():
        raise ScenarioError("there is nothing to average: no run, no time, or no scalar was used")
    count = np.where(some, total, 1.0)
    average, low, high = (
        np.where(some, a / count, np.nan)
        for a in (squares.sum(axis=0), *(chi2.ppf(p, count) for p in ((1 - level) / 2, (1 + level) / 2)))
    )
    inside = np.mean((average[some] >= low[some]) & (average[some] <= high[some]))
    return Consistency(average, low, high, float(inside), float(squares.sum() / total.sum()))
