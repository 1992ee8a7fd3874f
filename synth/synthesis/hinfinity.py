"""H-infinity output-feedback synthesis: precondition, solve, centre, recover, verify.

Methods
-------
    "extended"  seed LMI (16), multiplier free        lmi/loops.py, lmi/hinf.py
    "standard"  seed LMI (20)                         lmi/loops.py, lmi/hinf.py
    "lmi"       controller eliminated, (R, S) only    lmi/eliminate.py
    "riccati"   game Riccati equations by doubling    hinf_riccati.py
    "auto"      "lmi" up to order 20 and "riccati" above, the other one when verification fails

Continuous plants go through the Cayley map, which preserves the norm. Nothing unverified is returned.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Protocol

from synth.analysis.norms import Verification, verify
from synth.analysis.precondition import check_assumptions, precondition
from synth.checks import as_choice, as_number, as_whole
from synth.errors import InfeasibleError, ModelError, NumericalError, SynthError
from synth.files import provenance
from synth.synthesis.design import Design, Info
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import discretised
from synth.systems.statespace import StateSpace
from synth.threads import one_thread

METHODS = ("auto", "lmi", "riccati", "standard", "extended")
LARGEST_LMI = 20  # plant order up to which "auto" starts with the LMIs
CLOSE = 1e-3  # a norm within this of the level the controller was designed for is taken at once
CONTRADICTED = 1e-6  # a controller this much below the optimum a solver claims shows that it was none
ACCEPT = 1e-2  # a norm within this of the optimum counts as reaching it


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


@dataclass(frozen=True)
class Candidate:
    """A controller in the plant's own coordinates that the judge has measured."""

    controller: StateSpace
    closed_loop: StateSpace
    measured: Verification
    level: float  # the level it was designed for


@one_thread
def hinfsyn(
    P: Any,
    nmeas: int | None = None,
    ncon: int | None = None,
    *,
    method: str = "auto",
    gamma: float | None = None,
    ncont: int | None = None,
) -> Design:
    """Controller K that minimises the H-infinity norm of P closed by u = K y (positive feedback).

    Parameters
    ----------
    P : GeneralizedPlant, or a system in any form that `system` takes, whose last inputs are u and last outputs y;
        discrete or continuous; D11 and D22 may be nonzero
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant; `ncont` is MATLAB's name
    method : "auto", "lmi", "riccati", "standard" or "extended"
    gamma : a level to reach instead of the optimum; the LMI methods then return the analytic centre of what does

    Returns
    -------
    Design : unpacks as K, CL, gamma, info. `gamma` is the optimal level, or the one asked for, or, where the optimum
        cannot be approached, the level that was; `verified_norm` <= 1.01 gamma is what the closed loop was measured
        to have; `info.method` says which method answered.

    Raises
    ------
    ModelError : data that is no model: NaN, wrong shapes, an unspecified timebase.
    AssumptionError : (A, B2) is not stabilisable or (A, C2) not detectable; names the mode.
    InfeasibleError : `gamma` cannot be reached; carries the best level that was.
    NumericalError : every route failed; `statuses` says how each of them did.

    References
    ----------
    de Oliveira, Geromel and Bernussou (2002), Int. J. Control 75, 666; Gahinet and Apkarian (1994), Int. J. Robust
    and Nonlinear Control 4, 421; Pecorilla and Stesina (2024), doi 10.1002/rnc.7119, equations (16) to (22).
    """
    started = time.perf_counter()
    for name, count in (("nmeas", nmeas), ("ncon", ncon), ("ncont", ncont)):
        if count is not None:
            as_whole(name, count, "the number of signals, at least 1", least=1)
    if None not in (ncon, ncont) and ncon != ncont:
        raise ModelError(f"ncon = {ncon} and ncont = {ncont} are two names of one number; pass one of them")
    plant = as_plant(P, nmeas, ncont if ncon is None else ncon)
    as_choice("method", method, METHODS)
    if gamma is not None:
        gamma = as_number("gamma", gamma, "a positive level, or None for the optimum", above=0)
    check_assumptions(plant)
    discrete, to_plant = discretised(plant)
    conditioned = precondition(discrete)
    scale = conditioned.scale

    def judged(K: StateSpace, level: float) -> Candidate:
        controller = to_plant(conditioned.restore(K))
        closed_loop = plant.close(controller)
        return Candidate(controller, closed_loop, verify(closed_loop), level)

    failures: dict[str, str] = {}
    best: Design | None = None
    for name in order_of_routes(method, plant.sizes[0]):
        try:
            route = make_route(name, conditioned.plant)
            optimum, status = (gamma / scale, "level given") if gamma else route.minimise()
        except NumericalError as error:
            failures[name] = str(error)
            continue
        levels = [optimum] if gamma else [optimum * (1 + delta) for delta in route.backoff]
        found = best_of(route, levels, lambda K, g: judged(K, g * scale), failures)
        if found is None:
            continue
        norm, claim = found.measured.norm, optimum * scale
        if gamma and norm > gamma:
            failures[name] = f"best verified norm {norm:.6g} for a level of {gamma:.6g}"
            continue
        reached = claim if norm <= (1 + ACCEPT) * claim else norm
        versions, date = provenance("cvxpy", "clarabel")
        info = Info(
            method=name,
            status=status,
            level=found.level,
            spectral_radius=found.measured.spectral_radius,
            frequency=found.measured.frequency,
            seconds=time.perf_counter() - started,
            solver=route.solver,
            tolerance=route.tolerance,
            failures=failures,
            versions=versions,
            date=date,
        )
        design = Design(plant, found.controller, found.closed_loop, gamma or min(reached, norm), norm, info)
        if best is None or norm < best.verified_norm:
            best = design
        if gamma or norm >= claim * (1 - CONTRADICTED):
            break
        # the "optimum" was undercut, so it was none: ask the next route as well, keep the better design
        failures[name] = f"the solver's optimum {claim:.7g} was undercut by a controller that reaches {norm:.7g}"
    if best is not None:
        return best
    if gamma is not None:
        return suboptimal(plant, method, gamma)
    reasons = "; ".join(f"{name}: {reason}" for name, reason in failures.items())
    raise NumericalError(f"no method found a controller that verifies: {reasons}", failures)


