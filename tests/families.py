"""Families of linear plants, drawn by NumPy generators, and what coordinates and units do to them.

A `Move` is another realisation of the same plant: states x = T x', a unit of time, units of u and y. Doubles may not
hold the plant any more in its new coordinates: `held` says how much of a response the rounding of the moved matrices
changes, the responses being computed in arithmetic that is long enough. A move that loses more falls back to one that
rounds every entry on its own: the diagonal scaling.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
from flint import acb, acb_mat, ctx

from synth import GeneralizedPlant, StateSpace, augw
from synth.systems.realization import Matrices, rescaled, state_scales

BESIDE = 1 + 1e-7  # relative, of a frequency beside a pole
LOST = 1e-8  # relative, of a response: what moved coordinates may lose
ROUNDING = 2e-16
BITS = 240  # of the arithmetic in which responses are compared
AS_IT_IS = "as it is"  # "unit" of the control of a plant that is not turned
Random = np.random.Generator


def four_block(G: StateSpace, rng: Random) -> GeneralizedPlant:
    """Weights of one decade to either side of one on every channel."""
    d, n, y, u = (np.diag(10 ** rng.uniform(-1, 1, k)) for k in (G.nu, G.ny, G.ny, G.nu))
    return GeneralizedPlant.four_block(G, Wdist=d, Wnoise=n, Wout=y, Wact=u)


def integrating(rng: Random, bandwidth: float, pole: float) -> StateSpace:
    """The weight (s/M + w)/(s + pole), with M from 1.2 to 2."""
    M = rng.uniform(1.2, 2)
    return StateSpace([[-pole]], [[1.0]], [[bandwidth - pole / M]], [[1 / M]])


def double_integrator_axes(rng: Random) -> StateSpace:
    """One to three axes of 1/s^2 with a random inertia."""
    k = int(rng.integers(1, 4))
    J = rng.normal(size=(k, k))
    J = np.linalg.inv(J @ J.T + np.eye(k))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [np.zeros((k, 2 * k))]])
    return StateSpace(A, np.vstack([0 * J, J]), np.eye(k, 2 * k), np.zeros((k, k)))


def integrator_chain(rng: Random) -> StateSpace:
    """g/s^k, k from one to three."""
    k = int(rng.integers(1, 4))
    return StateSpace(np.eye(k, k=1), 10 ** rng.uniform(-2, 2) * np.eye(k)[:, -1:], np.eye(1, k), [[0.0]])


def orbiting_body(rng: Random) -> StateSpace:
    """A rigid body in orbit: gravity-gradient stiffness at 1e-3 rad/s, both signs, roll and yaw coupled."""
    w0, (sx, sy, sz) = 1.1e-3, rng.uniform(-0.9, 0.9, 3)
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[4, 1], A[5, 2] = -4 * w0**2 * sx, -3 * w0**2 * sy, -(w0**2) * sz
    A[3, 5], A[5, 3] = w0 * (1 - sx), -w0 * (1 + sz)
    B = np.vstack([np.zeros((3, 3)), np.diag(10 ** rng.uniform(-2, 2, 3))])
    return StateSpace(A, B, np.eye(3, 6), np.zeros((3, 3)))


def flexible_axis(rng: Random) -> StateSpace:
    """A rigid axis and up to four modes with a damping of 1e-5 to 1e-2, sensor and actuator apart."""
    blocks, b, c = [np.array([[0.0, 1], [0, 0]])], [0.0, 1.0], [1.0, 0.0]
    for _ in range(int(rng.integers(1, 5))):
        w, zeta = 10 ** rng.uniform(-1, 1.5), 10 ** rng.uniform(-5, -2)
        blocks.append(np.array([[0, 1], [-(w**2), -2 * zeta * w]]))
        b, c = [*b, 0.0, rng.normal()], [*c, rng.normal(), 0.0]
    return StateSpace(sla.block_diag(*blocks), np.array([b]).T, [c], [[0.0]])


def spread_lags(rng: Random) -> StateSpace:
    """One to eight lags over six decades, some in the right half plane, dense B and C."""
    n, m = int(rng.integers(1, 9)), int(rng.integers(1, 3))
    poles = -(10 ** rng.uniform(-3, 3, n)) * np.where(rng.random(n) < 0.2, -1, 1)
    gain = np.sqrt(np.abs(poles))[:, None]
    B, C = gain * rng.normal(size=(n, m)), (gain * rng.normal(size=(n, m))).T
    return StateSpace(np.diag(poles), B, C, np.zeros((m, m)))


def jordan_block(rng: Random) -> StateSpace:
    """One Jordan block of up to five states, in the left or the right half plane or at the origin."""
    n, p = int(rng.integers(2, 6)), float(rng.choice([0.0, rng.uniform(-2, 0.5)]))
    return StateSpace(p * np.eye(n) + np.eye(n, k=1), np.eye(n)[:, -1:], np.eye(1, n), [[0.0]])


def modal_form(rng: Random) -> StateSpace:
    """Two to eight real and complex poles of one to three decades in real modal form, one or two signals."""
    k, m, spread = int(rng.integers(1, 5)), int(rng.integers(1, 3)), rng.uniform(0.5, 1.5)
    blocks = []
    for w, zeta in zip(10 ** rng.uniform(-spread, spread, k), rng.uniform(0.05, 1.0, k), strict=True):
        blocks.append(w * np.array([[-zeta, np.sqrt(1 - zeta**2)], [-np.sqrt(1 - zeta**2), -zeta]]))
    gain = np.sqrt(np.repeat([np.linalg.norm(b, 2) for b in blocks], 2))[:, None]
    B, C = gain * rng.normal(size=(2 * k, m)), (gain * rng.normal(size=(2 * k, m))).T
    return StateSpace(sla.block_diag(*blocks), B, C, np.zeros((m, m)))


def companion_form(rng: Random, n: int, w0: float, unit: float = 1.0) -> StateSpace:
    """A companion form of n poles about w0 rad/s, as transfer functions come; states in units of `unit`."""
    den = np.poly(-w0 / unit * rng.uniform(0.3, 3, n))
    A = np.zeros((n, n))
    A[:-1, 1:], A[-1] = np.eye(n - 1), -den[::-1][:n]
    return StateSpace(unit * A, unit * np.eye(n)[:, -1:], den[-1] * np.eye(1, n), [[0.0]])


def dense_system(rng: Random) -> StateSpace:
    """Up to eight states and three signals, all of it random, a direct term too."""
    n, m, p = (int(rng.integers(1, k)) for k in (9, 4, 4))
    r = rng.standard_normal
    return StateSpace(r((n, n)) / np.sqrt(n) - rng.uniform(-0.5, 1) * np.eye(n), r((n, m)), r((p, n)), 0.3 * r((p, m)))


def sampled(rng: Random) -> StateSpace:
    """A discrete system of up to six states with poles about the unit circle, period 1e-3 to 10 s."""
    n, m, p = int(rng.integers(1, 7)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    r = rng.standard_normal
    A = r((n, n))
    A *= rng.uniform(0.5, 1.3) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, r((n, m)), r((p, n)), np.zeros((p, m)), 10 ** rng.uniform(-3, 1))


def companion_decades(rng: Random) -> StateSpace:
    """A companion form of two to five poles about 1 to 1e5 rad/s."""
    return companion_form(rng, int(rng.integers(2, 6)), 10 ** rng.uniform(0, 5))


PLANTS: dict[str, Callable[[Random], StateSpace]] = {
    "integrator chain": integrator_chain, "double integrators": double_integrator_axes, "orbiting": orbiting_body,
    "flexible": flexible_axis, "lags": spread_lags, "jordan": jordan_block, "modal": modal_form,
    "companion": companion_decades, "dense": dense_system, "sampled": sampled,
}  # fmt: skip


def double_integrators(rng: Random) -> GeneralizedPlant:
    """Four-block problem of one to three axes."""
    return four_block(double_integrator_axes(rng), rng)


def orbiting(rng: Random) -> GeneralizedPlant:
    """Four-block problem of a rigid body in orbit."""
    return four_block(orbiting_body(rng), rng)


def flexible(rng: Random) -> GeneralizedPlant:
    """Four-block problem of an axis with flexible modes."""
    return four_block(flexible_axis(rng), rng)


def lags(rng: Random) -> GeneralizedPlant:
    """Four-block problem of lags over six decades."""
    return four_block(spread_lags(rng), rng)


def jordan(rng: Random) -> GeneralizedPlant:
    """Four-block problem of a Jordan block."""
    return four_block(jordan_block(rng), rng)


def companion(rng: Random) -> GeneralizedPlant:
    """Mixed sensitivity of a companion form of up to five poles about 1 to 1e5 rad/s.

    Those that will be turned are of poles about 1 in units of w0: turned companion forms of fast poles hold no digit.
    """
    n, w0, turned = int(rng.integers(2, 6)), 10 ** rng.uniform(0, 5), rng.random() < 0.5
    G = companion_form(rng, n, w0, w0 if turned else 1.0)
    P = augw(G, integrating(rng, 0.3 * w0, 10 ** rng.uniform(-4, -2) * w0), float(10 ** rng.uniform(-1.5, 0.5)))
    return P if turned else replace(P, units={P.u[0]: AS_IT_IS})


def servo(rng: Random) -> GeneralizedPlant:
    """Mixed sensitivity of k/((s + a)(s + b)) with a quasi-integrating weight: poles down to 1e-8 rad/s."""
    a, b, pole = 10 ** rng.uniform(-2, 0.5), 10 ** rng.uniform(-5, -1), 10 ** rng.uniform(-8, -1)
    G = StateSpace([[-a, 0], [1, -b]], [[10 ** rng.uniform(-0.5, 1.5)], [0.0]], [[0.0, 1]], [[0.0]])
    return augw(G, integrating(rng, 10 ** rng.uniform(-0.5, 1), pole), float(10 ** rng.uniform(-1, 0.5)))


def dense(rng: Random) -> GeneralizedPlant:
    """All nine matrices random, direct terms too."""
    n, nw, nu, nz, ny = (int(rng.integers(*pair)) for pair in ((1, 13), (2, 5), (1, 3), (2, 5), (1, 3)))
    nw, nz = max(nw, ny + 1), max(nz, nu + 1)
    r = rng.standard_normal
    A = r((n, n)) / np.sqrt(n) - rng.uniform(-0.5, 1) * np.eye(n)
    return GeneralizedPlant(A, r((n, nw)), r((n, nu)), r((nz, n)), 0.3 * r((nz, nw)), r((nz, nu)), r((ny, n)),
                            r((ny, nw)), 0.3 * r((ny, nu)))  # fmt: skip


CLASSES: tuple[Callable[[Random], GeneralizedPlant], ...] = (
    double_integrators, orbiting, flexible, lags, jordan, companion, servo, dense,
)  # fmt: skip


@dataclass(frozen=True)
class Move:
    """x = T x', time in units of `unit` s."""

    T: np.ndarray  # (n, n)
    unit: float = 1.0  # s

    def __call__(self, G: StateSpace) -> StateSpace:
        """The system in the new coordinates; sqrt(unit) each goes to B and C, which keeps norms."""
        B, C = np.linalg.solve(self.T, G.B), G.C @ self.T
        if G.discrete:
            return StateSpace(np.linalg.solve(self.T, G.A @ self.T), B, C, G.D, G.dt / self.unit)
        A, root = self.unit * np.linalg.solve(self.T, G.A @ self.T), np.sqrt(self.unit)
        return StateSpace(A, root * B, root * C, G.D)


