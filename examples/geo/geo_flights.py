"""The flights of chapters 4 to 6 in one nonlinear simulator, and what has been flown so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import geo_controllers as design
import geo_limited as limited
import numpy as np

from plants import Run, geo, simulate, simulate_many, study
from plants.missions.geo import BOX, DAY, END, FORCE, MASS, OFFSET, SETTLE, WEAK_FORCE
from synth import Design, FuelMpc, MinimumFuel, c2d, free_motion, fuel_mpc, minimum_fuel

if TYPE_CHECKING:
    from geo_drift import Drift
    from geo_filter import Tracked
    from geo_keeping import Kept
    from geo_sensitivity import Peaks

NOISE = np.repeat([1.0, 1e-3], 3)  # m, m/s, one sigma of each sample: ours, the thesis does not say
PERIOD = 6.0  # s, the thesis's T = 0.1 min; of the linear controllers
STEP = 120.0  # s, of predictive control of least fuel
STEPPED = 3  # noisy runs of predictive control, which is stepped from Python, at most
MARGIN, LOOSE = 0.9, 10.0  # of the box required, for what is not foreseen; m, the box kept under noise
NEAR = OFFSET / 100  # 1 m: sections 4.5, 5.7
REACH, HOLD, PERTURBED = "in the box at 100 min", "in it until 1000 min", "likewise, perturbed"  # the bounds


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
        return self._rows(self.time < time)

    def since(self, time: float) -> Flight:
        """The rest of it, from that time in s."""
        return self._rows(self.time >= time)

    def _rows(self, rows: np.ndarray) -> Flight:
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

    @property
    def overshoot(self) -> float:
        """How far it passes the ideal point, % of where it began, in the axis that does so most."""
        return float(100 * (-self.position / self.position[0]).max())

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
    drift: dict[str, Drift] = field(default_factory=dict)
    tracked: dict[str, Tracked] = field(default_factory=dict)
    designs: dict[str, Design] = field(default_factory=dict)
    bounds: dict[str, MinimumFuel] = field(default_factory=dict)
    near: dict[str, Flight] = field(default_factory=dict)  # from 1 m
    peaks: dict[str, Peaks] = field(default_factory=dict)
    uncertain: dict[str, list[Flight]] = field(default_factory=dict)  # thrusters other than the model's
    chapter6: dict[str, Flight] = field(default_factory=dict)
    perturbed: dict[str, Flight] = field(default_factory=dict)
    saturated: dict[str, Flight] = field(default_factory=dict)
    free: dict[str, Flight] = field(default_factory=dict)  # further controllers, without and with
    windup: dict[str, Flight] = field(default_factory=dict)  # the limit of 1 N
    noisy: dict[str, list[Flight]] = field(default_factory=dict)
    kept: dict[str, Kept] = field(default_factory=dict)

    def per_day(self, name: str) -> float:
        """Fuel under noise, m/s per day, mean of the runs."""
        return float(self.noise_fuel(name).mean())

    def noise_fuel(self, name: str) -> np.ndarray:
        """(runs,) m/s per day under noise."""
        return np.array([f.delta_v() / f.run.duration for f in self.noisy[name]]) * DAY


def short(x: float) -> str:
    """Three digits, without powers of ten."""
    return "< 0.001" if x < 1e-3 else f"{x:.3g}" if x < 1000 else f"{x:.0f}"


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


def linear_flights(found: Study, controllers: Mapping[str, Any], runs: int, seed: int) -> None:
    """Every scenario with every linear controller, and those of 1 m and of anti-windup: one compiled batch."""
    calm, rough, weak = (options for _, options in scenarios(found, 0, seed))
    flights = [
        (into, name, geo.case(controller, duration=END, **options))
        for into, options in scenarios(found, runs, seed)
        for name, controller in controllers.items()
    ]
    near, designs = design.nearby(found.rate, PERIOD)
    found.designs |= designs
    flights += [(found.near, name, geo.case(K, duration=END, **(rough | {"start": NEAR}))) for name, K in near.items()]
    loop, guarded, shaped = limited.loop_shaping(found.rate, PERIOD)
    found.designs[limited.LOOP] = shaped
    flights += [
        (into, limited.LOOP, geo.case(loop, duration=END, **options))
        for into, options in ((found.free, calm), (found.windup, weak))
    ]
    told = {limited.LOOP_TOLD: guarded, limited.MIXED_TOLD: limited.observing(controllers[design.MIXED])}
    for batch in (flights, [(found.windup, name, geo.case(K, duration=END, **weak)) for name, K in told.items()]):
        for (into, name, _), run in zip(batch, simulate_many([c for _, _, c in batch]), strict=True):
            if into is found.noisy:
                found.noisy.setdefault(name, []).append(Flight(run, PERIOD))
            else:
                into[name] = Flight(run, PERIOD)
    foreseeing = design.Foreseeing(controllers[design.LQR], foreseen(PERIOD, round(END / PERIOD)))
    found.perturbed[design.FORESEEING] = Flight(simulate(*geo.case(foreseeing, OFFSET, END)), PERIOD)


def least_fuel(
    found: Study, step: float, horizon: int, *, box: float, limit: float, settle: float, known: float
) -> FuelMpc:
    """Predictive control of least fuel with the perturbations of the first `known` s foreseen."""
    model = c2d(design.relative_motion(found.rate), step)
    return fuel_mpc(
        model,
        box=box,
        umax=limit / MASS,
        horizon=horizon,
        settle=round(settle / step),
        forecast=foreseen(step, round(known / step)) @ model.B.T if known else None,
    )


def predictive_flights(found: Study, runs: int, seed: int) -> None:
    """The same scenarios with predictive control, which is stepped from Python."""
    for into, options in scenarios(found, min(runs, STEPPED), seed):
        loose = into is found.noisy
        controller = least_fuel(
            found,
            STEP,
            25 if loose else 75,
            box=MARGIN * (LOOSE if loose else BOX),
            limit=options["limit"],
            settle=0 if loose else SETTLE,
            known=END * options["perturbed"],
        )
        flight = Flight(simulate(*geo.case(controller, duration=END, **options)), STEP)
        if loose:
            found.noisy.setdefault(design.FUEL, []).append(flight)
        else:
            into[design.FUEL] = flight
        if not loose and into is not found.perturbed:
            quadratic = limited.quadratic(found.rate, options["limit"] / MASS)
            run = simulate(*geo.case(quadratic, duration=END, **options))
            (found.windup if into is found.saturated else found.free)[limited.QUADRATIC] = Flight(run, quadratic.dt)
