"""Normalised coprime factors G = N M^-1 = Ml^-1 Nl, and the two Riccati solutions they rest on.

With R = I + D D', S = I + D'D and Ab = A - B S^-1 D'C the control solution X and the filter solution Z satisfy

    continuous   Ab'X + X Ab - X B S^-1 B'X + C'R^-1 C = 0,   Ab Z + Z Ab' - Z C'R^-1 C Z + B S^-1 B' = 0
    discrete     X = Ab'X (I + B S^-1 B'X)^-1 Ab + C'R^-1 C,  Z = Ab Z (I + C'R^-1 C Z)^-1 Ab' + B S^-1 B'

The Cayley map keeps both, so that only the discrete equations are solved (`synth.systems.sampled` says at which rate).

References: Glover and McFarlane (1989), IEEE TAC 34, 821, equations (6) to (11) of the common notation with D;
Zhou, Doyle and Glover (1996), Robust and Optimal Control, section 13.8; Jonckheere and Silverman (1983), IEEE TAC
28, 953 (LQG balancing).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.norms import is_stable, spectral_radius, verify
from synth.checks import as_sign
from synth.equations.doubling import Riccati, is_nonnegative, is_positive, solve_riccati
from synth.errors import NumericalError
from synth.systems.generalized import GeneralizedPlant, remembering
from synth.systems.sampled import loop_rate, on_circle
from synth.systems.statespace import StateSpace, as_system, as_systems, check_loop

NEGLIGIBLE = 1e-8  # of the largest LQG singular value; below it they are rounding


class Solutions(NamedTuple):
    """Stabilising solutions of the two Riccati equations of a system."""

    X: np.ndarray  # (n, n) control
    Z: np.ndarray  # (n, n) filter
    residual: float  # relative, the larger one

    @property
    def coupling(self) -> float:
        """Spectral radius of X Z."""
        return float(np.linalg.eigvals(self.X @ self.Z).real.max(initial=0.0))


def ncfmargin(P: Any, K: Any, sign: int = -1) -> float:
    """Margin b(P, K) = 1 / ||[I; K] (I - P K)^-1 [I, P]||, between 0 and 1; 0 for an unstable loop.

    Parameters
    ----------
    P : (p x m) plant; K : (m x p) controller; in any form that `system` takes
    sign : -1 for negative feedback u = -K y (default), +1 for u = K y, the convention of `ncfsyn`

    Returns
    -------
    float, from the verified bound on the norm: within 1e-7 of the margin, and never above it unless rounding forbids

    Raises
    ------
    ModelError : shapes or timebases disagree, the loop is not well posed, `sign` is neither -1 nor 1.
    VerificationError : the loop is stable but too ill-conditioned to be measured.

    Reference: Vinnicombe (2001), Uncertainty and Feedback, section 2.2.
    """
    P, K = as_systems(P=P, K=K)
    sign = as_sign(sign)
    check_loop("P", P, "K", K)
    loop = gang_of_four(P).close(K if sign == 1 else -K)
    return 1 / verify(loop).norm if is_stable(loop) else 0.0


def gang_of_four(G: Any) -> GeneralizedPlant:
    """The plant whose loop under u = K y is [I; K] (I - G K)^-1 [I, G], from (output, input) disturbances to (y, u).

    G is (p x m), in any form that `system` takes.
    """
    G = as_system("G", G)
    p, m, I, O = G.ny, G.nu, np.eye, np.zeros
    plant = GeneralizedPlant(
        A=G.A,
        B1=np.hstack([O((G.n, p)), G.B]),
        B2=G.B,
        C1=np.vstack([G.C, O((m, G.n))]),
        D11=np.block([[I(p), G.D], [O((m, p)), O((m, m))]]),
        D12=np.vstack([G.D, I(m)]),
        C2=G.C,
        D21=np.hstack([I(p), G.D]),
        D22=G.D,
        dt=G.dt,
        w=(*(f"output disturbance {i}" for i in range(p)), *(f"input disturbance {i}" for i in range(m))),
        z=(*(f"output {i}" for i in range(p)), *(f"input {i}" for i in range(m))),
    )
    return remembering(plant, G, gang_of_four)


def transpose(G: StateSpace) -> StateSpace:
    """The dual system, whose transfer matrix is the transpose."""
    return StateSpace(G.A.T, G.C.T, G.B.T, G.D.T, G.dt)


def solutions(G: StateSpace) -> Solutions:
    """X and Z of a continuous or discrete system that can be stabilised.

    Raises
    ------
    NumericalError : an equation was not solved.
    """
    (H,) = on_circle(loop_rate(G), G)
    control, filtering = control_solution(H), control_solution(transpose(H))
    return Solutions(control.X, filtering.X, max(control.residual, filtering.residual))


def control_solution(G: StateSpace) -> Riccati:
    """X of a discrete system, with the state feedback u = F x of least energy of u and y together.

    Raises
    ------
    NumericalError : no stabilising solution was found.
    """
    n, m = G.n, G.nu
    Q, R, S = G.C.T @ G.C, np.eye(m) + G.D.T @ G.D, G.C.T @ G.D
    if n == 0:
        return Riccati(Q, R, S.T, 0.0)
    solution = solve_riccati(G.A, G.B, Q, R, S)
    if not _stabilises(G, solution):
        try:
            solution = solve_riccati(G.A, G.B, Q, R, S, start=sla.solve_discrete_are(G.A, G.B, Q, R, s=S))
        except (np.linalg.LinAlgError, ValueError):
            solution = None
    if solution is None or not _stabilises(G, solution):
        raise NumericalError(
            "the Riccati equations of the coprime factors have no accurate solution: double precision can hardly "
            "stabilise this plant; rescale the model, or strengthen its weakest actuator or sensor"
        )
    return solution


def _stabilises(G: StateSpace, s: Riccati | None) -> bool:
    return s is not None and is_positive(s.R) and is_nonnegative(s.X) and spectral_radius(G.A + G.B @ s.F) < 1


def right_factors(G: StateSpace) -> StateSpace:
    """[N; M] of a discrete system: stable, inner (N~N + M~M = I), G = N M^-1.

    Raises
    ------
    NumericalError : the Riccati equation was not solved.
    """
    s = control_solution(G)
    e, V = np.linalg.eigh(s.R)
    root = (V / np.sqrt(e)) @ V.T
    return StateSpace(
        G.A + G.B @ s.F, G.B @ root, np.vstack([G.C + G.D @ s.F, s.F]), np.vstack([G.D @ root, root]), G.dt
    )


def left_factors(G: StateSpace) -> StateSpace:
    """[Nl, Ml] of a discrete system: stable, co-inner (Nl Nl~ + Ml Ml~ = I), G = Ml^-1 Nl."""
    return transpose(right_factors(transpose(G)))


def balanced(G: StateSpace, s: Solutions) -> StateSpace:
    """The part of a system that matters, in coordinates in which X and Z are diagonal and equal.

    States whose singular value is rounding error are left out; nothing is inverted.
    """
    X, Z = _factor(s.X), _factor(s.Z)
    U, sigma, Vt = np.linalg.svd(X.T @ Z)
    k = int(np.sum(sigma > NEGLIGIBLE * sigma.max(initial=0.0)))
    root = np.sqrt(sigma[:k])
    T, Ti = Z @ Vt[:k].T / root, (X @ U[:, :k] / root).T
    return StateSpace(Ti @ G.A @ T, Ti @ G.B, G.C @ T, G.D, G.dt)


def _factor(M: np.ndarray) -> np.ndarray:
    """L with L L' = M, for a positive semidefinite M."""
    e, V = np.linalg.eigh(M)
    return V * np.sqrt(np.maximum(e, 0.0))
