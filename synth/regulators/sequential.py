"""The exported controller in Python, bit for bit: the same sums in the same order, in float or double.

    v = C x + D e,   u = min(max(v, umin), umax),   x+ = A x + B e + L (u - v)

Where an input e, a sum v or a new state is not finite - a NaN from a sensor, an overflow inside - the sample is a
fault: the last command is held, the states stay, and the caller is told. Before the first sample the command is zero,
as far as the limits allow. A state that is itself not finite stays, and every sample is a fault, until it is reset.

Every sum starts at zero and adds one rounded product after another, from left to right, first the states, then the
inputs, then the deficit u - v of the actuators. The C code (`synth.delivery.c`) is printed from this object.

With the anti-windup gain L a saturated controller follows what the actuators did: while u stays at a limit its
dynamics are A - L C, which must be stable, or the states run away. L = 0 leaves A, the plain clipped controller.

Reference: Astrom and Rundqwist (1989), Integrator windup and how to avoid it, ACC, section 5 (observers).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_limits, as_matrix, restore, shown
from synth.errors import ExportError, ModelError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.controller import LinearController
from synth.synthesis.design import Design
from synth.systems.statespace import StateSpace, as_system

DTYPES = {"double": np.float64, "float": np.float32}  # C's name of the type -> NumPy's
INTEGRATES = 1e-9  # a pole no further than this outside the unit circle is one of an integrator


class State(NamedTuple):
    """What the controller remembers between samples."""

    x: np.ndarray  # (n,)
    u: np.ndarray  # (m,) unit of u, the last command
    fault: bool  # whether the last sample was one, so that this command is held


@dataclass(frozen=True, eq=False)
class SequentialController:
    """A discrete controller with saturation and conditioned anti-windup, stepped as the exported C steps it.

    Make one with `SequentialController.of`, which checks.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, p)
    C: np.ndarray  # (m, n)
    D: np.ndarray  # (m, p)
    L: np.ndarray  # (n, m) what the states learn of the deficit
    umin: np.ndarray  # (m,) unit of u, -inf where free
    umax: np.ndarray  # (m,) unit of u, inf where free
    dt: float  # s
    __setstate__ = restore

    @property
    def dtype(self) -> str:
        """C's name of the numbers' type: "float" or "double"."""
        return "float" if self.A.dtype == np.float32 else "double"

    @property
    def limited(self) -> bool:
        """True when an output has a limit."""
        return bool(np.isfinite(self.umin).any() or np.isfinite(self.umax).any())

    @property
    def conditioned(self) -> bool:
        """True when the states learn of the deficit: there are limits and L is not zero."""
        return self.limited and bool(self.L.any())

    @property
    def system(self) -> StateSpace:
        """The controller with the rounded matrices and without limits, as a StateSpace in double precision."""
        A, B, C, D = (M.astype(float) for M in (self.A, self.B, self.C, self.D))
        return StateSpace(A, B, C, D, self.dt)

    def init(self) -> State:
        """Zero states, and zero commands as far as the limits allow."""
        zero = np.zeros(len(self.D), self.A.dtype)
        return State(np.zeros(len(self.A), self.A.dtype), self._limited(zero), False)

    def _limited(self, v: np.ndarray) -> np.ndarray:
        """V within the limits; the comparisons are such that NaN would not pass."""
        return np.where(~(v >= self.umin), self.umin, np.where(~(v <= self.umax), self.umax, v))

    def update(self, state: State, e: Any) -> tuple[State, np.ndarray]:
        """(state, e) -> (state, u) with controller input e (p,), u (m,): one call of the C function.

        The input is rounded to the controller's type first, as a C compiler does on assignment.
        """
        with np.errstate(all="ignore"):
            x, e = state.x, np.asarray(e, self.A.dtype)
            if e.shape != (self.D.shape[1],):
                raise ModelError(f"the controller input has shape {e.shape}; pass {self.D.shape[1]} numbers")
            v = _sum(len(self.D), (self.C, x), (self.D, e))
            u = self._limited(v)
            terms = [(self.A, x), (self.B, e)]
            if self.conditioned:
                terms.append((self.L, u - v))
            following = _sum(len(self.A), *terms)
        if np.isfinite(e).all() and np.isfinite(v).all() and np.isfinite(following).all():
            return State(following, u, False), u
        return state._replace(fault=True), state.u

    def step(self, state: State, y: Any, r: Any) -> tuple[State, np.ndarray]:
        """(state, y, r) -> (state, u): `update` with e = r - y, so that a simulator can fly the exported controller."""
        with np.errstate(all="ignore"):
            e = np.asarray(r, self.A.dtype) - np.asarray(y, self.A.dtype)
        return self.update(state, e)

    @classmethod
    def of(
        cls,
        source: Any,
        *,
        dtype: str = "double",
        umin: Any = None,
        umax: Any = None,
        antiwindup: Any = None,
        allow_unstable: bool = False,
    ) -> SequentialController:
        """From a discrete Design, StateSpace, `LinearController` or `AntiWindup` (whose limits and gain it keeps).

        Parameters
        ----------
        dtype : "double" or "float"
        umin, umax : number or (m,) limits of u, infinite where free; None for no limit
        antiwindup : (n, m) gain L; None for zero
        allow_unstable : accept poles on or outside the unit circle

        Raises
        ------
        ModelError : the limits or the gain are not valid.
        ExportError : the controller is continuous or unstable, its numbers do not fit into `dtype`, or A - L C is not
            stable.
        """
        if not isinstance(dtype, str) or dtype not in DTYPES:
            raise ExportError(f"dtype is {shown(dtype)}; pass 'double' or 'float'")
        if isinstance(source, AntiWindup):
            if not (umin is None and umax is None and antiwindup is None):
                raise ModelError("umin, umax or antiwindup is given, but an AntiWindup has its own; leave them away")
            umin, umax, antiwindup = source.umin, source.umax, source.L
        K = controller_of(source)
        if not K.discrete:
            raise ExportError(
                "the controller is continuous; a processor steps discrete ones: discretise it with c2d(K, dt), or "
                "design on c2d(plant, dt), and verify the sampled loop"
            )
        if antiwindup is not None and umin is None and umax is None:
            raise ModelError("antiwindup is given without limits; pass umin and umax, or leave it away")
        low = as_limits("umin", -np.inf if umin is None else umin, K.ny)
        high = as_limits("umax", np.inf if umax is None else umax, K.ny)
        L = np.zeros((K.n, K.ny))
        if antiwindup is not None and K.n:
            L = as_matrix("antiwindup", antiwindup, (K.n, K.ny))
        numbers = {"A": K.A, "B": K.B, "C": K.C, "D": K.D, "L": L, "umin": low, "umax": high}
        rounded = {name: _round(name, M, dtype) for name, M in numbers.items()}
        controller = cls(**rounded, dt=K.dt)
        if not (controller.umin < controller.umax).all():
            raise ModelError(f"umin = {low.tolist()} is not below umax = {high.tolist()}; leave room between them")
        _check_stability(controller, allow_unstable)
        return controller


