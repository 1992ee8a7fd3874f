"""Bring a generalised plant to coordinates in which its best H-infinity level is about one, and come back.

The level of a controller does not depend on the units of states, actuators, sensors, disturbances and regulated
outputs, but the arithmetic does: solvers work to absolute tolerances, and a level of 4e-6 with torques in Nm drowns
in them. Five steps: drop D22 (loop shift), balance by powers of two, solve two slightly regularised Riccati
equations (LQR and Kalman), scale u and y by their innovations, balance the state between the two solutions, and
set the level of that LQG loop to one.

References: Osborne (1960), J. ACM 7; Jonckheere and Silverman (1983), IEEE TAC 28, LQG balancing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.equations.doubling import regularised_lqr
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.modes import is_lost, unreachable
from synth.systems.statespace import StateSpace

FLOOR = 1e-8  # relative, on the singular values of the state transform
ILL_POSED = 1e-12  # relative distance of I + Dk D22 to singular
SWEEPS = 50  # of the power-of-two balancing; about five are used


@dataclass(frozen=True, kw_only=True)
class Conditioned:
    """A plant in good coordinates and the way back.

    x = T x_scaled, u = Su u_scaled, y_scaled = Sy (y - D22 u), gamma = scale * gamma_scaled.
    """

    plant: GeneralizedPlant  # scaled, D22 = 0
    scale: float  # gamma of the original plant over gamma of `plant`
    T: np.ndarray  # (n, n) state transform
    Su: np.ndarray  # (nu, nu) actuator scaling
    Sy: np.ndarray  # (ny, ny) sensor scaling
    D22: np.ndarray  # (ny, nu) of the original plant
    w: float  # factor on the gains from w; on those to z it is 1 / (scale w)

    def slope(self, found: np.ndarray) -> np.ndarray:
        """A derivative by [A B1 B2; C1 D11 D12; C2 D21 D22] of the original plant, from one by that of the scaled."""
        _, nw, _, nz, _ = self.plant.sizes
        left = sla.block_diag(np.linalg.inv(self.T), np.eye(nz) / (self.scale * self.w), self.Sy)
        right = sla.block_diag(self.T, np.eye(nw) * self.w, self.Su)
        return np.asarray(left).T @ found @ np.asarray(right).T

    def restore(self, K: StateSpace) -> StateSpace:
        """The controller for the original u and y, from one for the scaled plant.

        Raises
        ------
        NumericalError : the loop through D22 is not well posed (I + Dk D22 is singular).
        """
        B, C, D = K.B @ self.Sy, self.Su @ K.C, self.Su @ K.D @ self.Sy
        E = np.eye(len(D)) + D @ self.D22
        loop = K.D @ self.Sy @ self.D22 @ self.Su  # in the scaled units: those given may make any loop look singular
        distance = np.linalg.norm(np.eye(len(D)) + loop, -2) / (1 + np.linalg.norm(loop, 2))
        if distance < ILL_POSED:
            raise NumericalError(
                "the controller's direct term and D22 form an algebraic loop without a solution (I + Dk D22 is within "
                f"{distance:.1e} of singular); model the delay of the loop or ask for a larger gamma"
            )
        CE, DE = np.linalg.solve(E, C), np.linalg.solve(E, D)
        return StateSpace(K.A - B @ self.D22 @ CE, B - B @ self.D22 @ DE, CE, DE, K.dt)

    def entered(self, K: StateSpace) -> StateSpace:
        """The controller for the scaled plant, from one for the original u and y: the inverse of `restore`.

        Raises
        ------
        NumericalError : the loop through D22 is not well posed.
        """
        E = np.eye(len(K.D)) - K.D @ self.D22
        if not np.linalg.cond(E) < 1 / ILL_POSED:
            raise NumericalError("the controller's direct term and D22 form an algebraic loop without a solution")
        C, D = np.linalg.solve(E, K.C), np.linalg.solve(E, K.D)
        A, B = K.A + K.B @ self.D22 @ C, K.B + K.B @ self.D22 @ D
        Su, Sy = np.linalg.inv(self.Su), np.linalg.inv(self.Sy)
        return StateSpace(A, B @ Sy, Su @ C, Su @ D @ Sy, K.dt)

    def of(self, P: GeneralizedPlant) -> Conditioned:
        """Another plant with the same states and signals in these coordinates, such as the one that was mapped."""
        coordinates = _Coordinates(self.T, np.linalg.inv(self.T), self.Su, self.Sy, self.w, 1 / (self.scale * self.w))
        return replace(self, plant=_transformed(P, coordinates), D22=P.D22)


def check_assumptions(P: GeneralizedPlant) -> None:
    """Raise unless some controller stabilises the plant; continuous and discrete plants alike.

    The test of Popov, Belevitch and Hautus at every mode that is not asymptotically stable, on the invariant
    subspace of those modes of the balanced plant. Only rank lost to rounding counts as lost.

    Raises
    ------
    AssumptionError : (A, B2) is not stabilisable or (C2, A) not detectable; names the modes.
    """
    if P.A.shape[0] == 0:
        return
    S = _transformed(P, _balance(P))
    for assumption, balanced, given, what, remedy in (
        ("(A, B2) stabilisable", (S.A, S.B2), (P.A, P.B2), "no actuator moves", "add an actuator that reaches it"),
        ("(C2, A) detectable", (S.A.T, S.C2.T), (P.A.T, P.C2.T), "no sensor sees", "add a sensor that sees it"),
    ):
        modes = unreachable(*balanced, discrete=P.dt > 0)
        if modes and any(is_lost(*given, m) for m in modes):  # scaling may have lost what the coordinates given have
            listed = ", ".join(f"{m.real:.6g}" if m.imag == 0 else f"{m:.6g}" for m in modes)
            raise AssumptionError(
                assumption,
                f"no controller can stabilise this plant: {what} the mode at eigenvalue {listed} of A, which is not "
                f"asymptotically stable; {remedy}, or take the mode out of the model",
                modes,
            )


def precondition(P: GeneralizedPlant) -> Conditioned:
    """Scale a discrete plant so that its best H-infinity level is about one; see the file header.

    Multiplying the weights on w or z by a number changes `scale` only. D12 or D21 may be zero or lose rank.

    Raises
    ------
    ModelError : the plant is continuous (map it by `cayley` first).
    AssumptionError : no controller can stabilise the plant.
    NumericalError : no stabilising gain was found although the assumptions hold (nearly) to rounding.
    """
    if P.dt == 0:
        raise ModelError("the plant is continuous (dt = 0); map it to discrete time with cayley before conditioning")
    check_assumptions(P)
    return conditioned(P)


def conditioned(P: GeneralizedPlant) -> Conditioned:
    """`precondition` of a discrete plant whose assumptions were checked."""
    first = _balance(P)
    S = _transformed(P, first)
    lqr = regularised_lqr(S.A, S.B2, S.C1, S.D12, "(A, B2) stabilisable")
    kalman = regularised_lqr(S.A.T, S.C2.T, S.B1.T, S.D21.T, "(C2, A) detectable")
    T, Ti = _lqg_balancing(lqr.X, kalman.X)
    second = _Coordinates(T, Ti, _inverse_root(lqr.R), _inverse_root(kalman.R), 1.0, 1.0)
    S = _transformed(S, second)
    F, L = np.linalg.solve(second.Su, lqr.F @ T), np.linalg.solve(second.Sy, kalman.F @ Ti.T).T

    lqg = StateSpace(S.A + S.B2 @ F + L @ S.C2, -L, F, np.zeros_like(S.D22.T), P.dt)
    level = _peak(S.close(lqg)) or 1.0  # zero when nothing regulated can be disturbed
    # w and z each by level^-1/2; u and y follow so that the innovations stay of size one
    r, I = np.sqrt(level), np.eye
    third = _Coordinates(I(len(T)), I(len(T)), r * I(len(F)), r * I(len(S.C2)), 1 / r, 1 / r)
    return Conditioned(
        plant=_transformed(S, third), scale=level / (first.w * first.z), T=first.T @ T,
        Su=first.Su @ second.Su * r, Sy=r * second.Sy @ first.Sy, D22=P.D22, w=first.w / r,
    )  # fmt: skip


def balanced(P: GeneralizedPlant) -> Conditioned:
    """A plant, continuous or discrete, in units that are powers of two, so that the way back is exact; without D22."""
    c = _balance(P)
    return Conditioned(plant=_transformed(P, c), scale=1 / (c.w * c.z), T=c.T, Su=c.Su, Sy=c.Sy, D22=P.D22, w=c.w)


class _Coordinates(NamedTuple):
    """x = T x_new, u = Su u_new, y_new = Sy y; w and z are plain factors on the gains from w and to z."""

    T: np.ndarray
    Ti: np.ndarray  # inverse of T
    Su: np.ndarray
    Sy: np.ndarray
    w: float
    z: float


def _transformed(P: GeneralizedPlant, c: _Coordinates) -> GeneralizedPlant:
    """The plant in new coordinates, without D22."""
    return replace(
        P, A=c.Ti @ P.A @ c.T, B1=c.Ti @ P.B1 * c.w, B2=c.Ti @ P.B2 @ c.Su,
        C1=c.z * P.C1 @ c.T, D11=c.z * c.w * P.D11, D12=c.z * P.D12 @ c.Su,
        C2=c.Sy @ P.C2 @ c.T, D21=c.Sy @ P.D21 * c.w, D22=np.zeros_like(P.D22),
    )  # fmt: skip


@lru_cache(maxsize=8)
def _balance(P: GeneralizedPlant) -> _Coordinates:
    """Powers of two for every state, actuator and sensor, one number for w and one for z (Osborne)."""
    n, _, nu, _, ny = P.sizes
    x, u, y = np.ones(n), np.ones(nu), np.ones(ny)
    A = np.abs(P.A) - np.diag(np.abs(np.diag(P.A)))
    w = z = 1.0
    for _ in range(SWEEPS):
        w = _reciprocal(_stack(P.B1 / x[:, None], P.D11, P.D21 * y[:, None]))
        z = _reciprocal(_stack(P.C1 * x, P.D11 * w, P.D12 * u))
        du = _power_of_two([_reciprocal(_stack(P.B2[:, j] / x, z * P.D12[:, j])) / u[j] for j in range(nu)])
        dy = _power_of_two([_reciprocal(_stack(P.C2[i] * x, w * P.D21[i])) / y[i] for i in range(ny)])
        u, y, before = u * du, y * dy, x.copy()
        for i in range(n):
            row = _stack(A[i] * x, w * P.B1[i], P.B2[i] * u) / x[i]
            column = _stack(A[:, i] / x, z * P.C1[:, i], P.C2[:, i] * y) * x[i]
            if row > 0 and column > 0:
                x[i] *= _power_of_two(np.sqrt(row / column))
        if np.all(du == 1) and np.all(dy == 1) and np.all(x == before):
            break
    return _Coordinates(np.diag(x), np.diag(1 / x), np.diag(u), np.diag(y), w, z)


def _stack(*parts: np.ndarray) -> float:
    """Euclidean norm of all entries together."""
    return float(np.sqrt(sum(np.sum(p**2) for p in parts)))


def _reciprocal(size: float) -> float:
    """1 / size, or 1 for a signal without gain."""
    return 1 / size if size > 0 else 1.0


def _power_of_two(x):
    """The nearest powers of two."""
    return np.exp2(np.round(np.log2(x)))


def _inverse_root(M: np.ndarray) -> np.ndarray:
    """M^-1/2 of a positive definite matrix."""
    e, V = np.linalg.eigh(M)
    return (V / np.sqrt(np.maximum(e, FLOOR**2 * e[-1]))) @ V.T


def _lqg_balancing(X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T and its inverse with T'X T = T^-1 Y T^-T diagonal, as far as the floor allows."""
    Lx, Ly = _factor(X), _factor(Y)
    _, s, Vt = np.linalg.svd(Lx.T @ Ly)
    root = np.sqrt(np.maximum(s, FLOOR * s.max(initial=0.0)))
    T, Ti = Ly @ Vt.T / root, root[:, None] * (Vt @ np.linalg.inv(Ly))
    sign = np.sign(T[np.abs(T).argmax(axis=0), range(len(T))])  # the same for the same plant
    return T * sign, sign[:, None] * Ti


def _factor(M: np.ndarray) -> np.ndarray:
    """L with L L' = M up to the floor, invertible."""
    e, V = np.linalg.eigh(M)
    return V * np.sqrt(np.maximum(e, FLOOR**2 * e[-1:]))


def _peak(G: StateSpace) -> float:
    """Rough H-infinity norm: the largest gain at 0, Nyquist and the angles of the least damped poles."""
    poles = G.poles()
    angles = np.concatenate([[0.0, np.pi], np.angle(poles[np.argsort(-np.abs(poles))[:12]])])
    circle = np.exp(1j * np.abs(angles))[:, None, None] * np.eye(G.n)
    return float(np.linalg.norm(G.C @ np.linalg.solve(circle - G.A, G.B[None]) + G.D, 2, axis=(1, 2)).max())
