"""Proofs about H-infinity norms in ball arithmetic: what `certify` claims rests on this file and on Arb alone.

Every number is a midpoint with a radius that encloses the exact result. Plants and controllers enter as the exact
doubles they are; witnesses are doubles too, and a proof is a handful of products with them and one test of positive
definiteness (`matrices`).

Upper bound: with P = I + E > 0 in the coordinates T the bounded real lemma says that the closed loop is stable with
norm below g when

    M = [T^-1 A T   T^-1 B / g]
        [    C T           D / g]       satisfies  diag(P, I) - M' diag(P, I) M > 0.

Lower bound: suppose a controller of any order reaches a norm below g. Its closed loop has a storage function, the
least of which over the controller's states is x'P x with P > 0: for every x and w, not both zero, there is a u with

    x+'P x+ + |z|^2 - g^2 |w|^2 < x'P x,                                                                      (1)

and the dual plant has Q > 0 likewise, with P <= g^2 Q^-1. Call X a sub-solution for F when, with w = F x and
whatever u, x+'X x+ + |z|^2 - g^2 |w|^2 >= x'X x: a matrix inequality linear in X. If X and X' are sub-solutions for
the same F, so are those between them, and P > X implies P > X': on the way P can touch none of them, for at the x of
contact (1) would make x+'P x+ < x+'X x+. The way begins at X = 0, a sub-solution for F = 0, and leads in a few steps
close to the game Riccati solutions of both sides. There is no such controller if

- at P > X some w, from x = 0, gains whatever u is: x+'X x+ + |z|^2 - g^2 |w|^2 > 0; or
- P > X and Q > Y couple too strongly: X + d I <= P + d I <= g^2 Q^-1 + d I gives, as the inverse is monotone,
  (X + d I)^-1 >= Q (g^2 I + d Q)^-1 >= Y (g^2 I + d Y)^-1, which a vector refutes.

From the last sub-solution, 0 when there is none, on to what no strict inequality leads to, as where a zero is on the
stability boundary: by (1) P >= f(P), where f(X)(x) is the largest over w of the least over u of x+'X x+ + |z|^2 - g^2
|w|^2. As f is monotone, and X a sub-solution, X <= f(X) <= f(f(X)) <= ... <= P. If there is such a controller, every
one of these is found as the stationary point: the least over u is that of a positive definite form, D12'D12 + B2'X B2
(a block of the sub-solution's inequality; for X = 0 of R below, which would be singular otherwise), and what is left of
w is negative definite at P, so at all that is less. So they are X + H, H <- H0 + A'H (I + G H)^-1 A from 0, the game
Riccati equation shifted by X, and doubling in balls encloses the 2^k-th: a composition of such maps is a map of this
form wherever its inverses exist, which the balls prove, and rational functions that are equal agree where both are
defined. There is no such controller if an impulse gains there, if both sides couple, or if the 2^k-th is not above the
one of half as many steps.

D22 plays no part. Continuous systems are mapped by Cayley's transform, in balls as well, and discrete ones whose
samples are short beside the time they take to another rate, which is the same map of the unit disk.

E, and the sub-solutions, are sums of two doubles where one does not tell them from what is no solution: the
inequalities leave out as little as 1e-20 of the cost, so that a mode that hardly decays costs nothing either.

References: Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280, on the sub-solutions as an iteration; Chu,
Fan, Lin and Wang (2004), Int. J. Control 77, 767, on doubling; Johansson (2017), IEEE Trans. Computers 66, 1281, on
Arb.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from synth.proof.matrices import (
    block,
    columns,
    exact,
    identity,
    inverse_factor,
    is_positive_definite,
    is_small,
    rows,
    square,
    symmetric,
)
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace, common_timebase

NINE = ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22")  # matrices of a plant


class Balls(NamedTuple):
    """A system in balls."""

    A: arb_mat
    B: arb_mat
    C: arb_mat
    D: arb_mat


class Half(NamedTuple):
    """What one side of the lower bound, control or estimation, sees of the plant: itself or its dual."""

    A: arb_mat
    B1: arb_mat
    B2: arb_mat
    C1: arb_mat
    D11: arb_mat
    D12: arb_mat


@dataclass(frozen=True, eq=False)
class UpperWitness:
    """Coordinates in which one step of the closed loop contracts."""

    T: np.ndarray  # (n, n) states of plant and controller, x = T U x_new: T finds the size of things,
    U: np.ndarray  # (n, n) U, not far from I, more digits
    rest: np.ndarray  # (n, n) E, the last digits
    factor: np.ndarray  # (n + nw, n + nw) nearly the inverse Cholesky factor of the inequality
    rate: float  # rad/s of the map to discrete time, 0 for discrete time as it is


@dataclass(frozen=True, eq=False)
class Step:
    """From one sub-solution to the next, both for the same disturbance w = F x."""

    F: np.ndarray  # (nw, n)
    X: np.ndarray  # (n, n) symmetric, the next one,
    rest: np.ndarray  # (n, n) and its last digits: the next one is X + rest
    before: np.ndarray  # (n + nu, n + nu) nearly the inverse Cholesky factor of the inequality at the previous one
    after: np.ndarray  # (n + nu, n + nu) the same at the next one


@dataclass(frozen=True, eq=False)
class Coupling:
    """A vector for which the last sub-solutions X and Y of both sides couple too strongly."""

    v: np.ndarray  # (n)
    shift: float  # d
    factor: np.ndarray  # (n, n) nearly the inverse Cholesky factor of X + d I


@dataclass(frozen=True, eq=False)
class Impulse:
    """A disturbance from rest that gains on one side."""

    w: np.ndarray  # (nw), of the dual plant (nz)
    dual: bool  # whose side
    factor: np.ndarray  # (1 + nu, 1 + nu) nearly the inverse Cholesky factor of the gain


@dataclass(frozen=True, eq=False)
class Fall:
    """A state whose cost is less after 2^k iterations than after half as many, on one side."""

    v: np.ndarray  # (n)
    dual: bool  # whose side


@dataclass(frozen=True, eq=False)
class LowerWitness:
    """Two ways up to what a controller below the level would not allow."""

    T: np.ndarray  # (n, n) states of the plant, x = T x_new
    w: float  # factor on the gains from w
    z: float  # factor on the gains to z
    rate: float  # rad/s of the map to discrete time, 0 for discrete time as it is
    control: tuple[Step, ...]  # of the plant
    estimation: tuple[Step, ...]  # of the dual plant
    end: Coupling | Impulse | Fall
    doubled: tuple[int, int] = (0, 0)  # k of control and of estimation: from there on 2^(k-1) iterations, 0 for none


def proves_upper(P: GeneralizedPlant, K: StateSpace, witness: UpperWitness, level: float, bits: int) -> bool:
    """True when it is proved that K stabilises P with an H-infinity norm below `level`."""
    if not is_rate(witness.rate, P.dt):
        return False
    with ctx.workprec(bits):
        try:
            return contracts(closed_loop(P, K, witness.rate), witness, level)
        except (ZeroDivisionError, ValueError):  # a matrix that could be singular, shapes of another system
            return False


def contracts(G: Balls, witness: UpperWitness, level: float) -> bool:
    """True when a discrete system is proved stable with an H-infinity norm below `level`.

    Raises
    ------
    ZeroDivisionError, ValueError : a matrix that could be singular, shapes of another system.
    """
    M = contraction(G, exact(witness.T) * exact(witness.U), level)
    E = symmetric(witness.rest)
    ours = witness.rest.shape == witness.T.shape and bool(arb(level) > 0)
    return ours and is_small(E) and is_positive_definite(dissipated(M, E), witness.factor)


def proves_lower(P: GeneralizedPlant, witness: LowerWitness, level: float, bits: int) -> bool:
    """True when it is proved that no controller of any order reaches a norm below `level`."""
    if not is_rate(witness.rate, P.dt):
        return False
    with ctx.workprec(bits):
        g, end = arb(level) * arb(witness.w) * arb(witness.z), witness.end
        if not g > 0:
            return False
        try:
            control, estimation = in_coordinates(P, witness.T, witness.w, witness.z, witness.rate)
            ways = (control, witness.control, witness.doubled[0]), (estimation, witness.estimation, witness.doubled[1])
            if isinstance(end, Coupling):
                X, Y = (climb(*way, g) for way in ways)
                return X is not None and Y is not None and couples(X.last, Y.last, end, g)
            way = ways[1 if end.dual else 0]
            X = climb(*way, g)
            if X is None:
                return False
            if isinstance(end, Fall):
                return way[2] > 0 and falls(X, end.v)
            return is_positive_definite(impulse(way[0], X.last, end.w, g), end.factor)
        except (ZeroDivisionError, ValueError):
            return False


class Reached(NamedTuple):
    """What P exceeds at the end of a way, and with half as many iterations."""

    half: arb_mat
    last: arb_mat


def climb(half: Half, steps: Sequence[Step], doubled: int, g: arb) -> Reached | None:
    """What P exceeds at the end of the way, or None where a step is not proved."""
    X = exact(np.zeros((half.A.nrows(),) * 2))
    for k, step in enumerate(steps):
        new = solution(step)
        given = k == 0 and not np.any(step.F)  # |C1 x + D12 u|^2 >= 0
        if not given and not is_positive_definite(subsolution(half, X, step.F, g), step.before):
            return None
        if not is_positive_definite(subsolution(half, new, step.F, g), step.after):
            return None
        X = new
    reached = Reached(X, X)
    for found in islice(iterates(half, X, g), doubled):
        reached = Reached(reached.last, found)
    return reached


def iterates(half: Half, X: arb_mat, g: arb) -> Iterator[arb_mat]:
    """The first, second, fourth, ... iterate of the game Riccati equation from X, without end.

    Raises
    ------
    ZeroDivisionError : a matrix that is inverted could be singular.
    """
    B, D = block([[half.B1, half.B2]]), block([[half.D11, half.D12]])
    nw, nu, I, At = half.B1.ncols(), half.B2.ncols(), identity(half.A.nrows()), half.A.transpose()
    R = D.transpose() * D + B.transpose() * X * B - exact(np.diag([1.0] * nw + [0.0] * nu)) * (g * g)
    S = half.C1.transpose() * D + At * X * B
    A, G = half.A - B * R.solve(S.transpose()), B * R.solve(B.transpose())
    H = half.C1.transpose() * half.C1 + At * X * half.A - X - S * R.solve(S.transpose())
    while True:
        yield X + H
        E = I + G * H
        A, G, H = A * E.solve(A), G + A * E.solve(G) * A.transpose(), H + A.transpose() * H * E.solve(A)


def falls(reached: Reached, v: np.ndarray) -> bool:
    """True when v is proved to cost less than with half as many iterations."""
    x = exact(v[:, None])
    return bool((x.transpose() * (reached.last - reached.half) * x)[0, 0] < 0)


def solution(step: Step) -> arb_mat:
    """The sub-solution to which a step leads."""
    return symmetric(step.X) + symmetric(step.rest)


def subsolution(half: Half, X: arb_mat, F: np.ndarray, g: arb) -> arb_mat:
    """x+'X x+ + |z|^2 - g^2 |w|^2 - x'X x with w = F x, as a matrix in (x, u)."""
    f = exact(F)
    AB, CD = block([[half.A + half.B1 * f, half.B2]]), block([[half.C1 + half.D11 * f, half.D12]])
    n, m = half.A.nrows(), half.B2.ncols()
    O = exact(np.zeros((m, n)))
    paid = block([[X + f.transpose() * f * (g * g), O.transpose()], [O, exact(np.zeros((m, m)))]])
    return AB.transpose() * X * AB + CD.transpose() * CD - paid


def impulse(half: Half, X: arb_mat, w: np.ndarray, g: arb) -> arb_mat:
    """x+'X x+ + |z|^2 - g^2 |w|^2 from x = 0, as a matrix in (the size of w, u)."""
    f = exact(w[:, None])
    B, D = block([[half.B1 * f, half.B2]]), block([[half.D11 * f, half.D12]])
    paid = exact(np.diag([1.0] + [0.0] * half.B2.ncols())) * (g * g * square(f))
    return B.transpose() * X * B + D.transpose() * D - paid


