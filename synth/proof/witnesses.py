"""Witnesses for the proofs in `balls`, found in floating-point arithmetic: nothing here needs to be rigorous.

Upper bound: coordinates in which the solution of the bounded-real Riccati equation is I, refined in balls until the
inequality leaves a little more than nothing.

Lower bound, at a level just below the optimum, of control and of estimation: policy iteration for the disturbance,
each step answering w = F x with the best control, a Riccati equation that leaves out next to nothing of the cost, and
improving F; and where that is slow, or a zero on the stability boundary bars it, doubling in balls from zero. It ends
when both sides couple too strongly, or when on one side a disturbance gains or a cost that must grow falls.

Reference: Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from flint import arb, arb_mat, ctx

from synth.analysis.precondition import Conditioned, precondition
from synth.analysis.truncation import gramian_factor
from synth.equations.doubling import bounded_real, double, solve_riccati
from synth.equations.hinf_riccati import RiccatiRoute, dual
from synth.errors import ModelError, SynthError
from synth.proof import balls
from synth.proof.balls import Coupling, Fall, Impulse, LowerWitness, Step, UpperWitness
from synth.proof.matrices import exact, identity, inverse_factor, rounded, symmetric
from synth.proof.reasons import obstacles
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import design_rate, discretised, inverse_cayley, pole_rate
from synth.systems.statespace import StateSpace

DISTANCES = (2e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.3)  # of the lower bound below the Riccati equations' optimum
FAILURES = (SynthError, np.linalg.LinAlgError, ArithmeticError, ValueError)  # of an attempt: then there is another
OUTPUT = (0.0, 1e-12, 1e-8)  # state added to the closed loop's output for the coordinates of the upper bound, squared
UNSEEN = 1e-7  # added to what reaches a state and to what is seen of it, for coordinates alone
STRICTNESS = (1e-20, 1e-14)  # and for its inequality, in these coordinates
LEFT_OUT = 1e-20  # cost left out for the lower bound, relative to X
REFINED = 2  # Newton steps in balls
SAME = 3.0  # factor within which two rates are one
CONVERGED = 1e-9  # relative change of a policy iteration; it is quadratic
MAX_POLICIES = 30
MAX_DOUBLINGS = 60  # 2^60 steps
NOTHING = 1e-6  # part of the level of quadratic control: an optimum that counts as zero
NOT_FOUND = "no contradiction was found near the optimum of the Riccati equations"


def find_upper(P: GeneralizedPlant, K: StateSpace, level: float, bits: int) -> UpperWitness | None:
    """Coordinates that prove a norm below `level`, or None when none were found."""
    with np.errstate(all="ignore"), ctx.workprec(bits):
        for rate in _rates(P.dt, pole_rate(_poles(P.close(K)))):
            for witness in _contractions(P, K, level, rate):
                if balls.proves_upper(P, K, witness, level, bits):
                    return witness
    return None


def _poles(G: StateSpace) -> np.ndarray:
    """Poles in rad/s, of a discrete system those it has in continuous time."""
    poles = G.poles()
    return 2 / G.dt * (poles - 1) / (poles + 1) if G.discrete else poles


def _rates(dt: float, natural: float) -> tuple[float, ...]:
    """Rates to try in turn; 0 stands for discrete time as it is."""
    if dt == 0:
        return (natural,)
    own = not 0 < natural < np.inf or abs(np.log(natural * dt / 2)) < np.log(SAME)
    return (0.0,) if own else (natural, 0.0)


def _contractions(P: GeneralizedPlant, K: StateSpace, level: float, rate: float) -> Iterator[UpperWitness]:
    """Coordinates in which one step of the closed loop should contract."""
    for added, strictness in product(OUTPUT, STRICTNESS):
        try:
            G = balls.closed_loop(P, K, rate)
            T = _contracting(G, level, added)
            witness = None if T is None else _refined_contraction(G, T, level, strictness)
        except FAILURES:
            continue
        if T is not None and witness is not None:
            yield UpperWitness(T, *witness, rate)


def _refined_contraction(
    G: balls.Balls, T: np.ndarray, level: float, strictness: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """U, the last digits and the factor in nearly contracting coordinates T.

    The inequality is to leave what it leaves in these coordinates, and `strictness` where that is less.
    """
    n, U = len(T), np.eye(len(T))
    M = balls.contraction(G, exact(T), level)
    e, V = np.linalg.eigh(_reduced(balls.dissipated(M, exact(0 * T)), n)[0])
    left = (V * np.maximum(e, strictness)) @ V.T
    for _ in range(REFINED):
        found = _rooted(M, U, U.T @ left @ U)
        if found is None:
            return None
        U = found
        M = balls.contraction(G, exact(T) * exact(U), level)
    rest = _last_digits(M, U.T @ left @ U)
    factor = inverse_factor(balls.dissipated(M, symmetric(rest)))
    return None if factor is None else (U, rest, factor)


def _balanced(G: balls.Balls) -> np.ndarray:
    """Coordinates in which the states of a stable G are reached and seen alike, as far as `UNSEEN` allows."""
    A, B, C = (rounded(M) for M in (G.A, G.B, G.C))
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n], M[n, :n] = np.abs(A), np.linalg.norm(B, axis=1), np.linalg.norm(C, axis=0)
    scale = sla.matrix_balance(M, permute=False, separate=True)[1][0]  # powers of two
    t = scale[:n] / scale[n]
    A, Z = sla.schur(A / t[:, None] * t, output="real")[:2]
    B, C = Z.T @ (B / t[:, None]), (C * t) @ Z
    I = UNSEEN * np.eye(n)
    reached = gramian_factor(A, np.hstack([B, I * (np.linalg.norm(B) or 1.0)]))
    seen = gramian_factor(A.T, np.vstack([C, I * (np.linalg.norm(C) or 1.0)]).T)
    if not (np.isfinite(reached).all() and np.isfinite(seen).all()):
        return np.diag(t)
    _, sigma, Vt = np.linalg.svd(seen.T @ reached)
    return t[:, None] * (Z @ reached @ Vt.T / np.sqrt(sigma))


def _contracting(G: balls.Balls, level: float, added: float) -> np.ndarray | None:
    """Coordinates in which the bounded-real solution is I; states with the energy `added` are output besides."""
    T = _balanced(G)
    Tb = exact(T)
    Ti = Tb.inv()
    A, B, C, D = (rounded(M) for M in (Ti * G.A * Tb, Ti * G.B, G.C * Tb, G.D))
    states, O = np.sqrt(added) * (np.linalg.norm(C) or 1.0) * np.eye(len(A)), np.zeros((len(A), D.shape[1]))
    X = bounded_real(StateSpace(A, B, np.vstack([C, states]), np.vstack([D, O]), 1.0), level)
    if X is None:
        return None
    return T @ np.linalg.inv(np.linalg.cholesky(X + UNSEEN**2 * np.linalg.norm(X) * np.eye(len(X)))).T


def _rooted(M: arb_mat, U: np.ndarray, left: np.ndarray) -> np.ndarray | None:
    """Coordinates U nearer to those in which I solves the bounded-real equation that leaves `left`, or None.

    The Riccati equation is shifted by I, nearly its solution, in balls, where nothing cancels.
    """
    E, m, n = rounded(M.transpose() * M - identity(M.ncols())), rounded(M), len(U)
    A, B = m[:n, :n], m[:n, n:]
    W = np.linalg.solve(E[n:, n:], np.hstack([B.T, E[n:, :n]]))
    X = double(A - B @ W[:, n:], B @ W[:, :n], E[:n, :n] + left - E[:n, n:] @ W[:, n:])
    return None if X is None else U @ np.linalg.inv(np.linalg.cholesky(np.eye(n) + X)).T


def _last_digits(M: arb_mat, left: np.ndarray) -> np.ndarray:
    """What to add to I for a solution that leaves `left`, by Newton's steps in balls."""
    n, rest, m = len(left), np.zeros_like(left), rounded(M)
    for _ in range(REFINED):
        S, K = _reduced(balls.dissipated(M, symmetric(rest)), n)
        change = double(m[:n, :n] + m[:n, n:] @ K, 0 * rest, left - S)
        if change is None:
            break
        rest = rest + change
    return rest


