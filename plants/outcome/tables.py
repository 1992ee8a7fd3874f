"""Runs as tables: one row for each sample, columns with names and units in SI.

The columns of a run, in this order:

    time_s
    q0 ... q3, w_x_rad_s ..., wheel_0_rad_s ...     the states of a body; those of other plants are state.FIELD.INDEX
    output_0 ..., estimate_0 ..., reference_0 ...   (ny,) each
    command_0 ..., input_0 ...                      as issued, and as it acted on the plant
    extra.FIELD.INDEX ...                           what `record` returned
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from plants.errors import ScenarioError, StoreError
from plants.files import write_atomically
from plants.simulation import blocks
from plants.simulation.versions import of_packages

if TYPE_CHECKING:
    from plants.simulation.loop import Run

STATES = {  # of bodies: field -> names of its columns ("{}" is the index), unit
    "q": (("q0", "q1", "q2", "q3"), "1"),
    "w": (("w_x_rad_s", "w_y_rad_s", "w_z_rad_s"), "rad/s"),
    "wheels": (("wheel_{}_rad_s",), "rad/s"),
    "phase": (("wheel_{}_phase_rad",), "rad"),
    "gimbals": (("gimbal_{}_rad",), "rad"),
    "angles": (("roll_rad", "pitch_rad", "yaw_rad"), "rad"),
    "position": (("position_x_m", "position_y_m", "position_z_m"), "m"),
    "velocity": (("velocity_x_m_s", "velocity_y_m_s", "velocity_z_m_s"), "m/s"),
    "spent": (("spent_x_m_s", "spent_y_m_s", "spent_z_m_s"), "m/s"),
}
BODIES = ({"q", "w"}, {"angles", "w"}, {"position", "velocity"})  # fields of states whose units are known
METADATA = b"convex_synth"  # key of what is told of the whole run


def run_table(run: Run) -> pa.Table:
    """A run as an Arrow table, (N,) rows; a failed run has the rows before its failure.

    The unit of a column, where it is known, is in the metadata of its field under ``unit``; what holds for the whole
    run (planned duration, failure, versions) is JSON in the metadata of the schema under ``convex_synth``.

    Raises
    ------
    ScenarioError
        Something that is no real number, or not one row for each sample, in the states or in `extra`; its name is told.
    """
    fields, columns = [], []
    for name, unit, values in _columns(run):
        fields.append(pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"unit": unit} if unit else None))
        columns.append(pa.array(values))
    names = [field.name for field in fields]
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise ScenarioError(f"two columns would be called {twice[0]!r}: give one of them in extra another name")
    told = {
        "duration_s": float(run.duration),
        "ok": bool(run.ok),
        "failed_at_s": None if run.failed_at is None else float(run.failed_at),
        "culprit": run.culprit,
        "compiled": bool(run.compiled),
        "versions": of_packages(),
    }
    return pa.table(columns, pa.schema(fields, {METADATA: json.dumps(told).encode()}))


def write_parquet(run: Run, path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write `run_table` as Parquet, whole or not at all; it is read back bit for bit.

    Parameters
    ----------
    run : to write
    path : of the file
    force : replace a file that exists

    Raises
    ------
    StoreError
        The file exists and `force` is not set, or it cannot be written.
    ScenarioError
        As `run_table`.
    """
    target = _target(path, force)
    sink = pa.BufferOutputStream()
    pq.write_table(run_table(run), sink, use_dictionary=False)  # a dictionary would take all NaN for one
    return _write(target, sink.getvalue().to_pybytes())


def write_csv(run: Run, path: str | os.PathLike[str], *, force: bool = False) -> Path:
    """Write `run_table` as CSV: a line of names, then 17 digits, which a reader turns into the same doubles.

    Parameters, errors: as `write_parquet`. Truth values are 0 and 1.
    """
    target, table = _target(path, force), run_table(run)
    form = ",".join("%.17g" if pa.types.is_floating(field.type) else "%d" for field in table.schema)
    rows = zip(*(column.to_pylist() for column in table.columns), strict=True)
    lines = [",".join(map(_quoted, table.column_names)), *(form % row for row in rows)]
    return _write(target, ("\n".join(lines) + "\n").encode())


def _columns(run: Run) -> Iterator[tuple[str, str, np.ndarray]]:
    """Name, unit ("" if unknown) and values (N,) of every column."""
    n = len(run.time)
    yield "time_s", "s", _numbers("time", run.time, n)
    known = any(body <= set(getattr(run.states, "_fields", ())) for body in BODIES)
    for path, leaf in _leaves(run.states):
        values = _numbers(f"states.{path}", leaf, n)
        names, unit = STATES.get(path, ((), "")) if known else ((), "")
        if values.ndim == 2 and names and (len(names) == 1 or len(names) == values.shape[1]):
            names = [names[0].format(i) for i in range(values.shape[1])] if len(names) == 1 else names
            yield from ((name, unit, column) for name, column in zip(names, values.T, strict=True))
        else:
            yield from _spread(f"state.{path}".rstrip("."), values)
    for name in ("output", "estimate", "reference", "command", "input"):
        values = _numbers(f"{name}s", getattr(run, f"{name}s"), n)
        yield from ((f"{name}_{i}", "", column) for i, column in enumerate(values.T))
    for path, leaf in _leaves(run.extra):
        yield from _spread(f"extra.{path}".rstrip("."), _numbers(f"extra.{path}".rstrip("."), leaf, n))


def _leaves(tree: Any) -> list[tuple[str, Any]]:
    """The arrays in a tree and their dotted names."""
    blocks.register(tree)
    found = jax.tree_util.tree_flatten_with_path(tree)[0]
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in found]


def _spread(name: str, values: np.ndarray) -> Iterator[tuple[str, str, np.ndarray]]:
    """The columns of an array (N, ...)."""
    for index in np.ndindex(values.shape[1:]):
        yield ".".join([name, *map(str, index)]), "", values[(slice(None), *index)]


def _numbers(name: str, leaf: Any, rows: int) -> np.ndarray:
    """The array (N, ...) in the machine's byte order; ScenarioError if Arrow could not hold it."""
    values = np.asarray(leaf)
    if values.dtype.kind not in "biuf" or values.dtype.itemsize > 8:
        raise ScenarioError(f"{name} is of type {values.dtype}: a table takes real numbers, record it as such")
    if values.ndim < 1 or len(values) != rows:
        raise ScenarioError(f"{name} has shape {values.shape}: a table takes one row for each of the {rows} samples")
    return values.astype(values.dtype.newbyteorder("="))


def _quoted(name: str) -> str:
    """A name as CSV has it."""
    return '"' + name.replace('"', '""') + '"' if any(c in name for c in ',"\n\r') else name


def _target(path: str | os.PathLike[str], force: bool) -> Path:
    """The path, checked before anything is made."""
    if not isinstance(path, str | os.PathLike):
        raise ScenarioError(f"path = {path!r}: give the name of a file")
    if not isinstance(force, bool):
        raise ScenarioError(f"force = {force!r}: give True or False")
    target = Path(path)
    if target.is_dir():
        raise StoreError(f"{target} is a folder: give the name of a file in it")
    if target.exists() and not force:
        raise StoreError(f"{target} exists; pass force=True to replace it, or give another name")
    return target


def _write(target: Path, content: bytes) -> Path:
    try:
        return write_atomically(target, content)
    except OSError as error:
        raise StoreError(f"{target}: cannot be written ({error.strerror or error}); give another folder") from error
