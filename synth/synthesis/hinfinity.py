"""H-infinity output-feedback synthesis: precondition, solve, recover, verify; `search.py` has the order of attempts.

Methods
-------
    "riccati"   game Riccati equations by doubling    equations/hinf_riccati.py
    "lmi"       controller eliminated, (R, S) only    lmi/eliminate.py
    "standard"  seed LMI (20)                         lmi/loops.py, lmi/hinf.py
    "extended"  seed LMI (16), multiplier free        lmi/loops.py, lmi/hinf.py
    "auto"      "riccati"; where that is not certain also at other rates, and "lmi" up to order 20

Continuous plants go through the Cayley map, which preserves the norm. A plant without states has an answer in closed
form (`static.py`), whatever the method asked for. Nothing unverified is returned.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from synth.analysis.precondition import check_assumptions
from synth.checks import as_choice, as_number, as_whole, numerical
from synth.equations.hinf_riccati import RiccatiRoute
from synth.errors import InfeasibleError, ModelError, NumericalError, SynthError
from synth.files import provenance
from synth.synthesis.design import Design, Info
from synth.synthesis.search import LARGEST_LMI, Candidate, Route, Search
from synth.synthesis.static import static
from synth.systems.generalized import GeneralizedPlant
from synth.threads import one_thread

STUCK = 1e-5  # of the median decay: what is slower was not placed on purpose
ADDED = 1e-3  # likewise, where the equations were regularised, which moves what nothing else moves
METHODS = ("auto", "riccati", "lmi", "standard", "extended")
PROVABLE = 50  # states up to which an InfeasibleError comes with a proof, which takes about as long as the design
BITS = 128  # of that proof
TOLERANCE = 1e-3  # relative distance from the optimum that the controller must reach


@one_thread
@numerical
def hinfsyn(
    P: Any,
    nmeas: int | None = None,
    ncon: int | None = None,
    *,
    method: str = "auto",
    gamma: float | None = None,
    tol: float = TOLERANCE,
    ncont: int | None = None,
) -> Design:
    """Controller K that minimises the H-infinity norm of P closed by u = K y (positive feedback).

    Parameters
    ----------
    P : GeneralizedPlant, or a system in any form that `system` takes, whose last inputs are u and last outputs y;
        discrete or continuous; D11 and D22 may be nonzero; without states K is a gain, `info.method` is "parrott"
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant; `ncont` is MATLAB's name
    method : "auto", "riccati", "lmi", "standard" or "extended"
    gamma : a level to reach instead of the optimum; the LMI methods then return the analytic centre of what does
    tol : relative distance from the optimum that the controller must reach; where it does not, `info.status` says so

    Returns
    -------
    Design : unpacks as K, CL, gamma, info. `gamma` is the verified norm of this controller: what the closed loop was
        measured to have by two independent methods. `info.optimum` is the solver's claim of what is possible, no proof
        (`design.certify()` proves both bounds), `info.method` says which method answered, `info.warnings` what to know.

    Raises
    ------
    ModelError : data that is no model: NaN, wrong shapes, an unspecified timebase.
    AssumptionError : (A, B2) is not stabilisable or (A, C2) not detectable; names the mode.
    InfeasibleError : `gamma` was not reached; carries the best level that was, and the proved lower bound.
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
    tol = as_number("tol", tol, "a relative distance from the optimum, 1e-3 for example", above=0)
    if gamma is not None:
        gamma = as_number("gamma", gamma, "a positive level, or None for the optimum", above=0)
    if not len(plant.A):
        return static(plant, gamma, tol, started)
    check_assumptions(plant)
    search = Search(plant, tol, make_route)
    if gamma is not None:
        both = ("riccati", "lmi") if len(plant.A) <= LARGEST_LMI else ("riccati",)
        for name in both if method == "auto" else (method,):
            found = search.reach(name, None, gamma)
            if found is not None:
                return finished(search, found, started)
    search.optimise(method)
    if search.best is not None and not search.settled:
        search.refute(proved_lower(plant, search.best.measured.norm))
    best = search.best
    if best is None:
        latest = {name.split(",")[0]: reason for name, reason in search.failures.items()}
        reasons = "; ".join(f"{name}: {reason}" for name, reason in latest.items())
        raise NumericalError(f"no method found a controller that verifies: {reasons}", search.failures)
    if gamma is not None and best.measured.norm > gamma:
        raise not_reached(search, best, gamma)
    return finished(search, best, started)