def controller_of(source: Any) -> StateSpace:
    """The linear controller of a Design, a `LinearController`, an `AntiWindup` or a state-space system."""
    if isinstance(source, Design):
        return source.controller
    if isinstance(source, LinearController | AntiWindup):
        return StateSpace(source.A, source.B, source.C, source.D, source.dt)
    return as_system("the controller", source)


def _sum(rows: int, *terms: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Sum of M x over the terms, one rounded product after another."""
    total = np.zeros(rows, terms[0][0].dtype)
    for M, x in terms:
        for column, value in zip(M.T, x, strict=True):
            total = total + column * value
    return total


def _round(name: str, M: np.ndarray, dtype: str) -> np.ndarray:
    """The numbers in the type of the exported code, read-only."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = M.astype(DTYPES[dtype])
    lost = np.isfinite(M) & ~np.isfinite(rounded)
    if lost.any():
        raise ExportError(f"{name} has the entry {M[lost][0]:g}, beyond the range of {dtype}; scale the signals")
    rounded.flags.writeable = False
    return rounded


def _check_stability(controller: SequentialController, allow_unstable: bool) -> None:
    """The controller alone, and while every limited output is at its limit."""
    limited = np.isfinite(controller.umin) | np.isfinite(controller.umax)
    A, C, L = (np.asarray(M, dtype=float) for M in (controller.A, controller.C, controller.L))
    saturated = _radius(A - L[:, limited] @ C[limited])
    if limited.any() and saturated >= 1:
        raise ExportError(
            f"A - L C has spectral radius {saturated:.6g}: with its outputs at their limits the controller runs away; "
            "pass the gain of a stable observer as antiwindup (for designs by ncfsyn: AntiWindup.of)"
        )
    radius = _radius(A)
    if radius >= 1 and not (allow_unstable or (radius <= 1 + INTEGRATES and limited.all())):
        kind = "integrates" if radius <= 1 + INTEGRATES else "is unstable"
        raise ExportError(
            f"the controller {kind} (spectral radius {radius:.9g}): its states grow when the loop is open; "
            + ("pass umin, umax and antiwindup, or " if radius <= 1 + INTEGRATES else "")
            + "pass allow_unstable=True if that is intended"
        )


def _radius(A: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
