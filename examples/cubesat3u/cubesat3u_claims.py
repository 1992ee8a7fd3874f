"""What Pecorilla and Stesina (2024) state about their configurations, measured."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from plants import Indices, Statement, Verdict, cubesat3u, either, indices, pointing_errors

DEG = cubesat3u.DEG
BOUND = cubesat3u.REQUIREMENTS  # table 1


SUN_FIELD = "the angle between Sun and field"


HINF, SVD_HINF, PD, DIRECT = "EKF + Hinf", "SVD + Hinf", "EKF + PD", "EKF direct + Hinf"
MPC = ("EKF + MPC velocity", "EKF + MPC position")
SVD_MPC = ("SVD + MPC velocity", "SVD + MPC position")
PAPER = (MPC[0], SVD_HINF, HINF)  # the three configurations of the paper's figures
INDICES = {"APE": "ape", "control error": "control_error", "AKE": "ake", "PSE": "pse"}
BOUNDS = {name: getattr(BOUND, key) / DEG for name, key in INDICES.items()}  # deg
AXES = ("roll", "pitch", "yaw")


def worst(i: Indices, key: str) -> Any:
    """Worst axis of an index in degrees, () or (runs,)."""
    return getattr(i, key).max(axis=-1) / DEG


def passes(i: Indices) -> dict[str, np.ndarray]:
    """Which requirements are met, () or (runs,) bool each."""
    return {name: worst(i, key) <= BOUNDS[name] for name, key in INDICES.items()}


def growth(controller: Any, delay: int) -> float:
    """Growth per sample of small motions about nadir with `delay` extra samples: the loop is stable below 1."""
    A, B, _, _ = cubesat3u.linear_model()
    x, state, waiting, sizes = np.full(6, 1e-9), controller.init(), [np.zeros(3)] * delay, []
    while len(sizes) < 600 and 1e-14 < np.linalg.norm(x) < 1e-4:  # far from every limit, above rounding
        state, u = controller.step(state, x, np.zeros(6))
        waiting.append(u)
        x = A @ x + B @ waiting.pop(0)
        sizes.append(np.linalg.norm(x))
    late = np.log(sizes[len(sizes) // 2 :])
    return float(np.exp(np.polyfit(np.arange(len(late)), late, 1)[0]))


def delays_tolerated(controller: Any, most: int = 8) -> int:
    """Extra samples of delay up to which small motions die out."""
    return next((d - 1 for d in range(1, most + 1) if growth(controller, d) >= 1), most)


def microseconds(controller: Any, repetitions: int = 300) -> float:
    """Median time of a control step."""
    rng, state, spent = np.random.default_rng(0), controller.init(), []
    for _ in range(repetitions):
        y = rng.normal(scale=1e-3, size=6)
        start = time.perf_counter()
        state, _ = controller.step(state, y, np.zeros(6))
        spent.append(time.perf_counter() - start)
    return 1e6 * float(np.median(spent))


def findings(found: Any) -> list[str]:
    """What the paper does not say, in sentences with figures; of what has been flown."""
    sentences = []
    if HINF in found.nominal and PD in found.nominal:
        pairs = [(float(i.settling_time), worst(i, "pse")) for i in (found.nominal[HINF], found.nominal[PD])]
        sentences.append(
            f"A plain PD ({PD}) settles in {pairs[1][0]:.0f} s against {pairs[0][0]:.0f} s and has a PSE of "
            f"{pairs[1][1]:.4f} against {pairs[0][1]:.4f} deg: the stability of {HINF} is a matter of bandwidth."
        )
    if len(found.eclipse) == 2:
        peaks = {name: pointing_errors(run).angle[run.time > 300].max() / DEG for name, run in found.eclipse.items()}
        sentences.append(
            f"Over one orbit with its eclipse the pointing error of {HINF}, whose filter is fed by the vector "
            f"solution, reaches {peaks[HINF]:.2f} deg; with the vectors themselves ({DIRECT}) {peaks[DIRECT]:.2f} deg."
        )
    return sentences


def statements(found: Any) -> list[Statement]:
    """The claims of the paper."""

    def level(name: str, key: str) -> float:
        return float(worst(found.nominal[name], key))

    def figures(key: str, *names: str) -> str:
        return ", ".join(f"{name} {level(name, key):.3g}" for name in names) + " deg"

    def knowledge() -> Verdict:
        here = level(HINF, "ake") <= BOUND.ake / DEG < level(SVD_HINF, "ake")
        met = {name: worst(found.turned[name].results, "ake") <= BOUND.ake / DEG for name in (HINF, SVD_HINF)}
        verdict = either(here, bool(met[HINF].all() and not met[SVD_HINF].any()), SUN_FIELD)
        share = ", ".join(f"{name} meets it on {m.sum()} of {m.size}" for name, m in met.items())
        return verdict, f"AKE: {figures('ake', HINF, SVD_HINF)}; on random sunlit orbit planes {share}"

    def similar() -> Verdict:
        a, b = level(HINF, "ake"), level(MPC[0], "ake")
        return ("holds" if abs(a / b - 1) < 0.1 else "does not hold"), figures("ake", HINF, *MPC)

    def unstable() -> Verdict:
        settled = {name: found.campaigns[name].results.settling_time < found.window for name in SVD_MPC}
        fails = [m.mean() < 0.5 for m in settled.values()]
        text = ", ".join(f"{name} {m.sum()} of {m.size}" for name, m in settled.items())
        return either(*fails, "the form of the MPC"), f"runs that stay within 1 deg after {found.window:.0f} s: {text}"

    def control_error() -> Verdict:
        others = min(level(HINF, "control_error"), level(SVD_HINF, "control_error"))
        wins = [level(name, "control_error") < others for name in MPC]
        return either(wins[0], wins[1], "the form of the MPC"), figures("control_error", *MPC, HINF, SVD_HINF)

    def margin() -> Verdict:
        bound = BOUND.control_error / DEG
        large, fails = level(HINF, "control_error") < bound / 2, level(SVD_HINF, "control_error") > bound
        return either(large, fails, "the configuration"), figures("control_error", HINF, SVD_HINF)

    def stable() -> Verdict:
        wins = [level(HINF, "pse") < min(level(name, "pse"), level(SVD_HINF, "pse")) for name in MPC]
        late = {
            name: worst(indices(found.campaigns[name].kept[0], start=found.window, delta_t=10.0), "pse")
            for name in (HINF, *MPC)
        }
        text = ", ".join(f"{name} {value:.3g}" for name, value in late.items())
        rate = f"{figures('pse', HINF, SVD_HINF, *MPC)}; over 10 s instead of 1 s: {text}"
        return either(wins[0], wins[1], "the form of the MPC"), rate

    def worst_stability() -> Verdict:
        def is_worst(of: Any) -> list[bool]:
            pse = {name: float(worst(of[name], "pse")) for name in (SVD_HINF, *MPC)}
            return [pse[SVD_HINF] < pse[name] <= BOUND.pse / DEG for name in MPC]

        here, quiet = is_worst(found.nominal), is_worst(found.quiet)
        dependence = [text for text, depends in (
            ("the form of the MPC", (here[0] or quiet[0]) != (here[1] or quiet[1])),
            ("the noise of the vector sensors", here != quiet),
        ) if depends]  # fmt: skip
        verdict = f"depends on {' and '.join(dependence)}" if dependence else either(*here, "the form of the MPC")
        text = ", ".join(f"{name} {worst(i, 'pse'):.3g}" for name, i in found.quiet.items())
        return verdict, f"{figures('pse', *MPC, SVD_HINF, HINF)}; with vector sensors of half the noise {text} deg"

    def fast() -> Verdict:
        names = (*MPC, HINF, SVD_HINF)
        t = [float(found.nominal[name].settling_time) for name in names]
        text = ", ".join(f"{name} {value:.0f} s" for name, value in zip(names, t, strict=True))
        return either(t[0] < min(t[2:]), t[1] < min(t[2:]), "the form of the MPC"), f"settles to 1 deg: {text}"

    def costly() -> Verdict:
        effort = {name: 1e3 * float(found.nominal[name].effort.sum()) for name in (*MPC, HINF)}
        text = ", ".join(f"{name} {value:.1f}" for name, value in effort.items()) + " mN m s"
        more = [effort[name] > effort[HINF] for name in MPC]
        return either(more[0], more[1], "the form of the MPC"), f"integral of |torque|, three wheels: {text}"

    def few_exceptions() -> Verdict:
        result = found.campaigns[HINF].results
        met = {
            name: (worst(result, key) <= getattr(BOUND, key) / DEG)[1:]
            for name, key in (("APE", "ape"), ("control error", "control_error"), ("AKE", "ake"), ("PSE", "pse"))
        }
        share = min(m.mean() for m in met.values())
        text = ", ".join(f"{name} {m.sum()}/{m.size}" for name, m in met.items())
        return ("holds" if share >= 0.8 else "does not hold"), f"runs that meet the requirement: {text}"

    def robust() -> Verdict:
        d = {name: delays_tolerated(c) for name, c in found.controllers.items()}
        wins = d["Hinf"] > max(d["MPC velocity"], d["MPC position"])
        text = ", ".join(f"{name} {n}" for name, n in d.items())
        return ("holds" if wins else "does not hold"), f"samples of 0.5 s of unknown delay tolerated: {text}"

    def cheap() -> Verdict:
        t = {name: microseconds(c) for name, c in found.controllers.items()}
        ratios = ", ".join(f"{name} {t[name] / t['Hinf']:.1f}" for name in ("MPC velocity", "MPC position"))
        wins = t["Hinf"] < min(t["MPC velocity"], t["MPC position"])
        return ("holds" if wins else "does not hold"), f"time of a step relative to Hinf: {ratios}"

    def superior() -> Verdict:
        others = (*MPC, SVD_HINF)
        best = [name for name, key in INDICES.items() if level(HINF, key) <= min(level(n, key) for n in others)]
        beaten = [name for name, key in INDICES.items() if level(PD, key) <= level(HINF, key)]
        verdict = "holds" if len(best) == 4 and len(beaten) < 4 else "depends on the index"
        text = f"smallest in {', '.join(best) or 'none'}; a plain PD is as good or better in"
        return verdict, f"{text} {', '.join(beaten) or 'none'}"

    return [
        Statement(
            "The EKF configurations meet the AKE requirement, SVD + Hinf does not", "section 3.2, figure 10", knowledge
        ),
        Statement("EKF + MPC and EKF + Hinf know the attitude equally well", "section 3.2, figure 10", similar),
        Statement("With MPC instead of Hinf, the SVD alone would not even stabilise", "section 3.2", unstable),
        Statement("MPC has the smallest control error", "section 3.2, figure 12", control_error),
        Statement("EKF + Hinf meets the control error by a large margin, SVD + Hinf fails", "figure 12", margin),
        Statement("EKF + Hinf has a much smaller PSE than the other two", "section 3.2, figure 13", stable),
        Statement("EKF + MPC has the worst PSE but meets the requirement", "section 3.2, figure 13", worst_stability),
        Statement("MPC reaches the desired attitude faster", "figures 7 and 8", fast),
        Statement("MPC costs more control", "figure 9", costly),
        Statement(
            "The Monte Carlo of EKF + Hinf meets all requirements with a few exceptions", "figure 16", few_exceptions
        ),
        Statement("Hinf gives greater control robustness", "section 4", robust),
        Statement("Hinf costs less computation than MPC", "section 4", cheap),
        Statement("EKF + Hinf is superior to the other configurations", "sections 3.2 and 4", superior),
    ]
