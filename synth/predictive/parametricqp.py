"""Quadratic programs whose vectors are affine in measured data: taken out of CVXPY once, solved many times.

    minimise  v'Pv/2 + f'v   subject to  lower <= [v; A v] <= upper,      [f; upper] = offset + slope phi

`canonicalise` reads the matrices off the program CVXPY hands to its solver. `ParametricQp.solve` answers with the dual
active-set method DAQP (Arnstrom, Bemporad and Axehill 2022, doi 10.1109/TAC.2022.3176430). Every answer is checked by
its residuals (`synth.predictive.optimality`). If DAQP gives up or fails the check, Clarabel's interior-point method
names the active rows, on which the program is solved again and checked likewise; if that fails too, whoever posed the
program may know how to solve it in longer arithmetic.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import daqp
import numpy as np

from synth.errors import NumericalError
from synth.predictive.optimality import Optimality

if TYPE_CHECKING:
    import cvxpy as cp

# The program is to be scaled to unit variables. No regularisation: the Hessian is to be positive definite.
DAQP_SETTINGS = {"primal_tol": 1e-10, "eps_prox": 0.0}
# (phi, rows that are likely to be active or None) -> the optimum v in long arithmetic; raises NumericalError
Exactly = Callable[[np.ndarray, np.ndarray | None], np.ndarray]
ACCURACY = 1e-8  # bound of the error with which an optimum is accepted, in units of each variable
# As tight as double precision carries: the optimum of a flat objective is far less exact than its value.
CLARABEL_SETTINGS = {
    "tol_gap_abs": 1e-16,
    "tol_gap_rel": 1e-14,
    "tol_feas": 1e-14,
    "reduced_tol_gap_abs": 1e-10,
    "reduced_tol_gap_rel": 1e-10,
    "reduced_tol_feas": 1e-10,
    "static_regularization_constant": 1e-14,
}


class Solution(NamedTuple):
    """An optimum of a `ParametricQp`."""

    v: np.ndarray  # (N,) variables
    multipliers: np.ndarray  # (N + M,) positive at an upper limit, negative at a lower one; (0,) of an exact solution
    active: np.ndarray  # (N + M,) where the next solve starts: 1 at an upper limit, 3 at a lower one, as DAQP has it
    solver: str  # whose it is: "daqp", "clarabel" or "exact"


@dataclass(frozen=True, eq=False)
class ParametricQp:
    """The program in N variables, of which N + M rows are limited: the variables, then the rows of A.

    `solve` is a function of its arguments alone, to the last bit: DAQP starts from the working set it is given. The
    object keeps DAQP's memory as a scratch pad, one for each thread that solves; copies and pickles get their own.

    Raises
    ------
    NumericalError : the Hessian is not positive definite in double precision.
    """

    P: np.ndarray  # (N, N)
    A: np.ndarray  # (M, N)
    lower: np.ndarray  # (N + M,)
    offset: np.ndarray  # (2 N + M,)
    slope: np.ndarray  # (2 N + M, parameters)
    exact: Exactly | None = None  # the last resort, to be picklable
    used: int | None = None  # number of leading variables that the caller uses and that are checked; all unless given
    scratch: threading.local = field(init=False, repr=False, default_factory=threading.local)

    def __post_init__(self):
        self.scratch.daqp, self.scratch.optimality = self.workspace()

    def workspace(self) -> tuple[daqp.Model, Optimality]:
        """DAQP's memory for this program, and the check's."""
        N = self.P.shape[0]
        model = daqp.Model()
        flag, _ = model.setup(self.P, self.offset[:N], self.A, self.offset[N:], self.lower, self.cold_start())
        try:
            optimality = Optimality(self.P, self.A, self.lower, self.used or N) if flag >= 0 else None
        except np.linalg.LinAlgError:
            optimality = None
        if optimality is None:
            raise NumericalError(
                f"the program is refused: the condition number of its Hessian is {np.linalg.cond(self.P):.1e};"
                " weigh each variable enough to tell them apart",
                {"daqp": str(flag)},
            )
        model.settings = DAQP_SETTINGS
        return model, optimality

    def __reduce__(self):
        return type(self), (self.P, self.A, self.lower, self.offset, self.slope, self.exact, self.used)

    def cold_start(self) -> np.ndarray:
        """The empty working set, (N + M,)."""
        return np.zeros(self.lower.size, dtype=np.intc)

    def vectors(self, phi: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(f, upper) at the parameters `phi`."""
        both, N = self.slope.dot(phi), self.P.shape[0]
        both += self.offset
        return both[:N], both[N:]

    def solve(self, phi: np.ndarray, active: np.ndarray) -> Solution:
        """The optimum for the parameters `phi`, to `ACCURACY`: by DAQP from the working set `active`, else again.

        Raises
        ------
        NumericalError : no route leads to an optimum that passes the check; the statuses say how.
        """
        f, upper = self.vectors(phi)
        solution, status = self.solve_daqp(f, upper, active)
        return solution or self.solve_again(phi, f, upper, {"daqp": status})

    def solve_daqp(self, f: np.ndarray, upper: np.ndarray, active: np.ndarray) -> tuple[Solution | None, str]:
        """The optimum by DAQP, or None and why there is none."""
        try:
            model, optimality = self.scratch.daqp, self.scratch.optimality
        except AttributeError:  # the first solve in this thread
            model, optimality = self.scratch.daqp, self.scratch.optimality = self.workspace()
        flag = model.update(f=f, bupper=upper, sense=active)
        if flag:
            return None, str(flag)
        v, _, flag, info = model.solve()
        if flag != 1:
            return None, str(flag)
        y = info["lam"]
        if not math.isfinite(v.sum() + y.sum()):
            return None, "no numbers"
        error, active = optimality.error(v, y, f, upper)
        if not error <= ACCURACY:
            error = optimality.rounding(v, y, f, upper)
        return (Solution(v, y, active, "daqp"), "") if error <= ACCURACY else (None, f"error up to {error:.1e}")

    def solve_again(self, phi: np.ndarray, f: np.ndarray, upper: np.ndarray, statuses: dict[str, str]) -> Solution:
        """The optimum by Clarabel or in long arithmetic, after DAQP ended with `statuses`; raises as `solve`."""
        v, y, status = self.solve_clarabel(f, upper)
        if status in ("Solved", "AlmostSolved"):
            optimality = self.scratch.optimality
            for w, prices in (*optimality.refined(v, y, f, upper), (v, y)):
                error = optimality.rounding(w, prices, f, upper)
                if error <= ACCURACY:
                    return Solution(w, prices, self.cold_start(), "clarabel")
                status += f", error up to {error:.1e}"
        return self.solve_exactly(phi, statuses | {"clarabel": status})

    def solve_exactly(self, phi: np.ndarray, statuses: dict[str, str]) -> Solution:
        """The optimum in long arithmetic, after the others ended with `statuses`; raises as `solve`."""
        if self.exact is None:
            raise NumericalError("neither DAQP nor Clarabel solved the program", statuses)
        try:
            return Solution(self.exact(phi, self.likely(phi)), np.zeros(0), self.cold_start(), "exact")
        except NumericalError as error:
            statuses = statuses | {"exact": str(error)}
            raise NumericalError(
                "the program was solved neither in doubles nor in long arithmetic", statuses
            ) from error

    def likely(self, phi: np.ndarray) -> np.ndarray | None:
        """Signs of the rows that are likely to be active, (N + M,), where there is a cheap guess."""
        return None

    def solve_clarabel(self, f: np.ndarray, upper: np.ndarray) -> tuple[np.ndarray, np.ndarray, str]:
        """(v, multipliers, status) by an interior-point method."""
        import clarabel
        import scipy.sparse as sp

        above, below = np.isfinite(upper), np.isfinite(self.lower)
        rows = np.vstack([np.eye(f.size), self.A])
        b = np.concatenate([upper[above], -self.lower[below]])
        settings = clarabel.DefaultSettings()  # pyright: ignore[reportAttributeAccessIssue]
        settings.verbose = False
        for name, value in CLARABEL_SETTINGS.items():
            setattr(settings, name, value)
        cones = [clarabel.NonnegativeConeT(b.size)]  # pyright: ignore[reportAttributeAccessIssue]
        solver = clarabel.DefaultSolver(  # pyright: ignore[reportAttributeAccessIssue]
            sp.csc_array(np.triu(self.P)), f, sp.csc_array(np.vstack([rows[above], -rows[below]])), b, cones, settings
        )
        try:
            solution = solver.solve()
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a panic of Clarabel is no Exception
            return f, np.zeros(upper.size), f"{type(error).__name__}: {error}"
        x, z, y = np.asarray(solution.x), np.asarray(solution.z), np.zeros(upper.size)
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            return f, y, f"{solution.status} without numbers"
        y[above] += z[: above.sum()]
        y[below] -= z[above.sum() :]
        return x, y, str(solution.status)


