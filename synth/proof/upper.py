"""The upper bound's witness, found in floating-point arithmetic: nothing here needs to be rigorous.

Coordinates in which the solution of the bounded-real Riccati equation is I, from the solution in balanced coordinates,
refined in balls until the inequality leaves a little more than nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
import scipy.linalg as sla
from flint import arb_mat, ctx

from synth.analysis.truncation import gramian_factor
from synth.equations.doubling import bounded_real, double
from synth.errors import SynthError
from synth.proof import balls
from synth.proof.balls import UpperWitness
from synth.proof.matrices import exact, identity, inverse_factor, reduced, rounded, symmetric
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import pole_rate
from synth.systems.statespace import StateSpace

OUTPUT = (0.0, 1e-12, 1e-8)  # state added to the closed loop's output, squared, for the coordinates alone
UNSEEN = 1e-7  # added to what reaches a state and to what is seen of it, likewise
STRICTNESS = (1e-20, 1e-14)  # what the inequality leaves at least, in these coordinates
NEAR = 1e-6  # norm of what is added to I that Newton's steps take care of
REFINED = 2  # times at most that coordinates are made better, and Newton steps
SAME = 3.0  # factor within which two rates are one
FAILURES = (SynthError, np.linalg.LinAlgError, ArithmeticError, ValueError)  # of an attempt: then there is another


def find_upper(P: GeneralizedPlant, K: StateSpace, level: float, bits: int) -> UpperWitness | None:
    """Coordinates that prove a norm below `level`, or None when none were found."""
    with np.errstate(all="ignore"), ctx.workprec(bits):
        for rate in rates(P.dt, pole_rate(continuous_poles(P.close(K)))):
            try:
                G = balls.closed_loop(P, K, rate)
            except FAILURES:
                continue
            for witness in contractions(G, level, rate):
                if balls.proves_upper(P, K, witness, level, bits):
                    return witness
    return None


def continuous_poles(G: StateSpace) -> np.ndarray:
    """Poles in rad/s, of a discrete system those it has in continuous time."""
    poles = G.poles()
    return 2 / G.dt * (poles - 1) / (poles + 1) if G.discrete else poles


def rates(dt: float, natural: float) -> tuple[float, ...]:
    """Rates to try in turn; 0 stands for discrete time as it is."""
    if dt == 0:
        return (natural,)
    own = not 0 < natural < np.inf or abs(np.log(natural * dt / 2)) < np.log(SAME)
    return (0.0,) if own else (natural, 0.0)


def contractions(G: balls.Balls, level: float, rate: float) -> Iterator[UpperWitness]:
    """Coordinates in which one step of a closed loop, mapped at `rate`, should contract."""
    for added, strictness in product(OUTPUT, STRICTNESS):
        try:
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
    e, V = np.linalg.eigh(reduced(balls.dissipated(M, exact(0 * T)), n)[0])
    left = (V * np.maximum(e, strictness)) @ V.T
    for _ in range(REFINED):
        X = _shift(M, U.T @ left @ U)
        if X is None:
            return None
        if np.linalg.norm(X) < NEAR:
            break
        U = U @ np.linalg.inv(np.linalg.cholesky(np.eye(n) + X)).T
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


def _shift(M: arb_mat, left: np.ndarray) -> np.ndarray | None:
    """What to add to I for a solution of the bounded-real Riccati equation that leaves `left`; None for no solution.

    The equation is shifted by I, nearly its solution, in balls, where nothing cancels.
    """
    E, m, n = rounded(M.transpose() * M - identity(M.ncols())), rounded(M), len(left)
    A, B = m[:n, :n], m[:n, n:]
    W = np.linalg.solve(E[n:, n:], np.hstack([B.T, E[n:, :n]]))
    return double(A - B @ W[:, n:], B @ W[:, :n], E[:n, :n] + left - E[:n, n:] @ W[:, n:])


def _last_digits(M: arb_mat, left: np.ndarray) -> np.ndarray:
    """What to add to I for a solution that leaves `left`, by Newton's steps in balls."""
    n, rest, m = len(left), np.zeros_like(left), rounded(M)
    for _ in range(REFINED):
        S, K = reduced(balls.dissipated(M, symmetric(rest)), n)
        change = double(m[:n, :n] + m[:n, n:] @ K, 0 * rest, left - S)
        if change is None:
            break
        rest = rest + change
    return rest
