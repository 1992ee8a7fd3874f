"""Study: the three-axis satellite simulator of INPE's Space Mechanics and Control Division, a disk on an air bearing.

A paper on its attitude control by the SDRE method with a Kalman filter, in comparison with LQR [1]; numbers of its
section 4. Title, authors and equations 5 to 7, 13, 14, 16 and 17 are missing from the text we have.

Readings. Equation 5: 3-2-1 Euler angles, which do have a singularity at pitch +-90 deg. Equations 13 and 14: the
pseudo-linear form of `plants.dynamics.eulerbody`, the torque on the body u = -Iw dOm/dt as input,
x = [angles - target; w]. Equations 16 and 17: the usual Kalman filter with F = exp(A(x) T). LQR: the same at angles
zero, at rest. Angles only: the text does not say how it gets the rate; we fly the backward difference, no rate at all,
and the filter. The sampling time of 0.1 s, given for the filter, holds for the whole loop; gains are those of the
sampled regulator. "Mean values" of noise are taken as standard deviations, which agree with the covariances. Wheels
have no limits in the paper and start at rest. Performance is judged by the time to stay within 2 % of each step, and by
its overshoot.
"""

from typing import Any, NamedTuple

import numpy as np
from jax.typing import ArrayLike

from plants.checks import real, whole
from plants.dynamics.eulerbody import EulerBody, EulerState, RandomTorque, check_pitch
from plants.estimation.kalman import Kalman, RawAngles, kalman
from plants.hardware.actuators import ReactionWheels
from plants.hardware.sensors import AngleRateSuite
from plants.outcome.indices import step_response
from plants.simulation import uncertain
from plants.simulation.linearize import LinearModel, linearize
from plants.simulation.loop import Controller, Loop, Run, Scenario
from plants.simulation.uncertain import Driven, UncertainModel

DEG = np.pi / 180

INERTIA = np.diag([1.17, 1.17, 1.13])  # (3, 3) kg m^2, [1] section 4
PARAMETERS = ("Ix", "Iy", "Iz", "gx", "gy", "gz")  # names of its diagonal, and of the motors' gains
WHEEL_INERTIA = np.full(3, 0.0018)  # (3,) kg m^2, [1] section 4
TORQUE_NOISE = 1e-4  # () N m per axis, [1] section 4, Sw = 1e-8
ANGLE_NOISE = 0.2 * DEG  # () rad, [1] section 4, Sz = 0.04 deg^2
RATE_NOISE = 0.1 * DEG  # () rad/s, [1] section 4, Sz = 0.01 deg^2/s^2
Q = np.diag([1.0, 1, 1, 100, 100, 100])  # (6, 6) weight of the state, [1] section 4
R = 0.001 * np.eye(3)  # (3, 3) weight of the torque, [1] section 4
TARGET = np.array([50.0, 20, -30]) * DEG  # (3,) rad, [1] section 4, from zero
PERIOD = 0.1  # () s, [1] section 4
STEPS = 2  # Runge-Kutta steps per period, ours

TORQUE_LIMITS = (np.inf, 1.0, 0.2, 0.05)  # () N m per wheel, ours: is the comparison one of unlimited wheels?
INERTIA_SPREAD = 0.3  # () of each moment, ours: "not well determined" in [1] section 1
SMALL = TARGET / 10  # (3,) rad, ours: a slew beside which the noise is large
LARGE_ROLLS = (50, 70, 90, 100, 120, 150, 170)  # () deg of roll, with the target's pitch and yaw, ours
SETTLED = 0.02  # () of the step, ours
TAIL = 100.0  # () s, ours: from here on a run is taken as steady

BODY = EulerBody.create(INERTIA, wheel_inertia=WHEEL_INERTIA)
SENSORS = AngleRateSuite(angle_noise=ANGLE_NOISE, rate_noise=RATE_NOISE)


class Case(NamedTuple):
    """What differs between the runs of one controller, or many with a leading axis."""

    target: np.ndarray  # (..., 3) rad
    noise: np.ndarray  # (...) of the paper's noise, 1 for all of it and 0 for none
    torque_limit: np.ndarray  # (...) N m of each wheel
    seed: np.ndarray  # (...) of the process noise, a whole number
    moments: np.ndarray  # (..., 3) kg m^2, diagonal of the inertia; controllers and filters keep the nominal one


class Outcome(NamedTuple):
    """What is kept of a run; infinite where it failed."""

    settling: np.ndarray  # (3,) s, from which each angle stays within 2 % of its step; infinite if it does not
    overshoot: np.ndarray  # (3,) of the step
    error: np.ndarray  # (3,) rad, rms of the angles in steady state
    torque: np.ndarray  # () N m, rms over the axes in steady state
    peak: np.ndarray  # () N m, largest of the run on any axis

    @property
    def slowest(self) -> np.ndarray:
        """Settling time of the last angle, () s."""
        return self.settling.max(axis=-1)


