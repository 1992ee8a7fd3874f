"""H-infinity output feedback by two Riccati equations: search the lowest level, build the central controller.

A level g is feasible when the game Riccati equations of control (X) and of estimation (Y) have stabilising solutions
of the right signs and the spectral radius of X Y is below g^2. The plants here are discrete, with D22 = 0 and in the
scaled coordinates of `precondition`. Where D12 or D21 loses rank, or the plant has zeros on the unit circle, these
equations have no solution at the optimum; small regularisations appended to z and w then take its place. A controller
of the regularised plant is one of the plant itself with a norm at most as large, so the sweep over them is safe, and
it must be a sweep: how much a regularisation costs depends on the plant.

Reference: Stoorvogel (1992), The H-infinity control problem: a state space approach, chapters 9 and 10.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import ClassVar, NamedTuple, cast

import numpy as np
import scipy.linalg as sla

from synth.equations.doubling import Riccati, double, evaluate, is_positive, regularised_lqr, solve_riccati
from synth.equations.parrott import parrott
from synth.errors import NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.modes import crosses
from synth.systems.statespace import StateSpace

REGULARISATIONS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # relative to the scaled plant
BACKOFF = (*(1e-5 * 4.0**k for k in range(6)), 0.1, 1.0, 10.0, 1e2, 1e3)  # the last ones where the optimum is zero
NEGATIVE = 1e-9  # part of its size that an eigenvalue of X may lie below zero: rounding, where X vanishes
INVERTIBLE = 1e-4  # ratio of the singular values of D12 from which on it is inverted
INSIDE = 1e-6  # the central controller for a level is made for one lower by this part, so that it keeps the level
NEARLY = 0.99  # coupling just above an optimum that it decides
FAR = 1.1  # times the optimum, where equations are that have met no wall
FALLEN, NEARER = 1e-2, 5e-2  # parts that are left there, just above the optimum, of rcond and of the distance
LOWEST, HIGHEST = 1e-9, 1e9  # levels searched, scaled plant
BESIDE = 0.02  # relative distance from where the lowest level is thought to be at which is looked first
MAX_LEVELS = 120  # tried in one search; 10 to 30 are used


class Solutions(NamedTuple):
    """Both Riccati solutions at one level."""

    gamma: float
    X: Riccati | None
    Y: Riccati | None
    coupling: float  # spectral radius of X Y over gamma^2, infinite when one does not exist

    @property
    def feasible(self) -> bool:
        """True when a controller with norm below gamma exists."""
        return self.coupling < 1

    @property
    def rcond(self) -> float:
        """How far the equations are from singular, 0 to 1; 0 when one has no solution."""
        return min((1 / np.linalg.cond(r.R) if r else 0.0) for r in (self.X, self.Y))


class Search(NamedTuple):
    """Bracket of the lowest feasible level."""

    low: Solutions  # infeasible
    high: Solutions  # feasible
    levels: int  # how many were tried


@dataclass(frozen=True)
class RiccatiRoute:
    """Synthesis by Riccati equations for a conditioned plant: the lowest level, and controllers for a level."""

    plant: GeneralizedPlant  # discrete, D22 = 0, scaled
    X: np.ndarray  # (n, n) LQR solution, where the control equations start
    Y: np.ndarray  # (n, n) Kalman solution, where the estimation equations start
    _certain: dict[float, bool] = field(default_factory=dict, compare=False)  # levels that were looked at
    solver: ClassVar[str] = "doubling"
    tolerance: ClassVar[float] = 1e-7
    backoff: ClassVar[tuple[float, ...]] = BACKOFF

    @classmethod
    def of(cls, plant: GeneralizedPlant) -> RiccatiRoute:
        """The route for a plant; raises NumericalError when it cannot be stabilised to working precision."""
        P = plant
        X = regularised_lqr(P.A, P.B2, P.C1, P.D12, "(A, B2) stabilisable").X
        return cls(plant, X, regularised_lqr(P.A.T, P.C2.T, P.B1.T, P.D21.T, "(C2, A) detectable").X)

    def minimise(self) -> tuple[float, str]:
        """The lowest level at which the equations are solvable, and how it was found.

        Raises
        ------
        NumericalError : they are not at any level, with any regularisation.
        """
        best, statuses = None, {}
        for epsilon in (0.0, *REGULARISATIONS):
            try:
                found = search(regularised(self.plant, epsilon), self.X, self.Y, self.tolerance)
            except NumericalError as error:
                statuses[f"regularisation {epsilon:g}"] = str(error)
                continue
            if best is None or found.high.gamma < best[0].high.gamma:
                best = found, epsilon
            if epsilon == 0 and self.certain(found.high.gamma):
                break
        if best is None:
            raise NumericalError("the Riccati equations have no solution at any level and regularisation", statuses)
        (_, high, levels), epsilon = best
        note = f", regularised by {epsilon:g}" if epsilon else ""
        return high.gamma, f"coupling {high.coupling:.7f} after {levels} levels, rcond {high.rcond:.1e}{note}"

    def controllers(self, level: float) -> Iterator[StateSpace]:
        """Central controllers for `level`: of the plant, then of the regularised plants that can reach it."""
        for epsilon in (0.0, *REGULARISATIONS):
            P = regularised(self.plant, epsilon)
            K = central_controller(P, solve_level(P, level * (1 - INSIDE), self.X, self.Y))
            if K is not None:
                yield K

    def certain(self, level: float) -> bool:
        """True when the optimum found needs no second opinion.

        It is the Parrott bound; or a wall was met, not digits lost: just above it the coupling is nearly one, or an
        equation is nearly singular, or its loop nearly on the unit circle; and a slightly regularised plant is not
        feasible lower down.
        """
        if level not in self._certain:
            self._certain[level] = self._met(level)
        return self._certain[level]

    def _met(self, level: float) -> bool:
        if level <= parrott(self.plant) * (1 + BACKOFF[0]):
            return True
        near = solve_level(self.plant, level * (1 + INSIDE), self.X, self.Y)
        if not near.feasible:
            return False
        if near.coupling < NEARLY:
            far = solve_level(self.plant, level * FAR, self.X, self.Y)
            met = near.rcond < FALLEN * far.rcond or self._distance(near) < NEARER * self._distance(far)
            if not (far.feasible and met):
                return False
        return not solve_level(regularised(self.plant, 1e-5), level * (1 - 1e-4), self.X, self.Y).feasible

    def _distance(self, s: Solutions) -> float:
        """How far the loops of both equations are from the unit circle."""
        P, radii = self.plant, [0.0]
        for A, B, found in (
            (P.A, np.hstack([P.B1, P.B2]), s.X),
            (P.A.T, np.vstack([P.C1, P.C2]).T, s.Y),
        ):
            radii += [] if found is None else [float(np.abs(np.linalg.eigvals(A + B @ found.F)).max(initial=0.0))]
        return 1 - max(radii)


def regularised(P: GeneralizedPlant, epsilon: float) -> GeneralizedPlant:
    """The plant with epsilon x, epsilon u appended to z and independent noise of that size on x and y."""
    if epsilon == 0:
        return P
    n, nw, nu, nz, ny = P.sizes
    O, eI = np.zeros, lambda k: epsilon * np.eye(k)
    return replace(
        P, w=(), z=(),
        B1=np.hstack([P.B1, eI(n), O((n, ny))]), D21=np.hstack([P.D21, O((ny, n)), eI(ny)]),
        C1=np.vstack([P.C1, eI(n), O((nu, n))]), D12=np.vstack([P.D12, O((n, nu)), eI(nu)]),
        D11=np.block([[P.D11, O((nz, n + ny))], [O((n + nu, nw + n + ny))]]),
    )  # fmt: skip


def control_riccati(P: GeneralizedPlant, gamma: float, start: np.ndarray | None = None) -> Riccati | None:
    """Game Riccati equation of full-information control at level gamma, or None when gamma is too low.

    Stabilising, X >= 0, R22 > 0, and the Schur complement of R on w negative.
    """
    nw = P.sizes[1]
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    R = D.T @ D
    R[:nw, :nw] -= gamma**2 * np.eye(nw)
    split = _perfect(P)
    if split is None:
        solution = solve_riccati(P.A, B, P.C1.T @ P.C1, R, P.C1.T @ D, start=start)
    else:
        X = _unstable_part(split, gamma)
        solution = None if X is None else evaluate(P.A, B, P.C1.T @ P.C1, R, P.C1.T @ D, X)
    if solution is None or not is_positive(solution.R[nw:, nw:]):
        return None
    size = max(np.linalg.norm(M, 2) for M in (solution.X, solution.X if start is None else start))
    if np.linalg.eigvalsh(solution.X).min(initial=0.0) < -NEGATIVE * size:
        return None
    return solution if is_positive(-_worst_case(solution.R, nw)) else None


class _Perfect(NamedTuple):
    """What perfect control leaves: the modes V'x that are unstable under the feedback that makes z zero."""

    V: np.ndarray  # (n, k) orthonormal
    Ai: np.ndarray  # (k, k) inverse of their matrix Au
    E: np.ndarray  # (k, nu) V'B2 D12^-1
    Bw: np.ndarray  # (k, nw) V'(B1 - B2 D12^-1 D11)