KINDS = ("turned", "scaled", "turned, then scaled", "scaled, then turned")


def move(kind: str, n: int, rng: Random, unit: float = 1.0) -> Move:
    """Random coordinates: an orthogonal matrix Q, a scaling D by 10^[-6, 6], Q D, or D^k Q with k from 0 to 1/2."""
    Q, d, k = np.linalg.qr(rng.standard_normal((n, n)))[0], rng.uniform(-6, 6, n), rng.uniform(0, 0.5)
    D, gentle = np.diag(10**d), np.diag(10 ** (k * d))
    T = {"turned": Q, "scaled": D, "turned, then scaled": Q @ D, "scaled, then turned": gentle @ Q}[kind]
    return Move(T, unit)


def holding(kind: str, G: StateSpace, rng: Random, loss: Callable[[StateSpace], float], unit: float = 1.0) -> Move:
    """The random coordinates asked for, or their scaling alone where doubles do not hold the system in them.

    `loss` says how much of what is measured of the system another one in its place changes.
    """
    found = move(kind, G.n, rng, unit)
    if kind == "scaled" or max(loss(H) for H in (found(G), rounded(found(G), rng))) <= LOST:
        return found
    return move("scaled", G.n, rng, unit)


def rounded(G: StateSpace, rng: Random) -> StateSpace:
    """A system with errors as the rounding of a matrix product leaves them in its balanced matrices."""
    scales = state_scales(G.matrices)
    errors = [M + ROUNDING * np.linalg.norm(M) * rng.standard_normal(M.shape) for M in rescaled(G.matrices, scales)[:3]]
    return StateSpace(*rescaled(Matrices(*errors, G.D), 1 / scales), G.dt)


