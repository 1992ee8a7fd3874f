"""Structured singular values: how far every channel may change on its own, complex, until I - M Delta is singular.

    mu(M) = 1 / (the least max_i |delta_i| for which I - M diag(delta) is singular)
          <= min over diagonal D > 0 of sigma_max(D M D^-1),       with equality for up to three channels

At one frequency X = D^2 is found by the method of analytic centres: t X - M* X M > 0 is linear in X, and its inverse
W at the centre tells how much lower t can be, since no t is below min_i (M W M*)_ii / W_ii.

Over all frequencies nothing is gridded. A scaling D that is best at one frequency is enough wherever
sigma_max(D M D^-1) is below a level, and the ends of these intervals are unit eigenvalues of a pencil (`norms`).
Scalings are added until their intervals cover the circle, or one of them finds a higher level. Where constant ones
reach little, sections of first order follow the best ones.

References: Doyle (1982), IEE Proceedings D 129, 242 (mu, and the bound by scalings); Packard and Doyle (1993),
Automatica 29, 71 (power iteration); Boyd and El Ghaoui (1993), Linear Algebra and its Applications 188, 63
(analytic centres of generalised eigenvalue problems); Osborne (1960), J. ACM 7, 338 (balancing).
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synth.analysis.norms import TOLERANCE, Gain, Transfer, ascend, balance, climb, crossings, transfer
from synth.errors import NumericalError
from synth.systems.connect import series
from synth.systems.sampled import cayley
from synth.systems.statespace import StateSpace

EXACT = 1e-10  # relative distance of the scaled norm from its lower bound at which a scaling is best
ROUNDED = 1e-12  # relative distance of t from the largest eigenvalue below which rounding decides
CENTRES = 60  # at most; each brings t nearer by the factor NEARER
NEARER = 0.1
NEAR_CENTRE = 0.25  # Newton decrement from which on full steps stay inside
BALANCED = 1e-3  # change of a scale by which balancing ends
SWEEPS = 200  # of balancing
UNCOUPLED = 1e-10  # relative size of a coupling that is none
SCALINGS = 400  # at most, to cover the circle
SHARP = 1e-5  # of an interval of angles: where a maximum is climbed again if it is lower at the ends
BESIDE = 1e-7  # of an angle
LITTLE = 1e-2  # of an angle: how far a scaling should reach
STEP = 1e-3  # of an angle: over which scalings are seen to change
STEEPEST = 0.99  # slope of a section of first order
NARROW = 1e-9  # relative width of an interval of angles that is one frequency to rounding
POWERS = 200  # steps of a power iteration
STARTS = 8  # of it


class Scaled(NamedTuple):
    """The least scaled norm of a matrix."""

    norm: float  # sigma_max(D M D^-1)
    D: np.ndarray  # (m,) the diagonal


class Peak(NamedTuple):
    """The largest structured singular value over all frequencies."""

    value: float
    angle: float  # on the unit circle


def balanced_scaling(M: np.ndarray) -> Scaled:
    """The scaling that gives row and column i like norms (Osborne); it is the best one for two channels.

    Of two channels that are coupled one way only, the coupling can be scaled away: down to `UNCOUPLED`, which every
    entry counts at least in the coordinates reached, so that rounding errors of zero couple nothing either.
    """
    size = np.abs(M) ** 2
    radius = float(np.abs(np.linalg.eigvals(np.abs(M))).max())
    least = (UNCOUPLED * max(radius, UNCOUPLED * float(np.abs(M).max()))) ** 2
    off, D = ~np.eye(len(M), dtype=bool), np.ones(len(M))
    for _ in range(SWEEPS):
        most = 1.0
        for i, others in enumerate(off):
            row, column = np.maximum(size[i], least)[others].sum(), np.maximum(size[:, i], least)[others].sum()
            if row > 0 and column > 0:
                factor = (column / row) ** 0.25
                most = max(most, factor, 1 / factor)
                size[i] *= factor**2
                size[:, i] /= factor**2
                D[i] *= factor
        if most < 1 + BALANCED:
            break
    return Scaled(float(np.linalg.norm(M * D[:, None] / D, 2)), D)


def best_scaling(M: np.ndarray) -> Scaled:
    """The diagonal D > 0 with the least sigma_max(D M D^-1), to `EXACT`."""
    start = balanced_scaling(M)
    m = len(M)
    if m < 3 or start.norm == 0:
        return start
    N = M * start.D[:, None] / start.D / start.norm
    x, best, low = np.ones(m), start, 0.0
    t = top = 1.0  # the square of the norm relative to that of the start
    for _ in range(CENTRES):
        t = max(top + NEARER * (t - top), top * (1 + ROUNDED)) if t > top else 1 + NEARER
        centre = _centre(N, x, t)
        if centre is None:
            break
        x, bound = centre
        low = max(low, bound)
        D = start.D * np.sqrt(x)
        norm = float(np.linalg.norm(M * D[:, None] / D, 2))
        if norm < best.norm:
            best = Scaled(norm, D)
        top = (norm / start.norm) ** 2
        if top - low < EXACT * top or t - top < ROUNDED * t:
            break
    return best


def _centre(M: np.ndarray, x: np.ndarray, t: float) -> tuple[np.ndarray, float] | None:
    """The analytic centre of t X - M* X M > 0 with trace m, from a point inside, and a lower bound of all such t."""
    m, MH = len(M), M.conj().T
    for _ in range(CENTRES):
        try:
            W = np.linalg.inv(t * np.diag(x) - (MH * x) @ M)
            MW = M @ W
            V = MW @ MH
            w, v = W.diagonal().real, V.diagonal().real
            gradient = x * (v - t * w)
            hessian = np.outer(x, x) * (t**2 * abs(W) ** 2 - t * (abs(MW) ** 2 + abs(MW.T) ** 2) + abs(V) ** 2)
            K = np.block([[hessian, x[:, None]], [x[None, :], np.zeros((1, 1))]])
            step = np.linalg.solve(K, [*-gradient, 0.0])[:m]
        except np.linalg.LinAlgError:
            return None
        decrement = np.sqrt(max(float(-gradient @ step), 0.0))
        if not (np.isfinite(decrement) and w.min() > 0):
            return None
        x = x * (1 + step / (1 + decrement if decrement > NEAR_CENTRE else 1))
        if not x.min() > 0:
            return None
        x *= m / x.sum()
        if decrement < NEAR_CENTRE:
            return x, float((v / w).min())
    return None


def structured_norm(H: StateSpace) -> Peak:
    """The largest structured singular value of a stable discrete system over all frequencies.

    An upper bound, exact for up to three channels, at all frequencies up to the relative `TOLERANCE`: measured in
    floating point, not proved.

    Raises
    ------
    NumericalError : the scalings did not cover the circle.
    """
    response, poles = transfer(balance(H))

    def mu(angle: float) -> float:
        M = response(angle)
        return best_scaling(M).norm if np.isfinite(M).all() else np.inf

    level, angle = _highest_sample(response, poles)
    open_ends = [(0.0, np.pi)]  # intervals where the level is no bound yet
    at = angle
    for _ in range(SCALINGS):
        D = best_scaling(response(at)).D
        open_ends = _left(_times(H, D), level * (1 + TOLERANCE), open_ends)
        if any(low < at * (1 + LITTLE) and high > at * (1 - LITTLE) for low, high in open_ends):
            slopes = np.log(D / best_scaling(response(at * (1 - STEP))).D) / STEP
            open_ends = _left(_following(H, D, slopes - slopes.mean(), at), level * (1 + TOLERANCE), open_ends)
        if not open_ends:
            return _summit(mu, level, angle)
        low, high = max(open_ends, key=lambda ends: ends[1] - ends[0])
        at = (low + high) / 2 if low > 0.1 * high else 0.3 * high
        if (found := mu(at)) > level * (1 + TOLERANCE):
            level, angle = max((found, at), _top(mu, low, high))
            at = angle
    raise NumericalError(
        f"{SCALINGS} scalings do not bound the structured singular value by {level:.6g}: try other units"
    )


def _highest_sample(response: Transfer, poles: np.ndarray) -> tuple[float, float]:
    """The highest local maximum near some frequencies: the best scaling is asked where balancing may be beaten."""
    angles = np.unique(np.concatenate([np.abs(np.angle(poles)), np.geomspace(1e-5, np.pi, 40), [0.0]]))
    values = {i: response(t) for i, t in enumerate(angles)}
    bounds = {i: balanced_scaling(M).norm for i, M in values.items() if np.isfinite(M).all()}
    level, best = 0.0, 0
    for i in sorted(bounds, key=lambda i: -bounds[i]):
        if bounds[i] <= level:
            break
        level, best = max((level, best), (best_scaling(values[i]).norm, i))
    low, high = angles[max(best - 1, 0)], angles[min(best + 1, len(angles) - 1)]
    return max((level, float(angles[best])), _top(lambda t: best_scaling(response(t)).norm, low, high))


def _top(mu: Gain, low: float, high: float) -> tuple[float, float]:
    """The local maximum in an interval of angles, and where it is; a sharp one is climbed twice."""
    top, at = climb(mu, low, high)
    width = SHARP * (high - low)
    ends = max(at - width, 0.0), min(at + width, np.pi)
    return max((top, at), climb(mu, *ends)) if min(map(mu, ends)) < top * (1 - EXACT) else (top, at)


def _summit(mu: Gain, level: float, angle: float) -> Peak:
    """The point itself, or the maximum uphill of it."""
    if max(mu(angle * (1 - BESIDE)), mu(min(angle * (1 + BESIDE), np.pi))) > level * (1 + ROUNDED):
        level, angle = ascend(mu, level, angle)
    return Peak(level, angle)


def _left(scaled: StateSpace, level: float, intervals: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """What remains of intervals of angles where the norm of a scaled system is not below the level."""
    scaled = balance(scaled)
    response, _ = transfer(scaled)
    ends = np.unique(np.concatenate([[0.0], crossings(scaled, level), [np.pi]]))
    left = []
    for low, high in pairwise(ends.tolist()):
        M = response((low + high) / 2)
        if high - low > NARROW * high and not (np.isfinite(M).all() and np.linalg.norm(M, 2) < level):
            left += [(max(a, low), min(b, high)) for a, b in intervals if max(a, low) < min(b, high)]
    return [(a, b) for a, b in left if b - a > NARROW * b]


def _times(H: StateSpace, D: np.ndarray) -> StateSpace:
    """D H D^-1."""
    return StateSpace(H.A, H.B / D, D[:, None] * H.C, D[:, None] * H.D / D, H.dt)


def _following(H: StateSpace, D: np.ndarray, slopes: np.ndarray, angle: float) -> StateSpace:
    """D H D^-1 with scalings that change with frequency as the best ones do near an angle.

    |(s + a)/(s + b)| with a = w / k, b = w k has the slope (k^2 - 1)/(k^2 + 1) at s = j w, in logarithms, and the
    modulus 1/k. Where the largest singular value is a double one, constant scalings reach little beside their angle.
    """
    s = np.clip(slopes * 2 * np.tan(angle / 2) / (1 + np.tan(angle / 2) ** 2) / angle, -STEEPEST, STEEPEST)
    k, w = np.sqrt((1 + s) / (1 - s)), np.tan(angle / 2)
    a, b = w / k, w * k

    def sections(zeros: np.ndarray, poles: np.ndarray, gains: np.ndarray) -> StateSpace:
        lags = StateSpace(-np.diag(poles), np.eye(len(D)), np.diag(gains * (zeros - poles)), np.diag(gains))
        return cayley(lags, 1.0, H.dt)

    return series(series(sections(b, a, 1 / (D * k)), H), sections(a, b, D * k))


def destabilising(M: np.ndarray) -> np.ndarray:
    """The smallest complex diagonal (m,) that was found with I - M diag(delta) singular: power iteration."""
    if len(M) == 1:
        return 1 / M[0]
    D = best_scaling(M).D
    N, m = M * D[:, None] / D, len(M)
    rng, best, delta = np.random.default_rng(0), 0.0, np.full(m, np.inf, complex)
    for start in range(STARTS):
        b = np.linalg.svd(N)[2][0].conj() if start == 0 else rng.normal(size=m) + 1j * rng.normal(size=m)
        w = b
        for _ in range(POWERS):
            a = _unit(N @ b)
            w = _unit(N.conj().T @ (np.abs(w) * _phase(a)))
            b = np.abs(a) * _phase(w)
        turned = _phase(b) * _phase(N @ b).conj()
        values = np.linalg.eigvals(N * turned)
        top = values[np.argmax(np.abs(values))]
        if abs(top) > best:
            best, delta = float(abs(top)), turned / top
    return delta


def _unit(a: np.ndarray) -> np.ndarray:
    """The vector of length one, or zero."""
    return a / (np.linalg.norm(a) or 1.0)


def _phase(a: np.ndarray) -> np.ndarray:
    """Every entry with modulus one."""
    return np.exp(1j * np.angle(a))
