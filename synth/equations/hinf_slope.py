"""How the lowest H-infinity level changes with the plant, where the coupling of both Riccati equations decides it.

At the optimum rho(X Y) = gamma^2. With X Y v = rho v and a = Y v

    d rho = (a' dX a + rho v' dY v) / (v' a)

and dX solves a Lyapunov equation whose right side is the change of the equation with its feedback F held, since F is
stationary. The adjoint of that equation gives all derivatives at once, for the price of one solution of each.

Reference: Petersen, Anderson and Jonckheere (1991), Int. J. Robust and Nonlinear Control 1 (X and Y by the level).
"""

from __future__ import annotations

import numpy as np

from synth.equations.doubling import CONVERGED, MAX_STEPS, Riccati
from synth.equations.hinf_riccati import Solutions, dual
from synth.systems.generalized import GeneralizedPlant

DECIDES = 0.99  # coupling from which on it is what decides


def slope(P: GeneralizedPlant, at: Solutions) -> np.ndarray | None:
    """Derivative of log(gamma) by [A B1 B2; C1 D11 D12; C2 D21 D22], (n + nz + ny, n + nw + nu), at the optimum.

    P is discrete with D22 = 0; None where something else than the coupling decides.
    """
    if at.X is None or at.Y is None or not DECIDES < at.coupling < 1 / DECIDES:
        return None
    n, nw, nu, nz, ny = P.sizes
    values, vectors = np.linalg.eig(at.X.X @ at.Y.X)
    top = int(np.argmax(np.abs(values)))
    rho, v = float(values[top].real), np.real(vectors[:, top])
    a = at.Y.X @ v
    by_X, level_X = _adjoint(P, at.X, a / np.sqrt(v @ a))
    by_Y, level_Y = _adjoint(dual(P), at.Y, v * np.sqrt(rho / (v @ a)))
    found = np.zeros((n + nz + ny, n + nw + nu))
    found[: n + nz] += by_X
    found[:, : n + nw] += by_Y.T
    return found / (2 * rho + 2 * at.gamma**2 * (level_X + level_Y))


def _adjoint(P: GeneralizedPlant, at: Riccati, b: np.ndarray) -> tuple[np.ndarray, float]:
    """B' X b differentiated by [A B1 B2; C1 D11 D12], and minus that by gamma^2."""
    n, nw, *_ = P.sizes
    IF = np.vstack([np.eye(n), at.F])
    A = np.hstack([P.A, P.B1, P.B2]) @ IF
    C = np.hstack([P.C1, P.D11, P.D12]) @ IF
    W = _sum(A, np.outer(b, b))
    Fw = at.F[:nw]
    return 2 * np.vstack([at.X @ A, C]) @ W @ IF.T, float(np.trace(Fw @ W @ Fw.T))


def _sum(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Q + A Q A' + A^2 Q A'^2 + ... of a stable A."""
    for _ in range(MAX_STEPS):
        Q, A = Q + A @ Q @ A.T, A @ A
        if np.linalg.norm(A) < CONVERGED:
            break
    return Q
