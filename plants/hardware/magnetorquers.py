"""Magnetorquers: coils or rods that make a dipole moment, which the Earth's field turns."""

from dataclasses import dataclass
from functools import partial

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, each, positive, real, unit
from plants.errors import ScenarioError
from plants.simulation import blocks


@partial(blocks.node, data_fields=["axes", "share", "max_dipole", "residual", "step"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Magnetorquers:
    """Magnetorquers with limits. Build them with `Magnetorquers.create`.

    A dipole beyond the limit of any of them is made smaller as a whole, so it keeps its direction; each then rounds to
    its step. What is left in the cores without current adds to it.
    """

    axes: Numbers  # (3, n) unit columns, body axes
    share: Numbers  # (n, 3) moments per unit of dipole moment: pinv(axes)
    max_dipole: Numbers  # (n,) A m^2
    residual: Numbers  # (n,) A m^2
    step: Numbers  # (n,) A m^2, 0 for none

    @classmethod
    def create(
        cls,
        axes: ArrayLike | None = None,
        *,
        max_dipole: ArrayLike,
        residual: ArrayLike = 0.0,
        step: ArrayLike = 0.0,
    ) -> "Magnetorquers":
        """Magnetorquers from their data sheet.

        Parameters
        ----------
        axes : (3, n) unit columns, body axes; the three body axes by default. What they do not span is lost.
        max_dipole : () or (n,) A m^2, inf for no limit
        residual : () or (n,) A m^2, remanence of the cores along the axes
        step : () or (n,) A m^2, quantisation

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN; axes that are not unit vectors; a limit that is not positive, a negative step.
        """
        G = unit("axes", np.eye(3) if axes is None else axes, (3, None))
        n = G.shape[1]
        if n == 0:
            raise ScenarioError("axes = []: give at least one column")
        return cls(
            axes=G,
            share=np.linalg.pinv(G),
            max_dipole=each("max_dipole", max_dipole, n, positive, infinite=True),
            residual=each("residual", residual, n, real),
            step=each("step", step, n, real, low=0),
        )

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def apply(self, s: tuple[()], command: ArrayLike, x: object) -> tuple[tuple[()], Array]:
        """Dipole moment (3,) A m^2, body axes, for a command (3,) A m^2."""
        del x
        asked = jnp.asarray(self.share) @ jnp.asarray(command)
        asked = asked / jnp.maximum(1.0, jnp.max(jnp.abs(asked) / self.max_dipole))
        step = jnp.where(jnp.asarray(self.step) > 0, self.step, 1.0)
        made = jnp.where(jnp.asarray(self.step) > 0, step * jnp.round(asked / step), asked)
        return s, jnp.asarray(self.axes) @ (jnp.clip(made, -self.max_dipole, self.max_dipole) + self.residual)
