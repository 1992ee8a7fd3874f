"""From transfer functions to matrices: realisations that are balanced, minimal, and checked on a frequency grid.

An entry num(s)/den(s) becomes a companion form; the entries of a column that have one denominator share it. What the
parts of a transfer matrix have twice is then removed by two orthogonal staircases (modes that no input reaches, modes
that no output sees), for the order with the fewest states whose response still agrees with the polynomials.

Zeros and poles become a chain of sections of first and second order, which keeps digits that coefficients lose.

References: Kailath (1980), Linear Systems, chapters 2 and 6 (companion forms, realisations of transfer matrices);
Van Dooren (1981), IEEE TAC 26, 111 (staircase forms).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import scipy.linalg as sla

from synth.errors import ModelError

AGREES = 1e-8  # relative error of the response beyond which a realisation is refused
RANKS = (1e-7, 1e-9, 1e-11, 1e-13)  # relative size of what the staircase counts as nothing, tried in turn
ROUNDING = 1e-15  # of a coefficient beside the largest
POINTS = 60  # frequencies of the comparison
AT_ORIGIN = 1e-12  # relative size below which a pole is an integrator, for the gain at rest
DECADES = 2.0  # of the grid beyond the slowest and the fastest root
SINGULAR = 1e14  # condition of a singular matrix
FLOOR = 1e-8  # relative, of what counts in the choice of axes
HALF = 0.5  # of its size: a turn that does not leave less is not worth its rounding


class Matrices(NamedTuple):
    """A, B, C, D of a system."""

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    C: np.ndarray  # (p, n)
    D: np.ndarray  # (p, m)

    def at(self, s: complex) -> np.ndarray:
        """The transfer matrix at s (or z), (p, m) complex."""
        return self.C @ np.linalg.solve(s * np.eye(len(self.A)) - self.A, self.B) + self.D


Polynomials = Sequence[Sequence[np.ndarray]]  # p rows of m: coefficients, highest power first


def of_polynomials(name: str, num: Polynomials, den: Polynomials, *, discrete: bool) -> Matrices:
    """A minimal realisation of the transfer matrix num[i][j] / den[i][j].

    Raises
    ------
    ModelError : a denominator is zero, an entry is improper, or double precision cannot hold the matrix.
    """
    p, m = len(num), len(num[0])
    entries = {(i, j): _entry(name, num[i][j], den[i][j], (i, j)) for i in range(p) for j in range(m)}
    D = np.array([[entries[i, j][2] for j in range(m)] for i in range(p)])
    columns = _by_columns(entries, p, m)
    if p < m:  # the same by rows: fewer states where there are fewer outputs
        rows = _dual(_by_columns({(j, i): entry for (i, j), entry in entries.items()}, m, p))
        columns = min(columns, rows, key=lambda G: len(G.A))
    full = balanced(columns._replace(D=D))
    candidates = [full]
    for rank in RANKS:
        found = minimal(full, rank)
        if len(found.A) < len(full.A):
            candidates.append(found)
    grid = _grid([r for a, b, _ in entries.values() for r in (*np.roots(a), *np.roots(b))], discrete)
    worst = {}
    for G in sorted(candidates, key=lambda G: len(G.A)):
        with np.errstate(all="ignore"):  # what overflows does not agree
            worst = _disagreement(G, entries, grid)
        if worst["error"] <= AGREES:
            return G
    raise ModelError(
        f"{name} cannot be realised: its polynomials (order {len(full.A)}) lose so many digits that the response is "
        f"off by {worst['error']:.1e} of its size at {abs(worst['at']):.3g}; pass zeros, poles and gain, or matrices"
    )


def of_roots(name: str, zeros: np.ndarray, poles: np.ndarray, gain: float) -> Matrices:
    """The chain k (s - z1)(s - z2).../((s - p1)(s - p2)...) of sections of order one and two.

    Raises
    ------
    ModelError : more zeros than poles, or complex roots without their conjugates.
    """
    if len(zeros) > len(poles):
        raise ModelError(
            f"{name} has {len(zeros)} zeros and {len(poles)} poles: it is improper, with a gain that grows without "
            "end; add fast poles, as in s/(s/w + 1) with w well above the bandwidth"
        )
    quadratics, numerators = _sections(name, "poles", poles), _sections(name, "zeros", zeros)
    G = Matrices(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[gain]]))
    for k, den in enumerate(quadratics):
        num = numerators[k] if k < len(numerators) else np.ones(1)
        a, b, d = _entry(name, num, den, (0, 0))
        H = balanced(_by_columns({(0, 0): (a, b, d)}, 1, 1)._replace(D=np.array([[d]])))
        G = Matrices(
            np.block([[G.A, np.zeros((len(G.A), len(H.A)))], [H.B @ G.C, H.A]]),
            np.vstack([G.B, H.B @ G.D]),
            np.hstack([H.D @ G.C, H.C]),
            H.D @ G.D,
        )
    return balanced(G)


def gain_at_rest(G: Matrices, *, discrete: bool) -> float:
    """The gain of one entry at s = 0 or z = 1, without what cancels; inf where a pole stands there."""
    size = np.linalg.norm(G.A, 2) if len(G.A) else 0.0
    A, B, C, D = minimal(G, AT_ORIGIN)
    E = (np.eye(len(A)) if discrete else np.zeros_like(A)) - A
    if len(E) and np.linalg.svd(E, compute_uv=False)[-1] <= AT_ORIGIN * max(size, 1.0 if discrete else 0.0):
        return float(np.inf)
    return float((C @ np.linalg.solve(E, B) + D)[0, 0])


def fraction(G: Matrices) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of one entry, highest power first, without what cancels."""
    A, B, C, D = minimal(G, AT_ORIGIN)
    if not len(A):
        return D[0], np.ones(1)
    den = np.real(np.poly(A))
    num = np.real(np.poly(A - B @ C)) - den  # det(s I - A + B C) = det(s I - A) (1 + C (s I - A)^-1 B)
    size = np.abs(num).max() * ROUNDING
    return np.where(np.abs(num) > size, num, 0.0) + D[0, 0] * den, den


