"""The only door to CVXPY's solvers: tolerances, statuses, errors; and the upper staircase a block LMI is typed as."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import cvxpy as cp
import numpy as np

from synth.errors import NumericalError

TOLERANCE = 1e-8  # tighter only turns "optimal" into "optimal_inaccurate" without moving the solution
LARGEST = 1e100  # of an unknown: in the coordinates of a formulation its natural size is one
BACKOFF = (1e-3, 3e-3, 1e-2, 1e-1, 1.0, 1e1, 1e2, 1e3, 1e4)  # relative distances from the optimum, tried in turn


def staircase(rows: Sequence[Sequence[Any]]) -> cp.Expression:
    """A symmetric block matrix from its upper triangle; 0 stands for a zero block.

    Row i lists the blocks (i, i), (i, i+1), ...; diagonal blocks give the sizes.
    """
    sizes = [row[0].shape[0] for row in rows]

    def block(i: int, j: int):
        if i > j:
            return block(j, i).T
        entry = rows[i][j - i]
        return np.zeros((sizes[i], sizes[j])) if isinstance(entry, int) and entry == 0 else entry

    k = range(len(rows))
    return cp.bmat([[block(i, j) for j in k] for i in k])


def solve(objective: Any, lmis: Sequence[cp.Expression], *, tol: float = TOLERANCE) -> str:
    """Minimise a scalar (0: find the analytic centre) with every matrix in `lmis` positive semidefinite.

    Returns the solver's status, "optimal" or "optimal_inaccurate": neither is a proof, and the caller verifies.

    Raises
    ------
    NumericalError : the solver ended without a point; `statuses` says how.
    """
    problem = cp.Problem(cp.Minimize(objective), [M >> 0 for M in lmis])
    status = run(problem, "Clarabel", tol_gap_abs=tol, tol_gap_rel=tol, tol_feas=tol)
    if status not in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE):
        raise NumericalError(f"Clarabel ended with status {status!r}", {"clarabel": status})
    return status


def run(problem: cp.Problem, solver: str, **settings: Any) -> str:
    """Solve a problem and return the solver's status, whatever it is.

    Raises
    ------
    NumericalError : the solver broke down; its advice, meant for those who pose problems, is in `statuses`.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            problem.solve(solver=solver.upper(), **settings)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # CVXPY's SolverError and ValueError; a panic of Clarabel is no Exception
            statuses = {solver.lower(): f"{type(error).__name__}: {error}"}
            raise NumericalError(f"{solver} broke down without a solution", statuses) from None
    return str(problem.status)


def value(unknown: cp.Variable) -> np.ndarray:
    """The value of an unknown after `solve`.

    Raises
    ------
    NumericalError : it has none, or none to compute with: no real numbers, another shape, NaN or beyond `LARGEST`.
    """
    found = np.asarray(unknown.value)
    if found.dtype.kind not in "fiu" or found.shape != unknown.shape:
        what = "nothing" if unknown.value is None else f"{found.dtype} of shape {found.shape}"
        raise NumericalError(f"the solver left {what} for an unknown of shape {unknown.shape}")
    if not (np.abs(found) <= LARGEST).all():
        raise NumericalError(f"the solver left {np.abs(found).max():.3g} for an unknown: no number to compute with")
    return found
