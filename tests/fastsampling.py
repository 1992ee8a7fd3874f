"""Sampled loops by brute force: the disturbance held over N parts of a period, the energy of z exact (Keller-Anderson).

A norm from below that grows with N, and shares nothing with `synth.equations.lifting`.

Reference: Keller and Anderson (1992), IEEE TAC 37, 588.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

import synth
from synth.equations.doubling import regularised_lqr


def fast_sampled(P: synth.GeneralizedPlant, K: synth.StateSpace, N: int, *, late: int = 0, held=()) -> synth.StateSpace:
    """The loop from N values of every w that is not held (and one of those that are) to z, of one period.

    `late` is the delay in parts of the period. Energies of all signals are those of continuous time.
    """
    n, nw, m, *_ = P.sizes
    h, d = float(K.dt), float(K.dt) / N
    free = [j for j in range(nw) if j not in held]
    held = list(held)
    # one part: x, w, u constant
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    k = nw + m
    Ae = np.block([[P.A, B], [np.zeros((k, n + k))]])
    Ce = np.hstack([P.C1, D])
    step, gram = exponential_and_gram(Ae, Ce.T @ Ce, d)
    e, V = np.linalg.eigh((gram + gram.T) / 2)
    M = (V * np.sqrt(np.maximum(e, 0))).T  # |M (x, w, u)|^2 is the energy of z
    F, G = step[:n, :n], step[:n, n:]
    # signals of a period: x, xk, v (u before), w parts, w held
    s = n + K.n + m
    total = s + N * len(free) + len(held)
    I = np.eye(total)
    x, xk, before = I[:n], I[n : n + K.n], I[n + K.n : s]
    wheld = I[s + N * len(free) :] / np.sqrt(h)
    y = P.C2 @ x + (P.D21[:, held] @ wheld if held else 0)
    if late:
        y = y + P.D22 @ before
        u = K.C @ xk + K.D @ y
    else:
        u = np.linalg.solve(np.eye(m) - K.D @ P.D22, K.C @ xk + K.D @ y)
        y = y + P.D22 @ u
    rows = []
    xnext = K.A @ xk + K.B @ y
    for i in range(N):
        w = np.zeros((nw, total))
        w[free] = I[s + i * len(free) : s + (i + 1) * len(free)] / np.sqrt(d)
        if held:
            w[held] = wheld
        now = before if i < late else u
        rows.append(M @ np.vstack([x, w, now]))
        x = F @ x + G @ np.vstack([w, now])
    AB, CD = np.vstack([x, xnext, u]), np.vstack(rows)
    CD = np.linalg.qr(CD, mode="r")  # energies stay
    return synth.StateSpace(AB[:, :s], AB[:, s:], CD[:, :s], CD[:, s:], h)


def exponential_and_gram(A: np.ndarray, Q: np.ndarray, d: float) -> tuple[np.ndarray, np.ndarray]:
    """exp(A d) and the integral of exp(A't) Q exp(A t) over d s, by Gauss's rule on ever shorter pieces."""
    pieces = max(1, int(np.ceil(np.linalg.norm(A) * d)))
    part, gram = d / pieces, np.zeros_like(A)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    for node, weight in zip(nodes, weights, strict=True):
        E = sla.expm(A * part * (node + 1) / 2)
        gram += weight * part / 2 * E.T @ Q @ E
    E, found, power = sla.expm(A * part), np.zeros_like(A), np.eye(len(A))
    for _ in range(pieces):
        found += power.T @ gram @ power
        power = E @ power
    return power, found


def random_loop(seed: int, *, n: int = 3, m: int = 1, p: int = 1, nw: int = 2, nz: int = 2, h: float = 0.0):
    """A continuous plant, without direct terms but D12, and a discrete controller that stabilises it."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() - rng.uniform(-0.5, 0.3)) * np.eye(n)
    h = h or float(10 ** rng.uniform(-1.5, 0.3))
    P = synth.GeneralizedPlant(
        A=A, B1=rng.normal(size=(n, nw)), B2=rng.normal(size=(n, m)), C1=rng.normal(size=(nz, n)),
        D11=np.zeros((nz, nw)), D12=rng.normal(size=(nz, m)), C2=rng.normal(size=(p, n)), D21=np.zeros((p, nw)),
        D22=np.zeros((p, m)),
    )  # fmt: skip
    G = synth.c2d(synth.StateSpace(P.A, P.B2, P.C2, P.D22), h)
    Z, I = np.zeros, np.eye
    F = regularised_lqr(G.A, G.B, np.vstack([I(n), Z((m, n))]), np.vstack([Z((n, m)), I(m)]), "").F
    L = regularised_lqr(G.A.T, G.C.T, np.vstack([I(n), Z((p, n))]), np.vstack([Z((n, p)), I(p)]), "").F.T
    return P, synth.StateSpace(G.A + G.B @ F + L @ G.C, -L, F, Z((m, p)), h)
