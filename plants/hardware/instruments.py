"""Instruments: what every sensor of a spacecraft is, and any set of them as one block of a loop.

An instrument is a frozen dataclass of the numbers of its data sheet. Its state holds what it remembers, its reading
is a NamedTuple of finite numbers with a `valid` of 1 or 0: a blind instrument reads zero. What the environment does
not model (NaN) is no blindness: the reading is NaN, and the run says that the sensors failed.

A filter does not know an instrument, only its `innovation`: what was read less what is expected at an attitude, with
its slopes and variances. An instrument of a user's own serves in the filter if it has

    innovation(reading, q, own, env)   an `Innovation` at the attitude q (4,)
    deviation                          1 sigma of its scalars, above zero
    pair(reading, env)                 optional: a `Pair`, to find a first attitude
    parameters                         optional: what the filter may estimate of it as own (3,)

Reference: Markley and Crassidis (2014), chapters 4 and 6.

Attitudes are those of the body relative to frame N (inertial). Small rotations are vectors in rad about body axes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks

ARCSEC = np.pi / 180 / 3600  # rad: "8 arcsec, 1 sigma" is 8 * ARCSEC
DEG_PER_SQRT_H = np.pi / 180 / 60  # rad/sqrt(s): an angle random walk of 0.1 deg/sqrt(h) is 0.1 * DEG_PER_SQRT_H
DEG_PER_H = np.pi / 180 / 3600  # rad/s: a bias instability of 0.5 deg/h is 0.5 * DEG_PER_H


class Instrument(Protocol):
    """What is measured, such as by a star tracker."""

    @property
    def channels(self) -> int:
        """Number of independent standard normal numbers that one sample takes."""
        ...

    def init(self) -> Any:
        """State before the first sample."""
        ...

    def measure(self, s: Any, x: Any, env: Any, noise: Any, h: Any) -> tuple[Any, Any]:
        """New state and reading; `h` s have passed since the last sample, 0 at the first."""
        ...


class Innovation(NamedTuple):
    """What m scalars of a reading tell of an attitude, to first order."""

    z: Array  # (m,) read less expected
    attitude: Array  # (m, 3) slope of what is expected when the body turns by a small rotation, per rad
    own: Array  # (m, k) slope along the instrument's own parameters, k = 0 for none
    variance: Array  # (m,) of the noise of the scalars, which is independent
    valid: Array  # (m,) 1 or 0


class Direction(NamedTuple):
    """Reading of an instrument that gives a vector."""

    vector: Array  # (3,) body axes as believed, not normalised; zero if blind
    valid: Array  # () 1 or 0


class Pair(NamedTuple):
    """A direction seen from the body and what it is in frame N: two of them fix an attitude."""

    body: Array  # (3,) of any length
    reference: Array  # (3,) of any length
    deviation: Array  # () rad, 1 sigma per axis
    valid: Array  # () 1 or 0


@partial(blocks.node, data_fields=["instruments"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class SensorSuite:
    """Any set of instruments, sampled together: state and measurement are tuples in their order."""

    instruments: tuple[Any, ...]

    @classmethod
    def create(cls, instruments: Sequence[Instrument]) -> "SensorSuite":
        """The suite of these instruments; ScenarioError for what is none.

        Two that are alike are two entries of the list, and have noise of their own.
        """
        if not isinstance(instruments, list | tuple) or not instruments:
            raise ScenarioError(f"instruments = {instruments!r}: give a list of at least one")
        for i, instrument in enumerate(instruments):
            absent = [name for name in ("channels", "init", "measure") if not hasattr(instrument, name)]
            if absent or isinstance(instrument, type):
                raise ScenarioError(
                    f"instruments[{i}] = {instrument!r} is no instrument: it needs {', '.join(absent) or 'numbers'}; "
                    "build one by its `create`, such as StarTracker.create(...)"
                )
        return cls(instruments=tuple(instruments))

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return sum(instrument.channels for instrument in self.instruments)

    def init(self) -> tuple[Any, ...]:
        """The states of all."""
        return tuple(instrument.init() for instrument in self.instruments)

    def measure(
        self, s: tuple[Any, ...], x: Any, env: Any, noise: Array, h: ArrayLike
    ) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """New states and readings of all; each has the next of the normal numbers."""
        ends = np.cumsum([0] + [instrument.channels for instrument in self.instruments])
        both = [
            instrument.measure(s[i], x, env, noise[ends[i] : ends[i + 1]], h)
            for i, instrument in enumerate(self.instruments)
        ]
        return tuple(new for new, _ in both), tuple(reading for _, reading in both)


def tick(wait: Array, period: ArrayLike, h: ArrayLike) -> tuple[Array, Array]:
    """Clock of an instrument that reads every `period` s at most: h s later, new () s to wait and whether it is due.

    Readings fall on samples. A period that is no whole number of them is kept on average.
    """
    wait = wait - h
    due = wait <= 1e-6 * jnp.asarray(period)
    return jnp.where(due, jnp.maximum(wait + period, 0.0), wait), due


def within(cosine: Array, limit: ArrayLike) -> Array:
    """1 where the cosine is at least the limit, else 0; NaN where it is NaN, for what is not modelled."""
    return jnp.where(jnp.isnan(cosine), jnp.nan, (cosine >= limit).astype(float))


def mounting_of(boresight: Given) -> np.ndarray:
    """Attitude (4,) relative to the body of a sensor whose z axis is the boresight (3,): turned there the short way.

    Raises
    ------
    ScenarioError
        Wrong shape, NaN, a boresight that is not of length one.
    """
    b = unit("boresight", boresight)
    across = b[0] ** 2 + b[1] ** 2
    if across == 0 and b[2] < 0:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.array([1 + b[2] if b[2] > 0 else across / (1 - b[2]), -b[1], b[0], 0.0])
    return q / np.linalg.norm(q)


def unit(name: str, value: Given, size: int = 3) -> Numbers:
    """Vector of length one; ScenarioError otherwise. A traced one is taken at its word."""
    v = real(name, value, (size,))
    if isinstance(v, np.ndarray) and abs(np.linalg.norm(v) - 1) > 1e-6:
        raise ScenarioError(f"{name} must be of length one, got {v.tolist()} of length {np.linalg.norm(v):g}")
    return v


def distortion(scale_factor: Given, misalignment: Given, nonorthogonality: Given) -> np.ndarray:
    """Matrix (3, 3) from the true vector in body axes to what three imperfect axes give.

    Parameters
    ----------
    scale_factor : () or (3,) relative error, 1e-3 for 1000 ppm
    misalignment : (3,) rad, rotation of the axes from where they are believed
    nonorthogonality : (3,) rad, by which y leans towards x, z towards x, and z towards y

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, a scale factor of -1 or less.
    """
    k = real("scale_factor", scale_factor, (3,) if np.ndim(scale_factor) else (), low=-1 + 1e-9)
    a, b, c = real("nonorthogonality", nonorthogonality, (3,))
    lean = np.array([[1.0, 0, 0], [np.sin(a), np.cos(a), 0], [np.sin(b), np.sin(c), 1]])
    lean[2, 2] = np.sqrt(max(1 - lean[2, 0] ** 2 - lean[2, 1] ** 2, 0.0))
    with jax.enable_x64(True):
        turned = np.asarray(attitude.dcm(attitude.from_vector(real("misalignment", misalignment, (3,)))))
    return (1 + k * np.ones(3))[:, None] * (lean @ turned)


def direction_innovation(y: Direction, reference: Array, q: Array, own: Array, deviation: ArrayLike) -> Innovation:
    """Innovation of a direction read in body axes with `deviation` () rad per axis, at the attitude q (4,).

    The sensor's own parameters, if a filter estimates them, are its misalignment (3,) rad about body axes.
    """
    true = attitude.rotate(q, reference)
    slope = attitude.cross_matrix(true)  # a body turned by a small a sees true - a x true
    expected = true
    if own.shape[0]:
        turn = attitude.from_vector(own)
        expected, slope = attitude.rotate(turn, true), attitude.dcm(turn) @ slope
    ones = jnp.ones(3)
    return Innovation(
        z=jnp.where(y.valid > 0, y.vector - expected, 0.0),
        attitude=slope,
        own=attitude.cross_matrix(expected)[:, : own.shape[0]],
        variance=jnp.asarray(deviation) ** 2 * ones,
        valid=y.valid * ones,
    )
