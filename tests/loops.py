"""Loops as spacecraft have them, whose margins are known from their polynomials in exact arithmetic.

`one(rng)` draws numerator and denominator of a loop of one signal, `several(rng)` a stable loop of two or three that
are coupled; `exact_margin` finds the margins from the real roots of polynomials with rational coefficients.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from exact import exact_margins

from synth import StateSpace, feedback, system
from synth.analysis.norms import is_stable


@dataclass(frozen=True)
class Loop:
    """A transfer function of one signal."""

    kind: str
    num: np.ndarray
    den: np.ndarray


def _pd(w: float, k: float, rng) -> tuple:
    return np.array([1.4 / w, 1]) * k * w**2, [1, 0, 0]


def _pid(w: float, k: float, rng) -> tuple:
    return np.polymul([1 / w, 1], [1 / w, rng.uniform(0.05, 0.4)]) * k * w**3, [1, 0, 0, 0]


def _lags(w: float, k: float, rng) -> tuple:
    poles = w * 10 ** rng.uniform(-1.5, 1.5, rng.integers(2, 6))
    return [np.prod(poles) * k], np.poly(-poles)


def _unstable(w: float, k: float, rng) -> tuple:
    return [2 * k * w], np.polymul([1, -w * rng.uniform(0.1, 0.5)], [0.05 / w, 1])


def _lead(w: float, k: float, rng) -> tuple:
    return np.polymul([3 * k / w, k], [w * w]), np.polymul([1, 0, 0], [0.1 / w, 1])


def _flexible(rigid: Callable) -> Callable:
    def loop(w: float, k: float, rng) -> tuple:
        num, den = rigid(w, k, rng)
        for _ in range(rng.integers(1, 4)):
            pole, damping = w * 10 ** rng.uniform(-0.5, 2), 10 ** rng.uniform(-4, -1.5)
            zero = pole * rng.uniform(0.6, 0.98)
            num = np.polymul(num, [1 / zero**2, 2 * damping / zero, 1])
            den = np.polymul(den, [1 / pole**2, 2 * damping / pole, 1])
        return num, np.polymul(den, [1 / (30 * w), 1])

    return loop


KINDS = {
    "pd": _pd,
    "pid": _pid,
    "lags": _lags,
    "unstable": _unstable,
    "lead": _lead,
    "flexible pd": _flexible(_pd),
    "flexible pid": _flexible(_pid),
}


def one(rng: np.random.Generator) -> Loop:
    """A loop of one signal with a bandwidth between 1e-2 and 1e2 rad/s; some are unstable when closed."""
    kind = str(rng.choice([*KINDS]))
    w, k = 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-0.7, 0.7)
    num, den = KINDS[kind](w, k, rng)
    return Loop(kind, np.array(num, float), np.array(den, float))


def several(rng: np.random.Generator) -> StateSpace:
    """A loop of two or three signals, coupled at both ends, that is stable when it is closed."""
    while True:
        m = int(rng.integers(2, 4))
        L = diagonal([system(loop.num, loop.den) for loop in (one(rng) for _ in range(m))])
        X, Y = (np.eye(m) + rng.uniform(0, 0.6) * rng.normal(size=(m, m)) for _ in range(2))
        coupled = StateSpace(L.A, L.B @ X, np.linalg.solve(Y, L.C), np.linalg.solve(Y, L.D @ X))
        if is_stable(feedback(coupled, np.eye(m))):
            return coupled


def diagonal(systems: list[StateSpace]) -> StateSpace:
    """Loops of one signal side by side."""
    ends = np.cumsum([G.n for G in systems])
    m, n = len(systems), int(ends[-1])
    A, B, C = np.zeros((n, n)), np.zeros((n, m)), np.zeros((m, n))
    for i, (G, end) in enumerate(zip(systems, ends, strict=True)):
        own = slice(end - G.n, end)
        A[own, own], B[own, i], C[i, own] = G.A, G.B[:, 0], G.C[0]
    return StateSpace(A, B, C, np.diag([G.D[0, 0] for G in systems]))


def orthogonal(rng: np.random.Generator, n: int) -> np.ndarray:
    """Coordinates turned at random."""
    return np.linalg.qr(rng.normal(size=(n, n)))[0]


def in_units(L: StateSpace, states: np.ndarray, signals: np.ndarray, time: float) -> StateSpace:
    """The loop with states, signals (each by its own, at input and output alike) and time in other units."""
    return StateSpace(
        time * L.A * states[:, None] / states,
        time * states[:, None] * L.B / signals,
        signals[:, None] * L.C / states,
        signals[:, None] * L.D / signals,
    )


@dataclass(frozen=True)
class Exact:
    """Margins of a stable loop."""

    gain_up: float
    gain_down: float
    phase: float
    delay: float


def exact_margin(loop: Loop) -> Exact | None:
    """Margins from roots of rational polynomials; None for a loop that is unstable when closed."""
    found = exact_margins(loop.num, loop.den, skews=())
    if "phase" not in found:
        return None
    return Exact(found["gain up"], found["gain down"], float(np.deg2rad(found["phase"])), found["delay"])
