"""Stability margins: gain, phase and delay of one loop, disk margins of one or all, at the plant's input and output.

Nothing is gridded. A loop L(z) of one signal meets the critical point where it is real or has modulus one, that is,
at the unit eigenvalues of two symplectic-like pencils (L~ is the transpose of L(1/z)):

    gain    L - L~ = 0:    x+ = A x + B v, q = A'q+ + C'v, 0 = C x + (D - D') v - B'q+
    phase   L~ L - 1 = 0:  the pencil of the bounded-real lemma at level one (`norms`)

The disk margin with skew 0 is alpha = 2 / ||S - T||; the loop stays stable for every gain and phase, complex and in
each channel on its own, in the disk (1 + d/2)/(1 - d/2), |d| < alpha. Several channels at once are taken as one full
uncertain matrix, so that their alpha is guaranteed, and cautious. Continuous loops go through the Cayley map.

References: Seiler, Packard and Gahinet (2020), An Introduction to Disk Margins, IEEE Control Systems 40(5), 78;
Skogestad and Postlethwaite (2005), Multivariable Feedback Control, section 2.4.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from synth.analysis.coprime import ncfmargin
from synth.analysis.norms import balance, hinfnorm, is_stable
from synth.checks import as_sign
from synth.errors import ModelError
from synth.systems.connect import delayed, feedback, lft, series
from synth.systems.sampled import cayley, loop_rate
from synth.systems.statespace import StateSpace, as_system, as_systems, check_loop

NEAR_CIRCLE = 1e-4  # an eigenvalue this near the unit circle is a candidate; candidates are then polished
REAL = 1e-6  # |Im L| / |L| up to which a polished candidate counts as real
NEGLIGIBLE = 1e-9  # a gain below this, or above its inverse, is no limit: poles and zeros on the boundary show there
UNIT = 1e-6  # distance of |L| from one up to which a polished candidate counts as a crossing


Response = Callable[[float], complex]  # of a loop of one signal, by the angle on the unit circle


@dataclass(frozen=True)
class Margin:
    """What one loop can bear, one change at a time; all are 0 (gains 1) for an unstable loop."""

    gain_up: float  # the loop is stable for every gain from 1 up to this; inf when any is borne
    gain_down: float  # ... and from 1 down to this; 0 when any is borne
    phase: float  # rad, either way
    delay: float  # s
    gain_frequency: float  # rad/s, of the nearer gain margin in decibels; nan when there is none
    phase_frequency: float  # rad/s, of the phase margin; nan when |L| is never one
    delay_frequency: float  # rad/s, of the delay margin; inf where no delay is borne, nan when any is

    @property
    def gain_db(self) -> float:
        """The smaller of both gain margins, in decibels."""
        down = -20 * np.log10(self.gain_down) if self.gain_down > 0 else np.inf
        return float(min(20 * np.log10(self.gain_up), down))

    @property
    def phase_deg(self) -> float:
        """The phase margin in degrees."""
        return float(np.rad2deg(self.phase))


@dataclass(frozen=True)
class DiskMargin:
    """Gain and phase that may change together, in every channel at once."""

    alpha: float  # size of the disk, 0 for an unstable loop
    frequency: float  # rad/s, where it is smallest

    @property
    def gain(self) -> tuple[float, float]:
        """Gains that each channel bears: (1 - alpha/2)/(1 + alpha/2) and its inverse, down to 0 and up to inf."""
        low = max((1 - self.alpha / 2) / (1 + self.alpha / 2), 0.0)
        return low, 1 / low if low > 0 else np.inf

    @property
    def phase(self) -> float:
        """Phase that each channel bears, rad."""
        return float(2 * np.arctan(self.alpha / 2)) if self.alpha < 2 else float(np.pi / 2)


@dataclass(frozen=True)
class Margins:
    """The margins of the loop of P and K at both of its ends."""

    input: tuple[Margin, ...]  # (m,) one plant input at a time, the other loops closed
    output: tuple[Margin, ...]  # (p,) one plant output at a time
    disk_input: DiskMargin  # all plant inputs at once
    disk_output: DiskMargin  # all plant outputs at once
    ncf: float  # `ncfmargin`
    dt: float  # s

    @property
    def gain_db(self) -> float:
        """The smallest gain margin of all loops, in decibels."""
        return min(m.gain_db for m in (*self.input, *self.output))

    @property
    def phase_deg(self) -> float:
        """The smallest phase margin of all loops, in degrees."""
        return min(m.phase_deg for m in (*self.input, *self.output))

    @property
    def delay(self) -> float:
        """The smallest delay margin of all loops, in s."""
        return min(m.delay for m in (*self.input, *self.output))

    @property
    def disk(self) -> float:
        """The smaller alpha of both ends."""
        return min(self.disk_input.alpha, self.disk_output.alpha)


def margin(L: Any, sign: int = -1) -> Margin:
    """Gain, phase and delay margin of a loop of one signal.

    Parameters
    ----------
    L : loop transfer function of one signal, in any form that `system` takes
    sign : -1 for negative feedback 1 + L (default), +1 for 1 - L

    Raises
    ------
    ModelError : L has several inputs or outputs, or `sign` is neither -1 nor 1.

    Reference: Skogestad and Postlethwaite (2005), section 2.4.3.
    """
    G = _negative(L, sign)
    if (G.ny, G.nu) != (1, 1):
        raise ModelError(f"L is {G.ny} x {G.nu}; gain and phase margins are of one signal: see `margins`, `diskmargin`")
    if not _closed_loop_stable(G):
        return Margin(1.0, 1.0, 0.0, 0.0, np.nan, np.nan, np.nan)
    H, response, to_frequency = _on_circle(G)
    up, down, at_gain = _gain_margins(H, response)
    crossings = [(angle, np.angle(-response(angle))) for angle in _unit_crossings(H, response)]
    phase, at_phase = min(((abs(phi), angle) for angle, phi in crossings), default=(np.pi, np.nan))
    lags = [(float(phi % (2 * np.pi)) / to_frequency(angle), angle) for angle, phi in crossings if angle > 0]
    if not G.discrete and abs(G.D[0, 0]) > 1:  # at ever higher frequencies a delay, however short, turns L to -1
        lags.append((0.0, np.pi))
    if G.discrete and abs(response(np.pi)) > 1:  # likewise, with more and more samples
        lags.append((_samples_borne(G, min(lags, default=(np.inf,))[0] / G.dt) * G.dt, np.pi))
    delay, at_delay = min(lags, default=(np.inf, np.nan))
    frequencies = (float(to_frequency(angle)) for angle in (at_gain, at_phase, at_delay))
    return Margin(up, down, float(phase), float(delay), *frequencies)


def _samples_borne(G: StateSpace, most: float) -> float:
    """Whole samples of delay, `most` at most, at which a loop that is above one at the Nyquist frequency fails."""
    count = 0
    while count < most and _closed_loop_stable(G):
        G, count = delayed(G), count + 1
    return min(count, most)


def diskmargin(L: Any, sign: int = -1) -> DiskMargin:
    """Disk margin with skew 0 of a square loop, all of its channels at once.

    Parameters
    ----------
    L : (m x m) loop transfer matrix, in any form that `system` takes
    sign : -1 for negative feedback (default), +1 for positive

    Raises
    ------
    ModelError : L is not square, or `sign` is neither -1 nor 1.

    Reference: Seiler, Packard and Gahinet (2020), IEEE Control Systems 40(5), 78, theorem 1.
    """
    G = _negative(L, sign)
    if G.ny != G.nu:
        raise ModelError(f"L is {G.ny} x {G.nu}; a loop has as many outputs as inputs")
    if not _closed_loop_stable(G):
        return DiskMargin(0.0, np.nan)
    T = feedback(G, StateSpace.gain(np.eye(G.nu), G.dt))
    norm, frequency = hinfnorm(StateSpace(T.A, T.B, -2 * T.C, np.eye(G.nu) - 2 * T.D, T.dt))  # S - T = I - 2 T
    return DiskMargin(2 / norm, frequency)


def margins(P: Any, K: Any, sign: int = -1) -> Margins:
    """The margins of the loop of a plant and a controller, every signal on its own and all at once.

    Parameters
    ----------
    P : (p x m) plant; K : (m x p) controller; in any form that `system` takes
    sign : -1 for negative feedback u = -K y (default), +1 for u = K y, the convention of `hinfsyn` and `ncfsyn`

    Raises
    ------
    ModelError : sizes or timebases disagree, a loop is not well posed, `sign` is neither -1 nor 1.
    """
    P, K = as_systems(P=P, K=K)
    check_loop("P", P, "K", K)
    at_input, at_output = _negative(series(P, K), sign), _negative(series(K, P), sign)
    return Margins(
        input=tuple(margin(one_loop(at_input, i)) for i in range(P.nu)),
        output=tuple(margin(one_loop(at_output, i)) for i in range(P.ny)),
        disk_input=diskmargin(at_input),
        disk_output=diskmargin(at_output),
        ncf=ncfmargin(P, K, sign),
        dt=P.dt,
    )


def one_loop(L: StateSpace, i: int) -> StateSpace:
    """The loop that is seen where channel `i` of a square loop is cut, the others closed with negative feedback."""
    if L.nu == 1:
        return L
    order = [i, *(j for j in range(L.nu) if j != i)]
    ordered = StateSpace(L.A, L.B[:, order], L.C[order], L.D[np.ix_(order, order)], L.dt)
    return lft(ordered, StateSpace.gain(-np.eye(L.nu - 1), L.dt), L.nu - 1, L.nu - 1)


def _negative(L: Any, sign: int) -> StateSpace:
    """The loop for negative feedback."""
    L = as_system("L", L)
    return L if as_sign(sign) == -1 else -L


def _closed_loop_stable(L: StateSpace) -> bool:
    return is_stable(feedback(L, StateSpace.gain(np.eye(L.nu), L.dt)))


def _on_circle(L: StateSpace) -> tuple[StateSpace, Response, Callable[[float], float]]:
    """The loop in discrete time, balanced; its response by angle, of the given system itself; angle to rad/s."""
    given = balance(L)
    if L.discrete:
        return given, lambda angle: _response(given, np.exp(1j * angle)), lambda angle: angle / L.dt
    rate = loop_rate(given)

    def to_frequency(angle: float) -> float:
        return np.inf if angle >= np.pi else rate * np.tan(angle / 2)

    def response(angle: float) -> complex:
        return complex(L.D[0, 0]) if angle >= np.pi else _response(given, 1j * to_frequency(angle))

    return balance(cayley(given, rate)), response, to_frequency


def _response(L: StateSpace, s: complex) -> complex:
    """L at s or z; a pole there is a gain without bound."""
    try:
        return complex((L.C @ np.linalg.solve(s * np.eye(L.n) - L.A, L.B) + L.D)[0, 0])
    except np.linalg.LinAlgError:
        return complex(np.inf)


def _gain_margins(L: StateSpace, response: Response) -> tuple[float, float, float]:
    """Largest and smallest gain around one, and the angle of the nearer in decibels."""
    found = []
    for angle in _real_crossings(L, response):
        value = response(angle)
        if np.isfinite(value) and value.real < 0 and abs(value.imag) <= REAL * abs(value):
            found.append((-1 / value.real, angle))
    ups, downs = [f for f in found if 1 < f[0] < 1 / NEGLIGIBLE], [f for f in found if NEGLIGIBLE < f[0] < 1]
    up, down = min(ups, default=(np.inf, np.nan)), max(downs, default=(0.0, np.nan))
    nearer = min((f for f in (up, down) if np.isfinite(f[1])), key=lambda f: abs(np.log(f[0])), default=(1.0, np.nan))
    return float(up[0]), float(down[0]), float(nearer[1])


def _real_crossings(L: StateSpace, response: Response) -> list[float]:
    """Angles at which L is real: 0, pi, and the unit zeros of L - L~."""
    O = np.zeros
    M = np.block([
        [L.A, O((L.n, L.n)), L.B],
        [O((L.n, L.n)), -np.eye(L.n), L.C.T],
        [L.C, O((1, L.n)), L.D - L.D.T],
    ])  # fmt: skip
    N = np.block([
        [np.eye(L.n), O((L.n, L.n + 1))],
        [O((L.n, L.n)), -L.A.T, O((L.n, 1))],
        [O((1, L.n)), L.B.T, O((1, 1))],
    ])  # fmt: skip
    return [0.0, np.pi, *_polished(_unit_angles(M, N), lambda angle: response(angle).imag)]


def _unit_crossings(L: StateSpace, response: Response) -> list[float]:
    """Angles at which |L| is one."""
    n, m = L.n, 1
    M = np.block([
        [L.A, np.zeros((n, n)), L.B],
        [L.C.T @ L.C, -np.eye(n), L.C.T @ L.D],
        [L.D.T @ L.C, np.zeros((m, n)), L.D.T @ L.D - np.eye(m)],
    ])  # fmt: skip
    N = np.block([
        [np.eye(n), np.zeros((n, n + m))],
        [np.zeros((n, n)), -L.A.T, np.zeros((n, m))],
        [np.zeros((m, n)), -L.B.T, np.zeros((m, m))],
    ])  # fmt: skip
    angles = [0.0, np.pi, *_polished(_unit_angles(M, N), lambda angle: abs(response(angle)) - 1)]
    return [angle for angle in angles if abs(abs(response(angle)) - 1) <= UNIT]


def _unit_angles(M: np.ndarray, N: np.ndarray) -> np.ndarray:
    """Angles from 0 to pi of the eigenvalues of M - lambda N near the unit circle."""
    alpha, beta = np.asarray(sla.eigvals(M, N, homogeneous_eigvals=True))
    near = (np.abs(np.abs(alpha) - np.abs(beta)) <= NEAR_CIRCLE * np.abs(beta)) & (beta != 0)  # 0/0: of no frequency
    return np.unique(np.abs(np.angle(alpha[near] / beta[near])))


def _polished(angles: np.ndarray, function: Any) -> list[float]:
    """Zeros of a function near the angles: bracketed where it changes sign, as they are where it does not."""
    from scipy.optimize import root_scalar  # a fifth of a second, which no design needs

    found = []
    for angle in angles:
        width = 1e-6 * max(angle, 1e-6)
        while width < 1e-2 * max(angle, 1e-4):
            low, high = max(angle - width, 0.0), min(angle + width, np.pi)
            if function(low) * function(high) < 0:
                angle = root_scalar(function, bracket=(low, high), xtol=1e-15).root
                break
            width *= 10
        found.append(float(angle))
    return found
