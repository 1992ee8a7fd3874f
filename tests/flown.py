"""What the tests of the simulator fly: a pendulum with controllers that can, cannot and will not, and the CubeSat."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from plants.missions import cubesat3u
from plants.simulation.simulate import Loop, Scenario


class Swing(NamedTuple):
    angle: float
    rate: float


@dataclass(frozen=True)
class Pendulum:
    length: float = 1.0

    def derivative(self, x, u, env):
        return Swing(x.rate, -9.81 / self.length * jnp.sin(x.angle) + u[0])

    def output(self, x, env):
        return jnp.stack([x.angle, x.rate])

    def project(self, x):
        return x


@dataclass(frozen=True)
class Linear:
    """A linear controller without JAX, as `synth` hands it over."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dt: float

    def init(self):
        return np.zeros(len(self.A))

    def step(self, x, y, r):
        e = r - y
        return self.A @ x + self.B @ e, self.C @ x + self.D @ e


@dataclass(frozen=True)
class Opaque:
    """A controller that JAX cannot trace."""

    gain: float
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, np.array([self.gain * float(r[0] - y[0])])


@dataclass(frozen=True)
class NotANumber:
    """Gives NaN from a given angle on."""

    limit: float
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, jnp.where(y[:1] > self.limit, jnp.nan, 0.0 * y[:1])


def pd(kp, kd, dt=0.05):
    return Linear(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.array([[kp, kd]]), dt)


def scenario(**changes):
    return replace(Scenario(initial=Swing(1.0, 0.0), dt=0.05, periods=100, samples=2, steps=2), **changes)


def cubesat_pd(dt=cubesat3u.CONTROL_PERIOD, wn=0.17, zeta=0.8):
    """Two states of roll-off on top of the PD law, so that the controller has a memory."""
    I = np.diag(cubesat3u.INERTIA)
    D = np.hstack([2 * wn**2 * I, 2 * zeta * wn * I])
    return Linear(0.5 * np.eye(3), 0.5 * D, np.eye(3) * 0.5, 0.5 * D, dt)


def cubesat(surroundings, controller=None, **changes):
    loop = Loop(
        plant=cubesat3u.body(),
        controller=controller or cubesat_pd(),
        sensors=cubesat3u.suite(),
        navigator=cubesat3u.ekf(),
        actuator=cubesat3u.wheels(),
    )
    scn = Scenario(
        initial=cubesat3u.initial_state(surroundings),
        dt=0.5,
        periods=60,
        samples=5,
        environment=surroundings,
    )
    return loop, replace(scn, **changes)
