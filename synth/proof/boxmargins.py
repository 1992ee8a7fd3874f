"""Margins of loops, certain ones and those with uncertain parameters: the numbers then hold on the whole box, proved.

Every margin is a worst gain or a margin of stability of another loop:

    disk    1 / worst gain of H = S + (skew - 1)/2 I, what changes of the channels see. Of several channels the gain of
            D H D^-1 with constant diagonal D bounds the structured singular value, from above only
    gain    0 = u + k L u is stable for k in [1, K], and 0 = u / k + L u for 1/k in [1, K]: k as a parameter
    phase   the rotation of two copies of the loop, 0 = (I - t J) u + (I + t J) diag(L, L) u with J = [0 -1; 1 0] and
            t = tan(phase / 2), has the poles of L e^(j phase) and of L e^(-j phase), and is real
    delay   delays up to T are within |W| of P = (1 - s T/4)/(1 + s T/4), W = 1.1 s T/2 / (1 + s T/50^(1/2)): all are
            borne if the worst gain of W L / (1 + P L) is below one, a bound from below only. In discrete time
            |e^(-j w T) - 1| <= T/dt |z - 1| from one sample on, and pi/2 times that below
    ncf     1 / worst gain of [I; K] (I - P K)^-1 [I, P]

References: Seiler, Packard and Gahinet (2020), IEEE Control Systems 40(5), 78; Skogestad and Postlethwaite (2005),
Multivariable Feedback Control, sections 7.4 and 8.6 (delays, scaled bounds).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, overload

import numpy as np
from scipy import optimize

from synth.analysis import delayedmargins, diskmargins, stabilitymargins
from synth.analysis.diskmargins import DiskMargin
from synth.analysis.stabilitymargins import Loops, Margin, Margins
from synth.analysis.structured import best_scaling
from synth.analysis.worstcase import Numbers, samples
from synth.checks import as_number, as_sign
from synth.errors import ModelError, NumericalError
from synth.proof.pencils import Pencil
from synth.proof.stability import stability_margin
from synth.proof.worstcase import WorstCase
from synth.proof.worstgain import ROUNDED, inverted, worst_gain
from synth.systems.expressions import eye, product, zeros
from synth.systems.parameters import Parameter, ureal
from synth.systems.statespace import StateSpace, system
from synth.systems.uncertain import UncertainSystem, as_uncertain, series

NEAR = 1e-3  # relative distance of the bounds from which no other scaling is looked for
ROUNDS, STARTS = 3, 3  # of scalings, of a descent
DELAYS, FIRST = 8, 0.8  # proofs of a delay, and part of the one that was found to begin with
INSIDE, STEPS = 0.995, (0.25, 4.0)  # gain that is aimed at, and by how much a delay changes from proof to proof
COVER, CORNER = 1.1, 50**0.5  # of the weight W = 1.1 s T/2 / (1 + s T/50^(1/2)) that covers delays around their middle
DISK, GAIN_UP, GAIN_DOWN, PHASE, DELAY, NCF = "disk margin", "gain margin up", "gain margin down", "phase margin", \
    "delay margin", "ncf margin"  # fmt: skip


@dataclass(frozen=True, eq=False)
class BoxDiskMargin(DiskMargin):
    """A disk margin that is proved on the whole box."""

    worst: WorstCase = field(kw_only=True, repr=False)  # `lower` is alpha, `upper` the disk margin at `parameters`


@dataclass(frozen=True, eq=False)
class BoxMargin(Margin):
    """Gain, phase and delay that one loop can bear at every point of the box, proved one by one."""

    worst: dict[str, WorstCase] = field(kw_only=True, repr=False)
    """By field: bounds, and the parameters that reach the one that is not proved."""


@dataclass(frozen=True, eq=False)
class BoxMargins(Margins):
    """Margins of a loop at both ends that are proved on the whole box."""

    worst_ncf: WorstCase = field(kw_only=True, repr=False)

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


@overload
def diskmargin(L: UncertainSystem, sign: int = -1, *, skew: float = 0.0) -> BoxDiskMargin: ...
@overload
def diskmargin(L: Any, sign: int = -1, *, skew: float = 0.0) -> DiskMargin: ...
def diskmargin(L: Any, sign: int = -1, *, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a square loop, all of its channels at once, each changed on its own.

    Parameters
    ----------
    L : (m x m) loop transfer matrix, in any form that `system` takes, or an uncertain one
    sign : -1 for negative feedback (default), +1 for positive
    skew : sigma of the disk: 0 balances gains above and below one, 1 takes S alone, -1 T alone

    Returns
    -------
    DiskMargin : guaranteed up to a relative 1e-7; the largest such disk for up to three channels. Of an uncertain loop
        a `BoxDiskMargin`: `alpha` is proved for every point of the box, and `worst` has both bounds, the parameters
        that reach the other one, and the certificate, of the gain of S + (skew - 1)/2 I. The bounds of one channel
        meet; of several they need not, since scalings are constant.

    Raises
    ------
    ModelError : L is not square, `sign` is neither -1 nor 1, `skew` is no number.
    NumericalError : rounding hides the loop.

    Reference: Seiler, Packard and Gahinet (2020), IEEE Control Systems 40(5), 78, theorem 1 and section "MIMO".
    """
    if not isinstance(L, UncertainSystem):
        return diskmargins.diskmargin(L, sign, skew=skew)
    if not L.parameters:
        raise ModelError("L has no uncertain parameters; pass L.nominal")
    G, skew = negative(L, sign), as_number("skew", skew, "a number, 0 for gains up and down alike")
    if G.ny != G.nu:
        raise ModelError(f"L is {G.ny} x {G.nu}; a loop has as many outputs as inputs")
    T = G.feedback(1)
    H = UncertainSystem(T.E, T.A, T.B, -T.C, eye(G.nu) * ((1 + skew) / 2) - T.D, T.dt)
    worst = _worst_scaled(H, G, skew)
    point = diskmargins.diskmargin(G.at(worst.parameters), skew=skew)
    worst = replace(worst, upper=max(worst.lower, min(worst.upper, point.alpha)))
    return BoxDiskMargin(worst.lower, point.frequency, skew, point.factors, worst=worst)


