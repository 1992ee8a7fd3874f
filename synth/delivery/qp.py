"""A model predictive controller as data: the quadratic program that it solves in every step, as JSON or .mat.

    minimise v'P v/2 + f'v   subject to   lower <= [v; A v] <= upper,   [f; upper] = offset + slope phi

phi stacks the parameters of the step in the order of `parameters`; the first m entries of v times `unit` are the
command. Limits that are not there are missing (null) in JSON and infinite in .mat. The JSON file has a sha256 of all
of it, and `load_mpc` reads it back as the arrays of `document`.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.io

from synth.checks import as_path
from synth.errors import ModelError
from synth.files import PARTS, SEAL, check_seal, provenance, read_json, sealed_by_parts, write_atomically
from synth.synthesis import convention
from synth.systems.statespace import StateSpace

if TYPE_CHECKING:
    from synth.predictive.horizon import Mpc

FORMAT = "convex-synth mpc"
FORMAT_VERSION = 2
LOWEST = ("umin", "ymin", "lower")  # limits that are -inf where there is none
FREE = 1e20  # a limit beyond this is none


def save_mpc(controller: Mpc, path: str | os.PathLike[str]) -> Path:
    """Write the controller's settings and its canonical program to a ``.json`` or ``.mat`` file.

    Raises
    ------
    ModelError : the file name ends otherwise.
    """
    path = as_path("path", path)
    if path.suffix == ".json":
        return write_atomically(path, json_bytes(controller))
    if path.suffix == ".mat":
        return write_atomically(path, mat_bytes(controller))
    raise ModelError(f"path ends with {path.suffix!r}; a predictive controller is saved as .json or .mat")


def json_bytes(controller: Mpc) -> bytes:
    """The content of the .json file, with a sha256 of all of it."""
    return json.dumps(sealed_by_parts(jsonable(document(controller))), indent=1, allow_nan=False).encode()


def mat_bytes(controller: Mpc) -> bytes:
    """The content of the .mat file, one struct ``mpc``."""
    from synth.delivery.matlab import cell

    buffer, content = io.BytesIO(), document(controller)
    units = [content["units"].get(name, "") for name in (*content["y"], *content["u"])]
    content |= {"y": cell(content["y"]), "u": cell(content["u"]), "units": cell(units)}
    scipy.io.savemat(buffer, {"mpc": content}, oned_as="column", long_field_names=True)
    return buffer.getvalue()


def load_mpc(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Settings, model and program in a ``.json`` file of `save_mpc`, as `document` has them.

    Raises
    ------
    ModelError : the file is none, is incomplete, or was changed since it was written; the fields are named.
    """
    path = as_path("path", path)
    try:
        return from_dict(read_json(path))
    except ModelError as error:
        raise ModelError(f"path {path.name!r}: {error}; pass what save_mpc wrote") from None


def from_dict(data: Any) -> dict[str, Any]:
    """The inverse of `jsonable` for such a file, checked."""
    from synth import mistakes, schemas

    version = data.get("format_version") if isinstance(data, dict) and data.get("format") == FORMAT else None
    if isinstance(version, bool) or version not in (1, FORMAT_VERSION):
        raise ModelError(f"the data is no {FORMAT} of format version 1 or {FORMAT_VERSION}")
    if version == FORMAT_VERSION:
        check_seal(data)
    mistakes.check(schemas.SealedMpcFile if version == FORMAT_VERSION else schemas.MpcFile, data, "it is damaged")
    found = {key: value for key, value in data.items() if key not in (SEAL, PARTS)}
    try:
        model = StateSpace(**data["model"], dt=data["dt"])
        arrays = {key: _arrays(found[key]) for key in ("settings", "model", "unit", "parameters", "qp")}
    except ValueError as error:  # rows of different length
        raise ModelError(f"it is damaged: {error}") from None
    if model.digest() != data["model_sha256"]:
        raise ModelError("model_sha256 does not belong to the model in the file: one of them was changed")
    return found | arrays


def restored(found: Mapping[str, Any]) -> Mpc:
    """The controller of what `load_mpc` found: posed anew from its model and its settings, which say all of it.

    Raises
    ------
    ModelError : the settings are none of `mpc`.
    """
    from synth.predictive.horizon import mpc

    settings = {key: int(v) if key in ("Np", "Nc", "delay") else v for key, v in found["settings"].items()}
    names = {key: found[key] for key in ("u", "y", "units") if key in found}
    return mpc(StateSpace(**found["model"], dt=found["dt"], **names), form=found["form"], **settings)


def _arrays(value: Any, key: str = "") -> Any:
    """Lists as arrays, None as no limit."""
    if isinstance(value, dict):
        return {name: _arrays(item, name) for name, item in value.items()}
    if isinstance(value, list):
        free = -np.inf if key in LOWEST else np.inf
        return np.array([free if item is None else item for item in value], dtype=float)
    return value


def document(controller: Mpc) -> dict[str, Any]:
    """Settings, program and provenance as arrays, numbers and texts."""
    p, qp = controller.problem, controller.qp
    versions, date = provenance("cvxpy", "daqp")
    settings = {name: getattr(p, name) for name in ("Q", "R", "terminal", "umin", "umax", "ymin", "ymax", "hmax")}
    settings |= {name: float(getattr(p, name)) for name in ("Np", "Nc", "delay", "penalty")}
    return {
        "format": FORMAT,
        "format_version": float(FORMAT_VERSION),
        "form": p.form,
        **conventions(controller),
        "y": list(p.model.y),
        "u": list(p.model.u),
        "units": dict(p.model.units),
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


def conventions(controller: Mpc) -> dict[str, str]:
    """What the controller reads, when, and within which limits: the same words in every format."""
    p = controller.problem
    states, momentum = np.isfinite([*p.ymin, *p.ymax]).any(), np.isfinite(p.hmax).any()
    return {
        "convention": convention.PREDICTIVE,
        "sampling": convention.sampling(float(controller.dt), p.delay),
        "limits": convention.planned_limits(bool(states), bool(momentum)),
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
