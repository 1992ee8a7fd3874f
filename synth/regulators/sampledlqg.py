"""LQG for a continuous plant and a sampling processor: `kalmd` and `lqgd`, cost and noise sampled exactly.

    dx = A x + B u + w,  y = C x + D u + v   with white noise of intensities W and V, and u held for dt

    process noise       integral of e^(A t) W e^(A't) over a period
    measurement noise   V / dt: a sample is the mean of v over a period, of the states it is one instant
    cost                `sampled_cost`: what x'Q x + u'R u + 2 x'N u comes to between the samples

References: Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, chapter 9; Astrom and Wittenmark
(1997), Computer-Controlled Systems, chapter 11; Van Loan (1978), IEEE TAC 23, 395.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_array, as_cost, as_flag, as_period
from synth.errors import AssumptionError, ModelError
from synth.regulators.regulator import cost_of_a_period, dlqr, regulated
from synth.systems.connect import check_dynamic
from synth.systems.realization import Matrices, state_scales
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system


class Estimator(NamedTuple):
    """A discrete Kalman filter, which unpacks as MATLAB's [kest, L, P, M, Z]."""

    system: StateSpace  # (p + n x m + p) from u and y to the estimates of y and x, with the present measurement
    L: np.ndarray  # (n, p) gain of x[k+1|k] = F x[k|k-1] + G u + L (y - C x[k|k-1] - D u)
    P: np.ndarray  # (n, n) covariance of the error of x[k|k-1]
    M: np.ndarray  # (n, p) gain of x[k|k] = x[k|k-1] + M (y - C x[k|k-1] - D u)
    Z: np.ndarray  # (n, n) covariance of the error of x[k|k]


def kalmd(sys: Any, Qn: Any, Rn: Any, dt: Any) -> Estimator:
    """Discrete Kalman filter of a continuous plant dx = A x + B u + G w, y = C x + D u + v, noises sampled exactly.

    Parameters
    ----------
    sys : continuous plant with inputs u and then w, in any form that `system` takes; as many are w as Qn has rows
    Qn : (q, q) intensity of w, symmetric positive semidefinite; a number for one w, a list for independent ones
    Rn : (p, p) intensity of v, symmetric positive definite, likewise; a sample has the variance Rn / dt, so that a
        sensor whose samples have the variance r has Rn = r dt
    dt : () s, sampling period, u being held

    Returns
    -------
    Estimator : unpacks as system, L, P, M, Z

    Raises
    ------
    ModelError : sys is discrete, w acts on y directly, Qn has more rows than sys inputs, Rn is not positive definite.
    AssumptionError, NumericalError : as `lqr`, for the dual of the sampled plant.

    Reference: MATLAB Control System Toolbox, kalmd (the convention); Franklin, Powell and Workman (1998), section 9.4.
    """
    G, dt = _continuous("sys", sys), as_period(dt)
    given = as_array("Qn", Qn, "pass the intensity of the noise inputs, a number, a list or a matrix")
    q = 1 if given.ndim == 0 else len(given)
    if not 1 <= q <= G.nu:
        raise ModelError(
            f"Qn has {q} rows and sys {G.nu} inputs, of which the noise is the last ones; pass 1 to {G.nu}"
        )
    m = G.nu - q
    if G.D[:, m:].any():
        raise ModelError(
            "sys has a direct term from w to y, whose samples would have no finite variance; give Rn what it adds, or "
            "pass w through a lag"
        )
    E = G.B[:, m:]
    W, V = E @ as_cost("Qn", given, q) @ E.T, as_cost("Rn", Rn, G.ny, definite=True)
    F, B, C, D = c2d(StateSpace(G.A, G.B[:, :m], G.C, G.D[:, :m], 0.0), dt).matrices
    L, P, M, Z = _filter(F, C, _noise(G.A, W, dt), V / dt)
    I, O = np.eye(G.n), np.eye(G.ny)
    CM = C @ M
    system = StateSpace(
        F - L @ C,
        np.hstack([B - L @ D, L]),
        np.vstack([(O - CM) @ C, I - M @ C]),
        np.block([[(O - CM) @ D, CM], [-M @ D, M]]),
        dt,
    )
    return Estimator(system, L, P, M, Z)