def couples(X: arb_mat, Y: arb_mat, end: Coupling, g: arb) -> bool:
    """True when the coupling is proved to be too strong."""
    I, v, d = identity(X.nrows()), exact(end.v[:, None]), arb(end.shift)
    if not (d > 0 and is_positive_definite(X + d * I, end.factor)):
        return False
    a, E = (X + d * I) * v, g * g * I + d * Y
    factor = inverse_factor(E)
    if factor is None or not is_positive_definite(E, factor):
        return False
    return bool((a.transpose() * Y * E.solve(a) - v.transpose() * a)[0, 0] > 0)


def in_coordinates(P: GeneralizedPlant, T: np.ndarray, w: float, z: float, rate: float) -> tuple[Half, Half]:
    """The plant with x = T x_new and factors on w and z, mapped to discrete time, and its dual."""
    _, nw, nu, nz, ny = P.sizes
    G = mapped(in_balls(P.system), P.dt, rate)
    t, ws, zs = exact(T), arb(w), arb(z)
    A, B, C = t.inv() * G.A * t, t.inv() * G.B, G.C * t
    first, second = range(nw), range(nw, nw + nu)
    Z, Y = range(nz), range(nz, nz + ny)
    B1, B2, C1, C2 = columns(B, first) * ws, columns(B, second), rows(C, Z) * zs, rows(C, Y)
    D11, D12 = columns(rows(G.D, Z), first) * (ws * zs), columns(rows(G.D, Z), second) * zs
    D21 = columns(rows(G.D, Y), first) * ws
    dual = (M.transpose() for M in (A, C1, C2, B1, D11, D21))
    return Half(A, B1, B2, C1, D11, D12), Half(*dual)


