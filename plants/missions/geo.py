"""Study: keeping a geostationary satellite at its ideal point.

After a thesis of the SpaceMaster programme on station keeping by optimal and H-infinity control; section and figure
numbers are its own. It names no longitude, date, area or noise: those numbers are ours. Positions are relative to
the ideal point, x radial, y east, z north (`plants.dynamics.relative`); the satellite's attitude is ideal. Inputs are
accelerations in m/s^2, so that fuel is delta-v in m/s, the sum over the axes, as six thrusters would spend it.
"""

from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import real, whole
from plants.dynamics.relative import EARTH_RATE, Sky, Station, StationState
from plants.errors import ScenarioError
from plants.estimation.tracking import StateSensor, StationEkf, Tracking, Unfiltered, station_ekf
from plants.hardware.thrusters import PulsedThrusters, Thrusters
from plants.outcome.indices import settling_time
from plants.simulation import uncertain
from plants.simulation.linearize import LinearModel, linearize
from plants.simulation.loop import Loop, Run, Scenario
from plants.simulation.programs import Program
from plants.simulation.uncertain import Driven, UncertainModel
from plants.surroundings import gravity

DAY = 86400.0  # () s
MASS = 1000.0  # () kg, ours
GAINS = ("gx", "gy", "gz")  # names of thrust over mass of the axes, as told 1, as uncertain parameters
RATE = EARTH_RATE  # () rad/s, of the orbit
LONGITUDE = 0.0  # () rad, ours
EPOCH = datetime(2007, 6, 21)  # UTC, ours: northern summer, no eclipses
PRESSURE = 0.026  # () m^2/kg, ours: reflection coefficient 1.3, 20 m^2 of a satellite of 1000 kg
OFFSET = np.repeat([100.0, 0.0], 3)  # (6,) m, m/s: section 6.2
FORCE, WEAK_FORCE = 100.0, 1.0  # () N of each axis: sections 6.2 and 6.2.3
BOX, SETTLE, END = 0.1, 6000.0, 60000.0  # () m, () s, () s: within 10 cm after 100 of 1000 minutes, section 6.2
PULSE = 0.1  # () s, shortest pulse, ours
SAMPLE = 60.0  # () s, between two measurements, ours
TRACKING_NOISE = np.array([10.0, 1e-3, 100.0, 100.0])  # (4,) m, m/s, m, m, one sigma, ours
PUSH_NOISE = 1e-7  # () m/s^2, random acceleration of each sample, ours
WALK = 1e-10  # () m/s^2/sqrt(s), of what is left when Moon and Sun are known, ours
TIDE_WALK = 1e-8  # () m/s^2/sqrt(s), of Moon, Sun and sunlight when they are not: 8e-6 m/s^2 twice a day, ours
LONGEST_STEP = 600.0  # () s, of RK4: 3e-8 of the distance from the ideal point per radian of the orbit


class Outcome(NamedTuple):
    """A run in numbers; infinite if it failed."""

    delta_v: np.ndarray  # (3,) m/s of each axis, up to the last row
    per_day: float  # () m/s per day, of all axes
    settling_time: float  # () s, after which every coordinate of the position stays within the box
    farthest: float  # () m, largest coordinate of the position after the time asked for
    violation: float  # () m, by which that passes the box, 0 if it does not
    outside: float  # () share of the rows after that time with a coordinate outside the box


def satellite(longitude: float = LONGITUDE) -> Station:
    """The satellite with all perturbations."""
    return Station.create(longitude, pressure=PRESSURE)


def unperturbed(longitude: float = LONGITUDE) -> Station:
    """The satellite around a spherical Earth and nothing else: its linear model is Hill's."""
    return Station.create(longitude, harmonics=gravity.SPHERE, moon=0.0, sun=0.0)


def tracking(noise: ArrayLike = TRACKING_NOISE) -> Tracking:
    """Measurements of section 3.3 and of the longitude; the thesis's alone with three deviations."""
    return Tracking.create(float(satellite().radius), noise)


