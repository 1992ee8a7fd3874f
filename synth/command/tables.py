"""Reading tables of a TOML file: every mistake is collected with its path, so that all are told at once."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

import numpy as np

from synth.checks import shown


class Table:
    """One table; its functions read a key and note what is wrong with it, `close` notes keys that nobody read."""

    def __init__(self, data: Any, path: str, problems: list[str]):
        self.path, self.problems = path, problems
        self.keys: list[str] = []
        self.data: dict[str, Any] = data if isinstance(data, dict) else {}
        if not isinstance(data, dict):
            problems.append(f"{path}: expected a table, found {_kind(data)}")

    def at(self, key: str) -> str:
        """The path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def wrong(self, key: str, message: str) -> None:
        """Note a mistake."""
        self.problems.append(f"{self.at(key)}: {message}")

    def has(self, key: str) -> bool:
        """Whether the key is there; it counts as read."""
        self.keys.append(key)
        return key in self.data

    def table(self, key: str, *, needed: bool = False) -> Table:
        """A table inside; an empty one if it is missing."""
        if needed and not self.has(key):
            self.wrong(key, "missing")
        self.keys.append(key)
        return Table(self.data.get(key, {}), self.at(key), self.problems)

    def text(self, key: str, choices: Iterable[str] = (), default: str | None = None) -> str | None:
        """A string, one of the choices if there are some."""
        if not self.has(key):
            return default
        value, choices = self.data[key], tuple(choices)
        if not isinstance(value, str):
            self.wrong(key, f"expected text, found {_kind(value)}")
        elif choices and value not in choices:
            self.wrong(key, f"{shown(value)} is not one of {', '.join(choices)}{_hint(value, choices)}")
        else:
            return value
        return default

    def boolean(self, key: str) -> bool:
        """True or false; false if it is missing."""
        if self.has(key) and not isinstance(self.data[key], bool):
            self.wrong(key, f"expected true or false, found {_kind(self.data[key])}")
        return self.data.get(key) is True

    def number(self, key: str, *, least: float | None = None, above: float | None = None) -> float | None:
        """A finite number within its bounds; None if it is missing."""
        if not self.has(key):
            return None
        value = self.data[key]
        if not _is_number(value):
            self.wrong(key, f"expected a number, found {_kind(value)}")
        elif not np.isfinite(value):
            self.wrong(key, f"{value} is not finite")
        elif (least is not None and value < least) or (above is not None and value <= above):
            self.wrong(
                key, f"{value} is not {'above' if least is None else 'at least'} {above if least is None else least:g}"
            )
        else:
            return float(value)
        return None

    def names(self, key: str) -> tuple[str, ...]:
        """A list of texts; empty if it is missing."""
        if not self.has(key):
            return ()
        value = self.data[key]
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.wrong(key, "expected a list of names")
            return ()
        return tuple(value)

    def vector(self, key: str, size: int | None = None) -> list[float] | float | None:
        """A number or a list of them (infinite ones pass); None if it is missing."""
        if not self.has(key):
            return None
        value = self.data[key]
        items = value if isinstance(value, list) else [value]
        for i, item in enumerate(items):
            if not _is_number(item) or np.isnan(item):
                self.wrong(f"{key}[{i}]" if value is items else key, f"expected a number, found {_kind(item)}")
                return None
        if isinstance(value, list) and size is not None and len(value) != size:
            self.wrong(key, f"expected {size} numbers, found {len(value)}")
            return None
        return value

    def matrix(self, key: str, shape: tuple[int | None, int | None] = (None, None), *, needed: bool = True) -> Any:
        """A matrix as rows, {diag = [...]}, or a number times the identity; None if it is wrong or missing.

        None in the shape accepts any size.
        """
        if not self.has(key):
            if needed:
                self.wrong(key, "missing" + (f"; expected shape {_shape(shape)}" if shape != (None, None) else ""))
            return None
        value = self.data[key]
        if isinstance(value, dict):
            inside = self.table(key)
            diagonal = inside.vector("diag") if inside.has("diag") else inside.wrong("diag", "missing")
            inside.close()
            if diagonal is None:
                return None
            M = np.diag(np.atleast_1d(np.asarray(diagonal, float)))
        elif _is_number(value) and (shape[0] == shape[1] or None in shape):
            size = next((s for s in shape if s is not None), 1)
            M = np.diag(np.full(size, float(value)))
        else:
            M = self._rows(key, value)
        if M is None:
            return None
        if not np.isfinite(M).all():
            i, j = np.argwhere(~np.isfinite(M))[0]
            self.wrong(f"{key}[{i}][{j}]", f"{M[i, j]} is not finite")
            return None
        if any(want is not None and have != want for have, want in zip(M.shape, shape, strict=True)):
            self.wrong(key, f"expected shape {_shape(shape)}, found {_shape(M.shape)}")
            return None
        return M

    def _rows(self, key: str, value: Any) -> np.ndarray | None:
        """A list of rows of like length."""
        if not isinstance(value, list) or not value or not all(isinstance(row, list) for row in value):
            self.wrong(key, f"expected a matrix as a list of rows, found {_kind(value)}")
            return None
        before = len(self.problems)
        for i, row in enumerate(value):
            if len(row) != len(value[0]):
                self.wrong(f"{key}[{i}]", f"{len(row)} entries where row 0 has {len(value[0])}")
            for j, entry in enumerate(row):
                if not _is_number(entry):
                    self.wrong(f"{key}[{i}][{j}]", f"expected a number, found {_kind(entry)}")
        return np.array(value, float) if len(self.problems) == before else None

    def close(self) -> None:
        """Note the keys that nobody asked for."""
        for key in self.data:
            if key not in self.keys:
                self.wrong(key, f"unknown{_hint(key, self.keys)}")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _kind(value: Any) -> str:
    kinds = {bool: "true or false", str: "text", list: "a list", dict: "a table", int: "a number", float: "a number"}
    name = kinds.get(type(value), type(value).__name__)
    return f"{name} ({shown(value)})" if isinstance(value, str | bool | int | float) else name


def _shape(shape: Iterable[int | None]) -> str:
    return " x ".join("any" if size is None else str(size) for size in shape)


def _hint(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), 1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""
