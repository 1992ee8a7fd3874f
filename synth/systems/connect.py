"""Systems put together: in series, in feedback, and the linear fractional transformation that closes a plant.

`lft` is the positive one of H-infinity theory (u = K y), `feedback` the negative one.
"""

from __future__ import annotations

import numpy as np

from synth.errors import ModelError
from synth.systems.statespace import StateSpace, is_singular


def common_timebase(G: StateSpace, K: StateSpace) -> float:
    """The timebase two systems share, or a ModelError."""
    if not np.isclose(G.dt, K.dt, rtol=1e-12, atol=0):
        raise ModelError(f"the systems have timebases {G.dt} and {K.dt} s; convert one with c2d first")
    return G.dt


def series(G: StateSpace, H: StateSpace) -> StateSpace:
    """H after G: y = H G u."""
    dt = common_timebase(G, H)
    if G.ny != H.nu:
        raise ModelError(f"the first system has {G.ny} outputs, the second {H.nu} inputs; they must agree")
    A = np.block([[G.A, np.zeros((G.n, H.n))], [H.B @ G.C, H.A]])
    return StateSpace(A, np.vstack([G.B, H.B @ G.D]), np.hstack([H.D @ G.C, H.C]), H.D @ G.D, dt)


def delayed(G: StateSpace) -> StateSpace:
    """A discrete system whose outputs come one sample later."""
    p = G.ny
    return series(G, StateSpace(np.zeros((p, p)), np.eye(p), np.eye(p), np.zeros((p, p)), G.dt))


def feedback(G: StateSpace, K: StateSpace) -> StateSpace:
    """Negative feedback y = G (u - K y)."""
    dt = common_timebase(G, K)
    m, p = G.nu, G.ny
    P = StateSpace(G.A, np.hstack([G.B, G.B]), np.vstack([G.C, G.C]), np.vstack([np.hstack([G.D, G.D])] * 2), dt)
    if (K.nu, K.ny) != (p, m):
        raise ModelError(f"the controller is {K.ny} x {K.nu} where {m} x {p} is needed")
    return lft(P, -K, p, m)


def lft(P: StateSpace, K: StateSpace, nmeas: int, ncon: int) -> StateSpace:
    """Lower linear fractional transformation: P closed by u = K y (positive feedback).

    u and y are the last `ncon` inputs and `nmeas` outputs of P.

    Raises
    ------
    ModelError : dimensions or timebases disagree, or the loop is not well posed (I - D22 Dk is singular).
    """
    dt = common_timebase(P, K)
    if (K.ny, K.nu) != (ncon, nmeas):
        raise ModelError(f"the controller is {K.ny} x {K.nu} where {ncon} x {nmeas} is needed (ncon x nmeas)")
    if not (0 < nmeas < P.ny + 1 and 0 < ncon < P.nu + 1):
        raise ModelError(f"nmeas = {nmeas}, ncon = {ncon} do not fit a plant with {P.ny} outputs and {P.nu} inputs")
    mw, pz = P.nu - ncon, P.ny - nmeas
    B1, B2 = P.B[:, :mw], P.B[:, mw:]
    C1, C2 = P.C[:pz], P.C[pz:]
    D11, D12, D21, D22 = P.D[:pz, :mw], P.D[:pz, mw:], P.D[pz:, :mw], P.D[pz:, mw:]
    E = np.eye(ncon) - K.D @ D22
    if is_singular(E, 1 + np.linalg.norm(K.D @ D22, 2)):
        raise ModelError("the loop is not well posed: I - Dk D22 is singular; perturb D22 or the controller's D")
    # u = E^-1 (Ck xk + Dk C2 x + Dk D21 w), y = C2 x + D21 w + D22 u
    U = np.linalg.solve(E, np.hstack([K.D @ C2, K.C, K.D @ D21]))
    Y = np.hstack([C2, np.zeros((nmeas, K.n)), D21]) + D22 @ U
    x, w = slice(0, P.n + K.n), slice(P.n + K.n, None)
    top = np.hstack([P.A, np.zeros((P.n, K.n)), B1]) + B2 @ U
    bottom = np.hstack([np.zeros((K.n, P.n)), K.A, np.zeros((K.n, mw))]) + K.B @ Y
    out = np.hstack([C1, np.zeros((pz, K.n)), D11]) + D12 @ U
    AB = np.vstack([top, bottom])
    return StateSpace(AB[:, x], AB[:, w], out[:, x], out[:, w], dt)
