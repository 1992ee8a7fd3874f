"""Unmodelled dynamics: all stable linear systems whose gain stays below a bound or a weight, at every frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.checks import as_number, as_whole, shown
from synth.errors import ModelError
from synth.systems.statespace import StateSpace, as_system


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A full block Delta, stable, with largest singular value at most `bound` |`weight`| at every frequency."""

    name: str
    shape: tuple[int, int]  # outputs, inputs
    bound: float
    weight: StateSpace | None  # of one signal; None for one


def ultidyn(name: str, shape: Any = (1, 1), *, bound: float = 1.0, weight: Any = None) -> Dynamics:
    """Unmodelled linear dynamics, for `worst_gain(loop, dynamics=...)`.

    Parameters
    ----------
    name : how messages call it
    shape : (outputs, inputs)
    bound : of the largest singular value
    weight : what the bound is multiplied with at every frequency: a stable system of one signal, in any form that
        `system` takes, discrete for discrete loops

    Raises
    ------
    ModelError : no name, no sizes, a bound that is not positive, a weight with several signals or an unstable one.

    Reference: the names are those of MATLAB's `ultidyn`.
    """
    if not isinstance(name, str) or not name or not name.isprintable():
        raise ModelError(f"name is {shown(name)}; pass the name of the dynamics, a text such as 'flex'")
    if not isinstance(shape, list | tuple) or len(shape) != 2:
        raise ModelError(f"shape is {shown(shape)}; pass (outputs, inputs)")
    p, m = (as_whole("shape", size, "(outputs, inputs), whole numbers", least=1, most=100) for size in shape)
    bound = as_number("bound", bound, "a positive number")
    if bound <= 0:
        raise ModelError(f"bound is {bound:g}; pass a positive number")
    W = None if weight is None else as_system("weight", weight)
    if W is not None and (W.ny, W.nu) != (1, 1):
        raise ModelError(f"weight is {W.ny} x {W.nu}; pass one of one signal")
    if W is not None and W.n:
        poles = W.poles()
        if not (np.abs(poles) < 1 if W.discrete else np.real(poles) < 0).all():
            raise ModelError("weight is not stable; pass one whose poles are")
    return Dynamics(name, (p, m), bound, W)
