"""State-dependent Riccati control: the dynamics in pseudo-linear form, and a Riccati equation at every sample.

    dx = A(y) x + B(y) u        a model of `synth.regulators.sdc`, or one of your own

The command u regulates x to zero; r is not used, because y is the error already. A sample whose Riccati equation has
no solution is flown with the gain of the last one that had, and counted in the state's `failures`; before the first
solution that is the gain at rest at the target. Nothing is raised, because all this runs inside compiled loops. Make
controllers with `create`, which checks. Needs JAX with float64.

References: Cimen (2010), Annual Reviews in Control 34, 32; Romero and Souza (2022), CILAMCE, equations (3), (4) and
section 2.1; Glover and McFarlane (1989), IEEE TAC 34, 821.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from synth.checks import as_cost, shown
from synth.equations.are import care
from synth.equations.riccati import closed_loop_rate, continued, discrete_stabilising, stabilising, stabilising_pair
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.regulators.quaternion import as_period
from synth.regulators.regulator import binary, lqr, lqrd, sampled_cost
from synth.regulators.sdc import Factorisation

TINY = 1e-300  # keeps 0 / 0 from being one
SQUARINGS = 20  # of a matrix for its spectral radius, which is then right to 4e-7


class SdreState(NamedTuple):
    """What `Sdre` remembers."""

    gain: Any  # (m, n) last sound gain, u = -gain x
    failures: Any  # () samples so far without a solution
    X: Any  # (n, n) last sound solution
    before: Any  # (n, n) the one before


class GainState(NamedTuple):
    """What the static H-infinity laws remember."""

    gain: Any  # (m, n) last sound gain, u = -gain x
    failures: Any  # () samples so far without a solution


class NcfState(NamedTuple):
    """What `SdreHinf` remembers."""

    gain: Any  # (m, n) last sound feedback of the estimate
    injection: Any  # (n, n) last sound observer gain
    estimate: Any  # (n,) of x
    side: Any  # () coordinates of the estimate
    failures: Any  # () samples so far without a solution


@dataclass(frozen=True, kw_only=True)
class Sdre:
    """u = -R^-1 B'X x with A'X + X A - X B R^-1 B'X + Q = 0 at every sample (equations 3 and 4)."""

    model: Any  # Factorisation
    Q: np.ndarray  # (n, n) weight of x
    R_inverse: np.ndarray  # (m, m) inverse weight of u
    gain: np.ndarray  # (m, n) at rest at the target
    X: np.ndarray  # (n, n) solution there
    shift: float  # rad/s, typical closed-loop pole
    dt: float  # s

    @classmethod
    def create(cls, model: Factorisation, dt: float, *, Q: Any = None, R: Any = None) -> Sdre:
        """The SDRE controller of a factorised model, such as `MrpModel.create(inertia)`.

        Parameters
        ----------
        model : Factorisation
        dt : sampling time in s, positive
        Q : (n, n) weight of the state, symmetric positive semidefinite; identity when left out
        R : (m, m) weight of the command, symmetric positive definite; identity when left out

        Raises
        ------
        ModelError : weights that are none, `dt` not positive.
        AssumptionError : the factorisation is not stabilisable at the target, or Q does not see a mode there.
        """
        return cls(model=model, dt=as_period(dt), **_at_rest(model, Q, R))

    def init(self) -> SdreState:
        """At rest at the target, nothing failed."""
        return SdreState(self.gain, 0, self.X, self.X)

    def step(self, state: SdreState, y: Any, r: Any) -> tuple[SdreState, Any]:
        """(state, y, r) -> (state, u), u (m,) N m; the last two solutions continued in a line are the guess."""
        x, A, B = self.model.factorise(y, self.model.side(y))
        Kb = self.R_inverse @ B.T
        X, ok = continued(A, B @ Kb, self.Q, self.shift, 2 * state.X - state.before)
        gain = jnp.where(ok, Kb @ X, state.gain)
        new = SdreState(gain, state.failures + ~ok, jnp.where(ok, X, state.X), jnp.where(ok, state.X, state.before))
        return new, -gain @ x


