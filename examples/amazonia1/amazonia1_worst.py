"""The worst flight of the Monte Carlo's box: how far does the LQR turn the satellite on its way to rest?"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from plants import Loop, Scenario, amazonia1, attitude
from plants.missions.amazonia1 import DEG, INERTIA, INERTIA_SPREAD, MONTE_CARLO_RATE, Dispersion, Start
from plants.outcome.worst import Question

PERIOD, DURATION, ROW = 0.25, 600.0, 1.0  # s; the controller is one of this period


def box() -> tuple[Dispersion, Dispersion]:
    """Section 5."""
    moments, turn, rate = np.diag(INERTIA), np.full(3, 180 * DEG), np.full(3, MONTE_CARLO_RATE)
    lower = Dispersion((1 - INERTIA_SPREAD) * moments, -turn, -rate)
    return lower, Dispersion((1 + INERTIA_SPREAD) * moments, turn, rate)


def case(start: Dispersion, controller: Any) -> tuple[Loop, Scenario]:
    """One run."""
    with jax.enable_x64(True):
        q = np.asarray(_quaternion(start.angles))
    return amazonia1.manoeuvre(
        Start(start.moments, q, start.rates, np.zeros(3)), controller,
        duration=DURATION, period=PERIOD, keep_every=round(ROW / PERIOD),
    )  # fmt: skip


def turned(run: Any) -> Any:
    """Integral of the rate, deg."""
    return jnp.sqrt((run.outputs[:, 4:7] ** 2).sum(axis=1)).mean() * run.duration / DEG


def question(controller: Any, drawn: Any) -> Question:
    """With the dispersions of the Monte Carlo, leaves (m, ...)."""
    return Question(
        case=case,
        box=box(),
        objective=turned,
        shared=controller,
        drawn=drawn,
        name=f"LQR every {PERIOD:g} s: turned in {DURATION:g} s",
        unit="deg",
        history=lambda run: amazonia1.angles(run) / DEG,
        label="angle to go, deg",
        spelled=spelled,
    )


def spelled(start: Dispersion) -> str:
    """In the units of section 5."""
    moments = ", ".join(f"{100 * (a / b - 1):+.3g}" for a, b in zip(start.moments, np.diag(INERTIA), strict=True))
    angles, rates = ", ".join(f"{a / DEG:.4g}" for a in start.angles), ", ".join(f"{w:.3g}" for w in start.rates)
    return f"moments {moments} %; roll, pitch, yaw {angles} deg; rates {rates} rad/s"


_quaternion = jax.jit(attitude.from_euler)
