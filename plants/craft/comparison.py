"""Controllers against each other on one spacecraft: the same dispersed flights for each, and a first report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from plants.checks import positive, real
from plants.craft.spacecraft import Spacecraft
from plants.errors import ScenarioError
from plants.files import usable
from plants.guidance.laws import Dumping
from plants.outcome import figures, report, study
from plants.outcome.attitudeplots import wheel_speed_plot
from plants.outcome.inline import STYLE
from plants.simulation.campaign import Campaign, draw
from plants.simulation.loop import Loop, Run, Scenario
from plants.surroundings.disturbances import ConstantTorque

DEG = np.pi / 180
SHARE = 0.95  # () of the time, and of the runs
KEPT = 12  # flights of each controller that are drawn
RPM = 30 / np.pi  # of 1 rad/s
HEADERS = (
    "controller", "error, deg", "knowledge, deg", "settled, s", "torque, mN m", "fastest wheel, rpm", "failed",
)  # fmt: skip


class Dispersion(NamedTuple):
    """How far flights differ from each other: uniform within these bounds, either way."""

    angles: float = 10 * DEG  # rad, Euler angles at the start
    rate: float = 0.1 * DEG  # rad/s at the start, every axis
    inertia: float = 0.1  # () relative, of every axis
    torque: float = 0.0  # N m, constant, every axis: what no disturbance models


class Dispersed(NamedTuple):
    """One flight."""

    angles: Any  # (3,) rad
    rate: Any  # (3,) rad/s
    inertia: Any  # (3,) relative
    torque: Any  # (3,) N m


class Shared(NamedTuple):
    """What the flights of one controller have in common."""

    craft: Spacecraft
    controller: Any
    dumping: Dumping | None
    environment: Any
    duration: float  # s


class Measured(NamedTuple):
    """What is kept of a flight; infinite if it failed."""

    pointing: Any  # () rad, not exceeded for 95 % of the time after the first part
    knowledge: Any  # () rad, likewise of the estimate against the truth
    settled: Any  # () s, since when the error has stayed within the requirement; the whole flight if it does not
    torque: Any  # () N m, root of the mean square of the commanded torque
    speed: Any  # () rad/s, of the fastest wheel


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """What came out."""

    campaigns: dict[str, Campaign]  # by controller
    requirements: tuple[report.Requirement, ...]  # of 95 % of the runs, by controller
    report: Path | None

    def __str__(self) -> str:
        """For the terminal."""
        return "\n".join(map(str, self.requirements))

    def levels(self) -> dict[str, dict[str, float]]:
        """What 95 % of the runs of each controller keep: the fields of `Measured`, in SI."""
        return {
            name: {
                key: float(np.quantile(values, SHARE, method="higher"))
                for key, values in flown.results._asdict().items()
            }
            for name, flown in self.campaigns.items()
        }

    def rows(self) -> dict[str, list[str]]:
        """The same in words, with the number of failed runs, below `HEADERS`."""
        return {
            name: [
                f"{kept['pointing'] / DEG:.4g}",
                f"{kept['knowledge'] / DEG:.4g}",
                f"{kept['settled']:.0f}",
                f"{1e3 * kept['torque']:.4g}",
                f"{kept['speed'] * RPM:.0f}",
                f"{int((~self.campaigns[name].ok).sum())} of {len(self.campaigns[name].ok)}",
            ]
            for name, kept in self.levels().items()
        }


def compare_flights(
    craft: Spacecraft,
    controllers: Mapping[str, Any],
    *,
    duration: float,
    pointing: float,
    runs: int = 30,
    seed: int = 0,
    spread: Dispersion = Dispersion(),  # noqa: B008 (immutable)
    after: float | None = None,
    dumping: Dumping | None = None,
    environment: Any = None,
    out: Path | str | None = None,
    **options: Any,
) -> Comparison:
    """Fly every controller through the same dispersed flights, and report.

    Parameters
    ----------
    craft : see `spacecraft`
    controllers : name -> controller as `Spacecraft.loop` takes it
    duration : () s of each flight
    pointing : () rad, the requirement: half-cone of the error, for 95 % of the time
    runs, seed : of the dispersions and of the noise
    spread : how far the flights differ
    after : () s, from when errors count; the second half of the flight by default
    dumping : as in `Spacecraft.loop`
    environment : surroundings for `duration`; those of the orbit by default
    out : folder for report.html; no report without it
    options : further ones of `campaign`, such as `store`, `workers`

    Raises
    ------
    ScenarioError
        No controller, numbers that are not positive, what `campaign` refuses.
    """
    if not controllers:
        raise ScenarioError("controllers is empty: give at least one, such as {'H-infinity': design}")
    limit, span = float(positive("pointing", pointing)), float(positive("duration", duration))
    start = span / 2 if after is None else float(real("after", after, low=0))
    if start >= span:
        raise ScenarioError(f"after = {start:g} s: nothing is left of the flight, which ends at {span:g} s")
    folder = None if out is None else usable(Path(out))
    dispersed = draw(partial(_drawn, spread=spread), runs, seed)
    around = craft.environment(span) if environment is None else environment
    shared = {name: Shared(craft, K, dumping, around, span) for name, K in controllers.items()}
    flown: dict[str, Campaign] = {}
    begun = perf_counter()
    study.campaigns(
        _case, dispersed, shared, flown, measure=partial(measured, start=start, pointing=limit), seed=seed,
        keep=dict.fromkeys(shared, range(min(runs, KEPT))), **options,
    )  # fmt: skip
    asked = tuple(
        report.Requirement(f"{name}: error in {SHARE:.0%} of {runs} flights", _level(flown[name]), limit / DEG, "deg")
        for name in flown
    )
    page = None if folder is None else folder / "report.html"
    result = Comparison(campaigns=flown, requirements=asked, report=page)
    if page is not None:
        told = f"{runs} flights of {span:g} s for each controller, errors count from {start:g} s, seed {seed}"
        _write(page, craft, result, limit, told, perf_counter() - begun)
    return result


def measured(run: Run, *, start: float, pointing: float) -> Measured:
    """The figures of one flight."""
    if not run.ok:
        return Measured(*[np.inf] * len(Measured._fields))
    error, late = _angle(run.outputs), run.time >= start
    outside = np.flatnonzero(error > pointing)
    miss = 2 * np.arcsin(np.clip(np.linalg.norm(run.estimates[:, :3] - run.outputs[:, :3], axis=1), 0, 1))
    settled = 0.0 if not outside.size else run.time[outside[-1]]
    return Measured(
        pointing=np.quantile(error[late], SHARE),
        knowledge=np.quantile(miss[late], SHARE),
        settled=run.duration if outside.size and outside[-1] == len(error) - 1 else settled,
        torque=np.sqrt(np.mean(np.sum(run.commands[:, :3] ** 2, axis=1))),
        speed=np.abs(run.states.wheels).max(initial=0.0),
    )


def _drawn(seed: int, index: int, *, spread: Dispersion) -> Dispersed:
    """The dispersions of one run, from a stream of its own."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Dispersed(*(width * rng.uniform(-1, 1, 3) for width in spread))


