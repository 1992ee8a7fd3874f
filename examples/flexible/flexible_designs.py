"""The roll axis of the satellite with its uncertain parameters, and the controllers of roll.

Criterion: from [torque / (0.01 J); noise / 0.05] to [angle; 50 u / J], J the nominal inertia. Controllers take the
angle to u / J. Inertia, frequencies and couplings are those of the flexible satellite of `docs/robust_box.md`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize

from plants import flexible_model
from synth import Design, StateSpace, UncertainSystem, hinfsyn, musyn, system, ureal, worst_gain
from synth.synthesis.dkiteration import MuDesign

ROLL = 500.0  # kg m^2 about roll, without the rotors
FREQUENCIES = (1.2, 5.0)  # rad/s, bending of the panels with the hub held
COUPLINGS = (14.0, 6.0)  # sqrt(kg) m, to roll
DAMPING = 0.005
TORQUE, NOISE, EFFORT = 0.01, 0.05, 50.0  # of the criterion
BANDWIDTH, RATIO, ROLL_OFF = 0.1, 0.7, 10.0  # rad/s of PD
SPREAD = 20.0  # percent of inertia and frequencies
SPREAD_OF_DAMPING = 50.0  # percent

SPREAD_OF_MU = (
    1.0  # percent of inertia and frequencies, for D-K iteration, to which 20 % are as good as negative damping
)
BLOCKS = [(-1, 0), (-2, 0), (-2, 0), (2, 2)]  # inertia, two frequencies of which squares enter, performance

SIGNS = np.array([-1, -1, -1, 1, 1])  # of the numbers of the second-order controller

NOMINAL, DAMPED, MU, TUNED, PD = "H-infinity", "H-infinity, damped model", "mu, D-K", "second order, tuned", "PD"


def bending(inertia: Any, frequencies: Any, damping: Any = DAMPING) -> UncertainSystem:
    """Roll with the criterion: two inputs and outputs of the criterion, then u / J and the angle."""
    model = flexible_model(inertia, frequencies, couplings=COUPLINGS, damping=damping)
    n = len(model.E)
    B = ROLL * np.hstack([TORQUE * model.B, np.zeros((n, 1)), model.B])
    C = np.vstack([model.C[:1], np.zeros((1, n)), model.C[:1]])
    return UncertainSystem(model.E, model.A, B, C, [[0, 0, 0], [0, 0, EFFORT], [0, NOISE, 0]])


def uncertain(percentage: float = SPREAD, damping: float = 0.0) -> UncertainSystem:
    """Roll with inertia and frequencies within +- so many percent, and the damping likewise."""
    J = ureal("J", ROLL, percentage=percentage)
    w = [ureal(f"w{k + 1}", value, percentage=percentage) for k, value in enumerate(FREQUENCIES)]
    return bending(J, w, ureal("zeta", DAMPING, percentage=damping) if damping else DAMPING)


def law(design: Any) -> StateSpace:
    """The controller of a design, or itself."""
    return design if isinstance(design, StateSpace) else design.controller


def pd() -> StateSpace:
    """-(kp + kd s) with roll-off, as of a rigid body."""
    kp, kd, w = BANDWIDTH**2, 2 * RATIO * BANDWIDTH, ROLL_OFF
    return system([-kd * w**2, -kp * w**2], [1, 2 * RATIO * w, w**2])


def full_order() -> Design:
    """The optimum for the nominal parameters."""
    return hinfsyn(uncertain().nominal, 1, 1)


def damped(damping: float = 0.7) -> Design:
    """The optimum for modes with this damping and twice the noise: no notch where a mode may not be."""
    G = bending(ROLL, FREQUENCIES, damping).nominal
    return hinfsyn(StateSpace(G.A, G.B * [1, 2, 1], G.C, G.D * [1, 2, 1], 0), 1, 1)


def fractional(percentage: float) -> StateSpace:
    """Roll as a linear fractional form in J and w1, w2 within +- so many percent; last input u / J, last output angle.

    v = W (1 + r b) eta, f = W (1 + r b) (v + 2 z eta'); J (1 + r a) theta'' + d eta'' = tau, eta'' + d' theta'' + f = 0
    """
    r, W, J, k = percentage / 100, FREQUENCIES, ROLL, len(FREQUENCIES)
    n, blocks = 1 + k, 1 + 2 * k
    M = np.eye(n)
    M[0, 0], M[0, 1:], M[1:, 0] = J, COUPLINGS, COUPLINGS
    force, changed, driven = np.zeros((n, 2 * n)), np.zeros((n, blocks)), np.zeros((n, 3))
    driven[0], changed[0, 0] = [J * TORQUE, 0, J], -1
    C, D = np.zeros((blocks + 3, 2 * n)), np.zeros((blocks + 3, blocks + 3))
    for i, w in enumerate(W):
        eta, rate, first, second = 1 + i, n + 1 + i, 1 + 2 * i, 2 + 2 * i
        force[eta, [eta, rate]] = -w * w, -2 * DAMPING * w
        changed[eta, [first, second]] = -w, -1
        C[first, eta] = r * w
        C[second, [eta, rate]], D[second, first] = (r * w * w, r * w * 2 * DAMPING), r * w
    moved = np.linalg.solve(M, np.hstack([force, changed, driven]))
    C[0], D[0] = r * J * moved[0, : 2 * n], r * J * moved[0, 2 * n :]
    C[[blocks, blocks + 2], 0] = 1
    D[blocks + 1, -1], D[blocks + 2, -2] = EFFORT, NOISE
    A = np.vstack([np.eye(2 * n)[n:], moved[:, : 2 * n]])
    return StateSpace(A, np.vstack([np.zeros((n, blocks + 3)), moved[:, 2 * n :]]), C, D, 0.0)


def structured() -> MuDesign:
    """By D-K iteration, which takes inertia and frequencies for complex numbers, over the box that this bears."""
    return musyn(fractional(SPREAD_OF_MU), 1, 1, BLOCKS, order=1)


def tuned(percentage: float = SPREAD, rounds: int = 4) -> StateSpace:
    """(b2 s^2 + b1 s + b0) / (s^2 + a1 s + a0) with the least gain in the worst of several points of the box.

    The points are corners and middle; where the proof of a round finds a worse one, it is added for the next. The
    search itself, on a grid of frequencies, proves nothing.
    """
    box = uncertain(percentage)
    names, parameters = list(box.parameters), box.parameters.values()
    points = [tuple(p.nominal for p in parameters), *itertools.product(*((p.low, p.high) for p in parameters))]
    x = np.log([0.3, 0.14 * 9, 0.01 * 9, 1.4 * 3, 9.0])  # PD with roll-off at 3 rad/s
    for _ in range(rounds):
        worst = _worst([box.at(dict(zip(names, point, strict=True))) for point in points])
        for method in ("BFGS", "Nelder-Mead") * 2 + ("BFGS",):
            found = minimize(worst, x, method=method, options={"maxiter": 150})
            x = found.x
        b2, b1, b0, a1, a0 = SIGNS * np.exp(x)
        K = system([b2, b1, b0], [1, a1, a0])
        answer = worst_gain(box, K, tol=1e-3)
        if answer.lower < found.fun * 1.002:
            break
        points.append(tuple(answer.parameters[name] for name in names))
    return K


def _worst(models: Sequence[StateSpace]) -> Callable[[np.ndarray], float]:
    """Largest gain over models of roll, of the logarithms of |b2, b1, b0, a1, a0|; 1000 and more if one is unstable."""
    s = 1j * np.concatenate([np.geomspace(0.02, 15, 500), [1e6]])
    G = np.array([_response(model, s) for model in models])
    A, B, C = (np.array([part(m) for m in models]) for part in (lambda m: m.A, lambda m: m.B[:, 2:], lambda m: m.C[2:]))
    loop = np.zeros((len(A), 8, 8))

    def worst(x: np.ndarray) -> float:
        b2, b1, b0, a1, a0 = SIGNS * np.exp(x)
        b1, b0 = b1 - b2 * a1, b0 - b2 * a0
        loop[:, :6, :6], loop[:, :6, 6:] = A + B * b2 @ C, B @ [[b0, b1]]
        loop[:, 7:, :6], loop[:, 6:, 6:] = C, [[0, 1], [-a0, -a1]]
        if (margin := np.linalg.eigvals(loop).real.max()) >= 0:
            return 1e3 * (1 + margin)
        K = b2 + (b1 * s + b0) / (s**2 + a1 * s + a0)
        g, k, S = np.abs(G) ** 2, np.abs(K) ** 2, np.abs(1 - G * K) ** -2
        size = S * (TORQUE**2 * g + NOISE**2 * g * k + EFFORT**2 * k * (TORQUE**2 * g + NOISE**2))  # Frobenius, squared
        det = (TORQUE * NOISE * EFFORT) ** 2 * g * k * S
        return float(np.sqrt((size + np.sqrt(np.maximum(size**2 - 4 * det, 0))).max() / 2))

    return worst


def _response(G: StateSpace, s: np.ndarray) -> np.ndarray:
    """From u / J to the angle at s (k,)."""
    poles = s[:, None, None] * np.eye(len(G.A)) - G.A
    return (G.C[2:] @ np.linalg.solve(poles, np.broadcast_to(G.B[:, 2:], (len(s), len(G.A), 1))))[:, 0, 0]


def designs(rounds: int = 4) -> dict[str, Any]:
    """All controllers of roll by their names; further methods join here. `rounds` as of `tuned`."""
    return {NOMINAL: full_order(), DAMPED: damped(), MU: structured(), TUNED: tuned(rounds=rounds), PD: pd()}
