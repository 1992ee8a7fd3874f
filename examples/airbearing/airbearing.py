"""Air-bearing simulator: LQR, SDRE and Kalman filter on large slews with noise, the claims of the paper measured.

Counterparts of figures 2 to 6, the series of ever larger slews, torque limits, another inertia, margins, and what a
0.1 s hold makes of gains that were computed for continuous time. The opponent that the paper does not fly is the
constant gain on the exact kinematics. What the paper is, and how it was read: `plants.missions.airbearing`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from airbearing_box import MODEL, QUANTITY, WHOSE, questions
from airbearing_claims import SIMILAR, TITLE, counterparts, findings, gain_change, statements, summary
from airbearing_flights import (
    DIFFERENCE,
    DURATION,
    EXACT,
    FILTER,
    FILTER_ANGLES,
    LARGE,
    LAWS,
    LQR,
    NAIVE,
    NO_RATE,
    NOISY,
    SDRE,
    STEPS,
    Study,
    case,
    cases,
    configurations,
    inverse,
    linear,
)
from airbearing_margins import everywhere
from airbearing_worst import question
from matplotlib.figure import Figure

import synth
from plants import Table, airbearing, blocks, draw, figures, report, study
from plants.missions.airbearing import DEG, INERTIA_SPREAD, PERIOD, TAIL, TARGET, TORQUE_LIMITS, Outcome, Q, R
from plants.outcome import boxes, intersample, worst
from synth import ExportError, export, lqr, lqrd, state_feedback
from synth.regulators.regulator import sampled_cost

GLANCE = 100  # deg of roll, of the slew that says most
DRAWS = 100  # of the Monte Carlo beside the worst flight
AXES = ("roll, deg", "pitch, deg", "yaw, deg")
ABBREVIATIONS = {
    "SDRE": "state-dependent Riccati equation: a regulator designed anew in every sample",
    "LQR": "linear-quadratic regulator, designed at angles zero",
    "E^-1": "matrix that turns rates of the Euler angles into rates of the body",
    "rms": "root of the mean square",
}  # fmt: skip
__all__ = ["SIMILAR", "gain_change", "inverse"]


def fly(found: Study, duration: float, runs: int, seed: int) -> None:
    """Every case with every configuration; the laws with another inertia; SDRE on a small, a usual and a large slew."""
    configured, common = configurations(duration), {"measure": airbearing.outcome, "seed": seed}
    common |= {"workers": 1, **found.flying}
    keep: dict[str, Any] = {name: (0, NOISY) for name in configured}
    keep |= {name: range(NOISY + 1) for name in LAWS}
    study.campaigns(case, cases(runs, seed), configured, found.campaigns, keep=keep, **common)
    flown: dict[str, Any] = {}
    names = {f"{name}, other inertia": name for name in LAWS}
    shared = {long: configured[name] for long, name in names.items()}
    study.campaigns(case, draw(airbearing.disperse, runs, seed), shared, flown, **common)
    found.dispersed |= {name: flown[long] for long, name in names.items()}
    for name, target in STEPS.items():
        one = {f"{SDRE}, {name} slew": configured[SDRE]}
        noisy = [airbearing.case(target, noise=1.0, seed=seed + index) for index in range(runs)]
        study.campaigns(case, blocks.join([airbearing.case(target), *noisy]), one, flown, **common)
        found.steps[name] = flown[next(iter(one))]
    found.margins |= everywhere()


def spelled(values: np.ndarray, form: str) -> str:
    """Roll / pitch / yaw."""
    return " / ".join(format(v, form) if np.isfinite(v) else "never" for v in values)


def slews(found: Study) -> Table:
    """LQR and SDRE without noise."""
    rows = []
    for k, limit in enumerate(TORQUE_LIMITS):
        for name in LAWS:
            if name in found.campaigns and k < len(found.campaigns[name].index):
                o, wheels = found.one(name, k), "unlimited" if np.isinf(limit) else f"{limit:g} N m"
                rows.append(
                    (name, wheels, spelled(o.settling, ".1f"), spelled(100 * o.overshoot, ".2f"), f"{o.peak:.2f}")
                )
    return Table(
        "Slew to (50, 20, -30) deg without noise",
        ("controller", "wheels", "settling, s", "overshoot, %", "peak torque, N m"),
        rows,
        note=f"Roll / pitch / yaw; settled: within {airbearing.SETTLED:.0%} of the step to the end of the run.",
    )


def larger(found: Study) -> Table:
    """The last angle's settling time against the slew."""
    targets = {0: TARGET} | {len(TORQUE_LIMITS) + k: target for k, target in enumerate(LARGE)}
    names = [n for n in (*LAWS, FILTER) if n in found.campaigns and len(found.campaigns[n].index) >= NOISY]
    rows = [
        (str(tuple(round(float(a)) for a in target / DEG)), *(found.fate(name, k) for name in names))
        for k, target in targets.items()
    ]
    return Table(
        "Larger slews without noise", ("target, deg", *names), rows,
        note="When the last angle has settled. The filter is that for the paper's noise.",
    )  # fmt: skip


