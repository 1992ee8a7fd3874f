"""What the study flies: the whole satellite with wheels, star tracker, gyro, filter, and panels on all axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np
from flexible_designs import (
    COUPLINGS,
    DAMPING,
    FREQUENCIES,
    ROLL,
    SPREAD,
    SPREAD_OF_DAMPING,
    bending,
    law,
    pd,
)
from scipy.linalg import block_diag

from plants import (
    ARCSEC,
    DEG_PER_SQRT_H,
    Appendage,
    Campaign,
    ConstantTorque,
    IntegratingGyro,
    Loop,
    Run,
    Scenario,
    Spacecraft,
    StarTracker,
    Wheel,
    circular,
    equip,
    spacecraft,
    study,
)
from synth import LinearController, StateSpace, c2d

DEG = np.pi / 180
PITCH, YAW = 420.0, 560.0  # kg m^2
TORSION, IN_PLANE = (3.5, 2.0), (2.5, 8.0)  # rad/s and sqrt(kg) m of the modes of pitch and yaw
ROTOR = 0.05  # kg m^2 of a wheel
WHEELS = [Wheel.create(axis, max_torque=0.4, inertia=ROTOR, max_speed=400.0) for axis in np.eye(3)]
LEAK = np.array([2e-3, -1e-3, 1e-3])  # N m
PERIOD, STEPS = 0.05, 2  # s, and Runge-Kutta steps in it
DURATION, STEADY = 300.0, 200.0  # s, of a flight, and where every sound loop is steady
STATES = 20  # of a controller of all axes at most
QUIET = 0.005  # deg rms of roll about its mean, ten times the noise: beyond it the panels swing


class Case(NamedTuple):
    """What differs from flight to flight."""

    inertia: Any  # () kg m^2, of roll
    frequencies: Any  # (2,) rad/s, of bending
    damping: Any  # () of all modes
    angles: Any  # (3,) rad, at the start


class Shared(NamedTuple):
    """What the flights of one controller have in common."""

    controller: LinearController
    craft: Spacecraft
    environment: Any
    duration: float  # s


class Outcome(NamedTuple):
    """What is kept of every flight, from `STEADY` on; inf where it failed."""

    error: Any  # () deg, rms of roll about its mean
    largest: Any  # () deg
    bending: Any  # () sqrt(kg) m, rms of the first mode
    torque: Any  # () N m, rms about roll


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    designs: dict[str, Any] = field(default_factory=dict)
    optimum: Any = None  # `synth.Certificate` of the nominal optimum
    margins: dict[str, Any] = field(default_factory=dict)  # `synth.WorstCase` of the stability of each
    gains: dict[str, dict[float, Any]] = field(default_factory=dict)  # and of its gain, by percent
    whole: dict[str, Any] = field(default_factory=dict)  # gain over `SPREAD` with uncertain damping
    along: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)  # gain along one parameter, by controller
    campaigns: dict[str, Campaign] = field(default_factory=dict)

    def outcome(self, name: str) -> Outcome:
        """Of all flights of a controller."""
        return Outcome(*self.campaigns[name].results)

    def quiet(self, name: str) -> np.ndarray:
        """Which of its flights are quiet."""
        return np.asarray(self.outcome(name).error) < QUIET

    def stable(self, name: str) -> np.ndarray:
        """Which of them should be, by the poles of the linear loop at the parameters drawn."""
        drawn, K = self.campaigns[name].dispersed, law(self.designs[name])
        numbers = zip(drawn.inertia, drawn.frequencies, drawn.damping, strict=True)
        poles = [bending(float(J), w, float(z)).close(K).nominal.poles() for J, w, z in numbers]
        return np.array([np.max(np.real(p)) < 0 for p in poles])


def panels(frequencies: Any = FREQUENCIES, damping: Any = DAMPING) -> list[Appendage]:
    """Two panels along y: bending turns the hub about roll, torsion about pitch, in-plane bending about yaw."""
    roll = Appendage.create(frequencies, couplings=np.outer([1, 0, 0], COUPLINGS), damping=damping)
    rest = np.array([[0, 0], [TORSION[1], 0], [0, IN_PLANE[1]]])
    return [roll, Appendage.create([TORSION[0], IN_PLANE[0]], couplings=rest, damping=damping)]


def satellite() -> Spacecraft:
    """The nominal one, with its orbit, sensors and filter."""
    return spacecraft(
        name="A flexible satellite",
        inertia=np.array([ROLL, PITCH, YAW]) + ROTOR,
        wheels=WHEELS,
        appendages=panels(),
        sensors=[
            StarTracker.create(cross_noise=8 * ARCSEC, boresight=[0.0, 0.8, -0.6], period=0.5),
            IntegratingGyro.create(random_walk=0.005 * DEG_PER_SQRT_H, turn_on_bias=np.radians(0.0005)),
        ],
        orbit=circular(600e3, np.radians(97.8), raan=1.0),
        epoch=datetime(2026, 3, 20),
        disturbances=[ConstantTorque.create(LEAK)],
        dt=PERIOD,
    )


def three_axes(roll: Any) -> LinearController:
    """A controller of roll, from the angle to u / J, with PD about pitch and yaw; held for `PERIOD` (Tustin)."""
    laws = [law(roll), pd(), pd()]
    A, B, C, D = (np.asarray(block_diag(*(getattr(K, name) for K in laws))) for name in "ABCD")
    angles, moments = -2 * np.eye(3, 6), np.diag([ROLL, PITCH, YAW])  # the error is that of [q; w]
    K = StateSpace(A, B @ angles, moments @ C, moments @ D @ angles, 0)
    return LinearController.of(c2d(K, PERIOD, "tustin")).padded(STATES)


def drawn(seed: int, index: int) -> Case:
    """Inertia, frequencies and damping from the box of the proof; run 0 is nominal."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    far = rng.uniform(-1, 1, 4) * (index > 0)
    scale = 1 + SPREAD / 100 * far[:3]
    angles = rng.uniform(-1, 1, 3) * DEG
    damping = np.array(DAMPING * (1 + SPREAD_OF_DAMPING / 100 * far[3]))
    return Case(ROLL * scale[0], np.multiply(FREQUENCIES, scale[1:]), damping, angles)


def case(one: Case, shared: Shared) -> tuple[Loop, Scenario]:
    """One flight as the simulator takes it."""
    craft = shared.craft
    plant, _ = equip(
        np.array([one.inertia, PITCH, YAW]) + ROTOR,
        wheels=WHEELS,
        appendages=panels(one.frequencies, one.damping),
        disturbances=craft.plant.body.disturbances,
    )
    loop = replace(craft.loop(shared.controller), plant=plant)
    return loop, craft.scenario(shared.duration, environment=shared.environment, angles=one.angles, steps=STEPS)


def outcome(run: Run) -> Outcome:
    """Of one flight."""
    late = run.time >= STEADY
    if not run.ok or not late.any():
        return Outcome(*(np.array(np.inf),) * 4)
    roll, bending = 2 * run.outputs[late, 0] / DEG, run.states.modes[late, 0]
    torque = run.inputs[late, 0]
    return Outcome(_rms(roll - roll.mean()), np.abs(roll).max(), _rms(bending), _rms(torque))


def configurations(designs: Mapping[str, Any], duration: float) -> dict[str, Shared]:
    """The controllers on one orbit."""
    craft = satellite()
    around = craft.environment(duration)
    return {name: Shared(three_axes(K), craft, around, duration) for name, K in designs.items()}


def _rms(values: np.ndarray) -> np.ndarray:
    """Root of the mean square."""
    return np.sqrt(np.mean(values**2))
