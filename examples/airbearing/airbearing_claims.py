"""What the air-bearing paper states, measured; what it does not say; which controller to take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from airbearing_flights import (
    DIFFERENCE,
    DURATION,
    EXACT,
    FILTER,
    FILTER_ANGLES,
    LARGE,
    LAWS,
    LQR,
    NO_RATE,
    NOISY,
    SDRE,
    Study,
)
from airbearing_margins import Local

from plants import Campaign, Claim, Reading, Rule, Run, Statement, clopper_pearson, drawn, left_out, paired
from plants.dynamics.eulerbody import MARGIN, kinematics
from plants.missions.airbearing import DEG, INERTIA, INERTIA_SPREAD, PERIOD, TARGET, TORQUE_LIMITS, Outcome, Q, R
from synth import EulerModel
from synth.regulators.sdre import sampled_gain

TITLE = "001 SDRE and Kalman filter on the air bearing of INPE (title and authors missing from the text)"
SIMILAR = 1.1  # largest ratio that counts as "the same" or "similar"
REGULAR = 10.0  # largest norm of the kinematics that counts as regular
GAIN, PHASE = 6.0, 30.0  # dB, deg: the usual margins, of attitude control and elsewhere
SHARE = 0.85  # of the runs that have to settle with another inertia; 31 of 31 show it
LIMITED = range(1, len(TORQUE_LIMITS))  # cases with limited wheels
FAR = range(len(TORQUE_LIMITS), NOISY)  # cases with larger slews
AXES = ("roll", "pitch", "yaw")

FINITE = Rule("norm of E(angles) half a degree before pitch 90 deg", "<", REGULAR)
SOONER = Rule("settling time of the last angle, SDRE over the other", "<", 1)
NEVER = Rule("settling time of LQR on the farthest slew, if ever", ">", DURATION, "s")
LEVEL = Rule("settling time, longest slew over shortest", "<=", SIMILAR)
DEGRADED = Rule("settling time over that with all states", ">", SIMILAR)
NOISE_DEGRADED = Rule("rms error over that with all states, paired median", ">", SIMILAR)
QUIET = Rule("settling time with noise over without, paired median", "<=", SIMILAR)
AS_ROBUST = Rule("margin of SDRE over that of LQR", ">=", 1 / SIMILAR)
SETTLES = Rule(f"share of runs that settle with moments of +-{INERTIA_SPREAD:.0%}", ">=", SHARE)
KEEPS = Rule("settling time with another inertia, SDRE over the other, paired median", "<=", SIMILAR)
GOOD_GAIN = Rule("gain margin of SDRE", ">=", GAIN, "dB")
GOOD_PHASE = Rule("phase margin of SDRE", ">=", PHASE, "deg")
FILTERED = Rule("rms error with the filter over that without, paired median", "<", 1)
LESS = Rule("effect of noise on the large slew over that on the small one, paired median", "<", 1 / SIMILAR)
CONSTANT = Rule("change of the gain during the slew (2-norm, relative)", "<", 1e-3)


def slowest(o: Outcome) -> np.ndarray:
    """Settling time of the last angle, (runs,) s."""
    return np.asarray(o.slowest)


def rms(o: Outcome) -> np.ndarray:
    """Error that remains, over the axes, (runs,) rad."""
    return np.sqrt(np.mean(np.asarray(o.error) ** 2, axis=-1))


def together(first: Campaign, second: Campaign, part: Callable[[Outcome], np.ndarray], begin: int) -> tuple[Any, Any]:
    """A part of the outcomes of the runs from `begin` on that both have finished."""
    _, k, l = np.intersect1d(first.index, second.index, return_indices=True)
    chosen = first.index[k] >= begin
    if not chosen.any():
        raise IndexError(f"runs from {begin} on")
    return part(Outcome(*first.results))[k[chosen]], part(Outcome(*second.results))[l[chosen]]


def statements(found: Study) -> list[Statement]:
    """The claims of the paper, by section."""

    def against(pairs: Iterable[tuple[int, str]]) -> list[Reading]:
        made = []
        for k, name in pairs:
            s, o = found.one(SDRE, k), found.one(name, k)
            slew = "" if k < len(TORQUE_LIMITS) else f", {target_of(k)[0] / DEG:.0f} deg"
            wheels = f", {TORQUE_LIMITS[k]:g} N m" if k in LIMITED else ""
            text = f"{found.fate(SDRE, k)} and {100 * s.overshoot.max():.1f} % against "
            text += f"{found.fate(name, k)} and {100 * o.overshoot.max():.1f} %"
            made.append(Reading(f"against {name}{slew}{wheels}", float(s.slowest / o.slowest), text=text))
        return made

    def regular() -> list[Reading]:
        ends = sum(not found.campaigns[LQR].ok[k] for k in range(NOISY))
        size = np.linalg.norm(np.asarray(kinematics(np.array([0.0, np.pi / 2 - 1.001 * MARGIN, 0.0]))), 2)
        return [Reading("", float(size), text=f"{ends} of the {NOISY} slews of LQR without noise end there")]

    def far() -> list[Reading]:
        text = ", ".join(f"{target_of(k)[0] / DEG:.0f} deg: {found.fate(LQR, k)}" for k in FAR)
        return [Reading("", float(found.one(LQR, NOISY - 1).slowest), text=text)]

    def level() -> list[Reading]:
        times = np.array([found.one(SDRE, k).settling for k in (0, *FAR)])
        return [
            Reading(axis, float(t.max() / t.min()), text=f"{t.min():.1f} to {t.max():.1f} s in {len(t)} slews")
            for axis, t in zip(AXES, times.T, strict=True)
        ]

    def degraded() -> list[Reading]:
        full = found.one(SDRE).slowest
        return [
            Reading(name, float(found.one(name).slowest / full), text=f"{found.fate(name, 0)} of {full:.1f} s")
            for name in (DIFFERENCE, NO_RATE)
        ]

    def errors(pairs: Sequence[tuple[str, str]]) -> list[Reading]:
        return [
            paired(*together(found.campaigns[a], found.campaigns[b], rms, NOISY), ratio=True).reading(a)
            for a, b in pairs
        ]

    def quiet() -> list[Reading]:
        noisy, free = found.noisy(SDRE).settling, found.one(SDRE).settling
        return [
            paired(noisy[:, k], np.full(len(noisy), free[k]), ratio=True).reading(axis) for k, axis in enumerate(AXES)
        ]

    def margin(name: str) -> Local:
        return found.margins[name][TARGET[0] / DEG]

    def as_robust() -> list[Reading]:
        kinds = {"gain": ("gain", "dB"), "phase": ("phase", "deg"), "delay": ("delay", "s"), "disk": ("disk", "dB")}
        return [
            Reading(kind, getattr(margin(SDRE), part) / getattr(margin(LQR), part),
                    text=f"{getattr(margin(SDRE), part):.3g} {unit} against {getattr(margin(LQR), part):.3g} {unit}")
            for kind, (part, unit) in kinds.items()
        ]  # fmt: skip

    def inertia(names: Iterable[str]) -> list[Reading]:
        made = []
        for name in names:
            hits = np.isfinite(slowest(Outcome(*found.dispersed[name].results)))
            low, high = clopper_pearson(int(hits.sum()), len(hits))
            made.append(Reading(name, float(hits.mean()), float(low), float(high), f"{hits.sum()} of {len(hits)}"))
        return made

    def keeps() -> list[Reading]:
        return [
            paired(*together(found.dispersed[SDRE], found.dispersed[name], slowest, 0), ratio=True).reading(
                f"against {name}"
            )
            for name in (LQR, EXACT)
        ]

    def own(part: str) -> list[Reading]:
        return [
            Reading(f"target {roll:.0f} deg", getattr(loop, part))
            for roll, loop in found.margins[SDRE].items() if not np.isnan(roll)
        ]  # fmt: skip

    def less() -> list[Reading]:
        large, small = found.steps["large"], found.steps["small"]
        spent = {}
        for name, flown in (("large", large), ("small", small)):
            if flown.index[0] != 0:
                raise IndexError("run without noise")
            spent[name] = float(slowest(Outcome(*flown.results))[0])
        a, b = together(large, small, slowest, 1)
        times = paired(a / spent["large"], b / spent["small"], ratio=True)
        never = f"of the small one {np.isinf(b).sum()} of {len(b)} never settle"
        return [
            Reading("settling time", times.median, times.low, times.high, never),
            paired(*together(large, small, rms, 1), ratio=True).reading("rms error"),
        ]

    return [
        Statement("3-2-1 Euler angles have no singularity", "section 2", regular, FINITE,
                  why="E grows as 1 / cos(pitch)"),
        Statement("SDRE performs better than LQR with the same weights", "section 4, figure 2",
                  lambda: against([(0, LQR)]), SOONER),
        Statement("... and with wheels of 1, 0.2 and 0.05 N m", "not in the paper",
                  lambda: against((k, LQR) for k in LIMITED), SOONER, depends="the wheels"),
        Statement("SDRE is superior on large slews, where the nonlinear terms are relevant", "section 5",
                  lambda: against((k, name) for name in (LQR, EXACT) for k in (0, *FAR)), SOONER,
                  depends="the linear gain's error",
                  why="the nonlinear term that matters is the kinematics, and a constant gain on E^-1 (angles - "
                  "target) has it as well"),
        Statement("LQR becomes unstable far from the origin", "section 5", far, NEVER,
                  why="beyond 90 deg of roll its loop is unstable at the target itself: Euler rates are taken for body "
                  "rates"),
        Statement("SDRE keeps its level of performance in any region", "section 5", level, LEVEL,
                  depends="what level means"),
        Statement("Without rate sensor the performance degrades", "section 4, figure 3", degraded, DEGRADED,
                  depends="how the rate is obtained"),
        Statement("With noise the slew is similar", "section 4, figure 4", quiet, QUIET, depends="the angle"),
        Statement("With all states, SDRE is as robust as LQR", "sections 4 and 5", as_robust, AS_ROBUST,
                  depends="the margin", why="near the target both are nearly the same regulator"),
        Statement("SDRE is robust to an inertia that is not well known", "abstract, section 1",
                  lambda: inertia([SDRE]), SETTLES),
        Statement("... and no slower than a linear law then", "sections 4 and 5", keeps, KEEPS,
                  depends="the linear gain's error"),
        Statement("SDRE has a good stability margin: gain", "abstract", lambda: own("gain"), GOOD_GAIN,
                  depends="the target", why="the gain that the 0.1 s allow; in continuous time it would be unlimited"),
        Statement("SDRE has a good stability margin: phase", "abstract", lambda: own("phase"), GOOD_PHASE,
                  depends="the target"),
        Statement("With noise and angles only it degrades", "section 4, figure 5",
                  lambda: errors([(DIFFERENCE, SDRE), (NO_RATE, SDRE)]), NOISE_DEGRADED,
                  depends="how the rate is obtained"),
        Statement("The Kalman filter improves it", "section 4, figure 6",
                  lambda: errors([(FILTER_ANGLES, DIFFERENCE), (FILTER, SDRE)]), FILTERED, depends="the sensors"),
        Statement("Noise matters less on large slews", "section 5", less, LESS,
                  depends="what the noise is held against",
                  why="it is small beside a large step and the same error at its end"),
        Statement("The gains of SDRE are constant like those of LQR", "section 5",
                  lambda: [Reading("", gain_change(found.run(SDRE)))], CONSTANT),
    ]  # fmt: skip


def target_of(k: int) -> np.ndarray:
    """Of a case without noise, (3,) rad."""
    return TARGET if k < len(TORQUE_LIMITS) else LARGE[k - len(TORQUE_LIMITS)]


def gain_change(run: Run) -> float:
    """Largest relative change of the SDRE gain along a run, against its end."""
    model = EulerModel.create(INERTIA, run.references[0, :3])

    def gain(y: Any) -> Any:
        _, A, B = model.factorise(y, 1.0)
        return sampled_gain(A, B, Q, R, PERIOD)[0]

    with jax.enable_x64(True):
        K = np.asarray(jax.vmap(gain)(jnp.asarray(run.outputs[::10])))
    return float((np.linalg.norm(K - K[-1], 2, axis=(1, 2)) / np.linalg.norm(K[-1], 2)).max())


def counterparts() -> list[Claim]:
    """Figures that state nothing by themselves, and what is left out."""
    return [
        left_out("figure 1", "the simulator", "a drawing of the apparatus"),
        drawn("figure 2", "LQR and SDRE without noise", "Figures, first"),
        drawn("figure 3", "only angles fed back", "Figures, second and third"),
        drawn("figure 4", "SDRE with noise", "Figures, fourth"),
        drawn("figure 5", "noise and only angles", "Figures, fifth"),
        drawn("figure 6", "noise and Kalman filter", "Figures, sixth"),
        left_out(
            "equations 5 to 7, 13, 14, 16, 17", "model and filter", "missing from the text we have; read as usual"
        ),
        left_out("section 3", "SDRE avoids intensive calculation beside other nonlinear methods", "none is named"),
        left_out("section 4", "the performance is a function of the weights", "one pair of weights is given"),
        left_out("section 5", "reliable enough for an on-board computer", "nothing is measured"),
    ]


def findings(found: Study) -> list[str]:
    """What the paper does not say, in sentences with figures."""
    said = [
        "The 0.1 s that the paper gives for its filter cannot be the period at which the continuous gains act: held "
        "for so long they are unstable. All results are those of the sampled regulator with the same weights."
    ]
    slews = [k for k in (0, *FAR) if all(name in found.campaigns and k in found.campaigns[name].index for name in LAWS)]
    if slews:
        times = {name: [float(found.one(name, k).slowest) for k in slews] for name in LAWS}
        wins = sum(e < s for e, s in zip(times[EXACT], times[SDRE], strict=True))
        said.append(
            f"Fair, and not in the paper: the constant gain of LQR on E(angles)^-1 (angles - target) settles in "
            f"{min(times[EXACT]):.1f} to {max(times[EXACT]):.1f} s where SDRE takes {min(times[SDRE]):.1f} to "
            f"{max(times[SDRE]):.1f} s and LQR {min(times[LQR]):.1f} s or {longest(times[LQR])}; it is sooner than "
            f"SDRE in {wins} of {len(slews)} slews, without a Riccati equation."
        )
    if found.margins:
        lost = [roll for roll, loop in found.margins[LQR].items() if loop.radius >= 1]
        kept = max(loop.radius for loop in found.margins[EXACT].values())
        said.append(
            "LQR fails on large slews because it takes Euler rates for body rates. This is kinematics, not torque, "
            f"gyroscopic terms or saturation: linear at rest at the target its loop is unstable from "
            f"{min(lost, default=np.nan):.0f} deg of roll on; the same gain on E^-1 has a spectral radius of "
            f"{kept:.3f} at every target."
        )
    return said


def longest(times: Sequence[float]) -> str:
    """The largest of settling times in words."""
    return f"{max(times):.1f} s" if np.isfinite(max(times)) else "never"


def summary(found: Study) -> str:
    """Which controller to take, by the flights."""
    slews = [k for k in (0, *FAR) if all(name in found.campaigns and k in found.campaigns[name].index for name in LAWS)]
    if not found.complete or not slews:
        return ""
    worst = {name: max(float(found.one(name, k).slowest) for k in slews) for name in LAWS}
    best = min(worst, key=worst.__getitem__)
    rest = ", ".join(
        f"{name} {'never on some' if np.isinf(t) else f'{t:.1f} s'}" for name, t in worst.items() if name != best
    )
    error, plain = (np.median(rms(found.noisy(name))) / DEG for name in (FILTER, SDRE))
    return (
        f"Take {best}: it settles every one of the {len(slews)} slews within {worst[best]:.1f} s ({rest}). Put the "
        f"Kalman filter before it where noise matters: the error that remains falls from {plain:.3f} to {error:.3f} "
        "deg (with SDRE)."
    )
