"""Beyond nadir by day: the state machine of figure 6, an attitude far away, the forces on the orbit, a night."""

from __future__ import annotations

import functools
from typing import Any

import jax
import numpy as np
from cubesat3u_claims import BOUNDS
from cubesat3u_flights import Shared, Start, case

import plants
import synth
from plants import Loop, Run, Scenario, attitude, cubesat3u, pointing_errors
from plants.missions.cubesat3u import DEG
from plants.outcome.indices import error
from plants.simulation import programs

ORBIT = 5640.0  # s
FAR, NEAR = 170.0, 90.0  # deg, roll, ours
FASTER = 10  # () rates at the start of the tumble over those of table 5
DAMPED = 20.0  # s, in which the wheels take a tumble down, ours
SLOW, HOLD = 0.3 * DEG, 20.0  # rad/s, s: when it is detumbled
STAY = 0.2  # () of the flight, that it then looks at nadir
SLEW = {"max_rate": 1.0 * DEG, "max_acceleration": 0.02 * DEG}  # rad/s, rad/s^2
NAMES = ("detumbling", "nadir", f"{FAR:g} deg of roll")
angles = programs.Program(attitude.to_euler)


@programs.Program
def along(orbit: plants.Environment, times: Any) -> Any:
    """Part of the Sun's disk that is seen at the times (n,) s, (n,)."""
    return jax.vmap(lambda t: orbit.at(t).sunlit)(times)


def turned(roll: float) -> np.ndarray:
    """Attitude (4,) after a roll () deg."""
    return np.array([np.cos(roll * DEG / 2), np.sin(roll * DEG / 2), 0.0, 0.0])


def reference(roll: float) -> tuple[float, ...]:
    """What the controller is to track by r - y, (6,)."""
    return (*turned(roll)[1:], 0.0, 0.0, 0.0)


def tumbling(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """The state machine: the wheels stop a tumble, then nadir, then a roll tracked by the error quaternion."""
    loop, scenario = case(start._replace(rates=FASTER * start.rates), shared)
    damping = synth.state_feedback(np.hstack([np.zeros((3, 3)), np.diag(cubesat3u.INERTIA) / DAMPED]), scenario.dt)
    law = plants.AttitudeControl(controller=loop.controller)
    away = plants.Offset.create(turned(FAR), plants.Nadir())
    made = plants.sequence(
        [
            plants.mode(NAMES[0], plants.AttitudeControl(controller=damping),
                        until=plants.Slow.create(SLOW, hold=HOLD)),
            plants.mode(NAMES[1], law, until=plants.After.create(STAY * scenario.periods * scenario.dt), **SLEW),
            plants.mode(NAMES[2], law, guidance=away, **SLEW),
        ],
        dt=scenario.dt,
        navigators=[loop.navigator],
        wheel_axes=cubesat3u.WHEEL_AXES,
        wheel_inertia=cubesat3u.WHEEL_INERTIA,
        magnetorquers=False,
    )  # fmt: skip
    return Loop(
        plant=loop.plant, controller=made.controller, sensors=loop.sensors, navigator=made.navigator,
        actuator=loop.actuator,
    ), scenario  # fmt: skip


def misses(run: Run, roll: float, start: float) -> np.ndarray:
    """95 % level (3,) rad of the attitude against the roll, from `start` () s on; infinite if the run failed."""
    if not run.ok:
        return np.full(3, np.inf)
    late = run.outputs[run.time >= start, :3]
    off = np.asarray(angles(error(late, np.broadcast_to(turned(roll)[1:], late.shape))))
    return np.quantile(np.abs(off), 0.95, axis=0, method="inverted_cdf")


def fly_far(found: Any, drawn: Start, shared: Shared, options: Any) -> None:
    """Two rolls by r - y and one by the state machine, from every start."""
    flights = {
        f"{NEAR:g} deg, r - y": (case, shared._replace(reference=reference(NEAR)), NEAR, 0.5),
        f"{FAR:g} deg, r - y": (case, shared._replace(reference=reference(FAR)), FAR, 0.5),
        f"{FAR:g} deg, error quaternion": (tumbling, shared, FAR, 0.8),
    }
    for name, (how, common, roll, late) in flights.items():
        start = late * shared.periods * cubesat3u.CONTROL_PERIOD
        record = plants.commanded_record if how is tumbling else plants.ekf_record
        measure = functools.partial(misses, roll=roll, start=start)
        flown = plants.campaign(how, drawn, common, measure=measure, record=record, keep=[0], **options(name))
        if not flown.complete:
            raise KeyboardInterrupt
        found.tracked[name] = np.asarray(flown.results).max(axis=-1) / DEG <= BOUNDS["APE"]
        found.far[name] = flown.kept[0]


def perturb(found: Any, nominal: dict[int, Run], flown: dict[int, Run], orbits: tuple[Any, Any]) -> None:
    """What all forces on the orbit change against the oblateness alone: position () m and attitude () deg at most."""
    r = [np.asarray(env.splines)[: int(env.duration / env.step) + 1, 0, :3] for env in orbits]
    turns = [
        np.abs(pointing_errors(run).ape - pointing_errors(flown[index]).ape).max() for index, run in nominal.items()
    ]
    found.moved = float(np.linalg.norm(r[1] - r[0], axis=1).max()), float(max(turns) / DEG)


def into_night(duration: float) -> plants.Environment:
    """An environment of which the last two thirds lie in eclipse."""
    orbit = cubesat3u.environment(ORBIT)
    times = np.arange(0.0, ORBIT, orbit.step)
    with jax.enable_x64(True):
        sunlit = np.asarray(along(orbit, times))
    begins = times[np.argmax(sunlit < 1.0)] - duration / 3
    return cubesat3u.environment(
        duration, argument_of_latitude=cubesat3u.ARGUMENT_OF_LATITUDE + 2 * np.pi * begins / ORBIT
    )


def told(found: Any) -> list[str]:
    """Findings about all this, in sentences."""
    sentences = []
    if found.tracked:
        shares = "; ".join(f"{name} in {met.sum()} of {met.size} runs" for name, met in found.tracked.items())
        sentences.append(
            f"Another attitude than nadir is held within table 1 at {shares}: by r - y from the starts of table 5 at "
            "once, by the error quaternion after a tumble, nadir and a slew within its limits of rate and acceleration."
        )
    if found.moved:
        metres, degrees = found.moved
        sentences.append(
            f"Moon, Sun, harmonics to degree 3, drag and solar pressure on the orbit (figure 6) move the spacecraft by "
            f"{metres:.3g} m at most during the run, and its attitude by {degrees:.2g} deg: J2 alone is enough here."
        )
    return sentences
