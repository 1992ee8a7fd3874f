"""Stable systems of low order without zeros in the right half plane, of a magnitude that is free: scalings, weights.

    D(s) = g prod (s^2 + 2 a b s + a^2) / (s^2 + 2 c e s + c^2), and (s + a)/(s + c) if the order is odd

The coordinates are the logarithms of g, a, b, c, e of every pair, then of a, c of the single section: (1 + 2 k,) for
order k. Poles and zeros are stable whatever they are; D and 1/D are proper.

Reference: Balas, Doyle, Glover, Packard and Smith (1993), mu-Analysis and Synthesis Toolbox (weights by the level).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares
from scipy.special import expit

from synth.systems.realization import Matrices
from synth.systems.statespace import StateSpace

EVALUATIONS = 200  # of a fit
FARTHEST = 1.0  # decades beyond the data where poles and zeros may be
DAMPING = (0.05, 20.0)  # of a section
FAR = 150.0  # logarithm of a ratio of frequencies beyond which nothing changes


def fitted(omega: np.ndarray, magnitude: np.ndarray, weight: np.ndarray, order: int, below: float = 1.0) -> StateSpace:
    """The continuous system of that order whose magnitude is nearest at frequencies in rad/s, (k,) positive.

    Where it is below the magnitude its distance counts `below` times.
    """
    return StateSpace(*matrices(coordinates(omega, magnitude, weight, order, below)), 0.0)


def coordinates(
    omega: np.ndarray, magnitude: np.ndarray, weight: np.ndarray, order: int, below: float = 1.0
) -> np.ndarray:
    """The coordinates of `fitted`."""
    x, target = np.log(omega), np.log(magnitude)
    if order == 0:
        return np.array([np.average(target, weights=weight)])
    pairs, single = divmod(order, 2)
    least, most = box(order, omega)

    def misfit(y: np.ndarray) -> np.ndarray:
        off = weight * (log_magnitude(y, x)[0] - target)
        return np.where(off < 0, below * off, off)

    def slope(y: np.ndarray) -> np.ndarray:
        value, by = log_magnitude(y, x)
        return np.where(value < target, below * weight, weight)[:, None] * by

    best = None
    for ratio in (1.0, 3.0, 1 / 3):
        start = np.clip(_start(x, target, pairs, single, np.log(ratio)), least, most)
        found = least_squares(misfit, start, jac=slope, bounds=(least, most), max_nfev=EVALUATIONS)  # pyright: ignore[reportArgumentType]
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return best.x


def box(order: int, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest coordinates of a system that does something at frequencies in rad/s."""
    low, high = np.log(omega.min()) - FARTHEST * np.log(10), np.log(omega.max()) + FARTHEST * np.log(10)
    pairs, single = divmod(order, 2)
    bounds = [(-np.inf, np.inf)] + [(low, high), np.log(DAMPING)] * (2 * pairs) + [(low, high)] * (2 * single)
    least, most = np.array(bounds).T
    return least, most


def _start(x: np.ndarray, target: np.ndarray, pairs: int, single: int, shift: float) -> np.ndarray:
    """Sections evenly over the frequencies, zeros beside their poles."""
    at = np.quantile(x, (np.arange(pairs + single) + 0.5) / (pairs + single))
    y = [float(target[-1])]
    for w in at[:pairs]:
        y += [w + shift, 0.0, w - shift, 0.0]
    for w in at[pairs:]:
        y += [w + shift, w - shift]
    return np.array(y)


def order_of(y: np.ndarray) -> int:
    """Poles of the system of these coordinates."""
    return (len(y) - 1) // 2


def log_magnitude(y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log |D| at logarithms of k frequencies, (k,), every section relative to its high-frequency gain of one.

    With its derivatives by the coordinates, (k, len(y)).
    """
    value, slope = np.full_like(x, y[0]), np.ones((len(x), len(y)))
    pairs, single = divmod(order_of(y), 2)
    for k in range(1, 1 + 4 * pairs, 4):
        for sign, i in ((1, k), (-1, k + 2)):
            section, by_a, by_b = _section(x, y[i], y[i + 1])
            value = value + sign * section
            slope[:, i], slope[:, i + 1] = sign * by_a, sign * by_b
    if single:
        a, c = y[-2:]
        value = value + 0.5 * (np.logaddexp(2 * x, 2 * a) - np.logaddexp(2 * x, 2 * c))
        slope[:, -2], slope[:, -1] = expit(2 * (a - x)), -expit(2 * (c - x))
    return value, slope


def _section(x: np.ndarray, a: float, b: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log |(s^2 + 2 a b s + a^2)/s^2| for logarithms of s / j, a and b, with its derivatives by these two."""
    u, e = np.exp(2 * np.clip(a - x, -FAR, FAR)), np.exp(2 * b)
    size = (1 - u) ** 2 + 4 * e * u
    return 0.5 * np.log(size), u * (4 * e - 2 * (1 - u)) / size, 4 * e * u / size


def raised(y: np.ndarray, at: float) -> np.ndarray:
    """Coordinates of the same system with a pole and a zero more, which cancel at the logarithm of a frequency."""
    if order_of(y) % 2 == 0:
        return np.append(y, [at, at])
    pair = [half for w in y[-2:] for half in ((w + at) / 2, np.log(np.cosh((w - at) / 2)))]
    return np.append(y[:-2], pair)


def matrices(y: np.ndarray) -> Matrices:
    """The continuous system of the coordinates."""
    pairs, single = divmod(order_of(y), 2)
    D = Matrices(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.exp(y[:1, None]))
    for k in range(pairs):
        a, b, c, e = np.exp(y[1 + 4 * k : 5 + 4 * k])
        A, B = np.array([[0.0, c], [-c, -2 * c * e]]), np.array([[0.0], [1.0]])
        D = _after(D, Matrices(A, B, np.array([[(a**2 - c**2) / c, 2 * (a * b - c * e)]]), np.eye(1)))
    if single:
        a, c = np.exp(y[-2:])
        D = _after(D, Matrices(np.array([[-c]]), np.eye(1), np.array([[a - c]]), np.eye(1)))
    return D


def _after(G: Matrices, H: Matrices) -> Matrices:
    """H G."""
    A = np.block([[G.A, np.zeros((len(G.A), len(H.A)))], [H.B @ G.C, H.A]])
    return Matrices(A, np.vstack([G.B, H.B @ G.D]), np.hstack([H.D @ G.C, H.C]), H.D @ G.D)