def is_singular(M: np.ndarray, summed: np.ndarray | None = None) -> bool:
    """Singular to working precision, whatever the units of rows and columns.

    `summed` holds the sums of moduli that the entries of M were summed from; those of M itself when left out.

    Reference: Bauer (1966), Numerische Mathematik 8, 157, on the condition of a matrix under the best scaling.
    """
    try:
        effect = np.abs(np.linalg.inv(M)) @ (np.abs(M) if summed is None else summed)
    except np.linalg.LinAlgError:
        return True
    return not (np.isfinite(effect).all() and np.abs(np.linalg.eigvals(effect)).max(initial=0.0) < SINGULAR)


def loop_solve(L: np.ndarray, X: np.ndarray) -> np.ndarray | None:
    """(I - L)^-1 X for a loop of direct terms, (m, m), in units that balance it; None where I - L is singular."""
    found = cast("tuple[np.ndarray, tuple[np.ndarray, Any]]", sla.matrix_balance(L, permute=False, separate=True))
    balanced, scale = found[0], found[1][0][:, None]
    E = np.eye(len(L)) - balanced
    if is_singular(E, np.eye(len(L)) + np.abs(balanced)):
        return None
    return scale * np.linalg.solve(E, X / scale)


def balanced(G: Matrices) -> Matrices:
    """The same system with states scaled by powers of two so that its rows and columns have like norms."""
    return rescaled(G, state_scales(G))


def rescaled(G: Matrices, scales: np.ndarray) -> Matrices:
    """The same system with the states x / scales; exact for powers of two."""
    A, B, C, D = G
    return Matrices(A * scales / scales[:, None], B / scales[:, None], C * scales, D)


def state_scales(G: Matrices) -> np.ndarray:
    """Powers of two, (n,), that balance a system.

    Inputs and outputs weigh as much as the fastest mode, so that the time unit does not matter.
    """
    A, B, C, _ = G
    n = len(A)
    if n == 0:
        return np.ones(0)
    rate = _fastest(A)
    M = np.zeros((n + 1, n + 1))
    M[:-1, :-1] = np.abs(A)
    with np.errstate(all="ignore"):
        M[:-1, -1] = np.linalg.norm(B, axis=1) * np.sqrt(rate)
        M[-1, :-1] = np.linalg.norm(C, axis=0) * np.sqrt(rate)
        if not np.isfinite(M).all():
            return np.ones(n)
        _, (scale, _) = sla.matrix_balance(M, permute=False, separate=True)
        t = scale[:-1] / scale[-1]
    # numbers beyond the range of balancing stay as they are
    return t if np.isfinite(t).all() and t.all() else np.ones(n)


