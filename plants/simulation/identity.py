"""What a thing is, as a sha256: numbers by their bits, blocks by their fields, functions by their code.

So that a folder of flown runs can tell whether it is continued by the study that began it. A function is known by its
own code, its defaults and what it encloses, not by the code of what it calls.
"""

import dataclasses
import functools
import hashlib
import inspect
import textwrap
from collections.abc import Callable, Iterable, Mapping
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import jax
import numpy as np


def digest(thing: Any) -> str:
    """The sha256 of anything that campaigns are made of, the same in every process."""
    hashed = hashlib.sha256()
    for part in _parts(thing, ()):
        hashed.update(len(part).to_bytes(8, "big") + part)
    return hashed.hexdigest()


def source(function: Callable[..., Any] | None) -> str:
    """The code of a function for a reader, "" if it is not to be had."""
    if isinstance(function, functools.partial):
        given = [repr(a) for a in function.args] + [f"{name}={value!r}" for name, value in function.keywords.items()]
        return f"# partial: {', '.join(given)}\n{source(function.func)}"
    try:
        return textwrap.dedent(inspect.getsource(function)) if function is not None else ""
    except (OSError, TypeError):
        return ""


def _parts(thing: Any, above: tuple[int, ...]) -> Iterable[bytes]:
    """Bytes that differ where things differ."""
    if id(thing) in above:
        yield b"itself"
        return
    inside = (*above, id(thing))
    if thing is None or isinstance(thing, bool | int | str | bytes | complex):
        yield f"{type(thing).__name__} {thing!r}".encode("utf-8", "surrogatepass")
    elif isinstance(thing, float):
        yield f"float {thing.hex()}".encode()
    elif isinstance(thing, np.ndarray | np.generic | jax.Array) and np.asarray(thing).dtype != object:
        array = np.asarray(thing)
        yield f"array {array.dtype.str} {array.shape}".encode()
        yield array.tobytes()
    elif isinstance(thing, functools.partial):
        yield b"partial"
        yield from _parts((thing.func, thing.args, thing.keywords), inside)
    elif isinstance(thing, MethodType):
        yield b"method"
        yield from _parts((thing.__func__, thing.__self__), inside)
    elif isinstance(thing, FunctionType):
        yield f"function {thing.__module__}.{thing.__qualname__}".encode()
        yield from _code(thing.__code__)
        enclosed = [_content(cell) for cell in thing.__closure__ or ()]
        yield from _parts((thing.__defaults__, thing.__kwdefaults__, enclosed), inside)
    elif isinstance(thing, type | BuiltinFunctionType):
        yield f"name {thing.__module__}.{thing.__qualname__}".encode()
        if not isinstance(getattr(thing, "__self__", None), ModuleType | None):  # such as [1.0].count
            yield from _parts(thing.__self__, inside)
    else:
        yield f"{type(thing).__module__}.{type(thing).__qualname__}".encode()
        for name, value in _members(thing):
            yield from _parts(name, inside)
            yield from _parts(value, inside)


def _code(code: CodeType) -> Iterable[bytes]:
    """What a function does, wherever in its file it stands."""
    yield code.co_code
    yield repr((code.co_names, code.co_varnames)).encode()
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _code(constant)
        else:
            yield repr(sorted(map(repr, constant)) if isinstance(constant, frozenset) else constant).encode()


def _content(cell: Any) -> Any:
    """What a function encloses; nothing where it is not yet bound."""
    try:
        return cell.cell_contents
    except ValueError:
        return None


def _members(thing: Any) -> Iterable[tuple[Any, Any]]:
    """Names and values of what a thing holds; what a library in C holds is not seen.

    A thing that says what it is pickled as is that: what it keeps beside, such as a solver's memory, changes while it
    flies. Nor does a cached property count.
    """
    reduce = inspect.getattr_static(type(thing), "__reduce__")
    if isinstance(reduce, FunctionType):
        return list(enumerate(reduce(thing)))
    if dataclasses.is_dataclass(thing):
        return [(f.name, getattr(thing, f.name)) for f in dataclasses.fields(thing)]
    if isinstance(thing, Mapping):
        return list(thing.items())
    if isinstance(thing, set | frozenset):
        return [("member", each) for each in sorted(map(digest, thing))]
    if isinstance(thing, np.ndarray | tuple | list | range):
        return list(enumerate(thing))
    slots = {name for kind in type(thing).__mro__ for name in np.atleast_1d(getattr(kind, "__slots__", ()))}
    found = {name: getattr(thing, name) for name in sorted(slots) if hasattr(thing, name)}
    own = {**found, **getattr(thing, "__dict__", {})}
    cached = functools.cached_property
    return sorted((n, v) for n, v in own.items() if not isinstance(getattr(type(thing), n, None), cached))
