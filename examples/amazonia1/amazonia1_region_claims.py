"""What Romero and Souza (WSEAS 2022) state about regions of attraction, measured; the text begins in section 5."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from amazonia1_claims import share, shared
from amazonia1_flights import LQR, SDRE

from plants import Claim, Reading, Rule, Statement, amazonia1, clopper_pearson, drawn, left_out, paired
from plants.missions.amazonia1 import DEG, REGION_RATE, REGION_RATE_NORM

if TYPE_CHECKING:
    from amazonia1_region import Study

TITLE = "002 Romero and Souza (WSEAS 2022)"
PAPER = (LQR, SDRE)
TESTS = {"attitude and rate": "converged", "rate only": "slow"}
MATTERS = 0.05  # of all initial conditions: by so much a region has to be larger, ours
EVEN = 0.5  # least share of a quarter of the angles over the largest, ours
QUARTERS = 40  # runs from which quarters are looked at
RATES, RATE_NORM = (0.0385, 0.0332, 0.0225), 0.0556  # rad/s, section 5, as printed
BOUNDS = (270.0, 0.066)  # deg, rad/s, section 5, of the plane of figures 1 and 3
DIGITS = 5e-3  # relative, of figures that are printed with three digits

LARGER = Rule("share that SDRE brings to rest less that of LQR", ">", MATTERS)
GLOBAL = Rule("share that converges", "<", 1)
WHOLE = Rule("least share that converges in a quarter of the angles, over the largest", ">", EVEN)
WITHIN = Rule("largest |w0| that converged", "<=", REGION_RATE_NORM, "rad/s")
LACK = Rule("mean torque given over mean torque asked, median of the runs", "<", 1)
EQUAL = Rule("relative difference from the printed figure", "<=", DIGITS)
TEST = "the test of convergence"


def statements(found: Study) -> list[Statement]:
    """The claims of the paper."""

    def by_test(reading: Callable[[str, str], Reading]) -> list[Reading]:
        return [reading(label, test) for label, test in TESTS.items()]

    def larger(label: str, test: str) -> Reading:
        """Runs that one brings to rest and the other does not; the interval joins those of both counts."""
        first, second = (found.campaigns[name].index for name in PAPER)
        both = np.intersect1d(first, second)
        lqr, sdre = (getattr(found.outcome(name), test)[np.isin(found.campaigns[name].index, both)] for name in PAPER)
        alone, other, n = int((sdre & ~lqr).sum()), int((lqr & ~sdre).sum()), len(both)
        (low, high), (less, most) = (clopper_pearson(k, n, 0.975) for k in (alone, other))
        text = f"SDRE {sdre.sum()}, LQR {lqr.sum()} of {n}; SDRE alone {alone}, LQR alone {other}"
        return Reading(label, (alone - other) / n, float(low - most), float(high - less), text)

    def not_global(label: str, test: str) -> Reading:
        hits = {name: getattr(found.outcome(name), test) for name in PAPER}
        most = max(PAPER, key=lambda name: hits[name].mean())
        return shared(hits[most], label, ", ".join(f"{name} {share(h)}" for name, h in hits.items()))

    def all_angles(name: str) -> Reading:
        """By the norm of the Euler angles, quarter by quarter."""
        o, index = found.outcome(name), found.campaigns[name].index
        size = np.linalg.norm(found.drawn.angles[index], axis=1)
        if len(size) < QUARTERS:
            raise IndexError(f"{QUARTERS} runs")
        quarter = np.digitize(size, np.quantile(size, [0.25, 0.5, 0.75]))
        hits = [o.converged[quarter == k] for k in range(4)]
        least, most = (shared(choose(hits, key=np.mean)) for choose in (min, max))
        ends = least.low / most.high, min(least.high / most.low, 1.0) if most.low else 1.0
        return Reading(name, least.value / most.value, *ends, text=", ".join(f"{h.sum()}/{h.size}" for h in hits))

    def within(label: str, test: str) -> Reading:
        size = np.linalg.norm(found.drawn.rates, axis=1)
        largest = {
            name: size[found.campaigns[name].index][getattr(found.outcome(name), test)].max(initial=0.0)
            for name in PAPER
        }
        return Reading(label, max(largest.values()), text=", ".join(f"{k} {v:.4f}" for k, v in largest.items()))

    def lack(name: str) -> Reading:
        return paired(found.outcome(name).given, found.outcome(name).asked, ratio=True).reading(name)

    def rates() -> list[Reading]:
        w = np.linalg.solve(amazonia1.INERTIA, np.full(3, amazonia1.MOMENTUM))
        ours, printed = (*w, np.linalg.norm(w)), (*RATES, RATE_NORM)
        names = (*(f"w{axis}" for axis in "xyz"), "norm")
        return [
            Reading(name, abs(float(a) / b - 1), text=f"{a:.4f} rad/s")
            for name, a, b in zip(names, ours, printed, strict=True)
        ]

    def plane() -> list[Reading]:
        ours = (np.linalg.norm([180.0, 90.0, 180.0]), np.linalg.norm(np.full(3, REGION_RATE)))
        return [
            Reading(name, abs(float(a) / b - 1), text=f"{a:.4g} {unit}")
            for name, a, b, unit in zip(("angles", "rates"), ours, BOUNDS, ("deg", "rad/s"), strict=True)
        ]

    return [
        Statement("The wheels hold the momentum of 0.0385, 0.0332, 0.0225 rad/s, norm 0.0556", "section 5", rates,
                  EQUAL, depends="the axis", printed="0.0385, 0.0332, 0.0225; 0.0556 rad/s"),
        Statement("Initial conditions lie within 270 deg and 0.066 rad/s", "section 5", plane, EQUAL,
                  printed="270 deg, 0.066 rad/s", depends="the norm",
                  why="three rates of up to 0.0385 rad/s have a norm of up to 0.0667 rad/s"),
        Statement("The torque given is smaller than the torque computed", "section 5, figure 2",
                  lambda: [lack(name) for name in PAPER], LACK, depends="the controller"),
        Statement("Neither is globally asymptotically stable with these wheels", "section 5, figure 3",
                  lambda: by_test(not_global), GLOBAL, depends=TEST,
                  why="momentum bounds any controller: half of the initial conditions are beyond the wheels"),
        Statement("SDRE has a larger region of attraction than LQR", "section 5, figure 3; section 6",
                  lambda: by_test(larger), LARGER, depends=TEST,
                  why="beyond the wheels' momentum SDRE stops the body at an attitude that is not the desired one"),
        Statement("Both control the whole range of Euler angles", "section 5, figure 3",
                  lambda: [all_angles(name) for name in PAPER], WHOLE, depends="the controller"),
        Statement("No region of attraction reaches beyond |w0| = 0.0556 rad/s", "section 5",
                  lambda: by_test(within), WITHIN, printed="0.0556 rad/s", depends=TEST, why=weak(found)),
    ]  # fmt: skip


def weak(found: Study) -> str:
    """How little the paper's limit says."""
    below = np.linalg.norm(found.drawn.rates, axis=1) <= REGION_RATE_NORM
    outside = (found.load[below] > 1).mean() if below.any() else 0.0
    return f"the limit says little: {outside:.0%} of the initial conditions below it are beyond the wheels' momentum"


