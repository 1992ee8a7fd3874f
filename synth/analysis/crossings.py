"""Where a loop of one signal is real, and where its modulus is one: the frequencies at which margins are read.

Nothing is gridded. A loop L(z) meets the critical point where it is real or has modulus one, that is, at the unit
eigenvalues of two symplectic-like pencils (L~ is the transpose of L(1/z)):

    real    L - L~ = 0:    x+ = A x + B v, q = A'q+ + C'v, 0 = C x + (D - D') v - B'q+
    unit    L~ L - 1 = 0:  the pencil of the bounded-real lemma at level one (`norms.crossings`)

Continuous loops go through the Cayley map. A candidate is then moved to where the response of the given system, of its
own matrices, is real or of modulus one, and left out where it is not. Where rounding takes eigenvalues off the circle,
as integrators beside fast poles do, they still tell how closely to look: a change of sign from one to the next is a
crossing too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.norms import NEAR_CIRCLE, balance
from synth.analysis.norms import crossings as level_crossings
from synth.systems.modes import doubts
from synth.systems.sampled import cayley, loop_rate
from synth.systems.statespace import StateSpace

REAL = 1e-6  # |Im L| / |L| up to which a polished candidate counts as real
UNIT = 1e-6  # distance of |L| from one up to which a polished candidate counts as a crossing
NARROW, WIDE = 1e-6, 1e-2  # of an angle: where a change of sign is looked for
AT_ORIGIN = 1e-6  # angle, its least unit
BESIDE = 1e-3  # of a pole's angle: where the loop is looked at on both sides of it
SAME = 1e-6  # difference of angles, and relative one of responses, that is rounding


class Crossing(NamedTuple):
    """A frequency, and the loop there."""

    frequency: float  # rad/s, inf at the end of a continuous loop
    value: complex


@dataclass(frozen=True)
class Crossings:
    """What margins are read from."""

    real: tuple[Crossing, ...]  # L is real and finite, ends included
    unit: tuple[Crossing, ...]  # |L| is one, by frequency
    end: complex  # L at infinite frequency, at Nyquist's in discrete time


def find(L: StateSpace) -> Crossings:
    """The crossings of a loop of one signal."""
    given, poles = balance(L), doubts(balance(L).A)
    rate = 0.0 if L.discrete else loop_rate(given)
    mapped = given if L.discrete else balance(cayley(given, rate))

    def frequency(angle: float) -> float:
        if L.discrete:
            return angle / L.dt
        return np.inf if angle >= np.pi else float(rate * np.tan(angle / 2))

    def response(angle: float) -> complex:
        if not L.n or (angle >= np.pi and not L.discrete):
            return complex(L.D[0, 0])
        s = np.exp(1j * angle) if L.discrete else 1j * frequency(angle)
        try:
            if np.any(np.abs(poles[0] - s) <= poles[1]):  # a pole there, for all that rounding tells
                return complex(np.inf)
            return complex(given.matrices.at(s)[0, 0])
        except np.linalg.LinAlgError:
            return complex(np.inf)

    ends, (real_angles, others) = [0.0, np.pi], _real_angles(mapped)
    unit_angles = level_crossings(mapped, 1.0)
    moduli = np.abs(np.concatenate([poles[0], np.imag(poles[0])]))  # of continuous poles
    own = np.abs(np.angle(poles[0])) if L.discrete else 2 * np.arctan(moduli / (rate or 1.0))
    between = np.concatenate([real_angles, others, unit_angles, own * (1 - BESIDE), own * (1 + BESIDE)])
    real = [*ends, *_polished(real_angles, between, lambda angle: response(angle).imag)]
    unit = [*ends, *_polished(unit_angles, between, lambda angle: abs(response(angle)) - 1)]
    found = {angle: response(angle) for angle in sorted({*real, *unit})}
    is_real = [a for a in set(real) if np.isfinite(found[a]) and abs(found[a].imag) <= REAL * abs(found[a])]
    is_unit = [a for a in set(unit) if abs(abs(found[a]) - 1) <= UNIT]
    return Crossings(
        real=tuple(Crossing(frequency(a), found[a]) for a in _apart(is_real, found)),
        unit=tuple(Crossing(frequency(a), found[a]) for a in _apart(is_unit, found)),
        end=found[np.pi],
    )


def _apart(angles: list[float], found: dict[float, complex]) -> list[float]:
    """The angles in order, those once that rounding made of one: where a curve touches, and at the ends."""
    kept: list[float] = []
    for angle in sorted(angles, key=lambda a: (a not in (0.0, np.pi), a)):
        near = (other for other in kept if abs(angle - other) <= SAME)
        if not any(abs(found[angle] - found[other]) <= SAME * abs(found[other]) for other in near):
            kept.append(angle)
    return sorted(kept)


def _real_angles(L: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Angles from 0 to pi at which a discrete loop may be real, and those of the pencil's other eigenvalues."""
    O, n = np.zeros, L.n
    M = np.block([
        [L.A, O((n, n)), L.B],
        [O((n, n)), -np.eye(n), L.C.T],
        [L.C, O((1, n)), L.D - L.D.T],
    ])  # fmt: skip
    N = np.block([
        [np.eye(n), O((n, n + 1))],
        [O((n, n)), -L.A.T, O((n, 1))],
        [O((1, n)), L.B.T, O((1, 1))],
    ])  # fmt: skip
    alpha, beta = np.asarray(sla.eigvals(M, N, homogeneous_eigvals=True))
    alpha, beta = alpha[beta != 0], beta[beta != 0]  # 0/0: of no frequency
    near = np.abs(np.abs(alpha) - np.abs(beta)) <= NEAR_CIRCLE * np.abs(beta)
    angles = np.abs(np.angle(alpha / beta))
    return np.unique(angles[near]), np.unique(angles[~near])


def _polished(angles: np.ndarray, between: np.ndarray, function: Callable[[float], float]) -> list[float]:
    """Zeros of a function near the angles: bracketed where it changes sign, as they are where it does not.

    And those between neighbours of `between` where it changes sign.
    """
    from scipy.optimize import root_scalar  # a fifth of a second, which no design needs

    found = []
    for angle in angles:
        width = NARROW * max(angle, AT_ORIGIN)
        while width < WIDE * max(angle, 1e2 * AT_ORIGIN):
            low, high = max(angle - width, 0.0), min(angle + width, np.pi)
            if function(low) * function(high) < 0:
                angle = root_scalar(function, bracket=(low, high), xtol=1e-15).root
                break
            width *= 10
        found.append(float(angle))
    points = np.unique(between[(between > 0) & (between < np.pi)])
    points = np.unique([*points, *np.sqrt(points[1:] * points[:-1])])
    signs = np.sign([function(point) for point in points])
    for i in np.flatnonzero(signs[1:] * signs[:-1] < 0):
        found.append(float(root_scalar(function, bracket=(points[i], points[i + 1]), xtol=1e-15).root))
    return found
