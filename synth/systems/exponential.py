"""The matrix exponential, also where SciPy's is wrong.

SciPy takes the entries beside the diagonal of a large triangular matrix from (e^a - e^b) / (a - b), which is nothing
but rounding where a and b are nearly equal: for a = b (1 + 2e-16) it returns zero for them (seen in 1.17). A triangular
matrix with such a diagonal is balanced and put beside a rotation, so that it is not taken for one.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import scipy.linalg as sla

ALIKE = 1.0  # neighbours on the diagonal that are nearer than that, but not equal


def expm(M: np.ndarray) -> np.ndarray:
    """e^M, (n, n); not finite beyond what doubles hold, without a warning: models check what they are made of."""
    with np.errstate(all="ignore"):
        return _expm(M)


def _expm(M: np.ndarray) -> np.ndarray:
    beside = np.abs(np.diff(np.diag(M)))
    if not (np.any((beside > 0) & (beside < ALIKE)) and (not np.tril(M, -1).any() or not np.triu(M, 1).any())):
        return np.asarray(sla.expm(M))
    found = cast("tuple[np.ndarray, tuple[np.ndarray, Any]]", sla.matrix_balance(M, permute=False, separate=True))
    balanced, scale, n = found[0], found[1][0], len(M)
    E = np.asarray(sla.expm(sla.block_diag(balanced, [[0.0, 1e-3], [-1e-3, 0.0]])))[:n, :n]
    E = E * scale[:, None] / scale
    return np.triu(E) if not np.tril(M, -1).any() else np.tril(E)
