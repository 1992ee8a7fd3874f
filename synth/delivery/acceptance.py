"""The acceptance gate: the controller as it leaves, measured again under what a processor and actuators do to it.

Every condition closes the loop anew and measures it with the judge of `norms`; the norm is that of the plant's
channels from w to z. Nothing is taken from the synthesis but the level that was promised; where none is known, as of
a bare controller, the norm is reported and "not judged", and the gate rests on stability, rounding and margins.

    designed              the controller as it is in the file
    zero-order hold       a continuous design: plant held, controller by Tustin's method, at the sampling time given
    co-simulation unit    where asked (form="fmu"): outputs come a sample after the inputs, and all lines below see them
                          so: the plant's commands pass a sample of delay
    between the samples   where the continuous plant is known: the norm of `sdhinfnorm`, w that reaches y held
    one sample of delay   the command acts one sample later
    float32 numbers       every coefficient rounded to single precision, exact arithmetic
    float32 arithmetic    simulated beside float64, both as the exported C steps: largest difference of the commands
    saturation            simulated from displaced plant states, scaled so that the linear loop asks `overload` times
                          the limits at its peak; measurements and commands must come back below 1 % of their peaks

Saturation is judged by these simulations alone: they refute a controller, and prove nothing about other starts.

The margins asked by default are a sample of delay, without which the schedule of a processor decides on stability, and
a disk of alpha = 0.34: gains from -3 to +3 dB and phases up to 19 deg at any time in every channel at once, half of the
6 dB that a flight loop should bear in one channel. By theorem 1 of the reference a loop of one channel that has less
has a peak of |S - T| above 5.9, and some gain and phase that small make it unstable.

Reference: Seiler, Packard and Gahinet (2020), An Introduction to Disk Margins, IEEE Control Systems 40(5), 78.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synth.analysis.norms import is_stable, verify
from synth.analysis.sampleddata import SampledNorm, intersample
from synth.analysis.stabilitymargins import Margins, margins
from synth.checks import as_choice, as_number, check_period, shown, timebase_told
from synth.delivery.simulation import RETURNED, horizon, short, simulate, starts
from synth.errors import ExportError, ModelError, SynthError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.sequential import SequentialController, controller_of
from synth.synthesis.design import Design
from synth.synthesis.info import SAMPLED
from synth.synthesis.remarks import BETWEEN
from synth.systems.connect import delayed, input_delay
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system, common_timebase
from synth.systems.timebase import retimed
from synth.threads import one_thread

EXACT = 1.01  # ratio of the norm up to which it is called kept, as in `hinfsyn`
UNSTABLE = "not simulated: the loop is unstable"
DIRECT = "not simulated: the plant has a direct term D22, so that measurement and command would wait for each other"
HELD = "part of the discrete plant as it was modelled: nothing to measure"
FORMS = ("controller", "fmu")
LAG = "outputs are seen one sampling time after the inputs"
SAMPLES = "at the samples; the level is that of all times, judged below"
NO_LEVEL = "no level is known; give one (level=) and the norm is judged"


@dataclass(frozen=True)
class Requirements:
    """What is asked of a controller besides stability under every condition; None, or a margin of 0, asks nothing."""

    ratio: float = EXACT  # of the norm to the level, as designed; in float32 to the norm before rounding, too
    delay_ratio: float | None = None  # ... with one sample of delay
    intersample_ratio: float | None = BETWEEN  # ... between the samples, of a discrete design whose plant c2d sampled
    gain_margin_db: float | None = None  # smallest of all loops, one at a time
    phase_margin_deg: float | None = None  # smallest of all loops, one at a time
    delay_margin_samples: float | None = 1.0  # smallest of all loops, one at a time
    disk_margin: float | None = 0.34  # smaller alpha of plant input and output; see the head of this file
    ncf_margin: float | None = None

    def __post_init__(self):
        for name, value in vars(self).items():
            if name == "ratio" or (value is not None and name in ("delay_ratio", "intersample_ratio")):
                as_number(name, value, "a positive number", above=0)
            elif value is not None:
                as_number(name, value, "a number of at least 0, or None for nothing", least=0)


@dataclass(frozen=True)
class Condition:
    """One line of the gate's table."""

    name: str
    passed: bool | None  # None: not judged
    stable: bool | None = None  # None where it does not apply
    norm: float | None = None  # from w to z, units of the plant
    ratio: float | None = None  # of the norm to the level, if one is known
    note: str = ""
    required: bool = True  # False for what is only reported

    @property
    def verdict(self) -> str:
        """In one word."""
        if self.passed is None:
            return "not judged"
        return ("pass" if self.required else "-") if self.passed else "FAIL"


