"""TOML tables as the arguments of functions: units in the names, and all mistakes at once, each with its path.

A table is handed to the function of its kind. A key is one of its arguments, or an argument with a unit behind it,
such as `period` or `boresight_noise_arcsec`; which units fit is said for every argument.
"""

import datetime as dates
import difflib
import inspect
import re
import stat
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from plants.errors import ScenarioError
from plants.hardware.instruments import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H

LARGEST = 2**16  # bytes of a file
DEEPEST = 20  # parts of a key, levels of lists
MOST = 100  # rows of a list of tables
TOLD = 40  # mistakes
LONGEST = 60  # characters of a value in a message

Units = Mapping[str, float]  # behind an argument -> what one of it is in SI
ANGLE: Units = {"_deg": np.pi / 180, "_arcsec": ARCSEC}
RATE: Units = {"_deg_per_s": np.pi / 180, "_deg_per_h": DEG_PER_H}
SPIN: Units = {"_rpm": np.pi / 30}
SWING: Units = {"_Hz": 2 * np.pi}
ANGLE_WALK: Units = {"_deg_per_sqrt_h": DEG_PER_SQRT_H}
RATE_WALK: Units = {"_deg_per_h_per_sqrt_h": DEG_PER_H / 60}
LENGTH: Units = {"_km": 1e3, "_cm": 1e-2, "_mm": 1e-3}
FIELD: Units = {"_nT": 1e-9}
TORQUE: Units = {"_mNm": 1e-3}
MOMENTUM: Units = {"_mNms": 1e-3}
FORCE: Units = {"_mN": 1e-3}
PER_CENT: Units = {"_percent": 1e-2}
KINDS: dict[type, str] = {
    bool: "true or false", str: 'text, such as "A 6U CubeSat"', int: "a whole number",
    dates.datetime: "a date with a time, such as 2026-03-20T00:00:00",
}  # fmt: skip


class Kind(NamedTuple):
    """What a table is made into, and what its arguments are besides numbers and lists of numbers in SI."""

    make: Callable[..., Any]
    about: Mapping[str, Units | type] = {}
    single: bool = False  # numbers alone, no lists


class Refused:
    """What stands in the place of a part that could not be made."""


REFUSED = Refused()


def keys_of(kind: Kind) -> dict[str, tuple[str, float | None]]:
    """What a table of the kind may hold: key -> the argument that it means, and what one of it is in SI."""
    known = list(inspect.signature(kind.make).parameters)
    units = {name: about for name in known if isinstance(about := kind.about.get(name), Mapping)}
    behind = {name + unit: (name, size) for name, about in units.items() for unit, size in about.items()}
    plain: dict[str, tuple[str, float | None]] = {name: (name, None) for name in known}
    return plain | {key: meant for key, meant in behind.items() if key not in plain}


def read_toml(file: Path) -> dict[str, Any]:
    """The tables of a file.

    Raises
    ------
    ScenarioError
        It is missing, no file, larger than 64 KiB, or no TOML.
    """
    try:
        if not stat.S_ISREG(file.stat().st_mode):
            raise ScenarioError(f"{file}: this is a folder, a device or a pipe; pass a file")
        with file.open("rb") as stream:
            raw = stream.read(LARGEST + 1)
        if len(raw) > LARGEST:
            raise ScenarioError(f"{file}: larger than {LARGEST >> 10} KiB, which no spacecraft needs")
        text = raw.decode()
        parts = (part for part in re.split(r"[=,{}\[\]\n]", text) if not part.lstrip().startswith("#"))
        if any(len(re.findall(r"\.\s*[\w\"'-]", part)) > DEEPEST for part in parts):
            raise ScenarioError(f"{file}: a key has more than {DEEPEST} parts")
        return tomllib.loads(text)
    except OSError as error:
        raise ScenarioError(f"{file}: {(error.strerror or str(error)).lower()}") from error
    except RecursionError as error:
        raise ScenarioError(f"{file}: this is no TOML: it is nested too deep") from error
    except ValueError as error:
        if isinstance(error, ScenarioError):
            raise
        raise ScenarioError(f"{file}: this is no TOML: {error}") from error


