"""Margins of loops with a delay: of one signal exactly, of several with an approximant.

The approximant is exact to 1e-9 where any loop is above a hundredth, and what is less has no part in any margin below
40 dB. Of one signal, L(s) e^(-s T), none is needed: the delay turns L and leaves its modulus, so that unit crossings
are those of L, each T w further, and roots of the closed loop cross the axis there alone, to the right where |L| falls
with w and to the left where it rises, whatever the delay. So their number in the right half plane is that without delay
and a sum over crossings. Phase crossings of the turned loop are without end; those that matter lie below the last
frequency at which |L| is that of one of them.

Reference: Walton and Marshall (1987), IEE Proceedings D 134, 101 (direct method for systems with delays).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from synth.analysis import stabilitymargins
from synth.analysis.crossings import find
from synth.analysis.norms import balance
from synth.analysis.stabilitymargins import ANY, INSIDE, NEGLIGIBLE, AllMargins, Margin, Margins, one_signal
from synth.checks import as_number, numerical
from synth.errors import ModelError, NumericalError
from synth.systems.connect import input_delay, series
from synth.systems.delays import HIGHEST, pade, pade_error
from synth.systems.modes import doubts
from synth.systems.statespace import StateSpace, as_systems, check_loop, repeated

NEAR_REST = 1e-9  # of a range of frequencies: the least one that is looked at beside zero
TURN = np.pi / 12  # by which the delay turns the loop from one point of the search to the next
BESIDE = np.geomspace(1e-3, 1e3, 37)  # of the real part of a root, points about its frequency
UNDAMPED = 1e-6  # of its modulus, the least real part that is seen
MOST = 200_000  # points
TOUCHES = 1e-9  # of the logarithmic slope of |L|: it touches one there and does not cross
SMALL = 1e-2  # a loop below this has margins above 40 dB, whatever its phase
EXACT = 1e-9  # of an approximant, up to the frequency from which on all is small
BEYOND = 1e-6  # relative: an eigenvalue that near to the axis may be on it
AT_ONCE = 1e-9  # rad: a crossing without any delay


@numerical
def margin(L: Any, sign: int, delay: Any) -> Margin:
    """`stabilitymargins.margin` of L with a delay in s: any in continuous time, whole samples in discrete time.

    Raises
    ------
    ModelError : as there; the delay is negative, or no whole number of samples.
    NumericalError : the delay is so long beside the fastest root that its phase crossings cannot be listed, or the
        number of unstable roots does not confirm the gains.
    """
    G = one_signal(L, sign)
    T = as_number("delay", delay, "a time in s that is not negative", least=0)
    if G.discrete or T == 0:
        return stabilitymargins.margin(input_delay(G, T) if T else G)
    G = balance(G)
    if unstable_roots(G, T):
        return Margin(1.0, 1.0, 0.0, 0.0, np.nan, np.nan, np.nan)
    unit = [(float(np.angle(-value * np.exp(-1j * w * T))), w) for w, value in find(G).unit if 0 < w < np.inf]
    phase, at_phase = min(((abs(lag), w) for lag, w in unit), default=(np.pi, np.nan))
    later, at_delay = min(((lag % (2 * np.pi) / w, w) for lag, w in unit), default=(np.inf, np.nan))
    gains = _gains(G, T, max((w for _, w in unit), default=0.0))
    up = min((g for g in gains if g[0] > 1), default=(np.inf, np.nan))
    down = max((g for g in gains if g[0] < 1), default=(0.0, np.nan))
    end = abs(G.D[0, 0])  # at ever higher frequencies, where the delay turns on
    up = min(up, (1 / end, np.inf)) if end > NEGLIGIBLE else up
    nearer = min((g for g in (up, down) if 0 < g[0] < np.inf), key=lambda g: abs(np.log(g[0])), default=(1.0, np.nan))
    for part in INSIDE:
        for factor in (min(up[0], ANY) ** part, max(down[0], 1 / ANY) ** part):
            if unstable_roots(replace(G, C=factor * G.C, D=factor * G.D), T):
                raise NumericalError(
                    f"the gains read at the crossings are {down[0]:.4g} to {up[0]:.4g}, but the loop with its delay of "
                    f"{T:g} s is unstable with a factor of {factor:.4g}: rounding hides a crossing; bring the states "
                    "of the loop to better units"
                )
    return Margin(float(up[0]), float(down[0]), phase, later, nearer[1], at_phase, at_delay)


@numerical
def allmargin(L: Any, sign: int = -1, *, delay: Any = 0.0) -> AllMargins:
    """Every gain, phase and delay that brings a loop of one signal to the critical point.

    Parameters
    ----------
    L, sign : as of `margin`
    delay : s, the margins are of L(s) e^(-s delay), exactly; in discrete time whole samples. In continuous time there
        are gains without end then: those that are listed hold all that may be the nearest to one

    Raises
    ------
    ModelError : as `margin`.
    """
    G = one_signal(L, sign)
    T = as_number("delay", delay, "a time in s that is not negative", least=0)
    if G.discrete or T == 0:
        return stabilitymargins.allmargin(input_delay(G, T) if T else G)
    G = balance(G)
    unit = [(float(np.angle(-value * np.exp(-1j * w * T))), w) for w, value in find(G).unit if w < np.inf]
    lags = [(lag % (2 * np.pi) / w, w) for lag, w in unit if w > 0]
    gains = sorted(set(_gains(G, T, max((w for _, w in unit), default=0.0))), key=lambda g: g[1])
    columns = (np.array(pairs).reshape(-1, 2).T for pairs in (gains, unit, lags))
    return AllMargins(unstable_roots(G, T) == 0, *(column for pair in columns for column in pair))


@numerical
def margins(P: Any, K: Any, sign: int, delay: Any) -> Margins:
    """`stabilitymargins.margins` of a loop whose commands all come `delay` s later; whole samples in discrete time.

    Raises
    ------
    ModelError : as there; the delay is negative, or no whole number of samples, or a loop does not roll off.
    NumericalError : an approximant of the order 100 is none.
    """
    P, K = as_systems(P=P, K=K)
    check_loop("P", P, "K", K)
    T = as_number("delay", delay, "a time in s that is not negative", least=0)
    if T == 0 or P.discrete:
        return stabilitymargins.margins(input_delay(P, T) if T else P, K, sign)
    line = approximant(T, SMALL, "the loop of P and K", series(P, K), series(K, P))
    found = stabilitymargins.margins(series(repeated(line, P.nu), P), K, sign)
    if (P.nu, P.ny) != (1, 1):
        return found
    exact = margin(series(P, K), sign, T)
    return replace(found, input=(exact,), output=(exact,))


def approximant(T: float, level: float, name: str, *systems: StateSpace) -> StateSpace:
    """Pade's approximant of a delay that is off it by 1e-9 at most where any of continuous systems is above `level`.

    Raises
    ------
    ModelError : a system has that much of a direct term, which the delay turns without end.
    NumericalError : the order would be above 100.
    """
    corner = max(_last_above(name, balance(G), level) for G in systems)
    for n in range(1, HIGHEST + 1):
        if pade_error(T, n, corner) <= EXACT:
            return pade(T, n)
    raise NumericalError(
        f"delay is {T:g} s, and up to {corner:.4g} rad/s, where the gain of {name} is still {level:.2g}, no "
        f"approximant of order {HIGHEST} is a delay; sample the system with its delay, which is exact: "
        "c2d(G, dt, delay=T)"
    )


def _last_above(name: str, G: StateSpace, level: float) -> float:
    """The last frequency, rad/s, at which the gain of a continuous system is `level`; 0 where it is nowhere."""
    if np.linalg.norm(G.D, 2) >= level:
        raise ModelError(
            f"{name}: the gain at ever higher frequencies is {np.linalg.norm(G.D, 2):.3g}, where a delay turns without "
            "end; let the system roll off, or sample it with its delay: c2d(G, dt, delay=T)"
        )
    if not G.n:
        return 0.0
    C, D = G.C / level, G.D / level
    B = G.B
    R = np.linalg.inv(np.eye(G.nu) - D.T @ D)
    A = G.A + B @ R @ D.T @ C
    H = np.block([[A, B @ R @ B.T], [-C.T @ (np.eye(G.ny) + D @ R @ D.T) @ C, -A.T]])
    roots = np.linalg.eigvals(H)
    return float(np.abs(roots[np.abs(roots.real) <= BEYOND * np.abs(roots)].imag).max(initial=0.0)) * (1 + BEYOND)


def unstable_roots(G: StateSpace, T: float) -> int:
    """Roots of 1 + L(s) e^(-s T) in the right half plane or on its edge; without end, here 2^31, where |D| is one."""
    direct = float(G.D[0, 0])
    if abs(direct) >= 1:
        return 2**31
    if not G.n:
        return 0
    poles, doubt = doubts(G.A - G.B @ G.C / (1 + direct))
    count = int(np.sum(np.real(poles) > doubt))
    for w, value in find(G).unit:
        lag = float(np.angle(-value)) % (2 * np.pi)
        lag = 0.0 if 2 * np.pi - lag < AT_ONCE else lag
        if w == 0:
            count += lag < AT_ONCE  # the root at the origin stays
        elif w < np.inf and w * T >= lag:
            turns = int((w * T - lag) / (2 * np.pi)) + 1
            side = _falls(G, w)
            on_edge = lag < AT_ONCE and side < 0  # those roots were none of the right half plane
            count += 2 * side * (turns - on_edge)
    return max(count, 0)


def _falls(G: StateSpace, w: float) -> int:
    """1 where |L| falls with the frequency, -1 where it rises, 0 where it touches."""
    E = 1j * w * np.eye(G.n) - G.A
    X = np.linalg.solve(E, G.B)
    value, slope = (G.C @ X + G.D)[0, 0], -1j * w * (G.C @ np.linalg.solve(E, X))[0, 0]
    rise = float((slope / value).real)
    return 0 if abs(rise) < TOUCHES else int(-np.sign(rise))


def _gains(G: StateSpace, T: float, last: float) -> list[tuple[float, float]]:
    """Factors that bring the turned loop to -1, with their frequencies: all that may be the nearest to one."""
    first = _phase_crossings(G, T, last, last + 4 * np.pi / T)  # two turns beyond the last unit crossing
    below = max((abs(value) for w, value in first if abs(value) < 1), default=0.0)
    if below <= NEGLIGIBLE:
        end = last + 4 * np.pi / T
    else:
        crossings = find(replace(G, C=G.C / below, D=G.D / below)).unit
        end = max((w for w, _ in crossings if w < np.inf), default=0.0) * (1 + 1e-6)
    found = [*first, *_phase_crossings(G, T, 0.0, end)]
    return [(float(1 / abs(value)), float(w)) for w, value in found if NEGLIGIBLE < abs(value) < 1 / NEGLIGIBLE]


def _phase_crossings(G: StateSpace, T: float, low: float, high: float) -> list[tuple[float, complex]]:
    """Where the turned loop is real and negative, from `low` to `high` rad/s.

    It is looked for between points that see every turn of the delay and every root of L.
    """
    from scipy.optimize import root_scalar  # a fifth of a second, which no other loop needs

    roots = np.concatenate([G.poles(), G.zeros()])
    wide = np.maximum(np.abs(np.real(roots)), UNDAMPED * np.abs(roots))[:, None]
    about = (np.abs(np.imag(roots))[:, None] + wide * np.concatenate([-BESIDE, BESIDE])).ravel()
    count = int(np.ceil((high - low) * T / TURN)) + 2
    if count > MOST:
        raise NumericalError(
            f"delay is {T:g} s, which turns the loop {(high - low) * T / (2 * np.pi):.3g} times before its gain has "
            "fallen; pass a shorter delay, or the loop without what is that fast"
        )
    points = np.unique(np.concatenate([np.linspace(low, high, count), about[(about > low) & (about < high)]]))
    points = np.append(NEAR_REST * high, points[points > NEAR_REST * high]) if low == 0 else points

    def turned(w: float) -> complex:
        try:
            return complex(G.matrices.at(1j * w)[0, 0]) * np.exp(-1j * w * T)
        except np.linalg.LinAlgError:
            return complex(np.inf)

    values = np.array([turned(w) for w in points])
    heights = np.imag(values)
    rest = turned(0.0)
    found = [(0.0, rest)] if low == 0 and rest.real < 0 and np.isfinite(rest) else []
    for i in np.flatnonzero(heights[1:] * heights[:-1] <= 0):
        w = float(root_scalar(lambda w: turned(w).imag, bracket=(points[i], points[i + 1]), xtol=1e-15).root)
        value = turned(w)
        if value.real < 0 and abs(value.imag) < 1e-6 * abs(value):
            found.append((w, value))
    return found
