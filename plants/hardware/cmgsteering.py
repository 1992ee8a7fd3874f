"""Steering of moment gyroscopes: gimbal rates that give a torque, without asking for infinite ones at a singularity.

The rates -J' (J J' + a I)^-1 T give the torque T exactly where a = 0, which is where the manipulability
w = sqrt(det(J J')) is above a threshold w0; below it a = a0 (1 - w / w0)^2 trades torque for bounded rates (Nakamura
and Hanafusa 1986, doi 10.1115/1.3143764; for gyroscopes Oh and Vadali 1991). J is in units of their mean momentum.
Exactly at a singularity a torque along the singular direction is not given at all: nothing drives the cluster out.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, counted, positive
from plants.dynamics.cmgs import Cmgs
from plants.errors import ScenarioError
from plants.simulation import blocks


@partial(blocks.node, data_fields=["cmgs", "max_rate", "threshold", "damping"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class CmgSteering:
    """Singularity-robust steering of a cluster. Build it with `CmgSteering.create`."""

    cmgs: Cmgs
    max_rate: Numbers  # () rad/s
    threshold: Numbers  # () of the manipulability, momenta counted in their mean
    damping: Numbers  # ()

    @classmethod
    def create(
        cls, cmgs: Cmgs, *, max_rate: ArrayLike, threshold: ArrayLike = 0.3, damping: ArrayLike = 0.1
    ) -> "CmgSteering":
        """Steering of a cluster.

        Parameters
        ----------
        cmgs : the same that the plant is given, three gyroscopes at least
        max_rate : () rad/s, of each gimbal; rates beyond it are made smaller as a whole, inf for no limit
        threshold : () manipulability, for momenta of one, below which torque is traded for rates
        damping : () how much of it at a singularity, in units of squared momenta of one

        Raises
        ------
        ScenarioError
            Fewer than three gyroscopes; a number that is not positive.
        """
        if cmgs.gimbals.shape[1] < 3:
            raise ScenarioError(f"cmgs has {cmgs.gimbals.shape[1]} gyroscopes: three at least give every torque")
        return cls(
            cmgs=cmgs,
            max_rate=positive("max_rate", max_rate, infinite=True),
            threshold=positive("threshold", threshold),
            damping=positive("damping", damping),
        )

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def apply(self, s: tuple[()], command: ArrayLike, x: Any) -> tuple[tuple[()], Array]:
        """Gimbal rates (m,) rad/s for a torque on the body (3,) N m, at a plant state with `gimbals` (m,) rad."""
        size = jnp.mean(jnp.asarray(self.cmgs.momenta))
        gimbals = counted("gimbals of the state", x.gimbals, self.cmgs.momenta.shape[0], "gyroscope")
        J = self.cmgs.jacobian(gimbals) / size
        lack = jnp.maximum(1.0 - self.cmgs.singularity(gimbals) / size**3 / self.threshold, 0.0)
        spread = J @ J.T + self.damping * lack**2 * jnp.eye(3)
        rates = -J.T @ jnp.linalg.solve(spread, jnp.asarray(command) / size)
        return s, rates / jnp.maximum(1.0, jnp.max(jnp.abs(rates)) / self.max_rate)
