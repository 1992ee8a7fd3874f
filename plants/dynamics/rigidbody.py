"""Rigid body with reaction wheels: Euler's equation with the momentum and the reaction of the wheels.

Pecorilla and Stesina (2024), eq. 3, leaves out the reaction of the motors on the body; with it, for wheels of spin
inertia Js on the axes G (columns) and body inertia I that includes the wheels at rest,

    (I - G Js G') dw = T - w x (I w + G Js Om) - G u,      dOm = u / Js - G' dw

u is the torque of the motors on the wheels, so the body feels -G u. Eq. 7 is read as dq = (q0 w + q x w) / 2.
See Markley and Crassidis (2014), section 3.3.5.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from plants.checks import Numbers, counted, positive, unit
from plants.dynamics.inertia import check_moments, inertia_matrix
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.surroundings.disturbances import Disturbance, seen_from
from plants.surroundings.environment import OrbitEnv


class BodyState(NamedTuple):
    """State of a rigid body with n wheels."""

    q: ArrayLike  # (4,) attitude of the body relative to frame N
    w: ArrayLike  # (3,) rad/s, inertial rate in body axes
    wheels: ArrayLike  # (n,) rad/s, wheel speeds relative to the body


@partial(
    blocks.node,
    data_fields=["inertia", "inverse", "wheel_axes", "wheel_inertia", "disturbances"],
    meta_fields=[],
)
@dataclass(frozen=True, kw_only=True)
class RigidBody:
    """A rigid body with n reaction wheels, or without wheels and driven by an external torque.

    Build it with `RigidBody.create`, which checks the numbers. The bare constructor checks nothing, because JAX
    calls it with tracers.
    """

    inertia: Numbers  # (3, 3) kg m^2, wheels included
    inverse: Numbers  # (3, 3) 1/(kg m^2), of I - G Js G'
    wheel_axes: Numbers  # (3, n) unit spin axes in body axes, as columns
    wheel_inertia: Numbers  # (n,) kg m^2, about the spin axes
    disturbances: tuple[Disturbance, ...]

    @classmethod
    def create(
        cls,
        inertia: ArrayLike,
        *,
        wheel_axes: ArrayLike | None = None,
        wheel_inertia: ArrayLike | None = None,
        disturbances: tuple[Disturbance, ...] = (),
        physical: bool = True,
    ) -> "RigidBody":
        """Rigid body from its numbers, concrete or traced (then only shapes and precision are checked).

        Parameters
        ----------
        inertia : (3, 3) kg m^2, or (3,) its diagonal, with the wheels at rest relative to the body
        wheel_axes : (3, n) unit columns; without wheels the input is an external torque
        wheel_inertia : (n,) kg m^2
        disturbances : see `plants.surroundings.disturbances`
        physical : False takes moments that no distribution of mass has: studies that disperse them one by one draw some

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, float32 tracers; an inertia that is not symmetric or, without its rotors, not positive
            definite, or whose largest moment exceeds the sum of the others; axes that are not unit vectors; a wheel
            inertia that is not positive.
        """
        if (wheel_axes is None) != (wheel_inertia is None):
            raise ScenarioError("wheel_axes and wheel_inertia come together: give both or neither")
        I = inertia_matrix("inertia", inertia)
        G = unit("wheel_axes", np.zeros((3, 0)) if wheel_axes is None else wheel_axes, (3, None))
        Js = positive("wheel_inertia", np.zeros(0) if wheel_inertia is None else wheel_inertia, (G.shape[1],))
        rest = I - (G * Js) @ G.T
        if isinstance(rest, Tracer):
            inverse = jnp.linalg.inv(rest)
        else:
            if np.linalg.eigvalsh(rest)[0] <= 0:
                raise ScenarioError(f"inertia without the rotors must be positive definite, got {rest.tolist()} kg m^2")
            inverse = np.linalg.inv(rest)
        if physical and not isinstance(I, Tracer):
            check_moments("inertia", I)
        return cls(inertia=I, inverse=inverse, wheel_axes=G, wheel_inertia=Js, disturbances=tuple(disturbances))

    def check(self, x: BodyState) -> None:
        """Raise `ScenarioError` for a state that this body cannot have: other numbers of wheels, no unit quaternion."""
        for name, n in (("q", 4), ("w", 3), ("wheels", np.shape(self.wheel_inertia)[0])):
            shape = np.shape(getattr(x, name))
            if shape != (n,):
                wheels = f": the body has {n} wheels" if name == "wheels" else ""
                raise ScenarioError(f"initial.{name} has shape {shape}; give ({n},){wheels}")
        length = float(np.linalg.norm(x.q))
        if abs(length - 1) > 1e-6:
            raise ScenarioError(f"initial.q has length {length:.7g}: divide it by its length, an attitude has length 1")

    def derivative(self, x: BodyState, u: ArrayLike, env: OrbitEnv) -> BodyState:
        """Time derivative of the state.

        Parameters
        ----------
        x : state
        u : (n,) N m, torques of the motors on the wheels; without wheels (3,) N m, torque on the body
        env : surroundings

        Raises
        ------
        ScenarioError
            As many wheel speeds or motor torques as there are wheels are not there.
        """
        if self.wheel_axes.shape[1]:
            return self.motion(x, u, jnp.zeros(3), env)
        return self.motion(x, jnp.zeros(0), u, env)

    def motion(
        self, x: BodyState, motors: ArrayLike, torque: ArrayLike, env: OrbitEnv, stored: ArrayLike = 0.0
    ) -> BodyState:
        """`derivative` under torques of motors and of whatever else acts on the body.

        Parameters
        ----------
        x : state
        motors : (n,) N m, torques on the wheels about their axes, which react on the body
        torque : (3,) N m on the body, body axes, beside the disturbances
        env : surroundings
        stored : (3,) N m s, body axes, momentum held by devices other than the wheels

        Raises
        ------
        ScenarioError
            As many wheel speeds or motor torques as there are wheels are not there.
        """
        G, n = jnp.asarray(self.wheel_axes), self.wheel_axes.shape[1]
        counted("wheels of the state", x.wheels, n, "wheel")
        motors = counted("motor torques", motors, n, "wheel")
        load = self.disturbance_torque(x.q, env) - attitude.cross(x.w, self.momentum(x) + stored) + torque
        dw = self.inverse @ (load - G @ motors)  # Equation 3
        return BodyState(q=attitude.kinematics(x.q, x.w), w=dw, wheels=motors / self.wheel_inertia - G.T @ dw)

    def momentum(self, x: BodyState) -> Array:
        """Angular momentum I w + G Js Om in body axes, (3,) N m s. Equation 2."""
        I, G = jnp.asarray(self.inertia), jnp.asarray(self.wheel_axes)
        return I @ x.w + G @ (self.wheel_inertia * jnp.asarray(x.wheels))

    def disturbance_torque(self, q: ArrayLike, env: OrbitEnv) -> Array:
        """Sum of the disturbances at attitude q (4,) relative to frame N: (3,) N m in body axes."""
        seen, I = seen_from(q, env), jnp.asarray(self.inertia)
        return sum((d.torque(seen, I) for d in self.disturbances), start=jnp.zeros(3))

    def mass(self) -> Array:
        """(6, 6) what the rates of the output are multiplied by in Equation 3: one, and the inertia without rotors."""
        G, O = jnp.asarray(self.wheel_axes), jnp.zeros((3, 3))
        return jnp.block([[jnp.eye(3), O], [O, jnp.asarray(self.inertia) - (G * self.wheel_inertia) @ G.T]])

    def output(self, x: BodyState, env: OrbitEnv) -> Array:
        """What a nadir-pointing controller regulates: (6,) [q_OB; w_OB].

        q_OB : vector part of the attitude relative to frame O, scalar part >= 0
        w_OB : rad/s, rate relative to frame O in body axes. Equation 4
        """
        q = attitude.compose(x.q, attitude.conjugate(env.q_ON))
        return jnp.concatenate([attitude.positive(q)[1:], x.w - attitude.rotate(q, env.w_ON)])

    def error(self, y: ArrayLike, r: ArrayLike) -> Array:
        """How far an output y (6,) is from a reference r (6,): (6,) as `output`, relative to the attitude of r.

        At any angle: beyond small ones the difference of two vector parts is no rotation.
        """
        y, r = jnp.asarray(y), jnp.asarray(r)
        q = attitude.compose(attitude.from_vector_part(y[:3]), attitude.conjugate(attitude.from_vector_part(r[:3])))
        return jnp.concatenate([attitude.positive(q)[1:], y[3:] - attitude.rotate(q, r[3:])])

    def project(self, x: BodyState) -> BodyState:
        """The state with its quaternion scaled to unit length."""
        return x._replace(q=attitude.normalise(x.q))


def state_from(q_OB: ArrayLike, w_OB: ArrayLike, wheels: ArrayLike, env: OrbitEnv) -> BodyState:
    """State of a body whose attitude (4,) and rate (3,) rad/s (body axes) are known relative to frame O."""
    return BodyState(
        q=attitude.compose(q_OB, env.q_ON),
        w=jnp.asarray(w_OB) + attitude.rotate(q_OB, env.w_ON),
        wheels=jnp.asarray(wheels),
    )
