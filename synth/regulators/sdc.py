"""Pseudo-linear models of a rigid body with reaction wheels, dx = A(y) x + B u: state-dependent coefficients.

    y = [q0 q1 q2 q3  wx wy wz  hx hy hz]    quaternion (scalar first) of the body relative to the target frame at rest,
                                             rate in rad/s, wheel momentum hw in N m s, both in body axes
    Ib dw = -w x (Ib w + hw) + u             equation 23 with u = -g: the wheels take up dhw = g = -u in body axes
    hw = sum of Is (wheel speed + w . a) a   equation 21: of the inertial spin, so that Ib leaves the rotors' spin out

The input u is the torque on the body, N m. The sign of the quaternion is free. `EulerModel` measures 3-2-1 Euler
angles instead, y = [roll pitch yaw  wx wy wz  hx hy hz].

References: Romero and Souza (2022), CILAMCE, equations (21) to (26), whose q4 is q0 here; Schaub and Junkins (1996),
J. Astronautical Sciences 44, 1 (modified Rodrigues parameters and their shadow); the satellite simulator of INPE,
"SDRE and Kalman filter", equations (4), (5), (13), (14), see `EulerModel`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array

from synth.errors import ModelError
from synth.regulators.quaternion import as_inertia

MEASUREMENTS = 10


class Factorisation(Protocol):
    """Dynamics in pseudo-linear form, dx = A(y) x + B(y) u. Yours fits if it is a frozen dataclass with these."""

    def target(self) -> np.ndarray:
        """The measurement at rest at the target."""
        ...

    def side(self, y: Any) -> Any:
        """Which of several coordinates for x are in use at y, a float."""
        ...

    def factorise(self, y: Any, side: Any) -> tuple[Any, Any, Any]:
        """State x (n,), A (n, n) and B (n, m) at the measurement y, x in the coordinates `side`."""
        ...


@dataclass(frozen=True, kw_only=True)
class MrpModel:
    """x = [s; w], modified Rodrigues parameters s = qv / (1 + q0) of the short way round: stabilisable everywhere.

    ds = 1/4 [(1 - s's) I + 2 [s x] + 2 s s'] w; beyond half a turn the shadow, -s / s's, takes over.
    """

    inertia: np.ndarray  # (3, 3) kg m^2, Ib of equation 22
    inverse: np.ndarray  # (3, 3) 1/(kg m^2)

    @classmethod
    def create(cls, inertia: Any) -> MrpModel:
        """From Ib of equation 22, (3, 3) kg m^2: the body's inertia less the spin inertia of its rotors.

        Raises
        ------
        ModelError : the inertia is not symmetric positive definite.
        """
        J = as_inertia(inertia)
        return cls(inertia=J, inverse=np.linalg.inv(J))

    def target(self) -> np.ndarray:
        """Identity attitude, no rates, no wheel momentum."""
        return np.eye(1, MEASUREMENTS)[0]

    def side(self, y: Any) -> Any:
        """Sign of the quaternion with which s does not exceed one."""
        return _sign(y[0])

    def factorise(self, y: Any, side: Any) -> tuple[Any, Any, Any]:
        """[s; w], A and B, (6,), (6, 6), (6, 3)."""
        s, w = side * y[1:4] / (1 + side * y[0]), y[4:7]
        upper = ((1 - s @ s) * jnp.eye(3) + 2 * _cross(s) + 2 * s[:, None] * s) / 4
        return _assembled(self, s, w, y[7:10], jnp.zeros((3, 3)), upper)


@dataclass(frozen=True, kw_only=True)
class QuaternionModel:
    """x = [qv; w], the vector part of the quaternion: equation 26 without its fourth row, which is never stabilisable.

    dqv = -1/2 [w x] qv + 1/2 q0 w. At q0 = 0 the pair is not stabilisable either: |q0| is kept above a floor.
    """

    inertia: np.ndarray  # (3, 3) kg m^2, Ib of equation 22
    inverse: np.ndarray  # (3, 3) 1/(kg m^2)
    floor: float  # least |q0|

    @classmethod
    def create(cls, inertia: Any, *, floor: float = 1e-4) -> QuaternionModel:
        """From Ib of equation 22, (3, 3) kg m^2; the sign of q0 = 0 counts as positive.

        Raises
        ------
        ModelError : the inertia is not symmetric positive definite, or the floor not between 0 and 1.
        """
        J = as_inertia(inertia)
        if not 0 < floor < 1:
            raise ModelError(f"floor is {floor}; pass a number between 0 and 1, 1e-4 for example")
        return cls(inertia=J, inverse=np.linalg.inv(J), floor=float(floor))

    def target(self) -> np.ndarray:
        """Identity attitude, no rates, no wheel momentum."""
        return np.eye(1, MEASUREMENTS)[0]

    def side(self, y: Any) -> Any:
        """Always 1: the coordinates are never changed."""
        return jnp.ones(())

    def factorise(self, y: Any, side: Any) -> tuple[Any, Any, Any]:
        """[qv; w], A and B, (6,), (6, 6), (6, 3)."""
        w = y[4:7]
        q0 = _sign(y[0]) * jnp.maximum(jnp.abs(y[0]), self.floor)
        return _assembled(self, y[1:4], w, y[7:10], -_cross(w) / 2, q0 / 2 * jnp.eye(3))


@dataclass(frozen=True, kw_only=True)
class EulerModel:
    """x = [angles - target; w], 3-2-1 Euler angles: d angles = E(angles) w, I dw = (I w + hw) x w + u.

    E = [[1, s1 t2, c1 t2], [0, c1, -s1], [0, s1 / c2, c1 / c2]] with s, c, t of roll (1) and pitch (2). At pitch
    +-90 deg E does not exist. Angles are not wrapped: the way to the target is the one that the angles take.
    """

    inertia: np.ndarray  # (3, 3) kg m^2
    inverse: np.ndarray  # (3, 3) 1/(kg m^2)
    angles: np.ndarray  # (3,) rad, roll, pitch, yaw of the target

    @classmethod
    def create(cls, inertia: Any, angles: Any = (0.0, 0.0, 0.0)) -> EulerModel:
        """From the inertia (3, 3) kg m^2 that resists the torque u, and the target (3,) rad.

        Raises
        ------
        ModelError : the inertia is not symmetric positive definite, the target's pitch not within 90 deg.
        """
        J, target = as_inertia(inertia), np.asarray(angles, float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise ModelError(f"angles is {angles}; pass roll, pitch and yaw of the target in rad")
        if abs(target[1]) >= np.pi / 2:
            raise ModelError(f"angles has the pitch {target[1]:.6g} rad; 3-2-1 angles need it within +-pi/2")
        return cls(inertia=J, inverse=np.linalg.inv(J), angles=target)

    def target(self) -> np.ndarray:
        """At the target without rates and wheel momentum."""
        return np.concatenate([self.angles, np.zeros(6)])

    def side(self, y: Any) -> Any:
        """Always 1: the coordinates are never changed."""
        return jnp.ones(())

    def factorise(self, y: Any, side: Any) -> tuple[Any, Any, Any]:
        """[angles - target; w], A and B, (6,), (6, 6), (6, 3)."""
        (s1, s2, _), (c1, c2, _), o = jnp.sin(y[:3]), jnp.cos(y[:3]), jnp.zeros(())
        rows = [[o + 1, s1 * s2 / c2, c1 * s2 / c2], [o, c1, -s1], [o, s1 / c2, c1 / c2]]
        E, w = jnp.stack([jnp.stack(row) for row in rows]), y[3:6]
        O = jnp.zeros((3, 3))
        spin = self.inverse @ _cross(self.inertia @ w + y[6:9])
        A = jnp.concatenate([jnp.concatenate([O, E], 1), jnp.concatenate([O, spin], 1)])
        return jnp.concatenate([y[:3] - self.angles, w]), A, jnp.concatenate([O, jnp.asarray(self.inverse)])


def _sign(a: Any) -> Any:
    """1 for zero."""
    return jnp.where(a < 0, -1.0, 1.0)


def _cross(v: Any) -> Array:
    """[v x]."""
    a, b, c = v
    o = jnp.zeros_like(a)
    return jnp.stack([jnp.stack([o, -c, b]), jnp.stack([c, o, -a]), jnp.stack([-b, a, o])])


def _assembled(model: Any, attitude: Any, w: Any, wheels: Any, left: Any, right: Any) -> tuple[Array, Array, Array]:
    """X = [attitude; w], A = [[left, right], [0, Ib^-1 (hw x - w x Ib)]] (equation 25), B = [0; Ib^-1]."""
    O = jnp.zeros((3, 3))
    spin = model.inverse @ (_cross(wheels) - _cross(w) @ model.inertia)
    A = jnp.concatenate([jnp.concatenate([left, right], 1), jnp.concatenate([O, spin], 1)])
    return jnp.concatenate([attitude, w]), A, jnp.concatenate([O, jnp.asarray(model.inverse)])
