"""Files of `plants` appear whole or not at all, and a folder is tried before it is needed."""

import os
import signal
import stat
import subprocess
import sys

import pytest

from plants.files import UNFINISHED, usable, write_atomically


@pytest.mark.skipif(os.name != "posix", reason="modes of files are POSIX's")
@pytest.mark.parametrize("mask", [0o077, 0o022, 0o002])
def test_the_umask_is_respected(tmp_path, mask):
    before = os.umask(mask)
    try:
        write_atomically(tmp_path / "a", b"content")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o666 & ~mask


@pytest.mark.parametrize("broken", ["fsync", "replace"])
def test_after_an_exception_the_old_file_is_there_alone(tmp_path, monkeypatch, broken):
    write_atomically(tmp_path / "a", b"old")

    def fails(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, broken, fails)
    with pytest.raises(OSError, match="No space left"):
        write_atomically(tmp_path / "a", b"new")
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("a", b"old")]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
def test_a_killed_writer_leaves_the_old_file_and_a_name_that_tells(tmp_path):
    write_atomically(tmp_path / "a", b"old")
    code = (
        "import os, pathlib, signal\nfrom plants import files\n"
        "files.os.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"files.write_atomically(pathlib.Path({str(tmp_path / 'a')!r}), b'new')"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -signal.SIGKILL
    assert (tmp_path / "a").read_bytes() == b"old"
    (left,) = (p.name for p in tmp_path.iterdir() if p.name != "a")
    assert left.startswith(".a.")
    assert left.endswith(UNFINISHED)


@pytest.mark.parametrize("name", ["µ" * 120, "a" * 250])
def test_long_names_can_be_written(tmp_path, name):
    assert write_atomically(tmp_path / name, b"x").read_bytes() == b"x"


def test_a_usable_folder_is_made_and_left_empty(tmp_path):
    assert list(usable(tmp_path / "a" / "b").iterdir()) == []
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "x"):
        with pytest.raises(OSError):  # noqa: PT011 - its kind differs from system to system
            usable(folder)
