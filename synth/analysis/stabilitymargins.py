"""Stability margins: gain, phase and delay of one loop, disk margins of one or all, at the plant's input and output.

Gain, phase and delay are read where the loop, evaluated on its own matrices, is real or has modulus one (`crossings`),
and confirmed by the poles of the loop that they lead to, a complex gain inside them. Disk margins are in `diskmargins`.

Reference: Skogestad and Postlethwaite (2005), Multivariable Feedback Control, section 2.4.3.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from synth.analysis.coprime import ncfmargin
from synth.analysis.crossings import Crossings, find
from synth.analysis.diskmargins import DiskMargin, diskmargin, negative
from synth.analysis.norms import is_stable
from synth.checks import numerical
from synth.errors import ModelError, NumericalError
from synth.systems.connect import delayed, feedback, lft, series
from synth.systems.statespace import StateSpace, as_systems, check_loop

NEGLIGIBLE = 1e-9  # a gain below this, or above its inverse, is no limit: poles and zeros on the boundary show there
ROUNDED = 1e-12  # rad
INSIDE = (0.5, 0.999)  # parts of a margin at which the poles are asked
ANY = 1e3  # a gain, up or down, that is asked where any is borne


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


@dataclass(frozen=True, eq=False)
class AllMargins:
    """Every crossing of a loop, one change at a time, whether the closed loop is stable or not."""

    stable: bool  # the closed loop, as it is
    gain: np.ndarray  # (a,) factors that bring L to -1, positive
    gain_frequency: np.ndarray  # (a,) rad/s, inf at the end of a continuous loop
    phase: np.ndarray  # (b,) rad, positive where a lag brings L to -1, in (-pi, pi]
    phase_frequency: np.ndarray  # (b,) rad/s
    delay: np.ndarray  # (c,) s, the shortest that bring L to -1 at each frequency
    delay_frequency: np.ndarray  # (c,) rad/s


@dataclass(frozen=True, eq=False)
class Loops:
    """A loop for negative feedback, cut in three ways."""

    input: Any  # (m x m) at the plant's inputs, a StateSpace or an UncertainSystem
    output: Any  # (p x p) at its outputs
    both: Any  # (m + p, m + p) at all of them


@dataclass(frozen=True)
class Margins:
    """The margins of the loop of P and K at both of its ends."""

    input: tuple[Margin, ...]  # (m,) one plant input at a time, the other loops closed
    output: tuple[Margin, ...]  # (p,) one plant output at a time
    disk_input: DiskMargin  # all plant inputs at once
    disk_output: DiskMargin  # all plant outputs at once
    ncf: float  # `ncfmargin`
    dt: float  # s
    loops: Loops = field(repr=False, compare=False)

    @cached_property
    def disk_inputs(self) -> tuple[DiskMargin, ...]:
        """(m,) of one plant input at a time, the other loops closed."""
        return tuple(diskmargin(one_loop(self.loops.input, i)) for i in range(self.loops.input.nu))

    @cached_property
    def disk_outputs(self) -> tuple[DiskMargin, ...]:
        """(p,) of one plant output at a time."""
        return tuple(diskmargin(one_loop(self.loops.output, i)) for i in range(self.loops.output.nu))

    @cached_property
    def disk_both(self) -> DiskMargin:
        """All plant inputs and all plant outputs at once."""
        return diskmargin(self.loops.both)

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


@numerical
def margin(L: Any, sign: int = -1) -> Margin:
    """Gain, phase and delay margin of a loop of one signal.

    Parameters
    ----------
    L : loop transfer function of one signal, in any form that `system` takes
    sign : -1 for negative feedback 1 + L (default), +1 for 1 - L

    Raises
    ------
    ModelError : L has several inputs or outputs, or `sign` is neither -1 nor 1.
    NumericalError : the poles of the loop do not confirm what its crossings say.

    Reference: Skogestad and Postlethwaite (2005), section 2.4.3.
    """
    G = one_signal(L, sign)
    if not _closed_loop_stable(G):
        return Margin(1.0, 1.0, 0.0, 0.0, np.nan, np.nan, np.nan)
    found = find(G)
    gains = _gains(found)
    up, down = min((g for g in gains if g[0] > 1), default=None), max((g for g in gains if g[0] < 1), default=None)
    nearer = min((g for g in (up, down) if g), key=lambda g: abs(np.log(g[0])), default=(1.0, np.nan))
    phase, at_phase = min(((abs(phi), w) for phi, w in _phases(found)), default=(np.pi, np.nan))
    lags = _lags(found)
    if not G.discrete and abs(found.end) > 1:  # at ever higher frequencies a delay, however short, turns L to -1
        lags.append((0.0, np.inf))
    if G.discrete and abs(found.end) > 1:  # likewise, with more and more samples
        lags.append((_samples_borne(G, min(lags, default=(np.inf,))[0] / G.dt) * G.dt, np.pi / G.dt))
    delay, at_delay = min(lags, default=(np.inf, np.nan))
    kept = Margin(up[0] if up else np.inf, down[0] if down else 0.0, phase, delay, nearer[1], at_phase, at_delay)
    _confirm(G, kept)
    return kept


@numerical
def allmargin(L: Any, sign: int = -1) -> AllMargins:
    """`delayedmargins.allmargin` without a delay."""
    G = one_signal(L, sign)
    found = find(G)
    columns = (np.array(pairs).reshape(-1, 2).T for pairs in (_gains(found), _phases(found), _lags(found)))
    return AllMargins(_closed_loop_stable(G), *(column for pair in columns for column in pair))


def one_signal(L: Any, sign: int) -> StateSpace:
    """The loop for negative feedback."""
    G = negative(L, sign)
    if (G.ny, G.nu) != (1, 1):
        raise ModelError(f"L is {G.ny} x {G.nu}; gain and phase margins are of one signal: see `margins`, `diskmargin`")
    return G


def _gains(found: Crossings) -> list[tuple[float, float]]:
    """Factors that bring L to -1, with their frequencies."""
    return [(-1 / c.value.real, c.frequency) for c in found.real if NEGLIGIBLE < -c.value.real < 1 / NEGLIGIBLE]


def _phases(found: Crossings) -> list[tuple[float, float]]:
    """Lags in rad that bring L to -1, in (-pi, pi], with their frequencies."""
    lags = ((float(np.angle(-c.value)), c.frequency) for c in found.unit)
    return [(phi if phi > ROUNDED - np.pi else np.pi, w) for phi, w in lags]


def _lags(found: Crossings) -> list[tuple[float, float]]:
    """The shortest delays in s that bring L to -1, with their frequencies."""
    return [(phi % (2 * np.pi) / w, w) for phi, w in _phases(found) if 0 < w < np.inf]


def _confirm(G: StateSpace, kept: Margin) -> None:
    """Raise NumericalError unless the loop is stable for gains and phases inside the margins."""
    up, down = min(kept.gain_up, ANY), max(kept.gain_down, 1 / ANY)
    for part in INSIDE:
        for factor in (up**part, down**part, np.exp(1j * part * kept.phase), np.exp(-1j * part * kept.phase)):
            if not _stable_with(G, factor):
                raise NumericalError(
                    f"the margins read at the crossings are gains from {kept.gain_down:.4g} to {kept.gain_up:.4g} and "
                    f"{kept.phase_deg:.4g} deg, but the loop is unstable with a factor of {factor:.4g}: rounding hides "
                    "a crossing; bring the states of the loop to better units, or leave out what it hardly shows"
                )


def _stable_with(L: StateSpace, factor: complex) -> bool:
    """Whether the loop, times a factor, is stable when it is closed."""
    direct = 1 + factor * L.D[0, 0]
    if direct == 0:
        return False
    poles = np.linalg.eigvals(L.A - (factor / direct) * L.B @ L.C) if L.n else np.zeros(0)
    return bool(np.abs(poles).max(initial=0.0) < 1 if L.discrete else poles.real.max(initial=-1.0) < 0)


def _samples_borne(G: StateSpace, most: float) -> float:
    """Whole samples of delay, `most` at most, at which a loop that is above one at the Nyquist frequency fails."""
    count = 0
    while count < most and _closed_loop_stable(G):
        G, count = delayed(G), count + 1
    return min(count, most)


@numerical
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
    loops = Loops(negative(series(P, K), sign), negative(series(K, P), sign), _both(P, K, sign))
    return Margins(
        input=tuple(margin(one_loop(loops.input, i)) for i in range(P.nu)),
        output=tuple(margin(one_loop(loops.output, i)) for i in range(P.ny)),
        disk_input=diskmargin(loops.input),
        disk_output=diskmargin(loops.output),
        ncf=ncfmargin(P, K, sign),
        dt=P.dt,
        loops=loops,
    )


def _both(P: StateSpace, K: StateSpace, sign: int) -> StateSpace:
    """The loop cut at inputs and outputs at once: [u; y] = -[[0, -sign K], [-P, 0]] [u; y]."""
    m, p, n = P.nu, P.ny, P.n + K.n
    A, B, C = np.zeros((n, n)), np.zeros((n, m + p)), np.zeros((m + p, n))
    A[: P.n, : P.n], A[P.n :, P.n :] = P.A, K.A
    B[: P.n, :m], B[P.n :, m:] = P.B, K.B
    C[m:, : P.n], C[:m, P.n :] = -P.C, -sign * K.C
    return StateSpace(A, B, C, np.block([[np.zeros((m, m)), -sign * K.D], [-P.D, np.zeros((p, p))]]), P.dt)


def one_loop(L: StateSpace, i: int) -> StateSpace:
    """The loop that is seen where channel `i` of a square loop is cut, the others closed with negative feedback."""
    if L.nu == 1:
        return L
    order = [i, *(j for j in range(L.nu) if j != i)]
    ordered = StateSpace(L.A, L.B[:, order], L.C[order], L.D[np.ix_(order, order)], L.dt)
    return lft(ordered, StateSpace.gain(-np.eye(L.nu - 1), L.dt), L.nu - 1, L.nu - 1)


def _closed_loop_stable(L: StateSpace) -> bool:
    return is_stable(feedback(L, StateSpace.gain(np.eye(L.nu), L.dt)))
