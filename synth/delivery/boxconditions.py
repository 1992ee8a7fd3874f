"""Lines of the acceptance gate about an uncertain plant: what holds at every point of its box of parameters, proved.

    stability                 the box may be made so many times as large, without and with a sample of delay
    gain                      worst H-infinity norm from w to z, where the plant has w and z
    delay margin, and others  of disk, gain, phase and ncf: those that are required

A line passes by what is proved, fails by what is reached at named parameters, and is not judged in between, nor where
the time of the processor for all of them (`PATIENCE`) was up before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from synth.delivery.conditions import Condition, Requirements, missed, over
from synth.errors import SynthError
from synth.proof.boxmargins import (
    GAIN_DOWN,
    GAIN_UP,
    diskmargin,
    negative,
    one_loop,
    worst_delay,
    worst_gain_margin,
    worst_ncf,
    worst_phase,
)
from synth.proof.stability import stability_margin
from synth.proof.worstcase import WorstCase
from synth.proof.worstgain import worst_gain
from synth.systems.connect import delayed
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace
from synth.systems.uncertain import UncertainSystem, as_uncertain, series

PATIENCE = 120.0  # s of the processor, after which no further line is begun
STABLE = "stability over the box"
NEAR = 1e-3  # relative distance of bounds that is aimed at


class Found(NamedTuple):
    """A margin over the box."""

    proved: float
    reached: float
    parameters: dict[str, float]  # that reach it
    note: str = ""  # why the two are apart


def inside(plant: UncertainSystem, K: StateSpace) -> UncertainSystem:
    """The part of the plant from u to y."""
    m, p = K.ny, K.nu
    P = plant
    return UncertainSystem(P.E, P.A, P.B[:, P.nu - m :], P.C[P.ny - p :], P.D[P.ny - p :, P.nu - m :], P.dt)


def over_box(plant: UncertainSystem, K: StateSpace, level: float | None, asked: Requirements) -> Iterator[Condition]:
    """All lines for u = K y on a plant from (w, u) to (z, y), or from u to y.

    A continuous plant is held at the period of K.
    """
    ends = time.process_time() + PATIENCE
    try:
        plant = plant if plant.discrete else c2d(plant, K.dt)
        G, controller = inside(plant, K), as_uncertain("the controller", K, plant.dt)
    except SynthError as error:
        yield Condition(STABLE, None, note=f"not proved: {error}")
        return
    line = _stable(STABLE, G, K, asked.box_margin or 0.0)
    yield line
    if line.stable:
        yield _stable("one sample of delay over the box", G, delayed(K), asked.box_margin or 0.0)
        if plant.nu > K.ny and plant.ny > K.nu:
            yield _gain(plant, K, level, asked.box_gain_ratio)
    for kind, least, unit, find in _margins(G, controller, asked):
        name = f"{kind} margin over the box"
        if least and not line.stable:
            yield Condition(name, line.stable, note="not measured: the loop is not proved stable on the box")
        elif least and time.process_time() > ends:
            yield Condition(name, None, note=f"not reached within {PATIENCE:g} s of the processor")
        elif least:
            yield _judged(name, least, unit, find)


def _stable(name: str, G: UncertainSystem, K: StateSpace, least: float) -> Condition:
    """How many times as large the box may be made; `stable` is said of the box as it is."""
    try:
        found = stability_margin(G.feedback(K, 1), tol=NEAR)
    except SynthError as error:
        return Condition(name, None, note=f"not proved: {error}")
    proved, lost = found.lower if found.certificate else 0.0, found.eigenvalue is not None
    text = f"proved stable on {proved:.4g} times the box"
    text += f"; unstable on {found.upper:.4g} times it, with {_point(found.parameters)}" if lost else ""
    text += f"; required {least:g}" if least else ""
    passed = True if proved >= least else False if lost and found.upper <= least else None
    text += f"; {found.note}" if passed is None and found.note else ""
    stable = True if proved >= 1 else False if lost and found.upper <= 1 else None
    return Condition(name, passed, stable, note=text, required=least > 0, certificate=found.certificate)


def _gain(plant: UncertainSystem, K: StateSpace, level: float | None, limit: float | None) -> Condition:
    """The worst norm from w to z."""
    name = "gain over the box"
    try:
        found = worst_gain(plant, K, tol=NEAR)
    except SynthError as error:
        return Condition(name, None, note=f"not proved: {error}")
    at = f"{found.lower:.5g} is reached with {_point(found.parameters)}"
    if not np.isfinite(found.upper):
        return Condition(name, None, note=f"{at}; {found.note}", required=limit is not None)
    ratio, least = (None, None) if level is None else (over(found.upper, level), over(found.lower, level))
    if limit is None:
        return Condition(name, True, True, found.upper, ratio, at, required=False, certificate=found.certificate)
    if ratio is None or least is None:
        return Condition(name, None, True, found.upper, note=f"{at}; no level is known; give one (level=)")
    passed = True if ratio <= limit else False if least > limit else None
    note = at if passed else f"{at}; {missed(ratio, limit)}"
    return Condition(name, passed, True, found.upper, ratio, note, certificate=found.certificate)


def _margins(
    G: UncertainSystem, K: UncertainSystem, asked: Requirements
) -> Iterator[tuple[str, float | None, str, Callable[[], Found]]]:
    """Kind, what is required, unit, and what finds it; of loops one at a time the least of all."""
    own, late = negative(series(G, K), 1), negative(series(K, G), 1)
    ends = (own, late) if own.nu > 1 or late.nu > 1 else (own,)
    loops = [one_loop(L, i) for L in ends for i in range(L.nu)]
    samples, degrees = 1 / G.dt, float(np.rad2deg(1))
    yield "delay", asked.delay_margin_samples, "samples", lambda: _least((worst_delay(L, []) for L in loops), samples)
    yield "disk", asked.disk_margin, "", lambda: _least(diskmargin(L).worst for L in ends)
    yield "gain", asked.gain_margin_db, "dB", lambda: _least(found for L in loops for found in _gains(L))
    yield "phase", asked.phase_margin_deg, "deg", lambda: _least((worst_phase(L) for L in loops), degrees)
    yield "ncf", asked.ncf_margin, "", lambda: _least([worst_ncf(G, K, 1)])


def _gains(L: UncertainSystem) -> Iterator[WorstCase]:
    """Gain margins up and down, dB."""
    up, down = worst_gain_margin(L, GAIN_UP), worst_gain_margin(L, GAIN_DOWN)
    yield replace(up, lower=decibel(up.lower), upper=decibel(up.upper))
    yield replace(down, lower=-decibel(down.upper), upper=-decibel(down.lower))


def decibel(gain: float) -> float:
    """20 log10, of a gain of 0 too."""
    return 20 * float(np.log10(gain)) if gain > 0 else -np.inf


def _least(several: Iterable[WorstCase], scale: float = 1.0) -> Found:
    """What is proved and what is reached of all loops."""
    found = list(several)
    proved, reached = min(found, key=lambda r: r.lower), min(found, key=lambda r: r.upper)
    return Found(scale * proved.lower, scale * reached.upper, reached.parameters, proved.note)


def _judged(name: str, least: float, unit: str, find: Callable[[], Found]) -> Condition:
    """Passed by what is proved, failed by what is reached."""
    try:
        proved, reached, parameters, note = find()
    except SynthError as error:
        return Condition(name, None, note=f"not proved: {error}")
    passed = True if proved >= least else False if reached < least else None
    text = f"{proved:.4g} {unit}".strip() + " proved"
    text += f", {reached:.4g} reached with {_point(parameters)}" if parameters else ""
    text += f"; required {least:g}" + (f"; {note}" if passed is None and note else "")
    return Condition(name, passed, note=text)


def _point(parameters: dict[str, float]) -> str:
    """Parameters in words."""
    return ", ".join(f"{name} = {value:.6g}" for name, value in parameters.items()) or "the nominal parameters"
