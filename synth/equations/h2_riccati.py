"""H2-optimal output feedback from two Riccati equations, and the norm that no controller goes below.

    X    of the control with all of x and w known      u = F x + F0 w
    Y    of the filter, covariance of the error of x   gain -L

Continuous, D11 = 0:  K = (A + B2 F + L C2, -L, F, 0), and the least norm squared is

    tr B1'X B1 + tr R F Y F',   R = D12'D12

Discrete, where u may depend on the present measurement:  u = F x^ + M (y - C2 x^), M = (F Y C2' + F0 D21') Ry^-1,

    tr (D11'D11 + B1'X B1) + tr R (F Y F' - M Ry M'),   R = D12'D12 + B2'X B2,  Ry = D21 D21' + C2 Y C2'

and without its last term where K is to be strictly proper, M = 0: F0 falls out of it.

References: Doyle, Glover, Khargonekar and Francis (1989), IEEE TAC 34, 831; Chen and Francis (1995), Optimal
Sampled-Data Control Systems, chapter 6; Zhou, Doyle and Glover (1996), chapters 14 and 21.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synth.equations.are import solve
from synth.equations.parrott import reach
from synth.equations.refinement import Equation, evaluate, size
from synth.equations.starts import pencil
from synth.errors import AssumptionError, NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.modes import unseen
from synth.systems.statespace import StateSpace

CANCELLED = 1e-12  # of |D11|: a direct term of the loop that is rounding
RANK = 1e-12  # relative singular value of [A - s I, B2; C1, D12] at a point s that is no zero
DOUBTED = (
    1e-7  # relative residual of a solution of which `solve` is not certain, but that the measured loop may confirm
)
POINTS = (0.7390851, 1.6180340, 2.5029079)  # rad a sample on the unit circle; their tangents on the axis


class Optimal(NamedTuple):
    """The H2-optimal controller, and the square of the least norm; X and Y as in the header."""

    controller: StateSpace  # u = K y
    squared: float
    X: np.ndarray  # (n, n)
    Y: np.ndarray  # (n, n)
    residual: float  # the larger of the two equations' relative residuals


class _Half(NamedTuple):
    """One of the two equations, solved: control, or filter as its transpose."""

    X: np.ndarray
    F: np.ndarray  # gain of u = F x
    residual: float


def h2_controller(P: GeneralizedPlant, *, strictly_proper: bool = False) -> Optimal:
    """The H2-optimal controller of a balanced plant without D22, whose stabilisability was checked.

    Raises
    ------
    AssumptionError : in continuous time D12 or D21 loses rank, or D11 is out of their reach; a control has no effect
        on z or a measurement none from w; a zero from u to z or from w to y is on the stability boundary.
    NumericalError : a Riccati equation was not solved.
    """
    return _discrete(P, strictly_proper) if P.dt else _continuous(P, strictly_proper)


def _continuous(P: GeneralizedPlant, strictly_proper: bool) -> Optimal:
    u, y = reach(P.D12), reach(P.D21.T)
    for assumption, D, found, what in (
        ("D12 of full column rank", P.D12, u, "some control acts on z through the states only, so that it is driven "
         "without limit; give every u, and every combination of them, a weight in z"),
        ("D21 of full row rank", P.D21.T, y, "some measurement is free of noise, so that it is differentiated without "
         "limit; let a part of w of its own act on every y"),
    ):  # fmt: skip
        if found.U1.shape[1] < D.shape[1]:
            raise AssumptionError(assumption, f"no controller has the least H2 norm: {what}, however little")
    Dk = -u.R @ (u.U1.T @ P.D11 @ y.U1) @ y.R.T
    left = np.linalg.norm(P.D11 + P.D12 @ Dk @ P.D21, 2)
    size = np.linalg.norm(P.D11, 2)
    if left > CANCELLED * size or (strictly_proper and size > 0):
        raise AssumptionError(
            "D11 = 0 in continuous time, or cancelled by a direct term of the controller",
            f"no controller has a finite H2 norm: D11 passes white noise on to z, {size:.3g}, of which "
            f"{'a strictly proper one' if strictly_proper else 'the best direct term'} leaves "
            f"{size if strictly_proper else left:.3g}; let the weights fall off with frequency"
            + (", or pass strictly_proper=False" if strictly_proper and left <= CANCELLED * size else ""),
        )
    A, B1, C1 = P.A + P.B2 @ Dk @ P.C2, P.B1 + P.B2 @ Dk @ P.D21, P.C1 + P.D12 @ Dk @ P.C2
    # controls and measurements for which D12 and D21 are orthonormal
    B2, C2, E12, E21 = P.B2 @ u.R, y.R.T @ P.C2, u.U1, y.U1.T
    control = _half(A, B2, C1, E12, 0.0, "u", "z")
    filtering = _half(A.T, C2.T, B1.T, E21.T, 0.0, "w", "y")
    F, L = control.F, filtering.F.T
    squared = np.sum(B1 * (control.X @ B1)) + np.sum(F * (F @ filtering.X))
    K = StateSpace(A + B2 @ F + L @ C2, -L @ y.R.T, u.R @ F, np.zeros_like(Dk), 0.0)
    if size:  # K is that of the plant closed by Dk
        K = StateSpace(K.A, K.B, K.C, Dk, 0.0)
    return Optimal(K, float(squared), control.X, filtering.X, max(control.residual, filtering.residual))


def _discrete(P: GeneralizedPlant, strictly_proper: bool) -> Optimal:
    A, B1, B2, C1, D11, D12, C2, D21 = P.A, P.B1, P.B2, P.C1, P.D11, P.D12, P.C2, P.D21
    control = _half(A, B2, C1, D12, P.dt, "u", "z")
    filtering = _half(A.T, C2.T, B1.T, D21.T, P.dt, "w", "y")
    (X, F, _), (Y, L) = control, (filtering.X, filtering.F.T)
    R, Ry = D12.T @ D12 + B2.T @ X @ B2, D21 @ D21.T + C2 @ Y @ C2.T
    squared = np.sum(D11 * D11) + np.sum(B1 * (X @ B1)) + np.sum(F * (R @ F @ Y))
    M = np.zeros((len(R), len(Ry)))
    if not strictly_proper:
        F0 = -np.linalg.solve(R, B2.T @ X @ B1 + D12.T @ D11)
        M = np.linalg.solve(Ry, C2 @ Y @ F.T + D21 @ F0.T).T
        squared -= np.sum(M * (R @ M @ Ry))
    C = F - M @ C2
    K = StateSpace(A + B2 @ C + L @ C2, B2 @ M - L, C, M, P.dt)
    return Optimal(K, float(squared), X, Y, max(control.residual, filtering.residual))


def _half(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, dt: float, start: str, end: str) -> _Half:
    """X and F of min |C x + D u|^2 from `start` to `end`; the filter is the control of the transposed plant."""
    n, m = B.shape
    if n == 0:
        _check_rank(A, B, C, D, dt, start, end)
        return _Half(np.zeros((0, 0)), np.zeros((m, 0)), 0.0)
    e = Equation(A, B, C.T @ C, D.T @ D, C.T @ D, None, dt > 0)
    found = solve(e)
    if found.ok and np.isfinite(found.K).all():
        return _Half(found.X, -found.K, float(found.judge().residual))
    _check_rank(A, B, C, D, dt, start, end)
    G = np.linalg.pinv(e.R, hermitian=True) @ e.N.T
    if zeros := unseen(A - B @ G, e.Q - e.N @ G, discrete=dt > 0):
        raise AssumptionError(
            f"no zero from {start} to {end} on the stability boundary",
            f"no controller has the least H2 norm: the plant has a zero from {start} to {end} at "
            f"{', '.join(f'{zero:.6g}' for zero in zeros)}, where the best loop would have a pole that does not decay; "
            f"add {'a weight on what it hides to z' if start == 'u' else 'a part of w that drives what it hides'}",
            zeros,
        )
    residual, (which, remedy) = found.judge().residual, ("control", "z") if start == "u" else ("filter", "w")
    if residual <= DOUBTED and np.isfinite(found.K).all():  # rounding may have moved its poles: the loop is judged
        return _Half(found.X, -found.K, float(residual))
    if half := _plain(e):
        return half
    raise NumericalError(
        f"the Riccati equation of the {which} was not solved: "
        + (f"its relative residual is {residual:.1e}" if np.isfinite(residual) else "no start led to a stable loop")
        + f"; a zero from {start} to {end} may be near the stability boundary, weigh more of {remedy}"
    )


def _plain(e: Equation) -> _Half | None:
    """A solution in the states given, whose scaling for `solve` a tiny D'D upsets."""
    if (X := pencil(e)) is None or not np.isfinite(X).all():
        return None
    try:
        v = evaluate(e, X, None)
    except np.linalg.LinAlgError:
        return None
    residual = float(size(v.off) / (size(X) + size(e.Q)))
    return _Half(v.X, -v.K, residual) if residual <= DOUBTED and np.isfinite(v.K).all() else None


def _check_rank(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, dt: float, start: str, end: str) -> None:
    """Raise AssumptionError where the transfer function from u to z (or from y back to w) loses rank everywhere."""
    n, m = B.shape
    size = np.linalg.norm(A, 2) if n and not dt else 1.0
    for angle in POINTS:
        s = np.exp(1j * angle) if dt else 1j * (size or 1.0) * np.tan(angle / 2)
        M = np.block([[A - s * np.eye(n), B], [C, D]])
        length = np.linalg.norm(M, axis=0)
        sigma = np.linalg.svd(M / np.where(length > 0, length, 1.0), compute_uv=False)
        if len(M) >= n + m and sigma[-1] > RANK * sigma[0]:
            return
    what, remedy = (
        ("some control has no effect on z at any frequency", "give every u a weight in z")
        if start == "u"
        else ("some measurement is free of noise at every frequency", "let a part of w act on every y")
    )
    raise AssumptionError(
        f"full rank from {start} to {end}", f"the H2-optimal controller is not determined: {what}; {remedy}"
    )