def canonicalise(
    problem: cp.Problem,
    phi: cp.Parameter,
    variables: list[cp.Variable],
    exact: Exactly | None = None,
    used: int | None = None,
) -> ParametricQp:
    """The quadratic program in `variables`, all others eliminated by the equality constraints that define them.

    Read off at phi = 0 and at each unit vector, then checked at another point.

    Parameters
    ----------
    problem : a quadratic program whose only parameter is the vector `phi`
    variables : vectors without attributes that determine all others through equality constraints
    exact : solves the same program in long arithmetic, if there is such a way
    used : number of leading variables whose error counts; all unless given

    Raises
    ------
    NumericalError : the program's matrices depend on `phi`, its vectors do so in a way that is not affine, or the
        equality constraints do not determine the other variables.
    """

    def reduced(value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P, A, [f; b]) of: minimise v'Pv/2 + f'v subject to A v <= b."""
        phi.value = value
        data = problem.get_problem_data("CLARABEL")[0]
        P, c, W, b = data["P"].toarray(), data["c"], data["A"].toarray(), data["b"]
        columns = data["param_prob"].var_id_to_col
        own = np.concatenate([columns[v.id] + np.arange(v.size) for v in variables])
        other = np.setdiff1d(np.arange(c.size), own)
        equal, below = slice(0, data["dims"].zero), slice(data["dims"].zero, None)
        if data["dims"].zero != other.size:
            raise NumericalError(
                f"{data['dims'].zero} equations for {other.size} dependent variables: they are not determined"
            )
        solved = np.linalg.solve(W[equal, other], np.column_stack([W[equal, own], b[equal]]))
        N, w0 = np.zeros((c.size, own.size)), np.zeros(c.size)  # all variables: w = N v + w0
        N[own], N[other], w0[other] = np.eye(own.size), -solved[:, :-1], solved[:, -1]
        return N.T @ P @ N, W[below] @ N, np.concatenate([N.T @ (P @ w0 + c), b[below] - W[below] @ w0])

    P, A, offset = reduced(np.zeros(phi.size))
    slope = np.column_stack([reduced(e)[2] - offset for e in np.eye(phi.size)])
    probe = np.random.default_rng(0).standard_normal(phi.size)
    P1, A1, both = reduced(probe)
    scale = np.max(np.abs(offset) + np.abs(slope) @ np.abs(probe))
    affine = np.abs(both - offset - slope @ probe).max() <= 1e-9 * scale
    if not (np.array_equal(P, P1) and np.array_equal(A, A1) and affine):
        raise NumericalError("CVXPY's program is not affine in its parameter: check the scale of the data")
    return split_bounds((P + P.T) / 2, A, offset, slope, exact, used)


def split_bounds(
    P: np.ndarray,
    A: np.ndarray,
    offset: np.ndarray,
    slope: np.ndarray,
    exact: Exactly | None = None,
    used: int | None = None,
) -> ParametricQp:
    """Rows that bound one variable by a constant become bounds of that variable."""
    N = P.shape[0]
    simple = (np.count_nonzero(A, axis=1) == 1) & ~slope[N:].any(axis=1)
    lower, upper = np.full(N, -np.inf), np.full(N, np.inf)
    for row, b in zip(A[simple], offset[N:][simple], strict=True):
        i = int(np.flatnonzero(row)[0])
        if row[i] > 0:
            upper[i] = min(upper[i], b / row[i])
        else:
            lower[i] = max(lower[i], b / row[i])
    rest = ~simple
    return ParametricQp(
        P=P,
        A=np.ascontiguousarray(A[rest]),
        lower=np.concatenate([lower, np.full(rest.sum(), -np.inf)]),
        offset=np.concatenate([offset[:N], upper, offset[N:][rest]]),
        slope=np.vstack([slope[:N], np.zeros((N, slope.shape[1])), slope[N:][rest]]),
        exact=exact,
        used=used,
    )
