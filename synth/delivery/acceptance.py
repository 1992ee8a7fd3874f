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
    float32 numbers       every coefficient rounded to single precision (or to fixed point), exact arithmetic
    float32 arithmetic    simulated beside float64, both as the exported C steps: largest difference of the commands
    rounding (float32)    proved bound (`rounding`) of the commands' difference from exact arithmetic over any time, in
                          the loop while |w| <= 1, over the peaks that the commands have then
    saturation            simulated from displaced plant states, scaled so that the linear loop asks `overload` times
                          the limits at its peak; measurements and commands must come back below 1 % of their peaks
    ... over the box      of an uncertain plant: stability, gain, and the margins required, proved at every point of the
                          box of its parameters (see `synth.delivery.boxconditions`)

Saturation is judged by these simulations alone: they refute a controller, and prove nothing about other starts.

The margins asked by default are a sample of delay, without which the schedule of a processor decides on stability, and
a disk of alpha = 0.34: gains from -3 to +3 dB and phases up to 19 deg at any time in every channel at once, half of the
6 dB that a flight loop should bear in one channel. By theorem 1 of the reference a loop of one channel that has less
has a peak of |S - T| above 5.9, and some gain and phase that small make it unstable.

Reference: Seiler, Packard and Gahinet (2020), An Introduction to Disk Margins, IEEE Control Systems 40(5), 78.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from synth.analysis.coprime import gang_of_four
from synth.analysis.sampleddata import intersample
from synth.analysis.stabilitymargins import Margins, margins
from synth.checks import as_choice, as_limits, as_number, check_period, shown, timebase_told
from synth.delivery.boxconditions import over_box
from synth.delivery.conditions import NO_LEVEL, Condition, Requirements, between, margins_kept, measured
from synth.delivery.processor import PRECISIONS, in_numbers, inner, saturation
from synth.delivery.rounding import bounds
from synth.errors import ModelError, SynthError
from synth.proof.boxcertificate import BoxCertificate
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.fixed import FORMATS
from synth.regulators.sequential import controller_of
from synth.synthesis.design import Design
from synth.synthesis.info import SAMPLED
from synth.systems.connect import delayed, input_delay
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system, common_timebase
from synth.systems.timebase import retimed
from synth.systems.uncertain import UncertainSystem
from synth.threads import one_thread

