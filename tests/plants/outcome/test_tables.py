"""A run as a table is the run: bit for bit in Parquet, double for double in CSV, and nothing is half written."""

from __future__ import annotations

import csv
import dataclasses
import json
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq
import pytest
from attitude_runs import Recorded, attitude_run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from plants.errors import ScenarioError, StoreError
from plants.outcome.tables import run_table

KINDS = ("<f8", ">f8", "<f4", "<f2", "<i8", "<i4", "<u8", "<u1", "?")


class Deep(NamedTuple):
    first: np.ndarray
    inner: dict


@st.composite
def extras(draw):
    """Anything that may be recorded, of n samples."""
    n = draw(st.integers(0, 5))
    shape = st.lists(st.integers(0, 3), max_size=2).map(lambda more: (n, *more))

    def leaf():
        return draw(arrays.arrays(np.dtype(draw(st.sampled_from(KINDS))), shape))

    return n, Deep(leaf(), {"a": leaf(), "b": (leaf(), None)})


def same(a, b):
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(extras())
def test_parquet_is_read_back_bit_for_bit_and_csv_to_the_same_doubles(tmp_path, drawn):
    n, extra = drawn
    run = attitude_run(n, extra=extra)
    table = pq.read_table(run.to_parquet(tmp_path / "run.parquet", force=True))
    with open(run.to_csv(tmp_path / "run.csv", force=True), newline="") as file:
        names, *rows = list(csv.reader(file))
    assert names == table.column_names
    leaves = {"extra.first": extra.first, "extra.inner.a": extra.inner["a"], "extra.inner.b.0": extra.inner["b"][0]}
    flat = {
        ".".join([name, *map(str, index)]): leaf[(slice(None), *index)]
        for name, leaf in leaves.items()
        for index in np.ndindex(leaf.shape[1:])
    }
    assert [name for name in names if name.startswith("extra.")] == list(flat)
    wanted = flat | {"time_s": run.time, "q3": run.states.q[:, 3], "wheel_2_rad_s": run.states.wheels[:, 2]}
    for name, values in wanted.items():
        native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
        assert same(table[name].to_numpy(), native) or native.dtype == np.float16
        text = [row[names.index(name)] for row in rows]
        read = np.array([int(x) if native.dtype.kind in "iub" else float(x) for x in text], native.dtype)
        assert len(rows) == n
        np.testing.assert_array_equal(read, native)


def test_columns_have_names_units_and_what_holds_for_the_run():
    run = attitude_run(5, ok=False, failed_at=2.5, culprit="plant", extra=Recorded(np.arange(5), np.ones((5, 6))))
    table = run_table(run)
    assert table.num_rows == 5
    assert table.column_names[:11] == [
        "time_s", "q0", "q1", "q2", "q3", "w_x_rad_s", "w_y_rad_s", "w_z_rad_s", "wheel_0_rad_s", "wheel_1_rad_s",
        "wheel_2_rad_s",
    ]  # fmt: skip
    for name in ("output_5", "estimate_0", "reference_3", "command_2", "input_1", "extra.mode", "extra.error.5"):
        assert name in table.column_names
    assert table.schema.field("w_x_rad_s").metadata == {b"unit": b"rad/s"}
    told = json.loads(table.schema.metadata[b"convex_synth"])
    assert (told["ok"], told["failed_at_s"], told["culprit"], told["duration_s"]) == (False, 2.5, "plant", 2.5)
    assert told["versions"]["numpy"] == np.__version__


def test_states_of_other_plants_have_generic_names():
    class Tank(NamedTuple):
        q: np.ndarray  # a flow, not a quaternion
        level: np.ndarray

    names = run_table(attitude_run(3, states=Tank(np.ones(3), np.ones((3, 2))))).column_names
    assert names[1:4] == ["state.q", "state.level.0", "state.level.1"]
    assert run_table(attitude_run(3, states=np.ones((3, 2)))).column_names[1:3] == ["state.0", "state.1"]


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"name": np.array(["a", "b", "c"])}, r"extra\.name is of type <U1: a table takes real numbers"),
        ({"z": {"w": np.ones(3, complex)}}, r"extra\.z\.w is of type complex128"),
        ({"o": np.array([None, 1, 2])}, r"extra\.o is of type object"),
        ({"when": np.zeros(3, "datetime64[s]")}, r"extra\.when is of type datetime64"),
        ({"x": np.ones(2)}, r"extra\.x has shape \(2,\): a table takes one row for each of the 3 samples"),
        ({"x": 1.0}, r"extra\.x has shape \(\)"),
        ({"a": {"b": np.ones(3)}, "a.b": np.ones(3)}, r"two columns would be called 'extra\.a\.b'"),
    ],
)
@pytest.mark.parametrize("write", ["to_csv", "to_parquet"])
def test_what_is_no_table_is_refused_by_name(tmp_path, extra, message, write):
    with pytest.raises(ScenarioError, match=message):
        getattr(attitude_run(3, extra=extra), write)(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("write", ["to_csv", "to_parquet"])
def test_files_are_replaced_when_asked_for_only_and_never_by_halves(tmp_path, write, monkeypatch):
    run, path = attitude_run(3), tmp_path / "run"
    assert getattr(run, write)(str(path)) == path
    before = path.read_bytes()
    other = dataclasses.replace(run, time=run.time + 1)
    with pytest.raises(StoreError, match=r"exists; pass force=True"):
        getattr(other, write)(path)
    assert path.read_bytes() == before

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(StoreError, match=r"cannot be written \(No space left"):
            getattr(other, write)(path, force=True)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    getattr(other, write)(path, force=True)
    assert path.read_bytes() != before


@pytest.mark.parametrize("write", ["to_csv", "to_parquet"])
def test_wrong_paths_are_refused(tmp_path, write):
    save = getattr(attitude_run(3), write)
    with pytest.raises(StoreError, match="is a folder"):
        save(tmp_path)
    with pytest.raises(StoreError, match="cannot be written"):
        save(tmp_path / "missing" / "run")
    with pytest.raises(ScenarioError, match="give the name of a file"):
        save(7)
    with pytest.raises(ScenarioError, match="force = 1"):
        save(tmp_path / "run", force=1)
