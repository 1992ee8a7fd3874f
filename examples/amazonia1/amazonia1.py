"""Amazonia-1: the Monte Carlo of Romero and Souza (CILAMCE 2022) with every controller, their claims measured.

SDRE and SDRE + H-infinity as the paper has them and as they are meant, LQR as it is and with the short way round, PD
and PID are flown from the same random attitudes, rates and inertias, compared run by run, and written up in an HTML
report.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from amazonia1_box import MODEL, QUANTITY, WHOSE, questions
from amazonia1_claims import PAPER as TITLE
from amazonia1_claims import counterparts, findings, share, side, statements, summary
from amazonia1_flights import (
    AGAIN,
    DYNAMIC,
    LITERAL,
    LQR,
    MRP,
    NOMINAL,
    PAPER,
    PD,
    PID,
    PUSH,
    ROW,
    SDRE,
    SHORT,
    STATIC,
    STEP,
    Shared,
    Study,
    case,
    controllers,
    measure,
    starts,
)
from amazonia1_pointwise import EQUATIONS, levels
from amazonia1_worst import PERIOD as WORST_PERIOD
from amazonia1_worst import question
from matplotlib.figure import Figure

import synth
from plants import Campaign, Table, amazonia1, draw, figures, report, study
from plants.missions.amazonia1 import DEG
from plants.outcome import boxes, intersample, worst
from synth import ExportError, export

HEADERS = ("controller", "settled", "median, s", "max, s", "converged", "turned at most, deg",
           "mean torque, mN m", f"deg under {1e3 * PUSH:g} mN m", "fallbacks")  # fmt: skip
AGAINST = ("SDRE against", "settling time, s", "95 %", "p", "q0 < 0, s", "q0 > 0, s", "torque, ratio", "95 %", "p")
ABBREVIATIONS = {
    "SDRE": "state-dependent Riccati equation: a regulator designed anew in every sample",
    "MRP": "modified Rodrigues parameters, the factorisation without a singular attitude",
    "Hinf": "H-infinity: least worst-case gain, here of coprime factors",
    "LQR": "linear-quadratic regulator", "PD, PID": "proportional, integral, derivative control",
    "settled": "below 1 deg and 1e-3 rad/s to the end", "q0": "scalar part of the quaternion at the start",
}  # fmt: skip
GLANCE = (SDRE, MRP, DYNAMIC, LQR, SHORT, PID)  # of the first figure
__all__ = ["DYNAMIC", "LITERAL", "LQR", "MRP", "NOMINAL", "PD", "PID", "ROW", "SDRE", "SHORT", "STATIC", "share"]


def period_option(parser: Any) -> None:
    """--period, the same for both studies."""
    parser.add_argument("--period", type=float, default=STEP, metavar="SECONDS",
                        help=f"of control and integration (default {STEP:g}; {amazonia1.PERIOD:g} is the paper's, "
                             "which takes ten times as long)")  # fmt: skip


def check_period(parser: Any, period: float) -> None:
    """End the program with exit code 2 for a period that does not fill a row."""
    if not (period > 0 and np.isclose(ROW / period % 1, 0, atol=1e-9)):
        parser.error(f"--period {period:g}: give a part of {ROW:g} s, such as 0.05 or 0.5")


def fly(found: Study, built: dict[str, Any], runs: int, seed: int) -> None:
    """The Monte Carlo with every controller, then with the nominal inertia."""
    begun = starts(runs, seed)
    shared = {name: Shared(controller, found.duration) for name, controller in built.items()}
    common = {"measure": measure, "read": amazonia1.applied}
    keep: dict[str, Any] = dict.fromkeys(PAPER, range(runs + 1))
    study.campaigns(case, begun, shared, found.campaigns, keep=keep, **common, **found.flying)
    nominal = begun._replace(moments=np.broadcast_to(np.diag(amazonia1.INERTIA), begun.moments.shape))
    again = {f"{name}, nominal inertia": shared[name] for name in NOMINAL}
    flown: dict[str, Campaign] = {}
    study.campaigns(case, nominal, again, flown, **common, **found.flying)
    found.nominal |= {name: flown[f"{name}, nominal inertia"] for name in NOMINAL}
    if found.period != amazonia1.PERIOD:
        law = {f"{SDRE}, {amazonia1.PERIOD:g} s": Shared(controllers()[SDRE], found.duration)}
        study.campaigns(case, starts(min(runs, AGAIN), seed), law, flown, **common, **found.flying)
        found.fine[SDRE] = flown[next(iter(law))]
    found.levels |= levels(built, seed)


def table(found: Study) -> Table:
    """The table of controllers."""
    rows = []
    for name, flown in found.campaigns.items():
        o = found.random(name)
        n, times = len(o.settling_time), o.settling_time[o.settled]
        middle, last = (f"{np.median(times):.0f}", f"{times.max():.0f}") if len(times) else ("never", "never")
        rows.append([
            name, f"{len(times)}/{n}", middle, last, f"{o.converged.sum()}/{n}", f"{o.path.max() / DEG:.0f}",
            f"{1e3 * o.given.mean():.1f}", f"{found.pushed(name):.3f}", str(flown.results.fallbacks.sum()),
        ])  # fmt: skip
    rules = (
        f"Settled: below {amazonia1.SETTLED_ANGLE / DEG:g} deg and {amazonia1.SETTLED_RATE:g} rad/s to the end. "
        f"Converged: below {amazonia1.POINTED / DEG:g} deg and {amazonia1.SLOW:g} rad/s over the last "
        f"{amazonia1.TAIL:.0%} of {found.duration:g} s. Both on a grid of {ROW:g} s."
    )
    return Table("Monte Carlo", HEADERS, rows, note=rules)


def against(found: Study) -> Table:
    """SDRE against every other law, run by run."""
    rows = []
    for name in found.campaigns:
        if name == SDRE or SDRE not in found.campaigns:
            continue
        time, torque = found.compared(SDRE, name, "settling_time"), found.compared(SDRE, name, "given", ratio=True)
        sides = (side(found, name, behind).split(" ")[0] for behind in (True, False))
        rows.append([
            name, f"{time.median:+.1f}", f"{time.low:+.1f} to {time.high:+.1f}", f"{time.wilcoxon:.2g}", *sides,
            f"{torque.median:.3f}", f"{torque.low:.3f} to {torque.high:.3f}", f"{torque.wilcoxon:.2g}",
        ])  # fmt: skip
    return Table(
        "SDRE against the others, run by run", AGAINST, rows,
        note="Medians of the differences of settling times (negative: SDRE is sooner) and of the ratios of mean "
        "torques (below 1: SDRE takes less) over the same starts and inertias, with intervals by order statistics; p "
        "of the signed-rank test.",
    )  # fmt: skip


def pointwise(found: Study) -> Table:
    """The level of the H-infinity laws."""
    rows = [
        (name, str(EQUATIONS[name]), f"{v[0]:.3f}", f"{v.min():.3f}", f"{v.max():.3f}")
        for name, v in found.levels.items()
    ]
    return Table(
        "Level of eq. 12 over the one asked for",
        ("law", "Riccati equations", "at the target", "least", "largest"), rows,
        note="Model and law frozen at the target and at random starts of the Monte Carlo; 1 or less is what section "
        "2.1 promises.",
    )  # fmt: skip


def drawings(found: Study) -> report.Section:
    """Counterpart of figure 3."""
    drawn, labels = [], ("q1", "q2", "q3", "wx, rad/s", "wy, rad/s", "wz, rad/s")
    for letter, name in zip("ab", PAPER, strict=True):
        if name not in found.campaigns:
            continue
        runs = [r for i, r in found.campaigns[name].kept.items() if i > 0]
        lines = [(r.time, r.outputs[:, 1:7] * np.r_[np.full(3, np.sign(r.outputs[-1, 0])), np.ones(3)]) for r in runs]
        fig = figures.spread(lines, labels, until=found.duration)
        drawn.append((fig, f"{name}: all runs (figure 3{letter}). Signs of q by its end."))
    return study.drawings("Figure 3", drawn)


def settling(found: Study) -> tuple[Figure, str] | None:
    """Share of the runs that have settled, over time."""
    drawn = {}
    for name in filter(found.campaigns.__contains__, GLANCE):
        times = np.sort(found.random(name).settling_time)
        drawn[name] = (np.repeat(times, 2), np.repeat(np.arange(len(times) + 1), 2)[1:-1, None] / max(len(times), 1))
    if not drawn:
        return None
    shown = {name: (t[np.isfinite(t)], share[np.isfinite(t)]) for name, (t, share) in drawn.items()}
    return figures.histories(shown, ["share of runs settled"]), "Share of the runs that have settled, over time."


def cards(found: Study, built: dict[str, Any], out: Path) -> list[report.Card]:
    """Every controller at a glance, with the files of those that leave as C."""
    made, gain = [], exported(built[LQR], out)
    for name, controller in built.items():
        facts = {"law": type(controller).__name__, "sampling time": f"{controller.dt:g} s"}
        if hasattr(controller, "gamma_factor"):
            facts["level over the optimal one"] = f"{controller.gamma_factor:g}"
        if hasattr(controller, "model"):
            facts["factorisation"] = type(controller.model).__name__
        if hasattr(controller, "model") and name in found.campaigns:
            facts["samples without solution"] = str(found.campaigns[name].results.fallbacks.sum())
        files = gain if name in (LQR, SHORT) else []
        note = "Give it the quaternion times the sign of q0." if name == SHORT else ""
        made.append(report.Card(name, [*facts.items()], files, note))
    return made


def exported(gain: Any, out: Path) -> list[tuple[str, str]]:
    """The constant gain in C, and as an FMU where there is a compiler, written into `out`."""
    made = export(gain, "c", out, name="lqr", force=True)
    try:
        made += export(gain, "fmu3", out, name="lqr", force=True)
    except ExportError as error:
        print(f"no FMU: {error}")
    kinds = {".c": "the gain in C", ".h": "its header", ".fmu": "FMU 3.0"}
    return [(path.name, kinds[path.suffix]) for path in made]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "600 s flights, 4 runs, no search for the worst, no proofs"
    parser = study.parser(__doc__, out="out/amazonia1", fast=fast, runs=100)
    period_option(parser)
    options = study.parse(parser, arguments)
    check_period(parser, options.period)
    runs, duration = (min(options.runs, 4), 600.0) if options.fast else (options.runs, amazonia1.DURATION)
    found, built = Study(duration, options.period), controllers(options.period)

    def flights() -> None:
        fly(found, built, runs, options.seed)
        if not options.fast:
            asked = question(controllers(WORST_PERIOD)[LQR], draw(amazonia1.disperse, runs, options.seed))
            worst.ask(asked, found.worst, seed=options.seed)
            boxes.ask(questions(built), found.boxes, synth)

    study.carry_out(found, flights, options)
    return study.conclude(
        found,
        options.out,
        title="Amazonia-1: SDRE under parametric uncertainty",
        subtitle="SDRE, SDRE + H-infinity, LQR, PD and PID in one nonlinear simulator; after Romero and Souza, "
        "CILAMCE 2022",
        tables=[
            table(found),
            against(found),
            pointwise(found),
            *worst.tables(found.worst),
            *boxes.tables(found.boxes, options.out, quantity=QUANTITY, model=MODEL),
            *intersample.tables([a.question for a in found.boxes], synth, quantity=QUANTITY),
        ],
        statements=statements(found),
        counterparts=counterparts(),
        paper=TITLE,
        summary=summary(found),
        abbreviations=ABBREVIATIONS,
        first=settling(found),
        findings=[*findings(found), *boxes.findings(found.boxes, WHOSE)],
        cards=cards(found, built, options.out),
        sections=[drawings(found)],
        settings=f"{runs} runs, seed {options.seed}, {duration:g} s flights, period {options.period:g} s",
    )


if __name__ == "__main__":
    raise SystemExit(main())
