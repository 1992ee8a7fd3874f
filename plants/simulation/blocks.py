"""Frozen dataclasses of numbers as JAX sees them: registered, checked, and stacked into batches.

A field is a number that may differ from run to run if it holds floats or arrays of numbers, also inside tuples
and other dataclasses. Everything else (int, bool, str, functions) is part of the program: another value is
another compilation. `field(metadata={"static": True})` puts a field of floats among the latter.
"""

import dataclasses
import functools
import threading
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from plants.errors import OpaqueError, ScenarioError

T = TypeVar("T")
KNOWN = 256  # outlines that a function remembers

_registering = threading.Lock()  # JAX takes a class once, and threads fly at the same time


class Form(NamedTuple):
    """What a compiled function is compiled for, hashable."""

    structure: Any  # of one object
    axes: tuple[int | None, ...]  # of `vmap` for each leaf: 0 where it differs between lanes
    lanes: int

    def each(self, function: Callable[..., Any], leaves: Sequence[Any], *own: Any) -> Any:
        """`vmap` of function(object, *own); the arrays in `own` have a leading axis of lanes."""

        def one(leaves: Sequence[Any], *own: Any) -> Any:
            return function(jax.tree.unflatten(self.structure, leaves), *own)

        axes = (list(self.axes), *(0 for _ in own))
        return jax.vmap(one, in_axes=axes, axis_size=self.lanes)(leaves, *own)


class Stack(NamedTuple):
    """Several objects of one structure as one: what is equal in all is kept once."""

    leaves: list[Any]  # arrays; those that differ have a leading axis of lanes
    form: Form


def node(kind: type[T], data_fields: Sequence[str], meta_fields: Sequence[str]) -> type[T]:
    """Register a frozen dataclass with JAX: numbers in `data_fields`, the rest is part of the program.

    Not by `jax.tree_util.register_dataclass`: in JAX 0.10 the structures of different classes registered so are equal
    when their fields are alike, and `jit` then takes the compiled function of one class for the other's.
    """

    def flatten(block: Any) -> tuple[Any, Any]:
        return [getattr(block, name) for name in data_fields], tuple(getattr(block, name) for name in meta_fields)

    def flatten_with_keys(block: Any) -> tuple[Any, Any]:
        numbers, program = flatten(block)
        return list(zip(map(jax.tree_util.GetAttrKey, data_fields), numbers, strict=True)), program

    def unflatten(program: Any, numbers: Any) -> Any:
        return kind(**dict(zip(data_fields, numbers, strict=True)), **dict(zip(meta_fields, program, strict=True)))

    jax.tree_util.register_pytree_with_keys(kind, flatten_with_keys, unflatten, flatten)
    return kind


def register(block: Any) -> None:
    """Register the class of a frozen dataclass, and of those inside it, as pytrees, each class once.

    Raises
    ------
    OpaqueError
        If a block is a mutable dataclass.
    """
    if isinstance(block, tuple | list | dict):
        for item in block.values() if isinstance(block, dict) else block:
            register(item)
    if not dataclasses.is_dataclass(block) or isinstance(block, type):
        return
    kind = type(block)
    members = [f for f in dataclasses.fields(block) if f.init]
    for f in members:
        register(getattr(block, f.name))
    with _registering:
        if not jax.tree_util.all_leaves([block]):
            return  # already known to JAX
        if not kind.__dataclass_params__.frozen:  # pyright: ignore[reportAttributeAccessIssue]
            raise OpaqueError(f"{kind.__name__} is a mutable dataclass: declare it with frozen=True")
        data = [f.name for f in members if _is_data(f, getattr(block, f.name))]
        program = [f.name for f in members if f.name not in data]
        node(kind, data, program)


def check_numbers(block: Any, name: str, *, finite: bool = False) -> None:
    """Raise `ScenarioError` for a leaf that is not a number, is NaN (or infinite), or has lost precision."""
    for path, leaf in jax.tree_util.tree_flatten_with_path(block)[0]:
        where = name + jax.tree_util.keystr(path)
        try:
            value = np.asarray(leaf)
        except Exception as error:
            raise ScenarioError(f"{where} = {leaf!r} is not an array of numbers") from error
        if value.dtype.kind not in "fiub":
            hint = "make it a frozen dataclass or an array" if value.dtype == object else "give real numbers"
            raise ScenarioError(f"{where} has type {type(leaf).__name__}: {hint}")
        if value.dtype.kind == "f" and value.dtype.itemsize < 8:
            raise ScenarioError(
                f"{where} is {value.dtype}, of 7 digits: build it with NumPy or inside jax.enable_x64(True)"
            )
        if np.isnan(value).any() or (finite and not np.isfinite(value).all()):
            raise ScenarioError(f"{where} = {value} is not finite: give finite numbers")


