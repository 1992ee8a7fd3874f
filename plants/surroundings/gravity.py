"""What pulls and pushes a high satellite: the Earth's shape to degree 3, Moon and Sun, sunlight.

Everything is an acceleration at a position in axes that turn with the Earth about its pole, x in the equator at a
longitude of choice. References: Montenbruck and Gill (2000), Satellite Orbits, sections 3.2 to 3.4; Lemoine et al.
(1998), NASA/TP-1998-206861, for the coefficients of EGM96.
"""

from dataclasses import dataclass
from functools import partial

import erfa
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, positive
from plants.geometry.attitude import cross, dot
from plants.simulation import blocks
from plants.surroundings.disturbances import SOLAR_PRESSURE
from plants.surroundings.environment import visible_fraction
from plants.surroundings.orbit import EARTH_RADIUS, MU

MU_MOON = 4.902800e12  # () m^3/s^2  IERS Conventions (2010), table 1.1: the Earth's times 0.0123000371
MU_SUN = 1.32712442099e20  # () m^3/s^2  IERS Conventions (2010), table 1.1
AU = erfa.DAU  # () m

ORDERS = np.array([0, 1, 2, 0, 1, 2, 3])  # of the terms (2,0) (2,1) (2,2) (3,0) (3,1) (3,2) (3,3)
DEGREES = np.array([2, 2, 2, 3, 3, 3, 3])
# EGM96, fully normalised
COSINES = np.array([
    -0.484165371736e-3, -0.186987635955e-9, 0.243914352398e-5,
    0.957254173792e-6, 0.202998882184e-5, 0.904627768605e-6, 0.721072657057e-6,
])  # fmt: skip
SINES = np.array([
    0.0, 0.119528012031e-8, -0.140016683654e-5,
    0.0, 0.248513158716e-6, -0.619025944205e-6, 0.141435626958e-5,
])  # fmt: skip
# sqrt((2 - [m = 0]) (2 l + 1) (l - m)! / (l + m)!)
NORMALISATION = np.sqrt([5, 5 / 3, 5 / 12, 7, 7 / 6, 7 / 60, 7 / 360])


@partial(blocks.node, data_fields=["cosine", "sine"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Harmonics:
    """Coefficients C and S of the potential, not normalised, in the order of `ORDERS` and `DEGREES`."""

    cosine: Numbers  # (7,)
    sine: Numbers  # (7,)

    def seen_from(self, longitude: float) -> "Harmonics":
        """The coefficients in axes whose x axis is at `longitude` rad instead of 0."""
        c, s = np.cos(ORDERS * longitude), np.sin(ORDERS * longitude)
        return Harmonics(cosine=self.cosine * c + self.sine * s, sine=self.sine * c - self.cosine * s)

    def potential(self, r: ArrayLike) -> Array:
        """Potential at r (3,) m beyond that of a sphere, () m^2/s^2. The thesis's equation 2.3.

        A term is mu Re^l / r^(2l+1) times r^l P_lm(sin latitude) (C cos m longitude + S sin m longitude), a
        polynomial of degree l in x, y, z.
        """
        x, y, z = jnp.asarray(r)
        square = x * x + y * y + z * z
        even = [1.5 * z * z - 0.5 * square, 3 * x * z, 3 * (x * x - y * y),
                z * (2.5 * z * z - 1.5 * square), x * (7.5 * z * z - 1.5 * square), 15 * z * (x * x - y * y),
                15 * x * (x * x - 3 * y * y)]  # fmt: skip
        odd = [0 * x, 3 * y * z, 6 * x * y,
               0 * x, y * (7.5 * z * z - 1.5 * square), 30 * x * y * z,
               15 * y * (3 * x * x - y * y)]  # fmt: skip
        scale = (
            MU / jnp.sqrt(square) * jnp.stack([(EARTH_RADIUS / square) ** 2] * 3 + [(EARTH_RADIUS / square) ** 3] * 4)
        )
        return jnp.sum(scale * (jnp.asarray(self.cosine) * jnp.stack(even) + self.sine * jnp.stack(odd)))


EGM96 = Harmonics(cosine=COSINES * NORMALISATION, sine=SINES * NORMALISATION)
OBLATE = Harmonics(cosine=np.where(np.arange(7) == 0, EGM96.cosine, 0.0), sine=np.zeros(7))  # J2 alone
SPHERE = Harmonics(cosine=np.zeros(7), sine=np.zeros(7))


def earth(r: ArrayLike, harmonics: Harmonics) -> Array:
    """Acceleration (3,) m/s^2 by the Earth at r (3,) m."""
    r = jnp.asarray(r)
    square = dot(r, r)
    return -MU / (square * jnp.sqrt(square)) * r + jax.grad(harmonics.potential)(r)


def third_body(r: ArrayLike, body: ArrayLike, mu: ArrayLike) -> Array:
    """Acceleration (3,) m/s^2 at r by a body at `body`, relative to the Earth's centre; both (3,) m from there.

    The difference of what the body does to the satellite and to the Earth; it does not point at the body.
    """
    body = jnp.asarray(body)
    d = body - jnp.asarray(r)
    return jnp.asarray(mu) * (d / dot(d, d) ** 1.5 - body / dot(body, body) ** 1.5)


def sunlight(r: ArrayLike, sun: ArrayLike, coefficient: ArrayLike) -> Array:
    """Acceleration (3,) m/s^2 at r by radiation from the Sun at `sun`; both (3,) m from the Earth's centre.

    Parameters
    ----------
    coefficient : () m^2/kg, reflection coefficient times area over mass

    Notes
    -----
    The shadow is `sunlit`; the pressure falls with the square of the distance from the Sun.
    """
    d = sun - jnp.asarray(r)
    square = dot(d, d)
    push = SOLAR_PRESSURE * AU**2 * jnp.asarray(coefficient) * sunlit(r, sun)
    return -push / (square * jnp.sqrt(square)) * d


def sunlit(r: ArrayLike, sun: ArrayLike) -> Array:
    """Visible fraction () of the solar disc at r (3,) m behind a spherical Earth, from 0 to 1.

    The disc crosses the limb as in `plants.surroundings.environment`, so the edge of the shadow is as soft as it is in
    truth: at geostationary height it takes 2 minutes to cross, of the 70 that the longest shadow lasts.
    """
    r = jnp.asarray(r)
    d = sun - r
    across = cross(r, d)
    behind = jnp.arctan2(jnp.sqrt(dot(across, across)), -dot(r, d))  # angle from the Earth's centre to the Sun's
    return visible_fraction(behind - jnp.arcsin(EARTH_RADIUS / jnp.sqrt(dot(r, r))))


def station_radius(rate: float, harmonics: Harmonics) -> float:
    """Radius in m of the equatorial circle on which a satellite turns at `rate` rad/s, under C20 alone.

    The root of rate^2 r = mu / r^2 + 3/2 J2 mu Re^2 / r^4, by Newton's method.

    Raises
    ------
    ScenarioError
        A rate that is not positive and finite.
    """
    positive("rate", rate)
    oblate = -1.5 * float(harmonics.cosine[0]) * EARTH_RADIUS**2
    r = (MU / rate**2) ** (1 / 3)
    for _ in range(5):
        excess = rate**2 * r - MU / r**2 - oblate * MU / r**4
        r -= excess / (rate**2 + 2 * MU / r**3 + 4 * oblate * MU / r**5)
    return r
