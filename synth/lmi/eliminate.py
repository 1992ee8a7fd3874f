"""H-infinity output feedback with the controller eliminated: two small LMIs in (R, S), then an explicit controller.

References: Gahinet and Apkarian (1994), Int. J. Robust and Nonlinear Control 4, 421, theorem 5.2 and section 7;
Iwasaki and Skelton (1994), Automatica 30, 1307, theorem 1.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import cvxpy as cp
import numpy as np
import scipy.linalg as sla

from synth.errors import NumericalError
from synth.generalized import GeneralizedPlant
from synth.lmi.loops import recover
from synth.lmi.solve import BACKOFF, TOLERANCE, solve, staircase
from synth.statespace import StateSpace


def existence(plant: GeneralizedPlant, R: Any, S: Any, g: Any) -> list[cp.Expression]:
    """Matrices that are positive semidefinite if some controller of the plant's order reaches the level `g`.

    Parameters
    ----------
    R, S : (n, n) symmetric unknowns
    """
    n, nw, _, nz, _ = plant.sizes
    A, B1, B2, C1, D11, D12, C2, D21 = (
        plant.A, plant.B1, plant.B2, plant.C1, plant.D11, plant.D12, plant.C2, plant.D21,
    )  # fmt: skip
    NR = sla.block_diag(sla.null_space(np.hstack([B2.T, D12.T])), np.eye(nw))
    NS = sla.block_diag(sla.null_space(np.hstack([C2, D21])), np.eye(nz))
    control = staircase([
        [R - A @ R @ A.T, -A @ R @ C1.T,                   -B1],
        [                  g * np.eye(nz) - C1 @ R @ C1.T, -D11],
        [                                                   g * np.eye(nw)],
    ])  # fmt: skip
    sensing = staircase([
        [S - A.T @ S @ A, -A.T @ S @ B1,                   -C1.T],
        [                  g * np.eye(nw) - B1.T @ S @ B1, -D11.T],
        [                                                   g * np.eye(nz)],
    ])  # fmt: skip
    return [NR.T @ control @ NR, NS.T @ sensing @ NS, staircase([[R, np.eye(n)], [S]])]


def controllers(plant: GeneralizedPlant, R: np.ndarray, S: np.ndarray, g: float) -> Iterator[StateSpace]:
    """Controllers for a feasible (R, S) at the level `g`: seed LMI (20) with X1 = S, Y1 = R solved for its rest.

    The matrix is M0 + U Theta V' + V Theta' U' with Theta = [[An, Bn], [Cn, Dn]]; for every rho that makes
    M0 + rho U U' positive definite, Theta = rho U' Phi V (V' Phi V)^-1 solves it, Phi = (M0 + rho U U')^-1.

    Raises
    ------
    NumericalError : no rho makes the matrix positive definite: (R, S) is not feasible to working precision.
    """
    n, nw, nu, nz, ny = plant.sizes
    A, B1, C1, D11 = plant.A, plant.B1, plant.C1, plant.D11
    O, I = np.zeros, np.eye(n)
    M0 = np.block([
        [S,            I,            S @ A,        O((n, n)),      S @ B1,          O((n, nz))],
        [I,            R,            A,            A @ R,          B1,              O((n, nz))],
        [A.T @ S,      A.T,          S,            I,              O((n, nw)),      C1.T],
        [O((n, n)),    R @ A.T,      I,            R,              O((n, nw)),      R @ C1.T],
        [B1.T @ S,     B1.T,         O((nw, n)),   O((nw, n)),     g * np.eye(nw),  D11.T],
        [O((nz, n)),   O((nz, n)),   C1,           C1 @ R,         D11,             g * np.eye(nz)],
    ])  # fmt: skip
    U = np.zeros((len(M0), n + nu))
    U[:n, :n], U[n : 2 * n, n:], U[-nz:, n:] = I, plant.B2, plant.D12
    V = np.zeros((len(M0), n + ny))
    V[2 * n : 3 * n, n:], V[3 * n : 4 * n, :n], V[4 * n : 4 * n + nw, n:] = plant.C2.T, I, plant.D21.T
    found = False
    for rho in np.geomspace(1e0, 1e9, 10) * np.linalg.norm(M0, 2):
        try:
            factor = sla.cho_factor(M0 + rho * U @ U.T, lower=True)
        except np.linalg.LinAlgError:
            continue
        PhiV = sla.cho_solve(factor, V)
        theta = rho * U.T @ PhiV @ np.linalg.pinv(V.T @ PhiV, hermitian=True)
        found = True
        yield recover(plant, S, R, I, theta)
    if not found:
        raise NumericalError("the solution (R, S) of the elimination LMIs is not strictly feasible")


@dataclass(frozen=True)
class Eliminated:
    """Synthesis through (R, S): minimise the level, centre a little above it, build the controller."""

    plant: GeneralizedPlant
    R: cp.Variable  # (n, n)
    S: cp.Variable  # (n, n)
    solver: ClassVar[str] = "clarabel"
    tolerance: ClassVar[float] = TOLERANCE
    backoff: ClassVar[tuple[float, ...]] = BACKOFF

    @classmethod
    def of(cls, plant: GeneralizedPlant) -> Eliminated:
        """The unknowns for a plant."""
        n = plant.sizes[0]
        return cls(plant, *(cp.Variable((n, n), symmetric=True) for _ in range(2)))

    def minimise(self) -> tuple[float, str]:
        """The optimal level and the solver's status."""
        g = cp.Variable()
        status = solve(g, existence(self.plant, self.R, self.S, g))
        return float(g.value), status

    def controllers(self, level: float) -> Iterator[StateSpace]:
        """Controllers from the analytic centre of all (R, S) that reach `level`."""
        solve(0, existence(self.plant, self.R, self.S, level))
        yield from controllers(self.plant, self.R.value, self.S.value, level)
