"""What Pecorilla and Stesina (2024) state about their configurations, measured over all seeds that are flown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any

import numpy as np
from cubesat3u_robustness import MARGINS, margin_ratios, only_one_points, work

from plants import Indices, Paired, Reading, Rule, Statement, clopper_pearson, cubesat3u, paired

DEG = cubesat3u.DEG
BOUND = cubesat3u.REQUIREMENTS  # table 1

HINF, PD, DIRECT, SVD_HINF = "EKF + Hinf", "EKF + PD", "EKF direct + Hinf", "SVD + Hinf"
MPC = ("EKF + MPC velocity", "EKF + MPC position")
SVD_MPC = ("SVD + MPC velocity", "SVD + MPC position")
PAPER_EKF = "paper EKF"  # as figure 3 draws it; the others are ours
PAPER_HINF, PAPER_MPC = f"{PAPER_EKF} + Hinf", tuple(f"paper {name}" for name in MPC)
PAPER = (PAPER_MPC[0], SVD_HINF, PAPER_HINF)  # the three configurations of the paper's figures
INDICES = {"APE": "ape", "control error": "control_error", "AKE": "ake", "PSE": "pse"}
BOUNDS = {name: getattr(BOUND, key) / DEG for name, key in INDICES.items()}  # deg
AXES = ("roll", "pitch", "yaw")

MOST = 0.8  # () of the runs: "with a few exceptions"
HALF = 0.5  # () of the runs in which one configuration does and another does not
MUCH = 0.5  # () "much smaller", "by a large margin"
ALIKE = 0.1  # () "approximately similarly"
FORM, FILTER, PLANE, NOISE = (
    "the form of the MPC",
    "the filter",
    "the angle between Sun and field",
    "the sensors' noise",
)
SMALLER, LARGER = ("<", 1.0), (">", 1.0)
MEETS = Rule("share of the runs that meet the requirement", ">=", MOST)

Cases = Mapping[tuple[str, ...], Reading]  # by what tells them apart


def worst(i: Indices, key: str) -> Any:
    """Worst axis of an index in degrees, () or (runs,)."""
    return getattr(i, key).max(axis=-1) / DEG


def passes(i: Indices) -> dict[str, np.ndarray]:
    """Which requirements are met, () or (runs,) bool each."""
    return {name: worst(i, key) <= BOUNDS[name] for name, key in INDICES.items()}


def share(met: Any, text: str = "") -> Reading:
    """Of the runs, with its exact interval (Clopper and Pearson)."""
    met = np.asarray(met)
    low, high = clopper_pearson(int(met.sum()), met.size)
    return Reading("", float(met.mean()), float(low), float(high), f"{met.sum()} of {met.size}{text}")


def compared(first: Any, *others: Any, ratio: bool = True) -> Paired:
    """One configuration with the best of others, run by run, as many runs as all of them have."""
    runs = min(map(len, (first, *others)))
    return paired(first[:runs], np.min([other[:runs] for other in others], axis=0), ratio=ratio)


def ratio(first: Any, *others: Any) -> Reading:
    """Of one configuration to the best of others: the median and its interval."""
    return compared(first, *others).reading()


def dependence(rule: Rule, cases: Cases, factors: tuple[str, ...]) -> str:
    """Which of the factors that tell the cases apart change whether the rule is met."""
    met = {key: rule.met(reading) for key, reading in cases.items()}
    matter = {
        next(i for i, (x, y) in enumerate(zip(a, b, strict=True)) if x != y)
        for a, b in combinations(met, 2)
        if sum(x != y for x, y in zip(a, b, strict=True)) == 1 and {met[a], met[b]} == {True, False}
    }
    return " and ".join(factors[i] for i in sorted(matter)) or "the case"


def claim(
    text: str, source: str, rule: Rule, measured: Callable[[], Cases], *factors: str, printed: str = "", why: str = ""
) -> Statement:
    """A statement judged by one rule on cases that the factors tell apart."""

    def readings() -> list[Reading]:
        return [reading._replace(what=", ".join(filter(None, key))) for key, reading in measured().items()]

    try:
        depends = dependence(rule, measured(), factors)
    except (KeyError, IndexError):
        depends = "the case"
    return Statement(text, source, readings, rule=rule, printed=printed, depends=depends, why=why)


def statements(found: Any, known: str = PAPER_EKF) -> list[Statement]:
    """The claims of the paper: by default with its own filter, else with another, such as "EKF"."""
    hinf, mpc = f"{known} + Hinf", {form: f"{known} + MPC {form}" for form in ("velocity", "position")}
    svd_mpc = {form: f"SVD + MPC {form}" for form in mpc}

    def results(name: str, of: str = "campaigns") -> Any:
        return getattr(found, of)[name].results

    def level(name: str, key: str, of: str = "campaigns") -> np.ndarray:
        return worst(results(name, of), key)

    def against(key: str, of: str = "campaigns") -> Cases:
        """Of each MPC relative to both configurations with H-infinity."""
        others = [level(name, key, of) for name in (hinf, SVD_HINF)]
        return {(f"{form} form",): ratio(level(name, key, of), *others) for form, name in mpc.items()}

    def knowledge() -> Cases:
        cases = {}
        for what, of in (("fixed orbit", "campaigns"), ("random sunlit planes", "turned")):
            met = [level(name, "ake", of) <= BOUNDS["AKE"] for name in (hinf, SVD_HINF)]
            cases[(what,)] = share(met[0] & ~met[1], f"; EKF meets it in {met[0].sum()}, SVD in {met[1].sum()}")
        return cases

    def alike() -> Cases:
        cases = {}
        for form, name in mpc.items():
            p = compared(level(name, "ake"), level(hinf, "ake"))
            far = max(p.high - 1, 1 - p.low)
            near = 0.0 if p.low <= 1 <= p.high else min(abs(p.low - 1), abs(p.high - 1))
            cases[(f"{form} form",)] = Reading("", abs(p.median - 1), near, far, p.reading().text)
        return cases

    def margin() -> Cases:
        half = MUCH * BOUNDS["control error"]
        kept, lost = level(hinf, "control_error") <= half, level(SVD_HINF, "control_error") > BOUNDS["control error"]
        return {
            ("",): share(kept & lost, f"; {hinf} at most half of it in {kept.sum()}, SVD beyond it in {lost.sum()}")
        }

    def stability(key: str) -> Callable[[], Cases]:
        return lambda: {
            (f"{form} form",): ratio(level(hinf, key), level(name, key), level(SVD_HINF, key))
            for form, name in mpc.items()
        }

    def worst_stability() -> Cases:
        noises = {"sensors of ours": "campaigns"} | ({"half their noise": "quiet"} if known == PAPER_EKF else {})
        return {
            (f"{form} form", what): ratio(level(name, "pse", of), level(SVD_HINF, "pse", of))
            for what, of in noises.items()
            for form, name in mpc.items()
        }

    def times() -> Cases:
        t = {name: results(name).settling_time for name in (hinf, SVD_HINF, *mpc.values())}
        return {
            (f"{form} form",): compared(t[name], t[hinf], t[SVD_HINF], ratio=False).reading()
            for form, name in mpc.items()
        }

    def effort(name: str) -> np.ndarray:
        return results(name).effort.sum(axis=-1)

    def dispersed(name: str) -> dict[str, np.ndarray]:
        drawn = found.campaigns[name].index > 0
        return {index: met[drawn] for index, met in passes(results(name)).items()}

    def settled(name: str) -> np.ndarray:
        return results(name).settling_time < found.window

    def superior() -> Cases:
        others = (*mpc.values(), SVD_HINF)
        return {(name,): ratio(level(hinf, key), *(level(n, key) for n in others)) for name, key in INDICES.items()}

    def optimum() -> Cases:
        return {("",): Reading("", found.design.gamma / found.design.info.optimum)}

    def stable() -> Cases:
        return {("",): Reading("", float(np.abs(found.design.closed_loop.poles()).max()))}

    def tracked() -> Cases:
        return {(name,): share(met) for name, met in found.tracked.items()}

    times_worse = "{}, to the better of both with Hinf".format
    return [
        claim("The H-infinity controller minimises the gain from w to z", "section 2.3.1, eq. 16 to 27",
              Rule("verified norm over the optimum of the solver", "<=", 1.001), optimum,
              why="the norm is measured on the closed loop, by a method that knows nothing of the solver"),
        claim("Its full order ensures asymptotic stability of the closed loop", "section 2.3.1",
              Rule("largest modulus of the poles of the closed loop", *SMALLER), stable),
        claim("The controller can also track a desired attitude other than nadir", "section 2.3.1, figure 5",
              MEETS, tracked, "the angle and how the error is made",
              why="r - y from the starts of table 5; the error quaternion after a tumble and a slew"),
        claim("The EKF configurations meet the AKE requirement, SVD + Hinf does not", "section 3.2, figure 10",
              Rule("share of the runs in which the EKF meets it and the SVD does not", ">=", MOST), knowledge, PLANE,
              printed="0.31 deg required"),
        claim("The EKF results in a better estimation than the SVD alone", "section 3.2, figure 10",
              Rule("AKE with the EKF over that with the SVD", *SMALLER),
              lambda: {("",): ratio(level(hinf, "ake"), level(SVD_HINF, "ake"))}),
        claim("EKF + MPC and EKF + Hinf know the attitude equally well", "section 3.2, figure 10",
              Rule("relative difference of the AKE", "<", ALIKE), alike, FORM),
        claim("With the SVD, Hinf attenuates the noise of the estimate", "section 3.2",
              Rule("APE over AKE", *SMALLER), lambda: {("",): ratio(level(SVD_HINF, "ape"), level(SVD_HINF, "ake"))}),
        claim("With MPC instead of Hinf, the SVD alone would not even stabilise", "section 3.2",
              Rule(f"share of the runs that stay within 1 deg after {found.window:g} s", "<", HALF),
              lambda: {(f"{form} form",): share(settled(name)) for form, name in svd_mpc.items()}, FORM,
              why="the velocity form integrates, and its delay margin is a fifth of a sample"),
        claim("MPC has the smallest control error", "section 3.2, figure 12",
              Rule(times_worse("control error"), *SMALLER), lambda: against("control_error"), FORM),
        claim("EKF + Hinf meets the control error by a large margin, SVD + Hinf fails", "section 3.2, figure 12",
              Rule("share of the runs in which the one keeps half of it and the other none", ">=", MOST), margin,
              printed="0.31 deg required"),
        claim("EKF + Hinf has a much smaller PSE than the other two", "section 3.2, figure 13",
              Rule("PSE over the smaller of the others'", "<", MUCH), stability("pse"), FORM,
              why="a controller with a tenth of the gain passes less of the filter's noise on"),
        claim("... the same over 10 s instead of 1 s", "section 3.2, figure 13",
              Rule("PSE over 10 s over the smaller of the others'", "<", MUCH), stability("slow"), FORM,
              why="over 10 s the drift of the estimate counts, which is the same for all"),
        claim("EKF + MPC has the worst PSE", "section 3.2, figure 13",
              Rule("PSE over that of SVD + Hinf", *LARGER), worst_stability, FORM, NOISE,
              why="table 2 with the paper's sensors is not in the text"),
        claim("... but meets the requirement", "section 3.2, figure 13", MEETS,
              lambda: {(f"{form} form",): share(passes(results(n))["PSE"]) for form, n in mpc.items()}, FORM,
              printed="0.12 deg required"),
        claim("MPC reaches the desired attitude faster", "section 3.2, figures 7 and 8",
              Rule("time to settle to 1 deg, less the shorter of both with Hinf", "<", 0, "s"), times, FORM),
        claim("MPC costs more control", "section 3.2, figure 9",
              Rule("integral of |torque| over that of Hinf", *LARGER),
              lambda: {(f"{form} form",): ratio(effort(n), effort(hinf)) for form, n in mpc.items()}, FORM),
        claim("Hinf achieves good performance with small torques", "section 3.2, figures 7 to 9", MEETS,
              lambda: {("",): share(np.all([*passes(results(hinf)).values()], axis=0), "; all four of table 1")}),
        claim("The filter converges from a wrong first estimate", "section 3.2.1, figures 14 and 15", MEETS,
              lambda: {("AKE",): share(dispersed(hinf)["AKE"])}, why="started from zeros, up to 25 deg per axis away"),
        claim("The Monte Carlo of EKF + Hinf meets all requirements with a few exceptions", "section 3.2.1, figure 16",
              MEETS, lambda: {(name,): share(met) for name, met in dispersed(hinf).items()}, "the index",
              printed="30 runs"),
        claim("Hinf gives greater control robustness", "section 4", Rule("margin over that of the MPC", *LARGER),
              lambda: margin_ratios(found.controllers), "the margin", FORM,
              why=f"margins at the plant's input, each axis alone; the MPC without its limits; {', '.join(MARGINS)}"),
        claim("... also to the inertia, flown within 50 %", "section 4",
              Rule("share of Hinf among the runs in which only one of both meets table 1", ">", HALF),
              lambda: {(f"{form} form",): only_one_points(found, HINF, MPC[i]) for i, form in enumerate(mpc)}, FORM,
              why="with our filter; where both or none do, a run tells nothing"),
        claim("Hinf costs less computation than MPC", "section 4",
              Rule("multiplications and additions of a step over those of Hinf", *LARGER),
              lambda: {(f"{form} form",): work(found.controllers, form) for form in mpc}, FORM,
              why="counted in the C code of Hinf; of the MPC only what no solver saves, without an active limit"),
        claim("EKF + Hinf is superior to the other configurations", "sections 3.2 and 4",
              Rule("index over the smallest of the others'", *SMALLER), superior, "the index"),
    ]  # fmt: skip