def _worst_scaled(H: UncertainSystem, G: UncertainSystem, skew: float) -> WorstCase:
    """1 / the least proved gain of D H D^-1, and the least disk margin of the loops that were worst."""
    D = np.ones(H.nu)
    best = reached = inverted(worst_gain(H), DISK)
    if H.nu == 1 or best.eigenvalue is not None:
        return best
    for k in range(ROUNDS):
        scaled = UncertainSystem(H.E, H.A, H.B / D, D[:, None] * H.C, D[:, None] * H.D / D, H.dt)
        found = inverted(worst_gain(scaled), DISK) if k else best
        best = max(best, found, key=lambda r: r.lower)
        point = diskmargins.diskmargin(G.at(found.parameters), skew=skew)
        if not k or point.alpha < reached.upper:
            reached = replace(found, upper=point.alpha, frequency=point.frequency)
        if best.lower >= reached.upper * (1 - NEAR):
            break
        at = H.at(found.parameters)
        s = np.exp(1j * found.frequency * H.dt) if H.discrete else 1j * found.frequency
        M = at.C @ np.linalg.solve(s * np.eye(at.n) - at.A, at.B) + at.D
        D = best_scaling(M).D
    note = best.note
    if best.lower < reached.upper * (1 - NEAR) and not note:
        note = "the scaling of the channels is constant, so that the bounds of several channels need not meet"
    return replace(reached, lower=min(best.lower, reached.upper), note=note, certificate=best.certificate)


