"""Tables of a study file: what is wrong with each is collected with its path, so that all is told at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from synth.checks import shown
from synth.mistakes import Mistake, Record, hint, mistakes


class Table:
    """One table that was looked at by its schema; values that are wrong are None, as if they were missing."""

    def __init__(self, data: Any, path: str, problems: list[str], kind: type[Record] | None = None):
        self.path, self.problems = path, problems
        self.data: dict[str, Any] = data if isinstance(data, dict) else {}
        found = mistakes(kind, data, path) if kind else []
        problems += map(_told, found)
        self.bad = {mistake.key for mistake in found}

    def at(self, key: str) -> str:
        """The path of a key."""
        return f"{self.path}.{key}" if self.path else key

    def wrong(self, key: str, message: str) -> None:
        """Note a mistake."""
        self.problems.append(f"{self.at(key)}: {message}")

    def get(self, key: str, default: Any = None) -> Any:
        """The value, or the default if it is missing or wrong."""
        return default if key in self.bad else self.data.get(key, default)

    def given(self, *keys: str) -> dict[str, Any]:
        """The values of those keys that are there and sound."""
        return {key: self.data[key] for key in keys if key in self.data and key not in self.bad}

    def vector(self, key: str, size: int | None) -> Any:
        """A number or `size` of them; None if it is missing or wrong."""
        value = self.get(key)
        if isinstance(value, list) and size is not None and len(value) != size:
            self.wrong(key, f"expected {size} numbers, found {len(value)}")
            return None
        if value is not None and np.isnan(value).any():
            self.wrong(key, "nan is no limit")
            return None
        return value

    def matrix(self, key: str, shape: tuple[int | None, int | None] = (None, None)) -> Any:
        """A matrix as rows, {diag = [...]}, or a number times the identity; None if it is wrong or missing.

        None in the shape accepts any size.
        """
        value = self.get(key)
        if value is None:
            if key not in self.bad:
                self.wrong(key, "missing" + (f"; expected shape {_shape(shape)}" if shape != (None, None) else ""))
            return None
        if isinstance(value, dict):
            M = np.diag(np.atleast_1d(np.asarray(value["diag"], float)))
        elif isinstance(value, list) and value:
            for i, row in enumerate(value):
                if len(row) != len(value[0]):
                    self.wrong(f"{key}[{i}]", f"{len(row)} entries where row 0 has {len(value[0])}")
            if any(len(row) != len(value[0]) for row in value):
                return None
            M = np.array(value, float)
        elif not isinstance(value, list) and (shape[0] == shape[1] or None in shape):
            M = np.diag(np.full(next((s for s in shape if s is not None), 1), float(value)))
        else:
            self.wrong(key, f"expected a matrix as a list of rows, found {_kind(value)}")
            return None
        if any(want is not None and have != want for have, want in zip(M.shape, shape, strict=True)):
            self.wrong(key, f"expected shape {_shape(shape)}, found {_shape(M.shape)}")
            return None
        return M


def _told(mistake: Mistake) -> str:
    """A mistake in the words of a study."""
    if mistake.kind in ("missing", "unknown"):
        return str(mistake)
    if mistake.kind == "finite_number":
        what = f"{mistake.value} is not finite"
    elif mistake.kind == "literal_error":
        choices = mistake.wanted.removeprefix("one of ").replace(" or ", ", ").split(", ")
        what = f"{shown(mistake.value)} is not {mistake.wanted.replace(' or ', ', ')}"
        what += hint(mistake.value, choices) if isinstance(mistake.value, str) else ""
    elif mistake.kind.startswith(("above", "at least", "at most")):
        what = f"{mistake.value} is not {mistake.kind}"
    else:
        what = f"expected {mistake.wanted}, found {_kind(mistake.value)}"
    return f"{mistake.place}: {what}"


def _kind(value: Any) -> str:
    kinds = {bool: "true or false", str: "text", list: "a list", dict: "a table", int: "a number", float: "a number"}
    name = kinds.get(type(value), type(value).__name__)
    return f"{name} ({shown(value)})" if isinstance(value, str | bool | int | float) else name


def _shape(shape: Iterable[int | None]) -> str:
    return " x ".join("any" if size is None else str(size) for size in shape)
