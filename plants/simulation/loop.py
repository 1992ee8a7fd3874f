"""What a closed loop is: the protocols of its blocks, the loop, the scenario it flies, and the run that comes out.

Blocks are frozen dataclasses of numbers; what flows through them is NamedTuples of arrays. A controller written
elsewhere fits without knowing this package, because protocols are structural.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from plants.simulation import blocks

try:
    MEMORY = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")  # bytes
except (AttributeError, ValueError, OSError):  # not told here
    MEMORY = 2**40


class Plant(Protocol):
    """A nonlinear world, dx/dt = f(x, u, environment); `uncertain_model` asks it for a `mass()` if it has one."""

    def derivative(self, x: Any, u: Any, env: Any) -> Any:
        """dx/dt, a state-like tuple."""
        ...

    def output(self, x: Any, env: Any) -> Any:
        """(ny,) what is to be controlled, in the units of the reference."""
        ...

    def project(self, x: Any) -> Any:
        """The state brought back to its manifold after a step, such as a unit quaternion."""
        ...


class Sensors(Protocol):
    """What is measured of the plant; its state holds biases."""

    @property
    def channels(self) -> int:
        """Number of independent standard normal numbers that one sample takes."""
        ...

    def init(self) -> Any:
        """State before the first sample."""
        ...

    def measure(self, s: Any, x: Any, env: Any, noise: Any, h: Any) -> tuple[Any, Any]:
        """New state and measurement; `h` s have passed since the last sample, 0 at the first."""
        ...


class Navigator(Protocol):
    """What is known of the plant: measurements in, an estimate of the plant's output out.

    A navigator with an attribute `ny` gives so many numbers: the estimate of the output first, then what else the
    controller is to know, such as a magnetic field.
    """

    def init(self) -> Any:
        """State before the first measurement."""
        ...

    def update(self, s: Any, y: Any, u: Any, env: Any, h: Any) -> tuple[Any, Any]:
        """New state and estimate (ny,); `u` acted for the `h` s since the last sample (0 at the first)."""
        ...


class Controller(Protocol):
    """What to do about it: pure, called once every `dt` s."""

    @property
    def dt(self) -> Any:
        """Control period, s."""
        ...

    def init(self) -> Any:
        """State before the first call."""
        ...

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """New state and command (nu,) from the estimate y and the reference r, both (ny,)."""
        ...


class Actuator(Protocol):
    """What comes of the command: limits, lags, distribution.

    One with an attribute `channels` is called as ``apply(s, command, x, noise, h)``, with so many independent standard
    normal numbers in every sample of h s, none of them those of the sensors.
    """

    def init(self) -> Any:
        """State before the first command."""
        ...

    @property
    def apply(self) -> Callable[..., tuple[Any, Any]]:
        """``apply(s, command, x)`` gives the new state and the plant's input u."""
        ...


class Environment(Protocol):
    """What the plant flies through, as a function of time alone."""

    def at(self, t: Any) -> Any:
        """A NamedTuple of arrays at time t, s."""
        ...


def controller_of(thing: Any) -> Any:
    """The controller that an object gives by its method `as_controller`, as a `synth.Design`; others as they are."""
    give = None if hasattr(thing, "step") else getattr(thing, "as_controller", None)
    return give() if callable(give) else thing