def ekf(
    above: Sky,
    *,
    sensors: Tracking | None = None,
    model: Station | None = None,
    walk: float = WALK,
    guess: ArrayLike = np.zeros(6),  # noqa: B008 (not changed)
) -> StationEkf:
    """The filter of chapter 3 with a longitude and an unknown acceleration.

    Parameters
    ----------
    above : surroundings of the run
    sensors : `tracking()` by default
    model : what the filter knows, `satellite()` by default, for which Moon and Sun come from an almanac on board;
        the thesis's is `oblate()` (equation 3.14), to be given with `walk` = `TIDE_WALK`
    walk : () m/s^2/sqrt(s), of the unknown acceleration
    guess : (6,) m, m/s

    Raises
    ------
    ScenarioError
        The sensors leave a direction unknown, as the thesis's three measurements do.
    """
    return station_ekf(
        model or satellite(), sensors or tracking(), above, push=PUSH_NOISE, walk=walk, h=SAMPLE, guess=guess
    )


def oblate(longitude: float = LONGITUDE) -> Station:
    """The satellite under the attraction of an oblate Earth alone."""
    return Station.create(longitude, harmonics=gravity.OBLATE, moon=0.0, sun=0.0)


def sky(duration: float, *, longitude: float = LONGITUDE, epoch: datetime = EPOCH) -> Sky:
    """Moon, Sun and pole for `duration` s."""
    return Sky.over(longitude, epoch, duration)


def at_rest(start: ArrayLike = np.zeros(6)) -> StationState:  # noqa: B008 (not changed)
    """State from position and velocity (6,) m and m/s relative to the ideal point; no fuel spent yet."""
    start = np.asarray(real("start", start, (6,)))
    return StationState(position=start[:3], velocity=start[3:], spent=np.zeros(3))


def case(
    controller: Any,
    start: ArrayLike,
    duration: float,
    *,
    perturbed: bool = True,
    limit: float = FORCE,
    noise: ArrayLike | None = None,
    run: int = 0,
    seed: int = 0,
) -> tuple[Loop, Scenario]:
    """One run of a controller that commands accelerations (3,) m/s^2 from position and velocity (6,) m, m/s.

    Parameters
    ----------
    controller : its `dt` is the control period; it must divide the duration
    start : (6,) m, m/s
    duration : () s
    perturbed : everything acts, or the attraction of a sphere alone
    limit : () N, of each axis; infinite for none
    noise : (6,) m, m/s, one sigma of each sample of the output, white; without it the true output is seen
    run, seed : name of the noise

    Raises
    ------
    ScenarioError
        NaN, wrong shapes, a duration that is not a whole number of control periods.
    """
    dt = float(controller.dt)
    periods = whole("duration", duration, dt, "control periods")
    above = sky(duration)
    loop = Loop(
        plant=satellite() if perturbed else unperturbed(),
        controller=controller,
        sensors=None if noise is None else StateSensor.create(noise),
        navigator=None if noise is None else Unfiltered(),
        actuator=Thrusters.create(MASS, limit),
    )
    scenario = Scenario(
        initial=at_rest(start),
        dt=dt,
        periods=periods,
        steps=int(np.ceil(dt / LONGEST_STEP)),
        environment=above if perturbed else above.with_fixed_pole(),
        run=run,
        seed=seed,
    )
    return loop, scenario


def operational(
    controller: Any, start: ArrayLike, duration: float, *, force: float = WEAK_FORCE, run: int = 0, seed: int = 0
) -> tuple[Loop, Scenario]:
    """The same with all perturbations, tracked through the filter, and with thrusters that are on or off.

    Sampled every `SAMPLE` s, of which the control period must be a whole number; `ScenarioError` otherwise, and for
    what `case` refuses. The filter starts at the true state with the uncertainty of `station_ekf`.
    """
    loop, scenario = case(controller, start, duration, limit=force, run=run, seed=seed)
    samples = whole("controller.dt", scenario.dt, SAMPLE, "samples")
    loop = replace(
        loop,
        sensors=tracking(),
        navigator=ekf(sky(duration), guess=start),
        actuator=PulsedThrusters.create(MASS, force, shortest=PULSE, period=SAMPLE),
    )
    return loop, replace(scenario, samples=samples, steps=1)


