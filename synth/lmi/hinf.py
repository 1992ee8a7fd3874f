"""H-infinity norm below g: the bounded real lemma on the blocks of a loop.

    [ P   AG   B    0   ]
    [ .   S    0    CG' ]  >= 0,   S = G + G' - P
    [ .   .    a I  D'  ]
    [ .   .    .    b I ]      a b = g^2, a = b = g where nothing else shares G

Reference: de Oliveira, Geromel and Bernussou (2002), Int. J. Control 75, 666, theorem 2; with the output-feedback
fillings of `loops.py` these are equations (16) and (20) of Pecorilla and Stesina (2024).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import cvxpy as cp
import numpy as np

from synth.lmi.loops import Loop, OutputFeedback
from synth.lmi.solve import BACKOFF, TOLERANCE, solve, staircase, value
from synth.systems.statespace import StateSpace


def hinf(loop: Loop, a, b=None):
    """The matrix that is positive semidefinite when the square of the loop's H-infinity norm is at most a b.

    b is a where it is left out, the norm itself.
    """
    nz, nw = loop.D.shape
    return staircase([
        [loop.P, loop.AG, loop.B,         0],
        [        loop.S,  0,              loop.CG.T],
        [                 a * np.eye(nw), loop.D.T],
        [                                 (a if b is None else b) * np.eye(nz)],
    ])  # fmt: skip


@dataclass(frozen=True)
class FullOrder:
    """Synthesis with all unknowns in one LMI: minimise the level, then centre a little above it."""

    unknowns: OutputFeedback
    solver: ClassVar[str] = "clarabel"
    tolerance: ClassVar[float] = TOLERANCE
    backoff: ClassVar[tuple[float, ...]] = BACKOFF

    def minimise(self) -> tuple[float, str]:
        """The optimal level and the solver's status."""
        g = cp.Variable()
        status = solve(g, [hinf(self.unknowns.loop, g)])
        return float(value(g)), status

    def controllers(self, level: float) -> Iterator[StateSpace]:
        """The controller at the analytic centre of all unknowns that reach `level`."""
        solve(0, [hinf(self.unknowns.loop, level)])
        yield self.unknowns.controller()
