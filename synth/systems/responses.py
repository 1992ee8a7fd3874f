"""Step and impulse responses, exact at the samples, and their picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.checks import as_array
from synth.errors import ModelError
from synth.systems.exponential import expm

POINTS = 400  # of a continuous response
SETTLED = 6.0  # time constants of the slowest pole that are shown by default
CYCLES = 40.0  # at most, of the fastest pole that still swings
UNDECIDED = 1e-6  # of the fastest rate: poles nearer to the boundary count as integrators


@dataclass(frozen=True, eq=False)
class Response:
    """Answers of every output to every input, one input at a time."""

    time: np.ndarray  # (N,) s
    values: np.ndarray  # (N, p, m) unit of the output
    kind: str  # "step" or "impulse"
    dt: float  # s, 0 for continuous time
    u: tuple[str, ...]  # (m) names of the inputs
    y: tuple[str, ...]  # (p) names of the outputs

    def plot(self, ax: Any = None, **style: Any) -> np.ndarray:
        """Draw outputs (rows) against inputs (columns), staircases in discrete time; (p, m) of axes, new by default."""
        p, m = self.values.shape[1:]
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.subplots(p, m, sharex=True, squeeze=False, layout="constrained")[1]
        axes = np.asarray(ax, dtype=object).reshape(-1)
        if axes.size != p * m:
            raise ModelError(f"ax holds {axes.size} axes; pass {p * m}, outputs in rows and inputs in columns")
        axes: Any = axes.reshape(p, m)
        for i, j in np.ndindex(p, m):
            draw = axes[i, j].step if self.dt else axes[i, j].plot
            draw(self.time, self.values[:, i, j], **({"where": "post"} if self.dt else {}), **style)
            axes[i, j].set(ylabel=self.y[i] if j == 0 else "", title=f"{self.kind} of {self.u[j]}" if i == 0 else "")
        for each in axes[-1]:
            each.set_xlabel("samples" if self.dt is True else "time, s")
        return axes


def step(A, B, C, D, dt: float, time: Any, u: tuple[str, ...], y: tuple[str, ...]) -> Response:
    """Responses to unit steps from rest."""
    grid = time_grid(A, dt, time)
    n, m = B.shape
    if dt:
        states = _discrete(A, B, len(grid))
    else:
        F = np.block([[A, B], [np.zeros((m, n + m))]])
        states = _continuous(F, np.vstack([np.zeros((n, m)), np.eye(m)]), grid)[:, :n]
    return Response(grid, C @ states + D, "step", dt, u, y)


def impulse(A, B, C, D, dt: float, time: Any, u: tuple[str, ...], y: tuple[str, ...]) -> Response:
    """Responses to impulses of area one; of D only the discrete ones have a part, D / dt at time 0."""
    grid = time_grid(A, dt, time)
    if not dt:
        return Response(grid, C @ _continuous(A, B, grid), "impulse", dt, u, y)
    states = np.zeros((len(grid), *B.shape))
    if len(grid) > 1:
        states[1] = B / dt
    for k in range(2, len(grid)):
        states[k] = A @ states[k - 1]
    values = C @ states
    values[0] += D / dt
    return Response(grid, values, "impulse", dt, u, y)


def time_grid(A: np.ndarray, dt: float, time: Any) -> np.ndarray:
    """The samples of a response: those given, up to the end given, or until the slowest mode has settled."""
    if time is not None:
        given = as_array("time", time, "pass the end in s, or a grid of times from 0")
        if given.ndim > 1 or given.min(initial=0.0) < 0 or not given.size or (given.ndim == 0 and given == 0):
            raise ModelError(f"time is {given.tolist()}; pass the end in s, or a grid of times from 0")
        if given.ndim:
            if np.any(np.diff(given) <= 0):
                raise ModelError("time does not grow from sample to sample; pass a grid of rising times in s")
            if dt and not np.allclose(given, np.arange(len(given)) * dt, rtol=1e-9, atol=1e-9 * dt):
                raise ModelError(f"time is no row of samples 0, {dt:g}, {2 * dt:g}, ... s of this discrete system")
            return given
        end = float(given)
    else:
        end = _horizon(A, dt)
    return np.arange(int(np.floor(end / dt * (1 + 1e-12))) + 1) * dt if dt else np.linspace(0.0, end, POINTS)


def _horizon(A: np.ndarray, dt: float) -> float:
    """Until the slowest mode has settled; integrators and undamped modes are shown for some turns of the others."""
    poles = np.linalg.eigvals(A).astype(complex) if len(A) else np.zeros(0, complex)
    if dt:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / dt
    rates, speeds = np.abs(np.real(poles)), np.abs(poles)
    fastest = speeds.max(initial=0.0)
    if fastest == 0:
        return 10.0 * dt if dt else 10.0
    slow = rates[rates > UNDECIDED * fastest].min(initial=fastest)
    end = min(SETTLED / slow, CYCLES * 2 * np.pi / fastest * (10 if slow < fastest else 1))
    return max(end, 10.0 * dt)


def _continuous(F: np.ndarray, start: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """exp(F t) start on a grid; even steps need one exponential."""
    states = np.empty((len(grid), *start.shape))
    states[0] = expm(F * grid[0]) @ start if grid[0] else start
    steps = np.diff(grid)
    even = steps.size and np.allclose(steps, steps[0], rtol=1e-9, atol=0)
    E = expm(F * steps[0]) if even else None
    for k, h in enumerate(steps):
        states[k + 1] = (E if E is not None else expm(F * h)) @ states[k]
    return states


def _discrete(A: np.ndarray, B: np.ndarray, samples: int) -> np.ndarray:
    """States under unit steps."""
    states = np.zeros((samples, *B.shape))
    for k in range(1, samples):
        states[k] = A @ states[k - 1] + B
    return states