def closed_loop(P: GeneralizedPlant, K: StateSpace, rate: float) -> Balls:
    """P closed by u = K y, from w to z; mapped to discrete time when `rate` is not zero."""
    common_timebase(P.system, K)
    return mapped(closed({name: exact(getattr(P, name)) for name in NINE}, K), P.dt, rate)


def closed(P: Mapping[str, arb_mat], K: StateSpace) -> Balls:
    """A plant in balls, its nine matrices by name, closed by u = K y."""
    D12, D22, k = P["D12"], P["D22"], in_balls(K)
    E = identity(K.ny) - k.D * D22
    # u = E^-1 (Dk C2 x + Ck xk + Dk D21 w), y = C2 x + D21 w + D22 u
    Ux, Uk, Uw = E.solve(k.D * P["C2"]), E.solve(k.C), E.solve(k.D * P["D21"])
    A = [[P["A"] + P["B2"] * Ux, P["B2"] * Uk], [k.B * (P["C2"] + D22 * Ux), k.A + k.B * D22 * Uk]]
    B = [[P["B1"] + P["B2"] * Uw], [k.B * (P["D21"] + D22 * Uw)]]
    return Balls(block(A), block(B), block([[P["C1"] + D12 * Ux, D12 * Uk]]), P["D11"] + D12 * Uw)


