"""The limit of 1 N: controllers that know it, by anti-windup of two kinds or by prediction, and what it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import geo_controllers as design
import numpy as np
import scipy.linalg as sla

from plants import Reading, Rule, Statement
from plants.missions.geo import MASS, WEAK_FORCE
from synth import AntiWindup, Design, LinearController, Mpc, StateSpace, c2d, mpc, ncfsyn

if TYPE_CHECKING:
    from geo_flights import Study

LOOP, LOOP_TOLD = "loop shaping with integrators", "loop shaping, anti-windup"
MIXED_TOLD = "H-infinity of the thesis, anti-windup"
QUADRATIC = "MPC, the regulator's cost"
LIMIT = WEAK_FORCE / MASS  # m/s^2
GAIN, CORNER = 0.3, 0.02  # per min^2, rad/min: of W1 = GAIN (1 + CORNER / s), about as fast as the thesis's design
AHEAD = 40  # samples of a minute: twice what it takes to stop from 1 km with 1 N
ADDED = 5.0  # % of the start, of overshoot: what a limit may add without an "additional oscillation"
PRICE = 200.0  # of section 6.2.1
REFERENCE = {
    design.THESIS_LQR: design.THESIS_LQR,
    design.MIXED: design.MIXED,
    MIXED_TOLD: design.MIXED,
    LOOP_TOLD: LOOP,
    QUADRATIC: QUADRATIC,
    design.FUEL: design.FUEL,
}


def loop_shaping(n: float, dt: float) -> tuple[LinearController, AntiWindup, Design]:
    """H-infinity loop shaping (Glover and McFarlane) with integrators, without and with anti-windup, on the state."""
    unit, h, I3 = design.MINUTE, dt / design.MINUTE, design.I3
    G = c2d(design.relative_motion(n, unit), h)
    W1 = StateSpace(I3, h * CORNER * I3, GAIN * I3, GAIN * (1 + h * CORNER / 2) * I3, h)
    shaped = ncfsyn(StateSpace(G.A, G.B, -G.C, G.D, h), W1)
    K = shaped.controller
    plain = LinearController.of(StateSpace(K.A, K.B, K.C / unit**2, K.D / unit**2, dt))
    told = AntiWindup.of(shaped, -LIMIT * unit**2, LIMIT * unit**2)
    told = replace(
        told, C=plain.C, D=plain.D, L=told.L * unit**2, umin=-np.full(3, LIMIT), umax=np.full(3, LIMIT), dt=dt
    )
    return design.padded(plain, 12, 6), replace(told, B=unread(told.B), D=unread(told.D)), shaped


def unread(B: np.ndarray) -> np.ndarray:
    """The same matrix for three inputs more, the velocity, that are not read."""
    return np.pad(B, ((0, 0), (0, 3)))


def observing(K: LinearController) -> AntiWindup:
    """Anti-windup for a controller whose states mean nothing in particular: x+ = A x + B e + L (u - v).

    L is the gain of the Kalman filter of (A, C) under noise of B in the states and little noise of v: A - L C, the
    dynamics while the limit holds, is as fast as that allows. Astrom and Hagglund (1995), PID controllers, section 3.5.
    """
    Q = K.B @ K.B.T
    Q += 1e-9 * np.trace(Q) * np.eye(len(Q))
    R = 1e-8 * np.trace(K.C @ Q @ K.C.T) / 3 * design.I3
    X = sla.solve_discrete_are(K.A.T, K.C.T, Q, R)
    L = K.A @ X @ K.C.T @ np.linalg.inv(K.C @ X @ K.C.T + R)
    return AntiWindup(K.A, K.B, K.C, K.D, L, -np.full(3, LIMIT), np.full(3, LIMIT), K.dt)


def quadratic(n: float, limit: float, dt: float = 60.0) -> Mpc:
    """Predictive control with the cost of the thesis's regulator, in km and minutes, that knows the limit in m/s^2."""
    G = design.relative_motion(n)
    model = c2d(StateSpace(G.A, G.B, design.I6, np.zeros((6, 3))), dt)
    Q = np.diag([1e-3**2] * 3 + [(1e-3 * design.MINUTE) ** 2] * 3)
    R = PRICE * (1e-3 * design.MINUTE**2) ** 2 * design.I3
    last = sla.solve_discrete_are(model.A, model.B, Q, R)
    return mpc(model, Q=Q, R=R, Np=AHEAD, Nc=AHEAD, umin=-limit, umax=limit, form="position", terminal=last)


def added(found: Study, name: str) -> float:
    """Overshoot of a controller with 1 N from 1 km beyond that of its free motion, % of the start."""
    saturated = found.saturated | found.windup
    free = found.chapter6 | found.free
    return saturated[name].overshoot - free[REFERENCE[name]].overshoot


def saturation(found: Study) -> list[Statement]:
    """Oscillation under the limit, and its two cures."""

    def of(*names: str) -> Sequence[Reading]:
        saturated, free = found.saturated | found.windup, found.chapter6 | found.free
        return [
            Reading(
                name,
                added(found, name),
                text=f"{saturated[name].overshoot:.0f} % after {free[REFERENCE[name]].overshoot:.0f} % without a limit",
            )
            for name in names
        ]

    quantity = "overshoot that the limit of 1 N adds, from 1 km"
    return [
        Statement(
            "With the limit additional oscillations occur with both methods",
            "figures 6.5, 6.7",
            lambda: of(design.THESIS_LQR, design.MIXED),
            Rule(quantity, ">", ADDED, "% of the start"),
            depends="the controller",
        ),
        Statement(
            "Anti-windup cures the oscillations",
            "section 6.3",
            lambda: of(MIXED_TOLD, LOOP_TOLD),
            Rule(quantity, "<=", ADDED, "% of the start"),
            depends="the controller",
            why="no integrator winds up: 1 N cannot brake in time what was asked for without knowing of it",
        ),
        Statement(
            "Model predictive control cures the oscillations",
            "section 6.3",
            lambda: of(QUADRATIC, design.FUEL),
            Rule(quantity, "<=", ADDED, "% of the start"),
            depends="the cost",
            why="it knows when it has to brake",
        ),
    ]