def case(
    target: ArrayLike = TARGET,
    noise: float = 0.0,
    torque_limit: float = np.inf,
    seed: int = 0,
    moments: ArrayLike | None = None,
) -> Case:
    """One run, by default the paper's manoeuvre without noise and with its inertia."""
    return Case(
        real("target", target, (3,)),
        np.array(float(noise)),
        np.array(float(torque_limit)),
        np.array(int(seed)),
        np.diag(INERTIA) if moments is None else real("moments", moments, (3,)),
    )


def disperse(seed: int, index: int) -> Case:
    """The paper's manoeuvre with its noise and an inertia that is not well known; a stream of its own for every run."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    spread = rng.uniform(1 - INERTIA_SPREAD, 1 + INERTIA_SPREAD, 3)
    return case(noise=1.0, seed=seed + index, moments=np.diag(INERTIA) * spread)


def linear_model(p: ArrayLike, target: ArrayLike = TARGET) -> LinearModel:
    """Linear model at rest at a target: from the motors' torque (3,) N m to [angles; rad/s], (6,).

    Parameters
    ----------
    p : (6,) moments of inertia in kg m^2 and gains of the motors, 1 as they are told
    target : (3,) rad
    """
    return linearize(_driven(real("p", p, (6,))), _at_rest(target), np.zeros(3), _CALM, hold=("wheels",))


def uncertain_model(within: float = INERTIA_SPREAD, target: ArrayLike = TARGET) -> UncertainModel:
    """`linear_model` over moments and gains, the parameters `PARAMETERS`, within that part of each; exact."""
    nominal: dict[str, float] = dict(zip(PARAMETERS, [*np.diag(INERTIA).tolist(), 1.0, 1.0, 1.0], strict=True))
    return uncertain.uncertain_model(
        _driven, nominal, _at_rest(target), np.zeros(3), _CALM, within=within, hold=("wheels",)
    )


def _driven(p: Any) -> Driven:
    """The simulator with other moments, and with motors of other gains."""
    body = EulerBody.create(p[:3], wheel_inertia=WHEEL_INERTIA, physical=False)
    return Driven(plant=body, gains=p[3:], outputs=6)


def _at_rest(target: ArrayLike) -> EulerState:
    return EulerState(check_pitch("target", target), np.zeros(3), np.zeros(3))


_CALM = RandomTorque.create(0.0, period=1.0, duration=1.0, seed=0)


def raw(*, measured: float = 1.0, differenced: float = 0.0) -> RawAngles:
    """Measurements without a filter: all, or angles with their backward difference, or angles alone."""
    return RawAngles(body=BODY, measured=np.float64(measured), differenced=np.float64(differenced))


def filtered(*, rates: bool) -> Kalman:
    """The Kalman filter of angles and rates, or of angles alone; it starts as sure as one measurement."""
    return kalman(BODY, SENSORS, torque_noise=TORQUE_NOISE, rates=rates)


def manoeuvre(
    one: Case, controller: Controller, navigator: RawAngles | Kalman, *, duration: float
) -> tuple[Loop, Scenario]:
    """From rest at angles zero to rest at the target.

    Parameters
    ----------
    one : Case
    controller : y is `EulerBody.output`, its command the torque on the body (3,) N m; r is the target at rest
    navigator : `raw()` or `filtered()`
    duration : () s, a whole number of control periods

    Raises
    ------
    ScenarioError
        Unusable numbers; the message names them.
    SingularityError
        A target at or beyond pitch +-90 deg.
    """
    period = float(controller.dt)
    periods = whole("duration", duration, period, "control periods")
    noise = real("noise", one.noise, low=0)
    loop = Loop(
        plant=EulerBody.create(one.moments, wheel_inertia=WHEEL_INERTIA),
        controller=controller,
        sensors=AngleRateSuite(angle_noise=noise * ANGLE_NOISE, rate_noise=noise * RATE_NOISE),
        navigator=navigator,
        actuator=ReactionWheels.create(np.eye(3), torque_limit=one.torque_limit),
    )
    push = RandomTorque.create(noise * TORQUE_NOISE, period=period, duration=duration, seed=int(one.seed))
    return loop, Scenario(
        initial=EulerState(np.zeros(3), np.zeros(3), np.zeros(3)),
        dt=period,
        periods=periods,
        steps=STEPS,
        reference=np.concatenate([check_pitch("target", one.target), np.zeros(6)]),
        environment=push,
    )


def outcome(run: Run) -> Outcome:
    """What is kept of a run."""
    if not run.ok:
        worst = np.full(3, np.inf)
        return Outcome(worst, worst, worst, np.array(np.inf), np.array(np.inf))
    target, steady = run.references[0, :3], run.time >= TAIL - 1e-9
    settling, overshoot = step_response(run.time, run.outputs[:, :3], target, SETTLED)
    error = run.outputs[steady, :3] - target
    return Outcome(
        settling,
        overshoot,
        np.sqrt(np.mean(error**2, axis=0)),
        np.sqrt(np.mean(run.inputs[steady] ** 2)),
        np.array(np.abs(run.inputs).max()),
    )
