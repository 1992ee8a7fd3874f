"""Study: a 3U CubeSat that points to nadir with three reaction wheels.

M. Pecorilla, F. Stesina, "Novel extended Kalman filter + H-infinity optimal output feedback control configuration for
small satellites with high pointing stability requirements", Int. J. Robust Nonlinear Control 34(5), 2024,
pp. 2991-3010, doi 10.1002/rnc.7119: tables 1, 3, 4, 5. The hardware of its table 2 is not in the text we have; those
numbers are ours, of parts typical for the class, and so are epoch, node and starting point of the orbit.

Readings. The rates of tables 3 and 5 are taken as w_OB, relative to the orbital frame, which eq. 11 has among the
states: table 3's +0.0011 rad/s in y is then a body almost at inertial rest. The mass of table 5 is drawn and
reported, but no torque modelled here depends on it, and the inertia is dispersed on its own. Moments dispersed
axis by axis, as table 5 has it, may violate the triangle inequality of real bodies; Euler's equation allows it.
"""

from collections.abc import Sequence
from datetime import datetime
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.linalg import expm

from plants.checks import real
from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.errors import ScenarioError
from plants.estimation import navigation
from plants.geometry import attitude
from plants.hardware import sensors
from plants.hardware.actuators import ReactionWheels
from plants.simulation import uncertain
from plants.simulation.linearize import LinearModel, linearize
from plants.simulation.programs import Program
from plants.simulation.uncertain import UncertainModel
from plants.surroundings import forces, orbit
from plants.surroundings.disturbances import Disturbance, Drag, GravityGradient, ResidualDipole, SolarPressure
from plants.surroundings.environment import CircularEnvironment, Environment, sun_position

DEG = np.pi / 180


class Requirements(NamedTuple):
    """Bounds on the extrinsic indices at 95 % confidence, temporal interpretation."""

    ape: float  # () rad, absolute performance error
    control_error: float  # () rad
    ake: float  # () rad, absolute knowledge error
    pse: float  # () rad within `pse_interval`, performance stability error
    pse_interval: float  # () s


class Weights(NamedTuple):
    """Constant weights of the tracking problem (eq. 23), in the units of the channel they scale."""

    act: np.ndarray  # (3, 3) control torque
    proc: np.ndarray  # (3, 3) process noise
    dist: np.ndarray  # (6, 6) sensor noise
    err: np.ndarray  # (6, 6) error
    ref: np.ndarray  # (6, 6) reference


class Dispersion(NamedTuple):
    """One draw of table 5."""

    inertia: np.ndarray  # (3,) kg m^2, principal moments
    mass: float  # () kg
    angles: np.ndarray  # (3,) rad, roll, pitch, yaw of q_OB
    rates: np.ndarray  # (3,) rad/s, w_OB
    raan: float  # () rad, uniform on the circle; not in table 5, for studies that vary the orbit too


REQUIREMENTS = Requirements(0.65 * DEG, 0.31 * DEG, 0.31 * DEG, 0.12 * DEG, 1.0)  # table 1
WEIGHTS = Weights(  # table 4
    act=1e-2 * np.eye(3),
    proc=2.5e-4 * np.diag([1.2, 1.2, 0.25]),
    dist=5e-2 * np.eye(6),
    err=1e-5 * np.diag([1, 1, 1, 0.1, 0.1, 0.1]),
    ref=2e-2 * np.diag([1, 1, 1, 0.1, 0.1, 0.1]),
)
MPC_STATE_WEIGHT, MPC_INPUT_WEIGHT = 1000.0, 1000.0  # ()  table 3: Q, R as multiples of the identity
MPC_HORIZON, MPC_MOVES = 10, 7  # ()  table 3: Np, Nc

