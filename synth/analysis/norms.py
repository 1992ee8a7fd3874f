"""The independent judge: stability and norms of a system, by methods that share nothing with any synthesis.

Two routes to the H-infinity norm, both on a balanced realisation of the discrete system (a continuous one goes
through the Cayley map, which preserves the norm):

- from below, the level-set method: a frequency at which the largest singular value was evaluated. It cannot be
  too high, and would be too low only if a peak were missed;
- from above, the bounded-real Riccati equation at a slightly higher level (doubling). It has a stabilising
  solution exactly if the norm is below that level.

A pole is stable if it is so by more than rounding of A may have moved it, and what rounding may hide of the response
where it is largest is added to the norm.

References: Bruinsma and Steinbuch (1990), Systems & Control Letters 14, 287; Boyd and Balakrishnan (1990),
Systems & Control Letters 15, 1; bounded real lemma: de Souza and Xie (1992), Systems & Control Letters 18, 61.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.truncation import balanced_truncation, gramian_factor, rounding
from synth.checks import as_number
from synth.equations.doubling import bounded_real
from synth.errors import NumericalError, VerificationError
from synth.systems import realization
from synth.systems.generalized import GeneralizedPlant
from synth.systems.modes import crosses
from synth.systems.sampled import cayley, pole_rate
from synth.systems.statespace import StateSpace, as_system
from synth.threads import one_thread

TOLERANCE = 1e-7  # relative, of the peak
CONFIRM = (*(10.0**k for k in range(-7, 9)),)  # relative margins at which the second method confirms the first
ROUNDOFF = 1e-9  # a norm below this part of the closed loop's own entries is reported as this part
DIGITS = 0.3  # of the norm: what rounding may account for at most
ROUNDINGS = 2  # of doubles, in an entry of a matrix that was computed
SUSPICIOUS = 1e-6  # of a distance to the stability boundary, from which on it is compared with rounding
NEGLIGIBLE = 1e-8  # of the norm: what states that hardly matter may have in it
LARGE = 60  # states from which on the level-set method is left out where the bounded-real equation confirms a climb
CLIMBS = 2  # local maxima that are climbed then
GOLDEN = (np.sqrt(5) - 1) / 2
NEAR_CIRCLE = 1e-4  # an eigenvalue this near the unit circle is a candidate crossing; candidates are then evaluated

Gain = Callable[[float], float]  # largest singular value by the angle on the unit circle
Transfer = Callable[[float], np.ndarray]  # (p, m) complex


def spectral_radius(A: np.ndarray) -> float:
    """Largest modulus of the eigenvalues of A (n, n); 0 for n = 0."""
    return float(np.abs(np.linalg.eigvals(A)).max()) if A.size else 0.0


def is_stable(G: StateSpace) -> bool:
    """All poles strictly inside the unit circle (discrete) or the left half plane (continuous)."""
    if G.n == 0:
        return True
    return spectral_radius(G.A) < 1 if G.discrete else bool(np.real(G.poles()).max() < 0)


def balance(G: StateSpace) -> StateSpace:
    """The same system with states scaled by powers of two so that its rows and columns have like norms."""
    return StateSpace(*realization.balanced(G.matrices), G.dt)


def in_principal_axes(G: StateSpace) -> StateSpace:
    """The same system, turned as well as scaled where its coordinates are bad: see `realization.in_principal_axes`."""
    return StateSpace(*realization.in_principal_axes(G.matrices), G.dt)


def h2norm(system: Any) -> float:
    """H2 norm; inf for an unstable system or a continuous one with D different from 0.

    Reference: Zhou, Doyle and Glover (1996), Robust and Optimal Control, section 4.6.
    """
    G = balance(as_system("the system", system))
    if not is_stable(G) or (not G.discrete and np.any(G.D)):
        return np.inf
    if G.n == 0:
        return float(np.linalg.norm(G.D))
    H = G if G.discrete else cayley(G, pole_rate(G.poles()))  # its states are reached alike
    A, Z = sla.schur(H.A, output="real")[:2]
    return float(np.hypot(np.linalg.norm(G.C @ Z @ gramian_factor(A, Z.T @ H.B)), np.linalg.norm(G.D)))


@one_thread
def hinfnorm(system: Any, tol: float = TOLERANCE) -> tuple[float, float]:
    """H-infinity norm and the frequency (rad/s) of the peak, from below to relative accuracy `tol`.

    inf for an unstable system, with the frequency of the pole that is farthest out. The value is a singular value
    evaluated at the returned frequency; `verify` confirms it from above.
    """
    G = as_system("the system", system)
    tol = as_number("tol", tol, "a relative tolerance, 1e-9 for example", above=0)
    poles = G.poles()
    if _boundary_distance(G, poles) <= 0:
        worst = poles[np.argmax(np.abs(poles) if G.discrete else np.real(poles))]
        return np.inf, float(abs(np.angle(worst)) / G.dt if G.discrete else abs(worst.imag))
    found = _on_circle(G, poles, tol)
    return found.peak, found.frequency


@dataclass(frozen=True)
class Verification:
    """What the judge measured on a closed loop."""

    spectral_radius: float  # largest pole modulus (continuous: largest real part, rad/s)
    norm: float  # verified bound on the H-infinity norm, within 1e-7 of the peak unless rounding forbids
    peak: float  # largest singular value that was found, <= norm
    frequency: float  # rad/s, where the peak is
    rounding: float  # part of the norm that rounding may account for
    poles: np.ndarray = field(repr=False, compare=False)  # (n,) of the closed loop


@one_thread
def verify(system: Any) -> Verification:
    """Measure a closed loop: stability first, then the norm by two independent methods.

    Raises
    ------
    VerificationError : the system is not stable, or the second method confirms no level near the first.
    """
    G = as_system("the system", system)
    poles = G.poles()
    radius = float(np.abs(poles).max(initial=0.0) if G.discrete else np.real(poles).max(initial=-np.inf))
    _check_stable(G, poles, radius)
    found = _on_circle(G, poles, TOLERANCE)
    H = found.system
    floor = ROUNDOFF * float(np.linalg.norm(H.D, 2) + np.linalg.norm(H.C, 2) * np.linalg.norm(H.B, 2))
    top = max(found.peak, found.mapped)
    if top < floor:  # a loop in which nearly everything cancels: what rounding leaves of it is known better
        floor = min(floor, rounding(H))
    norm = top * (1 + CONFIRM[0]) if found.confirmed and top >= floor else confirm(H, max(top, floor))
    lost = max(_lost(H, np.exp(1j * found.angle), float(np.linalg.norm(H.A))), abs(found.peak - found.mapped))
    return _with_rounding(Verification(radius, norm, found.peak, found.frequency, 0.0, poles), lost)


@one_thread
def judge(P: GeneralizedPlant, K: StateSpace) -> tuple[StateSpace, Verification]:
    """The loop of a plant and a controller, u = K y, and what `verify` measures on it.

    Where the direct term of a controller is huge, A + B2 Dk C2 has lost digits before any judge sees it. What that may
    do to the response where it is largest is part of the norm.

    Raises
    ------
    ModelError : sizes or timebases do not fit, or the loop is not well posed.
    VerificationError : as `verify`.
    """
    closed_loop = P.close(K)
    measured = verify(closed_loop)
    if not np.any(K.D) or not len(P.A):
        return closed_loop, measured
    w = min(measured.frequency, 1e300)
    D = np.abs(np.linalg.solve(np.eye(K.ny) - K.D @ P.D22, K.D))
    summed = np.zeros_like(closed_loop.A)
    summed[: len(P.A), : len(P.A)] = np.abs(P.B2) @ D @ np.abs(P.C2)
    return closed_loop, _with_rounding(measured, _lost(closed_loop, np.exp(1j * w * P.dt) if P.dt else 1j * w, summed))


class _Found(NamedTuple):
    """The peak of a stable system, evaluated on it, and the balanced discrete system that it was found on."""

    system: StateSpace
    peak: float
    angle: float
    frequency: float  # rad/s
    confirmed: bool  # the bounded-real equation has a solution just above the peak
    mapped: float  # the peak of the discrete system, which has rounded the one that was given


def _boundary_distance(G: StateSpace, poles: np.ndarray) -> float:
    """How far the poles are inside the unit circle or the left half plane; 0 or less for an unstable system."""
    return float(1 - np.abs(poles).max(initial=0.0) if G.discrete else -np.real(poles).max(initial=-1.0))


def _on_circle(G: StateSpace, poles: np.ndarray, tol: float) -> _Found:
    """The peak of a stable system to the relative accuracy `tol`."""
    if G.discrete:
        H = balance(G)
        peak, theta, confirmed = _peak(H, tol)
        return _Found(H, peak, theta, theta / G.dt, confirmed, peak)
    rate = pole_rate(poles)
    H = balance(cayley(G, rate))
    peak, theta, confirmed = _peak(H, tol)
    w = float(rate * np.tan(theta / 2))
    direct = _gain_at(balance(G), 1j * w)
    return _Found(H, direct if np.isfinite(direct) else peak, theta, w, confirmed, peak)


def _gain_at(G: StateSpace, s: complex) -> float:
    """Largest singular value of a stable system at s; inf where numbers end."""
    try:
        M = G.C @ np.linalg.solve(s * np.eye(G.n) - G.A, G.B.astype(complex)) + G.D
        return float(np.linalg.norm(M, 2)) if np.isfinite(M).all() else np.inf
    except np.linalg.LinAlgError:
        return np.inf


def _check_stable(G: StateSpace, poles: np.ndarray, radius: float) -> None:
    """Raise VerificationError unless every pole is stable by more than rounding of A may have moved it."""
    distance = _boundary_distance(G, poles)
    if distance <= 0:
        what = "spectral radius" if G.discrete else "largest real part of a pole"
        raise VerificationError(f"the closed loop is unstable: {what} {radius:.9g}")
    if distance < SUSPICIOUS * (1.0 if G.discrete else np.abs(poles).max(initial=0.0)) and crosses(
        G.A, discrete=G.discrete
    ):
        raise VerificationError(
            f"the closed loop is stable by {distance:.1e} only, which is within rounding of its own entries: a pole of "
            "the plant, or a zero of it that the controller cancels, is on the stability boundary"
        )


def _lost(G: StateSpace, s: complex, size: float | np.ndarray) -> float:
    """What rounding of A may change of the response at s or z; `size` is its norm, or (n, n) what was rounded."""
    if G.n == 0:
        return 0.0
    E = s * np.eye(G.n) - G.A
    try:
        left, right = np.linalg.solve(E.T, G.C.T).T, np.linalg.solve(E, G.B)
    except np.linalg.LinAlgError:
        return np.inf
    if isinstance(size, float):
        effect = np.linalg.norm(left, 2) * size * np.linalg.norm(right, 2)
    else:
        effect = np.linalg.norm(np.abs(left) @ size @ np.abs(right), 2)
    return float(ROUNDINGS * np.finfo(float).eps * effect)


def _with_rounding(measured: Verification, lost: float) -> Verification:
    """The measurement with what rounding may hide added to the norm, if that is a small part of it."""
    if lost > DIGITS * measured.norm:
        raise VerificationError(
            f"the closed loop is too ill-conditioned to be judged: rounding may change its norm of {measured.norm:.6g} "
            f"by {lost:.2g}; ask for a larger gamma, or bring the model to better units"
        )
    return replace(measured, norm=measured.norm + lost, rounding=measured.rounding + lost)


def confirm(G: StateSpace, peak: float) -> float:
    """Smallest level above `peak` at which the bounded-real Riccati equation of a stable discrete G has a solution.

    Where that is not close above, as with poles that zeros nearly cancel, the equation is solved without the states
    that hardly matter, and their share is added.
    """
    if peak == 0:
        return 0.0
    if bounded_real(G, peak * (1 + CONFIRM[0]), stable=True) is not None:
        return float(peak * (1 + CONFIRM[0]))
    reduced, share = balanced_truncation(G, NEGLIGIBLE * peak)
    for margin in CONFIRM:
        for H, added in ((reduced, share), (G, 0.0)):
            if bounded_real(H, peak * (1 + margin), stable=H is G) is not None:
                return float(peak * (1 + margin) + added)
    raise VerificationError(
        f"the level-set method finds a norm of {peak:.6g}, the bounded-real Riccati equation has no solution "
        f"even {CONFIRM[-1]:.0e} times above it: the closed loop is too ill-conditioned to be judged"
    )


def _peak(G: StateSpace, tol: float) -> tuple[float, float, bool]:
    """Peak gain of a stable discrete system, its angle on the unit circle, and whether it was confirmed from above."""
    if G.n == 0:
        return float(np.linalg.norm(G.D, 2)), 0.0, True
    gain, poles = _gain(G)
    angles = np.unique(np.concatenate([np.abs(np.angle(poles)), np.geomspace(1e-5, np.pi, 40), [0.0, np.pi]]))
    values = np.array([gain(t) for t in angles])
    best = int(np.argmax(values))
    level, angle = float(values[best]), float(angles[best])
    if level == 0.0 or not np.isfinite(level):
        return level, angle, True
    if G.n >= LARGE:  # the pencil is dear: climb first, and leave it if the Riccati equation says that this is the top
        level, angle = _highest(gain, angles, values)
        if bounded_real(G, level * (1 + CONFIRM[0]), stable=True) is not None:
            return level, angle, True
    for _ in range(60):
        ends = crossings(G, level * (1 + tol))
        middles = np.concatenate([(ends[1:] + ends[:-1]) / 2, ends])
        values = [gain(t) for t in middles]
        if not values or max(values) <= level * (1 + tol):
            return *ascend(gain, float(level), float(angle)), False
        best = int(np.argmax(values))
        level, angle = values[best], float(middles[best])
    raise NumericalError("the level-set iteration for the H-infinity norm did not end in 60 steps")


def _highest(gain: Gain, angles: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """The highest of the local maxima of the gain near the largest of its sorted samples."""
    padded = np.concatenate([[-np.inf], values, [-np.inf]])
    tops = np.flatnonzero((values >= padded[:-2]) & (values >= padded[2:]))
    tops = sorted(tops, key=lambda i: -values[i])[:CLIMBS]
    last = len(angles) - 1
    return max(climb(gain, angles[max(i - 1, 0)], angles[min(i + 1, last)]) for i in tops)


def ascend(gain: Gain, level: float, angle: float) -> tuple[float, float]:
    """The local maximum that is reached uphill from a point, in ever wider steps."""
    width = max(1e-4 * angle, 1e-9)
    while width < np.pi:
        top, at = climb(gain, max(angle - width, 0.0), min(angle + width, np.pi))
        inside = abs(at - angle) < 0.9 * width
        if top > level:
            level, angle = top, at
        if inside:
            break
        width *= 4
    return level, angle


def climb(gain: Gain, low: float, high: float, part: float = 1e-6) -> tuple[float, float]:
    """The local maximum of the gain in an interval of angles, and where it is to a part of it, by golden section."""
    a, b = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    fa, fb = gain(a), gain(b)
    narrow = part * (high - low)  # the top is flat: the gain is known to the square of that
    narrow = max(narrow, 4 * np.finfo(float).eps * max(abs(low), abs(high)))
    while high - low > narrow:
        if fa > fb:
            high, b, fb = b, a, fa
            a = high - GOLDEN * (high - low)
            fa = gain(a)
        else:
            low, a, fa = a, b, fb
            b = low + GOLDEN * (high - low)
            fb = gain(b)
    return max((fa, float(a)), (fb, float(b)))


def transfer(G: StateSpace) -> tuple[Transfer, np.ndarray]:
    """The function angle -> G(e^{j angle}), inf at a pole, and the poles; one Schur form serves them all."""
    T, Z = sla.rsf2csf(*sla.schur(G.A, output="real")[:2]) if G.n else (np.zeros((0, 0), complex), np.zeros((0, 0)))
    poles, ZB, CZ, E = np.diag(T).copy(), Z.conj().T @ G.B, G.C @ Z, np.asfortranarray(-T)

    def response(angle: float) -> np.ndarray:
        np.fill_diagonal(E, np.exp(1j * angle) - poles)
        try:
            X = sla.solve_triangular(E, ZB, check_finite=False) if G.n else ZB
        except np.linalg.LinAlgError:  # a pole of the mapped system on the circle
            return np.full(G.D.shape, np.inf, complex)
        return CZ @ X + G.D

    return response, poles


def _gain(G: StateSpace) -> tuple[Gain, np.ndarray]:
    """The function angle -> largest singular value, and the poles."""
    response, poles = transfer(G)

    def gain(angle: float) -> float:
        M = response(angle)
        return float(np.linalg.norm(M, 2)) if np.isfinite(M).all() else np.inf

    return gain, poles


def crossings(G: StateSpace, level: float) -> np.ndarray:
    """Angles at which a singular value of G may equal `level`: those of D'D - I with B, C scaled by level^-1/2."""
    A, B, C, D = G.A, G.B / np.sqrt(level), G.C / np.sqrt(level), G.D / level
    return singular_angles(A, B, C.T @ C, C.T @ D, D.T @ D - np.eye(G.nu))