def in_principal_axes(G: Matrices) -> Matrices:
    """The same system in good coordinates, whatever those given; see `principal_axes`."""
    return principal_axes(G)[0]


def principal_axes(G: Matrices) -> tuple[Matrices, np.ndarray]:
    """The system turned and balanced in turns while that halves it, and T (n, n) with x = T x_new.

    Powers of two do not see through a turn. Its axes are those of the state transform that would make M = A A' + B B'
    and N = A'A + C'C equal and diagonal, the geometric mean of M and N^-1; what rounding takes is that of a turn.

    Reference: Bhatia (2007), Positive Definite Matrices, chapter 4 (geometric mean).
    """
    scales = state_scales(G)
    G, T = rescaled(G, scales), np.diag(scales)
    if not len(G.A):
        return G, T
    rate = _fastest(G.A)
    with np.errstate(all="ignore"):
        while 0 < _size(G, rate) < np.inf:
            Q = _principal_axes(G, rate)
            turned = Matrices(Q.T @ G.A @ Q, Q.T @ G.B, G.C @ Q, G.D)
            scales = state_scales(turned)
            turned = rescaled(turned, scales)
            if not _size(turned, rate) < HALF * _size(G, rate):
                break
            G, T = turned, T @ Q * scales
    return G, T


def _principal_axes(G: Matrices, rate: float) -> np.ndarray:
    """Orthogonal (n, n), from factors of M and N; what hardly counts in either is taken for a little."""
    root = np.sqrt(rate)
    U, s, _ = np.linalg.svd(np.hstack([G.A, root * G.B]), full_matrices=False)
    V, t, _ = np.linalg.svd(np.hstack([G.A.T, root * G.C.T]), full_matrices=False)
    U, V = (axes * np.maximum(size / (size[0] or 1.0), FLOOR) for axes, size in ((U, s), (V, t)))
    _, mean, Wt = np.linalg.svd(V.T @ U)
    return np.linalg.svd(U @ Wt.T / np.sqrt(mean))[0]


def _size(G: Matrices, rate: float) -> float:
    """Norm of A, B and C in units of rate and of a signal, which goes with the unit of time."""
    return float(np.sqrt(np.linalg.norm(G.A) ** 2 + rate * (np.linalg.norm(G.B) ** 2 + np.linalg.norm(G.C) ** 2)))


def _fastest(A: np.ndarray) -> float:
    """The largest modulus of an eigenvalue, one where all are zero."""
    return float(np.abs(np.linalg.eigvals(A)).max()) or 1.0


def minimal(G: Matrices, rank: float) -> Matrices:
    """The part that inputs reach and outputs see; `rank` is the relative size of what counts as nothing."""
    return balanced(_dual(_reached(_dual(_reached(G, rank)), rank)))


def _reached(G: Matrices, rank: float) -> Matrices:
    """The subspace that the inputs reach, by orthogonal staircase."""
    A, B, C, D = G
    n = len(A)
    basis = np.zeros((n, 0))
    new, scale = B, np.linalg.norm(B, 2) if B.size else 0.0
    size = np.linalg.norm(A, 2) if n else 0.0
    while new.size and basis.shape[1] < n:
        new = new - basis @ (basis.T @ new)
        new = new - basis @ (basis.T @ new)  # twice is enough
        U, s, _ = np.linalg.svd(new, full_matrices=False)
        kept = U[:, s > rank * scale]
        if not kept.shape[1]:
            break
        basis = np.linalg.qr(np.hstack([basis, kept]))[0]
        new, scale = A @ basis[:, -kept.shape[1] :], size
    return Matrices(basis.T @ A @ basis, basis.T @ B, C @ basis, D)


def _dual(G: Matrices) -> Matrices:
    return Matrices(G.A.T, G.C.T, G.B.T, G.D.T)