def finished(search: Search, found: Candidate, started: float) -> Design:
    """The design of a controller that was measured."""
    plant, measured = search.plant, found.measured
    versions, date = provenance(*(() if found.solver == "doubling" else ("cvxpy", "clarabel")))
    told = tuple(search.warnings()) if found is search.best else ()
    contradicted = tuple(search.contradictions()) if found is search.best else ()
    slowest, why = slowest_pole(plant, measured.poles, ADDED if "regularised" in found.status else STUCK)
    info = Info(
        method=found.method,
        status="; ".join((found.status, *told, *contradicted)),
        level=found.level,
        optimum=search.optimum,
        spectral_radius=measured.spectral_radius,
        slowest=slowest,
        frequency=measured.frequency,
        seconds=time.perf_counter() - started,
        solver=found.solver,
        tolerance=found.tolerance,
        warnings=(*told, *why),
        failures=dict(search.failures),
        versions=versions,
        date=date,
    )
    return Design(plant, found.controller, found.closed_loop, measured.norm, info)


def not_reached(search: Search, best: Candidate, gamma: float) -> InfeasibleError:
    """The error for a level that was asked for and not reached, with what is proved about it."""
    norm = best.measured.norm
    lower = proved_lower(search.plant, norm)
    best_so_far = f"the best verified level is {norm:.7g} (by {best.method!r})"
    if lower >= gamma:
        text = f"gamma = {gamma:.7g} cannot be reached: no controller goes below {lower:.7g}, which is proved"
        return InfeasibleError(f"{text}; {best_so_far}", best=norm, lower=lower)
    proved = f"proved impossible is only what is below {lower:.7g}" if lower else "nothing is proved impossible"
    return InfeasibleError(f"gamma = {gamma:.7g} was not reached: {best_so_far}, {proved}", best=norm, lower=lower)


def proved_lower(plant: GeneralizedPlant, norm: float) -> float:
    """A level that no controller reaches, near a norm that was reached; 0 where none is proved."""
    if len(plant.A) > PROVABLE:
        return 0.0
    from synth.proof.lower import find_lower

    try:
        found, _ = find_lower(plant, norm, None, BITS)
    except (SynthError, np.linalg.LinAlgError):  # then nothing is proved
        return 0.0
    return found[0] if found else 0.0


def slowest_pole(plant: GeneralizedPlant, poles: np.ndarray, part: float = STUCK) -> tuple[float, tuple[str, ...]]:
    """The slowest decay of the loop in rad/s, and a warning where the design hardly moved it off the boundary."""
    own, loop = _decays(plant.system.poles(), plant.dt), _decays(poles, plant.dt)
    slowest = float(loop.min(initial=np.inf))
    slow = part * float(np.median(loop)) if loop.size else 0.0
    inherited = np.any((own > 0) & (np.abs(own - slowest) <= 0.5 * slowest))  # as of a slow weight
    if slowest > slow or inherited or not np.any(own < slow):
        return slowest, ()
    return slowest, (
        f"a pole of the loop decays at {slowest:.2g} rad/s only, half in {np.log(2) / slowest:.2g} s: nothing in z "
        "asks for more, and rounding placed it; weigh the state behind it, or take it out of the model",
    )


def _decays(poles: np.ndarray, dt: float) -> np.ndarray:
    """Rates at which modes decay, rad/s."""
    return -np.log(np.maximum(np.abs(poles), 1e-300)) / dt if dt else -np.real(poles)


def as_plant(P: Any, nmeas: int | None, ncon: int | None) -> GeneralizedPlant:
    """Any accepted description as a GeneralizedPlant."""
    if not isinstance(P, GeneralizedPlant):
        if nmeas is None or ncon is None:
            raise ModelError(f"nmeas = {nmeas}, ncon = {ncon}; both are needed to split a plain system into w, u, z, y")
        P = GeneralizedPlant.partition(P, nmeas, ncon)
    _, _, nu, _, ny = P.sizes
    if nmeas not in (None, ny) or ncon not in (None, nu):
        raise ModelError(f"nmeas = {nmeas}, ncon = {ncon} contradict the plant's {ny} measurements and {nu} controls")
    return P


def make_route(name: str, plant: GeneralizedPlant) -> Route:
    """The method of that name on a conditioned plant; CVXPY is imported here, when it is needed.

    Raises
    ------
    NumericalError : CVXPY cannot be imported.
    """
    if name == "riccati":
        return RiccatiRoute.of(plant)
    try:
        from synth.lmi.eliminate import Eliminated
        from synth.lmi.hinf import FullOrder
        from synth.lmi.loops import extended, standard
    except ImportError as error:
        raise NumericalError(f"method {name!r} needs CVXPY, which is not installed as it should be: {error}") from error
    if name == "lmi":
        return Eliminated.of(plant)

    return FullOrder(extended(plant) if name == "extended" else standard(plant))
