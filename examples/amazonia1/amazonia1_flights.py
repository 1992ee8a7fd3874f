"""What flies in the Amazonia-1 studies: the controllers, their starts, one run, the Monte Carlo, what is kept of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from plants import Campaign, Loop, Paired, Scenario, amazonia1, paired, study
from plants.missions.amazonia1 import DEG, PERIOD, Outcome, Start
from synth import (
    MrpModel,
    QuaternionModel,
    Sdre,
    SdreHinf,
    SdreHinfPaperLiteral,
    SdreHinfStatic,
    quaternion_lqr,
    quaternion_pd,
    quaternion_pid,
)
from synth.regulators.quaternion import QuaternionPid

SDRE, MRP, LQR, SHORT, PD, PID = "SDRE", "SDRE, MRP", "LQR", "LQR, short way", "PD", "PID"
LITERAL, STATIC, DYNAMIC = "SDRE + Hinf, as published", "SDRE + Hinf, static", "SDRE + Hinf, dynamic"
READINGS = (LITERAL, STATIC, DYNAMIC)  # of steps 5 and 6 of section 2.1
LINEAR = (LQR, SHORT, PD, PID)  # constant gains
PAPER = (SDRE, LITERAL)  # figure 3
NOMINAL = (SDRE, SHORT)  # flown once more with the nominal inertia
STEP = 0.5  # s, period by default; the paper's is a tenth, at which no verdict is another
PUSH = 1e-3  # N m about each axis, our test of disturbance rejection
AGAIN = 12  # starts that are flown with the paper's period, too
INTEGRAL_TIME = 120.0  # s, of the PID, ours
ROW = 1.0  # s between two rows that are kept


class Shared(NamedTuple):
    """What the runs of one controller have in common."""

    controller: Any  # its dt is the control period, s
    duration: float  # s


class Measured(NamedTuple):
    """What is kept of a run."""

    outcome: Outcome
    fallbacks: int  # samples in which no Riccati equation could be solved


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    duration: float  # s, of a flight
    period: float = PERIOD  # s, of control and integration
    campaigns: dict[str, Campaign] = field(default_factory=dict)
    nominal: dict[str, Campaign] = field(default_factory=dict)  # the same starts with the nominal inertia
    fine: dict[str, Campaign] = field(default_factory=dict)  # some of the starts with the paper's period
    levels: dict[str, np.ndarray] = field(default_factory=dict)  # see `amazonia1_pointwise.levels`

    def random(self, name: str) -> Outcome:
        """The runs of the Monte Carlo that have finished."""
        return _random(self.campaigns[name])[1]

    def pushed(self, name: str) -> float:
        """Angle that a constant torque leaves, deg."""
        flown = self.campaigns[name]
        return float(flown.results.outcome.angle[(flown.dispersed.torque != 0).any(axis=1)][0] / DEG)

    def behind(self, name: str) -> np.ndarray:
        """Which of its runs start with q0 < 0, (runs,)."""
        flown = self.campaigns[name]
        return flown.dispersed.q[_drawn(flown), 0] < 0

    def compared(
        self, first: str, second: str, part: str, *, ratio: bool = False, behind: bool | None = None
    ) -> Paired:
        """A `part` of the outcomes of two controllers over the runs that both have finished.

        Parameters
        ----------
        behind : only the runs that start with q0 < 0, or with `False` only the others
        """
        (i, a), (j, b) = _random(self.campaigns[first]), _random(self.campaigns[second])
        _, k, l = np.intersect1d(i, j, return_indices=True)
        if behind is not None:
            chosen = self.behind(first)[k] == behind
            k, l = k[chosen], l[chosen]
        if not len(k):
            raise IndexError(f"runs of both {first} and {second}")
        return paired(getattr(a, part)[k], getattr(b, part)[l], ratio=ratio)

    def moved(self, name: str) -> np.ndarray:
        """By how much the dispersed inertia moves the settling time of each run, (runs,) s."""
        return _apart(self.campaigns[name], self.nominal[name])

    def refined(self, name: str) -> np.ndarray:
        """By how much the paper's period moves it, (runs,) s."""
        return _apart(self.campaigns[name], self.fine[name])


