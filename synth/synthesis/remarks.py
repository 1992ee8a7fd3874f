"""What must be said of a design in words: its margins, where they are poor, and a level that no controller changes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from synth.analysis.sampleddata import SampledNorm
from synth.analysis.stabilitymargins import Margins
from synth.equations.parrott import parrott_parts
from synth.systems.generalized import GeneralizedPlant

LEAST_GAIN = 6.0  # dB
LEAST_PHASE = 30.0  # deg
LEAST_DELAY = 1.0  # samples
BETWEEN = 1.05  # of the norm: what happens between the samples may be that much larger
NEAR_FLOOR = 1.1  # of Parrott's bound: a level up to here is made by the weights


def words(m: Margins) -> str:
    """The margins in one line."""
    delay = f"{m.delay / m.dt:.3g} samples" if m.dt else f"{m.delay:.3g} s"
    return (
        f"gain {m.gain_db:.3g} dB, phase {m.phase_deg:.3g} deg, delay {delay}, "
        f"disk {m.disk_input.alpha:.3g} at the plant's input, {m.disk_output.alpha:.3g} at its output"
    )


def poor(m: Margins | None) -> Iterator[str]:
    """A warning for every margin that is smaller than a flight loop should have."""
    if m is None:
        yield "the margins of its loop could not be measured"
        return
    if m.gain_db < LEAST_GAIN:
        yield f"the gain margin is {m.gain_db:.3g} dB, below {LEAST_GAIN:g} dB"
    if m.phase_deg < LEAST_PHASE:
        yield f"the phase margin is {m.phase_deg:.3g} deg, below {LEAST_PHASE:g} deg"
    if m.dt and m.delay < LEAST_DELAY * m.dt:
        yield f"the delay margin is {m.delay / m.dt:.3g} samples: the loop is unstable with one sample of delay"


def between(norm: SampledNorm | None, gamma: float) -> Iterator[str]:
    """A warning where the loop does more between the samples than at them."""
    if norm is not None and norm.upper > BETWEEN * gamma:
        more = f"{100 * (norm.upper / gamma - 1):.3g} % above gamma" if gamma else "gamma is zero"
        yield (
            f"between the samples the norm is {norm.upper:.4g}, {more}: sample faster, or design for it with "
            "sdhinfsyn(plant.continuous, h)"
        )


def floored(P: GeneralizedPlant, gamma: float) -> Iterator[str]:
    """A warning where the level is one that no controller changes, with the channel whose weight makes it.

    A plant without states has no other level.
    """
    if not len(P.A):
        return
    parts = parrott_parts(P)
    floor = max(float(np.linalg.norm(M, 2)) for M in parts)
    if not floor or gamma > NEAR_FLOOR * floor:
        return
    M = max(parts, key=lambda M: float(np.linalg.norm(M, 2)))
    z, w = np.unravel_index(np.abs(M).argmax(), M.shape)
    yield (
        f"gamma is within {100 * (NEAR_FLOOR - 1):.0f} % of {floor:.4g}, which is the weights' doing and no controller "
        f"changes: {P.w[w]!r} acts directly on {P.z[z]!r}, out of reach of the controls or the measurements; lower "
        "that weight, or let it fall off with frequency, or the level says nothing about the loop"
    )
