"""The loops of the air-bearing study as linear ones at rest at the target: stability and margins at the wheels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from airbearing_flights import EXACT, LAWS, SDRE, inverse, linear

from plants.missions.airbearing import DEG, PERIOD, TARGET, Q, R
from synth import StateSpace, lqrd, margins
from synth.regulators.regulator import sampled_cost

ROLLS = (float("nan"), 50.0, 70.0, 90.0, 100.0, 170.0)  # deg, of the targets; `nan` stands for all angles zero


class Local(NamedTuple):
    """A sampled loop near its target; margins are zero where it is unstable."""

    radius: float  # spectral radius
    gain: float  # dB, smallest of the three wheels, one at a time
    phase: float  # deg, likewise
    delay: float  # s, likewise
    disk: float  # dB, by which all three may change at once, with phase


def target(roll: float) -> np.ndarray:
    """The paper's target with another roll (deg), (3,) rad; `nan` stands for angles zero."""
    return np.zeros(3) if np.isnan(roll) else np.array([roll * DEG, TARGET[1], TARGET[2]])


def gain(name: str, angles: np.ndarray) -> np.ndarray:
    """The gain of a law at rest at `angles` (3,) rad, (3, 6)."""
    K = lqrd(*(linear(angles) if name == SDRE else linear()), Q, R, PERIOD)[0]
    return np.hstack([K[:, :3] @ np.asarray(inverse(angles)), K[:, 3:]]) if name == EXACT else K


def local(name: str, angles: np.ndarray) -> Local:
    """The loop of a law at rest at `angles` (3,) rad with the paper's inertia."""
    A, B = linear(angles)
    F, G, *_ = sampled_cost(A, B, Q, R, PERIOD)
    K = gain(name, angles)
    radius = float(np.abs(np.linalg.eigvals(F - G @ K)).max())
    if radius >= 1:
        return Local(radius, 0.0, 0.0, 0.0, 0.0)
    found = margins(StateSpace(F, G, np.eye(6), np.zeros((6, 3)), PERIOD), K)
    each = found.input
    return Local(
        radius,
        min(m.gain_db for m in each),
        min(m.phase_deg for m in each),
        min(m.delay for m in each),
        found.disk_input.gain_db,
    )


def everywhere() -> dict[str, dict[float, Local]]:
    """law -> roll of the target, deg -> its loop there."""
    return {name: {roll: local(name, target(roll)) for roll in ROLLS} for name in LAWS}
