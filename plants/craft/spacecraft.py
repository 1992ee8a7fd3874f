"""Your own spacecraft, from its data sheets to a loop that flies: the one door to what the rooms below have.

    craft = spacecraft(inertia=..., wheels=[...], sensors=[...], orbit=..., epoch=..., dt=1.0)
    craft.linear()        what a controller has to turn, as matrices
    craft.weights(...)    of a generalised plant, from what is required
    craft.loop(K)         the loop with a controller, filter and actuators in it
    craft.scenario(...)   what it flies

Controllers are designed elsewhere: matrices go out, and whatever has `dt`, `init` and `step` comes in.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import positive, real, whole
from plants.craft import requirements
from plants.dynamics.satellite import Satellite, SatelliteState
from plants.errors import ScenarioError
from plants.estimation.mekf import Mekf, mekf
from plants.geometry import attitude
from plants.guidance.frames import Guidance
from plants.guidance.guided import Guided
from plants.guidance.laws import AttitudeControl, Dumping
from plants.guidance.modes import mode
from plants.guidance.sequences import sequence
from plants.hardware.effectors import Effectors, equip
from plants.hardware.instruments import SensorSuite
from plants.hardware.magnetometer import ThreeAxisMagnetometer
from plants.hardware.magnetorquers import Magnetorquers
from plants.hardware.ratesensors import Tachometers
from plants.hardware.wheels import Wheel
from plants.simulation import blocks
from plants.simulation.linearize import LinearModel, linearize
from plants.simulation.loop import Loop, Scenario
from plants.surroundings import orbit as orbits
from plants.surroundings.disturbances import Disturbance, GravityGradient
from plants.surroundings.environment import CircularEnvironment, Environment
from plants.surroundings.orbit import Orbit

OUTPUTS = 6  # [vector part of the error quaternion; rad/s]


@dataclass(frozen=True)
class Read:
    """A field of the reading of one instrument of a suite."""

    place: int
    field: str

    def __call__(self, y: Any) -> Any:
        """The field of a measurement."""
        return getattr(y[self.place], self.field)


@partial(blocks.node, data_fields=["plant"], meta_fields=[])
@dataclass(frozen=True)
class _Seen:
    """A satellite whose flexible modes are measured too."""

    plant: Satellite

    def derivative(self, x: SatelliteState, u: Array, env: Any) -> SatelliteState:
        return self.plant.derivative(x, u, env)

    def output(self, x: SatelliteState, env: Any) -> Array:
        return jnp.concatenate([self.plant.output(x, env), jnp.asarray(x.modes), jnp.asarray(x.mode_rates)])

    def project(self, x: SatelliteState) -> SatelliteState:
        return self.plant.project(x)


@dataclass(frozen=True, kw_only=True)
class Spacecraft:
    """A spacecraft; build it with `spacecraft`."""

    name: str
    plant: Satellite
    actuator: Effectors
    sensors: SensorSuite | None
    navigator: Mekf | None
    orbit: Orbit
    epoch: datetime  # UTC
    dt: float  # () s, control period
    samples: int  # of the sensors in a control period

    @property
    def inertia(self) -> np.ndarray:
        """(3, 3) kg m^2."""
        return np.asarray(self.plant.body.inertia)

    @property
    def torque(self) -> float:
        """Torque that the wheels can give about every axis at least, () N m; inf without wheels."""
        wheels = self.actuator.wheels
        if wheels is None:
            return np.inf
        shares = np.abs(np.linalg.pinv(np.asarray(wheels.axes)))
        return float(1 / (shares / np.asarray(wheels.max_torque)[:, None]).max())

    def linear(self) -> LinearModel:
        """Continuous model from the torque on the body (3,) N m to the output (6,), about rest at nadir.

        The output is [vector part of the quaternion; rad/s] relative to frame O, with the gravity gradient of the
        circular orbit of the same energy; the momentum of the wheels is left out. The state is the output, followed by
        the k modes of the appendages and their rates: with them A is (6 + 2 k, 6 + 2 k).
        """
        flexible = self.plant.appendages
        body = Satellite.create(
            self.inertia,
            thrusters=True,
            appendages=() if flexible is None else (flexible,),
            disturbances=(GravityGradient(),),
            physical=False,
        )
        around = CircularEnvironment.along(self._circular())
        rest = body.state(np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), around)
        A, B, C, D = linearize(_Seen(body), rest, np.zeros(3), around)
        return LinearModel(A, B, C[:OUTPUTS], D[:OUTPUTS])

    def weights(self, *, pointing: float, bandwidth: float, integral: bool = True) -> dict[str, Any]:
        """First weights of `GeneralizedPlant.four_block` for `linear` at `dt`; see `requirements.weights`."""
        return requirements.weights(self.inertia, self.dt, self.torque, pointing, bandwidth, integral)

    def costs(self, *, pointing: float, bandwidth: float) -> dict[str, Any]:
        """First weights and limits of `synth.mpc` for `linear` at `dt`; see `requirements.costs`."""
        return requirements.costs(self.inertia, self.torque, pointing, bandwidth)

    def environment(self, duration: float, **options: Any) -> Environment:
        """Surroundings for `duration` () s from the epoch; options of `Environment.along`."""
        return Environment.along(self.orbit, self.epoch, duration, **options)

    def loop(self, controller: Any, *, dumping: Dumping | None = None) -> Loop:
        """The closed loop with a controller of the error (6,) to a torque on the body (3,) N m.

        Parameters
        ----------
        controller : anything with `dt`, `init` and `step`, or that gives it by `as_controller`, as a `synth.Design`
        dumping : law for the magnetorquers, such as `CrossProductDumping`; without it they rest

        Raises
        ------
        ScenarioError
            `dumping` without magnetorquers, or without magnetometer and tachometers that it works by.
        """
        loop = Loop(
            plant=self.plant,
            controller=controller,
            sensors=self.sensors,
            navigator=self.navigator,
            actuator=self.actuator,
        )
        if self.actuator.magnetorquers is None:
            if dumping is not None:
                raise ScenarioError("dumping works by magnetorquers, and the spacecraft has none")
            return loop
        made = sequence(
            [mode("pointing", AttitudeControl(controller=loop.controller, dumping=dumping))],
            dt=self.dt,
            navigators=[self.navigator],
            wheel_axes=self.plant.body.wheel_axes,
            wheel_inertia=self.plant.body.wheel_inertia,
            field=self.reads(ThreeAxisMagnetometer, "vector"),
            wheels=self.reads(Tachometers, "wheels"),
        )
        return replace(loop, controller=made.controller, navigator=made.navigator)

    def reads(self, kind: type, field: str) -> Read:
        """The field of the reading of an instrument, as a function of a measurement: for `sequence`.

        Raises
        ------
        ScenarioError
            The spacecraft has no such instrument.
        """
        instruments = () if self.sensors is None else self.sensors.instruments
        for place, instrument in enumerate(instruments):
            if isinstance(instrument, kind):
                return Read(place, field)
        raise ScenarioError(f"sensors has no {kind.__name__}: add one, what is asked for works by it")

    def scenario(
        self,
        duration: float,
        *,
        environment: Any = None,
        guidance: Guidance | None = None,
        angles: Given = (0.0, 0.0, 0.0),
        rate: Given = (0.0, 0.0, 0.0),
        speeds: Given | None = None,
        **more: Any,
    ) -> Scenario:
        """A flight of `duration` () s from an attitude relative to frame O.

        Parameters
        ----------
        duration : () s, a whole number of control periods
        environment : by default that of the orbit, made anew in every call; pass one that serves many flights
        guidance : commanded frame; frame O by default
        angles : (3,) rad, 3-2-1 Euler angles (roll, pitch, yaw)
        rate : (3,) rad/s relative to frame O, body axes
        speeds : (n,) rad/s of the wheels; at rest by default
        more : further fields of `Scenario`

        Raises
        ------
        ScenarioError
            A duration that is no whole number of periods, wrong shapes, NaN.
        """
        periods = whole("duration", duration, self.dt, "control periods")
        around = self.environment(duration) if environment is None else environment
        with jax.enable_x64(True):
            q = np.asarray(attitude.from_euler(real("angles", angles, (3,))))
        initial = self.plant.state(
            q, real("rate", rate, (3,)), around, wheels=None if speeds is None else np.asarray(speeds, float)
        )
        flown = around if guidance is None else Guided(environment=around, guidance=guidance)
        return Scenario(
            initial=initial, dt=self.dt, periods=periods, samples=self.samples, environment=flown, **more
        )  # fmt: skip

    def _circular(self) -> Orbit:
        """A circular orbit of the same energy, plane and place."""
        r, v = np.asarray(self.orbit.r), np.asarray(self.orbit.v)
        a = 1 / (2 / np.linalg.norm(r) - v @ v / orbits.MU)
        along = v - r * (r @ v) / (r @ r)
        return Orbit(a * r / np.linalg.norm(r), np.sqrt(orbits.MU / a) * along / np.linalg.norm(along))


def spacecraft(
    *,
    inertia: ArrayLike,
    wheels: Sequence[Wheel] = (),
    magnetorquers: Magnetorquers | None = None,
    sensors: Sequence[Any] = (),
    orbit: Orbit,
    epoch: datetime,
    dt: float,
    samples: int = 1,
    disturbances: Sequence[Disturbance] = (),
    name: str = "spacecraft",
    navigation: dict[str, Any] | None = None,
    **effectors: Any,
) -> Spacecraft:
    """A spacecraft from its data sheets.

    Parameters
    ----------
    inertia : (3, 3) kg m^2, or (3,) its diagonal, with the wheels at rest
    wheels : `Wheel.create(...)` for each, of different kinds if need be
    magnetorquers : `Magnetorquers.create(...)`
    sensors : instruments, such as `StarTracker.create(...)` and `IntegratingGyro.create(...)`; a `mekf` is made for
        them. Without any the controller gets the true state
    orbit : `circular(...)` or `keplerian(...)`
    epoch : UTC at the start
    dt : () s, control period
    samples : of the sensors in a control period
    disturbances : torques beside the gravity gradient, which always acts
    name : for reports
    navigation : further arguments of `mekf`
    effectors : further arguments of `equip`, such as `thrusters`, `cmgs`, `appendages`, `wanted_speeds`

    Raises
    ------
    ScenarioError
        What `equip`, `SensorSuite.create` and `mekf` refuse; magnetorquers without sensors.
    """
    period = float(positive("dt", dt))
    if not isinstance(samples, int) or isinstance(samples, bool) or samples < 1:
        raise ScenarioError(f"samples = {samples!r}: give a whole number of at least 1")
    if not isinstance(orbit, Orbit) or np.shape(orbit.r) != (3,):
        raise ScenarioError(f"orbit = {orbit!r}: give one, such as circular(500e3, np.radians(97.4))")
    if not isinstance(epoch, datetime):
        raise ScenarioError(f"epoch = {epoch!r}: give a datetime in UTC, such as datetime(2026, 3, 20, 12)")
    if magnetorquers is not None and not sensors:
        raise ScenarioError("sensors: magnetorquers work by the measured field; give a magnetometer and tachometers")
    plant, actuator = equip(
        inertia,
        wheels=wheels,
        magnetorquers=magnetorquers,
        disturbances=(GravityGradient(), *disturbances),
        **effectors,
    )
    suite = SensorSuite.create(list(sensors)) if sensors else None
    navigator = None if suite is None else mekf(suite, **(navigation or {}))
    blocks.register(plant)
    return Spacecraft(
        name=name,
        plant=plant,
        actuator=actuator,
        sensors=suite,
        navigator=navigator,
        orbit=orbit,
        epoch=epoch,
        dt=period,
        samples=samples,
    )
