"""The optimal level of normalised-coprime-factor stabilisation as one semidefinite program, without bisection.

    minimise s   subject to   diag(Y + s Bb Bb', s I) >= [Ab; Cb] Y [Ab; Cb]',      [ Y  I ]
                              diag(V + s Cb'Cb,  s I) >= [Ab, Bb]' V [Ab, Bb],      [ .  V ] >= 0

with Ab = A - B S^-1 D'C, Bb = B S^-1/2, Cb = R^-1/2 C. These are the Riccati inequalities of P = (Y/s)^-1 and of
Q = (V/s)^-1: they say P >= X and Q >= Z for the stabilising solutions, and the last one that the spectral radius of
P Q is at most s^2. So the least s^2 is that of X Z, and the level sqrt(1 + s^2).

References: Glover and McFarlane (1989), IEEE TAC 34, 821 (the level); Gahinet and Apkarian (1994), Int. J. Robust
and Nonlinear Control 4, 421 (Riccati inequalities as LMIs in the inverses, and their coupling).
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from synth.lmi.solve import solve, staircase, value
from synth.systems.statespace import StateSpace


def optimal_level(G: StateSpace) -> tuple[float, str]:
    """Smallest H-infinity norm of [I; K] (I - G K)^-1 [I, G] over all stabilising K, and the solver's status.

    Parameters
    ----------
    G : discrete, in the coordinates of `coprime.balanced`

    Raises
    ------
    NumericalError : the solver ended without a point that is one.
    """
    n, m, p = G.n, G.nu, G.ny
    if n == 0:
        return 1.0, "nothing reached and seen"
    S, R = np.eye(m) + G.D.T @ G.D, np.eye(p) + G.D @ G.D.T
    A = G.A - G.B @ np.linalg.solve(S, G.D.T @ G.C)
    # B B' and C'C are all that matters, so that a Cholesky factor serves as the root
    B, C = np.linalg.solve(np.linalg.cholesky(S), G.B.T).T, np.linalg.solve(np.linalg.cholesky(R), G.C)
    Y, V = (cp.Variable((n, n), symmetric=True) for _ in range(2))
    s = cp.Variable()
    AC, AB = np.vstack([A, C]), np.hstack([A, B])
    control = staircase([[Y + s * B @ B.T, 0], [s * np.eye(p)]]) - AC @ Y @ AC.T
    filtering = staircase([[V + s * C.T @ C, 0], [s * np.eye(m)]]) - AB.T @ V @ AB
    status = solve(s, [control, filtering, staircase([[Y, np.eye(n)], [V]])])
    return float(np.hypot(1.0, value(s))), status
