"""From continuous to discrete time and back: `c2d`, and the Cayley map that keeps norms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from synth.checks import as_choice, as_period
from synth.errors import ModelError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import is_singular
from synth.systems.statespace import StateSpace, as_system


def c2d(G: Any, dt: float, method: str = "zoh") -> StateSpace:
    """Continuous to discrete: `"zoh"` exact hold equivalent, `"tustin"` bilinear.

    Parameters
    ----------
    G : continuous system, in any form that `system` takes
    dt : sampling time in seconds, positive
    method : "zoh" or "tustin"

    Raises
    ------
    ModelError : G is no system or is discrete already, dt is not positive.
    """
    G = as_system("G", G)
    if G.discrete:
        raise ModelError(f"the system is already discrete (dt = {G.dt} s); c2d takes a continuous one")
    dt = as_period(dt)
    as_choice("method", method, ("zoh", "tustin"))
    if G.n == 0:
        return replace(G, dt=dt)
    if method == "zoh":
        M = sla.expm(dt * np.block([[G.A, G.B], [np.zeros((G.nu, G.n + G.nu))]]))
        return replace(G, A=M[: G.n, : G.n], B=M[: G.n, G.n :], dt=dt)
    return replace(cayley(G, 2 / dt, dt), u=G.u, y=G.y, units=G.units)


def cayley(G: StateSpace, rate: float, dt: float = 1.0) -> StateSpace:
    """Norm-preserving map of a continuous system to a discrete one, s = rate (z - 1)/(z + 1).

    Stability, H-infinity norm and stabilisability carry over exactly; `inverse_cayley` is the way back.

    Raises
    ------
    ModelError : `rate` (rad/s) is an eigenvalue of A.
    """
    E = rate * np.eye(G.n) - G.A
    if is_singular(E, rate + np.linalg.norm(G.A, 2)):
        raise ModelError(f"{rate} rad/s is an eigenvalue of A: choose another rate for the Cayley map")
    A = np.linalg.solve(E, rate * np.eye(G.n) + G.A)
    B = np.sqrt(2 * rate) * np.linalg.solve(E, G.B)
    C = np.sqrt(2 * rate) * np.linalg.solve(E.T, G.C.T).T
    D = G.D + G.C @ np.linalg.solve(E, G.B)
    return StateSpace(A, B, C, D, dt)


def cayley_rate(G: StateSpace) -> float:
    """A rate in rad/s for the Cayley map: the geometric mean of the pole moduli, away from every pole."""
    moduli = np.abs(G.poles())
    moduli = moduli[moduli > 1e-8 * max(moduli.max(initial=0.0), 1e-300)]
    rate = float(np.exp(np.log(moduli).mean())) if moduli.size else 1.0
    while G.n and np.abs(G.poles() - rate).min() < 1e-2 * rate:
        rate *= 1.1
    return rate


def inverse_cayley(G: StateSpace, rate: float) -> StateSpace:
    """The way back from `cayley`: z = (rate + s)/(rate - s).

    Raises
    ------
    ModelError : -1 is an eigenvalue of A, that is, the continuous system would be improper.
    """
    E = G.A + np.eye(G.n)
    if is_singular(E, 1 + np.linalg.norm(G.A, 2)):
        raise ModelError("-1 is an eigenvalue of A: the continuous system would not be proper")
    A = rate * np.linalg.solve(E, G.A - np.eye(G.n))
    B = np.sqrt(2 * rate) * np.linalg.solve(E, G.B)
    C = np.sqrt(2 * rate) * np.linalg.solve(E.T, G.C.T).T
    D = G.D - G.C @ np.linalg.solve(E, G.B)
    return StateSpace(A, B, C, D, 0.0)


def discretised(plant: GeneralizedPlant) -> tuple[GeneralizedPlant, Callable[[StateSpace], StateSpace]]:
    """A discrete plant with the same norms, and the way back for its controllers."""
    if plant.dt > 0:
        return plant, lambda K: K
    _, _, nu, _, ny = plant.sizes
    rate = cayley_rate(plant.system)
    return GeneralizedPlant.partition(cayley(plant.system, rate), ny, nu), lambda K: inverse_cayley(K, rate)