@dataclass(frozen=True, kw_only=True)
class SdreSampled:
    """`Sdre` for long periods: the regulator of the model sampled at y, with u held and the same integral as cost.

    u = -(R + G'X G)^-1 (G'X F + N') x, where X solves the discrete Riccati equation of `sampled_cost`. The gains of
    `Sdre` are those of continuous time, which a hold can make unstable; see `synth.regulators.regulator.lqrd`.
    """

    model: Any  # Factorisation
    Q: np.ndarray  # (n, n) weight of x
    R: np.ndarray  # (m, m) weight of u
    gain: np.ndarray  # (m, n) at rest at the target
    dt: float  # s

    @classmethod
    def create(cls, model: Factorisation, dt: float, *, Q: Any = None, R: Any = None) -> SdreSampled:
        """Parameters and errors of `Sdre.create`."""
        A, B = _linear(model)
        Q = as_cost("Q", 1.0 if Q is None else Q, len(A))
        R = as_cost("R", 1.0 if R is None else R, B.shape[1], definite=True)
        K, _, _ = lqrd(A, B, Q, R, as_period(dt))
        return cls(model=model, Q=Q, R=R, gain=K, dt=as_period(dt))

    def init(self) -> GainState:
        """Nothing failed."""
        return GainState(self.gain, 0)

    def step(self, state: GainState, y: Any, r: Any) -> tuple[GainState, Any]:
        """(state, y, r) -> (state, u), u (m,) N m."""
        x, A, B = self.model.factorise(y, self.model.side(y))
        return _hold(state, x, *sampled_gain(A, B, self.Q, self.R, self.dt))


@dataclass(frozen=True, kw_only=True)
class SdreHinf:
    """Glover and McFarlane's robust controller of [Q^1/2] (sI - A)^-1 B [R^-1/2], at every sample anew.

    An observer of x with a state feedback, of the level gamma = gamma_factor gamma_min (see
    `synth.synthesis.loopshaping`):

        dxh = A xh + B u + Z Q (x - xh),   u = -R^-1 B'Xg xh,   Xg = [(1 - g^-2) I - g^-2 X Z]^-1 X

    with X, Z from the control and the filter Riccati equation and gamma_min^2 = 1 + rho(X Z). The observer is stepped
    by the trapezoidal rule, starts from the first measurement, and is told the command within the actuator's limit.
    """

    model: Any  # Factorisation
    Q: np.ndarray  # (n, n) weight of x
    R_inverse: np.ndarray  # (m, m) inverse weight of u
    gain: np.ndarray  # (m, n) at rest at the target
    injection: np.ndarray  # (n, n) at rest at the target
    shift: float  # rad/s, typical closed-loop pole
    gamma_factor: float  # level over the optimal one
    torque_limit: float  # N m of the actuator, per axis
    dt: float  # s

    @classmethod
    def create(
        cls,
        model: Factorisation,
        dt: float,
        *,
        Q: Any = None,
        R: Any = None,
        gamma_factor: float = 1.1,
        torque_limit: float = np.inf,
    ) -> SdreHinf:
        """The robust controller of a factorised model; parameters and errors of `Sdre.create`, and

        Parameters
        ----------
        model, dt, Q, R : as in `Sdre.create`
        gamma_factor : level asked for over the optimal one, above 1
        torque_limit : N m, what the actuator can give on every axis; none when left out

        Raises
        ------
        ModelError : also for a `gamma_factor` not above 1 or a limit that is not positive.
        AssumptionError : as in `Sdre.create`; also when Q leaves a mode at the target that the filter cannot see.
        """
        if not torque_limit > 0:
            raise ModelError(f"torque_limit is {torque_limit}; pass a positive torque in N m, or leave it out")
        rest = _robust_at_rest(model, Q, R, as_gamma_factor(gamma_factor))
        return cls(
            model=model, gamma_factor=float(gamma_factor), torque_limit=float(torque_limit), dt=as_period(dt), **rest
        )

    def init(self) -> NcfState:
        """At rest at the target, nothing measured yet."""
        return NcfState(self.gain, self.injection, np.zeros(len(self.Q)), 0.0, 0)

    def step(self, state: NcfState, y: Any, r: Any) -> tuple[NcfState, Any]:
        """(state, y, r) -> (state, u), u (m,) N m."""
        side = self.model.side(y)
        x, A, B = self.model.factorise(y, side)
        # new coordinates move the estimate along, so that its error stays
        moved = state.estimate + x - self.model.factorise(y, state.side)[0]
        estimate = jnp.where(state.side == 0, x, moved)
        K, Z, ok = robust_gain(A, B, self.Q, self.R_inverse, self.shift, self.gamma_factor)
        gain = jnp.where(ok, K, state.gain)
        injection = jnp.where(ok, Z @ self.Q, state.injection)
        u = -gain @ estimate
        given = jnp.clip(u, -self.torque_limit, self.torque_limit)
        slope = A @ estimate + B @ given + injection @ (x - estimate)
        half = jnp.eye(len(A)) - self.dt / 2 * (A - injection)
        estimate = estimate + self.dt * jnp.linalg.solve(half, slope)
        return NcfState(gain, injection, estimate, side, state.failures + ~ok), u


