"""The search for a controller: attempts by several routes and at several rates, every controller measured.

What a route says is its optimum is a claim. A claim is believed when the Riccati equations are certain of it or when
two attempts agree, and when a controller was measured to come within the tolerance. As long as that is not so the
next attempt is made; the controller with the smallest measured norm is kept, and what contradicts it is told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import chain, islice
from typing import ClassVar, NamedTuple, Protocol

import numpy as np

from synth.analysis.norms import Verification, judge
from synth.analysis.precondition import Conditioned, conditioned
from synth.equations.hinf_riccati import RiccatiRoute
from synth.errors import ModelError, SynthError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import design_rate, discretised, inverse_cayley
from synth.systems.statespace import StateSpace

LARGEST_LMI = 20  # plant order up to which "auto" asks the LMIs for a second opinion
RATES = (0.1, 10.0, 0.01, 100.0, 1e-3)  # parts of the natural rate, at the fast end of the loop, that are tried in turn
FEW = 2  # of them before the LMIs are asked, and for the LMIs themselves, which are slow
SAME = 3.0  # factor within which two rates are one
FAILS = (SynthError, np.linalg.LinAlgError)  # how an attempt ends that comes to nothing
NOTHING, LITTLE = 1e-6, 1e-3  # parts of the LQG loop's level: an optimum that counts as zero, a norm that is near it


class Route(Protocol):
    """One method on a conditioned plant."""

    solver: ClassVar[str]
    tolerance: ClassVar[float]  # relative, of that solver
    backoff: ClassVar[tuple[float, ...]]  # relative distances from the optimum at which to ask for controllers, in turn

    def minimise(self) -> tuple[float, str]:
        """The lowest level the method believes possible, and the solver's word on it."""
        ...

    def controllers(self, level: float) -> Iterator[StateSpace]:
        """Controllers that should reach `level`."""
        ...


class Claim(NamedTuple):
    """What a route says of the optimum."""

    level: float  # of the plant as it was given
    scaled: float  # of the conditioned plant, whose LQG loop has the level one
    method: str
    status: str
    certain: bool


@dataclass(frozen=True)
class Candidate:
    """A controller in the plant's own coordinates that the judge has measured."""

    controller: StateSpace
    closed_loop: StateSpace
    measured: Verification
    level: float  # the level it was designed for
    method: str
    status: str  # of the route
    solver: str
    tolerance: float


