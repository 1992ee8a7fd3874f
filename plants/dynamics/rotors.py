"""What real wheels do besides their motors: friction on the rotor, and the shake of one that is not balanced.

Friction (Armstrong-Helouvry, Dupont and Canudas de Wit 1994, section 2) of a rotor at the speed Om, on the rotor:

    -(b Om + (c + (s - c) exp(-(Om / v)^2)) tanh(Om / e))     b viscous, c Coulomb, s static, v Stribeck, e creep

The sign of a dry friction is smoothed over the creep speed e, so a rotor at rest creeps instead of sticking: under a
torque T < s it turns at about e T / s. The slope s / e must be slow for the Runge-Kutta step: see `Friction.step`.

Imbalance ("simple jitter": Alcorn, Allard and Schaub 2018, doi 10.2514/1.G003277): on the body act the force Us Om^2 at
the wheel and the torque Ud Om^2, both along a direction across the axis that turns with the rotor. They are external in
this model, so they shake the body but do not conserve momentum exactly, nor do they act on the rotor.

A wheel here is anything with the numbers of `plants.hardware.wheels.Wheel`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike

from plants.checks import Numbers
from plants.geometry import attitude
from plants.simulation import blocks

RUNGE_KUTTA = 2.78  # () |step * slope| up to which the classical method of order 4 is stable on the negative axis
TURN = 20  # () Runge-Kutta steps in a turn of a rotor whose imbalance is to be felt


def column(wheels: Sequence[Any], name: str) -> Any:
    """That number of all wheels, (n,) or for vectors (3, n)."""
    values = [getattr(wheel, name) for wheel in wheels]
    library: Any = jnp if any(isinstance(value, Tracer) for value in values) else np
    return library.stack([library.asarray(value) for value in values], axis=-1)


@partial(blocks.node, data_fields=["viscous", "coulomb", "static", "stribeck", "creep"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Friction:
    """Friction of n rotors."""

    viscous: Numbers  # (n,) N m s
    coulomb: Numbers  # (n,) N m
    static: Numbers  # (n,) N m, at least that of Coulomb
    stribeck: Numbers  # (n,) rad/s, over which static friction gives way
    creep: Numbers  # (n,) rad/s, over which dry friction changes its sign

    @classmethod
    def of(cls, wheels: Sequence[Any]) -> "Friction | None":
        """Friction of wheels from their data sheets; None if they have none."""
        numbers = {name: column(wheels, name) for name in ("viscous", "coulomb", "static")}
        if not any(isinstance(value, Tracer) or value.any() for value in numbers.values()):
            return None
        return cls(**numbers, stribeck=column(wheels, "stribeck"), creep=column(wheels, "creep"))

    def torque(self, speeds: ArrayLike) -> Array:
        """Torque on the rotors, (n,) N m, at speeds (n,) rad/s relative to the body."""
        Om = jnp.asarray(speeds)
        dry = self.coulomb + (self.static - self.coulomb) * jnp.exp(-((Om / self.stribeck) ** 2))
        return -jnp.asarray(self.viscous) * Om - dry * jnp.tanh(Om / self.creep)

    def step(self, inertia: ArrayLike) -> Array:
        """Longest Runge-Kutta step, () s, at which rotors of inertia (n,) kg m^2 come to rest without ringing."""
        slope = (self.viscous + self.static / self.creep) / jnp.asarray(inertia)
        return RUNGE_KUTTA / jnp.max(slope)


@partial(blocks.node, data_fields=["static", "dynamic", "positions", "across", "along"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Imbalance:
    """Imbalance of n rotors."""

    static: Numbers  # (n,) kg m
    dynamic: Numbers  # (n,) kg m^2
    positions: Numbers  # (3, n) m, from the centre of mass
    across: Numbers  # (3, n) where the heavy side of each rotor is at phase zero
    along: Numbers  # (3, n) and a quarter of a turn later

    @classmethod
    def of(cls, wheels: Sequence[Any]) -> "Imbalance | None":
        """Imbalance of wheels from their data sheets; None if they have none."""
        numbers = {name: column(wheels, f"{name}_imbalance") for name in ("static", "dynamic")}
        if not any(isinstance(value, Tracer) or value.any() for value in numbers.values()):
            return None
        axes = np.asarray(column(wheels, "axis"))
        far = np.eye(3)[np.argmin(np.abs(axes), axis=0)].T  # the body axis farthest from each spin axis
        across = far - axes * (axes * far).sum(axis=0)
        across /= np.linalg.norm(across, axis=0)
        return cls(**numbers, positions=column(wheels, "position"), across=across, along=np.cross(axes, across, axis=0))

    def torque(self, speeds: ArrayLike, phase: ArrayLike) -> Array:
        """Torque on the body, (3,) N m, of rotors at speeds (n,) rad/s and phases (n,) rad."""
        Om, angle = jnp.asarray(speeds), jnp.asarray(phase)
        heavy = jnp.cos(angle) * self.across + jnp.sin(angle) * self.along
        lever = attitude.cross(jnp.asarray(self.positions).T, (self.static * heavy).T).T
        return jnp.sum(Om**2 * (lever + self.dynamic * heavy), axis=1)