@lru_cache(maxsize=16)
def _perfect(P: GeneralizedPlant) -> _Perfect | None:
    """The unstable modes under perfect control, where u reaches all of z directly; None where it does not.

    None also where double precision cannot tell on which side of the stability boundary a mode lies: then P12 has a
    zero there, which no controller may cancel.
    """
    if P.D12.shape[0] != P.D12.shape[1]:
        return None
    sigma = np.linalg.svd(P.D12, compute_uv=False)
    if sigma[-1] <= INVERTIBLE * sigma[0]:
        return None
    E = np.linalg.solve(P.D12.T, P.B2.T).T
    A, Bw = P.A - E @ P.C1, P.B1 - E @ P.D11
    if crosses(A, discrete=True):
        return None
    T, Z, k = cast("tuple[np.ndarray, np.ndarray, int]", sla.schur(A.T, output="real", sort="ouc"))
    V = Z[:, :k]
    return _Perfect(V, np.linalg.inv(T[:k, :k].T), V.T @ E, V.T @ Bw)


def _unstable_part(p: _Perfect, gamma: float) -> np.ndarray | None:
    """X of `control_riccati` in closed form; None when gamma is too low.

    With u = -D12^-1 (C1 x + D11 w) + v a cost is left on v alone: X is zero but on the modes V'x that this feedback
    leaves unstable, and its inverse W there solves a linear equation. So a stable mode that is slower than rounding can
    tell, as of the weight of a mixed sensitivity, does no harm.

        V'(A - B2 D12^-1 C1) = Au V',  Au W Au' - W = E E' - Bw Bw' / gamma^2
    """
    n, k = p.V.shape
    if k == 0:
        return np.zeros((n, n))
    W = double(p.Ai.T, np.zeros((k, k)), p.Ai @ (p.E @ p.E.T - p.Bw @ p.Bw.T / gamma**2) @ p.Ai.T)
    if W is None or not is_positive(W):
        return None
    X = p.V @ np.linalg.solve(W, p.V.T)
    return (X + X.T) / 2


