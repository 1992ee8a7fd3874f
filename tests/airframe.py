"""Lateral motion of an airframe, after Mackenroth (2004), Robust Control Systems, section 14.1 (p. 430)."""

import numpy as np

from synth import StateSpace, system
from synth.systems.generalized import beside
from synth.systems.statespace import repeated

BLOCKS = [(2, 2), (7, 8)]  # both actuators together; performance


def airframe() -> StateSpace:
    """The generalised plant, (2 + 7 + 2) inputs, (2 + 8 + 5) outputs; angles in degrees, rates in deg/s.

    Inputs: actuators' uncertainty, reference of the roll angle, noise (4), wind beta and p; rudder zeta, aileron xi.
    Outputs: of the uncertainty's weight, errors of phi, beta, p, r, then zeta, xi, their rates; reference, measured
    phi, beta, p, r.
    """
    A = np.array([[-0.0869, 0, 0.039, -1], [-4.424, -1.184, 0, 0.335], [0, 1, 0, 0], [2.148, -0.021, 0, -0.228]])
    wind = np.array([[0.0869, 0], [4.424, 1.184], [0, -1], [-2.148, 0.021]])
    deflected = np.array([[0.0223, 0], [0.547, 2.12], [0, 0], [-1.169, 0.065]])
    craft = StateSpace(A, np.hstack([wind, deflected]), np.eye(4), np.zeros((4, 4)))  # beta, p, phi, r
    actuator = StateSpace([[0, 1], [-1600, -56]], [[0], [1600]], np.eye(2), np.zeros((2, 1)))
    angle, rate = system([1, 1.5], [1.5, 0.015]), system([1, 1.5], [10, 20])
    parts = [
        craft, actuator, actuator, angle, angle, rate, rate, system([2.25], [1, 2.1, 2.25]),
        repeated(system([0.0005 / 0.02, 0.0005], [1, 1]), 4), repeated(system([0.25, 0.05], [0.125, 1]), 2),
    ]  # fmt: skip
    all_ = beside(parts)
    # inputs of the parts: wind (0, 1), zeta, xi (2, 3); command of zeta, xi (4, 5); e_phi, beta, p, r (6-9);
    # reference (10); noise (11-14); uncertainty (15, 16)
    # outputs: beta, p, phi, r (0-3); zeta, its rate, xi, its rate (4-7); errors (8-11); reference (12); noise (13-16);
    # uncertainty (17, 18)
    F = np.zeros((17, 19))  # inputs of the parts from their outputs
    F[2, 4] = F[3, 6] = F[7, 0] = F[8, 1] = F[9, 3] = 1.0
    F[6, 12], F[6, 2] = 1.0, -1.0
    E = np.zeros((17, 11))  # and from w = (d0, d1, reference, n0..n3, wind beta, wind p), u
    E[4, 0] = E[5, 1] = E[10, 2] = E[0, 7] = E[1, 8] = E[4, 9] = E[5, 10] = E[15, 9] = E[16, 10] = 1.0
    E[11:15, 3:7] = np.eye(4)
    H, T = np.zeros((15, 19)), np.zeros((15, 11))  # outputs from those of the parts, and from w, u
    for i, j in enumerate((17, 18, 8, 9, 10, 11)):
        H[i, j] = 1.0
    T[6, 9] = T[7, 10] = 1 / 20
    H[8, 5] = H[9, 7] = 1 / 60
    T[10, 2] = 1.0
    for i, j in enumerate((2, 0, 1, 3)):
        H[11 + i, j] = H[11 + i, 13 + i] = 1.0
    X = np.linalg.inv(np.eye(17) - F @ all_.D)
    A, B = all_.A + all_.B @ X @ F @ all_.C, all_.B @ X @ E
    Y = np.eye(19) + all_.D @ X @ F
    return StateSpace(A, B, H @ Y @ all_.C, H @ all_.D @ X @ E + T)