def _reduced(M: arb_mat, n: int) -> tuple[np.ndarray, np.ndarray]:
    """What M, a quadratic form in (x, u), is with the u = K x of its stationary point, and this K."""
    m = rounded(M)
    K = -np.linalg.solve(m[n:, n:], m[n:, :n])
    I = exact(np.vstack([np.eye(n), K]))
    return rounded(I.transpose() * M * I), K


Side = tuple[GeneralizedPlant, balls.Half, np.ndarray]  # a plant or its dual, in doubles and in balls, and a start


class Climb(NamedTuple):
    """How far one side came."""

    way: tuple[Step, ...] | int
    X: arb_mat  # (n, n) what P exceeds there
    w: np.ndarray | None = None  # (nw) a disturbance that gains, where there is one
    v: np.ndarray | None = None  # (n) a state whose cost falls, where there is one


def find_lower(
    P: GeneralizedPlant, upper: float, level: float | None, bits: int
) -> tuple[tuple[float, LowerWitness] | None, str]:
    """The highest of a few levels below the optimum (or the one given) with its witness, or None and the reason."""
    scaled, failure = np.inf, ""
    for rate in _rates(P.dt, _design_rate(P)):
        try:
            with np.errstate(all="ignore"), ctx.workprec(bits):
                found, scaled = _lower(P, upper, level, bits, rate)
        except FAILURES as error:
            failure = str(error)
            continue
        if found is not None:
            return found, ""
    return None, _reason(P, scaled, failure)