class Tables:
    """What is read of a file, and what is wrong with it."""

    def __init__(self, data: dict[str, Any]):
        self.data, self.problems = data, list[str]()

    def check_keys(self, known: Sequence[str]) -> None:
        """Note the keys of the file that mean nothing, and drop them."""
        for key in [key for key in self.data if key not in known]:
            self.problems.append(f"{_key(key)}: there is no such field; {_near(key, known)}")
            del self.data[key]

    def rows(self, name: str, owner: str) -> list[Any]:
        """The tables of a list."""
        given = self.data.get(name, [])
        if isinstance(given, list) and all(isinstance(row, dict) for row in given):
            if len(given) <= MOST:
                return given
            self.problems.append(f"{name}: {len(given)} tables, where {MOST} are the most")
        else:
            self.problems.append(f"{name}: give a table for each {owner}, below a line [[{name}]]")
        return []

    def chosen(self, table: Any, path: str, kinds: Mapping[str, Kind]) -> Any:
        """What a table with a `kind` describes."""
        if not isinstance(table, dict):
            return self._refuse(f"{path}: give a table, below a line [{path}]")
        kind = table.get("kind")
        if not isinstance(kind, str) or kind not in kinds:
            said = f"{path}.kind = {_shown(kind)}" if "kind" in table else f"{path}.kind: missing"
            return self._refuse(f"{said}; {_near(str(kind), list(kinds))}")
        return self.made({key: value for key, value in table.items() if key != "kind"}, path, kinds[kind])

    def made(self, table: Any, path: str, kind: Kind, **ready: Any) -> Any:
        """kind.make(**table) in SI units, with what is `ready` beside it; REFUSED if something is wrong."""
        if not isinstance(table, dict):
            return self._refuse(f"{path}: give a table, below a line [{path}]")
        fields = inspect.signature(kind.make).parameters
        names = {key: meant for key, meant in keys_of(kind).items() if meant[0] not in ready}
        known = [name for name in fields if name not in ready]
        before, dot = len(self.problems), f"{path}." if path else ""
        arguments: dict[str, Any] = {}
        keys: dict[str, str] = {}  # argument -> what the file calls it
        for key, value in table.items():
            name, scale = names.get(key, (None, None))
            if name is None:
                self.problems.append(f"{dot}{_key(key)}: there is no such field; {_near(key, list(names), known)}")
            elif name in arguments:
                self.problems.append(f"{dot}{key}: {keys[name]} says the same; give one of them")
            else:
                about = kind.about.get(name, {})
                wrong = _unlike(value, about, scale, name, kind.single)
                if wrong:
                    self.problems.append(f"{dot}{key} = {_shown(value)}: {wrong}")
                keys[name] = key
                arguments[name] = REFUSED if wrong else _scaled(value, scale)
        empty = inspect.Parameter.empty
        meant = {names[near[0]][0] for key in table if key not in names if (near := _close(key, list(names)))}
        missing = [n for n in known if fields[n].default is empty and n not in arguments and n not in meant]
        for name in missing:
            about = kind.about.get(name, {})
            units = ", ".join(name + unit for unit in about) if isinstance(about, Mapping) else ""
            self.problems.append(f"{dot}{name}: missing{f'; give it in SI units, or {units}' if units else ''}")
        if len(self.problems) > before:
            return REFUSED
        told = {name: f"{dot}{key} = {_shown(table[key])}" for name, key in keys.items()}
        return self._called(kind.make, arguments | ready, path, told)

    def _called(self, make: Callable[..., Any], arguments: dict[str, Any], path: str, told: dict[str, str]) -> Any:
        """make(**arguments), of which the file says what is `told`; what it refuses is noted."""
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                return make(**arguments)
        except ScenarioError as error:
            first = re.match(r"\w+", str(error))
            place = told.get(first[0], path) if first else path
            return self._refuse(f"{place}: {error}" if place else str(error))
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            said = f"{path}: " if path else ""
            return self._refuse(
                f"{said}numbers too far apart or too large to compute with ({error}); check their units"
            )

    def _refuse(self, problem: str) -> Refused:
        self.problems.append(problem)
        return REFUSED

    def told(self, file: Path) -> str:
        """All mistakes, of very many the first."""
        count = len(self.problems)
        head = f"{file}:" if count == 1 else f"{file} is wrong in {count} places:"
        more = [f"and {count - TOLD} more"] if count > TOLD else []
        return "\n  ".join([head, *self.problems[:TOLD], *more])


def _unlike(value: Any, about: Units | type, scale: float | None, name: str, single: bool) -> str:
    """What is wrong with a value before it is handed on; empty if nothing is."""
    if isinstance(about, type):
        right = isinstance(value, about) and (about is bool or not isinstance(value, bool))
        return "" if right else f"give {KINDS[about]}"
    if single and isinstance(value, list):
        return "give one number"
    if trouble := _no_numbers(value):
        return trouble
    if about is ANGLE and scale is None and np.abs(np.asarray(value, float)).max(initial=0) > 2 * np.pi:
        return f"that many rad are more than a turn; for degrees write {name}_deg"
    return ""


def _no_numbers(value: Any, depth: int = 0) -> str:
    """Why a value is no number, list or matrix of numbers; empty if it is one."""
    if isinstance(value, list):
        if depth == 2:
            return "give a number, a list, or a list of rows"
        if trouble := next(filter(None, (_no_numbers(item, depth + 1) for item in value)), ""):
            return trouble
        if len({len(item) if isinstance(item, list) else -1 for item in value}) > 1:
            return "its rows are of different lengths"
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "give a number, or a list of them"
    return "no double holds such a number" if isinstance(value, int) and value.bit_length() > 1023 else ""


def _scaled(value: Any, scale: float | None) -> Any:
    """The value in SI."""
    return value if scale is None else (np.asarray(value, float) * scale).tolist()


def _near(word: str, known: Sequence[str], listed: Sequence[str] | None = None) -> str:
    """The word that was meant, or those that there are."""
    near = _close(word, known)
    return f"did you mean {near[0]!r}?" if near else f"there is {', '.join(known if listed is None else listed)}"


def _close(word: str, known: Sequence[str]) -> list[str]:
    """The known word that is nearest, if one is near."""
    return difflib.get_close_matches(word[:LONGEST], known, 1)


def _key(key: str) -> str:
    """A key for a message."""
    return key if re.fullmatch(r"[\w-]{1,60}", key, re.ASCII) else _shown(key)


def _shown(value: Any) -> str:
    """A value for a message: short, and nothing that would steer a terminal."""
    text = ascii(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
