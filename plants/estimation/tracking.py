"""Where a geostationary satellite is: measurements of its radius, radial rate, latitude and longitude.

The thesis's measurements (3.13), scaled to be lengths and speeds, with r1 the radius of the ideal point:

    (2 r1 x + x^2 + y^2 + z^2) / (2 r1),   ((r1 + x) x' + y y' + z z') / r1,   z,   r1 atan2(y, r1 + x)

The last, the longitude, is not the thesis's: without it y cannot be known.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Numbers
from scipy.linalg import expm

from plants.checks import positive, real
from plants.dynamics.relative import EARTH_RATE, Sky, SkyEnv, Station, StationState
from plants.errors import ScenarioError
from plants.estimation.updates import scalar_updates
from plants.simulation import blocks
from plants.simulation.programs import Program
from plants.simulation.simulate import rk4

SHOWS = ("radius", "radial rate", "latitude", "longitude")  # what the rows of a measurement come from
AXES = ("x (radial)", "y (east)", "z (north)", "x'", "y'", "z'")
LOST = 1000.0  # () m, an error that a day of tracking must bring down in any direction


@partial(blocks.node, data_fields=["noise"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class StateSensor:
    """Position and velocity as they are, plus white noise."""

    noise: ArrayLike  # (6,) m, m/s, one sigma of each sample

    @classmethod
    def create(cls, noise: ArrayLike) -> "StateSensor":
        """Checked sensor; ScenarioError for a wrong shape, NaN or a negative deviation."""
        return cls(noise=real("noise", noise, (6,), low=0))

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return 6

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def measure(
        self, s: tuple[()], x: StationState, env: object, noise: Array, h: ArrayLike
    ) -> tuple[tuple[()], Array]:
        """Position and velocity (6,)."""
        del env, h
        return s, jnp.concatenate([jnp.asarray(x.position), jnp.asarray(x.velocity)]) + self.noise * noise


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Unfiltered:
    """The measurement is the estimate."""

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def update(self, s: tuple[()], y: Array, u: Array, env: object, h: ArrayLike) -> tuple[tuple[()], Array]:
        """The measurement."""
        del u, env, h
        return s, y


@partial(blocks.node, data_fields=["radius", "noise"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Tracking:
    """The measurements at the head of this file, with white noise: four of them, or the thesis's three."""

    radius: ArrayLike  # () m, of the ideal point
    noise: ArrayLike  # (4,) or (3,) m, m/s, m, m, one sigma of each sample

    @classmethod
    def create(cls, radius: float, noise: ArrayLike) -> "Tracking":
        """Checked sensors.

        Parameters
        ----------
        radius : () m, of the ideal point
        noise : one sigma of radius m, radial rate m/s, height over the equator m and, unless it is not measured, of
            the distance along the equator m

        Raises
        ------
        ScenarioError
            NaN, a wrong shape, a deviation that is not positive.
        """
        rows = len(SHOWS) if np.shape(noise) == (len(SHOWS),) else len(SHOWS) - 1
        deviations = positive("noise", noise, (rows,))
        return cls(radius=real("radius", radius, low=1.0), noise=deviations)

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return np.shape(self.noise)[0]

    def init(self) -> tuple[()]:
        """No state."""
        return ()

    def measure(
        self, s: tuple[()], x: StationState, env: object, noise: Array, h: ArrayLike
    ) -> tuple[tuple[()], Array]:
        """Measurement (4,) or (3,) of the state x."""
        del env, h
        return s, self.expected(jnp.concatenate([jnp.asarray(x.position), jnp.asarray(x.velocity)])) + (
            self.noise * noise
        )

    def expected(self, x: ArrayLike) -> Array:
        """Measurement without noise of position and velocity x (6,). Equation 3.13, scaled."""
        p, v = jnp.split(jnp.asarray(x), 2)
        radius = p[0] + jnp.sum(p * p) / (2 * self.radius)
        rate = v[0] + jnp.sum(p * v) / self.radius
        longitude = self.radius * jnp.arctan2(p[1], self.radius + p[0])
        return jnp.stack([radius, rate, p[2], longitude])[: np.shape(self.noise)[0]]


class Observability(NamedTuple):
    """What a series of measurements tells of a state: the best filter's errors without any other knowledge."""

    deviations: np.ndarray  # (6,) m, standard errors along the directions, largest first; velocities over the rate
    directions: np.ndarray  # (6, 6) unit rows in (x, y, z, x'/n, y'/n, z'/n)

    def hidden(self, limit: float = LOST) -> list[str]:
        """The directions that stay unknown by more than `limit` m, each by its largest components."""
        return [
            " and ".join(AXES[i] for i in np.flatnonzero(np.abs(row) > 0.5 * np.abs(row).max()))
            for row, deviation in zip(self.directions, self.deviations, strict=True)
            if not deviation <= limit
        ]


def observability(
    model: Station, sensors: Tracking, above: Sky, x: ArrayLike, *, h: float, samples: int
) -> Observability:
    """What `samples` measurements tell of a state, h s apart and without pushes in between, to first order.

    The singular values of H, H F, H F^2, ... over the noise, with F = expm(A h) and the slopes A of the dynamics and
    H of the measurement at the state x (6,); their inverses are standard errors, infinite for a direction that no
    measurement depends on.
    """
    x = real("x", x, (6,))
    with jax.enable_x64(True):
        A, H = (np.asarray(a) for a in _slopes(model, sensors, above, x))
    scale = np.repeat([1.0, EARTH_RATE], 3)
    F, H = expm(A * h) * scale / scale[:, None], H * scale / np.asarray(sensors.noise)[:, None]
    rows = [H]
    for _ in range(samples - 1):
        rows.append(rows[-1] @ F)
    _, values, directions = np.linalg.svd(np.vstack(rows))
    values = np.where(values > np.finfo(float).eps * values[0], values, 0.0)
    with np.errstate(divide="ignore"):
        return Observability(deviations=1 / values[::-1], directions=directions[::-1])


