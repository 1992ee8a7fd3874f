"""Sun sensors: fine ones give a direction in a field of view, coarse ones are photocells that the Earth lights too.

The Earth's light is that of a sphere of one albedo, diffuse everywhere: a patch dA at the distance d sends the fraction
albedo / pi cos(to the Sun) cos(to the spacecraft) dA / d^2 of sunlight, from its own direction. Bhanderi and Bak
(2005), Modeling Earth albedo for satellites in Earth orbit, AIAA 2005-6465, with one reflectivity for all patches.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.directionsensors import FIELDS, DirectionSensor
from plants.hardware.instruments import Innovation, Pair, tick, within
from plants.simulation import blocks
from plants.surroundings.orbit import EARTH_RADIUS

DUSK = 0.5  # () visible fraction of the Sun below which a fine sensor gives no direction
RINGS, SECTORS = 8, 16  # patches of the Earth that are summed
ALBEDO = 0.3  # () of the Earth, the mean of all clouds and grounds


@partial(blocks.node, data_fields=FIELDS, meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class FineSunSensor(DirectionSensor):
    """Direction to the Sun, where at least half of its disc is in view. Build it with `create`, which checks."""

    def target(self, env: Any) -> Array:
        """Direction to the Sun (3,), frame N."""
        return env.sun

    def light(self, env: Any) -> Array:
        """Whether at least half of the disc is visible."""
        return within(env.sunlit, DUSK)


class Currents(NamedTuple):
    """Reading of photocells."""

    currents: Array  # (n,) of the current at right angles to full sunlight
    valid: Array  # () 1 or 0


@partial(blocks.node, data_fields=["noise", "normals", "half_angle", "albedo", "scale", "period"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class CoarseSunSensors:
    """Photocells whose current is the cosine of the angle to the light. Build them with `CoarseSunSensors.create`."""

    noise: ArrayLike  # () 1 sigma, of the current in full sunlight
    normals: Numbers  # (n, 3) unit vectors, body axes
    half_angle: ArrayLike  # () rad from the normal beyond which the mounting shades the cell
    albedo: ArrayLike | None  # () of the Earth
    scale: Numbers  # (n,) true sensitivity over the believed one
    period: ArrayLike  # () s between two readings, 0 for one at every sample

    @classmethod
    def create(
        cls,
        *,
        noise: float,
        normals: Given | None = None,
        half_angle: float = np.pi / 2,
        albedo: float | None = None,
        scale: Given | None = None,
        period: float = 0.0,
    ) -> "CoarseSunSensors":
        """Photocells, by default one on each of the six sides, +x, -x, +y, -y, +z, -z.

        Parameters
        ----------
        noise : () 1 sigma of each current, of the current in full sunlight
        normals : (n, 3) unit vectors in body axes
        half_angle : () rad from the normal, the field of view
        albedo : () of the Earth in [0, 1], such as `ALBEDO`; not modelled if absent
        scale : (n,) true sensitivity of each over the believed one; ones if absent
        period : () s between two readings; 0 for one at every sample

        Raises
        ------
        ScenarioError
            Wrong shapes, NaN, negative numbers, normals that are not of length one, an albedo above 1.
        """
        sides = real("normals", np.kron(np.eye(3), [[1.0], [-1.0]]) if normals is None else normals, (None, 3))
        if isinstance(sides, np.ndarray) and not np.allclose(np.linalg.norm(sides, axis=1), 1, rtol=0, atol=1e-6):
            raise ScenarioError(f"normals must be unit rows, got {sides.tolist()}: normalise them")
        light = None if albedo is None else real("albedo", albedo, low=0)
        if isinstance(light, np.ndarray) and light > 1:
            raise ScenarioError(f"albedo = {albedo}: give a fraction, at most 1")
        n = sides.shape[0]
        return cls(
            noise=real("noise", noise, low=0),
            normals=sides,
            half_angle=positive("half_angle", half_angle),
            albedo=light,
            scale=real("scale", np.ones(n) if scale is None else scale, (n,), low=0),
            period=real("period", period, low=0),
        )

    @property
    def channels(self) -> int:
        """Normal numbers per sample."""
        return np.shape(self.normals)[0]

    @property
    def deviation(self) -> ArrayLike:
        """1 sigma of each current, ()."""
        return self.noise

    def init(self) -> Array:
        """Time to the next reading, () s."""
        return jnp.zeros(())

    def measure(self, s: Array, x: Any, env: Any, noise: Array, h: ArrayLike) -> tuple[Array, Currents]:
        """Currents of the cells; in the shadow of the Earth they are noise."""
        wait, due = tick(s, self.period, h)
        currents = self.scale * self.light(x.q, env) + self.noise * noise
        return wait, Currents(due * currents, due.astype(float))

    def light(self, q: Array, env: Any) -> Array:
        """Light on each cell (n,) at the attitude q (4,), of full sunlight at right angles."""
        light = env.sunlit * self.response(attitude.rotate(q, env.sun))
        if self.albedo is None:
            return light
        towards, strength = earth_light(env.r, env.sun)
        return light + self.albedo * (strength @ self.response(attitude.rotate(q[None], towards)))

    def response(self, direction: Array) -> Array:
        """Cosine between light from a direction (..., 3), body axes, and the normals in whose view it is: (..., n)."""
        cosine = direction @ jnp.asarray(self.normals).T
        seen = cosine > jnp.cos(jnp.minimum(self.half_angle, jnp.pi / 2))
        return jnp.where(seen, cosine, 0.0 * cosine)

    def innovation(self, y: Currents, q: Array, own: Array, env: Any) -> Innovation:
        """Currents less the expected ones, the Earth's light included if the instrument is told of it."""

        def expected(a: Array) -> Array:
            return self.light(attitude.compose(attitude.from_vector(a), q), env)

        level = expected(jnp.zeros(3))
        ones = jnp.ones_like(level)
        return Innovation(
            z=jnp.where(y.valid > 0, y.currents - level, 0.0),
            attitude=jax.jacfwd(expected)(jnp.zeros(3)),
            own=jnp.zeros((level.shape[0], own.shape[0])),
            variance=jnp.asarray(self.noise) ** 2 * ones,
            valid=y.valid * ones,
        )

    def pair(self, y: Currents, env: Any) -> Pair:
        """Direction by least squares over the lit cells, the Earth's light taken for an error of its size."""
        normals = jnp.asarray(self.normals)
        lit = (y.currents > jnp.maximum(3 * jnp.asarray(self.noise), 0.1)).astype(float)
        square = (lit[:, None] * normals).T @ normals
        seen = y.valid * within(env.sunlit, DUSK) * (jnp.linalg.det(square) > 0.1)
        read = jnp.linalg.solve(jnp.where(seen > 0, square, jnp.eye(3)), (lit * y.currents) @ normals)
        stray = 0.0 if self.albedo is None else jnp.asarray(self.albedo) / 2
        return Pair(seen * read, env.sun, jnp.sqrt(jnp.asarray(self.noise) ** 2 + stray**2), seen)


