"""A body with everything that turns satellites: wheels as sold, magnetorquers, thrusters, moment gyroscopes.

The equations are those of `RigidBody`, with the friction of the rotors added to the torques of their motors, and with
the torques of imbalance, coils, thrusters and gyroscopes on the body. The plant's input is

    u = [torques of the n motors on the wheels (N m) | rates of the m gimbals (rad/s) | dipole moment (3,) A m^2 |
         torque of the thrusters on the body (3,) N m]

of which only those parts are there that the satellite has. `plants.hardware.effectors.Effectors` makes it of a command.
Flexible appendages act on the body as `plants.dynamics.appendages` says: by a torque, a momentum, and less inertia.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from plants.checks import Numbers, counted, real, unit
from plants.dynamics.appendages import Appendage
from plants.dynamics.cmgs import Cmgs
from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.dynamics.rotors import TURN, Friction, Imbalance, column
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.simulation.loop import Environment
from plants.simulation.programs import Program
from plants.surroundings.disturbances import Disturbance
from plants.surroundings.environment import OrbitEnv


class SatelliteState(NamedTuple):
    """State of a satellite with n wheels, m moment gyroscopes and k flexible modes."""

    q: ArrayLike  # (4,) attitude of the body relative to frame N
    w: ArrayLike  # (3,) rad/s, inertial rate in body axes
    wheels: ArrayLike  # (n,) rad/s, wheel speeds relative to the body
    phase: ArrayLike  # (n,) rad, of the rotors in [0, 2 pi); (0,) if they are balanced
    gimbals: ArrayLike  # (m,) rad, gimbal angles
    modes: ArrayLike = np.zeros(0)  # (k,) sqrt(kg) m, modal coordinates of the appendages
    mode_rates: ArrayLike = np.zeros(0)  # (k,) sqrt(kg) m/s


class Effort(NamedTuple):
    """The plant's input in its parts."""

    motors: Array  # (n,) N m
    rates: Array  # (m,) rad/s
    dipole: Array  # (3,) A m^2, body axes; zeros without magnetorquers
    torque: Array  # (3,) N m, body axes; zeros without thrusters


