"""Lines of the acceptance gate about the processor: rounded numbers, rounded sums, and limits of the commands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from synth.analysis.norms import is_stable
from synth.delivery import rounding
from synth.delivery.conditions import Condition, Requirements, measured, over
from synth.delivery.rounding import UNASKED, in_loop, listed, loop_peaks
from synth.delivery.simulation import RETURNED, horizon, short, simulate, starts
from synth.errors import ExportError, ModelError, NumericalError, SynthError
from synth.regulators.fixed import FORMATS, FixedController
from synth.regulators.sequential import SequentialController
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

PRECISIONS = (*rounding.PRECISIONS, *FORMATS)
UNSTABLE = "not simulated: the loop is unstable"
DIRECT = "not simulated: the plant has a direct term D22, so that measurement and command would wait for each other"
LARGE = f"not bounded unasked: the controller has more than {UNASKED} states; pass inputs, bounds of |y|"


def inner(P: GeneralizedPlant) -> StateSpace:
    """What the controller sees of the plant: from u to y."""
    return StateSpace(P.A, P.B2, P.C2, P.D22, P.dt)


def in_numbers(
    precision: str, P: GeneralizedPlant, K: StateSpace, level: float | None, held: float | None, asked: Requirements,
    inputs: np.ndarray | None, commands: np.ndarray | None,
) -> Iterator[Condition]:  # fmt: skip
    """Rounded coefficients, rounded arithmetic, and its proved bound; the norm before rounding is `held`.

    `inputs` (p,) and `commands` (m,) are bounds of |y| and |u|, if some are known.
    """
    if precision != "double":
        try:
            rounded = _rounded(P, K, precision, inputs)
        except (ExportError, NumericalError) as error:
            yield Condition(f"{precision} numbers", False, note=str(error))
            return
        numbers = measured(f"{precision} numbers", P, rounded.system, level, None)
        if numbers.norm is not None and held is not None and numbers.norm > asked.ratio * max(held, level or 0.0):
            note = f"{over(numbers.norm, held):.4g} times the norm before rounding; at most {asked.ratio:g} is required"
            numbers = replace(numbers, passed=False, note=note)
        yield numbers
        yield _arithmetic(f"{precision} arithmetic", P, K, rounded, bool(numbers.stable))
    yield _bounded(f"rounding ({precision})", P, K, precision, inputs, commands, asked.rounding_ratio)


def _rounded(
    P: GeneralizedPlant, K: StateSpace, precision: str, inputs: np.ndarray | None
) -> SequentialController | FixedController:
    """The controller as it leaves, without its limits."""
    if precision not in FORMATS:
        return SequentialController.of(K, dtype=rounding.PRECISIONS[precision], allow_unstable=True)
    Y = loop_peaks(P, K)[0] if inputs is None else inputs
    return FixedController.of(K, precision, Y)


def _arithmetic(
    name: str, P: GeneralizedPlant, K: StateSpace, rounded: SequentialController | FixedController, stable: bool
) -> Condition:
    """Simulated beside doubles, from all plant states displaced at once, within the inputs that fixed point takes."""
    G = inner(P)
    if G.D.any():
        return Condition(name, False, note=DIRECT)
    if not (stable and is_stable(P.close(K))):
        return Condition(name, False, False, note=UNSTABLE)
    exact = SequentialController.of(K, allow_unstable=True)
    samples, covered = horizon(P, K)
    start = starts(G, K, np.ones(K.ny)).sum(axis=0)
    linear = simulate(G, exact, start, samples)
    if isinstance(rounded, FixedController):
        largest = np.abs(linear.y).max(axis=0) / np.ldexp(rounded.most.astype(float), -rounded.read)
        start = start / (largest.max() or 1.0)
        linear = simulate(G, exact, start, samples)
    other = simulate(G, rounded, start, samples)
    size = np.abs(linear.v).max(axis=0)
    off = float((np.abs(other.v - linear.v).max(axis=0) / np.where(size > 0, size, 1.0)).max())
    left = other.left(linear.peaks())
    fine = off <= RETURNED and (left <= RETURNED or not covered)
    note = f"commands differ by at most {off:.1e} of their peaks" + ("" if covered else short(samples))
    if not fine:
        note += f", and {left:.1e} of the peaks is left at the end; at most {RETURNED:g} is required"
    return Condition(name, fine, fine, note=note)


def _bounded(
    name: str,
    P: GeneralizedPlant,
    K: StateSpace,
    precision: str,
    inputs: np.ndarray | None,
    commands: np.ndarray | None,
    limit: float | None,
) -> Condition:
    """The proved bound of the commands' difference over any time, over their peaks."""
    if inputs is None and K.n > UNASKED:
        return Condition(name, None, note=LARGE)
    try:
        found, peaks = in_loop(P, K, precision, inputs, commands)
    except SynthError as error:
        return Condition(name, None, note=f"not bounded: {error}")
    ratio = max(over(off, peak) if off > 0 else 0.0 for off, peak in zip(found.command, peaks, strict=True))
    where = "|w| <= 1" if inputs is None else f"|y| <= {listed(found.inputs)}"
    note = f"|u - exact u| <= {listed(found.command)}, {ratio:.1e} of the peaks of u, at any time with {where}"
    if limit is None or ratio <= limit:
        return Condition(name, True, note=note, required=limit is not None)
    return Condition(name, False, note=f"{note}; at most {limit:g} is required")


