"""Moments of inertia and motors' gains within a part of nominal: the laws at rest at the paper's target."""

from __future__ import annotations

import numpy as np
from airbearing_flights import LAWS
from airbearing_margins import gain

from plants import airbearing
from plants.missions.airbearing import DEG, INERTIA_SPREAD, PERIOD, TARGET
from plants.outcome.boxes import Question
from synth import StateSpace

WITHIN = (0.1, INERTIA_SPREAD)
QUANTITY = "Gain from a torque of the motors to the Euler angles, deg per mN m"
MODEL = (
    "At rest at the paper's target, where the gain of SDRE is that of the Riccati equation there: nothing is said of "
    "the slew. Exact in moments and gains, and so is the held torque."
)
WHOSE = "three moments of inertia and three gains of the motors"


def questions() -> list[Question]:
    """Of every law, over the spread of the flights."""
    model = airbearing.uncertain_model(INERTIA_SPREAD)
    return [
        Question(
            name, name.lower().replace(" ", "_").replace("^-", ""), model, airbearing.linear_model,
            # the motors turn the body the other way
            StateSpace.gain(gain(name, TARGET), PERIOD),
            1e-3 / DEG * np.eye(3, 6), WITHIN,
        )
        for name in LAWS
    ]  # fmt: skip
