"""Linear-quadratic regulators `lqr`, `dlqr`, `lqrd`, `lqg`, with the names and returns of python-control and MATLAB.

Every gain is checked on the data given: its Riccati equation, the stability of its loop for all that rounding may have
done, and how much the data's own rounding moves it (`synth.equations.refinement`). Why there is none is asked after a
failure only (`synth.regulators.diagnosis`).

References: Anderson and Moore (1990), Optimal Control: Linear Quadratic Methods; Zhou, Doyle and Glover (1996), Robust
and Optimal Control, chapter 13; Van Loan (1978), IEEE TAC 23, 395 (the integrals of a sampled cost).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, overload

import numpy as np

from synth.checks import as_array, as_cost, as_matrix, as_number, as_symmetric
from synth.equations.are import check_descriptor, is_definite, solve
from synth.equations.refinement import Equation, Judged
from synth.errors import ModelError, NumericalError
from synth.regulators.diagnosis import failure
from synth.systems.connect import check_dynamic
from synth.systems.exponential import expm as exponential
from synth.systems.realization import Matrices, state_scales
from synth.systems.statespace import StateSpace, as_system


class Regulator(tuple[np.ndarray, np.ndarray, np.ndarray]):
    """K, S, E of a regulator u = -K x, with what was measured of them.

    Attributes
    ----------
    K : (m, n) gain; S : (n, n) solution of the Riccati equation; E : (n,) closed-loop poles, complex
    residual : of the Riccati equation on the data given, an entry relative to the sum of the moduli of its terms; units
        of states and commands do not change it
    condition : relative change of S for the worst relative change of the data by as much, entry by entry, to first
        order, in the norm of balanced states; S has about log10(1e16 / condition) digits
    """

    _judge: Callable[[], Judged]

    def __new__(cls, K: np.ndarray, S: np.ndarray, E: np.ndarray, judge: Callable[[], Judged]) -> Regulator:  # noqa: D102
        self = super().__new__(cls, (K, S, E))
        self._judge = judge
        return self

    K = property(lambda self: self[0])
    S = property(lambda self: self[1])
    E = property(lambda self: self[2])
    residual = property(lambda self: float(self._judged.residual))
    condition = property(lambda self: float(self._judged.condition))

    @cached_property
    def _judged(self) -> Judged:
        return self._judge()

    def __reduce__(self) -> tuple[Any, ...]:
        return _regulator_of, (*self, *self._judged)


def _regulator_of(K: np.ndarray, S: np.ndarray, E: np.ndarray, *measured: float) -> Regulator:
    """A regulator from its parts."""
    return Regulator(K, S, E, lambda: Judged(*measured))


@overload
def lqr(A: Any, B: Any, Q: Any, R: Any, N: Any = None, *, E: Any = None) -> Regulator: ...
@overload
def lqr(sys: Any, Q: Any, R: Any, N: Any = None, /, *, E: Any = None) -> Regulator: ...
def lqr(*arguments: Any, E: Any = None, **named: Any) -> Regulator:
    """Regulator u = -K x that minimises the integral of x'Q x + u'R u + 2 x'N u along E dx = A x + B u.

    Called as lqr(A, B, Q, R[, N]) or lqr(sys, Q, R[, N]); for a discrete `sys` it is `dlqr`.

    Parameters
    ----------
    A : (n, n); B : (n, m), a list is a column; sys : a system in any form that `synth.system` takes
    Q : (n, n) symmetric; of all weights a number stands for that multiple of the identity, a list for a diagonal. It
        may be indefinite where the cost of motions that come to rest is bounded below nevertheless
    R : (m, m) symmetric positive definite
    N : (n, m) cross weight; zero when left out
    E : (n, n) invertible, by name only; the identity when left out

    Returns
    -------
    Regulator : unpacks to K, S, E and carries `residual` and `condition`
        K : (m, n) gain
        S : (n, n) stabilising solution of A'S E + E'S A - (E'S B + N) R^-1 (E'S B + N)' + Q = 0
        E : (n,) closed-loop poles, complex

    Raises
    ------
    ModelError : shapes do not fit, a number is not finite, Q or R is not symmetric, R not positive, E singular.
    AssumptionError : (A, B) cannot be stabilised, semidefinite weights do not see a mode on the imaginary axis, or
        indefinite ones leave the cost unbounded.
    NumericalError : no stabilising solution was found, or none whose residual is small; names both.

    Examples
    --------
    >>> from synth import lqr
    >>> K, S, E = lqr([[0, 1], [0, 0]], [0, 1], [1, 0], 1)
    >>> K.round(6).tolist()
    [[1.0, 1.414214]]
    """
    given = _arguments("lqr", ("Q", "R", "N"), arguments, named)
    Q, R, N = given.weights
    return _regulator(given.A, given.B, Q, R, N, E, discrete=bool(given.dt))


@overload
def dlqr(A: Any, B: Any, Q: Any, R: Any, N: Any = None, *, E: Any = None) -> Regulator: ...
@overload
def dlqr(sys: Any, Q: Any, R: Any, N: Any = None, /, *, E: Any = None) -> Regulator: ...
def dlqr(*arguments: Any, E: Any = None, **named: Any) -> Regulator:
    """Regulator u = -K x that minimises the sum of x'Q x + u'R u + 2 x'N u along E x+ = A x + B u.

    Called as dlqr(A, B, Q, R[, N]) or dlqr(sys, Q, R[, N]). Parameters, returns and raises as `lqr`, with
    E'S E = A'S A - (A'S B + N) (R + B'S B)^-1 (A'S B + N)' + Q and the unit circle for the imaginary axis. R may be
    singular, zero or indefinite where R + B'S B is positive definite.
    """
    given = _arguments("dlqr", ("Q", "R", "N"), arguments, named)
    if given.dt == 0:
        raise ModelError("sys is continuous; pass a discrete system (c2d), or call lqr")
    Q, R, N = given.weights
    return _regulator(given.A, given.B, Q, R, N, E, discrete=True)


class Given(NamedTuple):
    """The arguments of a regulator."""

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    dt: float | None  # s, 0 in continuous time; None where no system was given
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
        G = as_system("sys", found["sys"])
        return Given(G.A, G.B, G.dt, weights)
    A, B = as_matrix("A", found["A"]), as_array("B", found["B"], "pass a real matrix, states x inputs")
    B = as_matrix("B", B.reshape(-1, 1) if B.ndim < 2 and len(A) > 1 else B)
    n = len(B)
    if A.shape != (n, n):
        raise ModelError(f"A is {A.shape[0]} x {A.shape[1]} where {n} x {n} is needed for B, which has {n} rows")
    return Given(A, B, None, weights)


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
def lqrd(A: Any, B: Any, Q: Any, R: Any, dt: Any, N: Any = None) -> Regulator: ...
@overload
def lqrd(sys: Any, Q: Any, R: Any, dt: Any, N: Any = None, /) -> Regulator: ...
def lqrd(*arguments: Any, **named: Any) -> Regulator:
    """Regulator u = -K x, held for `dt` s, that minimises the integral of x'Q x + u'R u + 2 x'N u, dx = A x + B u.

    Called as lqrd(A, B, Q, R, dt[, N]) or lqrd(sys, Q, R, dt[, N]); N comes last, where MATLAB has it before dt.
    The continuous gain of `lqr` under a hold can be unstable: it suits periods well below its fastest time constant.

    Parameters
    ----------
    A, B, sys, Q, R, N : as in `lqr`
    dt : () s, control period, positive

    Returns
    -------
    K, S, E : as of `dlqr`, for the sampled model and the cost between the samples: x'S x is the integral from x on

    Raises
    ------
    ModelError, AssumptionError, NumericalError : as `lqr`; also for a period that loses stabilisability.
    """
    given = _arguments("lqrd", ("Q", "R", "dt", "N"), arguments, named)
    if given.dt:
        raise ModelError(f"sys has dt = {given.dt}; lqrd samples a continuous system itself")
    A, B, (n, m) = given.A, given.B, given.B.shape
    Q, R = as_symmetric("Q", given.weights[0], n), as_cost("R", given.weights[1], m, definite=True)
    dt = as_number("dt", given.weights[2], "the control period in seconds", above=0)
    N = np.zeros((n, m)) if given.weights[3] is None else as_matrix("N", given.weights[3], (n, m))
    scales = _scales(A, B, Q)
    A, B, Q, N = A * scales / scales[:, None], B / scales[:, None], scales[:, None] * Q * scales, scales[:, None] * N
    found = regulated(cost_of_a_period(A, B, Q, R, N, dt))
    K, S, E = found
    return Regulator(K / scales, S / scales / scales[:, None], E, lambda: found._judged)


def regulated(cost: SampledCost) -> Regulator:
    """The regulator of a sampled model and cost."""
    Q, R = (cost.Q + cost.Q.T) / 2, (cost.R + cost.R.T) / 2
    return _regulator(cost.F, cost.G, Q, R, cost.N, None, discrete=True)


def cost_of_a_period(A: np.ndarray, B: np.ndarray, Q: Any, R: Any, N: Any, dt: float) -> SampledCost:
    """`sampled_cost` for modes of any speed, from balanced matrices.

    Raises
    ------
    NumericalError : an unstable mode has too many time constants in a period.
    """
    doublings = max(int(np.ceil(np.log2(max(np.linalg.norm(A, 2) * dt, 1.0)))), 0)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = sampled_cost(A, B, Q, R, dt / 2**doublings, N=N)
        for _ in range(doublings):
            cost = _doubled(cost)
    if not all(np.isfinite(M).all() for M in cost):
        raise NumericalError(
            f"the fastest mode of A, {np.abs(np.linalg.eigvals(A)).max():.4g} rad/s, has too many time constants in "
            f"dt = {dt:g} s for an exponential; pass a shorter period, or a model without that mode"
        )
    return cost


def sampled_cost(
    A: Any, B: Any, Q: Any, R: Any, dt: Any, *, N: Any = None, xp: Any = np, expm: Any = exponential
) -> SampledCost:
    """Model and cost of one period `dt` s with the command held, by one exponential (Van Loan).

    With M = [[A, B], [0, 0]] and W = [[Q, N], [N', R]]:  exp([[-M', W], [0, M]] dt) = [[., X], [0, e^M dt]], and
    the integral of e^M't W e^Mt over the period is (e^M dt)' X. Traceable with `jax.numpy` and its `expm`, which gives
    up on large exponents: commands and costs have units in which B and W are no larger than A. It loses digits where
    modes of A decay within a small part of the period: `lqrd` doubles a short one.
    """
    n, m = B.shape
    N = xp.zeros((n, m)) if N is None else N
    longest = xp.maximum(_largest(A, xp) * dt, 1.0)
    b = 1 / binary(_largest(B, xp) * dt / longest, xp)  # unit of u
    M = xp.block([[A, b * B], [xp.zeros((m, n + m))]])
    W = xp.block([[Q, b * N], [b * N.T, b * b * R]])
    w = binary(_largest(W, xp) * dt / longest, xp)  # unit of the cost
    E = expm(xp.block([[-M.T, W / w], [xp.zeros((n + m, n + m)), M]]) * dt)
    end = E[n + m :, n + m :]
    J = w * (end.T @ E[: n + m, n + m :])
    return SampledCost(end[:n, :n], end[:n, n:] / b, J[:n, :n], J[n:, n:] / (b * b), J[:n, n:] / b)


def _largest(M: Any, xp: Any) -> Any:
    """Of the entries' moduli, 0 where there are none."""
    return xp.max(xp.abs(M), initial=0.0)