def earth_light(r: ArrayLike, sun: ArrayLike) -> tuple[Array, Array]:
    """Sunlight from the Earth at r (3,) m with the Sun along `sun` (3,): directions (p, 3) and strengths (p,).

    Strengths are for an albedo of 1, of full sunlight; a cell gets the sum of strength times cosine, at most (Earth's
    radius / |r|)^2. A patch of the solid angle dw, as the spacecraft sees it, has cos(to the Sun) / pi dw. Gauss's rule
    in the cosine of the angle from nadir, equal steps around.
    """
    r = jnp.asarray(r)
    distance = jnp.sqrt(attitude.dot(r, r))
    up, ratio = r / distance, jnp.minimum(EARTH_RADIUS / distance, 1.0)
    nodes, weights = np.polynomial.legendre.leggauss(RINGS)
    limb = jnp.sqrt(1 - ratio**2)
    cosine = limb + (1 - limb) * (nodes + 1) / 2  # of the angle from nadir
    sine = jnp.sqrt(1 - cosine**2)
    around = 2 * np.pi * np.arange(SECTORS) / SECTORS
    east = attitude.normalise(attitude.cross(jnp.eye(3)[jnp.argmin(jnp.abs(up))], up))
    ring = np.cos(around)[:, None] * east + np.sin(around)[:, None] * attitude.cross(up, east)
    towards = sine[:, None, None] * ring - cosine[:, None, None] * up
    way = cosine - jnp.sqrt(jnp.maximum(ratio**2 - sine**2, 0.0))  # to the ground, in units of the distance
    lit = jnp.maximum((up + way[:, None, None] * towards) @ jnp.asarray(sun) / ratio, 0.0)
    solid = (1 - limb) / 2 * weights * 2 * np.pi / SECTORS
    return towards.reshape(-1, 3), (lit * solid[:, None]).ravel() / np.pi
