"""Algebraic Riccati equations `care`, `dare` with a verdict: one, or thousands at once, in NumPy.

A batch is doubled and corrected by one step of Newton's method, all lanes together. What rounding leaves in doubt there
is solved alone: on states scaled by powers of two, from several starts, refined until the residual no longer falls.
A solution is accepted when its residual is small on the data given, and when its closed loop is stable for all that
rounding may have done (`synth.equations.refinement`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import get_lapack_funcs

from synth.checks import SYMMETRIC, as_array
from synth.equations.refinement import (
    CERTAIN,
    ROUNDED,
    Equation,
    Evaluated,
    Inverse,
    Judged,
    by_schur,
    by_squaring,
    evaluate,
    judged,
    rooted,
    size,
)
from synth.equations.starts import Folded, doubling, folded, hamiltonian, pencil, schur
from synth.errors import ModelError
from synth.systems.modes import crosses, decay, doubts, unreachable, unseen

ACCURATE = 1e-14  # relative residual at which no other start is tried
TOGETHER = 1e-14  # relative residual, per root of the states, up to which a lane needs no solution of its own
UNDOUBTED = 1e-2  # doubt up to which a lane needs none
ACCEPTED = 1e-12  # relative residual; a solution worse than this is no solution
SINGULAR = 1e-14  # relative singular value of a descriptor matrix
FAR = 1e-5  # relative distance of a closed loop's poles from the boundary that rounding does not make
SURE = 10.0  # doubts by which a mode of the plant is off the boundary: its coordinates cost some
DOUBTED = 1e6  # doubt beyond which poles that look sound come from multiple roots on the boundary
PLAIN = 1e-3  # the same at a glance
SETTLED = 1e-10  # relative size of a step of Newton's method whose square is lost in rounding
SQUARED = 1e-8  # the same where the residual is at rounding too
NEWTON_STEPS = 20
STEPS_TOGETHER = 8  # of Newton's method; a lane that needs more is solved alone
FEW = 2  # lanes that are quicker alone
LANES = 2**17  # numbers in one matrix of all lanes that go together: they stay near the processor

(gebal,) = get_lapack_funcs(("gebal",), dtype=np.float64)


class Solution(NamedTuple):
    """Stabilising solution of a Riccati equation; without meaning where `ok` is false."""

    X: Any  # (..., n, n)
    ok: Any  # (...) bool


class Solved(NamedTuple):
    """Stabilising solution of one equation, and how good it is."""

    X: np.ndarray  # (n, n)
    K: np.ndarray  # (m, n) u = -K x
    poles: np.ndarray  # (n,) complex, of the closed loop
    ok: bool
    judge: Callable[[], Judged]  # residual, condition and doubt, when they are asked for


class Found(NamedTuple):
    """A refined solution, its Lyapunov operator's inverse, and the poles where they fell out."""

    v: Evaluated
    inverse: Inverse
    poles: np.ndarray | None
    settled: bool  # Newton's last step was as good as nothing

    def plain(self, e: Equation) -> bool:
        """Whether it is certain at a glance: settled, its residual nothing beside Q, its poles far from the axis."""
        return bool(
            self.settled
            and self.poles is not None
            and size(self.v.off) <= ACCURATE * size(e.Q)
            and -max(np.real(self.poles).tolist()) > PLAIN * size(self.v.closed)
        )


def care(A, B, Q, R=None, N=None, E=None) -> Solution:
    """Stabilising solutions of A'X E + E'X A - (E'X B + N) R^-1 (E'X B + N)' + Q = 0, one or many, as NumPy arrays.

    Parameters
    ----------
    A : (..., n, n); B : (..., n, m); Q : (..., n, n) symmetric, of any signature
    R : (..., m, m) symmetric, positive definite; identity when left out
    N : (..., n, m) cross weight; zero when left out
    E : (..., n, n) invertible; identity when left out

    Returns
    -------
    Solution : X (..., n, n) and ok (...); not ok where (A, B) cannot be stabilised, where Q does not see a mode on the
        imaginary axis, or where an indefinite Q leaves no optimum

    Raises
    ------
    ModelError : shapes do not fit, a number is not finite, Q or R is not symmetric, R not positive, E singular.
    """
    return _all(_checked(A, B, Q, R, N, E, discrete=False))


