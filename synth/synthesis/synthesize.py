"""One controller for several specifications, each an LMI on one loop, each measured; `combined.py` has the search."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from synth.analysis.precondition import check_assumptions
from synth.checks import as_choice, numerical, printable, timebase_told
from synth.files import provenance
from synth.synthesis.combined import ALONE, Search, mapped
from synth.synthesis.design import Design, Info
from synth.synthesis.hinfinity import as_plant, slowest_pole
from synth.synthesis.remarks import words
from synth.synthesis.specifications import MET, Bound, Disc, Norm, StrictlyProper
from synth.synthesis.tasks import DIRECT, FORMS, Task, Told
from synth.threads import one_thread


@dataclass(frozen=True, eq=False)
class Synthesis:
    """A controller that meets several specifications. Unpacks as ``K, CL, gamma, info``."""

    design: Design  # as every tool takes it; its `gamma` is the verified H-infinity norm from all w to all z
    specifications: tuple[Told, ...]  # what was minimised first

    plant = property(lambda self: self.design.plant)
    controller = property(lambda self: self.design.controller)
    closed_loop = property(lambda self: self.design.closed_loop)
    info = property(lambda self: self.design.info)
    warnings = property(lambda self: self.design.warnings)

    @property
    def gamma(self) -> float:
        """The minimised norm, measured."""
        return self.specifications[0].measured

    def __iter__(self) -> Iterator[Any]:
        """K, CL, gamma, info."""
        return iter((self.design.K, self.design.CL, self.gamma, self.info))

    def __repr__(self) -> str:
        rows = []
        for told in self.specifications:
            level = "minimised" if told.level is None else f"at most {told.level:.7g}"
            alone = "" if told.alone is None else f" (alone {told.alone:.7g} is possible)"
            rows.append(f"\n          {told.name} {level}: {told.measured:.7g} measured{alone}")
        K, margins = self.controller, self.design.margins
        return printable(
            f"Synthesis(order {K.n} controller, {K.nu} measurements, {K.ny} controls, {timebase_told(K.dt)}, "
            f"method {self.info.method!r}, {self.info.seconds:.2f} s"
            + "".join(rows)
            + (f"\n          margins: {words(margins)}" if margins else "")
            + "".join(f"\n          warning: {text}" for text in self.warnings)
            + ")"
        )


@one_thread
@numerical
def synthesize(
    P: Any,
    nmeas: int | None = None,
    ncon: int | None = None,
    *,
    minimize: Norm,
    subject_to: Sequence[Bound | Disc | StrictlyProper] = (),
    method: str = DIRECT,
) -> Synthesis:
    """Controller K that minimises one norm of P closed by u = K y (positive feedback) while others stay below levels.

    Parameters
    ----------
    P : GeneralizedPlant, or a system in any form that `system` takes, whose last inputs are u and last outputs y;
        discrete or continuous
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant
    minimize : `Hinf`, `H2` or `GeneralisedH2` of a channel, `H2(w="noise", z=["error", 2])`; all signals when left out
    subject_to : bounds `H2(...) <= level`, at most one `Disc(centre, radius)` for the poles, `StrictlyProper()`
    method : "direct", descents from the controllers that are best for one norm alone; or LMIs that share a
        multiplier, "extended" with a Lyapunov matrix for every specification, "standard" with one for all, in
        continuous time for `Hinf` and `Disc`, which the Cayley map keeps

    Returns
    -------
    Synthesis : `specifications` lists for each the level, what the LMI claims, what was measured on the closed loop by
        code that shares nothing with it, and the least value without the others; `design` is what `export` takes

    Raises
    ------
    ModelError : data that is no model, an unknown channel, a specification that the plant's timebase does not allow.
    AssumptionError : (A, B2) is not stabilisable or (A, C2) not detectable; names the mode.
    InfeasibleError : the bounds were not met together, though the LMIs were tried with wider ones, which are judged on
        the loop by what was asked for; says which cannot be met alone, or what the last controller missed.
    NumericalError : every attempt failed; `statuses` says how each of them did.
    """
    started = time.perf_counter()
    plant = as_plant(P, nmeas, ncon)
    as_choice("method", method, FORMS)
    task = Task.of(plant, minimize, subject_to, method)
    check_assumptions(plant)
    search = Search(task, *mapped(task))
    found = search.run()
    versions, date = provenance("cvxpy", "clarabel")
    slowest, why = slowest_pole(plant, found.verified.poles)
    told = (search.told,) if search.told else ()
    info = Info(
        method="alone" if found.status == ALONE else method,
        status=found.status,
        level=found.verified.norm,
        optimum=None,
        spectral_radius=found.verified.spectral_radius,
        slowest=slowest,
        frequency=found.verified.frequency,
        seconds=time.perf_counter() - started,
        solver="clarabel",
        tolerance=MET,
        failures=dict(search.failures),
        versions=versions,
        date=date,
        warnings=(*told, *why),
    )
    design = Design(plant, found.controller, found.closed_loop, found.verified.norm, info)
    return Synthesis(design, tuple(search.tell(found)))
