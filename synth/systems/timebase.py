"""Timebases of systems that work together: they agree, or one has a sampling time that nobody said (dt = True)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from synth.checks import joint_timebase
from synth.errors import ModelError


def common_timebase(G: Any, K: Any, names: tuple[str, str] | None = None) -> float:
    """The timebase two systems share, or a ModelError; an unspecified sampling time is that of the other one."""
    dt = joint_timebase(G.dt, K.dt)
    if dt is None:
        which = f"{names[0]} and {names[1]}" if names else "the systems"
        raise ModelError(f"{which} have timebases {G.dt} and {K.dt} s; convert one with c2d first")
    return dt


def retimed(G: Any, dt: float) -> Any:
    """A system with the timebase of its company, where its own sampling time is unspecified."""
    return replace(G, dt=dt) if G.dt is True and dt is not True else G
