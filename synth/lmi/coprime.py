"""The optimal level of normalised-coprime-factor stabilisation as one semidefinite program, without bisection.

    minimise s   subject to   [ Y  Y Ab'         Y Cb' ]        [ V  V Ab          V Bb ]        [ Y  I ]
                              [ .  Y + s Bb Bb'  0     ] >= 0,  [ .  V + s Cb'Cb   0    ] >= 0,  [ .  V ] >= 0
                              [ .  .             s I   ]        [ .  .             s I  ]

with Ab = A - B S^-1 D'C, Bb = B S^-1/2, Cb = R^-1/2 C. The first says Y/s <= X^-1, the second V/s <= Z^-1 for the
Riccati solutions X and Z, the third Y >= V^-1; together s^2 >= rho(X Z), and the level is sqrt(1 + s^2).

Reference: Glover and McFarlane (1989), IEEE TAC 34, 821, theorem 4.3 (the level); the Riccati inequalities are
those of Gahinet and Apkarian (1994), with s taken out of the products.
"""

from __future__ import annotations

import cvxpy as cp
import numpy as np

from synth.lmi.solve import solve, staircase
from synth.statespace import StateSpace


def optimal_level(G: StateSpace) -> tuple[float, str]:
    """Smallest H-infinity norm of [I; K] (I - G K)^-1 [I, G] over all stabilising K, and the solver's status.

    Parameters
    ----------
    G : discrete, in the coordinates of `coprime.balanced`

    Raises
    ------
    NumericalError : the solver ended without a point.
    """
    n, m, p = G.n, G.nu, G.ny
    if n == 0:
        return 1.0, "no states"
    S, R = np.eye(m) + G.D.T @ G.D, np.eye(p) + G.D @ G.D.T
    A = G.A - G.B @ np.linalg.solve(S, G.D.T @ G.C)
    # B B' and C'C are all that matters, so that a Cholesky factor serves as the root
    B, C = np.linalg.solve(np.linalg.cholesky(S), G.B.T).T, np.linalg.solve(np.linalg.cholesky(R), G.C)
    Y, V = (cp.Variable((n, n), symmetric=True) for _ in range(2))
    s = cp.Variable()
    control = staircase([
        [Y, Y @ A.T,       Y @ C.T],
        [   Y + s * B @ B.T, 0],
        [                  s * np.eye(p)],
    ])  # fmt: skip
    filtering = staircase([
        [V, V @ A,         V @ B],
        [   V + s * C.T @ C, 0],
        [                  s * np.eye(m)],
    ])  # fmt: skip
    status = solve(s, [control, filtering, staircase([[Y, np.eye(n)], [V]])])
    return float(np.sqrt(1 + float(s.value) ** 2)), status
