"""Plants whose bounds should be provable: half continuous, half discrete, half of them stable, of order 2 to 8."""

from __future__ import annotations

import numpy as np
from families import Random, four_block, integrating

from synth import GeneralizedPlant, StateSpace, augw, c2d

KINDS = ("regular", "four-block", "mixed sensitivity")


def drawn(seed: int) -> GeneralizedPlant:
    """Plants number 0, 1, 2, ...: twelve of them have every kind, both times, stable and unstable."""
    rng, kind = np.random.default_rng([11, seed]), KINDS[seed % 3]
    discrete, stable = bool(seed // 3 % 2), bool(seed // 6 % 2)
    n, m = int(rng.integers(2, 9)), int(rng.integers(1, 3))
    if kind == "regular":
        return _regular(rng, n, discrete, stable)
    if kind == "four-block":
        return four_block(_system(rng, n, m, discrete, stable), rng)
    G = _system(rng, max(1, n - m), m, discrete, stable)
    bandwidth = (0.3 / G.dt if discrete else 1.0) * 10 ** rng.uniform(-1, 0)
    W1 = integrating(rng, bandwidth, bandwidth * 10 ** rng.uniform(-5, -1))
    return augw(G, c2d(W1, G.dt, "tustin") if discrete else W1, float(10 ** rng.uniform(-1.5, 0.5)))


def _system(rng: Random, n: int, m: int, discrete: bool, stable: bool) -> StateSpace:
    """Random, with its slowest or fastest-growing pole where it is wanted."""
    r = rng.standard_normal
    A = r((n, n)) / np.sqrt(n)
    values = np.linalg.eigvals(A)
    if discrete:
        A *= (rng.uniform(0.3, 0.98) if stable else rng.uniform(1.02, 1.6)) / np.abs(values).max()
    else:
        A -= (values.real.max() + rng.uniform(0.05, 1) * (1 if stable else -1)) * np.eye(n)
    return StateSpace(A, r((n, m)), r((m, n)), np.zeros((m, m)), 10 ** rng.uniform(-3, 1) if discrete else 0.0)


def _regular(rng: Random, n: int, discrete: bool, stable: bool) -> GeneralizedPlant:
    """All nine matrices random, D11 and D22 half the time; square D12 and D21 among them."""
    nu, ny = (int(rng.integers(1, 3)) for _ in range(2))
    nz, nw = nu + int(rng.integers(0, 3)), ny + int(rng.integers(0, 3))
    G, r = _system(rng, n, 1, discrete, stable), rng.standard_normal
    direct = [0.3 * (rng.random() < 0.5) for _ in range(2)]
    return GeneralizedPlant(
        G.A, r((n, nw)), r((n, nu)), r((nz, n)), direct[0] * r((nz, nw)), r((nz, nu)), r((ny, n)), r((ny, nw)),
        direct[1] * r((ny, nu)), G.dt,
    )  # fmt: skip
