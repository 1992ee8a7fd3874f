"""Model predictive control of a linear plant with hard input limits and soft output and momentum limits.

    minimise    sum_{k=1..Np} |r - x_k|^2_Q  +  sum_{k=0..Nc-1} |u_k|^2_R  or  |u_k - u_{k-1}|^2_R  +  soft limits
    subject to  x_{k+1} = A x_k + B u_k + d,   umin <= u_k <= umax,   u_k = u_{Nc-1} beyond the control horizon

Position form: |u|^2, d = 0. Velocity form: |du|^2 and d = x_0 - A x_{-1} - B u_{-1}, the increment the model did not
foresee; with d held, x_{k+1} - x_k = A (x_k - x_{k-1}) + B du_k, the incremental model, which integrates.

The problem is posed once in CVXPY (`pose`), where it reads as above. Its canonical quadratic program, whose vectors
are affine in the measured data, is taken out once (`synth.predictive.parametricqp`) and then stepped by DAQP; CVXPY
with Clarabel stays as the reference. Where the plant's own growth over the horizon would drown that program in rounding
it is stepped in other variables (`synth.predictive.prestabilised`). Every command is checked before it leaves.

Signs and units: u is what acts on the plant, on a spacecraft the torque on the body. The actuators store the
reaction, h_{k+1} = h_k - dt u_k, on a spacecraft the momentum of the wheels about the body axes in N m s.

Source of the study's values Q = R = 1000 I, Np = 10, Nc = 7: Pecorilla and Stesina 2024, table 3.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from synth.checks import as_choice, as_cost, as_limits, as_number, as_signal, as_whole, check_period
from synth.errors import ModelError, NumericalError
from synth.predictive.mpcproblem import MpcProblem
from synth.predictive.parametricqp import CLARABEL_SETTINGS, ParametricQp, canonicalise
from synth.predictive.prestabilised import LongArithmetic, prestabilise
from synth.systems.statespace import as_system

if TYPE_CHECKING:
    import cvxpy as cp

CONDITIONED = 1e6  # condition number up to which the program is stepped in the commands themselves


class MpcState(NamedTuple):
    """What the controller remembers from sample to sample."""

    prediction: np.ndarray | None  # (n,) the model's forecast of the next x; None before the first sample
    inputs: np.ndarray  # (max(delay, 1), m) last commands, oldest first
    momentum: np.ndarray  # (m,) momentum stored in the actuators, units of u times s
    active: np.ndarray  # (N + M,) DAQP's working set, where the next solve starts
    fallbacks: int  # how often DAQP gave up or failed the check and another route answered


@dataclass(frozen=True)
class PosedProblem:
    """The problem as CVXPY sees it: the reference for the fast path."""

    problem: cp.Problem
    phi: cp.Parameter  # measured data, laid out by MpcProblem.parameters
    variables: list[cp.Variable]  # commands (Nc m,) in units of MpcProblem.unit, relative excess of each soft limit

    def solve(self, phi: np.ndarray) -> np.ndarray:
        """The optimal commands and slacks for parameters `phi`, by CVXPY and Clarabel.

        Raises
        ------
        NumericalError : Clarabel reports anything but an optimum.
        """
        from synth.lmi.solve import run

        self.phi.value = phi
        run(self.problem, "Clarabel", **CLARABEL_SETTINGS)
        parts = [v.value for v in self.variables]
        if self.problem.status != "optimal" or any(p is None for p in parts):
            raise NumericalError(f"Clarabel ended with {self.problem.status!r}", {"clarabel": self.problem.status})
        return np.concatenate([np.asarray(p) for p in parts])


def pose(p: MpcProblem) -> PosedProblem:
    """The control problem in CVXPY, with the measured data as one parameter."""
    import cvxpy as cp

    A, B = p.model.A, p.model.B
    n, m, steps = p.model.n, p.model.nu, p.delay + p.Np
    where = p.parameters
    phi = cp.Parameter(where["inputs"].stop, name="phi")
    x0, d, r, h = (phi[where[name]] for name in ("x", "d", "r", "h"))
    past = [phi[where["inputs"]][i * m : (i + 1) * m] for i in range(max(p.delay, 1))]
    v = cp.Variable(p.Nc * m, name="commands")
    planned = [cp.multiply(p.unit, v[k * m : (k + 1) * m]) for k in range(p.Nc)]
    acting = past[: p.delay] + planned + [planned[-1]] * (p.Np - p.Nc)

    X = cp.Variable((steps + 1, n), name="states")
    constraints = [X[0] == x0, v <= np.tile(p.umax / p.unit, p.Nc), v >= np.tile(p.umin / p.unit, p.Nc)]
    constraints += [X[k + 1] == A @ X[k] + B @ acting[k] + d for k in range(steps)]

    previous = [past[-1], *planned[:-1]]
    weighted = planned if p.form == "position" else [u - last for u, last in zip(planned, previous, strict=True)]
    Q, R, P = square_root(p.Q), square_root(p.R), square_root(p.terminal)
    cost = [cp.sum_squares(Q @ (r - X[p.delay + k])) for k in range(1, p.Np)]
    cost += [cp.sum_squares(P @ (r - X[steps]))]
    cost += [cp.sum_squares(R @ u) for u in weighted]

    # between two samples of a held command h runs straight: beyond Nc its last value is the extreme one
    stored = {k: h - p.model.dt * sum(acting[:k]) for k in (*range(p.delay + 1, p.delay + p.Nc), steps)}
    channels = [soft_limit([X[k][i] for k in range(p.delay + 1, steps + 1)], p.ymin[i], p.ymax[i]) for i in range(n)]
    channels += [soft_limit([hk[i] for hk in stored.values()], -p.hmax[i], p.hmax[i]) for i in range(m)]
    channels = [excess for excess in channels if excess]
    slacks = cp.Variable(len(channels), name="slacks") if channels else None
    objective = sum(cost) / p.cost_unit / 2
    if slacks is not None:
        objective += p.penalty * (cp.sum(slacks) + cp.sum_squares(slacks) / 2)
        constraints += [slacks >= 0]
        constraints += [e <= slacks[i] for i, excess in enumerate(channels) for e in excess]
    return PosedProblem(cp.Problem(cp.Minimize(objective), constraints), phi, [v] if slacks is None else [v, slacks])


def soft_limit(values: list[Any], lower: float, upper: float) -> list[Any]:
    """How far each value exceeds the finite ones of its limits, in units of the larger limit."""
    unit = max((abs(limit) for limit in (lower, upper) if np.isfinite(limit)), default=1.0) or 1.0
    above = [(x - upper) / unit for x in values if np.isfinite(upper)]
    return above + [(lower - x) / unit for x in values if np.isfinite(lower)]


def square_root(W: np.ndarray) -> np.ndarray:
    """F with F'F = W for a symmetric positive semidefinite W."""
    eigenvalues, V = np.linalg.eigh(W)
    return np.sqrt(np.maximum(eigenvalues, 0))[:, None] * V.T


