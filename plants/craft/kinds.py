"""The tables that a file of a spacecraft may have: what each is made into, and which units fit its arguments."""

from datetime import datetime
from typing import Any

import numpy as np

from plants.checks import positive, real, unit
from plants.craft.comparison import Dispersion
from plants.craft.spacecraft import Spacecraft, spacecraft
from plants.craft.tables import (
    ANGLE,
    ANGLE_WALK,
    FIELD,
    FORCE,
    LENGTH,
    MOMENTUM,
    PER_CENT,
    RATE,
    RATE_WALK,
    SPIN,
    SWING,
    TORQUE,
    Kind,
)  # fmt: skip
from plants.dynamics.appendages import Appendage
from plants.dynamics.cmgs import Cmgs
from plants.dynamics.rigidbody import RigidBody
from plants.errors import ScenarioError
from plants.guidance.magnetic import CrossProductDumping
from plants.hardware.attitudethrusters import AttitudeThrusters, Pwm, Pwpf, Schmitt
from plants.hardware.cmgsteering import CmgSteering
from plants.hardware.magnetometer import ThreeAxisMagnetometer
from plants.hardware.magnetorquers import Magnetorquers
from plants.hardware.orbitsensors import GpsReceiver, HorizonSensor
from plants.hardware.ratesensors import IntegratingGyro, Tachometers
from plants.hardware.startracker import StarTracker
from plants.hardware.sunsensors import CoarseSunSensors, FineSunSensor
from plants.hardware.wheels import Wheel
from plants.surroundings.atmosphere import Atmosphere, LayeredAtmosphere
from plants.surroundings.disturbances import ConstantTorque, Drag, ResidualDipole, SolarPressure
from plants.surroundings.forces import DragForce, EarthShape, MoonGravity, PressureForce, SunGravity
from plants.surroundings.orbit import Oblateness, Orbit, circular, keplerian

LOWEST = 50e3  # m, altitude below which nothing flies, so that it was meant in another unit


def _body(
    inertia: Any,
    epoch: datetime,
    dt: float,
    samples: int = 1,
    name: str = "spacecraft",
    wanted_speeds: Any = None,
    null_rate: Any = None,
    minimax: bool = False,
    spanning: bool = True,
    physical: bool = True,
    parts: dict[str, Any] | None = None,
) -> Spacecraft | None:
    """The spacecraft; without its parts, because they are wrong, what can be told of the body alone."""
    if parts is None:
        positive("dt", dt)
        RigidBody.create(inertia, physical=physical)
        return None
    return spacecraft(
        inertia=inertia, epoch=epoch, dt=dt, samples=samples, name=name, wanted_speeds=wanted_speeds,
        null_rate=null_rate, minimax=minimax, spanning=spanning, physical=physical, **parts,
    )  # fmt: skip


def _requirements(pointing: float, bandwidth: float, integral: bool = True) -> dict[str, Any]:
    p, b = float(positive("pointing", pointing)), float(positive("bandwidth", bandwidth))
    if p > np.pi:
        raise ScenarioError(f"pointing must be at most half a turn, got {p:g} rad: write pointing_deg for degrees")
    return {"pointing": p, "bandwidth": b, "integral": integral}


def _flight(duration: float, after: float | None = None) -> dict[str, Any]:
    span = float(positive("duration", duration))
    late = None if after is None else float(real("after", after, low=0))
    if late is not None and late >= span:
        raise ScenarioError(f"after must be below duration = {span:g} s, or no error counts")
    return {"duration": span, "after": late}


def _dispersion(
    angles: float = Dispersion().angles,
    rate: float = Dispersion().rate,
    inertia: float = Dispersion().inertia,
    torque: float = Dispersion().torque,
) -> Dispersion:
    given = {"angles": angles, "rate": rate, "inertia": inertia, "torque": torque}
    made = Dispersion(**{name: float(real(name, value, low=0)) for name, value in given.items()})
    if made.inertia >= 1:
        raise ScenarioError("inertia must be below 1: it is relative to that of the spacecraft")
    return made


def _navigation(deviation: float = 0.1, bias_deviation: float | None = None) -> dict[str, Any]:
    given = {"deviation": deviation} | ({} if bias_deviation is None else {"bias_deviation": bias_deviation})
    return {name: float(real(name, value, low=0)) for name, value in given.items()}


