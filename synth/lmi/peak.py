"""Peak gain of a loop: the largest |z| for a w of which no sample is larger than one, bounded by an ellipsoid.

    [ P   AG        B   ]           [ g I   CG    D           ]
    [ .   (1-a) S   0   ]  >= 0     [ .     a S   0           ]  >= 0,   S = G + G' - P,  0 < a < 1
    [ .   .         m I ]           [ .     .     (g - m) I   ]

The states stay in an ellipsoid that a decides about, so that this is a bound and not the gain, whatever a; the least
bound is found by a search over a.

Reference: Abedor, Nagpal and Poolla (1996), Int. J. Robust and Nonlinear Control 6, 899.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from synth.lmi.loops import Loop
from synth.lmi.solve import staircase


def peak(loop: Loop, a: float, g: Any, m: Any) -> list[cp.Expression]:
    """The matrices that are positive semidefinite when the peak gain is at most g, for some m."""
    nz, nw = loop.D.shape
    return [
        staircase([[loop.P, loop.AG, loop.B], [(1 - a) * loop.S, 0], [m * np.eye(nw)]]),
        staircase([[g * np.eye(nz), loop.CG, loop.D], [a * loop.S, 0], [(g - m) * np.eye(nw)]]),
    ]