@dataclass(frozen=True, eq=False, kw_only=True)
class Mpc:
    """A model predictive controller; `mpc` makes it.

    `step` is a function of its arguments alone, to the last bit. One object serves one thread (`ParametricQp`).
    """

    problem: MpcProblem
    qp: ParametricQp  # variables: the command in units of MpcProblem.unit, later ones, then relative slacks

    @property
    def dt(self) -> float:
        """Sampling time in seconds."""
        return self.problem.model.dt

    def init(self) -> MpcState:
        """At rest: no command given, no momentum stored."""
        m = self.problem.model.nu
        return MpcState(
            prediction=None,
            inputs=np.zeros((max(self.problem.delay, 1), m)),
            momentum=np.zeros(m),
            active=self.qp.cold_start(),
            fallbacks=0,
        )

    def parameters(self, state: MpcState, y: Any, r: Any) -> np.ndarray:
        """The measured data as the program's parameter vector, laid out by `MpcProblem.parameters`.

        Raises
        ------
        ModelError : `y` or `r` has the wrong size or is not finite.
        """
        n, m = self.problem.model.B.shape
        y, r = as_signal("y", y), as_signal("r", r)
        if y.shape == (n,):
            x, h = y, state.momentum
        elif y.shape == (n + m,):
            x, h = y[:n], y[n:]
        else:
            raise ModelError(f"y has shape {y.shape}; pass the state ({n},) or state and momentum ({n + m},)")
        if r.shape != (n,):
            raise ModelError(f"r has shape {r.shape}; pass the state to go to, ({n},)")
        d = np.zeros(n) if state.prediction is None else x - state.prediction
        phi = np.concatenate((x, d, r, h, state.inputs.ravel()))
        if not isfinite(phi.dot(phi)):
            raise ModelError(f"y is {y}, r is {r}; every entry must be finite")
        return phi

    def step(self, state: MpcState, y: Any, r: Any) -> tuple[MpcState, np.ndarray]:
        """The next state and the command.

        Parameters
        ----------
        y : (n,) measured or estimated state; or (n + m,), followed by the measured momentum of the actuators
            (units of u times s), which is otherwise summed up from the commands
        r : (n,) state to go to

        Returns
        -------
        state, u : u is (m,), within [umin, umax] to rounding; with a delay it acts `delay` samples later.

        Raises
        ------
        ModelError : `y` or `r` has the wrong size or is not finite.
        NumericalError : no route leads to a command that passes the check. There is no NaN and no stale command.

        Notes
        -----
        What leaves is within 1e-8 of the optimum, in units of the larger limit: the residuals of the optimality
        conditions show it of DAQP's and Clarabel's answers (`Optimality`); the last resort, long arithmetic, may take
        seconds. `fallbacks` counts the steps that DAQP did not answer, or not well enough.
        """
        p, model = self.problem, self.problem.model
        phi = self.parameters(state, y, r)
        try:
            solution = self.qp.solve(phi, state.active)
        except NumericalError as error:
            data = {name: phi[where].tolist() for name, where in p.parameters.items()}
            raise NumericalError(f"no command at {data}: {error}", error.statuses) from error
        u = p.unit * solution.v[: p.unit.size]
        if p.delay:
            acting, inputs = state.inputs[0], np.concatenate((state.inputs[1:], u[None]))
        else:
            acting, inputs = u, u[None]
        return MpcState(
            prediction=model.A.dot(phi[: model.n]) + model.B.dot(acting) if p.form == "velocity" else None,
            inputs=inputs,
            momentum=phi[p.parameters["h"]] - model.dt * acting,
            active=solution.active,
            fallbacks=state.fallbacks + (solution.solver != "daqp"),
        ), u


