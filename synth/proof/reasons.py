"""Why a plant may have no provable lower bound: only what is really there is named.

A strict inequality of control asks that [A - z I, B2; C1, D12] keeps its column rank all along the stability boundary,
infinity included in continuous time; of estimation the same of the dual plant. Where the rank is lost, the optimum is
approached but not attained, and sub-solutions come near the truth only in the limit.
"""

from __future__ import annotations

import numpy as np

from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import rescaled, state_scales
from synth.systems.zeros import transmission_zeros

LOST = 1e-10  # relative singular value of a rank that is lost, each row and column of length one
NEAR = 1e-6  # relative distance from the boundary within which a zero is looked at


def obstacles(P: GeneralizedPlant) -> list[str]:
    """Zeros of the plant on its stability boundary, from u to z and from w to y, in words."""
    _, nw, _, nz, _ = P.sizes
    A, B, C, D = rescaled(P.system.matrices, state_scales(P.system.matrices))
    control = A, B[:, nw:], C[:nz], D[:nz, nw:]
    estimation = A.T, C[nz:].T, B[:, :nw].T, D[nz:, :nw].T
    found = []
    for way, name, side in (("u to z", "D12", control), ("w to y", "D21", estimation)):
        if (ways := _normal_rank(*side)) < side[1].shape[1]:
            found.append(f"from {way} only {ways} of {side[1].shape[1]} ways are independent, at any frequency")
            continue
        if P.dt == 0 and (rank := _rank(side[-1])) < side[-1].shape[1]:
            found.append(f"from {way} a zero at infinity ({name} has rank {rank} of {side[-1].shape[1]})")
        found += [f"from {way} a zero at {point:.6g} rad/s" for point in _boundary_zeros(*side, P.dt)]
    return found


def _normal_rank(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> int:
    """Rank of the transfer matrix but at its zeros."""
    s = np.exp(1j) * (1.0 + np.abs(np.linalg.eigvals(A)).max(initial=0.0))  # no pole, and hardly a zero
    return _rank(C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D)


def _rank(D: np.ndarray) -> int:
    """Rank of a matrix with columns of length one, or zero."""
    size = np.linalg.norm(D, axis=0)
    sigma = np.linalg.svd(D / np.where(size > 0, size, 1.0), compute_uv=False)
    return int(np.sum(sigma > LOST))


def _boundary_zeros(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, dt: float) -> list[float]:
    """Frequencies in rad/s, not negative, at which the columns of the system matrix are dependent."""
    values = np.concatenate([transmission_zeros(A, B, C, D), np.linalg.eigvals(A)])
    if dt:
        near = values[np.abs(np.abs(values) - 1) <= NEAR]
        points = np.abs(np.angle(near)) / dt
    else:
        size = max(float(np.linalg.norm(A, 2)), 1e-300) if A.size else 1.0
        near = values[np.abs(values.real) <= NEAR * np.maximum(np.abs(values), NEAR * size)]
        points = np.abs(near.imag)
    found: list[float] = []
    for w in sorted(points):
        s = np.exp(1j * w * dt) if dt else 1j * w
        M = np.block([[A - s * np.eye(len(A)), B], [C, D]])
        columns = np.linalg.norm(M, axis=0)
        lost = not columns.all() or np.linalg.svd(M / columns, compute_uv=False)[-1] <= LOST
        if lost and not any(abs(w - v) <= NEAR * w for v in found):
            found.append(float(w))
    return found
