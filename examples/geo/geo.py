"""Geostationary station keeping: the thesis's regulator and H-infinity controller against the least fuel there is.

Chapter 6 flown anew in one nonlinear simulator: 100 m to 10 cm in 100 minutes, 1 km with 1 N, noise; then two weeks in
a box. LQR, LQG, H-infinity and predictive control of least fuel are compared in m/s, with the bound that no control
can undercut.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import geo_controllers as design
import numpy as np
from geo_claims import HOLD, PERTURBED, REACH, statements
from geo_figures import sections
from geo_worst import question

from plants import Requirement, Run, Table, geo, simulate, simulate_many, study
from plants.missions.geo import BOX, DAY, END, FORCE, MASS, OFFSET, SETTLE, WEAK_FORCE
from plants.outcome import worst
from synth import Design, FuelMpc, MinimumFuel, c2d, free_motion, fuel_mpc, minimum_fuel

NOISE = np.repeat([1.0, 1e-3], 3)  # m, m/s, one sigma of each sample: ours, the thesis does not say
PERIOD = 6.0  # s, the thesis's T = 0.1 min; of the linear controllers
STEP = 120.0  # s, of predictive control
BOXES = (100.0, 1000.0)  # m, half-widths of the boxes kept
SLOW, AHEAD = 1800.0, 96  # s, samples, of box keeping: two days ahead
DRAWS = 100  # of the Monte Carlo beside the worst flight
MARGIN, LOOSE = 0.9, 10.0  # of the box required, for what is not foreseen; m, the box kept under noise
FULL = (
    design.THESIS_LQR,
    design.LQR,
    design.FORESEEING,
    design.FUEL,
)  # controllers that are given the velocity as well


@dataclass(frozen=True)
class Flight:
    """A run in the numbers of this study."""

    run: Run
    step: float  # s, between two rows

    @property
    def time(self) -> np.ndarray:
        """(N,) s."""
        return self.run.time

    @property
    def position(self) -> np.ndarray:
        """(N, 3) m, relative to the ideal point."""
        return self.run.outputs[:, :3]

    @property
    def acceleration(self) -> np.ndarray:
        """(N, 3) m/s^2, by the thrusters."""
        return self.run.inputs

    @property
    def force(self) -> np.ndarray:
        """(N, 3) N."""
        return MASS * self.acceleration

    @property
    def largest_force(self) -> float:
        """N, of one axis."""
        return float(np.abs(self.force).max())

    @property
    def last(self) -> float:
        """m, distance from the ideal point at the end."""
        return float(np.linalg.norm(self.position[-1]))

    def until(self, time: float) -> Flight:
        """The beginning of it, up to that time in s."""
        rows = self.time < time
        run = replace(self.run, time=self.time[rows], outputs=self.run.outputs[rows], inputs=self.run.inputs[rows])
        return Flight(run, self.step)

    def delta_v(self, until: float = np.inf) -> float:
        """m/s, of all axes, up to that time in s."""
        return float(np.abs(self.acceleration[self.time < until]).sum() * self.step)

    @property
    def by_axis(self) -> np.ndarray:
        """(3,) m/s, of each axis."""
        return np.abs(self.acceleration).sum(axis=0) * self.step

    @property
    def spread(self) -> float:
        """m, root mean square of the distance over the second half."""
        late = self.position[len(self.position) // 2 :]
        return float(np.sqrt((late**2).sum(axis=1).mean()))

    def farthest(self, since: float) -> float:
        """m, largest component of the position from `since` s on."""
        return float(np.abs(self.position[self.time >= since]).max())


@dataclass
class Study(study.Study):
    """What has been flown so far."""

    days: float  # of box keeping
    rate: float = geo.RATE  # rad/s, of the orbit
    settle: float = SETTLE
    box: float = BOX
    designs: dict[str, Design] = field(default_factory=dict)
    bounds: dict[str, MinimumFuel] = field(default_factory=dict)
    chapter6: dict[str, Flight] = field(default_factory=dict)
    perturbed: dict[str, Flight] = field(default_factory=dict)
    saturated: dict[str, Flight] = field(default_factory=dict)
    noisy: dict[str, list[Flight]] = field(default_factory=dict)
    kept: dict[float, Flight] = field(default_factory=dict)
    operated: dict[float, Flight] = field(default_factory=dict)
    kept_bounds: dict[float, MinimumFuel] = field(default_factory=dict)

    def per_day(self, name: str) -> float:
        """Fuel under noise, m/s per day, mean of the runs."""
        return float(np.mean([f.delta_v() / f.run.duration for f in self.noisy[name]]) * DAY)


def bounds(rate: float) -> dict[str, MinimumFuel]:
    """What the task costs at least: in the box at 100 minutes; in it until the end; likewise with perturbations."""
    step = 300.0
    settle, samples = round(SETTLE / step), round(END / step)
    return {
        REACH: bound(rate, OFFSET, BOX, step, settle, settle=settle, perturbed=False),
        HOLD: bound(rate, OFFSET, BOX, step, samples, settle=settle, perturbed=False),
        PERTURBED: bound(rate, OFFSET, BOX, step, samples, settle=settle, perturbed=True),
    }


def bound(
    rate: float, start: np.ndarray, box: float, step: float, samples: int, *, settle: int, perturbed: bool
) -> MinimumFuel:
    """What it costs at least to be in a box at the samples from `settle` on."""
    G, push = design.relative_motion(rate), foreseen(step, samples) if perturbed else None
    free = free_motion(G, start, dt=step, samples=samples, held=push)
    return minimum_fuel(G, free, box, dt=step, settle=settle)


def foreseen(step: float, samples: int) -> np.ndarray:
    """Perturbation at the ideal point in the middle of each sample, (samples, 3) m/s^2."""
    return geo.perturbation((np.arange(samples) + 0.5) * step)


def linear_flights(found: Study, controllers: Mapping[str, Any], runs: int, seed: int) -> None:
    """Every scenario with every linear controller: one compiled batch."""
    flights = [
        (into, name, geo.case(controller, duration=END, **options))
        for into, options in scenarios(found, runs, seed)
        for name, controller in controllers.items()
    ]
    for (into, name, _), run in zip(flights, simulate_many([c for _, _, c in flights]), strict=True):
        if into is found.noisy:
            found.noisy.setdefault(name, []).append(Flight(run, PERIOD))
        else:
            into[name] = Flight(run, PERIOD)
    foreseeing = design.Foreseeing(controllers[design.LQR], foreseen(PERIOD, round(END / PERIOD)))
    found.perturbed[design.FORESEEING] = Flight(simulate(*geo.case(foreseeing, OFFSET, END)), PERIOD)


def scenarios(found: Study, runs: int, seed: int) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """(where the flights are kept, what is flown)."""
    strong, quiet = {"start": OFFSET, "limit": FORCE, "noise": np.zeros(6)}, np.zeros(6)
    noisy = {"start": quiet, "limit": FORCE, "perturbed": True, "noise": NOISE, "seed": seed}
    return [
        (found.chapter6, strong | {"perturbed": False}),
        (found.perturbed, strong | {"perturbed": True}),
        (found.saturated, {"start": 10 * OFFSET, "limit": WEAK_FORCE, "perturbed": True, "noise": quiet}),
        *((found.noisy, noisy | {"run": r}) for r in range(runs)),
    ]


def least_fuel(
    found: Study, step: float, horizon: int, *, box: float, limit: float, settle: float, known: float
) -> FuelMpc:
    """Predictive control of least fuel with the perturbations of the first `known` s foreseen."""
    model = c2d(design.relative_motion(found.rate), step)
    return fuel_mpc(
        model,
        box=MARGIN * box,
        umax=limit / MASS,
        horizon=horizon,
        settle=round(settle / step),
        forecast=foreseen(step, round(known / step)) @ model.B.T if known else None,
    )


def predictive_flights(found: Study, runs: int, seed: int) -> None:
    """The same scenarios with predictive control, which is stepped from Python."""
    for into, options in scenarios(found, runs, seed):
        loose = into is found.noisy
        controller = least_fuel(
            found, STEP, 25 if loose else 75,
            box=LOOSE if loose else BOX, limit=options["limit"], settle=0 if loose else SETTLE,
            known=END * options["perturbed"],
        )  # fmt: skip
        flight = Flight(simulate(*geo.case(controller, duration=END, **options)), STEP)
        if loose:
            found.noisy.setdefault(design.FUEL, []).append(flight)
        else:
            into[design.FUEL] = flight


def keep_boxes(found: Study, seed: int) -> None:
    """Boxes of several sizes, all perturbations on, for days."""
    duration = found.days * DAY
    for box in BOXES:
        controller = least_fuel(found, SLOW, AHEAD, box=box, limit=WEAK_FORCE, settle=0.0, known=duration)
        hours = round(duration / 3600)
        found.kept_bounds[box] = bound(found.rate, np.zeros(6), box, 3600.0, hours, settle=1, perturbed=True)
        found.kept[box] = Flight(simulate(*geo.case(controller, np.zeros(6), duration, limit=WEAK_FORCE)), SLOW)
        operated = geo.operational(controller, np.zeros(6), duration, seed=seed)
        found.operated[box] = Flight(simulate(*operated), geo.SAMPLE)


def fly(found: Study, runs: int, seed: int) -> None:
    """All of it."""
    found.bounds |= bounds(found.rate)
    controllers, found.designs = design.linear(found.rate, PERIOD)
    linear_flights(found, controllers, runs, seed)
    predictive_flights(found, runs, seed)
    keep_boxes(found, seed)


def task_table(found: Study) -> Table:
    """Chapter 6: 100 m to 10 cm."""
    headers = ("controller", "measures", "m/s in 100 min", "m/s in 1000 min", "within, cm", "largest force, N",
               "perturbed: m/s", "perturbed: within, cm")  # fmt: skip
    rows, marks = [], []
    for name, b in found.bounds.items():
        figures = {REACH: (f"{b.lower:.4f}", "-", "-"), HOLD: ("-", f"{b.lower:.4f}", "-"),
                   PERTURBED: ("-", "-", f"{b.lower:.4f}")}[name]  # fmt: skip
        rows.append((f"bound: {name}", "any", *figures[:2], "10", "any", figures[2], "10"))
        marks.append([""] * 8)
    for name in dict.fromkeys((*found.chapter6, *found.perturbed)):
        row, mark = [name, measures(name)], ["", ""]
        if calm := found.chapter6.get(name):
            off = calm.farthest(SETTLE)
            row += [f"{calm.delta_v(SETTLE):.3f}", f"{calm.delta_v():.3f}", cm(off), f"{calm.largest_force:.3g}"]
            mark += ["", "", verdict(off <= BOX), verdict(calm.largest_force <= FORCE)]
        row, mark = row + ["-"] * (6 - len(row)), mark + [""] * (6 - len(mark))
        if rough := found.perturbed.get(name):
            off = rough.farthest(SETTLE)
            row, mark = [*row, f"{rough.delta_v():.3f}", cm(off)], [*mark, "", verdict(off <= BOX)]
        rows.append((*row, *["-"] * (8 - len(row))))
        marks.append([*mark, *[""] * (8 - len(mark))])
    note = (
        "From 100 m in each axis; within: largest component of the position from 100 to 1000 minutes. Perturbed: with "
        "Moon, Sun, the Earth's shape and solar pressure, which predictive control and the regulator called foreseeing "
        "know beforehand and the others do not. The bounds hold for the linear plant and any control of any thrust."
    )
    return Table("100 m to 10 cm in 100 minutes", headers, rows, marks, note)


def cm(length: float) -> str:
    """A length in m as centimetres."""
    return f"{100 * length:.2g}" if length < 1 else f"{100 * length:.0f}"


def measures(name: str) -> str:
    """What a controller is given."""
    return "state" if name in FULL else "position"


def verdict(good: bool) -> str:
    """The colour of a cell."""
    return "pass" if good else "fail"


def other_tables(found: Study) -> list[Table]:
    """1 km with 1 N, noise, boxes."""
    far = [
        (name, f"{f.farthest(0):.0f}", f"{f.farthest(END / 2):.3g}", f"{f.last:.3g}", f"{f.delta_v():.2f}")
        for name, f in found.saturated.items()
    ]
    noisy = [
        (name, measures(name), f"{found.per_day(name):.3g}", f"{np.mean([f.spread for f in many]):.3g}")
        for name, many in found.noisy.items()
    ]
    return [
        Table("1 km with 1 N", ("controller", "farthest, m", "second half: within, m", "at the end, m", "m/s"), far,
              note="From 1 km in each axis, thrust limited to 1 N in each axis, perturbed, 1000 minutes."),
        Table("Noise", ("controller", "measures", "m/s per day", "distance, m rms"), noisy,
              note=f"{NOISE[0]:g} m and {1e3 * NOISE[3]:g} mm/s, one sigma in each axis, every {PERIOD:g} s; "
              f"{design.FUEL} every {STEP:g} s with a box of +-{LOOSE:g} m. No filter but the controller's own."),
        keeping_table(found),
    ]  # fmt: skip


def keeping_table(found: Study) -> Table:
    """What a box costs."""
    rows, marks = [], []
    point = found.perturbed.get(design.FUEL)
    if point:
        held = (point.by_axis - point.until(SETTLE).by_axis) * DAY / (END - SETTLE)
        figures = [f"{x:.3f}" for x in (held.sum(), *held)]
        rows.append((f"+-{MARGIN * BOX:g} of {BOX:g}", "15 hours", "-", *figures, f"{point.farthest(SETTLE):.4g}"))
        marks.append([*[""] * 7, verdict(point.farthest(SETTLE) <= BOX)])
    for flights, by in ((found.kept, "state"), (found.operated, "filter, pulses")):
        for box, f in flights.items():
            lower, days = found.kept_bounds[box].lower, found.days
            figures = [f"{x / days:.3f}" for x in (lower, f.delta_v(), *f.by_axis)]
            rows.append((f"+-{MARGIN * box:g} of {box:g}", by, *figures, f"{f.farthest(0):.4g}"))
            marks.append([*[""] * 7, verdict(f.farthest(0) <= box)])
    headers = ("box, m", "flown", "bound", "m/s per day", "radial", "along", "normal", "farthest, m")
    note = (
        f"{design.FUEL}, perturbations foreseen. The first row is what holding the point costs from 100 minutes on in "
        f"the first table. The others: {found.days:g} days from rest at the ideal point, 1 N; between the samples, of "
        f"{SLOW / 60:g} minutes, the box is not looked at. Bound: m/s per day, of the whole box, the margin included. "
        f"Filter, pulses: tracked in radius, its rate, latitude and longitude every {geo.SAMPLE:g} s through an "
        f"extended Kalman filter, with pulses of at least {geo.PULSE:g} s."
    )
    return Table("Keeping a box", headers, rows, marks, note)


def requirements(found: Study) -> list[Requirement]:
    """Section 6.2 for predictive control, and our own: within 10 % of the bound."""
    margins = []
    for flights, name, world in ((found.chapter6, HOLD, ""), (found.perturbed, PERTURBED, ", perturbed")):
        if flight := flights.get(design.FUEL):
            lower = found.bounds[name].lower
            margins += [
                Requirement(
                    f"{design.FUEL}: position from 100 minutes on{world}",
                    100 * flight.farthest(SETTLE),
                    100 * BOX,
                    "cm",
                ),
                Requirement(f"{design.FUEL}: delta-v over its bound{world}", flight.delta_v() / lower, 1.1, ""),
            ]
    return margins


def stem(name: str) -> str:
    """A file name."""
    return name.lower().replace(",", "").replace(" ", "_").replace("-", "_")


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = "two days of box keeping, one noisy run, no search for the worst"
    parser = study.parser(__doc__, out="out/geo", fast=fast, runs=3, what="noisy runs of each controller",
                          stored=False)  # fmt: skip
    parser.add_argument("--days", type=int, default=14, help="of box keeping (default 14)")
    options = study.parse(parser, arguments, natural=("days",))
    runs, days = (1, 2) if options.fast else (options.runs, options.days)
    if days < 1:
        parser.error(f"--days {days}: give at least 1")
    found = Study(days=days)

    def flights() -> None:
        fly(found, runs, options.seed)
        if not options.fast:
            worst.ask(question(found.rate, DRAWS, options.seed), found.worst, seed=options.seed)

    study.carry_out(found, flights)
    return study.conclude(
        found,
        options.out,
        title="Geostationary station keeping: fuel",
        subtitle="LQR, LQG, H-infinity and predictive control against the least fuel there is; after a thesis on "
        "station keeping by optimal and H-infinity control",
        tables=[task_table(found), *other_tables(found), *worst.tables(found.worst)],
        statements=statements(found),
        requirements=requirements(found),
        cards=[study.card(name, d, options.out, stem(name)) for name, d in found.designs.items()],
        sections=sections(found),
        settings=f"{runs} noisy runs, seed {options.seed}, {days} days of box keeping",
        packages=("cvxpy", "highspy", "clarabel"),
        notes=[
            "the designs are in their own units of time: "
            + ", ".join(f"{name} {design.UNITS.get(name, (design.MINUTE,))[0]:g} s" for name in found.designs)
        ],
    )


if __name__ == "__main__":
    raise SystemExit(main())
