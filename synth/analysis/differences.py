"""Differences of models as stable systems with the same singular values at all frequencies, for covers.

    output multiplicative    E = (G - G0) G0^-1
    additive                 E = G - G0

In the states (x, x0) of G and of G0, or of its inverse, A of E is block triangular, so that both blocks are treated
alike, the second in the transpose:

- poles on the stability boundary, of G or zeros of G0: z = U'x - Y x0, with U'A = L U' and L Y - Y A0 + U'A01 = 0, has
  z' = L z + (U'B - Y B0) v. It is left out where U'B - Y B0 = 0 but for a part of SHARED: a smaller change of B or C of
  a model makes it so. Elsewhere E is unbounded, and refused;
- poles beyond it: output injection moves those of G to their mirror images, M E with M all-pass (G is M^-1 N, with M
  and N stable), and state feedback those of G0, or its zeros. Whether they cancel need not be decided.

G0^-1 is taken of phi G0 where G0 is strictly proper, with phi = (s + a)^r that makes the direct term invertible: phi G
and phi G0 have the same quotient.

References: Vidyasagar (1985), Control System Synthesis, chapter 4 (coprime factors); Zhou, Doyle and Glover (1996),
Robust and Optimal Control, section 13.7 (all-pass denominators).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.errors import AssumptionError, NumericalError
from synth.systems.modes import decay, doubts
from synth.systems.realization import Matrices, balanced, in_principal_axes, is_singular
from synth.systems.sampled import inverse_cayley, pole_rate
from synth.systems.statespace import StateSpace

INPUT, OUTPUT, ADDITIVE = KINDS = ("input multiplicative", "output multiplicative", "additive")
POINTS, DECADES = 100, 2.0  # of frequencies of comparisons and fits, and how far beyond poles they go
FLOOR = 1e-3  # of the largest error: what is below it is not looked at
NOTHING = 1e-12  # of what it was summed from: a direct term, or a response, that rounding made
EXACT = 1e-14  # the same at the highest frequency of sampled models
MOVED = 1e-6  # of the size of A: poles that are all integrators
SHARED = 1e-8  # of what it was summed from: what drives a pole on the boundary that models share
ON_AXIS = 1e-7  # relative distance of a pole to the stability boundary
CLUSTER = 1e-13  # coefficients of the polynomial of poles, relative to the size of A, that are integrators
MADE = 30  # doubts of an eigenvalue: what the roundings of the computation that made A, a hold for example, may add
AT_REST = 1e-4  # of the fastest: poles on the boundary that may be integrators
BESIDE = 1.001  # of a resonance, where the response of an undamped one is finite
AGREES = 1e-3  # relative error of the response of an error system beyond which it is refused
ROUNDED = 1e-10  # of a quotient of responses: what rounding may make of it

Poles = tuple[np.ndarray, np.ndarray]  # all of a matrix, (n,), and which of them are chosen, (n,)


class Difference(NamedTuple):
    """w Delta of a model."""

    system: StateSpace  # stable, with its singular values
    stable: bool  # whether it is stable itself
    omega: np.ndarray  # (k,) rad/s
    hidden: np.ndarray  # (k,) how far the largest singular value of `system` is off that of the responses there


def difference(G: StateSpace, G0: StateSpace, kind: str, i: int, dt: float) -> Difference:
    """What models[i] is off the nominal one, as a stable system compared with the responses.

    Raises
    ------
    AssumptionError : it is unbounded, or nominal has no inverse.
    NumericalError : rounding hides it.
    """
    if kind == INPUT:
        found = difference(_transposed(G), _transposed(G0), OUTPUT, i, dt)
        return found._replace(system=_transposed(found.system))
    E, n, stable = _difference(G, G0) if kind == ADDITIVE else (*_quotient(G, G0, i), True)
    omega = frequencies([G, G0, E])
    model, middle = G.frequency_response(omega), G0.frequency_response(omega)
    if kind == ADDITIVE:
        exact, size = model - middle, np.linalg.norm(model, axis=(1, 2)) + np.linalg.norm(middle, axis=(1, 2))
        rounded = blur(G, omega) + blur(G0, omega)
    else:
        exact, size, rounded = np.linalg.solve(middle.mT, (model - middle).mT).mT, 1.0, ROUNDED
    expected = np.linalg.norm(exact, 2, axis=(1, 2))
    if np.all(expected <= NOTHING * size):  # a model that is the nominal one
        return Difference(StateSpace.gain(np.zeros_like(E.D), 0.0), True, omega, expected)
    try:
        for scale in (np.linalg.norm(E.B, axis=0), np.linalg.norm(E.C, axis=1)):
            E, n, cancels = _stabilised(E, n, scale)
            (E, n), stable = _turned(E, n), stable and (cancels or kind == ADDITIVE)
        E = _turned_well(E)
        found = np.linalg.norm(E.frequency_response(omega), 2, axis=(1, 2))
        hidden = np.maximum(np.abs(found - expected) - rounded, 0.0)
    except np.linalg.LinAlgError:
        hidden = np.full(len(omega), np.inf)
    if np.any(hidden > AGREES * np.maximum(expected, FLOOR * expected.max())):
        raise NumericalError(
            f"rounding hides the difference of models[{i}] and nominal, whose gains between the slowest poles and the "
            'highest frequency reach over too many decades: pass kind="additive", leave fast dynamics out, or sample '
            "more slowly"
        )
    values, axis, _ = _poles(E.A)
    if axis.any():
        slow = float(np.abs(np.imag(values[axis])).min())
        raise AssumptionError(
            "a finite difference",
            f"models[{i}] and nominal differ without bound at {2 / dt * np.arctan(slow) if dt else slow:.4g} rad/s: a "
            "pole of one on the stability boundary, or a zero of nominal there, is not shared; pass another kind of "
            f"{', '.join(KINDS)}, another nominal model, or damp it. Coprime factor uncertainty (`nugap`, `ncfsyn`) "
            "has no such limit",
            tuple(values[axis]),
        )
    return Difference(E, stable, omega, hidden)


def _difference(G: StateSpace, G0: StateSpace) -> tuple[StateSpace, int, bool]:
    """G - G0 without poles on the boundary that cancel, the states of G, and whether those beyond it cancel."""
    fastest = float(np.abs(np.concatenate([G.poles(), G0.poles()])).max(initial=0.0))
    (values, axis, beyond), (values0, axis0, beyond0) = _poles(G.A), _poles(G0.A)
    stable = _same(split(G, (values, beyond))[1], split(G0, (values0, beyond0))[1], fastest)
    (rest, part), (rest0, part0) = split(G, (values, axis)), split(G0, (values0, axis0))
    if _same(part, part0, fastest):
        G, G0 = rest, rest0
    A = np.asarray(sla.block_diag(G.A, G0.A)).reshape(G.n + G0.n, G.n + G0.n)
    return StateSpace(A, np.vstack([G.B, G0.B]), np.hstack([G.C, -G0.C]), G.D - G0.D, 0.0), G.n, stable


def _quotient(G: StateSpace, G0: StateSpace, i: int) -> tuple[StateSpace, int]:
    """(G - G0) G0^-1 in the states of G and of G0, and the number of the former."""
    if G0.ny != G0.nu:
        raise AssumptionError(
            "nominal is square", f"nominal is {G0.ny} x {G0.nu}; a multiplicative kind needs one that is square: pass "
            'kind="additive"',
        )  # fmt: skip
    rate = _size(G0.A, G0.poles()) if _integrates(G0) else pole_rate(G0.poles())
    for _ in range(G0.n):
        if np.any(G0.D):
            break
        if np.any(G.D):
            raise AssumptionError(
                "falls off as fast", f"models[{i}] falls off more slowly than nominal at high frequencies, so that no "
                'weight covers it: pass kind="additive", or a nominal model with as few more poles than zeros',
            )  # fmt: skip
        G, G0 = _raised(G, rate), _raised(G0, rate)
    if is_singular(G0.D):
        raise AssumptionError(
            "nominal has an inverse",
            "the direct term of nominal, or of the first derivative of its outputs that has one, is singular, and a "
            'multiplicative kind needs its inverse: pass kind="additive"',
        )
    # e = (G - G0) u with G0 u = v: u = D0^-1 (v - C0 x0)
    Di, D = np.linalg.inv(G0.D), G.D - G0.D
    A = np.block([[G.A, -G.B @ Di @ G0.C], [np.zeros((G0.n, G.n)), G0.A - G0.B @ Di @ G0.C]])
    return StateSpace(A, np.vstack([G.B, G0.B]) @ Di, np.hstack([G.C, -G.D @ Di @ G0.C]), D @ Di, 0.0), G.n


def _raised(G: StateSpace, rate: float) -> StateSpace:
    """(s / rate + 1) G of a strictly proper G."""
    D = G.C @ G.B / rate
    return StateSpace(G.A, G.B, G.C @ G.A / rate + G.C, _cleaned(D, NOTHING * np.abs(G.C) @ np.abs(G.B) / rate), G.dt)


def _cleaned(D: np.ndarray, rounded: np.ndarray) -> np.ndarray:
    """A direct term without what rounding made of it."""
    return np.where(np.abs(D) <= rounded, 0.0, D)


def blur(G: StateSpace, omega: np.ndarray) -> np.ndarray:
    """What rounding of A may change of a response, (k,)."""
    changes = []
    for s in np.exp(1j * omega * G.dt) if G.discrete else 1j * omega:
        E = s * np.eye(G.n) - G.A
        left, right = np.linalg.solve(E.T, G.C.T), np.linalg.solve(E, G.B)
        changes.append(np.linalg.norm(left) * np.linalg.norm(G.A) * np.linalg.norm(right))
    return 10 * np.finfo(float).eps * np.array(changes)


def _turned(E: StateSpace, n: int) -> tuple[StateSpace, int]:
    """The transpose with the other states first; A stays block triangular."""
    order = [*range(n, E.n), *range(n)]
    return StateSpace(E.A.T[np.ix_(order, order)], E.C.T[order], E.B.T[:, order], E.D.T, E.dt), E.n - n


def _transposed(G: StateSpace) -> StateSpace:
    return StateSpace(G.A.T, G.C.T, G.B.T, G.D.T, G.dt)


def _stabilised(E: StateSpace, n: int, scale: np.ndarray) -> tuple[StateSpace, int, bool]:
    """E with the poles of its first n states stable, and whether those beyond the boundary are not driven.

    On the boundary they are left out if they are not driven, and stay if they are; beyond it they are mirrored. `scale`
    is what the inputs are beside which rounding made, (m,).
    """
    values, axis, beyond = _poles(E.A[:n, :n])
    if axis.any():
        U, V, Y, driven = _driven(E, n, (values, axis), scale)
        if not driven:
            T = np.asarray(sla.block_diag(V, np.eye(E.n - n)))
            left = T.T.copy()
            T[:n, V.shape[1] :] = U @ Y  # x = U Y x0 + V r
            E, n = StateSpace(left @ E.A @ T, left @ E.B, E.C @ T, E.D, 0.0), V.shape[1]
            values, _, beyond = _poles(E.A[:n, :n])
    if not beyond.any():
        return E, n, True
    cancels = not _driven(E, n, (values, beyond), scale)[-1]
    # output injection -W P^-1 W'C' on the right invariant subspace W, with L'P + P L = W'C'C W and A W = W L
    W, _, L = _invariant(E.A[:n, :n], (values, beyond))
    CW = E.C[:, :n] @ W
    H = np.zeros((E.n, E.ny))
    H[:n] = -W @ np.linalg.solve(sla.solve_continuous_lyapunov(L.T, CW.T @ CW), CW.T)
    return StateSpace(E.A + H @ E.C, E.B + H @ E.D, E.C, E.D, 0.0), n, cancels


def _driven(E: StateSpace, n: int, chosen: Poles, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """U, V and Y of chosen poles of the first states, U'x - Y x0 and the rest V'x, and whether they are driven."""
    U, V, L = _invariant(E.A[:n, :n].T, chosen)
    Y = _sylvester(L.T, E.A[n:, n:], -U.T @ E.A[:n, n:])
    drive = U.T @ E.B[:n] - Y @ E.B[n:]
    summed = np.abs(U.T) @ np.abs(E.B[:n]) + np.abs(Y) @ np.abs(E.B[n:])
    size = np.maximum(np.linalg.norm(summed, axis=0), scale)
    return U, V, Y, bool(np.any(np.linalg.norm(drive, axis=0) > SHARED * size))


def split(G: StateSpace, chosen: Poles) -> tuple[StateSpace, StateSpace]:
    """What is left of a system without chosen poles, and the part with them, which has no direct term; G is the sum."""
    U, V, L = _invariant(G.A, chosen)
    rest = V.T @ G.A @ V
    X = _sylvester(L, rest, -U.T @ G.A @ V)
    B = V.T @ G.B
    part = StateSpace(L, U.T @ G.B - X @ B, G.C @ U, np.zeros_like(G.D), G.dt)
    return StateSpace(rest, B, G.C @ (U @ X + V), G.D, G.dt), part


def _same(G: StateSpace, G0: StateSpace, fastest: float) -> bool:
    """Whether two strictly proper systems, parts of some with such poles, have the same moments C A^k B."""
    rate = max(AT_REST * fastest, *(float(np.linalg.norm(H.A, 2)) if H.n else 0.0 for H in (G, G0))) or 1.0
    B, B0 = G.B, G0.B
    size = np.linalg.norm(G.C) * np.linalg.norm(B) + np.linalg.norm(G0.C) * np.linalg.norm(B0)
    for _ in range(G.n + G0.n):
        if np.linalg.norm(G.C @ B - G0.C @ B0) > SHARED * size:
            return False
        B, B0 = G.A @ B / rate, G0.A @ B0 / rate
    return True


def _invariant(A: np.ndarray, chosen: Poles) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Orthonormal U of the invariant subspace of chosen poles, V of its complement, and L with A U = U L."""
    values, mask = chosen
    if not mask.any():
        return np.zeros((len(A), 0)), np.eye(len(A)), np.zeros((0, 0))
    schur = sla.schur(A, sort=lambda re, im=0.0: mask[np.abs(values - complex(re, im)).argmin()])
    T, Z, k = schur[0], schur[1], int(schur[-1])
    return Z[:, :k], Z[:, k:], T[:k, :k]


