"""Witnesses for the proofs in `balls`, found in floating-point arithmetic: nothing here needs to be rigorous.

Upper bound: the solution of the bounded-real Riccati equation, with a little state added to the output so that the
inequality is strict.

Lower bound: policy iteration for the disturbance on both sides, control and estimation, at a level just below the
optimum. Each step answers the feedback w = F x with the best control, a Riccati equation with a little less cost, so
that the inequality is strict, and improves F. It ends when the two solutions couple too strongly, or when one side
has a disturbance that gains without bound.

Reference: Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from flint import arb, ctx

from synth.analysis.precondition import Conditioned, precondition
from synth.equations.doubling import bounded_real, double, solve_riccati
from synth.equations.hinf_riccati import RiccatiRoute, dual
from synth.errors import NumericalError
from synth.proof import balls
from synth.proof.balls import Coupling, Impulse, LowerWitness, Step, UpperWitness
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import design_rate, discretised, pole_rate
from synth.systems.statespace import StateSpace

DISTANCES = (
    2e-7,
    1e-6,
    1e-5,
    1e-4,
    1e-3,
    1e-2,
    0.1,
    0.3,
)  # of the lower bound below the optimum of the Riccati equations
STRICTNESS = (1e-8, 1e-10, 1e-12)  # state added to the closed loop's output for the upper bound, squared
LEFT_OUT = (1e-2, 1e-4)  # cost left out for the lower bound, in parts of the distance
CONVERGED = 1e-9  # relative change of a policy iteration; it is quadratic
MAX_POLICIES = 30


def find_upper(P: GeneralizedPlant, K: StateSpace, level: float, bits: int) -> UpperWitness | None:
    """Coordinates that prove a norm below `level`, or None when none were found."""
    rate = 0.0 if P.dt else pole_rate(P.close(K).poles())
    with ctx.workprec(bits):
        G = balls.closed_loop(P, K, rate)
        T0 = _scales(*(balls.rounded(M) for M in (G.A, G.B, G.C)))
        size = float(np.linalg.norm(balls.rounded(G.C) @ T0)) or 1.0
        for strictness in STRICTNESS:
            T = _contracting(G, T0, level, np.sqrt(strictness) * size)
            U = None if T is None else _refined(G, T, level, strictness)
            if T is None or U is None:
                continue
            M = balls.contraction(G, balls.exact(T) * balls.exact(U), level)
            factor = balls.inverse_factor(balls.identity(M.ncols()) - M.transpose() * M)
            if factor is not None:
                witness = UpperWitness(T, U, factor, rate)
                if balls.proves_upper(P, K, witness, level, bits):
                    return witness
    return None


def _scales(A: np.ndarray, B: np.ndarray, C: np.ndarray) -> np.ndarray:
    """Powers of two that give every state rows and columns of like norms."""
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n], M[n, :n] = np.abs(A), np.linalg.norm(B, axis=1), np.linalg.norm(C, axis=0)
    scale = sla.matrix_balance(M, permute=False, separate=True)[1][0]
    return np.diag(scale[:n] / scale[n])


def _contracting(G: balls.Balls, T: np.ndarray, level: float, added: float) -> np.ndarray | None:
    """Coordinates in which the bounded-real solution is I, from the coordinates T; `added` times these are output."""
    Tb = balls.exact(T)
    Ti = Tb.inv()
    A, B, C, D = (balls.rounded(M) for M in (Ti * G.A * Tb, Ti * G.B, G.C * Tb, G.D))
    n = len(A)
    extended = StateSpace(A, B, np.vstack([C, added * np.eye(n)]), np.vstack([D, np.zeros((n, D.shape[1]))]), 1.0)
    X = bounded_real(extended, level)
    try:
        return None if X is None else T @ np.linalg.inv(np.linalg.cholesky(X)).T
    except np.linalg.LinAlgError:
        return None


def _refined(G: balls.Balls, T: np.ndarray, level: float, strictness: float) -> np.ndarray | None:
    """U, which makes T U such coordinates to the last digit.

    The Riccati equation is shifted by I, nearly its solution, in balls, where nothing cancels.
    """
    M = balls.contraction(G, balls.exact(T), level)
    E, M, n = balls.rounded(M.transpose() * M - balls.identity(M.ncols())), balls.rounded(M), len(T)
    A, B = M[:n, :n], M[:n, n:]
    try:
        W = np.linalg.solve(E[n:, n:], np.hstack([B.T, E[n:, :n]]))
        X = double(A - B @ W[:, n:], B @ W[:, :n], E[:n, :n] + strictness * np.eye(n) - E[:n, n:] @ W[:, n:])
        return None if X is None else np.linalg.inv(np.linalg.cholesky(np.eye(n) + X)).T
    except np.linalg.LinAlgError:
        return None


class Climb(NamedTuple):
    """How far one side came."""

    steps: tuple[Step, ...]
    X: np.ndarray  # (n, n) the last sub-solution
    w: np.ndarray | None  # (nw) a disturbance that gains, where there is one


def find_lower(
    P: GeneralizedPlant, upper: float, level: float | None, bits: int
) -> tuple[tuple[float, LowerWitness] | None, str]:
    """The highest of a few levels below the optimum (or the one given) with its witness, or None and the reason."""
    rate = 0.0 if P.dt else design_rate(P)
    discrete, _ = discretised(P, rate or None)
    c = precondition(discrete)
    before, after = np.linalg.norm(np.linalg.solve(c.T, discrete.B1)), np.linalg.norm(c.plant.B1)
    w = float(after / before) if before and after else 1.0  # `precondition` shares its scale between w and z
    z = 1 / (c.scale * w)
    reason = "no contradiction was found near the optimum of the Riccati equations"
    with ctx.workprec(bits):
        halves = balls.in_coordinates(P, c.T, w, z, rate)
        floating = _rounded(halves, c)
        try:
            route = RiccatiRoute.of(floating)
            optimum = min(route.minimise()[0] * c.scale, upper)
        except NumericalError as error:
            return None, str(error)
        for distance, part in product(DISTANCES, LEFT_OUT):
            g = optimum * (1 - distance) if level is None else level
            control, estimation = (
                _climb(side, half, start, g / c.scale, part * distance)
                for side, half, start in zip((floating, dual(floating)), halves, (route.X, route.Y), strict=True)
            )
            if not (control.steps and estimation.steps):
                reason = (
                    "no strict inequality on one side, as with a zero from u to z or w to y on the stability boundary"
                )
            found = _end(control, estimation, halves, g / c.scale)
            if found is not None:
                witness = LowerWitness(c.T, w, z, rate, *found)
                if balls.proves_lower(P, witness, g, bits):
                    return (float(g), witness), ""
    return None, reason


def _rounded(halves: tuple[balls.Half, balls.Half], c: Conditioned) -> GeneralizedPlant:
    """The conditioned plant once more, from balls, so that it agrees with them to the last digit."""
    control, estimation = halves
    A, B1, B2, C1, D11, D12 = (balls.rounded(M) for M in control)
    C2, D21 = balls.rounded(estimation.B2).T, balls.rounded(estimation.D12).T
    return replace(c.plant, A=A, B1=B1, B2=B2 @ c.Su, C1=C1, D11=D11, D12=D12 @ c.Su, C2=c.Sy @ C2, D21=c.Sy @ D21)


def _climb(P: GeneralizedPlant, half: balls.Half, start: np.ndarray, level: float, strictness: float) -> Climb:
    """Policy iteration for w on one side, up to the game Riccati solution or to a disturbance that gains."""
    n, nw = P.B1.shape
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    R = D.T @ D
    R[:nw, :nw] -= level**2 * np.eye(nw)
    F, X, steps = np.zeros((nw, n)), np.zeros((n, n)), []
    for _ in range(MAX_POLICIES):
        C = P.C1 + P.D11 @ F
        Q = C.T @ C - level**2 * F.T @ F - strictness * np.eye(n)
        answer = solve_riccati(P.A + P.B1 @ F, P.B2, Q, P.D12.T @ P.D12, C.T @ P.D12, start=start)
        step = None if answer is None else _step(half, X, F, answer.X, level)
        if answer is None or step is None:
            break
        grown = np.linalg.norm(answer.X - X)
        X = start = answer.X
        steps.append(step)
        RX, SX = R + B.T @ X @ B, P.C1.T @ D + P.A.T @ X @ B
        e, V = np.linalg.eigh(RX[:nw, :nw] - RX[:nw, nw:] @ np.linalg.solve(RX[nw:, nw:], RX[nw:, :nw]))
        if e[-1] > 0:
            return Climb(tuple(steps), X, V[:, -1])
        if grown < CONVERGED * np.linalg.norm(X):
            break
        F = -np.linalg.solve(RX, SX.T)[:nw]
    return Climb(tuple(steps), X, None)


def _step(half: balls.Half, X: np.ndarray, F: np.ndarray, new: np.ndarray, level: float) -> Step | None:
    """The step from X to `new` with its factors, or None when an inequality does not hold."""
    g = arb(level)
    after = balls.inverse_factor(balls.subsolution(half, balls.symmetric(new), F, g))
    if not np.any(F):  # the first one needs no factor at X = 0
        return None if after is None else Step(F, new, np.zeros((0, 0)), after)
    before = balls.inverse_factor(balls.subsolution(half, balls.symmetric(X), F, g))
    return None if after is None or before is None else Step(F, new, before, after)


def _end(
    control: Climb, estimation: Climb, halves: tuple[balls.Half, balls.Half], level: float
) -> tuple[tuple[Step, ...], tuple[Step, ...], Coupling | Impulse] | None:
    """What the two sides together contradict the level with, or None."""
    g = arb(level)
    for is_dual, half, side in ((False, halves[0], control), (True, halves[1], estimation)):
        if side.w is not None:
            factor = balls.inverse_factor(balls.impulse(half, balls.symmetric(side.X), side.w, g))
            if factor is not None:
                end = Impulse(side.w, is_dual, factor)
                return ((), side.steps, end) if is_dual else (side.steps, (), end)
    X, Y = control.X, estimation.X
    e = np.linalg.eigvalsh(X)
    shift = max(-2 * float(e[0]), 1e-13 * float(e[-1]))
    if not shift > 0:
        return None
    I = np.eye(len(X))
    L = np.linalg.cholesky(X + shift * I)
    e, V = np.linalg.eigh(L.T @ np.linalg.solve(level**2 * I + shift * Y, Y) @ L)
    factor = balls.inverse_factor(balls.symmetric(X) + arb(shift) * balls.identity(len(X)))
    if e[-1] <= 1 or factor is None:
        return None
    return control.steps, estimation.steps, Coupling(np.linalg.solve(L.T, V[:, -1]), shift, factor)
