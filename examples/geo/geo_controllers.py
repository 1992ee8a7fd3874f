"""The controllers of the geostationary study, each tuned by one number: its unit of time.

The thesis counts in minutes. In a longer unit tau the same weights ask for the same motion, slower by tau / 60 s, so
that every structure has one number that trades fuel for speed. `UNITS` holds the longest units with which 100 m are
brought within 10 cm in 100 minutes on the linear plant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from synth import (
    Design,
    GeneralizedPlant,
    LinearController,
    StateSpace,
    c2d,
    dlqr,
    hinfsyn,
    lqg,
    lqr,
    mixsyn,
    state_feedback,
)

THESIS_LQR, LQR, LQG = "LQR of the thesis", "LQR, tuned", "LQG"
MIXED, MIXED_TUNED, FOUR_BLOCK = "H-infinity of the thesis", "H-infinity, tuned", "H-infinity, four blocks"
LQR4, MIXED5, MIXED5_CHEAP = "LQR of chapter 4", "H-infinity of chapter 5", "H-infinity of chapter 5, cheap control"
FORESEEING, FUEL = "LQR, tuned, foreseeing", "least-fuel MPC"
MINUTE = 60.0  # s
# unit of time in s and the second number of each structure; a 3 % longer unit misses the 10 cm
UNITS = {LQR: (740.0, 1.5), LQG: (620.0, 32.0), MIXED_TUNED: (715.0, 0.8), FOUR_BLOCK: (530.0, 1.0)}
I3, I6 = np.eye(3), np.eye(6)
SHIFT = 0.1  # per unit of time, makes the thesis's weights a problem with a solution


class Weights(NamedTuple):
    """The thesis's weights in its own symbols, times in minutes."""

    Ms: float  # of wP (5.41, 6.4)
    A: float
    wB: float  # rad/min
    tau: float  # min, of wI (5.42, 6.5)
    r0: float
    rinf: float
    wu: float  # (6.6)


CHAPTER6 = Weights(2.0, 0.03, 1.0, 1 / 20, 0.3, 2.0, 1.5)
CHAPTER5 = Weights(2.0, 0.003, 10.0, 0.1, 0.3, 2.0, 1.5)  # section 5.6 does not say wu: that of 6.6
CHEAP = CHAPTER5._replace(wu=1e-3)  # and one with which the level is nearly one


def relative_motion(n: float, unit: float = 1.0) -> StateSpace:
    """Relative motion about a circular orbit of rate `n` rad/s, x radial, y along the track, z normal to the plane.

    States position (3) and velocity (3), input acceleration (3), output position (3); times in `unit` s.
    Reference: Clohessy and Wiltshire (1960); the thesis, equations 3.19 to 3.21, corrected.
    """
    m = n * unit
    A = np.zeros((6, 6))
    A[:3, 3:] = I3
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * m**2, 2 * m, -2 * m, -(m**2)
    return StateSpace(A, I6[:, 3:], I6[:3], np.zeros((3, 3)))


def thesis_regulator(n: float, price: float) -> tuple[np.ndarray, np.ndarray]:
    """(gain, closed-loop eigenvalues) of sections 4.4 and 6.2.1, in km and minutes: (3, 6), (6,).

    Euler's A for 0.1 min, an input matrix that was not multiplied by it, Q = I, R = `price` I.
    """
    G, step = relative_motion(n, MINUTE), 0.1
    K, _, E = dlqr(I6 + step * G.A, G.B, I6, price * I3)
    return K, E


def thesis_weights(w: Weights = CHAPTER6) -> tuple[StateSpace, float, StateSpace]:
    """W1, W2 and W3 of equations 5.41, 5.42 and 6.4 to 6.6."""
    corner = w.rinf / w.tau
    W1 = first_order(1 / w.Ms, w.wB * (1 - w.A / w.Ms), w.wB * w.A)
    return W1, w.wu, first_order(w.rinf, corner * (w.r0 - w.rinf), corner)


def first_order(direct: float, residue: float, pole: float) -> StateSpace:
    """direct + residue / (s + pole)."""
    return StateSpace(np.array([[-pole]]), np.array([[1.0]]), np.array([[residue]]), np.array([[direct]]))


def mixed_sensitivity(n: float, unit: float = MINUTE, shift: float = SHIFT, weights: Weights = CHAPTER6) -> Design:
    """The thesis's H-infinity problem in that unit of time, position measured."""
    return mixsyn(relative_motion(n, unit), *thesis_weights(weights), shift=shift)


def four_block(n: float, unit: float, push: float) -> Design:
    """The regular problem: accelerations of `push` units, noise of one, position and acceleration weighed alike."""
    plant = relative_motion(n, unit)
    return hinfsyn(GeneralizedPlant.four_block(plant, Wdist=push * I3, Wnoise=I3, Wout=I3, Wact=I3))


