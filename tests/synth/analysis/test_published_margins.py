"""Gain, phase, delay and disk margins that others print: manuals, papers, books, and the tests of other packages.

A number is held to its last printed digit, rounded or cut. Some prints are looser than they look, read off a grid of
frequencies or computed in rounded arithmetic: these are named as loose, shown to be so, and the value is tested against
exact arithmetic instead, as every number of a continuous loop is.

Sources: python-control, `margin_test.py` (among them the loops of Bavafi-Toosi (2015), J. Control Syst. Eng. 3(1), 51)
and issues #465, #947; Octave control 3.4, `margin.m`; ControlSystems.jl, `test_analysis.jl`; jamestjsp/controlsys;
MathWorks, Control System and Robust Control Toolbox, pages `margin`, `allmargin`, `diskmargin`, "Assessing Gain and
Phase Margins", "Disk Margin and Smallest Destabilizing Perturbation"; Seiler, Packard and Gahinet (2020), IEEE Control
Systems 40(5), 78; Skogestad and Postlethwaite (2005), Multivariable Feedback Control, sections 2.4 and 2.6; Astrom and
Murray (2008), Feedback Systems, section 9.3; Kuo, Automatic Control Systems; Dorf and Bishop, Modern Control Systems.
"""

from dataclasses import dataclass, field
from functools import cache, reduce

import numpy as np
import pytest
from exact import SKEWS, exact_margins, numbered
from numpy.typing import ArrayLike

from synth import StateSpace, allmargin, c2d, diskmargin, margin, system


def p(*factors) -> np.ndarray:
    """Product of polynomials, highest power first."""
    return reduce(np.polymul, factors, np.ones(1))


@dataclass(frozen=True, eq=False)
class Case:
    """A loop of one signal and the numbers that are printed for it."""

    num: ArrayLike
    den: ArrayLike
    printed: dict[str, str]
    loose: dict[str, str] = field(default_factory=dict)
    dt: float = 0.0  # s, of num / den in z
    hold: float = 0.0  # s, of the hold with which num / den in s is sampled

    @property
    def loop(self) -> StateSpace:
        L = system(self.num, self.den, self.dt) if self.dt else system(self.num, self.den)
        return c2d(L, self.hold) if self.hold else L


TORTURE = p([0.002], [1, 0.02], [1, 0.05], [1, 5], [1, 10])
TORTURED = p([1, -0.0005], [1, 0.0001], [1, 0.01], [1, 0.2], [1, 1], [1, 100], [1, 100])
INVERSE = p([10, 1], [5, 1])  # Skogestad and Postlethwaite's inverse response process is 3 (1 - 2 s) / INVERSE
DISTURBED = p([10, 1], [0.05, 1], [0.05, 1])  # and 200 / DISTURBED their disturbance process
MASSES = p([1, 2, 100], [1, 2, 100]) - np.pad(p([1, 100], [1, 100]), (2, 0))  # two masses, a spring, three dampers

