"""Star tracker: an inertial attitude at its own rate, after a delay, blind near the Sun and the Earth or when it turns.

Its frame S has the boresight as z axis. Noise is a small rotation about the axes of S: the roll about the boresight
is known several times worse than where the boresight points. Markley and Crassidis (2014), section 4.3.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.instruments import Innovation, mounting_of, tick, unit, within
from plants.simulation import blocks
from plants.surroundings.orbit import EARTH_RADIUS


class StarFix(NamedTuple):
    """Reading of a star tracker."""

    q: Array  # (4,) attitude of frame S relative to N when the exposure was made; zero if there is none
    age: Array  # () s since that exposure
    exposed: Array  # () 1 if an exposure is made now, seeing stars or not, else 0
    valid: Array  # () 1 or 0


class Exposures(NamedTuple):
    """State of `StarTracker`."""

    wait: Array  # () s until the next exposure
    q: Array  # (depth, 4) of exposures whose fix is under way, newest first
    age: Array  # (depth,) s since they were made
    open: Array  # (depth,) 1 until the fix is given
    valid: Array  # (depth,) 1 if the exposure saw stars


@partial(
    blocks.node,
    data_fields=[
        "cross_noise", "boresight_noise", "mounting", "misalignment", "period", "delay", "sun_exclusion",
        "earth_exclusion", "fastest",
    ],
    meta_fields=["depth"],
)  # fmt: skip
@dataclass(frozen=True, kw_only=True)
class StarTracker:
    """A star tracker. Build it with `StarTracker.create`, which checks the numbers."""

    cross_noise: ArrayLike  # () rad, 1 sigma of a fix about each axis across the boresight
    boresight_noise: ArrayLike  # () rad, about the boresight
    mounting: Numbers  # (4,) attitude of S relative to the body, as believed
    misalignment: Numbers  # (3,) rad, rotation of the true S from the believed one, axes of S
    period: ArrayLike  # () s between two exposures, 0 for one at every sample
    delay: ArrayLike  # () s from an exposure to its fix
    sun_exclusion: ArrayLike | None  # () rad, least angle from the boresight to the Sun
    earth_exclusion: ArrayLike | None  # () rad, least angle from the boresight to the limb of the Earth
    fastest: ArrayLike  # () rad/s, rate of the body above which stars smear
    depth: int  # exposures whose fix is under way at once, at most

    @classmethod
    def create(
        cls,
        *,
        cross_noise: float,
        boresight_noise: float | None = None,
        boresight: Given | None = None,
        mounting: Given | None = None,
        misalignment: Given = (0.0, 0.0, 0.0),
        period: float = 0.0,
        delay: float = 0.0,
        sun_exclusion: float | None = None,
        earth_exclusion: float | None = None,
        fastest: float = np.inf,
    ) -> "StarTracker":
        """A star tracker from its data sheet; angles of arc seconds are numbers times `ARCSEC`.

        Parameters
        ----------
        cross_noise : () rad, 1 sigma of a fix about each axis across the boresight
        boresight_noise : () rad, about the boresight; eight times the other if absent
        boresight : (3,) unit vector in body axes, z by default; the roll about it is that of the shortest turn there
        mounting : (4,) attitude of the sensor relative to the body instead, where the roll matters
        misalignment : (3,) rad, of the true sensor from the believed one, axes of the sensor
        period : () s between exposures, 1 / update rate; 0 for one at every sample
        delay : () s from an exposure to its fix
        sun_exclusion : () rad, blind with the Sun nearer to the boresight; not modelled if absent
        earth_exclusion : () rad, blind with the limb of the Earth nearer to the boresight; not modelled if absent
        fastest : () rad/s, blind when the body turns faster

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, negative numbers, a boresight or quaternion not of length one, both of them; a delay
            without the period, from which follows how many fixes are under way.
        """
        if boresight is not None and mounting is not None:
            raise ScenarioError("boresight and mounting say the same twice: give one of them")
        cross = real("cross_noise", cross_noise, low=0)
        wait, late = real("period", period, low=0), real("delay", delay, low=0)
        if late > 0 and not wait > 0:
            raise ScenarioError(f"delay = {delay} s needs the period of the tracker too: give period = 1 / update rate")
        limits = {
            name: None if value is None else real(name, value, low=0)
            for name, value in (("sun_exclusion", sun_exclusion), ("earth_exclusion", earth_exclusion))
        }
        return cls(
            cross_noise=cross,
            boresight_noise=8 * cross if boresight_noise is None else real("boresight_noise", boresight_noise, low=0),
            mounting=mounting_of((0.0, 0.0, 1.0) if boresight is None else boresight)
            if mounting is None
            else unit("mounting", mounting, 4),
            misalignment=real("misalignment", misalignment, (3,)),
            period=wait,
            delay=late,
            **limits,
            fastest=positive("fastest", fastest, infinite=True),
            depth=math.ceil(late / wait - 1e-9) if late > 0 else 0,
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 3

    @property
    def parameters(self) -> str:
        """What a filter may estimate of it, (3,)."""
        return "misalignment, rad"

    @property
    def deviation(self) -> Array:
        """1 sigma of a fix about the axes of S, (3,) rad."""
        return jnp.stack([jnp.asarray(a) for a in (self.cross_noise, self.cross_noise, self.boresight_noise)])

    def init(self) -> Exposures:
        """No exposure yet; the first is made at the first sample."""
        n = self.depth
        return Exposures(jnp.zeros(()), jnp.zeros((n, 4)), jnp.zeros(n), jnp.zeros(n), jnp.zeros(n))

    def measure(self, s: Exposures, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Exposures, StarFix]:
        """The fix that is ready, if there is one, and an exposure if it is time; needs x.q, x.w and what may blind."""
        wait, due = tick(s.wait, self.period, h)
        q_SN = attitude.compose(
            attitude.from_vector(noise * self.deviation + self.misalignment), attitude.compose(self.mounting, x.q)
        )
        seen = due * self.sight(x, env)
        new = seen * q_SN
        if not self.depth:
            return s._replace(wait=wait), StarFix(new, jnp.zeros(()), due.astype(float), seen)
        age = s.age + h
        ready = s.open * (age >= self.delay - 1e-6 * jnp.asarray(self.period))
        oldest = ready * (jnp.cumsum(ready[::-1])[::-1] == 1)  # of those that are ready; the others wait for a sample
        fix = StarFix(oldest @ s.q, oldest @ age, due.astype(float), oldest @ s.valid)

        def push(value: Any, queue: Array) -> Array:
            return jnp.where(due, jnp.concatenate([jnp.asarray(value)[None], queue[:-1]]), queue)

        return Exposures(wait, push(new, s.q), push(0.0, age), push(1.0, s.open - oldest), push(seen, s.valid)), fix

    def sight(self, x: Any, env: Any) -> Array:
        """1 if it sees stars from the state x, 0 if not; NaN where what may blind it is not modelled."""
        w = jnp.asarray(x.w)
        seen = (attitude.dot(w, w) <= jnp.asarray(self.fastest) ** 2).astype(float)
        q_SN = attitude.compose(attitude.from_vector(self.misalignment), attitude.compose(self.mounting, x.q))
        boresight = attitude.rotate(attitude.conjugate(q_SN), jnp.array([0.0, 0.0, 1.0]))
        if self.sun_exclusion is not None:
            dazzled = within(attitude.dot(boresight, env.sun), jnp.cos(self.sun_exclusion)) * within(env.sunlit, 1e-12)
            seen = seen * (1 - dazzled)
        if self.earth_exclusion is not None:
            distance = jnp.sqrt(attitude.dot(env.r, env.r))
            radius = jnp.arcsin(jnp.minimum(EARTH_RADIUS / distance, 1.0))
            nadir = -attitude.dot(boresight, env.r) / distance
            seen = seen * (1 - within(nadir, jnp.cos(jnp.minimum(radius + self.earth_exclusion, jnp.pi))))
        return seen

    def innovation(self, y: StarFix, q: Array, own: Array, env: Any) -> Innovation:
        """Rotation from the expected fix to the one read, axes of S, at the attitude q (4,) when it was exposed.

        The tracker's own parameters, if a filter estimates them, are its misalignment (3,) rad.
        """
        del env
        q_SB = jnp.asarray(self.mounting)
        if own.shape[0]:
            q_SB = attitude.compose(attitude.from_vector(own), q_SB)
        read = jnp.where(y.valid > 0, y.q, jnp.array([1.0, 0.0, 0.0, 0.0]))
        error = attitude.compose(read, attitude.conjugate(attitude.compose(q_SB, q)))
        return Innovation(
            z=attitude.to_vector(error),
            attitude=attitude.dcm(q_SB),
            own=jnp.eye(3)[:, : own.shape[0]],
            variance=self.deviation**2,
            valid=y.valid * jnp.ones(3),
        )

    def body_attitude(self, y: StarFix) -> Array:
        """The attitude (4,) of the body when the fix was exposed, as believed; of no meaning without a fix."""
        return attitude.compose(attitude.conjugate(self.mounting), y.q)