@dataclass
class Search:
    """One plant, whose assumptions were checked, and what was found out about it."""

    plant: GeneralizedPlant
    tol: float  # relative distance from the optimum
    make_route: Callable[[str, GeneralizedPlant], Route]
    claims: list[Claim] = field(default_factory=list)
    best: Candidate | None = None
    failures: dict[str, str] = field(default_factory=dict)
    _maps: dict[float | None, tuple[Conditioned, Callable[[StateSpace], StateSpace]]] = field(default_factory=dict)

    def optimise(self, method: str) -> None:
        """Attempt after attempt, until one is believed or none is left."""
        if method not in ("auto", "riccati"):
            self.cross_check()
        for name, rate in self.attempts(method):
            self.attempt(name, rate)
            if self.settled:
                return

    def attempts(self, method: str) -> Iterator[tuple[str, float | None]]:
        """Methods and rates in the order in which they are tried; None stands for the natural rate."""
        first = "riccati" if method == "auto" else method
        others = ((first, rate) for rate in self.rates())
        if first != "riccati":
            return chain([(first, None)], islice(others, FEW))
        second = [("lmi", None)] if method == "auto" and len(self.plant.A) <= LARGEST_LMI else []
        return chain([(first, None)], islice(others, FEW), second, others)

    def rates(self) -> Iterator[float]:
        """Other rates, rad/s, for when the natural one does not do."""
        factors = RATES
        if self.plant.dt > 0:  # which is used as it is, at 2/dt
            try:
                G, (_, _, nu, _, ny) = self.plant.system, self.plant.sizes
                natural = design_rate(GeneralizedPlant.partition(inverse_cayley(G, 2 / G.dt), ny, nu))
            except ModelError:  # a pole at -1
                return
            factors = (1.0, *RATES)
        else:
            natural = design_rate(self.plant)
        for factor in factors:
            rate = natural * factor
            if not self.plant.dt or abs(np.log(rate * self.plant.dt / 2)) > np.log(SAME):
                yield rate

    @property
    def settled(self) -> bool:
        """True when the best controller is within `tol` of an optimum that is believed, or the optimum is zero.

        Believed is what the Riccati equations are certain of, or what two attempts agree on.
        """
        if self.best is None:
            return False
        if any(claim.scaled < NOTHING and self.reached * claim.scaled < LITTLE * claim.level for claim in self.claims):
            return True
        agreeing = self.agreeing
        if any(claim.certain and claim not in agreeing and claim.level < self.reached for claim in self.claims):
            return False
        return len(agreeing) > 1 or any(claim.certain for claim in agreeing)

    def refute(self, lower: float) -> None:
        """Drop the claims below a level that no controller reaches; near the best norm it is the optimum itself."""
        for claim in self.claims:
            if claim.level < lower:
                self.failures[f"{claim.method}, optimum {claim.level:.7g}"] = (
                    f"false: none goes below {lower:.7g}, proved"
                )
        self.claims = [claim for claim in self.claims if claim.level >= lower]
        if lower > 0 and self.reached <= (1 + self.tol) * lower:
            self.claims.append(Claim(lower, 1.0, "proof", "proved in ball arithmetic", certain=True))

    @property
    def reached(self) -> float:
        """The norm of the best controller without what rounding may hide, which no other attempt would lessen."""
        return np.inf if self.best is None else self.best.measured.norm - self.best.measured.rounding

    @property
    def agreeing(self) -> list[Claim]:
        """The claims that the best controller comes within `tol` of, from above or from below."""
        return [c for c in self.claims if c.level / (1 + self.tol) <= self.reached <= (1 + self.tol) * c.level]

    @property
    def optimum(self) -> float | None:
        """The lowest believed level, or where none is the lowest claim; a controller that goes lower is lower."""
        believed = self.agreeing if self.settled and self.agreeing else self.claims
        levels = [claim.level for claim in believed]
        return min([*levels, self.best.measured.norm] if self.best else levels) if levels else None

    def at(self, rate: float | None) -> tuple[Conditioned, Callable[[StateSpace], StateSpace]]:
        """The plant in discrete time and good coordinates, and the way back from there for controllers."""
        if rate not in self._maps:
            discrete, to_plant = discretised(self.plant, rate)
            self._maps[rate] = conditioned(discrete), to_plant
        return self._maps[rate]

    def route(self, method: str, rate: float | None) -> tuple[Route, float]:
        """A route, and the level of the plant over that of the conditioned one."""
        c, _ = self.at(rate)
        return self.make_route(method, c.plant), c.scale

    def cross_check(self) -> None:
        """Let the Riccati equations say what they think the optimum is."""
        try:
            self._claimed("riccati", *self.route("riccati", None))
        except FAILS as error:
            self.failures["riccati, as the cross-check"] = str(error)

    def attempt(self, method: str, rate: float | None) -> None:
        """Ask a route for its optimum, and for controllers ever farther from it until one keeps its level."""
        name = method if rate is None else f"{method} at {rate:.3g} rad/s"
        try:
            route, scale = self.route(method, rate)
            optimum, status = self._claimed(method, route, scale)
        except FAILS as error:
            self.failures[name] = str(error)
            return
        levels = [optimum * (1 + distance) for distance in sorted({min(self.tol, *route.backoff), *route.backoff})]
        for level, following in zip(levels, [*levels[1:], np.inf], strict=True):
            found = self.controllers(name, method, route, rate, level, status)
            if found is not None and found.measured.norm - found.measured.rounding <= max(
                found.level, min(following, 2 * level) * scale
            ):
                return

    def _claimed(self, method: str, route: Route, scale: float) -> tuple[float, str]:
        optimum, status = route.minimise()
        certain = isinstance(route, RiccatiRoute) and route.certain(optimum)
        self.claims.append(Claim(optimum * scale, optimum, method, status, certain))
        return optimum, status

    def reach(self, method: str, rate: float | None, gamma: float) -> Candidate | None:
        """A controller with a measured norm of at most gamma."""
        try:
            route, scale = self.route(method, rate)
        except FAILS as error:
            self.failures[method] = str(error)
            return None
        found = self.controllers(method, method, route, rate, gamma / scale, "level given")
        if found is None:
            return None
        if found.measured.norm > gamma:
            self.failures[method] = f"best verified norm {found.measured.norm:.6g} for a level of {gamma:.6g}"
            return None
        return found

    def controllers(
        self, name: str, method: str, route: Route, rate: float | None, level: float, status: str
    ) -> Candidate | None:
        """The best of a route's controllers for a scaled level, the first that keeps it; all are measured."""
        c, to_plant = self.at(rate)
        best = None
        label = f"{name}, level {level * c.scale:.9g}"
        try:
            for K in route.controllers(level):
                try:
                    controller = to_plant(c.restore(K))
                    closed_loop, measured = judge(self.plant, controller)
                except FAILS as error:
                    self.failures[label] = str(error)
                    continue
                found = Candidate(
                    controller, closed_loop, measured, level * c.scale, method, status, route.solver, route.tolerance
                )
                best = found if best is None or measured.norm < best.measured.norm else best
                if measured.norm <= found.level:
                    break
        except FAILS as error:
            self.failures[label] = str(error)
        if best is None:
            self.failures.setdefault(label, "no controller came of it")
        if best is not None and (self.best is None or best.measured.norm < self.best.measured.norm):
            self.best = best
        return best

    def warnings(self) -> Iterator[str]:
        """What a user must know of the best controller and its claims."""
        if self.best is None or not self.claims:
            return
        rounding, lowest = self.best.measured.rounding, min(self.claims)
        if rounding > self.tol * self.best.measured.norm:
            part = rounding / self.best.measured.norm
            yield f"the loop is ill-conditioned: {part:.2g} of its norm is what rounding may hide"
        if lowest.scaled < NOTHING:
            yield (
                "the optimum is zero, or so small that it is not attained: gains grow without bound as the level "
                f"falls; the norm of this controller is {self.best.measured.norm:.4g}: ask for a level with gamma="
            )
        elif self.reached > (1 + self.tol) * lowest.level and not self.settled:
            yield (
                f"{lowest.method!r} claims an optimum of {lowest.level:.7g}; this controller is "
                f"{self.reached / lowest.level - 1:.2g} above it"
            )

    def contradictions(self) -> Iterator[str]:
        """Claims that are not believed, for the status."""
        if self.best is None:
            return
        for method in dict.fromkeys(claim.method for claim in self.claims):
            claim = min(claim for claim in self.claims if claim.method == method)
            if claim.level > (1 + self.tol) * self.reached:
                yield f"the optimum {claim.level:.7g} of {method!r} was none: it was undercut"
            elif claim.level < self.reached / (1 + self.tol) and self.settled and claim.scaled >= NOTHING:
                yield f"an optimum of {claim.level:.7g}, claimed by {method!r}, was not confirmed"
