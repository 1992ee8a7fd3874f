"""All poles of a loop in a disc with its centre on the real axis.

    [ P   (AG - c G) / r ]
    [ .   S              ]  >= 0,   S = G + G' - P

The map z -> (z - c) / r takes the disc to the unit one, so this says that (A - c I) / r is stable.

Reference: de Oliveira, Geromel and Bernussou (2002), Int. J. Control 75, 666, for stability; Chilali and Gahinet
(1996), IEEE TAC 41, 358, for regions of poles.
"""

from __future__ import annotations

import cvxpy as cp

from synth.lmi.loops import Loop
from synth.lmi.solve import staircase


def disc(loop: Loop, centre: float, radius: float) -> cp.Expression:
    """The matrix that is positive semidefinite when all poles are in the disc."""
    return staircase([[loop.P, (loop.AG - centre * loop.G) / radius], [loop.S]])
