"""Examples from the literature, by name, for tests and benchmarks."""

import json
from pathlib import Path

import numpy as np

from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

DATA = Path(__file__).parent / "data"

# Optimal level of the CubeSat plant below, found by Riccati root finding and enclosed by proofs of both bounds.
GAMMA_PECORILLA2024 = 4.1579256061e-6


def cubesat_model() -> StateSpace:
    """Pecorilla and Stesina (2024), doi 10.1002/rnc.7119, equations (12) to (15), tables 3 and 5: exact hold, 0.5 s."""
    mu, radius = 3.986004418e14, 6378137.0 + 470e3
    w0 = np.sqrt(mu / radius**3)
    Ix, Iy, Iz = 0.0546, 0.0546, 0.0074
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3) / 2
    A[3, 0], A[3, 5] = -8 * w0**2 * (Iy - Iz) / Ix, w0 * (Iz + Ix - Iy) / Ix
    A[4, 1] = -6 * w0**2 * (Ix - Iz) / Iy
    A[5, 2], A[5, 3] = -2 * w0**2 * (Iy - Ix) / Iz, -w0 * (Iz + Ix - Iy) / Iz
    B = np.vstack([np.zeros((3, 3)), np.diag([1 / Ix, 1 / Iy, 1 / Iz])])
    return c2d(StateSpace(A, B, np.eye(6), np.zeros((6, 3))), 0.5)


def cubesat_pecorilla2024(factor: float = 1.0) -> GeneralizedPlant:
    """Equation (27) with the weights of table 4, all multiplied by `factor` (gamma goes with its square)."""
    return GeneralizedPlant.tracking(
        cubesat_model(),
        Wact=factor * 1e-2 * np.eye(3),
        Wproc=factor * 2.5e-4 * np.diag([1.2, 1.2, 0.25]),
        Wdist=factor * 5e-2 * np.eye(6),
        Werr=factor * 1e-5 * np.diag([1, 1, 1, 0.1, 0.1, 0.1]),
        Wr=factor * 2e-2 * np.diag([1, 1, 1, 0.1, 0.1, 0.1]),
    )


def compleib() -> dict[str, tuple[GeneralizedPlant, float]]:
    """Continuous plants of the COMPleib collection (Leibfritz) with reference optima: name -> (plant, gamma)."""
    plants = json.loads((DATA / "compleib_open.json").read_text())["plants"]
    names = ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22", "dt")
    return {key: (GeneralizedPlant(**{k: p[k] for k in names}), p["gamma"]) for key, p in plants.items()}


def random_plant(
    seed: int, n: int, nw: int, nu: int, nz: int, ny: int, *, direct: bool, deficient: str
) -> GeneralizedPlant:
    """Random discrete plant; `deficient` names which of D12, D21 lose rank: "none", "D12", "D21" or "both"."""
    rng = np.random.default_rng(seed)

    def r(a, b):
        return rng.normal(size=(a, b))

    A = r(n, n)
    A *= rng.uniform(0.5, 1.5) / np.abs(np.linalg.eigvals(A)).max()
    D12, D21 = r(nz, nu), r(ny, nw)
    if deficient in ("D12", "both"):
        D12[:, -1] = 0
    if deficient in ("D21", "both"):
        D21[-1] = 0
    D11, D22 = r(nz, nw) * direct, 0.3 * r(ny, nu) * direct
    return GeneralizedPlant(A, r(n, nw), r(n, nu), r(nz, n), D11, D12, r(ny, n), D21, D22, 1.0)


def mass_spring_chain(n: int) -> GeneralizedPlant:
    """n/2 masses of 1 kg between two walls, springs 1 N/m, dampers 0.02 N s/m, zero-order hold of 0.2 s.

    w: a force on every mass (1 N) and noise of the sensor (0.1 m); z: all positions and the control force;
    u: a force on the last mass; y: the position of the first one.
    """
    N = n // 2
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    A = np.block([[np.zeros((N, N)), np.eye(N)], [-K, -0.02 * K]])
    G = c2d(StateSpace(A, np.eye(n)[:, N:], np.eye(n), np.zeros((n, N))), 0.2)
    O, I = np.zeros, np.eye(n)
    return GeneralizedPlant(
        A=G.A, B1=np.hstack([G.B, O((n, 1))]), B2=G.B[:, -1:],
        C1=np.vstack([I[:N], O((1, n))]), D11=O((N + 1, N + 1)), D12=np.eye(N + 1)[:, -1:],
        C2=I[:1], D21=0.1 * np.eye(N + 1)[-1:], D22=O((1, 1)), dt=0.2,
    )  # fmt: skip


def aircraft_slicot() -> StateSpace:
    """The example of AB09AD, AB09BD and AB13AD in SLICOT's documentation: seven states, 3 x 2."""
    half = np.array([[-0.04165, 0, 4.92], [-5.21, -12.5, 0], [0, 3.33, -3.33]])
    A = np.zeros((7, 7))
    A[:3, :3] = A[4:, 4:] = half
    A[0, 3], A[3, 0], A[3, 4], A[4, 3] = -4.92, 0.545, -0.545, 4.92
    B, C = np.zeros((7, 2)), np.zeros((3, 7))
    B[1, 0] = B[5, 1] = 12.5
    C[0, 0] = C[1, 3] = C[2, 4] = 1
    return StateSpace(A, B, C, np.zeros((3, 2)))
