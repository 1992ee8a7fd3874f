"""What measure returns comes back from the disk as it was: every number, every shape, every bit."""

import copy
import functools
import itertools
import json
import subprocess

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from processes import started
from scipy.interpolate import CubicSpline

import synth
from plants.errors import StoreError
from plants.simulation import identity, records
from plants.simulation.batch import Batch
from plants.simulation.columns import array, column, together
from plants.simulation.store import Store

KINDS = ("f8", "f4", "f2", "i8", "i4", "i2", "i1", "u8", "u4", "u2", "u1", "?", "c16", "c8")
SHAPES = hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=3)
WHAT = {"study": "s", "runs": 1000, "seed": 0, "hashes": {"measure": "a"}}


def bits(values):
    return np.ascontiguousarray(values).tobytes()


def batch(results, first=0, errors=None):
    count = len(next(iter(results.values())))
    return Batch(
        index=np.arange(first, first + count),
        ok=np.ones(count, bool),
        failed_at=np.full(count, np.nan),
        culprit=np.full(count, ""),
        results=results,
        applied=None,
        varied=frozenset(),
        kept={},
        errors=errors or {},
    )


@settings(deadline=None, max_examples=100)
@given(st.data(), st.sampled_from(KINDS), st.integers(1, 4), SHAPES)
def test_arrays_are_columns_and_back_bit_for_bit(data, kind, count, shape):
    values = data.draw(hnp.arrays(kind, (count, *shape)))
    missing = np.array(data.draw(st.lists(st.booleans(), min_size=count, max_size=count)))
    for mask in (None, missing):
        field, made = column("x", values, mask)
        back = array(pa.chunked_array([made]), field)
        assert back.shape == values.shape
        there = np.ones(count, bool) if mask is None else ~missing
        if there.all():
            assert back.dtype == values.dtype
            assert bits(back) == bits(values)
        else:
            np.testing.assert_array_equal(back[there], values[there].astype(back.dtype))
            assert np.isnan(back[~there]).all()