@dataclass(frozen=True)
class Acceptance:
    """What the gate measured."""

    conditions: tuple[Condition, ...]
    margins: Margins | None  # None for a loop that is unstable or cannot be judged
    level: float | None  # the level that the ratios refer to: the one given, or gamma of the design; None: unknown
    dt: float  # s, sampling time of the loop that was measured
    controller_sha256: str  # of the controller that was put in

    @property
    def passed(self) -> bool:
        """Whether every condition that could be judged is met."""
        return not self.failed

    @property
    def failed(self) -> tuple[Condition, ...]:
        """The conditions that are not met."""
        return tuple(c for c in self.conditions if c.passed is not None and not c.passed)

    @property
    def not_judged(self) -> tuple[Condition, ...]:
        """The conditions that nothing can be said about, for want of a level."""
        return tuple(c for c in self.conditions if c.passed is None)

    @property
    def verdict(self) -> str:
        """In one line, for the files of the controller."""
        failed, unknown = (", ".join(c.name for c in lines) for lines in (self.failed, self.not_judged))
        text = f"{f'NOT accepted ({failed})' if failed else 'accepted'} at {self.period}"
        return text + (f"; not judged, no level known: {unknown}" if unknown else "")

    @property
    def period(self) -> str:
        """The sampling time in words."""
        return "an unspecified sampling time" if self.dt is True else f"a sampling time of {self.dt:g} s"


@one_thread
def accept(
    design: Any,
    plant: Any = None,
    *,
    level: float | None = None,
    dt: float | None = None,
    umin: Any = None,
    umax: Any = None,
    antiwindup: Any = None,
    overload: float = 2.0,
    requirements: Requirements | None = None,
    form: str = "controller",
) -> Acceptance:
    """Measure a controller as it leaves: hold, delay, single precision, saturation and margins.

    Parameters
    ----------
    design : Design, or a controller u = K y (positive feedback) that comes without a plant: a state-space system, or
        an `AntiWindup` with the limits and the gain that it has
    plant : GeneralizedPlant to measure it on, for a discrete controller also the continuous one; None for the design's
        own. On a loop-shaping design's own plant W2 G W1 it is Ks that is measured, since the file does not hold G;
        with a plant it is W1 Ks W2
    level : the norm that was promised on this plant; None for gamma of a design on its own plant, and for none
        otherwise: then no line that compares with it is judged
    dt : sampling time in s of a continuous design, which is needed: conditions of a processor are those of samples
    umin, umax : number or (m,) limits of the commands; None leaves saturation out
    antiwindup : (n, m) gain of the exported controller, see `export`
    overload : peak demand of the linear loop in the saturated simulations, over the limits
    requirements : see `Requirements`
    form : "controller", whose command acts at the instant of its sample, as that of the C code; "fmu" for a
        co-simulation unit, whose command comes one sampling time later

    Returns
    -------
    Acceptance : with one `Condition` per line; nothing is raised for a controller that fails

    Raises
    ------
    ModelError : a continuous design without `dt`, sizes that do not fit, limits or requirements that make no sense.
    """
    requirements = Requirements() if requirements is None else requirements
    as_choice("form", form, FORMS)
    if isinstance(design, AntiWindup):
        if not (umin is None and umax is None and antiwindup is None):
            raise ModelError("umin, umax or antiwindup is given, but an AntiWindup has its own; leave them away")
        umin, umax, antiwindup = design.umin, design.umax, design.L
    P, K, gamma = _loop(design, plant)
    level = gamma if level is None else as_number("level", level, "the norm that was promised, or None", above=0)
    overload = as_number("overload", overload, "a number above 1, or the commands would not saturate", above=1)
    if not isinstance(requirements, Requirements):
        raise ModelError(f"requirements is {shown(requirements)}; pass Requirements(...), or None for the defaults")
    if isinstance(design, Design) and design.shaping and plant is None and not (umin is None and umax is None):
        raise ModelError(
            "umin and umax limit the command u, but the file of a loop-shaping design holds the shaped plant W2 G W1 "
            "only; pass the plant (gang_of_four(G)) as well"
        )
    between = isinstance(design, Design) and plant is None and design.info.method == SAMPLED
    first = _measured("designed", P, K, level, None if between else requirements.ratio)
    lines, continuous = [first], P.dt == 0
    if P.dt == 0:
        if dt is None:
            raise ModelError("the design is continuous; pass dt, the sampling time in s at which it will run")
        P, K = sampled(P, dt), c2d(K, dt, "tustin")
        lines.append(_measured("zero-order hold", P, K, level, None, "sampled, w held; controller by Tustin"))
    else:
        if dt is not None and not np.isclose(dt, P.dt):
            raise ModelError(f"dt = {shown(dt)} is given, but the design has {timebase_told(P.dt)}; leave dt away")
        lines.append(Condition("zero-order hold", first.passed is not False, note=HELD, required=False))
    if between:  # whose level is not that of the samples
        lines[0] = replace(first, passed=first.norm is not None, ratio=None, note=first.note or SAMPLES, required=False)
    norm = intersample(P, K, P.dt if form == "fmu" else 0.0)
    if form == "fmu":
        P = lagging(P)
        lines.append(_measured("co-simulation unit", P, K, level, requirements.delay_ratio, LAG))
    held = next((c.norm for c in reversed(lines) if c.norm is not None), None)
    as_it_is = all(c.stable is not False for c in lines)
    if norm is not None:
        limit = requirements.ratio if between else requirements.intersample_ratio
        limit = requirements.delay_ratio if form == "fmu" else None if continuous else limit
        lines.append(_between(norm, level, limit))
    lines.append(_measured("one sample of delay", P, delayed(K), level, requirements.delay_ratio))
    lines += _single_precision(P, K, level, held, requirements.ratio)
    if umin is not None or umax is not None:
        lines.append(_saturation(P, K, umin, umax, antiwindup, overload))
    found, reason = None, "the loop is unstable"
    if as_it_is:
        try:
            found = margins(inner(P), K, sign=1)
        except SynthError as error:
            reason = str(error)
    digest = controller_of(design).digest()
    return Acceptance((*lines, *_margins(found, requirements, reason)), found, level, P.dt, digest)


