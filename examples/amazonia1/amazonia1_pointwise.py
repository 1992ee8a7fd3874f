"""What the paper states about its models and its H-infinity law at one state, as matrices: no flight.

Equation numbers are those of Romero and Souza (CILAMCE 2022).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from amazonia1_flights import DYNAMIC, LITERAL, NET_INERTIA, SDRE, STATIC, starts

from synth import StateSpace, ncfmargin

STATES = 20  # of the Monte Carlo's starts at which the level is measured, beside the target
EQUATIONS = {SDRE: 1, LITERAL: 3, STATIC: 2, DYNAMIC: 2}  # Riccati equations that a law solves in a sample


def printed_pair(q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B of eq. 26 with all seven states, wheels at rest; q scalar first."""
    A, B = _spin(w)
    W = np.cross(np.eye(3), w)
    A[:3, :3], A[3, :3], A[:3, 4:] = -0.5 * W, -0.5 * w, 0.5 * q[0] * np.eye(3)
    return A, B


def rate_pair(q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B by eq. 14 with Omega, which the paper turns down."""
    del q
    A, B = _spin(w)
    A[:3, :3], A[:3, 3], A[3, :3] = -0.5 * np.cross(np.eye(3), w), 0.5 * w, -0.5 * w
    return A, B


def attitude_pair(q: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B by eq. 14 with Xi, which the paper turns down as well."""
    A, B = _spin(w)
    A[:3, 4:], A[3, 4:] = 0.5 * (q[0] * np.eye(3) + np.cross(np.eye(3), q[1:])), -0.5 * q[1:]
    return A, B


def _spin(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A (7, 7) with the rows of eq. 25 alone, and B."""
    A, B = np.zeros((7, 7)), np.vstack([np.zeros((4, 3)), -np.linalg.inv(NET_INERTIA)])
    A[4:, 4:] = -np.linalg.solve(NET_INERTIA, np.cross(np.eye(3), w) @ NET_INERTIA)
    return A, B


def out_of_reach(A: np.ndarray, B: np.ndarray) -> float:
    """Smallest singular value of [A - s I, B] over the modes s that do not decay: zero if one cannot be stabilised."""
    modes = [s for s in np.linalg.eigvals(A) if s.real > -1e-9]
    return min(np.linalg.svd(np.hstack([A - s * np.eye(len(A)), B]), compute_uv=False)[-1] for s in modes)


def levels(built: dict[str, Any], seed: int) -> dict[str, np.ndarray]:
    """Norm of eq. 12 over the gamma that is asked for, (1 + STATES,) for each law: at the target and at random starts.

    Model and law are frozen at the state. Asked for are gamma_min of eq. 10 by the published law and by SDRE, and
    `gamma_factor` times as much by the others.
    """
    begun, model = starts(STATES, seed), built[SDRE].model
    measured = np.column_stack([begun.q, begun.rates, np.zeros_like(begun.rates)])[1:]  # the first is for the push
    found: dict[str, list[float]] = {name: [] for name in EQUATIONS}
    with jax.enable_x64(True):
        for y in map(jnp.asarray, (model.target(), *measured)):
            A, B = map(np.asarray, model.factorise(y, 1.0)[1:])
            P = StateSpace(A, B, np.eye(6), np.zeros((6, 3)))
            laws = {name: built[name].step(built[name].init(), y, None)[0] for name in EQUATIONS}
            Z = np.asarray(laws[DYNAMIC].injection)  # Q = 1
            least = np.sqrt(1 + np.abs(np.linalg.eigvals(np.asarray(laws[SDRE].X) @ Z)).max())  # equation 10
            for name, law in laws.items():
                K: Any = -np.asarray(law.gain)
                if name == DYNAMIC:
                    K = StateSpace(A + B @ K - Z, Z, K, np.zeros((3, 6)))
                asked = least * getattr(built[name], "gamma_factor", 1.0)
                margin = ncfmargin(P, K, sign=1)
                found[name].append(1 / margin / asked if margin else np.inf)
    return {name: np.array(values) for name, values in found.items()}
