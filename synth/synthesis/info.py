"""How a design came about, as a record and as what a file holds of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from synth.checks import shown
from synth.errors import ModelError


@dataclass(frozen=True)
class Info:
    """How a design came about, and what the judge measured."""

    method: str  # the route that answered: "lmi", "riccati", "standard", "extended"
    status: str  # the solver's own word, which is no proof
    level: float  # the level the controller was designed for
    optimum: float | None  # what the solver claims to be possible, which is no proof; None when it was not looked for
    spectral_radius: float  # of the closed loop (continuous: largest real part, rad/s)
    slowest: float  # rad/s, decay of the slowest pole of the closed loop
    frequency: float  # rad/s, peak of the closed loop's largest singular value
    seconds: float  # wall time from call to verified design
    solver: str  # what solved the problem
    tolerance: float  # relative, of that solver
    failures: Mapping[str, str]  # routes and back-offs that were tried before, with their reasons
    versions: Mapping[str, str]  # packages that took part
    date: str  # ISO 8601, UTC
    warnings: tuple[str, ...] = ()  # what a user must know
    shift: float = 0.0  # rad/s, of the stability boundary (mixed sensitivity)
    shifted_norm: float | None = None  # verified norm of the shifted problem, to which the optimum then belongs


SIGNED = ("spectral_radius", "slowest")  # the other numbers are not negative
OPTIONAL = ("optimum", "shifted_norm")


def to_dict(info: Info) -> dict[str, Any]:
    """As plain data; a number that JSON has no word for is in Python's words: a loop without poles decays with inf."""
    return {
        key: repr(value) if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in asdict(info).items()
    }


def from_dict(data: Any) -> Info:
    """The inverse of `to_dict`; raises ModelError for what no design says of itself."""
    if not isinstance(data, dict):
        raise ModelError(f"info is {shown(data)}; a design has a table there")
    kinds = {f.name: str(f.type) for f in fields(Info)}
    if unknown := sorted(data.keys() - kinds.keys()):
        raise ModelError(f"info has {', '.join(map(shown, unknown))}, which this release does not know")
    return Info(**{key: _field(key, kinds[key], value) for key, value in data.items()})


def _field(key: str, kind: str, value: Any) -> Any:
    if kind == "str" and isinstance(value, str):
        return value
    if kind.startswith("Mapping") and isinstance(value, dict) and all(isinstance(v, str) for v in value.values()):
        return value
    if kind.startswith("tuple") and isinstance(value, list | tuple) and all(isinstance(v, str) for v in value):
        return tuple(value)
    if kind.startswith("float"):
        number = float(value) if isinstance(value, str) and value in ("inf", "-inf", "nan") else value
        if number is None and key in OPTIONAL:
            return None
        if isinstance(number, int | float) and not isinstance(number, bool) and (key in SIGNED or not number < 0):
            return number
    raise ModelError(f"info.{key} is {shown(value)}, which no design has")
