"""Control moment gyroscopes: rotors of constant speed whose axes are turned by gimbals.

Gyroscope i holds the momentum h_i along s_i and turns about g_i, across s_i, by its gimbal angle d_i:

    h(d) = sum h_i (cos d_i s_i + sin d_i g_i x s_i),      J(d) = dh/dd = [h_i (cos d_i g_i x s_i - sin d_i s_i)]

The torque on the body is -(J dd/dt + w x h). The inertia of the gimbals counts as part of the body, and the torque that
turns them is not modelled: their rates are given. Leve, Hamilton and Peck (2015), Spacecraft Momentum Control Systems.
"""

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, each, positive, real, unit
from plants.errors import ScenarioError
from plants.simulation import blocks


@partial(blocks.node, data_fields=["momenta", "gimbals", "spins"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Cmgs:
    """A cluster of m single-gimbal control moment gyroscopes. Build it with `Cmgs.create` or `Cmgs.pyramid`."""

    momenta: Numbers  # (m,) N m s, of each rotor
    gimbals: Numbers  # (3, m) unit gimbal axes, body axes
    spins: Numbers  # (3, m) unit spin axes at gimbal angle zero, body axes

    @classmethod
    def create(cls, gimbal_axes: ArrayLike, spin_axes: ArrayLike, *, momentum: ArrayLike) -> "Cmgs":
        """A cluster from its numbers.

        Parameters
        ----------
        gimbal_axes : (3, m) unit columns, body axes
        spin_axes : (3, m) unit columns across the gimbal axes: where the momenta point at gimbal angle zero
        momentum : () or (m,) N m s, of each rotor

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, axes that are not unit vectors or not perpendicular, a momentum that is not positive.
        """
        g = unit("gimbal_axes", gimbal_axes, (3, None))
        s = unit("spin_axes", spin_axes, (3, g.shape[1]))
        across = np.abs((g * s).sum(axis=0))
        if (across > 1e-9).any():
            raise ScenarioError(
                f"spin_axes must be perpendicular to gimbal_axes, got cosines {across.tolist()}: a gimbal turns "
                "the spin axis in a plane"
            )
        return cls(momenta=each("momentum", momentum, g.shape[1], positive), gimbals=g, spins=s)

    @classmethod
    def pyramid(cls, *, momentum: ArrayLike, skew: float = np.arctan(np.sqrt(2.0))) -> "Cmgs":
        """Four gyroscopes, one on each face of a pyramid about the body's z axis.

        Parameters
        ----------
        momentum : () or (4,) N m s, of each rotor
        skew : () rad in (0, pi/2), of the faces from the base; at 54.74 deg the momentum envelope is nearly a sphere

        Raises
        ------
        ScenarioError
            A momentum that is not positive, a skew out of range.
        """
        b = float(real("skew", skew))
        if not 0 < b < np.pi / 2:
            raise ScenarioError(f"skew = {b} rad: give the angle of the faces from the base, between 0 and pi/2")
        turn = np.arange(4) * np.pi / 2
        c, s = np.cos(turn), np.sin(turn)
        gimbals = np.stack([np.sin(b) * c, np.sin(b) * s, np.full(4, np.cos(b))])
        return cls.create(gimbals, np.stack([-s, c, np.zeros(4)]), momentum=momentum)

    def momentum(self, angles: ArrayLike) -> Array:
        """Momentum (3,) N m s, body axes, at gimbal angles (m,) rad."""
        d = jnp.asarray(angles)
        return (jnp.cos(d) * self.spins + jnp.sin(d) * self._sides()) @ jnp.asarray(self.momenta)

    def jacobian(self, angles: ArrayLike) -> Array:
        """Slope of the momentum in the gimbal angles (m,) rad: (3, m) N m s."""
        d = jnp.asarray(angles)
        return (jnp.cos(d) * self._sides() - jnp.sin(d) * self.spins) * self.momenta

    def singularity(self, angles: ArrayLike) -> Array:
        """Manipulability sqrt(det(J J')), () (N m s)^3: zero where no rates give some torque (Yoshikawa 1985)."""
        J = self.jacobian(angles)
        return jnp.sqrt(jnp.maximum(jnp.linalg.det(J @ J.T), 0.0))

    def _sides(self) -> Array:
        """Directions (3, m) a quarter of a turn after the spin axes."""
        return jnp.cross(jnp.asarray(self.gimbals), jnp.asarray(self.spins), axis=0)
