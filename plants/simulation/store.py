"""A folder in which runs outlive the process that flies them.

    manifest.json                  what is flown: study, seed, hashes of plant, controller and measure, versions; sealed
    chunks/FIRST-LAST-SHA.parquet  a row for each of some runs, written when they have been flown
    runs/INDEX-SHA.parquet         the trajectory of one run, a row for each sample
    lock                           held by the process that writes

Every file is written under another name, forced to the disk and renamed, and carries the sha256 of its content in its
name and that of the manifest inside. A file that is not as it was written is never read as if it were.
"""

import contextlib
import hashlib
import io
import json
import platform
import shutil
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from plants.errors import StoreError
from plants.files import UNFINISHED, write_atomically
from plants.simulation import versions
from plants.simulation.columns import array, column, together

FORMAT = 1
MANIFEST, CHUNKS, RUNS, LOCK = "manifest.json", "chunks", "runs", "lock"
LARGEST = 1 << 24  # bytes of a manifest
WHAT = {  # parts of a manifest that must be the same when a store is continued, in words
    "study": "study", "runs": "number of runs", "seed": "seed", "hashes": "", "versions": "version of",
}  # fmt: skip

Columns = Mapping[str, np.ndarray]


class Store:
    """A folder of rows and trajectories; open it to read, or to write with `writing`.

    Parameters
    ----------
    folder : of an earlier campaign or sweep

    Raises
    ------
    StoreError
        No store, or a manifest that is not as it was written.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder).absolute()  # work may change the directory
        self.manifest = _manifest(self.folder / MANIFEST)
        self.damaged: list[str] = []  # chunks that were set aside, and why
        self._lock: filelock.BaseFileLock | None = None

    def __repr__(self) -> str:
        runs, study = self.manifest["runs"], self.manifest["study"]
        return f"Store({str(self.folder)!r}): {len(self.index)} of {runs} runs of {study}"

    @classmethod
    def writing(cls, folder: Path | str, what: Mapping[str, Any], *, resume: bool) -> "Store":
        """The store of `what` (study, runs, seed, hashes, code), made if the folder is new; close it at the end.

        Raises
        ------
        StoreError
            It is another study's, another process writes to it, it holds runs and `resume` is False, or the folder
            cannot be written.
        """
        folder = Path(folder).absolute()
        lock = filelock.FileLock(folder / LOCK)
        try:
            for part in (CHUNKS, RUNS):
                (folder / part).mkdir(parents=True, exist_ok=True)
            lock.acquire(timeout=0)
        except filelock.Timeout as held:
            raise StoreError(
                f"store {folder}: another process is flying into it; wait for its end or give another folder"
            ) from held
        except (OSError, NotImplementedError) as error:  # the latter of file systems without locks
            raise _unwritable(folder, error) from error
        try:
            for part in (folder, folder / CHUNKS, folder / RUNS):
                _sweep(part)
            store = cls._begun(folder, what, resume)
        except BaseException:
            lock.release()
            raise
        store._lock = lock
        return store

    @classmethod
    def _begun(cls, folder: Path, what: Mapping[str, Any], resume: bool) -> "Store":
        """The store of a locked folder."""
        path = folder / MANIFEST
        if not path.exists():
            strays = sum(1 for _ in _files(folder / CHUNKS))
            if strays:
                raise StoreError(
                    f"store {folder}: {strays} chunks but no {MANIFEST}; bring it back or give another folder"
                )
            made = datetime.now(UTC).isoformat(timespec="seconds")
            told = {
                "format": FORMAT,
                **what,
                "versions": versions.of_packages(),
                "made": made,
                "machine": platform.platform(),
            }
            _write(path, json.dumps(_sealed(told), indent=1).encode())
            return cls(folder)
        store = cls(folder)
        _same(store, {**what, "versions": versions.of_packages()})
        if resume:
            store.damaged = store.set_aside()
        elif len(store.index):
            raise StoreError(
                f"store {folder}: holds {len(store.index)} of {store.manifest['runs']} runs of this study; "
                "resume=True (--resume) flies the others, or give another folder"
            )
        return store

    def close(self) -> None:
        """Let other processes write."""
        if self._lock is not None:
            self._lock.release()

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    @property
    def index(self) -> np.ndarray:
        """(n,) indices of the runs that are stored, sorted.

        Raises
        ------
        StoreError
            A chunk is damaged, or a run is in two of them.
        """
        return self.columns(["index"])["index"]

    def columns(self, names: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Columns (n, ...) by name, a row for each stored run, sorted by index; StoreError as for `index`."""
        table = self.table(names)
        return {name: array(table.column(name), table.schema.field(name)) for name in table.column_names}

    def table(self, names: Sequence[str] | None = None) -> pa.Table:
        """The same as a pyarrow table, which has ``to_pandas()``; StoreError as for `index`."""
        files = sorted(_files(self.folder / CHUNKS))
        names = None if names is None else list(dict.fromkeys(["index", *names]))
        if not files:
            return pa.table({"index": pa.array([], pa.int64())})
        table = together([self._read(path, names) for path in files], f"store {self.folder}").sort_by("index")
        index = table.column("index").to_numpy()
        double = index[1:][np.diff(index) == 0]
        if len(double):
            raise StoreError(
                f"store {self.folder}: run {double[0]} is in two chunks; remove the one that was copied there"
            )
        if len(index) and not (0 <= index[0] and index[-1] < self.manifest["runs"]):
            raise StoreError(
                f"store {self.folder}: run {index[-1]} is beyond the {self.manifest['runs']} of its manifest"
            )
        return table

    def set_aside(self) -> list[str]:
        """Rename the chunks that are damaged, so that their runs are flown again; their names, with the reason.

        Raises
        ------
        StoreError
            One cannot be read or renamed, which is no damage.
        """
        found = []
        for path in sorted(_files(self.folder / CHUNKS)):
            content = _content(path)
            try:
                self._parsed(path, content, ["index"])
            except StoreError as error:
                found.append(str(error))
                try:
                    path.rename(path.with_name(f"{path.name}.damaged"))
                except OSError as refused:
                    raise _unwritable(path, refused) from error
        return found

    def write(self, columns: Columns, missing: Columns | None = None) -> None:
        """Add rows, (n, ...) of each column with the integer column "index"; `missing` are masks (n,) of what is null.

        Raises
        ------
        StoreError
            The file cannot be written; what was stored before is as it was.
        """
        index = columns["index"]
        content = self._parquet(columns, {}, missing or {})
        name = f"{index.min():09d}-{index.max():09d}-{_short(content)}.parquet"
        _write(self.folder / CHUNKS / name, content)

    def write_run(self, index: int, columns: Columns, about: Mapping[str, Any]) -> None:
        """Keep the trajectory of one run: columns (N, ...), and what else there is to say in JSON; as `write`."""
        content = self._parquet(columns, {"about": json.dumps(about), "index": str(index)}, {})
        _write(self.folder / RUNS / f"{index:09d}-{_short(content)}.parquet", content)

    @property
    def kept(self) -> list[int]:
        """Indices of the runs whose trajectories are stored."""
        names = (path.name.split("-")[0] for path in _files(self.folder / RUNS))
        return sorted({int(name) for name in names if name.isdecimal()})

    def trajectory(self, index: int) -> pa.Table:
        """The trajectory of one run, a row for each sample; nothing else is read.

        Raises
        ------
        StoreError
            It was not kept, or its file is damaged.
        """
        files = sorted(path for path in _files(self.folder / RUNS) if path.name.startswith(f"{index:09d}-"))
        if not files:
            some = ", ".join(map(str, self.kept[:10])) or "none"
            raise StoreError(
                f"store {self.folder}: no trajectory of run {index} is kept (of {some} there is one); keep={index}"
            )
        table = self._read(files[0], None)
        if (table.schema.metadata or {}).get(b"index") != str(index).encode():
            raise StoreError(f"{files[0]}: is the trajectory of another run, under a new name; remove it")
        return table

    def arrays(self, index: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """The same as arrays (N, ...) by name, and what `write_run` was told about it."""
        table = self.trajectory(index)
        about = json.loads((table.schema.metadata or {})[b"about"])
        return {name: array(table.column(name), table.schema.field(name)) for name in table.column_names}, about

    def _parquet(self, columns: Columns, metadata: Mapping[str, str], missing: Columns) -> bytes:
        """The content of a file of these columns."""
        fields = {name: column(name, np.asarray(values), missing.get(name)) for name, values in columns.items()}
        schema = pa.schema([field for field, _ in fields.values()], {**metadata, "manifest": self.manifest["sha256"]})
        sink = io.BytesIO()
        pq.write_table(pa.table([array for _, array in fields.values()], schema), sink, compression="zstd")
        return sink.getvalue()

    def _read(self, path: Path, names: Sequence[str] | None) -> pa.Table:
        """A file of this store, after its sha256 was checked."""
        return self._parsed(path, _content(path), names)

    def _parsed(self, path: Path, content: bytes, names: Sequence[str] | None) -> pa.Table:
        remedy = "bring it back from a copy, or resume: its runs are then flown again"
        if path.name.split(".")[0].rsplit("-", 1)[-1] != _short(content):
            raise StoreError(f"{path}: was damaged or changed after it was written (its sha256 differs); {remedy}")
        try:
            table = pq.read_table(io.BytesIO(content), columns=None if names is None else list(names))
        except (pa.ArrowException, OSError, KeyError) as error:
            raise StoreError(f"{path}: is no Parquet file of runs ({error}); {remedy}") from error
        if (table.schema.metadata or {}).get(b"manifest") != self.manifest["sha256"].encode():
            raise StoreError(f"{path}: belongs to another store; remove it")
        return table


def move_aside(folder: Path) -> Path | None:
    """Rename a folder of stores, so that others can be begun; its new place, None if there is none.

    What an earlier call has moved there is removed.

    Raises
    ------
    StoreError
        A process is flying into one of them.
    """
    if not folder.is_dir():
        return None
    for path in folder.glob(f"*/{LOCK}"):
        try:
            with filelock.FileLock(path, timeout=0):
                pass
        except filelock.Timeout as held:
            raise StoreError(
                f"{path.parent}: another process is flying into it; wait for its end, or give another folder"
            ) from held
    previous = folder.with_name(f"{folder.name}.previous")
    if previous.is_dir():
        shutil.rmtree(previous)
    return folder.rename(previous)


def _content(path: Path) -> bytes:
    """What is in a file, which a pipe or a device is not."""
    try:
        if not path.is_file():
            raise OSError("it is no file")
        return path.read_bytes()
    except OSError as error:
        raise StoreError(
            f"{path}: cannot be read ({error.strerror or error}); bring it back, or remove it and resume"
        ) from error


def _sweep(folder: Path) -> None:
    """Remove what killed writers left behind."""
    for path in folder.glob(f".*{UNFINISHED}"):
        with contextlib.suppress(OSError):
            path.unlink()


def _files(folder: Path) -> Iterable[Path]:
    """The finished files of a folder."""
    return (path for path in folder.glob("*.parquet") if not path.name.startswith("."))


def _manifest(path: Path) -> dict[str, Any]:
    """The manifest, as it was written."""
    remedy = "bring it back from a copy, or fly into another folder"
    try:
        if not path.is_file() or path.stat().st_size > LARGEST:
            raise StoreError(f"{path}: is no manifest of a campaign; give the folder that store= was given")
        told = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise StoreError(f"{path}: cannot be read ({error}); {remedy}") from error
    if not isinstance(told, dict) or told != _sealed(told):
        raise StoreError(f"{path}: was damaged or changed after it was written (its sha256 differs); {remedy}")
    if told.get("format") != FORMAT:
        raise StoreError(f"{path}: has format {told.get('format')!r}, this version reads {FORMAT}; {remedy}")
    return told


def _sealed(told: Mapping[str, Any]) -> dict[str, Any]:
    """A manifest with the sha256 of all else in it."""
    rest = {key: value for key, value in told.items() if key != "sha256"}
    return {**rest, "sha256": hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()}


def _same(store: Store, what: Mapping[str, Any]) -> None:
    """Raise StoreError, with all differences, where a store was begun by something else."""
    found = []
    for key, words in WHAT.items():
        old, new = store.manifest.get(key), what.get(key)
        if isinstance(new, Mapping) and isinstance(old, Mapping):
            for name in {**old, **new}:
                if old.get(name) != new.get(name):
                    found.append(f"{words} {name} ({_brief(old.get(name))}, now {_brief(new.get(name))})".strip())
        elif old != new:
            found.append(f"{words} ({_brief(old)}, now {_brief(new)})")
    if found:
        raise StoreError(
            f"store {store.folder}: was begun with another {', another '.join(found)}; give another folder"
        )


def _brief(value: Any) -> str:
    return str(value)[:16]


def _short(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:32]


def _write(path: Path, content: bytes) -> None:
    try:
        write_atomically(path, content)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError | NotImplementedError) -> StoreError:
    why = getattr(error, "strerror", None) or error
    return StoreError(
        f"{path}: cannot be written ({why}); what was stored before is safe: make room or give another folder, then "
        "resume"
    )
