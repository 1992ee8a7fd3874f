"""Files appear whole or not at all, are read within limits, and say by a sha256 whether they are as they were written.

One reader for JSON and TOML: a regular file of at most `LARGEST` bytes in UTF-8, nested at most `DEEPEST` levels, with
numbers that a double can hold and no key twice. Everything else is a `ModelError`, before it is too late.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import functools
import hashlib
import json
import math
import os
import stat
from collections.abc import Callable, Iterable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from synth.errors import ModelError

LARGEST = 64 * 2**20  # bytes of a file; a design of order 400 has 10 MiB
DEEPEST = 50  # levels of lists and tables; a certificate has 7
UNFINISHED = ".partial"  # how the name of a file ends that a killed writer left behind; it may be removed
DEVICES = ("CON", "PRN", "AUX", "NUL", "CONIN$", "CONOUT$", "CLOCK$")
SEAL, PARTS = "sha256", "parts_sha256"


def write_atomically(path: Path, content: bytes, mode: int = 0o666) -> Path:
    """Write beside the target, force it to the disk and rename: a reader sees the old file or the new one, never half.

    The umask is taken from the file's mode. A writer that is killed leaves at most a hidden ``.NAME.*.partial``.

    Raises
    ------
    OSError : the folder is missing or cannot be written, or the disk is full; the old file is as it was.
    """
    temporary = path.parent / f".{path.name[:40]}.{os.urandom(6).hex()}{UNFINISHED}"
    try:
        with open(temporary, "xb", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    _settle(path.parent)
    return path


def check_writable(folder: Path) -> None:
    """Raise OSError where no file can be written into a folder; one is written and removed again."""
    probe = folder / f".{os.urandom(6).hex()}{UNFINISHED}"
    try:
        probe.write_bytes(b"probe")
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)


def _settle(folder: Path) -> None:
    """Force the names in a folder to the disk, where the system lets folders be opened and forced."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:  # Windows, or a folder that may be written but not listed
        return
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        os.close(handle)


def is_device(name: str) -> bool:
    """True for a file's name that is a device on Windows whatever follows its first dot, such as con.json or nul."""
    stem = name.split(".")[0].rstrip(" ").upper()
    return stem in DEVICES or (
        stem[:3] in ("COM", "LPT") and len(stem) == 4 and stem[3] in "0123456789\u00b9\u00b2\u00b3"
    )


def read_bytes(path: Path, largest: int = LARGEST) -> bytes:
    """The content of a regular file of at most `largest` bytes.

    Raises
    ------
    ModelError : the file is missing, a folder, a device or a pipe, larger, or cannot be read.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(handle, "rb") as file:
            about = os.fstat(handle)
            if not stat.S_ISREG(about.st_mode):
                raise ModelError("it is a device or a pipe; pass a file")
            content = b"" if about.st_size > largest else file.read(largest + 1)
            if max(about.st_size, len(content)) > largest:
                raise ModelError(f"it is larger than {largest / 2**20:.3g} MiB, which no model here needs")
            return content
    except FileNotFoundError:
        raise ModelError("there is no such file") from None
    except IsADirectoryError:
        raise ModelError("this is a folder; pass a file") from None
    except OSError as error:
        folder = os.path.isdir(path)  # Windows says that access is denied
        raise ModelError(
            "this is a folder; pass a file" if folder else f"it cannot be read ({error.strerror})"
        ) from None
    except ValueError as error:
        if isinstance(error, ModelError):
            raise
        raise ModelError(f"its name is none ({error}); pass the path of a file") from None


def parsed(path: Path, parse: Callable[[str], Any], kind: str, *, finite: bool = False, largest: int = LARGEST) -> Any:
    """What `parse` finds in a text file, as plain data that `check_plain` has seen.

    Raises
    ------
    ModelError : as `read_bytes` and `check_plain`, or the file is no UTF-8 text, or `parse` cannot make sense of it.
    """
    return _plain(lambda: parse(read_bytes(path, largest).decode()), kind, finite)


def _plain(parse: Callable[[], Any], kind: str, finite: bool) -> Any:
    """What `parse` finds, checked."""
    try:
        data = parse()
    except ModelError:
        raise
    except RecursionError:
        raise ModelError(f"it is no {kind} (it is nested deeper than {DEEPEST} levels)") from None
    except ValueError as error:
        raise ModelError(f"it is no {kind} ({error})") from None
    check_plain(data, finite=finite)
    return data


def read_json(path: Path) -> Any:
    """The data in a JSON file, without the numbers that JSON does not know.

    Raises
    ------
    ModelError : as `parsed`, or a key is given twice, or a number is not finite.
    """
    return parsed(path, _strict, "JSON", finite=True)


def json_of(text: str) -> Any:
    """The same of a text."""
    return _plain(lambda: _strict(text), "JSON", True)


def _strict(text: str) -> Any:
    return json.loads(text, parse_constant=_refuse, object_pairs_hook=_once)


def _refuse(text: str) -> None:
    raise ModelError(f"it holds {text}, which is no number; every entry must be finite")


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A mapping that says nothing twice."""
    if len(found := dict(pairs)) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ModelError(f"the key {next(key for key in keys if keys.count(key) > 1)[:60]!r} is given twice")
    return found