def counterparts() -> list[Claim]:
    """Tables and figures, and what is left out."""
    lost = "missing from the text we have, which begins in section 5"
    return [
        drawn("figure 1", "initial conditions", "Figures 1 to 3, first"),
        drawn("figure 2", "computed against actual control", "Figures 1 to 3, second"),
        drawn("figure 3", "regions of attraction", "Figures 1 to 3, third"),
        left_out("sections 1 to 4", "model and controllers", lost),
        left_out("table 1", "satellite", f"{lost}; that of paper 000 is taken"),
        left_out("table 2", "parameters of the Monte Carlo", f"{lost}; section 5 tells those that are flown"),
        left_out("equation 15", "test of convergence", f"{lost}; two readings are judged"),
        left_out("section 6", "the approach is tractable; confidence is a matter of computing", "an opinion"),
    ]


def reached(found: Study) -> list[str]:
    """What the paper does not say: who reaches what can be reached."""
    if not found.campaigns:
        return []
    counts = []
    for name in found.campaigns:
        feasible = found.feasible(name)
        counts.append(f"{name} {(found.outcome(name).converged & feasible).sum()} of {feasible.sum()}")
    return [
        f"Of the initial conditions that the wheels can bring to rest at the desired attitude reach it: "
        f"{', '.join(counts)}. No controller can reach the others: the momentum has to go into the wheels."
    ]


def findings(found: Study, period: float) -> list[str]:
    """How sharp the bound of momentum is, where runs come so near that it matters."""
    beyond = {name: found.load[flown.index[found.outcome(name).converged]] for name, flown in found.campaigns.items()}
    beyond = {name: load[load > 1] for name, load in beyond.items() if (load > 1).any()}
    if not beyond:
        return []
    text = ", ".join(f"{name} {len(load)} (by at most {load.max() - 1:.2%})" for name, load in beyond.items())
    added = amazonia1.WHEEL_TORQUE * period / amazonia1.MOMENTUM
    kept = amazonia1.SLOW * np.diag(amazonia1.INERTIA).max() / amazonia1.MOMENTUM
    return [
        f"Converged beyond the momentum of the wheels: {text}. The bound is that sharp: a wheel passes its speed limit "
        f"by what the motor adds in a period, {added:.2%} of it, and the tests let the body keep {kept:.2%}.",
    ]


def summary(found: Study) -> str:
    """Which controller to take, by the flights."""
    if not found.complete:
        return ""
    counts = {name: int((found.outcome(name).converged & found.feasible(name)).sum()) for name in found.campaigns}
    path = {name: np.median(found.outcome(name).path[found.feasible(name)]) / DEG for name in counts}
    best = max(counts, key=lambda name: (counts[name], -path[name]))
    rest = ", ".join(f"{name} {counts[name]} and {path[name]:.0f} deg" for name in counts if name != best)
    return (
        f"Take {best}: it brings {counts[best]} of the {found.feasible(best).sum()} initial conditions to rest that "
        f"the wheels can hold, and turns {path[best]:.0f} deg for it (median); {rest}. What is beyond takes larger "
        "wheels."
    )