class TrackingState(NamedTuple):
    """State of `StationEkf`."""

    x: Array  # (9,) position m, velocity m/s, unknown acceleration m/s^2
    P: Array  # (9, 9) its covariance


@dataclass(frozen=True, kw_only=True)
class StationEkf:
    """Extended Kalman filter for position, velocity and an unknown acceleration; build it with `station_ekf`.

    The acceleration walks at random: it takes up what the model leaves out, such as the tides of Moon and Sun.
    Slopes of dynamics and measurement are derived by `jax.jacfwd`, at the estimate.
    """

    model: Station  # what the filter believes
    sensors: Tracking
    push: ArrayLike  # () m/s^2, one sigma of a random acceleration, new in every sample
    walk: ArrayLike  # () m/s^2/sqrt(s), of the unknown acceleration
    guess: ArrayLike  # (6,) m, m/s
    deviation: ArrayLike  # (9,) m, m/s, m/s^2, of the first guess

    def init(self) -> TrackingState:
        """The first guess."""
        x = jnp.concatenate([jnp.asarray(self.guess), jnp.zeros(3)])
        return TrackingState(x, jnp.diag(jnp.asarray(self.deviation) ** 2))

    def update(self, s: TrackingState, y: Array, u: Array, env: SkyEnv, h: ArrayLike) -> tuple[TrackingState, Array]:
        """Predict over the h s during which u acted, then correct by the measurement: new state, estimate (6,)."""
        x, P = jax.lax.optimization_barrier(self.predict(s, u, env, h))
        known = jnp.ones(y.shape[0])
        H = jnp.pad(jax.jacfwd(self.sensors.expected)(x[:6]), ((0, 0), (0, 3)))
        e, P = scalar_updates(P, y - self.sensors.expected(x[:6]), H, jnp.asarray(self.sensors.noise) ** 2, known)
        return TrackingState(x + e, P), (x + e)[:6]

    def predict(self, s: TrackingState, u: Array, env: SkyEnv, h: ArrayLike) -> tuple[Array, Array]:
        """State (9,) and covariance (9, 9) h s later."""
        p, v, d = jnp.split(s.x, 3)
        new = rk4(self.model, StationState(p, v, jnp.zeros(3)), u + d, [env] * 3, h)
        A = jnp.zeros((9, 9)).at[:6, :6].set(_dynamics(self.model, s.x[:6], env)).at[3:6, 6:].set(jnp.eye(3)) * h
        F = jnp.eye(9) + A + A @ A / 2 + A @ A @ A / 6
        step = jnp.vstack([h**2 / 2 * jnp.eye(3), h * jnp.eye(3), jnp.zeros((3, 3))]) * self.push
        Q = step @ step.T + jnp.diag(jnp.repeat(jnp.array([0.0, 0.0, 1.0]), 3)) * h * self.walk**2
        return jnp.concatenate([new.position, new.velocity, d]), F @ s.P @ F.T + Q


def station_ekf(
    model: Station,
    sensors: Tracking,
    above: Sky,
    *,
    push: float,
    walk: float,
    h: float,
    guess: Numbers = (0.0,) * 6,
    deviation: Numbers = (1e3, 1e3, 1e3, 0.1, 0.1, 0.1, 1e-5, 1e-5, 1e-5),
) -> StationEkf:
    """A filter that can do what it is for.

    Parameters
    ----------
    model : what is believed of the satellite and of what acts on it
    sensors : of which it takes the noise
    above : surroundings of the first guess
    push : () m/s^2, one sigma of a random acceleration, new in every sample
    walk : () m/s^2/sqrt(s), of an unknown acceleration
    h : () s, between two samples
    guess, deviation : (6,) m, m/s; (9,) m, m/s, m/s^2, standard deviation of the first guess

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, negative deviations; sensors from which a day of tracking leaves a direction unknown: the
        message names it.
    """
    first = real("guess", guess, (6,))
    positive("h", h)
    seen = observability(model, sensors, above, first, h=h, samples=max(round(86400 / h), 2))
    if seen.hidden():
        raise ScenarioError(
            f"{', '.join(SHOWS[: sensors.channels])} do not show {', '.join(seen.hidden())}: after a day its standard "
            f"error is {seen.deviations[0] / 1e3:.3g} km; measure the {SHOWS[-1]} too"
        )
    return StationEkf(
        model=model,
        sensors=sensors,
        push=real("push", push, low=0),
        walk=real("walk", walk, low=0),
        guess=first,
        deviation=real("deviation", deviation, (9,), low=0),
    )


def _dynamics(model: Station, x: ArrayLike, env: SkyEnv) -> Array:
    """Slope (6, 6) of the rate of position and velocity."""

    def rate(x: Array) -> Array:
        change = model.derivative(StationState(x[:3], x[3:], jnp.zeros(3)), jnp.zeros(3), env)
        return jnp.concatenate([jnp.asarray(change.position), jnp.asarray(change.velocity)])

    return jax.jacfwd(rate)(jnp.asarray(x))


@Program
def _slopes(model: Station, sensors: Tracking, above: Sky, x: Array) -> tuple[Array, Array]:
    """Slopes of dynamics (6, 6) and measurement (rows, 6)."""
    return _dynamics(model, x, above.at(0.0)), jax.jacfwd(sensors.expected)(x)