def stack(objects: Sequence[Any], varying: Collection[str] = ()) -> Stack:
    """Stack equal-structured pytrees; leaves equal in all are kept once unless their path is in `varying`.

    Raises
    ------
    ScenarioError
        If structures or array shapes differ.
    """
    leaves: list[Any] = []
    axes: list[int | None] = []
    structure, columns = _columns(objects)
    for name, column in columns.items():
        if name not in varying and _equal(column):
            leaves.append(_array(column[0]))
            axes.append(None)
            continue
        shapes = {np.shape(item) for item in column}
        if len(shapes) > 1:
            raise ScenarioError(f"{name} has shapes {sorted(shapes)} in one batch: give all runs the same shape")
        leaves.append(np.stack([_array(item) for item in column]))
        axes.append(0)
    return Stack(leaves, Form(structure, tuple(axes), len(objects)))


def outline(tree: Any) -> Any:
    """What shapes hang on: the structure of a pytree, and shape and type of its numbers; hashable if its program is.

    Raises
    ------
    TypeError
        If a leaf is no number.
    """
    leaves, structure = jax.tree.flatten(tree)
    kinds = [leaf.dtype if hasattr(leaf, "dtype") else np.asarray(leaf).dtype for leaf in leaves]
    if any(kind.kind not in "fiub" for kind in kinds):
        raise TypeError("a leaf is no number")
    return structure, tuple(zip(map(np.shape, leaves), kinds, strict=True))


def remembered(function: Callable[..., T]) -> Callable[..., T]:
    """function(tree, *static) of what hangs on the tree's outline alone: asked once for each. Failures are not kept."""
    known: dict[Any, T] = {}

    @functools.wraps(function)
    def asked(tree: Any, *static: Any) -> T:
        try:
            key = outline(tree), static
            hash(key)
        except TypeError:  # something that is no number, or a program that cannot be told from others
            return function(tree, *static)
        if key not in known:
            result = function(tree, *static)
            if len(known) >= KNOWN:
                known.clear()
            known[key] = result
        return known[key]

    return asked


def differing(objects: Sequence[Any]) -> set[str]:
    """Paths of the leaves that are not equal in all objects, such as "[0].plant.inertia"."""
    return {name for name, column in _columns(objects)[1].items() if not _equal(column)}


def join(parts: Sequence[Any]) -> Any:
    """Pytrees of numbers as one of arrays, with a leading axis; plain dataclasses are registered as needed."""
    for part in parts:
        register(part)
    return jax.tree.map(lambda *column: np.stack([np.asarray(item) for item in column]), *parts)


def _columns(objects: Sequence[Any]) -> tuple[Any, dict[str, tuple[Any, ...]]]:
    """The common structure, and the leaves of all objects by path."""
    named, structure = jax.tree_util.tree_flatten_with_path(objects[0])
    rows = []
    for index, item in enumerate(objects):
        row, other = jax.tree.flatten(item)
        if other != structure:
            raise ScenarioError(
                f"run {index} differs from run 0 in more than numbers (classes or whole-number settings): "
                "fly it in a batch of its own"
            )
        rows.append(row)
    names = [jax.tree_util.keystr(path) for path, _ in named]
    return structure, dict(zip(names, zip(*rows, strict=True), strict=True))


def _equal(column: Sequence[Any]) -> bool:
    """Whether all items are the same numbers."""
    return all(item is column[0] or np.array_equal(item, column[0]) for item in column[1:])


def _array(leaf: Any) -> np.ndarray:
    """A NumPy array of full width: float64, int64 or bool."""
    value = np.asarray(leaf)
    wide = {"f": np.float64, "i": np.int64, "u": np.int64, "b": np.bool_}
    return value.astype(wide[value.dtype.kind], copy=False)


def _is_data(member: dataclasses.Field | None, value: Any) -> bool:
    """Whether a field holds numbers that may differ from run to run."""
    if member is not None and member.metadata.get("static", False):
        return False
    if value is None or dataclasses.is_dataclass(value):
        return True
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return value.dtype.kind in "fiub"
    if isinstance(value, tuple | list):
        return all(_is_data(None, item) for item in value)
    return isinstance(value, float)