CONTROL_PERIOD = 0.5  # () s, table 3
SAMPLES = 5  # ()  sensor samples per control period, table 3: 0.1 s
ALTITUDE = 470e3  # () m, table 3
INCLINATION = 51.6 * DEG  # () rad, table 3
ANGLES = np.array([-15.0, 25.0, 10.0]) * DEG  # (3,) rad, table 3: roll, pitch, yaw of q_OB at the start
RATES = np.array([0.0, 0.0011, 0.0])  # (3,) rad/s, table 3: w_OB at the start
INERTIA = np.array([0.0546, 0.0546, 0.0074])  # (3,) kg m^2, table 5
MOMENTS = ("Ix", "Iy", "Iz")  # names of the same as uncertain parameters
MASS = 4.548  # () kg, table 5

EPOCH = datetime(2024, 3, 20, 9, 0, 0)  # UTC, ours
RAAN = 2.0  # () rad, ours
ARGUMENT_OF_LATITUDE = np.pi  # () rad, ours: descending node; the next 1000 s lie in sunlight
MPC_RATE_LIMIT = 0.1  # () rad/s, ours, a soft limit
SIZE = np.array([0.1, 0.1, 0.34])  # (3,) m, of a 3U CubeSat with its rails
MASS_CENTRE = np.array([0.005, 0.005, 0.020])  # (3,) m, from the centre of the box, ours
DRAG_COEFFICIENT, REFLECTION_COEFFICIENT = 2.2, 1.3  # ()  ours
DIPOLE = np.array([5e-3, 5e-3, 5e-3])  # (3,) A m^2, residual, ours
WHEEL_AXES = np.eye(3)  # (3, 3) ours
WHEEL_INERTIA = np.full(3, 10.8e-3 / 628)  # (3,) kg m^2: 10.8 mN m s at full speed, ours
WHEEL_TORQUE, WHEEL_SPEED = 1e-3, 628.0  # () N m, () rad/s, ours
SUN_NOISE = 0.3 * DEG  # () rad per axis, 1 sigma, ours
MAGNETOMETER_NOISE = 120e-9  # () T per axis, 1 sigma, ours
GYRO_NOISE = 0.03 * DEG  # () rad/s per axis at 10 Hz, 1 sigma, ours
GYRO_BIAS = np.array([0.02, -0.015, 0.01]) * DEG  # (3,) rad/s, ours
GYRO_BIAS_WALK = 1e-5 * DEG  # () rad/s/sqrt(s), ours
WINDOW = 5  # ()  samples of the smoothing filter, ours
EKF_ATTITUDE_NOISE = 0.0025  # ()  vector part of a quaternion, ours
EKF_TORQUE_NOISE = 3e-7  # () N m sqrt(s), ours
EKF_NOISE = {"torque_noise": EKF_TORQUE_NOISE, "bias_walk": GYRO_BIAS_WALK}


def disturbances() -> tuple[Disturbance, ...]:
    """Gravity gradient, residual dipole, drag and solar pressure."""
    return (
        GravityGradient(),
        ResidualDipole.create(DIPOLE),
        Drag.create(SIZE, MASS_CENTRE, DRAG_COEFFICIENT),
        SolarPressure.create(SIZE, MASS_CENTRE, REFLECTION_COEFFICIENT),
    )


def body(moments: ArrayLike = INERTIA, *, disturbed: bool = True) -> RigidBody:
    """The spacecraft with its wheels, principal moments (3,) kg m^2; undisturbed for the model of a filter."""
    return RigidBody.create(
        np.diag(np.asarray(moments, float)),
        wheel_axes=WHEEL_AXES,
        wheel_inertia=WHEEL_INERTIA,
        disturbances=disturbances() if disturbed else (),
        physical=False,
    )


def wheels() -> ReactionWheels:
    """The three wheels with their limits."""
    return ReactionWheels.create(WHEEL_AXES, torque_limit=WHEEL_TORQUE, speed_limit=WHEEL_SPEED)


def suite() -> sensors.AttitudeSuite:
    """Sun sensor, magnetometer and gyro."""
    return sensors.attitude_suite(
        sun_noise=SUN_NOISE,
        magnetometer_noise=MAGNETOMETER_NOISE,
        gyro_noise=GYRO_NOISE,
        gyro_bias=GYRO_BIAS,
        gyro_bias_walk=GYRO_BIAS_WALK,
    )


