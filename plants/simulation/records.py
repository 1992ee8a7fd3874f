"""Batches and trajectories as the columns of a store, and back, bit for bit."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pyarrow as pa

from plants.errors import StoreError
from plants.simulation.batch import ARRAYS, Batch
from plants.simulation.columns import array
from plants.simulation.loop import Run
from plants.simulation.store import Store

EXCEPTION = "exception"  # culprit of a run that ended in one, in a store
NEAR = 1e-9  # relative; what another processor may make of a flight


def leaves(tree: Any, root: str) -> dict[str, Any]:
    """Leaves by a name such as "results.outcome.angle"."""
    named = jax.tree_util.tree_flatten_with_path(tree)[0]
    found = {".".join([root, *(str(_key(entry)) for entry in path)]): leaf for path, leaf in named}
    if len(found) < len(named):
        raise StoreError(f"two columns of {root} would be of one name ({', '.join(found)}): no dots in names of fields")
    return found


def write(store: Store, batch: Batch, dispersed: Any) -> None:
    """Add a batch to a store: a row for each run, those with an exception have no results.

    Raises
    ------
    StoreError
        It cannot be written.
    """
    for index, run in batch.kept.items():
        write_run(store, index, run)
    failed = np.array([*batch.errors], int)
    index = np.concatenate([batch.index, failed])
    if not len(index):
        return
    count = len(failed)
    given = {
        "index": index,
        "ok": np.append(batch.ok, np.zeros(count, bool)),
        "failed_at": np.append(batch.failed_at, np.full(count, np.nan)),
        "culprit": np.array([*batch.culprit, *[EXCEPTION] * count], str),
        "error": np.array([*[""] * len(batch.index), *map(_plain, batch.errors.values())], str),
    } | {name: np.asarray(leaf)[index] for name, leaf in leaves(dispersed, "dispersed").items()}
    measured = {**leaves(batch.results, "results"), **leaves(batch.applied, "applied")}
    for name, values in measured.items():
        given[name] = np.concatenate([values, np.zeros((count, *values.shape[1:]), values.dtype)])
    store.write(given, missing=dict.fromkeys(measured, np.arange(len(index)) >= len(batch.index)))


def read(store: Store, table: pa.Table, like: Batch) -> Batch:
    """The rows of a store's table, in the form of a batch; the trajectories stay where they are.

    Raises
    ------
    StoreError
        `like` is of another form, or an exception.
    """
    if like.errors:
        index, text = next(iter(like.errors.items()))
        raise StoreError(
            f"store {store.folder}: run {index} ends in an exception now, which it did not; give another folder\n{text}"
        )
    sound = table.filter(_without_error(table))
    columns = {name: array(sound.column(name), sound.schema.field(name)) for name in sound.column_names}

    def tree(form: Any, root: str) -> Any:
        try:
            return jax.tree.unflatten(jax.tree.structure(form), [columns[name] for name in leaves(form, root)])
        except KeyError as missing:
            raise StoreError(
                f"store {store.folder}: has no column {missing}: measure or read returns another form now"
            ) from missing

    return Batch(
        index=columns["index"],
        ok=columns["ok"],
        failed_at=columns["failed_at"],
        culprit=columns["culprit"],
        results=tree(like.results, "results"),
        applied=None if like.applied is None else tree(like.applied, "applied"),
        varied=like.varied,
        kept={},
        errors=errors(table),
    )


def errors(table: pa.Table) -> dict[int, str]:
    """Tracebacks of the stored runs that ended in an exception, by index."""
    told = table.select(["index", "error"]).to_pydict()
    return {index: text for index, text in zip(told["index"], told["error"], strict=True) if text}


def first_sound(table: pa.Table) -> int | None:
    """Index of the first stored run that did not end in an exception."""
    index = table.filter(_without_error(table)).column("index")
    return index[0].as_py() if len(index) else None


def check_again(store: Store, stored: Batch, again: Batch) -> None:
    """Raise StoreError where a stored run comes out otherwise when it is flown again.

    A hash tells whether `case` and `measure` have changed, not whether what they call has.
    """
    index = int(again.index[0])
    row = int(np.flatnonzero(stored.index == index)[0])
    fields = ("ok", "failed_at", "culprit", "results", "applied")
    for field in fields:
        now = leaves(getattr(again, field), field)
        for name, value in leaves(getattr(stored, field), field).items():
            if not _same(value[row], now[name][0]):
                raise StoreError(
                    f"store {store.folder}: run {index} comes out otherwise now ({name} = {value[row]} then, "
                    f"{now[name][0]} now): what case or measure call was changed; give another folder"
                )


def write_run(store: Store, index: int, run: Run) -> None:
    """Keep one trajectory; StoreError as for `write`."""
    columns = {}
    for name in ARRAYS:
        columns |= {each: np.asarray(leaf) for each, leaf in leaves(getattr(run, name), name).items()}
    memory = [np.asarray(leaf) for leaf in jax.tree.leaves(run.memory)]
    numbers = all(leaf.dtype.kind in "fiub" for leaf in memory)
    about = {name: getattr(run, name) for name in ("duration", "ok", "failed_at", "culprit", "compiled")}
    about["memory"] = [[leaf.dtype.str, leaf.shape, leaf.ravel().tolist()] for leaf in memory] if numbers else None
    store.write_run(index, columns, about)


def read_run(store: Store, index: int, like: Run) -> Run:
    """A kept trajectory in the form of another run of the campaign; StoreError as for `Store.arrays`."""
    columns, about = store.arrays(index)

    def tree(name: str) -> Any:
        form = getattr(like, name)
        return jax.tree.unflatten(jax.tree.structure(form), [columns[each] for each in leaves(form, name)])

    memory = about.pop("memory")
    if memory is not None:
        arrays = [np.array(values, kind).reshape(shape) for kind, shape, values in memory]
        about["memory"] = jax.tree.unflatten(jax.tree.structure(like.memory), arrays)
    ends = {"memory": None, "actuator": None, **about}
    return dataclasses.replace(like, **ends, **{name: tree(name) for name in ARRAYS})


def _plain(text: str) -> str:
    """The text without the halves of characters that file names may have."""
    return text.encode(errors="backslashreplace").decode()


def _without_error(table: pa.Table) -> pa.Array:
    """Which rows have results."""
    return pa.array([not text for text in table.column("error").to_pylist()], pa.bool_())


def _same(then: Any, now: Any) -> bool:
    """Equal, or as near as other processors come."""
    then, now = np.asarray(then), np.asarray(now)
    if then.shape != now.shape or then.dtype.kind not in "fiubc":
        return np.array_equal(then, now)
    size = np.abs(then[np.isfinite(then)]).max(initial=0)
    return np.allclose(now, then, rtol=NEAR, atol=NEAR * size, equal_nan=True)


def _key(entry: Any) -> Any:
    """Name, key or number of a step into a pytree."""
    for kind in ("name", "key", "idx"):
        if hasattr(entry, kind):
            return getattr(entry, kind)
    return entry