def _case(d: Dispersed, shared: Shared) -> tuple[Loop, Scenario]:
    """Loop and scenario of one run."""
    craft, plant = shared.craft, shared.craft.plant
    moved = replace(craft, plant=plant.scaled(1 + d.inertia / 2, (ConstantTorque.create(d.torque),)))
    flight = moved.scenario(shared.duration, environment=shared.environment, angles=d.angles, rate=d.rate)
    return moved.loop(shared.controller, dumping=shared.dumping), flight


def _angle(outputs: np.ndarray) -> np.ndarray:
    """Angle (N,) rad of the error whose vector part comes first."""
    return 2 * np.arcsin(np.clip(np.linalg.norm(outputs[:, :3], axis=1), 0, 1))


def _level(flown: Campaign) -> float:
    """Error () deg that is not exceeded in 95 % of the runs."""
    return float(np.quantile(flown.results.pointing, SHARE, method="higher")) / DEG


def _write(page: Path, craft: Spacecraft, found: Comparison, pointing: float, told: str, seconds: float) -> None:
    """The report."""
    sections = [
        report.Section("Requirements", report.requirements_table(found.requirements)),
        report.Section(
            "Controllers",
            report.table(HEADERS, [[name, *row] for name, row in found.rows().items()])
            + report.paragraph(
                f"Levels that {SHARE:.0%} of the runs keep; errors are kept for {SHARE:.0%} of the time."
            ),
        ),
        report.Section(
            "Budget",
            report.requirements_table(_budget(craft, found, pointing))
            + report.paragraph(f"What {SHARE:.0%} of the runs take of what there is."),
        ),
        study.drawings(
            "Pointing error", [(_errors(found, pointing), "Every line is a flight; dashed: the requirement.")]
        ),
        study.drawings(
            "First flight", [(_first(found), "Error, commanded torques and fastest wheel of the first flight.")]
        ),
        *_wheels(craft, found),
        report.Section("Spacecraft", report.table(("what", "value"), _sheet(craft))),
    ]
    made = study.Study(complete=True, seconds=seconds)
    met = sum(r.met for r in found.requirements)
    text = report.page(
        craft.name,
        f"Pointing within {pointing / DEG:.4g} deg: {_counted(len(found.campaigns))}, dispersed flights",
        sections,
        study.provenance(told, made),
        highlights=[(f"{met} of {len(found.requirements)}", "requirements met")],
    )
    study.written(page, text, sections)