def _apart(first: Campaign, second: Campaign) -> np.ndarray:
    """Distance of the settling times over the runs that both have finished, (runs,) s."""
    (i, a), (j, b) = _random(first), _random(second)
    _, k, l = np.intersect1d(i, j, return_indices=True)
    x, y = a.settling_time[k], b.settling_time[l]
    same = x == y  # also if neither has settled
    return np.where(same, 0.0, np.abs(np.where(same, 0.0, x) - np.where(same, 0.0, y)))


def _drawn(flown: Campaign) -> np.ndarray:
    """Which runs are of the Monte Carlo."""
    return (flown.dispersed.torque == 0).all(axis=1)


def _random(flown: Campaign) -> tuple[np.ndarray, Outcome]:
    """Indices and outcomes of the runs of the Monte Carlo."""
    drawn = _drawn(flown)
    return flown.index[drawn], Outcome(*(values[drawn] for values in flown.results.outcome))


def bandwidth(law: QuaternionPid) -> tuple[float, float]:
    """Natural frequency (rad/s) and damping ratio of a PD law on the nominal satellite: geometric mean of its poles."""
    inverse, O = np.linalg.inv(NET_INERTIA), np.zeros((3, 3))
    poles = np.linalg.eigvals(np.block([[O, np.eye(3) / 2], [-inverse @ law.Kp, -inverse @ law.Kd]]))
    frequency = np.exp(np.log(np.abs(poles)).mean())
    return float(frequency), float(-poles.real.mean() / frequency)


NET_INERTIA = amazonia1.INERTIA - np.diag(amazonia1.WHEEL_INERTIA)  # (3, 3) kg m^2, eq. 22: without the rotors' spin


def controllers(period: float = PERIOD) -> dict[str, Any]:
    """Q = 1 and R = 1 as the paper has it, for the nominal inertia; PD and PID have the LQR's mean bandwidth."""
    dt, gibbs = period, QuaternionModel.create(NET_INERTIA)  # eq. 26
    short = quaternion_lqr(NET_INERTIA, dt, short_way=True)
    wn, zeta = bandwidth(short)
    return {
        SDRE: Sdre.create(gibbs, dt),
        MRP: Sdre.create(MrpModel.create(NET_INERTIA), dt),
        LITERAL: SdreHinfPaperLiteral.create(gibbs, dt),
        STATIC: SdreHinfStatic.create(gibbs, dt),
        DYNAMIC: SdreHinf.create(gibbs, dt),
        LQR: quaternion_lqr(NET_INERTIA, dt),
        SHORT: short,
        PD: quaternion_pd(NET_INERTIA, wn, zeta, dt),
        PID: quaternion_pid(NET_INERTIA, wn, zeta, dt, integral_time=INTEGRAL_TIME),
    }


def starts(runs: int, seed: int) -> Start:
    """A run from rest under a constant torque, then the `runs` of the Monte Carlo."""
    drawn = amazonia1.monte_carlo(runs, seed)
    pushed = Start(np.diag(amazonia1.INERTIA), np.array([1.0, 0, 0, 0]), np.zeros(3), np.full(3, PUSH))
    return Start(*(np.concatenate([one[None], many]) for one, many in zip(pushed, drawn, strict=True)))


def case(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    period = shared.controller.dt
    return amazonia1.manoeuvre(
        start, shared.controller, duration=shared.duration, period=period, keep_every=round(ROW / period)
    )


def measure(run: Any) -> Measured:
    """Outcome and the controller's own count of Riccati equations without solution."""
    return Measured(amazonia1.outcome(run), int(getattr(run.memory, "failures", 0)))