def _loop(design: Any, plant: Any) -> tuple[GeneralizedPlant, StateSpace, float | None]:
    """The plant, the controller that closes it, and the level it was designed for (on its own plant)."""
    if isinstance(design, Design) and plant is None:
        return design.plant, design.closing, design.gamma
    if not isinstance(plant, GeneralizedPlant):
        raise ModelError(
            "the controller comes without a plant; pass a GeneralizedPlant (gang_of_four(G) for a plain G)"
        )
    K = design.controller if isinstance(design, Design) else as_system("the controller", design, plant.dt)
    if plant.dt == 0 and K.discrete and K.dt is not True:
        plant = c2d(plant, K.dt)
    dt = common_timebase(plant.system, K)
    plant, K = retimed(plant, dt), retimed(K, dt)
    _, _, m, _, p = plant.sizes
    if (K.ny, K.nu) != (m, p):
        raise ModelError(f"the controller is {K.ny} x {K.nu}; the plant needs {m} x {p} (controls x measurements)")
    own = isinstance(design, Design) and not design.shaping and plant.system.digest() == design.plant.system.digest()
    return plant, K, design.gamma if own else None


def inner(P: GeneralizedPlant) -> StateSpace:
    """What the controller sees of the plant: from u to y."""
    return StateSpace(P.A, P.B2, P.C2, P.D22, P.dt)


def sampled(P: GeneralizedPlant, dt: float) -> GeneralizedPlant:
    """A continuous plant with all inputs held over `dt` s and all outputs sampled."""
    return c2d(P, dt)


def lagging(P: GeneralizedPlant) -> GeneralizedPlant:
    """A discrete plant whose commands u act one sample later."""
    _, nw, m, _, p = P.sizes
    check_period("the controller", P.dt)
    late = input_delay(P.system, [0.0] * nw + [P.dt] * m)
    return replace(GeneralizedPlant.partition(late, p, m), w=P.w, u=P.u, z=P.z, y=P.y, units=P.units)


