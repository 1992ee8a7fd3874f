"""What an argument must be before anything is computed with it: numbers, matrices, choices, timebases.

Every function here returns the value in the one form that is used inside, or raises a `ModelError` that names the
argument, what was got, and what to pass instead. Nothing is clipped, rounded or taken for something else.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from synth.errors import ModelError, NumericalError

P = ParamSpec("P")
T = TypeVar("T")

SYMMETRIC = 1e-12  # relative
POSITIVE = ("a symmetric positive semidefinite matrix", "a symmetric positive definite matrix")
SHOWN = 60  # characters of a wrong value in a message
MOST = 1_000_000  # samples or signals that anybody counts
KINDS = {"c": "complex", "M": "a date", "m": "a time span", "S": "text", "U": "text", "V": "a record"}


def shown(value: Any) -> str:
    """A wrong value as a message shows it: short, on one line."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # an object that cannot even be shown is still named by its type
        text = ""
    if not text or text.startswith("<") or len(text) > SHOWN:
        text = f"{text[:SHOWN]}... " if text and not text.startswith("<") else ""
        return f"{text}({type(value).__name__})" if text else f"an object of type {type(value).__name__}"
    return text


def printable(text: str) -> str:
    """Text for a terminal: control characters and what turns the direction of writing stand as escapes, lines stay."""
    return "".join(c if c.isprintable() or c == "\n" else c.encode("unicode_escape").decode() for c in text)


def as_array(
    name: str,
    value: Any,
    wanted: str = "pass real numbers",
    kind: str = "an array of real numbers",
    *,
    finite: bool = True,
) -> np.ndarray:
    """Float64 numbers in an array of any shape, a copy; finite ones unless the caller looks at that itself."""
    if type(value) is np.ndarray and value.dtype == np.float64 and math.isfinite(np.vdot(value, value)):
        return value.copy()
    if callable(value):
        raise ModelError(f"{name} is not {kind} ({shown(value)}); {wanted}")
    if hasattr(value, "toarray"):
        raise ModelError(f"{name} is a sparse matrix; pass {name}.toarray(), small systems are kept dense")
    try:
        check_unmasked(name, value)
        raw: Any = np.asarray(value)
        if raw.dtype.kind in KINDS and not (raw.dtype.kind == "c" and not np.any(raw.imag)):
            raise ModelError(f"{name} is not {kind} (it is {KINDS[raw.dtype.kind]}, {shown(value)}); {wanted}")
        if trouble := _unlike_doubles(value, raw):
            raise ModelError(f"{name} {trouble}")
        M = np.array(raw.real if raw.dtype.kind == "c" else raw, dtype=float)
    except ModelError:
        raise
    except Exception as error:  # whatever a foreign object raises when it is asked for numbers
        raise ModelError(f"{name} is not {kind} ({shown(value)}: {error}); {wanted}") from None
    if finite and not np.isfinite(M).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(M))[0])
        at = f"[{', '.join(map(str, where))}]" if where else ""
        raise ModelError(f"{name}{at} is {M[where]}; every entry must be finite")
    return M


def _unlike_doubles(value: Any, raw: np.ndarray) -> str:
    """What is lost or made up where data is taken for doubles, with the remedy; empty where nothing is.

    `raw` is the value as NumPy takes it, which does not tell the precision of the parts of a list.
    """
    if raw.dtype.kind == "O":  # lists with whole numbers beyond 64 bits are
        if (listed := isinstance(value, list | tuple)) and all(type(x) in (int, float) for x in raw.flat):
            return ""
        odd = next((x for x in raw.flat if type(x) not in (int, float)), None) if listed else value
        return f"holds objects, such as {shown(odd)}, no numbers of a machine; pass np.array(..., dtype=float)"
    for part in (raw, *_arrays_in(value)):
        dtype = np.dtype(part.dtype)
        if dtype.kind in "fc" and dtype not in (np.float64, np.complex128):
            digits = np.finfo(dtype).precision
            return f"is {dtype}, of {digits + 1} digits, where doubles have 16; pass it .astype(float) if that is meant"
    return ""