def dare(A, B, Q, R=None, N=None, E=None) -> Solution:
    """Stabilising solutions of E'X E = A'X A - (A'X B + N) (R + B'X B)^-1 (A'X B + N)' + Q, as `care`.

    The boundary is the unit circle. R may be singular, zero or indefinite, as long as R + B'X B is not singular.
    """
    return _all(_checked(A, B, Q, R, N, E, discrete=True))


def solve(e: Equation) -> Solved:
    """Stabilising solution of one equation with finite data, R symmetric and, in continuous time, positive definite."""
    n = len(e.A)
    with np.errstate(all="ignore"):
        inverse_E = None if e.E is None else np.linalg.inv(e.E)
        try:
            f = folded(e, inverse_E)
            H = hamiltonian(f)
            t = _scales(H)
        except np.linalg.LinAlgError:  # R is singular
            f, H, t = None, None, np.ones(n)
        e, r = _scaled(e, t)
        if inverse_E is not None:
            inverse_E = inverse_E / t[:, None] / r
        best, ok, least = None, False, np.inf
        for X in _starts(e, f, H, t, inverse_E):
            if X is None or (found := _refined(e, X, inverse_E)) is None:
                continue
            if found.plain(e):
                best, ok = found, True
                break
            j = judged(e, found.v, found.inverse, inverse_E)
            if j.residual < least:
                best, least = found, j.residual
                ok = j.residual <= ACCEPTED and (j.doubt < CERTAIN or _stands(e, found.v, j))
            if least <= ACCURATE:  # the stabilising solution is one: another start leads to it too
                break
    if best is None:
        nothing = np.full((n, n), np.nan)
        return Solved(nothing, nothing, nothing[0].astype(complex), False, lambda: Judged(np.inf, np.inf, np.inf))
    v, inverse, poles, _ = best
    poles = np.linalg.eigvals(v.closed).astype(complex) if poles is None else poles
    return Solved(r[:, None] * v.X * r, v.K / t, poles, bool(ok), partial(judged, e, v, inverse, inverse_E))


def _scaled(e: Equation, t: np.ndarray) -> tuple[Equation, np.ndarray]:
    """The equation of the states x / t, and the powers of two r, (n,), by which its rows were multiplied."""
    if e.E is None:
        E, r = None, 1 / t
    else:
        E = e.E * t
        r = np.exp2(-np.round(np.log2(np.abs(E).max(1))))
        E = r[:, None] * E
    columns, rows = t[:, None], r[:, None]
    return Equation(e.A * (rows * t), e.B * rows, e.Q * (columns * t), e.R, e.N * columns, E, e.discrete), r


