"""Eigenvalues, how far rounding may have moved each of them, and those that inputs do not reach."""

from __future__ import annotations

from typing import cast

import numpy as np
import scipy.linalg as sla

ROUNDED = 1e-14  # of the entries of a matrix
LOST = 1e-13  # relative distance to a loss of rank, per state, that rounding explains
DEFECTIVE = 1e-8  # least angle of left and right eigenvectors: of eigenvalues that are double to rounding


def doubts(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of A, (n,) complex, and the doubt about each, (n,): |y'| |A| |x| / |y'x|, parts of rounding.

    y and x are its left and right eigenvectors. Scaling the states by powers of two changes nothing.

    Reference: Golub and Van Loan (2013), Matrix Computations, section 7.2.2.
    """
    if not len(A):
        return np.zeros(0, complex), np.zeros(0)
    values, Y, X = cast("tuple[np.ndarray, ...]", sla.eig(A, left=True))
    angles = np.abs(np.einsum("ij,ij->j", Y.conj(), X))
    moved = np.einsum("ij,ik,kj->j", np.abs(Y), np.abs(A), np.abs(X))
    return values, ROUNDED * np.maximum(moved / np.maximum(angles, DEFECTIVE), np.abs(values))


def crosses(A: np.ndarray, *, discrete: bool) -> bool:
    """True when an eigenvalue may lie on either side of the stability boundary, for all that double precision knows."""
    values, doubt = doubts(A)
    return bool(np.any(np.abs(decay(values, discrete=discrete)) <= doubt))


def decay(values: np.ndarray, *, discrete: bool) -> np.ndarray:
    """How far inside the stability boundary eigenvalues lie: negative outside."""
    return 1 - np.abs(values) if discrete else -np.real(values)


def unreachable(A: np.ndarray, B: np.ndarray, *, discrete: bool) -> tuple[complex, ...]:
    """Modes of A on or outside the stability boundary that B does not reach, up to rounding."""
    n = len(A)
    size = np.linalg.norm(A, 2) or 1.0  # zero for integrators

    values, doubt = doubts(A)

    def persistent(value):
        return decay(value, discrete=discrete) <= doubt[np.abs(values - value).argmin()]

    # rows of U' span the left invariant subspace: U' A = Au U'
    schur = sla.schur(A.T, output="complex", sort=persistent)
    Tr, Z, k = schur[0], schur[1], int(schur[-1])
    Au, Bu = Tr[:k, :k].T, Z[:, :k].T @ B
    gain = np.linalg.norm(B, 2)
    Bu = Bu / gain * size if gain > 0 else Bu  # size / gain overflows for the smallest doubles
    lost = []
    for mode in np.diag(Tr)[:k]:
        s = np.linalg.svd(np.hstack([Au - mode * np.eye(k), Bu]), compute_uv=False)
        if s[-1] <= LOST * n * max(size, 1e-300) and not any(abs(mode - m) <= 1e-6 * abs(mode) for m in lost):
            lost.append(mode)
    clean = [complex(m.real, 0.0 if abs(m.imag) <= 1e-9 * abs(m) else m.imag) for m in lost]
    return tuple(sorted(clean, key=lambda m: (m.real, m.imag)))


def is_lost(A: np.ndarray, B: np.ndarray, mode: complex) -> bool:
    """True when B does not reach a mode of A, up to rounding."""
    size, gain = np.linalg.norm(A, 2) or 1.0, np.linalg.norm(B, 2) or 1.0
    s = np.linalg.svd(np.hstack([A - mode * np.eye(len(A)), B / gain * size]), compute_uv=False)
    return bool(s[-1] <= LOST * len(A) * size)


def unseen(A: np.ndarray, Q: np.ndarray, *, discrete: bool) -> tuple[complex, ...]:
    """Modes of A on the stability boundary, up to rounding, that the symmetric weight Q does not see."""
    values, doubt = doubts(A)

    def on_boundary(mode: complex) -> bool:
        return abs(decay(np.asarray(mode), discrete=discrete)) <= max(
            doubt[np.abs(values - mode).argmin()], abs(values - mode).min()
        )

    return tuple(mode for mode in unreachable(A.T, Q, discrete=discrete) if on_boundary(mode))
