"""Uncertain plants from continuous to discrete time: exact maps, and polynomials with remainders elsewhere."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import scipy.linalg as sla

from synth.errors import ModelError
from synth.systems.expressions import eye, zeros
from synth.systems.parameters import as_expression
from synth.systems.polynomialholds import polynomial_hold
from synth.systems.uncertain import UncertainSystem, algebraic


def sampled_uncertain(G: UncertainSystem, dt: float, method: str, tol: float) -> UncertainSystem:
    """By a hold ("zoh", within `tol` where it is no polynomial), by "tustin" or by "midpoint"; see `synth.c2d`."""
    if method == "zoh":
        return _uncertain_hold(G, dt, tol)
    return (_uncertain_tustin if method == "tustin" else _uncertain_midpoint)(G, dt)


def _uncertain_hold(G: UncertainSystem, dt: float, tol: float) -> UncertainSystem:
    """The hold equivalent x+ = x + dt v1 + dt^2/2 v2 + ..., E v1 = A x + B u, E v2 = A v1, ..., where v ends.

    The v are algebraic states, so that nothing is divided by a parameter; zeros of E and A say which there are.
    """
    if not algebraic(G.E).any():
        if not any(entry.parameters for M in (G.E, G.A) for entry in M.flat):
            F = G.nominal.A
            exponential = sla.expm(dt * np.block([[F, np.eye(G.n)], [np.zeros((G.n, 2 * G.n))]]))
            E = np.array([[entry.nominal for entry in row] for row in G.E])
            held = exponential[: G.n, G.n :] @ np.linalg.inv(E) @ G.B
            return UncertainSystem(None, exponential[: G.n, : G.n], held, G.C, G.D, dt, G.u, G.y)
        if (chain := _derivatives(G)) is not None:
            return _taylor(G, dt, chain)
        return _polynomial(G, dt, tol)
    raise ModelError(
        "method is 'zoh' and the system G has algebraic states, whose hold equivalent is not made; pass "
        "method='tustin', which is an exact map of its own, or sample G.at(values)"
    )


def _polynomial(G: UncertainSystem, dt: float, tol: float) -> UncertainSystem:
    """x+ = x + Phi v, E v = A x + B u: v are algebraic states, Phi are polynomials with remainders."""
    n, E, B = G.n, zeros(2 * G.n, 2 * G.n), zeros(2 * G.n, G.nu)
    E[:n, :n] = eye(n)
    A = np.block([[eye(n), polynomial_hold(G.E, G.A, dt, tol)], [G.A, -G.E]])
    B[n:] = G.B
    return UncertainSystem(E, A, B, np.hstack([G.C, zeros(G.ny, n)]), G.D, dt, G.u, G.y)


def _derivatives(G: UncertainSystem) -> list[np.ndarray] | None:
    """Which states have a derivative of order 1, 2, ... under a held input; None where they do not end.

    By the zeros of E and A: states have none if their rows of A see only states without one of the order before, and
    their rows of E one another.
    """
    E, A = (np.array([[not entry.is_zero for entry in row] for row in M], bool).reshape(M.shape) for M in (G.E, G.A))
    chain = [np.ones(G.n, bool)]
    while chain[-1].any():
        if len(chain) > G.n + 1:
            return None
        moving = A[:, chain[-1]].any(axis=1)
        for _ in range(G.n):
            moving = moving | np.any(E[:, moving], axis=1)
        chain.append(np.asarray(moving, bool))
    return chain[:-1]


def _taylor(G: UncertainSystem, dt: float, chain: list[np.ndarray]) -> UncertainSystem:
    """The series with the derivatives of `chain` as algebraic states."""
    parts = [np.flatnonzero(moving) for moving in chain]
    starts = np.cumsum([G.n, *(len(part) for part in parts)])
    n, x = int(starts[-1]), range(G.n)
    E, A, B, C = zeros(n, n), zeros(n, n), zeros(n, G.nu), zeros(G.ny, n)
    E[np.ix_(x, x)] = A[np.ix_(x, x)] = eye(G.n)
    C[:, x] = G.C
    before, factor = np.arange(G.n), Fraction(1)
    for k, part in enumerate(parts):
        own, factor = range(int(starts[k]), int(starts[k + 1])), factor * Fraction(dt) / (k + 1)
        A[part, own] = [as_expression("dt", factor)] * len(part)
        A[np.ix_(own, own)] = -G.E[np.ix_(part, part)]
        source = range(G.n) if k == 0 else range(int(starts[k - 1]), int(starts[k]))
        A[np.ix_(own, source)] = G.A[np.ix_(part, before)]
        before = part
    B[starts[0] : starts[1]] = G.B
    return UncertainSystem(E, A, B, C, G.D, dt, G.u, G.y)


def _uncertain_tustin(G: UncertainSystem, dt: float) -> UncertainSystem:
    """Tustin's map without an inverse: (2/dt) E (q - x) = A (q + x) + B u with x+ = q, an algebraic state."""
    fixed = algebraic(G.E)
    E, A = G.E * (2 / Fraction(dt)), G.A
    x, a = np.flatnonzero(~fixed), np.flatnonzero(fixed)
    k, n = len(x), G.n + len(x)
    first, held, own = range(k), range(k, 2 * k), range(2 * k, n)
    Ed, Ad, Bd, Cd = zeros(n, n), zeros(n, n), zeros(n, G.nu), zeros(G.ny, n)
    Ed[np.ix_(first, first)] = Ad[np.ix_(first, held)] = eye(k)
    Ad[np.ix_(held, first)], Ad[np.ix_(held, held)] = (A + E)[np.ix_(x, x)], (A - E)[np.ix_(x, x)]
    Ad[np.ix_(held, own)], Ad[np.ix_(own, own)] = A[np.ix_(x, a)], A[np.ix_(a, a)]
    Ad[np.ix_(own, first)] = Ad[np.ix_(own, held)] = A[np.ix_(a, x)]
    Bd[held], Bd[own] = G.B[x], G.B[a]
    Cd[:, first] = Cd[:, held] = G.C[:, x]
    Cd[:, own] = G.C[:, a]
    return UncertainSystem(Ed, Ad, Bd, Cd, G.D, dt, G.u, G.y)


def _uncertain_midpoint(G: UncertainSystem, dt: float) -> UncertainSystem:
    """The midpoint rule with a held input: of the same degrees in the parameters as G."""
    if algebraic(G.E).any():
        raise ModelError("the system G has algebraic states, which the midpoint rule does not keep; pass 'tustin'")
    h = Fraction(dt)
    return UncertainSystem(G.E - G.A * (h / 2), G.E + G.A * (h / 2), G.B * h, G.C, G.D, dt, G.u, G.y)
