"""One period of a continuous plant between a hold and a sampler, as a discrete plant of the same H-infinity level.

Over a period the state goes forward and its costate p, the gradient of |z|^2 - |w|^2, goes back:

    x(h) = Phi x(0) + L L' p(h),    p(0) = C' C x(0) + Phi' p(h)        E = Phi - I

L is what the worst w reaches, C what z sees. A period follows another by Redheffer's product, and that exists exactly
when |C L| of the two is below one: no w within them both has a gain of one. So a period is made of a step that is
short enough to have no such w for certain, doubled until it is long enough, and every doubling decides. Nothing grows
that the plant itself does not make grow, and slow states beside fast ones keep their digits, as E has no ones in it.

References: Bamieh and Pearson (1992), IEEE TAC 37, 418 (lifting); Kabamba and Hara (1993), IEEE TAC 38, 1337, and
Chen and Francis (1995), Optimal Sampled-Data Control Systems, chapter 13 (the equivalent discrete plant); Redheffer
(1960), J. Math. Phys. 39, 269 (the product).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from synth.errors import NumericalError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import Matrices, in_principal_axes

SHORT = 0.25  # norm of the Hamiltonian over the first step: its series converges at once, no w in it has a gain of one
TERMS = 16  # of that series: 0.25^16/16! is far below rounding
DOUBLINGS = 200  # 2^200 steps: no plant in doubles needs more
WIDE = 2.0**80  # of the size of the plant: a level at which w has no part in its own making


class Period(NamedTuple):
    """Redheffer's form of a period, and the squared Hilbert-Schmidt norm from w to z within it, of small gains."""

    E: np.ndarray  # (n, n) Phi - I
    L: np.ndarray  # (n, r)
    C: np.ndarray  # (q, n)
    within: float


def period(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, h: float) -> Period | None:
    """The plant x' = A x + B w, z = C x + D w over h s; None where a w within has a gain of one or more.

    Parameters
    ----------
    A : (n, n); B : (n, m); C : (p, n); D : (p, m); in balanced coordinates

    Raises
    ------
    NumericalError : doubles cannot hold the number of steps.
    """
    made = _absorbed(B, D, C)
    if made is None:
        return None
    B, changed, C = made
    A = A + changed
    H = np.block([[-A.T, -C.T @ C], [B @ B.T, A]])
    steps = 4 * h * float(np.linalg.norm(H, 1))
    if not steps < 2.0**DOUBLINGS:
        raise NumericalError(f"the plant is {steps:.1e} times faster than the period; take its fastest states out")
    doublings = max(0, int(np.ceil(np.log2(steps)))) if steps > 0 else 0
    found: Period | None = _first(A, B, C, h / 2**doublings)
    for _ in range(doublings):
        if found is not None:
            found = joined(found, found)
    return found


def joined(first: Period, second: Period) -> Period | None:
    """One after the other; None where a w within both has a gain of one or more."""
    T = second.C @ first.L
    made = _absorbed(first.L, T, second.C)
    if made is None:
        return None
    L, between, C = made
    E1, E2 = first.E, second.E
    between = between + between @ E1
    return Period(
        E1 + E2 + E2 @ E1 + between + E2 @ between,
        _narrow(np.hstack([second.L, L + E2 @ L])),
        _narrow(np.vstack([first.C, C + C @ E1]).T).T,
        first.within + second.within + float(np.sum(T**2)),
    )


