"""Generalised H2 norm on the blocks of a loop: the largest peak of |z| for a w of energy one.

It is that of the largest eigenvalue of the covariance of z, for which see `h2.py`, in place of its trace.

Reference: Wilson (1989), IEEE TAC 34, 94; Scherer, Gahinet and Chilali (1997), IEEE TAC 42, 896.
"""

from __future__ import annotations

from typing import Any

import cvxpy as cp
import numpy as np

from synth.lmi.h2 import covariance
from synth.lmi.loops import Loop


def generalised_h2(loop: Loop, a: Any, b: Any) -> list[cp.Expression]:
    """The matrices that are positive semidefinite when the square of the generalised H2 norm is at most a b."""
    return covariance(loop, b * np.eye(loop.D.shape[0]), a)
