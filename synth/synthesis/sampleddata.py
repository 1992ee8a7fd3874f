"""`sdhinfsyn`: the discrete controller of a continuous plant that is best at all times, not at the samples only.

At a level the plant over a period is a discrete plant (`equations/lifting.py`), for which `hinfsyn` finds a controller.
The norm that it has, measured between the samples, is the next level: no controller for a level has more than that
level, so they fall, in ever smaller steps. In the end the level below, by the tolerance, is asked for as well.

Reference: Bamieh and Pearson (1992), IEEE TAC 37, 418; Chen and Francis (1995), Optimal Sampled-Data Control Systems,
chapter 13.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from synth.analysis.norms import verify
from synth.analysis.sampleddata import TOLERANCE as FINEST
from synth.analysis.sampleddata import SampledNorm, bounds, lifted
from synth.checks import as_number, numerical
from synth.equations.lifting import Lifting
from synth.errors import NumericalError, SynthError
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import TOLERANCE, as_plant, hinfsyn, slowest_pole
from synth.synthesis.info import SAMPLED
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace
from synth.threads import one_thread

ROUNDS = 12  # of the level; three to five are used
FINER = 0.1  # of the tolerance: how near the bounds of a norm are


@one_thread
@numerical
def sdhinfsyn(
    P: Any,
    h: float,
    nmeas: int | None = None,
    ncon: int | None = None,
    *,
    delay: float = 0.0,
    held: Any = None,
    tol: float = TOLERANCE,
) -> Design:
    """Discrete controller K that minimises the H-infinity norm of continuous P closed by sampler, K and hold.

    Parameters
    ----------
    P : continuous GeneralizedPlant, or a system in any form that `system` takes, whose last inputs are u and last
        outputs y; D11 and D22 may be nonzero. A w that reaches a sampler directly (D21) is constant over a period, as
        noise of a sample and a reference that a computer gives are; the others are any signals
    h : sampling time in s
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant
    delay : s from the sample to the new value of the hold, from 0 to h, as the processor takes it: exact
    held : names or numbers of more w that are constant over a period, of those that reach no sampler directly
    tol : relative distance from the optimum that the controller must reach; where it does not, `info.status` says so

    Returns
    -------
    Design : unpacks as K, CL, gamma, info. `gamma` is the upper bound of the norm between the samples that `sdhinfnorm`
        measured for this controller, `intersample` has both bounds; `plant` and `closed_loop` are those of the samples,
        `plant.continuous` is P, `plant.delay` and `plant.held` are those of here. `info.optimum` is the largest level
        of which the solver says that no controller reaches it, no proof; None where it says of none.

    Raises
    ------
    ModelError, AssumptionError, NumericalError : as `hinfsyn`; P is discrete.

    Reference: Bamieh and Pearson (1992), IEEE TAC 37, 418.
    """
    started = time.perf_counter()
    plant = as_plant(P, nmeas, ncon)
    h = as_number("h", h, "the sampling time in s, positive", above=0)
    tol = as_number("tol", tol, "a relative distance from the optimum, 1e-3 for example", above=0)
    lifting = lifted(plant, h, delay, held, noisy=True)
    search = _Search(lifting, tol)
    search.run()
    K, _, design = search.best
    norm = bounds(lifting, K, FINEST)
    _, nw, nu, *_ = plant.sizes
    sampled = c2d(plant, h, delay=np.repeat([0.0, lifting.delay], [nw, nu]))
    named = [j for j in lifting.held if not plant.D21[:, j].any()]
    sampled = replace(sampled, held=tuple(plant.w[j] for j in named))
    closed_loop = sampled.close(K)
    measured = verify(closed_loop)
    slowest, why = slowest_pole(sampled, measured.poles)
    info = replace(
        design.info,
        method=SAMPLED,
        status="; ".join((f"{design.info.method!r} for the samples, {search.rounds} rounds", *search.told)),
        level=search.level,
        optimum=search.lower or None,
        spectral_radius=measured.spectral_radius,
        slowest=slowest,
        frequency=norm.frequency,
        seconds=time.perf_counter() - started,
        warnings=(*search.told, *why),
    )
    return Design(sampled, K, closed_loop, norm.upper, info)


class _Search:
    """Levels and the controllers that were designed for them."""

    def __init__(self, lifting: Lifting, tol: float):
        self.lifting, self.tol = lifting, tol
        self.best: tuple[StateSpace, SampledNorm, Design]
        self.level, self.lower, self.rounds = np.inf, 0.0, 0
        self.told: tuple[str, ...] = ()

    def run(self) -> None:
        """Fall until the level below the best norm, by the tolerance, is not reached."""
        start, _ = self.lifting.at(self.lifting.wide) or (None, None)
        if start is None:
            raise NumericalError("the numbers of the plant are too far apart for doubles; choose other units")
        self.attempt(_scaled(start, np.sqrt(self.lifting.wide)), np.inf)
        while self.rounds < ROUNDS:
            before = self.best[1].upper
            if before == 0 or self.lower >= before * (1 - self.tol):
                return
            self.at(before)
            if self.best[1].upper > before * (1 - self.tol) and not self.at(before * (1 - self.tol)):
                return
        self.told = (f"the norm still fell after {ROUNDS} rounds",)

    def at(self, level: float) -> bool:
        """Design for a level; whether that led to a better controller."""
        found = self.lifting.at(level)
        before = self.best[1].upper
        if found is None:  # no controller changes what happens within a period
            self.lower = max(self.lower, level)
            return False
        try:
            claimed = self.attempt(found[0], level)
        except SynthError as error:
            self.told = (f"the level {level:.7g} could not be decided: {error}",)
            return False
        if claimed > 1:
            self.lower = max(self.lower, level)
        elif self.best[1].upper >= before and level < before:
            self.told = (f"the solver claims that {level:.7g} can be reached, and was not believed",)
        return self.best[1].upper < before

    def attempt(self, plant: GeneralizedPlant, level: float) -> float:
        """A controller for the plant of a level, measured between the samples; returns the optimum that is claimed."""
        self.rounds += 1
        design = hinfsyn(plant, tol=self.tol)
        norm = bounds(self.lifting, design.controller, FINER * self.tol)
        if not hasattr(self, "best") or norm.upper < self.best[1].upper:
            self.best, self.level = (design.controller, norm, design), level
        return design.gamma if design.info.optimum is None else design.info.optimum


def _scaled(P: GeneralizedPlant, factor: float) -> GeneralizedPlant:
    """The plant with w and z in other units, each by the factor."""
    return replace(P, B1=P.B1 * factor, C1=P.C1 * factor, D11=P.D11 * factor**2, D12=P.D12 * factor, D21=P.D21 * factor)
