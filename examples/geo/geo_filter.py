"""Chapter 3: the extended Kalman filter, and the coordinate that its three measurements do not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

import geo_controllers as design
import numpy as np
from geo_flights import short
from scipy.stats import chi2

from plants import (
    Observability,
    Reading,
    Rule,
    Run,
    Statement,
    StationEkf,
    Table,
    geo,
    nees,
    observability,
    simulate_many,
)
from plants.missions.geo import DAY, SAMPLE, TIDE_WALK, TRACKING_NOISE
from plants.outcome.consistency import Consistency

if TYPE_CHECKING:
    from geo_flights import Study

THREE = TRACKING_NOISE[:3]  # radius, its rate, latitude: equation 3.13
PAPER, PAPER_TOLD = "three measurements (3.13), Earth alone", "three measurements, Moon and Sun known"
OURS, OURS_UNTOLD = "with the longitude, Moon and Sun known", "with the longitude, Moon and Sun estimated"
TIDE = 8e-6  # m/s^2, of Moon and Sun: the process noise of a filter that is told of neither
FIRST = np.repeat([1e3, 0.1], 3)  # m, m/s, one sigma of the first guess
AXES, BETTER = (
    ("x (radial)", "y (along)", "z (normal)"),
    0.1,
)  # of the first guess: what has been learnt of a coordinate
EVERY = 120  # samples between two that are compared


@dataclass(frozen=True)
class Tracked:
    """A day of drift followed by filters of one kind from different first guesses."""

    runs: list[Run]

    @property
    def errors(self) -> np.ndarray:
        """(runs, N, 6) estimated less true, m and m/s."""
        return np.array([run.estimates - run.outputs for run in self.runs])

    @property
    def covariances(self) -> np.ndarray:
        """(runs, N, 6, 6) what the filters believe."""
        return np.array([run.extra for run in self.runs])

    @property
    def late(self) -> slice:
        """The second half."""
        return slice(len(self.runs[0].time) // 2, None, EVERY)

    @property
    def rms(self) -> np.ndarray:
        """(6,) over the second half and the runs."""
        return np.sqrt((self.errors[:, self.late] ** 2).mean(axis=(0, 1)))

    @property
    def believed(self) -> np.ndarray:
        """(6,) one sigma by the filters themselves."""
        return np.sqrt(np.diagonal(self.covariances[:, self.late], axis1=2, axis2=3).mean(axis=(0, 1)))

    @property
    def consistency(self) -> Consistency:
        """NEES per degree of freedom."""
        scale = np.repeat([1.0, 1e-4], 3)
        e, P = self.errors[:, self.late] / scale, self.covariances[:, self.late] / np.outer(scale, scale)
        return nees(e, P)

    def learnt(self) -> list[Reading]:
        """Error of each coordinate over that of the first guess, with the interval of a deviation of normal numbers."""
        n = len(self.runs)
        low, high = np.sqrt(n / chi2.ppf([0.975, 0.025], n))
        values = self.rms[:3] / FIRST[:3]
        return [Reading(axis, x, low * x, high * x) for axis, x in zip(AXES, values, strict=True)]


def filters(above: Any) -> dict[str, StationEkf]:
    """By what they measure and know; the thesis's are built by hand, for `geo.ekf` refuses what cannot see."""
    ours = geo.ekf(above)
    blind = replace(ours, sensors=geo.tracking(THREE), deviation=np.r_[FIRST, np.zeros(3)], walk=np.zeros(()))
    return {
        PAPER: replace(blind, model=geo.oblate(), push=np.asarray(TIDE)),
        PAPER_TOLD: blind,
        OURS: ours,
        OURS_UNTOLD: geo.ekf(above, model=geo.oblate(), walk=TIDE_WALK),
    }


def believed(x: Any, env: Any, sensors: Any, navigator: Any) -> Any:
    """The covariance of position and velocity, as a record."""
    del x, env, sensors
    return navigator.P[:6, :6]


def track(found: Study, runs: int, seed: int) -> None:
    """A day of free drift from the ideal point, by every filter from the same first guesses and noise."""
    guesses = np.random.default_rng(seed).normal(size=(runs, 6)) * FIRST
    loop, scenario = geo.case(geo.Coast(dt=SAMPLE), np.zeros(6), DAY, seed=seed)
    kinds = filters(scenario.environment)
    for pair in (PAPER, PAPER_TOLD), (OURS, OURS_UNTOLD):  # which measure alike, and share a program
        cases = [
            (replace(loop, sensors=f.sensors, navigator=replace(f, guess=guess)), replace(scenario, run=i))
            for f in (kinds[name] for name in pair)
            for i, guess in enumerate(guesses)
        ]
        flown = simulate_many(cases, record=believed)
        found.tracked |= {name: Tracked(flown[k * runs : (k + 1) * runs]) for k, name in enumerate(pair)}


def filter_table(found: Study) -> Table:
    """Errors, what the filters believe, and whether that is right."""
    rows = []
    for name, t in found.tracked.items():
        c = t.consistency
        errors = [short(x) for x in (*t.rms[:3], *t.believed[:3])]
        rows.append((name, f"{rank(name)} of 6", *errors, f"{c.mean:.3g}", c.verdict))
    headers = (
        "filter",
        "states seen",
        "x, m rms",
        "y, m rms",
        "z, m rms",
        "sigma x, m",
        "sigma y, m",
        "sigma z, m",
        "NEES per state",
        "the filter is",
    )
    runs = len(next(iter(found.tracked.values())).runs) if found.tracked else 0
    note = (
        f"A day of free drift, {runs} filters of each kind from guesses 1 km and 10 cm/s (one sigma) off; the second "
        f"half. Every {SAMPLE:g} s radius to {THREE[0]:g} m, its rate to {1e3 * THREE[1]:g} mm/s, height over the "
        f"equator and arc of longitude to {TRACKING_NOISE[3]:g} m. Sigma is what the filter believes. NEES: "
        "normalised estimation error squared, 1 for a filter that is right. The thesis says neither noise nor first "
        "guess."
    )
    return Table("The extended Kalman filter", headers, rows, note=note)


