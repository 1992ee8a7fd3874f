"""Anti-windup of loop-shaping controllers: the observer is told what the actuator did, and the weight follows.

    v = C x + D e,  u = min(max(v, umin), umax),  x+ = A x + B e + L (u - v)

With the deficit u - v zero this is the controller W1 Ks W2. With W1 = (A1, B1, C1, D1) the input of the shaped plant
that goes with the actual u is us + D1^-1 (u - v) instead of us. Fed to the state of W1 (Hanus) and, as the input of
the shaped plant Gs, to the observer in Ks, it makes L = [0; (B + H D) D1^-1; B1 D1^-1] on the states of W2, Ks, W1.

References: Hanus, Kinnaert and Henrotte (1987), Automatica 23, 729; Skogestad and Postlethwaite (2005),
Multivariable Feedback Control, section 9.4.5; McFarlane and Glover (1992), IEEE TAC 37, 759.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.checks import as_limits, shown
from synth.errors import ModelError
from synth.synthesis.design import Design

OBSERVER = 1e-8  # relative mismatch of the controller's dynamics with those of an observer of the plant
INVERTIBLE = 1e-12  # relative distance of the direct term of W1 to singular


@dataclass(frozen=True)
class AntiWindup:
    """u = min(max(C x + D e, umin), umax), x+ = A x + B e + L (u - C x - D e), with e = r - y as in `controller`.

    Make one with `AntiWindup.of`, which checks. The fields are not checked here, so that the class can be rebuilt
    from traced arrays.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, p)
    C: np.ndarray  # (m, n)
    D: np.ndarray  # (m, p)
    L: np.ndarray  # (n, m) what the states learn of the deficit
    umin: np.ndarray  # (m,) unit of u
    umax: np.ndarray  # (m,) unit of u
    dt: float  # s

    def init(self) -> np.ndarray:
        """The zero state, (n,)."""
        return np.zeros(self.A.shape[-1])

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """(state, y, r) -> (state, u) with state (n,), y and r (p,), u (m,) within its limits."""
        e = r - y
        v = self.C @ state + self.D @ e
        u = v.clip(self.umin, self.umax)
        return self.A @ state + self.B @ e + self.L @ (u - v), u

    @classmethod
    def of(cls, design: Design, umin: Any, umax: Any) -> AntiWindup:
        """From a discrete design by `ncfsyn` for the plant from u to e = r - y, that is, of -G where y = G u.

        Parameters
        ----------
        umin, umax : (m,) or numbers, limits of the actuator, unit of u; infinite ones are allowed

        Raises
        ------
        ModelError : the design is continuous or not one of `ncfsyn`, the direct term of W1 is not invertible, the
            limits have no room between them.
        """
        if not isinstance(design, Design):
            raise ModelError(f"design is {shown(design)}; pass a Design by ncfsyn, which has an observer inside")
        parts = design.shaping
        if parts is None:
            raise ModelError("the design has no shaping: anti-windup is for designs by ncfsyn, with an observer inside")
        K = design.controller
        if not K.discrete:
            raise ModelError("the design is continuous; a sampled loop steps discrete ones: design on c2d(G, dt)")
        low, high = (as_limits(name, value, K.ny) for name, value in (("umin", umin), ("umax", umax)))
        if not (low < high).all():
            raise ModelError(f"umin = {low.tolist()} is not below umax = {high.tolist()}; leave room between them")
        W1, D1 = parts.W1, parts.W1.D
        s = np.linalg.svd(D1, compute_uv=False)
        if W1.ny != W1.nu or s[-1] <= INVERTIBLE * s[0]:
            raise ModelError(f"W1.D = {D1.tolist()} is not invertible; conditioning needs a W1 with a direct term")
        L = np.vstack([np.zeros((parts.W2.n, W1.nu)), _observer_input(design), W1.B])
        return cls(K.A, K.B, K.C, K.D, np.linalg.solve(D1.T, L.T).T, low, high, K.dt)


def _observer_input(design: Design) -> np.ndarray:
    """B + H D of the observer in Ks, whose gain H is read back from Ks and Gs.

    Ks = [A + H C + (B + H D) F, (B + H D) J - H; F, J], so that H = (B J - Bk) (I - D J)^-1.
    """
    assert design.shaping is not None
    Ks, P = design.shaping.Ks, design.plant
    A, B, C, D = P.A, P.B2, P.C2, P.D22
    H = np.linalg.solve((np.eye(len(D)) - D @ Ks.D).T, (B @ Ks.D - Ks.B).T).T
    observer = A + H @ C + (B + H @ D) @ Ks.C if Ks.n == len(A) else np.full_like(Ks.A, np.inf)
    if np.linalg.norm(observer - Ks.A) > OBSERVER * np.linalg.norm(Ks.A):
        raise ModelError("Ks is no observer of the shaped plant: anti-windup needs the controller as ncfsyn made it")
    return B + H @ D