def _reason(P: GeneralizedPlant, scaled: float, failure: str) -> str:
    """Why nothing was found, as far as it is known."""
    if scaled < NOTHING:
        return "the optimum is zero, or so small beside that of quadratic control that it cannot be told from zero"
    if found := obstacles(P):
        return f"no strict inequality on one side: on the stability boundary there is {', and '.join(found)}"
    return f"{NOT_FOUND}: {failure}" if failure else NOT_FOUND


def _design_rate(P: GeneralizedPlant) -> float:
    """The rate of a generalised plant, also of a discrete one; its own where it has none in continuous time."""
    if P.dt == 0:
        return design_rate(P)
    try:
        return design_rate(GeneralizedPlant.partition(inverse_cayley(P.system, 2 / P.dt), P.sizes[4], P.sizes[2]))
    except ModelError:  # a pole at -1
        return 2 / P.dt


def _lower(
    P: GeneralizedPlant, upper: float, level: float | None, bits: int, rate: float
) -> tuple[tuple[float, LowerWitness] | None, float]:
    """`find_lower` in the discrete time of one rate, and the optimum over the level of quadratic control."""
    discrete, _ = discretised(P, rate or None)
    c = precondition(discrete)
    before, after = np.linalg.norm(np.linalg.solve(c.T, discrete.B1)), np.linalg.norm(c.plant.B1)
    w = float(after / before) if before and after else 1.0  # `precondition` shares its scale between w and z
    z = 1 / (c.scale * w)
    halves = balls.in_coordinates(P, c.T, w, z, rate)
    floating = _rounded(halves, c)
    route = RiccatiRoute.of(floating)
    scaled = route.minimise()[0]
    optimum = min(scaled * c.scale, upper)
    sides = (floating, halves[0], route.X), (dual(floating), halves[1], route.Y)
    for distance in DISTANCES if level is None else (0.0,):
        asked = optimum * (1 - distance) if level is None else level
        g = arb(asked) * arb(w) * arb(z)  # exactly: strictness is far smaller than rounding
        for control, estimation in _ways(sides, g):
            try:
                found = _end(control, estimation, halves, g)
            except FAILURES:
                continue
            if found is not None:
                witness = LowerWitness(c.T, w, z, rate, *found)
                if balls.proves_lower(P, witness, asked, bits):
                    return (asked, witness), scaled
    return None, scaled


def _rounded(halves: tuple[balls.Half, balls.Half], c: Conditioned) -> GeneralizedPlant:
    """The conditioned plant once more, from balls, so that it agrees with them to the last digit."""
    control, estimation = halves
    A, B1, B2, C1, D11, D12 = (rounded(M) for M in control)
    C2, D21 = rounded(estimation.B2).T, rounded(estimation.D12).T
    return replace(c.plant, A=A, B1=B1, B2=B2 @ c.Su, C1=C1, D11=D11, D12=D12 @ c.Su, C2=c.Sy @ C2, D21=c.Sy @ D21)


def _ways(sides: tuple[Side, Side], g: arb) -> Iterator[tuple[Climb, Climb]]:
    """Ways up on both sides, dearer ones only when they are asked for: by policies, by doubling, and mixed."""
    policies = tuple(_climb(*side, g) for side in sides)
    yield policies[0], policies[1]
    doubled = tuple(_double(*side, g) for side in sides)
    yield doubled[0], doubled[1]
    yield policies[0], doubled[1]
    yield doubled[0], policies[1]


def _climb(P: GeneralizedPlant, half: balls.Half, start: np.ndarray, g: arb) -> Climb:
    """Policy iteration for w on one side, up to the game Riccati solution or to a disturbance that gains."""
    n, nw = P.B1.shape
    level, F, X, steps = float(g), np.zeros((nw, n)), np.zeros((n, n)), []
    for _ in range(MAX_POLICIES):
        C = P.C1 + P.D11 @ F
        answer = solve_riccati(
            P.A + P.B1 @ F, P.B2, C.T @ C - level**2 * F.T @ F, P.D12.T @ P.D12, C.T @ P.D12, start=start
        )
        try:
            step = None if answer is None else _step(half, steps[-1] if steps else None, F, answer.X, g)
            w, F = (None, F) if step is None else _answer(P, step.X, level)
        except FAILURES:
            step = w = None
        if step is None:
            break
        grown = np.linalg.norm(step.X - X)
        X = start = step.X
        steps.append(step)
        if w is not None:
            return Climb(tuple(steps), balls.solution(step), w)
        if grown < CONVERGED * np.linalg.norm(X):
            break
    return Climb(tuple(steps), balls.solution(steps[-1]) if steps else exact(X))


