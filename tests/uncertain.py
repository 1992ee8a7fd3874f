"""Uncertain loops of the literature and random ones, by the names of tests."""

from __future__ import annotations

import numpy as np
from literature import cubesat_pecorilla2024

from synth import UncertainSystem, series, system, ureal

BANDWIDTH, DAMPING, ROLLOFF = 0.1, 0.7, 10.0  # of the satellite's controller, rad/s and ratios


def flexible_satellite(percentage: float, modes: int = 2, channels: int = 1, damping: float = 0.005) -> UncertainSystem:
    """The reference plant of the method: one axis, a hub with flexible panels, PD control with roll-off; 4 + 2 modes.

    Hub inertia and cantilever frequencies are uncertain. From torque (and noise of the angle) to the torque at the
    hub and the angle times the controller's gain.
    """
    inertia, couplings, frequencies = 500.0, (14.0, 6.0, 3.0), (1.2, 5.0, 11.0)  # kg m^2, sqrt(kg) m, rad/s
    J = ureal("J", inertia, percentage=percentage)
    w = [ureal(f"w{k + 1}", frequencies[k], percentage=percentage) for k in range(modes)]
    kp, kd = inertia * BANDWIDTH**2, 2 * DAMPING * inertia * BANDWIDTH
    q = 1 + modes
    n = 2 * q + 2
    E, A = np.eye(n).astype(object), np.zeros((n, n), object)
    B, C, D = np.zeros((n, channels)), np.zeros((2, n)), np.zeros((2, channels))
    A[:q, q : 2 * q] = np.eye(q)
    E[q, q] = J
    for k in range(modes):
        E[q, q + 1 + k] = E[q + 1 + k, q] = couplings[k]
        A[q + 1 + k, 1 + k], A[q + 1 + k, q + 1 + k] = -(w[k] ** 2), -2 * damping * w[k]
    x, v = 2 * q, 2 * q + 1  # the controller's
    A[q, [x, v]] = -kp, -kd
    A[x, v] = 1.0
    A[v, [x, v, 0]] = -(ROLLOFF**2), -1.4 * ROLLOFF, ROLLOFF**2
    B[q, 0], D[0, 0] = 1.0, 1.0
    C[0, [x, v]], C[1, 0] = (-kp, -kd), kp
    if channels == 2:
        B[v, 1] = 0.01 * ROLLOFF**2
    return UncertainSystem(E, A, B, C, D)


def de_gaston_safonov() -> UncertainSystem:
    """800 (1 + .1 d1) (s + 2) / (s (s + 4 + .2 d2) (s + 6 + .3 d3) (s + 10)), unity feedback.

    De Gaston and Safonov (1988), IEEE TAC 33, 156; published margin 3.4174.
    """
    d1, d2, d3 = (ureal(f"d{k}", 0.0, plusminus=1.0) for k in (1, 2, 3))
    A = [[0, 1, 0, 0], [0, -4 - d2 / 5, 1, 0], [0, 0, -6 - 3 * d3 / 10, 1], [0, 0, 0, -10]]
    return UncertainSystem(A=A, B=[0, 0, 0, 800 * (1 + d1 / 10)], C=[2, 1, 0, 0]).feedback(1)


def two_masses() -> UncertainSystem:
    """Two masses and a spring of 1 +- 20 %, C = 100 ((s + 1)/(0.001 s + 1))^3, from reference to position.

    Documentation of MATLAB's Robust Control Toolbox, "Robustness of servo controller": margin 2.8826 .. 2.8864.
    """
    m1, m2, k = (ureal(name, 1.0, percentage=20) for name in ("m1", "m2", "k"))
    E = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, m1, 0], [0, 0, 0, m2]]
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-k, k, 0, 0], [k, -k, 0, 0]]
    lead = system([1, 1], [0.001, 1])
    return series(100 * lead * lead * lead, UncertainSystem(E, A, [0, 0, 1, 0], [0, 1, 0, 0])).feedback(1)


def cubesat(percentage: float) -> UncertainSystem:
    """The sampled CubeSat of `literature`, 15 + 3 inputs and 9 + 6 outputs, with an uncertain inertia about every axis.

    The hold of a rigid body is exact: what torques do in a period is divided by the inertia, and so are the small
    torques of the orbit, which stay those of the nominal body.
    """
    P = cubesat_pecorilla2024()
    moments = (0.0546, 0.0546, 0.0074)  # kg m^2
    E, A = np.eye(6).astype(object), P.A.astype(object)
    for k, (axis, moment) in enumerate(zip("xyz", moments, strict=True)):
        ratio = ureal(f"I{axis}", moment, percentage=percentage) * (1 / moment)
        E[k, k] = E[3 + k, 3 + k] = ratio
        A[k] = A[k] * ratio
        A[3 + k, 3 + k] = A[3 + k, 3 + k] + (ratio - 1)
    D = np.block([[P.D11, P.D12], [P.D21, P.D22]])
    return UncertainSystem(E, A, np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2]), D, P.dt)


def random_loop(seed: int) -> UncertainSystem:
    """One to three parameters in any matrix, two to four states, continuous or discrete, nominally stable."""
    rng = np.random.default_rng(seed)
    dt = float(rng.choice([0.0, 0.5]))
    n, p, m, q = (int(rng.integers(low, high)) for low, high in ((2, 5), (1, 4), (1, 3), (1, 3)))
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    if dt:
        A = A / np.abs(poles).max() * rng.uniform(0.6, 0.98)
    else:
        A = A - (poles.real.max() + rng.uniform(0.02, 0.22)) * np.eye(n)
    E, A, D = np.eye(n).astype(object), A.astype(object), (rng.normal(size=(q, m)) * rng.integers(0, 2)).astype(object)
    B = rng.normal(size=(n, m)).astype(object)
    for k in range(p):
        nominal = float(rng.normal())
        d = ureal(f"p{k}", nominal, plusminus=(-float(rng.uniform(0.02, 0.3)), float(rng.uniform(0.02, 0.3)))) - nominal
        i, j = rng.integers(n, size=2)
        A[i, j] = A[i, j] + d * float(rng.normal())
        if rng.random() < 0.4:
            i, j = rng.integers(n, size=2)
            A[i, j] = A[i, j] + d * d
        if rng.random() < 0.4:
            i = rng.integers(n)
            E[i, i] = E[i, i] + d / 2
        if rng.random() < 0.3:
            D[0, 0] = D[0, 0] + d * 0.3
        if rng.random() < 0.3:
            B[0, 0] = B[0, 0] * (1 + d)
    return UncertainSystem(E, A, B, rng.normal(size=(q, n)), D, dt)
