"""The search behind `synthesize`: controllers by descent or by LMIs that share the multiplier G, all measured.

Descents start at the controllers that are best for one of the norms alone; `direct.py` has them. Where none of them
meets all bounds, the LMIs are asked, and the descent goes on from their controller.

Sharing G costs: the bounds are met, but the level that is minimised is above the least one. How far depends on how the
Lyapunov matrices P of the specifications are scaled to each other, which is searched for. A controller that is best
for the minimised norm alone and meets the bounds all the same is taken as it is.

References: Scherer, Gahinet and Chilali (1997), IEEE TAC 42, 896 (one Lyapunov matrix for all); de Oliveira, Geromel
and Bernussou (2002), Int. J. Control 75, 666 (one for each, one multiplier).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from synth.analysis.norms import judge
from synth.analysis.precondition import Conditioned, conditioned
from synth.errors import InfeasibleError, NumericalError, SynthError
from synth.synthesis.affineloop import AffineLoop
from synth.synthesis.direct import Goal, descents
from synth.synthesis.h2 import h2syn
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.specifications import H2, MET, Disc, Hinf, Norm
from synth.synthesis.tasks import DIRECT, Found, Task, Told, name_of
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
REGULAR = 1e-2  # part of its size that u costs and y is noisy, in the design that stabilises
LOCAL = "a local minimum, found by descent"
ALONE = "the best controller for the minimised norm meets all"
FAILS = (SynthError, np.linalg.LinAlgError)


def mapped(task: Task) -> tuple[Conditioned, Any, Disc | None]:
    """The plant in discrete time and good coordinates, the way back for controllers, and the disc there."""
    if task.plant.dt:
        return conditioned(task.plant), lambda K: K, task.disc
    rate = design_rate(task.plant)
    disc = task.disc.moved(rate) if task.disc else None
    discrete, back = discretised(task.plant, rate)
    return conditioned(discrete), back, disc


def regular(P: GeneralizedPlant) -> GeneralizedPlant:
    """The plant with every u in z and a noise on every y besides."""
    _, nw, nu, nz, ny = P.sizes
    u, y = (REGULAR * max(float(np.linalg.norm(M, 2)), 1.0) for M in (P.D12, P.D21))
    return GeneralizedPlant(
        P.A, np.hstack([P.B1, np.zeros((len(P.A), ny))]), P.B2, np.vstack([P.C1, np.zeros((nu, len(P.A)))]),
        np.zeros((nz + nu, nw + ny)), np.vstack([P.D12, u * np.eye(nu)]), P.C2, np.hstack([P.D21, y * np.eye(ny)]),
        P.D22, dt=P.dt,
    )  # fmt: skip


@dataclass
class Search:
    """The scales of the specifications, and the controllers that were found."""

    task: Task
    scaled: Conditioned
    back: Any
    disc: Disc | None  # of the discrete plant
    failures: dict[str, str] = field(default_factory=dict)
    reached: list[float] = field(default_factory=list)  # factors by which bounds had to be relaxed in descents
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
                    f"{name_of(bound.norm, task.plant)} <= {bound.level:.7g} was not met: {alone[0]:.7g} is the least "
                    f"that the solver claims possible {without}, which is no proof",
                    best=alone[0],
                )
        if self.alone[0] and not (task.proper and self.alone[0][1].D.any()):
            found = self.judged("alone", self.alone[0][1], None, ALONE, 1.0)
            if found:
                return found
        if task.method == DIRECT and (found := self.descended(self.starts(), None)):
            return found
        best = None
        asked = task.bounds or task.disc
        for part in (RELAXED if asked else RELAXED[:1]) if task.by_lmis else ():
            found = self.relaxed(part)
            if found and (best is None or found.values[0] < best.values[0]):
                best = found
            elif best:
                break
        if best and task.method == DIRECT:
            further = self.descended([self.straight.entered(best.controller)], best.claimed)
            best = further if further and further.values[0] < best.values[0] else best
        if best is None and not asked:
            raise NumericalError(f"no attempt led to a controller that verifies: {self.missed}", self.failures)
        if best is None:
            raise self.infeasible()
        if best.claimed and best.values[0] > best.claimed * (1 + TOLD):
            self.told = f"the LMIs claim {best.claimed:.7g}, which this controller does not reach"
        return best

    def starts(self) -> Iterator[StateSpace]:
        """Controllers for `scaled.plant` to descend from: the best alone, central ones, one that merely stabilises."""
        task = self.task
        known = [alone[1] for alone in self.alone if alone]
        others: list[tuple[Norm, float | None]] = []  # best alone for the channel, or central at the level
        for bound, alone in zip(task.bounds, self.alone[1:], strict=True):
            channel = {"w": bound.norm.w, "z": bound.norm.z}
            others += [] if alone else [(H2(**channel), None), (Hinf(**channel), None)]
            others += [(bound.norm, bound.level)] if isinstance(bound.norm, Hinf) else []
        for norm, level in others:
            P = norm.channel(task.plant)
            try:
                known.append((hinfsyn(P, gamma=level) if isinstance(norm, Hinf) else h2syn(P)).controller)
            except FAILS as error:
                self.failures[f"{name_of(norm, task.plant)} alone, to start from"] = str(error)
        for K in known:
            try:
                yield self.straight.entered(K)
            except FAILS as error:
                self.failures["a controller to start from, in good units"] = str(error)
        if not task.plant.dt or not known or task.proper:
            try:
                yield h2syn(regular(self.straight.plant), strictly_proper=True).controller
            except FAILS as error:
                self.failures["a strictly proper controller that stabilises"] = str(error)

    @cached_property
    def straight(self) -> Conditioned:
        """The plant in good coordinates and its own time."""
        return self.scaled if self.task.plant.dt else self.scaled.of(self.task.plant)

    def descended(self, starts: Iterable[StateSpace], claimed: float | None) -> Found | None:
        """The best controller that descents lead to, of those that meet all."""
        task, plant, scale = self.task, self.straight.plant, self.straight.scale
        rate = 1.0 if task.plant.dt else design_rate(task.plant)
        free = task.free(plant)
        bounds = [Goal(bound.norm.barrier(plant, rate), bound.level / scale) for bound in task.bounds]
        if task.disc:
            bounds.append(Goal(task.disc.barrier, task.disc.radius))
        lowered = Goal(task.minimize.barrier(plant, rate))
        best = None
        for K in descents(lambda order: AffineLoop.of(plant, order, rate, free), starts, lowered, bounds, self.reached):
            try:
                K = self.straight.restore(K)
            except FAILS as error:
                self.failures["descent"] = self.missed = str(error)
                continue
            found = self.judged("descent", K, claimed, LOCAL, 1.0)
            best = found if found and (best is None or found.values[0] < best.values[0]) else best
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
        unknowns = standard(plant) if task.method == "standard" else extended(plant)
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
            parts.append(f"{name_of(bound.norm, task.plant)} <= {bound.level:.7g}{room}")
        if task.disc:
            parts.append(f"poles within {task.disc.radius:.7g} of {task.disc.centre:.7g}")
        more = ", or a disc that holds all modes that no control moves or no sensor sees" if task.disc else ""
        missed = f"; the last controller missed: {self.missed}" if self.missed else ""
        if self.reached:
            missed = f"; all together were met when relaxed by a factor of {min(self.reached):.4g}{missed}"
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
            f"{name_of(bound.norm, task.plant)} is {value:.7g} for {bound.level:.7g}"
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
        yield Told(name_of(task.minimize, task.plant), None, found.claimed, found.values[0], alone[0])
        for bound, value, least in zip(task.bounds, found.values[1:], alone[1:], strict=True):
            claimed = None if found.claimed is None else found.part * bound.level
            yield Told(name_of(bound.norm, task.plant), bound.level, claimed, value, least)
        if task.disc:
            farthest = task.disc.measured(found.closed_loop)
            claimed = None if found.claimed is None else found.part * task.disc.radius
            yield Told(f"poles about {task.disc.centre:.7g}", task.disc.radius, claimed, farthest, None)