def steady(found: Study) -> Table:
    """What noise leaves."""
    rows = []
    for name in (*LAWS, DIFFERENCE, NO_RATE, FILTER, FILTER_ANGLES):
        if name not in found.campaigns or len(found.campaigns[name].index) <= NOISY:
            continue
        error, torque, lost = pooled(found, name)
        free, flown = found.fate(name, 0), found.campaigns[name].ok[NOISY:]
        rows.append((name, free, f"{len(flown) - lost}/{len(flown)}", f"{error:.3f}", f"{torque:.2g}"))
    return Table(
        "Slew with noise",
        ("configuration", "settles without noise", "sound with noise", "rms error, deg", "rms torque, N m"),
        rows, note=f"Rms over the sound runs and the axes from {TAIL:g} s on.",
    )  # fmt: skip


def pooled(found: Study, name: str) -> tuple[float, float, int]:
    """Rms error (deg) and rms torque (N m) over the sound noisy runs, and how many were lost."""
    o = found.noisy(name)
    sound = np.isfinite(o.torque)
    if not sound.any():
        return np.inf, np.inf, len(sound)
    error, torque = np.sqrt(np.mean(o.error[sound] ** 2)), np.sqrt(np.mean(o.torque[sound] ** 2))
    return float(error / DEG), float(torque), int((~sound).sum())


def inertia(found: Study) -> Table:
    """What another inertia does to the slew."""
    rows = []
    for name, flown in found.dispersed.items():
        times = np.asarray(Outcome(*flown.results).slowest)
        settled = np.isfinite(times)
        spread = f"{np.median(times):.1f} / {times.max():.1f}" if settled.all() else "never"
        rows.append((name, f"{settled.sum()}/{len(times)}", found.fate(name, 0), spread))
    return Table(
        "Slew with noise and another inertia",
        ("controller", "settled", "nominal, no noise", "settling, median / max, s"), rows,
        note=f"Each moment by up to {INERTIA_SPREAD:.0%}; the controllers keep the nominal ones.",
    )  # fmt: skip


def locally(found: Study) -> Table:
    """Margins at rest at the target."""
    rows = [
        (name, "zero" if np.isnan(roll) else f"{roll:.0f}", f"{m.radius:.4f}", *(
            ("unstable",) * 4 if m.radius >= 1 else
            (f"{m.gain:.2f}", f"{m.phase:.1f}", f"{1e3 * m.delay:.0f}", f"{m.disk:.2f}")
        ))
        for name, loops in found.margins.items() for roll, m in loops.items()
    ]  # fmt: skip
    return Table(
        "Loops at rest at the target",
        ("controller", "roll of the target, deg", "spectral radius", "gain, dB", "phase, deg", "delay, ms", "disk, dB"),
        rows,
        note=f"Sampled at {PERIOD:g} s; pitch and yaw of the paper's target. Margins at the wheels, smallest of one "
        "wheel at a time; the disk is of all three at once.",
    )