@lru_cache(maxsize=16)
def dual(P: GeneralizedPlant) -> GeneralizedPlant:
    """Estimation as control."""
    return replace(
        P, A=P.A.T, B1=P.C1.T, B2=P.C2.T, C1=P.B1.T, C2=P.B2.T, D11=P.D11.T, D12=P.D21.T, D21=P.D12.T,
        D22=P.D22.T, w=(), u=(), z=(), y=(),
    )  # fmt: skip


def estimation_riccati(P: GeneralizedPlant, gamma: float, start: np.ndarray | None = None) -> Riccati | None:
    """The dual of `control_riccati`, for estimation from y."""
    return control_riccati(dual(P), gamma, start)


def solve_level(P: GeneralizedPlant, gamma: float, X0: np.ndarray, Y0: np.ndarray) -> Solutions:
    """Both Riccati equations at one level, started from solutions at a higher one."""
    X = control_riccati(P, gamma, X0)
    Y = estimation_riccati(P, gamma, Y0) if X else None
    if X is None or Y is None:
        return Solutions(gamma, X, Y, np.inf)
    return Solutions(gamma, X, Y, float(np.abs(np.linalg.eigvals(X.X @ Y.X)).max(initial=0.0)) / gamma**2)


def central_controller(P: GeneralizedPlant, s: Solutions) -> StateSpace | None:
    """Central controller at a feasible level, for any D11 and D22 = 0; None when the second equation fails.

    With the worst disturbance put into the plant, an estimation problem is left whose solution Z takes the place of
    (I - Y X / gamma^2)^-1 Y, so that nothing nearly singular is inverted at the optimum.

    Reference: Stoorvogel (1992), sections 10.3 and 10.4.
    """
    _, nw, nu, *_ = P.sizes
    g, X = s.gamma, s.X
    if X is None or s.Y is None or not s.feasible:
        return None
    F1, F2 = X.F[:nw], X.F[nw:]
    R21, R22 = X.R[nw:, :nw], X.R[nw:, nw:]
    T, h = g * _root(-_worst_case(X.R, nw), -0.5), _root(R22, 0.5)
    hi = np.linalg.inv(h)
    Pt = replace(
        P, A=P.A + P.B1 @ F1, B1=P.B1 @ T, C1=-h @ F2, D11=hi @ R21 @ T, D12=h,
        C2=P.C2 + P.D21 @ F1, D21=P.D21 @ T, z=(),
    )  # fmt: skip
    Z = estimation_riccati(Pt, g, s.Y.X) or estimation_riccati(Pt, g)
    if Z is None:
        return None
    N12, N22 = Z.R[:nu, nu:], Z.R[nu:, nu:]
    M2 = Pt.A @ Z.X @ Pt.C2.T + Pt.B1 @ Pt.D21.T
    D, M = -np.linalg.solve(N22, (hi @ N12).T).T, np.linalg.solve(N22, M2.T).T
    B, C = M + P.B2 @ D, F2 - D @ Pt.C2
    return StateSpace(Pt.A + P.B2 @ F2 - B @ Pt.C2, B, C, D, P.dt)