def check_unmasked(name: str, value: Any) -> None:
    """Raise ModelError for masked entries; NumPy takes what is below the mask, or NaN."""
    if any(np.ma.is_masked(part) for part in _arrays_in(value)):
        raise ModelError(f"{name} has masked entries, which have no value; fill them, or leave their rows away")


def _arrays_in(value: Any) -> Iterator[Any]:
    """Arrays and their scalars in lists of any depth."""
    if isinstance(value, list | tuple):
        if not {*map(type, value)} <= {float, int, bool}:
            for item in value:
                yield from _arrays_in(item)
    elif hasattr(value, "dtype"):
        yield value


def as_roots(name: str, value: Any) -> np.ndarray:
    """Complex numbers, in texts too as files have them; raises what NumPy raises, and ModelError for other kinds."""
    check_unmasked(name, value)
    raw = np.asarray(value)
    if (raw.dtype.kind in "fc" or isinstance(value, np.ndarray)) and (trouble := _unlike_doubles(value, raw)):
        raise ModelError(f"{name}: it {trouble}")
    return np.asarray(value, dtype=complex)


def as_signal(name: str, value: Any) -> np.ndarray:
    """Measured numbers in every step of a controller: float64, of any shape, not looked at further if they are."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    return as_array(name, value, finite=False)


def numerical(function: Callable[P, T]) -> Callable[P, T]:
    """The function with what LAPACK and Python raise where doubles end as a `NumericalError`."""

    @functools.wraps(function)
    def told(*arguments: P.args, **options: P.kwargs) -> T:
        try:
            return function(*arguments, **options)
        except (np.linalg.LinAlgError, ArithmeticError) as error:
            raise NumericalError(
                f"the numbers given are too large, too small or too far apart for doubles ({error}); choose other units"
            ) from error

    return told


def restore(self: object, state: Mapping[str, Any]) -> None:
    """`__setstate__` of a class whose arrays are read-only: in its copies and pickles they are so again."""
    for name, value in state.items():
        if isinstance(value, np.ndarray):
            value = value.view()
            value.flags.writeable = False
        object.__setattr__(self, name, value)


def as_matrix(name: str, value: Any, shape: tuple[int | None, int | None] = (None, None)) -> np.ndarray:
    """A finite float64 matrix; numbers and vectors become the row or column that fits `shape`, None fits any size."""
    M = as_array(name, value, "pass numbers in rows and columns", "a real matrix")
    if M.ndim == 2 and shape in ((None, None), M.shape):
        return M
    if M.ndim > 2:
        raise ModelError(f"{name} has {M.ndim} dimensions; pass a matrix")
    if M.ndim < 2:
        column = M.ndim == 1 and shape[1] == 1 and shape[0] in (None, M.size)
        M = M.reshape(-1, 1) if column else M.reshape(1, -1)
    if any(want is not None and have != want for have, want in zip(M.shape, shape, strict=True)):
        raise ModelError(f"{name} is {M.shape[0]} x {M.shape[1]} where {sizes(shape)} is needed")
    return M


def as_weight(name: str, value: Any, size: int) -> np.ndarray:
    """A (size, size) weight: a number stands for that multiple of the identity, a list for a diagonal."""
    M = as_array(name, value, f"pass a number, {size} numbers or a {size} x {size} matrix")
    if M.ndim == 0:
        return float(M) * np.eye(size)
    if M.ndim == 1:
        if M.size != size:
            raise ModelError(f"{name} has {M.size} entries; pass a number, {size} of them or a {size} x {size} matrix")
        return np.diag(M)
    return M if M.shape == (size, size) else as_matrix(name, M, (size, size))


def as_vector(name: str, value: Any, size: int) -> np.ndarray:
    """A vector (size,); a row or a column will do, a number stands for one entry only."""
    M = as_array(name, value, f"pass {size} numbers")
    if M.size != size or M.ndim > 2 or (M.ndim == 2 and 1 not in M.shape):
        raise ModelError(f"{name} has shape {M.shape}; pass {size} numbers")
    return M.ravel()


def sizes(shape: Iterable[int | None]) -> str:
    """A shape in words, `any` where any size will do."""
    return " x ".join("any" if s is None else str(s) for s in shape)


def as_number(name: str, value: Any, wanted: str, *, above: float | None = None, least: float | None = None) -> float:
    """A finite number, within its bounds; `wanted` says what to pass."""
    if isinstance(value, bool | np.bool_ | str | bytes) or value is None or np.ndim(_quiet(value)) != 0:
        raise ModelError(f"{name} is {shown(value)}; pass {wanted}")
    check_unmasked(name, value)
    if isinstance(value, np.ndarray | np.generic) and (trouble := _unlike_doubles(value, np.asarray(value))):
        raise ModelError(f"{name} {trouble}")
    try:
        number = float(value)
    except Exception:  # whatever a foreign object raises
        raise ModelError(f"{name} is {shown(value)}; pass {wanted}") from None
    if not np.isfinite(number) or (above is not None and number <= above) or (least is not None and number < least):
        raise ModelError(f"{name} is {shown(value)}; pass {wanted}")
    return number


def _quiet(value: Any) -> Any:
    """The value if NumPy can say how many dimensions it has, else a list, which no number is."""
    try:
        np.ndim(value)
    except Exception:  # ragged lists and foreign objects
        return []
    return value


def as_whole(name: str, value: Any, wanted: str, *, least: int, most: int = MOST) -> int:
    """A whole number within its bounds."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise ModelError(f"{name} is {shown(value)}; pass {wanted}")
    if not least <= value <= most:
        raise ModelError(f"{name} is {shown(value)}; pass {wanted}{f', at most {most}' if value > most else ''}")
    return int(value)


