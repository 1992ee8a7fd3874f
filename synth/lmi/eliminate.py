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
from synth.lmi.loops import recover
from synth.lmi.solve import BACKOFF, TOLERANCE, solve, staircase, value
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

LARGEST = 1e5  # bound on the eigenvalues of R and S in balanced coordinates, where their natural size is one


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
    NR: Any = sla.block_diag(sla.null_space(np.hstack([B2.T, D12.T])), np.eye(nw))
    NS: Any = sla.block_diag(sla.null_space(np.hstack([C2, D21])), np.eye(nz))
    control: Any = staircase([
        [R - A @ R @ A.T, -A @ R @ C1.T,                   -B1],
        [                  g * np.eye(nz) - C1 @ R @ C1.T, -D11],
        [                                                   g * np.eye(nw)],
    ])  # fmt: skip
    sensing: Any = staircase([
        [S - A.T @ S @ A, -A.T @ S @ B1,                   -C1.T],
        [                  g * np.eye(nw) - B1.T @ S @ B1, -D11.T],
        [                                                   g * np.eye(nz)],
    ])  # fmt: skip
    return [NR.T @ control @ NR, NS.T @ sensing @ NS, staircase([[R, np.eye(n)], [S]])]


def controller(plant: GeneralizedPlant, R: np.ndarray, S: np.ndarray, g: float) -> StateSpace:
    """The central controller for a feasible (R, S) at the level `g`.

    Seed LMI (20) with X1 = S, Y1 = R is solved for the rest. It is M + U Theta V' + V Theta' U' >= 0 with
    Theta = [[An, Bn], [Cn, Dn]] and U' V = 0. In an orthonormal basis [U, N] its Schur complement after eliminating N
    is a concave quadratic in Theta, largest (as a matrix) at

        Theta = -U' M N (N' M N)^-1 N' V [V' N (N' M N)^-1 N' V]^-1.

    A congruence first makes the diagonal blocks of M one.

    Raises
    ------
    NumericalError : N' M N is not positive definite: (R, S) is not feasible to working precision.
    """
    n, nw, nu, nz, ny = plant.sizes
    A, B1, C1, D11 = plant.A, plant.B1, plant.C1, plant.D11
    O, I = np.zeros, np.eye(n)
    M = np.block([
        [S,            I,            S @ A,        O((n, n)),      S @ B1,          O((n, nz))],
        [I,            R,            A,            A @ R,          B1,              O((n, nz))],
        [A.T @ S,      A.T,          S,            I,              O((n, nw)),      C1.T],
        [O((n, n)),    R @ A.T,      I,            R,              O((n, nw)),      R @ C1.T],
        [B1.T @ S,     B1.T,         O((nw, n)),   O((nw, n)),     g * np.eye(nw),  D11.T],
        [O((nz, n)),   O((nz, n)),   C1,           C1 @ R,         D11,             g * np.eye(nz)],
    ])  # fmt: skip
    U = np.zeros((len(M), n + nu))
    U[:n, :n], U[n : 2 * n, n:], U[-nz:, n:] = I, plant.B2, plant.D12
    V = np.zeros((len(M), n + ny))
    V[2 * n : 3 * n, n:], V[3 * n : 4 * n, :n], V[4 * n : 4 * n + nw, n:] = plant.C2.T, I, plant.D21.T
    try:
        s, r = (np.linalg.inv(np.linalg.cholesky(X)) for X in (S, R))
        E = np.asarray(sla.block_diag(s, r, s, r, np.eye(nw + nz) / np.sqrt(g)))
        M, U, V = E @ M @ E.T, E @ U, E @ V
        (QU, RU), (QV, RV) = _basis(U), _basis(V)
        N = sla.null_space(QU.T)
        factor = sla.cho_factor(N.T @ M @ N, lower=True)
    except np.linalg.LinAlgError:
        raise NumericalError("the solution (R, S) of the elimination LMIs is not strictly feasible") from None
    X = sla.cho_solve(factor, N.T @ QV)
    theta = -np.linalg.solve((QV.T @ N @ X).T, (QU.T @ M @ N @ X).T).T
    return recover(plant, S, R, I, RU @ theta @ RV.T)


def _basis(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An orthonormal basis Q of the range of M, and R with M R = Q; redundant columns fall away."""
    left, sigma, right = np.linalg.svd(M, full_matrices=False)
    keep = sigma > 1e-12 * sigma[0]
    return left[:, keep], right[keep].T / sigma[keep]


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
        return float(value(g)), status

    def controllers(self, level: float) -> Iterator[StateSpace]:
        """The central controller of the analytic centre of all (R, S) that reach `level`.

        Where measurements or actuators are perfect the set of (R, S) is unbounded and has no centre; a second
        attempt bounds it.
        """
        lmis = existence(self.plant, self.R, self.S, level)
        bound = LARGEST * np.eye(self.plant.sizes[0])
        for bounds in ([], [bound - self.R, bound - self.S]):
            solve(0, [*lmis, *bounds])
            yield controller(self.plant, value(self.R), value(self.S), level)