@overload
def margin(L: UncertainSystem, sign: int = -1, *, delay: float = 0.0) -> BoxMargin: ...
@overload
def margin(L: Any, sign: int = -1, *, delay: float = 0.0) -> Margin: ...
def margin(L: Any, sign: int = -1, *, delay: float = 0.0) -> Margin:
    """Gain, phase and delay margin of a loop of one signal.

    Parameters
    ----------
    L : loop transfer function of one signal, in any form that `system` takes, or an uncertain one
    sign : -1 for negative feedback 1 + L (default), +1 for 1 - L
    delay : s, of a certain loop: the margins are of L(s) e^(-s delay), exactly; in discrete time whole samples

    Returns
    -------
    Margin : of an uncertain loop a `BoxMargin`, whose numbers are proved for every point of the box, gains up to 101
        and down to its inverse; `worst` has both bounds by field, the parameters that reach the other one, and the
        certificate. The bounds of gains and phases meet; that of the delay is one from below.

    Raises
    ------
    ModelError : L has several signals, `sign` is neither -1 nor 1, the delay is negative or of an uncertain loop.
    NumericalError : the poles of the loop do not confirm what its crossings say.

    References: Skogestad and Postlethwaite (2005), section 2.4.3; Walton and Marshall (1987), IEE Proc. D 134, 101
    (delays); for uncertain loops the head of this file.
    """
    if not isinstance(L, UncertainSystem):
        return delayedmargins.margin(L, sign, delay)
    _check_undelayed("L", delay)
    if not L.parameters:
        raise ModelError("L has no uncertain parameters; pass L.nominal")
    G = negative(L, sign)
    if (G.ny, G.nu) != (1, 1):
        raise ModelError(f"L is {G.ny} x {G.nu}; gain and phase margins are of one signal: see `margins`, `diskmargin`")
    if not _is_stable(G):
        nothing = stabilitymargins.margin(G.nominal)
        return BoxMargin(*(getattr(nothing, name) for name in Margin.__dataclass_fields__), worst={})
    up, down, phase = worst_gain_margin(G, GAIN_UP), worst_gain_margin(G, GAIN_DOWN), worst_phase(G)
    late = worst_delay(G, [up, down, phase])
    nearer = min((up, down), key=lambda r: abs(np.log(r.lower if r is up else r.upper)))
    worst = {"gain_up": up, "gain_down": down, "phase": phase, "delay": late}
    return BoxMargin(
        up.lower, down.upper, phase.lower, late.lower, nearer.frequency, phase.frequency, late.frequency, worst=worst
    )


def _check_undelayed(name: str, delay: Any) -> None:
    if as_number("delay", delay, "a time in s that is not negative", least=0):
        raise ModelError(
            f"delay is {delay:g} s and {name} is uncertain; pass series({name}, pade(delay, n)) for bounds"
        )


def worst_gain_margin(G: UncertainSystem, quantity: str) -> WorstCase:
    """Gains from one on, up or down."""
    k = _parameter(G, "gain" if quantity == GAIN_UP else "1/gain", 1.0, (1.0, 2.0))
    one = eye(1)
    cut = _cut(G, one, one * k) if quantity == GAIN_UP else _cut(G, one * k, one)
    found, proved, reached = _grown(cut, k.parameters)
    proved = 1.0 if proved is None else proved
    if quantity == GAIN_UP:
        return replace(found, quantity=quantity, lower=proved, upper=reached)
    return replace(found, quantity=quantity, lower=1 / reached, upper=(1 + ROUNDED) / proved)


def worst_phase(G: UncertainSystem) -> WorstCase:
    """Phases either way, rad."""
    t = _parameter(G, "tan(phase/2)", 0.0, (0.0, 1.0))
    turn = zeros(2, 2)
    turn[0, 1], turn[1, 0] = -t, t
    found, proved, reached = _grown(_cut(G, eye(2) - turn, eye(2) + turn), t.parameters)
    return replace(
        found, quantity=PHASE, lower=2 * float(np.arctan(proved or 0.0)) * (1 - ROUNDED),
        upper=min(2 * float(np.arctan(reached)), np.pi),
    )  # fmt: skip


def _cut(G: UncertainSystem, left: np.ndarray, right: np.ndarray) -> UncertainSystem:
    """The loop 0 = left u + right diag(G, G, ...) u, without inputs and outputs."""
    m, n = len(left), len(left) * G.n
    I = np.eye(m)
    E, A, B, C, D = (np.kron(I, M) for M in (G.E, G.A, G.B, G.C, G.D))
    E = np.block([[E, zeros(n, m)], [zeros(m, n + m)]])
    A = np.block([[A, B], [product(right, C), left + product(right, D)]])
    return UncertainSystem(E, A, zeros(n + m, 1), zeros(1, n + m), 0, G.dt)


def _parameter(G: UncertainSystem, name: str, nominal: float, span: tuple[float, float]) -> Any:
    while name in G.parameters:
        name += "'"
    return ureal(name, nominal, range=span)


def _grown(cut: UncertainSystem, one: dict[str, Parameter]) -> tuple[WorstCase, float | None, float]:
    """The margin of one parameter over the ranges of the others; what is proved of it, and what is reached."""
    (name,) = one
    found = stability_margin(cut, growing=name)
    proved = found.certificate.system.parameters[name].high if found.certificate else None
    reached = found.parameters.get(name, np.inf)
    return replace(found, parameters={n: x for n, x in found.parameters.items() if n != name}), proved, reached