def frequencies(*systems: StateSpace) -> np.ndarray:
    """Frequencies in rad/s at and about the poles of systems of one timebase, and over the decades between."""
    poles = np.concatenate([G.poles() for G in systems] or [np.ones(1)])
    dt = systems[0].dt
    if dt:
        angles = np.abs(np.angle(poles))
        return np.unique(np.concatenate([angles[angles > 1e-9], np.geomspace(1e-4, 3.0, 30)])) * BESIDE / dt
    moduli = np.abs(poles)[np.abs(poles) > 1e-9 * np.abs(poles).max(initial=0)]
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    return np.unique(np.concatenate([moduli, np.abs(poles.imag), np.geomspace(low / 30, high * 30, 30)]))[1:] * BESIDE


def response(G: StateSpace, omega: np.ndarray, unit: float = 1.0) -> np.ndarray:
    """Transfer matrices (N, p, m) at `omega` rad/s, time in units of `unit` s; exact for the doubles of G."""
    with _long_arithmetic():
        return _doubles([_exact(G, w, unit) for w in omega])


def loop_response(P: GeneralizedPlant, K: StateSpace, omega: np.ndarray, unit: float = 1.0) -> np.ndarray:
    """Response (N, nz, nw) of P closed by u = K y, likewise."""
    found, (_, nw, nu, nz, ny) = [], P.sizes
    with _long_arithmetic():
        I = _matrix(np.eye(nu))
        for w in omega:
            G, H = _exact(P.system, w, unit), _exact(K, w, unit)
            zw, zu, yw, yu = (
                _part(G, *at) for at in ((0, nz, 0, nw), (0, nz, nw, nu), (nz, ny, 0, nw), (nz, ny, nw, nu))
            )
            found.append(zw + zu * (I - H * yu).solve(H * yw))
        return _doubles(found)


