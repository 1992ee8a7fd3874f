"""How far a claimed optimum of a strictly convex quadratic program can be from the true one.

    minimise  v'Pv/2 + f'v   subject to  lower <= [v; A v] <= upper,     multipliers y, > 0 at `upper`

Whatever (v, y) is, it is the optimum of a program with f and the limits moved by the natural residual

    e = [v; A v] - clip([v - g; A v + y_A], lower, upper),      g = P v + f + A'y_A:

a variable is free and its g vanishes, or at the limit towards which g drives it; a row is at the limit that its
multiplier names, or within. By strong convexity the first moves v by no more than its own size, in the norms of P and
of its inverse; the second moves it by its size over s, the least singular value of the active rows, all of unit length
in the norm of the inverse, as long as the same rows are active. Where this is too coarse, the inverse of the optimality
conditions of the working set says what either, and the rounding in them, does to each variable.

References: Boyd and Vandenberghe (2004), sections 5.5 and 9.1.2; Pang (1987), Mathematics of OR 12, 474.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
import scipy.linalg as sla

EPS = np.finfo(float).eps
DISTINCT = 3e-6  # DAQP lets no row into its working set that is closer than this to the span of the others


class Optimality:
    """The conditions of a program, ready to be checked. It keeps buffers, so that one object serves one thread.

    Raises
    ------
    LinAlgError : P is not positive definite in double precision.
    """

    def __init__(self, P: np.ndarray, A: np.ndarray, lower: np.ndarray):
        N = len(P)
        scale = np.sqrt(np.diag(P))
        self.root = np.linalg.cholesky(P)  # (N, N) lower triangular, P = root root'
        self.rows, self.columns, self.lower = np.vstack([P, A]), np.array(A.T), lower
        lengths = np.linalg.norm(sla.solve_triangular(self.root, self.limited().T, lower=True), axis=0)
        reach = lengths[:N].max()  # how far v may go, in any one variable, per unit of the norm of P
        lengths[lengths == 0] = 1
        # of each entry of the natural residual: what it may do to v at the most, doubled for the sum of two norms
        self.weight = 2 * reach / lengths / DISTINCT
        self.weight[:N] += 2 * reach / scale / sqrt(np.linalg.eigvalsh(P / scale / scale[:, None])[0])
        self.products, self.residual = np.empty(lower.size), np.empty(lower.size)
        self.parts = self.products[:N], self.products[N:], self.residual[:N], self.residual[N:], np.empty(N)

    def error(self, v: np.ndarray, y: np.ndarray, f: np.ndarray, upper: np.ndarray, accepted: float) -> float:
        """A bound of |v - v*|, of each variable in its own unit, or relative where it is larger than that.

        inf where there is none. The working set is looked at only if the coarse bound is above `accepted`.
        """
        e, yA = self.residual, y[f.size :]
        g, w, e_v, e_w, prices = self.parts
        self.rows.dot(v, out=self.products)
        self.columns.dot(yA, out=prices)
        g += f
        g += prices
        np.subtract(v, g, out=e_v)
        np.add(w, yA, out=e_w)
        np.minimum(e, upper, out=e)
        np.maximum(e, self.lower, out=e)
        e_v -= v
        e_w -= w
        e *= self.weight
        bound = sqrt(e.dot(e))
        return bound if bound <= accepted else self._error_on(y != 0, v, y, f, e / self.weight)

    def _error_on(self, active: np.ndarray, v: np.ndarray, y: np.ndarray, f: np.ndarray, e: np.ndarray) -> float:
        """A bound of |v - v*| from the natural residual `e`, where the rows `active` are."""
        N = f.size
        if active.sum() > N or not np.isfinite(e).all():
            return np.inf
        limited = np.abs(self.limited())
        gradient = np.where(active[:N], 0, np.abs(e[:N]))
        gradient += 2 * EPS * (np.abs(self.rows[:N]) @ np.abs(v) + np.abs(f) + limited.T @ np.abs(y))
        beyond = np.where(active[:N], np.abs(e[:N]), 0)
        beyond = np.concatenate([beyond, np.abs(e[N:]) + 2 * EPS * (limited[N:] @ np.abs(v))])
        Q, R = np.linalg.qr(self.active_rows(active))
        inverse = sla.solve_triangular(self.root, np.eye(N), lower=True)
        if not np.abs(np.diag(R)).min(initial=1) > 0:
            return np.inf
        onto = inverse.T @ Q
        free = np.abs(inverse.T @ inverse - onto @ onto.T) @ gradient
        bound = free + np.abs(sla.solve_triangular(R, onto.T).T if active.any() else onto) @ beyond[active]
        error = float((bound / np.maximum(np.abs(v), 1)).max())
        return error if np.isfinite(error) else np.inf

    def limited(self) -> np.ndarray:
        """The identity and A, (N + M, N)."""
        return np.vstack([np.eye(len(self.root)), self.rows[len(self.root) :]])

    def active_rows(self, active: np.ndarray) -> np.ndarray:
        """Rows in coordinates in which P is the identity, as columns."""
        return sla.solve_triangular(self.root, self.limited()[active].T, lower=True)

    def refined(
        self, v: np.ndarray, y: np.ndarray, f: np.ndarray, upper: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """[(v, y)] with the rows that (v, y) nearly names exactly at their limits; none where they depend."""
        w = self.limited() @ v
        square = np.sum(sla.solve_triangular(self.root, self.limited().T, lower=True) ** 2, axis=0)
        above, below = y * square > upper - w, -y * square > w - self.lower
        active, limit, found = above | below, np.where(above, upper, self.lower), np.zeros(y.size)
        Q, R = np.linalg.qr(self.active_rows(active))
        if active.sum() > f.size or not np.abs(np.diag(R)).min(initial=1) > 0:
            return []
        free = -sla.solve_triangular(self.root, f, lower=True)
        if active.any():
            share = sla.solve_triangular(R.T, limit[active], lower=True)
            found[active] = sla.solve_triangular(R, Q.T @ free - share)
            free = free - Q @ (Q.T @ free - share)
        return [(sla.solve_triangular(self.root.T, free), found)]
