"""Amazonia-1: the Monte Carlo of Romero and Souza (CILAMCE 2022) with every controller, their claims measured.

SDRE and SDRE + H-infinity as the paper has them and as they are meant, LQR, PD and PID are flown from the same random
attitudes, rates and inertias, compared, and written up in an HTML report.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from amazonia1_worst import PERIOD as WORST_PERIOD
from amazonia1_worst import question

from plants import (
    Campaign,
    Loop,
    Scenario,
    Statement,
    Table,
    Verdict,
    amazonia1,
    clopper_pearson,
    draw,
    figures,
    report,
    study,
)
from plants.missions.amazonia1 import DEG, PERIOD, Outcome, Start
from plants.outcome import worst
from synth import (
    MrpModel,
    QuaternionModel,
    Sdre,
    SdreHinf,
    SdreHinfPaperLiteral,
    SdreHinfStatic,
    quaternion_lqr,
    quaternion_pd,
    quaternion_pid,
)

SDRE, MRP, LQR, PD, PID = "SDRE", "SDRE, MRP", "LQR", "PD", "PID"
LITERAL, STATIC, DYNAMIC = "SDRE + Hinf, as published", "SDRE + Hinf, static", "SDRE + Hinf, dynamic"
PAPER = (SDRE, LITERAL)  # figure 3
PUSH = 1e-3  # N m about each axis, our test of disturbance rejection
FREQUENCY, DAMPING, INTEGRAL_TIME = 0.04, 0.75, 120.0  # rad/s, 1, s: PD and PID with about the gains of the LQR
ROW = 1.0  # s between two rows that are kept
HEADERS = ("controller", "settled", "median, s", "max, s", "converged", "turned at most, deg",
           "mean torque, mN m", f"deg under {1e3 * PUSH:g} mN m", "fallbacks")  # fmt: skip


class Shared(NamedTuple):
    """What the runs of one controller have in common."""

    controller: Any  # its dt is the control period, s
    duration: float  # s


class Measured(NamedTuple):
    """What is kept of a run."""

    outcome: Outcome
    fallbacks: int  # samples in which no Riccati equation could be solved


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    duration: float  # s, of a flight
    campaigns: dict[str, Campaign] = field(default_factory=dict)

    def random(self, name: str) -> Outcome:
        """The runs of the Monte Carlo that have finished."""
        flown = self.campaigns[name]
        drawn = (flown.dispersed.torque == 0).all(axis=1)
        return Outcome(*(values[drawn] for values in flown.results.outcome))

    def pushed(self, name: str) -> float:
        """Angle that a constant torque leaves, deg."""
        flown = self.campaigns[name]
        return float(flown.results.outcome.angle[(flown.dispersed.torque != 0).any(axis=1)][0] / DEG)


def controllers(period: float = PERIOD) -> dict[str, Any]:
    """Q = 1 and R = 1 as the paper has it, for the nominal inertia without the spin of the rotors (eq. 22)."""
    inertia, dt = amazonia1.INERTIA - np.diag(amazonia1.WHEEL_INERTIA), period
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
    period = shared.controller.dt
    return amazonia1.manoeuvre(
        start, shared.controller, duration=shared.duration, period=period, keep_every=round(ROW / period)
    )


def measure(run: Any) -> Measured:
    """Outcome and the controller's own count of Riccati equations without solution."""
    return Measured(amazonia1.outcome(run), int(getattr(run.memory, "failures", 0)))


def fly(found: Study, controllers: dict[str, Any], runs: int, seed: int) -> None:
    """The Monte Carlo with every controller."""
    study.campaigns(
        case,
        starts(runs, seed),
        {name: Shared(controller, found.duration) for name, controller in controllers.items()},
        found.campaigns,
        measure=measure,
        read=amazonia1.applied,
        keep=dict.fromkeys(PAPER, range(runs + 1)),
        **found.flying,
    )


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