def _double(P: GeneralizedPlant, half: balls.Half, _: np.ndarray, g: arb) -> Climb:
    """Ever more iterates from zero on one side, until they converge, or to a disturbance that gains or a fall."""
    last, done, level = exact(np.zeros((len(P.A),) * 2)), 0, float(g)
    try:
        for count, X in enumerate(balls.iterates(half, MAX_DOUBLINGS, g)):
            F, grown = rounded(X), rounded(X - last)
            e, V = np.linalg.eigh((grown + grown.T) / 2)
            if count and e[0] < 0 and balls.falls(half, count, V[:, 0], g):
                return Climb(count, X, v=V[:, 0])
            w, _ = _answer(P, F, level)
            last, done = X, count
            if w is not None or np.linalg.norm(grown) < CONVERGED * np.linalg.norm(F):
                return Climb(count, X, w)
    except FAILURES:  # what was reached before is proved
        pass
    return Climb(done, last)


def _answer(P: GeneralizedPlant, X: np.ndarray, level: float) -> tuple[np.ndarray | None, np.ndarray]:
    """A disturbance that gains on x'X x, if there is one, else the feedback F of the worst one, w = F x."""
    nw = P.B1.shape[1]
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    R, S = D.T @ D + B.T @ X @ B, P.C1.T @ D + P.A.T @ X @ B
    R[:nw, :nw] -= level**2 * np.eye(nw)
    e, V = np.linalg.eigh(R[:nw, :nw] - R[:nw, nw:] @ np.linalg.solve(R[nw:, nw:], R[nw:, :nw]))
    return (V[:, -1] if e[-1] > 0 else None), -np.linalg.solve(R, S.T)[:nw]


def _step(half: balls.Half, last: Step | None, F: np.ndarray, X: np.ndarray, g: arb) -> Step | None:
    """The step to X, refined, with its factors, or None when an inequality does not hold."""
    new, M = _refined(half, F, X, g)
    X, rest = _two_doubles(new)
    after = inverse_factor(M)
    if after is None or last is None:  # the first one needs no factor at X = 0
        return None if after is None else Step(F, X, rest, np.zeros((0, 0)), after)
    before = inverse_factor(balls.subsolution(half, balls.solution(last), F, g))
    return None if before is None else Step(F, X, rest, before, after)


def _refined(half: balls.Half, F: np.ndarray, X: np.ndarray, g: arb) -> tuple[arb_mat, arb_mat]:
    """The solution near X that leaves `LEFT_OUT` of the cost, and its inequality: Newton's steps in balls."""
    n = len(X)
    new = symmetric(X)
    A, B = rounded(half.A + half.B1 * exact(F)), rounded(half.B2)
    left = LEFT_OUT * max(1.0, float(np.linalg.norm(X))) * np.eye(n)
    for _ in range(REFINED):
        S, K = _reduced(balls.subsolution(half, new, F, g), n)
        change = double(A + B @ K, np.zeros((n, n)), S - left)
        if change is None:
            break
        X, rest = _two_doubles(new + exact(change))
        new = symmetric(X) + symmetric(rest)
    return new, balls.subsolution(half, new, F, g)


def _two_doubles(X: arb_mat) -> tuple[np.ndarray, np.ndarray]:
    """Doubles with the sum X, and what one of them leaves of it."""
    first = rounded(X)
    return first, rounded(X - exact(first))


def _end(
    control: Climb, estimation: Climb, halves: tuple[balls.Half, balls.Half], g: arb
) -> tuple[tuple[Step, ...] | int, tuple[Step, ...] | int, Coupling | Impulse | Fall] | None:
    """What the two sides together contradict the level with, or None."""
    for is_dual, half, side in ((False, halves[0], control), (True, halves[1], estimation)):
        end = None if side.v is None else Fall(side.v, is_dual)
        if side.w is not None:
            factor = inverse_factor(balls.impulse(half, side.X, side.w, g))
            end = None if factor is None else Impulse(side.w, is_dual, factor)
        if end is not None:
            return ((), side.way, end) if is_dual else (side.way, (), end)
    X, Y = rounded(control.X), rounded(estimation.X)
    e = np.linalg.eigvalsh(X)
    shift = max(-2 * float(e[0]), 1e-13 * float(e[-1]))
    if not shift > 0:
        return None
    I = np.eye(len(X))
    L = np.linalg.cholesky(X + shift * I)
    e, V = np.linalg.eigh(L.T @ np.linalg.solve(float(g) ** 2 * I + shift * Y, Y) @ L)
    factor = inverse_factor(control.X + arb(shift) * identity(len(X)))
    if e[-1] <= 1 or factor is None:
        return None
    return control.way, estimation.way, Coupling(np.linalg.solve(L.T, V[:, -1]), shift, factor)