def mapped(G: Balls, dt: float, rate: float) -> Balls:
    """Norm-preserving map to the discrete time of `rate`; for rate 0 the system itself, which is discrete.

    Cayley's s = rate (z - 1)/(z + 1) of continuous time; there and back again, at 2/dt and at `rate`, of discrete time.
    """
    if rate == 0:
        return G
    r, I = arb(rate), identity(G.A.nrows())
    if dt == 0:
        E, root = r * I - G.A, (2 * r).sqrt()
        return Balls(E.solve(r * I + G.A), E.solve(G.B) * root, G.C * E.inv() * root, G.D + G.C * E.solve(G.B))
    own = 2 / arb(dt)
    c = (r - own) / (r + own)
    E, root = I + c * G.A, (1 - c * c).sqrt()
    return Balls(E.solve(G.A + c * I), E.solve(G.B) * root, G.C * E.inv() * root, G.D - G.C * E.solve(G.B) * c)


def is_rate(rate: float, dt: float) -> bool:
    """Whether systems with this timebase may be mapped at this rate."""
    return np.isfinite(rate) and (rate > 0 or (rate == 0 and dt > 0))


def contraction(G: Balls, T: arb_mat, level: float) -> arb_mat:
    """M of the upper bound."""
    Ti, g = T.inv(), arb(level)
    return block([[Ti * G.A * T, Ti * G.B * (1 / g)], [G.C * T, G.D * (1 / g)]])


def dissipated(M: arb_mat, E: arb_mat) -> arb_mat:
    """diag(I + E, I) - M' diag(I + E, I) M of the upper bound."""
    n, paid = E.nrows(), identity(M.ncols()) - M.transpose() * M
    AB = rows(M, range(n))
    O = exact(np.zeros((n, M.ncols() - n)))
    added = block([[E, O], [O.transpose(), exact(np.zeros((M.ncols() - n,) * 2))]])
    return paid + added - AB.transpose() * E * AB


def in_balls(G: StateSpace) -> Balls:
    """The system's doubles, exactly."""
    return Balls(exact(G.A), exact(G.B), exact(G.C), exact(G.D))
