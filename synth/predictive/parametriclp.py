"""Linear programs whose right-hand side is measured data: taken out of CVXPY once, solved many times by HiGHS.

    minimise  c'v   subject to   A v <= room,   lower <= v <= upper

`canonicalise` reads c, A and the limits off the cone program that CVXPY makes of it. `ParametricLp.solve` starts the
dual simplex method of HiGHS (Huangfu and Hall 2018, doi 10.1007/s12532-017-0130-5) from the basis of the solve before:
a change of the right-hand side leaves that basis dual feasible, so a few pivots are enough. Every optimum is checked.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import highspy
import numpy as np
import scipy.sparse as sp

from synth.errors import NumericalError

if TYPE_CHECKING:
    import cvxpy as cp

# One thread: the programs are small. No presolve: it would throw away the basis.
HIGHS_OPTIONS = {"output_flag": False, "threads": 1, "solver": "simplex", "presolve": "off",
    "primal_feasibility_tolerance": 1e-9, "dual_feasibility_tolerance": 1e-9}  # fmt: skip

ACCURACY = (
    1e-6  # of an optimum: beyond its limits relative to 1 + the limit, above the optimal cost relative to 1 + the cost
)


class LpSolution(NamedTuple):
    """An optimum of a `ParametricLp`."""

    v: np.ndarray  # (N,) variables
    objective: float
    basis: Any  # of HiGHS, where the next solve starts
    iterations: int  # pivots


@dataclass(frozen=True, eq=False)
class ParametricLp:
    """The program in N variables and M rows.

    `solve` is a function of its arguments alone: HiGHS starts from the basis it is given and from nothing else. The
    object keeps HiGHS's memory as a scratch pad, one for each thread that solves; copies and pickles get their own.
    """

    c: np.ndarray  # (N,)
    A: np.ndarray  # (M, N)
    lower: np.ndarray  # (N,)
    upper: np.ndarray  # (N,)
    scratch: threading.local = field(init=False, repr=False, default_factory=threading.local)

    def __reduce__(self):
        return ParametricLp, (self.c, self.A, self.lower, self.upper)

    def workspace(self) -> Any:
        """HiGHS with this program and no right-hand side yet."""
        A: Any = sp.csc_array(self.A)
        M, N = A.shape
        model: Any = highspy.HighsLp()
        model.num_col_, model.num_row_ = N, M
        model.col_cost_, model.col_lower_, model.col_upper_ = self.c, self.lower, self.upper
        model.row_lower_, model.row_upper_ = np.full(M, -np.inf), np.full(M, np.inf)
        model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        model.a_matrix_.start_, model.a_matrix_.index_ = A.indptr, A.indices
        model.a_matrix_.value_ = A.data
        highs: Any = highspy.Highs()
        for name, value in HIGHS_OPTIONS.items():
            highs.setOptionValue(name, value)
        if highs.passModel(model) == highspy.HighsStatus.kError:
            raise NumericalError("HiGHS rejects the program; check the scale of its data", {"highs": "rejected"})
        return highs

    def solve(self, room: np.ndarray, basis: Any = None) -> LpSolution:
        """The optimum for the right-hand side `room` (M,), inf where a row is free, from `basis` or from none.

        What comes of a basis and is no optimum, or does not pass the check, is solved again from none.

        Raises
        ------
        NumericalError : HiGHS ends with anything but an optimum, or with one that does not pass the check.
        """
        try:
            highs = self.scratch.highs
        except AttributeError:  # the first solve in this thread
            highs = self.scratch.highs = self.workspace()
        M = room.size
        highs.changeRowsBounds(M, np.arange(M, dtype=np.int32), np.full(M, -np.inf), room)
        highs.clearSolver()
        if basis is not None:
            highs.setBasis(basis)
        highs.run()
        status = highs.getModelStatus()
        if status != highspy.HighsModelStatus.kOptimal:
            if basis is not None:
                return self.solve(room)
            word = highs.modelStatusToString(status)
            raise NumericalError(f"HiGHS ended with {word!r}", {"highs": word})
        info, solution = highs.getInfo(), highs.getSolution()
        v, prices = np.array(solution.col_value), np.array(solution.row_dual)
        error = self.error(v, prices, room)
        if not error <= ACCURACY:  # HiGHS' prices are not exact where rows are scaled far apart
            error = self._against_another(v, room)
        if not error <= ACCURACY:
            if basis is not None:  # nearly singular, and its digits are lost
                return self.solve(room)
            raise NumericalError(f"HiGHS calls optimal what is off by {error:.1e}", {"highs": f"off by {error:.1e}"})
        return LpSolution(
            v,
            info.objective_function_value,
            highs.getBasis(),
            info.simplex_iteration_count,
        )

    def _against_another(self, v: np.ndarray, room: np.ndarray) -> float:
        """How far `v` is beyond its limits, or its cost above that of another solve, from scratch and by SciPy."""
        from scipy.optimize import linprog

        if not np.isfinite(v).all():
            return np.inf
        counts = np.isfinite(room)
        rows = sp.csr_array(self.A)[np.flatnonzero(counts)]
        found = linprog(self.c, rows, room[counts], bounds=np.column_stack([self.lower, self.upper]), method="highs-ds")
        if found.status != 0:
            return np.inf
        cost = self.c @ v
        return float(np.maximum(self._beyond(v, room), (cost - found.fun) / (1.0 + abs(cost))))

    def _beyond(self, v: np.ndarray, room: np.ndarray) -> float:
        """How far `v` is beyond its limits, those of the rows relative to 1 + |room|."""
        counts = np.isfinite(room)
        rows = (self.A @ v - room)[counts] / (1.0 + np.abs(room[counts]))
        return float(np.concatenate([rows, v - self.upper, self.lower - v]).max())

    def error(self, v: np.ndarray, prices: np.ndarray, room: np.ndarray) -> float:
        """How far `v` is beyond its limits, or its cost above the bound that `prices` (M,) give; inf if no numbers.

        Weak duality: c'v >= prices'room + (c - A'prices)'v at the lesser limits, for prices of at most 0.
        """
        if not (np.isfinite(v).all() and np.isfinite(prices).all()):
            return np.inf
        counts = np.isfinite(room)
        prices = np.where(counts, np.minimum(prices, 0.0), 0.0)
        left = self.c - self.A.T @ prices
        limit = np.where(left > 0, self.lower, self.upper)
        free = ~np.isfinite(limit)  # of a limit: there nothing may be left
        cost = self.c @ v
        gap = cost - prices[counts] @ room[counts] - left[~free] @ limit[~free]
        beyond = max(self._beyond(v, room), np.abs(left[free]).max(initial=0.0))
        return float(np.maximum(beyond, gap / (1.0 + abs(cost))))


def canonicalise(problem: cp.Problem, room: cp.Parameter, variables: list[cp.Variable]) -> ParametricLp:
    """The linear program in `variables` whose rows have the entries of `room` as right-hand sides, in their order.

    Parameters
    ----------
    problem : a linear program with `variables` and the vector parameter `room` and no others; every entry of `room`
        is the right-hand side of one row, every other row limits one variable

    Raises
    ------
    NumericalError : the program is not of that form.
    """

    def data(value: np.ndarray) -> tuple[np.ndarray, sp.csr_array, np.ndarray]:
        """(c, A, b) of: minimise c'v subject to A v <= b."""
        room.value = value
        found = problem.get_problem_data("CLARABEL")[0]  # cones: what CVXPY hands to HiGHS changes with its version
        columns = found["param_prob"].var_id_to_col
        own = np.concatenate([columns[v.id] + np.arange(v.size) for v in variables])
        if found["dims"].zero or own.size != found["c"].size:
            raise NumericalError("the program has equations or variables of its own; pose it with inequalities alone")
        return found["c"][own], sp.csr_array(found["A"])[:, own], found["b"]

    numbers = 1.0 + np.arange(room.size)
    c, A, offset = data(np.zeros(room.size))
    _, A1, b = data(numbers)
    which = np.rint(b - offset).astype(int)  # number of the entry on the right-hand side, 0 for none
    rows = np.flatnonzero(which)[np.argsort(which[which != 0])]
    if not np.array_equal(which[rows], numbers) or np.abs(b - offset - which).max() > 1e-9 or offset[rows].any():
        raise NumericalError("an entry of `room` is not the right-hand side of exactly one row")
    if abs(A - A1).max() > 0:
        raise NumericalError("the program's matrix depends on `room`; CVXPY is to see it on the right alone")
    lower, upper = np.full(c.size, -np.inf), np.full(c.size, np.inf)
    for row in np.flatnonzero(which == 0):
        entries = A[[row]].tocoo()
        if entries.nnz != 1:
            raise NumericalError(f"row {row} limits {entries.nnz} variables and has no entry of `room`")
        i, a = int(entries.coords[1][0]), float(entries.data[0])
        if a > 0:
            upper[i] = min(upper[i], offset[row] / a)
        else:
            lower[i] = max(lower[i], offset[row] / a)
    return ParametricLp(c, A[rows].toarray(), lower, upper)
