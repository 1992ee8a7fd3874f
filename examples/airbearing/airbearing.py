"""Air-bearing simulator: LQR, SDRE and Kalman filter on large slews with noise, the claims of the paper measured.

Counterparts of figures 2 to 6, the series of ever larger slews, torque limits, and what a 0.1 s hold makes of gains
that were computed for continuous time. What the paper is, and how it was read: `plants.missions.airbearing`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from airbearing_worst import question

from plants import Campaign, Loop, Run, Scenario, Statement, Table, Verdict, airbearing, blocks, figures, report, study
from plants.missions.airbearing import (
    DEG,
    INERTIA,
    LARGE_ROLLS,
    PERIOD,
    TAIL,
    TARGET,
    TORQUE_LIMITS,
    Case,
    Outcome,
    Q,
    R,
)
from plants.outcome import worst
from synth import EulerModel, SdreSampled, lqr, lqrd, state_feedback
from synth.regulators.regulator import sampled_cost
from synth.regulators.sdre import sampled_gain

LQR, SDRE, NAIVE = "LQR", "SDRE", "LQR, continuous gain held"
DIFFERENCE, NO_RATE = "SDRE, angles and their differences", "SDRE, angles alone"
FILTER, FILTER_ANGLES = "SDRE, Kalman filter", "SDRE, Kalman filter of angles alone"
DURATION = 200.0  # s
SIMILAR = 1.1  # largest ratio of settling times that counts as "the same" or "similar"
LARGE = [np.array([roll * DEG, TARGET[1], TARGET[2]]) for roll in LARGE_ROLLS if roll * DEG != TARGET[0]]
DRAWS = 100  # of the Monte Carlo beside the worst flight
NOISY = len(TORQUE_LIMITS) + len(LARGE)  # index of the first run with noise
AXES = ("roll, deg", "pitch, deg", "yaw, deg")


class Shared(NamedTuple):
    """What the runs of one configuration have in common."""

    gain: Any  # (3, 9) of a fixed law, or None for the SDRE of the run's target
    navigator: Any
    duration: float  # s


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    campaigns: dict[str, Campaign] = field(default_factory=dict)

    def one(self, name: str, index: int = 0) -> Outcome:
        """One run of a configuration."""
        return Outcome(*(values[index] for values in self.campaigns[name].results))

    def noisy(self, name: str) -> Outcome:
        """Its runs with noise."""
        if not len(self.campaigns[name].index[NOISY:]):
            raise IndexError(f"noise of {name}")
        return Outcome(*(values[NOISY:] for values in self.campaigns[name].results))

    def run(self, name: str, index: int = 0) -> Run:
        """The trajectory of one run."""
        return self.campaigns[name].kept[index]

    def fate(self, name: str, index: int) -> str:
        """When the last angle has settled, or why it has not."""
        flown, o = self.campaigns[name], self.one(name, index)
        if not flown.ok[index]:
            reason = "pitch at 90 deg" if flown.culprit[index] == "plant" else flown.culprit[index]
            return f"fails at {flown.failed_at[index]:.1f} s ({reason})"
        return f"{o.slowest:.1f} s" if np.isfinite(o.slowest) else "does not settle"


def linear(angles: Any = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """A and B at rest, (6, 6) and (6, 3)."""
    with jax.enable_x64(True):
        model = EulerModel.create(INERTIA, angles)
        _, A, B = model.factorise(jnp.asarray(model.target()), 1.0)
        return np.asarray(A), np.asarray(B)


def configurations(duration: float) -> dict[str, Shared]:
    """Everything that is flown; the LQR is that of angles zero."""
    A, B = linear()
    wheels = np.zeros((3, 3))  # no feedback of the wheels' momentum
    sampled, held = np.hstack([lqrd(A, B, Q, R, PERIOD)[0], wheels]), np.hstack([lqr(A, B, Q, R)[0], wheels])
    raw, filtered = airbearing.raw, airbearing.filtered
    return {
        LQR: Shared(sampled, raw(), duration),
        SDRE: Shared(None, raw(), duration),
        DIFFERENCE: Shared(None, raw(measured=0.0, differenced=1.0), duration),
        NO_RATE: Shared(None, raw(measured=0.0), duration),
        FILTER: Shared(None, filtered(rates=True), duration),
        FILTER_ANGLES: Shared(None, filtered(rates=False), duration),
        NAIVE: Shared(held, raw(), duration),
    }


def cases(runs: int, seed: int) -> Case:
    """The manoeuvre with each torque limit, the larger ones, and `runs` times the manoeuvre with noise."""
    return blocks.join([
        *(airbearing.case(torque_limit=limit) for limit in TORQUE_LIMITS),
        *(airbearing.case(target) for target in LARGE),
        *(airbearing.case(noise=1.0, seed=seed + index) for index in range(runs)),
    ])  # fmt: skip


def case(one: Case, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    if shared.gain is None:
        controller = SdreSampled.create(EulerModel.create(INERTIA, one.target), PERIOD, Q=Q, R=R)
    else:
        controller = state_feedback(shared.gain, PERIOD)
    return airbearing.manoeuvre(one, controller, shared.navigator, duration=shared.duration)


def fly(found: Study, duration: float, runs: int, seed: int) -> None:
    """Every case with every configuration."""
    configured = configurations(duration)
    keep = {name: (0, NOISY) for name in configured} | {name: range(NOISY + 1) for name in (LQR, SDRE)}
    study.campaigns(
        case,
        cases(runs, seed),
        configured,
        found.campaigns,
        measure=airbearing.outcome,
        keep=keep,
        seed=seed,
        **{"workers": 1, **found.flying},
    )


def spelled(values: np.ndarray, form: str) -> str:
    """Roll / pitch / yaw."""
    return " / ".join(format(v, form) if np.isfinite(v) else "never" for v in values)


def slews(found: Study) -> Table:
    """LQR and SDRE without noise."""
    rows = []
    for k, limit in enumerate(TORQUE_LIMITS):
        for name in (LQR, SDRE):
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
    names = [n for n in (LQR, SDRE, FILTER) if n in found.campaigns and len(found.campaigns[n].index) >= NOISY]
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
    for name in (LQR, SDRE, DIFFERENCE, NO_RATE, FILTER, FILTER_ANGLES):
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


def statements(found: Study) -> list[Statement]:
    """The claims of the paper."""

    def regular() -> Verdict:
        ends = [k for k in range(NOISY) if not found.campaigns[LQR].ok[k]]
        text = "E(angles) grows as 1 / cos(pitch)"
        return "does not hold", f"{text}; {len(ends)} of the {NOISY} slews of LQR without noise end at pitch 90 deg"

    def better(indices: Sequence[int]) -> Verdict:
        pairs = [(found.one(SDRE, k), found.one(LQR, k)) for k in indices]
        wins = [(s.settling < q.settling).all() and (s.overshoot <= q.overshoot).all() for s, q in pairs]
        text = "; ".join(
            f"{found.fate(SDRE, k)} and {100 * s.overshoot.max():.1f} % against "
            f"{found.fate(LQR, k)} and {100 * q.overshoot.max():.1f} %"
            for k, (s, q) in zip(indices, pairs, strict=True)
        )
        return (
            "holds" if all(wins) else "depends on the slew" if any(wins) else "does not hold"
        ), f"settling time and overshoot: {text}"

    def far() -> Verdict:
        fates = [found.fate(LQR, k) for k in range(len(TORQUE_LIMITS), NOISY)]
        lost = ~np.isfinite([found.one(LQR, k).slowest for k in range(len(TORQUE_LIMITS), NOISY)])
        text = ", ".join(f"{t[0] / DEG:.0f} deg: {f}" for t, f in zip(LARGE, fates, strict=True))
        return "holds" if lost[-1] else "does not hold", text

    def everywhere() -> Verdict:
        times = np.array([found.one(SDRE, k).slowest for k in (0, *range(len(TORQUE_LIMITS), NOISY))])
        text = f"{np.isfinite(times).sum()} of {len(times)} settle, after {times.min():.1f} to {times.max():.1f} s"
        if times.max() <= SIMILAR * times.min():
            return "holds", text
        return "depends on what level means" if np.isfinite(times).all() else "does not hold", text

    def compared(first: str, second: str, noise: bool) -> tuple[float, float, str]:
        if not noise:
            a, b = found.one(first).slowest, found.one(second).slowest
            return float(a), float(b), f"{found.fate(first, 0)} against {found.fate(second, 0)}"
        a, b = pooled(found, first), pooled(found, second)
        return a[0], b[0], f"rms {a[0]:.3f} deg and {a[1]:.2g} N m against {b[0]:.3f} deg and {b[1]:.2g} N m"

    def degraded(noise: bool) -> Verdict:
        worse, full, text = compared(DIFFERENCE, SDRE, noise)
        none, _, other = compared(NO_RATE, SDRE, noise)
        verdict = study.either(worse > SIMILAR * full, none > SIMILAR * full, "how the rate is obtained")
        what = "" if noise else "settling time with "
        return verdict, f"{what}differences: {text}; {what}no rate: {other}"

    def quiet() -> Verdict:
        medians, free = np.median(found.noisy(SDRE).settling, axis=0), found.one(SDRE).settling
        text = f"settles {spelled(medians, '.1f')} s (median) against {spelled(free, '.1f')} s"
        return "holds" if (medians <= SIMILAR * free).all() else "does not hold", text

    def robust() -> Verdict:
        a, b, text = compared(SDRE, LQR, noise=True)
        return "holds" if a <= SIMILAR * b else "does not hold", text

    def improved() -> Verdict:
        a, b, text = compared(FILTER_ANGLES, DIFFERENCE, noise=True)
        c, d, other = compared(FILTER, SDRE, noise=True)
        return study.either(a < b, c < d, "the sensors"), f"angles alone: {text}; with rates: {other}"

    def constant() -> Verdict:
        change = gain_change(found.run(SDRE))
        return "holds" if change < 1e-3 else "does not hold", f"gains change by {change:.0%} during the slew (2-norm)"

    limits, large = range(len(TORQUE_LIMITS)), range(len(TORQUE_LIMITS), NOISY)
    return [
        Statement("3-2-1 Euler angles have no singularity", "section 2", regular),
        Statement("SDRE performs better than LQR with the same weights", "figure 2", lambda: better([0])),
        Statement("... and with wheels of 1, 0.2 and 0.05 N m", "not in the paper", lambda: better(limits[1:])),
        Statement("... and on larger slews", "section 5", lambda: better(large)),
        Statement("LQR becomes unstable far from the origin", "section 5", far),
        Statement("SDRE keeps its level of performance in any region", "section 5", everywhere),
        Statement("Without rate sensor the performance degrades", "figure 3", lambda: degraded(noise=False)),
        Statement("With noise the slew is similar", "figure 4", quiet),
        Statement("With all states, SDRE is as robust as LQR", "section 4", robust),
        Statement("With noise and angles only it degrades", "figure 5", lambda: degraded(noise=True)),
        Statement("The Kalman filter improves it", "figure 6", improved),
        Statement("The gains of SDRE are constant like those of LQR", "section 5", constant),
    ]


def gain_change(run: Run) -> float:
    """Largest relative change of the SDRE gain along a run, against its end."""
    model = EulerModel.create(INERTIA, run.references[0, :3])

    def gain(y: Any) -> Any:
        _, A, B = model.factorise(y, 1.0)
        return sampled_gain(A, B, Q, R, PERIOD)[0]

    with jax.enable_x64(True):
        K = np.asarray(jax.vmap(gain)(jnp.asarray(run.outputs[::10])))
    return float((np.linalg.norm(K - K[-1], 2, axis=(1, 2)) / np.linalg.norm(K[-1], 2)).max())


def pictures(found: Study) -> list[report.Section]:
    """Counterparts of figures 2 to 6, and the larger slews."""

    def lines(shown: dict[str, tuple[str, int]]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        flown = {label: found.campaigns[n].kept.get(k) for label, (n, k) in shown.items() if n in found.campaigns}
        return {label: (run.time, run.outputs[:, :3] / DEG) for label, run in flown.items() if run is not None}

    last, first = NOISY - 1, len(TORQUE_LIMITS)
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
        ("The largest slew.", {LQR: (LQR, last), SDRE: (SDRE, last)}, DURATION),
    ]  # fmt: skip
    series = [(caption, lines(shown), until) for caption, shown, until in drawn]
    noisy = lines({n: (n, NOISY) for n in (DIFFERENCE, SDRE, FILTER)})
    late = {n: (t[t >= TAIL], (angles - TARGET / DEG)[t >= TAIL]) for n, (t, angles) in noisy.items()}
    series.insert(6, ("Figures 4 to 6: the error that remains.", late, DURATION))
    return [study.drawings("Figures", [(figures.histories(s, AXES, until=u), c) for c, s, u in series if s])]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "120 s flights, 2 runs with noise, no search for the worst"
    options = study.parse(
        study.parser(__doc__, out="out/airbearing", fast=fast, runs=16, what="runs with noise"), arguments
    )
    runs, duration = (min(options.runs, 2), 120.0) if options.fast else (options.runs, DURATION)
    found = Study()

    def flights() -> None:
        fly(found, duration, runs, options.seed)
        if not options.fast:
            controller = state_feedback(configurations(duration)[LQR].gain, PERIOD)
            worst.ask(question(controller, DRAWS, options.seed), found.worst, seed=options.seed)

    study.carry_out(found, flights, options)
    return study.conclude(
        found,
        options.out,
        title="Air-bearing simulator: SDRE with a Kalman filter",
        subtitle="LQR and SDRE on large slews of a three-axis satellite simulator; after the SDRE and Kalman filter "
        "study of INPE's Space Mechanics and Control Division",
        tables=[slews(found), larger(found), steady(found), held(found), *worst.tables(found.worst)],
        statements=statements(found),
        sections=pictures(found),
        findings=FINDINGS,
        settings=f"{runs} runs with noise, seed {options.seed}, {duration:g} s flights, {PERIOD:g} s period",
    )


FINDINGS = (
    "The 0.1 s that the paper gives for its filter cannot be the period at which the continuous gains act: held for so "
    "long they are unstable. All results are those of the sampled regulator with the same weights.",
    "LQR fails on large slews because it takes Euler rates for body rates. This is kinematics: limits of torque do not "
    "change it.",
)


if __name__ == "__main__":
    raise SystemExit(main())
