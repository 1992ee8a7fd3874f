"""Amazonia-1: regions of attraction of LQR and SDRE after Romero and Souza (WSEAS 2022), their claims measured.

Doi 10.37394/23202.2022.21.9. Any number of initial conditions in bounded memory; exact binomial intervals; the set
that the wheels can bring to rest at all; the rate-only test of convergence beside one with attitude. A single run is
flown again, with all its rows, by --replay INDEX.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from amazonia1 import LQR, MRP, SDRE, Shared, case, controllers, judge, measure, provenance, share
from matplotlib.figure import Figure
from tqdm import tqdm

from plants import amazonia1, campaign, figures, report, simulate
from plants.amazonia1 import DEG, RPM, Dispersion, Outcome
from plants.indices import clopper_pearson

NAMES = (LQR, SDRE, MRP)
PAPER = (LQR, SDRE)
HEADERS = ("controller", "runs", "attitude and rate", "95 %", "of the feasible", "rate only", "95 %", "fallbacks")
BINS = np.linspace(0, 2, 21)  # of the momentum load
TESTS = {"attitude and rate": "converged", "rate only": "slow"}
KEPT = ("settling_time", "angle", "rate", "path", "asked", "given", "wheel_speed")


@dataclass
class Study:
    """What has been measured so far; complete unless interrupted."""

    drawn: Dispersion
    load: np.ndarray  # (runs,) share of a wheel's momentum that rest would take
    duration: float  # s, of a flight
    campaigns: dict[str, campaign.Campaign] = field(default_factory=dict)
    complete: bool = False
    seconds: float = 0.0

    def outcome(self, name: str) -> Outcome:
        """Finished runs of a controller."""
        return self.campaigns[name].results.outcome

    def feasible(self, name: str) -> np.ndarray:
        """Which of them the wheels can bring to rest at all."""
        return self.load[self.campaigns[name].index] <= 1


def fly(study: Study, chosen: Mapping[str, Any], seed: int) -> None:
    """Every initial condition with every controller; what has finished stays in the study."""
    runs = len(study.load)
    start = amazonia1.starts(study.drawn)
    with tqdm(total=len(chosen) * runs, desc="runs", delay=2.0) as bar:
        for done, (name, controller) in enumerate(chosen.items()):

            def advanced(finished: int, before: int = done * runs) -> None:
                bar.update(before + finished - bar.n)

            shared = Shared(controller, study.duration)
            flown = campaign.campaign(
                case, start, shared, measure=measure, read=amazonia1.applied, progress=False, on_batch=advanced
            )
            if len(flown.index):
                study.campaigns[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
    study.complete = True


def rows(study: Study) -> list[list[str]]:
    """The table of controllers."""
    table = []
    for name, flown in study.campaigns.items():
        o, feasible = study.outcome(name), study.feasible(name)
        n = len(feasible)
        spans = ["{:.4f} to {:.4f}".format(*clopper_pearson(int(h.sum()), n)) for h in (o.converged, o.slow)]
        table.append([
            name, str(n), str(o.converged.sum()), spans[0], f"{(o.converged & feasible).sum()}/{feasible.sum()}",
            str(o.slow.sum()), spans[1], str(flown.results.fallbacks.sum()),
        ])  # fmt: skip
    return table


def statements(study: Study) -> list[tuple[str, str, Callable[[], tuple[str, str]]]]:
    """(claim, where it stands, how it is judged)."""

    def of_both(converged: bool, slow: bool) -> str:
        """Verdict from those of the honest and of the rate-only test."""
        if converged == slow:
            return "holds" if slow else "does not hold"
        return "depends on the test of convergence"

    def counts() -> str:
        found = {name: study.outcome(name) for name in PAPER}
        return "; ".join(
            f"{name}: attitude and rate {share(o.converged)}, rate only {share(o.slow)}" for name, o in found.items()
        )

    def larger() -> tuple[str, str]:
        """By the runs that one converges and the other does not: is SDRE the one in more than half of such runs?"""
        first, second = (study.campaigns[name].index for name in PAPER)
        both = first[np.isin(first, second)]
        verdicts, texts = {}, []
        for label, test in TESTS.items():
            lqr, sdre = (
                getattr(study.outcome(name), test)[np.isin(study.campaigns[name].index, both)] for name in PAPER
            )
            alone, other = int((sdre & ~lqr).sum()), int((lqr & ~sdre).sum())
            verdicts[test] = alone + other > 0 and clopper_pearson(alone, alone + other)[0] > 0.5
            texts.append(f"{label}: SDRE alone {alone}, LQR alone {other}")
        return of_both(**verdicts), f"{counts()}; {'; '.join(texts)}"

    def not_global() -> tuple[str, str]:
        found, feasible = [study.outcome(name) for name in PAPER], study.feasible(SDRE)
        verdict = of_both(not any(o.converged.all() for o in found), not any(o.slow.all() for o in found))
        return verdict, f"{counts()}; {share(feasible)} satisfy the momentum bound that holds for any controller"

    def all_angles() -> tuple[str, str]:
        """Convergence by the norm of the Euler angles, quarter by quarter."""
        texts, even = [], []
        for name in PAPER:
            o, index = study.outcome(name), study.campaigns[name].index
            size = np.linalg.norm(study.drawn.angles[index], axis=1)
            if len(size) < 40:
                return "not measured", f"{len(size)} runs are too few for quarters"
            quarter = np.digitize(size, np.quantile(size, [0.25, 0.5, 0.75]))
            hits = [o.converged[quarter == k] for k in range(4)]
            texts.append(f"{name} " + ", ".join(f"{h.sum()}/{h.size}" for h in hits))
            even.append(min(h.mean() for h in hits) > 0.5 * max(h.mean() for h in hits))
        verdict = "holds" if all(even) else "does not hold"
        return verdict, f"converged by quarters of the norm of the Euler angles: {'; '.join(texts)}"

    def limit() -> tuple[str, str]:
        texts, within = [], []
        for name in PAPER:
            o, size = study.outcome(name), np.linalg.norm(study.drawn.rates[study.campaigns[name].index], axis=1)
            largest = {test: float(size[getattr(o, test)].max(initial=0.0)) for test in ("converged", "slow")}
            within += [value <= amazonia1.REGION_RATE_NORM for value in largest.values()]
            texts.append(f"{name} {largest['converged']:.4f} by attitude and rate, {largest['slow']:.4f} by rate only")
        outside = study.load[(np.linalg.norm(study.drawn.rates, axis=1) <= amazonia1.REGION_RATE_NORM)] > 1
        verdict = "holds" if all(within) else "does not hold"
        return verdict, (
            f"largest |w0| that converged, rad/s: {'; '.join(texts)}. The bound says little: {outside.mean():.0%} of "
            "the initial conditions below it are beyond the momentum of the wheels"
        )

    def lack() -> tuple[str, str]:
        ratio = {name: study.outcome(name).given / study.outcome(name).asked for name in PAPER}
        verdict = "holds" if all(np.nanmedian(r) < 1 for r in ratio.values()) else "does not hold"
        text = ", ".join(
            f"{name} {np.nanmedian(r):.2f} ({np.nanquantile(r, 0.05):.2f} to {np.nanquantile(r, 0.95):.2f})"
            for name, r in ratio.items()
        )
        return verdict, f"mean torque given over mean torque asked, median (5 to 95 %): {text}"

    return [
        ("SDRE has a larger region of attraction than LQR", "section 5, figure 3; section 6", larger),
        ("Neither is globally asymptotically stable with these wheels", "section 5, figure 3", not_global),
        ("Both control the whole range of Euler angles", "section 5, figure 3", all_angles),
        ("No region of attraction reaches beyond |w0| = 0.0556 rad/s", "section 5", limit),
        ("The torque given is smaller than the torque computed", "section 5, figure 2", lack),
    ]


def drawings(study: Study) -> list[tuple[Figure, str]]:
    """Figures 1 to 3 of the paper, and the share that converges against the momentum bound."""
    size, rate = np.linalg.norm(study.drawn.angles, axis=1) / DEG, np.linalg.norm(study.drawn.rates, axis=1)
    plane = ("norm of the Euler angles, deg", "|w0|, rad/s")
    limit = [amazonia1.REGION_RATE_NORM]
    every = {"beyond the wheels": study.load > 1, "within their momentum": study.load <= 1}
    found = [(
        figures.scatter({"initial conditions": (size, rate, every)}, *plane, across=limit),
        "Initial conditions (figure 1), and those that the wheels can bring to rest at the desired attitude: "
        "|(A' J w0)_k| <= Is w_max for every axis. Dashed: the paper's limit.",
    )]  # fmt: skip
    torque, regions, bound = {}, {}, {}
    for name, flown in study.campaigns.items():
        o, i, feasible = study.outcome(name), flown.index, study.feasible(name)
        groups = {
            "beyond the wheels": ~o.slow & ~feasible, "not converged": ~o.slow & feasible,
            "rate only": o.slow & ~o.converged, "attitude and rate": o.converged,
        }  # fmt: skip
        torque[name] = (1e3 * o.asked, 1e3 * o.given, {"run": np.ones(len(i), bool)})
        regions[name] = (size[i], rate[i], groups)
        bound[name] = (study.load[i], rate[i], groups)
    found.append((figures.scatter(torque, "asked, mN m", "given, mN m", diagonal=True),
                  "Mean torque over a run, computed and actual (figure 2). Dashed: equal."))  # fmt: skip
    found.append((figures.scatter(regions, *plane, across=limit),
                  "Regions of attraction (figure 3), by both tests of convergence."))  # fmt: skip
    found.append(
        (
            figures.scatter(bound, "largest share of a wheel's momentum at rest", plane[1], up=[1.0]),
            "The same against momentum: right of the dashed line no controller can converge in attitude and rate.",
        )
    )
    shown = [name for name in PAPER if name in study.campaigns and study.complete]
    if shown:
        hits = {
            f"{name}, {label}": np.histogram(study.load[getattr(study.outcome(name), test)], BINS)[0]
            for name in shown
            for label, test in TESTS.items()
        }
        totals = np.histogram(study.load, BINS)[0]
        found.append((figures.shares(BINS, hits, totals, "largest share of a wheel's momentum at rest", up=[1.0]),
                      "Share of initial conditions that converge, with exact 95 % intervals."))  # fmt: skip
    return found


def write(study: Study, claims: list[report.Claim], out: Path, settings: str) -> Path:
    """Report and data into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    data: dict[str, Any] = {"angles": study.drawn.angles, "rates": study.drawn.rates, "momentum_load": study.load}
    for name, flown in study.campaigns.items():
        key = name.replace(", ", "_").lower()
        data |= {f"{key}_index": flown.index}
        data |= {f"{key}_{part}": getattr(study.outcome(name), part) for part in KEPT}
    np.savez_compressed(out / "region.npz", **data)
    tests = (
        f"Rate only: |w| <= {amazonia1.SLOW:g} rad/s over the last {amazonia1.TAIL:.0%} of {study.duration:g} s. "
        f"Attitude and rate: within {amazonia1.POINTED / DEG:g} deg of the desired attitude as well. The paper's own "
        "test, its eq. 15, is missing from the text we have. Intervals are exact (Clopper and Pearson)."
    )
    parts = [report.figure(fig, text, salt=f"region{k}") for k, (fig, text) in enumerate(drawings(study))]
    sections = [
        report.Section("What converges", report.table(HEADERS, rows(study)) + report.paragraph(tests)),
        report.Section("The paper's claims, measured", report.claims_table(claims)),
        report.Section("Figures 1 to 3", "".join(parts)),
        report.Section("Data", report.links([("region.npz", "initial conditions and outcomes, SI and radians")])),
    ]
    path = out / "report.html"
    page = report.page(
        "Amazonia-1: regions of attraction",
        "LQR and SDRE with wheels that saturate; after Romero and Souza (2022), doi 10.37394/23202.2022.21.9",
        sections,
        provenance(settings, study.complete, study.seconds),
    )
    path.write_text(page, encoding="utf-8")
    return path