@dataclass(frozen=True, kw_only=True)
class SdreHinfStatic:
    """u = -R^-1 B'Xg x: the state feedback of `SdreHinf` without its observer."""

    model: Any  # Factorisation
    Q: np.ndarray  # (n, n) weight of x
    R_inverse: np.ndarray  # (m, m) inverse weight of u
    gain: np.ndarray  # (m, n) at rest at the target
    injection: np.ndarray  # (n, n) at rest at the target, not used
    shift: float  # rad/s, typical closed-loop pole
    gamma_factor: float  # level over the optimal one
    dt: float  # s

    @classmethod
    def create(
        cls, model: Factorisation, dt: float, *, Q: Any = None, R: Any = None, gamma_factor: float = 1.1
    ) -> SdreHinfStatic:
        """Parameters and errors of `SdreHinf.create`."""
        rest = _robust_at_rest(model, Q, R, as_gamma_factor(gamma_factor))
        return cls(model=model, gamma_factor=float(gamma_factor), dt=as_period(dt), **rest)

    def init(self) -> GainState:
        """Nothing failed."""
        return GainState(self.gain, 0)

    def step(self, state: GainState, y: Any, r: Any) -> tuple[GainState, Any]:
        """(state, y, r) -> (state, u), u (m,) N m."""
        x, A, B = self.model.factorise(y, self.model.side(y))
        K, _, ok = robust_gain(A, B, self.Q, self.R_inverse, self.shift, self.gamma_factor)
        return _hold(state, x, K, ok)


@dataclass(frozen=True, kw_only=True)
class SdreHinfPaperLiteral:
    """The H-infinity law that reproduces the published results, steps 1 to 6 of section 2.1; not a robust controller.

    Those results are slow because of gamma = gamma_min and of L = gamma^2 I + X Z where equation 13 prints
    L = (1 - gamma^2) I + X Z. Its controller (AK, BK) is taken for a plant, whose regulator with unit weights, P, is
    applied to x: u = -B'P x. For comparisons only.
    """

    model: Any  # Factorisation
    gain: np.ndarray  # (m, n) at rest at the target
    shift: float  # rad/s, typical closed-loop pole
    dt: float  # s

    @classmethod
    def create(cls, model: Factorisation, dt: float) -> SdreHinfPaperLiteral:
        """Unit weights, as published; errors of `Sdre.create`."""
        rest = _at_rest(model, None, None)
        A, B = _linear(model)
        X, (Z, ok) = rest["X"], _filter_at_rest(A, B, rest)
        AK, BK = _published(A, B, X, Z, np.abs(np.linalg.eigvals(X @ Z)).max(), np)
        P, solved = care(AK, BK, np.eye(len(A)))
        if not (ok and solved):
            raise NumericalError("the third Riccati equation has no solution at the target; use SdreHinf")
        return cls(model=model, gain=B.T @ P, shift=rest["shift"], dt=as_period(dt))

    def init(self) -> GainState:
        """Nothing failed."""
        return GainState(self.gain, 0)

    def step(self, state: GainState, y: Any, r: Any) -> tuple[GainState, Any]:
        """(state, y, r) -> (state, u), u (m,) N m."""
        x, A, B = self.model.factorise(y, self.model.side(y))
        return _hold(state, x, *published_gain(A, B, self.shift))


@jax.jit
def sampled_gain(A: Array, B: Array, Q: Any, R: Any, dt: Any) -> tuple[Array, Array]:
    """The gain of `lqrd` (m, n) and whether it exists; traceable."""
    t = 1 / binary(jnp.sqrt(jnp.diagonal(Q)), jnp)  # units of x in which all states are weighed alike
    A, B, Q = A * t / t[:, None], B / t[:, None], t[:, None] * Q * t
    F, G, Q, R, N = sampled_cost(A, B, Q, R, dt, xp=jnp, expm=jax.scipy.linalg.expm)
    S = jnp.linalg.solve(R, jnp.concatenate([N.T, G.T], 1))  # takes the cross weight out
    RN, RG = S[:, : len(A)], S[:, len(A) :]
    X, ok = discrete_stabilising(F - G @ RN, G @ RG, Q - N @ RN)
    K = jnp.linalg.solve(R + G.T @ X @ G, G.T @ X @ F + N.T)
    return K / t, ok & jnp.isfinite(K).all()


@jax.jit
def robust_gain(
    A: Array, B: Array, Q: Any, R_inverse: Any, shift: Any, gamma_factor: Any
) -> tuple[Array, Array, Array]:
    """State feedback K = R^-1 B'Xg, filter solution Z and whether they exist; traceable."""
    Kb = R_inverse @ B.T
    X, Z, ok = stabilising_pair(A, B @ Kb, Q, shift)
    K = _robust(X, Z, Kb, gamma_factor, _spectral_radius(X @ Z), jnp)
    return K, Z, ok & jnp.isfinite(K).all()