def _magnetorquer(axis: Any, max_dipole: float, residual: float = 0.0, step: float = 0.0) -> dict[str, Any]:
    return {
        "axes": unit("axis", axis, (3,)), "max_dipole": positive("max_dipole", max_dipole, infinite=True),
        "residual": real("residual", residual), "step": real("step", step, low=0),
    }  # fmt: skip


def _thruster(position: Any, direction: Any, force: float) -> dict[str, Any]:
    return {
        "positions": real("position", position, (3,)), "directions": unit("direction", direction, (3,)),
        "force": positive("force", force),
    }  # fmt: skip


def _pwm(shortest: float, spread: float = 0.0, specific_impulse: float = np.inf) -> dict[str, Any]:
    return {"modulator": Pwm.create(shortest=shortest), "spread": spread, "specific_impulse": specific_impulse}


def _schmitt(
    on: float, off: float, shortest: float = 0.0, spread: float = 0.0, specific_impulse: float = np.inf
) -> dict[str, Any]:
    made = Schmitt.create(on=on, off=off, shortest=shortest)
    return {"modulator": made, "spread": spread, "specific_impulse": specific_impulse}


def _pwpf(
    on: float,
    off: float,
    gain: float,
    lag: float,
    shortest: float = 0.0,
    spread: float = 0.0,
    specific_impulse: float = np.inf,
) -> dict[str, Any]:
    made = Pwpf.create(on=on, off=off, gain=gain, lag=lag, shortest=shortest)
    return {"modulator": made, "spread": spread, "specific_impulse": specific_impulse}


def _gyroscope(gimbal_axis: Any, spin_axis: Any, momentum: float) -> dict[str, Any]:
    return {
        "gimbal_axes": unit("gimbal_axis", gimbal_axis, (3,)), "spin_axes": unit("spin_axis", spin_axis, (3,)),
        "momentum": positive("momentum", momentum),
    }  # fmt: skip


def _steering(max_rate: float, threshold: float = 0.3, damping: float = 0.1) -> dict[str, Any]:
    return {"max_rate": max_rate, "threshold": threshold, "damping": damping}


def _circular(altitude: float, inclination: float, raan: float = 0.0, argument_of_latitude: float = 0.0) -> Orbit:
    if 0 < altitude < LOWEST:
        raise ScenarioError(f"altitude must be above {LOWEST:g} m for an orbit: for kilometres write altitude_km")
    return circular(altitude, inclination, raan, argument_of_latitude)


def _layered(factor: float = 1.0, highest: float = LayeredAtmosphere().highest) -> LayeredAtmosphere:
    known = {
        "factor": float(real("factor", factor, low=0)),
        "highest": float(positive("highest", highest, infinite=True)),
    }
    return LayeredAtmosphere(**known)


def _exponential(density: float, altitude: float, scale_height: float) -> Atmosphere:
    return Atmosphere(
        density=float(real("density", density, low=0)),
        altitude=float(real("altitude", altitude)),
        scale_height=float(positive("scale_height", scale_height)),
    )


def _drag_force(ballistic: float) -> DragForce:
    return DragForce.create(ballistic)