def ekf() -> navigation.Ekf:
    """The extended Kalman filter of the paper, eq. 8 and figure 3, started from zeros, for the nominal inertia.

    A moving average before Wahba's problem, whose solution counts the same whatever the angle between Sun and field.
    """
    return navigation.ekf(*_believed(), attitude_noise=EKF_ATTITUDE_NOISE, window=WINDOW, **EKF_NOISE)


def consistent_ekf() -> navigation.Ekf:
    """Ours: `ekf` without the moving average, and with the covariance of the solution of Wahba's problem."""
    return navigation.ekf(*_believed(), attitude_noise=None, window=1, **EKF_NOISE)


def direct_ekf() -> navigation.Ekf:
    """Ours: corrected by the Sun and field vectors themselves, of which the field remains in eclipse."""
    return navigation.direct_ekf(*_believed(), **EKF_NOISE)


def _believed() -> tuple[RigidBody, sensors.AttitudeSuite]:
    """What the filters know of the spacecraft and of its sensors."""
    return body(disturbed=False), suite()


def svd() -> navigation.SvdNavigator:
    """The deterministic attitude of section 2.2."""
    return navigation.svd_navigator(suite(), window=WINDOW)


def environment(
    duration: float,
    *,
    raan: ArrayLike = RAAN,
    argument_of_latitude: ArrayLike = ARGUMENT_OF_LATITUDE,
    step: float = 10.0,
    moved_by: Sequence[orbit.Force] = (orbit.Oblateness(),),
) -> Environment:
    """Surroundings along an orbit of the study for `duration` s; several nodes (...) rad give a batch.

    What moves the orbit besides a spherical Earth is in `moved_by`: all of figure 6 are `perturbations`.
    """
    start = orbit.circular(ALTITUDE, INCLINATION, raan, argument_of_latitude)
    return Environment.along(start, EPOCH, duration, step=step, forces=moved_by)


def perturbations() -> tuple[orbit.Force, ...]:
    """What moves the orbit in figure 6: the Earth's shape, Moon, Sun, drag and solar pressure.

    Both pressures on the mean area of the box over all attitudes, a quarter of its surface (Cauchy).
    """
    x, y, z = SIZE
    area = (x * y + y * z + z * x) / 2
    return (
        forces.EarthShape(),
        forces.MoonGravity(),
        forces.SunGravity(),
        forces.DragForce.create(DRAG_COEFFICIENT * area / MASS),
        forces.PressureForce.create(REFLECTION_COEFFICIENT * area / MASS),
    )


def noon(raan: ArrayLike, duration: float) -> np.ndarray:
    """Argument of latitude (...) rad from which an arc of `duration` s is centred on the orbit's noon.

    Parameters
    ----------
    raan : (...) rad, right ascension of the ascending node
    """
    node, sun = np.asarray(raan, float), sun_position(EPOCH, np.zeros(1))[0]
    along = sun[0] * np.cos(node) + sun[1] * np.sin(node)
    across = (sun[1] * np.cos(node) - sun[0] * np.sin(node)) * np.cos(INCLINATION) + sun[2] * np.sin(INCLINATION)
    radius = orbit.EARTH_RADIUS + ALTITUDE
    return np.arctan2(across, along) - np.sqrt(orbit.MU / radius**3) * duration / 2


def initial_state(surroundings: Environment, angles: ArrayLike = ANGLES, rates: ArrayLike = RATES) -> BodyState:
    """State at t = 0 with wheels at rest, NumPy.

    Parameters
    ----------
    surroundings : gives the orbital frame at t = 0; one, not a batch
    angles : (3,) rad, roll, pitch, yaw of q_OB; table 3 by default
    rates : (3,) rad/s, w_OB; table 3 by default

    Raises
    ------
    ScenarioError
        Wrong shapes or NaN.
    """
    return _state_at_start(surroundings, real("angles", angles, (3,)), real("rates", rates, (3,)), np.zeros(3))