def as_choice(name: str, value: Any, choices: Iterable[str]) -> str:
    """One of a few words."""
    choices = tuple(choices)
    if not isinstance(value, str) or value not in choices:
        raise ModelError(f"{name} is {shown(value)}; pass one of {', '.join(choices)}")
    return value


def as_flag(name: str, value: Any) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise ModelError(f"{name} is {shown(value)}; pass True or False")
    return bool(value)


def as_path(name: str, value: Any) -> Path:
    """A path of the file system."""
    if not isinstance(value, str | os.PathLike):
        raise ModelError(f"{name} is {shown(value)}; pass the path of a file or folder")
    return Path(value)


def as_sign(sign: Any) -> int:
    """-1 or +1 of a feedback."""
    if isinstance(sign, bool) or np.ndim(_quiet(sign)) != 0 or sign not in (-1, 1):
        raise ModelError(f"sign is {shown(sign)}; pass -1 (negative feedback) or 1 (positive feedback)")
    return int(sign)


def as_timebase(dt: Any) -> float:
    """Sampling time in seconds, 0 for continuous time, True for discrete time of which nobody said the sampling time.

    True counts as one: frequencies are then in rad/sample, times in samples. See `joint_timebase`, `check_period`.
    """
    if dt is True or (isinstance(dt, np.bool_) and dt):
        return True
    if isinstance(dt, bool | np.bool_) or dt is None:
        raise ModelError(
            f"dt is {dt}: the timebase is unspecified; pass 0 (continuous), the sampling time in seconds, or True "
            "(discrete, the sampling time unknown)"
        )
    return as_number("dt", dt, "0 (continuous) or a positive sampling time in seconds", least=0)


def joint_timebase(a: float, b: float) -> float | None:
    """The timebase of two systems together: True goes with every sampling time; None where they disagree."""
    if a is True or b is True:
        return None if a == 0 or b == 0 else b if a is True else a
    return a if np.isclose(a, b, rtol=1e-12, atol=0) else None


def check_period(name: str, dt: float) -> None:
    """Raise ModelError for a sampling time that nobody said, where seconds are needed."""
    if dt is True:
        raise ModelError(f"{name} has dt = True, an unspecified sampling time; say it: system({name}, dt=0.1)")


def timebase_told(dt: float) -> str:
    """A timebase in words."""
    return "dt = True (unspecified)" if dt is True else f"dt = {dt:g} s" if dt else "continuous"


def as_period(dt: Any) -> float:
    """A sampling time in seconds, positive."""
    if isinstance(dt, int | float) and dt == 0 and not isinstance(dt, bool):
        raise ModelError("dt is 0; pass the sampling time in seconds")
    return as_number("dt", dt, "the sampling time in seconds, positive", above=0)


