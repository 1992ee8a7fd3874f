"""Descent of a function with kinks, from a point at which its slope is known almost everywhere.

BFGS with a line search that asks for some decrease and for a slope that is less steep, no more: at a kink the inverse
Hessian learns in which directions the function cannot go, so what was learnt must not be thrown away.

Reference: Lewis and Overton (2013), Mathematical Programming 141, 135.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

ARMIJO, WOLFE = 1e-4, 0.5  # parts of the slope
TRIALS = 12  # of a line search, where a look at the function is dear
PATIENCE = 8  # steps that must gain something together: at a kink some gain little
FIRST = 0.1  # length of the first step


class Descent:
    """Where the descent has come to."""

    def __init__(
        self,
        function: Callable[[np.ndarray], tuple[float, np.ndarray]],
        x: np.ndarray,
        *,
        H: np.ndarray | None = None,
        trials: int = TRIALS,
    ):
        self.function, self.x, self.trials = function, x, trials
        self.value, self.slope = function(x)
        self.H = H  # inverse Hessian, of a function much like this one where it is given
        self.calls = 0  # of the function

    def run(self, calls: int, gain: float) -> bool:
        """Steps down, by about so many calls; False where the last ones gained less than `gain` together."""
        values, last = [self.value], self.calls + calls
        while self.calls < last:
            if not self._step():
                return False
            values.append(self.value)
            if len(values) > PATIENCE and values[-1 - PATIENCE] - self.value < gain:
                return False
        return True

    def _step(self) -> bool:
        """A step along -H slope; False where there is none."""
        size = float(np.linalg.norm(self.slope))
        p = -self.slope * (FIRST / size if size else 0.0) if self.H is None else -self.H @ self.slope
        found = self._searched(p, float(self.slope @ p))
        if found is None:
            return False
        s, self.value, slope = found
        y = slope - self.slope
        self.x, self.slope = self.x + s, slope
        if s @ y > 0:
            I = np.eye(len(s))
            W = I - np.outer(s, y) / (s @ y)
            self.H = W @ (I * (s @ y) / (y @ y) if self.H is None else self.H) @ W.T + np.outer(s, s) / (s @ y)
        return True

    def _searched(self, p: np.ndarray, downhill: float) -> tuple[np.ndarray, float, np.ndarray] | None:
        """A step along p, with value and slope there; the best found where no step has all that is asked."""
        low, high, t, found = 0.0, np.inf, 1.0, None
        for _ in range(self.trials if downhill < 0 else 0):
            value, slope = self.function(self.x + t * p)
            self.calls += 1
            if not value <= self.value + ARMIJO * t * downhill:
                high = t
            else:
                found = t * p, value, slope
                if slope @ p >= WOLFE * downhill:
                    break
                low = t
            t = (low + high) / 2 if np.isfinite(high) else 2 * low
        return found
