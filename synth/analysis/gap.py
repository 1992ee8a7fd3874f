"""Gap and nu-gap: how far two plants are apart as seen by feedback.

With the normalised right factors G_i = [N; M] (graph symbols, inner) and the left ones Ml, Nl of the second plant:

    nu-gap   ||P||, P = Ml N1 - Nl M1,  if det(G2~ G1) has no zero on the unit circle and no winding number, else 1
    gap      inf over stable Q of ||G1 - G2 Q||,  the same both ways if the nu-gap is below 1, else 1

P is the gap of the frequency responses on the Riemann sphere. Since [G2~; P] maps G1 - G2 Q to [G2~ G1 - Q; P]
isometrically, a level g above ||P|| is reached exactly if Nehari's problem for G2~ G1 W^-1 is solvable at one, with
W~ W = g^2 I - P~ P: if the Hankel norm of its anticausal part is at most one. That norm falls smoothly with g.
Continuous plants go through the Cayley map, which keeps graphs and norms.

References: Vinnicombe (1993), IEEE TAC 38, 1371 (nu-gap); Georgiou (1988), Systems & Control Letters 11, 253, and
Georgiou and Smith (1990), IEEE TAC 35, 673 (gap); Francis (1987), A Course in H-infinity Control Theory, chapter 8
(two-block problem by spectral factor and Hankel norm).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.coprime import balanced, gang_of_four, left_factors, right_factors, solutions
from synth.analysis.delayedmargins import approximant
from synth.analysis.norms import hinfnorm, in_principal_axes, spectral_radius
from synth.analysis.precondition import check_assumptions
from synth.checks import as_array, as_number, shown
from synth.equations.doubling import is_positive, solve_riccati
from synth.errors import ModelError, NumericalError
from synth.systems.connect import input_delay, series
from synth.systems.sampled import loop_rate, on_circle
from synth.systems.statespace import StateSpace, as_systems, repeated
from synth.systems.uncertain import UncertainSystem

TOLERANCE = 1e-9  # of the gap, absolute
FIRST, LONG, LEVELS = 1e-2, 0.1, 6  # gain below which an approximant is no delay: to begin with, of long ones; tries
MOST_VERTICES, SAMPLES = 5, 8  # parameters whose vertices are models of a box, and samples besides


class Gap(NamedTuple):
    """Two distances between plants, 0 <= nugap <= gap <= 1."""

    gap: float
    nugap: float


def gapmetric(G1: Any, G2: Any, *, delay: float = 0.0) -> Gap:
    """Gap and nu-gap of two plants of the same size and timebase.

    A controller with ncfmargin(G1, K) = b stabilises every G2 with nugap < b and has a margin there of at least
    sin(arcsin b - arcsin nugap).

    Parameters
    ----------
    G1, G2 : (p x m) plants, in any form that `system` takes
    delay : s, by which the inputs of G2 act later than those of G1 (negative: earlier); a delay that both have changes
        nothing. In discrete time whole samples. In continuous time an approximant, off by 1e-9 at most where a plant
        has the gain that it needs for the nu-gap: that stays exact to 2e-9, the gap is within 0.02 (0.2 for delays that
        are long beside the time a plant takes), or 0.8 nu-gaps if that is less

    Returns
    -------
    Gap : unpacks as gap, nugap. The nu-gap has a relative accuracy of 1e-7, the gap an absolute one of 1e-7, but
        5e-6 where it is itself below 1e-4: equal plants are found that far apart

    Raises
    ------
    ModelError : sizes or timebases differ; the delay is of a continuous plant that does not roll off, or of a discrete
        one and no whole number of samples.
    AssumptionError : a plant has an unstable mode that is not reached or not seen; its graph would not be the plant.
    NumericalError : a Riccati equation was not solved; the delay is too long for an approximant.

    References: Vinnicombe (1993), IEEE TAC 38, 1371; Georgiou and Smith (1990), IEEE TAC 35, 673.
    """
    G1, G2 = as_systems(G1=G1, G2=G2)
    if (G1.ny, G1.nu) != (G2.ny, G2.nu):
        raise ModelError(f"G1 is {G1.ny} x {G1.nu}, G2 is {G2.ny} x {G2.nu}; a gap needs plants of the same size")
    late = as_number("delay", delay, "the time in s by which G2 acts later than G1")
    if late:
        return _late(G1, G2, late)
    for G in (G1, G2):
        check_assumptions(gang_of_four(G))
    G1, G2 = in_principal_axes(G1), in_principal_axes(G2)
    H1, H2 = (balanced(H, solutions(H)) for H in on_circle(loop_rate(G1, G2), G1, G2))
    R1, R2 = right_factors(H1), right_factors(H2)
    if not _homotopic(R1, R2):
        return Gap(1.0, 1.0)
    P = _mismatch(R1, left_factors(H2))
    nugap = min(hinfnorm(P)[0], 1.0)
    return Gap(_directed_gap(R1, R2, P, nugap), nugap)


def _late(G1: StateSpace, G2: StateSpace, delay: float) -> Gap:
    """The distances of plants of which one acts later, G2 or, where the delay is negative, G1.

    Where both gains are below g their chordal distance is below 2 g: what the approximant does there does not matter to
    a larger nu-gap.
    """
    first, second = (G1, G2) if delay > 0 else (G2, G1)
    if G1.discrete:
        return gapmetric(first, input_delay(second, abs(delay)))
    level = FIRST
    for _ in range(LEVELS):
        try:
            line = approximant(abs(delay), level, "G1, G2", G1, G2)
        except NumericalError:
            if level != FIRST:
                raise
            line = approximant(abs(delay), level := LONG, "G1, G2", G1, G2)
        found = gapmetric(first, series(repeated(line, second.nu), second))
        if found.nugap >= 2 * level:
            return found
        level = min(FIRST, found.nugap / 2.5) or TOLERANCE
    raise NumericalError(f"the nu-gap is {found.nugap:.3g}, which the approximant of the delay hides")


class Neighbours(NamedTuple):
    """A model and how far a set is from it in the nu-gap."""

    nominal: StateSpace
    index: int | None  # of the nominal model among the models, None where it was given
    radius: float  # the largest nu-gap, 1 where no one controller may do for all
    nugaps: np.ndarray  # (k,) of every model to the nominal one


def nugap(models: Any, nominal: Any = None, *, delays: Any = None) -> Neighbours:
    """Nu-gaps of a set of models to a nominal one, by default to the member that is nearest to the farthest of them.

    A controller with ncfmargin(nominal, K) > radius stabilises every model of the set.

    Parameters
    ----------
    models : list of (p x m) plants, each in any form that `system` takes, or an UncertainSystem, of which the nominal
        model, vertices and samples are taken: not the whole box
    nominal : the model in the middle; a member is chosen when left out
    delays : (k,) s, by which the inputs of each model act later than those of the nominal one, or of one another

    Returns
    -------
    Neighbours : unpacks as nominal, index, radius, nugaps

    Raises
    ------
    ModelError : there are no models, or sizes or timebases differ.
    AssumptionError : as `gapmetric`.

    Reference: Vinnicombe (2001), Uncertainty and Feedback, section 3.2.
    """
    plants = members(models, nominal)
    k = len(plants) - (nominal is not None)
    late = np.zeros(k) if delays is None else as_array("delays", delays, "pass a time in s for each of the models")
    if late.shape != (k,):
        raise ModelError(f"delays has the shape {late.shape}; pass a time in s for each of the {k} models")
    if nominal is not None:
        middle = plants.pop()
        gaps = np.array([gapmetric(middle, G, delay=T).nugap for G, T in zip(plants, late, strict=True)])
        return Neighbours(middle, None, float(gaps.max()), gaps)
    table = np.zeros((len(plants), len(plants)))
    for i, G in enumerate(plants):
        for j in range(i):
            table[i, j] = table[j, i] = gapmetric(G, plants[j], delay=late[j] - late[i]).nugap
    best = int(table.max(axis=1).argmin())
    return Neighbours(plants[best], best, float(table[best].max()), table[best])


def members(models: Any, nominal: Any = None) -> list[StateSpace]:
    """The plants of a set, and the nominal one last where there is one; of the same size and timebase.

    Raises
    ------
    ModelError : there are no models, or sizes or timebases differ.
    """
    if isinstance(models, UncertainSystem):
        vertices = models.gridded(2) if len(models.parameters) <= MOST_VERTICES else []
        models = [models.nominal, *(G for _, G in (*vertices, *models.sample(SAMPLES)))]
    if not isinstance(models, list | tuple) or not models:
        raise ModelError(f"models is {shown(models)}; pass a list of models, or an UncertainSystem")
    named = {f"models[{i}]": G for i, G in enumerate(models)} | ({} if nominal is None else {"nominal": nominal})
    plants = list(as_systems(**named))
    sizes = [f"{G.ny} x {G.nu}" for G in plants]
    if len(set(sizes)) > 1:
        told = ", ".join(f"{name} is {size}" for name, size in zip(named, sizes, strict=True))
        raise ModelError(f"{told}; models, and nominal, must have the same size")
    return plants


def _mismatch(R1: StateSpace, L2: StateSpace) -> StateSpace:
    """Ml N1 - Nl M1 from right factors [N; M] and left factors [Nl, Ml], with the states of R1 first."""
    m = R1.nu
    left = StateSpace(L2.A, np.hstack([L2.B[:, m:], -L2.B[:, :m]]), L2.C, np.hstack([L2.D[:, m:], -L2.D[:, :m]]), L2.dt)
    return series(R1, left)


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


def _directed_gap(R1: StateSpace, R2: StateSpace, P: StateSpace, low: float) -> float:
    """Infimum over stable Q of ||R1 - R2 Q||, by bisection between ||P|| and 1."""
    if R2.n == 0:
        return low  # nothing is anticausal
    gramian = sla.solve_discrete_lyapunov(R2.A, R2.B @ R2.B.T)
    high = 1.0
    while high - low > TOLERANCE:
        middle = (high + low) / 2
        low, high = (low, middle) if _hankel_norm(R1, R2, P, gramian, middle) <= 1 else (middle, high)
    return high


def _hankel_norm(R1: StateSpace, R2: StateSpace, P: StateSpace, gramian: np.ndarray, g: float) -> float:
    """Hankel norm of the anticausal part of R2~ R1 W^-1 with W~ W = g^2 I - P~ P; infinite for g below ||P||.

    W^-1 = [A + B F, B h; F, h] / g from the bounded-real Riccati equation of P / g, and R1 W^-1 = [As, Bs; Cs, Ds].
    What a unit impulse leaves in the anticausal state of R2~, with X = A2'X As + C2'Cs, is M = C2'Ds + A2'X Bs.
    """
    C, D = P.C / g, P.D / g
    s = solve_riccati(P.A, P.B, C.T @ C, D.T @ D - np.eye(P.nu), C.T @ D)
    if s is None or not is_positive(-s.R) or spectral_radius(P.A + P.B @ s.F) >= 1:
        return np.inf
    e, V = np.linalg.eigh(-s.R)
    h = (V / np.sqrt(e)) @ V.T / g
    As, Bs = P.A + P.B @ s.F, P.B @ h
    Cs, Ds = np.hstack([R1.C, np.zeros((R1.ny, P.n - R1.n))]) + R1.D @ s.F, R1.D @ h
    X = _stein(R2.A.T, As, R2.C.T @ Cs)
    M = R2.C.T @ Ds + R2.A.T @ X @ Bs
    reached = sla.solve_discrete_lyapunov(R2.A.T, M @ M.T)
    return float(np.sqrt(np.linalg.eigvals(gramian @ reached).real.max()))


def _stein(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """X = A X B + Q for stable A and B, by squaring."""
    X = Q
    while np.linalg.norm(A) * np.linalg.norm(B) > np.finfo(float).eps:
        X, A, B = X + A @ X @ B, A @ A, B @ B
    return X
