"""How a design came about, as a record and as what a file holds of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

SAMPLED = "sampled-data"  # the method of a design whose norm is that between the samples too


@dataclass(frozen=True)
class Info:
    """How a design came about, and what the judge measured."""

    method: str  # the route that answered: "lmi", "riccati", "standard", "extended", "sampled-data"
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


def to_dict(info: Info) -> dict[str, Any]:
    """As plain data; a number that JSON has no word for is in Python's words: a loop without poles decays with inf."""
    return {
        key: repr(value) if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in (asdict(info) | {"warnings": list(info.warnings)}).items()
    }


def from_dict(data: Mapping[str, Any]) -> Info:
    """The inverse of `to_dict`, of what `synth.schemas.Info` has seen."""
    numbers = {f.name for f in fields(Info) if str(f.type).startswith("float")}
    found: dict[str, Any] = {k: float(v) if k in numbers and isinstance(v, str) else v for k, v in data.items()}
    found["warnings"] = tuple(found.get("warnings", ()))
    return Info(**found)