def _robust(X: Any, Z: Any, Kb: Any, gamma_factor: Any, rho: Any, xp: Any) -> Any:
    """The state feedback of `SdreHinf` from the solutions of its two equations."""
    g2 = gamma_factor**2 * (1 + rho)
    return Kb @ xp.linalg.solve((1 - 1 / g2) * xp.eye(len(X)) - X @ Z / g2, X)


@jax.jit
def published_gain(A: Array, B: Array, shift: Any) -> tuple[Array, Array]:
    """The gain of `SdreHinfPaperLiteral` and whether it exists; traceable."""
    I = jnp.eye(len(A))
    X, Z, ok = stabilising_pair(A, B @ B.T, I, shift)
    AK, BK = _published(A, B, X, Z, _spectral_radius(X @ Z), jnp)
    P, solved = stabilising(AK, BK @ BK.T, I, shift)
    return B.T @ P, ok & solved


def _published(A: Any, B: Any, X: Any, Z: Any, rho: Any, xp: Any) -> tuple[Any, Any]:
    """AK and BK of the published controller from the solutions of its first two equations."""
    g2 = 1 + rho  # equation 10
    BK = g2 * xp.linalg.solve((g2 * xp.eye(len(A)) + X @ Z).T, Z)  # equation 13 with C = I, D = 0 and its L changed
    return A - B @ B.T @ X + BK, BK


def as_gamma_factor(value: Any) -> float:
    """A number above 1, or a ModelError."""
    if not (np.isfinite(value) and value > 1):
        raise ModelError(f"gamma_factor is {value}; pass a number above 1, 1.1 for example")
    return float(value)


def _linear(model: Factorisation) -> tuple[np.ndarray, np.ndarray]:
    """A and B at the target.

    Raises
    ------
    ModelError : the model cannot be factorised.
    """
    if not all(callable(getattr(model, name, None)) for name in ("target", "side", "factorise")):
        raise ModelError(f"model is {shown(model)}; pass a model with target, side and factorise, MrpModel for example")
    with jax.enable_x64(True):
        y = jnp.asarray(model.target(), float)
        _, A, B = model.factorise(y, model.side(y))
        return np.array(A), np.array(B)


def _at_rest(model: Factorisation, Q: Any, R: Any) -> dict[str, Any]:
    """Weights, and the regulator at the target."""
    A, B = _linear(model)
    n, m = B.shape
    Q, R = as_cost("Q", 1.0 if Q is None else Q, n), as_cost("R", 1.0 if R is None else R, m, definite=True)
    K, X, _ = lqr(A, B, Q, R)
    R_inverse = np.linalg.inv(R)
    shift = float(closed_loop_rate(A, B @ R_inverse @ B.T, Q))
    return {"Q": Q, "R_inverse": R_inverse, "gain": K, "X": X, "shift": shift}


def _robust_at_rest(model: Factorisation, Q: Any, R: Any, gamma_factor: float) -> dict[str, Any]:
    """Weights, and the robust gains at the target."""
    rest = _at_rest(model, Q, R)
    A, B = _linear(model)
    Z, ok = _filter_at_rest(A, B, rest)
    X = rest.pop("X")
    K = _robust(X, Z, rest["R_inverse"] @ B.T, gamma_factor, np.abs(np.linalg.eigvals(X @ Z)).max(), np)
    if not (ok and np.isfinite(K).all()):
        raise AssumptionError(
            "(Q, A) detectable",
            "the filter has no solution at the target: Q does not see an unstable mode of A; weigh it",
        )
    return rest | {"gain": K, "injection": Z @ rest["Q"]}


def _filter_at_rest(A: np.ndarray, B: np.ndarray, rest: dict[str, Any]) -> tuple[np.ndarray, bool]:
    """Solution of the filter's equation at the target and whether it exists; NumPy, so that nothing is compiled."""
    values, vectors = np.linalg.eigh(rest["Q"])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    Z, ok = care(A.T, root, B @ rest["R_inverse"] @ B.T)
    return np.where(ok, Z, 0.0), bool(ok)


def _hold(state: GainState, x: Array, K: Array, ok: Array) -> tuple[GainState, Array]:
    """One sample of a static law: its gain if it is sound, else the last one, counted."""
    gain = jnp.where(ok, K, state.gain)
    return GainState(gain, state.failures + ~ok), -gain @ x


def _spectral_radius(M: Array) -> Array:
    """Of a product of two positive semidefinite matrices, whose eigenvalues are real and not negative."""

    def square(P, _):
        P = P @ P
        return P / (jnp.trace(P) + TINY), None

    P, _ = jax.lax.scan(square, M / (jnp.trace(M) + TINY), length=SQUARINGS)
    return jnp.trace(P @ M) / (jnp.trace(P) + TINY)
