"""How far a claimed optimum of a strictly convex quadratic program can be from the true one.

    minimise  v'Pv/2 + f'v   subject to  lower <= [v; A v] <= upper,     multipliers y, > 0 at `upper`

Whatever (v, y) is, it is the optimum of a program with f and the limits moved by the natural residual

    e = [v; A v] - clip([v - g; A v + y_A], lower, upper),      g = P v + f + A'y_A:

a variable is free and its g vanishes, or at the limit towards which g drives it; a row is at the limit that its
multiplier names, or within. What the first and the second do to v the inverse of the optimality conditions says, as
long as the same rows are active; it depends on the working set alone, and is kept for those that were met before. A
row beyond its limit moves v by what it takes to bring it back. Strong convexity keeps all this finite.

References: Boyd and Vandenberghe (2004), sections 5.5 and 10.1; Pang (1987), Mathematics of OR 12, 474.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

EPS = np.finfo(float).eps
DISTINCT = 3e-6  # DAQP lets no row into its working set that is closer than this to the span of the others
DAQP_ACTIVE = np.array([0, 1, 3], dtype=np.intc)  # its flag for a row with multiplier 0, > 0 (upper), < 0 (lower)
KEPT = 512  # working sets whose effects are kept


class Optimality:
    """The conditions of a program, ready to be checked. It keeps buffers, so that one object serves one thread.

    `used` is the number of leading variables whose error counts.

    Raises
    ------
    LinAlgError : P is not positive definite in double precision.
    """

    def __init__(self, P: np.ndarray, A: np.ndarray, lower: np.ndarray, used: int):
        N, self.used = len(P), used
        self.rows, self.columns, self.lower = np.vstack([P, A]), np.array(A.T), lower
        self.inverse = sla.solve_triangular(np.linalg.cholesky(P), np.eye(N), lower=True)  # P^-1 = inverse' inverse
        self.lengthwise = np.hstack([self.inverse, self.inverse @ A.T])  # what is limited, where P is the identity
        self.products, self.residual = np.empty(lower.size), np.empty(lower.size)
        self.parts = self.products[:N], self.products[N:], self.residual[:N], self.residual[N:], np.empty(N)
        self.known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def error(self, v: np.ndarray, y: np.ndarray, f: np.ndarray, upper: np.ndarray) -> tuple[float, np.ndarray]:
        """(bound of |v - v*|, working set): of each used variable in its own unit; without rounding, see `rounding`.

        The working set is (N + M,), as DAQP flags it.
        """
        e, yA, signs = self.residual, y[f.size :], np.sign(y)
        g, w, e_v, e_w, prices = self.parts
        active, effect = self.known.get(signs.tobytes()) or self.met(signs)
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
        np.abs(e, out=e)
        return effect.dot(e), active.copy()

    def met(self, signs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(working set, its `effect`) of multipliers with these signs, from now on known."""
        active = DAQP_ACTIVE.take(signs.astype(np.intp), mode="wrap")
        if len(self.known) >= KEPT:
            self.known.clear()
        found = self.known[signs.tobytes()] = active, self.effect(active != 0)
        return found

    def effect(self, active: np.ndarray) -> np.ndarray:
        """What a unit of each entry of the natural residual does to a used variable at the most, (N + M,)."""
        N = len(self.inverse)
        beyond = self.beyond(active)
        if beyond is None:
            return np.full(active.size, np.inf)
        onto, shift = beyond
        apart = self.lengthwise - onto @ (onto.T @ self.lengthwise)  # what brings a row back and moves no active one
        squares = np.maximum(np.sum(apart**2, axis=0), DISTINCT**2 * np.sum(self.lengthwise**2, axis=0))
        moves = np.abs(self.inverse[:, : self.used].T @ apart).max(axis=0)
        found = moves / np.where(squares > 0, squares, 1)
        found[:N] = np.abs(self.gradient(onto)[: self.used]).max(axis=0)
        found[active] = np.abs(shift[: self.used]).max(axis=0, initial=0)
        return found

    def gradient(self, onto: np.ndarray) -> np.ndarray:
        """What the gradient does to v where rows with the span `onto` stay at their limits, (N, N)."""
        onto = self.inverse.T @ onto
        return self.inverse.T @ self.inverse - onto @ onto.T

    def beyond(self, active: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """(orthonormal span of the active rows, what their limits do to v); None where they depend on each other."""
        M = self.lengthwise[:, active]
        Q, R = np.linalg.qr(M)
        if M.shape[1] > len(M) or not np.abs(np.diag(R)).min(initial=1) > 0:
            return None
        shift = sla.solve_triangular(R, Q.T @ self.inverse).T if active.any() else np.zeros((len(M), 0))
        return Q, shift

    def rounding(self, v: np.ndarray, y: np.ndarray, f: np.ndarray, upper: np.ndarray) -> float:
        """As `error`, finer and slower: variable by variable, relative to those above 1, and with its own rounding."""
        N, active = f.size, y != 0
        beyond = self.beyond(active)
        limited = np.vstack([np.eye(N), self.rows[N:]])
        w = limited @ v
        g = self.rows[:N] @ v + f + self.columns @ y[N:]
        e = np.abs(w - np.minimum(np.maximum(np.concatenate([v - g, w[N:] + y[N:]]), self.lower), upper))
        if beyond is None or not np.isfinite(e).all():
            return np.inf
        onto, shift = beyond
        inside, noise = np.where(active, 0, e), 2 * EPS * (np.abs(limited) @ np.abs(v))
        noise[:N] = 0  # the variables themselves are exact
        gradient = inside[:N] + 2 * EPS * (
            np.abs(self.rows[:N]) @ np.abs(v) + np.abs(f) + np.abs(limited).T @ np.abs(y)
        )
        bound = np.abs(self.gradient(onto)) @ gradient + np.abs(shift) @ (e + noise)[active]
        bound += self.effect(active)[N:] @ np.maximum(inside - noise, 0)[N:]  # rows that are beyond, beyond doubt
        return float((bound / np.maximum(np.abs(v), 1))[: self.used].max())

    def refined(
        self, v: np.ndarray, y: np.ndarray, f: np.ndarray, upper: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """[(v, y)] with the rows that (v, y) nearly names exactly at their limits; none where they depend."""
        N = f.size
        w = np.concatenate([v, self.rows[N:] @ v])
        square = np.sum(self.lengthwise**2, axis=0)
        above, below = y * square > upper - w, -y * square > w - self.lower
        active, limit, found = above | below, np.where(above, upper, self.lower), np.zeros(y.size)
        beyond = self.beyond(active)
        if beyond is None:
            return []
        onto, shift = beyond
        z = shift @ limit[active] - self.gradient(onto) @ f
        found[active] = np.linalg.lstsq(self.lengthwise[:, active], -self.inverse @ (self.rows[:N] @ z + f))[0]
        return [(z, found)]
