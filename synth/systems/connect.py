"""Systems put together: in series, in feedback, and the linear fractional transformation that closes a plant.

`lft` is the positive one of H-infinity theory (u = K y), `feedback` the negative one unless `sign` says otherwise.
All take any description of a system, and uncertain ones (`UncertainSystem`), which stay so.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, overload

import numpy as np

from synth.checks import as_array, as_whole, check_period, shown
from synth.errors import ModelError
from synth.systems import uncertain
from synth.systems.delays import as_late, lagged
from synth.systems.realization import loop_solve
from synth.systems.statespace import StateSpace, as_systems
from synth.systems.uncertain import UncertainSystem


@overload
def series(G: UncertainSystem, H: Any) -> UncertainSystem: ...
@overload
def series(G: Any, H: Any) -> StateSpace: ...
def series(G: Any, H: Any) -> Any:
    """H after G: y = H G u.

    Raises
    ------
    ModelError : sizes or timebases do not fit.
    """
    if isinstance(G, UncertainSystem) or isinstance(H, UncertainSystem):
        return uncertain.series(G, H)
    G, H = as_systems(G=G, H=H)
    if G.ny != H.nu:
        raise ModelError(f"the first system, G, has {G.ny} outputs, the second, H, {H.nu} inputs; they must agree")
    return H * G


def delayed(G: StateSpace) -> StateSpace:
    """A discrete system whose outputs come one sample later."""
    p = G.ny
    return series(G, StateSpace(np.zeros((p, p)), np.eye(p), np.eye(p), np.zeros((p, p)), G.dt))


def input_delay(G: StateSpace, delay: Any) -> StateSpace:
    """A discrete system whose inputs act `delay` s later, a whole number of samples; one number for all, or m of them.

    Raises
    ------
    ModelError : the system is continuous, or a delay is negative or no whole number of samples.
    """
    if not G.discrete:
        raise ModelError(
            f"delay is {shown(delay)} s, which no continuous system of finite order has; sample the plant first "
            "(c2d(G, dt, delay=...), or `sample` in a study file), or put a Pade approximant into it (pade)"
        )
    if np.any(as_array("delay", delay)):
        check_period("the plant", G.dt)
    samples = np.add(*as_late("delay", delay, G.nu, G.dt))
    if not np.allclose(samples, np.round(samples), rtol=0, atol=1e-6):
        raise ModelError(
            f"delay is {shown(delay)} s, {samples.tolist()} samples of {G.dt:g} s; pass whole samples, or sample the "
            "continuous plant with it, which is exact: c2d(G, dt, delay=...)"
        )
    line = lagged(G.nu, range(G.nu), np.round(samples).astype(int).tolist(), G.dt)
    return replace(G * line, u=G.u, units=G.units)


@overload
def feedback(G: UncertainSystem, K: Any = 1, sign: int = -1) -> UncertainSystem: ...
@overload
def feedback(G: Any, K: Any = 1, sign: int = -1) -> StateSpace: ...
def feedback(G: Any, K: Any = 1, sign: int = -1) -> Any:
    """The loop y = G (u + sign K y), negative by default; K = 1 stands for the identity.

    Raises
    ------
    ModelError : sizes or timebases do not fit, the loop is not well posed, `sign` is neither -1 nor 1.
    """
    if isinstance(G, UncertainSystem) or isinstance(K, UncertainSystem):
        return uncertain.feedback(G, K, sign)
    if np.isscalar(K) and not isinstance(K, str | bytes | bool):
        return as_systems(G=G)[0].feedback(K, sign)
    G, K = as_systems(G=G, K=K)
    return G.feedback(K, sign)


@overload
def lft(P: UncertainSystem, K: Any, nmeas: int | None = None, ncon: int | None = None) -> UncertainSystem: ...
@overload
def lft(P: Any, K: Any, nmeas: int | None = None, ncon: int | None = None) -> StateSpace: ...
def lft(P: Any, K: Any, nmeas: int | None = None, ncon: int | None = None) -> Any:
    """Lower linear fractional transformation: P closed by u = K y (positive feedback).

    u and y are the last `ncon` inputs and `nmeas` outputs of P; as many as K has when left out.

    Raises
    ------
    ModelError : dimensions or timebases disagree, or the loop is not well posed (I - D22 Dk is singular).
    """
    if isinstance(P, UncertainSystem) or isinstance(K, UncertainSystem):
        return uncertain.lft(P, K, nmeas, ncon)
    P, K = as_systems(P=P, K=K)
    nmeas = as_whole("nmeas", K.nu if nmeas is None else nmeas, "the number of measurements", least=1)
    ncon = as_whole("ncon", K.ny if ncon is None else ncon, "the number of controls", least=1)
    if (K.ny, K.nu) != (ncon, nmeas):
        raise ModelError(f"the controller K is {K.ny} x {K.nu} where {ncon} x {nmeas} is needed (ncon x nmeas)")
    if not (0 < nmeas < P.ny + 1 and 0 < ncon < P.nu + 1):
        raise ModelError(f"nmeas = {nmeas}, ncon = {ncon} do not fit P with {P.ny} outputs and {P.nu} inputs")
    mw, pz = P.nu - ncon, P.ny - nmeas
    B1, B2 = P.B[:, :mw], P.B[:, mw:]
    C1, C2 = P.C[:pz], P.C[pz:]
    D11, D12, D21, D22 = P.D[:pz, :mw], P.D[:pz, mw:], P.D[pz:, :mw], P.D[pz:, mw:]
    # u = (I - Dk D22)^-1 (Ck xk + Dk C2 x + Dk D21 w), y = C2 x + D21 w + D22 u
    U = loop_solve(K.D @ D22, np.hstack([K.D @ C2, K.C, K.D @ D21]))
    if U is None:
        raise ModelError("the loop is not well posed: I - Dk D22 is singular; perturb D22 or the controller's D")
    Y = np.hstack([C2, np.zeros((nmeas, K.n)), D21]) + D22 @ U
    x, w = slice(0, P.n + K.n), slice(P.n + K.n, None)
    top = np.hstack([P.A, np.zeros((P.n, K.n)), B1]) + B2 @ U
    bottom = np.hstack([np.zeros((K.n, P.n)), K.A, np.zeros((K.n, mw))]) + K.B @ Y
    out = np.hstack([C1, np.zeros((pz, K.n)), D11]) + D12 @ U
    AB = np.vstack([top, bottom])
    units = {name: unit for name, unit in P.units.items() if name in (*P.u[:mw], *P.y[:pz])}
    return StateSpace(AB[:, x], AB[:, w], out[:, x], out[:, w], P.dt, P.u[:mw], P.y[:pz], units)


def check_dynamic(name: str, G: StateSpace) -> None:
    """Raise ModelError for a system without states."""
    if G.n == 0:
        raise ModelError(f"{name} has no states; add the dynamics to be controlled")
