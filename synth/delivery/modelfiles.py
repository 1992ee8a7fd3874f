"""Files that hold plants, controllers and designs: read, and checked when read.

A JSON file says in `format` what it is:

    convex-synth design       what `Design.save` writes
    convex-synth controller   what `export` writes of a controller without a plant, with limits and gain of anti-windup
    convex-synth system       A, B, C, D of a plant or a controller, or A, B1, B2, ..., D22 of a generalised plant, or
                              num, den or zeros, poles, gain (as `synth.system` takes them) with `dt`; `delay` in s

A system is  {"format": "convex-synth system", "format_version": 1, "dt": 0.5, "A": [[...], ...], ...}  with matrices
as lists of rows, `dt` in seconds (0 for continuous time), and optionally the names of its signals, "u": [...],
"y": [...] (and "w", "z" of a generalised plant), and "units": {name: unit}. A .mat file has the same matrices as
variables or as fields of a struct, such as those of MATLAB's `ss`; or it is one that `export` wrote.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from synth.checks import as_limits, as_matrix, as_path, shown
from synth.delivery.leaving import check_leaves
from synth.delivery.matfiles import read_mat
from synth.errors import ModelError
from synth.files import SEAL, check_seal, json_of, read_json, write_atomically
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis import design as designs
from synth.synthesis import plantdata
from synth.synthesis.design import Design
from synth.systems.connect import input_delay
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace, as_system

SYSTEM = "convex-synth system"
CONTROLLER = "convex-synth controller"
FORMAT_VERSION = 1  # of a system
CONTROLLER_VERSION = 2
UNSEALED = "read from a file of format version 1, which has no sha256 of all of it"
NINE = tuple(f.name for f in fields(GeneralizedPlant))[:9]  # A, B1, ..., D22
FRACTIONS = (("num", "den"), ("zeros", "poles", "gain"))  # instead of A, B, C, D
LABELS = ("w", "u", "z", "y")
WRITTEN, JSON = ("design", "controller"), "json"  # structs in a .mat file by `export`, and the field with all of it
STRUCT = {**{key: key.upper() for key in "abcde"}, "dt": "dt", "ts": "dt"}  # fields, in any case -> what they are


@dataclass(frozen=True, eq=False)
class Model:
    """A plant or controller with the names of its signals.

    Raises
    ------
    ModelError : the number of names is not that of the signals, or a name is given twice.
    """

    system: StateSpace
    u: tuple[str, ...] = ()  # (m) names of the inputs
    y: tuple[str, ...] = ()  # (p) names of the outputs
    units: dict[str, str] = field(default_factory=dict)  # of the signals that have one
    limited: AntiWindup | None = None  # a controller with the limits and the gain that its file holds
    convention: str = ""  # of a controller, as `synth.synthesis.convention` words it
    warnings: tuple[str, ...] = ()  # what a user must know of the file

    def __post_init__(self):
        for key, size in (("u", self.system.nu), ("y", self.system.ny)):
            names = tuple(getattr(self, key)) or tuple(f"{key}{i}" for i in range(size))
            if len(names) != size or len(set(names)) != size or not all(isinstance(name, str) for name in names):
                raise ModelError(f"{key} is {list(names)}; give {size} different names")
            object.__setattr__(self, key, names)
        if unknown := set(self.units) - {*self.u, *self.y}:
            raise ModelError(f"units are given for {sorted(unknown)}, which are no signals of the system")


def read(path: str | os.PathLike[str]) -> Design | GeneralizedPlant | Model:
    """What is in a ``.json`` or ``.mat`` file; a design is closed and measured again.

    Raises
    ------
    ModelError : the file is missing, no file, of another kind, incomplete or damaged, with what to do about it.
    VerificationError : a design does not do what its file says.
    """
    path = as_path("path", path)
    return _from_mat(path) if path.suffix == ".mat" else _from_data(read_json(path))


def _from_data(data: Any) -> Design | GeneralizedPlant | Model:
    """What a JSON file holds."""
    kind = data.get("format") if isinstance(data, dict) else None
    if kind == designs.FORMAT:
        return designs.from_dict(data)
    if kind not in (SYSTEM, CONTROLLER):
        known = ", ".join(map(repr, (designs.FORMAT, CONTROLLER, SYSTEM)))
        raise ModelError(f"the format is {shown(kind)}; one of {known} can be read here")
    version, last = data.get("format_version"), CONTROLLER_VERSION if kind == CONTROLLER else FORMAT_VERSION
    if isinstance(version, bool) or version not in range(1, last + 1):
        raise ModelError(
            f"format_version is {shown(version)}, this release reads {' and '.join(map(str, range(1, last + 1)))}; "
            "read the file with the release that wrote it"
        )
    return _controller(data) if kind == CONTROLLER else as_model(checked(data))


def checked(data: dict[str, Any]) -> dict[str, Any]:
    """The data of a system or controller as its file has it, if it is as `synth.schemas` says."""
    from synth import mistakes, schemas

    form, _ = _form(data)
    kinds = {"B1": schemas.PlantFile, "num": schemas.PolynomialFile, "zeros": schemas.RootsFile}
    kind = schemas.ControllerFile if data["format"] == CONTROLLER else kinds.get(form, schemas.SystemFile)
    mistakes.check(kind, data, "the system is damaged")
    return data


def _form(data: dict[str, Any]) -> tuple[str, tuple[str, ...]]:
    """What tells the form of a system, "A", "B1", "num" or "zeros", and the keys that it needs, which are there."""
    forms = {keys[0]: keys for keys in FRACTIONS if any(key in data for key in keys)}
    form = "B1" if "B1" in data else next(iter(forms), "A")
    needed = (*(NINE if form == "B1" else forms.get(form, tuple("ABCD"))), "dt")
    if missing := [name for name in needed if name not in data]:
        raise ModelError(f"the system has no {', '.join(missing)}; it needs {', '.join(needed)}")
    return form, needed


def _controller(data: dict[str, Any]) -> Model:
    """A controller as `export` writes it; files of version 1 have no sha256 of all of it."""
    sealed = data.get("format_version") == CONTROLLER_VERSION
    if sealed:
        check_seal(data)
    elif SEAL in data:
        raise ModelError(f"it has format version 1 and a {SEAL}: one of them was changed")
    if "B1" in data:
        raise ModelError("it has the matrices of a generalised plant, which is no controller")
    found = as_model(checked(data))
    assert isinstance(found, Model)
    own = f"sha256 {found.system.digest()}"
    if not data.get("controller", own).endswith(own):  # of a design its order comes first
        raise ModelError("its matrices are not those whose sha256 it tells: one of them was changed")
    return found if sealed else replace(found, warnings=(UNSEALED,))


def as_model(data: dict[str, Any]) -> GeneralizedPlant | Model:
    """A system from plain data: matrices, `dt`, names and units."""
    form, needed = _form(data)
    parts: dict[str, Any] = {name: data[name] for name in needed}
    names: dict[str, Any] = {key: tuple(data[key]) for key in LABELS if key in data}
    units = dict(data.get("units", {}))
    try:
        if form == "B1":
            return plantdata.from_dict({**parts, **names, "units": units, "continuous": data.get("continuous")})
        system = StateSpace(**parts) if form == "A" else as_system("the system", parts)
        if "delay" in data:
            system = input_delay(system, data["delay"])
        ins, outs = ("y", "u") if data.get("format") == CONTROLLER else ("u", "y")  # a controller reads y
        return Model(
            system, names.get(ins, ()), names.get(outs, ()), units, _limited(data, system), data.get("convention", "")
        )
    except MemoryError:
        raise ModelError("the system has more states than there is memory for") from None
    except (TypeError, ValueError) as error:
        raise error if isinstance(error, ModelError) else ModelError(f"the system is damaged: {error}") from None


def _limited(data: dict[str, Any], K: StateSpace) -> AntiWindup | None:
    """The controller with its limits, null where there are none, and its anti-windup gain, if the data has them."""
    if "L" not in data:
        return None
    if missing := [name for name in ("umin", "umax") if not isinstance(data.get(name), list)]:
        raise ModelError(f"the controller has L but no list {', '.join(missing)}; list a limit or null per command")
    L = as_matrix("L", data["L"], (K.n, K.ny)) if K.n else np.zeros((0, K.ny))
    umin, umax = (
        as_limits(name, [free if limit is None else limit for limit in data[name]], K.ny)
        for name, free in (("umin", -np.inf), ("umax", np.inf))
    )
    return AntiWindup(K.A, K.B, K.C, K.D, L, umin, umax, K.dt)


def save_system(path: str | os.PathLike[str], model: Model | StateSpace | GeneralizedPlant) -> Path:
    """Write a system as ``.json``, with every bit of its matrices.

    Raises
    ------
    ModelError : the file name ends otherwise, the model is none, or a controller with limits.
    ExportError : a controller that is no linear system; says what to do instead.
    """
    path = as_path("path", path)
    if path.suffix != ".json":
        raise ModelError(f"path ends with {path.suffix!r}; a system is saved as .json")
    if not isinstance(model, Model | GeneralizedPlant):
        check_leaves(model, "json")
        model = Model(as_system("model", model))
    if isinstance(model, Model) and model.limited:
        raise ModelError("the controller has limits and anti-windup, which no system has; write it with `export`")
    data: dict[str, Any] = {"format": SYSTEM, "format_version": FORMAT_VERSION}
    if isinstance(model, GeneralizedPlant):
        data |= plantdata.to_dict(model)
    else:
        data |= {"dt": model.system.dt} | {name: getattr(model.system, name).tolist() for name in "ABCD"}
        data |= {key: getattr(model, key) for key in ("u", "y", "units")}
    return write_atomically(path, json.dumps(data, indent=1, allow_nan=False).encode())


def _from_mat(path: Path) -> Design | GeneralizedPlant | Model:
    """What `export` wrote, or the variables A, B, C, D (or A, B1, ..., D22) and dt, or a struct with such fields."""
    data = read_mat(path, (*NINE, *"BCD", "dt", *WRITTEN))
    for name in WRITTEN:
        if f"{name}.{JSON}" in data:
            return _written(name, data)
    found: dict[str, Any] = {name: value for name, value in data.items() if name in (*NINE, *"BCD", "dt")}
    if "design" in data:
        raise ModelError(
            "it is a design for MATLAB of an older release; pass the .json file of the design, which holds all of it"
        )
    if not found:
        found = _struct(data)
    for name, value in found.items():
        if value.dtype.kind not in "fiu":
            raise ModelError(f"{name} is no real matrix but {value}; save numbers (full(A) for a sparse A)")
        if value.dtype.kind == "f" and value.dtype != np.float64:
            raise ModelError(f"{name} has single precision, 7 digits; save double({name}) if that is meant")
    if "dt" in found:
        if found["dt"].size != 1:
            raise ModelError(f"dt has {found['dt'].size} entries; save one number")
        dt = float(found["dt"].ravel()[0])
        found["dt"] = True if dt == -1 else dt  # as in MATLAB
    return as_model(found)


def _written(name: str, data: dict[str, np.ndarray]) -> Design | GeneralizedPlant | Model:
    """What `export` wrote: the text of the JSON file in it, if the matrices beside it are still the same."""
    text = data[f"{name}.{JSON}"]
    held = json_of(str(text.ravel()[0]) if text.dtype.kind == "U" and text.size else "")
    parts = {"K": "controller", "P": "plant"} if name == "design" else {"": ""}
    for place, key in parts.items():
        source = held.get(key, {}) if key else held
        for entry in (*NINE, *"BCD"):
            shown_as = f"{name}.{place}.{entry}" if place else f"{name}.{entry}"
            if shown_as not in data or entry not in source:
                continue
            if not np.array_equal(np.asarray(source[entry], float).ravel(), np.ravel(data[shown_as])):
                raise ModelError(
                    f"{shown_as} is not the one in {name}.{JSON}: one of them was changed. Save a controller that you "
                    "changed as A, B, C, D, dt, and have it verified anew"
                )
    return _from_data(held)


def _struct(data: dict[str, np.ndarray]) -> dict[str, Any]:
    """A, B, C, D and dt of the one struct that has fields of these names (a, b, c, d and Ts of MATLAB's `ss` too)."""
    structs: dict[str, dict[str, Any]] = {}
    for name, value in data.items():
        owner, dot, key = name.partition(".")
        if dot and key.lower() in STRUCT:
            structs.setdefault(owner, {})[STRUCT[key.lower()]] = value
    whole = {owner: fields for owner, fields in structs.items() if set("ABCD") <= fields.keys()}
    if len(whole) > 1:
        raise ModelError(f"it has several systems, {', '.join(sorted(whole))}; save one")
    found = next(iter(whole.values()), {})
    E = found.pop("E", np.zeros(0))
    if E.size and not np.array_equal(E, np.eye(len(E))):
        raise ModelError("its system has a descriptor matrix E; save ss(G, 'explicit')")
    return found