HELD = "part of the discrete plant as it was modelled: nothing to measure"
FORMS = ("controller", "fmu")
LAG = "outputs are seen one sampling time after the inputs"
SAMPLES = "at the samples; the level is that of all times, judged below"


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
        """The conditions that nothing can be said about, such as norms where no level is known."""
        return tuple(c for c in self.conditions if c.passed is None)

    @property
    def verdict(self) -> str:
        """In one line, for the files of the controller."""
        unknown = [c for c in self.not_judged if c.note == NO_LEVEL]
        others = [c for c in self.not_judged if c.note != NO_LEVEL]
        failed, unknown, others = (", ".join(c.name for c in lines) for lines in (self.failed, unknown, others))
        text = f"{f'NOT accepted ({failed})' if failed else 'accepted'} at {self.period}"
        text += f"; not judged, no level known: {unknown}" if unknown else ""
        return text + (f"; not judged: {others}" if others else "")

    @property
    def certificates(self) -> dict[str, BoxCertificate]:
        """What proves the lines about the box of an uncertain plant, by the name of the line."""
        return {c.name: c.certificate for c in self.conditions if c.certificate is not None}

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
    precision: str = "float32",
    inputs: Any = None,
) -> Acceptance:
    """Measure a controller as it leaves: hold, delay, single precision, saturation and margins.

    Parameters
    ----------
    design : Design, or a controller u = K y (positive feedback) that comes without a plant: a state-space system, or
        an `AntiWindup` with the limits and the gain that it has
    plant : GeneralizedPlant to measure it on, for a discrete controller also the continuous one; None for the design's
        own. On a loop-shaping design's own plant W2 G W1 it is Ks that is measured, since the file does not hold G;
        with a plant it is W1 Ks W2. Or an UncertainSystem from (w, u) to (z, y) or from u to y, whose box adds lines;
        the others are at its nominal parameters: from u to y on the design's own plant, or gang_of_four(G) without one
    level : the norm that was promised on this plant; None for gamma of a design on its own plant, and for none
        otherwise: then no line that compares with it is judged
    dt : sampling time in s of a continuous design, which is needed: conditions of a processor are those of samples
    umin, umax : number or (m,) limits of the commands; None leaves saturation out
    antiwindup : (n, m) gain of the exported controller, see `export`
    overload : peak demand of the linear loop in the saturated simulations, over the limits
    requirements : see `Requirements`
    precision : of the exported numbers: "float32", "double", or words of fixed point, "q15" or "q31"
    inputs : number or (p,) bound of |y|, unit of y, under which rounding is bounded and by which fixed point is scaled,
        as in `export`; None for what y and u reach in the loop while every |w| is at most 1
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
    as_choice("precision", precision, PRECISIONS)
    if isinstance(design, AntiWindup):
        if not (umin is None and umax is None and antiwindup is None):
            raise ModelError("umin, umax or antiwindup is given, but an AntiWindup has its own; leave them away")
        umin, umax, antiwindup = design.umin, design.umax, design.L
    if precision in FORMATS and antiwindup is not None:
        raise ModelError(f"antiwindup is given, and precision is {precision!r}: fixed point has none; leave one away")
    P, K, gamma = _loop(design, plant)
    inputs = None if inputs is None else bounds("inputs", inputs, K.nu)
    level = gamma if level is None else as_number("level", level, "the norm that was promised, or None", above=0)
    overload = as_number("overload", overload, "a number above 1, or the commands would not saturate", above=1)
    if not isinstance(requirements, Requirements):
        raise ModelError(f"requirements is {shown(requirements)}; pass Requirements(...), or None for the defaults")
    if isinstance(design, Design) and design.shaping and plant is None and not (umin is None and umax is None):
        raise ModelError(
            "umin and umax limit the command u, but the file of a loop-shaping design holds the shaped plant W2 G W1 "
            "only; pass the plant (gang_of_four(G)) as well"
        )
    at_all_times = isinstance(design, Design) and P is design.plant and design.info.method == SAMPLED
    first = measured("designed", P, K, level, None if at_all_times else requirements.ratio)
    lines, continuous = [first], P.dt == 0
    if P.dt == 0:
        if dt is None:
            raise ModelError("the design is continuous; pass dt, the sampling time in s at which it will run")
        P, K = sampled(P, dt), c2d(K, dt, "tustin")
        lines.append(measured("zero-order hold", P, K, level, None, "sampled, w held; controller by Tustin"))
    else:
        if dt is not None and not np.isclose(dt, P.dt):
            raise ModelError(f"dt = {shown(dt)} is given, but the design has {timebase_told(P.dt)}; leave dt away")
        lines.append(Condition("zero-order hold", True, note=HELD, required=False))
    if at_all_times:  # whose level is not that of the samples
        lines[0] = replace(first, passed=first.norm is not None, ratio=None, note=first.note or SAMPLES, required=False)
    norm = intersample(P, K, P.dt if form == "fmu" else 0.0)
    if form == "fmu":
        P = lagging(P)
        lines.append(measured("co-simulation unit", P, K, level, requirements.delay_ratio, LAG))
    held = next((c.norm for c in reversed(lines) if c.norm is not None), None)
    as_it_is = all(c.stable is not False for c in lines)
    if norm is not None:
        limit = requirements.ratio if at_all_times else requirements.intersample_ratio
        limit = requirements.delay_ratio if form == "fmu" else None if continuous else limit
        lines.append(between(norm, level, limit))
    lines.append(measured("one sample of delay", P, delayed(K), level, requirements.delay_ratio))
    lines += in_numbers(precision, P, K, level, held, requirements, inputs, _largest(umin, umax, K.ny))
    if umin is not None or umax is not None:
        lines.append(saturation(P, K, umin, umax, antiwindup, overload))
    found, reason = None, "the loop is unstable"
    if as_it_is:
        try:
            found = margins(inner(P), K, sign=1)
        except SynthError as error:
            reason = str(error)
    lines += margins_kept(found, requirements, reason)
    if isinstance(plant, UncertainSystem):
        lines += over_box(plant, delayed(K) if form == "fmu" else K, level, requirements)
    return Acceptance(tuple(lines), found, level, P.dt, controller_of(design).digest())


def _loop(design: Any, plant: Any) -> tuple[GeneralizedPlant, StateSpace, float | None]:
    """The plant, the controller that closes it, and the level it was designed for (on its own plant)."""
    if isinstance(design, Design) and plant is None:
        return design.plant, design.closing, design.gamma
    K = controller_of(design) if isinstance(design, Design | AntiWindup) else as_system(
        "the controller", design, getattr(plant, "dt", 0)
    )  # fmt: skip
    if isinstance(plant, UncertainSystem):
        if isinstance(design, Design) and not design.shaping and (plant.nu, plant.ny) == (K.ny, K.nu):
            return design.plant, K, design.gamma
        plant = _nominal(plant, K)
    if not isinstance(plant, GeneralizedPlant):
        raise ModelError(
            "the controller comes without a plant; pass a GeneralizedPlant (gang_of_four(G) for a plain G)"
        )
    if plant.dt == 0 and K.discrete and K.dt is not True:
        plant = c2d(plant, K.dt)
    dt = common_timebase(plant.system, K)
    plant, K = retimed(plant, dt), retimed(K, dt)
    _, _, m, _, p = plant.sizes
    if (K.ny, K.nu) != (m, p):
        raise ModelError(f"the controller is {K.ny} x {K.nu}; the plant needs {m} x {p} (controls x measurements)")
    if isinstance(design, Design) and not design.shaping and plant.system.digest() == design.plant.system.digest():
        return plant, K, design.gamma
    return plant, K, None


def _nominal(plant: UncertainSystem, K: StateSpace) -> GeneralizedPlant:
    """The plant at its nominal parameters, the four-block problem of one from u to y."""
    G = plant.nominal
    return gang_of_four(G) if (G.nu, G.ny) == (K.ny, K.nu) else GeneralizedPlant.partition(G, K.nu, K.ny)


def _largest(umin: Any, umax: Any, size: int) -> np.ndarray | None:
    """Bounds (m,) of |u| by limits on both sides; None where one is missing."""
    low, high = (
        as_limits(name, free if limit is None else limit, size)
        for name, limit, free in (("umin", umin, -np.inf), ("umax", umax, np.inf))
    )
    found = np.maximum(np.abs(low), np.abs(high))
    return found if np.isfinite(found).all() and (found > 0).all() else None


def sampled(P: GeneralizedPlant, dt: float) -> GeneralizedPlant:
    """A continuous plant with all inputs held over `dt` s and all outputs sampled."""
    return c2d(P, dt)


def lagging(P: GeneralizedPlant) -> GeneralizedPlant:
    """A discrete plant whose commands u act one sample later."""
    _, nw, m, _, p = P.sizes
    check_period("the controller", P.dt)
    late = input_delay(P.system, [0.0] * nw + [P.dt] * m)
    return replace(GeneralizedPlant.partition(late, p, m), w=P.w, u=P.u, z=P.z, y=P.y, units=P.units)