CASES = {
    "python-control: (s+2)/(s^2+2s+3)": Case([1, 2], [1, 2, 3], {"gain up": "inf"}),
    "python-control: 1/(s^3+2s^2+3s+4)": Case(
        [1],
        [1, 2, 3, 4],
        {"gain up": "2.", "gain at": "1.7321", "real 0": "-0.5", "alpha 1": "0.4170", "at 1": "1.6620"},
        {"gain at": "1.7325"},
    ),
    "python-control: (s-18)/((s-5)(s+2))": Case(
        [1, -18], [1, -3, -10], {"phase 0": "147.0743", "phase 0 at": "2.5483"}
    ),
    "python-control: four resonances": Case(
        p([8.75], [4, 0.4, 1]),
        p([100, 1], [1, 0.22, 1], [0.01, 0.008, 1]),
        {
            "gain up": "2.2716",
            "gain at": "10.0053",
            "phase at": "0.0850",
            "phase 1": "-157.7844",
            "phase 1 at": "0.9373",
            "phase 2 at": "1.0919",
            "alpha 1": "0.5591",
            "at 1": "9.9918",
        },
        {"phase": "97.5941", "phase 2": "134.7359"},
    ),
    "python-control: zero in the right half plane": Case(
        p([-0.01, 0.1]),
        p([1, 2], [1, 1]),
        {"gain up": "300.0", "gain at": "5.6569", "alpha 1": "0.9917", "at 1": "2.3171"},
    ),
    "python-control: 2/(s+1)^3": Case(
        [2],
        [1, 3, 3, 1],
        {"gain up": "4.000", "real 0": "-0.25", "gain at": "1.732"},
        {"phase": "67.6058", "gain at": "1.7322", "phase at": "0.7663"},
    ),
    "python-control: 0.8/(s+1)^3": Case([0.8], [1, 3, 3, 1], {}, {"gain up": "10.0014", "gain at": "1.7322"}),
    "python-control: 200/(s(s+1)(s+20))": Case(
        [200], [1, 21, 20, 0], {"gain at": "4.47213595", "real 0": "-0.47619048"}
    ),
    "python-control: type -1": Case([2, 0], [1, 1], {"phase 0 at": "0.5774"}, {"phase 0": "-120.0007"}),
    "python-control: type 1": Case([1, 0.1], [1, 1, 0], {"phase": "144.9032", "phase at": "0.3162", "gain up": "inf"}),
    # MATLAB finds the gain margin 0 here: L is at -180 deg only in the limit, and every smaller gain is borne
    "python-control: type 2": Case(
        [1, 0.1], [1, 1, 0, 0], {"phase": "44.4594", "phase at": "0.7907", "gain up": "inf", "gain down": "0"}
    ),
    "python-control: type 3": Case(
        p([1, 0.1], [1, 0.1]),
        [1, 1, 0, 0, 0],
        {"phase at": "0.7951", "gain at": "0.1119"},
        {"gain down": "0.0626", "phase": "37.1748"},
    ),
    "python-control: Bavafi-Toosi 2.1": Case(
        TORTURE,
        TORTURED,
        {
            "gain 0": "0.01",
            "gain 0 at": "0",
            "gain 1 at": "0.0243",
            "gain 2": "22798",
            "gain 2 at": "0.4385",
            "phase 0": "-14.5640",
            "phase 0 at": "0.0022",
        },
        {
            "gain 1": "179.2931",
            "gain 3": "1.5946e7",
            "gain 4": "7.2477e8",
            "gain 3 at": "6.8640",
            "gain 4 at": "84.9323",
        },
    ),
    "python-control: Bavafi-Toosi 2.1 times 1000": Case(
        1000 * TORTURE,
        TORTURED,
        {"gain at": "0.0243", "phase": "22.5215", "phase at": "0.0630"},
        {"gain down": "0.1793"},
    ),
    "python-control: Bavafi-Toosi 2.1 times 5000": Case(
        5000 * TORTURE,
        TORTURED,
        {"gain up": "4.5596", "gain at": "0.4385", "phase": "21.2101", "phase at": "0.1868"},
    ),
    "python-control #947": Case(
        [1, 0.5, 0.05],
        [1, 0, 0, 0],
        {
            "gain down": "0.1",
            "phase": "63.84244593",
            "gain at": "0.22360679774",
            "phase at": "1.06498625115",
        },
    ),
    "python-control #465": Case(
        [2],
        [1, 3, 2, 0],
        {
            "gain up": "2.955761",
            "phase": "32.398492",
            "alpha 1": "0.429535",
            "gain at": "1.403725",
            "phase at": "0.749367",
            "at 1": "0.923898",
        },
        hold=0.01,
    ),
    "python-control #465, MATLAB": Case(
        [2], [1, 3, 2, 0], {"gain up": "2.79", "phase": "31.5", "gain at": "1.36", "phase at": "0.749"}, hold=0.05
    ),
    "python-control: 2/(s+1)^3 sampled": Case(
        [2],
        [1, 3, 3, 1],
        {
            "gain up": "3.4927",
            "phase": "65.4212",
            "alpha 1": "0.5763",
            "gain at": "1.6283",
            "phase at": "0.76625",
            "at 1": "1.2019",
        },
        hold=0.1,
    ),
    "python-control #523 a": Case(
        [4.4 * np.pi**2],
        [1, 0.8 * np.pi, 4 * np.pi**2],
        {
            "gain up": "2.3842",
            "phase": "18.161",
            "alpha 1": "0.26953",
            "gain at": "11.712",
            "phase at": "8.7478",
            "at 1": "9.1504",
        },
        hold=0.05,
    ),
    "python-control #523 b": Case(
        [5e4],
        [1, 101, 10101, 10100, 10000],
        {
            "gain up": "18.8766",
            "phase": "26.3564",
            "alpha 1": "0.406841",
            "gain at": "9.76358",
            "phase at": "2.32933",
            "at 1": "2.55986",
        },
        hold=1e-3,
    ),
    "python-control: third order in z": Case(
        [3e-4, 11e-4, 3e-4], [1, -2.7145, 2.4562, -0.7408], {"gain at": "1.6235", "real 0": "-0.28598"}, dt=0.1
    ),
    "Octave margin": Case(
        [24], [1, 6, 11, 6], {"gain up": "2.50", "phase": "35.43", "gain at": "3.32", "phase at": "2.06"}
    ),
    "Octave margin, sampled": Case(
        [24], [1, 6, 11, 6], {"gain up": "1.41", "phase": "18.60", "gain at": "2.48", "phase at": "2.04"}, hold=0.3
    ),
    # "phase at" is read off a grid of 100 frequencies
    "ControlSystems.jl: 1/(s(s+1))": Case([1], [1, 1, 0], {"gain up": "inf"}, {"phase at": "0.7871132"}),
    "ControlSystems.jl #961": Case([50], [5, 10.25, 6.25, 1], {"phase 0": "-35.1"}),
    "ControlSystems.jl: two masses": Case(p([100], [1, 2, 100]), p(MASSES, [0.002, 1]), {"delay": "0.037433"}),
    "MATLAB margin": Case(
        [0.04798, 0.0464],
        [1, -1.81, 0.9048],
        {"gain up": "2.0517", "phase": "13.5711", "gain at": "5.4374", "phase at": "4.3544"},
        dt=0.1,
    ),
    "MATLAB margin: 1/(s(s+1)^2)": Case([1], [1, 2, 1, 0], {"gain dB": "6.02", "phase": "21.4", "gain at": "1"}),
    "MATLAB: Assessing Gain and Phase Margins": Case([0.5, 1.3], [1, 1.2, 1.6, 0], {"gain up": "2.7"}),
    # MATLAB allmargin and diskmargin; Seiler, Packard and Gahinet read 1.94 rad/s off a grid
    "Seiler et al.: 25/(s^3+10s^2+10s+10)": Case(
        [25],
        [1, 10, 10, 10],
        {
            "gain up": "3.6000",
            "gain at": "3.1623",
            "phase": "29.1104",
            "phase at": "1.7844",
            "delay": "0.2847",
            "alpha 0": "0.46",
            "at 0": "1.96",
            "low 0": "0.6273",
            "high 0": "1.5942",
            "disk phase 0": "25.8",
            "disk dB 0": "4.05",
        },
        {"at 0": "1.94"},
    ),
    "controlsys: 1/2/(s+1)": Case(
        [0.5], [1, 1], {"alpha 0": "2", "disk phase 0": "90", "alpha 1": "1", "low 1": "0.5"}
    ),
    "controlsys: 10/(s+1)": Case([10], [1, 1], {"alpha 0": "2", "disk phase 0": "90", "alpha 1": "1", "low 1": "0.5"}),
    "Skogestad: inverse response": Case([-6, 3], INVERSE, {"gain up": "2.5", "gain at": "0.412"}),
    "Skogestad: PI": Case(
        1.136 * p([-6, 3], [12.7, 1]),
        p([12.7, 0], INVERSE),
        {"gain up": "1.63", "phase": "19.4", "phase at": "0.236", "delay": "1.44", "Ms": "3.92", "Mt": "3.35"},
    ),
    "Skogestad: unstable process": Case(
        p([5], [1.5, 1]) / 1.5,
        p([1, -1, 0], [0.02, 1], [0.02, 1]),
        {"gain up": "18.7", "gain down": "0.21", "phase": "59.5", "Ms": "1.19", "Mt": "1.38"},
    ),
    "Skogestad: loop shaping": Case(
        [-0.3, 0.15],
        p([1, 0], [2, 1], [0.33, 1]),
        {"gain up": "2.92", "phase": "54", "phase at": "0.15", "gain at": "0.43", "Ms": "1.75", "Mt": "1.11"},
    ),
    "Skogestad: disturbance process, K0": Case(
        p([10], [0.1, 1]),
        p([1, 0], [0.01, 1], [0.05, 1], [0.05, 1]),
        {"gain up": "9.95", "phase": "72.9", "phase at": "11.4", "Ms": "1.34", "Mt": "1"},
    ),
    "Skogestad: disturbance process, K1": Case(
        [100], DISTURBED, {"gain up": "4.04", "phase": "44.7", "phase at": "8.48", "Ms": "1.83", "Mt": "1.33"}
    ),
    "Skogestad: disturbance process, K2": Case(
        [100, 200],
        p([1, 0], DISTURBED),
        {"gain up": "3.24", "phase": "30.9", "phase at": "8.65", "Ms": "2.28", "Mt": "1.89"},
    ),
    "Skogestad: disturbance process, K3": Case(
        [100, 200],
        p([1, 0], [10, 1], [0.05, 1], [0.005, 1]),
        {"gain up": "19.7", "phase": "50.9", "phase at": "9.27", "Ms": "1.43", "Mt": "1.23"},
    ),
    "Astrom and Murray: 3/(s+1)^3": Case([3], [1, 3, 3, 1], {"gain up": "2.67", "phase": "41.7"}),
    # the gain margin is infinite: near 10 rad/s, where |L| is 1/266, L lags by 174.5 deg, and never by 180
    "Astrom and Murray: good margins, little distance": Case(
        p([0.38], [1, 0.1, 0.55]),
        p([1, 1, 0], [1, 0.06, 0.5]),
        {"phase": "70", "alpha 1": "0.27", "gain up": "inf"},
    ),
    "Kuo: 2500/(s(s+5)(s+50))": Case(
        [2500], [1, 55, 250, 0], {"gain dB": "14.80", "phase": "31.72", "phase at": "6.22"}
    ),
    "Dorf: 1/(s(s+1)(s/5+1))": Case([1], [0.2, 1.2, 1, 0], {"gain dB": "15", "phase": "43"}),
}


