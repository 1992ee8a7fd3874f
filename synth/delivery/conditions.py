"""The lines of the acceptance gate: what is asked, what a loop was found to do, and by how much it misses.

A line passes, fails, or is "not judged" where nothing can be said, with the reason. What fails says in its note what
was found beside what is required.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from synth.analysis.norms import is_stable, verify
from synth.analysis.sampleddata import SampledNorm
from synth.analysis.stabilitymargins import Margins
from synth.checks import as_number
from synth.errors import SynthError
from synth.proof.boxcertificate import BoxCertificate
from synth.synthesis.remarks import BETWEEN
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

EXACT = 1.01  # ratio of the norm up to which it is called kept, as in `hinfsyn`
ROUNDED = 1e-2  # of the commands' peaks, that rounding may move them by
NO_LEVEL = "no level is known; give one (level=) and the norm is judged"
RATIOS = ("delay_ratio", "intersample_ratio", "rounding_ratio", "box_gain_ratio")


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
    rounding_ratio: float | None = ROUNDED  # proved bound of what rounding does to the commands, of their peaks
    box_margin: float | None = 1.0  # size, of the box of an uncertain plant, up to which the loop is proved stable
    box_gain_ratio: float | None = None  # of the norm to the level, at every point of the box

    def __post_init__(self):
        for name, value in vars(self).items():
            if name == "ratio" or (value is not None and name in RATIOS):
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
    certificate: BoxCertificate | None = field(default=None, compare=False, repr=False)  # of what is proved over a box

    @property
    def verdict(self) -> str:
        """In one word."""
        if self.passed is None:
            return "not judged"
        return ("pass" if self.required else "-") if self.passed else "FAIL"


def measured(
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
    ratio = None if level is None else over(norm, level)
    if limit is None or (ratio is not None and ratio <= limit):
        return Condition(name, True, True, norm, ratio, note)
    if ratio is None:
        return Condition(name, None, True, norm, note=NO_LEVEL)
    return Condition(name, False, True, norm, ratio, missed(ratio, limit))


def missed(ratio: float, limit: float) -> str:
    """By how much a norm is too large."""
    return f"{ratio:.4g} times the level; at most {limit:g} is required"


def between(found: SampledNorm, level: float | None, limit: float | None) -> Condition:
    """What the loop does at all times."""
    name, norm, note = "between the samples", found.upper, ""
    if not np.isfinite(norm):
        return Condition(name, False, False, note="the loop is unstable")
    ratio = None if level is None else over(norm, level)
    passed = True if limit is None else None if ratio is None else ratio <= limit
    if limit is not None and not passed:
        note = NO_LEVEL if ratio is None else missed(ratio, limit)
    return Condition(name, passed, True, norm, ratio, note)


def over(norm: float, level: float) -> float:
    """Their ratio, one where both are zero."""
    return norm / level if level > 0 else np.inf if norm > 0 else 1.0


def margins_kept(found: Margins | None, required: Requirements, reason: str) -> Iterator[Condition]:
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
            yield Condition(name, False if least else None, note=f"not measured: {reason}", required=bool(least))
            continue
        text = f"{value:.4g} {unit}".strip() + f" ({meaning})" + (f"; required {least:g}" if least else "")
        yield Condition(name, not least or value >= least, note=text, required=bool(least))