def _scales(H: np.ndarray) -> np.ndarray:
    """Powers of two, (n,), x = scales x_new, that balance a Hamiltonian matrix; going back is exact."""
    n = len(H) // 2
    *_, s, _ = gebal(H, scale=1, permute=0)
    powers = np.frexp(s)[1]
    t = np.ldexp(1.0, (powers[:n] - powers[n:]) // 2)
    return t if math.isfinite((t @ t) * (1 / t @ (1 / t))) else np.ones(n)


def _starts(e, f, H, t, inverse_E) -> Iterator[np.ndarray | None]:
    """First solutions of the scaled equation, the quickest first."""
    if f is not None:
        back = (lambda X: X) if inverse_E is None else (lambda X: inverse_E.T @ X @ inverse_E)
        columns = t[:, None]
        if not e.discrete:
            d = np.concatenate([t, 1 / t])
            if (X := schur(H * d / d[:, None])) is not None:
                yield back(X)
        scaled = Folded(f.A * t / columns, f.G / t / columns, columns * f.Q * t)
        yield back(doubling(Folded(*(M[None] for M in scaled)), discrete=e.discrete)[0])
    yield pencil(e)


def _refined(e: Equation, X: np.ndarray, inverse_E: np.ndarray | None) -> Found | None:
    """Newton's method until the residual no longer falls, or must be at rounding; None where no loop is stable."""
    best, least, step = None, np.inf, np.inf
    for _ in range(NEWTON_STEPS):
        try:
            v = evaluate(e, X, inverse_E)
        except np.linalg.LinAlgError:
            break
        left, settled = size(v.off), step <= SETTLED
        if not left < least and not settled:
            break
        if e.discrete:
            (stable, inverse), poles = by_squaring(v.closed, True), None
        elif best is None or step > ROUNDED:  # less moves no pole
            poles, inverse = by_schur(v.closed)
            stable = -max(np.real(poles).tolist()) > ROUNDED * size(v.closed)
        if not stable:
            break
        best = Found(v, inverse, poles, settled)
        if settled or left > least / 2:
            break
        D, least = inverse(v.off), left
        if inverse_E is not None:
            D = inverse_E.T @ D @ inverse_E
        X = X + D
        X = (X + X.T) / 2
        step = size(D) / (size(X) or 1.0)
    return best


def _stands(e: Equation, v: Evaluated, j: Judged) -> bool:
    """Whether the regulator is right mode by mode although the equation as a whole is ill-conditioned.

    Every mode that does not decay by itself is moved, semidefinite weights see those on the boundary, and the closed
    loop decays. Rounding makes stable poles of roots on the boundary too, of multiple ones with a doubt beyond all
    bounds: either the plant surely has no mode there, or the doubt is small for poles that slow. Indefinite weights say
    nothing of modes.
    """
    A, B = (e.A, e.B) if e.E is None else (np.linalg.solve(e.E, e.A), np.linalg.solve(e.E, e.B))
    F = np.linalg.pinv(e.R, hermitian=True) @ e.N.T
    if crosses(v.closed, discrete=e.discrete) or unreachable(A, B, discrete=e.discrete):
        return False
    poles = np.linalg.eigvals(v.closed)
    near = FAR if e.discrete else FAR * np.abs(poles).max()
    far = bool((decay(poles, discrete=e.discrete) > near).all())
    if not semidefinite(e):
        return far and j.doubt < 1
    A = A - B @ F
    own, doubt = doubts(A)  # to which zeros that a change of coordinates left as small numbers are data
    rates = decay(own, discrete=e.discrete)
    if (rates - doubt > near).all():  # of a plant that decays, all is seen and moved
        return True
    sure = bool((np.abs(rates) > SURE * np.maximum(doubt, ROUNDED * size(A))).all())
    believed = j.doubt < (DOUBTED if sure or far else 1)
    return bool(believed) and not unseen(A, e.Q - e.N @ F, discrete=e.discrete)


def semidefinite(e: Equation) -> bool:
    """Whether the weights of one equation are positive semidefinite to rounding, its states being balanced."""
    d = np.sqrt(np.abs(np.diag(e.R)))
    d[d == 0] = 1.0
    R, N = e.R / np.outer(d, d), e.N / d
    Q = e.Q - N @ np.linalg.pinv(R, hermitian=True) @ N.T
    rounding = SYMMETRIC * sum(e.B.shape)
    return bool(
        np.linalg.eigvalsh(R)[0] >= -rounding and np.linalg.eigvalsh(Q)[0] >= -rounding * np.abs(e.Q).max(initial=0.0)
    )


def _all(e: Equation) -> Solution:
    """Every lane: together, and alone where that leaves doubt."""
    lead, n = e.A.shape[:-2], e.A.shape[-1]
    lanes = e.each(lambda M: M.reshape(-1, *M.shape[-2:]))
    X, ok, count = np.zeros(lanes.A.shape), np.zeros(len(lanes.A), bool), max(LANES // max(n, 1) ** 2, 1)
    for k in range(0, len(X) if n else 0, count):
        part = slice(k, k + count)
        X[part], ok[part] = _together(lanes.each(lambda M, part=part: M[part]))
    for k in np.flatnonzero(~ok) if n else ():
        alone = solve(lanes.each(lambda M, k=k: M[k]))
        X[k], ok[k] = alone.X, alone.ok
    return Solution(X.reshape(*lead, n, n), (ok | (n == 0)).reshape(lead))


def _together(e: Equation) -> tuple[np.ndarray, np.ndarray]:
    """X of many equations, (b, n, n), and where it is certain, (b)."""
    with np.errstate(all="ignore"):
        inverse_E = None if e.E is None else np.linalg.inv(e.E)
        try:
            f = folded(e, inverse_E)
        except np.linalg.LinAlgError:
            return np.full(e.A.shape, np.nan), np.zeros(len(e.A), bool)
        X, certain, lanes = doubling(f, discrete=e.discrete), np.zeros(len(e.A), bool), np.arange(len(e.A))
        if inverse_E is not None:
            X = inverse_E.mT @ X @ inverse_E
        for _ in range(STEPS_TOGETHER):
            part = lanes if len(lanes) < len(X) else slice(None)
            own = None if inverse_E is None else inverse_E[part]
            X[part], certain[part], settled = _step(e.each(lambda M, part=part: M[part]), X[part], own)
            lanes = lanes[~settled & np.isfinite(X[lanes]).all((-2, -1))]
            if len(lanes) <= FEW:
                break
    return X, certain


def _step(e: Equation, X: np.ndarray, inverse_E: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Newton's step from X (b, n, n), where what it leads to is certain, and where no other step is needed."""
    v = evaluate(e, X, inverse_E)
    stable, inverse = by_squaring(v.closed, e.discrete)
    D = inverse(v.off)
    D = D if inverse_E is None else inverse_E.mT @ D @ inverse_E
    X = X + D
    v = evaluate(e, (X + X.mT) / 2, inverse_E)
    j = judged(e, v, inverse, inverse_E)  # whose closed loop is the last one's but for the square of D
    settled = (j.residual <= TOGETHER * math.sqrt(X.shape[-1])) & (size(D) <= SQUARED * size(X))
    return v.X, stable & settled & (j.doubt < UNDOUBTED), settled


def _checked(A, B, Q, R, N, E, *, discrete: bool) -> Equation:
    """The arguments with the same leading axes, as NumPy arrays."""
    named = {"A": A, "B": B, "Q": Q} | {k: M for k, M in {"R": R, "N": N, "E": E}.items() if M is not None}
    arrays = {name: as_array(name, value, finite=False) for name, value in named.items()}
    for name, value in arrays.items():
        if value.ndim < 2 or not np.isfinite(value).all():
            raise ModelError(f"{name} is no array of finite matrices (shape {value.shape}); pass (..., rows, columns)")
    n, m = arrays["B"].shape[-2:]
    for name, want in {"A": (n, n), "Q": (n, n), "R": (m, m), "N": (n, m), "E": (n, n)}.items():
        if name in arrays and arrays[name].shape[-2:] != want:
            raise ModelError(f"{name} has shape {arrays[name].shape}; B of {n} x {m} needs {want[0]} x {want[1]}")
    for name in {"Q", "R"} & set(arrays):
        M = arrays[name]
        skew = np.abs(M - M.mT).max(initial=0.0)
        if skew > SYMMETRIC * np.abs(M).max(initial=0.0):
            raise ModelError(f"{name} is not symmetric: asymmetry {skew:.6g}; pass ({name} + {name}')/2, the same cost")
        if skew > 0:
            arrays[name] = (M + M.mT) / 2
    if R is not None and not discrete and not is_definite(arrays["R"]):
        least = np.linalg.eigvalsh(arrays["R"]).min()
        raise ModelError(f"R is not symmetric positive definite: eigenvalue {least:.6g}")
    if E is not None:
        check_descriptor(arrays["E"])
    full = {"R": np.eye(m), "N": np.zeros((n, m))} | arrays
    try:
        lead = np.broadcast_shapes(*(M.shape[:-2] for M in full.values()))
    except ValueError:
        shapes = ", ".join(f"{name} {M.shape}" for name, M in arrays.items())
        raise ModelError(f"the leading axes do not fit: {shapes}; pass as many of each, or one") from None
    wide = {name: np.broadcast_to(M, (*lead, *M.shape[-2:])) for name, M in full.items()}
    return Equation(wide["A"], wide["B"], wide["Q"], wide["R"], wide["N"], wide.get("E"), discrete)


def is_definite(R: np.ndarray) -> bool:
    """Whether symmetric matrices are positive definite beyond rounding; the units of each row do not matter."""
    try:
        roots = rooted(R).diagonal(0, -2, -1)
    except np.linalg.LinAlgError:
        return False
    return bool((roots * roots > SYMMETRIC * R.diagonal(0, -2, -1)).all())


def check_descriptor(E: np.ndarray) -> None:
    """Raise ModelError for a singular descriptor matrix (..., n, n); units of its rows and columns do not matter."""
    with np.errstate(all="ignore"):
        scaled = E / np.abs(E).max(-1, keepdims=True)
        scaled = scaled / np.abs(scaled).max(-2, keepdims=True)
    if np.isfinite(scaled).all():
        values = np.linalg.svd(scaled, compute_uv=False)
        if (values[..., -1:] > SINGULAR * values[..., :1]).all():
            return
    raise ModelError("E is singular; pass an invertible descriptor matrix, with the algebraic equations eliminated")
