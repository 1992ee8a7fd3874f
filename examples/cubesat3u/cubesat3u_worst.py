"""The worst flight of table 5's box: what error does the H-infinity controller leave after 100 s, attitude known?"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from plants import Loop, Scenario, cubesat3u
from plants.missions.cubesat3u import DEG
from plants.outcome.worst import Question

SINCE, DURATION = 100.0, 200.0  # s


class Start(NamedTuple):
    """One draw of table 5, or a corner of it."""

    inertia: Any  # (3,) kg m^2
    angles: Any  # (3,) rad
    rates: Any  # (3,) rad/s


class Shared(NamedTuple):
    """What all flights have in common."""

    environment: Any
    controller: Any


def box() -> tuple[Start, Start]:
    """Table 5."""
    wide, fast = np.full(3, 25 * DEG), np.full(3, 0.3 * DEG)
    return Start(0.9 * cubesat3u.INERTIA, -wide, -fast), Start(1.1 * cubesat3u.INERTIA, wide, fast)


def case(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """One run, without noise: the controller sees the true attitude and rate."""
    loop = Loop(plant=cubesat3u.body(start.inertia), controller=shared.controller, actuator=cubesat3u.wheels())
    return loop, Scenario(
        initial=cubesat3u.initial_state(shared.environment, start.angles, start.rates),
        dt=cubesat3u.CONTROL_PERIOD,
        periods=round(DURATION / cubesat3u.CONTROL_PERIOD),
        samples=cubesat3u.SAMPLES,
        environment=shared.environment,
    )


def error(run: Any) -> Any:
    """Angle from the desired attitude, (N,) deg."""
    return 2 * jnp.arcsin(jnp.minimum(jnp.sqrt((run.outputs[:, :3] ** 2).sum(axis=1)), 1.0)) / DEG


def left(run: Any) -> Any:
    """Largest error from `SINCE` on, deg."""
    return error(run)[run.time >= SINCE].max()


def question(controller: Any, drawn: Any) -> Question:
    """With the dispersions of the Monte Carlo, (m, ...) like `Start`."""
    return Question(
        case=case,
        box=box(),
        objective=left,
        shared=Shared(cubesat3u.environment(DURATION), controller),
        drawn=Start(*drawn),
        name=f"H-infinity, attitude known: error from {SINCE:g} s on",
        unit="deg",
        history=lambda run: np.asarray(error(run)),
        label="error, deg",
        spelled=spelled,
        scale="log",
    )


def spelled(start: Start) -> str:
    """In the units of table 5."""
    inertia = ", ".join(f"{100 * (a / b - 1):+.3g}" for a, b in zip(start.inertia, cubesat3u.INERTIA, strict=True))
    angles, rates = (", ".join(f"{a / DEG:.3g}" for a in values) for values in (start.angles, start.rates))
    return f"inertia {inertia} %; roll, pitch, yaw {angles} deg; rates {rates} deg/s"