def _entry(name: str, num: np.ndarray, den: np.ndarray, at: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, float]:
    """Strictly proper numerator and monic denominator, and the direct term."""
    num, den = np.trim_zeros(num, "f"), np.trim_zeros(den, "f")
    if not len(den):
        raise ModelError(f"{name} has the denominator 0 in entry {at}; pass one with a coefficient that is not zero")
    if len(num) > len(den):
        raise ModelError(
            f"{name} is improper in entry {at}: the numerator has degree {len(num) - 1}, the denominator "
            f"{len(den) - 1}, so that the gain grows without end; add fast poles, as in s/(s/w + 1) with w well above "
            "the bandwidth"
        )
    with np.errstate(all="ignore"):
        monic = den / den[0]
        padded = np.concatenate([np.zeros(len(den) - len(num)), num]) / den[0]
        direct = float(padded[0])
        proper = (padded - direct * monic)[1:]
    if not (np.isfinite(monic).all() and np.isfinite(proper).all() and np.isfinite(direct)):
        raise ModelError(f"{name} has coefficients in entry {at} too far apart for doubles; choose other units")
    return proper, monic, direct


def _by_columns(entries: dict, p: int, m: int) -> Matrices:
    """Companion forms side by side; entries of a column with one denominator share theirs. D is left zero."""
    blocks, inputs, outputs = [], [], []
    for j in range(m):
        shared: dict[bytes, list[int]] = {}
        for i in range(p):
            num, den, _ = entries[i, j]
            if np.any(num):
                shared.setdefault(den.tobytes(), []).append(i)
        for rows in shared.values():
            den = entries[rows[0], j][1]
            k = len(den) - 1
            A = np.eye(k, k=-1)
            A[0] = -den[1:]
            B, C = np.zeros((k, m)), np.zeros((p, k))
            B[0, j] = 1.0
            for i in rows:
                C[i] = entries[i, j][0]
            blocks.append(A)
            inputs.append(B)
            outputs.append(C)
    n = sum(map(len, blocks))
    A = np.asarray(sla.block_diag(*blocks)) if blocks else np.zeros((0, 0))
    B = np.vstack(inputs) if inputs else np.zeros((0, m))
    C = np.hstack(outputs) if outputs else np.zeros((p, 0))
    return Matrices(A.reshape(n, n), B, C, np.zeros((p, m)))


def _grid(roots: Sequence[complex], discrete: bool) -> np.ndarray:
    """Points on the stability boundary about the roots."""
    if discrete:
        return np.exp(1j * np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    moduli = np.abs(np.asarray(roots, complex))
    moduli = moduli[moduli > 1e-12 * moduli.max(initial=0.0)]
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    return 1j * np.geomspace(low * 10**-DECADES, high * 10**DECADES, POINTS)


def _disagreement(G: Matrices, entries: dict, grid: np.ndarray) -> dict:
    """The largest relative error of the response, and where; relative to the size of the terms of an entry."""
    worst = {"error": 0.0, "at": 0j}
    for s in grid:
        response = G.at(s)
        for (i, j), (num, den, direct) in entries.items():
            below = np.polyval(den, s)
            exact = (np.polyval(num, s) if num.size else 0.0) / below + direct
            size = (np.polyval(np.abs(num), abs(s)) if num.size else 0.0) / abs(below) + abs(direct)
            if size == 0:
                error = 0.0 if response[i, j] == 0 else abs(response[i, j]) / np.abs(response).max()
            else:
                error = abs(response[i, j] - exact) / size
            if not error <= worst["error"]:
                worst = {"error": float(error) if error == error else np.inf, "at": s}
    return worst


def _sections(name: str, kind: str, roots: np.ndarray) -> list[np.ndarray]:
    """Real polynomials of degree two, and one of degree one last where their number is odd."""
    roots = np.asarray(roots, complex)
    side = np.sign(np.imag(roots))
    upper, lower, real = roots[side > 0], roots[side < 0], np.sort(np.real(roots[side == 0]))
    if len(upper) != len(lower) or not np.allclose(np.sort_complex(upper), np.sort_complex(lower.conj()), rtol=1e-12):
        raise ModelError(f"{name} has complex {kind} without their conjugates; pass both of each pair")
    pairs = [np.array([1.0, -2 * r.real, abs(r) ** 2]) for r in sorted(upper, key=abs)]
    pairs += [np.poly(real[k : k + 2]) for k in range(0, len(real) - 1, 2)]
    return pairs + ([np.poly(real[-1:])] if len(real) % 2 else [])