@cache
def measured(source: str) -> dict[str, float]:
    """All numbers of a loop, by their names above."""
    L = CASES[source].loop
    one, every = margin(L), allmargin(L)
    out = {
        "gain up": one.gain_up,
        "gain down": one.gain_down,
        "gain dB": one.gain_db,
        "gain at": one.gain_frequency,
        "phase": one.phase_deg,
        "phase at": one.phase_frequency,
        "delay": one.delay,
        **numbered(every.gain_frequency, every.gain, "gain"),
        **numbered(every.phase_frequency, np.rad2deg(every.phase), "phase"),
        **numbered(every.gain_frequency, -1 / every.gain, "real"),
    }
    for skew in SKEWS if every.stable else ():
        disk = diskmargin(L, skew=skew)
        names = ("alpha", "at", "low", "high", "disk phase", "disk dB")
        values = (disk.alpha, disk.frequency, *disk.gain, disk.phase_deg, disk.gain_db)
        out |= {f"{name} {skew}": value for name, value in zip(names, values, strict=True)}
    return out | ({"Ms": 1 / out["alpha 1"], "Mt": 1 / out["alpha -1"]} if every.stable else {})


def numbers(kind: str) -> list:
    return [
        pytest.param(source, name, text, id=f"{source}: {name} {text}")
        for source, case in CASES.items()
        for name, text in getattr(case, kind).items()
    ]