def search(P: GeneralizedPlant, X0: np.ndarray, Y0: np.ndarray, tol: float = 1e-7, near: float | None = None) -> Search:
    """The lowest feasible level to the relative accuracy `tol`.

    Secant on the logarithm of the coupling inside a bracket; bisection where the existence of X or Y binds.

    Parameters
    ----------
    X0, Y0 : (n, n) starts of the two equations, near their solutions at a high level
    near : where the lowest level is thought to be, if anything is known of it

    Raises
    ------
    NumericalError : no level up to `HIGHEST` is feasible.
    """
    bound = parrott(P)
    low = Solutions(max(bound, LOWEST), None, None, np.inf)
    high, count = solve_level(P, (1 + BESIDE) * near if near else max(1.2, 1.2 * bound), X0, Y0), 1
    while not high.feasible:
        if high.gamma > HIGHEST:
            raise NumericalError("the Riccati equations have no solution at any level")
        low, high, count = high, solve_level(P, 3 * high.gamma, X0, Y0), count + 1
    if near and low.gamma < (1 - BESIDE) * near < high.gamma:
        trial, count = solve_level(P, (1 - BESIDE) * near, X0, Y0), count + 1
        low, high = (low, trial) if trial.feasible else (trial, high)
    weight = 1.0  # of the lower end in the secant (Illinois)
    while high.gamma > low.gamma * (1 + tol) and count < MAX_LEVELS:
        # start from solutions at a higher level: those at a lower one are too large
        X, Y = (r.X if r else start for r, start in ((high.X, X0), (high.Y, Y0)))
        trial = solve_level(P, _next_level(low, high, weight, tol), X, Y)
        count += 1
        if trial.feasible:
            high, weight = trial, weight / 2
        else:
            low, weight = trial, 1.0
    return Search(low, high, count)


def _next_level(low: Solutions, high: Solutions, weight: float, tol: float) -> float:
    """Where to look between an infeasible and a feasible level."""
    a, b = np.log(low.gamma), np.log(high.gamma)
    if np.isfinite(low.coupling) and high.coupling > 0:
        fa, fb = weight * np.log(low.coupling), np.log(high.coupling)
        middle = (a * fb - b * fa) / (fb - fa)
    else:
        middle = max((a + b) / 2, b - np.log(4))
    return float(np.exp(np.clip(middle, a + tol / 2, b - tol / 2)))


def _worst_case(R: np.ndarray, nw: int) -> np.ndarray:
    """Schur complement of R on w."""
    return R[:nw, :nw] - R[:nw, nw:] @ np.linalg.solve(R[nw:, nw:], R[nw:, :nw])


def _root(M: np.ndarray, power: float) -> np.ndarray:
    """Power of a positive definite matrix."""
    e, V = np.linalg.eigh(M)
    return (V * e**power) @ V.T
