"""Amazonia-1: the Monte Carlo of Romero and Souza (CILAMCE 2022) with every controller, their claims measured.

SDRE and SDRE + H-infinity as the paper has them and as they are meant, LQR, PD and PID are flown from the same random
attitudes, rates and inertias, compared, and written up in an HTML report.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from plants import amazonia1, campaign, figures, report
from plants.amazonia1 import DEG, Outcome, Start
from plants.indices import clopper_pearson
from plants.loop import Loop, Scenario
from synth.quaternion import quaternion_lqr, quaternion_pd, quaternion_pid
from synth.sdc import MrpModel, QuaternionModel
from synth.sdre import Sdre, SdreHinf, SdreHinfPaperLiteral, SdreHinfStatic

SDRE, MRP, LQR, PD, PID = "SDRE", "SDRE, MRP", "LQR", "PD", "PID"
LITERAL, STATIC, DYNAMIC = "SDRE + Hinf, as published", "SDRE + Hinf, static", "SDRE + Hinf, dynamic"
PAPER = (SDRE, LITERAL)  # figure 3
PUSH = 1e-3  # N m about each axis, our test of disturbance rejection
FREQUENCY, DAMPING, INTEGRAL_TIME = 0.04, 0.75, 120.0  # rad/s, 1, s: PD and PID with about the gains of the LQR
ROW = 20  # control periods between two rows that are kept: 1 s
HEADERS = ("controller", "settled", "median, s", "max, s", "converged", "turned at most, deg",
           "mean torque, mN m", f"deg under {1e3 * PUSH:g} mN m", "fallbacks")  # fmt: skip


class Shared(NamedTuple):
    """What the runs of one controller have in common."""

    controller: Any
    duration: float  # s


class Measured(NamedTuple):
    """What is kept of a run."""

    outcome: Outcome
    fallbacks: int  # samples in which no Riccati equation could be solved


@dataclass
class Study:
    """What has been measured so far; complete unless interrupted."""

    duration: float  # s, of a flight
    campaigns: dict[str, campaign.Campaign] = field(default_factory=dict)
    complete: bool = False
    seconds: float = 0.0

    def random(self, name: str) -> Outcome:
        """The runs of the Monte Carlo that have finished."""
        flown = self.campaigns[name]
        drawn = (flown.dispersed.torque == 0).all(axis=1)
        return Outcome(*(values[drawn] for values in flown.results.outcome))

    def pushed(self, name: str) -> float:
        """Angle that a constant torque leaves, deg."""
        flown = self.campaigns[name]
        return float(flown.results.outcome.angle[(flown.dispersed.torque != 0).any(axis=1)][0] / DEG)


def controllers() -> dict[str, Any]:
    """Q = 1 and R = 1 as the paper has it, for the nominal inertia without the spin of the rotors (eq. 22)."""
    inertia, dt = amazonia1.INERTIA - np.diag(amazonia1.WHEEL_INERTIA), amazonia1.PERIOD
    gibbs = QuaternionModel.create(inertia)  # eq. 26
    return {
        SDRE: Sdre.create(gibbs, dt),
        MRP: Sdre.create(MrpModel.create(inertia), dt),
        LITERAL: SdreHinfPaperLiteral.create(gibbs, dt),
        STATIC: SdreHinfStatic.create(gibbs, dt),
        DYNAMIC: SdreHinf.create(gibbs, dt),
        LQR: quaternion_lqr(inertia, dt),
        PD: quaternion_pd(inertia, FREQUENCY, DAMPING, dt),
        PID: quaternion_pid(inertia, FREQUENCY, DAMPING, dt, integral_time=INTEGRAL_TIME),
    }


def starts(runs: int, seed: int) -> Start:
    """A run from rest under a constant torque, then the `runs` of the Monte Carlo."""
    drawn = amazonia1.monte_carlo(runs, seed)
    pushed = Start(np.diag(amazonia1.INERTIA), np.array([1.0, 0, 0, 0]), np.zeros(3), np.full(3, PUSH))
    return Start(*(np.concatenate([one[None], many]) for one, many in zip(pushed, drawn, strict=True)))


def case(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    return amazonia1.manoeuvre(start, shared.controller, duration=shared.duration, keep_every=ROW)


def measure(run: Any) -> Measured:
    """Outcome and the controller's own count of Riccati equations without solution."""
    return Measured(amazonia1.outcome(run), int(getattr(run.memory, "failures", 0)))