def as_texts(key: str, names: Any) -> tuple[str, ...]:
    """Texts in a tuple; one text stands for itself."""
    found = (names,) if isinstance(names, str) else names
    if not isinstance(found, tuple | list) or not all(isinstance(n, str) for n in found):
        raise ModelError(f"{key} is {shown(names)}; give a list of names")
    return tuple(found)


def as_names(key: str, names: Any, size: int, told: str = "") -> tuple[str, ...]:
    """`size` different names; key0, key1, ... when there are none. `told` begins the message."""
    found = as_texts(key, names) or tuple(f"{key}{i}" for i in range(size))
    if len(found) != size or len(set(found)) != size:
        raise ModelError(f"{f'{told} {found}' if told else f'{key} is {list(found)}'}; give {size} different names")
    return found


def as_symmetric(name: str, value: Any, size: int) -> np.ndarray:
    """A symmetric weight of any signature; numbers and lists as in `as_weight`."""
    M = as_weight(name, value, size)
    if not np.count_nonzero(M != M.T):
        return M
    skew = np.abs(M - M.T).max(initial=0.0)
    if skew > SYMMETRIC * np.abs(M).max():
        raise ModelError(f"{name} is not symmetric; pass ({name} + {name}')/2, which weighs the same")
    return (M + M.T) / 2


def as_cost(name: str, value: Any, size: int, *, definite: bool = False) -> np.ndarray:
    """A symmetric positive (semi)definite weight of a quadratic cost; numbers and lists as in `as_weight`."""
    M = as_symmetric(name, value, size)
    scale = np.abs(M).max(initial=0.0)
    least = float(f"{np.linalg.eigvalsh(M).min(initial=np.inf):.6g}")
    if least < -SYMMETRIC * size * scale:
        raise ModelError(f"{name} has the eigenvalue {least}; a weight has none below zero: pass {POSITIVE[definite]}")
    if definite and least <= SYMMETRIC * scale:
        raise ModelError(
            f"{name} has the eigenvalue {least}; every command must cost something: pass {POSITIVE[definite]}"
        )
    return M


def as_limits(name: str, value: Any, size: int, free: tuple[float, ...] = (-np.inf, np.inf)) -> np.ndarray:
    """One limit per channel, (size,), a number standing for all; infinite ones in `free` mean no limit."""
    wanted = f"pass a number or {size} of them"
    if isinstance(value, str | bytes):
        raise ModelError(f"{name} is {shown(value)}; {wanted}")
    limits = as_array(name, value, wanted, finite=False)
    if np.asarray(value).dtype.kind not in "iuf" or np.isnan(limits).any() or limits.shape not in ((), (size,)):
        raise ModelError(f"{name} is {shown(value)}; {wanted}")
    if not (np.isfinite(limits) | np.isin(limits, free)).all():
        raise ModelError(f"{name} is {limits}; pass finite numbers" + (f" or {free[0]}" if free else ""))
    return np.array(np.broadcast_to(limits, (size,)))


def as_indices(kind: str, key: Any, names: tuple[str, ...]) -> list[int]:
    """Numbers of the signals that a key means."""
    if isinstance(key, slice):
        return list(range(len(names))[key])
    if isinstance(key, list | tuple | range) or (isinstance(key, np.ndarray) and key.ndim):
        return [i for k in key for i in as_indices(kind, k, names)]
    if isinstance(key, str):
        if key not in names:
            raise ModelError(f"there is no {kind} {key!r}; there are {', '.join(names)}")
        return [names.index(key)]
    i = as_whole(kind, key, f"a name or a number from 0 to {len(names) - 1}", least=-len(names), most=len(names) - 1)
    return [i % len(names)]


def given_names(key: str, names: tuple[str, ...]) -> tuple[str, ...]:
    """Names, or numbers in the place of those that were made up."""
    return tuple(str(i) for i in range(len(names))) if names == as_names(key, (), len(names)) else names


def as_units(units: Any) -> Mapping[str, str]:
    """Names with their units."""
    if not isinstance(units, Mapping) or not all(isinstance(text, str) for pair in units.items() for text in pair):
        raise ModelError(f"units is {shown(units)}; pass names and units, {{'torque': 'N m'}}")
    return units
