"""Eigenvalues, and how far rounding may have moved each of them."""

from __future__ import annotations

from typing import cast

import numpy as np
import scipy.linalg as sla

ROUNDED = 1e-14  # of the entries of a matrix
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
    return values, ROUNDED * moved / np.maximum(angles, DEFECTIVE)


def crosses(A: np.ndarray, *, discrete: bool) -> bool:
    """True when an eigenvalue may lie on either side of the stability boundary, for all that double precision knows."""
    values, doubt = doubts(A)
    return bool(np.any(np.abs(1 - np.abs(values) if discrete else np.real(values)) <= doubt))
