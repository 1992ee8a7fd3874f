"""Linear-quadratic regulators `lqr`, `dlqr`, `lqrd`, `lqg`, with the names and returns of python-control and MATLAB.

References: Anderson and Moore (1990), Optimal Control: Linear Quadratic Methods; Zhou, Doyle and Glover (1996), Robust
and Optimal Control, chapter 13; Van Loan (1978), IEEE TAC 23, 395 (the integrals of a sampled cost).
"""

from __future__ import annotations

from typing import Any, NamedTuple, overload

import numpy as np
import scipy.linalg as sla

from synth.analysis.precondition import check_assumptions
from synth.checks import as_array, as_cost, as_matrix, as_number
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.systems.connect import check_dynamic
from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import Matrices, state_scales
from synth.systems.statespace import StateSpace, as_system

UNSEEN = 1e-10  # relative singular value below which a mode on the boundary is not seen


Gains = tuple[np.ndarray, np.ndarray, np.ndarray]


@overload
def lqr(A: Any, B: Any, Q: Any, R: Any, N: Any = None) -> Gains: ...
@overload
def lqr(sys: Any, Q: Any, R: Any, N: Any = None, /) -> Gains: ...
def lqr(*arguments: Any, **named: Any) -> Gains:
    """Regulator u = -K x that minimises the integral of x'Q x + u'R u + 2 x'N u along dx = A x + B u.

    Called as lqr(A, B, Q, R[, N]) or lqr(sys, Q, R[, N]); for a discrete `sys` it is `dlqr`.

    Parameters
    ----------
    A : (n, n); B : (n, m), a list is a column; sys : a system in any form that `synth.system` takes
    Q : (n, n) symmetric positive semidefinite; of all weights a number stands for that multiple of the identity, a
        list for a diagonal
    R : (m, m) symmetric positive definite
    N : (n, m) cross weight, [[Q, N], [N', R]] positive semidefinite; zero when left out

    Returns
    -------
    K : (m, n) gain
    S : (n, n) stabilising solution of A'S + S A - (S B + N) R^-1 (S B + N)' + Q = 0
    E : (n,) closed-loop poles, complex

    Raises
    ------
    ModelError : shapes do not fit, a number is not finite, weights that are not symmetric or not positive.
    AssumptionError : (A, B) cannot be stabilised, or the weights do not see a mode on the imaginary axis.
    NumericalError : no stabilising solution was found although both hold (nearly).

    Examples
    --------
    >>> from synth import lqr
    >>> K, S, E = lqr([[0, 1], [0, 0]], [0, 1], [1, 0], 1)
    >>> K.round(6).tolist()
    [[1.0, 1.414214]]
    """
    given = _arguments("lqr", ("Q", "R", "N"), arguments, named)
    return _regulator(given.G, *given.weights, discrete=given.G.discrete)


@overload
def dlqr(A: Any, B: Any, Q: Any, R: Any, N: Any = None) -> Gains: ...
@overload
def dlqr(sys: Any, Q: Any, R: Any, N: Any = None, /) -> Gains: ...
def dlqr(*arguments: Any, **named: Any) -> Gains:
    """Regulator u = -K x that minimises the sum of x'Q x + u'R u + 2 x'N u along x+ = A x + B u.

    Called as dlqr(A, B, Q, R[, N]) or dlqr(sys, Q, R[, N]). Parameters, returns and raises as `lqr`, with
    S = A'S A - (A'S B + N) (R + B'S B)^-1 (A'S B + N)' + Q and the unit circle for the imaginary axis.
    """
    given = _arguments("dlqr", ("Q", "R", "N"), arguments, named)
    if given.whole and not given.G.discrete:
        raise ModelError("sys is continuous; pass a discrete system (c2d), or call lqr")
    return _regulator(given.G, *given.weights, discrete=True)


class Given(NamedTuple):
    """The arguments of a regulator."""

    G: StateSpace  # its A and B
    whole: bool  # a system was given, whose timebase counts
    weights: list[Any]


