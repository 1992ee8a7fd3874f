"""Days in a box, with everything that acts: what holding a satellite costs once its filter knows where it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import geo_controllers as design
import numpy as np
from geo_filter import OURS
from geo_flights import MARGIN, Flight, bound, least_fuel

from plants import Table, geo, simulate, simulate_many
from plants.missions.geo import BOX, DAY, END, SAMPLE, SETTLE, WEAK_FORCE

if TYPE_CHECKING:
    from geo_flights import Study

BOXES = (100.0, 1000.0)  # m, half-widths of the boxes kept
THIN, WIDE = 0.9, 0.8  # of the box, aimed at
SLOW, AHEAD = 1800.0, 96  # s, samples: two days ahead
FIRST = DAY  # s, in which the filter finds out where the satellite is


@dataclass(frozen=True)
class Kept:
    """Flights in a box, aimed at a part of it."""

    box: float  # m
    part: float
    flights: list[Flight]  # of several seeds
    lower: float  # m/s per day, bound of the whole box
    filtered: bool

    @property
    def settled(self) -> list[Flight]:
        """What is reported: from the second day on, so that those with and without a filter are compared alike."""
        return [f.since(FIRST) for f in self.flights]

    @property
    def days(self) -> float:
        """Of what is reported."""
        return (self.flights[0].run.duration - FIRST) / DAY

    @property
    def per_day(self) -> np.ndarray:
        """(seeds, 3) m/s per day, of each axis."""
        return np.array([f.by_axis for f in self.settled]) / self.days

    @property
    def farthest(self) -> float:
        """m, of all seeds."""
        return max(f.farthest(0) for f in self.settled)

    @property
    def first_day(self) -> float:
        """m/s of the first day, mean of the seeds."""
        return float(np.mean([f.delta_v(FIRST) for f in self.flights]))

    @property
    def first_farthest(self) -> float:
        """m, in the first day, of all seeds."""
        return max(f.until(FIRST).farthest(0) for f in self.flights)


def keep_boxes(found: Study, seeds: int, seed: int) -> None:
    """Boxes of several sizes, all perturbations on, for days."""
    duration = found.days * DAY
    hours = round(duration / 3600)
    for box in BOXES:
        lower = bound(found.rate, np.zeros(6), box, 3600.0, hours, settle=1, perturbed=True).lower / found.days
        for part in (THIN, WIDE) if box == min(BOXES) else (THIN,):
            controller = least_fuel(found, SLOW, AHEAD, box=part * box, limit=WEAK_FORCE, settle=0.0, known=duration)
            name = f"+-{part * box:g} of {box:g}"
            if part == THIN:
                flown = simulate(*geo.case(controller, np.zeros(6), duration, limit=WEAK_FORCE))
                found.kept[f"{name}, state"] = Kept(box, part, [Flight(flown, SLOW)], lower, False)
            cases = [geo.operational(controller, np.zeros(6), duration, seed=seed + k) for k in range(seeds)]
            flights = [Flight(run, SAMPLE) for run in simulate_many(cases)]
            found.kept[f"{name}, filter"] = Kept(box, part, flights, lower, True)


def keeping_table(found: Study) -> Table:
    """What a box costs."""
    rows, marks = [], []
    point = found.perturbed.get(design.FUEL)
    if point:
        late = point.since(SETTLE)
        held = late.by_axis * DAY / (END - SETTLE)
        figures = [f"{x:.3f}" for x in (held.sum(), *held)]
        rows.append((f"+-{MARGIN * BOX:g} of {BOX:g}", "state", "-", "-", *figures, f"{late.farthest(0):.4g}"))
        marks.append([*[""] * 8, verdict(late.farthest(0) <= BOX)])
    for k in found.kept.values():
        figures = [f"{x:.3f}" for x in (k.per_day.sum(axis=1).mean(), *k.per_day.mean(axis=0))]
        by, first = "filter, pulses" if k.filtered else "state", f"{k.first_day:.3f}"
        rows.append((f"+-{k.part * k.box:g} of {k.box:g}", by, f"{k.lower:.3f}", first, *figures, f"{k.farthest:.4g}"))
        marks.append([*[""] * 8, verdict(k.farthest <= k.box)])
    headers = (
        "box, m",
        "known by",
        "bound",
        "first day, m/s",
        "m/s per day",
        "radial",
        "along",
        "normal",
        "farthest, m",
    )
    seeds = max((len(k.flights) for k in found.kept.values()), default=0)
    note = (
        f"{design.FUEL}, perturbations foreseen. The first row is what holding the point costs from 100 minutes on in "
        f"the first table. The others: {found.days:g} days from rest at the ideal point, 1 N; between the samples, of "
        f"{SLOW / 60:g} minutes, the box is not looked at. Bound: m/s per day, of the whole box, the margin included. "
        f"Filter, pulses: tracked in radius, its rate, latitude and longitude every {SAMPLE:g} s through an extended "
        f"Kalman filter that begins 1 km and 10 cm/s unsure, with pulses of at least {geo.PULSE:g} s, from {seeds} "
        f"seed{'s' if seeds > 1 else ''} (mean, and the farthest of all). The first day, in which the "
        "filter finds out where it is, stands apart, and the rest is reported from then on; the bound is of all days."
    )
    return Table("Keeping a box", headers, rows, marks, note)


def verdict(good: bool) -> str:
    """The colour of a cell."""
    return "pass" if good else "fail"


def findings(found: Study) -> list[str]:
    """What measuring costs, and the margin that it needs."""
    box = min(BOXES)
    state, thin, wide = (
        found.kept.get(f"+-{p * box:g} of {box:g}, {by}")
        for p, by in ((THIN, "state"), (THIN, "filter"), (WIDE, "filter"))
    )
    if state is None or thin is None or wide is None:
        return []
    sigma = sigma_along(found)
    return [
        f"Station keeping in +-{box:g} m through the filter costs {mean(thin):.3f} m/s per day, {mean(state):.3f} "
        f"with the state known: measuring costs {100 * (mean(thin) / mean(state) - 1):+.0f} %. The first day costs "
        f"{thin.first_day:.2f} m/s and goes {thin.first_farthest:.0f} m far, because the controller acts on a filter "
        f"that does not know yet where it is. {THIN:g} of the box is a thin margin: 3 sigma of y are {3 * sigma:.0f} "
        f"m after a day, and {box * (1 - THIN):.0f} m are left; the farthest is {thin.farthest:.1f} m. Aiming at "
        f"{WIDE:g} keeps within {wide.farthest:.1f} m for {mean(wide):.3f} m/s per day."
    ]


def sigma_along(found: Study) -> float:
    """m, what the filter believes of y after a day."""
    return float(np.sqrt(found.tracked[OURS].covariances[:, -1, 1, 1].mean()))


def mean(kept: Kept) -> float:
    """m/s per day."""
    return float(kept.per_day.sum(axis=1).mean())