def _sylvester(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """X of A X - X B = Q."""
    return np.asarray(sla.solve_sylvester(A, -B, Q)) if Q.size else np.zeros(Q.shape)


def frequencies(systems: list[StateSpace]) -> np.ndarray:
    """Frequencies in rad/s about the poles of systems, some decades beyond them, and beside resonances."""
    found, peaks = [np.zeros(0)], [np.zeros(0)]
    for G in systems:
        poles, axis, _ = _poles(G.A)
        moduli = np.abs(poles)
        still = axis & (moduli <= AT_REST * np.linalg.norm(G.A))
        found.append(moduli[~still])
        peaks.append(np.abs(np.imag(poles[~still])) * BESIDE)
    moduli, at = np.concatenate(found), np.concatenate(peaks)
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    grid = np.geomspace(low / 10**DECADES, high * 10**DECADES, POINTS)
    return np.unique(np.concatenate([grid, at[at >= low]]))


def check_poles(systems: list[StateSpace]) -> None:
    """Raise AssumptionError unless all have as many poles beyond the boundary as the last one."""
    unstable = [values[beyond] for values, _, beyond in (_poles(G.A) for G in systems)]
    for i, poles in enumerate(unstable[:-1]):
        if len(poles) != len(unstable[-1]):
            raise AssumptionError(
                "as many unstable poles",
                f"models[{i}] has {len(poles)} unstable poles, nominal has {len(unstable[-1])}: no loop is judged by a "
                "multiplicative or additive cover of such models; leave the model out, choose a nominal model with as "
                "many, or take coprime factor uncertainty (`nugap`, `ncfsyn`), which lets their number change",
                tuple(poles),
            )


def _poles(A: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poles, (n,), which of them are on the imaginary axis, and which beyond it, but for rounding.

    Multiple integrators, whose poles rounding moves far, are told by the polynomial of their cluster.
    """
    values, doubt = doubts(A)
    axis = np.abs(np.real(values)) <= np.maximum(doubt, ON_AXIS * np.abs(values))
    axis |= integrators(A, values, discrete=False)
    return values, axis, ~axis & (np.real(values) > 0)


def persistent(A: np.ndarray, *, discrete: bool) -> Poles:
    """Poles, and which of them may be on or beyond the stability boundary, for all that rounding lets one know."""
    values, doubt = doubts(A)
    return values, (decay(values, discrete=discrete) <= MADE * doubt) | integrators(A, values, discrete=discrete)


def resting(A: np.ndarray, *, discrete: bool) -> Poles:
    """Poles, and which of them are integrators."""
    values = np.linalg.eigvals(A)
    return values, integrators(A, values, discrete=discrete)


def integrators(A: np.ndarray, values: np.ndarray, *, discrete: bool) -> np.ndarray:
    """Which eigenvalues of A are at rest, z = 1 or s = 0, but for rounding, (n,), told by the polynomial of all."""
    if discrete:
        A, values = A - np.eye(len(A)), values - 1
    found, nearest, whole = np.zeros(len(values), bool), np.argsort(np.abs(values)), _size(A, values)
    for k in range(len(values), 0, -1):
        if np.all(np.abs(np.poly(values[nearest[:k]] / whole)[1:]) <= CLUSTER):
            found[nearest[:k]] = True
            break
    return found


def prepared(G: StateSpace) -> StateSpace:
    """The system in continuous time, z = (1 + s)/(1 - s) for a discrete one, and in good coordinates.

    Those given are kept where all poles are integrators, which rounding moves: nothing says what is fast.
    """
    if G.discrete:
        H = inverse_cayley(G, 1.0)
        summed = np.abs(G.D) + np.abs(G.C) @ np.abs(np.linalg.inv(G.A + np.eye(G.n))) @ np.abs(G.B)
        G = StateSpace(H.A, H.B, H.C, _cleaned(H.D, EXACT * summed), 0.0)
    return G if _integrates(G) else _turned_well(G)


def _turned_well(G: StateSpace) -> StateSpace:
    """The system in its principal axes, those of outputs in a unit in which its gain is about one."""
    H = StateSpace(*balanced(G.matrices), 0.0)
    gain = np.linalg.norm(H.B) * np.linalg.norm(H.C) / _size(H.A, H.poles())
    unit = 2.0 ** np.round(np.log2(gain)) if 0 < gain < np.inf else 1.0
    A, B, C, _ = in_principal_axes(Matrices(H.A, H.B, H.C / unit, H.D))
    return StateSpace(A, B, C * unit, G.D, 0.0)


def _integrates(G: StateSpace) -> bool:
    """Whether all poles are integrators but for rounding, of which there are some."""
    return 0 < G.n and bool(np.abs(G.poles()).max() <= MOVED * _size(G.A, np.zeros(1)))


def _size(A: np.ndarray, poles: np.ndarray) -> float:
    """The modulus of the fastest pole, or of all of the balanced A where they are rounding beside it; 1 for none."""
    fastest = float(np.abs(poles).max(initial=0.0))
    whole = float(np.linalg.norm(sla.matrix_balance(A, permute=False)[0])) if len(A) else 0.0
    return (whole if fastest <= MOVED * whole else fastest) or 1.0
