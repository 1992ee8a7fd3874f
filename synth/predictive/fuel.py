"""Least fuel: predictive control that minimises a 1-norm, and the bound below which no control can go.

    minimise    sum_k |u_k|_1 / max(umax)  +  penalty sum_k |s_k / box|_1       (dt |u_k|_1: fuel, delta-v)
    subject to  x_{k+1} = A x_k + B u_k + d_k,   |u_k| <= umax,   |C x_k| <= box + s_k,  s_k >= 0   from `settle` on

The box is soft, so that the program is never infeasible; the penalty is exact: s = 0 wherever the box can be kept and
keeping it costs less fuel than the penalty. Between the samples the box is not looked at.

The bound (`minimum_fuel`) is the dual program: with G(t) the impulse response, for all multipliers l_k of the samples

    integral of |u|_1  >=  -(sum l_k'f_k + box'|l_k|) / max_t |p(t)|_inf,      p(t) = sum_{t_k > t} G(t_k - t)' l_k

f the motion without control, p the primer vector. It holds for every control: continuous, impulsive, of any thrust.
Between the points at which p is computed it is bounded through its second derivative.

References: Lawden (1963), Optimal Trajectories for Space Navigation; Boyd and Vandenberghe (2004), section 5.2;
Maciejowski (2002), Predictive Control with Constraints, section 3.4 (exact penalties).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from synth.checks import as_limits, as_matrix, as_number, as_period, as_signal, as_vector, as_whole, check_period
from synth.errors import ModelError, NumericalError
from synth.predictive.parametriclp import ParametricLp, canonicalise
from synth.systems.connect import check_dynamic
from synth.systems.exponential import expm
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system

if TYPE_CHECKING:
    import cvxpy as cp

REFINED = 20  # points between two samples at which the primer vector is computed


class FuelState(NamedTuple):
    """What the controller remembers from sample to sample."""

    sample: int  # number of steps taken
    basis: Any  # of HiGHS, where the next solve starts; None before the first


@dataclass(frozen=True, eq=False, kw_only=True)
class FuelMpc:
    """A predictive controller of least fuel; `fuel_mpc` makes it. Pure; one object serves one thread."""

    model: StateSpace  # discrete; n states, m inputs, q outputs
    box: np.ndarray  # (q,) half-width of what the outputs are to be kept in
    umax: np.ndarray  # (m,) limit of |u|
    horizon: int  # samples
    settle: int  # samples from the start before the box counts
    forecast: np.ndarray  # (any, n) known increments d_k of the state from the start, zero beyond its end
    lp: ParametricLp  # variables: u+ and u- (horizon m,) in units of umax, excess (horizon q,) in units of the box

    @property
    def dt(self) -> float:
        """Sampling time in seconds."""
        return self.model.dt

    def init(self) -> FuelState:
        """The first sample."""
        return FuelState(0, None)

    def room(self, sample: int, x: np.ndarray, r: np.ndarray) -> np.ndarray:
        """What is left to the upper and to the lower side of the box if nothing is done, in boxes, (2 horizon q,)."""
        N, (q, n) = self.horizon, self.model.C.shape
        ahead = np.zeros((N, n))
        known = self.forecast[sample : sample + N]
        ahead[: len(known)] = known
        y = np.empty((N, q))
        for k in range(N):
            x = self.model.A @ x + ahead[k]
            y[k] = (self.model.C @ x - r) / self.box
        limit = np.where(np.arange(sample + 1, sample + N + 1) >= self.settle, 1.0, np.inf)[:, None]
        return np.concatenate([(limit - y).ravel(), (limit + y).ravel()])

    def step(self, state: FuelState, y: Any, r: Any) -> tuple[FuelState, np.ndarray]:
        """The next state and the command.

        Parameters
        ----------
        y : (n,) measured or estimated state
        r : (q,) centre of the box, or (n,) a state whose output it is

        Returns
        -------
        state, u : u is (m,), within the limits

        Raises
        ------
        ModelError : `y` or `r` has the wrong size or is not finite.
        NumericalError : HiGHS fails. There is no stale command.
        """
        q, n = self.model.C.shape
        x, r = as_signal("y", y), as_signal("r", r)
        if x.shape != (n,) or r.shape not in ((q,), (n,)):
            raise ModelError(f"y has shape {x.shape}, r {r.shape}; pass the state ({n},) and the box's centre ({q},)")
        if not (np.isfinite(x).all() and np.isfinite(r).all()):
            raise ModelError(f"y is {x}, r is {r}; every entry must be finite")
        centre = r if r.shape == (q,) else self.model.C @ r
        solution = self.lp.solve(self.room(state.sample, x, centre), state.basis)
        m = self.umax.size
        u = self.umax * (solution.v[:m] - solution.v[self.horizon * m :][:m])
        return FuelState(state.sample + 1, solution.basis), u


def fuel_mpc(
    model: Any,
    *,
    box: Any,
    umax: Any,
    horizon: int,
    settle: int = 0,
    forecast: Any = None,
    penalty: float = 100.0,
) -> FuelMpc:
    """A predictive controller that keeps outputs in a box with least fuel.

    Parameters
    ----------
    model : discrete system in any form that `system` takes: m inputs whose integral of |u| is the fuel
        (accelerations), q outputs without direct term
    box : scalar or (q,) half-widths, units of y
    umax : scalar or (m,) limits of |u|
    horizon : samples ahead; the box is to be seen from where it begins to count
    settle : samples from the start before the box counts
    forecast : (any, n) known increments of the state in each sample from the start; none unless given. What is not
        known beforehand is left to the feedback: make the box smaller than the one required
    penalty : price of one box of excess at one sample, in units of the largest command over one sample

    Raises
    ------
    ModelError : an argument is not valid; the message names it, its value and the remedy.
    """
    model = as_system("model", model)
    if not model.discrete:
        raise ModelError(f"model has dt = {model.dt}; discretise it with c2d at the control period first")
    check_period("model", model.dt)
    if model.D.any():
        raise ModelError("model has a direct term D; the outputs kept in a box are to be functions of the state")
    as_whole("horizon", horizon, "a whole number of samples, at least 1", least=1)
    as_whole("settle", settle, "a whole number of samples, at least 0", least=0)
    widths, thrust = as_limits("box", box, model.ny, ()), as_limits("umax", umax, model.nu, ())
    for name, value in (("box", widths), ("umax", thrust)):
        if not (value > 0).all():
            raise ModelError(f"{name} is {value}; pass positive numbers")
    penalty = as_number("penalty", penalty, "a positive number", above=0)
    known = np.zeros((0, model.n)) if forecast is None else as_matrix("forecast", forecast, (None, model.n))
    problem, room, variables = pose(model, widths, thrust, horizon, penalty)
    lp = canonicalise(problem, room, variables)
    return FuelMpc(model=model, box=widths, umax=thrust, horizon=horizon, settle=settle, forecast=known, lp=lp)


def pose(
    model: StateSpace, box: np.ndarray, umax: np.ndarray, horizon: int, penalty: float
) -> tuple[cp.Problem, cp.Parameter, list[cp.Variable]]:
    """The program in CVXPY, its parameter, and the variables in the order of `FuelMpc.lp`."""
    import cvxpy as cp

    q, m, N = model.ny, model.nu, horizon
    plus, minus = cp.Variable(N * m, name="plus"), cp.Variable(N * m, name="minus")  # units of umax
    excess = cp.Variable(N * q, name="excess")  # boxes
    room = cp.Parameter(2 * N * q, name="room")
    moved = response(model, N) * np.tile(umax, N) / np.tile(box, N)[:, None] @ (plus - minus)
    fuel = np.tile(umax, N) @ (plus + minus)
    objective = cp.Minimize(fuel / umax.max() + penalty * cp.sum(excess))
    sides: list[Any] = [moved - excess <= room[: N * q], -moved - excess <= room[N * q :]]
    signs: list[Any] = [plus >= 0, minus >= 0, excess >= 0, plus <= 1, minus <= 1]
    return cp.Problem(objective, sides + signs), room, [plus, minus, excess]


def response(model: StateSpace, N: int) -> np.ndarray:
    """Outputs at samples 1..N to held inputs at samples 0..N-1: block Toeplitz, (N q, N m)."""
    q, m = model.ny, model.nu
    blocks, X = [], model.B
    for _ in range(N):
        blocks.append(model.C @ X)
        X = model.A @ X
    T = np.zeros((N, q, N, m))
    for lag, block in enumerate(blocks):
        for k in range(lag, N):
            T[k, :, k - lag] = block
    return T.reshape(N * q, N * m)


@dataclass(frozen=True, eq=False)
class MinimumFuel:
    """What a task costs at least, and impulses that do it for little more."""

    lower: float  # no control does it for less: the dual value over the primer's peak
    upper: float  # fuel of the impulses, >= lower
    impulses: np.ndarray  # (samples, m) integral of u, at times 0, dt, ...
    peak: float  # of the primer vector between the samples; 1 at the samples
    motion: np.ndarray  # (samples + 1, q) outputs under the impulses


def minimum_fuel(G: Any, free: Any, box: Any, *, dt: float, settle: int = 1) -> MinimumFuel:
    """The least integral of |u|_1 with which any control keeps outputs in a box at the samples from `settle` on.

    Parameters
    ----------
    G : continuous system in any form that `system` takes: m inputs, q outputs, without direct term
    free : (samples + 1, q) outputs without control at times 0, dt, 2 dt, ..., with whatever acts on the plant;
        `free_motion` gives those of G alone
    box : scalar or (q,) half-widths
    dt : s, between the samples
    settle : first sample at which the box counts, at least 1

    Raises
    ------
    ModelError : an argument is not valid; the message names it, its value and the remedy.
    NumericalError : the program was not solved: the task is impossible at any price, or badly scaled.

    Notes
    -----
    `lower` holds for the linear G and every control, of any thrust, that meets the box at the samples; meeting it
    between them as well costs no less; up to the rounding of the arithmetic it is a bound, not an estimate.
    """
    import cvxpy as cp

    from synth.lmi.solve import run, value

    G = as_system("G", G)
    if G.discrete or G.D.any():
        raise ModelError(f"G has dt = {G.dt} and |D| = {np.abs(G.D).max():g}; pass a continuous system without D")
    f = as_matrix("free", free, (None, G.ny))
    widths, K, q, m = as_limits("box", box, G.ny, ()), len(f) - 1, G.ny, G.nu
    as_whole("settle", settle, "a whole number of samples, at least 1", least=1)
    if settle > K:
        raise ModelError(f"settle is {settle}, free ends at sample {K}; the box never counts")
    if not (widths > 0).all():
        raise ModelError(f"box is {widths}; pass positive half-widths")
    dt = as_period(dt)
    Phi = c2d(G, dt).A
    moves = response(StateSpace(Phi, Phi @ G.B, G.C, G.D, dt), K)  # of impulses
    scale = np.tile(widths, K - settle + 1)
    rest = f[settle:].ravel() / scale
    v = cp.Variable(K * m)
    y = rest + (moves[(settle - 1) * q :] / scale[:, None]) @ v
    sides: list[Any] = [y <= 1, -y <= 1]
    problem = cp.Problem(cp.Minimize(cp.norm1(v)), sides)
    if run(problem, "HiGHS") != "optimal":
        raise NumericalError(f"HiGHS ended with {problem.status!r}", {"highs": problem.status})
    impulses, multipliers = value(v), value(sides[0].dual_variables[0]) - value(sides[1].dual_variables[0])
    peak = primer_peak(G, (multipliers / scale).reshape(-1, q), dt / REFINED, settle)
    bound = float(multipliers @ rest - np.abs(multipliers).sum())
    motion = f[1:] + (moves @ impulses).reshape(K, q)
    return MinimumFuel(
        lower=bound / max(peak, 1.0),
        upper=float(np.abs(impulses).sum()),
        impulses=impulses.reshape(K, m),
        peak=peak,
        motion=np.vstack([f[:1], motion]),
    )


def primer_peak(G: StateSpace, multipliers: np.ndarray, h: float, settle: int) -> float:
    """A bound of the largest entry of the primer vector p, backwards over the samples in steps of `h` s.

    Within a step p leaves its chord by at most h^2/8 max |p''|, and with p' = -B'A'c of the costate c, entry by entry,
    |p''| <= |A^2 B|' exp(|A| h)' |c|.
    """
    back = expm(G.A.T * h)
    bend = h**2 / 8 * np.abs(G.A @ G.A @ G.B).T @ expm(np.abs(G.A).T * h)
    costate, points, chords = np.zeros(G.n), [0.0], [0.0]
    for k in range(len(multipliers) + settle - 1, 0, -1):
        if k >= settle:
            costate = costate + G.C.T @ multipliers[k - settle]
        for _ in range(REFINED):
            points.append(np.abs(G.B.T @ costate).max())
            chords.append((bend @ np.abs(costate)).max())
            costate = back @ costate
        points.append(np.abs(G.B.T @ costate).max())
    return float(max(points) + max(chords))


def free_motion(G: Any, x0: Any, *, dt: float, samples: int, held: Any = None) -> np.ndarray:
    """Outputs of a continuous system from the state `x0` at 0, dt, ..., (samples + 1, q), without control.

    Parameters
    ----------
    held : (samples, m) inputs that act anyway, such as known perturbations, each held for one sample; none unless given

    Raises
    ------
    ModelError : G is discrete, or a shape does not fit.
    """
    G = c2d(as_system("G", G), dt)
    check_dynamic("G", G)
    x = as_vector("x0", x0, G.n)
    as_whole("samples", samples, "a whole number of samples, at least 1", least=1)
    inputs = np.zeros((samples, G.nu)) if held is None else as_matrix("held", held, (samples, G.nu))
    y = [G.C @ x]
    for u in inputs:
        x = G.A @ x + G.B @ u
        y.append(G.C @ x)
    return np.array(y)