def best_of(
    route: Route,
    levels: list[float],
    judged: Callable[[StateSpace, float], Candidate],
    failures: dict[str, str],
) -> Candidate | None:
    """The controller with the smallest verified norm, once one has kept its claim; None when none did.

    A claim is kept when the norm is at the level the controller was designed for or, after all levels were tried,
    near it.
    """
    best: Candidate | None = None
    for level in levels:
        try:
            for K in route.controllers(level):
                try:
                    found = judged(K, level)
                except SynthError as error:
                    failures[f"attempt {len(failures) + 1}, level {level:.9g}"] = str(error)
                    continue
                if best is None or found.measured.norm < best.measured.norm:
                    best = found
                if found.measured.norm <= (1 + CLOSE) * found.level:
                    return best
        except (NumericalError, InfeasibleError) as error:
            failures[f"attempt {len(failures) + 1}, level {level:.9g}"] = str(error)
    return best if best is not None and best.measured.norm <= (1 + ACCEPT) * best.level else None


def suboptimal(plant: GeneralizedPlant, method: str, gamma: float) -> Design:
    """The optimal design where it is below `gamma`, an InfeasibleError where it is not."""
    best = hinfsyn(plant, method=method)
    if best.verified_norm <= gamma:
        return replace(best, gamma=gamma)
    raise InfeasibleError(
        f"gamma = {gamma:.7g} cannot be reached; the best verified level is {best.verified_norm:.7g} "
        f"(optimum {best.gamma:.7g} by {best.info.method!r})",
        best=best.verified_norm,
    )


def as_plant(P: Any, nmeas: int | None, ncon: int | None) -> GeneralizedPlant:
    """Any accepted description as a GeneralizedPlant with at least one state."""
    if not isinstance(P, GeneralizedPlant):
        if nmeas is None or ncon is None:
            raise ModelError(f"nmeas = {nmeas}, ncon = {ncon}; both are needed to split a plain system into w, u, z, y")
        P = GeneralizedPlant.partition(P, nmeas, ncon)
    n, _, nu, _, ny = P.sizes
    if nmeas not in (None, ny) or ncon not in (None, nu):
        raise ModelError(f"nmeas = {nmeas}, ncon = {ncon} contradict the plant's {ny} measurements and {nu} controls")
    if n == 0:
        raise ModelError("the plant P has no states (A is empty); add the dynamics to be controlled")
    return P


def order_of_routes(method: str, n: int) -> tuple[str, ...]:
    """The methods to try, in order, for a plant of order `n`."""
    if method != "auto":
        return (method,)
    return ("lmi", "riccati") if n <= LARGEST_LMI else ("riccati", "lmi")


def make_route(name: str, plant: GeneralizedPlant) -> Route:
    """The method of that name on a conditioned plant; CVXPY is imported here, when it is needed."""
    if name == "riccati":
        from synth.equations.hinf_riccati import RiccatiRoute

        return RiccatiRoute.of(plant)
    if name == "lmi":
        from synth.lmi.eliminate import Eliminated

        return Eliminated.of(plant)
    from synth.lmi.hinf import FullOrder
    from synth.lmi.loops import extended, standard

    return FullOrder(extended(plant) if name == "extended" else standard(plant))
