"""The plant of a study: matrices, polynomials, zeros and poles, a file beside it, or the model of a spacecraft."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from synth.checks import as_array, shown
from synth.command import door, studyschemas
from synth.command.tables import Table
from synth.delivery.modelfiles import FRACTIONS, NINE, Model, read
from synth.errors import ModelError, SynthError
from synth.files import is_device
from synth.mistakes import Record
from synth.synthesis.design import Design
from synth.systems.connect import input_delay
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system


def read_plant(table: Table, folder: Path) -> tuple[GeneralizedPlant | StateSpace | None, dict[str, Any]]:
    """The plant, sampled if that is asked for, and the names and units of its signals."""
    about: dict[str, Any] = {key: tuple(table.get(key, ())) for key in ("u", "y")}
    about["units"] = dict(table.get("units", {}))
    sample, hold = table.get("sample"), table.get("hold", "zoh")
    before = len(table.problems)
    try:
        other = next((form for key, form in ELSEWHERE.items() if key in table.data), None)
        plant = other(table, folder, about) if other else _from_matrices(table)
        delay = table.data.get("delay", 0.0)
        if sample is not None and plant is not None:
            plant = _sampled(plant, sample, hold, delay)
        elif "delay" in table.data and plant is not None:
            if isinstance(plant, GeneralizedPlant):
                raise ModelError(
                    "delay is for inputs u alone, or for a continuous generalised plant with `sample`; put it into A, "
                    "B1, ... of a discrete one"
                )
            plant = input_delay(plant, delay)
    except SynthError as error:
        if len(table.problems) == before:
            table.problems.append(f"{table.path}: {error}")
        plant = None
    if isinstance(plant, StateSpace):
        for key, size in (("u", plant.nu), ("y", plant.ny)):
            if about[key] and len({*about[key]}) != size:
                table.wrong(key, f"expected {size} different names, found {len({*about[key]})}")
                about[key] = ()
    return plant, about


def plant_kind(data: dict[str, Any]) -> type[Record]:
    """What a table of a plant holds, by the keys that it has."""
    if "spacecraft" in data:
        return studyschemas.SpacecraftPlant
    if "file" in data:
        return studyschemas.FilePlant
    if any(key in data for keys in FRACTIONS for key in keys):
        return studyschemas.FractionPlant
    nine = any(name in data for name in NINE[1:])
    return studyschemas.GeneralizedPlant if nine else studyschemas.MatrixPlant


def _sampled(plant: GeneralizedPlant | StateSpace, dt: float, hold: str, delay: Any) -> GeneralizedPlant | StateSpace:
    """The discrete plant, whose inputs u act `delay` s later."""
    if isinstance(plant, StateSpace):
        return c2d(plant, dt, hold, delay=delay)
    if hold != "zoh":
        raise ModelError("hold is 'tustin'; a generalised plant is sampled with 'zoh'")
    _, nw, m, *_ = plant.sizes
    late = as_array("delay", delay, f"pass a time in s that is not negative, or {m} of them")
    if late.shape not in ((), (m,)):
        raise ModelError(f"delay is {shown(delay)}; pass a time in s that is not negative, or {m} of them")
    return c2d(plant, dt, delay=np.concatenate([np.zeros(nw), np.broadcast_to(late, m)]))


def _from_file(table: Table, folder: Path, about: dict[str, Any]) -> GeneralizedPlant | StateSpace | None:
    """The plant in a file beside the study."""
    name = table.get("file")
    if name is None:
        return None
    if trouble := _stray(name):
        table.wrong("file", f"{name}: {trouble}")
        return None
    try:
        found = read(folder / name)
    except SynthError as error:
        table.wrong("file", f"{name}: {error}")
        return None
    if isinstance(found, Design):
        found = found.plant
    if isinstance(found, Model):
        for key in ("u", "y", "units"):
            about[key] = about[key] or getattr(found, key)
        return found.system
    return found


def _from_spacecraft(table: Table, folder: Path, about: dict[str, Any]) -> StateSpace | None:
    """The linear plant of the spacecraft in a file beside the study."""
    name = table.get("spacecraft")
    if name is None:
        return None
    if trouble := _stray(name):
        table.wrong("spacecraft", f"{name}: {trouble}")
        return None
    try:
        about["craft"] = door.read(folder / name)
        plant = about["craft"].plant()
    except ModelError as error:
        table.wrong("spacecraft", str(error))
        return None
    about |= {key: getattr(plant, key) for key in ("u", "y", "units")}
    return replace(plant, u=(), y=(), units={})


def _stray(name: str) -> str:
    """What is wrong with where a file is said to be; empty if nothing is."""
    path = Path(name)
    if any(is_device(part) for part in path.parts):
        return "Windows takes this name for a device; give the file another"
    if not path.is_absolute() and (path.drive or os.path.normpath(name).startswith(os.pardir)):
        return "it is outside the folder of the study; put the file beside the study, or write its whole path"
    return ""


ELSEWHERE = {"spacecraft": _from_spacecraft, "file": _from_file}  # key of a plant that is in another file


def _from_matrices(table: Table) -> GeneralizedPlant | StateSpace | None:
    """The plant from its matrices; shapes follow A and D, or A, D11 and D22."""
    dt = table.get("dt")
    if given := fraction(table):
        return None if dt is None else as_system(table.path, given | {"dt": dt})
    nine = any(name in table.data for name in NINE[1:])
    names = NINE if nine else tuple("ABCD")
    rows: dict[str, Any] = {}
    n = len(table.data["A"]) if isinstance(table.data.get("A"), list) else None
    for name in ("A", *(("D11", "D22") if nine else ())):
        rows[name] = table.matrix(name, (n, n) if name == "A" else (None, None))
    rest = [name for name in names if name not in rows]
    for name in rest:
        rows[name] = table.matrix(name, _expected(name, rows, n))
    if dt is None or any(M is None for M in rows.values()):
        return None
    return GeneralizedPlant(**rows, dt=dt) if nine else StateSpace(**rows, dt=dt)


def fraction(table: Table) -> dict[str, Any]:
    """Polynomials, or zeros, poles and gain, if the table has them."""
    return table.given(*(key for keys in FRACTIONS for key in keys))


def _expected(name: str, rows: dict[str, Any], n: int | None) -> tuple[int | None, int | None]:
    """The shape of a matrix of the plant, as far as others have told it."""

    def size(key: str, axis: int) -> int | None:
        return None if rows.get(key) is None else rows[key].shape[axis]

    shapes = {
        "B": (n, None), "C": (None, n), "D": (size("C", 0), size("B", 1)),
        "B1": (n, size("D11", 1)), "B2": (n, size("D22", 1)), "C1": (size("D11", 0), n), "C2": (size("D22", 0), n),
        "D12": (size("D11", 0), size("D22", 1)), "D21": (size("D22", 0), size("D11", 1)),
    }  # fmt: skip
    return shapes[name]
