"""The checked data of a predictive controller and what follows from it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from synth.systems.statespace import StateSpace


@dataclass(frozen=True, eq=False, kw_only=True)
class MpcProblem:
    """The checked data of a controller; `mpc` makes it."""

    model: StateSpace  # n states = outputs, m inputs
    Q: np.ndarray  # (n, n) weight of r - x
    R: np.ndarray  # (m, m) weight of u or du
    terminal: np.ndarray  # (n, n) weight of r - x at the end of the horizon
    Np: int  # prediction horizon, samples
    Nc: int  # control horizon, samples
    umin: np.ndarray  # (m,) hard limit of u
    umax: np.ndarray  # (m,) hard limit of u
    form: str  # "velocity" or "position"
    ymin: np.ndarray  # (n,) soft limit of x, -inf where free
    ymax: np.ndarray  # (n,) soft limit of x, inf where free
    hmax: np.ndarray  # (m,) soft limit of |h|, units of u times s, inf where free
    delay: int  # samples between a command and its action
    penalty: float  # weight of a soft limit's relative excess, in units of `cost_unit`

    @cached_property
    def unit(self) -> np.ndarray:
        """Largest magnitude of each input: the unit of the decision variables, (m,)."""
        return np.maximum(np.abs(self.umin), np.abs(self.umax))

    @cached_property
    def parameters(self) -> dict[str, slice]:
        """Where measured state, disturbance, reference, momentum and past commands stand in the parameter vector."""
        n, m = self.model.n, self.model.nu
        ends = np.cumsum([n, n, n, m, max(self.delay, 1) * m]).tolist()
        names = ("x", "d", "r", "h", "inputs")
        return {name: slice(a, b) for name, a, b in zip(names, [0, *ends[:-1]], ends, strict=True)}

    @cached_property
    def cost_unit(self) -> float:
        """What full command held over the prediction horizon costs: the unit of the objective.

        The errors of all samples and R once, the increment of the velocity form; the position form pays R Nc times.
        """
        G = np.zeros((self.model.n, self.model.nu))
        H = self.unit[:, None] * self.R * self.unit
        with np.errstate(all="ignore"):
            for k in range(self.Np):
                G = self.model.A @ G + self.model.B * self.unit
                H = H + G.T @ (self.Q if k < self.Np - 1 else self.terminal) @ G
        return float(np.linalg.eigvalsh(H)[-1]) if np.isfinite(H).all() else np.inf

    @cached_property
    def condition(self) -> float:
        """Condition number of the Hessian in the commands, in units of `unit`; inf beyond what doubles hold."""
        m, N, last = self.model.nu, self.Nc * self.model.nu, (self.Nc - 1) * self.model.nu
        moves = (np.eye(N) - (np.eye(N, k=-m) if self.form == "velocity" else 0)) * np.tile(self.unit, self.Nc)
        H, G = moves.T @ np.kron(np.eye(self.Nc), self.R) @ moves, np.zeros((self.model.n, N))
        with np.errstate(all="ignore"):
            for k in range(self.Np):
                G = self.model.A @ G
                G[:, min(k * m, last) :][:, :m] += self.model.B * self.unit
                H += G.T @ (self.Q if k < self.Np - 1 else self.terminal) @ G
        return float(np.linalg.cond(H)) if np.isfinite(H).all() else np.inf
