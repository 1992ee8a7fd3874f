"""Transmission zeros: where a transfer matrix loses rank.

The system is reduced, by orthogonal transformations only, to one with the same finite zeros and an invertible direct
term, whose zeros are the eigenvalues of a pencil.

Reference: Emami-Naeini and Van Dooren (1982), Automatica 18, 415.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

RANK = 1e-12  # relative size of what counts as nothing
INFINITE = 1e-12  # |beta| of a generalised eigenvalue at infinity, relative to its |alpha| and to the largest


def transmission_zeros(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Finite transmission zeros of (A, B, C, D), complex; none for a transfer matrix without full normal rank."""
    M = np.block([[A, B], [C, D]])
    tolerance = RANK * float(np.linalg.norm(M) or 1.0)
    A, B, C, D = _reduced(A, B, C, D, tolerance)  # D has full row rank
    A, B, C, D = _reduced(A.T, C.T, B.T, D.T, tolerance)  # and full column rank: it is invertible
    n = len(A)
    if n == 0 or (D.size == 0 and (B.size or C.size)):
        return np.zeros(0, complex)
    if D.size == 0:
        return np.linalg.eigvals(A).astype(complex)
    M = np.block([[A, B], [C, D]])
    N = sla.block_diag(np.eye(n), np.zeros_like(D))
    # the columns that [C D] leaves free hold the zeros
    _, _, V = np.linalg.svd(M[n:])
    W = V[len(D) :].T
    alpha, beta = np.asarray(sla.eigvals(M[:n] @ W, N[:n] @ W, homogeneous_eigvals=True))
    finite = np.abs(beta) > INFINITE * np.maximum(np.abs(alpha), np.abs(beta).max(initial=0.0))
    return alpha[finite] / beta[finite]


def _reduced(A, B, C, D, tolerance: float):
    """The same zeros with a D of full row rank and fewer states."""
    while True:
        n, p = len(A), len(D)
        U, s, _ = np.linalg.svd(D) if D.size else (np.eye(p), np.zeros(0), None)
        rank = int(np.sum(s > tolerance))
        C, D = U.T @ C, U.T @ D
        C1, D1, C2 = C[:rank], D[:rank], C[rank:]
        if not len(C2):
            return A, B, C1, D1
        _, s, V = np.linalg.svd(C2) if n else (None, np.zeros(0), np.eye(0))
        seen = int(np.sum(s > tolerance))
        if seen == 0:
            return A, B, C1, D1
        # x = V' [seen; hidden]: the outputs C2 are zero only while the seen states are, which leaves their equations
        T = np.vstack([V[seen:], V[:seen]]).T  # hidden first
        A, B, C1 = T.T @ A @ T, T.T @ B, C1 @ T
        h = n - seen
        A, B, C, D = A[:h, :h], B[:h], np.vstack([C1[:, :h], A[h:, :h]]), np.vstack([D1, B[h:]])
