"""Every moment of inertia within a part of nominal: the laws frozen at rest at the target, and what that says of them.

At the target the SDRE laws are linear ones with the gains of the Riccati equations there, and so are their loops near
it; of slews from far away, and of wheels at their limits, these figures say nothing.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from amazonia1_flights import DYNAMIC, LITERAL, LQR, MRP, NET_INERTIA, PD, PID, SDRE, STATIC

from plants import amazonia1
from plants.missions.amazonia1 import DEG, INERTIA_SPREAD
from plants.outcome.boxes import Question
from synth import StateSpace

SHOWN = 2 / DEG * 1e-3 * np.eye(3, 6)  # deg per mN m
QUANTITY = "Gain from a torque on the body to the angle, deg per mN m"
MODEL = (
    "At rest at the target, wheels at rest and within their limits, where the laws of SDRE are those of the Riccati "
    "equations there: nothing is said of large angles. Exact in the moments, and so is the held torque."
)
WHOSE = "three moments of inertia"


def laws(built: Mapping[str, Any]) -> dict[str, StateSpace]:
    """From [vector part of the quaternion; rate] to the torque on the body near the target, by name."""
    I, O, dt = np.eye(6), np.zeros((3, 6)), float(built[SDRE].dt)
    half = np.diag([0.5] * 3 + [1.0] * 3)  # modified Rodrigues parameters are half of the vector part
    gains = {f"{LQR}, {SDRE}": built[SDRE].gain, MRP: built[MRP].gain @ half}
    gains |= {name: built[name].gain for name in (LITERAL, STATIC)}
    pd, pid, robust = built[PD], built[PID], built[DYNAMIC]
    gains[PD] = np.hstack([pd.Kp, pd.Kd])
    found = {name: StateSpace.gain(-K, dt) for name, K in gains.items()}
    found[PID] = StateSpace(np.eye(3), dt * I[:3], -pid.Ki, -np.hstack([pid.Kp, pid.Kd]), dt)
    A, B, K, Z = *_linear(), robust.gain, robust.injection
    turn = dt * np.linalg.inv(I - dt / 2 * (A - Z))
    found[DYNAMIC] = StateSpace(I + turn @ (A - B @ K - Z), turn @ Z, -K, O, dt)
    return found


def _linear() -> tuple[np.ndarray, np.ndarray]:
    """What the observer believes, (6, 6) and (6, 3)."""
    O = np.zeros((3, 3))
    return np.block([[O, np.eye(3) / 2], [O, O]]), np.vstack([O, np.linalg.inv(NET_INERTIA)])


def questions(built: Mapping[str, Any]) -> list[Question]:
    """Of every law, over the spread of the Monte Carlo."""
    model = amazonia1.uncertain_model(INERTIA_SPREAD)
    return [
        Question(
            name, "_".join(re.findall(r"\w+", name.lower())), model, amazonia1.wheeled_model,
            StateSpace(law.A, law.B, -law.C, -law.D, law.dt),  # the motors push the body the other way
            SHOWN, (INERTIA_SPREAD,),
        )
        for name, law in laws(built).items()
    ]  # fmt: skip