def gaussian(n: float, unit: float, push: float) -> StateSpace:
    """LQG for the signals of `four_block`, u = K (r - y)."""
    G = relative_motion(n, unit)
    weight, noise = np.diag([1.0] * 3 + [0.0] * 3 + [1.0] * 3), np.diag([0.0] * 3 + [push**2] * 3 + [1.0] * 3)
    K = lqg(G, weight, noise)
    return StateSpace(K.A, -K.B, K.C, -K.D)


def sampled(K: StateSpace, unit: float, dt: float) -> LinearController:
    """A controller of lengths and `unit` s as one of metres and seconds: trapezoidal rule, on the position (3,)."""
    seconds = StateSpace(K.A / unit, K.B / unit, K.C / unit**2, K.D / unit**2)
    return LinearController.of(c2d(seconds, dt, "tustin"))


def regulator(n: float, unit: float, dt: float, *, rate: float = 0.0) -> LinearController:
    """LQR with weights 1 of position and acceleration and `rate` of velocity, on the state (6,)."""
    G = relative_motion(n, unit)
    K = lqr(G.A, G.B, np.diag([1.0] * 3 + [rate] * 3), I3)[0]
    return state_feedback(np.hstack([K[:, :3] / unit**2, K[:, 3:] / unit]), dt)


@dataclass(frozen=True)
class Foreseeing:
    """A controller that takes off what is known to act in each sample."""

    controller: LinearController
    known: np.ndarray  # (samples, 3) m/s^2

    @property
    def dt(self) -> float:
        """Sampling time in seconds."""
        return self.controller.dt

    def init(self) -> tuple[int, Any]:
        """The first sample."""
        return 0, self.controller.init()

    def step(self, state: tuple[Any, Any], y: Any, r: Any) -> tuple[tuple[Any, Any], Any]:
        """(state, y, r) -> (state, u)."""
        sample, inner = state
        inner, u = self.controller.step(inner, y, r)
        return (sample + 1, inner), u - self.known[sample]


def linear(n: float, dt: float) -> tuple[dict[str, LinearController], dict[str, Design]]:
    """All linear controllers on the state (6,), m and m/s, and the designs of those that come from one.

    All have twelve states, so that one compiled loop serves them; those without dynamics leave them at zero.
    """
    designs = {
        MIXED: mixed_sensitivity(n),
        MIXED_TUNED: mixed_sensitivity(n, *UNITS[MIXED_TUNED]),
        FOUR_BLOCK: four_block(n, *UNITS[FOUR_BLOCK]),
    }
    units = {name: UNITS.get(name, (MINUTE,))[0] for name in designs}
    made = {
        THESIS_LQR: thesis_feedback(n, 200, dt),
        LQR: regulator(n, UNITS[LQR][0], dt, rate=UNITS[LQR][1]),
        LQG: sampled(gaussian(n, *UNITS[LQG]), UNITS[LQG][0], dt),
    }
    made |= {name: sampled(d.controller, units[name], dt) for name, d in designs.items()}
    return {name: padded(K, 12, 6) for name, K in made.items()}, designs


def thesis_feedback(n: float, price: float, dt: float) -> LinearController:
    """The gain of `thesis_regulator` on metres and seconds."""
    gain = thesis_regulator(n, price)[0]
    return state_feedback(np.hstack([gain[:, :3] / MINUTE**2, gain[:, 3:] / MINUTE]), dt)


def nearby(n: float, dt: float) -> tuple[dict[str, LinearController], dict[str, Design]]:
    """What chapters 4 and 5 fly from 1 m, and the designs, as `linear`."""
    designs = {MIXED5: mixed_sensitivity(n, weights=CHAPTER5), MIXED5_CHEAP: mixed_sensitivity(n, weights=CHEAP)}
    made = {LQR4: thesis_feedback(n, 100, dt)}
    made |= {name: sampled(d.controller, MINUTE, dt) for name, d in designs.items()}
    return {name: padded(K, 12, 6) for name, K in made.items()}, designs


def padded(K: LinearController, states: int, inputs: int) -> LinearController:
    """The same controller with states that stay at zero and inputs that are not read."""
    more, unread = states - len(K.A), inputs - K.B.shape[1]
    return LinearController.of(
        StateSpace(
            np.pad(K.A, (0, more)),
            np.pad(K.B, ((0, more), (0, unread))),
            np.pad(K.C, ((0, 0), (0, more))),
            np.pad(K.D, ((0, 0), (0, unread))),
            K.dt,
        )
    )
