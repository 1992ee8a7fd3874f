"""The worst case of a loop over its box of parameters: found in doubles, proved in balls.

The search (`analysis.worstcase`) gives a point and a level just beyond it; the proof (`robust`, `boxes`) holds there,
or names a worse point, from which the search goes on, or leaves boxes undecided, and the next level is farther away.
What is not proved is never called unstable: unstable is a point whose poles are not all in the stability region.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from flint import fmpq

from synth.analysis import worstcase as search
from synth.analysis.norms import hinfnorm
from synth.checks import as_number, as_whole, shown
from synth.errors import ModelError
from synth.proof import robust
from synth.proof.boxcertificate import GAIN, STABILITY, BoxCertificate, gain_at
from synth.proof.boxes import HIGHEST, Outcome, explored
from synth.proof.pencils import Pencil, rational
from synth.systems.parameters import Parameter
from synth.systems.uncertain import UncertainSystem

BITS = (256, 512, 1024, 2048)  # as many as it takes for the rounding to doubles to be all that is lost
BOXES = 200_000
WORK = 500_000_000  # coefficients on the boxes of a proof
WIDER = 10.0  # times as far from what was found, where a level is not proved
WIDEST = 60.0  # relative distance beyond which no level is tried
TRIES = 30  # levels
NEWS = 1e-2  # part of tol by which a worse point changes the level
PIECES, PER_DECADE = 20, 6  # of frequency
BEYOND = 8.0  # times the fastest pole, and below the slowest
CENTRES = 32  # of undecided boxes, from which the search goes on
SAFE = 1e-12  # relative, below the gain that was found
NOTHING = 1e-140  # a gain below it is none
SHIFTED = (1.0, 1.0293, 1.0719)  # of the pieces of frequency, where a node meets a pole


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class WorstCase:
    """Bounds on what can happen in a box of parameters.

    Of a gain `upper` is proved, and `parameters` reach `lower`; of a stability margin `lower` is proved, and
    `parameters` reach `upper`.
    """

    quantity: str  # "gain", "stability", or which margin (`margin`, `diskmargin`)
    lower: float
    upper: float
    parameters: dict[str, float]  # where the worst was found; empty where nothing was
    frequency: float  # rad/s, of the gain or of the pole
    eigenvalue: complex | None  # the pole that is not stable at the parameters, rad/s or in the z plane
    norm: float  # H-infinity norm at the parameters by `hinfnorm`, inf of an unstable loop
    note: str  # why the bounds are not closer, and what would help; empty where they are
    boxes: int  # that the last proof needed
    certificate: BoxCertificate | None  # None where nothing is proved

    @property
    def gap(self) -> float:
        """Relative distance of the bounds, upper / lower - 1."""
        return self.upper / self.lower - 1 if self.lower > 0 and np.isfinite(self.upper) else np.inf

    def __repr__(self) -> str:
        at = ", ".join(f"{name} = {value:.9g}" for name, value in self.parameters.items())
        pole = None if self.eigenvalue is None else f"{self.eigenvalue:.6g}"
        if self.quantity == GAIN:
            proved = f"proved: stable, gain below {self.upper:.9g}" if self.certificate else "no upper bound proved"
            found = f"reached: {self.lower:.9g} at {self.frequency:.6g} rad/s with {at}"
            found = f"unstable, pole {pole}, with {at}" if pole else found
        elif self.quantity != STABILITY:
            found, proved = f"reached: {self.quantity} {self.upper:.9g} with {at}", f"proved: {self.lower:.9g}"
            proved = proved if self.certificate else "nothing proved"
        else:
            proved = f"proved: stable up to {self.lower:.9g} times the box" if self.certificate else "nothing proved"
            found = f"unstable at {self.upper:.9g} times the box, pole {pole}, with {at}" if pole else "none found"
        return "\n".join([found, proved, *([f"note: {self.note}"] if self.note else [])])


def worst_of_box(ask: Asked) -> WorstCase:
    """The worst gain over the parameters."""
    pencil, N = Pencil.of(ask.G, ask.box), search.Numbers(ask.G, ask.box)
    unstable, peaks = (np.zeros(len(ask.box)), []) if not pencil.is_stable_at(pencil.nominal) else _climbed(pencil, N)
    if unstable is not None:
        return _unstable(ask, N, unstable)
    size = robust.size_of_gain(pencil)
    if not robust.fits(pencil, size, bordered=True):
        return _gain(ask, peaks[0], None, too_large(pencil, size, bordered=True))
    frame, pieces = accurate(N, pencil, robust.gain_pieces)
    most, distance, outcome, proof = ask.most(size), ask.tol, None, None
    for _ in range(TRIES):
        level = _above(peaks[0].gain, distance)
        outcome = explored(robust.at_level(pieces, level), robust.is_positive, most, robust.negative_corner)
        if outcome.proved:
            proof = Proof(level, frame, outcome)
            break
        unstable, higher = _climbed(pencil, N, *doubtful(outcome, N, frame.edges))
        if unstable is not None:
            return _unstable(ask, N, unstable)
        if higher[0].gain > peaks[0].gain * (1 + NEWS * ask.tol):
            peaks = higher
        else:
            distance *= WIDER
        if distance > WIDEST:
            break
    return _gain(ask, peaks[0], proof, remark("an upper bound", most, outcome, proof, wide=distance > ask.tol))


class Frame(NamedTuple):
    """What the polynomials of a proof are made with."""

    edges: list[float]  # of the pieces of frequency
    bits: int
    degrees: tuple[int, ...]  # of interpolants, see `robust.degrees_for`


class Proof(NamedTuple):
    """A level that was proved."""

    level: float
    frame: Frame
    outcome: Outcome


class Asked(NamedTuple):
    """What the caller wants."""

    G: UncertainSystem
    box: tuple[Parameter, ...]
    tol: float
    boxes: int

    def most(self, size: int) -> int:
        """Boxes that a proof may need, with so many coefficients on each."""
        return max(min(self.boxes, WORK // size), 1000)


def asked(loop: Any, controller: Any, tol: Any, boxes: Any) -> Asked:
    """Arguments that are ones, the loop closed."""
    if not isinstance(loop, UncertainSystem):
        raise ModelError(f"loop is {shown(loop)}; pass an UncertainSystem, whose matrices hold ureal parameters")
    if controller is not None:
        try:
            loop = loop.close(controller)
        except ModelError as error:
            raise ModelError(f"controller: {error}") from None
    if not loop.parameters:
        raise ModelError("loop has no uncertain parameters; hinfnorm measures certain systems, certify proves designs")
    if not Pencil.of(loop, tuple(loop.parameters.values())).order:
        raise ModelError("loop has no states that move; the gain of a matrix needs no proof of stability")
    tol = as_number("tol", tol, "a relative distance from 1e-9 to 1", least=1e-9)
    if tol > 1:
        raise ModelError(f"tol is {tol:g}; pass a relative distance from 1e-9 to 1")
    boxes = as_whole("boxes", boxes, "a number of boxes", least=1, most=10**8)
    return Asked(loop, tuple(loop.parameters.values()), tol, boxes)


def _climbed(pencil: Pencil, N: search.Numbers, *starts: Any) -> tuple[np.ndarray | None, list[search.Peak]]:
    """An unstable point, exactly so, or large gains, the largest first."""
    unstable, peaks = search.worst_gain(N, *starts)
    if unstable is not None and pencil.is_stable_at(exact_point(N, unstable)):  # by rounding alone
        unstable, peaks = search.worst_gain(N, *starts, stable_below=search.ROUNDED)
    return unstable, peaks


def exact_point(N: search.Numbers, t: np.ndarray) -> list[fmpq]:
    """Parameters at t, as they are."""
    return [rational(x) for x in N.values(t)]


def accurate(N: search.Numbers, pencil: Pencil, make: Callable) -> tuple[Frame, Any]:
    """Polynomials whose balls are small beside rounding to doubles, or beside what interpolants are off."""
    found: Any = None
    for shift in SHIFTED:
        edges = _edges(N, pencil.order + 2, shift)
        degrees = robust.degrees_for(pencil, edges, bordered=make is robust.gain_pieces)
        for bits in BITS:
            try:
                made = make(pencil, edges, bits, degrees)
            except ZeroDivisionError:
                continue
            found = Frame(edges, bits, degrees), made
            if pencil.off:
                return found
            size = np.abs(made.coefficients).reshape(*made.errors.shape, -1).max(axis=2)
            if (made.errors <= 2 * robust.MIDPOINT * size).all():
                return found
        if found is not None:
            return found
    raise ModelError("loop has a pole at every frequency of the interpolation; give it some damping")


def _edges(N: search.Numbers, least: int, shift: float) -> list[float]:
    """Ends of pieces of frequency around the nominal poles, with few digits."""
    poles = N.in_plane(N.poles(np.zeros(len(N.nominal))))
    moduli = np.abs(poles)
    moduli = moduli[moduli > 1e-9 * moduli.max()] if moduli.any() else np.ones(1)
    low, high = moduli.min() / BEYOND, moduli.max() * BEYOND
    count = max(PIECES, least, round(PER_DECADE * np.log10(high / low)))
    return [float(np.float32(x * shift)) for x in np.geomspace(low, high, count)]


def _above(gain: float, distance: float) -> float:
    """A level above a gain; something very small above none."""
    return float(np.nextafter(gain * (1 + distance), np.inf)) if gain > NOTHING else 2 * NOTHING


def doubtful(
    outcome: Outcome, N: search.Numbers, edges: list[float], scale: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Points t from which to search again, and frequencies: where a level is refuted, or what is left undecided."""
    if outcome.refuted is not None:
        pieces, points = np.array([outcome.refuted[0]]), outcome.refuted[1][None]
    elif outcome.left is not None:
        left = outcome.left
        which = np.unique(np.linspace(0, len(left.low) - 1, CENTRES).astype(int))
        pieces, points = left.piece[which], left.low[which] + left.width[which] / 2
    else:
        return np.zeros((0, len(N.nominal))), np.zeros(0)
    ends = np.array([[0, 1 / edges[0]], *([w, 1 / w] for w in edges), [edges[-1], 0]])
    a, b, f = ends[pieces], ends[pieces + 1], points[:, :1]
    u = a * (1 - f) + b * f
    with np.errstate(divide="ignore"):
        w = np.sqrt(u[:, 0] / u[:, 1])
    return N.fractions(points[:, 1:], scale), np.clip(w, edges[0] / 1e3, edges[-1] * 1e3)


