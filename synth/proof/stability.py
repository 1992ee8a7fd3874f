"""`stability_margin` of a loop over its box of parameters: found in doubles, proved in balls.

Some of the ranges may be made larger while the others stay as they are: with a gain or the tangent of half a phase as a
parameter that is how margins over a box are proved (`boxmargins`).
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from synth.analysis import worstcase as search
from synth.checks import shown
from synth.errors import ModelError
from synth.proof import robust
from synth.proof.boxcertificate import STABILITY, scale_of
from synth.proof.boxes import explored
from synth.proof.pencils import Pencil
from synth.proof.worstcase import (
    BOXES,
    NEWS,
    TRIES,
    WIDER,
    WIDEST,
    Asked,
    Proof,
    WorstCase,
    accurate,
    asked,
    certified,
    doubtful,
    exact_point,
    frequency_of,
    named_point,
    remark,
    too_large,
)
from synth.systems.parameters import Parameter
from synth.threads import one_thread

FEW = 16  # part of the boxes after which a worse point is looked for first
NEAREST, HALVINGS = 1e-13, 50  # relative, of the exact boundary of stability on a ray, and steps to it


@one_thread
def stability_margin(
    loop: Any, controller: Any = None, *, growing: Any = (), tol: float = 1e-5, boxes: int = BOXES
) -> WorstCase:
    """How many times as large the box of parameters can be made before the loop loses stability, from both sides.

    The box is made larger about the nominal values, each range up and down by the same factor.

    Parameters
    ----------
    loop, controller, tol, boxes : as of `worst_gain`; inputs and outputs of the loop do not matter
    growing : names of the parameters whose ranges are made larger, all when left out; the others stay in theirs, and
        `certificate` holds the box that was proved

    Returns
    -------
    WorstCase : the loop is proved stable on the whole box made `lower` times as large; at `parameters`, in the box
        `upper` times as large, it has the unstable pole `eigenvalue`. `upper` is inf where no instability was found up
        to a hundred times the box.

    Raises
    ------
    ModelError : as `worst_gain`.

    Reference: as `worst_gain`.
    """
    ask = asked(loop, controller, tol, boxes)
    growing = _names(growing, ask)
    pencil, N = Pencil.of(ask.G, ask.box), search.Numbers(ask.G, ask.box, growing)
    if not pencil.is_stable_at(pencil.nominal):
        return _margin(ask, N, np.zeros(len(ask.box)), None, "the loop is not stable at the nominal parameters")
    limit = _limit(ask, N)
    size, worst = robust.size_of_stability(pencil), _nearest(pencil, N, limit)
    if not robust.fits(pencil, size, bordered=False):
        return _margin(ask, N, worst, None, too_large(pencil, size, bordered=False))
    if worst is not None and N.size(worst) < search.NOWHERE:
        return _margin(ask, N, worst, None, "the loop is unstable before the ranges are made larger")
    most, distance, outcome, proof = ask.most(size), ask.tol, None, None
    few = most // FEW
    for _ in range(TRIES):
        found = min(search.FARTHEST, limit) if worst is None else N.size(worst)
        level = found if worst is None and distance == ask.tol else found / (1 + distance)
        grown, scale = (_grown(ask, growing, level), Fraction(1)) if growing else (ask.box, Fraction(level))
        larger = Pencil.of(ask.G, grown, scale)
        frame, start = accurate(N, larger, robust.stability_pieces)
        outcome = explored(start, robust.excludes_zero, few, lambda _: None)
        if outcome.proved:
            proof = Proof(level, frame, outcome)
            break
        nearer = _nearest(pencil, N, limit, doubtful(outcome, N, frame.edges, level)[0])
        if nearer is not None and N.size(nearer) < found * (1 - NEWS * ask.tol):
            worst, few = nearer, most // FEW
        elif few < most:  # nothing worse is in the boxes that are left: more of them may tell
            few = most
        else:
            distance *= WIDER
        if distance > WIDEST:
            break
    note = remark("a margin", most, outcome, proof, wide=distance > ask.tol)
    if worst is None and limit < search.FARTHEST and not note:
        note = f"hold equivalents were made for {limit:.9g} times the box; give the plant wider ranges before c2d"
    return _margin(ask, N, worst, proof, note)


robstab = stability_margin  # MATLAB's name


def _limit(ask: Asked, N: search.Numbers) -> float:
    """How many times as large the box may be made for what stands for hold equivalents."""
    holds = {(q.name, q.low, q.high) for r in ask.G.remainders.values() for q in r.hold.box}
    limit = Fraction(10) ** 6
    for p, grows in zip(ask.box, N.growing, strict=True):
        for _, low, high in (q for q in holds if grows and q[0] == p.name):
            for end, farthest in ((p.low, low), (p.high, high)):
                room, own = abs(Fraction(farthest) - Fraction(p.nominal)), abs(Fraction(end) - Fraction(p.nominal))
                limit = min(limit, room / own) if own else limit
    found = float(limit)
    return found if Fraction(found) <= limit else float(np.nextafter(found, 0))


def _nearest(pencil: Pencil, N: search.Numbers, limit: float, *starts: Any) -> np.ndarray | None:
    """An unstable point, exactly so, in a box as small as was found; eigenvalues may be wrong, so it is moved on."""
    t = search.nearest_instability(N, *starts)
    if t is None or N.size(t) > limit:
        return None
    stable = pencil.is_stable_at(exact_point(N, t))
    for k in range(1, 22):
        other = 1 + (NEAREST if stable else -NEAREST) * 4**k
        if pencil.is_stable_at(exact_point(N, N.on_ray(t, other))) != stable:
            break
    else:
        return None if stable else t
    low, high = (1.0, other) if stable else (other, 1.0)
    for _ in range(HALVINGS):
        if high - low < NEAREST:
            break
        middle = (low + high) / 2
        low, high = (middle, high) if pencil.is_stable_at(exact_point(N, N.on_ray(t, middle))) else (low, middle)
    return N.on_ray(t, high)


def _names(growing: Any, ask: Asked) -> tuple[str, ...]:
    """Names of parameters; none where all of them grow."""
    names = (growing,) if isinstance(growing, str) else growing
    known = [p.name for p in ask.box]
    if not isinstance(names, list | tuple) or not set(map(str, names)) <= set(known):
        raise ModelError(f"growing is {shown(growing)}; pass names of parameters: {', '.join(known)}")
    return () if set(names) == set(known) else tuple(names)


def _grown(ask: Asked, growing: tuple[str, ...], level: float) -> tuple[Parameter, ...]:
    """The box with some ranges made larger, rounded inwards."""

    def end(p: Parameter, x: float) -> float:
        exact = Fraction(p.nominal) + Fraction(level) * (Fraction(x) - Fraction(p.nominal))
        y = float(exact)
        return (
            y
            if abs(Fraction(y) - Fraction(p.nominal)) <= abs(exact - Fraction(p.nominal))
            else float(np.nextafter(y, p.nominal))
        )

    return tuple(
        Parameter(p.name, p.nominal, end(p, p.low), end(p, p.high)) if p.name in growing else p for p in ask.box
    )


def _margin(ask: Asked, N: search.Numbers, worst: np.ndarray | None, proof: Proof | None, note: str) -> WorstCase:
    """The result, with a point that is unstable exactly."""
    point, upper, pole, frequency = {}, np.inf, None, np.nan
    growing = () if N.growing.all() else tuple(p.name for p, grows in zip(ask.box, N.growing, strict=True) if grows)
    if worst is not None:
        point = named_point(ask, N.values(worst))
        box = [p for p, grows in zip(ask.box, N.growing, strict=True) if grows]
        upper = _above(scale_of(box, point)) if N.size(worst) else 0.0
        pole = Pencil.of(ask.G, ask.box).worst_pole(exact_point(N, worst))
        frequency = frequency_of(ask.G, pole)
    lower, certificate = 0.0, None
    if proof and growing:
        grown = _grown(ask, growing, proof.level)
        reached = _above(scale_of(grown, point)) if point else np.inf
        lower = float(np.nextafter(proof.level, 0))
        G = ask.G.with_ranges(grown)
        certificate = certified(ask._replace(G=G), STABILITY, proof._replace(level=1.0), reached, point, 0.0)
    elif proof:
        lower, certificate = proof.level, certified(ask, STABILITY, proof, upper, point, 0.0)
    return WorstCase(
        quantity=STABILITY, lower=lower, upper=upper, parameters=point, frequency=frequency, eigenvalue=pole,
        norm=np.inf if point else np.nan, note=note, boxes=proof.outcome.boxes if proof else 0,
        certificate=certificate,
    )  # fmt: skip


def _above(scale: Fraction) -> float:
    return float(np.nextafter(float(scale), np.inf))
