"""What the study states, judged by rules, and which controller to take."""

from __future__ import annotations

import numpy as np
from flexible_designs import DAMPED, MU, NOMINAL, PD, SPREAD, SPREAD_OF_DAMPING, SPREAD_OF_MU, TUNED, law, uncertain
from flexible_flights import QUIET, Study

from plants import Reading, Rule, Statement, clopper_pearson
from synth import StateSpace, margins

BREAKS = Rule("deviation of all parameters that makes the loop unstable", "<", 1, "%")
BELOW = Rule("proved gain over the box", "<", 1)
PRICE = Rule("proved gain over the box, over what no controller undercuts without uncertainty", "<", 1.25)
WORSE = Rule("gain in the box over what is proved for the tuned controller", ">", 1.5)
KEEPS = Rule(f"share of flights with less than {QUIET:g} deg rms of roll", ">", 0.8)
AGREE = Rule("share of flights that are quiet where the poles are stable and swing where they are not", ">", 0.8)


def statements(found: Study) -> list[Statement]:
    """All of them."""

    def broken() -> list[Reading]:
        m = found.margins[NOMINAL]
        at = ", ".join(f"{name} = {value:.6g}" for name, value in m.parameters.items())
        return [Reading("", SPREAD * m.upper, text=f"pole {m.eigenvalue:.3g} rad/s with {at}")]

    def proved() -> list[Reading]:
        return [Reading("", found.gains[TUNED][SPREAD].upper), Reading("with the damping", found.whole[TUNED].upper)]

    def price() -> list[Reading]:
        return [Reading("", found.gains[TUNED][SPREAD].upper / found.optimum.lower)]

    def worse() -> list[Reading]:
        ours = found.gains[TUNED][SPREAD].upper
        return [Reading(name, found.gains[name][SPREAD].lower / ours) for name in (DAMPED, PD)]

    def share(names: tuple[str, ...], agree: bool) -> list[Reading]:
        made = []
        for name in names:
            quiet = found.quiet(name)
            hits = quiet == found.stable(name) if agree else quiet
            low, high = clopper_pearson(int(hits.sum()), len(hits))
            made.append(Reading(name, float(hits.mean()), float(low), float(high), f"{hits.sum()} of {len(hits)}"))
        return made

    box = f"inertia and frequencies within {SPREAD:g} %"
    return [
        Statement("The optimum for the nominal parameters does not survive 1 % of them", "the counterexample", broken,
                  BREAKS, why="it cancels modes by notches, which are as narrow as the modes are damped"),
        Statement(f"A controller of second order keeps its gain below 1 with {box}", "the proof", proved, BELOW,
                  depends="the damping"),
        Statement("... for less than a quarter more than the optimum has without uncertainty", "the proof", price,
                  PRICE),
        Statement("... and with much less than the simpler ways", "the proof", worse, WORSE, depends="the way"),
        Statement("The optimum holds the attitude in flight all the same", "the flights",
                  lambda: share((NOMINAL,), False), KEEPS),
        Statement("What is proved stable holds it", "the flights", lambda: share((DAMPED, TUNED, PD), False), KEEPS,
                  depends="the controller"),
        Statement("Poles of the linear roll axis tell which nonlinear flights swing", "the flights",
                  lambda: share((NOMINAL,), True), AGREE),
    ]  # fmt: skip


def findings(found: Study) -> list[str]:
    """In sentences with figures."""
    said = []
    if NOMINAL in found.designs:
        G = uncertain().nominal
        m = margins(StateSpace(G.A, G.B[:, 2:], G.C[2:], np.zeros((1, 1)), 0), law(found.designs[NOMINAL]), sign=1)
        said.append(
            f"The optimum's margins look sound: {m.input[0].phase_deg:.0f} deg of phase, {m.input[0].delay:.2f} s of "
            f"delay, {m.disk_input.gain_db:.1f} dB on a disk. Gain and phase at the plant's input are not the "
            "frequency of a mode: only the box tells."
        )
    if all(SPREAD in found.gains.get(name, {}) for name in (DAMPED, TUNED, PD)):
        said.append(
            "Rolling off earlier does not help. Torque and angle are at the same place, so a controller with phase "
            "lead up to the last mode takes energy from every mode, whatever its frequency. PD has the lead at the "
            f"price of noise: its gain is {found.gains[PD][SPREAD].lower:.3g}, the tuned controller's "
            f"{found.gains[TUNED][SPREAD].lower:.3g}."
        )
    if MU in found.margins:
        said.append(
            "D-K iteration takes real numbers for complex ones, and a complex change of a stiffness is negative "
            f"damping as well: over wide boxes it ends far above one. Over {SPREAD_OF_MU:g} % it ends at mu = "
            f"{found.designs[MU].mu.upper:.2f} with order {found.designs[MU].controller.n}, and the real box that its "
            f"loop is proved to bear is {SPREAD * found.margins[MU].lower:.3g} %."
        )
    return said


def summary(found: Study) -> str:
    """Which controller to take."""
    if not found.complete or TUNED not in found.whole:
        return ""
    optimum, quiet = found.designs[NOMINAL], found.quiet(NOMINAL)
    return (
        f"Take the tuned controller of second order: with inertia and frequencies within {SPREAD:g} % and damping "
        f"within {SPREAD_OF_DAMPING:g} % its gain is proved below {found.whole[TUNED].upper:.3f}. The optimum of order "
        f"{optimum.controller.n} has {optimum.gamma:.3f} at the nominal parameters and is unstable "
        f"{SPREAD * found.margins[NOMINAL].upper:.2g} % away from them: {(~quiet).sum()} of {len(quiet)} flights swing."
    )


def least_quiet(found: Study) -> int:
    """The flight in which the nominal optimum swings most."""
    return int(np.argmax(np.nan_to_num(np.asarray(found.outcome(NOMINAL).error), posinf=0.0)))