def frequency_of(G: UncertainSystem, pole: complex) -> float:
    """Of a pole, in rad/s."""
    return float(abs(np.angle(pole)) / G.dt) if G.discrete else abs(pole.imag)


def named_point(ask: Asked, values: np.ndarray) -> dict[str, float]:
    """Parameters by name."""
    return {p.name: float(x) for p, x in zip(ask.box, values, strict=True)}


def _unstable(ask: Asked, N: search.Numbers, t: np.ndarray) -> WorstCase:
    pole = Pencil.of(ask.G, ask.box).worst_pole(exact_point(N, t))
    return WorstCase(
        quantity=GAIN, lower=np.inf, upper=np.inf, parameters=named_point(ask, N.values(t)),
        frequency=frequency_of(ask.G, pole), eigenvalue=pole, norm=np.inf, note="", boxes=0, certificate=None,
    )  # fmt: skip


def too_large(pencil: Pencil, size: int, *, bordered: bool) -> str:
    """What does not fit, and what would."""
    r = dict(zip(pencil.names, pencil.degrees(bordered=bordered), strict=True))
    dear = max(r, key=lambda name: r[name])
    return (
        f"nothing was proved: the polynomial has {size} coefficients on a box (degree {pencil.order} in omega^2, in "
        f"parameters {'twice ' if bordered else ''}{r}), and {robust.MOST_COEFFICIENTS} of degree at most {HIGHEST} "
        f"fit; holding {dear!r} at its nominal value would divide them by {(2 if bordered else 1) * r[dear] + 1}"
    )