def worst_delay(G: UncertainSystem, others: Sequence[WorstCase]) -> WorstCase:
    """Delays from nothing on, s: a bound from below, and the shortest margin that was found."""
    point, reached, frequency = _shortest(G, [r.parameters for r in others if r.parameters])
    best = _samples_late(G) if G.discrete else _small_gain(G, reached)
    return replace(
        best, quantity=DELAY, upper=max(reached, best.lower), parameters=point, frequency=frequency, eigenvalue=None,
        norm=np.nan, note=best.note or "the delay is proved by small gain, which is a bound from below",
    )  # fmt: skip


def _samples_late(G: UncertainSystem) -> WorstCase:
    """By the gain of (z - 1) T, T = (1 + L)^-1 L."""
    found = worst_gain(series(G.feedback(1), system([[0.0]], [[1.0]], [[-1.0]], [[1.0]], dt=G.dt)), tol=NEAR)
    count = 1 / found.upper if 0 < found.upper < np.inf else 0.0  # of (z - 1)/z, which is as large
    return replace(found, lower=G.dt * (count if count >= 1 else count * 2 / np.pi) * (1 - ROUNDED))


def _small_gain(G: UncertainSystem, reached: float) -> WorstCase:
    """By the gain that e^(-s T') - P, with P = (1 - s T/4)/(1 + s T/4) in the middle of all T' up to T, sees."""
    poles = np.abs(G.feedback(1).nominal.poles())
    T = reached * FIRST if np.isfinite(reached) else 1 / float(np.exp(np.log(poles[poles > 0]).mean()))
    tried = []
    for _ in range(DELAYS if T > 0 else 1):
        P, W = system([-T / 4, 1], [T / 4, 1]), system([COVER * T / 2, 0], [T / CORNER, 1])
        found = worst_gain(series(G.feedback(P), W), tol=NEAR)
        tried.append(replace(found, lower=T) if found.upper < 1 else replace(found, lower=0.0, certificate=None))
        T *= float(np.clip(INSIDE / found.upper if found.upper > 0 else np.inf, *STEPS))
        best = max(tried, key=lambda r: r.lower)
        if T < best.lower * (1 + NEAR):
            break
    return best


def _shortest(G: UncertainSystem, starts: Sequence[dict[str, float]]) -> tuple[dict[str, float], float, float]:
    """Parameters with the shortest delay margin that was found, that margin, and its frequency."""
    box = tuple(G.parameters.values())
    N = Numbers(G, box)

    def named(t: np.ndarray) -> dict[str, float]:
        return dict(zip(G.parameters, map(float, N.values(np.clip(t, -1, 1))), strict=True))

    def delay(point: dict[str, float]) -> tuple[float, float]:
        try:
            found = stabilitymargins.margin(G.at(point))
        except (NumericalError, ModelError):
            return np.inf, np.nan
        return found.delay, found.delay_frequency

    tries = sorted(((delay(named(t))[0], k, t) for k, t in enumerate(samples(len(box)))), key=lambda x: x[:2])
    points = [*starts, *(named(t) for _, _, t in tries[:1])]
    for value, _, t in tries[:STARTS]:
        if 0 < value < np.inf:
            moved = optimize.minimize(
                lambda t: min(delay(named(t))[0] / value, 1e3), t, bounds=[(-1, 1)] * len(box), method="L-BFGS-B",  # noqa: B023
                options={"maxiter": 30},
            )  # fmt: skip
            points.append(named(moved.x))
    best = min(points, key=lambda point: delay(point)[0])
    return best, *delay(best)