def statements(found: Study) -> list[Statement]:
    """The claims of the paper."""

    def settles(*names: str) -> Verdict:
        hits = [found.random(name).settled for name in names]
        text = "; ".join(f"{name} {share(h)}" for name, h in zip(names, hits, strict=True))
        return ("holds" if all(h.all() for h in hits) else "does not hold"), f"settled: {text}"

    def median(name: str) -> float:
        return float(np.median(found.random(name).settling_time))

    def times(*names: str) -> str:
        return ", ".join(f"{name} {median(name):.0f} s" for name in names)

    def slower() -> Verdict:
        slow = [median(name) > median(SDRE) for name in (LITERAL, STATIC, DYNAMIC)]
        verdict = "holds" if all(slow) else "depends on how steps 5 and 6 are read" if any(slow) else "does not hold"
        return verdict, f"median: {times(SDRE, LITERAL, STATIC, DYNAMIC)}"

    def rejects() -> Verdict:
        better = found.pushed(LITERAL) < found.pushed(SDRE)
        text = ", ".join(f"{name} {found.pushed(name):.3f}" for name in (SDRE, LITERAL, STATIC, DYNAMIC))
        verdict = "holds" if better else "does not hold"
        return verdict, f"angle left by {1e3 * PUSH:g} mN m about each axis, deg: {text}"

    def stabilisable() -> Verdict:
        here = np.array([1.0, 0, 0, 0])
        rest = out_of_reach(*printed_pair(here, np.zeros(3)))
        slow = out_of_reach(*printed_pair(here, np.full(3, 1e-4)))
        verdict = "holds" if rest > 1e-12 else "does not hold"
        return verdict, f"distance to a pair that is not: {rest:.1g} at rest, {slow:.1g} at 1e-4 rad/s about each axis"

    def linear(other: str) -> Verdict:
        a, b = found.random(SDRE), found.random(other)
        better = [a.settled.sum() > b.settled.sum(), median(SDRE) < median(other), a.given.mean() < b.given.mean()]
        verdict = "holds" if all(better[1:]) else "depends on the index" if any(better) else "does not hold"
        text = ", ".join(
            f"{name} {o.settled.sum()} settled, mean torque {1e3 * o.given.mean():.1f} mN m, "
            f"turned {o.path.max() / DEG:.0f} deg at most"
            for name, o in ((SDRE, a), (other, b))
        )
        return verdict, f"median {times(SDRE, other)}; {text}"

    return [
        Statement("SDRE is robust to +-20 % in the inertia", "abstract, section 5", lambda: settles(SDRE)),
        Statement("SDRE + Hinf is robust to +-20 % in the inertia", "section 5",
                  lambda: settles(LITERAL, STATIC, DYNAMIC)),
        Statement("SDRE + Hinf uses more time than SDRE to stabilise", "section 5, figure 3", slower),
        Statement("It is slower because it rejects disturbances better", "section 6, as a conjecture", rejects),
        Statement("Equation 26 is pointwise stabilisable", "section 4.1", stabilisable),
        Statement("SDRE performs better than PID", "section 1", lambda: linear(PID)),
        Statement("Nonlinear control performs better than linear", "abstract", lambda: linear(LQR)),
    ]  # fmt: skip


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


def cards(found: Study, built: dict[str, Any]) -> list[report.Card]:
    """Every controller at a glance."""
    made = []
    for name, controller in built.items():
        facts = {"law": type(controller).__name__, "sampling time": f"{controller.dt:g} s"}
        if hasattr(controller, "gamma_factor"):
            facts["level over the optimal one"] = f"{controller.gamma_factor:g}"
        if hasattr(controller, "model"):
            facts["factorisation"] = type(controller.model).__name__
        if hasattr(controller, "model") and name in found.campaigns:
            facts["samples without solution"] = str(found.campaigns[name].results.fallbacks.sum())
        made.append(report.Card(name, [*facts.items()]))
    return made


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "600 s flights, 4 runs, no search for the worst"
    options = study.parse(study.parser(__doc__, out="out/amazonia1", fast=fast, runs=100), arguments)
    runs, duration = (min(options.runs, 4), 600.0) if options.fast else (options.runs, amazonia1.DURATION)
    found, built = Study(duration), controllers()

    def flights() -> None:
        fly(found, built, runs, options.seed)
        if not options.fast:
            asked = question(controllers(WORST_PERIOD)[LQR], draw(amazonia1.disperse, runs, options.seed))
            worst.ask(asked, found.worst, seed=options.seed)

    study.carry_out(found, flights, options)
    return study.conclude(
        found,
        options.out,
        title="Amazonia-1: SDRE under parametric uncertainty",
        subtitle="SDRE, SDRE + H-infinity, LQR, PD and PID in one nonlinear simulator; after Romero and Souza, "
        "CILAMCE 2022",
        tables=[table(found), *worst.tables(found.worst)],
        statements=statements(found),
        cards=cards(found, built),
        sections=[drawings(found)],
        settings=f"{runs} runs, seed {options.seed}, {duration:g} s flights",
    )


if __name__ == "__main__":
    raise SystemExit(main())