def fly(study: Study, controllers: Mapping[str, Any], runs: int, seed: int) -> None:
    """The Monte Carlo with every controller; what has finished stays in the study."""
    drawn = starts(runs, seed)
    with tqdm(total=len(controllers) * (runs + 1), desc="runs", delay=2.0) as bar:
        for done, (name, controller) in enumerate(controllers.items()):

            def advanced(finished: int, before: int = done * (runs + 1)) -> None:
                bar.update(before + finished - bar.n)

            flown = campaign.campaign(
                case,
                drawn,
                Shared(controller, study.duration),
                measure=measure,
                read=amazonia1.applied,
                keep=range(runs + 1) if name in PAPER else (),
                progress=False,
                on_batch=advanced,
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
        o = study.random(name)
        n, times = len(o.settling_time), o.settling_time[o.settled]
        middle, last = (f"{np.median(times):.0f}", f"{times.max():.0f}") if len(times) else ("never", "never")
        table.append([
            name, f"{len(times)}/{n}", middle, last, f"{o.converged.sum()}/{n}", f"{o.path.max() / DEG:.0f}",
            f"{1e3 * o.given.mean():.1f}", f"{study.pushed(name):.3f}", str(flown.results.fallbacks.sum()),
        ])  # fmt: skip
    return table


def share(hits: np.ndarray) -> str:
    """How many, and how many it may be in truth."""
    low, high = clopper_pearson(int(hits.sum()), len(hits))
    return f"{hits.sum()}/{len(hits)} (95 %: {low:.3f} to {high:.3f})"


def printed_pair(q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B of eq. 26 with all seven states, wheels at rest; q scalar first."""
    Ib = amazonia1.INERTIA - np.diag(amazonia1.WHEEL_INERTIA)
    W = np.cross(np.eye(3), -w)
    A, B = np.zeros((7, 7)), np.vstack([np.zeros((4, 3)), -np.linalg.inv(Ib)])
    A[:3, :3], A[3, :3], A[:3, 4:] = -0.5 * W, -0.5 * w, 0.5 * q[0] * np.eye(3)
    A[4:, 4:] = -np.linalg.solve(Ib, W @ Ib)
    return A, B


def out_of_reach(A: np.ndarray, B: np.ndarray) -> float:
    """Smallest singular value of [A - s I, B] over the modes s that do not decay: zero if one cannot be stabilised."""
    modes = [s for s in np.linalg.eigvals(A) if s.real > -1e-9]
    return min(np.linalg.svd(np.hstack([A - s * np.eye(len(A)), B]), compute_uv=False)[-1] for s in modes)


def statements(study: Study) -> list[tuple[str, str, Callable[[], tuple[str, str]]]]:
    """(claim, where it stands, how it is judged)."""

    def settles(*names: str) -> tuple[str, str]:
        hits = [study.random(name).settled for name in names]
        text = "; ".join(f"{name} {share(h)}" for name, h in zip(names, hits, strict=True))
        return ("holds" if all(h.all() for h in hits) else "does not hold"), f"settled: {text}"

    def median(name: str) -> float:
        return float(np.median(study.random(name).settling_time))

    def times(*names: str) -> str:
        return ", ".join(f"{name} {median(name):.0f} s" for name in names)

    def slower() -> tuple[str, str]:
        found = [median(name) > median(SDRE) for name in (LITERAL, STATIC, DYNAMIC)]
        verdict = "holds" if all(found) else "depends on how steps 5 and 6 are read" if any(found) else "does not hold"
        return verdict, f"median: {times(SDRE, LITERAL, STATIC, DYNAMIC)}"

    def rejects() -> tuple[str, str]:
        better = study.pushed(LITERAL) < study.pushed(SDRE)
        text = ", ".join(f"{name} {study.pushed(name):.3f}" for name in (SDRE, LITERAL, STATIC, DYNAMIC))
        verdict = "holds" if better else "does not hold"
        return verdict, f"angle left by {1e3 * PUSH:g} mN m about each axis, deg: {text}"

    def stabilisable() -> tuple[str, str]:
        here = np.array([1.0, 0, 0, 0])
        rest = out_of_reach(*printed_pair(here, np.zeros(3)))
        slow = out_of_reach(*printed_pair(here, np.full(3, 1e-4)))
        verdict = "holds" if rest > 1e-12 else "does not hold"
        return verdict, f"distance to a pair that is not: {rest:.1g} at rest, {slow:.1g} at 1e-4 rad/s about each axis"

    def linear(other: str) -> tuple[str, str]:
        a, b = study.random(SDRE), study.random(other)
        better = [a.settled.sum() > b.settled.sum(), median(SDRE) < median(other), a.given.mean() < b.given.mean()]
        verdict = "holds" if all(better[1:]) else "depends on the index" if any(better) else "does not hold"
        text = ", ".join(
            f"{name} {o.settled.sum()} settled, mean torque {1e3 * o.given.mean():.1f} mN m, "
            f"turned {o.path.max() / DEG:.0f} deg at most"
            for name, o in ((SDRE, a), (other, b))
        )
        return verdict, f"median {times(SDRE, other)}; {text}"

    return [
        ("SDRE is robust to +-20 % in the inertia", "abstract, section 5", lambda: settles(SDRE)),
        ("SDRE + Hinf is robust to +-20 % in the inertia", "section 5", lambda: settles(LITERAL, STATIC, DYNAMIC)),
        ("SDRE + Hinf uses more time than SDRE to stabilise", "section 5, figure 3", slower),
        ("It is slower because it rejects disturbances better", "section 6, as a conjecture", rejects),
        ("Equation 26 is pointwise stabilisable", "section 4.1", stabilisable),
        ("SDRE performs better than PID", "section 1", lambda: linear(PID)),
        ("Nonlinear control performs better than linear", "abstract", lambda: linear(LQR)),
    ]  # fmt: skip


def judge(found: list[tuple[str, str, Callable[[], tuple[str, str]]]]) -> list[report.Claim]:
    """Every claim with its verdict; those whose runs are missing are "not measured"."""
    claims = []
    for text, source, decide in found:
        try:
            verdict, measured = decide()
        except (KeyError, IndexError) as missing:
            verdict, measured = "not measured", f"interrupted before {missing.args[0]}"
        claims.append(report.Claim(text, source, verdict, measured))
    return claims


def drawings(study: Study) -> str:
    """Counterpart of figure 3, and the settling times."""
    parts, labels = [], ("q1", "q2", "q3", "wx, rad/s", "wy, rad/s", "wz, rad/s")
    for letter, name in zip("ab", PAPER, strict=True):
        if name not in study.campaigns:
            continue
        runs = [r for i, r in study.campaigns[name].kept.items() if i > 0]
        lines = [(r.time, r.outputs[:, 1:7] * np.r_[np.full(3, np.sign(r.outputs[-1, 0])), np.ones(3)]) for r in runs]
        fig = figures.spread(lines, labels, until=study.duration)
        parts.append(report.figure(fig, f"{name}: all runs (figure 3{letter}). Signs of q by its end.", salt=name))
    return "".join(parts)


def provenance(settings: str, complete: bool, seconds: float) -> list[str]:
    """What a report was made with."""
    versions = ", ".join(f"{n} {metadata.version(n)}" for n in ("convex-synth", "jax", "numpy", "scipy"))
    state = "complete" if complete else "INTERRUPTED: what was flown until then"
    return [f"{settings}; {state}; {seconds:.0f} s", f"Python {platform.python_version()}, {versions}"]


def write(study: Study, controllers: Mapping[str, Any], claims: list[report.Claim], out: Path, settings: str) -> Path:
    """The report into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    rules = (
        f"Settled: below {amazonia1.SETTLED_ANGLE / DEG:g} deg and {amazonia1.SETTLED_RATE:g} rad/s to the end. "
        f"Converged: below {amazonia1.POINTED / DEG:g} deg and {amazonia1.SLOW:g} rad/s over the last "
        f"{amazonia1.TAIL:.0%} of {study.duration:g} s. Both on a grid of {ROW * amazonia1.PERIOD:g} s."
    )
    sections = [
        report.Section("Controllers", report.table(HEADERS, rows(study)) + report.paragraph(rules)),
        report.Section("The paper's claims, measured", report.claims_table(claims)),
        report.Section("Figure 3", drawings(study)),
        report.Section("Settings", report.table(("controller", "as"), [(n, repr(c)) for n, c in controllers.items()])),
    ]
    path = out / "report.html"
    page = report.page(
        "Amazonia-1: SDRE under parametric uncertainty",
        "SDRE, SDRE + H-infinity, LQR, PD and PID in one nonlinear simulator; after Romero and Souza, CILAMCE 2022",
        sections,
        provenance(settings, study.complete, study.seconds),
    )
    path.write_text(page, encoding="utf-8")
    return path


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fast", action="store_true", help="600 s flights and 4 runs: a quick look")
    parser.add_argument("--runs", type=int, default=100, help="runs of the Monte Carlo (default 100)")
    parser.add_argument("--seed", type=int, default=0, help="of the dispersions (default 0)")
    parser.add_argument("--out", type=Path, default=Path("out/amazonia1"), help="folder for the report")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs {options.runs}: at least one run is needed")
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: give a whole number of at least 0")
    runs, duration = (min(options.runs, 4), 600.0) if options.fast else (options.runs, amazonia1.DURATION)
    started = time.perf_counter()
    study, all_controllers = Study(duration), controllers()
    try:
        fly(study, all_controllers, runs, options.seed)
    except KeyboardInterrupt:
        print("interrupted: the report holds what was flown")
    study.seconds = time.perf_counter() - started
    print(report.text_table(HEADERS, rows(study)), end="\n\n")
    claims = judge(statements(study))
    for claim in claims:
        print(f"{claim.text}\n  {claim.verdict.upper()}: {claim.measured}")
    settings = f"{runs} runs, seed {options.seed}, {duration:g} s flights"
    path = write(study, all_controllers, claims, options.out, settings)
    print(f"\nin all {time.perf_counter() - started:.0f} s; report: {path}")
    return 0 if study.complete else 130


if __name__ == "__main__":
    raise SystemExit(main())
