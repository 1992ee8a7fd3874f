"""Thrust over mass of every axis within a part of nominal: the loops of chapter 6 on Hill's equations, sampled."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from geo_controllers import FOUR_BLOCK, LQR, MIXED, THESIS_LQR

from plants import geo
from plants.outcome.boxes import Question
from synth import LinearController, StateSpace

LAWS = (MIXED, THESIS_LQR, LQR, FOUR_BLOCK)
WITHIN = 0.3  # of each, the thesis's weight wI at rest
QUANTITY = "Gain from an acceleration to the position, m per µm/s²"
MODEL = (
    "Hill's equations with the thrust of every axis over the mass other than the model's, and constant: what section "
    "5.5 allows beyond that is in the norm of wI T above. Exact in the gains; the held thrust by the midpoint rule in "
    "what is proved, exactly in the column of the simulator's plant."
)
WHOSE = "three ratios of thrust and mass"


def questions(controllers: Mapping[str, LinearController]) -> list[Question]:
    """Of `LAWS`; the others have orders with which a proof takes as long, and say nothing new."""
    model = geo.uncertain_model(WITHIN)
    return [
        Question(
            name, name.lower().replace(",", "").replace(" ", "_"), model, geo.driven_model,
            moving(controllers[name]), 1e-6 * np.eye(3, 6), (WITHIN,),
        )
        for name in LAWS
    ]  # fmt: skip


def moving(K: LinearController) -> StateSpace:
    """The law from y to u without the states that only make all of one size."""
    k = np.flatnonzero(K.B.any(axis=1) | K.A.any(axis=1))
    return StateSpace(K.A[np.ix_(k, k)], -K.B[k], K.C[:, k], -K.D, K.dt)
