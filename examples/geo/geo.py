"""Geostationary station keeping: the thesis's regulator and H-infinity controller against the least fuel there is.

All six chapters flown anew in one nonlinear simulator: free drift, the filter, 1 m, 100 m to 10 cm in 100 minutes, 1 km
with 1 N, thrusters other than the model's, noise; then days in a box. LQR, LQG, H-infinity and predictive control are
compared in m/s, with the bound that no control can undercut.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import geo_box as box
import geo_controllers as design
import geo_drift as drift
import geo_filter as filters
import geo_keeping as keeping
import geo_limited as limited
import geo_sensitivity as sensitivity
import numpy as np
from geo_claims import ALIKE, findings, statements
from geo_counterparts import counterparts
from geo_figures import first, sections
from geo_flights import (
    HOLD,
    LOOSE,
    NOISE,
    PERIOD,
    PERTURBED,
    REACH,
    STEP,
    Study,
    bounds,
    linear_flights,
    predictive_flights,
    short,
)
from geo_flights import Flight as Flight
from geo_keeping import BOXES as BOXES
from geo_keeping import keep_boxes, verdict
from geo_worst import question

import synth
from plants import Card, Requirement, Table, study
from plants.missions.geo import BOX, END, FORCE, SETTLE
from plants.outcome import boxes, intersample, worst
from synth import ExportError, LinearController, export

DRAWS = 100  # of the Monte Carlo beside the worst flight
FILTERS, THRUSTERS = 12, 40  # of each kind from different guesses; drawn plants of section 5.5
FULL = (design.THESIS_LQR, design.LQR, design.FORESEEING, design.FUEL)  # that are given the velocity as well
ABBREVIATIONS = {
    "LQR": "linear-quadratic regulator: full state, a constant gain",
    "LQG": "the same behind a Kalman filter of the position",
    "H-infinity": "control that makes the largest gain from disturbances to weighted errors least",
    "MPC": "model predictive control: an optimisation over the hours ahead in every sample",
    "delta-v": "integral of the thrusters' acceleration, m/s: the fuel",
    "EKF": "extended Kalman filter",
    "NEES": "normalised estimation error squared: 1 per state if a filter's errors are as large as it believes",
    "S, T": "sensitivity and complementary sensitivity of the loop",
    "wP, wI, wu": "the thesis's weights of performance, uncertainty and control",
    "J2": "the Earth's oblateness",
}


def fly(found: Study, runs: int, seed: int, seeds: int = 3) -> None:
    """All of it."""
    drift.drift(found)
    filters.track(found, FILTERS, seed)
    found.bounds |= bounds(found.rate)
    controllers, designs = design.linear(found.rate, PERIOD)
    found.designs |= designs
    linear_flights(found, controllers, runs, seed)
    sensitivity.measure(found)
    sensitivity.uncertain_flights(found, controllers, THRUSTERS, seed)
    predictive_flights(found, runs, seed)
    keep_boxes(found, seeds, seed)


def task_table(found: Study) -> Table:
    """Chapter 6: 100 m to 10 cm."""
    headers = (
        "controller",
        "measures",
        "m/s in 100 min",
        "m/s in 1000 min",
        "within, cm",
        "largest force, N",
        "perturbed: m/s",
        "perturbed: within, cm",
    )
    rows, marks = [], []
    for name, b in found.bounds.items():
        figures = {
            REACH: (f"{b.lower:.4f}", "-", "-"),
            HOLD: ("-", f"{b.lower:.4f}", "-"),
            PERTURBED: ("-", "-", f"{b.lower:.4f}"),
        }[name]
        rows.append((f"bound: {name}", "any", *figures[:2], "10", "any", figures[2], "10"))
        marks.append([""] * 8)
    for name in dict.fromkeys((*found.chapter6, *found.perturbed)):
        row, mark = [name, measures(name)], ["", ""]
        if calm := found.chapter6.get(name):
            off = calm.farthest(SETTLE)
            row += [f"{calm.delta_v(SETTLE):.3f}", f"{calm.delta_v():.3f}", cm(off), f"{calm.largest_force:.3g}"]
            mark += ["", "", verdict(off <= BOX), verdict(calm.largest_force <= FORCE)]
        row, mark = row + ["-"] * (6 - len(row)), mark + [""] * (6 - len(mark))
        if rough := found.perturbed.get(name):
            off = rough.farthest(SETTLE)
            row, mark = [*row, f"{rough.delta_v():.3f}", cm(off)], [*mark, "", verdict(off <= BOX)]
        rows.append((*row, *["-"] * (8 - len(row))))
        marks.append([*mark, *[""] * (8 - len(mark))])
    note = (
        "From 100 m in each axis; within: largest component of the position from 100 to 1000 minutes. Perturbed: with "
        "Moon, Sun, the Earth's shape and solar pressure, which predictive control and the regulator called foreseeing "
        "know beforehand and the others do not. The bounds hold for the linear plant and any control of any thrust."
    )
    return Table("100 m to 10 cm in 100 minutes", headers, rows, marks, note)


def cm(length: float) -> str:
    """A length in m as centimetres."""
    return "< 0.01" if length < 1e-4 else f"{100 * length:.2g}" if length < 1 else f"{100 * length:.0f}"


def measures(name: str) -> str:
    """What a controller is given."""
    return "state" if name in FULL else "position"


def other_tables(found: Study) -> list[Table]:
    """1 km with 1 N, noise, boxes."""
    far = [
        (
            name,
            f"{f.farthest(0):.0f}",
            *map(short, (f.overshoot, f.farthest(END / 2), f.last)),
            f"{f.delta_v():.2f}",
        )
        for name, f in (found.saturated | found.windup).items()
    ]
    stepped, compiled = (len(found.noisy.get(name, ())) for name in (design.FUEL, design.LQR))
    noisy = [
        (name, measures(name), f"{found.per_day(name):.3g}", f"{np.mean([f.spread for f in many]):.3g}")
        for name, many in found.noisy.items()
    ]
    return [
        sensitivity.uncertain_table(found),
        Table(
            "1 km with 1 N",
            ("controller", "farthest, m", "overshoot, %", "second half: within, m", "at the end, m", "m/s"),
            far,
            note="From 1 km in each axis, thrust limited to 1 N in each axis, perturbed, 1000 minutes. Overshoot: how "
            "far the ideal point is passed, % of the start, in the worst axis. Loop shaping is H-infinity of another "
            "kind, with integrators.",
        ),
        Table(
            "Noise",
            ("controller", "measures", "m/s per day", "distance, m rms"),
            noisy,
            note=f"{NOISE[0]:g} m and {1e3 * NOISE[3]:g} mm/s, one sigma in each axis, every {PERIOD:g} s; "
            f"{design.FUEL} every {STEP:g} s with a box of +-{LOOSE:g} m, {stepped} runs, the others {compiled}. No "
            "filter but the controller's own.",
        ),
        keeping.keeping_table(found),
    ]


def requirements(found: Study) -> list[Requirement]:
    """Section 6.2 for predictive control, and our own: within 10 % of the bound."""
    margins = []
    for flights, name, world in ((found.chapter6, HOLD, ""), (found.perturbed, PERTURBED, ", perturbed")):
        if flight := flights.get(design.FUEL):
            lower = found.bounds[name].lower
            margins += [
                Requirement(
                    f"{design.FUEL}: position from 100 minutes on{world}",
                    100 * flight.farthest(SETTLE),
                    100 * BOX,
                    "cm",
                ),
                Requirement(f"{design.FUEL}: delta-v over its bound{world}", flight.delta_v() / lower, ALIKE, ""),
            ]
    return margins


def stem(name: str) -> str:
    """A file name, which is a C identifier as well."""
    return name.lower().replace(",", "").replace(" ", "_").replace("-", "_")


def cards(found: Study, out: Path) -> list[Card]:
    """The designs and what is flown of them: u = K e, e the reference less the position."""
    made = []
    for name, d in found.designs.items():
        card = study.card(name, d, out, stem(name))
        unit = design.UNITS.get(name, (design.MINUTE,))[0]
        flown = () if name == limited.LOOP else code(design.sampled(d.controller, unit, PERIOD), out, stem(name))
        made.append(card._replace(files=[*card.files, *flown], facts=[("unit of time", f"{unit:g} s"), *card.facts]))
    if design.LQR in found.chapter6:
        unit, rate = design.UNITS[design.LQR]
        K = design.regulator(found.rate, unit, PERIOD, rate=rate)
        facts = [("order", "0"), ("inputs", "position and velocity"), ("period", f"{PERIOD:g} s")]
        made.append(Card(design.LQR, facts, code(K, out, stem(design.LQR))))
    return made


def code(K: LinearController, out: Path, name: str) -> list[tuple[str, str]]:
    """The files of a sampled controller in metres and seconds: C, and an FMU where there is a compiler."""
    what, files = f"as flown, every {PERIOD:g} s, metres and m/s2", []
    for format, text in (("c", "C99"), ("fmu2", "FMI 2.0 co-simulation")):
        try:
            files += [(path.name, f"{text}, {what}") for path in export(K, format, out, name=name, force=True)]
        except ExportError as error:
            print(f"{name}: {error}")
    return files


def summary(found: Study) -> str:
    """Which controller to take, of those that fly the task with everything that acts."""
    off = {name: f.farthest(found.settle) for name, f in found.perturbed.items()}
    fuel = {name: found.perturbed[name].delta_v() for name, x in off.items() if x <= found.box}
    if not fuel or PERTURBED not in found.bounds:
        return ""
    best, *others = sorted(fuel, key=lambda name: fuel[name])
    text = (
        f"Take {best}: with Moon, Sun, the Earth's shape and sunlight it brings the satellite from 100 m within 10 cm "
        f"for {fuel[best]:.2f} m/s, where no control needs less than {found.bounds[PERTURBED].lower:.2f}"
    )
    text += "".join(f"; {name} needs {fuel[name]:.2f}" for name in others)
    missed = [
        f"{name} ({cm(off[name])} cm)" for name in (design.THESIS_LQR, design.MIXED) if off.get(name, 0) > found.box
    ]
    return text + (f"; {' and '.join(missed)} miss it" if missed else "") + "."


def said(found: Study) -> Sequence[str]:
    """What the thesis does not say."""
    return [*filters.findings(found), *drift.findings(found), *findings(found), *keeping.findings(found)]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "two days of box keeping with one seed, six noisy runs, no search for the worst, no proofs"
    parser = study.parser(
        __doc__, out="out/geo", fast=fast, runs=12, what="noisy runs of each linear controller", stored=False
    )
    parser.add_argument("--days", type=int, default=5, help="of box keeping (default 5)")
    options = study.parse(parser, arguments, natural=("days",))
    runs, days, seeds = (6, 2, 1) if options.fast else (options.runs, options.days, 3)
    if days < 2:
        parser.error(f"--days {days}: give at least 2, of which the first is the filter's")
    found = Study(days=days)

    def flights() -> None:
        fly(found, runs, options.seed, seeds)
        if not options.fast:
            worst.ask(question(found.rate, DRAWS, options.seed), found.worst, seed=options.seed)
            asked = box.questions(design.linear(found.rate, PERIOD)[0])
            boxes.ask(asked, found.boxes, synth)

    study.carry_out(found, flights)
    return study.conclude(
        found,
        options.out,
        title="Geostationary station keeping: fuel",
        subtitle="LQR, LQG, H-infinity and predictive control against the least fuel there is; after a thesis on "
        "station keeping by optimal and H-infinity control",
        paper="004 Neokleous (2007)",
        summary=summary(found),
        first=first(found),
        tables=[
            task_table(found),
            drift.drift_table(found),
            filters.filter_table(found),
            *other_tables(found),
            *worst.tables(found.worst),
            *boxes.tables(found.boxes, options.out, quantity=box.QUANTITY, model=box.MODEL),
            *intersample.tables([a.question for a in found.boxes], synth, quantity=box.QUANTITY),
        ],
        statements=statements(found),
        counterparts=counterparts(),
        requirements=requirements(found),
        findings=[*said(found), *boxes.findings(found.boxes, box.WHOSE)],
        cards=cards(found, options.out),
        sections=sections(found),
        abbreviations=ABBREVIATIONS,
        settings=f"{runs} noisy runs, {THRUSTERS} drawn plants, {FILTERS} filters of each kind, seed {options.seed}, "
        f"{days} days of box keeping with {seeds} seeds",
        packages=("cvxpy", "highspy", "clarabel"),
    )


if __name__ == "__main__":
    raise SystemExit(main())
