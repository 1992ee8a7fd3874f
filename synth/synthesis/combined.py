"""The search behind `synthesize`: LMIs that share the multiplier G, scales between them, controllers measured.

Sharing G costs: the bounds are met, but the level that is minimised is above the least one. How far depends on how the
Lyapunov matrices P of the specifications are scaled to each other, which is searched for. A controller that is best
for the minimised norm alone and meets the bounds all the same is taken as it is.

References: Scherer, Gahinet and Chilali (1997), IEEE TAC 42, 896 (one Lyapunov matrix for all); de Oliveira, Geromel
and Bernussou (2002), Int. J. Control 75, 666 (one for each, one multiplier).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from synth.analysis.norms import Verification, judge
from synth.analysis.precondition import Conditioned, conditioned
from synth.checks import shown
from synth.errors import InfeasibleError, ModelError, NumericalError, SynthError
from synth.synthesis.specifications import MET, Bound, Disc, Norm, StrictlyProper
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import design_rate, discretised
from synth.systems.statespace import StateSpace

SURE = 1e-3  # relative: a bound that is farther below the least value alone is not tried
MOST = 40  # moves of the scales
STEPS = (4.0, 2.0, 2**0.5)  # factors by which the scale of a specification is moved
WORTH = 1e-4  # relative, of the level: a move of the scales that brings less is not made
STARTS = (0, -1, 1, -2, 2, -3, 3)  # powers of the first factor at which a point that meets all bounds is looked for
FEW = 3  # of them where the LMIs have wider bounds
RELAXED = (1.0, 1.02, 1.05, 1.1, 1.2, 1.5, 2.0)  # factors by which the LMIs may have wider bounds, tried in turn
TOLD = 1e-2  # relative distance of the measured norm from the claimed one from which on it is told
BACKOFF = (1e-3, 1e-2, 1e-1, 1.0)  # relative distances from the least level at which to ask for controllers
ALONE = "the best controller for the minimised norm meets all"
FAILS = (SynthError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Told:
    """One specification of a result."""

    name: str
    level: float | None  # that was asked for; None for what was minimised
    claimed: float | None  # by the LMI, whose bound may be wider than `level`; no proof; None where none was needed
    measured: float
    alone: float | None  # the least value of any controller, without the other specifications, where it is known


@dataclass(frozen=True)
class Task:
    """What was asked for, checked."""

    plant: GeneralizedPlant
    minimize: Norm
    bounds: tuple[Bound, ...]
    disc: Disc | None
    proper: bool
    method: str

    @classmethod
    def of(cls, plant: GeneralizedPlant, minimize: Any, subject_to: Any, method: str) -> Task:
        """What `synthesize` was called with.

        Raises
        ------
        ModelError : it is no specification, or none for this plant.
        """
        if not isinstance(minimize, Norm) or type(minimize) is Norm:
            raise ModelError(f"minimize is {shown(minimize)}; pass Hinf(...), H2(...) or GeneralisedH2(...)")
        if not isinstance(subject_to, list | tuple) or not all(
            isinstance(item, Bound | Disc | StrictlyProper) for item in subject_to
        ):
            raise ModelError(
                f"subject_to is {shown(subject_to)}; pass a list of bounds such as H2(...) <= 2, Disc(centre, radius), "
                "StrictlyProper()"
            )
        bounds = tuple(item for item in subject_to if isinstance(item, Bound))
        discs = [item for item in subject_to if isinstance(item, Disc)]
        if len(discs) > 1:
            raise ModelError(f"subject_to has {len(discs)} discs; pass one that lies in all of them")
        proper = any(isinstance(item, StrictlyProper) for item in subject_to)
        if not len(plant.A):
            raise ModelError("P has no states; hinfsyn and h2syn know the best gain")
        for norm in (minimize, *(bound.norm for bound in bounds)):
            norm.numbers(plant)
            if not plant.dt and not norm.anytime:
                raise ModelError(
                    f"{_name(norm, plant)} is a specification of discrete time, and P is continuous: sample P by c2d, "
                    "or design with h2syn"
                )
        if proper and not plant.dt:
            raise ModelError("StrictlyProper() is a specification of discrete time, and P is continuous: leave it away")
        return cls(plant, minimize, bounds, discs[0] if discs else None, proper, method)

    def values(self, closed_loop: StateSpace) -> list[float]:
        """The measured value of every norm, the minimised one first."""
        return [norm.measured(self.plant, closed_loop) for norm in (self.minimize, *(b.norm for b in self.bounds))]


def _name(norm: Norm, plant: GeneralizedPlant) -> str:
    """A norm as it was asked for."""
    z, w = norm.numbers(plant)
    parts = [("w", w, plant.w), ("z", z, plant.z)]
    listed = ", ".join(f"{key}={[names[i] for i in k]}" for key, k, names in parts if len(k) < len(names))
    return f"{type(norm).__name__}({listed})"


def mapped(task: Task) -> tuple[Conditioned, Any, Disc | None]:
    """The plant in discrete time and good coordinates, the way back for controllers, and the disc there."""
    if task.plant.dt:
        return conditioned(task.plant), lambda K: K, task.disc
    rate = design_rate(task.plant)
    disc = task.disc.moved(rate) if task.disc else None
    discrete, back = discretised(task.plant, rate)
    return conditioned(discrete), back, disc


@dataclass(frozen=True)
class Found:
    """A controller that meets all specifications, measured."""

    controller: StateSpace
    closed_loop: StateSpace
    verified: Verification
    values: list[float]
    claimed: float | None  # of the minimised norm
    status: str
    part: float  # factor by which the bounds in its LMIs were wider


@dataclass
class Search:
    """The scales of the specifications, and the controllers that were found."""

    task: Task
    scaled: Conditioned
    back: Any
    disc: Disc | None  # of the discrete plant
    failures: dict[str, str] = field(default_factory=dict)
    told: str = ""
    missed: str = ""  # by the last controller that was measured
    scales: tuple[float, ...] | None = None  # of the bounds, once a point that meets all is known

    def run(self) -> Found:
        """The best of all controllers for the minimised norm alone, if it serves; else one by LMIs."""
        task = self.task
        norms = (task.minimize, *(bound.norm for bound in task.bounds))
        self.alone = [norm.alone(task.plant, proper=task.proper) for norm in norms]
        for bound, alone in zip(task.bounds, self.alone[1:], strict=True):
            if alone and alone[0] > bound.level * (1 + SURE):
                without = "with StrictlyProper() only" if task.proper else "alone"
                raise InfeasibleError(
                    f"{_name(bound.norm, task.plant)} <= {bound.level:.7g} was not met: {alone[0]:.7g} is the least "
                    f"that the solver claims possible {without}, which is no proof",
                    best=alone[0],
                )
        if self.alone[0] and not (task.proper and self.alone[0][1].D.any()):
            found = self.judged("alone", self.alone[0][1], None, ALONE, 1.0)
            if found:
                return found
        best = None
        asked = task.bounds or task.disc
        for part in RELAXED if asked else RELAXED[:1]:
            found = self.relaxed(part)
            if found and (best is None or found.values[0] < best.values[0]):
                best = found
            elif best:
                break
        if best is None and not asked:
            raise NumericalError(f"no attempt led to a controller that verifies: {self.missed}", self.failures)
        if best is None:
            raise self.infeasible()
        if best.claimed and best.values[0] > best.claimed * (1 + TOLD):
            self.told = f"the LMIs claim {best.claimed:.7g}, which this controller does not reach"
        return best

    def relaxed(self, part: float) -> Found | None:
        """The best controller that meets all when measured, of those whose LMIs have bounds that are wider by a factor.

        LMIs that share G are sufficient only: a loop is better than they say. It is judged by what was asked for.
        """
        if (least := self.least(part)) is None:
            return None
        level, status = least
        best = None
        for distance in BACKOFF:
            found = self.centred(level, part, distance, status)
            best = found if found and (best is None or found.values[0] < best.values[0]) else best
            if best and best.values[0] <= level * self.scaled.scale * (1 + distance):
                break
        return best

    def pose(self, level: Any, scales: tuple[float, ...], part: float) -> tuple[Any, list[Any]]:
        """The unknowns and the LMIs for a level of the minimised norm, a number or an unknown itself.

        Parameters
        ----------
        scales : of the bounds, each a against b
        part : factor by which the bounds and the radius of the disc are wider than was asked for, 1 or more
        """
        import cvxpy as cp

        from synth.lmi.disc import disc
        from synth.lmi.loops import extended, standard

        task, plant = self.task, self.scaled.plant
        n, _, nu, _, ny = plant.sizes
        unknowns = extended(plant) if task.method == "extended" else standard(plant)
        if task.proper:
            unknowns = replace(unknowns, Dn=np.zeros((nu, ny)))
        loop = unknowns.loop

        def own() -> Any:
            if task.method == "standard":
                return loop
            return replace(loop, P=cp.Variable((2 * n, 2 * n), symmetric=True))

        z, w = task.minimize.numbers(task.plant)
        lmis = task.minimize.lmis(loop.channel(z, w), level, level)
        for bound, scale in zip(task.bounds, scales, strict=True):
            z, w = bound.norm.numbers(task.plant)
            most = part * bound.level / self.scaled.scale
            lmis += bound.norm.lmis(own().channel(z, w), most * scale, most / scale)
        if self.disc:
            lmis.append(disc(own(), self.disc.centre, part * self.disc.radius))
        return unknowns, lmis

    def minimised(self, scales: tuple[float, ...], part: float) -> tuple[float, str]:
        """The least level at these scales, inf where there is none."""
        import cvxpy as cp

        from synth.lmi.solve import solve, value

        g = cp.Variable()
        try:
            status = solve(g, self.pose(g, scales, part)[1])
            return max(float(value(g)), 0.0) or np.inf, status
        except FAILS as error:
            self.failures[f"bounds times {part:g}, scales {', '.join(f'{s:.3g}' for s in scales)}"] = str(error)
            return np.inf, str(error)

    def least(self, part: float = 1.0) -> tuple[float, str] | None:
        """The least level over `scales`, by moving one at a time, ever less; once they are known they stay.

        None where no scales were found at which the LMIs have a solution.
        """
        if self.scales is not None:
            level, status = self.minimised(self.scales, part)
            return (level, status) if np.isfinite(level) else None
        count = len(self.task.bounds)
        tried: dict[tuple[float, ...], tuple[float, str]] = {}

        def at(scales: tuple[float, ...]) -> float:
            if scales not in tried:
                tried[scales] = self.minimised(scales, part)
            return tried[scales][0]

        starts = [(STEPS[0] ** power,) * count for power in (STARTS if part == 1 else STARTS[:FEW])]
        scales = next((start for start in starts if np.isfinite(at(start))), None)
        if scales is None:
            return None
        for step in STEPS if count else ():
            for i in range(count):
                for factor in (step, 1 / step):
                    moved = (*scales[:i], scales[i] * factor, *scales[i + 1 :])
                    while len(tried) < MOST and at(moved) < at(scales) * (1 - WORTH):
                        scales = moved
                        moved = (*scales[:i], scales[i] * factor, *scales[i + 1 :])
        self.scales = scales
        return tried[scales]

    def infeasible(self) -> InfeasibleError:
        """The error for bounds that were not met together."""
        task = self.task
        parts = []
        for bound, alone in zip(task.bounds, self.alone[1:], strict=True):
            room = f", alone {alone[0]:.4g} is possible" if alone else ""
            parts.append(f"{_name(bound.norm, task.plant)} <= {bound.level:.7g}{room}")
        if task.disc:
            parts.append(f"poles within {task.disc.radius:.7g} of {task.disc.centre:.7g}")
        more = ", or a disc that holds all modes that no control moves or no sensor sees" if task.disc else ""
        missed = f"; the last controller missed: {self.missed}" if self.missed else ""
        text = f"no controller was found that meets all, which proves nothing: {'; '.join(parts)}{missed}"
        return InfeasibleError(f"{text}; allow more{more}", best=np.inf)

    def centred(self, level: float, part: float, distance: float, status: str) -> Found | None:
        """The controller at the analytic centre of all unknowns that reach a level a little above the least."""
        from synth.lmi.solve import solve

        name = f"level {level * (1 + distance) * self.scaled.scale:.7g}, bounds times {part:g}"
        try:
            unknowns, lmis = self.pose(level * (1 + distance), self.scales or (), part)
            solve(0, lmis)
            K = self.back(self.scaled.restore(unknowns.controller()))
        except FAILS as error:
            self.failures[name] = self.missed = str(error)
            return None
        return self.judged(name, K, level * self.scaled.scale, status, part)

    def judged(self, name: str, K: StateSpace, claimed: float | None, status: str, part: float) -> Found | None:
        """A controller with its loop and what was measured of it; None where it misses something."""
        task = self.task
        try:
            closed_loop, verified = judge(task.plant, K)
            values = task.values(closed_loop)
        except FAILS as error:
            self.failures[name] = self.missed = str(error)
            return None
        missed = [
            f"{_name(bound.norm, task.plant)} is {value:.7g} for {bound.level:.7g}"
            for bound, value in zip(task.bounds, values[1:], strict=True)
            if not value <= bound.level * (1 + MET)
        ]
        if task.disc and not task.disc.measured(closed_loop) <= task.disc.radius * (1 + MET):
            missed.append(f"a pole is {task.disc.measured(closed_loop):.7g} from {task.disc.centre:.7g}")
        if missed:
            self.failures[name] = self.missed = "; ".join(missed)
            return None
        return Found(K, closed_loop, verified, values, claimed, status, part)

    def tell(self, found: Found) -> Iterator[Told]:
        """Every specification with what became of it."""
        task, alone = self.task, [a[0] if a else None for a in self.alone]
        yield Told(_name(task.minimize, task.plant), None, found.claimed, found.values[0], alone[0])
        for bound, value, least in zip(task.bounds, found.values[1:], alone[1:], strict=True):
            claimed = None if found.claimed is None else found.part * bound.level
            yield Told(_name(bound.norm, task.plant), bound.level, claimed, value, least)
        if task.disc:
            farthest = task.disc.measured(found.closed_loop)
            claimed = None if found.claimed is None else found.part * task.disc.radius
            yield Told(f"poles about {task.disc.centre:.7g}", task.disc.radius, claimed, farthest, None)