def mpc(
    model: Any,
    *,
    Q: Any,
    R: Any,
    Np: int,
    Nc: int,
    umin: Any,
    umax: Any,
    form: str = "velocity",
    terminal: Any = None,
    ymin: Any = None,
    ymax: Any = None,
    hmax: Any = None,
    delay: int = 0,
    penalty: float = 10.0,
) -> Mpc:
    """A model predictive controller for x+ = A x + B u, y = x.

    Parameters
    ----------
    model : discrete system, in any form that `system` takes, whose outputs are its n states; m inputs
    Q : (n, n) weight of the error r - x, symmetric positive semidefinite; of all weights a number stands for that
        multiple of the identity, a list for a diagonal
    R : (m, m) weight of u (position form) or of its increments (velocity form), symmetric positive definite
    Np, Nc : prediction and control horizon in samples, 1 <= Nc <= Np; u is held beyond Nc
    umin, umax : scalar or (m,) hard limits of u
    form : "velocity" penalises increments and integrates: no offset under a constant disturbance.
        "position" penalises u itself: calmer under noise, but a constant disturbance leaves an offset.
    terminal : (n, n) weight of the last error of the horizon, Q unless given
    ymin, ymax : scalar or (n,) soft limits of the state (of a spacecraft: its rates), infinite where free
    hmax : scalar or (m,) soft limit of |h|, the momentum stored in the actuators; h+ = h - dt u
    delay : samples between a command and its action; the prediction starts when the command acts
    penalty : weight of an excess s of a soft limit, penalty (s + s^2/2), where s is relative to the limit and the
        objective is in units of what full command held over Np costs (errors over the horizon, and R once). A soft
        limit is kept exactly, where it can be kept, as long as its multiplier stays below the penalty.

    Raises
    ------
    ModelError : an argument is not valid; the message names it, its value and the remedy.
    NumericalError : the plant grows beyond 1e308 over the horizon.
    """
    model = as_system("model", model)
    n, m = model.n, model.nu
    if not model.discrete:
        raise ModelError(f"model has dt = {model.dt}; discretise it with c2d at the control period first")
    check_period("model", model.dt)
    if not (np.array_equal(model.C, np.eye(n)) and not model.D.any()):
        raise ModelError(
            "model has outputs other than its state; pass C = I, D = 0 and feed the controller an estimate"
        )
    as_choice("form", form, ("velocity", "position"))
    for name, value, least in (("Np", Np, 1), ("Nc", Nc, 1), ("delay", delay, 0)):
        as_whole(name, value, f"a whole number of samples, at least {least}", least=least)
    if Nc > Np:
        raise ModelError(f"Nc is {Nc}, beyond Np = {Np}; a control horizon ends within the prediction horizon")
    penalty = as_number("penalty", penalty, "a positive number", above=0)
    inf = np.inf
    problem = MpcProblem(
        model=model,
        Q=as_cost("Q", Q, n),
        R=as_cost("R", R, m, definite=True),
        terminal=as_cost("terminal", Q if terminal is None else terminal, n),
        Np=Np,
        Nc=Nc,
        umin=as_limits("umin", umin, m, ()),
        umax=as_limits("umax", umax, m, ()),
        form=form,
        ymin=as_limits("ymin", -inf if ymin is None else ymin, n, (-inf,)),
        ymax=as_limits("ymax", inf if ymax is None else ymax, n, (inf,)),
        hmax=as_limits("hmax", inf if hmax is None else hmax, m, (inf,)),
        delay=delay,
        penalty=penalty,
    )
    for low, high in (("umin", "umax"), ("ymin", "ymax")):
        below, above = getattr(problem, low), getattr(problem, high)
        if not (below < above).all():
            i = int(np.flatnonzero(~(below < above))[0])
            raise ModelError(f"{low}[{i}] = {below[i]} is not below {high}[{i}] = {above[i]}; exchange or widen them")
    if not (problem.hmax > 0).all():
        raise ModelError(f"hmax is {problem.hmax}; pass positive limits")
    if problem.condition > CONDITIONED:
        return Mpc(problem=problem, qp=prestabilise(problem))
    posed, exact = pose(problem), LongArithmetic(problem, commands=True)
    return Mpc(problem=problem, qp=canonicalise(posed.problem, posed.phi, posed.variables, exact, m))
