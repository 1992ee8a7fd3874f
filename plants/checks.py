"""What a number of a plant must be before it may enter a simulation.

Factories call `real` on every argument. Shape and precision are checked also of values that JAX is tracing;
the rest needs concrete numbers and is skipped inside `jit`, `vmap` and `grad`, where nothing can raise.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from plants.errors import ScenarioError

Numbers = np.ndarray | Array  # what the fields of a plant hold


def real(
    name: str, value: Any, shape: tuple[int | None, ...] = (), *, low: float | None = None, infinite: bool = False
) -> Any:
    """Float64 array of the given shape: concrete values come back as NumPy arrays, traced ones as they are.

    Parameters
    ----------
    name : what the error message calls the field
    value : anything `np.asarray` takes
    shape : expected shape, None where any length will do
    low : least value allowed, no bound if None
    infinite : whether +inf is allowed ("no limit")

    Raises
    ------
    ScenarioError
        Wrong shape, not real numbers, NaN or infinity, below `low`; a traced value that is not float64.
    """
    traced = isinstance(value, Tracer)
    if traced and value.dtype != np.float64:
        raise ScenarioError(f"{name} is traced as {value.dtype}: enter `jax.enable_x64(True)` around the call")
    try:
        array = value if traced else np.asarray(value)
        if not np.can_cast(array.dtype, np.float64, "same_kind"):
            raise TypeError(f"{array.dtype} is not real")
        array = value if traced else array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ScenarioError(f"{name} must be real numbers, got {value!r}") from error
    if not traced and np.ma.is_masked(value):
        raise ScenarioError(f"{name} has masked entries, which have no value: fill them, or leave them away")
    if len(array.shape) != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        wanted = tuple("n" if n is None else n for n in shape)
        raise ScenarioError(f"{name} must have shape {wanted}, got {array.shape}")
    if traced:
        return array
    if not np.isfinite(np.where(array == np.inf, 0.0, array) if infinite else array).all():
        raise ScenarioError(f"{name} must be finite, got {array.tolist()}: check where it comes from")
    if low is not None and (array < low).any():
        raise ScenarioError(f"{name} must be at least {low:g}, got {array.tolist()}")
    return array


def positive(name: str, value: Any, shape: tuple[int | None, ...] = (), *, infinite: bool = False) -> Any:
    """As `real`, with every entry above zero; ScenarioError otherwise."""
    array = real(name, value, shape, infinite=infinite)
    if not isinstance(array, Tracer) and not (array > 0).all():
        raise ScenarioError(f"{name} must be positive, got {array.tolist()}")
    return array


def each(name: str, value: Any, n: int, check: Callable[..., Any], **options: Any) -> Any:
    """A number for each of n devices, (n,), from one for all or as many; checked by `real` or `positive`."""
    checked = check(name, value, (n,) if np.ndim(value) else (), **options)
    return checked if np.ndim(checked) else checked * np.ones(n)


def counted(name: str, value: Any, n: int, what: str) -> Any:
    """The same, concrete or traced, if it has the shape (n,); ScenarioError that it is not one for each `what`."""
    if np.shape(value) != (n,):
        raise ScenarioError(f"{name} has shape {np.shape(value)}: give ({n},), one for each {what}")
    return jnp.asarray(value)


def unit(name: str, value: Any, shape: tuple[int | None, ...]) -> Any:
    """As `real`, a vector or columns of length one (to 1e-9); ScenarioError otherwise."""
    array = real(name, value, shape)
    if not isinstance(array, Tracer):
        lengths = np.linalg.norm(array, axis=0)
        if not np.allclose(lengths, 1, rtol=0, atol=1e-9):
            what, were = ("a unit vector", "length") if array.ndim == 1 else ("unit columns", "lengths")
            raise ScenarioError(f"{name} must be {what}, got {were} {lengths.tolist()}: normalise them")
    return array


def whole(name: str, value: Any, part: Any, what: str) -> int:
    """How many times `part` s fit into `value` s, at least once and without rest (to 1e-9).

    Raises
    ------
    ScenarioError
        They do not; the message names both, and `what` a part is, such as "control periods".
    """
    value, part = float(positive(name, value)), float(positive(what, part))
    count = round(value / part)
    if count < 1 or abs(count * part - value) > 1e-9 * value:
        raise ScenarioError(f"{name} = {value} s: give a whole number of {what} of {part} s, at least one")
    return count
