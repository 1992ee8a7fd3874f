"""Loop shaping with normalised coprime factors (Glover and McFarlane): shape, robustify, verify.

    Gs = W2 G W1 is the shaped plant, us = Ks ys its controller (positive feedback), u = W1 Ks W2 y that of G.

Ks is an observer of the shaped plant with a state feedback, nu being what it did not expect of the measurement:

    nu = ys - C x - D us,  x+ = A x + B us - H nu  (x+ stands for dx/dt in continuous time)

    Xg = [(1 - g^-2) I - g^-2 X Z]^-1 X,  R = I + D D',  S = I + D'D
    continuous   H = -(B D' + Z C') R^-1,              us = -B'Xg x - D'ys
    discrete     H = -(B D' + A Z C') (R + C Z C')^-1,
                 [S + B'Xg B] us = -(D'C + B'Xg A) x - (D' - B'Xg H) nu

Without states the optimal level is 1, and Ks = -D' reaches it: [I; -D'] R^-1 [I, D] is a projection.

The optimal level is sqrt(1 + rho(X Z)), or that of one semidefinite program (`lmi/coprime.py`); each checks the
other. The gains rest on X and Z in either case. What leaves is stable and was measured to keep its level.

References: McFarlane and Glover (1992), IEEE TAC 37, 759; Glover and McFarlane (1989), IEEE TAC 34, 821; Skogestad
and Postlethwaite (2005), Multivariable Feedback Control, section 9.4.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np

from synth.analysis.coprime import Solutions, balanced, gang_of_four, solutions
from synth.analysis.norms import in_principal_axes, judge
from synth.analysis.precondition import check_assumptions
from synth.checks import as_choice, as_number, numerical
from synth.equations.doubling import FINAL_RESIDUAL
from synth.errors import InfeasibleError, ModelError, NumericalError, VerificationError
from synth.files import provenance
from synth.synthesis.design import Design, Info, Shaping
from synth.synthesis.hinfinity import slowest_pole
from synth.systems.connect import series
from synth.systems.sampled import apart, loop_moduli, on_circle
from synth.systems.statespace import StateSpace, as_system, common_timebase, repeated
from synth.threads import one_thread

METHODS = ("riccati", "lmi")
AGREE = 1e-3  # relative difference of the two optimal levels beyond which the semidefinite program is not believed
INSIDE = 1e-6  # the controller for a level is made for one lower by this part, or half way to the optimum if nearer


class Optimum(NamedTuple):
    """The optimal level, and who says so."""

    gamma: float
    method: str
    status: str
    failures: dict[str, str]


@one_thread
@numerical
def ncfsyn(
    G: Any,
    W1: Any = None,
    W2: Any = None,
    *,
    gamma_factor: float = 1.1,
    gamma: float | None = None,
    method: str = "riccati",
) -> Design:
    """Controller u = W1 Ks W2 y (positive feedback) that robustly stabilises the shaped plant W2 G W1.

    For a loop closed on e = r - y design for the plant from u to e, that is, for -G.

    Parameters
    ----------
    G : (p x m) plant, in any form that `system` takes; continuous or discrete, D may be nonzero
    W1 : weight in front of the plant, m outputs: a system in any of these forms, one of a single signal for every
        channel; identity when left out
    W2 : weight behind the plant, p inputs; likewise
    gamma_factor : the level asked for, over the optimal one; above 1
    gamma : the level itself, instead of `gamma_factor`
    method : "riccati" or "lmi", what finds the optimal level. `info.method` says which one was believed: where they
        differ by more than 1e-3 it is the Riccati equations, and `info.warnings` says so

    Returns
    -------
    Design : `controller` is W1 Ks W2, `shaping` holds W1, W2 and Ks; `plant` is the four-block problem
        [I; Ks] (I - Gs Ks)^-1 [I, Gs] that Ks closes, Gs in balanced coordinates; `info.level` is the level asked
        for, `gamma` <= level what was measured, `info.optimum` the optimal level. 1 / gamma is the guaranteed margin
        of `ncfmargin`.

    Raises
    ------
    ModelError : data that is no model, weights that do not fit, `gamma_factor` not above 1.
    AssumptionError : the shaped plant has an unstable mode that is not reached or not seen; names it.
    InfeasibleError : `gamma` is not above the optimal level, which is in `best`.
    NumericalError : the Riccati equations were not solved.
    VerificationError : the loop does not keep the level, for example one that touches the optimal level.

    References
    ----------
    McFarlane and Glover (1992), IEEE TAC 37, 759; Skogestad and Postlethwaite (2005), section 9.4.
    """
    started = time.perf_counter()
    as_choice("method", method, METHODS)
    gamma_factor = as_number("gamma_factor", gamma_factor, "a number above 1, 1.1 for example", above=1)
    if gamma is not None:
        gamma = as_number("gamma", gamma, "a positive level, or None for gamma_factor times the optimum", above=0)
    W1, Gs, W2 = shaped(as_system("G", G), W1, W2)
    plant = gang_of_four(Gs)
    check_assumptions(plant)
    riccati = solutions(Gs)
    optimum = optimal(Gs, riccati, method)
    level, lowest = gamma or gamma_factor * optimum.gamma, max(optimum.gamma, np.sqrt(1 + riccati.coupling))
    if level <= lowest:
        raise InfeasibleError(
            f"gamma = {level:.9g} is not above the optimal level {optimum.gamma:.9g} of the shaped plant; "
            "ask for a larger one, or for less bandwidth in the weights",
            best=optimum.gamma,
        )
    Ks = observer_controller(Gs, riccati, level - min(INSIDE * level, (level - lowest) / 2))
    closed_loop, measured = judge(plant, Ks)
    if measured.norm > level:
        raise VerificationError(
            f"the controller for gamma = {level:.9g} was measured to reach {measured.norm:.9g} only (optimal level "
            f"{optimum.gamma:.9g}); ask for a larger gamma"
        )
    lmi = optimum.method == "lmi"
    told = tuple(f"{name!r} was not believed: {reason}" for name, reason in optimum.failures.items())
    versions, date = provenance(*(("cvxpy", "clarabel") if lmi else ()))
    info = Info(
        method=optimum.method,
        status="; ".join((optimum.status, *told)),
        level=level,
        optimum=optimum.gamma,
        spectral_radius=measured.spectral_radius,
        slowest=slowest_pole(plant, measured.poles)[0],
        frequency=measured.frequency,
        seconds=time.perf_counter() - started,
        solver="clarabel" if lmi else "doubling",
        tolerance=AGREE if lmi else FINAL_RESIDUAL,
        warnings=told,
        failures=optimum.failures,
        versions=versions,
        date=date,
    )
    shaping = Shaping(W1, W2, Ks)
    return Design(plant, shaping.controller, closed_loop, measured.norm, info, shaping)


def shaped(G: StateSpace, W1: Any, W2: Any) -> tuple[StateSpace, StateSpace, StateSpace]:
    """W1, the shaped plant W2 G W1 in balanced coordinates (turned too, where that halves it), and W2."""
    weights = []
    for name, W, size, side in (("W1", W1, G.nu, "outputs"), ("W2", W2, G.ny, "inputs")):
        W = repeated(as_system(name, np.eye(size) if W is None else W, G.dt), size)
        if (W.ny if side == "outputs" else W.nu) != size:
            raise ModelError(f"{name} is {W.ny} x {W.nu}; it needs {size} {side} to fit the {G.ny} x {G.nu} plant")
        common_timebase(G, W, ("the plant", name))
        weights.append(W)
    W1, W2 = weights
    return W1, in_principal_axes(series(series(W1, G), W2)), W2


def optimal(G: StateSpace, riccati: Solutions, method: str) -> Optimum:
    """The optimal level of a plant by the method asked for, by the Riccati equations where that one fails."""
    reference = float(np.sqrt(1 + riccati.coupling))
    failures: dict[str, str] = {}
    if method == "lmi" and G.n:
        from synth.lmi.coprime import optimal_level

        # the program is best conditioned in the middle of the closed-loop poles
        middle = float(np.exp(np.log(loop_moduli(G)).mean()))
        try:
            H = balanced(G, riccati)
            level, status = optimal_level(*on_circle(apart(middle, H.poles()), H))
            if abs(level - reference) <= AGREE * reference:
                return Optimum(level, "lmi", f"{status}; Riccati equations {reference:.9g}", failures)
            failures["lmi"] = f"{status}, level {level:.9g} against {reference:.9g} of the Riccati equations"
        except NumericalError as error:
            failures["lmi"] = str(error)
    return Optimum(reference, "riccati", f"residual {riccati.residual:.1e}", failures)


def observer_controller(G: StateSpace, riccati: Solutions, gamma: float) -> StateSpace:
    """Ks for a level above the optimal one; its state is the estimate of G's (see the file header)."""
    A, B, C, D = G.A, G.B, G.C, G.D
    X, Z = riccati.X, riccati.Z
    R = np.eye(G.ny) + D @ D.T
    Xg = np.linalg.solve((1 - gamma**-2) * np.eye(G.n) - gamma**-2 * X @ Z, X)
    if G.discrete:
        H = -np.linalg.solve(R + C @ Z @ C.T, (B @ D.T + A @ Z @ C.T).T).T
        # nu put into the last line of the header and solved for us
        E = np.eye(G.nu) + B.T @ Xg @ (B + H @ D)
        F, J = np.linalg.solve(E, -B.T @ Xg @ (A + H @ C)), np.linalg.solve(E, B.T @ Xg @ H - D.T)
    else:
        H = -np.linalg.solve(R, (B @ D.T + Z @ C.T).T).T
        F, J = -B.T @ Xg, -D.T
    return StateSpace(A + H @ C + (B + H @ D) @ F, (B + H @ D) @ J - H, F, J, G.dt)