@overload
def margins(P: UncertainSystem, K: Any, sign: int = -1, *, delay: float = 0.0) -> BoxMargins: ...
@overload
def margins(P: Any, K: Any, sign: int = -1, *, delay: float = 0.0) -> Margins: ...
def margins(P: Any, K: Any, sign: int = -1, *, delay: float = 0.0) -> Margins:
    """The margins of the loop of a plant and a controller, every signal on its own and all at once.

    Parameters
    ----------
    P : (p x m) plant, in any form that `system` takes, or an uncertain one; K : (m x p) controller, likewise
    sign : -1 for negative feedback u = -K y (default), +1 for u = K y, the convention of `hinfsyn` and `ncfsyn`
    delay : s, by which all commands u come later, of a certain loop; whole samples in discrete time. In continuous time
        exact for one signal; else an approximant off by 1e-9 at most where any loop is above 1/100: margins above 40 dB
        and disks above 1.9 are then read where it is no delay any more

    Returns
    -------
    Margins : of an uncertain plant `BoxMargins`, whose numbers are proved for every point of the box

    Raises
    ------
    ModelError : sizes or timebases disagree, a loop is not well posed, `sign` is neither -1 nor 1; with a delay a loop
        that does not roll off. NumericalError : the delay is too long for an approximant.
    """
    if not (isinstance(P, UncertainSystem) or isinstance(K, UncertainSystem)):
        return delayedmargins.margins(P, K, sign, delay)
    _check_undelayed("P", delay)
    sign = as_sign(sign)
    P = as_uncertain("P", P, K.dt if isinstance(K, UncertainSystem) else None)
    K = as_uncertain("K", K, P.dt)
    if (K.ny, K.nu) != (P.nu, P.ny):
        raise ModelError(f"K is {K.ny} x {K.nu}; P, which is {P.ny} x {P.nu}, needs {P.nu} x {P.ny}")
    ncf = worst_ncf(P, K, sign)
    loops = Loops(negative(series(P, K), sign), negative(series(K, P), sign), _both(P, K, sign))
    return BoxMargins(
        input=tuple(margin(one_loop(loops.input, i)) for i in range(P.nu)),
        output=tuple(margin(one_loop(loops.output, i)) for i in range(P.ny)), disk_input=diskmargin(loops.input),
        disk_output=diskmargin(loops.output), ncf=ncf.lower, dt=P.dt, loops=loops, worst_ncf=ncf,
    )  # fmt: skip


def worst_ncf(P: UncertainSystem, K: UncertainSystem, sign: int) -> WorstCase:
    """The largest gain from disturbances of y and u to y and u, inverted."""
    n, m, p, I, O = P.n, P.nu, P.ny, eye, zeros
    seen = UncertainSystem(  # these, and then from u to y
        P.E, P.A, np.hstack([O(n, p), P.B, P.B]), np.vstack([P.C, O(m, n), P.C]),
        np.block([[I(p), P.D, P.D], [O(m, p), O(m, m), I(m)], [I(p), P.D, P.D]]), P.dt,
    )  # fmt: skip
    return inverted(worst_gain(seen.lft(negative(K, -sign))), NCF)


def _both(P: UncertainSystem, K: UncertainSystem, sign: int) -> UncertainSystem:
    """The loop cut at inputs and outputs at once: [u; y] = -[[0, -sign K], [-P, 0]] [u; y]."""
    m, p, n, k = P.nu, P.ny, P.n, K.n
    E, A = (np.block([[M, zeros(n, k)], [zeros(k, n), N]]) for M, N in ((P.E, K.E), (P.A, K.A)))
    B = np.block([[P.B, zeros(n, p)], [zeros(k, m), K.B]])
    C = np.block([[zeros(m, n), -sign * K.C], [-P.C, zeros(p, k)]])
    D = np.block([[zeros(m, m), -sign * K.D], [-P.D, zeros(p, p)]])
    return UncertainSystem(E, A, B, C, D, P.dt)


def one_loop(L: UncertainSystem, i: int) -> UncertainSystem:
    """The loop that is seen where channel `i` of a square loop is cut, the others closed with negative feedback."""
    if L.nu == 1:
        return L
    order = [i, *(j for j in range(L.nu) if j != i)]
    ordered = UncertainSystem(L.E, L.A, L.B[:, order], L.C[order], L.D[np.ix_(order, order)], L.dt)
    return ordered.lft(StateSpace.gain(-np.eye(L.nu - 1), L.dt))


def _is_stable(G: UncertainSystem) -> bool:
    """Whether the loop is at the nominal parameters, exactly."""
    pencil = Pencil.of(T := G.feedback(1), tuple(T.parameters.values()))
    return pencil.is_stable_at(pencil.nominal)


def negative(L: UncertainSystem, sign: int) -> UncertainSystem:
    """The loop for negative feedback."""
    return L if as_sign(sign) == -1 else UncertainSystem(L.E, L.A, L.B, -L.C, -L.D, L.dt, L.u, L.y)