def disperse(seed: int, index: int) -> Dispersion:
    """Run `index` of the Monte Carlo of table 5, uniform within its bounds.

    Every run has its own stream (SeedSequence of the seed, spawned by the index), so a run is the same whatever
    the number of runs and the size of a batch.
    """
    for name, value in (("seed", seed), ("index", index)):
        if not isinstance(value, int | np.integer) or value < 0:
            raise ScenarioError(f"{name} must be a whole number of at least 0, got {value!r}")
    draw = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Dispersion(
        inertia=INERTIA * draw.uniform(0.9, 1.1, 3),
        mass=MASS + draw.uniform(-1, 1),
        angles=draw.uniform(-25, 25, 3) * DEG,
        rates=draw.uniform(-0.3, 0.3, 3) * DEG,
        raan=draw.uniform(0, 2 * np.pi),
    )


def continuous_model() -> LinearModel:
    """Equation 12: nadir attitude on a circular orbit, gravity gradient, input the torque on the body.

    The wheels are at rest and their rotors count as part of the body. In truth a rotor does not resist a turn
    about its own axis, which makes B larger by Js / I: 0.03 % in x and y, 0.23 % in z.
    """
    surroundings = CircularEnvironment.along(orbit.circular(ALTITUDE, INCLINATION, RAAN, ARGUMENT_OF_LATITUDE))
    plant = RigidBody.create(np.diag(INERTIA), disturbances=(GravityGradient(),))
    x = _state_at_start(surroundings, np.zeros(3), np.zeros(3), np.zeros(0))
    return linearize(plant, x, np.zeros(3), surroundings)


def wheeled_model(moments: ArrayLike) -> LinearModel:
    """`continuous_model` of the body that flies, with wheels at rest: the input is the torque of the motors (3,) N m.

    Gravity gradient alone: what else acts at nadir is small, and the faces of the box give drag and light no slope.
    """
    surroundings, x = _at_nadir()
    return linearize(_wheeled(real("moments", moments, (3,))), x, np.zeros(3), surroundings, hold=("wheels",))


def uncertain_model(within: float = 0.1) -> UncertainModel:
    """`wheeled_model` over all moments of inertia, the parameters `MOMENTS`, within that part of each.

    Exact: Euler's equation and the gravity gradient are of first order in the moments.
    """
    surroundings, x = _at_nadir()
    moments: dict[str, float] = dict(zip(MOMENTS, INERTIA.tolist(), strict=True))
    return uncertain.uncertain_model(_wheeled, moments, x, np.zeros(3), surroundings, within=within, hold=("wheels",))


def _at_nadir() -> tuple[CircularEnvironment, BodyState]:
    surroundings = CircularEnvironment.along(orbit.circular(ALTITUDE, INCLINATION, RAAN, ARGUMENT_OF_LATITUDE))
    return surroundings, _state_at_start(surroundings, np.zeros(3), np.zeros(3), np.zeros(3))


def _wheeled(moments: Any) -> RigidBody:
    wheels = {"wheel_axes": WHEEL_AXES, "wheel_inertia": WHEEL_INERTIA}
    return RigidBody.create(moments, disturbances=(GravityGradient(),), physical=False, **wheels)


def linear_model(dt: float = CONTROL_PERIOD) -> LinearModel:
    """`continuous_model` under zero-order hold of dt s, exactly: (Ad, Bd, Cd, Dd). Equations 13 to 15."""
    if not dt > 0:
        raise ScenarioError(f"dt must be positive, got {dt} s")
    A, B, C, D = continuous_model()
    n, m = B.shape
    block = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * dt)
    return LinearModel(block[:n, :n], block[:n, n:], C, D)


def _state_at_start(surroundings: Any, angles: np.ndarray, rates: np.ndarray, speeds: np.ndarray) -> BodyState:
    """State at t = 0 from q_OB as Euler angles, w_OB and wheel speeds."""
    with jax.enable_x64(True):
        x = _place(surroundings, angles, rates, speeds)
    return BodyState(*(np.asarray(part) for part in x))


@Program
def _place(surroundings: Any, angles: Array, rates: Array, speeds: Array) -> BodyState:
    return state_from(attitude.from_euler(angles), rates, speeds, surroundings.at(0.0))