def unit(text: str) -> float:
    """Of the last digit."""
    digits, _, power = text.partition("e")
    return 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))


@pytest.mark.parametrize(("source", "name", "text"), numbers("printed"))
def test_printed(source, name, text):
    found = measured(source)[name]
    assert found == float(text) or abs(found - float(text)) <= unit(text), found


@cache
def exact(source: str) -> dict[str, float]:
    return exact_margins(CASES[source].num, CASES[source].den)


@pytest.mark.parametrize(("source", "name", "text"), numbers("loose"))
def test_loose_prints_are_bettered(source, name, text):
    true = exact(source)[name]
    assert unit(text) / 2 < abs(float(text) - true) < 0.01 * abs(true)
    assert measured(source)[name] == pytest.approx(true, rel=1e-6)


CONTINUOUS = [source for source, case in CASES.items() if not case.dt + case.hold]


@pytest.mark.parametrize("source", CONTINUOUS)
def test_in_exact_arithmetic(source):
    found, true = measured(source), exact(source)
    for name, value in true.items():
        if not name.startswith("at "):  # a peak is flat
            assert found[name] == pytest.approx(value, rel=1e-8, abs=1e-12, nan_ok=True), name


@pytest.mark.parametrize("source", CONTINUOUS)
def test_no_crossing_is_invented(source):
    def names(numbers) -> set[str]:
        return {name for name in numbers if name.startswith(("gain", "phase")) and any(map(str.isdigit, name))}

    assert names(measured(source)) == names(exact(source))
