"""Files appear whole or not at all, and a folder is known to be usable before anything is flown for it."""

import contextlib
import errno
import os
from pathlib import Path

UNFINISHED = ".partial"  # how the name of a file ends that a killed writer left behind; it may be removed


def write_atomically(path: Path, content: bytes) -> Path:
    """Write beside the target, force it to the disk and rename: a reader sees the old file or the new one, never half.

    The file's mode follows the umask. A writer that is killed leaves at most a hidden ``.NAME.*.partial``.

    Raises
    ------
    OSError
        The folder is missing or cannot be written, or the disk is full; the old file is as it was.
    """
    temporary = path.parent / f".{path.name[:40]}.{os.urandom(6).hex()}{UNFINISHED}"
    try:
        with open(temporary, "xb") as file:
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


def usable(folder: Path) -> Path:
    """The folder, made if it is missing; a file was written there and removed again.

    Raises
    ------
    OSError
        It cannot be made, is no folder, or cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    probe = folder / f".{os.urandom(6).hex()}{UNFINISHED}"
    try:
        probe.write_bytes(b"probe")
    finally:
        with contextlib.suppress(OSError):
            probe.unlink(missing_ok=True)
    return folder


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
