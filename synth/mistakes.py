"""A table of a file against what it may hold: all that is wrong is found at once, each with its place.

Rows of numbers tell their first mistake. pydantic looks; it is imported with this module, by readers when they read.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from synth.checks import shown
from synth.errors import MOST, ModelError


class Record(BaseModel):
    """A table with these fields and no others; nothing is converted, and numbers are finite."""

    model_config = ConfigDict(
        strict=True, extra="forbid", allow_inf_nan=False, protected_namespaces=(), defer_build=True
    )


class Mistake(NamedTuple):
    """One value that a file may not hold."""

    place: str  # such as plant.A[1][0]
    key: str  # of the table, at the beginning of the place
    kind: str  # "missing", "unknown" or what is wrong
    wanted: str  # what belongs there; of an unknown key the one that was meant
    value: Any

    def __str__(self) -> str:
        if self.kind == "missing":
            return f"{self.place}: missing{self.wanted and f'; {self.wanted}'}"
        if self.kind == "unknown":
            return f"{self.place}: unknown{self.wanted}"
        return f"{self.place} is {shown(self.value)}; {self.wanted} belongs there"


WANTED: dict[str, str] = {
    "float_type": "a number", "int_type": "a whole number", "int_from_float": "a whole number",
    "string_type": "text", "bool_type": "true or false", "list_type": "a list", "dict_type": "a table",
    "model_type": "a table", "model_attributes_type": "a table", "finite_number": "a finite number",
}  # fmt: skip


def mistakes(kind: type[Record], data: Any, path: str = "") -> list[Mistake]:
    """All that is wrong with a table of a file; `path` is where it stands."""
    try:
        kind.model_validate(data)
    except ValidationError as error:
        found = error.errors(include_url=False)
    else:
        return []
    return [_mistake(kind, entry, path) for entry in found]


def check(kind: type[Record], data: Any, what: str) -> None:
    """Raise ModelError with all that is wrong, of very much the beginning, on one line; `what` begins it."""
    if found := mistakes(kind, data):
        more = f"; and {len(found) - MOST} more mistakes" if len(found) > MOST else ""
        raise ModelError(f"{what}: {'; '.join(map(str, found[:MOST]))}{more}")


def _mistake(kind: type[Record], entry: Mapping[str, Any], path: str) -> Mistake:
    """An error of the validator in our words."""
    keys = [key for key in entry["loc"] if not (isinstance(key, str) and key.startswith("<") and key.endswith(">"))]
    place = path
    for key in keys:
        place = f"{place}[{key}]" if isinstance(key, int) else f"{place}.{key}" if place else str(key)
    what, limits, value = entry["type"], entry.get("ctx", {}), entry["input"]
    first = str(keys[0]) if keys else ""
    if what == "missing":
        return Mistake(place, first, what, _described(kind, keys), None)
    if what == "extra_forbidden":
        return Mistake(place, first, "unknown", hint(str(keys[-1]), _known(kind, keys[:-1])), value)
    for name, words in (("gt", "above"), ("ge", "at least"), ("le", "at most")):
        if name in limits:
            return Mistake(place, first, f"{words} {limits[name]:g}", f"a number {words} {limits[name]:g}", value)
    if "<word>" in entry["loc"]:
        return Mistake(place, first, what, "a number", value)
    if what == "literal_error":
        return Mistake(place, first, what, f"one of {limits['expected']}".replace("'", ""), value)
    return Mistake(place, first, what, WANTED.get(what, str(entry["msg"]).lower()), value)


def hint(word: str, known: Iterator[str] | list[str]) -> str:
    """The known word that was meant, perhaps."""
    near = difflib.get_close_matches(word, list(known), 1, cutoff=0.5)
    return f"; did you mean {near[0]!r}?" if near else ""


def _described(kind: type[Record], keys: list[Any]) -> str:
    """What a field of the table itself says of itself."""
    return (kind.model_fields[keys[0]].description or "") if len(keys) == 1 and keys[0] in kind.model_fields else ""


def _known(kind: type[Record], keys: list[Any]) -> list[str]:
    """Names of the fields at a place."""
    kinds: list[Any] = [kind]
    for key in keys:
        inner = [k.model_fields[key] for k in kinds if key in k.model_fields]
        kinds = [k for field in inner for k in _records((field.annotation, *field.metadata))] or kinds
    return [name for k in kinds for name in k.model_fields]


def _records(annotation: Any) -> Iterator[type[Record]]:
    """The tables that a value may be."""
    if isinstance(annotation, type) and issubclass(annotation, Record):
        yield annotation
    for inner in annotation if isinstance(annotation, tuple) else get_args(annotation):
        yield from _records(inner)
