"""The loop of a plant and an exported controller, simulated from displaced states: what the gate looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synth.analysis.norms import spectral_radius
from synth.regulators.fixed import FixedController
from synth.regulators.sequential import SequentialController
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

RETURNED = 1e-2  # of the linear response's peak
TIME_CONSTANTS = 20  # of the slowest pole of the linear loop, that a response is given to return
LONGEST = 20_000  # samples of a simulation
COMMANDED = 1e-12  # a start whose commands stay below this part of the largest demands nothing


@dataclass(frozen=True)
class Response:
    """A simulated loop without exogenous inputs."""

    y: np.ndarray  # (samples, p)
    v: np.ndarray  # (samples, m) commands, after their limits

    def peaks(self) -> np.ndarray:
        """Largest value of every measurement and command, (p + m,)."""
        return np.abs(np.hstack([self.y, self.v])).max(axis=0)

    def returned(self, peaks: np.ndarray) -> bool:
        """Whether the last twentieth stays below 1 % of the peaks of the linear loop."""
        return self.left(peaks) <= RETURNED

    def left(self, peaks: np.ndarray) -> float:
        """The largest part of the linear loop's peaks in the last twentieth; inf where a signal ran away."""
        tail = max(len(self.y) // TIME_CONSTANTS, 1)
        found = Response(self.y[-tail:], self.v[-tail:]).peaks()
        if not np.isfinite(found).all():
            return np.inf
        return float((found[found > 0] / np.where(peaks > 0, peaks, np.nextafter(0, 1))[found > 0]).max(initial=0.0))


def simulate(
    G: StateSpace, controller: SequentialController | FixedController, start: np.ndarray, samples: int
) -> Response:
    """The loop of a plant (float64, without direct term) and a controller stepped as the exported C steps it."""
    x, state = start, controller.init()
    y, v = np.empty((samples, G.ny)), np.empty((samples, G.nu))
    with np.errstate(over="ignore", invalid="ignore"):  # a response that grows without bound has not returned
        for k in range(samples):
            y[k] = G.C @ x
            state, v[k] = controller.update(state, y[k])
            x = G.A @ x + G.B @ v[k]
    return Response(y, v)


def horizon(P: GeneralizedPlant, K: StateSpace) -> tuple[int, bool]:
    """Samples of a stable loop to simulate, and whether they cover the time constants that a response is given."""
    radius = spectral_radius(P.close(K).A)
    needed = TIME_CONSTANTS / -np.log(radius) if radius > 0 else 1
    return int(min(max(np.ceil(needed), 50), LONGEST)), needed <= LONGEST


def short(samples: int) -> str:
    """What is said of a simulation that was cut off."""
    return f"; only {samples} samples simulated, fewer than {TIME_CONSTANTS} time constants"


def starts(G: StateSpace, K: StateSpace, limits: np.ndarray) -> np.ndarray:
    """Plant states (any, n) to start from, one displaced at a time: those that the controller answers.

    Each is scaled so that the linear loop's largest command, over its limit, is one.
    """
    A = np.block([[G.A + G.B @ K.D @ G.C, G.B @ K.C], [K.B @ G.C, K.A]])
    C, X = np.hstack([K.D @ G.C, K.C]) / limits[:, None], np.eye(G.n + K.n)[:, : G.n]
    largest = np.zeros(G.n)
    for _ in range(LONGEST):
        largest = np.maximum(largest, np.abs(C @ X).max(axis=0))
        X = A @ X
        if np.abs(C @ X).max(initial=0.0) <= COMMANDED * largest.max(initial=0.0) and np.abs(X).max(initial=0.0) < 1:
            break
    answered = largest > COMMANDED * largest.max(initial=0.0)
    return np.diag(1 / np.where(answered, largest, np.inf))[answered]
