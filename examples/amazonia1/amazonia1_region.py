"""Amazonia-1: regions of attraction of LQR and SDRE after Romero and Souza (WSEAS 2022), their claims measured.

Doi 10.37394/23202.2022.21.9. Any number of initial conditions in bounded memory; exact binomial intervals; the set
that the wheels can bring to rest at all; the rate-only test of convergence beside one with attitude. A single run is
flown again, with all its rows, by --replay INDEX.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from amazonia1 import ABBREVIATIONS, check_period, period_option
from amazonia1_box import QUANTITY, questions
from amazonia1_flights import LQR, MRP, SDRE, SHORT, Shared, case, controllers, measure
from amazonia1_region_claims import PAPER, TESTS, TITLE, counterparts, findings, reached, statements, summary
from matplotlib.figure import Figure

import synth
from plants import Campaign, Table, amazonia1, clopper_pearson, figures, report, simulate, study
from plants.files import write_atomically
from plants.missions.amazonia1 import DEG, RPM, Dispersion, Outcome
from plants.outcome import intersample

NAMES = (LQR, SHORT, SDRE, MRP)
HEADERS = ("controller", "runs", "attitude and rate", "95 %", "of the feasible", "rate only", "95 %", "fallbacks")
BINS = np.linspace(0, 2, 21)  # of the momentum load
KEPT = ("settling_time", "angle", "rate", "path", "asked", "given", "wheel_speed")


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    drawn: Dispersion
    load: np.ndarray  # (runs,) share of a wheel's momentum that rest would take
    duration: float  # s, of a flight
    campaigns: dict[str, Campaign] = field(default_factory=dict)

    def outcome(self, name: str) -> Outcome:
        """Finished runs of a controller."""
        return self.campaigns[name].results.outcome

    def feasible(self, name: str) -> np.ndarray:
        """Which of them the wheels can bring to rest at all."""
        return self.load[self.campaigns[name].index] <= 1


def fly(found: Study, chosen: Mapping[str, Any]) -> None:
    """Every initial condition with every controller."""
    study.campaigns(
        case,
        amazonia1.starts(found.drawn),
        {name: Shared(controller, found.duration) for name, controller in chosen.items()},
        found.campaigns,
        measure=measure,
        read=amazonia1.applied,
        **found.flying,
    )


def table(found: Study) -> Table:
    """The table of controllers."""
    rows = []
    for name, flown in found.campaigns.items():
        o, feasible = found.outcome(name), found.feasible(name)
        n = len(feasible)
        spans = ["{:.4f} to {:.4f}".format(*clopper_pearson(int(h.sum()), n)) for h in (o.converged, o.slow)]
        rows.append([
            name, str(n), str(o.converged.sum()), spans[0], f"{(o.converged & feasible).sum()}/{feasible.sum()}",
            str(o.slow.sum()), spans[1], str(flown.results.fallbacks.sum()),
        ])  # fmt: skip
    tests = (
        f"Rate only: |w| <= {amazonia1.SLOW:g} rad/s over the last {amazonia1.TAIL:.0%} of {found.duration:g} s. "
        f"Attitude and rate: within {amazonia1.POINTED / DEG:g} deg of the desired attitude as well. The paper's own "
        "test, its eq. 15, is missing from the text we have. Intervals are exact (Clopper and Pearson)."
    )
    return Table("What converges", HEADERS, rows, note=tests)


def drawings(found: Study) -> list[tuple[Figure, str]]:
    """Figures 1 to 3 of the paper, and the share that converges against the momentum bound."""
    size, rate = np.linalg.norm(found.drawn.angles, axis=1) / DEG, np.linalg.norm(found.drawn.rates, axis=1)
    plane = ("norm of the Euler angles, deg", "|w0|, rad/s")
    limit = [amazonia1.REGION_RATE_NORM]
    every = {"beyond the wheels": found.load > 1, "within their momentum": found.load <= 1}
    drawn = [(
        figures.scatter({"initial conditions": (size, rate, every)}, *plane, across=limit),
        "Initial conditions (figure 1), and those that the wheels can bring to rest at the desired attitude: "
        "|(A' J w0)_k| <= Is w_max for every axis. Dashed: the paper's limit.",
    )]  # fmt: skip
    if not found.campaigns:
        return drawn
    torque, regions, bound = {}, {}, {}
    for name, flown in found.campaigns.items():
        o, i, feasible = found.outcome(name), flown.index, found.feasible(name)
        groups = {
            "beyond the wheels": ~o.slow & ~feasible, "not converged": ~o.slow & feasible,
            "rate only": o.slow & ~o.converged, "attitude and rate": o.converged,
        }  # fmt: skip
        torque[name] = (1e3 * o.asked, 1e3 * o.given, {"run": np.ones(len(i), bool)})
        regions[name] = (size[i], rate[i], groups)
        bound[name] = (found.load[i], rate[i], groups)
    drawn.append((figures.scatter(torque, "asked, mN m", "given, mN m", diagonal=True),
                  "Mean torque over a run, computed and actual (figure 2). Dashed: equal."))  # fmt: skip
    drawn.append((figures.scatter(regions, *plane, across=limit),
                  "Regions of attraction (figure 3), by both tests of convergence."))  # fmt: skip
    drawn.append(
        (
            figures.scatter(bound, "largest share of a wheel's momentum at rest", plane[1], up=[1.0]),
            "The same against momentum: right of the dashed line no controller can converge in attitude and rate.",
        )
    )
    shown = [name for name in PAPER if name in found.campaigns and found.complete]
    if shown:
        hits = {
            f"{name}, {label}": np.histogram(found.load[getattr(found.outcome(name), test)], BINS)[0]
            for name in shown
            for label, test in TESTS.items()
        }
        totals = np.histogram(found.load, BINS)[0]
        drawn.append((figures.shares(BINS, hits, totals, "largest share of a wheel's momentum at rest", up=[1.0]),
                      "Share of initial conditions that converge, with exact 95 % intervals."))  # fmt: skip
    return drawn


def save(found: Study, path: Path) -> None:
    """Initial conditions and outcomes of all runs."""
    data: dict[str, Any] = {"angles": found.drawn.angles, "rates": found.drawn.rates, "momentum_load": found.load}
    for name, flown in found.campaigns.items():
        key = name.replace(", ", "_").replace(" ", "_").lower()
        data |= {f"{key}_index": flown.index}
        data |= {f"{key}_{part}": getattr(found.outcome(name), part) for part in KEPT}
    np.savez_compressed(content := io.BytesIO(), **data)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())


def replay(chosen: Mapping[str, Any], index: int, seed: int, duration: float, out: Path) -> Path:
    """Fly one initial condition again with every controller, all rows kept, and plot it."""
    one = Dispersion(*(part[None] for part in amazonia1.disperse_region(seed, index)))
    start = amazonia1.starts(one)
    load = float(amazonia1.momentum_load(start)[0])
    series, lines = {}, []
    for name, controller in chosen.items():
        first = type(start)(*(part[0] for part in start))
        run = simulate(*amazonia1.manoeuvre(first, controller, duration=duration, period=controller.dt))
        measured = measure(run)
        o = measured.outcome
        verdict = "converges" if o.converged else "slow, but elsewhere" if o.slow else "does not converge"
        settled = f"settles after {o.settling_time:.0f} s" if o.settled else "never settles"
        lines.append(
            f"{name}: {verdict}; {o.angle / DEG:.3g} deg and {o.rate:.3g} rad/s at the end, "
            f"{settled}, turns {o.path / DEG:.0f} deg, {measured.fallbacks} fallbacks"
        )
        norms = [np.linalg.norm(values, axis=1) for values in (run.outputs[:, 4:7], run.commands, run.inputs)]
        table = np.column_stack([amazonia1.angles(run) / DEG, norms[0], *norms[1:], run.states.wheels / RPM])
        every = max(1, round(0.5 / controller.dt))
        series[name] = (run.time[::every], table[::every])
    labels = ("angle, deg", "|w|, rad/s", "asked, N m", "given, N m", *(f"wheel {a}, rpm" for a in "xyz"))
    text = [
        f"Euler angles {np.round(one.angles[0] / DEG, 2)} deg, rates {np.round(one.rates[0], 5)} rad/s",
        f"At rest the wheels would hold {load:.3f} of their momentum: "
        + ("within their limits" if load <= 1 else "beyond their limits"),
        *lines,
    ]
    print("\n".join(text))
    settings = f"run {index}, seed {seed}, {duration:g} s flight"
    body = "".join(map(report.paragraph, text)) + report.figure(
        figures.histories(series, labels), f"Initial condition {index}, seed {seed}.", salt="replay"
    )
    page = report.page(
        f"Amazonia-1: initial condition {index}",
        settings,
        [report.Section("Flown again", body)],
        study.provenance(settings, study.Study(complete=True)),
    )
    return study.written(out / f"replay_{index}.html", page)


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast, what = "100 s flights and 8 initial conditions", "initial conditions"
    parser = study.parser(__doc__, out="out/amazonia1_region", fast=fast, runs=400, what=what)
    parser.add_argument("--replay", type=int, metavar="INDEX", help="fly one initial condition again and plot it")
    period_option(parser)
    options = study.parse(parser, arguments, natural=["replay"])
    check_period(parser, options.period)
    runs, duration = (min(options.runs, 8), 100.0) if options.fast else (options.runs, amazonia1.DURATION)
    built = controllers(options.period)
    chosen = {name: built[name] for name in NAMES}
    if options.replay is not None:
        print(f"page: {replay(chosen, options.replay, options.seed, duration, options.out)}")
        return 0
    drawn = amazonia1.region(runs, options.seed)
    near = [q for q in questions(built) if q.controller in (f"{LQR}, {SDRE}", MRP)]  # near the target they are linear
    found = Study(drawn, amazonia1.momentum_load(amazonia1.starts(drawn)), duration)
    study.carry_out(found, lambda: fly(found, chosen), options)
    save(found, options.out / "region.npz")
    return study.conclude(
        found,
        options.out,
        title="Amazonia-1: regions of attraction",
        subtitle="LQR and SDRE with wheels that saturate; after Romero and Souza (2022), doi 10.37394/23202.2022.21.9",
        tables=[table(found), *intersample.tables(near, synth, quantity=QUANTITY)],
        statements=statements(found),
        findings=[*reached(found), *findings(found, options.period)],
        counterparts=counterparts(),
        paper=TITLE,
        summary=summary(found),
        abbreviations={k: v for k, v in ABBREVIATIONS.items() if k in ("SDRE", "MRP", "LQR")},
        sections=[
            study.drawings("Figures 1 to 3", drawings(found)),
            report.Section("Data", report.links([("region.npz", "initial conditions and outcomes, SI and radians")])),
        ],
        settings=f"{runs} initial conditions, seed {options.seed}, {duration:g} s flights, period {options.period:g} s",
    )


if __name__ == "__main__":
    raise SystemExit(main())
