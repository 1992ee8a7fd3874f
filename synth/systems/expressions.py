"""Matrices whose entries are polynomials in uncertain parameters."""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.errors import ModelError
from synth.systems.parameters import ZERO, as_expressions


def product(M: np.ndarray, N: np.ndarray) -> np.ndarray:
    """M N of expressions, also without columns and rows between them."""
    out = zeros(M.shape[0], N.shape[1])
    for i, row in enumerate(M):
        for k in (k for k, entry in enumerate(row) if not entry.is_zero):
            for j in (j for j, entry in enumerate(N[k]) if not entry.is_zero):
                out[i, j] = out[i, j] + row[k] * N[k, j]
    return out


def eye(n: int) -> np.ndarray:
    """The identity as expressions."""
    return as_expressions("I", np.eye(n))


def zeros(p: int, m: int) -> np.ndarray:
    """Zeros as expressions."""
    return np.full((p, m), ZERO, object)


def fitted(A: Any, B: Any, C: Any, D: Any) -> tuple[np.ndarray, ...]:
    """Two-dimensional matrices whose sizes agree."""
    A, D = as_expressions("A", A), as_expressions("D", D)
    if A.size == 0:
        D = D.reshape(1, 1) if D.ndim == 0 else D
        if D.ndim != 2 or any(as_expressions(name, M).size for name, M in (("B", B), ("C", C))):
            raise ModelError("A has no entries; of a system without states pass B and C without entries, and D in rows")
        return zeros(0, 0), zeros(0, D.shape[1]), zeros(D.shape[0], 0), D
    A = square("A", A, len(A) if A.ndim else 1)
    n = len(A)
    B, C = as_expressions("B", B), as_expressions("C", C)
    B = B.reshape(n, -1) if B.ndim < 2 and (B.size == n or n == 1) else B
    C = C.reshape(-1, n) if C.ndim < 2 and (C.size == n or n == 1) else C
    for name, M, axis in (("B", B, 0), ("C", C, 1)):
        if M.ndim != 2 or M.shape[axis] != n or not M.size:
            raise ModelError(f"{name} has shape {M.shape}; A is {n} x {n}: pass {'rows' if axis == 0 else 'columns'} "
                             f"for {n} states")  # fmt: skip
    p, m = C.shape[0], B.shape[1]
    if D.ndim == 0 and D[()].is_zero:
        D = zeros(p, m)
    D = D.reshape(p, m) if D.ndim < 2 and D.size == p * m and 1 in (p, m) else D
    if D.shape != (p, m):
        raise ModelError(f"D has shape {D.shape} where {p} x {m} is needed")
    return A, B, C, D


def square(name: str, value: Any, n: int) -> np.ndarray:
    """An (n, n) matrix of expressions."""
    M = as_expressions(name, value)
    M = M.reshape(1, 1) if M.ndim == 0 else M
    if M.shape != (n, n):
        raise ModelError(f"{name} has shape {M.shape} where {n} x {n} is needed")
    return M.copy()
