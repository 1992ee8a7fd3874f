"""Controllers as plain data: what the simulator asks of them, and the linear ones.

A controller is an object with `dt`, `init() -> state` and `step(state, y, r) -> (state, u)`. The state goes in and
comes out; nothing is remembered in the object, so one controller serves any number of runs at once.

Sign: the linear controllers act on the error e = r - y, the controller input of the tracking plant
(Pecorilla and Stesina 2024, equation 27). That is the positive convention u = K e of `lft`: a K from `hinfsyn` on
`GeneralizedPlant.tracking` is used as it is, without a minus sign.

The steps are written with `@` alone, so the same lines run on NumPy arrays and inside a JAX transformation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from synth.checks import as_array, as_matrix, as_number, as_timebase, as_weight, as_whole, check_period, restore
from synth.errors import ModelError
from synth.systems.statespace import StateSpace, as_system


class Controller(Protocol):
    """What a sampled loop needs to know about a controller."""

    @property
    def dt(self) -> float:
        """Sampling time in seconds."""
        ...

    def init(self) -> Any:
        """The state before the first sample."""
        ...

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """The next state and the command, from the measurement `y` and the reference `r`. Pure."""
        ...


@dataclass(frozen=True)
class LinearController:
    """x+ = A x + B e, u = C x + D e with e = r - y (positive convention, equation 27).

    Make one with `LinearController.of`, which checks. The fields are not checked here, so that the class can be
    rebuilt from traced arrays.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, p)
    C: np.ndarray  # (m, n)
    D: np.ndarray  # (m, p)
    dt: float  # s
    __setstate__ = restore

    def init(self) -> np.ndarray:
        """The zero state, (n,)."""
        return np.zeros(self.A.shape[-1])

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """(state, y, r) -> (state, u) with state (n,), y and r (p,), u (m,)."""
        e = r - y
        return self.A @ state + self.B @ e, self.C @ state + self.D @ e

    def padded(self, states: int) -> LinearController:
        """The same law with zeros for further states, so that controllers of different orders share a compiled flight.

        Raises
        ------
        ModelError : no whole number up to 1000, or the controller has more states.
        """
        n = len(self.A)
        states = as_whole("states", states, f"a whole number of at least {n}", least=n, most=max(n, 1000))
        A, B = np.zeros((states, states)), np.zeros((states, self.B.shape[1]))
        C = np.zeros((len(self.C), states))
        A[:n, :n], B[:n], C[:, :n] = self.A, self.B, self.C
        return LinearController(A, B, C, self.D, self.dt)

    @classmethod
    def of(cls, K: Any) -> LinearController:
        """From a discrete system whose input is e = r - y, in any form that `synth.system` takes.

        Raises
        ------
        ModelError : K is no state-space system or is continuous.
        """
        K = as_system("K", K)
        if not K.discrete:
            raise ModelError(f"K has dt = {K.dt}: a sampled loop steps discrete controllers; convert it with c2d first")
        check_period("K", K.dt)
        return cls(K.A, K.B, K.C, K.D, K.dt)


def state_feedback(K: Any, dt: float) -> LinearController:
    """The static controller u = K (r - y), a `LinearController` without states.

    Parameters
    ----------
    K : (m, p) gain, units of u per unit of y
    dt : sampling time in s, positive

    Raises
    ------
    ModelError : K is no finite matrix or `dt` is no sampling time.
    """
    return LinearController.of(StateSpace.gain(as_matrix("K", K), as_timebase(dt)))


def proportional_derivative(inertia: Any, wn: float, zeta: float, dt: float) -> LinearController:
    """Proportional-derivative attitude control u = -I (2 wn^2 q + 2 zeta wn w) on y = [q; w].

    For small angles q is half the rotation vector, so every axis becomes th'' + 2 zeta wn th' + wn^2 th = 0.

    Parameters
    ----------
    inertia : (3,) principal moments or (3, 3) matrix, kg m^2
    wn : natural frequency in rad/s, positive
    zeta : damping ratio, positive
    dt : sampling time in s, positive

    Returns
    -------
    LinearController : y and r are (6,), the quaternion's vector part and the body rate in rad/s; u is (3,) in N m,
        the torque on the body.

    Raises
    ------
    ModelError : a value is not positive, or the inertia is not symmetric positive definite.
    """
    J = as_inertia(inertia)
    wn, zeta = (as_number(name, v, "a positive number", above=0) for name, v in (("wn", wn), ("zeta", zeta)))
    return state_feedback(np.hstack([2 * wn**2 * J, 2 * zeta * wn * J]), dt)


def as_inertia(inertia: Any) -> np.ndarray:
    """A symmetric positive definite (3, 3) matrix in kg m^2, from itself or from principal moments."""
    J = (
        as_weight("inertia", inertia, 3)
        if np.ndim(as_array("inertia", inertia))
        else as_matrix("inertia", inertia, (3, 3))
    )
    if not np.allclose(J, J.T, rtol=0, atol=1e-12 * np.abs(J).max()) or np.linalg.eigvalsh(J)[0] <= 0:
        raise ModelError(f"inertia is {J.tolist()}; pass a symmetric positive definite matrix in kg m^2")
    return J