def held(found: Study) -> Table:
    """Continuous and sampled gains under a hold."""
    A, B = linear()
    K, rows = lqr(A, B, Q, R)[0], []
    for period in (0.002, 0.005, 0.007, 0.01, PERIOD):
        radii = []
        for gain in (K, lqrd(A, B, Q, R, period)[0]):
            F, G, *_ = sampled_cost(A, B, Q, R, period)
            radii.append(f"{np.abs(np.linalg.eigvals(F - G @ gain)).max():.4f}")
        rows.append((f"{period:g}", *radii))
    flown = ""
    if NAIVE in found.campaigns and len(found.campaigns[NAIVE].index) > 1:
        flown = f" Flown at {PERIOD:g} s, it {found.fate(NAIVE, 0)}; with wheels of {TORQUE_LIMITS[1]:g} N m it ends "
        flown += f"in a chatter of {found.one(NAIVE, 1).torque:.2g} N m rms."
    return Table(
        "Warning: gains of continuous time, held", ("period, s", "of continuous time", "of sampled data"), rows,
        note="Spectral radius of the LQR loop at rest; above 1 it is unstable. The continuous loop has poles near -270 "
        f"and -280 rad/s.{flown}",
    )  # fmt: skip


def lines(found: Study, shown: dict[str, tuple[str, int]]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Angles (deg) over time: label -> (configuration, run)."""
    flown = {label: found.campaigns[n].kept.get(k) for label, (n, k) in shown.items() if n in found.campaigns}
    return {label: (run.time, run.outputs[:, :3] / DEG) for label, run in flown.items() if run is not None}


def glance(found: Study) -> tuple[Figure, str] | None:
    """The slew from which LQR never arrives, with the three laws."""
    k = len(TORQUE_LIMITS) + [round(t[0] / DEG) for t in LARGE].index(GLANCE)
    target = LARGE[k - len(TORQUE_LIMITS)] / DEG
    series = {
        name: (time, np.abs(angles - target).max(axis=1, keepdims=True))
        for name, (time, angles) in lines(found, {name: (name, k) for name in LAWS}).items()
    }
    if not series:
        return None
    return figures.histories(series, ["largest error, deg"], until=DURATION / 2, scale="log"), (
        f"Largest error of an angle on the slew to {spelled(target, '.0f')} deg. LQR takes Euler rates for body rates; "
        "the same gain on E^-1 does not."
    )


def cards(out: Path, duration: float) -> list[report.Card]:
    """The laws, and the constant gain in C."""
    gain = state_feedback(configurations(duration)[LQR].gain[:, :6], PERIOD)
    made = export(gain, "c", out, name="lqr", force=True)
    try:
        made += export(gain, "fmu3", out, name="lqr", force=True)
    except ExportError as error:
        print(f"no FMU: {error}")
    kinds = {".c": "the gain in C", ".h": "its header", ".fmu": "FMU 3.0"}
    files = [(path.name, kinds[path.suffix]) for path in made]
    facts = [("sampling time", f"{PERIOD:g} s"), ("weights", "Q = diag(1, 1, 1, 100, 100, 100), R = 0.001")]
    return [
        report.Card(LQR, [("law", "constant gain"), *facts], files),
        report.Card(EXACT, [("law", "the same gain"), *facts], files, "Give it E(angles)^-1 times the angles' error."),
        report.Card(SDRE, [("law", "Riccati equation in every sample"), *facts]),
    ]


def pictures(found: Study) -> list[report.Section]:
    """Counterparts of figures 2 to 6, and the larger slews."""

    first = len(TORQUE_LIMITS)
    drawn = [
        ("Figure 2: LQR and SDRE without noise.", {LQR: (LQR, 0), SDRE: (SDRE, 0)}, 80.0),
        ("Figure 3: without noise, only angles fed back.",
         {"all states": (SDRE, 0), "differences": (DIFFERENCE, 0)}, 80.0),
        ("Figure 3 in the other reading, no rate at all; the line ends at the singularity.",
         {"no rate": (NO_RATE, 0)}, 80.0),
        ("Figure 4: all states, with noise.", {"without": (SDRE, 0), "with noise": (SDRE, NOISY)}, 80.0),
        ("Figure 5: with noise, only angles fed back.",
         {"differences": (DIFFERENCE, NOISY)}, 80.0),
        ("Figure 6: with noise and Kalman filter.",
         {"angles and rates": (FILTER, NOISY), "angles alone": (FILTER_ANGLES, NOISY)}, 80.0),
        ("LQR on larger slews; lines that end have met the singularity.",
         {f"{t[0] / DEG:.0f} deg": (LQR, first + k) for k, t in enumerate(LARGE)}, DURATION),
        ("SDRE on larger slews.", {f"{t[0] / DEG:.0f} deg": (SDRE, first + k) for k, t in enumerate(LARGE)}, 80.0),
        ("LQR's gain on E^-1 on larger slews.",
         {f"{t[0] / DEG:.0f} deg": (EXACT, first + k) for k, t in enumerate(LARGE)}, 80.0),
    ]  # fmt: skip
    series = [(caption, lines(found, shown), until) for caption, shown, until in drawn]
    noisy = lines(found, {n: (n, NOISY) for n in (DIFFERENCE, SDRE, FILTER)})
    late = {n: (t[t >= TAIL], (angles - TARGET / DEG)[t >= TAIL]) for n, (t, angles) in noisy.items()}
    series.insert(6, ("Figures 4 to 6: the error that remains.", late, DURATION))
    return [study.drawings("Figures", [(figures.histories(s, AXES, until=u), c) for c, s, u in series if s])]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "120 s flights, 2 runs with noise, no search for the worst, no proofs"
    options = study.parse(
        study.parser(__doc__, out="out/airbearing", fast=fast, runs=31, what="runs with noise"), arguments
    )
    runs, duration = (min(options.runs, 2), 120.0) if options.fast else (options.runs, DURATION)
    found = Study()

    def flights() -> None:
        fly(found, duration, runs, options.seed)
        if not options.fast:
            controller = state_feedback(configurations(duration)[LQR].gain, PERIOD)
            worst.ask(question(controller, DRAWS, options.seed), found.worst, seed=options.seed)
            boxes.ask(questions(), found.boxes, synth)

    study.carry_out(found, flights, options)
    tables = [slews(found), larger(found), locally(found), inertia(found), steady(found), held(found)]
    return study.conclude(
        found,
        options.out,
        title="Air-bearing simulator: SDRE with a Kalman filter",
        subtitle="LQR and SDRE on large slews of a three-axis satellite simulator; after the SDRE and Kalman filter "
        "study of INPE's Space Mechanics and Control Division",
        tables=[
            *tables,
            *worst.tables(found.worst),
            *boxes.tables(found.boxes, options.out, quantity=QUANTITY, model=MODEL),
            *intersample.tables([a.question for a in found.boxes], synth, quantity=QUANTITY),
        ],
        statements=statements(found),
        counterparts=counterparts(),
        paper=TITLE,
        summary=summary(found),
        abbreviations=ABBREVIATIONS,
        first=glance(found),
        sections=pictures(found),
        findings=[*findings(found), *boxes.findings(found.boxes, WHOSE)],
        cards=cards(options.out, duration),
        settings=f"{runs} runs with noise, seed {options.seed}, {duration:g} s flights, {PERIOD:g} s period",
    )


if __name__ == "__main__":
    raise SystemExit(main())