def saturation(P: GeneralizedPlant, K: StateSpace, umin: Any, umax: Any, antiwindup: Any, overload: float) -> Condition:
    """Simulate the limited loop from every displaced state, both ways."""
    name = "saturation"
    G = inner(P)
    try:
        options: dict[str, Any] = {"umin": umin, "umax": umax, "antiwindup": antiwindup}
        limited = SequentialController.of(K, allow_unstable=True, **options)
    except ExportError as error:
        return Condition(name, False, False, note=str(error))
    linear = SequentialController.of(K, allow_unstable=True)
    if not limited.limited:
        raise ModelError(f"umin = {umin}, umax = {umax} limit nothing; pass finite limits, or leave them away")
    if (limited.umin >= 0).any() or (limited.umax <= 0).any():
        raise ModelError(f"umin = {limited.umin.tolist()}, umax = {limited.umax.tolist()}; zero must lie between them")
    if G.D.any():
        return Condition(name, False, note=DIRECT)
    if not is_stable(P.close(K)):
        return Condition(name, False, False, note=UNSTABLE)
    samples, covered = horizon(P, K)
    if not covered:
        return Condition(name, False, note="cannot be told" + short(samples))
    displaced = overload * starts(G, K, np.minimum(limited.umax, -limited.umin))
    signs = (1,) if np.array_equal(limited.umax, -limited.umin) else (1, -1)  # a loop with like limits is odd
    if not len(displaced):
        return Condition(name, True, note="no state to displace that the controller answers", required=False)
    peaks = np.max([simulate(G, linear, x, samples).peaks() for x in displaced], axis=0)
    left = {
        f"{'-+'[sign > 0]}x{int(np.flatnonzero(x)[0])}": simulate(G, limited, sign * x, samples).left(peaks)
        for sign in signs
        for x in displaced
    }
    failed = [start for start, part in left.items() if part > RETURNED]
    worst = max(left, key=lambda start: left[start])
    ending = (
        f"not back after {samples} samples from {', '.join(failed)}, where {_part(left[worst])} of the linear loop's "
        f"peaks is left from {worst}; at most {RETURNED:g} is required" if failed else f"back within {samples} samples"
    )  # fmt: skip
    note = f"{len(left)} starts that ask {overload:g} times the limits, {ending}"
    return Condition(name, not failed, not failed, note=note)


def _part(left: float) -> str:
    """What is left of a peak, in words."""
    return "more than numbers hold" if np.isinf(left) else f"{left:.3g}"
