"""The worst slew within the paper's angles and our wheels: what error does the LQR add up on its way?"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from plants import Loop, Scenario, airbearing, draw
from plants.missions.airbearing import DEG, PERIOD, TARGET, TORQUE_LIMITS
from plants.outcome.worst import Question

DURATION = 80.0  # s


class Slew(NamedTuple):
    """A slew without noise."""

    target: Any  # (3,) rad
    torque_limit: Any  # () N m of each wheel


def box() -> tuple[Slew, Slew]:
    """The paper's angles to both sides, and all our limits of the wheels."""
    size, limits = np.abs(TARGET), [limit for limit in TORQUE_LIMITS if np.isfinite(limit)]
    return Slew(-size, min(limits)), Slew(size, max(limits))


def case(slew: Slew, controller: Any) -> tuple[Loop, Scenario]:
    """One run."""
    one = airbearing.case(slew.target, torque_limit=slew.torque_limit)
    return airbearing.manoeuvre(one, controller, airbearing.raw(), duration=DURATION)


def error(run: Any) -> Any:
    """Largest of the three angles' errors, (N,) deg."""
    return jnp.abs(run.outputs[:, :3] - run.references[:, :3]).max(axis=1) / DEG


def added(run: Any) -> Any:
    """Its integral, deg s."""
    return error(run).sum() * PERIOD


def question(controller: Any, runs: int, seed: int) -> Question:
    """With as many uniform draws."""
    lower, upper = box()

    def one(seed: int, index: int) -> Slew:
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
        return Slew(*(rng.uniform(a, b) for a, b in zip(lower, upper, strict=True)))

    return Question(
        case=case,
        box=(lower, upper),
        objective=added,
        shared=controller,
        drawn=draw(one, runs, seed),
        name=f"LQR without noise: integral of the error in {DURATION:g} s",
        unit="deg s",
        history=lambda run: np.asarray(error(run)),
        label="error, deg",
        spelled=spelled,
        scale="log",
    )


def spelled(slew: Slew) -> str:
    """Target and wheels."""
    target = ", ".join(f"{a / DEG:.3g}" for a in slew.target)
    return f"target {target} deg with wheels of {slew.torque_limit:.3g} N m"