def lqgd(G: Any, QXU: Any, QWV: Any, dt: Any, *, current: bool = False) -> StateSpace:
    """Discrete controller u = K y (positive feedback) of least expected cost of a continuous plant, u being held.

    The cost is the mean of [x; u]' QXU [x; u] over all time, not over the samples.

    Parameters
    ----------
    G : (p x m) continuous plant, in any form that `system` takes
    QXU : (n + m, n + m) weight of [x; u], symmetric positive semidefinite, its lower right block positive definite
    QWV : (n + p, n + p) intensity of [w; v], likewise, without a block between w and v
    dt : () s, sampling period
    current : whether u may depend on the present measurement, which costs less and needs a fast processor

    Returns
    -------
    StateSpace : (m x p), discrete, of the order of G

    Raises
    ------
    ModelError, AssumptionError, NumericalError : as `lqg`, for the sampled plant; `current` with a direct term D.

    Reference: Astrom and Wittenmark (1997), Computer-Controlled Systems, section 11.4.
    """
    G, dt = _continuous("G", G), as_period(dt)
    n, m, p = G.n, G.nu, G.ny
    W, V = as_cost("QXU", QXU, n + m), as_cost("QWV", QWV, n + p)
    as_cost("the block of u in QXU", W[n:, n:], m, definite=True)
    as_cost("the block of v in QWV", V[n:, n:], p, definite=True)
    if V[:n, n:].any():
        raise ModelError("QWV has a block between w and v, which has no meaning for samples; pass zeros there")
    if as_flag("current", current) and G.D.any():
        raise ModelError("current is True and G has a direct term D: u would depend on itself; pass current=False")
    scales = state_scales(Matrices(G.A, G.B, G.C, G.D))
    A, B, C = G.A * scales / scales[:, None], G.B / scales[:, None], G.C * scales
    cost = cost_of_a_period(A, B, scales[:, None] * W[:n, :n] * scales, W[n:, n:], scales[:, None] * W[:n, n:], dt)
    K = regulated(cost)[0]
    L, _, M, _ = _filter(cost.F, C, _noise(A, V[:n, :n] / scales / scales[:, None], dt), V[n:, n:] / dt)
    F, E = cost.F, cost.G
    if current:
        seen = np.eye(n) - M @ C
        A, B, C, D = (F - E @ K) @ seen, (F - E @ K) @ M, -K @ seen, -K @ M
    else:
        A, B, C, D = F - E @ K - L @ (C - G.D @ K), L, -K, np.zeros((m, p))
    return StateSpace(A * scales[:, None] / scales, B * scales[:, None], C / scales, D, dt)


def _continuous(name: str, value: Any) -> StateSpace:
    """A continuous plant with states."""
    G = as_system(name, value)
    if G.discrete:
        raise ModelError(f"{name} is discrete already; pass the continuous plant, or call dlqr and lqg")
    check_dynamic(name, G)
    return G


def _noise(A: np.ndarray, W: np.ndarray, dt: float) -> np.ndarray:
    """Covariance that white noise of intensity W adds to the state in a period, (n, n)."""
    n = len(A)
    scales = state_scales(Matrices(A, np.diag(np.sqrt(np.diag(W))), np.zeros((1, n)), np.zeros((1, n))))
    A, W = A * scales / scales[:, None], W / scales / scales[:, None]
    none = np.zeros((n, 0))
    found = cost_of_a_period(A.T, none, W, np.zeros((0, 0)), none, dt).Q
    return scales[:, None] * (found + found.T) / 2 * scales


def _filter(F: np.ndarray, C: np.ndarray, W: np.ndarray, V: np.ndarray) -> tuple[np.ndarray, ...]:
    """L, P, M, Z of the stationary discrete filter."""
    try:
        K, P, _ = dlqr(F.T, C.T, W, V)
    except AssumptionError as error:
        told = f"of the filter, for which read sensor for actuator, noise for weight and estimate for control: {error}"
        raise AssumptionError(error.assumption, told, error.modes) from None
    M = np.linalg.solve(V + C @ P @ C.T, C @ P).T
    Z = P - M @ C @ P
    return K.T, P, M, (Z + Z.T) / 2
