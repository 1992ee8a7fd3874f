"""Thrusters in pairs along the axes of a satellite: limits, and pulses of a whole number of bits.

Commands and what comes of them are accelerations, (3,) m/s^2 in the axes of the command. Attitude is ideal and the
mass constant: a day of station keeping takes a hundredth of a percent of it.
"""

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, positive, whole
from plants.simulation import blocks


@partial(blocks.node, data_fields=["limit"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Thrusters:
    """Throttled thrusters: every axis saturates by itself. Build them with `Thrusters.create`."""

    limit: Numbers  # () m/s^2

    @classmethod
    def create(cls, mass: float, force: float) -> "Thrusters":
        """Thrusters of `force` N at most, infinite for no limit, on a satellite of `mass` kg.

        Raises
        ------
        ScenarioError
            NaN, a mass or force that is not positive.
        """
        return cls(limit=positive("force", force, infinite=True) / positive("mass", mass))

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def apply(self, s: tuple[()], command: ArrayLike, x: object) -> tuple[tuple[()], Array]:
        """Acceleration (3,) m/s^2 for a command (3,) m/s^2."""
        del x
        return s, jnp.clip(jnp.asarray(command), -self.limit, self.limit)


@partial(blocks.node, data_fields=["limit", "bit", "most"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class PulsedThrusters:
    """Thrusters that are on or off, for whole multiples of a shortest pulse. Build them with `PulsedThrusters.create`.

    In every sample the number of pulses nearest to what is asked for is fired, and what rounding left out is asked
    for again in the next (first-order sigma-delta modulation): the impulse delivered stays within half a bit of
    the impulse commanded, however small the command. What exceeds the limit is lost, not kept for later. The plant
    feels the pulses of a sample as an acceleration spread over the sample, whose mean is exact.
    """

    limit: Numbers  # () m/s^2
    bit: Numbers  # () m/s^2, one pulse spread over a sample
    most: Numbers  # () pulses in a sample

    @classmethod
    def create(cls, mass: float, force: float, *, shortest: float, period: float) -> "PulsedThrusters":
        """Pulsed thrusters.

        Parameters
        ----------
        mass : () kg
        force : () N, while on
        shortest : () s, shortest pulse; its impulse force * shortest is the minimum impulse bit
        period : () s, the sampling period `Scenario.h` at which `apply` is called

        Raises
        ------
        ScenarioError
            NaN, a number that is not positive, a period that is not a whole number of pulses.
        """
        push = positive("force", force) / positive("mass", mass)
        most = np.asarray(float(whole("period", period, positive("shortest", shortest), "shortest pulses")))
        return cls(limit=push, bit=push / most, most=most)

    def init(self) -> Array:
        """What is owed, (3,) m/s^2 over a sample: nothing yet."""
        return jnp.zeros(3)

    def apply(self, s: Array, command: ArrayLike, x: object) -> tuple[Array, Array]:
        """What is owed now, and the acceleration (3,) m/s^2 that the pulses amount to."""
        del x
        asked = jnp.clip(jnp.asarray(command), -self.limit, self.limit) + s
        fired = jnp.asarray(self.bit) * jnp.clip(jnp.round(asked / self.bit), -self.most, self.most)
        return asked - fired, fired
