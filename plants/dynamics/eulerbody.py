"""Rigid body with three reaction wheels in 3-2-1 Euler angles, driven by a random torque: a platform on an air bearing.

    d angles = E(angles) w                                  E = [[1, s1 t2, c1 t2], [0, c1, -s1], [0, s1/c2, c1/c2]]
    I dw = (I w + h) x w - u + d,  h = Iw Om,  dh = u       u: torque that spins the wheels up, d: of the surroundings

with s, c, t of roll (1) and pitch (2). I holds the wheels, whose speeds Om are relative to the body. In pseudo-linear
form, [angles; w] has A = [[0, E], [0, I^-1 [(I w + h) x]]] and B = [0; I^-1] for the torque on the body, -u + d.

At pitch +-90 deg E does not exist. `check_pitch` and `kinematics` raise there; in a compiled loop the derivative is
NaN from `MARGIN` on, which ends the run with its time and the culprit "plant".
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from plants.checks import Numbers, positive, real
from plants.dynamics.inertia import check_moments, inertia_matrix
from plants.errors import ScenarioError, SingularityError
from plants.geometry import attitude
from plants.simulation import blocks

MARGIN = np.radians(0.5)  # rad of pitch before +-90 deg, where E has grown to 115


class EulerState(NamedTuple):
    """State of a rigid body with three wheels."""

    angles: ArrayLike  # (3,) rad, roll, pitch, yaw: 3-2-1, |pitch| < 90 deg, roll and yaw not wrapped
    w: ArrayLike  # (3,) rad/s, inertial rate in body axes
    wheels: ArrayLike  # (3,) rad/s, wheel speeds relative to the body


class TorqueEnv(NamedTuple):
    """Surroundings at one time."""

    torque: Array  # (3,) N m on the body, body axes


@partial(blocks.node, data_fields=["inertia", "inverse", "wheel_inertia"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class EulerBody:
    """A rigid body with wheels on its three axes. Build it with `EulerBody.create`, which checks the numbers."""

    inertia: Numbers  # (3, 3) kg m^2, wheels included
    inverse: Numbers  # (3, 3) 1/(kg m^2)
    wheel_inertia: Numbers  # (3,) kg m^2

    @classmethod
    def create(cls, inertia: ArrayLike, *, wheel_inertia: ArrayLike, physical: bool = True) -> "EulerBody":
        """Body from its inertia and that of its wheels about their spin axes.

        Parameters
        ----------
        inertia : (3, 3) kg m^2, or (3,) its diagonal
        wheel_inertia : (3,) kg m^2
        physical : as in `RigidBody.create`

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, an inertia that is not symmetric positive definite or that no body has, a wheel without
            inertia.
        """
        I, Js = inertia_matrix("inertia", inertia), positive("wheel_inertia", wheel_inertia, (3,))
        if isinstance(I, Tracer):
            return cls(inertia=I, inverse=jnp.linalg.inv(I), wheel_inertia=Js)
        if np.linalg.eigvalsh(I)[0] <= 0:
            raise ScenarioError(f"inertia must be symmetric positive definite, got {I.tolist()} kg m^2")
        if physical:
            check_moments("inertia", I)
        return cls(inertia=I, inverse=np.linalg.inv(I), wheel_inertia=Js)

    def derivative(self, x: EulerState, u: ArrayLike, env: TorqueEnv) -> EulerState:
        """Time derivative of the state under wheel torques u (3,) N m and the torque of the surroundings."""
        u = jnp.asarray(u)
        gyroscopic = attitude.cross(self.momentum(x), x.w)
        return EulerState(
            angles=kinematics(x.angles) @ x.w,
            w=self.inverse @ (gyroscopic - u + env.torque),
            wheels=u / self.wheel_inertia,
        )

    def momentum(self, x: EulerState) -> Array:
        """Angular momentum I w + h in body axes, (3,) N m s."""
        return jnp.asarray(self.inertia) @ x.w + self.wheel_inertia * jnp.asarray(x.wheels)

    def mass(self) -> Array:
        """(9, 9) what the rates of the output are multiplied by in the equations of motion: ones and the inertia."""
        O, one = jnp.zeros((3, 3)), jnp.eye(3)
        return jnp.block([[one, O, O], [O, jnp.asarray(self.inertia), O], [O, O, one]])

    def output(self, x: EulerState, env: TorqueEnv) -> Array:
        """(9,): angles (3,) rad, rate (3,) rad/s, wheel momentum h (3,) N m s."""
        return jnp.concatenate([jnp.asarray(x.angles), jnp.asarray(x.w), self.wheel_inertia * jnp.asarray(x.wheels)])

    def project(self, x: EulerState) -> EulerState:
        """The state as it is."""
        return x

    def pseudolinear(self, angles: ArrayLike, w: ArrayLike, wheels: ArrayLike) -> tuple[Array, Array]:
        """A (6, 6) and B (6, 3) of d[angles; w] = A [angles; w] + B (torque on the body)."""
        O, momentum = jnp.zeros((3, 3)), self.momentum(EulerState(angles, w, wheels))
        spin = self.inverse @ attitude.cross_matrix(momentum)
        A = jnp.block([[O, kinematics(angles)], [O, spin]])
        return A, jnp.concatenate([O, jnp.asarray(self.inverse)])


@partial(blocks.node, data_fields=["torque", "period"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class RandomTorque:
    """A torque on the body, independent from sample to sample and linear in between: band-limited white noise."""

    torque: Numbers  # (N, 3) N m, at 0, period, 2 period ...; the last one for good
    period: Numbers  # () s

    @classmethod
    def create(cls, deviation: float, *, period: float, duration: float, seed: int) -> "RandomTorque":
        """Torque of standard deviation `deviation` N m on each axis, every `period` s until `duration` s.

        Raises
        ------
        ScenarioError
            A negative deviation, a period or duration that is not positive.
        """
        real("deviation", deviation, low=0)
        for name, value in (("period", period), ("duration", duration)):
            if not real(name, value) > 0:
                raise ScenarioError(f"{name} = {value} s: give a positive number")
        samples = 1 + int(np.ceil(duration / period - 1e-9))
        drawn = np.random.default_rng(seed).standard_normal((samples, 3))
        return cls(torque=deviation * drawn, period=np.array(float(period)))

    def at(self, t: ArrayLike) -> TorqueEnv:
        """The torque at t () s."""
        table, place = jnp.asarray(self.torque), jnp.asarray(t) / self.period
        k = jnp.clip(place.astype(int), 0, len(table) - 2)
        part = jnp.clip(place - k, 0.0, 1.0)
        return TorqueEnv((1 - part) * table[k] + part * table[k + 1])


def kinematics(angles: ArrayLike) -> Array:
    """E (3, 3) with d angles = E w; NaN within `MARGIN` of pitch +-90 deg and beyond it.

    Raises
    ------
    SingularityError
        The same for concrete angles; under `jit` it is NaN.
    """
    if not isinstance(angles, Tracer):
        check_pitch("angles", angles)
    a = jnp.asarray(angles)
    (s1, s2, _), (c1, c2, _) = jnp.sin(a), jnp.cos(a)
    c2 = jnp.where(c2 > np.sin(MARGIN), c2, jnp.nan)
    zero, one = jnp.zeros_like(s1), jnp.ones_like(s1)
    rows = [[one, s1 * s2 / c2, c1 * s2 / c2], [zero, c1, -s1], [zero, s1 / c2, c1 / c2]]
    return jnp.stack([jnp.stack(row) for row in rows])


def check_pitch(name: str, angles: ArrayLike) -> np.ndarray:
    """The angles (3,) rad as float64, or the reason why they are none.

    Raises
    ------
    ScenarioError
        Wrong shape or NaN.
    SingularityError
        A pitch at, beyond or within `MARGIN` of +-90 deg.
    """
    a = real(name, angles, (3,))
    if abs(a[1]) >= np.pi / 2 - MARGIN:
        raise SingularityError(
            f"{name} has the pitch {np.degrees(a[1]):.6g} deg, where 3-2-1 Euler angles have no rate: stay within "
            f"+-{90 - np.degrees(MARGIN):g} deg, or describe the attitude by a quaternion (`plants.dynamics.rigidbody`)"
        )
    return a
