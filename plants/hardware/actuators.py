"""Actuators: from the torque a controller asks for to the torque the motors give.

These wheels have limits only; `plants.hardware.wheels.WheelArray` has what data sheets say.

A delay between command and action belongs to the loop (`plants.simulation.simulate.Loop.delay`), not to the wheels.
"""

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, counted, each, positive, unit
from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.simulation import blocks


@partial(
    blocks.node,
    data_fields=["distribution", "torque_limit", "speed_limit"],
    meta_fields=[],
)
@dataclass(frozen=True, kw_only=True)
class ReactionWheels:
    """Reaction wheels with limits; without limits they are ideal. Build them with `ReactionWheels.create`.

    Every motor saturates by itself, so a saturated command changes direction. At the speed limit a wheel gives
    no torque that would speed it up further; the limit is tested once per call, so it can be passed by what
    the motor adds in one sample.
    """

    distribution: Numbers  # (n, 3) motor torque per unit of body torque: -pinv(axes)
    torque_limit: Numbers  # (n,) N m
    speed_limit: Numbers  # (n,) rad/s

    @classmethod
    def create(
        cls, axes: ArrayLike, *, torque_limit: ArrayLike = np.inf, speed_limit: ArrayLike = np.inf
    ) -> "ReactionWheels":
        """Wheels that share a body torque so that the sum of squared motor torques is least.

        Parameters
        ----------
        axes : (3, n) unit spin axes in body axes, as columns
        torque_limit : () or (n,) N m, of all motors or of each
        speed_limit : () or (n,) rad/s, of all wheels or of each, relative to the body

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, axes that are not unit vectors or do not span space, limits that are not positive.
        """
        G, limits = unit("axes", axes, (3, None)), {}
        for name, limit in (("torque_limit", torque_limit), ("speed_limit", speed_limit)):
            limits[name] = each(name, limit, G.shape[1], positive, infinite=True)
        if np.linalg.matrix_rank(G) < 3:
            raise ScenarioError(f"axes must span space, got {G.tolist()}: three independent columns at least")
        return cls(distribution=-np.linalg.pinv(G), **limits)

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def apply(self, s: tuple[()], command: ArrayLike, x: BodyState) -> tuple[tuple[()], Array]:
        """Motor torques (n,) N m on the wheels for a body torque `command` (3,) N m."""
        speeds = counted("wheels of the state", x.wheels, self.distribution.shape[0], "wheel")
        u = jnp.clip(jnp.asarray(self.distribution) @ command, -self.torque_limit, self.torque_limit)
        return s, jnp.where((u * speeds > 0) & (jnp.abs(speeds) >= self.speed_limit), 0.0, u)
