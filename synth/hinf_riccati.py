"""H-infinity output feedback by two Riccati equations: search the optimal level, build the central controller.

A level g is feasible when the game Riccati equations of control (X) and of estimation (Y) have stabilising solutions
of the right signs and the spectral radius of X Y is below g^2. Everything here lives in the scaled coordinates of
`precondition`; `Conditioned.restore` and `Conditioned.scale` are the way back. A plant whose D12 or D21 loses rank, or
that has zeros on the unit circle, gets a small regularisation appended to z and w, and the controller is judged
on the plant without it.

Reference: Stoorvogel (1992), The H-infinity control problem: a state space approach, chapters 9 and 10.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.doubling import Riccati, bounded_real, is_nonnegative, is_positive, solve_riccati
from synth.errors import InfeasibleError, NumericalError, VerificationError
from synth.generalized import GeneralizedPlant
from synth.norms import balance, confirm, hinfnorm, is_stable
from synth.precondition import Conditioned
from synth.statespace import StateSpace

REGULARISATIONS = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)  # of plants without a regular solution, relative to the scaled plant
MARGINS = tuple(1e-5 * 4**k for k in range(7))  # central controller above the optimal level, tried in this order
NEAR_BEST = 1e-4  # relative: of the verified designs this near the lowest level the most regularised is taken
LOWEST, HIGHEST = 1e-9, 1e9  # levels searched, scaled plant


class RiccatiDesign(NamedTuple):
    """Central controller for the plant of a `Conditioned`, all in its scaled coordinates."""

    controller: StateSpace  # u = K y for the scaled plant, (nu x ny)
    gamma: float  # proven by the bounded-real equation for this controller
    gamma_opt: float  # lowest level found feasible, with any regularisation
    regularisation: float  # appended to z and w, 0 for regular plants
    evaluations: int  # pairs of Riccati equations solved
    rcond_X: float  # reciprocal condition of R + B'X B in the control equation
    rcond_Y: float  # the same in the estimation equation
    coupling: float  # spectral radius of X Y over gamma^2, below 1


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


def riccati_hinf(c: Conditioned, gamma: float | None = None, tol: float = 1e-7) -> RiccatiDesign:
    """Central H-infinity controller for the scaled plant of `c`, optimal or at a level asked for.

    Parameters
    ----------
    gamma : level asked for in scaled units (original level / c.scale); None searches the optimum
    tol : relative accuracy of the optimal level

    Raises
    ------
    InfeasibleError : no controller was found at `gamma`; carries the lowest level reached, in scaled units.
    NumericalError : no level gave a controller whose closed loop is stable and has the norm it should have.
    """
    designs, statuses = [], {}
    for epsilon in (0.0, *REGULARISATIONS):
        P = regularised(c.plant, epsilon)
        try:
            optimum, below, count = search(P, c.X, c.Y, tol)
            designs.append(_verified(c, P, optimum, gamma, epsilon, count))
        except NumericalError as error:
            statuses[f"regularisation {epsilon:g}"] = str(error)
            continue
        if gamma is not None and designs[-1].gamma <= gamma:
            return designs[-1]
        if epsilon == 0 and _trusted(c, optimum, below):
            break
    if not designs:
        raise NumericalError("no Riccati route led to a verified controller", statuses)
    lowest, floor = min(d.gamma for d in designs), min(min(d.gamma, d.gamma_opt) for d in designs)
    if gamma is not None:
        raise InfeasibleError(f"no controller reached {gamma:.6g}; the lowest verified level is {lowest:.6g}", lowest)
    best = next(d for d in designs if d.gamma <= lowest * (1 + NEAR_BEST))
    return best._replace(gamma_opt=floor)


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


def parrott(P: GeneralizedPlant) -> float:
    """Level below which no controller can go, whatever its direct term: the parts of D11 out of reach of u and y."""

    def complement(D):
        return sla.null_space(D.T) if np.any(D) else np.eye(len(D))

    left, right = complement(P.D12).T @ P.D11, P.D11 @ complement(P.D21.T)
    return max((float(np.linalg.norm(M, 2)) if M.size else 0.0) for M in (left, right))


def control_riccati(P: GeneralizedPlant, gamma: float, start: np.ndarray | None = None) -> Riccati | None:
    """Game Riccati equation of full-information control at level gamma, or None when gamma is too low.

    Stabilising, X >= 0, R22 > 0, and the Schur complement of R on w negative.
    """
    n, nw, *_ = P.sizes
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    R = D.T @ D
    R[:nw, :nw] -= gamma**2 * np.eye(nw)
    solution = solve_riccati(P.A, B, P.C1.T @ P.C1, R, P.C1.T @ D, start=start)
    if solution is None or not is_positive(solution.R[nw:, nw:]) or not is_nonnegative(solution.X):
        return None
    return solution if is_positive(-_worst_case(solution.R, nw)) else None


def estimation_riccati(P: GeneralizedPlant, gamma: float, start: np.ndarray | None = None) -> Riccati | None:
    """The dual of `control_riccati`, for estimation from y."""
    dual = replace(
        P, A=P.A.T, B1=P.C1.T, B2=P.C2.T, C1=P.B1.T, C2=P.B2.T, D11=P.D11.T, D12=P.D21.T, D21=P.D12.T,
        D22=P.D22.T, w=(), u=(), z=(), y=(),
    )  # fmt: skip
    return control_riccati(dual, gamma, start)


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
    n, nw, nu, *_ = P.sizes
    g, X = s.gamma, s.X
    if X is None or s.Y is None:
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


def search(P: GeneralizedPlant, X0: np.ndarray, Y0: np.ndarray, tol: float = 1e-7) -> tuple[Solutions, Solutions, int]:
    """Solutions at the lowest feasible level and at the infeasible one next to it, and how many levels were tried.

    Secant on the logarithm of the coupling inside a bracket; bisection where the existence of X or Y binds.

    Raises
    ------
    NumericalError : no level up to `HIGHEST` is feasible.
    """
    bound = parrott(P)
    high = solve_level(P, max(1.2, 1.2 * bound), X0, Y0)
    low, count = Solutions(max(bound, LOWEST), None, None, np.inf), 1
    while not high.feasible:
        if high.gamma > HIGHEST:
            raise NumericalError("the Riccati equations have no solution at any level; the plant is close to irregular")
        low = high
        high = solve_level(P, 3 * high.gamma, X0, Y0)
        count += 1
    weight = 1.0  # of the lower end in the secant (Illinois)
    while high.gamma > low.gamma * (1 + tol) and count < 120:
        gamma = _next_level(low, high, weight, tol)
        trial = solve_level(P, gamma, high.X.X, high.Y.X)
        count += 1
        if trial.feasible:
            high, weight = trial, weight / 2
        else:
            low, weight = trial, 1.0
    return high, low, count


def _next_level(low: Solutions, high: Solutions, weight: float, tol: float) -> float:
    """Where to look between an infeasible and a feasible level."""
    a, b = np.log(low.gamma), np.log(high.gamma)
    if np.isfinite(low.coupling) and high.coupling > 0:
        fa, fb = weight * np.log(low.coupling), np.log(high.coupling)
        middle = (a * fb - b * fa) / (fb - fa)
    else:
        middle = max((a + b) / 2, b - np.log(4))
    return float(np.exp(np.clip(middle, a + tol / 2, b - tol / 2)))


def _verified(
    c: Conditioned, P: GeneralizedPlant, optimum: Solutions, gamma: float | None, epsilon: float, evaluations: int
) -> RiccatiDesign:
    """Central controller of P (regularised) at gamma or just above the optimum, verified on the plant of c."""
    levels = [(optimum.gamma * (1 + d), optimum.gamma * (1 + 1.01 * d)) for d in MARGINS]  # of controller, of proof
    if gamma is not None and gamma > levels[0][1]:
        levels = [(gamma / (1 + 1e-6), gamma), *(pair for pair in levels if pair[1] <= gamma)]
    for level, proof in levels:
        s = solve_level(P, level, c.X, c.Y)
        K = central_controller(P, s)
        evaluations += 1
        if K is None or s.X is None or s.Y is None:
            continue
        G = balance(c.plant.close(K))
        if not is_stable(G) or bounded_real(G, proof) is None:
            continue
        if epsilon > 0 and gamma is None:  # without the regularisation the norm is lower
            proof = _measured(G, proof)
        rcond_X, rcond_Y = (float(1 / np.linalg.cond(r.R)) for r in (s.X, s.Y))
        return RiccatiDesign(K, proof, optimum.gamma, epsilon, evaluations, rcond_X, rcond_Y, s.coupling)
    raise NumericalError(f"no central controller near level {optimum.gamma:.6g} passed its verification")


def _measured(G: StateSpace, proof: float) -> float:
    """The lowest level that the bounded-real equation confirms, from one that it does."""
    try:
        return min(proof, confirm(G, hinfnorm(G)[0]))
    except VerificationError:  # a norm at rounding level
        while proof > LOWEST and bounded_real(G, proof / 2) is not None:
            proof /= 2
        return proof


def _trusted(c: Conditioned, optimum: Solutions, below: Solutions) -> bool:
    """True when the optimum found without regularisation needs no second opinion.

    Either it is the Parrott bound, or the coupling crosses one between two levels at which both solutions exist and
    a slightly regularised plant, whose controllers serve the plant itself, is not feasible lower down either.
    """
    if optimum.gamma <= parrott(c.plant) * (1 + MARGINS[0]):
        return True
    if not np.isfinite(below.coupling):
        return False
    return not solve_level(regularised(c.plant, 1e-5), optimum.gamma * (1 - 1e-4), c.X, c.Y).feasible


def _worst_case(R: np.ndarray, nw: int) -> np.ndarray:
    """Schur complement of R on w."""
    return R[:nw, :nw] - R[:nw, nw:] @ np.linalg.solve(R[nw:, nw:], R[nw:, :nw])


def _root(M: np.ndarray, power: float) -> np.ndarray:
    """Power of a positive definite matrix."""
    e, V = np.linalg.eigh(M)
    return (V * e**power) @ V.T