def binary(x: Any, xp: Any) -> Any:
    """The power of two next to x, 1 where there is none: units changed by it change no bits."""
    x = xp.where((x > 0) & (x < np.inf), x, 1.0)
    return xp.ldexp(1.0, xp.round(xp.log2(x)).astype(int))


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
    K = _regulator(G.A, G.B, W[:n, :n], W[n:, n:], W[:n, n:], None, discrete=G.discrete)[0]
    L = _regulator(G.A.T, G.C.T, V[:n, :n], V[n:, n:], V[:n, n:], None, discrete=G.discrete)[0].T
    return StateSpace(G.A - G.B @ K - L @ (G.C - G.D @ K), L, -K, np.zeros((m, p)), G.dt)


def _regulator(A: Any, B: Any, Q: Any, R: Any, N: Any, E: Any, *, discrete: bool) -> Regulator:
    """`lqr` or `dlqr`."""
    n, m = B.shape
    if n == 0:
        raise ModelError("A has no states; there is nothing to regulate")
    Q, R = as_symmetric("Q", Q, n), as_symmetric("R", R, m)
    if not discrete and not is_definite(R):
        as_cost("R", R, m, definite=True)  # which names the eigenvalue
        raise ModelError("R is not positive definite to rounding; every command must cost something")
    N = np.zeros((n, m)) if N is None else as_matrix("N", N, (n, m))
    if E is not None:
        E = as_matrix("E", E, (n, n))
        check_descriptor(E)
    equation = Equation(A, B, Q, R, N, E, discrete)
    found = solve(equation)
    if not found.ok or (discrete and not is_definite(R + B.T @ found.X @ B)):
        raise failure(equation, found)
    return Regulator(found.K, found.X, found.poles, found.judge)


def _scales(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Powers of two, (n,), x = scales x_new, for which states are of like size; going back is exact."""
    return state_scales(Matrices(A, B, np.diag(np.sqrt(np.abs(np.diag(Q)))), np.zeros((len(A), B.shape[1]))))