@settings(deadline=None, max_examples=50)
@given(st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0")), min_size=1, max_size=5))
def test_texts_too(texts):
    for values in (np.array(texts), np.array([texts, texts])):
        field, made = column("x", values)
        assert array(pa.chunked_array([made]), field).tolist() == values.tolist()


def test_nan_keeps_its_bits_and_zero_its_sign(tmp_path):
    odd = [0x7FF8000000000001, 0xFFF8000000000003, 0x7FF0000000000001, 0x8000000000000000, 0, 0x7FF0000000000000]
    values = np.array(odd, np.uint64).view(float)
    with Store.writing(tmp_path, WHAT, resume=False) as store:
        records.write(store, batch({"x": values}, errors={6: "went wrong"}), {"d": np.zeros(7)})
        table = store.table()
        assert bits(records.read(store, table, batch({"x": values})).results["x"]) == bits(values)


@pytest.mark.parametrize("values", [np.array([{}]), np.array(["\ud800"]), np.array([1, "a"], object)])
def test_what_is_neither_number_nor_text_is_refused_by_name(values):
    with pytest.raises(StoreError, match=r"results\.x of type .* cannot be stored"):
        column("results.x", values)


@settings(deadline=None, max_examples=50)
@given(st.data(), st.sampled_from(KINDS[:-2]), st.sampled_from(KINDS[:-2]), st.sampled_from([(), (2,), (2, 0), (2, 3)]))
def test_chunks_of_other_types_are_what_numpy_makes_of_them(data, one, other, shape):
    chunks_fit(data.draw(hnp.arrays(one, (2, *shape))), data.draw(hnp.arrays(other, (3, *shape))))


@pytest.mark.parametrize("shape", [(), (2,), (2, 0)])
def test_chunks_of_any_two_types_of_numbers_fit(shape):
    for one, other in itertools.permutations(KINDS[:-2], 2):
        chunks_fit(np.ones((2, *shape), one), np.zeros((3, *shape), other))


def chunks_fit(a, b):
    tables = []
    for values in (a, b):
        field, made = column("x", values)
        tables.append(pa.table([made], pa.schema([field])))
    table = together(tables, "here")
    back, wanted = array(table.column("x"), table.schema.field("x")), np.concatenate([a, b])
    assert back.dtype == wanted.dtype
    np.testing.assert_array_equal(back, wanted)


def test_chunks_that_do_not_fit_are_refused():
    fields = [column("x", values) for values in (np.zeros(2), np.array(["a"]), np.zeros((2, 3)))]
    tables = [pa.table([made], pa.schema([field])) for field, made in fields]
    for pair in ((0, 1), (0, 2), (1, 2)):
        with pytest.raises(StoreError, match="here: chunks do not fit together"):
            together([tables[i] for i in pair], "here")


def test_two_columns_of_one_name_are_refused():
    with pytest.raises(StoreError, match="no dots in names"):
        records.leaves({"a.b": 1.0, "a": {"b": 2.0}}, "results")


@pytest.mark.parametrize("name", ["with spaces", "with ünïcödé 漢", "with [brackets]*?", "a/b/c"])
def test_a_store_may_stand_anywhere(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    with Store.writing(name, WHAT, resume=False) as store:
        monkeypatch.chdir("/")
        records.write(store, batch({"x": np.arange(3)}), {"d": np.zeros(3)})
    (tmp_path / "link").symlink_to(tmp_path / name)
    assert Store(tmp_path / "link").index.tolist() == [0, 1, 2]
    with Store.writing(tmp_path / "link", WHAT, resume=True) as store:
        records.write(store, batch({"x": np.arange(3)}, 3), {"d": np.zeros(6)})
    assert Store(tmp_path / name).index.tolist() == [0, 1, 2, 3, 4, 5]


def test_tampering_is_seen(tmp_path):
    """Five hundred changes of manifest, chunks and trajectories: none is read."""
    rng = np.random.default_rng(1)
    with Store.writing(tmp_path, WHAT, resume=False) as store:
        for first in (0, 8, 16):
            records.write(store, batch({"x": rng.normal(size=(8, 2))}, first), {"d": rng.normal(size=24)})
        for index in (3, 4):
            store.write_run(index, {"time": np.arange(5.0)}, {"ok": True})
    before = Store(tmp_path).columns()
    accepted = 0
    for _ in range(500):
        files = [*tmp_path.glob("manifest.json"), *tmp_path.glob("chunks/*.parquet"), *tmp_path.glob("runs/*.parquet")]
        path = files[rng.integers(len(files))]
        content = bytearray(whole := path.read_bytes())
        at, kind = int(rng.integers(len(content))), rng.integers(4)
        if kind == 0:
            content[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            del content[at:]
        elif kind == 2:
            content[at:at] = bytes([int(rng.integers(256))])
        else:
            content += bytes(1 + int(rng.integers(9)))
        path.write_bytes(content)
        try:
            store = Store(tmp_path)
            if path.parent.name == "runs":
                store.trajectory(int(path.name[:9]))
                accepted += 1
            else:
                now = store.columns()  # blanks between the entries of a manifest say nothing
                told = json.loads(whole) if path.suffix == ".json" else None
                accepted += told != store.manifest or any(bits(now[name]) != bits(before[name]) for name in before)
        except StoreError:
            pass
        path.write_bytes(whole)
    assert accepted == 0


def test_a_trajectory_under_the_name_of_another_is_refused(tmp_path):
    with Store.writing(tmp_path, WHAT, resume=False) as store:
        store.write_run(3, {"time": np.arange(5.0)}, {})
    path = next(tmp_path.glob("runs/*"))
    path.rename(path.with_name(path.name.replace("000000003", "000000004")))
    (tmp_path / "runs" / "notes.parquet").write_text("no run")
    with pytest.raises(StoreError, match="trajectory of another run"):
        Store(tmp_path).trajectory(4)
    assert Store(tmp_path).kept == [4]


def test_a_manifest_of_another_store_reads_no_chunk(tmp_path):
    for name, seed in (("a", 1), ("b", 2)):
        with Store.writing(tmp_path / name, WHAT | {"seed": seed}, resume=False) as store:
            records.write(store, batch({"x": np.zeros(2)}), {"d": np.zeros(2)})
    (tmp_path / "a" / "manifest.json").write_bytes((tmp_path / "b" / "manifest.json").read_bytes())
    with pytest.raises(StoreError, match="belongs to another store"):
        Store(tmp_path / "a").table()


def test_digests_know_what_a_function_is_made_of():
    def made(constant=1.0, enclosed=2.0, default=3.0):
        text = f"def measure(run, given={default}): return {constant} * run + enclosed + given"
        space = {}
        exec(f"def outer(enclosed):\n    {text}\n    return measure", space)
        return space["outer"](enclosed)

    functions = [
        made(),
        made(constant=1.0000000000000002),
        made(enclosed=2.5),
        made(enclosed=np.nextafter(2.0, 3)),
        made(default=3.5),
        functools.partial(made(), given=1),
        functools.partial(made(), given=2),
        functools.partial(made(), 1),
        lambda run: run in {"a", "b"},
        lambda run: run in {"a", "c"},
    ]
    found = [identity.digest(function) for function in functions]
    assert len(set(found)) == len(found)
    assert identity.digest(made()) == found[0]


class Slotted:
    __slots__ = ("inside",)

    def __init__(self, inside):
        self.inside = inside


def test_digests_know_what_objects_hold():
    pairs = [
        (Slotted(1.0), Slotted(2.0)),
        (CubicSpline([0, 1, 2], [0, 1, 4]), CubicSpline([0, 1, 2], [0, 1, 5])),
        ([1.0].count, [2.0].count),
        (0.0, -0.0),
        (1, True),
        ([1], (1,)),
    ]
    for one, other in pairs:
        assert identity.digest(one) != identity.digest(other)
        assert identity.digest(copy.deepcopy(one)) == identity.digest(one)


@pytest.mark.slow
class Solver:
    """A controller's part that remembers what it has done, and is pickled without it."""

    def __init__(self, gain):
        self.gain, self.memory = gain, []

    def __reduce__(self):
        return Solver, (self.gain,)


class Lazy:
    """Its square is worked out when it is asked for."""

    def __init__(self, gain):
        self.gain = gain

    @functools.cached_property
    def square(self):
        return self.gain**2


def test_digests_do_not_know_what_a_flight_leaves_behind():
    """--resume refused a study whose MPC had met its last resort: the solver's memory was part of the controller."""
    used, lazy = Solver(2.0), Lazy(2.0)
    before = identity.digest(used), identity.digest(lazy)
    used.memory.append(1.0)
    assert lazy.square == 4.0
    assert (identity.digest(used), identity.digest(lazy)) == before
    assert identity.digest(Solver(3.0)) != before[0]
    assert identity.digest(Lazy(3.0)) != before[1]


def test_an_mpc_is_the_same_after_its_last_resort():
    mpc = synth.mpc(synth.StateSpace([[1, 1], [0, 1]], [[0], [1]], np.eye(2), 0, dt=1.0),
                    Np=5, Nc=3, Q=1.0, R=1.0, umin=-1.0, umax=1.0)  # fmt: skip
    before = identity.digest(mpc)
    mpc.step(mpc.init(), np.ones(2), np.zeros(2))
    mpc.qp.exact(np.zeros(mpc.qp.slope.shape[1]))
    assert identity.digest(mpc) == before


def test_digests_are_the_same_in_every_process():
    text = (
        "from dispersed import *; import functools; from plants.simulation import identity;"
        "print(identity.digest([case, last, read, lambda run: run in {'a', 'b', 'c'}, {'x', 'y', 'z'}, Damper(1.0)]))"
    )
    found = set()
    for seed in ("1", "2"):
        with started("-c", text, stdout=subprocess.PIPE, text=True, surroundings={"PYTHONHASHSEED": seed}) as process:
            found.add(process.communicate()[0])
    assert len(found) == 1
    assert len(found.pop().strip()) == 64