def check_plain(data: Any, *, finite: bool = False) -> None:
    """Raise ModelError for data that is nested too deep, or has numbers no double holds or texts that are none."""
    todo = [("", data, 0)]
    while todo:
        place, value, depth = todo.pop()
        if depth > DEEPEST:
            raise ModelError(f"it is nested deeper than {DEEPEST} levels, at {place[:60]}...")
        items: Iterable[tuple[Any, Any]] = ((None, value),)
        if isinstance(value, dict):
            items = (*((None, key) for key in value), *value.items())
        elif isinstance(value, list):
            items = enumerate(value)
        for key, item in items:
            at = (
                place if key is None else f"{place}[{key}]" if isinstance(value, list) else f"{place}.{key}".lstrip(".")
            )
            if isinstance(item, dict | list):
                todo.append((at, item, depth + 1))
            elif isinstance(item, str) and not _is_text(item):
                raise ModelError(f"{ascii(at)[1:-1]} is {ascii(item)[:60]}, which is no text of Unicode")
            elif isinstance(item, int | float) and (_is_huge(item) or (finite and not math.isfinite(item))):
                raise ModelError(f"{at} is a number that no double holds; every entry must be finite")


def _is_text(text: str) -> bool:
    return text.isascii() or not any("\ud800" <= letter <= "\udfff" for letter in text)


def _is_huge(number: float) -> bool:
    """True for whole numbers beyond the doubles."""
    return isinstance(number, int) and number.bit_length() > 1023


def sealed(data: Mapping[str, Any]) -> dict[str, Any]:
    """The data with the sha256 of all else in it: a checksum of its JSON text, which is no signature."""
    rest = {key: value for key, value in data.items() if key != SEAL}
    return {**rest, SEAL: _digest(rest)}


def sealed_by_parts(data: Mapping[str, Any]) -> dict[str, Any]:
    """The same with a sha256 of every field too, two levels deep, which tell what was changed."""
    rest = {key: value for key, value in data.items() if key not in (SEAL, PARTS)}
    return sealed({**rest, PARTS: {place: _digest(value) for place, value in _fields(rest)}})


def check_seal(data: Mapping[str, Any]) -> None:
    """Raise ModelError where the data is not as it was sealed, with the fields that were changed."""
    rest = {key: value for key, value in data.items() if key != SEAL}
    if data.get(SEAL) == _digest(rest):
        return
    told = data.get(PARTS)
    told = told if isinstance(told, dict) else {}
    now = {place: _digest(value) for place, value in _fields({k: v for k, v in rest.items() if k != PARTS})}
    changed = [
        *(place for place in told if told[place] != now.get(place)),
        *(place for place in now if place not in told),
    ]
    if not told:
        which = "something in it"
    elif not changed:
        which = "sha256 itself, or the order of its fields,"
    else:
        which = ", ".join(str(place)[:60] for place in changed[:5]) + (" and more" if len(changed) > 5 else "")
    raise ModelError(f"{which} was changed after the file was written: the sha256 differs; take it from where it came")


def _fields(data: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    """Names and values, two levels deep."""
    for key, value in data.items():
        if isinstance(value, dict) and value:
            yield from ((f"{key}.{name}", part) for name, part in value.items())
        else:
            yield key, value


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()


def provenance(*packages: str) -> tuple[dict[str, str], str]:
    """Versions of the packages that took part, and the date (ISO 8601, UTC)."""
    versions = {name: _version(name) for name in ("convex-synth", "numpy", "scipy", *packages)}
    return versions, datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


@functools.cache
def _version(package: str) -> str:
    """Its version; read once, because parsing the metadata takes a millisecond."""
    return metadata.version(package)
