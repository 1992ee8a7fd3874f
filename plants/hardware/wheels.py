"""Reaction wheels as they are sold: data sheets, and an array of any wheels on any axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from plants.checks import Numbers, counted, positive, real, unit
from plants.dynamics.rotors import column
from plants.errors import ScenarioError
from plants.hardware import sharing
from plants.simulation import blocks

RPM = 2 * np.pi / 60  # rad/s


@partial(
    blocks.node,
    data_fields=[
        "axis", "max_torque", "max_speed", "inertia", "viscous", "coulomb", "static", "stribeck", "creep",
        "torque_noise", "torque_step", "static_imbalance", "dynamic_imbalance", "position",
    ],
    meta_fields=[],
)  # fmt: skip
@dataclass(frozen=True, kw_only=True)
class Wheel:
    """The data sheet of one wheel. Build it with `Wheel.create`; give the same to the plant and to `WheelArray`."""

    axis: Numbers  # (3,) unit spin axis, body axes
    max_torque: Numbers  # () N m, of the motor
    max_speed: Numbers  # () rad/s, relative to the body
    inertia: Numbers  # () kg m^2, of the rotor about its axis
    viscous: Numbers  # () N m s, friction: see `plants.dynamics.rotors`
    coulomb: Numbers  # () N m
    static: Numbers  # () N m
    stribeck: Numbers  # () rad/s
    creep: Numbers  # () rad/s
    torque_noise: Numbers  # () N m sqrt(s), density: the mean over h s has the deviation torque_noise / sqrt(h)
    torque_step: Numbers  # () N m, of the motor's command; 0 for none
    static_imbalance: Numbers  # () kg m
    dynamic_imbalance: Numbers  # () kg m^2
    position: Numbers  # (3,) m, from the centre of mass, body axes

    @classmethod
    def create(
        cls,
        axis: ArrayLike,
        *,
        max_torque: ArrayLike,
        max_momentum: ArrayLike | None = None,
        max_speed: ArrayLike | None = None,
        max_speed_rpm: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
        viscous: ArrayLike = 0.0,
        coulomb: ArrayLike = 0.0,
        static: ArrayLike | None = None,
        stribeck: ArrayLike | None = None,
        creep: ArrayLike = 1.0,
        torque_noise: ArrayLike = 0.0,
        torque_step: ArrayLike = 0.0,
        static_imbalance_g_cm: ArrayLike = 0.0,
        dynamic_imbalance_g_cm2: ArrayLike = 0.0,
        position: ArrayLike | None = None,
    ) -> "Wheel":
        """A wheel from its data sheet: two of momentum, speed and inertia, from which the third follows.

        Parameters
        ----------
        axis : (3,) unit spin axis, body axes
        max_torque : () N m, inf for no limit
        max_momentum : () N m s, at full speed
        max_speed, max_speed_rpm : () rad/s or rev/min, one of them; inf for no limit (then give the inertia)
        inertia : () kg m^2, of the rotor about its axis
        viscous : () N m s, friction in proportion to the speed
        coulomb : () N m, dry friction, whatever the speed
        static : () N m, dry friction at rest; that of Coulomb by default
        stribeck : () rad/s, over which static friction gives way; ten times `creep` by default
        creep : () rad/s, over which dry friction changes its sign at zero crossing
        torque_noise : () N m sqrt(s), spectral density (two-sided root) of the motor's torque
        torque_step : () N m, quantisation of the motor's torque
        static_imbalance_g_cm, dynamic_imbalance_g_cm2 : () g cm, g cm^2, as data sheets have them
        position : (3,) m, from the centre of mass, body axes; needed with a static imbalance

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN; an axis that is not a unit vector; torque, momentum, speed or inertia that is not
            positive, or not two of the last three; negative friction, noise, step or imbalance; static friction below
            that of Coulomb; a static imbalance without position.
        """
        if max_speed is not None and max_speed_rpm is not None:
            raise ScenarioError("max_speed and max_speed_rpm are both given: give one")
        if max_speed_rpm is not None:
            max_speed = positive("max_speed_rpm", max_speed_rpm, infinite=True) * RPM
        speed, Js = _speed_and_inertia(max_momentum, max_speed, inertia)
        sheet = {
            name: real(name, value, low=0)
            for name, value in (
                ("viscous", viscous), ("coulomb", coulomb), ("static", coulomb if static is None else static),
                ("torque_noise", torque_noise), ("torque_step", torque_step),
                ("static_imbalance_g_cm", static_imbalance_g_cm), ("dynamic_imbalance_g_cm2", dynamic_imbalance_g_cm2),
            )
        }  # fmt: skip
        slip = positive("creep", creep)
        decay = positive("stribeck", 10 * slip if stribeck is None else stribeck)
        if not isinstance(gap := sheet["static"] - sheet["coulomb"], Tracer) and gap < 0:
            raise ScenarioError(f"static = {static} N m is below coulomb = {coulomb} N m: friction is largest at rest")
        shaken = sheet.pop("static_imbalance_g_cm"), sheet.pop("dynamic_imbalance_g_cm2")
        if position is None and (isinstance(shaken[0], Tracer) or shaken[0] > 0):
            raise ScenarioError("position is missing: a static imbalance turns the body by the lever of its wheel (m)")
        return cls(
            axis=unit("axis", axis, (3,)),
            max_torque=positive("max_torque", max_torque, infinite=True),
            max_speed=speed,
            inertia=Js,
            stribeck=decay,
            creep=slip,
            static_imbalance=1e-5 * shaken[0],
            dynamic_imbalance=1e-7 * shaken[1],
            position=real("position", np.zeros(3) if position is None else position, (3,)),
            **sheet,
        )

    @property
    def max_momentum(self) -> Any:
        """() N m s, at full speed."""
        return self.inertia * self.max_speed


def axes_of(wheels: Sequence[Wheel]) -> Any:
    """Spin axes of wheels as columns, (3, n)."""
    return column(wheels, "axis")


@partial(
    blocks.node,
    data_fields=[
        "axes", "maps", "idle", "wanted", "null_rate", "max_torque", "max_speed", "inertia", "torque_step",
        "torque_noise",
    ],
    meta_fields=[],
)  # fmt: skip
@dataclass(frozen=True, kw_only=True)
class WheelArray:
    """Reaction wheels as sold, of any number, axes and kinds. Build it with `WheelArray.create`.

    A body torque is shared by the motors; a torque that leaves the body alone drives the speeds to the wanted point of
    the null space with what the motors have left. Each motor rounds to its step and saturates by itself, and a
    wheel's speed is held within its limit: the motor gives what brings its rotor exactly there in one sample (on a body
    that stays, without friction) and no more. The noise comes last.
    """

    axes: Numbers  # (3, n) unit columns
    maps: Numbers  # (k, n, 3) motor torques per unit of body torque; the one with the least largest share is taken
    idle: Numbers  # (n, n) projection on motor torques that leave the body alone
    wanted: Numbers  # (n,) N m s, momenta of the rotors whose part in the null space is wanted
    null_rate: Numbers  # () 1/s
    max_torque: Numbers  # (n,) N m
    max_speed: Numbers  # (n,) rad/s
    inertia: Numbers  # (n,) kg m^2
    torque_step: Numbers  # (n,) N m
    torque_noise: Numbers  # (n,) N m sqrt(s)

    @classmethod
    def create(
        cls,
        wheels: Sequence[Wheel],
        *,
        wanted_speeds: ArrayLike | None = None,
        null_rate: ArrayLike | None = None,
        minimax: bool = False,
        spanning: bool = True,
    ) -> "WheelArray":
        """An array from the data sheets of its wheels.

        Parameters
        ----------
        wheels : n of them, the same that the plant is given
        wanted_speeds : (n,) rad/s, of a body without momentum: away from zero crossings, for example; what of them is
            not in the null space (of the momenta) is left to the torque that is asked for
        null_rate : () 1/s, at which the wanted point is approached; with `wanted_speeds`
        minimax : whether the largest motor torque (in parts of its limit) is least, instead of the sum of squares
        spanning : False takes axes that do not span space, as of one momentum wheel: torques across them are not made

        Raises
        ------
        ScenarioError
            No wheels, axes that do not span space though they should or minimax needs it; wanted speeds of another
            number, beyond the limit, without null space or without rate; a minimax distribution of unlimited torques.
        """
        wheels = tuple(wheels)
        if not wheels:
            raise ScenarioError("wheels = []: give at least three data sheets")
        G, n = axes_of(wheels), len(wheels)
        numbers = {name: column(wheels, name) for name in ("max_torque", "max_speed", "inertia")}
        if (spanning or minimax) and np.linalg.matrix_rank(G) < 3:
            raise ScenarioError(
                f"axes of the wheels must span space, got {G.T.tolist()}: three independent at least, or spanning=False"
            )
        if (wanted_speeds is None) != (null_rate is None):
            raise ScenarioError("wanted_speeds and null_rate come together: give both or neither")
        idle = np.eye(n) - np.linalg.pinv(G) @ G
        wanted = np.zeros(n)
        if wanted_speeds is not None:
            speeds = real("wanted_speeds", wanted_speeds, (n,))
            wanted = numbers["inertia"] * speeds
            if not isinstance(numbers["max_speed"], Tracer) and (np.abs(speeds) > numbers["max_speed"]).any():
                raise ScenarioError(f"wanted_speeds = {speeds.tolist()} rad/s exceed max_speed of a wheel: stay below")
            if not isinstance(wanted, Tracer) and np.linalg.norm(idle @ wanted) <= 1e-9 * np.linalg.norm(wanted):
                raise ScenarioError(
                    f"wanted_speeds = {speeds.tolist()} rad/s have no part in the null space of the axes, where the "
                    "body feels nothing: give speeds along it (four wheels at least)"
                )
        if minimax and not np.isfinite(numbers["max_torque"]).all():
            raise ScenarioError("minimax shares torques in parts of their limits: give every wheel a max_torque")
        share = sharing.least_largest(G, numbers["max_torque"]) if minimax else sharing.least_squares(G)
        return cls(
            axes=G, maps=-share, idle=idle, wanted=wanted,
            null_rate=real("null_rate", 0.0 if null_rate is None else null_rate, low=0), **numbers,
            torque_step=column(wheels, "torque_step"), torque_noise=column(wheels, "torque_noise"),
        )  # fmt: skip

    @property
    def channels(self) -> int:
        """Normal numbers per sample: one for each motor."""
        return self.inertia.shape[0]

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def apply(
        self, s: tuple[()], command: ArrayLike, x: Any, noise: ArrayLike, h: ArrayLike
    ) -> tuple[tuple[()], Array]:
        """Motor torques (n,) N m for a body torque (3,) N m.

        Parameters
        ----------
        s : ()
        command : (3,) N m, torque on the body
        x : plant state with `wheels` (n,) rad/s
        noise : (n,) standard normal numbers
        h : () s, sampling period
        """
        return s, self.torques(command, x, h) + self.noise(noise, h)

    def torques(self, command: ArrayLike, x: Any, h: ArrayLike) -> Array:
        """Motor torques (n,) N m within all limits, in whole steps, without noise; see `apply`."""
        Om = counted("wheels of the state", x.wheels, self.channels, "wheel")
        most = jnp.clip((self.max_speed - Om) * self.inertia / h, 0.0, self.max_torque)
        least = -jnp.clip((self.max_speed + Om) * self.inertia / h, 0.0, self.max_torque)
        u = jnp.clip(sharing.smallest(self.maps, command, self.max_torque), least, most)
        turn = jnp.asarray(self.idle) @ (self.null_rate * (self.wanted - self.inertia * Om))
        room = jnp.where(turn > 0, most - u, least - u) / jnp.where(turn == 0, 1.0, turn)
        u = u + jnp.clip(jnp.min(jnp.where(turn == 0, jnp.inf, room)), 0.0, 1.0) * turn
        step = jnp.where(jnp.asarray(self.torque_step) > 0, self.torque_step, 1.0)
        rounded = step * jnp.round(u / step)
        rounded = jnp.where((rounded > most) | (rounded < least), step * jnp.trunc(u / step), rounded)
        return jnp.where(jnp.asarray(self.torque_step) > 0, rounded, u)

    def noise(self, noise: ArrayLike, h: ArrayLike) -> Array:
        """What the motors add by themselves in a sample of h s, (n,) N m, for standard normal numbers (n,)."""
        return jnp.asarray(self.torque_noise) / jnp.sqrt(jnp.asarray(h)) * jnp.asarray(noise)


def _speed_and_inertia(momentum: Any, speed: Any, inertia: Any) -> tuple[Any, Any]:
    """Speed limit and inertia from two of three."""
    given = [name for name, value in (("max_momentum", momentum), ("max_speed", speed), ("inertia", inertia))
             if value is not None]  # fmt: skip
    if len(given) != 2:
        raise ScenarioError(
            f"of max_momentum, max_speed (or max_speed_rpm) and inertia, {' and '.join(given) or 'none'} given: "
            "give two, the third follows"
        )
    limit = None if speed is None else positive("max_speed", speed, infinite=momentum is None)
    h = None if momentum is None else positive("max_momentum", momentum)
    Js = h / limit if inertia is None else positive("inertia", inertia)  # pyright: ignore[reportOptionalOperand]
    return h / Js if limit is None else limit, Js
