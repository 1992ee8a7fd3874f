"""Order reduction of anything: systems by their Hankel singular values, designs by what the loop loses.

A controller is judged in its loop. Its states are balanced there: of the Gramians of the closed loop from w to z the
blocks of the controller's states, so that states count as far as w moves them and z feels them. Unstable controllers
need no exception, because the loop is stable: their modes are cut with the others, or stay while the others are cut.
Integrators always stay, unless "coprime" is asked for, which cuts the normalised coprime factors of the controller.
All that comes of it is measured by the judge, and the best of one order is kept.

References: Ceton, Wortelboer and Bosgra (1993), 2nd ECC, 907 (closed-loop balancing); Anderson and Liu (1989), IEEE
TAC 34, 802 (controller reduction).
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, overload

import numpy as np

from synth.analysis.differences import persistent, resting
from synth.analysis.hankel import Parts, balancing, grid, joined, meaningful, parts
from synth.analysis.norms import Verification, in_principal_axes, is_stable, judge
from synth.analysis.reduce import COPRIME, MATCHDC, METHODS, TRUNCATE, Reduction, coprime_balancing, cut, reduced
from synth.analysis.sampleddata import intersample
from synth.analysis.truncation import Balancing, gramian_factors
from synth.checks import as_choice, as_number, as_whole, numerical, shown
from synth.errors import InfeasibleError, ModelError, NumericalError, SynthError
from synth.files import provenance
from synth.synthesis.design import Design
from synth.synthesis.dkiteration import MuDesign
from synth.synthesis.hinfinity import slowest_pole
from synth.synthesis.info import SAMPLED, Info
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace, as_system, common_timebase, retimed
from synth.threads import one_thread

FAILS = (SynthError, np.linalg.LinAlgError)  # how a controller is found to be none


@overload
def reduce(G: Design, order: int | None = None, *, loss: float | None = None, method: str = "auto") -> Design: ...
@overload
def reduce(
    G: Any,
    order: int | None = None,
    *,
    error: float | None = None,
    loss: float | None = None,
    method: str = "auto",
    input_weight: Any = None,
    output_weight: Any = None,
    plant: None = None,
) -> Reduction: ...
@overload
def reduce(
    G: Any,
    order: int | None = None,
    *,
    loss: float | None = None,
    method: str = "auto",
    plant: GeneralizedPlant,
) -> Design: ...
@one_thread
@numerical
def reduce(
    G: Any,
    order: int | None = None,
    *,
    error: float | None = None,
    loss: float | None = None,
    method: str = "auto",
    input_weight: Any = None,
    output_weight: Any = None,
    plant: GeneralizedPlant | None = None,
) -> Any:
    """A system, or the controller of a design, with fewer states, and what that costs: measured, not only bounded.

    Parameters
    ----------
    G : a system in any form that `system` takes, continuous or discrete; or a Design, whose controller is reduced
    order : number of states that are left, modes that are not stable included; or fewer, where fewer are all there is
    error : of a system, instead of `order`: the largest H-infinity norm of the difference (of "coprime" the largest
        gap); the fewest states that were measured to be within it
    loss : of a design, instead of `order`: by which part `gamma` may grow, 1e-3 for example; the lowest order that was
        measured to be within it
    method : "truncate" (exact at high frequencies; "auto" of a system), "matchdc" (residualised, exact at rest) or
        "coprime" (normalised coprime factors: unstable modes count like others and may move, and the units of u and y
        are weights); "auto" of a design tries all
    input_weight, output_weight : of a system, stable, for the error `output_weight (G - Gr) input_weight`
    plant : where G is a controller that is no Design: the plant that it closes by u = G y (positive feedback), whose
        norm from w to z judges it as if it were one; `gang_of_four(P)` for a plant from u to y

    Returns
    -------
    Reduction : `system`, `order`, `error` as measured, `bound` from the Hankel singular values, `singular_values`; it
        can be passed on as a system. Modes on or beyond the stability boundary stay with "truncate" and "matchdc".
    Design : of a design, or with `plant`, with the closed loop and `gamma` measured anew; `info.status` says how. Where
        no lower order is within the loss it is the design that was given

    Raises
    ------
    ModelError : not one of `order`, `error` and `loss`, or one that does not belong to G; an order below the number of
        modes that stay; a weight that is not stable or does not fit; a MuDesign, which its norm does not judge.
    VerificationError : with `plant`: its loop with G is not stable.
    InfeasibleError : no controller of that order that was tried stabilises the loop.
    NumericalError : doubles cannot tell stable from other modes, or what is left is not stable.
    AssumptionError : "coprime", of a system with an unstable mode that is not reached or not seen.

    References: Moore (1981), IEEE TAC 26, 17; Liu and Anderson (1989), Int. J. Control 50, 1379; Enns (1984), 23rd CDC,
    127; McFarlane, Glover and Vidyasagar (1990), IEEE TAC 35, 369; Ceton, Wortelboer and Bosgra (1993), 2nd ECC, 907.

    Examples
    --------
    >>> from synth import reduce, system
    >>> found = reduce(system([1, 2.1], [1, 3, 2]), error=0.01)  # a pole at -2 and a zero at -2.1
    >>> found
    Reduction(order 1 of 2 by 'truncate'; measured error 0.00579, bound 0.00579)
    >>> found.system.n
    1
    """
    as_choice("method", method, ("auto", *METHODS))
    if plant is not None:
        G = _as_design(G, plant)
    if not isinstance(G, Design):
        if loss is not None:
            raise ModelError(
                f"loss is {shown(loss)}, but G is no Design and closes no plant; pass order or error, or the plant"
            )
        found = as_system("G", G)
        return reduced(found, order, error, TRUNCATE if method == "auto" else method, input_weight, output_weight)
    for name, value in (("error", error), ("input_weight", input_weight), ("output_weight", output_weight)):
        if value is not None:
            raise ModelError(
                f"{name} is {shown(value)}, but the loop of a Design judges, or that with plant: pass order or loss"
            )
    if isinstance(G, MuDesign):
        raise ModelError("G is a MuDesign, which its norm does not judge; pass G.controller, and measure mu again")
    if (order is None) == (loss is None):
        raise ModelError(f"order is {shown(order)} and loss is {shown(loss)}; pass one of them")
    return _of_design(G, order, loss, METHODS if method == "auto" else (method,))


def _as_design(K: Any, plant: Any) -> Design:
    """A controller that came about elsewhere, and the loop that it closes."""
    if isinstance(K, Design) or not isinstance(plant, GeneralizedPlant):
        raise ModelError(
            f"plant is {shown(plant)}; pass the GeneralizedPlant that the controller G closes, or a Design alone"
        )
    K = as_system("G", K, plant.dt)
    K = retimed(K, common_timebase(StateSpace.gain(0.0, plant.dt), K, ("plant", "G")))
    (loop, measured), (versions, date) = judge(plant, K), provenance()
    slowest, why = slowest_pole(plant, measured.poles)
    info = Info(
        method="given", status="designed elsewhere", level=measured.norm, optimum=None,
        spectral_radius=measured.spectral_radius, slowest=slowest, frequency=measured.frequency, seconds=0.0,
        solver="none", tolerance=0.0, failures={}, versions=versions, date=date, warnings=why,
    )  # fmt: skip
    return Design(plant, K, loop, measured.norm, info)


class _Cut(NamedTuple):
    """One way to leave states of a controller out."""

    name: str
    method: str
    parts: Parts
    balancing: Balancing

    def controller(self, order: int) -> StateSpace | None:
        """With that many states, or fewer where fewer are all there is; None where more of them stay."""
        k = min(order - self.parts.kept.n, meaningful(self.balancing.sigma))
        return None if k < 0 else joined(self.parts.kept, cut(self.parts.stable, self.balancing, k, self.method))


class _Found(NamedTuple):
    """A controller that was measured."""

    norm: float
    name: str
    K: StateSpace
    loop: StateSpace
    measured: Verification


def _of_design(design: Design, order: int | None, loss: float | None, methods: tuple[str, ...]) -> Design:
    """The design with the best controller of an order, or of the lowest order within the loss."""
    started, K = time.perf_counter(), design.closing
    if order is not None:
        order = as_whole("order", order, f"a number of states from 0 to {K.n}", least=0, most=K.n)
    allowed = np.inf if loss is None else 1 + as_number("loss", loss, "the part by which gamma may grow", least=0)
    cuts = list(_cuts(design.plant, in_principal_axes(K), methods))
    reasons: dict[str, str] = {}
    for k in range(K.n) if order is None else (order,):
        tried = (_measured(design, one, k, allowed * design.gamma, reasons) for one in cuts)
        best = min((found for found in tried if found), key=lambda found: found.norm, default=None)
        if best is not None:
            return _finished(design, best, time.perf_counter() - started)
    if order is None or order == K.n:
        return design
    why = "; ".join(f"{name}: {reason}" for name, reason in reasons.items()) or "more modes of it stay"
    raise InfeasibleError(
        f"order is {order}: no controller of that order was found that stabilises the loop ({why}); pass loss= to have "
        f"the order found, or a higher one (the design has {K.n})",
        best=design.gamma,
    )


def _cuts(P: GeneralizedPlant, K: StateSpace, methods: tuple[str, ...]) -> Iterator[_Cut]:
    """All ways: what stays are integrators, or all that is not stable; truncated, residualised; coprime factors."""
    _, _, nu, _, ny = P.sizes
    P = GeneralizedPlant.partition(in_principal_axes(StateSpace(*P.system.matrices, P.dt)), ny, nu)
    ways: list[tuple[str, Parts]] = []
    for name, which in (("states", resting), ("stable states", persistent)):
        try:
            found = parts(K, which)
        except NumericalError:  # then all modes are cut alike
            found = Parts(K, StateSpace.gain(np.zeros_like(K.D), K.dt))
        if not ways or found.kept.n > ways[0][1].kept.n:
            ways.append((f"{name} balanced in the loop", found))
    for name, each in ways:
        first = P.sizes[0] + each.kept.n
        try:
            reached, seen = gramian_factors(P.close(joined(each.kept, each.stable)))
            balanced = balancing(each.stable, reached[first:], seen[first:])
        except FAILS:
            continue
        for method, how in ((TRUNCATE, "truncated"), (MATCHDC, "residualised")):
            if method in methods:
                yield _Cut(f"{name}, {how}", method, each, balanced)
    if COPRIME in methods and (methods == (COPRIME,) or not ways[0][1].kept.n):
        try:
            none = StateSpace.gain(np.zeros_like(K.D), K.dt)
            yield _Cut("coprime factors, truncated", TRUNCATE, Parts(K, none), coprime_balancing(K))
        except FAILS:  # a controller with modes that do nothing, which the others leave out
            return


def _measured(design: Design, one: _Cut, order: int, level: float, reasons: dict[str, str]) -> _Found | None:
    """The controller of one way, where the judge finds its loop stable and within a level."""
    P = design.plant
    try:
        K = one.controller(order)
        between_samples = design.info.method == SAMPLED
        if K is None or (np.isfinite(level) and not between_samples and _exceeds(P.close(K), level)):
            return None
        loop, measured = judge(P, K)
        norm = measured.norm
        if between_samples:
            between = intersample(P, K)
            norm = np.inf if between is None else between.upper
    except FAILS as error:
        reasons[one.name] = str(error)
        return None
    return _Found(norm, one.name, K, loop, measured) if np.isfinite(norm) and norm <= level else None


def _exceeds(loop: StateSpace, level: float) -> bool:
    """Whether a loop is seen to be unstable or above a level before the judge, who takes longer, is asked."""
    return not is_stable(loop) or bool(
        np.linalg.norm(loop.frequency_response(grid(loop)), 2, axis=(1, 2)).max() > level
    )


def _finished(design: Design, found: _Found, seconds: float) -> Design:
    """The design with another controller, and how it came about."""
    info, shaping, measured = design.info, design.shaping, found.measured
    K = replace(found.K, u=design.closing.u, y=design.closing.y, units=design.closing.units)
    slowest, why = slowest_pole(design.plant, measured.poles)
    versions, date = provenance(*(set(info.versions) - {"convex-synth", "numpy", "scipy"}))
    text = f"controller reduced from order {design.closing.n} to {K.n} ({found.name})"
    told = replace(
        info,
        status=f"{info.status}; {text}, norm {found.norm:.7g} for {design.gamma:.7g}",
        optimum=None if info.shift else info.optimum,
        spectral_radius=measured.spectral_radius,
        slowest=slowest,
        frequency=measured.frequency,
        seconds=seconds,
        versions=versions,
        date=date,
        warnings=(*info.warnings, *(text for text in why if text not in info.warnings)),
        shift=0.0,
        shifted_norm=None,
    )
    shaping = None if shaping is None else replace(shaping, Ks=K)
    return replace(
        design, controller=shaping.controller if shaping else K, closed_loop=found.loop, gamma=found.norm, info=told,
        shaping=shaping,
    )  # fmt: skip