def rank(name: str) -> int:
    """States that a day of the measurements of a filter shows to within 1 km."""
    return 6 - len(seen(3 if name in (PAPER, PAPER_TOLD) else 4).hidden())


@cache
def seen(rows: int) -> Observability:
    """What a day of the first `rows` measurements tells of the six states."""
    sensors, above = geo.tracking(TRACKING_NOISE[:rows]), geo.sky(DAY).with_fixed_pole()
    return observability(geo.oblate(), sensors, above, np.zeros(6), h=SAMPLE, samples=round(DAY / SAMPLE))


def statements(found: Study) -> list[Statement]:
    """The claims of chapter 3, and of what later chapters make of the filter."""

    def simpler() -> list[Reading]:
        off, radius = 1e3, float(geo.satellite().radius)
        return [Reading("1 km off", off**2 / (2 * radius) / THREE[0])]

    def observable() -> list[Reading]:
        few, many = seen(3), seen(4)
        rows = (("(3.13)", few), ("with the longitude", many))
        return [
            Reading(name, 6 - len(s.hidden()), text=f"standard error of the worst direction {s.deviations[0]:.3g} m")
            for name, s in rows
        ]

    def controllable() -> list[Reading]:
        G, printed = design.relative_motion(found.rate, design.MINUTE), np.array([[0, 0, 0, 1, 1, 1.0]]).T
        kinds = {"B of 6 x 3": G.B, "B as printed (3.21), 6 x 1": printed}
        return [Reading(name, _krylov_rank(G.A, B)) for name, B in kinds.items()]

    def good() -> Sequence[Reading]:
        return found.tracked[PAPER].learnt()

    def good_with_longitude() -> Sequence[Reading]:
        return found.tracked[OURS].learnt()

    return [
        Statement(
            "r2^2 - r1^2 in place of r2 does not deteriorate the accuracy (3.12, 3.13)",
            "section 3.3",
            simpler,
            Rule("difference of the two over the noise of the radius", "<=", 0.1),
        ),
        Statement(
            "The observability matrix has rank 6",
            "section 4.4",
            observable,
            Rule("states that a day of measurements shows to within 1 km", ">=", 6),
            printed="6",
            depends="whether the longitude is measured",
            why="a turn about the pole changes neither radius nor latitude",
        ),
        Statement(
            "The controllability matrix has rank 6",
            "section 4.4",
            controllable,
            Rule("rank", ">=", 6),
            printed="6",
            depends="the size of B",
            why="the printed column pushes all three axes by one number",
        ),
        Statement(
            "With the extended Kalman filter there are very good estimations of x, y and z",
            "sections 3.4, 5.6",
            good,
            Rule("error in the second half of a day over that of the first guess", "<=", BETTER),
            depends="the axis",
            why="nothing that is measured tells y: the filter keeps its first guess, and says so in its covariance",
        ),
        Statement(
            "With the longitude measured too there are",
            "sections 3.4, 5.6, ours",
            good_with_longitude,
            Rule("error in the second half of a day over that of the first guess", "<=", BETTER),
            depends="the axis",
        ),
    ]


def _krylov_rank(A: np.ndarray, B: np.ndarray) -> int:
    """Rank of [B, A B, A^2 B, ...], in units of time in which the entries of A are alike."""
    n = design.relative_motion(geo.RATE, design.MINUTE).A[3, 4] / 2
    T = np.diag([1.0] * 3 + [1 / n] * 3)
    A = T @ A @ np.linalg.inv(T) / n
    columns = [T @ B]
    for _ in range(len(A) - 1):
        columns.append(A @ columns[-1])
    return int(np.linalg.matrix_rank(np.hstack(columns), tol=1e-9 * np.abs(np.hstack(columns)).max()))


def findings(found: Study) -> list[str]:
    """The most damning fact of the thesis."""
    if OURS_UNTOLD not in found.tracked:
        return []
    paper, ours = found.tracked[PAPER], found.tracked[OURS]
    told, untold = found.tracked[PAPER_TOLD], found.tracked[OURS_UNTOLD]
    return [
        "The thesis's filter does not see where along the orbit the satellite is. Radius, its rate and latitude are "
        f"the same at every longitude: {rank(PAPER)} of 6 states are observable. From a first guess 1 km off, y is "
        f"{paper.rms[1]:.0f} m off after a day (x {paper.rms[0]:.2g} m, z {paper.rms[2]:.2g} m), also with Moon and "
        f"Sun known ({told.rms[1]:.0f} m). Figure 3.4 can show good tracking of y only if the filter was started at "
        "the true y; chapters 4 to 6 feed that estimate to the controllers. Measuring the longitude mends it: "
        f"{ours.rms[1]:.2g} m. Told of Moon and Sun the filter knows that it does not know (it believes "
        f"{told.believed[1]:.0f} m, NEES {told.consistency.mean:.2g} per state), and nobody asked it; with (3.14) "
        f"alone it is too sure as well (NEES {paper.consistency.mean:.2g}).",
        "Of our own filters the one that estimates Moon and Sun instead of knowing them is "
        f"{untold.consistency.verdict} too (NEES {untold.consistency.mean:.2g} per state): tides are no random walk. "
        "The study flies the one that knows them.",
    ]
