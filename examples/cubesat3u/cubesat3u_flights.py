"""What the study flies: the cases of its campaigns, and what is measured of every run."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from plants import Indices, Loop, Run, Scenario, attitude, cubesat3u, draw, indices, pointing_errors, stability
from plants.missions.cubesat3u import REQUIREMENTS
from plants.simulation.programs import Program

SLOW = 10.0  # s, the other interval over which the stability is read, ours
EVERY = 10.0  # s, between the samples at which the filters' errors are kept
VARYING = (  # in some of the campaigns, so that all of them fly the same compiled programs
    "[0].plant.inertia", "[0].plant.inverse", "[1].initial.q", "[1].initial.w", "[1].environment.splines",
)  # fmt: skip
WIDE = 0.5  # () of the moments of inertia: five times the dispersion of table 5, ours


class Start(NamedTuple):
    """What differs between the runs of the campaign; run 0 is table 3, the others are drawn from table 5."""

    inertia: np.ndarray  # (3,) kg m^2
    angles: np.ndarray  # (3,) rad
    rates: np.ndarray  # (3,) rad/s


class Shared(NamedTuple):
    """What the runs of one configuration have in common."""

    environment: Any
    controller: Any
    navigator: Any
    periods: int
    reference: Any = (0.0,) * 6  # vector part of a quaternion and rad/s, relative to frame O


def start_of_table_3() -> Start:
    """One run."""
    return Start(cubesat3u.INERTIA, cubesat3u.ANGLES, cubesat3u.RATES)


def starts(runs: int, seed: int) -> Start:
    """Table 3 and `runs` draws of table 5."""

    def one(seed: int, index: int) -> Start:
        if index == 0:
            return start_of_table_3()
        drawn = cubesat3u.disperse(seed, index)
        return Start(drawn.inertia, drawn.angles, drawn.rates)

    return draw(one, runs + 1, seed)


def of_wide_inertia(drawn: Start) -> Start:
    """The same starts with every moment of inertia within `WIDE` instead of the 10 % of table 5."""
    return drawn._replace(inertia=cubesat3u.INERTIA * (1 + WIDE / 0.1 * (drawn.inertia / cubesat3u.INERTIA - 1)))


def case(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    loop = Loop(
        plant=cubesat3u.body(start.inertia),
        controller=shared.controller,
        sensors=cubesat3u.suite(),
        navigator=shared.navigator,
        actuator=cubesat3u.wheels(),
    )
    return loop, Scenario(
        initial=cubesat3u.initial_state(shared.environment, start.angles, start.rates),
        dt=cubesat3u.CONTROL_PERIOD,
        periods=shared.periods,
        samples=cubesat3u.SAMPLES,
        reference=np.asarray(shared.reference),
        environment=shared.environment,
    )


def applied(loop: Loop, scenario: Scenario) -> Start:
    """The dispersion read back from the blocks that fly."""
    with jax.enable_x64(True):
        angles, rates = map(np.asarray, attitude_of(loop.plant, scenario.initial, scenario.environment))
        return Start(np.diag(loop.plant.inertia), angles, rates)


@Program
def attitude_of(plant: Any, x: Any, environment: Any) -> tuple[Any, Any]:
    """Roll, pitch and yaw (3,) rad and rates (3,) rad/s at first, relative to frame O."""
    y = plant.output(x, environment.at(0.0))
    return attitude.to_euler(jnp.concatenate([jnp.sqrt(1 - y[:3] @ y[:3])[None], y[:3]])), y[3:]


def quiet(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """The same run with Sun sensor and magnetometer of half the noise: table 2 of the paper is not in the text."""
    loop, scenario = case(start, shared)
    sun, field_ = loop.sensors.sun, loop.sensors.magnetometer
    sun, field_ = (dataclasses.replace(sensor, noise=sensor.noise / 2) for sensor in (sun, field_))
    return dataclasses.replace(loop, sensors=dataclasses.replace(loop.sensors, sun=sun, magnetometer=field_)), scenario


def on_plane(drawn: tuple[Start, Any], shared: Shared) -> tuple[Loop, Scenario]:
    """`case` in an environment of its own."""
    start, surroundings = drawn
    return case(start, shared._replace(environment=surroundings))


@dataclass(frozen=True, kw_only=True)
class Measured(Indices):
    """Indices of a run, and what its filter believed every `EVERY` s, NaN if the run failed."""

    slow: np.ndarray  # (3,) rad, PSE over `SLOW` s
    white: np.ndarray  # (k, 9) errors of the filter's states in units of what it believes; (0, 9) without a filter
    nis: np.ndarray  # (k,) normalised innovation squared
    rows: np.ndarray  # (k,) its degrees of freedom


def measure(run: Run, start: float) -> Measured:
    """What is kept of every run, from `start` () s on."""
    i = indices(run, start=start, delta_t=REQUIREMENTS.pse_interval)
    h = cubesat3u.CONTROL_PERIOD / cubesat3u.SAMPLES
    lag, step = round(SLOW / h), round(EVERY / h)
    late = slice(round(start / h), None, step)
    slow, believed = np.full(3, np.inf), run.extra
    if run.ok:
        drift = stability(pointing_errors(run).ape, lag)[run.time[lag:] >= start - 1e-9]
        slow = np.quantile(np.abs(drift), i.share, axis=0, method="inverted_cdf")
    if believed is None:
        parts = {"white": np.zeros((0, 9)), "nis": np.zeros(0), "rows": np.zeros(0)}
    elif run.ok:
        parts = {"white": believed.error[late], "nis": believed.nis[late], "rows": believed.rows[late]}
    else:
        k = len(range(*late.indices(round(run.duration / h))))
        parts = {"white": np.full((k, 9), np.nan), "nis": np.full(k, np.nan), "rows": np.full(k, np.nan)}
    fields = {f.name: getattr(i, f.name) for f in dataclasses.fields(Indices)}
    return Measured(**fields, slow=slow, **parts)
