"""The predictive controller's program in balls, in variables in which an unstable plant does not drown it in rounding.

In the commands themselves the Hessian of an unstable plant grows like the open loop, |A|^(2 Np), and doubles lose it.
Here the variables v_k are what is added to the feedback that is optimal without limits,

    u_0 = v_0,     u_k = -K_k z_k + T_k v_k,     z_k = (x_k, u_{k-1}, d, r)

by the Riccati recursion of the horizon itself. The cost is then a sum of squares, |u_0 + K_0 z_0|^2 in the weight H_0
and |v_k|^2, and the growth is gone from it; the limits become rows of closed-loop responses. It is the same program
in other coordinates.

Beyond Nc the command is held and the plant runs open: the last command has to be known to as many digits as it grows.
So the recursion runs in ball arithmetic, with as many bits as it takes.

References: Rossiter, Kouvaritakis and Rice (1998), Automatica 34, 65 (prestabilised predictions); Rawlings, Mayne and
Diehl (2017), Model Predictive Control, section 8.8 (Riccati recursion of a horizon); Johansson (2017), IEEE Trans.
Computers 66, 1281 (Arb).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from synth.errors import NumericalError
from synth.predictive.mpcproblem import MpcProblem

BITS = (384, 768, 1536, 3072)  # tried in turn
SMALL = 2.0**-200  # largest radius of a number, relative to the largest of its row


class Feedback(NamedTuple):
    """Of one sample: u = -K z + T v."""

    K: arb_mat  # (m, 3 n + m)
    T: arb_mat  # (m, m) T'H T = weight
    H: arb_mat  # (m, m) curvature of the cost


class Limits(NamedTuple):
    """Rows (factor M v) + (factor M' phi) - (slack) <= bound; M are rows of the predictions."""

    row: np.ndarray  # (rows,) of M
    factor: np.ndarray  # (rows,)
    bound: np.ndarray  # (rows,)
    slack: np.ndarray  # (rows,) its number, -1 for none


class Exact(NamedTuple):
    """The program in balls: the objective of `pose` times a number that makes the weight of most variables 1."""

    bits: int  # of the arithmetic
    hessian: arb_mat  # (m, m) of u_0 / unit, where this is a variable; 1 of all others but the slacks
    gradient: arb_mat  # (m, parameters)
    predictions: arb_mat  # (any, Nc m + parameters) what the limits are on: commands, states, momentum
    limits: Limits
    penalty: float  # of the slacks

    @property
    def slacks(self) -> int:
        """How many there are."""
        return int(self.limits.slack.max(initial=-1)) + 1


def exact_program(p: MpcProblem, *, plain: bool) -> Exact:
    """The program of `pose` in the variables (v, slacks), each number to 200 bits.

    Parameters
    ----------
    plain : v_0 is the command itself in units of `p.unit`; else it is what is added to the feedback, as all others are,
        and no variable has a linear cost

    Raises
    ------
    NumericalError : the plant grows so much over the horizon that it takes more than 3072 bits, or 1e308.
    """
    if np.isfinite(p.cost_unit):
        for bits in BITS:
            with ctx.workprec(bits):
                try:
                    found = _program(p, bits, plain)
                except ZeroDivisionError:  # the curvature of some command is not yet told from zero
                    continue
                if all(_is_accurate(M) for M in (found.predictions, found.gradient, found.hessian)):
                    return found
    raise NumericalError(
        f"full command over Np = {p.Np} samples costs {p.cost_unit:.3g}: the plant grows too much; shorten the horizon"
    )


def _program(p: MpcProblem, bits: int, plain: bool) -> Exact:
    n, m, N = p.model.n, p.model.nu, p.Nc * p.model.nu
    feedback = _feedback(p)
    unit, H = balls(np.diag(p.unit)), feedback[0].H
    root = 2.0 ** round(np.log2(float((unit * H * unit).trace().mid()) / m) / 2)  # exact, and so is its square
    where, columns = p.parameters, N + p.parameters["inputs"].stop

    def measured(name: str, first: int, size: int) -> arb_mat:
        """Entries of a parameter as functions of (v, phi)."""
        found = np.zeros((size, columns))
        found[:, N + where[name].start + first :][:, :size] = np.eye(size)
        return balls(found)

    past = [measured("inputs", i * m, m) for i in range(max(p.delay, 1))]
    d, r, x, h = (measured(name, 0, size) for name, size in (("d", n), ("r", n), ("x", n), ("h", m)))
    A, B, dt, u = balls(p.model.A), balls(p.model.B), arb(p.model.dt), past[-1]
    for acting in past[: p.delay]:
        x, h = A * x + B * acting + d, h - acting * dt
    known = feedback[0].K * _stacked(x, u, d, r)  # no v in it
    states, commands, momentum = [], [], []
    for k in range(p.Np):
        if k == 0 and plain:
            u = _placed(unit, 0, columns)
        elif k < p.Nc:
            u = _placed(feedback[k].T * arb(root), k * m, columns) - feedback[k].K * _stacked(x, u, d, r)
        x, h = A * x + B * u + d, h - u * dt
        states.append(x)
        if k < p.Nc:
            commands.append(u)
        if k < p.Nc - 1 or k == p.Np - 1:
            momentum.append(h)
    scale = arb(1 / root**2)
    known = arb_mat([row[N:] for row in known.tolist()])
    return Exact(
        bits=bits,
        hessian=unit * H * unit * scale,
        gradient=unit * H * known * scale,
        predictions=_stacked(*commands, *states, *momentum),
        limits=_limits(p),
        penalty=p.penalty * p.cost_unit / root**2,
    )


def _feedback(p: MpcProblem) -> list[Feedback]:
    """The regulators of samples 0 to Nc - 1."""
    n, m = p.model.B.shape
    x, u, d, r = np.split(np.eye(3 * n + m), np.cumsum([n, m, n]))  # z = (x, u before, d, r)
    F = balls(x.T @ p.model.A @ x + x.T @ d + d.T @ d + r.T @ r)
    G = balls(x.T @ p.model.B + u.T)
    held, R, before = F + G * balls(u), balls(p.R), balls(p.R @ u if p.form == "velocity" else 0 * u)
    start = balls(u.T @ p.R @ u if p.form == "velocity" else 0 * (u.T @ u))
    stage, last = (balls((r - x).T @ W @ (r - x)) for W in (p.Q, p.terminal))
    cost, found = last, []
    for k in reversed(range(p.Np)):
        if k >= p.Nc:
            cost = held.transpose() * cost * held
        else:
            MF, MG = cost * F, cost * G
            H, L = R + G.transpose() * MG, G.transpose() * MF - before
            K = H.solve(L)
            cost = F.transpose() * MF + start - L.transpose() * K
            found.append(Feedback(K, _inverse_root(H), H))
        cost = (cost + cost.transpose()) * arb(0.5) + stage
    return found[::-1]


def _limits(p: MpcProblem) -> Limits:
    """Hard limits of the commands, soft ones of states and momentum; the rows in the order of the predictions."""
    n, m = p.model.B.shape
    hard, states = p.Nc * m, p.Np * n
    rows, slack = [], -1
    for i in range(hard):
        j = i % m
        rows += [(i, 1 / p.unit[j], p.umax[j] / p.unit[j], -1), (i, -1 / p.unit[j], -p.umin[j] / p.unit[j], -1)]
    soft = [(hard + np.arange(p.Np) * n + i, p.ymin[i], p.ymax[i]) for i in range(n)]
    soft += [(hard + states + np.arange(p.Nc) * m + i, -p.hmax[i], p.hmax[i]) for i in range(m)]
    for where, lower, upper in soft:
        sides = [(sign, limit) for sign, limit in ((1, upper), (-1, lower)) if np.isfinite(limit)]
        slack += bool(sides)
        unit = max((abs(limit) for _, limit in sides), default=1.0) or 1.0
        rows += [(i, sign / unit, sign * limit / unit, slack) for sign, limit in sides for i in where]
    row, factor, bound, slacks = np.array(rows, dtype=float).reshape(-1, 4).T
    return Limits(row.astype(int), factor, bound, slacks.astype(int))


def balls(M: np.ndarray) -> arb_mat:
    """A matrix as the exact doubles that it is."""
    return arb_mat(M.shape[0], M.shape[1], M.ravel().tolist())


def _stacked(*parts: arb_mat) -> arb_mat:
    return arb_mat(sum(M.nrows() for M in parts), parts[0].ncols(), [e for M in parts for e in M.entries()])


def _placed(M: arb_mat, first: int, columns: int) -> arb_mat:
    """`M` in the columns from `first` on of a matrix of zeros."""
    zero = arb(0)
    return arb_mat([[zero] * first + row + [zero] * (columns - first - len(row)) for row in M.tolist()])


def _inverse_root(H: arb_mat) -> arb_mat:
    """T with T'H T = I, the columns orthogonalised one after the other.

    Raises
    ------
    ZeroDivisionError : a ball around zero.
    """
    m = H.nrows()
    basis: list[arb_mat] = []
    for i in range(m):
        e = arb_mat(m, 1, [arb(int(j == i)) for j in range(m)])
        for t in basis:
            e = e - t * (t.transpose() * H * e)[0, 0]
        square = (e.transpose() * H * e)[0, 0]
        if not square > 0:
            raise ZeroDivisionError
        basis.append(e * (1 / square.sqrt()))
    return _stacked(*(t.transpose() for t in basis)).transpose()


def rounded(M: arb_mat) -> np.ndarray:
    """The midpoints as doubles."""
    return np.array([float(e.mid()) for e in M.entries()]).reshape(M.nrows(), M.ncols())


def _is_accurate(M: arb_mat) -> bool:
    """Whether every radius is small beside the largest number of its row."""
    for row in M.tolist():
        if float(max(e.rad() for e in row)) > SMALL * max(abs(float(e.mid())) for e in row):
            return False
    return True
