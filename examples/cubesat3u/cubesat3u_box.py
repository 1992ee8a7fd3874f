"""All moments of inertia within a part of nominal: every loop with the body that flies, linear about nadir."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from cubesat3u_controllers import linear_law

from plants import cubesat3u
from plants.missions.cubesat3u import DEG
from plants.outcome.boxes import Question
from synth import StateSpace

WITHIN = (0.1, 0.3)  # of each moment, ours; table 5 has the first
SHOWN = 2e-6 / DEG * np.eye(3, 6)  # deg per uN m, from the vector part of the quaternion
QUANTITY = "Gain from a torque on the body to the angle, deg per µN m"
MODEL = (
    "Of the flown body with its wheels at rest, linear about nadir, with gravity gradient; exact in the moments. The "
    "torque is held by the midpoint rule in what is proved, exactly in the column of the simulator's plant. An MPC has "
    "the law that holds while no limit is active."
)
WHOSE = "three moments of inertia"


def questions(controllers: Mapping[str, Any], gains: Mapping[str, tuple[float, ...]]) -> list[Question]:
    """Of all controllers; the worst gain of those in `gains`, over the boxes named there."""
    model = cubesat3u.uncertain_model(max(WITHIN))
    laws = {name: linear_law(controller) for name, controller in controllers.items()}
    return [
        Question(
            name, name.lower().replace(" ", "_"), model, cubesat3u.wheeled_model,
            StateSpace(law.A, law.B, -law.C, -law.D, law.dt),  # the motors push the body the other way
            SHOWN, gains.get(name, ()),
        )
        for name, law in laws.items()
    ]  # fmt: skip