def replay(chosen: Mapping[str, Any], index: int, seed: int, duration: float, out: Path) -> Path:
    """Fly one initial condition again with every controller, all rows kept, and plot it."""
    one = Dispersion(*(part[None] for part in amazonia1.disperse_region(seed, index)))
    start = amazonia1.starts(one)
    load = float(amazonia1.momentum_load(start)[0])
    series, lines = {}, []
    for name, controller in chosen.items():
        first = type(start)(*(part[0] for part in start))
        run = simulate.simulate(*amazonia1.manoeuvre(first, controller, duration=duration))
        found = measure(run)
        o = found.outcome
        verdict = "converges" if o.converged else "slow, but elsewhere" if o.slow else "does not converge"
        settled = f"settles after {o.settling_time:.0f} s" if o.settled else "never settles"
        lines.append(
            f"{name}: {verdict}; {o.angle / DEG:.3g} deg and {o.rate:.3g} rad/s at the end, "
            f"{settled}, turns {o.path / DEG:.0f} deg, {found.fallbacks} fallbacks"
        )
        norms = [np.linalg.norm(values, axis=1) for values in (run.outputs[:, 4:7], run.commands, run.inputs)]
        table = np.column_stack([amazonia1.angles(run) / DEG, norms[0], *norms[1:], run.states.wheels / RPM])
        series[name] = (run.time[::10], table[::10])
    labels = ("angle, deg", "|w|, rad/s", "asked, N m", "given, N m", *(f"wheel {a}, rpm" for a in "xyz"))
    text = [
        f"Euler angles {np.round(one.angles[0] / DEG, 2)} deg, rates {np.round(one.rates[0], 5)} rad/s",
        f"At rest the wheels would hold {load:.3f} of their momentum: "
        + ("within their limits" if load <= 1 else "beyond their limits"),
        *lines,
    ]
    print("\n".join(text))
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"replay_{index}.html"
    body = "".join(map(report.paragraph, text)) + report.figure(
        figures.histories(series, labels), f"Initial condition {index}, seed {seed}.", salt="replay"
    )
    settings = f"run {index}, seed {seed}, {duration:g} s flight"
    title = f"Amazonia-1: initial condition {index}"
    page = report.page(title, settings, [report.Section("Flown again", body)], provenance(settings, True, 0.0))
    path.write_text(page, encoding="utf-8")
    return path


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fast", action="store_true", help="100 s flights and 8 initial conditions: a quick look")
    parser.add_argument("--runs", type=int, default=400, help="initial conditions (default 400)")
    parser.add_argument("--seed", type=int, default=0, help="of the initial conditions (default 0)")
    parser.add_argument("--out", type=Path, default=Path("out/amazonia1_region"), help="folder for report and data")
    parser.add_argument("--replay", type=int, metavar="INDEX", help="fly one initial condition again and plot it")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs {options.runs}: at least one run is needed")
    for name in ("seed", "replay"):
        if (getattr(options, name) or 0) < 0:
            parser.error(f"--{name} {getattr(options, name)}: give a whole number of at least 0")
    runs, duration = (min(options.runs, 8), 100.0) if options.fast else (options.runs, amazonia1.DURATION)
    built = controllers()
    chosen = {name: built[name] for name in NAMES}
    if options.replay is not None:
        print(f"page: {replay(chosen, options.replay, options.seed, duration, options.out)}")
        return 0
    started = time.perf_counter()
    drawn = amazonia1.region(runs, options.seed)
    study = Study(drawn, amazonia1.momentum_load(amazonia1.starts(drawn)), duration)
    try:
        fly(study, chosen, options.seed)
    except KeyboardInterrupt:
        print("interrupted: the report holds what was flown")
    study.seconds = time.perf_counter() - started
    print(report.text_table(HEADERS, rows(study)), end="\n\n")
    claims = judge(statements(study))
    for claim in claims:
        print(f"{claim.text}\n  {claim.verdict.upper()}: {claim.measured}")
    settings = f"{runs} initial conditions, seed {options.seed}, {duration:g} s flights"
    path = write(study, claims, options.out, settings)
    print(f"\nin all {time.perf_counter() - started:.0f} s; report: {path}")
    return 0 if study.complete else 130


if __name__ == "__main__":
    raise SystemExit(main())