BODY = Kind(
    _body,
    {
        "name": str, "epoch": datetime, "samples": int, "minimax": bool, "spanning": bool, "physical": bool,
        "wanted_speeds": SPIN,
    },
)  # fmt: skip
REQUIREMENTS = Kind(_requirements, {"pointing": ANGLE, "bandwidth": RATE, "integral": bool})
FLIGHT = Kind(_flight)
DISPERSION = Kind(_dispersion, {"angles": ANGLE, "rate": RATE, "inertia": PER_CENT, "torque": TORQUE})
NAVIGATION = Kind(_navigation, {"deviation": ANGLE, "bias_deviation": RATE})
DUMPING = Kind(CrossProductDumping.create, {"wanted": MOMENTUM})
ORBITS = {
    "circular": Kind(
        _circular,
        {"altitude": LENGTH, "inclination": ANGLE, "raan": ANGLE, "argument_of_latitude": ANGLE},
        single=True,
    ),
    "keplerian": Kind(
        keplerian,
        {
            "semi_major_axis": LENGTH, "inclination": ANGLE, "raan": ANGLE, "argument_of_perigee": ANGLE,
            "true_anomaly": ANGLE,
        },
        single=True,
    ),
}  # fmt: skip
WHEEL = Kind(
    Wheel.create,
    {
        "max_torque": TORQUE, "max_momentum": MOMENTUM, "max_speed": SPIN, "coulomb": TORQUE, "static": TORQUE,
        "stribeck": SPIN, "creep": SPIN, "torque_step": TORQUE, "position": LENGTH,
    },
)  # fmt: skip
VIEW = {"noise": ANGLE, "half_angle": ANGLE, "misalignment": ANGLE}
AXES = {"scale_factor": PER_CENT, "misalignment": ANGLE, "nonorthogonality": ANGLE}
SENSORS = {
    "star tracker": Kind(
        StarTracker.create,
        {
            "cross_noise": ANGLE, "boresight_noise": ANGLE, "misalignment": ANGLE, "sun_exclusion": ANGLE,
            "earth_exclusion": ANGLE, "fastest": RATE,
        },
    ),
    "gyro": Kind(
        IntegratingGyro.create,
        {
            **AXES, "random_walk": ANGLE_WALK, "rate_random_walk": RATE_WALK, "bias_instability": RATE, "bias": RATE,
            "turn_on_bias": RATE, "quantum": ANGLE, "fastest": RATE,
        },
    ),
    "fine sun sensor": Kind(FineSunSensor.create, VIEW),
    "coarse sun sensors": Kind(CoarseSunSensors.create, {"half_angle": ANGLE}),
    "magnetometer": Kind(ThreeAxisMagnetometer.create, {**AXES, "noise": FIELD, "bias": FIELD, "quantum": FIELD}),
    "horizon sensor": Kind(HorizonSensor.create, VIEW),
    "gps": Kind(GpsReceiver.create),
    "tachometers": Kind(Tachometers.create, {"quantum": SPIN}),
}  # fmt: skip
CALIBRATED = {"star tracker": ANGLE, "fine sun sensor": ANGLE, "horizon sensor": ANGLE, "magnetometer": FIELD}
BOX = {"size": LENGTH, "mass_centre": LENGTH}
DISTURBANCES = {
    "residual dipole": Kind(ResidualDipole.create),
    "drag": Kind(Drag.create, BOX),
    "solar pressure": Kind(SolarPressure.create, BOX),
    "constant torque": Kind(ConstantTorque.create, {"vector": TORQUE}),
}
ATMOSPHERES = {
    "layered": Kind(_layered, {"highest": LENGTH}),
    "exponential": Kind(_exponential, {"altitude": LENGTH, "scale_height": LENGTH}),
    "none": Kind(lambda: None),
}
FORCES = {
    "oblateness": Kind(Oblateness),
    "earth shape": Kind(lambda: EarthShape()),
    "sun": Kind(SunGravity),
    "moon": Kind(MoonGravity),
    "drag": Kind(_drag_force),
    "pressure": Kind(PressureForce.create),
}
MAGNETORQUER = Kind(_magnetorquer)
THRUSTER = Kind(_thruster, {"position": LENGTH, "force": FORCE})
MODULATORS = {"pwm": Kind(_pwm), "schmitt": Kind(_schmitt), "pwpf": Kind(_pwpf)}
GYROSCOPE = Kind(_gyroscope, {"momentum": MOMENTUM})
STEERING = Kind(_steering, {"max_rate": RATE})


APPENDAGES = {
    "modes": Kind(Appendage.create, {"frequencies": SWING, "damping": PER_CENT}),
    "hinged panel": Kind(Appendage.hinged, {"position": LENGTH, "centre": LENGTH, "damping": PER_CENT}),
    "tank": Kind(Appendage.pendulum, {"length": LENGTH, "hinge": LENGTH, "damping": PER_CENT}),
}


def magnetorquers(columns: dict[str, Any]) -> Magnetorquers:
    """All of them, from their numbers as columns."""
    return Magnetorquers.create(columns.pop("axes"), **columns)


def thrusters(columns: dict[str, Any], propulsion: dict[str, Any]) -> AttitudeThrusters:
    """All of them, with what they share."""
    return AttitudeThrusters.create(columns["positions"], columns["directions"], force=columns["force"], **propulsion)


def gyroscopes(columns: dict[str, Any], steering: dict[str, Any]) -> CmgSteering:
    """The cluster, with how it is steered."""
    cluster = Cmgs.create(columns["gimbal_axes"], columns["spin_axes"], momentum=columns["momentum"])
    return CmgSteering.create(cluster, **steering)