def remark(what: str, most: int, outcome: Outcome | None, proof: Proof | None, *, wide: bool) -> str:
    """Why the bounds are not as near as they were asked for, and what would help."""
    if proof:
        return f"levels nearer to the one found were left undecided by at most {most} boxes in doubles" if wide else ""
    left = 0 if outcome is None or outcome.left is None else len(outcome.left.low)
    return (
        f"{what} was not proved: {left} boxes were left undecided of {most}, and no unstable point was found in them; "
        "more boxes, a larger tol or smaller ranges would help"
    )


def _gain(ask: Asked, peak: search.Peak, proof: Proof | None, note: str) -> WorstCase:
    """The result, with the norm measured again where the gain is largest."""
    G, pencil = ask.G, Pencil.of(ask.G, ask.box)
    point = named_point(ask, peak.values)
    H, unit = G.at(point), 2.0 ** round(np.log2(peak.gain)) if peak.gain > NOTHING else 1.0
    norm, omega = hinfnorm(replace(H, C=H.C / unit, D=H.D / unit))
    tries = [peak.w, float(np.tan(omega * G.dt / 2)) if G.discrete else omega]
    bits = proof.frame.bits if proof else BITS[0]
    lower, w = max((float(gain_at(pencil, point, w, bits).lower()) * (1 - SAFE), w) for w in tries if np.isfinite(w))
    claimed = (lower, point, w) if lower > 0 else (0.0, {}, 0.0)
    certificate = proof and certified(ask, GAIN, proof, *claimed)
    return WorstCase(
        quantity=GAIN, lower=lower, upper=proof.level if proof else np.inf, parameters=point,
        frequency=float(2 * np.arctan(w) / G.dt) if G.discrete else w, eigenvalue=None, norm=norm * unit, note=note,
        boxes=proof.outcome.boxes if proof else 0, certificate=certificate,
    )  # fmt: skip


def certified(
    ask: Asked, quantity: str, proof: Proof, reached: float, point: dict[str, float], w: float
) -> BoxCertificate:
    """What was proved, with what proves it again."""
    return BoxCertificate(
        quantity=quantity, level=proof.level, reached=reached, point=point, w=w, system=ask.G, bits=proof.frame.bits,
        edges=tuple(proof.frame.edges), degrees=proof.frame.degrees, script=tuple(proof.outcome.script),
    )  # fmt: skip
