"""What every file says of a controller in the same words: what it reads with which sign, when, and within which limits.

A minus sign or a sample that a file leaves to the reader is how good controllers fail on the bench.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

ERROR = "e = r - y, u = K e: its input is the error e, the reference less the measurement"
MEASURED = "u = K y on the measured output, positive feedback: its input is the measurement y"
UNTOLD = "u = K y; whether y is the measurement or the error r - y was not told with the controller"
PREDICTIVE = (
    "u = mpc(y, r): y is the state as measured or estimated, r the state to go to, and no error is formed outside; "
    "u is what acts on the plant"
)
PLANNED = "umin <= u <= umax, which the plan knows and no command exceeds"
SOFT = "soft ones, which the plan keeps wherever they can be kept: "
REGULATED = (
    "u = -K(y) x: the measurement y is of the body relative to its target, which is the error already; x is regulated "
    "to zero, there is no r"
)
CLIPPED = "u = min(max(v, umin), umax) with v = C x + D y"
CONDITIONED = "the states learn of what was cut off, x+ = A x + B y + L (u - v)"
UNCONDITIONED = "the states go on as if nothing had been cut off"


def sign(y: Sequence[str], *, shaped: bool = False) -> str:
    """The sign of a design's controller: it reads errors where the plant's measurements are named so.

    Parameters
    ----------
    y : names of the plant's measurements; `GeneralizedPlant.tracking`, `four_block` and `augw` call theirs "error ..."
    shaped : of a loop-shaping design, whose plant holds W2 G W1: u = K y closes the loop of G
    """
    return ERROR if not shaped and all(name.startswith("error") for name in y) else MEASURED


def sampling(dt: float, delay: int = 0) -> str:
    """When the controller reads and acts; `delay` in samples."""
    if dt == 0:
        return "continuous time"
    every = "the sampling time, which was not told" if dt is True else f"{dt!r} s"
    if delay:
        late = f"{delay} sampling times later" if delay > 1 else "one sampling time later"
        return f"sample k is read at k times {every}; its command acts {late}, which is planned for, until the next one"
    return (
        f"sample k is read at k times {every}; its command acts from that instant, without time to compute it, until "
        "the next one"
    )


def limits(low: Any, high: Any, conditioned: bool) -> str:
    """What happens to commands beyond their limits, () or (m,)."""
    if not (np.isfinite(low).any() or np.isfinite(high).any()):
        return "none"
    return f"{CLIPPED}; {CONDITIONED if conditioned else UNCONDITIONED}"


def planned_limits(states: bool, momentum: bool) -> str:
    """What a predictive controller does about its limits, and whether it has soft ones."""
    soft = [*(["ymin <= y <= ymax"] if states else []), *(["|momentum| <= hmax"] if momentum else [])]
    return PLANNED + (f"; {SOFT}{', '.join(soft)}" if soft else "")
