"""Control laws of modes: an attitude controller with momentum dumping beside it, and detumbling by the field alone.

Commands are [torque (3,) N m; dipole moment (3,) A m^2], in body axes.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
from jax import Array

from plants.checks import Numbers, positive
from plants.errors import ScenarioError
from plants.guidance.modes import Known
from plants.simulation import blocks
from plants.simulation.loop import Controller, controller_of


class Dumping(Protocol):
    """A law that takes momentum out of the wheels by the magnetic field."""

    def dipole(self, momentum: Any, field: Any, /) -> Any: ...  # noqa: D102


@partial(blocks.node, data_fields=["controller", "dumping"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class AttitudeControl:
    """Any controller of the error (6,) [vector part of the error quaternion; rad/s] to a torque (3,) N m.

    What gives a controller is taken too, as by `Loop`.
    """

    controller: Controller
    dumping: Dumping | None = None

    def __post_init__(self) -> None:
        """Ask what gives a controller for it."""
        object.__setattr__(self, "controller", controller_of(self.controller))

    @property
    def dt(self) -> Any:
        """Control period, s."""
        return self.controller.dt

    def init(self) -> Any:
        """The controller's first state."""
        return self.controller.init()

    def step(self, s: Any, known: Known, dt: Any) -> tuple[Any, Any]:
        """New state and command."""
        del dt
        numbers: Any = np if isinstance(known.error, np.ndarray) else jnp
        new, torque = self.controller.step(s, known.error, numbers.zeros(6))
        dipole = numbers.zeros(3)
        if self.dumping is not None:
            dipole = numbers.asarray(self.dumping.dipole(known.momentum, known.field))
        return new, numbers.concatenate([numbers.asarray(torque), dipole])


class Fields(NamedTuple):
    """State of `Detumbling`."""

    field: Any  # (3,) T, one control period ago
    there: Any  # () whether there was one


@partial(blocks.node, data_fields=["gain", "limit"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Detumbling:
    """B-dot: a dipole moment against the change of the measured field, m = -k dB/dt / |B|^2; build it with `create`.

    Its torque takes energy out of the rotation across the field, which turns along the orbit, so that all of it goes.
    Stickler and Alfriend (1976), Journal of Spacecraft 13, 282; gain by Avanzini and Giulietti (2012), Journal of
    Guidance 35, 1326.
    """

    gain: Numbers  # () N m s
    limit: Numbers  # (3,) A m^2

    @classmethod
    def create(cls, gain: float, *, limit: Any) -> "Detumbling":
        """B-dot law.

        Parameters
        ----------
        gain : () N m s; about 2 n (1 + sin i) J in an orbit of rate n and inclination i, for a least inertia J
        limit : () or (3,) A m^2, largest dipole moment of each axis

        Raises
        ------
        ScenarioError
            A gain or a limit that is not positive.
        """
        limits = np.broadcast_to(positive("limit", limit, np.shape(limit)), (3,)) if np.ndim(limit) < 2 else None
        if limits is None:
            raise ScenarioError(f"limit has shape {np.shape(limit)}: give one dipole moment, or one for each axis")
        return cls(gain=positive("gain", gain), limit=np.array(limits))

    def init(self) -> Fields:
        """No field yet."""
        return Fields(np.zeros(3), np.zeros(()))

    def step(self, s: Fields, known: Known, dt: Any) -> tuple[Fields, Any]:
        """New state and command."""
        B: Array = jnp.asarray(known.field)
        square = jnp.sum(B * B)
        change = s.there * (B - s.field) / dt
        dipole = -self.gain * change / jnp.where(square > 0, square, 1.0)
        bounded = jnp.clip(dipole, -jnp.asarray(self.limit), jnp.asarray(self.limit))
        return Fields(B, jnp.ones(())), jnp.concatenate([jnp.zeros(3), bounded])
