"""Everything that turns a satellite as one actuator, and the plant that it acts on, from one list of data sheets."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.dynamics.appendages import Appendage
from plants.dynamics.satellite import Satellite
from plants.errors import ScenarioError
from plants.hardware.attitudethrusters import AttitudeThrusters
from plants.hardware.cmgsteering import CmgSteering
from plants.hardware.magnetorquers import Magnetorquers
from plants.hardware.wheels import Wheel, WheelArray
from plants.simulation import blocks
from plants.surroundings.disturbances import Disturbance


class EffectorState(NamedTuple):
    """States of the effectors that have one."""

    thrusters: Any  # `ThrusterState`, or () without thrusters


@partial(blocks.node, data_fields=["wheels", "cmgs", "magnetorquers", "thrusters"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Effectors:
    """Wheels or moment gyroscopes, magnetorquers and thrusters as one actuator. Build it with `equip`.

    The command is the torque on the body (3,) N m, and after it, with magnetorquers, the dipole moment (3,) A m^2. The
    torque goes to wheels or gyroscopes; thrusters make what these cannot, or all of it if they are alone; if nothing
    makes torques it has no effect. What comes out is the input of `plants.dynamics.satellite.Satellite`.
    """

    wheels: WheelArray | None
    cmgs: CmgSteering | None
    magnetorquers: Magnetorquers | None
    thrusters: AttitudeThrusters | None

    @property
    def channels(self) -> int:
        """Normal numbers per sample: of the wheels, then of the thrusters; one at least, with which comes h."""
        return max(1, sum(part.channels for part in (self.wheels, self.thrusters) if part is not None))

    @property
    def sizes(self) -> tuple[int, int]:
        """Entries of the command that are a torque, a dipole moment."""
        return 3, 3 * (self.magnetorquers is not None)

    def init(self) -> EffectorState:
        """The states before the first command."""
        return EffectorState(() if self.thrusters is None else self.thrusters.init())

    def apply(
        self, s: EffectorState, command: ArrayLike, x: Any, noise: Array, h: ArrayLike
    ) -> tuple[EffectorState, Array]:
        """Input of the plant for a command.

        Parameters
        ----------
        s : state
        command : (3,) or (6,), see the class
        x : plant state with `wheels`, `gimbals`
        noise : (channels,) standard normal numbers
        h : () s, sampling period

        Raises
        ------
        ScenarioError
            A command of another length.
        """
        asked, (t, d) = jnp.asarray(command), self.sizes
        if asked.shape != (t + d,):
            raise ScenarioError(f"the command has shape {asked.shape}: give {t} of a torque and {d} of a dipole moment")
        left, dipole, parts = asked[:t], asked[t:], []
        if self.wheels is not None:
            motors, n = self.wheels.torques(left, x, h), self.wheels.channels
            left = left + jnp.asarray(self.wheels.axes) @ motors
            parts.append(motors + self.wheels.noise(noise[:n], h))
        if self.cmgs is not None:
            rates = self.cmgs.apply((), left, x)[1]
            left = left + self.cmgs.cmgs.jacobian(x.gimbals) @ rates
            parts.append(rates)
        if self.magnetorquers is not None:
            parts.append(self.magnetorquers.apply((), dipole, x)[1])
        if self.thrusters is not None:
            spent, torque = self.thrusters.apply(s.thrusters, left, x, noise[-self.thrusters.channels :], h)
            s = EffectorState(spent)
            parts.append(torque)
        return s, jnp.concatenate(parts)


def equip(
    inertia: ArrayLike,
    *,
    wheels: Sequence[Wheel] = (),
    magnetorquers: Magnetorquers | None = None,
    thrusters: AttitudeThrusters | None = None,
    cmgs: CmgSteering | None = None,
    wanted_speeds: ArrayLike | None = None,
    null_rate: ArrayLike | None = None,
    minimax: bool = False,
    spanning: bool = True,
    appendages: Sequence[Appendage] = (),
    disturbances: tuple[Disturbance, ...] = (),
    physical: bool = True,
) -> tuple[Satellite, Effectors]:
    """A satellite and its actuator from the same data sheets.

    Parameters
    ----------
    inertia : (3, 3) kg m^2, or (3,) its diagonal, with wheels and appendages at rest relative to the body
    wheels : data sheets, of different kinds if need be
    magnetorquers, thrusters, cmgs : what else there is; wheels or cmgs, not both
    wanted_speeds, null_rate, minimax, spanning : as in `WheelArray.create`
    appendages : panels, booms, tanks
    disturbances, physical : as in `RigidBody.create`

    Returns
    -------
    tuple
        plant and actuator of a `Loop`

    Raises
    ------
    ScenarioError
        What `Satellite.create` and `WheelArray.create` refuse; wheels and moment gyroscopes at once.
    """
    wheels = tuple(wheels)
    if wheels and cmgs is not None:
        raise ScenarioError("wheels and cmgs are both given: which of them makes a torque is not said; give one")
    if cmgs is not None and not isinstance(cmgs, CmgSteering):
        raise ScenarioError(f"cmgs is {type(cmgs).__name__}: give CmgSteering.create(cluster, max_rate=...)")
    if not wheels and (wanted_speeds is not None or null_rate is not None or minimax):
        raise ScenarioError("wanted_speeds, null_rate and minimax are of wheels, and there are none: leave them out")
    plant = Satellite.create(
        inertia,
        wheels=wheels,
        magnetorquers=magnetorquers is not None,
        thrusters=thrusters is not None,
        cmgs=None if cmgs is None else cmgs.cmgs,
        appendages=appendages,
        disturbances=disturbances,
        physical=physical,
    )
    array = None
    if wheels:
        array = WheelArray.create(
            wheels, wanted_speeds=wanted_speeds, null_rate=null_rate, minimax=minimax, spanning=spanning
        )
    return plant, Effectors(wheels=array, cmgs=cmgs, magnetorquers=magnetorquers, thrusters=thrusters)