def _budget(craft: Spacecraft, found: Comparison, pointing: float) -> list[report.Requirement]:
    """Errors, torques and momenta of each controller against what is allowed, can be given, can be stored."""
    rows, wheels = [], craft.actuator.wheels
    for name, kept in found.levels().items():
        estimate = report.Requirement(f"{name}: error of the estimate", kept["knowledge"] / DEG, pointing / DEG, "deg")
        rows.append(estimate)
        if wheels is not None:
            limits = np.asarray(wheels.max_speed) * RPM
            rows.append(
                report.Requirement(
                    f"{name}: torque, root mean square", 1e3 * kept["torque"], 1e3 * craft.torque, "mN m"
                )
            )
            if np.ptp(limits) == 0:  # else the fastest wheel need not be the fullest
                rows.append(report.Requirement(f"{name}: fastest wheel", kept["speed"] * RPM, limits[0], "rpm"))
    return rows


def _errors(found: Comparison, pointing: float) -> Any:
    """Figure: the error of the kept flights over time."""
    runs = {name: list(c.kept.values()) for name, c in found.campaigns.items()}
    fig = figures.bundles(
        {name: [(run.time, _angle(run.outputs) / DEG) for run in kept] for name, kept in runs.items()},
        "error, deg",
        pointing / DEG,
    )
    return fig


def _utc(epoch: datetime) -> datetime:
    """The moment in UTC; one without a time zone is in UTC."""
    return epoch.replace(tzinfo=UTC) if epoch.tzinfo is None else epoch.astimezone(UTC)


def _counted(number: int) -> str:
    return f"{number} controller{'s' if number > 1 else ''}"


def _wheels(craft: Spacecraft, found: Comparison) -> list[report.Section]:
    """Section: the speeds of all wheels in the first flight of each controller."""
    first = {name: c.kept[0] for name, c in found.campaigns.items() if 0 in c.kept}
    if craft.actuator.wheels is None or not first:
        return []
    limits = np.asarray(craft.actuator.wheels.max_speed)
    limit = float(limits[0]) if np.ptp(limits) == 0 else None
    drawn = []
    for name, run in first.items():
        with mpl.rc_context(STYLE):
            fig = Figure(figsize=(figures.WIDTH, 2.6), layout="constrained")
            wheel_speed_plot(run, fig.subplots(), limit=limit)
        drawn.append((fig, f"{name}, first flight"))
    return [study.drawings("Wheel speeds", drawn)]


def _first(found: Comparison) -> Any:
    """Figure: the first flight of each controller."""
    first = {name: c.kept[0] for name, c in found.campaigns.items() if 0 in c.kept}
    series = {
        name: (
            run.time,
            np.column_stack(
                [
                    _angle(run.outputs) / DEG,
                    1e3 * np.linalg.norm(run.commands[:, :3], axis=1),
                    np.abs(run.states.wheels).max(axis=1, initial=0.0) * RPM,
                ]
            ),
        )
        for name, run in first.items()
    }
    return figures.histories(series, ["error, deg", "torque, mN m", "wheels, rpm"])


def _sheet(craft: Spacecraft) -> Sequence[Sequence[str]]:
    """The spacecraft in words."""
    wheels, instruments = craft.actuator.wheels, () if craft.sensors is None else craft.sensors.instruments
    rows = [("inertia, kg m^2", "; ".join(" ".join(f"{J:.4g}" for J in row) for row in craft.inertia))]
    if wheels is not None:
        speed = np.asarray(wheels.max_speed)
        rows += [
            ("wheels", f"{len(speed)}"),
            ("torque of a motor, mN m", ", ".join(f"{1e3 * t:.4g}" for t in np.asarray(wheels.max_torque))),
            ("momentum of a wheel, mN m s", ", ".join(f"{1e3 * h:.4g}" for h in np.asarray(wheels.inertia) * speed)),
        ]
    rows += [
        ("sensors", ", ".join(type(i).__name__ for i in instruments) or "none: the true state"),
        ("control period", f"{craft.dt:g} s, {craft.samples} samples"),
        ("epoch", f"{_utc(craft.epoch):%Y-%m-%d %H:%M} UTC"),
    ]
    return rows
