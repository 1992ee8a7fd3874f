"""A mode of a mission: its guidance, its navigator, its control law, and what it waits for."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import positive
from plants.errors import ScenarioError
from plants.guidance.conditions import Condition
from plants.guidance.frames import Guidance, Nadir

NY = 19  # entries of `Known`


class Known(NamedTuple):
    """What is known on board."""

    output: Array  # (6,) estimate of the plant's output, relative to frame O
    error: Array  # (6,) [vector part of the error quaternion; rad/s], relative to the commanded frame
    field: Array  # (3,) T, body axes, as measured
    momentum: Array  # (3,) N m s, of the wheels, body axes
    mode: Array  # () index

    @classmethod
    def of(cls, y: ArrayLike) -> "Known":
        """From the estimate (19,) of a sequence."""
        y = jnp.asarray(y) if isinstance(y, jax.Array) else np.asarray(y)
        return cls(y[0:6], y[6:12], y[12:15], y[15:18], y[18])  # pyright: ignore[reportArgumentType]


class Law(Protocol):
    """A control law of a mode."""

    def init(self) -> Any: ...  # noqa: D102

    def step(self, s: Any, known: Known, dt: Any, /) -> tuple[Any, Any]:
        """New state and command [torque (3,) N m; dipole moment (3,) A m^2], every dt s."""
        ...


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A mode of a `sequence`; build it with `mode`."""

    name: str
    law: Law
    guidance: Guidance
    until: Condition | None  # None: for good
    then: str | None  # None: the mode after this one
    navigator: int  # index
    limits: tuple[float, float] | None  # () rad/s, () rad/s^2 of its slew


def mode(
    name: str,
    law: Law,
    *,
    guidance: Guidance | None = None,
    until: Condition | None = None,
    then: str | None = None,
    navigator: int = 0,
    max_rate: float | None = None,
    max_acceleration: float | None = None,
) -> Mode:
    """A mode.

    Parameters
    ----------
    name : what it is called
    law : the control law, such as `AttitudeControl` or `Detumbling`
    guidance : the commanded frame; frame O by default
    until : what ends the mode; without it the mode lasts
    then : name of the mode that follows; the next of the sequence by default
    navigator : index of the navigator that the mode trusts
    max_rate, max_acceleration : () rad/s, () rad/s^2 of the slew with which the mode begins; without both the
        commanded frame is that of the guidance at once, and the command may jump as far as the error does

    Raises
    ------
    ScenarioError
        One limit without the other, limits that are not positive.
    """
    if (max_rate is None) != (max_acceleration is None):
        raise ScenarioError(f"max_rate and max_acceleration of mode {name!r} come together: give both or neither")
    limits = None
    if max_rate is not None:
        limits = float(positive("max_rate", max_rate)), float(positive("max_acceleration", max_acceleration))
    frame = Nadir() if guidance is None else guidance
    return Mode(name=name, law=law, guidance=frame, until=until, then=then, navigator=navigator, limits=limits)
