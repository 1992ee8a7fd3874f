"""The predictive controller's program for unstable plants and long horizons, and any such program in long arithmetic.

`prestabilise` rounds the exact program of `synth.predictive.exactprogram` to doubles once: in its variables it is well
conditioned. `LongArithmetic` solves it as it is, at any measurement: what doubles cannot tell, such as a plant beyond
control, whose limits are all active, or a soft limit that cannot be kept and weighs 1e20 times the rest, it can.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import daqp
import numpy as np
from flint import arb, arb_mat, ctx

from synth.predictive.exactprogram import Exact, exact_program, rounded
from synth.predictive.leastnorm import LeastNorm
from synth.predictive.mpcproblem import MpcProblem
from synth.predictive.optimality import DAQP_ACTIVE
from synth.predictive.parametricqp import DAQP_SETTINGS, ParametricQp, Solution

MILDER = (1e12, 1e8, 1e4, 1e2, 1.0, 1e-2, 1e-4)  # penalties that are tried for a guess of the active rows
STIFF = 1e6  # a penalty beyond this times the weight of a command drowns the rest of the objective in its rounding


@dataclass(frozen=True, eq=False)
class LongArithmetic:
    """The optimum at any parameters, whatever doubles make of it: seconds at the most, else it is reported."""

    problem: MpcProblem
    commands: bool  # the program's variables are the commands, else those of `prestabilise`
    scratch: threading.local = field(init=False, repr=False, default_factory=threading.local)

    def __reduce__(self):
        return LongArithmetic, (self.problem, self.commands)

    def __call__(self, phi: np.ndarray, active: np.ndarray | None = None) -> np.ndarray:
        """The optimal variables, then the slacks.

        Parameters
        ----------
        active : (N + M,) rows of the program of `prestabilise` that are likely to be active, > 0 at the upper limit

        Raises
        ------
        NumericalError : as `exact_program` and `LeastNorm.solve`.
        """
        p, m = self.problem, self.problem.model.nu
        try:
            e, least_norm = self.scratch.exact
        except AttributeError:
            e, least_norm = self.scratch.exact = self.posed()
        N = p.Nc * m
        with ctx.workprec(e.bits):
            M, root = e.predictions.tolist(), arb(e.penalty).sqrt()
            free = (arb_mat([row[N:] for row in M]) * arb_mat(len(phi), 1, phi.tolist())).entries()
            b = [arb(-1)] * e.slacks
            for row, factor, bound, slack in zip(*e.limits, strict=True):
                b.append(bound - factor * free[row] - (slack >= 0))
            z = least_norm.solve(b, [] if active is None else self.rows(active, N, e.slacks))[0].entries()
            planned = (arb_mat([row[:N] for row in M[:N]]) * arb_mat(N, 1, z[:N])).entries()
            commands = [(u + c) / p.unit[i % m] for i, (u, c) in enumerate(zip(planned, free, strict=False))]
            v = commands if self.commands else commands[:m] + z[m:N]
            return np.array([float(e) for e in v] + [float(s / root - 1) for s in z[N:]])

    def posed(self) -> tuple[Exact, LeastNorm]:
        """The program, and its rows in variables of weight 1: a slack is z / root - 1."""
        e, N = exact_program(self.problem, plain=False), self.problem.Nc * self.problem.model.nu
        with ctx.workprec(e.bits):
            M, unit = e.predictions.tolist(), 1 / arb(e.penalty).sqrt()
            slacks = [[-unit * j for j in row] for row in np.eye(e.slacks, dtype=int).tolist()]
            G, none = [[arb(0)] * N + row for row in slacks], [arb(0)] * e.slacks
            for row, factor, _, slack in zip(*e.limits, strict=True):
                G.append([factor * t for t in M[row][:N]] + (slacks[slack] if slack >= 0 else none))
            return e, LeastNorm(arb_mat(G))

    def rows(self, active: np.ndarray, N: int, slacks: int) -> list[int]:
        """Where the active rows of the program of `prestabilise` stand here: slacks, both limits of u_0, the rest."""
        m = self.problem.model.nu
        first = np.column_stack([active[:m] > 0, active[:m] < 0]).ravel()
        return np.flatnonzero(np.concatenate([active[N : N + slacks], first, active[N + slacks :]])).tolist()


class PrestabilisedQp(ParametricQp):
    """The program of `prestabilise`.

    A penalty that drowns the rest is set aside first: if the soft limits can be kept, and no channel's multipliers add
    up to more than its penalty, that is the optimum.
    """

    kept: ParametricQp | None  # the program without slacks

    def __post_init__(self):
        super().__post_init__()
        ends = np.flatnonzero(np.diag(self.P) > STIFF)
        first = int(ends[0]) if ends.size else len(self.P)
        object.__setattr__(self, "kept", self.without(first) if first < len(self.P) else None)

    def without(self, first: int) -> ParametricQp:
        """The program with the variables from `first` on at zero."""
        N = len(self.P)
        rows = np.r_[:first, N : self.lower.size]
        vectors = np.r_[:first, N + rows]
        return ParametricQp(
            self.P[:first, :first],
            np.ascontiguousarray(self.A[:, :first]),
            self.lower[rows],
            self.offset[vectors],
            self.slope[vectors],
            used=self.used,
        )

    def solve(self, phi: np.ndarray, active: np.ndarray) -> Solution:
        """As `ParametricQp.solve`."""
        if self.kept is None:
            return super().solve(phi, active)
        f, upper = self.vectors(phi)
        N, n = len(self.P), len(self.kept.P)
        rows = np.r_[:n, N : upper.size]
        solution, status = self.kept.solve_daqp(f[:n], upper[rows], active[rows])
        if solution is None:
            return self.solve_exactly(phi, {"daqp": status})
        price = f[n:] + self.A[:, n:].T @ solution.multipliers[n:]  # what is left of the penalty
        if not (price >= 0).all():
            return self.solve_exactly(phi, {"daqp": "a soft limit is worth more than its penalty"})
        v, y, active = np.zeros(N), np.zeros(upper.size), np.full(upper.size, DAQP_ACTIVE[-1])
        v[:n], y[rows], y[n:N], active[rows] = solution.v, solution.multipliers, -price, solution.active
        return Solution(v, y, active, "daqp")

    def likely(self, phi: np.ndarray) -> np.ndarray | None:
        """What DAQP makes of the program with a penalty that doubles carry: mostly the same rows are active."""
        f, upper = self.vectors(phi)
        slacks = self.offset[: f.size] != 0  # only they have a linear cost of their own
        penalty = self.P[slacks, slacks].max(initial=0)
        for milder in (penalty, *(e for e in MILDER if e < penalty)):
            weight = np.where(slacks, milder / (penalty or 1), 1)
            model = daqp.Model()
            flag, _ = model.setup(self.P * weight, f * weight, self.A, upper, self.lower, self.cold_start())
            if flag < 0:
                continue
            model.settings = DAQP_SETTINGS
            _, _, flag, info = model.solve()
            if flag == 1:
                return np.sign(info["lam"])
        return None


def prestabilise(p: MpcProblem) -> ParametricQp:
    """The program of `pose` in the variables (v, slacks); the first m are u_0 in units of `p.unit`.

    Raises
    ------
    NumericalError : as `exact_program`.
    """
    e, m, N = exact_program(p, plain=True), p.model.nu, p.Nc * p.model.nu
    M, slacks, (row, factor, bound, slack) = rounded(e.predictions), e.slacks, (a[2 * m :] for a in e.limits)
    P, f = np.eye(N + slacks), np.zeros(N + slacks)
    P[:m, :m] = rounded(e.hessian)
    P[N:, N:] *= e.penalty
    f[N:] = e.penalty
    rows = factor[:, None] * M[row]
    A = np.hstack([rows[:, :N], -np.equal.outer(slack, np.arange(slacks)).astype(float)])
    lower = np.concatenate([p.umin / p.unit, np.full(N - m, -np.inf), np.zeros(slacks), np.full(len(A), -np.inf)])
    upper = np.concatenate([p.umax / p.unit, np.full(N - m + slacks, np.inf), bound])
    slope = np.zeros((N + slacks + lower.size, rows.shape[1] - N))
    slope[:m] = rounded(e.gradient)
    slope[2 * (N + slacks) :] = -rows[:, N:]
    long = LongArithmetic(p, commands=False)
    return PrestabilisedQp((P + P.T) / 2, A, lower, np.concatenate([f, upper]), slope, long, m)
