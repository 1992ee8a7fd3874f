"""What Romero and Souza (CILAMCE 2022) state, measured; what they do not say; which controller to take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from amazonia1_flights import (
    DYNAMIC,
    INTEGRAL_TIME,
    LINEAR,
    LITERAL,
    LQR,
    MRP,
    NOMINAL,
    PID,
    PUSH,
    READINGS,
    SDRE,
    SHORT,
    STATIC,
    Study,
)
from amazonia1_pointwise import EQUATIONS, attitude_pair, out_of_reach, printed_pair, rate_pair

from plants import Claim, Paired, Reading, Rule, Statement, amazonia1, clopper_pearson, drawn, left_out, paired
from plants.missions.amazonia1 import DEG, POINTED, SETTLED_ANGLE, SETTLED_RATE, SLOW

PAPER = "000 Romero and Souza (CILAMCE 2022)"
SHARE = 0.95  # of the runs that a law has to bring to rest to count as robust; 100 of 100 show it, 30 of 30 do not
ROUNDING = 1e-12  # a pair of matrices that is nearer to one without stabilising gain has none itself

SETTLES = Rule(f"share of runs that settle (below {SETTLED_ANGLE / DEG:g} deg and {SETTLED_RATE:g} rad/s)", ">=", SHARE)
RESTS = Rule(f"share of runs at rest at the end (below {POINTED / DEG:g} deg and {SLOW:g} rad/s)", ">=", SHARE)
LATER = Rule("settling time less that of SDRE, paired median", ">", 0, "s")
SOONER = Rule("settling time of SDRE less that of the other, paired median", "<", 0, "s")
CHEAPER = Rule("mean torque of SDRE over that of the other, paired median", "<", 1)
STIFFER = Rule("angle left by a constant torque, over that of SDRE", "<", 1)
LEVEL = Rule("norm of eq. 12 over the gamma asked for, largest", "<=", 1)
FEWER = Rule("the same norm of the law that solves two equations, largest", ">", 1)
STABILISABLE = Rule("distance to a pair that cannot be stabilised", ">", ROUNDING)
NOT = Rule("distance to a pair that cannot be stabilised", "<=", ROUNDING)
MOVED = Rule("change of the settling time by +-20 % of inertia, SDRE less LQR, short way, paired median", ">", 0, "s")
FARTHER = Rule("angle turned by LQR beyond that with the short way, starts with q0 < 0, paired median", ">", 0, "deg")
READ = "how steps 5 and 6 are read"
LAW = "the linear law"


def share(hits: np.ndarray) -> str:
    """How many, and how many it may be in truth."""
    low, high = clopper_pearson(int(hits.sum()), len(hits))
    return f"{hits.sum()}/{len(hits)} (95 %: {low:.3f} to {high:.3f})"


def shared(hits: np.ndarray, what: str = "", text: str = "") -> Reading:
    """A share of runs with its exact interval."""
    low, high = clopper_pearson(int(hits.sum()), len(hits))
    return Reading(what, float(hits.mean()), float(low), float(high), text or f"{hits.sum()} of {len(hits)}")


def statements(found: Study) -> list[Statement]:
    """The claims of the paper, by section."""

    def runs(test: str, names: Iterable[str]) -> list[Reading]:
        return [shared(getattr(found.random(name), test), name) for name in names]

    def against(names: Iterable[str], part: str, ratio: bool) -> list[Reading]:
        return [found.compared(SDRE, name, part, ratio=ratio).reading(f"against {name}") for name in names]

    def later() -> list[Reading]:
        return [found.compared(name, SDRE, "settling_time").reading(name) for name in READINGS]

    def stiffer() -> list[Reading]:
        left = {name: found.pushed(name) for name in (SDRE, *READINGS)}
        text = ", ".join(f"{name} {angle:.3f}" for name, angle in left.items())
        return [Reading(LITERAL, left[LITERAL] / left[SDRE], text=f"deg under {1e3 * PUSH:g} mN m: {text}")]

    def level(names: Sequence[str]) -> list[Reading]:
        return [
            Reading(name, float(found.levels[name].max()), text=f"{found.levels[name][0]:.3g} at the target, "
                    f"{len(found.levels[name])} states")
            for name in names
        ]  # fmt: skip

    def pair(make: Callable[..., tuple[np.ndarray, np.ndarray]], q: Sequence[float], what: str = "") -> Reading:
        rest, slow = (out_of_reach(*make(np.array(q), np.full(3, rate))) for rate in (0.0, 1e-4))
        return Reading(what, min(rest, slow), text=f"{rest:.1g} at rest, {slow:.1g} at 1e-4 rad/s about each axis")

    def moved() -> list[Reading]:
        first, second = (found.moved(name) for name in NOMINAL)
        n = min(len(first), len(second))
        if not n:
            raise IndexError("the runs with the nominal inertia")
        medians = ", ".join(f"{name} {np.median(t):.0f} s" for name, t in zip(NOMINAL, (first, second), strict=True))
        by = paired(first[:n], second[:n])
        return [Reading("", by.median, by.low, by.high, f"Wilcoxon p = {by.wilcoxon:.2g}; medians: {medians}")]

    def farther() -> list[Reading]:
        by = found.compared(LQR, SHORT, "path", behind=True)
        return [Reading("", by.median / DEG, by.low / DEG, by.high / DEG, f"farther in {by.larger} of {by.runs}")]

    target, aside = (1.0, 0.0, 0.0, 0.0), (0.5, 0.5, -0.5, 0.5)
    return [
        Statement("SDRE performs better than PID: settling time", "section 1, of [5]",
                  lambda: against([PID], "settling_time", False), SOONER,
                  why=f"the paper gives no gains; ours has the LQR's bandwidth, integral time {INTEGRAL_TIME:g} s"),
        Statement("SDRE performs better than PID: torque", "section 1, of [5]",
                  lambda: against([PID], "given", True), CHEAPER),
        Statement("Nonlinear control performs better than linear: settling time", "abstract",
                  lambda: against(LINEAR, "settling_time", False), SOONER, depends=LAW,
                  why="LQR without the sign of q0 goes the long way round; the others do not"),
        Statement("Nonlinear control performs better than linear: torque", "abstract",
                  lambda: against(LINEAR, "given", True), CHEAPER, depends=LAW),
        Statement("Nonlinear control can be more sensitive to uncertain parameters", "abstract", moved, MOVED),
        Statement("A linear law of three quaternion components stabilises globally", "section 1, of [18]",
                  lambda: runs("settled", [LQR, SHORT]), SETTLES, depends="whether it takes the short way"),
        Statement("An exogenous signal is attenuated by gamma in each step", "section 2.1", lambda: level(READINGS),
                  LEVEL, depends=READ,
                  why="the static laws leave the observer out, which the level is proved with; the third equation of "
                  "step 5 does not bring it back"),
        Statement("A quaternion can make the loop unwind: a long way back from nearby", "section 3.1", farther,
                  FARTHER, why="-K [qv; w] pushes towards q0 = 1 alone"),
        Statement("Eq. 14 with Omega is not pointwise stabilisable", "section 4.1",
                  lambda: [pair(rate_pair, target)], NOT, why="the torque does not reach the quaternion"),
        Statement("Eq. 14 with Xi is not pointwise stabilisable", "section 4.1",
                  lambda: [pair(attitude_pair, target, "target"), pair(attitude_pair, aside, "aside")], NOT,
                  why="the length of the quaternion cannot be moved"),
        Statement("Eq. 26 is pointwise stabilisable", "section 4.1", lambda: [pair(printed_pair, target)],
                  STABILISABLE, why="at rest its fourth state is moved by nothing; we fly six states"),
        Statement("SDRE is robust to +-20 % in the inertia", "abstract, sections 5 and 6",
                  lambda: runs("settled", [SDRE]), SETTLES, printed="100 runs, no count"),
        Statement("... and comes to rest at the target by the end", "section 5, by our stricter test",
                  lambda: runs("converged", [SDRE]), RESTS),
        Statement("SDRE + Hinf is robust to +-20 % in the inertia", "sections 5 and 6",
                  lambda: runs("settled", READINGS), SETTLES, printed="100 runs, no count", depends=READ),
        Statement("... and comes to rest at the target by the end (SDRE + Hinf)", "section 5, by our stricter test",
                  lambda: runs("converged", READINGS), RESTS, depends=READ,
                  why="as published it is so slow that not all runs are there after 1800 s"),
        Statement("SDRE + Hinf uses more time than SDRE to stabilise", "section 5, figure 3", later, LATER,
                  depends=READ, why="slow is the sign of L in eq. 13 as it has to be changed for the published result"),
        Statement("It is slower because it rejects disturbances better", "section 6, as a conjecture",
                  stiffer, STIFFER, why="observed is the slow law, as published"),
        Statement("Exactly three Riccati equations give the suboptimal controller", "section 6",
                  lambda: level([DYNAMIC]), FEWER, printed="3",
                  why=f"{EQUATIONS[DYNAMIC]} equations give the level that is asked for, without iterating over gamma; "
                  "with C = 1 one of them is that of SDRE itself"),
    ]  # fmt: skip


def counterparts() -> list[Claim]:
    """Tables and figures that state nothing, and what is left out."""
    return [
        drawn("table 1", "satellite, wheels, references", "numbers of the study, plants/missions/amazonia1.py"),
        drawn("figure 2", "control loop", "the loop that is flown: ideal sensors, three wheels with their limits"),
        drawn("figure 3a", "quaternion errors and rates of SDRE", "Figure 3, a"),
        drawn("figure 3b", "quaternion errors and rates of SDRE + Hinf", "Figure 3, b"),
        left_out("figure 1", "robust stabilisation of coprime factors", "a block diagram; its level is judged, eq. 12"),
        left_out("section 1", "simple, tractable, flexible; its drawback the computation", "nothing is measured"),
        left_out("section 3.1", "eq. 16 is global", "an identity of kinematics, held by tests"),
        left_out("section 6", "the approach by coprime factors is a contribution", "an opinion"),
    ]


def findings(found: Study) -> list[str]:
    """What the paper does not say, in sentences with figures."""
    said = []
    if {SDRE, LQR, SHORT, MRP} <= set(found.campaigns):
        both, fair = (found.compared(SDRE, name, "settling_time") for name in (LQR, SHORT))
        torque, thrift = (found.compared(name, SHORT, "given", ratio=True) for name in (SDRE, MRP))
        said.append(
            f"What SDRE has over LQR is the sign of q0. Over the same starts it settles {spelled(both)} beside LQR, "
            f"from q0 < 0 {side(found, LQR, True)}, else {side(found, LQR, False)}. Beside an LQR that takes the "
            f"short way, one comparison more, it settles {spelled(fair)} with {more(torque)} torque; with modified "
            f"Rodrigues parameters, another factorisation, it takes {more(thrift)}."
        )
    if {STATIC, DYNAMIC, LITERAL} <= set(found.levels):
        top = {name: values.max() for name, values in found.levels.items()}
        said.append(
            f"With its observer the H-infinity law has {top[DYNAMIC]:.3f} of the norm asked for; as published it "
            f"has {top[LITERAL]:.1f} times as much, with the static gain {top[STATIC]:.0f} times, and SDRE itself has "
            f"{top[SDRE]:.1f} times the best."
        )
    for name in found.fine:
        apart = found.refined(name)
        said.append(
            f"Flown with a period of {found.period:g} s where the paper has {amazonia1.PERIOD:g} s (--period "
            f"{amazonia1.PERIOD:g} flies it): with both, {name} settles at most {apart.max(initial=0.0):.0f} s apart "
            f"in {len(apart)} runs."
        )
    return said


def more(by: Paired) -> str:
    """A ratio in words."""
    text = f"{abs(by.median - 1):.0%} {'more' if by.median > 1 else 'less'}"
    return f"{text} (ratio {by.low:.2f} to {by.high:.2f})"


def side(found: Study, name: str, behind: bool) -> str:
    """SDRE against a law, of the starts on one side of q0 = 0."""
    try:
        return spelled(found.compared(SDRE, name, "settling_time", behind=behind))
    except IndexError:
        return "(none)"


def spelled(by: Paired) -> str:
    """A paired difference of times in words."""
    return f"{by.median:+.1f} s ({by.low:+.1f} to {by.high:+.1f} s, Wilcoxon p = {by.wilcoxon:.2g}, n = {by.runs})"


def summary(found: Study) -> str:
    """Which controller to take, by the flights."""
    sound = [name for name in found.campaigns if found.random(name).converged.all()]
    if not sound or SDRE not in sound:
        return ""
    times = {name: float(np.median(found.random(name).settling_time)) for name in sound}
    torques = {name: 1e3 * float(found.random(name).given.mean()) for name in sound}
    fastest, thrifty = min(times, key=times.__getitem__), min(torques, key=torques.__getitem__)
    plain = min((name for name in LINEAR if name in sound), key=times.__getitem__, default=SDRE)
    kinds = {"for speed": fastest, "for torque": thrifty, "for constant gains": plain}
    told = {name: " and ".join(kind for kind, taken in kinds.items() if taken == name) for name in kinds.values()}
    taken = ", ".join(f"{name} {kind} ({times[name]:.0f} s, {torques[name]:.1f} mN m)" for name, kind in told.items())
    return (
        f"Of the {len(sound)} laws that bring all {len(found.random(SDRE).given)} runs to rest take {taken}; "
        f"SDRE of the paper has {times[SDRE]:.0f} s and {torques[SDRE]:.1f} mN m (medians of the settling time, mean "
        "torques)."
    )
