"""Reading .mat files in a process of their own: a damaged one ends that process, not this one."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from synth.errors import ModelError
from synth.files import read_bytes

CHILD = Path(__file__).with_name("matchild.py")
PATIENCE = 120.0  # s, from the start of the process to its answer; it takes half a second


def read_mat(path: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """The variables of a .mat file of version 7 or older that have one of the names; texts say what is no real matrix.

    Raises
    ------
    ModelError : as `read_bytes`, or it is no such file, is damaged, or is not read in two minutes and 4 GiB.
    """
    content = read_bytes(path)
    if not sys.executable:
        raise ModelError("a .mat file is read by a Python of its own, and none can be started; save it as .json")
    try:
        done = subprocess.run(
            [sys.executable, "-P", str(CHILD), *names],
            input=content,
            capture_output=True,
            timeout=PATIENCE,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"},
        )
    except subprocess.TimeoutExpired:
        raise ModelError(f"it was not read in {PATIENCE:g} s; it is damaged, or save the matrices as .json") from None
    except OSError as error:
        raise ModelError(f"no process to read a .mat file could be started ({error.strerror})") from None
    if done.returncode < 0 or done.returncode > 1:
        raise ModelError("it is no .mat file of version 7 or older, or is damaged: reading it ended the process")
    if done.returncode:
        reason = " ".join(done.stderr.decode(errors="replace").split())[-200:]
        raise ModelError(f"it is no .mat file of version 7 or older ({reason})")
    try:
        with np.load(io.BytesIO(done.stdout), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except Exception as error:  # the process was damaged before it answered
        raise ModelError(f"it is a damaged .mat file ({error})") from None