def singular_angles(A: np.ndarray, B: np.ndarray, Q: np.ndarray, S: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Angles at which [X; I]* [Q S; S* R] [X; I], X = (z I - A)^-1 B, may be singular, in [0, pi].

    Unit eigenvalues of the symplectic pencil x+ = A x + B v, p = A'p+ + Q x + S v, 0 = B'p+ + S* x + R v, x+ = z x.
    """
    n, m = B.shape
    M = np.block([
        [A, np.zeros((n, n)), B],
        [Q, -np.eye(n), S],
        [S.conj().T, np.zeros((m, n)), R],
    ])  # fmt: skip
    N = np.block([
        [np.eye(n), np.zeros((n, n + m))],
        [np.zeros((n, n)), -A.T, np.zeros((n, m))],
        [np.zeros((m, n)), -B.T, np.zeros((m, m))],
    ])  # fmt: skip
    alpha, beta = np.asarray(sla.eigvals(M, N, homogeneous_eigvals=True, check_finite=False))
    near = np.abs(np.abs(alpha) - np.abs(beta)) <= NEAR_CIRCLE * np.abs(beta)
    angles = np.abs(np.angle(alpha[near]) - np.angle(beta[near]))
    return np.unique(np.minimum(angles, 2 * np.pi - angles))
