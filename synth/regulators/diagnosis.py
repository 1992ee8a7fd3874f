"""Why a regulator was not found: asked after a failure only, of the balanced data, mode by mode.

A cost is bounded below for the motions that come to rest only if no sinusoid earns anything, that is if

    F(s)* [[Q, N], [N', R]] F(s) >= 0,   F(s) = [(s I - A)^-1 B; I],   on the stability boundary (Popov's function).

Reference: Willems (1971), IEEE TAC 16, 621 (frequency conditions of least squares optimal control).
"""

from __future__ import annotations

import numpy as np

from synth.analysis.precondition import check_assumptions
from synth.equations.are import Solved, semidefinite, solve
from synth.equations.refinement import Equation
from synth.errors import AssumptionError, NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.modes import unseen
from synth.systems.realization import Matrices, rescaled, state_scales

EARNED = 1e-9  # relative; less is rounding
POINTS = 400  # frequencies of Popov's function, and those of the Hamiltonian's eigenvalues


def failure(e: Equation, found: Solved) -> AssumptionError | NumericalError:
    """The error to raise for an equation that was not solved."""
    n, m = e.B.shape
    A, B = (e.A, e.B) if e.E is None else (np.linalg.solve(e.E, e.A), np.linalg.solve(e.E, e.B))
    t = state_scales(Matrices(A, B, np.diag(np.sqrt(np.abs(np.diag(e.Q)))), np.zeros((n, m))))
    A, B, *_ = rescaled(Matrices(A, B, np.eye(n), np.zeros((n, m))), t)
    e = Equation(A, B, t[:, None] * e.Q * t, e.R, t[:, None] * e.N, None, e.discrete)
    return (
        _unmoved(e)
        or _unseen(e)
        or _earning(e)
        or _free(e)
        or NumericalError(
            f"the Riccati equation was not solved: {_measured(found)}. The weights hardly see a mode, or the commands "
            "hardly move it: change the weights or the model, or pass states of like size"
        )
    )


def _measured(found: Solved) -> str:
    j = found.judge()
    if not np.isfinite(j.residual):
        return "no start led to a stable closed loop"
    return f"the relative residual is {j.residual:.1e}, the condition {j.condition:.1e}"


def _unmoved(e: Equation) -> AssumptionError | None:
    """A mode that is not stable and that no command moves."""
    n, m = e.B.shape
    I, O = np.eye(n), np.zeros
    try:
        check_assumptions(
            GeneralizedPlant(
                A=e.A, B1=I, B2=e.B, C1=I, D11=O((n, n)), D12=O((n, m)), C2=I, D21=O((n, n)), D22=O((n, m)),
                dt=1.0 if e.discrete else 0.0,
            )
        )  # fmt: skip
    except AssumptionError as error:
        return AssumptionError("(A, B) stabilisable", str(error), error.modes)
    return None


def _unseen(e: Equation) -> AssumptionError | None:
    """A mode on the boundary that semidefinite weights do not see."""
    if not semidefinite(e):
        return None
    F = np.linalg.pinv(e.R, hermitian=True) @ e.N.T
    modes = unseen(e.A - e.B @ F, e.Q - e.N @ F, discrete=e.discrete)
    if not modes:
        return None
    return AssumptionError(
        "(Q, A) without unseen modes on the stability boundary",
        f"Q does not see the mode at eigenvalue {', '.join(f'{mode:.6g}' for mode in modes)} of A, which neither "
        "decays nor grows, so that the best regulator leaves it there; give it some weight",
        modes,
    )


def _earning(e: Equation) -> AssumptionError | None:
    """A sinusoid with a negative cost."""
    at, least, _ = _popov(e)
    if least > -EARNED:
        return None
    return AssumptionError(
        "a cost that is bounded below",
        f"no regulator is the best: [[Q, N], [N', R]] has negative eigenvalues, and a motion that swings at {at:.4g} "
        f"{'rad a sample' if e.discrete else 'rad/s'} earns more than it costs; raise R, or pass a Q without negative "
        "eigenvalues",
    )


def _free(e: Equation) -> AssumptionError | None:
    """A command that costs nothing at any frequency."""
    _, _, most = _popov(e)
    if most > EARNED:
        return None
    return AssumptionError(
        "R + B'S B positive definite",
        "some command costs nothing, neither itself nor by what it moves, so that the gain is not determined; give it "
        "some weight in R",
    )


def _popov(e: Equation) -> tuple[float, float, float]:
    """Where the least relative eigenvalue of Popov's function is lowest, that eigenvalue, and the highest such."""
    n, m = e.B.shape
    stabilising = solve(e._replace(Q=np.eye(n), R=np.eye(m), N=np.zeros((n, m))))
    if not stabilising.ok:
        return 0.0, 0.0, 1.0
    F = stabilising.K
    C = e.A - e.B @ F
    W = np.block([[e.Q, e.N], [e.N.T, e.R]])
    values, V = np.linalg.eigh(W)
    modulus = (V * np.abs(values)) @ V.T
    angles = _frequencies(e, C)
    s = np.exp(1j * angles) if e.discrete else 1j * angles
    P = np.linalg.solve(s[:, None, None] * np.eye(n) - C, e.B[None])
    T = np.concatenate([P, np.eye(m) - F @ P], 1)
    size = T.mT.conj() @ modulus @ T
    d = 1 / np.sqrt(np.maximum(np.einsum("kii->ki", size).real, np.finfo(float).tiny))
    least = np.linalg.eigvalsh(d[:, :, None] * (T.mT.conj() @ W @ T) * d[:, None, :])[:, 0]
    k = int(np.argmin(least))
    return float(angles[k]), float(least[k]), float(least.max())


def _frequencies(e: Equation, C: np.ndarray) -> np.ndarray:
    """A grid about the poles, and the middles between the Hamiltonian's eigenvalues, where something may be earned."""
    if e.discrete:
        return np.linspace(0, np.pi, POINTS)
    moduli = np.abs(np.linalg.eigvals(C))
    grid = np.geomspace(1e-3 * moduli.min(), 1e3 * moduli.max(), POINTS)
    F = np.linalg.solve(e.R, e.N.T)
    A = e.A - e.B @ F
    H = np.block([[A, -e.B @ np.linalg.solve(e.R, e.B.T)], [-e.Q + e.N @ F, -A.T]])
    crossings = np.sort(np.abs(np.linalg.eigvals(H).imag))
    return np.concatenate([[0.0], grid, crossings, (crossings[1:] + crossings[:-1]) / 2])
