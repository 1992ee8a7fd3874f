"""H2 norm on the blocks of a loop: the covariance of z for white noise of covariance one in w is at most a W.

    [ P   AG   B   ]            [ W   CG   D   ]
    [ .   S    0   ]  >= 0      [ .   S    0   ]  >= 0      S = G + G' - P
    [ .   .    a I ]            [ .   .    a I ]

The H2 norm is at most g where trace W <= g^2 / a. D may have any value. `a` scales P against those of the other
specifications, with which it shares G; alone every value does.

Reference: de Oliveira, Geromel and Bernussou (2002), Int. J. Control 75, 666, theorem 1.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from synth.lmi.loops import Loop
from synth.lmi.solve import staircase


def covariance(loop: Loop, W: Any, a: Any) -> list[cp.Expression]:
    """The matrices that are positive semidefinite when the covariance of z is at most a W, (nz, nz)."""
    noise = a * np.eye(loop.D.shape[1])
    return [
        staircase([[X, XG, B], [loop.S, 0], [noise]]) for X, XG, B in ((loop.P, loop.AG, loop.B), (W, loop.CG, loop.D))
    ]


def h2(loop: Loop, a: Any, b: Any) -> list[cp.Expression]:
    """The matrices that are positive semidefinite when the square of the loop's H2 norm is at most a b."""
    nz = loop.D.shape[0]
    W = cp.Variable((nz, nz), symmetric=True)
    return [*covariance(loop, W, a), cp.reshape(b - cp.trace(W), (1, 1), order="C")]