def _absorbed(B: np.ndarray, T: np.ndarray, C: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """B (I - T'T)^-1/2, B T'(I - TT')^-1 C and (I - TT')^-1/2 C; None unless |T| < 1."""
    U, s, Vt = np.linalg.svd(T, full_matrices=False)
    if not s.max(initial=0.0) < 1:
        return None
    room = (1 - s) * (1 + s)
    more = s**2 / (np.sqrt(room) * (1 + np.sqrt(room)))  # 1/sqrt(room) - 1
    BV, UC = B @ Vt.T, U.T @ C
    return B + (BV * more) @ Vt, (BV * (s / room)) @ UC, C + (U * more) @ UC


def _narrow(L: np.ndarray) -> np.ndarray:
    """A factor of L L' with no more columns than rows; every row keeps its digits."""
    return L if L.shape[1] <= L.shape[0] else np.asarray(np.linalg.qr(L.T, mode="r")).T


def _first(A: np.ndarray, B: np.ndarray, C: np.ndarray, h: float) -> Period:
    """A step so short that the exponential of the Hamiltonian is a short series; no D."""
    n = len(A)
    H = h * np.block([[-A.T, -C.T @ C], [B @ B.T, A]])
    X = np.zeros_like(H)  # exp(H) - I by Horner's rule
    for k in range(TERMS, 0, -1):
        X = (H + H @ X) / k
    G = np.eye(n) + X[:n, :n]
    W, Q = np.linalg.solve(G.T, X[n:, :n].T).T, -np.linalg.solve(G, X[:n, n:])
    E = -np.linalg.solve(G.T, X[:n, :n].T)
    return Period(E, _root(W), _root(Q).T, _within(A, B, C, h))


def _root(W: np.ndarray) -> np.ndarray:
    """L with L L' = W positive semidefinite; every row keeps its digits."""
    size = np.sqrt(np.maximum(np.diag(W), 0))
    unit = np.where(size > 0, size, 1.0)
    e, V = np.linalg.eigh((W + W.T) / 2 / unit / unit[:, None])
    kept = e > len(W) * np.finfo(float).eps
    return size[:, None] * V[:, kept] * np.sqrt(e[kept])


def _within(A: np.ndarray, B: np.ndarray, C: np.ndarray, h: float) -> float:
    """Integral of (h - t) |C exp(A t) B|^2 (Frobenius) over a short step."""
    terms, X = [], B
    for k in range(TERMS):
        terms.append(np.ravel(C @ X))
        X = A @ X * (h / (k + 1))
    k = np.add.outer(np.arange(TERMS), np.arange(TERMS))
    return h**2 * float(np.sum(np.array(terms) @ np.array(terms).T / ((k + 1) * (k + 2))))


@dataclass(frozen=True, eq=False)
class Lifting:
    """A continuous plant, in good coordinates, whose u is held and whose y is sampled every h s."""

    plant: GeneralizedPlant  # continuous
    h: float  # s
    delay: float  # s, from 0 to h: when after the sample the hold takes the new u
    held: tuple[int, ...]  # those w that are constant over a period; the others are free and have no part in y
    given: GeneralizedPlant  # the plant in its own coordinates

    @classmethod
    def of(cls, plant: GeneralizedPlant, h: float, delay: float, held: tuple[int, ...]) -> Lifting:
        """The same in good coordinates of the state; those of the signals stay."""
        A, B, C, _ = in_principal_axes(plant.system.matrices)
        m, p = plant.B1.shape[1], plant.C1.shape[0]
        moved = replace(plant, A=A, B1=B[:, :m], B2=B[:, m:], C1=C[:p], C2=C[p:])
        return cls(moved, h, delay, held, plant)

    @property
    def free(self) -> list[int]:
        """The w that are any signals."""
        return [j for j in range(len(self.plant.w)) if j not in self.held]

    @property
    def direct(self) -> float:
        """Norm of the direct term from the free w to z, below which no level is."""
        return float(np.linalg.norm(self.plant.D11[:, self.free], 2)) if self.free else 0.0

    @property
    def wide(self) -> float:
        """A level beside which the gain of a period is nothing: of the H2 norm, where H-infinity starts."""
        P = self.plant
        sizes = [np.linalg.norm(M) for M in (P.B1, P.C1, P.D11, P.D12)]
        return WIDE * float(np.exp2(np.ceil(np.log2(1 + sizes[0] * sizes[1] * (1 + self.h) + max(sizes)))))

    def units(self, level: float) -> np.ndarray:
        """Powers of two, (k + m,), that make the held w and u count as much over a period as the states do."""
        P, held = self.plant, list(self.held)
        rate = float(np.linalg.norm(P.A)) + 1 / self.h
        B, D = np.hstack([P.B1[:, held], P.B2]), np.hstack([P.D11[:, held], P.D12])
        with np.errstate(divide="ignore"):
            sizes = rate / np.linalg.norm(B, axis=0), np.sqrt(rate * level) / np.linalg.norm(D, axis=0)
        found = np.minimum(*sizes)
        found[~np.isfinite(found)] = 1.0
        return np.exp2(np.round(np.log2(found)))

    def at(self, level: float) -> tuple[GeneralizedPlant, Period] | None:
        """The discrete plant that has a level below one exactly when this plant has one below `level`, and its period.

        None where some free w has a gain of `level` or more within a period, which no controller changes.

        Its state is that of the plant, and the u still held where there is a delay. Its z and w are those of a whole
        period, over sqrt(level); a w that is held counts as the signal that it is: h |w|^2 a period.
        """
        P, h, free, held = self.plant, self.h, self.free, list(self.held)
        m = len(P.u)
        root, late = np.sqrt(level), self.delay > 0
        B, C, D = P.B1[:, free] / root, P.C1 / root, P.D11[:, free] / level
        Bv, Dv = np.hstack([P.B1[:, held], P.B2]), np.hstack([P.D11[:, held], P.D12]) / root
        unit = self.units(level)
        old, new = Matrices(P.A, Bv * unit, C, Dv * unit), len(held) + np.arange(m)
        whole = None
        for acts, time in [(False, self.delay)] * late + [(True, h - self.delay)] * (self.delay < h):
            part = period(*_extended(old, B, D, new, late, acts), time)
            whole = part if whole is None or part is None else joined(whole, part)
            if whole is None:
                return None
        assert whole is not None  # h is positive
        unit = np.concatenate([unit, unit[new]]) if late else unit
        return self._plant(whole, unit, root), whole

    def _plant(self, whole: Period, unit: np.ndarray, root: float) -> GeneralizedPlant:
        """The period as a plant; the constants of the period are in `unit`: held w, the u that was held before, u."""
        P, late = self.plant, self.delay > 0
        n, _, m, _, ny = P.sizes
        k, N = len(self.held), len(whole.E)
        energy = root * np.sqrt(self.h)
        F, C = np.array(whole.E), np.array(whole.C)
        F[:, n:], C[:, n:] = F[:, n:] / unit, C[:, n:] / unit
        F[:n, :n] += np.eye(n)
        now, before = slice(N - m, N), slice(n + k, n + k + m if late else n + k)
        x = [*range(n), *range(before.start, before.stop)]
        s = len(x) - n
        L = np.vstack([whole.L[:n], np.zeros((s, whole.L.shape[1]))])
        A = np.vstack([F[:n, x], np.zeros((s, len(x)))])
        O = np.zeros
        return GeneralizedPlant(
            A=A,
            B1=np.hstack([L, np.vstack([F[:n, n : n + k], O((s, k))]) / energy, O((len(x), 1))]),
            B2=np.vstack([F[:n, now], np.eye(m)[:s]]),
            C1=np.vstack([C[:, x], O((1, len(x)))]),
            D11=np.vstack([np.hstack([O((len(C), L.shape[1])), C[:, n : n + k] / energy, O((len(C), 1))]),
                           O((1, L.shape[1] + k + 1))]),
            D12=np.vstack([C[:, now], O((1, m))]),
            C2=np.hstack([P.C2, P.D22[:, :s]]),
            D21=np.hstack([O((ny, L.shape[1])), P.D21[:, list(self.held)] / energy, O((ny, 1))]),
            D22=O((ny, m)) if late else P.D22,
            dt=self.h, u=P.u, y=P.y,
        )  # fmt: skip


def _extended(
    G: Matrices, B: np.ndarray, D: np.ndarray, new: np.ndarray, late: bool, acts: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The plant with the constants of a period as states; with a delay both the u before and the u after are."""
    n, k = G.B.shape
    Bv, Dv = (np.hstack([M, np.zeros((len(M), len(new) if late else 0))]) for M in (G.B, G.D))
    if late and acts:  # the columns of u now belong to the second of them
        for M in (Bv, Dv):
            M[:, k:], M[:, new] = M[:, new].copy(), 0.0
    A = np.block([[G.A, Bv], [np.zeros((Bv.shape[1], n + Bv.shape[1]))]])
    return A, np.vstack([B, np.zeros((Bv.shape[1], B.shape[1]))]), np.hstack([G.C, Dv]), D
