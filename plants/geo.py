"""Study: keeping a geostationary satellite at its ideal point.

After a thesis of the SpaceMaster programme on station keeping by optimal and H-infinity control; section and figure
numbers are its own. It names no longitude, date, area or noise: those numbers are ours. Positions are relative to
the ideal point, x radial, y east, z north (`plants.relative`); the satellite's attitude is ideal. Inputs are
accelerations in m/s^2, so that fuel is delta-v in m/s, the sum over the axes, as six thrusters would spend it.
"""

from datetime import datetime
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants import gravity
from plants.checks import real
from plants.errors import ScenarioError
from plants.linearize import LinearModel, linearize
from plants.loop import Loop, Scenario
from plants.relative import EARTH_RATE, Sky, Station, StationState
from plants.tracking import StateSensor, Unfiltered
from plants.thrusters import Thrusters

DAY = 86400.0  # () s
MASS = 1000.0  # () kg, ours
RATE = EARTH_RATE  # () rad/s, of the orbit
LONGITUDE = 0.0  # () rad, ours
EPOCH = datetime(2007, 6, 21)  # UTC, ours: northern summer, no eclipses
PRESSURE = 0.026  # () m^2/kg, ours: reflection coefficient 1.3, 20 m^2 of a satellite of 1000 kg
OFFSET = np.repeat([100.0, 0.0], 3)  # (6,) m, m/s: section 6.2
FORCE, WEAK_FORCE = 100.0, 1.0  # () N of each axis: sections 6.2 and 6.2.3
BOX, SETTLE, END = 0.1, 6000.0, 60000.0  # () m, () s, () s: within 10 cm after 100 of 1000 minutes, section 6.2
PULSE = 0.1  # () s, shortest pulse, ours
LONGEST_STEP = 120.0  # () s, of RK4: 1e-9 of the distance from the ideal point in two weeks


def satellite(longitude: float = LONGITUDE) -> Station:
    """The satellite with all perturbations."""
    return Station.create(longitude, pressure=PRESSURE)


def unperturbed(longitude: float = LONGITUDE) -> Station:
    """The satellite around a spherical Earth and nothing else: its linear model is Hill's."""
    return Station.create(longitude, harmonics=gravity.SPHERE, moon=0.0, sun=0.0)


def sky(duration: float, *, longitude: float = LONGITUDE, epoch: datetime = EPOCH) -> Sky:
    """Moon, Sun and pole for `duration` s."""
    return Sky.over(longitude, epoch, duration)


def at_rest(start: ArrayLike = np.zeros(6)) -> StationState:  # noqa: B008 (immutable use)
    """State from position and velocity (6,) m and m/s relative to the ideal point; no fuel spent yet."""
    start = real("start", start, (6,))
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
    periods = round(duration / dt)
    if periods < 1 or abs(periods * dt - duration) > 1e-9 * duration:
        raise ScenarioError(f"duration = {duration} s must be a whole number of control periods of {dt} s")
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


def _model(harmonics: gravity.Harmonics) -> LinearModel:
    """Linear model at rest at the ideal point, without Moon, Sun and motion of the pole."""
    plant = Station.create(harmonics=harmonics, moon=0.0, sun=0.0)
    return linearize(plant, at_rest(), np.zeros(3), sky(DAY).with_fixed_pole(), hold=("spent",))


@jax.jit
def _perturbation(plant: Station, above: Sky, times: Array) -> Array:
    rest = StationState(*(jnp.zeros(3),) * 3)
    return jax.vmap(lambda t: plant.derivative(rest, jnp.zeros(3), above.at(t)).velocity)(times)
