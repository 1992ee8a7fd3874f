"""The worst start within a kilometre: what does the tuned LQR spend, perturbed, with weak thrusters?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import geo_controllers as design
import jax.numpy as jnp
import numpy as np

from plants import Loop, Scenario, Thrusters, draw, geo
from plants.missions.geo import MASS, WEAK_FORCE
from plants.outcome.worst import Question

PERIOD, DURATION = 60.0, 30000.0  # s


class Start(NamedTuple):
    """Where a flight begins and what it flies with."""

    position: Any  # (3,) m
    velocity: Any  # (3,) m/s
    limit: Any  # () N of each axis


def box() -> tuple[Start, Start]:
    """1 km, 5 cm/s, 1 to 5 N."""
    near, slow = np.full(3, 1000.0), np.full(3, 0.05)
    return Start(-near, -slow, WEAK_FORCE), Start(near, slow, 5 * WEAK_FORCE)


def case(start: Start, shared: tuple[Loop, Scenario]) -> tuple[Loop, Scenario]:
    """One run: the common one from another start."""
    loop, scenario = shared
    initial = geo.at_rest(np.concatenate([start.position, start.velocity]))
    return replace(loop, actuator=Thrusters.create(MASS, start.limit)), replace(scenario, initial=initial)


def spent(run: Any) -> Any:
    """Delta-v of all axes, m/s."""
    return jnp.abs(run.inputs).sum() * PERIOD


def question(rate: float, runs: int, seed: int) -> Question:
    """With as many uniform draws."""
    lower, upper = box()
    unit, weight = design.UNITS[design.LQR]
    controller = design.regulator(rate, unit, PERIOD, rate=weight)

    def one(seed: int, index: int) -> Start:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        return Start(*(rng.uniform(a, b) for a, b in zip(lower, upper, strict=True)))

    return Question(
        case=case,
        box=(lower, upper),
        objective=spent,
        shared=geo.case(controller, np.zeros(6), DURATION),
        drawn=draw(one, runs, seed),
        name=f"{design.LQR}, every {PERIOD:g} s, perturbed: delta-v in {DURATION / PERIOD:g} min",
        unit="m/s",
        history=lambda run: np.linalg.norm(run.outputs[:, :3], axis=1),
        label="distance, m",
        spelled=spelled,
        scale="log",
    )


def spelled(start: Start) -> str:
    """From where, how fast, with what."""
    position = ", ".join(f"{x:.4g}" for x in start.position)
    velocity = ", ".join(f"{100 * v:.3g}" for v in start.velocity)
    return f"from {position} m (radial, along, normal) at {velocity} cm/s with {start.limit:.3g} N"
