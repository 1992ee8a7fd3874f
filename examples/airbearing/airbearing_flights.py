"""What flies in the air-bearing study: the configurations, the cases, one run, what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from plants import Campaign, Loop, Run, Scenario, airbearing, blocks, study
from plants.missions.airbearing import (
    DEG,
    INERTIA,
    LARGE_ROLLS,
    PERIOD,
    SMALL,
    TARGET,
    TORQUE_LIMITS,
    Case,
    Outcome,
    Q,
    R,
)
from synth import EulerModel, SdreSampled, lqr, lqrd, state_feedback

LQR, SDRE, NAIVE = "LQR", "SDRE", "LQR, continuous gain held"
EXACT = "LQR gain on E^-1"  # of the error in Euler angles: the opponent that mends the kinematics alone
DIFFERENCE, NO_RATE = "SDRE, angles and their differences", "SDRE, angles alone"
FILTER, FILTER_ANGLES = "SDRE, Kalman filter", "SDRE, Kalman filter of angles alone"
LAWS = (LQR, SDRE, EXACT)
DURATION = 200.0  # s
LARGE = [np.array([roll * DEG, TARGET[1], TARGET[2]]) for roll in LARGE_ROLLS if roll * DEG != TARGET[0]]
NOISY = len(TORQUE_LIMITS) + len(LARGE)  # index of the first run with noise
STEPS = {"small": SMALL, "of the paper": TARGET, "large": LARGE[-1]}  # slews whose noise is compared


@dataclass(frozen=True, kw_only=True)
class ExactKinematics:
    """u = -K [E(angles)^-1 (angles - target); w]: constant gains on the error as a turn of the body.

    E^-1 = [[1, 0, -s2], [0, c1, s1 c2], [0, -s1, c1 c2]] exists at every attitude, also where E does not.
    """

    gain: Any  # (3, 6) N m/rad and N m s/rad
    target: Any  # (3,) rad
    dt: float  # s

    def init(self) -> np.ndarray:
        """Nothing to remember."""
        return np.zeros(0)

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """(state, y, r) -> (state, u), u (3,) N m on the body."""
        return state, -self.gain @ jnp.concatenate([inverse(y[:3]) @ (y[:3] - self.target), y[3:6]])


def inverse(angles: Any) -> Any:
    """E(angles)^-1, (3, 3)."""
    (s1, s2, _), (c1, c2, _) = jnp.sin(angles), jnp.cos(angles)
    one, o = jnp.ones_like(s1), jnp.zeros_like(s1)
    rows = [[one, o, -s2], [o, c1, s1 * c2], [o, -s1, c1 * c2]]
    return jnp.stack([jnp.stack(row) for row in rows])


class Shared(NamedTuple):
    """What the runs of one configuration have in common."""

    gain: Any  # (3, 9) of a fixed law, or None for the SDRE of the run's target
    navigator: Any
    duration: float  # s
    exact: bool = False  # the gain acts on E^-1 (angles - target)


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    campaigns: dict[str, Campaign] = field(default_factory=dict)
    dispersed: dict[str, Campaign] = field(default_factory=dict)  # with noise and another inertia in each run
    margins: dict[str, dict[float, Any]] = field(default_factory=dict)  # see `airbearing_margins.everywhere`
    steps: dict[str, Campaign] = field(default_factory=dict)  # SDRE to each of `STEPS`: a run without noise, then with

    def one(self, name: str, index: int = 0) -> Outcome:
        """One run of a configuration."""
        return Outcome(*(values[index] for values in self.campaigns[name].results))

    def noisy(self, name: str) -> Outcome:
        """Its runs with noise."""
        if not len(self.campaigns[name].index[NOISY:]):
            raise IndexError(f"noise of {name}")
        return Outcome(*(values[NOISY:] for values in self.campaigns[name].results))

    def run(self, name: str, index: int = 0) -> Run:
        """The trajectory of one run."""
        return self.campaigns[name].kept[index]

    def fate(self, name: str, index: int) -> str:
        """When the last angle has settled, or why it has not."""
        flown, o = self.campaigns[name], self.one(name, index)
        if not flown.ok[index]:
            reason = "pitch at 90 deg" if flown.culprit[index] == "plant" else flown.culprit[index]
            return f"fails at {flown.failed_at[index]:.1f} s ({reason})"
        return f"{o.slowest:.1f} s" if np.isfinite(o.slowest) else "does not settle"


def linear(angles: Any = (0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """A and B at rest, (6, 6) and (6, 3)."""
    with jax.enable_x64(True):
        model = EulerModel.create(INERTIA, angles)
        _, A, B = model.factorise(jnp.asarray(model.target()), 1.0)
        return np.asarray(A), np.asarray(B)


def configurations(duration: float) -> dict[str, Shared]:
    """Everything that is flown; the LQR is that of angles zero."""
    A, B = linear()
    wheels = np.zeros((3, 3))  # no feedback of the wheels' momentum
    sampled, held = np.hstack([lqrd(A, B, Q, R, PERIOD)[0], wheels]), np.hstack([lqr(A, B, Q, R)[0], wheels])
    raw, filtered = airbearing.raw, airbearing.filtered
    return {
        LQR: Shared(sampled, raw(), duration),
        SDRE: Shared(None, raw(), duration),
        EXACT: Shared(sampled, raw(), duration, exact=True),
        DIFFERENCE: Shared(None, raw(measured=0.0, differenced=1.0), duration),
        NO_RATE: Shared(None, raw(measured=0.0), duration),
        FILTER: Shared(None, filtered(rates=True), duration),
        FILTER_ANGLES: Shared(None, filtered(rates=False), duration),
        NAIVE: Shared(held, raw(), duration),
    }


def cases(runs: int, seed: int) -> Case:
    """The manoeuvre with each torque limit, the larger ones, and `runs` times the manoeuvre with noise."""
    return blocks.join([
        *(airbearing.case(torque_limit=limit) for limit in TORQUE_LIMITS),
        *(airbearing.case(target) for target in LARGE),
        *(airbearing.case(noise=1.0, seed=seed + index) for index in range(runs)),
    ])  # fmt: skip


def case(one: Case, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    if shared.gain is None:
        controller: Any = SdreSampled.create(EulerModel.create(INERTIA, one.target), PERIOD, Q=Q, R=R)
    elif shared.exact:
        controller = ExactKinematics(gain=shared.gain[:, :6], target=one.target, dt=PERIOD)
    else:
        controller = state_feedback(shared.gain, PERIOD)
    return airbearing.manoeuvre(one, controller, shared.navigator, duration=shared.duration)
