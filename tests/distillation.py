"""The distillation column of Skogestad and Postlethwaite (2005), Multivariable Feedback Control, section 8.11.3."""

import numpy as np

from synth import StateSpace, series, system
from synth.systems.statespace import repeated

BLOCKS = [(1, 1), (1, 1), (2, 2)]  # input uncertainty of every channel, performance
SLOW = 1e-6  # rad/min: the integrator of the weight, 1e-2 of it that of the controller


def distillation() -> tuple[StateSpace, StateSpace]:
    """The generalised plant, (2 + 2 + 2) x (2 + 2 + 2), and K = 0.7/s G^-1; time in minutes.

    G = 1/(75 s + 1) [87.8, -86.4; 108.2, -109.6], wI = (s + 0.2)/(0.5 s + 1), wP = (s/2 + 0.05)/s, y = -(G u + d).
    """
    gain, I, O = np.array([[87.8, -86.4], [108.2, -109.6]]), np.eye(2), np.zeros((2, 2))
    G = series(repeated(system([1], [75, 1]), 2), StateSpace.gain(gain, 0.0))
    Wp, Wi = (repeated(system(*W), 2) for W in (([0.5, 0.05], [1, SLOW]), ([1, 0.2], [0.5, 1])))
    A = np.block([[Wi.A, O, O], [O, G.A, O], [O, Wp.B @ G.C, Wp.A]])
    B = np.block([[O, O, Wi.B], [G.B, O, G.B], [O, Wp.B, O]])
    C = np.block([[Wi.C, O, O], [O, Wp.D @ G.C, Wp.C], [O, -G.C, O]])
    D = np.block([[O, O, Wi.D], [O, Wp.D, O], [O, -I, O]])
    K = series(repeated(system([75, 1], [1, 1e-2 * SLOW]), 2), StateSpace.gain(0.7 * np.linalg.inv(gain), 0.0))
    return StateSpace(A, B, C, D), K