def _arguments(function: str, names: tuple[str, ...], positional: tuple[Any, ...], named: dict[str, Any]) -> Given:
    """(A, B, ...) or (sys, ...), by position or by name; the last of `names` may be left out."""
    call = f"{function}(A, B, {', '.join(names)}) or {function}(sys, {', '.join(names)})"
    values = list(positional)
    whole = "sys" in named or bool(values and _is_system(values[0]))
    order = (*(("sys",) if whole else ("A", "B")), *names)
    if len(values) > len(order):
        raise ModelError(f"{function} was given {len(values)} arguments; call {call}")
    found = dict(zip(order, values, strict=False))
    for name, value in named.items():
        if name not in order or name in found:
            raise ModelError(f"{function} has no argument {name!r} left; call {call}")
        found[name] = value
    if missing := [name for name in order[: len(order) - (names[-1] == "N")] if name not in found]:
        raise ModelError(f"{function} was not given {', '.join(missing)}; call {call}")
    weights = [found.get(name) for name in names]
    if whole:
        return Given(as_system("sys", found["sys"]), True, weights)
    A, B = as_matrix("A", found["A"]), as_array("B", found["B"], "pass a real matrix, states x inputs")
    B = as_matrix("B", B.reshape(-1, 1) if B.ndim < 2 and len(A) > 1 else B)
    n = len(B)
    if A.shape != (n, n):
        raise ModelError(f"A is {A.shape[0]} x {A.shape[1]} where {n} x {n} is needed for B, which has {n} rows")
    return Given(StateSpace(A, B, np.zeros((1, n)), np.zeros((1, B.shape[1]))), False, weights)


def _is_system(value: Any) -> bool:
    """Whether a first argument is a system rather than the matrix A."""
    if isinstance(value, tuple):
        return not all(np.isscalar(entry) for entry in value) and not _is_matrix(value)
    return not (
        isinstance(value, np.ndarray | list) or np.isscalar(value) or value is None or hasattr(value, "__array__")
    )


def _is_matrix(value: tuple) -> bool:
    """Whether a tuple is rows of numbers."""
    return all(isinstance(row, tuple | list) and all(np.isscalar(x) for x in row) for row in value)


class SampledCost(NamedTuple):
    """x+ = F x + G u, and the cost of one period as x'Q x + u'R u + 2 x'N u, with u held."""

    F: Any  # (n, n)
    G: Any  # (n, m)
    Q: Any  # (n, n)
    R: Any  # (m, m)
    N: Any  # (n, m)


@overload
def lqrd(A: Any, B: Any, Q: Any, R: Any, dt: Any) -> Gains: ...
@overload
def lqrd(sys: Any, Q: Any, R: Any, dt: Any, /) -> Gains: ...
def lqrd(*arguments: Any, **named: Any) -> Gains:
    """Regulator u = -K x, held for `dt` s, that minimises the integral of x'Q x + u'R u along dx = A x + B u.

    Called as lqrd(A, B, Q, R, dt) or lqrd(sys, Q, R, dt).
    The continuous gain of `lqr` under a hold can be unstable: it suits periods well below its fastest time constant.

    Parameters
    ----------
    A, B, sys, Q, R : as in `lqr`
    dt : () s, control period, positive

    Returns
    -------
    K, S, E : as of `dlqr`, for the sampled model and the cost between the samples

    Raises
    ------
    ModelError, AssumptionError, NumericalError : as `lqr`; also for a period that loses stabilisability.
    """
    given = _arguments("lqrd", ("Q", "R", "dt"), arguments, named)
    if given.G.discrete:
        raise ModelError(f"sys has dt = {given.G.dt}; lqrd samples a continuous system itself")
    A, B, n, m = given.G.A, given.G.B, given.G.n, given.G.nu
    Q, R = as_cost("Q", given.weights[0], n), as_cost("R", given.weights[1], m, definite=True)
    dt = as_number("dt", given.weights[2], "the control period in seconds", above=0)
    scales = _scales(A, B, Q)
    A, B, Q = A * scales / scales[:, None], B / scales[:, None], scales[:, None] * Q * scales
    doublings = max(int(np.ceil(np.log2(max(np.linalg.norm(A, 2) * dt, 1.0)))), 0)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = sampled_cost(A, B, Q, R, dt / 2**doublings)
        for _ in range(doublings):
            cost = _doubled(cost)
    if not all(np.isfinite(M).all() for M in cost):
        raise NumericalError(
            f"the fastest mode of A, {np.abs(np.linalg.eigvals(A)).max():.4g} rad/s, has too many time constants in "
            f"dt = {dt:g} s for an exponential; pass a shorter period, or a model without that mode"
        )
    K, S, E = dlqr(cost.F, cost.G, (cost.Q + cost.Q.T) / 2, (cost.R + cost.R.T) / 2, cost.N)
    return K / scales, S / scales / scales[:, None], E


