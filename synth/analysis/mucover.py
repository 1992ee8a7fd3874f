"""The bound of the structured singular value by (D, G) scalings at all frequencies, none of them left out.

A level t is proved between two frequencies by scalings that are interpolated: at both ends the analytic centres of
those that prove t, and X(w) between them, affine in c = (r^2 - w^2)/(r^2 + w^2) = cos(theta) under the Cayley map of
rate r. Then F(w) (`scalings`) is a quadratic form of the mapped system and its delayed signals, and is singular only at
unit eigenvalues of one pencil (`norms.singular_angles`); between these its least eigenvalue is looked at. Intervals in
which it is not positive are halved. Where no scalings prove t at an end, a higher level was found.

All of this is floating point: verified between frequencies, not proved.

References: as of `scalings`; Boyd, Balakrishnan and Kabamba (1989), Math. Control Signals Systems 2, 207 (level sets).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from synth.analysis.blocks import Structure
from synth.analysis.norms import balance, climb, singular_angles
from synth.analysis.scalings import Cone, Scalings, Search, best_scalings
from synth.errors import NumericalError
from synth.systems.sampled import apart, cayley
from synth.systems.statespace import StateSpace

INTERVALS = 3000  # at most
TRIES = 40  # levels
PER_DECADE = 3  # frequencies of the first look
BEYOND = 10.0  # times the fastest pole, and below the slowest
FAR = 16.0  # ratio by which an interval without end is cut
LITTLE = 1e-6  # of the largest norm: a bound below it is not looked for
NARROW = 1e-9  # relative width of an interval that is one frequency to rounding
WITHIN = 1e-9  # part of an interval of angles at its ends where the centres themselves prove the level
EXACT = 0.03  # part of the tolerance to which bounds at single frequencies are found
WIDER = 3.0  # times the tolerance, where a level is not proved
WIDEST = 0.3  # tolerance beyond which none is

Parts = tuple[np.ndarray, np.ndarray, np.ndarray]  # D on the outputs, D on the inputs, G
Response = Callable[[float], np.ndarray]  # rad/s -> (p, m)


class Cover(NamedTuple):
    """A bound at all frequencies."""

    upper: float  # verified at all frequencies
    peak: float  # the largest bound found at one frequency
    frequency: float  # rad/s, where that is
    scalings: Scalings  # there
    tops: list[float]  # rad/s, the highest frequencies of the first look
    intervals: int  # that cover all frequencies
    centres: dict[float, Parts]  # rad/s -> scalings between which `upper` was shown, with det D = 1


def response(G: StateSpace) -> Response:
    """The transfer matrix of a continuous system by frequency in rad/s, inf included."""
    H = balance(G)

    def at(w: float) -> np.ndarray:
        return H.matrices.at(1j * w) if np.isfinite(w) and H.n else H.D.astype(complex)

    return at


def cover(G: StateSpace, blocks: Structure, tol: float) -> Cover:
    """The bound of a stable continuous system over all frequencies, within `tol` of the largest at one of them.

    Raises
    ------
    NumericalError : no level near it could be shown between frequencies.
    """
    at, cone, exact = response(G), Cone(blocks), tol * EXACT

    def mu(w: float) -> float:
        return best_scalings(at(w), blocks, cone, exact).bound

    bounds = {w: Search(at(w), cone).size for w in _edges(G)}
    floor = LITTLE * max(float(np.linalg.norm(at(w), 2)) for w in bounds) or np.finfo(float).tiny
    peak = 0.0
    for w in sorted(bounds, key=lambda w: -bounds[w]):
        if bounds[w] > peak or not blocks.is_complex:  # balancing has not shown yet that it is lower
            bounds[w] = mu(w)
            peak = max(peak, bounds[w])
    tops = sorted(bounds, key=lambda w: -bounds[w])
    peak, where = _climbed(mu, bounds, tops[0], exact)
    for _ in range(TRIES):
        level = max(peak * (1 + tol), floor)
        shown = Level(G, at, cone, level)
        found = shown.proved(sorted(bounds))
        if isinstance(found, int):
            centres = {w: parts for w, parts in shown.centres.items() if parts is not None}
            return Cover(level, peak, where, best_scalings(at(where), blocks, cone), tops, found, centres)
        if found is not None:
            bounds[found] = mu(found)
            if bounds[found] > peak:
                peak, where = _climbed(mu, bounds, found, exact)
                continue
        tol *= WIDER
        if tol > WIDEST:
            break
    raise NumericalError(
        f"the largest bound found at a frequency is {peak:.6g}, and no level up to {WIDEST:.0%} above it could be "
        "shown between frequencies: rounding hides it; bring the states of M to better units"
    )


def _edges(G: StateSpace) -> list[float]:
    """Frequencies of the first look: zero, poles, a few in every decade, infinity."""
    moduli = np.abs(G.poles())
    moduli = moduli[moduli > 0]
    if not moduli.size:
        return [0.0, np.inf]
    low, high = moduli.min() / BEYOND, moduli.max() * BEYOND
    some = np.geomspace(low, high, int(np.ceil(PER_DECADE * np.log10(high / low))) + 1)
    edges = np.unique([*some, *moduli])
    return [0.0, *edges[np.append(True, np.diff(edges) > NARROW * edges[1:])].tolist(), np.inf]


def _climbed(mu: Callable[[float], float], bounds: dict[float, float], w: float, exact: float) -> tuple[float, float]:
    """The local maximum between the neighbours of a frequency, over its logarithm."""
    edges = sorted(bounds)
    i = edges.index(w)
    low, high = edges[max(i - 1, 0)], edges[min(i + 1, len(edges) - 1)]
    low, high = low or edges[1] / FAR, high if np.isfinite(high) else edges[-2] * FAR
    if not 0 < low < high:
        return bounds[w], w
    top, at = climb(lambda x: mu(float(np.exp(x))), float(np.log(low)), float(np.log(high)), exact)
    return max((top, float(np.exp(at))), (bounds[w], w))


class Level:
    """A level that is to be shown at all frequencies."""

    def __init__(self, G: StateSpace, at: Response, cone: Cone, level: float):
        self.G, self.at, self.cone, self.level = G, at, cone, level
        self.poles = G.poles()
        self.centres: dict[float, Parts | None] = {}

    def proved(self, edges: list[float]) -> int | float | None:
        """How many intervals show it; else a frequency where the bound is above it, None where rounding decides."""
        left, count, last = list(pairwise(edges)), 0, None
        while left:
            low, high = left.pop()
            ends = self.centre(low, last), self.centre(high, last)
            for w, end in zip((low, high), ends, strict=True):
                if end is None:
                    return w
            last = ends[0]
            count += 1
            if not self.holds(low, high, *ends):  # pyright: ignore[reportArgumentType]
                middle = _middle(low, high)
                if count > INTERVALS or not low < middle < high or high - low < NARROW * high < np.inf:
                    return None
                left += [(low, middle), (middle, high)]
        return count

    def centre(self, w: float, near: Parts | None) -> Parts | None:
        """The analytic centre of the scalings that show the level at a frequency."""
        if w not in self.centres:
            search = Search(self.at(w), self.cone)
            if near is not None:
                search.start_at(near)
            self.centres[w] = search.centre_at(self.level)
        return self.centres[w]

    def form(self, w: float, parts: Parts) -> float:
        """The least eigenvalue of F at a frequency, with D = I on the inputs by its diagonal."""
        M, (left, right, G) = self.at(w), parts
        GM = G @ M
        F = self.level**2 * right - M.conj().T @ left @ M - 1j * (GM - GM.conj().T)
        d = np.sqrt(np.real(right.diagonal()))
        return float(np.linalg.eigvalsh(F / np.outer(d, d))[0])

    def holds(self, low: float, high: float, first: Parts, last: Parts) -> bool:
        """F is positive with interpolated scalings at all frequencies between two."""
        rate = np.sqrt(low * high) if low > 0 and np.isfinite(high) else high if np.isfinite(high) else low
        rate = apart(float(rate) or 1.0, self.poles)
        a, b = (2 * np.arctan(w / rate) if np.isfinite(w) else np.pi for w in (low, high))

        def parts(angle: float) -> Parts:
            share = (np.cos(a) - np.cos(angle)) / (np.cos(a) - np.cos(b))
            left, right, G = ((1 - share) * X + share * Y for X, Y in zip(first, last, strict=True))
            return left, right, G

        def positive(angle: float) -> bool:
            return self.form(rate * np.tan(angle / 2), parts(angle)) > 0

        if not positive((a + b) / 2):
            return False
        ends = self.singular(rate, a, b, first, last)
        inside = ends[(ends > a + WITHIN * (b - a)) & (ends < b - WITHIN * (b - a))]
        points = [a, *inside.tolist(), b]
        return all(positive((x + y) / 2) for x, y in pairwise(points))

    def singular(self, rate: float, a: float, b: float, first: Parts, last: Parts) -> np.ndarray:
        """Angles at which F with interpolated scalings may be singular."""
        H = balance(cayley(self.G, rate))
        n, (p, m) = H.n, H.D.shape
        dl, dr = (np.sqrt(np.real(X.diagonal())) for X in first[:2])
        dl, dr = dl * self.level**-0.5, dr * self.level**0.5  # F over the level squared, on balanced signals
        B, C, D = H.B / dr, dl[:, None] * H.C, dl[:, None] * H.D / dr
        X, Y = (
            _form(left / np.outer(dl, dl), right * self.level**2 / np.outer(dr, dr), G / np.outer(dr, dl))
            for left, right, G in (first, last)
        )
        slope = (X - Y) / (np.cos(a) - np.cos(b))
        at_zero = X - np.cos(a) * slope
        both = np.block([[at_zero, slope / 2], [slope / 2, np.zeros_like(slope)]])
        N = np.block([[C, D], [np.zeros((m, n)), np.eye(m)]])  # (q, w) of (x, w)
        k = p + m
        A = np.block([[H.A, np.zeros((n, k))], [N[:, :n], np.zeros((k, k))]])
        out = np.block([[N[:, :n], np.zeros((k, k)), N[:, n:]], [np.zeros((k, n)), np.eye(k), np.zeros((k, m))]])
        W = out.T @ both @ out
        z = n + k
        return singular_angles(A, np.vstack([B, N[:, n:]]), W[:z, :z], W[:z, z:], W[z:, z:])


def _form(left: np.ndarray, right: np.ndarray, G: np.ndarray) -> np.ndarray:
    """F as a form of (q, w): real where it is."""
    F = np.block([[-left, 1j * G.conj().T], [-1j * G, right]])
    return F if np.any(np.imag(F)) else np.real(F)


def _middle(low: float, high: float) -> float:
    """Between two frequencies."""
    if low == 0:
        return high / FAR if np.isfinite(high) else 1.0
    return float(np.sqrt(low) * np.sqrt(high)) if np.isfinite(high) else low * FAR