@contextmanager
def _long_arithmetic() -> Iterator[None]:
    before, ctx.prec = ctx.prec, BITS
    try:
        yield
    finally:
        ctx.prec = before


def _exact(G: StateSpace, omega: float, unit: float) -> acb_mat:
    s = acb(0, float(omega)) * unit
    s = (s * G.dt).exp() if G.discrete else s
    A, B, C, D = map(_matrix, G.matrices)
    return C * (s * _matrix(np.eye(G.n)) - A).solve(B) + D if G.n else D


def _matrix(M: np.ndarray) -> acb_mat:
    return acb_mat(*M.shape, M.ravel().tolist())


def _part(M: acb_mat, top: int, rows: int, left: int, columns: int) -> acb_mat:
    return acb_mat(rows, columns, [M[top + i, left + j] for i in range(rows) for j in range(columns)])


def _doubles(matrices: list[acb_mat]) -> np.ndarray:
    return np.array([[[complex(M[i, j]) for j in range(M.ncols())] for i in range(M.nrows())] for M in matrices])


def apart(F: np.ndarray, G: np.ndarray) -> float:
    """The largest difference of two responses (N, p, m), relative to the largest singular value."""
    size = np.linalg.norm(F, 2, axis=(1, 2)).max(initial=0.0)
    return float(np.linalg.norm(F - G, 2, axis=(1, 2)).max(initial=0.0) / size) if size else 0.0