def _measured(
    name: str, P: GeneralizedPlant, K: StateSpace, level: float | None, limit: float | None, note: str = ""
) -> Condition:
    """Close the loop and let the judge measure it."""
    stable = False
    try:
        closed_loop = P.close(K)
        stable = is_stable(closed_loop)
        norm = verify(closed_loop).norm
    except SynthError as error:
        return Condition(name, False, stable, note=str(error))
    ratio = None if level is None else _over(norm, level)
    if limit is None or (ratio is not None and ratio <= limit):
        return Condition(name, True, True, norm, ratio, note)
    if ratio is None:
        return Condition(name, None, True, norm, note=NO_LEVEL)
    return Condition(name, False, True, norm, ratio, f"at most {limit:g} is required")


def _between(found: SampledNorm, level: float | None, limit: float | None) -> Condition:
    """What the loop does at all times."""
    name, norm, note = "between the samples", found.upper, ""
    if not np.isfinite(norm):
        return Condition(name, False, False, note="the loop is unstable")
    ratio = None if level is None else _over(norm, level)
    passed = True if limit is None else None if ratio is None else ratio <= limit
    if not passed:
        note = NO_LEVEL if ratio is None else f"at most {limit:g} is required"
    return Condition(name, passed, True, norm, ratio, note)


def _over(norm: float, level: float) -> float:
    """Their ratio, one where both are zero."""
    return norm / level if level > 0 else np.inf if norm > 0 else 1.0


def _single_precision(P, K, level, held, limit) -> Iterator[Condition]:
    """Rounded coefficients, then rounded arithmetic; the norm before rounding is `held`."""
    try:
        rounded = SequentialController.of(K, dtype="float", allow_unstable=True)
        exact = SequentialController.of(K, allow_unstable=True)
    except ExportError as error:
        yield Condition("float32 numbers", False, note=str(error))
        return
    numbers = _measured("float32 numbers", P, rounded.system, level, None)
    if numbers.norm is not None and held is not None and numbers.norm > limit * max(held, level or 0.0):
        note = f"{_over(numbers.norm, held):.4g} times the norm before rounding; at most {limit:g} is required"
        numbers = replace(numbers, passed=False, note=note)
    yield numbers
    G = inner(P)
    if G.D.any():
        yield Condition("float32 arithmetic", False, note=DIRECT)
        return
    if not (numbers.stable and is_stable(P.close(K))):
        yield Condition("float32 arithmetic", False, False, note=UNSTABLE)
        return
    samples, covered = horizon(P, K)
    start = starts(G, K, np.ones(K.ny)).sum(axis=0)
    linear, single = simulate(G, exact, start, samples), simulate(G, rounded, start, samples)
    size = np.abs(linear.v).max(axis=0)
    off = float((np.abs(single.v - linear.v).max(axis=0) / np.where(size > 0, size, 1.0)).max())
    fine = off <= RETURNED and (single.returned(linear.peaks()) or not covered)
    note = f"commands differ by at most {off:.1e} of their peaks" + ("" if covered else short(samples))
    yield Condition("float32 arithmetic", fine, fine, note=note)


def _saturation(P, K, umin, umax, antiwindup, overload) -> Condition:
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
    failed = [
        f"{'-+'[sign > 0]}x{int(np.flatnonzero(x)[0])}"
        for sign in signs
        for x in displaced
        if not simulate(G, limited, sign * x, samples).returned(peaks)
    ]
    ending = (
        f"not back after {samples} samples from {', '.join(failed)}" if failed else f"back within {samples} samples"
    )
    note = f"{len(displaced) * len(signs)} starts that ask {overload:g} times the limits, {ending}"
    return Condition(name, not failed, not failed, note=note)


def _margins(found: Margins | None, required: Requirements, reason: str) -> Iterator[Condition]:
    """The margins kept, beside those required."""
    values = {
        "gain margin": (found and found.gain_db, required.gain_margin_db, "dB", "one loop at a time"),
        "phase margin": (found and found.phase_deg, required.phase_margin_deg, "deg", "one loop at a time"),
        "delay margin": (
            found and found.delay / found.dt, required.delay_margin_samples, "samples", "one loop at a time"
        ),
        "disk margin": (found and found.disk, required.disk_margin, "", "alpha, all inputs or all outputs at once"),
        "ncf margin": (found and found.ncf, required.ncf_margin, "", "between 0 and 1"),
    }  # fmt: skip
    for name, (value, least, unit, meaning) in values.items():
        if value is None:
            yield Condition(name, False, note=f"not measured: {reason}")
            continue
        text = f"{value:.4g} {unit}".strip() + f" ({meaning})" + (f"; required {least:g}" if least else "")
        yield Condition(name, not least or value >= least, note=text, required=bool(least))