def outcome(run: Run, *, box: float = BOX, since: float = SETTLE) -> Outcome:
    """What became of a run of this study, on the grid of its rows; the fuel is exact whatever the grid.

    Parameters
    ----------
    run : of a `Station`
    box : () m, half-width of the box that every coordinate of the position is to be kept in
    since : () s, when it must be there

    Raises
    ------
    ScenarioError
        The run has no row after `since`.
    """
    if not run.ok:
        return Outcome(np.full(3, np.inf), *(np.inf,) * 5)
    largest, late = np.abs(run.outputs[:, :3]).max(axis=1), run.time >= since
    if not late.any() or run.time[-1] == 0:
        raise ScenarioError(f"since = {since} s is after the last row at {run.time[-1]} s, or that is the first")
    farthest = largest[late].max()
    return Outcome(
        delta_v=run.states.spent[-1],
        per_day=float(run.states.spent[-1].sum() / run.time[-1] * DAY),
        settling_time=settling_time(run.time, largest, np.nextafter(box, np.inf)),
        farthest=float(farthest),
        violation=float(max(farthest - box, 0.0)),
        outside=float((largest[late] > box).mean()),
    )


@dataclass(frozen=True, kw_only=True)
class Coast:
    """No thrust, as a controller."""

    dt: float  # () s, control period

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def step(self, state: tuple[()], y: Array, r: Array) -> tuple[tuple[()], Array]:
        """Nothing."""
        del r
        return state, 0.0 * y[:3]


def perturbation(times: ArrayLike) -> np.ndarray:
    """Acceleration relative to the ideal point of a satellite that rests there, at `times` (n,) s: (n, 3) m/s^2."""
    times = np.asarray(real("times", times, (None,), low=0))
    with jax.enable_x64(True):
        return np.asarray(_perturbation(satellite(), sky(float(times.max()) + 1.0), times))


def hill_model() -> LinearModel:
    """Hill's equations, at rest at the ideal point of a spherical Earth. Equations 1.6 and 3.14 with c = 1."""
    return _model(gravity.SPHERE)


def oblate_model() -> LinearModel:
    """The same with J2, the model of Schweighart and Sedwick for an equatorial orbit. Equation 3.14."""
    return _model(gravity.OBLATE)


def driven_model(gains: ArrayLike) -> LinearModel:
    """`hill_model` with thrusters that give (3,) times what they are told, or a mass that is other by its inverse."""
    return linearize(_driven(real("gains", gains, (3,))), at_rest(), np.zeros(3), _still(), hold=("spent",))


def uncertain_model(within: float = 0.3) -> UncertainModel:
    """`driven_model` over the gains of the axes, the parameters `GAINS`, within that part of each; exact."""
    gains: dict[str, float] = dict.fromkeys(GAINS, 1.0)
    return uncertain.uncertain_model(_driven, gains, at_rest(), np.zeros(3), _still(), within=within, hold=("spent",))


def _driven(gains: Any) -> Driven:
    return Driven(plant=unperturbed(), gains=gains, outputs=6)


def _still() -> Sky:
    return sky(DAY).with_fixed_pole()


def _model(harmonics: gravity.Harmonics) -> LinearModel:
    """Linear model at rest at the ideal point, without Moon, Sun and motion of the pole."""
    plant = Station.create(harmonics=harmonics, moon=0.0, sun=0.0)
    return linearize(plant, at_rest(), np.zeros(3), _still(), hold=("spent",))


@Program
def _perturbation(plant: Station, above: Sky, times: Array) -> Array:
    rest = StationState(*(jnp.zeros(3),) * 3)
    return jax.vmap(lambda t: jnp.asarray(plant.derivative(rest, jnp.zeros(3), above.at(t)).velocity))(times)
