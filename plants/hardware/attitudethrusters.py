"""Thrusters that turn the body: who fires, for how long, and what it costs.

A torque is shared by on-times without sign of the least total (`plants.hardware.sharing`); a modulator makes pulses of
them. The plant feels the pulses of a sample as a torque spread over it, whose mean is exact. Modulators: pulse width
(PWM), Schmitt trigger, and pulse-width pulse-frequency: the trigger behind a lag that is fed what was not given (Wie
2008, Space Vehicle Dynamics and Control, section 7.5; Sidi 1997, Spacecraft Dynamics and Control, chapter 9).
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, each, positive, real, unit
from plants.errors import ScenarioError
from plants.hardware import sharing
from plants.simulation import blocks

GRAVITY = 9.80665  # () m/s^2, of specific impulse


class Trigger(NamedTuple):
    """State of n Schmitt triggers."""

    firing: Array  # (n,) 1 or 0
    held: Array  # (n,) s, that a pulse must still last


class Lagged(NamedTuple):
    """State of n triggers behind lags."""

    trigger: Trigger
    lag: Array  # (n,)


@partial(blocks.node, data_fields=["shortest"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Pwm:
    """Pulse width: one pulse a sample, as long as it takes; one that were shorter than the shortest is not fired."""

    shortest: Numbers  # () s

    @classmethod
    def create(cls, *, shortest: ArrayLike) -> "Pwm":
        """Modulator of pulses of at least `shortest` s; ScenarioError if that is not positive."""
        return cls(shortest=positive("shortest", shortest))

    def init(self, n: int) -> tuple[()]:
        """No state."""
        del n
        return ()

    def fire(self, s: tuple[()], duty: ArrayLike, h: ArrayLike) -> tuple[tuple[()], Array]:
        """On-times (n,) s of a sample of h s for the parts (n,) of it that are asked for."""
        on = jnp.asarray(duty) * h
        return s, jnp.where(on >= self.shortest, on, 0.0)


@partial(blocks.node, data_fields=["on", "off", "shortest"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Schmitt:
    """Schmitt trigger: full thrust from the on-level up, until what is asked for falls to the off-level.

    On-times are whole samples, so the sampling period must resolve the shortest pulse.
    """

    on: Numbers  # () of full thrust
    off: Numbers  # () of full thrust
    shortest: Numbers  # () s

    @classmethod
    def create(cls, *, on: ArrayLike, off: ArrayLike, shortest: ArrayLike = 0.0) -> "Schmitt":
        """Trigger from its levels.

        Parameters
        ----------
        on : () part of full thrust that is asked for when a thruster opens: half the width of the dead zone
        off : () part of it, below `on`, when it closes
        shortest : () s, that a pulse lasts at least

        Raises
        ------
        ScenarioError
            Levels that are not 0 <= off < on, a negative time.
        """
        high, low = positive("on", on), real("off", off, low=0)
        if float(low) >= float(high):
            raise ScenarioError(f"off = {off} must be below on = {on}: the difference is the hysteresis")
        return cls(on=high, off=low, shortest=real("shortest", shortest, low=0))

    def init(self, n: int) -> Trigger:
        """All closed."""
        return Trigger(jnp.zeros(n), jnp.zeros(n))

    def fire(self, s: Trigger, duty: ArrayLike, h: ArrayLike) -> tuple[Trigger, Array]:
        """On-times (n,) s of a sample of h s for the parts (n,) of it that are asked for."""
        asked = jnp.asarray(duty)
        firing = jnp.where(asked >= self.on, 1.0, jnp.where(asked <= self.off, 0.0, s.firing))
        firing = jnp.where(s.held > 1e-9 * self.shortest, 1.0, firing)
        left = jnp.where(s.firing > 0, s.held, self.shortest)
        return Trigger(firing, jnp.where(firing > 0, jnp.maximum(left - h, 0.0), 0.0)), firing * h


@partial(blocks.node, data_fields=["trigger", "gain", "lag"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Pwpf:
    """Pulse-width pulse-frequency modulator: lag dv = gain (asked - given) - v, and a Schmitt trigger on v."""

    trigger: Schmitt
    gain: Numbers  # ()
    lag: Numbers  # () s

    @classmethod
    def create(
        cls, *, on: ArrayLike, off: ArrayLike, gain: ArrayLike, lag: ArrayLike, shortest: ArrayLike = 0.0
    ) -> "Pwpf":
        """Modulator from the levels of its trigger (see `Schmitt.create`), gain () and lag () s of its filter.

        Raises
        ------
        ScenarioError
            What `Schmitt.create` refuses; a gain or lag that is not positive.
        """
        trigger = Schmitt.create(on=on, off=off, shortest=shortest)
        return cls(trigger=trigger, gain=positive("gain", gain), lag=positive("lag", lag))

    def init(self, n: int) -> Lagged:
        """All closed."""
        return Lagged(self.trigger.init(n), jnp.zeros(n))

    def fire(self, s: Lagged, duty: ArrayLike, h: ArrayLike) -> tuple[Lagged, Array]:
        """On-times (n,) s of a sample of h s for the parts (n,) of it that are asked for."""
        target = jnp.asarray(self.gain) * (jnp.asarray(duty) - s.trigger.firing)
        v = target + jnp.exp(-jnp.asarray(h) / self.lag) * (s.lag - target)
        trigger, on = self.trigger.fire(s.trigger, v, h)
        return Lagged(trigger, v), on


class ThrusterState(NamedTuple):
    """State of n thrusters."""

    modulator: Any
    impulse: Array  # (n,) N s, given so far


@partial(blocks.node, data_fields=["torques", "force", "maps", "modulator", "spread", "exhaust"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class AttitudeThrusters:
    """Thrusters on a body, full on or off. Build them with `AttitudeThrusters.create`.

    What exceeds full thrust is made smaller as a whole, so the torque keeps its direction. The force on the centre of
    mass is not modelled.
    """

    torques: Numbers  # (3, n) N m, body axes, of each thruster
    force: Numbers  # (n,) N
    maps: Numbers  # (k, n, 3) on-time per unit of torque and time; those allowed of least total are taken
    modulator: Pwm | Schmitt | Pwpf
    spread: Numbers  # () relative, 1 sigma of the impulse that a thruster gives in a sample
    exhaust: Numbers  # () m/s

    @classmethod
    def create(
        cls,
        positions: ArrayLike,
        directions: ArrayLike,
        *,
        force: ArrayLike,
        modulator: Pwm | Schmitt | Pwpf,
        spread: ArrayLike = 0.0,
        specific_impulse: ArrayLike = np.inf,
    ) -> "AttitudeThrusters":
        """Thrusters from where they are.

        Parameters
        ----------
        positions : (3, n) m, from the centre of mass, body axes, as columns
        directions : (3, n) unit columns, of the force on the body
        force : () or (n,) N, while on
        modulator : `Pwm`, `Schmitt` or `Pwpf`
        spread : () relative, 1 sigma of the impulse that a thruster gives in a sample, from one to the next
        specific_impulse : () s, of the propellant; infinite for propellant that weighs nothing

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN; directions that are not unit vectors; a force that is not positive; thrusters that cannot
            turn the body about every axis in both senses.
        """
        r = real("positions", positions, (3, None))
        n = r.shape[1]
        f = each("force", force, n, positive)
        arms = np.cross(r, unit("directions", directions, (3, n)), axis=0)
        return cls(
            torques=arms * f,
            force=f,
            maps=sharing.least_total(arms * f),
            modulator=modulator,
            spread=real("spread", spread, low=0),
            exhaust=GRAVITY * positive("specific_impulse", specific_impulse, infinite=True),
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample: one for each thruster."""
        return self.force.shape[0]

    def init(self) -> ThrusterState:
        """All closed, nothing spent."""
        n = self.force.shape[0]
        return ThrusterState(self.modulator.init(n), jnp.zeros(n))

    def apply(
        self, s: ThrusterState, command: ArrayLike, x: object, noise: ArrayLike, h: ArrayLike
    ) -> tuple[ThrusterState, Array]:
        """Mean torque (3,) N m on the body over a sample of h s, for a command (3,) N m."""
        del x
        duty = sharing.cheapest(self.maps, command)
        memory, on = self.modulator.fire(s.modulator, duty / jnp.maximum(1.0, jnp.max(duty)), h)
        given = on * (1 + self.spread * jnp.asarray(noise))  # s, of nominal force
        return ThrusterState(memory, s.impulse + self.force * given), jnp.asarray(self.torques) @ given / h

    def propellant(self, s: ThrusterState) -> Array:
        """Propellant spent so far, () kg."""
        return jnp.sum(jnp.asarray(s.impulse)) / self.exhaust