@partial(
    blocks.node,
    data_fields=["body", "friction", "imbalance", "cmgs", "appendages", "fastest"],
    meta_fields=["magnetorquers", "thrusters"],
)
@dataclass(frozen=True, kw_only=True)
class Satellite:
    """A body with several kinds of effector and, if need be, flexible appendages. Build it with `Satellite.create`.

    With magnetorquers the environment must model the magnetic field.
    """

    body: RigidBody
    friction: Friction | None
    imbalance: Imbalance | None
    cmgs: Cmgs | None
    appendages: Appendage | None
    fastest: Numbers  # () rad/s, the highest speed of a wheel
    magnetorquers: bool
    thrusters: bool

    @classmethod
    def create(
        cls,
        inertia: ArrayLike,
        *,
        wheels: Sequence[Any] = (),
        magnetorquers: bool = False,
        thrusters: bool = False,
        cmgs: Cmgs | None = None,
        appendages: Sequence[Appendage] = (),
        disturbances: tuple[Disturbance, ...] = (),
        physical: bool = True,
    ) -> "Satellite":
        """A satellite from its numbers.

        Parameters
        ----------
        inertia : (3, 3) kg m^2, or (3,) its diagonal, with wheels and appendages at rest relative to the body
        wheels : data sheets, such as `plants.hardware.wheels.Wheel`; they may differ from each other
        magnetorquers, thrusters : whether the input has their dipole moment, their torque
        cmgs : a cluster of moment gyroscopes
        appendages : panels, booms, tanks; see `Appendage`
        disturbances, physical : as in `RigidBody.create`

        Raises
        ------
        ScenarioError
            What `RigidBody.create` refuses; no effector at all; appendages that carry more inertia than there is.
        """
        wheels = tuple(wheels)
        if not (wheels or magnetorquers or thrusters or cmgs):
            raise ScenarioError("nothing turns the satellite: give wheels, magnetorquers, thrusters or cmgs")
        body = RigidBody.create(
            inertia,
            wheel_axes=column(wheels, "axis") if wheels else None,
            wheel_inertia=column(wheels, "inertia") if wheels else None,
            disturbances=disturbances,
            physical=physical,
        )
        flexible = Appendage.joined(appendages) if appendages else None
        return cls(
            body=body if flexible is None else _carrying(body, flexible),
            friction=Friction.of(wheels) if wheels else None,
            imbalance=Imbalance.of(wheels) if wheels else None,
            cmgs=cmgs,
            appendages=flexible,
            fastest=column(wheels, "max_speed").max() if wheels else np.zeros(()),
            magnetorquers=bool(magnetorquers),
            thrusters=bool(thrusters),
        )

    def scaled(self, factors: ArrayLike, disturbances: tuple[Disturbance, ...] = ()) -> "Satellite":
        """The satellite with the inertia S J S and couplings S d, S = diag(factors), and with further disturbances.

        As if its masses lay farther out: what the appendages carry of the inertia stays the same share.

        Parameters
        ----------
        factors : (3,) along the body axes
        disturbances : beside those it has

        Raises
        ------
        ScenarioError
            What `RigidBody.create` refuses.
        """
        S: Any = factors if isinstance(factors, Tracer) else real("factors", factors, (3,))
        body = RigidBody.create(
            S[:, None] * self.body.inertia * S,
            wheel_axes=self.body.wheel_axes,
            wheel_inertia=self.body.wheel_inertia,
            disturbances=(*self.body.disturbances, *disturbances),
            physical=False,
        )
        if self.appendages is None:
            return replace(self, body=body)
        flexible = replace(self.appendages, couplings=S[:, None] * self.appendages.couplings)
        return replace(self, body=_carrying(body, flexible), appendages=flexible)

    @property
    def sizes(self) -> tuple[int, int, int, int]:
        """Entries of the input that are torques of motors, gimbal rates, dipole moment, torque of thrusters."""
        m = 0 if self.cmgs is None else self.cmgs.gimbals.shape[1]
        return self.body.wheel_axes.shape[1], m, 3 * self.magnetorquers, 3 * self.thrusters

    @property
    def longest_step(self) -> float:
        """Longest Runge-Kutta step, s, that friction, imbalance and flexible modes allow; inf without them.

        Raise `Scenario.samples` to come below it: the steps within a sample are compiled one by one.
        """
        with jax.enable_x64(True):
            rest = np.inf if self.friction is None else float(self.friction.step(self.body.wheel_inertia))
        turn = np.inf if self.imbalance is None else 2 * np.pi / float(self.fastest) / TURN
        swing = np.inf if self.appendages is None else 2 * np.pi / self.appendages.free(self._rest)[-1] / TURN
        return min(rest, turn, swing)

    @property
    def _rest(self) -> Any:
        """Inertia without that of the wheels about their axes, (3, 3) kg m^2, concrete."""
        G = np.asarray(self.body.wheel_axes)
        return np.asarray(self.body.inertia) - (G * np.asarray(self.body.wheel_inertia)) @ G.T

    @property
    def _modes(self) -> int:
        """Flexible modes."""
        return 0 if self.appendages is None else self.appendages.frequencies.shape[0]

    def check(self, x: SatelliteState) -> None:
        """Raise `ScenarioError` for a state that this satellite cannot have, as `RigidBody.check`."""
        self.body.check(BodyState(x.q, x.w, x.wheels))
        n, m, _, _ = self.sizes
        counted("initial.phase", x.phase, 0 if self.imbalance is None else n, "rotor that is not balanced")
        counted("initial.gimbals", x.gimbals, m, "gyroscope")
        counted("initial.modes", x.modes, self._modes, "flexible mode")
        counted("initial.mode_rates", x.mode_rates, self._modes, "flexible mode")

    def split(self, u: ArrayLike) -> Effort:
        """The parts of an input; ScenarioError if it has another length."""
        u, (n, m, c, t) = jnp.asarray(u), self.sizes
        if u.shape != (n + m + c + t,):
            raise ScenarioError(
                f"the input has shape {u.shape}: give {n} motor torques, {m} gimbal rates, {c} of a dipole moment and "
                f"{t} of a torque, in this order"
            )
        motors, rates, dipole, torque = jnp.split(u, [n, n + m, n + m + c])
        return Effort(motors, rates, dipole if c else jnp.zeros(3), torque if t else jnp.zeros(3))

    def derivative(self, x: SatelliteState, u: ArrayLike, env: OrbitEnv) -> SatelliteState:
        """Time derivative of the state under an input u (see `split`).

        Raises
        ------
        ScenarioError
            A state or an input for other numbers of wheels, gyroscopes or flexible modes.
        """
        part, (n, m, _, _) = self.split(u), self.sizes
        counted("wheels of the state", x.wheels, n, "wheel")
        counted("phase of the state", x.phase, 0 if self.imbalance is None else n, "rotor that is not balanced")
        counted("gimbals of the state", x.gimbals, m, "gyroscope")
        for name in ("modes", "mode_rates"):
            counted(f"{name} of the state", getattr(x, name), self._modes, "flexible mode")
        motors, torque = part.motors, part.torque
        stored: ArrayLike = 0.0
        if self.friction is not None:
            motors = motors + self.friction.torque(x.wheels)
        if self.imbalance is not None:
            torque = torque + self.imbalance.torque(x.wheels, x.phase)
        if self.magnetorquers:
            torque = torque + attitude.cross(part.dipole, attitude.rotate(x.q, env.B))
        if self.cmgs is not None:
            stored = self.cmgs.momentum(x.gimbals)
            torque = torque - self.cmgs.jacobian(x.gimbals) @ part.rates
        back, rates, d = jnp.zeros(0), jnp.asarray(x.mode_rates), jnp.zeros((3, 0))
        if self.appendages is not None:
            back, d = self.appendages.restoring(x.modes, rates), jnp.asarray(self.appendages.couplings)
            torque, stored = torque + d @ back, stored + d @ rates
        moved = self.body.motion(BodyState(x.q, x.w, x.wheels), motors, torque, env, stored)
        phase = jnp.zeros(0) if self.imbalance is None else jnp.asarray(x.wheels)
        return SatelliteState(
            *moved, phase=phase, gimbals=part.rates, modes=rates, mode_rates=-back - d.T @ jnp.asarray(moved.w)
        )

    def momentum(self, x: SatelliteState) -> Array:
        """Angular momentum in body axes, of the body and all that moves on it, (3,) N m s."""
        held = self.body.momentum(BodyState(x.q, x.w, x.wheels))
        if self.appendages is not None:
            held = held + self.appendages.momentum(x.mode_rates)
        return held if self.cmgs is None else held + self.cmgs.momentum(x.gimbals)

    def output(self, x: SatelliteState, env: OrbitEnv) -> Array:
        """(6,) [q; w] relative to frame O of the environment, as `RigidBody.output`."""
        return self.body.output(BodyState(x.q, x.w, x.wheels), env)

    def error(self, y: ArrayLike, r: ArrayLike) -> Array:
        """How far an output y (6,) is from a reference r (6,), as `RigidBody.error`."""
        return self.body.error(y, r)

    def project(self, x: SatelliteState) -> SatelliteState:
        """The state with its quaternion scaled to unit length and its phases within a turn."""
        return x._replace(q=attitude.normalise(x.q), phase=jnp.mod(jnp.asarray(x.phase), 2 * jnp.pi))

    def state(
        self,
        q_OB: ArrayLike,
        w_OB: ArrayLike,
        environment: Environment,
        *,
        t: float = 0.0,
        wheels: ArrayLike | None = None,
        gimbals: ArrayLike | None = None,
        modes: ArrayLike | None = None,
        mode_rates: ArrayLike | None = None,
    ) -> SatelliteState:
        """State of the satellite whose attitude and rate are known relative to frame O, NumPy.

        Parameters
        ----------
        q_OB : (4,) unit quaternion
        w_OB : (3,) rad/s, body axes
        environment : its surroundings, `at(t)`
        t : () s
        wheels : (n,) rad/s; at rest by default
        gimbals : (m,) rad; zeros by default
        modes, mode_rates : (k,) sqrt(kg) m and sqrt(kg) m/s; undeformed by default

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, a quaternion that is not of unit length.
        """
        n, m, _, _ = self.sizes
        q, w = unit("q_OB", q_OB, (4,)), real("w_OB", w_OB, (3,))
        speeds = real("wheels", np.zeros(n) if wheels is None else wheels, (n,))
        angles = real("gimbals", np.zeros(m) if gimbals is None else gimbals, (m,))
        rest = np.zeros(self._modes)
        bent = real("modes", rest if modes is None else modes, rest.shape)
        bending = real("mode_rates", rest if mode_rates is None else mode_rates, rest.shape)
        blocks.register(environment)
        with jax.enable_x64(True):
            body = [np.asarray(part) for part in _place(environment, np.asarray(float(t)), q, w, speeds)]
        phase = np.zeros(0 if self.imbalance is None else n)
        return SatelliteState(*body, phase=phase, gimbals=angles, modes=bent, mode_rates=bending)


def _carrying(body: RigidBody, flexible: Appendage) -> RigidBody:
    """The body whose appendages move on it: less inertia answers to a torque."""
    G: Any = body.wheel_axes
    hub = flexible.hub(body.inertia - (G * body.wheel_inertia) @ G.T)
    return replace(body, inverse=(jnp if isinstance(hub, Tracer) else np).linalg.inv(hub))


@Program
def _place(environment: Any, t: Array, q: Array, w: Array, speeds: Array) -> BodyState:
    return state_from(q, w, speeds, environment.at(t))
