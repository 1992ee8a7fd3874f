"""Runs that nobody flew, of bodies with an attitude: for pictures and tables."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from plants.simulation.loop import Run


class Body(NamedTuple):
    q: np.ndarray
    w: np.ndarray
    wheels: np.ndarray


class Recorded(NamedTuple):
    mode: np.ndarray
    error: np.ndarray


def turn(angle: np.ndarray, axis: Any) -> np.ndarray:
    """Vector parts (n, 3) of turns by angles (n,) rad about a unit axis."""
    return np.sin(angle / 2)[:, None] * np.asarray(axis, float)


def attitude_run(n: int = 40, wheels: int = 3, **changes: Any) -> Run:
    """A body that turns from 20 deg about z to rest, with an estimate that is 0.1 deg off about x."""
    time = 0.5 * np.arange(n)
    angle = np.radians(20) * np.exp(-time)
    v, w = turn(angle, [0, 0, 1]), np.outer(np.exp(-time), [0.1, 0.2, -0.3])
    q = np.c_[np.cos(angle / 2), v]
    outputs = np.c_[v, w]
    off = np.radians(0.1) / 2
    known = np.c_[np.sin(off) * q[:, 0], np.sin(off) * q[:, 3], np.cos(off) * q[:, 3]]  # a turn about x after q
    commands = np.outer(np.cos(time), [1e-3, 2e-3, 3e-3])
    fields = {
        "duration": 0.5 * n, "time": time, "states": Body(q, w, 100 * np.outer(np.sin(time), np.ones(wheels))),
        "outputs": outputs, "estimates": np.c_[known, w], "references": np.zeros((n, 6)), "commands": commands,
        "inputs": -0.5 * np.outer(np.cos(time), np.full(wheels or 3, 1e-3)), "extra": None, "ok": True,
        "failed_at": None, "culprit": "", "compiled": True,
    }  # fmt: skip
    return Run(**(fields | changes))


def attitudes(angles):
    """Outputs (N, 6) of 3-2-1 Euler angles (N, 3) rad; SciPy's quaternion is the same."""
    q = Rotation.from_euler("ZYX", np.asarray(angles)[:, ::-1]).as_quat(scalar_first=True)
    q *= np.where(q[:, :1] < 0, -1, 1)
    return np.hstack([q[:, 1:], np.zeros((len(q), 3))])


def run(true, known=None, desired=None, torque=None, h=0.5):
    """A sound run of 3-2-1 Euler angles (N, 3) rad: true, estimated and desired."""
    n = len(true)
    true = attitudes(true)
    return Run(
        duration=n * h,
        time=h * np.arange(n),
        states=None,
        outputs=true,
        estimates=true if known is None else attitudes(known),
        references=np.zeros((n, 6)) if desired is None else attitudes(desired),
        commands=np.zeros((n, 3)),
        inputs=np.zeros((n, 3)) if torque is None else torque,
        extra=None,
        ok=True,
        failed_at=None,
        culprit="",
        compiled=True,
    )
