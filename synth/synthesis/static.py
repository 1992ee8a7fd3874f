"""H-infinity control of a plant without states: Parrott's theorem gives the optimum and a static controller.

    z = D11 w + D12 u,  y = D21 w + D22 u,  u = K y:   D11 + D12 Q D21,  Q = K (I - D22 K)^-1,  K = (I + Q D22)^-1 Q

Where I + Q D22 is singular, part of Q is left away: by convexity (1 - d) Q reaches (1 - d) gamma + d |D11| at least.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from synth.analysis.norms import Verification, judge
from synth.equations.parrott import RANK, direct_term, parrott
from synth.errors import InfeasibleError, NumericalError, SynthError
from synth.files import provenance
from synth.synthesis.design import Design, Info
from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import loop_solve
from synth.systems.statespace import StateSpace

ILL_POSED = 1e-9  # relative distance of I + Q D22 to singular
NOTHING = 1e-12  # of |D11|: an optimum that counts as zero
PARTS = (0.0, 0.25, 0.5, 1.0)  # of what is allowed above the optimum, given up for a loop that is well posed


def static(P: GeneralizedPlant, gamma: float | None, tol: float, started: float) -> Design:
    """The optimal design of a plant without states, or one for the level `gamma`.

    Raises
    ------
    InfeasibleError : `gamma` was not reached.
    NumericalError : every controller tried forms an algebraic loop with D22 that has no solution, or did not verify.
    """
    optimum, size = parrott(P), float(np.linalg.norm(P.D11, 2))
    level = optimum if gamma is None else max(gamma, optimum)
    allowed = (1 + tol) * optimum if gamma is None else level
    best: tuple[StateSpace, StateSpace, Verification] | None = None
    failures: dict[str, str] = {}
    for part, K in _controllers(P, level, optimum, allowed, size):
        try:
            closed_loop, measured = judge(P, K)
        except SynthError as error:
            failures[f"{part:g} of the tolerance"] = str(error)
            continue
        if best is None or measured.norm < best[2].norm:
            best = K, closed_loop, measured
        if measured.norm <= allowed or measured.norm <= NOTHING * size:
            break
    if best is None:
        reason = "; ".join(failures.values()) or "K and D22 form an algebraic loop without a solution"
        more = "" if optimum > NOTHING * size else "; the optimum of zero is not attained: ask for a level with gamma="
        raise NumericalError(f"no controller of this plant without states was found: {reason}{more}", failures)
    K, closed_loop, measured = best
    if gamma is not None and measured.norm > gamma:
        raise InfeasibleError(
            f"gamma = {gamma:.7g} was not reached: the best verified level is {measured.norm:.7g}; Parrott's theorem "
            f"gives an optimum of {optimum:.7g}, in floating point, which is no proof",
            best=measured.norm,
        )
    versions, date = provenance()
    info = Info(
        method="parrott",
        status="level given" if gamma is not None else "optimum in closed form",
        level=level,
        optimum=optimum,
        spectral_radius=measured.spectral_radius,
        slowest=np.inf,
        frequency=measured.frequency,
        seconds=time.perf_counter() - started,
        solver="singular values",
        tolerance=RANK,
        failures=failures,
        versions=versions,
        date=date,
    )
    return Design(P, K, closed_loop, measured.norm, info)


def _controllers(
    P: GeneralizedPlant, level: float, optimum: float, allowed: float, size: float
) -> Iterator[tuple[float, StateSpace]]:
    """Well-posed controllers, each with the part of what is allowed above the optimum that it gives up."""
    room = min((allowed - optimum) / (size - optimum), 1.0) if size > optimum else 1.0
    first, last = direct_term(P, level), direct_term(P, optimum)
    for part in PARTS:
        Q = (1 - part * room) * (last if part else first)
        loop = np.linalg.eigvals(-Q @ P.D22)  # eigenvalues have no units
        if np.abs(1 - loop).min() > ILL_POSED * (1 + np.abs(loop).max()):
            K = loop_solve(-Q @ P.D22, Q)
            if K is not None:
                yield part, StateSpace.gain(K, P.dt)