def sampled_cost(A: Any, B: Any, Q: Any, R: Any, dt: Any, *, xp: Any = np, expm: Any = sla.expm) -> SampledCost:
    """Model and cost of one period `dt` s with the command held, by one exponential (Van Loan).

    With M = [[A, B], [0, 0]] and W = diag(Q, R):  exp([[-M', W], [0, M]] dt) = [[., X], [0, e^M dt]], and the integral
    of e^M't W e^Mt over the period is (e^M dt)' X. Traceable with `jax.numpy` and its `expm`.
    It loses digits where modes of A decay within a small part of the period: `lqrd` doubles a short one.
    """
    n, m = B.shape
    M = xp.block([[A, B], [xp.zeros((m, n + m))]])
    W = xp.block([[Q, xp.zeros((n, m))], [xp.zeros((m, n)), R]])
    E = expm(xp.block([[-M.T, W], [xp.zeros((n + m, n + m)), M]]) * dt)
    end = E[n + m :, n + m :]
    J = end.T @ E[: n + m, n + m :]
    return SampledCost(end[:n, :n], end[:n, n:], J[:n, :n], J[n:, n:], J[:n, n:])


def _doubled(cost: SampledCost) -> SampledCost:
    """Model and cost of two periods with the same command: exact where one exponential loses the fast modes."""
    F, G, Q, R, N = cost
    return SampledCost(
        F @ F, F @ G + G, Q + F.T @ Q @ F, 2 * R + G.T @ Q @ G + G.T @ N + N.T @ G, N + F.T @ (Q @ G + N)
    )


def lqg(G: Any, QXU: Any, QWV: Any) -> StateSpace:
    """Controller u = K y (positive feedback, as MATLAB's) of least expected cost: Kalman filter and regulator.

        dx = A x + B u + w,  y = C x + D u + v      (x+ for dx in discrete time)

    Parameters
    ----------
    G : (p x m) plant, in any form that `synth.system` takes
    QXU : (n + m, n + m) weight of [x; u], symmetric positive semidefinite, its lower right block positive definite
    QWV : (n + p, n + p) covariance (discrete) or intensity (continuous) of [w; v], likewise

    Returns
    -------
    StateSpace : (m x p), of the order of G; in discrete time u depends on the measurements before the present one

    Raises
    ------
    ModelError, AssumptionError, NumericalError : as `lqr`, for G or for its dual.
    """
    G = as_system("G", G)
    n, m, p = G.n, G.nu, G.ny
    check_dynamic("G", G)
    W, V = as_cost("QXU", QXU, n + m), as_cost("QWV", QWV, n + p)
    as_cost("the block of u in QXU", W[n:, n:], m, definite=True)
    as_cost("the block of v in QWV", V[n:, n:], p, definite=True)
    K = _regulator(G, W[:n, :n], W[n:, n:], W[:n, n:], discrete=G.discrete)[0]
    dual = StateSpace(G.A.T, G.C.T, G.B.T, G.D.T, G.dt)
    L = _regulator(dual, V[:n, :n], V[n:, n:], V[:n, n:], discrete=G.discrete)[0].T
    return StateSpace(G.A - G.B @ K - L @ (G.C - G.D @ K), L, -K, np.zeros((m, p)), G.dt)