@dataclass(frozen=True, kw_only=True)
class Loop:
    """A closed loop. Without sensors and navigator the controller sees the true output.

    Without an actuator u is the command. For `controller` an object that gives one is taken too, such as a
    `synth.Design`, by its method `as_controller`.
    """

    plant: Plant
    controller: Controller
    sensors: Sensors | None = None
    navigator: Navigator | None = None
    actuator: Actuator | None = None
    delay: int = 0  # control periods between a command and its action

    def __post_init__(self) -> None:
        """Ask what gives a controller for it."""
        object.__setattr__(self, "controller", controller_of(self.controller))


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Everything else that defines a run: from where, through what, for how long, towards what, which noise."""

    initial: Any  # plant state at t = 0
    dt: float  # () s, control period
    periods: int  # control periods in the run
    samples: int = 1  # sensor samples per control period
    steps: int = 1  # Runge-Kutta steps per sample
    reference: ArrayLike | None = None  # (ny,) or (periods, ny) units of the output; zeros if absent
    environment: Environment | None = None
    keep_every: int = 1  # 1: a row per sensor sample; more: one per so many control periods, for long campaigns
    seed: int = 0  # of the noise, shared by the runs of a campaign
    run: int = 0  # index of the run: with the seed, the name of its noise
    bound: float = 1e9  # () any unit; a state, estimate or command beyond it has diverged

    def __post_init__(self) -> None:
        """Take lists of numbers in the state as arrays."""
        x = self.initial
        lists = {
            n: np.array(v) for n in getattr(x, "_fields", ()) if isinstance(v := getattr(x, n), list) and _plain(v)
        }
        if lists:
            object.__setattr__(self, "initial", x._replace(**lists))

    @property
    def h(self) -> float:
        """Sampling period, s."""
        return self.dt / self.samples

    @property
    def rows(self) -> int:
        """Rows of a control period that is kept."""
        return self.samples if self.keep_every == 1 else 1


blocks.node(Loop, ["plant", "controller", "sensors", "navigator", "actuator"], ["delay"])
blocks.node(
    Scenario,
    ["initial", "dt", "reference", "environment", "seed", "run", "bound"],
    ["periods", "samples", "steps", "keep_every"],
)


@dataclass(frozen=True, kw_only=True)
class Run:
    """What came out, one row per sensor sample, or the first of every `keep_every` control periods.

    A failed run holds the rows before its failure only. `inputs` is what acted on the plant during the sample that
    starts at `time`.
    """

    duration: float  # s, as planned
    time: np.ndarray  # (N,) s
    states: Any  # plant state of (N, ...) arrays
    outputs: np.ndarray  # (N, ny) true
    estimates: np.ndarray  # (N, ny) as the controller sees them
    references: np.ndarray  # (N, ny)
    commands: np.ndarray  # (N, nu) as issued in this period
    inputs: np.ndarray  # (N, m)
    extra: Any  # what `record` returned, (N, ...) arrays
    ok: bool
    failed_at: float | None  # s, start of the control period in which it failed
    culprit: str  # "controller", "plant", "sensors" or "navigator"; "" if ok
    compiled: bool  # whether the controller was compiled with the loop or stepped from Python
    memory: Any = None  # the controller's state at the end: its counters, for example
    actuator: Any = None  # the actuator's state at the end: what thrusters have given, for example

    def plot(self, ax: Any = None, **options: Any) -> np.ndarray:
        """Draw the run; see `plants.attitude_plot` for a body with an attitude, `plants.run_plot` for others."""
        from plants.outcome.attitudeplots import flight_plot  # a convenience from above

        return flight_plot(self, ax, **options)

    def sphere_plot(self, axis: ArrayLike, **options: Any) -> np.ndarray:
        """Draw where a body axis points; see `plants.attitude_sphere`."""
        from plants.outcome.spheres import attitude_sphere

        return attitude_sphere(self, axis, **options)

    def to_parquet(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write a row for each sample as Parquet; see `plants.run_table` for the columns."""
        from plants.outcome.tables import write_parquet

        return write_parquet(self, path, force=force)

    def to_csv(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write a row for each sample as CSV; see `plants.run_table` for the columns."""
        from plants.outcome.tables import write_csv

        return write_csv(self, path, force=force)


def _plain(values: Any) -> bool:
    """Whether this is a list of numbers."""
    return isinstance(values, list) and all(isinstance(value, int | float) for value in values)


def env_at(scn: Scenario, t: Any) -> Any:
    """The environment at time t, or None."""
    return None if scn.environment is None else scn.environment.at(t)


def output_shape(loop: Loop, scn: Scenario) -> Any:
    """Shape of the plant's output."""
    return jax.eval_shape(lambda p, s: p.output(jax.tree.map(jnp.asarray, s.initial), env_at(s, 0.0)), loop.plant, scn)


def reference_at(loop: Loop, scn: Scenario, k: Any = None) -> Any:
    """The reference of period k, (ny,), or as given when k is None."""
    if scn.reference is None:
        return jnp.zeros(output_shape(loop, scn).shape)
    table = jnp.asarray(scn.reference, float)
    return table if table.ndim == 1 or k is None else table[k]


def act(loop: Loop, s: Any, command: Any, x: Any, noise: Any, h: Any) -> tuple[Any, Any]:
    """New state of the actuator and the plant's input u; without an actuator u is the command."""
    if loop.actuator is None:
        return s, command
    if actuator_channels(loop):
        return loop.actuator.apply(s, command, x, noise, h)
    return loop.actuator.apply(s, command, x)


def actuator_channels(loop: Loop) -> int:
    """Normal numbers that the actuator takes in a sample."""
    return getattr(loop.actuator, "channels", 0)


def first_estimate(loop: Loop, scn: Scenario) -> Any:
    """What stands for the estimate before there is one: the reference, and zeros for what else a navigator tells."""
    r = reference_at(loop, scn, 0)
    more = getattr(loop.navigator, "ny", r.shape[0]) - r.shape[0]
    return jnp.concatenate([r, jnp.zeros(more)]) if more else r


def seen(loop: Loop, scn: Scenario, estimate: Any, r: Any) -> tuple[Any, Any]:
    """What the controller gets, an estimate and a reference: their difference and zeros where the plant says how.

    A plant with ``error(y, r)``, both (ny,), says how far y is from r, such as by the quaternion between two attitudes:
    a difference of their vector parts means nothing beyond small angles.
    """
    error = getattr(loop.plant, "error", None)
    if error is None or scn.reference is None:
        return estimate, r
    ny = r.shape[0]
    return jnp.concatenate([error(estimate[:ny], r), estimate[ny:]]), jnp.zeros(ny)
