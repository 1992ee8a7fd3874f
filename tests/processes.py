"""Processes that tests start, watch and end, each by its number."""

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

TESTS = Path(__file__).parent
PATIENCE = 240.0  # s; on a busy machine


@contextmanager
def started(*command, surroundings=None, **options):
    """`python COMMAND`, which can import the tests; killed at the end if it still runs."""
    paths = [str(TESTS), str(TESTS.parent), os.environ.get("PYTHONPATH", "")]
    surroundings = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))} | (surroundings or {})
    process = subprocess.Popen([sys.executable, *map(str, command)], env=surroundings, **options)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stdout:
            process.stdout.close()


def until(condition, what="it"):
    """What a condition gives once it is true."""
    begun = time.monotonic()
    while not (found := condition()):
        assert time.monotonic() - begun < PATIENCE, f"{what} did not come"
        time.sleep(0.005)
    return found


def workers(pid):
    """Numbers of the worker processes of a process, from what Linux tells."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if parent == pid and "popen_loky" in (entry / "cmdline").read_text():
                found.append(int(entry.name))
        except (OSError, ValueError, IndexError):
            continue  # it has just ended
    return found


def lives(pid):
    """Whether a process runs; one that only waits to be counted does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False
