"""Stable systems of low order without zeros in the right half plane whose magnitude is as given: scalings, weights.

    D(s) = g prod (s^2 + 2 a b s + a^2) / (s^2 + 2 c e s + c^2), and (s + a)/(s + c) if the order is odd

Its logarithm is fitted by least squares over the logarithms of g, a, b, c, e, so that poles and zeros are stable
whatever the data; D and 1/D are proper.

Reference: Balas, Doyle, Glover, Packard and Smith (1993), mu-Analysis and Synthesis Toolbox (weights by the level).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from synth.systems.connect import series
from synth.systems.statespace import StateSpace

EVALUATIONS = 200  # of a fit
FARTHEST = 1.0  # decades beyond the data where poles and zeros may be
DAMPING = (0.05, 20.0)  # of a section


def fitted(omega: np.ndarray, magnitude: np.ndarray, weight: np.ndarray, order: int, below: float = 1.0) -> StateSpace:
    """The continuous system of that order whose magnitude is nearest at frequencies in rad/s, (k,) positive.

    Where it is below the magnitude its distance counts `below` times.
    """
    x, target = np.log(omega), np.log(magnitude)
    if order == 0:
        return StateSpace.gain([[float(np.exp(np.average(target, weights=weight)))]], 0.0)
    low, high = x.min() - FARTHEST * np.log(10), x.max() + FARTHEST * np.log(10)
    pairs, single = divmod(order, 2)
    bounds = [(-np.inf, np.inf)] + [(low, high), np.log(DAMPING)] * (2 * pairs) + [(low, high)] * (2 * single)
    least, most = np.array(bounds).T

    def misfit(y: np.ndarray) -> np.ndarray:
        off = weight * (_log_magnitude(y, x, pairs) - target)
        return np.where(off < 0, below * off, off)

    best = None
    for ratio in (1.0, 3.0, 1 / 3):
        start = _start(x, target, pairs, single, np.log(ratio))
        found = least_squares(misfit, np.clip(start, least, most), bounds=(least, most), max_nfev=EVALUATIONS)
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return _system(best.x, pairs, single)


def _start(x: np.ndarray, target: np.ndarray, pairs: int, single: int, shift: float) -> np.ndarray:
    """Sections evenly over the frequencies, zeros beside their poles."""
    at = np.quantile(x, (np.arange(pairs + single) + 0.5) / (pairs + single))
    y = [float(target[-1])]
    for w in at[:pairs]:
        y += [w + shift, 0.0, w - shift, 0.0]
    for w in at[pairs:]:
        y += [w + shift, w - shift]
    return np.array(y)


def _log_magnitude(y: np.ndarray, x: np.ndarray, pairs: int) -> np.ndarray:
    """Log |D|; every section relative to its high-frequency gain of one."""
    value = np.full_like(x, y[0])
    for k in range(pairs):
        a, b, c, e = y[1 + 4 * k : 5 + 4 * k]
        value = value + _section(x, a, b) - _section(x, c, e)
    if len(y) > 1 + 4 * pairs:
        a, c = y[-2:]
        value = value + 0.5 * (np.logaddexp(2 * x, 2 * a) - np.logaddexp(2 * x, 2 * c))
    return value


def _section(x: np.ndarray, a: float, b: float) -> np.ndarray:
    """Log |(s^2 + 2 a b s + a^2)/s^2| for logarithms of s / j, a and b."""
    u = np.exp(2 * np.clip(a - x, -300, 300))
    return 0.5 * np.log((1 - u) ** 2 + 4 * np.exp(2 * b) * u)


def _system(y: np.ndarray, pairs: int, single: int) -> StateSpace:
    """The system of the parameters."""
    D = StateSpace.gain([[float(np.exp(y[0]))]], 0.0)
    for k in range(pairs):
        a, b, c, e = np.exp(y[1 + 4 * k : 5 + 4 * k])
        A = np.array([[0.0, c], [-c, -2 * c * e]])
        C = [[(a**2 - c**2) / c, 2 * (a * b - c * e)]]
        D = series(D, StateSpace(A, np.array([[0.0], [1.0]]), np.array(C), np.eye(1), 0.0))
    if single:
        a, c = np.exp(y[-2:])
        D = series(D, StateSpace(np.array([[-c]]), np.eye(1), np.array([[a - c]]), np.eye(1), 0.0))
    return D


def misfit(D: StateSpace, omega: Sequence[float] | np.ndarray, magnitude: np.ndarray) -> float:
    """The largest ratio of magnitudes, as a logarithm."""
    found = np.abs(D.frequency_response(np.asarray(omega))[:, 0, 0])
    return float(np.abs(np.log(found / magnitude)).max())
