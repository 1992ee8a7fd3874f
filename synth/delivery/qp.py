"""A model predictive controller as data: the quadratic program that it solves in every step, as JSON or .mat.

    minimise v'P v/2 + f'v   subject to   lower <= [v; A v] <= upper,   [f; upper] = offset + slope phi

phi stacks the parameters of the step in the order of `parameters`; the first m entries of v times `unit` are the
command. Limits that are not there are missing (null) in JSON and infinite in .mat.
"""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import scipy.io

from synth.errors import ModelError
from synth.files import provenance, write_atomically
from synth.predictive.horizon import Mpc

FREE = 1e20  # a limit beyond this is none


def save_mpc(controller: Mpc, path: str | os.PathLike[str]) -> Path:
    """Write the controller's settings and its canonical program to a ``.json`` or ``.mat`` file.

    Raises
    ------
    ModelError : the file name ends otherwise.
    """
    path = Path(path)
    content = document(controller)
    if path.suffix == ".json":
        return write_atomically(path, json.dumps(jsonable(content), indent=1, allow_nan=False).encode())
    if path.suffix == ".mat":
        buffer = io.BytesIO()
        scipy.io.savemat(buffer, {"mpc": content}, oned_as="column", long_field_names=True)
        return write_atomically(path, buffer.getvalue())
    raise ModelError(f"path ends with {path.suffix!r}; a predictive controller is saved as .json or .mat")


def document(controller: Mpc) -> dict[str, Any]:
    """Settings, program and provenance as arrays, numbers and texts."""
    p, qp = controller.problem, controller.qp
    versions, date = provenance("cvxpy", "daqp")
    settings = {name: getattr(p, name) for name in ("Q", "R", "terminal", "umin", "umax", "ymin", "ymax", "hmax")}
    settings |= {name: float(getattr(p, name)) for name in ("Np", "Nc", "delay", "penalty")}
    return {
        "format": "convex-synth mpc",
        "format_version": 1.0,
        "form": p.form,
        "dt": float(controller.dt),
        "model": {name: getattr(p.model, name) for name in "ABCD"},
        "model_sha256": p.model.digest(),
        "settings": settings,
        "unit": p.unit,
        "parameters": {name: np.array([s.start, s.stop], dtype=float) for name, s in p.parameters.items()},
        "qp": {name: getattr(qp, name) for name in ("P", "A", "lower", "offset", "slope")},
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items()),
        "date": date,
    }


def jsonable(value: Any) -> Any:
    """Arrays as lists, absent limits as None."""
    if isinstance(value, dict):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return [jsonable(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if abs(value) < FREE else None
    return value
