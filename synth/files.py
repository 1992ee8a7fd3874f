"""Files appear whole or not at all, and say with which versions and when they were made."""

from __future__ import annotations

import datetime
import functools
import os
import tempfile
from importlib import metadata
from pathlib import Path


def write_atomically(path: Path, content: bytes) -> Path:
    """Write beside the target and rename, so that a reader never sees half a file."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise
    return path


def provenance(*packages: str) -> tuple[dict[str, str], str]:
    """Versions of the packages that took part, and the date (ISO 8601, UTC)."""
    versions = {name: _version(name) for name in ("convex-synth", "numpy", "scipy", *packages)}
    return versions, datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


@functools.cache
def _version(package: str) -> str:
    """Its version; read once, because parsing the metadata takes a millisecond."""
    return metadata.version(package)
