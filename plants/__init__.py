"""Nonlinear worlds, their sensors and estimators, and the one simulator that flies them.

    geometry       rotations: `attitude`
    surroundings   `Environment` (field, Sun, eclipse, air) along a `circular` or `keplerian` orbit under `Force`s,
                   `ground_track`, `target_position`, disturbance torques
    dynamics       `RigidBody`, `Satellite` (with all that turns it), `EulerBody`, `Station` (relative motion)
    hardware       `equip` makes plant and actuator of data sheets (`Wheel`, `Magnetorquers`, `AttitudeThrusters`,
                   `CmgSteering`); `StarTracker`, `IntegratingGyro`, ... in a `SensorSuite`
    estimation     `mekf` over any set of instruments, `ekf`, `svd_navigator`, `kalman`, `station_ekf`
    guidance       commanded frames (`Nadir`, `Pointing`, `Profile`), `Schedule` and `Guided`, `mode` and `sequence`,
                   `Detumbling`, `CrossProductDumping`
    simulation     `Loop` and `Scenario` go into `simulate`, `simulate_many`, `campaign`, `worst_flights`, `linearize`;
                   a `Run` comes out; `Store` reads what a campaign has stored, `sweep` goes through designs
    outcome        `indices`, `budget`, `nees`, `settling_time`, `run_plot`, `attitude_plot`, `attitude_sphere`,
                   `campaign_plot`; `run_table`; `report` and `study` make pages
    craft          `spacecraft` from data sheets, `compare_flights` of its controllers
    missions       `cubesat3u`, `amazonia1`, `airbearing`, `geo`: the numbers of the studies

The names below are imported when they are first used, so that ``import plants`` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from plants.dynamics.cmgs import Cmgs as Cmgs
    from plants.dynamics.eulerbody import EulerBody as EulerBody
    from plants.dynamics.eulerbody import EulerState as EulerState
    from plants.dynamics.eulerbody import RandomTorque as RandomTorque
    from plants.dynamics.eulerbody import TorqueEnv as TorqueEnv
    from plants.dynamics.relative import Sky as Sky
    from plants.dynamics.relative import Station as Station
    from plants.dynamics.relative import StationState as StationState
    from plants.dynamics.rigidbody import BodyState as BodyState
    from plants.dynamics.rigidbody import RigidBody as RigidBody
    from plants.dynamics.rigidbody import state_from as state_from
    from plants.dynamics.satellite import Satellite as Satellite
    from plants.dynamics.satellite import SatelliteState as SatelliteState
    from plants.errors import EngineError as EngineError
    from plants.errors import PlantError as PlantError
    from plants.errors import ScenarioError as ScenarioError
    from plants.errors import SingularityError as SingularityError
    from plants.errors import StoreError as StoreError
    from plants.estimation.kalman import Kalman as Kalman
    from plants.estimation.kalman import RawAngles as RawAngles
    from plants.estimation.kalman import kalman as kalman
    from plants.estimation.mekf import Mekf as Mekf
    from plants.estimation.mekf import mekf as mekf
    from plants.estimation.mekf import mekf_record as mekf_record
    from plants.estimation.navigation import Ekf as Ekf
    from plants.estimation.navigation import Smoothing as Smoothing
    from plants.estimation.navigation import SvdNavigator as SvdNavigator
    from plants.estimation.navigation import ekf as ekf
    from plants.estimation.navigation import svd_navigator as svd_navigator
    from plants.estimation.tracking import Observability as Observability
    from plants.estimation.tracking import StateSensor as StateSensor
    from plants.estimation.tracking import StationEkf as StationEkf
    from plants.estimation.tracking import Unfiltered as Unfiltered
    from plants.estimation.tracking import observability as observability
    from plants.estimation.tracking import station_ekf as station_ekf
    from plants.estimation.wahba import wahba_covariance as wahba_covariance
    from plants.estimation.wahba import wahba_pair as wahba_pair
    from plants.estimation.wahba import wahba_svd as wahba_svd
    from plants.geometry import attitude as attitude
    from plants.guidance.conditions import After as After
    from plants.guidance.conditions import Pointed as Pointed
    from plants.guidance.conditions import Slow as Slow
    from plants.guidance.directions import Fixed as Fixed
    from plants.guidance.directions import Forward as Forward
    from plants.guidance.directions import OrbitNormal as OrbitNormal
    from plants.guidance.directions import ToEarth as ToEarth
    from plants.guidance.directions import ToSun as ToSun
    from plants.guidance.directions import ToTarget as ToTarget
    from plants.guidance.frames import Inertial as Inertial
    from plants.guidance.frames import Nadir as Nadir
    from plants.guidance.frames import Offset as Offset
    from plants.guidance.frames import Pointing as Pointing
    from plants.guidance.frames import Profile as Profile
    from plants.guidance.guided import Guided as Guided
    from plants.guidance.guided import Schedule as Schedule
    from plants.guidance.laws import AttitudeControl as AttitudeControl
    from plants.guidance.laws import Detumbling as Detumbling
    from plants.guidance.magnetic import CrossProductDumping as CrossProductDumping
    from plants.guidance.magnetic import LqrDumping as LqrDumping
    from plants.guidance.magnetic import bdot as bdot
    from plants.guidance.magnetic import bdot_gain as bdot_gain
    from plants.guidance.magnetic import cross_product as cross_product
    from plants.guidance.magnetic import field_rate as field_rate
    from plants.guidance.modes import Known as Known
    from plants.guidance.modes import Mode as Mode
    from plants.guidance.modes import mode as mode
    from plants.guidance.sequences import Sequence as Sequence
    from plants.guidance.sequences import commanded_record as commanded_record
    from plants.guidance.sequences import sequence as sequence
    from plants.hardware.actuators import ReactionWheels as ReactionWheels
    from plants.hardware.attitudethrusters import AttitudeThrusters as AttitudeThrusters
    from plants.hardware.attitudethrusters import Pwm as Pwm
    from plants.hardware.attitudethrusters import Pwpf as Pwpf
    from plants.hardware.attitudethrusters import Schmitt as Schmitt
    from plants.hardware.attitudethrusters import ThrusterState as ThrusterState
    from plants.hardware.cmgsteering import CmgSteering as CmgSteering
    from plants.hardware.effectors import Effectors as Effectors
    from plants.hardware.effectors import equip as equip
    from plants.hardware.instruments import ARCSEC as ARCSEC
    from plants.hardware.instruments import DEG_PER_H as DEG_PER_H
    from plants.hardware.instruments import DEG_PER_SQRT_H as DEG_PER_SQRT_H
    from plants.hardware.instruments import Innovation as Innovation
    from plants.hardware.instruments import Instrument as Instrument
    from plants.hardware.instruments import SensorSuite as SensorSuite
    from plants.hardware.magnetometer import ThreeAxisMagnetometer as ThreeAxisMagnetometer
    from plants.hardware.magnetorquers import Magnetorquers as Magnetorquers
    from plants.hardware.orbitsensors import GpsReceiver as GpsReceiver
    from plants.hardware.orbitsensors import HorizonSensor as HorizonSensor
    from plants.hardware.ratesensors import IntegratingGyro as IntegratingGyro
    from plants.hardware.ratesensors import Tachometers as Tachometers
    from plants.hardware.sensors import AngleRate as AngleRate
    from plants.hardware.sensors import AngleRateSuite as AngleRateSuite
    from plants.hardware.sensors import AttitudeSuite as AttitudeSuite
    from plants.hardware.sensors import Gyro as Gyro
    from plants.hardware.sensors import Magnetometer as Magnetometer
    from plants.hardware.sensors import SunSensor as SunSensor
    from plants.hardware.sensors import attitude_suite as attitude_suite
    from plants.hardware.startracker import StarTracker as StarTracker
    from plants.hardware.sunsensors import CoarseSunSensors as CoarseSunSensors
    from plants.hardware.sunsensors import FineSunSensor as FineSunSensor
    from plants.hardware.thrusters import PulsedThrusters as PulsedThrusters
    from plants.hardware.thrusters import Thrusters as Thrusters
    from plants.hardware.wheels import Wheel as Wheel
    from plants.hardware.wheels import WheelArray as WheelArray
    from plants.missions import airbearing as airbearing
    from plants.missions import amazonia1 as amazonia1
    from plants.missions import cubesat3u as cubesat3u
    from plants.missions import geo as geo
    from plants.outcome import figures as figures
    from plants.outcome import report as report
    from plants.outcome import study as study
    from plants.outcome.budgets import Budget as Budget
    from plants.outcome.budgets import Levels as Levels
    from plants.outcome.budgets import Spread as Spread
    from plants.outcome.budgets import budget as budget
    from plants.outcome.budgets import sampled_loop as sampled_loop
    from plants.outcome.consistency import Consistency as Consistency
    from plants.outcome.consistency import consistency as consistency
    from plants.outcome.consistency import consistency_table as consistency_table
    from plants.outcome.consistency import nees as nees
    from plants.outcome.consistency import nis as nis
    from plants.outcome.indices import Errors as Errors
    from plants.outcome.indices import Indices as Indices
    from plants.outcome.indices import clopper_pearson as clopper_pearson
    from plants.outcome.indices import indices as indices
    from plants.outcome.indices import pointing_errors as pointing_errors
    from plants.outcome.indices import pooled_level as pooled_level
    from plants.outcome.indices import settling_time as settling_time
    from plants.outcome.indices import stability as stability
    from plants.outcome.indices import step_response as step_response
    from plants.outcome.indices import windows as windows
    from plants.outcome.plots import campaign_plot as campaign_plot
    from plants.outcome.plots import run_plot as run_plot
    from plants.outcome.report import Card as Card
    from plants.outcome.report import Claim as Claim
    from plants.outcome.report import Requirement as Requirement
    from plants.outcome.report import Section as Section
    from plants.outcome.study import Statement as Statement
    from plants.outcome.study import Table as Table
    from plants.outcome.study import Verdict as Verdict
    from plants.outcome.study import campaigns as campaigns
    from plants.outcome.study import drawings as drawings
    from plants.outcome.study import either as either
    from plants.outcome.worstbudget import WorstBudget as WorstBudget
    from plants.outcome.worstbudget import worst_budget as worst_budget
    from plants.simulation import blocks as blocks
    from plants.simulation.campaign import Campaign as Campaign
    from plants.simulation.campaign import campaign as campaign
    from plants.simulation.campaign import draw as draw
    from plants.simulation.campaign import replay as replay
    from plants.simulation.campaign import replay_case as replay_case
    from plants.simulation.linearize import LinearModel as LinearModel
    from plants.simulation.linearize import linearize as linearize
    from plants.simulation.loop import Actuator as Actuator
    from plants.simulation.loop import Controller as Controller
    from plants.simulation.loop import Loop as Loop
    from plants.simulation.loop import Navigator as Navigator
    from plants.simulation.loop import Plant as Plant
    from plants.simulation.loop import Run as Run
    from plants.simulation.loop import Scenario as Scenario
    from plants.simulation.loop import Sensors as Sensors
    from plants.simulation.loopmodel import LoopModel as LoopModel
    from plants.simulation.loopmodel import linear_loop as linear_loop
    from plants.simulation.simulate import can_compile as can_compile
    from plants.simulation.simulate import simulate as simulate
    from plants.simulation.simulate import simulate_many as simulate_many
    from plants.simulation.store import Store as Store
    from plants.simulation.sweep import Sweep as Sweep
    from plants.simulation.sweep import sweep as sweep
    from plants.simulation.worstflights import WorstFlights as WorstFlights
    from plants.simulation.worstflights import worst_flights as worst_flights
    from plants.surroundings.atmosphere import Air as Air
    from plants.surroundings.atmosphere import Atmosphere as Atmosphere
    from plants.surroundings.atmosphere import LayeredAtmosphere as LayeredAtmosphere
    from plants.surroundings.disturbances import ConstantTorque as ConstantTorque
    from plants.surroundings.disturbances import Disturbance as Disturbance
    from plants.surroundings.disturbances import Drag as Drag
    from plants.surroundings.disturbances import GravityGradient as GravityGradient
    from plants.surroundings.disturbances import ResidualDipole as ResidualDipole
    from plants.surroundings.disturbances import SolarPressure as SolarPressure
    from plants.surroundings.environment import CircularEnvironment as CircularEnvironment
    from plants.surroundings.environment import Environment as Environment
    from plants.surroundings.environment import FreeSpace as FreeSpace
    from plants.surroundings.environment import OrbitEnv as OrbitEnv
    from plants.surroundings.forces import DragForce as DragForce
    from plants.surroundings.forces import EarthShape as EarthShape
    from plants.surroundings.forces import MoonGravity as MoonGravity
    from plants.surroundings.forces import PressureForce as PressureForce
    from plants.surroundings.forces import SunGravity as SunGravity
    from plants.surroundings.ground import GroundTrack as GroundTrack
    from plants.surroundings.ground import Look as Look
    from plants.surroundings.ground import ground_track as ground_track
    from plants.surroundings.ground import look as look
    from plants.surroundings.ground import target_position as target_position
    from plants.surroundings.msis import Msis as Msis
    from plants.surroundings.orbit import Elements as Elements
    from plants.surroundings.orbit import Force as Force
    from plants.surroundings.orbit import Oblateness as Oblateness
    from plants.surroundings.orbit import Orbit as Orbit
    from plants.surroundings.orbit import circular as circular
    from plants.surroundings.orbit import elements as elements
    from plants.surroundings.orbit import keplerian as keplerian
    from plants.surroundings.orbit import propagate as propagate

_HOME = {  # of a name; modules are their own home
    "ARCSEC": "hardware.instruments",
    "Actuator": "simulation.loop",
    "After": "guidance.conditions",
    "Air": "surroundings.atmosphere",
    "AngleRate": "hardware.sensors",
    "AngleRateSuite": "hardware.sensors",
    "Atmosphere": "surroundings.atmosphere",
    "AttitudeControl": "guidance.laws",
    "AttitudeSuite": "hardware.sensors",
    "AttitudeThrusters": "hardware.attitudethrusters",
    "BodyState": "dynamics.rigidbody",
    "Budget": "outcome.budgets",
    "Campaign": "simulation.campaign",
    "Card": "outcome.report",
    "CircularEnvironment": "surroundings.environment",
    "Claim": "outcome.report",
    "CmgSteering": "hardware.cmgsteering",
    "Cmgs": "dynamics.cmgs",
    "CoarseSunSensors": "hardware.sunsensors",
    "Comparison": "craft.comparison",
    "Consistency": "outcome.consistency",
    "ConstantTorque": "surroundings.disturbances",
    "Controller": "simulation.loop",
    "CrossProductDumping": "guidance.magnetic",
    "DEG_PER_H": "hardware.instruments",
    "DEG_PER_SQRT_H": "hardware.instruments",
    "Detumbling": "guidance.laws",
    "Dispersion": "craft.comparison",
    "Disturbance": "surroundings.disturbances",
    "Drag": "surroundings.disturbances",
    "DragForce": "surroundings.forces",
    "EarthShape": "surroundings.forces",
    "Effectors": "hardware.effectors",
    "Ekf": "estimation.navigation",
    "Elements": "surroundings.orbit",
    "EngineError": "errors",
    "Environment": "surroundings.environment",
    "Errors": "outcome.indices",
    "EulerBody": "dynamics.eulerbody",
    "EulerState": "dynamics.eulerbody",
    "FineSunSensor": "hardware.sunsensors",
    "Fixed": "guidance.directions",
    "Force": "surroundings.orbit",
    "Forward": "guidance.directions",
    "FreeSpace": "surroundings.environment",
    "GpsReceiver": "hardware.orbitsensors",
    "GravityGradient": "surroundings.disturbances",
    "GroundTrack": "surroundings.ground",
    "Guided": "guidance.guided",
    "Gyro": "hardware.sensors",
    "HorizonSensor": "hardware.orbitsensors",
    "Indices": "outcome.indices",
    "Inertial": "guidance.frames",
    "Innovation": "hardware.instruments",
    "Instrument": "hardware.instruments",
    "IntegratingGyro": "hardware.ratesensors",
    "Kalman": "estimation.kalman",
    "Known": "guidance.modes",
    "LayeredAtmosphere": "surroundings.atmosphere",
    "Levels": "outcome.budgets",
    "LinearModel": "simulation.linearize",
    "Look": "surroundings.ground",
    "Loop": "simulation.loop",
    "LoopModel": "simulation.loopmodel",
    "LqrDumping": "guidance.magnetic",
    "Magnetometer": "hardware.sensors",
    "Magnetorquers": "hardware.magnetorquers",
    "Mekf": "estimation.mekf",
    "Mode": "guidance.modes",
    "MoonGravity": "surroundings.forces",
    "Msis": "surroundings.msis",
    "Nadir": "guidance.frames",
    "Navigator": "simulation.loop",
    "Oblateness": "surroundings.orbit",
    "Observability": "estimation.tracking",
    "Offset": "guidance.frames",
    "Orbit": "surroundings.orbit",
    "OrbitEnv": "surroundings.environment",
    "OrbitNormal": "guidance.directions",
    "Plant": "simulation.loop",
    "PlantError": "errors",
    "Pointed": "guidance.conditions",
    "Pointing": "guidance.frames",
    "PressureForce": "surroundings.forces",
    "Profile": "guidance.frames",
    "PulsedThrusters": "hardware.thrusters",
    "Pwm": "hardware.attitudethrusters",
    "Pwpf": "hardware.attitudethrusters",
    "RandomTorque": "dynamics.eulerbody",
    "RawAngles": "estimation.kalman",
    "ReactionWheels": "hardware.actuators",
    "Requirement": "outcome.report",
    "ResidualDipole": "surroundings.disturbances",
    "RigidBody": "dynamics.rigidbody",
    "Run": "simulation.loop",
    "Satellite": "dynamics.satellite",
    "SatelliteState": "dynamics.satellite",
    "Scenario": "simulation.loop",
    "ScenarioError": "errors",
    "Schedule": "guidance.guided",
    "Schmitt": "hardware.attitudethrusters",
    "Section": "outcome.report",
    "SensorSuite": "hardware.instruments",
    "Sensors": "simulation.loop",
    "Sequence": "guidance.sequences",
    "SingularityError": "errors",
    "Sky": "dynamics.relative",
    "Slow": "guidance.conditions",
    "Smoothing": "estimation.navigation",
    "SolarPressure": "surroundings.disturbances",
    "Spacecraft": "craft.spacecraft",
    "Spread": "outcome.budgets",
    "StarTracker": "hardware.startracker",
    "StateSensor": "estimation.tracking",
    "Statement": "outcome.study",
    "Station": "dynamics.relative",
    "StationEkf": "estimation.tracking",
    "StationState": "dynamics.relative",
    "Store": "simulation.store",
    "StoreError": "errors",
    "SunGravity": "surroundings.forces",
    "SunSensor": "hardware.sensors",
    "SvdNavigator": "estimation.navigation",
    "Sweep": "simulation.sweep",
    "Table": "outcome.study",
    "Tachometers": "hardware.ratesensors",
    "ThreeAxisMagnetometer": "hardware.magnetometer",
    "ThrusterState": "hardware.attitudethrusters",
    "Thrusters": "hardware.thrusters",
    "ToEarth": "guidance.directions",
    "ToSun": "guidance.directions",
    "ToTarget": "guidance.directions",
    "TorqueEnv": "dynamics.eulerbody",
    "Unfiltered": "estimation.tracking",
    "Verdict": "outcome.study",
    "Wheel": "hardware.wheels",
    "WheelArray": "hardware.wheels",
    "WorstBudget": "outcome.worstbudget",
    "WorstFlights": "simulation.worstflights",
    "airbearing": "missions.airbearing",
    "amazonia1": "missions.amazonia1",
    "attitude": "geometry.attitude",
    "attitude_plot": "outcome.attitudeplots",
    "attitude_sphere": "outcome.spheres",
    "attitude_suite": "hardware.sensors",
    "bdot": "guidance.magnetic",
    "bdot_gain": "guidance.magnetic",
    "blocks": "simulation.blocks",
    "body_axis": "outcome.spheres",
    "budget": "outcome.budgets",
    "campaign": "simulation.campaign",
    "campaign_plot": "outcome.plots",
    "campaigns": "outcome.study",
    "can_compile": "simulation.simulate",
    "circular": "surroundings.orbit",
    "clopper_pearson": "outcome.indices",
    "commanded_record": "guidance.sequences",
    "compare_flights": "craft.comparison",
    "consistency": "outcome.consistency",
    "consistency_table": "outcome.consistency",
    "cross_product": "guidance.magnetic",
    "cubesat3u": "missions.cubesat3u",
    "draw": "simulation.campaign",
    "drawings": "outcome.study",
    "either": "outcome.study",
    "ekf": "estimation.navigation",
    "elements": "surroundings.orbit",
    "equip": "hardware.effectors",
    "field_rate": "guidance.magnetic",
    "figures": "outcome.figures",
    "geo": "missions.geo",
    "ground_track": "surroundings.ground",
    "ground_track_plot": "outcome.spheres",
    "indices": "outcome.indices",
    "kalman": "estimation.kalman",
    "keplerian": "surroundings.orbit",
    "linear_loop": "simulation.loopmodel",
    "linearize": "simulation.linearize",
    "look": "surroundings.ground",
    "mekf": "estimation.mekf",
    "mekf_record": "estimation.mekf",
    "mode": "guidance.modes",
    "nees": "outcome.consistency",
    "nis": "outcome.consistency",
    "observability": "estimation.tracking",
    "pointing_errors": "outcome.indices",
    "pooled_level": "outcome.indices",
    "propagate": "surroundings.orbit",
    "replay": "simulation.campaign",
    "replay_case": "simulation.campaign",
    "report": "outcome.report",
    "run_plot": "outcome.plots",
    "run_table": "outcome.tables",
    "sampled_loop": "outcome.budgets",
    "sequence": "guidance.sequences",
    "settling_time": "outcome.indices",
    "simulate": "simulation.simulate",
    "simulate_many": "simulation.simulate",
    "spacecraft": "craft.spacecraft",
    "stability": "outcome.indices",
    "state_from": "dynamics.rigidbody",
    "station_ekf": "estimation.tracking",
    "step_response": "outcome.indices",
    "study": "outcome.study",
    "svd_navigator": "estimation.navigation",
    "sweep": "simulation.sweep",
    "target_position": "surroundings.ground",
    "wahba_covariance": "estimation.wahba",
    "wahba_pair": "estimation.wahba",
    "wahba_svd": "estimation.wahba",
    "wheel_speed_plot": "outcome.attitudeplots",
    "windows": "outcome.indices",
    "worst_budget": "outcome.worstbudget",
    "worst_flights": "simulation.worstflights",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str):
    """Import a public name from its module."""
    if name not in _HOME:
        raise AttributeError(f"module 'plants' has no attribute {name!r}")
    home = importlib.import_module(f"plants.{_HOME[name]}")
    value = home if _HOME[name].endswith(f".{name}") and name not in vars(home) else getattr(home, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return [*globals(), *_HOME]
