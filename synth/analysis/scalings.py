"""Upper bounds of the structured singular value by (D, G) scalings, at one matrix.

For D, G that commute with the structure (a positive number for a full block, a positive definite matrix for a repeated
number, and a Hermitian G for a real one)

    F = t D - M* D M - j (G M - M* G) >= 0   with D > 0   proves   mu(M) <= sqrt(t)

since j (w* G q - q* G w) = 0 for every w = delta q with a real delta. F is linear in (D, G). The least t is found by
the method of analytic centres (`structured` has it for complex numbers); the bound that is returned is the largest
eigenvalue of a pencil with the scalings that were found, not what the method claims.

References: Fan, Tits and Doyle (1991), IEEE TAC 36, 25 (the bound); Young, Newlin and Doyle (1991), CDC (scaled form);
Boyd and El Ghaoui (1993), Linear Algebra and its Applications 188, 63 (analytic centres of eigenvalue problems).
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.blocks import Structure
from synth.analysis.structured import balanced_scaling

EXACT = 1e-7  # relative distance of t from the bound at its centre, from which on it is the best
CENTRES = 150  # at most
NEARER = 0.1  # part of that distance which the next level keeps
STEPS = 60  # of Newton's method to a centre
NEAR_CENTRE = 0.25  # Newton decrement from which on full steps stay inside
CENTRED = 1e-4  # decrement at which a centre is reached that others are interpolated with
LARGEST_G = 1e3  # times D and the norm of the balanced matrix
ROUNDED = 1e-10  # relative, of an eigenvalue that was computed
NOTHING = 1e-8  # times the norm: a bound below it is zero
FLAT = 1e-13  # relative curvature that is none


class Scalings(NamedTuple):
    """Scalings, and the bound that they prove."""

    bound: float  # of mu
    left: np.ndarray  # (p, p) Hermitian: D on the outputs of M
    right: np.ndarray  # (m, m) Hermitian: D on its inputs
    G: np.ndarray  # (m, p)


class Cone:
    """The scalings of a structure as real coordinates x, (k,)."""

    def __init__(self, blocks: Structure):
        m, p = blocks.shape
        left, right, G, small = [], [], [], []
        self.blocks = blocks
        self.sizes = [block.size[0] if block.repeated else 1 for block in blocks.blocks]
        for i, block in enumerate(blocks.blocks):
            for kind in ("D", "G") if block.kind == "real" else ("D",):
                for E in _hermitian(self.sizes[i]):
                    parts = np.zeros((p, p), complex), np.zeros((m, m), complex), np.zeros((m, p), complex)
                    if kind == "D":
                        rows, columns = block.size
                        parts[0][block.columns, block.columns] = E if block.repeated else np.eye(columns)
                        parts[1][block.rows, block.rows] = E if block.repeated else np.eye(rows)
                    else:
                        parts[2][block.rows, block.columns] = E
                    for found, part in zip((left, right, G), parts, strict=True):
                        found.append(part)
                    small.append((i, kind, E))
        self.left, self.right, self.G, self.small = np.array(left), np.array(right), np.array(G), small
        self.weights = np.array([float(np.trace(E).real) if kind == "D" else 0.0 for _, kind, E in small])

    @cached_property
    def identity(self) -> np.ndarray:
        """D = I, G = 0."""
        return np.array([float(kind == "D" and np.array_equal(E, np.diag(E.diagonal()))) for _, kind, E in self.small])

    def parts(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """D on outputs and inputs, and G."""
        left, right, G = (np.tensordot(x, parts, 1) for parts in (self.left, self.right, self.G))
        return left, right, G

    def terms(self, M: np.ndarray) -> np.ndarray:
        """M* D M + j (G M - M* G) of every coordinate, (k, m, m)."""
        GM = self.G @ M
        return M.conj().T @ self.left @ M + 1j * (GM - GM.conj().transpose(0, 2, 1))

    def stiffness(self, M: np.ndarray, level: float, parts: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        """How much F minds a change of every block's scaling, (k,): the norm of dF/dlog(D) beside F itself.

        Near one where the level leaves room, large where it does not.
        """
        left, right, _ = parts
        R = np.linalg.inv(np.linalg.cholesky(level**2 * right - M.conj().T @ left @ M))
        found = []
        for block in self.blocks.blocks:
            X = np.zeros_like(right)
            X[block.rows, block.rows] = level**2 * right[block.rows, block.rows]
            X = X - M[block.columns].conj().T @ left[block.columns, block.columns] @ M[block.columns]
            found.append(float(np.linalg.norm(R @ X @ R.conj().T)))
        return np.array(found)

    def barriers(self, largest: float) -> tuple[np.ndarray, list[np.ndarray]]:
        """What must be positive of D and G, whatever the matrix: numbers (k, s), and matrices, each (k, r, r)."""
        numbers, matrices = [], []
        for i, (block, r) in enumerate(zip(self.blocks.blocks, self.sizes, strict=True)):
            for sign in (-1, 1) if block.kind == "real" else (0,):
                B = np.zeros((len(self.small), r, r), complex)
                for k, (of, kind, E) in enumerate(self.small):
                    if of == i:
                        B[k] = largest * E if kind == "D" and sign else sign * E if kind == "G" else E
                if r == 1:
                    numbers.append(np.real(B[:, 0, 0]))
                else:
                    matrices.append(B)
        return np.array(numbers).reshape(-1, len(self.small)).T, matrices


def _hermitian(r: int) -> list[np.ndarray]:
    """A basis of the Hermitian r x r matrices."""
    basis = []
    for i in range(r):
        for j in range(i, r):
            E = np.zeros((r, r), complex)
            E[i, j] = E[j, i] = 1.0
            basis.append(E)
            if i != j:
                E = np.zeros((r, r), complex)
                E[i, j], E[j, i] = 1j, -1j
                basis.append(E)
    return basis


def balanced(M: np.ndarray, blocks: Structure) -> np.ndarray:
    """A number d for every block with which D M D^-1 has rows and columns of like norms, (k,)."""
    norms = blocks.norms(M)
    return balanced_scaling(norms).D if norms.any() else np.ones(len(norms))


def bound_of(M: np.ndarray, left: np.ndarray, right: np.ndarray, G: np.ndarray) -> float:
    """The bound of mu(M) that scalings prove; inf where D is not positive definite."""
    GM = G @ M
    try:
        R = np.linalg.cholesky(right)
        T = M.conj().T @ left @ M + 1j * (GM - GM.conj().T)
        Y = sla.solve_triangular(R, sla.solve_triangular(R, T, lower=True).conj().T, lower=True)
        np.linalg.cholesky(left)
        top = float(np.linalg.eigvalsh((Y + Y.conj().T) / 2)[-1])
    except (np.linalg.LinAlgError, ValueError):
        return np.inf
    return float(np.sqrt(max(top, 0.0)) * (1 + ROUNDED))


def best_scalings(M: np.ndarray, blocks: Structure, cone: Cone | None = None, exact: float = EXACT) -> Scalings:
    """The scalings with the least bound, to about `exact`, relative."""
    search = Search(M, cone or Cone(blocks))
    search.descend(0.0, exact)
    return search.result()


class Search:
    """Scalings of one matrix on the way down."""

    def __init__(self, M: np.ndarray, cone: Cone):
        self.M, self.cone = M, cone
        self.d = balanced(M, cone.blocks)
        self.N = cone.blocks.scaled(M, self.d)
        self.size = float(np.linalg.norm(self.N, 2)) or 1.0
        self.N = self.N / self.size
        self.terms = cone.terms(self.N)
        self.numbers, self.matrices = cone.barriers(LARGEST_G)
        self.x = cone.identity.copy()
        self.top = self._top(self.x)

    def start_at(self, scalings: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Take scalings of another matrix, if they are better than none and inside the barriers."""
        x = self._coordinates(scalings)
        if (x @ self.numbers > 0).all() and all(
            np.linalg.eigvalsh(np.tensordot(x, B, 1))[0] > 0 for B in self.matrices
        ):
            x *= self.cone.weights.sum() / (self.cone.weights @ x)
            if self._top(x) < self.top:
                self.x, self.top = x, self._top(x)

    def descend(self, level: float, exact: float = EXACT) -> bool:
        """Lower t until the bound is below the level, or cannot be lower by `exact`; True where it is below."""
        target = (level / self.size) ** 2
        t = max(self.top * 1.1, NOTHING)
        for _ in range(CENTRES):
            if level and self.top < target:
                return True
            x = self._centre(self.x, t, NEAR_CENTRE)
            if x is None:
                break
            self.x, top = x, self._top(x)
            self.top = min(self.top, top)
            if t - top < exact * t or top < NOTHING**2:
                break
            t = top + NEARER * (t - top)
        return bool(level and self.top < target)

    def centre_at(self, level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """The analytic centre of the scalings that prove a level, with det D = 1; None where there are none."""
        if not self.descend(level):
            return None
        x = self._centre(self.x, (level / self.size) ** 2, CENTRED)
        return None if x is None else self._unscaled(x)

    def result(self) -> Scalings:
        """The best scalings found, in the units of the matrix."""
        left, right, G = self._unscaled(self.x)
        bound = bound_of(self.N, *self.cone.parts(self.x)) * self.size
        return Scalings(bound if bound > NOTHING * self.size else 0.0, left, right, G)

    def _unscaled(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        outputs, inputs = self.cone.blocks.spread(self.d)
        left, right, G = self.cone.parts(x)
        left, right = left * np.outer(outputs, outputs), right * np.outer(inputs, inputs)
        unit = np.exp(-np.linalg.slogdet(right)[1] / len(right))
        return left * unit, right * unit, G * np.outer(inputs, outputs) * (unit * self.size)

    def _coordinates(self, scalings: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
        outputs, inputs = self.cone.blocks.spread(1 / self.d)
        _, right, G = scalings
        right, G = right * np.outer(inputs, inputs), G * np.outer(inputs, outputs) / self.size
        x = np.empty(len(self.cone.small))
        for k, (i, kind, E) in enumerate(self.cone.small):
            block = self.cone.blocks.blocks[i]
            part = G[block.rows, block.columns] if kind == "G" else right[block.rows, block.rows]
            part = part if block.repeated else part[:1, :1]
            x[k] = np.vdot(E, part).real / np.vdot(E, E).real
        return x

    def _top(self, x: np.ndarray) -> float:
        """The least t with F >= 0; may be negative."""
        _, right, _ = self.cone.parts(x)
        R = np.linalg.cholesky(right)
        Y = sla.solve_triangular(R, np.tensordot(x, self.terms, 1), lower=True)
        Y = sla.solve_triangular(R, Y.conj().T, lower=True)
        return float(np.linalg.eigvalsh((Y + Y.conj().T) / 2)[-1])

    def _centre(self, x: np.ndarray, t: float, near: float) -> np.ndarray | None:
        """The analytic centre of F > 0 and the barriers, from a point inside, up to a decrement."""
        blocks = [t * self.cone.right - self.terms, *self.matrices]
        k = len(x)
        K = np.zeros((k + 1, k + 1))
        K[:k, k] = K[k, :k] = self.cone.weights
        for _ in range(STEPS):
            values = x @ self.numbers
            if not (values > 0).all():
                return None
            parts = self.numbers / values
            gradient, hessian = parts.sum(axis=1), parts @ parts.T
            try:
                for B in blocks:
                    R = np.linalg.inv(np.linalg.cholesky((x @ B.reshape(k, -1)).reshape(B.shape[1:])))
                    flat = (R @ B @ R.conj().T).reshape(k, -1)
                    gradient += flat[:, :: len(R) + 1].sum(axis=1).real
                    hessian += (flat.conj() @ flat.T).real
                hessian[np.diag_indices(k)] += FLAT * np.trace(hessian)
                K[:k, :k] = hessian
                step = np.linalg.solve(K, np.append(gradient, 0.0))[:k]
            except np.linalg.LinAlgError:
                return None
            decrement = float(np.sqrt(max(gradient @ step, 0.0)))
            if not np.isfinite(decrement):
                return None
            x = x + step / (1 + decrement if decrement > NEAR_CENTRE else 1)
            if decrement < near:
                return x
        return None
