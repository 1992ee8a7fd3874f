"""Gap and nu-gap: how far two plants are apart as seen by feedback.

With normalised right factors [N; M] = G_i (graph symbols, inner) and the left ones of G2 as Ml, Nl:

    nu-gap   ||Ml N1 - Nl M1||  if det(G2~ G1) has no zero on the unit circle and does not wind around it, else 1
    gap      inf over stable Q of ||G1 - G2 Q||,  the same both ways if the nu-gap is below 1, else 1

The first norm is the largest gap of the two frequency responses on the Riemann sphere. The second is a model matching
problem whose measurement is its disturbance: it is solvable at a level exactly if the game Riccati equation of full
information is, so that the level is bracketed by that equation alone. Continuous plants go through the Cayley map,
which keeps graphs and norms.

References: Vinnicombe (1993), IEEE TAC 38, 1371 (nu-gap); Georgiou (1988), Systems & Control Letters 11, 253, and
Georgiou and Smith (1990), IEEE TAC 35, 673 (gap as model matching).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.coprime import discretised, fastest, left_factors, right_factors
from synth.errors import ModelError
from synth.generalized import GeneralizedPlant
from synth.hinf_riccati import control_riccati
from synth.loopshaping import four_block
from synth.norms import balance, hinfnorm
from synth.precondition import check_assumptions
from synth.statespace import StateSpace, common_timebase

TOLERANCE = 1e-7  # of the gap, absolute


class Gap(NamedTuple):
    """Two distances between plants, 0 <= nugap <= gap <= 1."""

    gap: float
    nugap: float


def gapmetric(G1: Any, G2: Any) -> Gap:
    """Gap and nu-gap of two plants of the same size and timebase.

    A controller with ncfmargin(G1, K) = b stabilises every G2 with nugap < b and has a margin there of at least
    sin(arcsin b - arcsin nugap).

    Parameters
    ----------
    G1, G2 : (p x m) StateSpace, control.StateSpace or (A, B, C, D, dt)

    Returns
    -------
    Gap : unpacks as gap, nugap; absolute accuracy about 1e-7 (nu-gap relative)

    Raises
    ------
    ModelError : sizes or timebases differ.
    AssumptionError : a plant has an unstable mode that is not reached or not seen; its graph would not be the plant.
    NumericalError : a Riccati equation was not solved.

    References: Vinnicombe (1993), IEEE TAC 38, 1371; Georgiou and Smith (1990), IEEE TAC 35, 673.
    """
    G1, G2 = balance(StateSpace.of(G1)), balance(StateSpace.of(G2))
    common_timebase(G1, G2)
    if (G1.ny, G1.nu) != (G2.ny, G2.nu):
        raise ModelError(f"G1 is {G1.ny} x {G1.nu}, G2 is {G2.ny} x {G2.nu}; a gap needs plants of the same size")
    for G in (G1, G2):
        check_assumptions(four_block(G))
    rate = max(fastest(G1), fastest(G2))
    H1, H2 = discretised(G1, rate), discretised(G2, rate)
    R1, R2 = right_factors(H1), right_factors(H2)
    nugap = _nu_gap(R1, R2, left_factors(H2))
    return Gap(1.0 if nugap == 1 else _directed_gap(R1, R2, nugap), nugap)


def _nu_gap(R1: StateSpace, R2: StateSpace, L2: StateSpace) -> float:
    """The nu-gap from right factors of both plants and left factors of the second, all discrete."""
    if not _homotopic(R1, R2):
        return 1.0
    m = R1.nu  # the left factors are [Nl, Ml], the right ones [N; M]
    B, D = np.hstack([L2.B[:, m:], -L2.B[:, :m]]), np.hstack([L2.D[:, m:], -L2.D[:, :m]])
    A = np.block([[R1.A, np.zeros((R1.n, L2.n))], [B @ R1.C, L2.A]])
    psi = StateSpace(A, np.vstack([R1.B, B @ R1.D]), np.hstack([D @ R1.C, L2.C]), D @ R1.D, R1.dt)
    return min(hinfnorm(psi)[0], 1.0)


def _homotopic(R1: StateSpace, R2: StateSpace) -> bool:
    """Whether det(R2~ R1) does not wind around the unit circle: as many zeros inside it as R1 has poles.

    The zeros are generalised eigenvalues of x+ = A1 x + B1 u, q = A2' q+ + C2' v, 0 = B2' q+ + D2' v with
    v = C1 x + D1 u and q+ = lambda q; nothing is inverted.
    """
    n1, n2, m = R1.n, R2.n, R1.nu
    M = np.block([
        [R1.A,            np.zeros((n1, n2)), R1.B],
        [R2.C.T @ R1.C,   -np.eye(n2),        R2.C.T @ R1.D],
        [R2.D.T @ R1.C,   np.zeros((m, n2)),  R2.D.T @ R1.D],
    ])  # fmt: skip
    N = np.block([
        [np.eye(n1),         np.zeros((n1, n2 + m))],
        [np.zeros((n2, n1)), -R2.A.T, np.zeros((n2, m))],
        [np.zeros((m, n1)),  -R2.B.T, np.zeros((m, m))],
    ])  # fmt: skip
    alpha, beta = np.asarray(sla.eigvals(M, N, homogeneous_eigvals=True))
    return int(np.sum(np.abs(alpha) < np.abs(beta))) == n1


def model_matching(R1: StateSpace, R2: StateSpace) -> GeneralizedPlant:
    """The plant z = (R1 - R2 Q) w, with Q as the controller that measures w."""
    n1, n2, m = R1.n, R2.n, R1.nu
    return GeneralizedPlant(
        A=np.block([[R1.A, np.zeros((n1, n2))], [np.zeros((n2, n1)), R2.A]]),
        B1=np.vstack([R1.B, np.zeros((n2, m))]),
        B2=np.vstack([np.zeros((n1, m)), -R2.B]),
        C1=np.hstack([R1.C, R2.C]),
        D11=R1.D,
        D12=-R2.D,
        C2=np.zeros((m, n1 + n2)),
        D21=np.eye(m),
        D22=np.zeros((m, m)),
        dt=R1.dt,
    )


def _directed_gap(R1: StateSpace, R2: StateSpace, low: float) -> float:
    """Infimum over stable Q of ||R1 - R2 Q||, by bisection between the nu-gap and 1."""
    P, high = model_matching(R1, R2), 1.0
    while high - low > TOLERANCE:
        middle = (high + low) / 2
        if control_riccati(P, middle) is None:
            low = middle
        else:
            high = middle
    return high
