"""The blocks of a closed loop as functions of the unknowns.

A specification (`hinf.py`) is written once on a `Loop`; the fillings differ only in how the blocks depend on the
unknowns. Output feedback, with the change of variables of de Oliveira, Geromel and Bernussou (2002):

    G = [[H, S0], [I, G0]],  S0 = H G0 + V U
    extended characterisation (seed equation 16): P free, S0 free
    standard characterisation (seed equation 20): P = G = [[X1, I], [I, Y1]], that is H = X1, G0 = Y1, S0 = I

Seed equations: Pecorilla and Stesina (2024), doi 10.1002/rnc.7119, with these corrections: block (4,4) of (16) is
G + G' - Y1, its block (4,6) G' C1' + Cn' D12'; (18) factorises S - H G and has -H B2; in (20) and (21) the letters
Ad1 to Dd1 stand for the unknowns An to Dn. The unknowns J and S of (16) are here blocks of P and G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cvxpy as cp
import numpy as np

from synth.errors import NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace


@dataclass(frozen=True)
class Loop:
    """x+ = A x + B w, z = C x + D w in products with a multiplier G; S = G + G' - P."""

    P: Any  # (N, N) symmetric, Lyapunov matrix
    G: Any  # (N, N) multiplier, P itself in the standard characterisation
    AG: Any  # (N, N) A G
    B: Any  # (N, nw)
    CG: Any  # (nz, N) C G
    D: Any  # (nz, nw)

    @property
    def S(self) -> Any:
        """G + G' - P, (N, N)."""
        return self.G + self.G.T - self.P

    def channel(self, z: Sequence[int], w: Sequence[int]) -> Loop:
        """The loop from some w to some z, by their numbers."""
        return replace(self, B=self.B[:, w], CG=self.CG[z, :], D=self.D[z, :][:, w])


@dataclass(frozen=True)
class OutputFeedback:
    """A dynamic output-feedback controller of the plant's order as unknowns."""

    plant: GeneralizedPlant
    P: Any  # (2n, 2n) symmetric
    H: Any  # (n, n)
    G0: Any  # (n, n)
    S0: Any  # (n, n)
    An: Any  # (n, n)
    Bn: Any  # (n, ny)
    Cn: Any  # (nu, n)
    Dn: Any  # (nu, ny)

    @property
    def loop(self) -> Loop:
        """The closed loop after the congruence that makes it affine in the unknowns."""
        p, H, G0 = self.plant, self.H, self.G0
        A, B1, B2, C1, C2 = p.A, p.B1, p.B2, p.C1, p.C2
        D11, D12, D21 = p.D11, p.D12, p.D21
        An, Bn, Cn, Dn = self.An, self.Bn, self.Cn, self.Dn
        return Loop(
            P=self.P,
            G=cp.bmat([[H, self.S0], [np.eye(len(A)), G0]]),
            AG=cp.bmat([[H @ A + Bn @ C2, An], [A + B2 @ Dn @ C2, A @ G0 + B2 @ Cn]]),
            B=cp.vstack([H @ B1 + Bn @ D21, B1 + B2 @ Dn @ D21]),
            CG=cp.hstack([C1 + D12 @ Dn @ C2, C1 @ G0 + D12 @ Cn]),
            D=D11 + D12 @ Dn @ D21,
        )

    def controller(self) -> StateSpace:
        """The controller at the solution of the unknowns."""
        unknowns = (self.H, self.G0, self.S0, self.An, self.Bn, self.Cn, self.Dn)
        H, G0, S0, An, Bn, Cn, Dn = (np.asarray(getattr(v, "value", v)) for v in unknowns)
        return recover(self.plant, H, G0, S0, np.block([[An, Bn], [Cn, Dn]]))


def _unknowns(plant: GeneralizedPlant) -> dict[str, cp.Variable]:
    n, _, nu, _, ny = plant.sizes
    shapes = {"An": (n, n), "Bn": (n, ny), "Cn": (nu, n), "Dn": (nu, ny)}
    return {name: cp.Variable(shape) for name, shape in shapes.items()}


def extended(plant: GeneralizedPlant) -> OutputFeedback:
    """Filling of seed equation (16): the multiplier is free."""
    n = plant.sizes[0]
    H, G0, S0 = (cp.Variable((n, n)) for _ in range(3))
    return OutputFeedback(plant, cp.Variable((2 * n, 2 * n), symmetric=True), H, G0, S0, **_unknowns(plant))


def standard(plant: GeneralizedPlant) -> OutputFeedback:
    """Filling of seed equation (20): the multiplier is the Lyapunov matrix."""
    n = plant.sizes[0]
    I = np.eye(n)
    X1, Y1 = (cp.Variable((n, n), symmetric=True) for _ in range(2))
    return OutputFeedback(plant, cp.bmat([[X1, I], [I, Y1]]), X1, Y1, I, **_unknowns(plant))


def recover(plant: GeneralizedPlant, H, G, S, theta: np.ndarray) -> StateSpace:
    """The controller from the unknowns: seed equation (18), with V U = S - H G split by its SVD.

    Parameters
    ----------
    H, G, S : (n, n)
    theta : (n + nu, n + ny), [[An, Bn], [Cn, Dn]]

    Raises
    ------
    NumericalError : S - H G is singular to working precision.
    """
    n, _, nu, _, ny = plant.sizes
    A, B2, C2 = plant.A, plant.B2, plant.C2
    left, sigma, right = np.linalg.svd(S - H @ G)
    if n and sigma[-1] <= np.finfo(float).eps * sigma[0]:
        raise NumericalError(f"S - H G is singular (condition {sigma[0] / max(sigma[-1], 1e-300):.1e}): no controller")
    V, U = left * np.sqrt(sigma), np.sqrt(sigma)[:, None] * right
    Vi, Ui = np.linalg.inv(V), np.linalg.inv(U)
    shifted = theta.copy()
    shifted[:n, :n] -= H @ A @ G
    K = (
        np.block([[Vi, -Vi @ H @ B2], [np.zeros((nu, n)), np.eye(nu)]])
        @ shifted
        @ np.block([[Ui, np.zeros((n, ny))], [-C2 @ G @ Ui, np.eye(ny)]])
    )
    return StateSpace(K[:n, :n], K[:n, n:], K[n:, :n], K[n:, n:], plant.dt)
