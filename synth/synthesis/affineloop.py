"""The closed loop as an affine function of the controller's matrices, and slopes by them.

    [A B; C D] = M + L Theta R,   Theta = [Ak Bk; Ck Dk],   D22 = 0

so that a derivative S by [A B; C D] is L' S R' by Theta.

Reference: Gahinet and Apkarian (1994), Int. J. Robust and Nonlinear Control 4, 421, section 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from synth.analysis.barriers import gramian
from synth.analysis.norms import is_stable
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

FLOOR = 1e-8  # relative, of the Gramians' singular values that a state transformation is made of


@dataclass(frozen=True, eq=False)
class AffineLoop:
    """A plant without D22, and controllers of some order as vectors."""

    plant: GeneralizedPlant
    order: int  # of the controllers
    rate: float  # rad/s, unit of the controller's dynamics in continuous time; 1 in discrete time
    free: np.ndarray  # (nu, ny) whether an entry of Dk may be other than zero
    M: np.ndarray
    L: np.ndarray
    R: np.ndarray

    @classmethod
    def of(cls, plant: GeneralizedPlant, order: int, rate: float, free: np.ndarray) -> AffineLoop:
        """For controllers of an order."""
        n, nw, nu, nz, ny = plant.sizes
        k, root = order, np.sqrt(rate)
        states, own = sla.block_diag(plant.A, np.zeros((k, k))), root * np.eye(k)
        M = np.block([
            [states, np.vstack([plant.B1, np.zeros((k, nw))])],
            [np.hstack([plant.C1, np.zeros((nz, k))]), plant.D11],
        ])  # fmt: skip
        L = np.block([[np.zeros((n, k)), plant.B2], [own, np.zeros((k, nu))], [np.zeros((nz, k)), plant.D12]])
        R = np.block([[np.zeros((k, n)), own, np.zeros((k, nw))], [plant.C2, np.zeros((ny, k)), plant.D21]])
        return cls(plant, order, rate, free, M, L, R)

    def closed(self, theta: np.ndarray) -> StateSpace:
        """The loop of a controller."""
        n, _, nu, _, ny = self.plant.sizes
        N = n + self.order
        S = self.M + self.L @ theta.reshape(self.order + nu, self.order + ny) @ self.R
        return StateSpace(S[:N, :N], S[:N, N:], S[N:, :N], S[N:, N:], self.plant.dt)

    def slope(self, found: np.ndarray) -> np.ndarray:
        """A derivative by the controller from one by the loop; none by entries that are not free."""
        slope = self.L.T @ found @ self.R.T
        slope[self.order :, self.order :] *= self.free
        return slope.ravel()

    def vector(self, K: StateSpace) -> np.ndarray:
        """A controller, its states chosen so that they are reached and seen alike in the loop where that is stable."""
        k, root = self.order, np.sqrt(self.rate)
        D = K.D * self.free

        def stacked(A, B, C):
            return np.block([[A / root**2, B / root], [C / root, D]]).ravel()

        given = stacked(K.A, K.B, K.C)
        G = self.closed(given)
        if not k or not np.isfinite(G.A).all() or not is_stable(G):
            return given
        W, V = gramian(G.A, G.B @ G.B.T, G.dt)[-k:, -k:], gramian(G.A.T, G.C.T @ G.C, G.dt)[-k:, -k:]
        if not (np.isfinite(W).all() and np.isfinite(V).all()):
            return given
        a, b = _root(W), _root(V)
        _, s, Vt = np.linalg.svd(b.T @ a)
        T = a @ Vt.T / np.sqrt(np.maximum(s, FLOOR * s[0]))
        Ti = np.linalg.inv(T)
        return stacked(Ti @ K.A @ T, Ti @ K.B, K.C @ T) if np.isfinite(Ti).all() else given

    def controller(self, theta: np.ndarray) -> StateSpace:
        """The controller of a vector."""
        _, _, nu, _, ny = self.plant.sizes
        k, root = self.order, np.sqrt(self.rate)
        S = theta.reshape(k + nu, k + ny)
        return StateSpace(root**2 * S[:k, :k], root * S[:k, k:], root * S[k:, :k], S[k:, k:], self.plant.dt)


def _root(W: np.ndarray) -> np.ndarray:
    """L with L L' = W up to the floor, invertible unless W is zero."""
    e, V = np.linalg.eigh(W)
    return V * np.sqrt(np.maximum(e, FLOOR * e[-1] or 1.0))