def _regulator(G: StateSpace, Q: Any, R: Any, N: Any, *, discrete: bool) -> Gains:
    """`lqr` or `dlqr`."""
    A, B, n, m = G.A, G.B, G.n, G.nu
    N = as_matrix("N", np.zeros((n, m)) if N is None else N, (n, m))
    Q, R = as_cost("Q", Q, n), as_cost("R", R, m, definite=True)
    as_cost("[[Q, N], [N', R]]", np.block([[Q, N], [N.T, R]]), n + m)
    if n == 0:
        raise ModelError("A has no states; there is nothing to regulate")
    scales = _scales(A, B, Q)
    A, B, Q, N = A * scales / scales[:, None], B / scales[:, None], scales[:, None] * Q * scales, scales[:, None] * N
    _check_stabilisable(A, B, discrete)
    F = np.linalg.solve(R, N.T)
    _check_seen(A - B @ F, Q - N @ F, discrete)
    try:
        if discrete:
            S = sla.solve_discrete_are(A, B, Q, R, s=N)
            K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A + N.T)
        else:
            S = sla.solve_continuous_are(A, B, Q, R, s=N)
            K = np.linalg.solve(R, B.T @ S + N.T)
    except np.linalg.LinAlgError as error:
        raise NumericalError(
            f"the Riccati equation was not solved ({error}); rescale the states or the weights"
        ) from None
    E = np.linalg.eigvals(A - B @ K).astype(complex)
    if (np.abs(E).max() >= 1) if discrete else (E.real.max() >= 0):
        raise NumericalError(
            f"the regulator found leaves a pole at {E[np.argmax(np.abs(E) if discrete else E.real)]:.6g}: the weights "
            "hardly see it or the actuators hardly move it; rescale the states or change the weights"
        )
    return K / scales, (S + S.T) / 2 / scales / scales[:, None], E


def _scales(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Powers of two, (n,), x = scales x_new, for which states are of like size; going back is exact."""
    return state_scales(Matrices(A, B, np.diag(np.sqrt(np.maximum(np.diag(Q), 0.0))), np.zeros((len(A), B.shape[1]))))


def _check_stabilisable(A, B, discrete: bool) -> None:
    """Raise AssumptionError unless (A, B) can be stabilised."""
    n, m = B.shape
    I, O = np.eye(n), np.zeros
    try:
        check_assumptions(
            GeneralizedPlant(
                A=A, B1=I, B2=B, C1=I, D11=O((n, n)), D12=O((n, m)), C2=I, D21=O((n, n)), D22=O((n, m)),
                dt=1.0 if discrete else 0.0,
            )
        )  # fmt: skip
    except AssumptionError as error:
        raise AssumptionError("(A, B) stabilisable", str(error), error.modes) from None


def _check_seen(A, Q, discrete: bool) -> None:
    """Raise AssumptionError for a mode on the stability boundary that Q does not see."""
    size, weight = np.linalg.norm(A, 2) or 1.0, np.linalg.norm(Q, 2) or 1.0
    for mode in np.linalg.eigvals(A):
        off = abs(abs(mode) - 1) if discrete else abs(mode.real) / size
        pencil = np.vstack([(A - mode * np.eye(len(A))) / size, Q / weight])
        if off < UNSEEN and np.linalg.svd(pencil, compute_uv=False)[-1] < UNSEEN:
            raise AssumptionError(
                "(Q, A) without unseen modes on the stability boundary",
                f"Q does not see the mode at eigenvalue {mode:.6g} of A, which neither decays nor grows, so that the "
                "best regulator leaves it there; give it some weight",
                (complex(mode),),
            )
