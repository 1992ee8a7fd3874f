"""Inertia of a rigid body: from what it is given, and whether any body has it."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from plants.checks import real
from plants.errors import ScenarioError


def inertia_matrix(name: str, value: Any) -> Any:
    """Inertia (3, 3) kg m^2 from a matrix, or from three moments as its diagonal; traced numbers stay traced.

    Raises
    ------
    ScenarioError
        Wrong shape, NaN, float32 tracers, a matrix that is not symmetric.
    """
    if np.shape(value) == (3,):
        moments = real(name, value, (3,))
        return jnp.diag(moments) if isinstance(moments, Tracer) else np.diag(moments)
    I = real(name, value, (3, 3))
    if not isinstance(I, Tracer) and not np.allclose(I, I.T, rtol=0, atol=1e-12 * np.abs(I).max()):
        raise ScenarioError(f"{name} must be symmetric, got {I.tolist()}: products of inertia come in pairs")
    return I


def check_moments(name: str, I: np.ndarray) -> None:
    """Raise `ScenarioError` if no distribution of mass has the inertia I (3, 3) kg m^2.

    Each principal moment is at most the sum of the other two (Markley and Crassidis 2014, section 3.3.1); equal for a
    flat plate, so to 1e-9.
    """
    small, middle, large = np.linalg.eigvalsh(I)
    if large > (small + middle) * (1 + 1e-9):
        raise ScenarioError(
            f"{name} has the principal moments {small:.6g}, {middle:.6g}, {large:.6g} kg m^2, which no body has: none "
            "may exceed the sum of the others; physical=False takes them all the same (moments dispersed one by one)"
        )
