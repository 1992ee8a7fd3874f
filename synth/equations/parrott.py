"""Parrott's theorem: how far a direct term alone can bring the gain of D11 + D12 Q D21 down, and the Q that does.

D12 does not reach the directions U2 of z, D21 does not see the directions V2 of w, so no Q, static or not, goes below

    gamma_0 = max(|U2' D11|, |D11 V2|).

In bases [U1, U2] and [V1, V2] of z and w, with D11 = [[E11, E12], [E21, E22]] and E22 = sum of l_i s_i r_i', some Q
reaches every gamma >= gamma_0:

    U1' D12 Q D21 V1 = -E11 - sum of E12 r_i l_i' E21 s_i / (gamma^2 - s_i^2)

Where gamma = s_i both E12 r_i and l_i' E21 vanish, and so does the term.

References: Parrott (1978), J. Functional Analysis 30, 311; Davis, Kahan and Weinberger (1982), SIAM J. Numerical
Analysis 19, 445, theorem 1.2; Zhou, Doyle and Glover (1996), Robust and Optimal Control, theorem 2.21.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synth.systems.generalized import GeneralizedPlant

RANK = 1e-12  # relative, of the singular values of D12 with columns (D21 with rows) of length one
ROUNDING = 1e-15  # relative, of gamma^2 - s^2


class Reach(NamedTuple):
    """What a matrix D reaches."""

    U1: np.ndarray  # orthonormal basis of its range
    U2: np.ndarray  # ... and of what is left
    R: np.ndarray  # D R = U1


def reach(D: np.ndarray) -> Reach:
    """The range of D (p, m), whose columns may have any units."""
    length = np.linalg.norm(D, axis=0)
    length = np.where(length > 0, length, 1.0)
    U, s, Vt = np.linalg.svd(D / length)
    k = int(np.sum(s > RANK * s.max(initial=0.0)))
    return Reach(U[:, :k], U[:, k:], Vt[:k].T / s[:k] / length[:, None])


def parrott(P: GeneralizedPlant) -> float:
    """Level below which no controller can go, whatever its direct term: the parts of D11 out of reach of u and y."""
    return max(float(np.linalg.norm(M, 2)) for M in parrott_parts(P))


def parrott_parts(P: GeneralizedPlant) -> tuple[np.ndarray, np.ndarray]:
    """The part of D11 out of reach of u, and the part out of reach of y, each (nz, nw)."""
    U2, V2 = reach(P.D12).U2, reach(P.D21.T).U2
    return U2 @ (U2.T @ P.D11), (P.D11 @ V2) @ V2.T


def direct_term(P: GeneralizedPlant, gamma: float) -> np.ndarray:
    """Q (nu, ny) with |D11 + D12 Q D21| <= gamma, for a gamma not below `parrott`."""
    u, y = reach(P.D12), reach(P.D21.T)
    E = np.hstack([u.U1, u.U2]).T @ P.D11 @ np.hstack([y.U1, y.U2])
    i, j = u.U1.shape[1], y.U1.shape[1]
    X = -E[:i, :j]
    if gamma > 0 and E[i:, j:].size:
        left, s, right = np.linalg.svd(E[i:, j:] / gamma, full_matrices=False)
        room = np.maximum((1 - s) * (1 + s), ROUNDING)
        X = X - (E[:i, j:] @ right.T) * (s / room) @ (left.T @ (E[i:, :j] / gamma))
    return u.R @ X @ y.R.T
