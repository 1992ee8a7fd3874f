"""A campaign of pendulums that takes a moment, for tests of campaigns, stores and engines."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from flown import Pendulum, Swing

from plants.simulation import campaign
from plants.simulation.simulate import Loop, Scenario


class Draw(NamedTuple):
    length: float
    angle: float


@dataclass(frozen=True)
class Encoder:
    """Angle and rate with white noise."""

    noise: float

    @property
    def channels(self):
        return 2

    def init(self):
        return ()

    def measure(self, s, x, env, noise, h):
        return s, jnp.stack([x.angle, x.rate]) + self.noise * noise


@dataclass(frozen=True)
class Direct:
    """The measurement is the estimate."""

    gain: float = 1.0

    def init(self):
        return ()

    def update(self, s, y, u, env, h):
        return s, self.gain * y


@dataclass(frozen=True)
class Damper:
    gain: float
    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.gain * (r - y)[1:]


@dataclass(frozen=True)
class HostDamper(Damper):
    """The same, but JAX cannot trace it."""

    def step(self, s, y, r):
        return s, np.array([self.gain * (float(r[1]) - float(y[1]))])


def sample(seed, index):
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Draw(length=rng.uniform(0.5, 2.0), angle=rng.uniform(-1, 1))


def case(d, controller):
    loop = Loop(plant=Pendulum(float(d.length)), controller=controller, sensors=Encoder(0.01), navigator=Direct())
    return loop, Scenario(initial=Swing(float(d.angle), 0.0), dt=0.05, periods=40, samples=2)


def last(run):
    return {"last": run.estimates[-1] if run.ok else np.full(2, np.inf), "rows": len(run.time)}


def read(loop, scenario):
    return Draw(loop.plant.length, scenario.initial.angle)


def fly(dispersed=None, controller=None, **options):
    dispersed = campaign.draw(sample, 23, 5) if dispersed is None else dispersed
    options = {"measure": last, "progress": False, **options}
    return campaign.campaign(case, dispersed, controller or Damper(1.0), **options)
