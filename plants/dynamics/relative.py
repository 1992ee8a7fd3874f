"""Motion relative to a point that stands still over the Earth's equator.

Frame H turns with the Earth: x is radial, outwards through the point, y east, z along the pole. A satellite at
r = radius e_x + rho moves by

    rho'' = a(r) + u - 2 w x rho' - w' x r - w x (w x r)

with everything that acts in a(r). The rate w of the frame is that of the Earth's rotation about the celestial
intermediate pole, and of the pole itself (3e-12 rad/s, yet in resonance with the motion in z: 12 m in two days). No
term is linearised, and an inertial integration differenced against the point gives the same.
"""

from dataclasses import dataclass, replace
from datetime import datetime
from functools import partial
from typing import NamedTuple

import erfa
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.interpolate import CubicSpline

from plants.checks import Numbers, positive, real
from plants.geometry.attitude import cross
from plants.simulation import blocks
from plants.surroundings import gravity, table
from plants.surroundings.ephemeris import EARTH_RATE, STEP, about_pole, julian, moon_position, pole, sun_position
from plants.surroundings.gravity import Harmonics


class SkyEnv(NamedTuple):
    """Surroundings at one time, axes of frame H."""

    moon: Array  # (3,) m, from the Earth's centre
    sun: Array  # (3,) m, from the Earth's centre
    w: Array  # (3,) rad/s, inertial rate of frame H
    dw: Array  # (3,) rad/s^2, its derivative


@partial(blocks.node, data_fields=["splines", "angle"], meta_fields=["step", "duration"])
@dataclass(frozen=True, kw_only=True)
class Sky:
    """Moon, Sun and the motion of the pole, from splines; build it with `Sky.over`.

    The table is in axes that follow the pole and do not turn with the Earth (celestial intermediate reference
    system), in which everything is slow; `at` turns it. UT1 = UTC, no polar motion.
    """

    splines: Numbers  # (n, 4, 9) cubic coefficients of every interval: Moon, Sun, rate of the axes
    angle: Numbers  # () rad, from the axes of the table to frame H at t = 0
    step: float  # () s, length of an interval
    duration: float  # () s, from the epoch

    @classmethod
    def over(cls, longitude: float, epoch: datetime, duration: float) -> "Sky":
        """Surroundings of the point at `longitude` for `duration` s from `epoch`.

        Parameters
        ----------
        longitude : () rad, east
        epoch : UTC (a datetime without time zone is taken as UTC)
        duration : () s

        Raises
        ------
        ScenarioError
            NaN, a duration that is not positive, an epoch before 1972 or after 2029.
        """
        real("longitude", longitude)
        positive("duration", duration)
        times = STEP * np.arange(max(int(np.ceil(duration / STEP)) + 2, 5))
        utc1, utc2, _, _ = julian(epoch, times)
        axes = pole(epoch, times)  # (n, 3, 3)
        moon, sun = moon_position(epoch, times), sun_position(epoch, times)
        turning = CubicSpline(times / STEP, axes).derivative()(times / STEP) / STEP @ np.swapaxes(axes, 1, 2)
        rate = np.stack([turning[:, 1, 2], turning[:, 2, 0], turning[:, 0, 1]], axis=-1)  # turning is -[rate x]
        columns = [(axes @ moon[..., None])[..., 0], (axes @ sun[..., None])[..., 0], rate]
        return cls(
            splines=table.splines(np.concatenate(columns, axis=-1)),
            angle=np.asarray(erfa.era00(utc1, utc2[0]) + longitude),
            step=STEP,
            duration=float(duration),
        )

    def with_fixed_pole(self) -> "Sky":
        """The same with a pole that does not move, as in textbooks."""
        fixed = self.splines * np.where(np.arange(9) < 6, 1.0, 0.0)
        return replace(self, splines=fixed)

    def at(self, t: ArrayLike) -> SkyEnv:
        """Surroundings at t () s; all NaN outside [0, duration]."""
        place = table.piece(self.splines, self.step, self.duration, t)
        row, slope = table.value(*place), table.slope(*place) / self.step
        spin = jnp.array([0.0, 0.0, EARTH_RATE])
        turn = self.angle + EARTH_RATE * jnp.asarray(t)
        tilt = about_pole(turn, row[6:9])
        return SkyEnv(
            moon=about_pole(turn, row[0:3]),
            sun=about_pole(turn, row[3:6]),
            w=spin + tilt,
            dw=about_pole(turn, slope[6:9]) - cross(spin, tilt),
        )


class StationState(NamedTuple):
    """State of a satellite near its station, axes of frame H."""

    position: ArrayLike  # (3,) m, from the ideal point
    velocity: ArrayLike  # (3,) m/s, relative to it
    spent: ArrayLike  # (3,) m/s, integral of |acceleration by thrusters| of each axis


@partial(blocks.node, data_fields=["radius", "harmonics", "moon", "sun", "pressure"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Station:
    """A satellite near a geostationary point; its input is the acceleration (3,) m/s^2 by its thrusters.

    Build it with `Station.create`. To switch a force off set its strength to zero.
    """

    radius: Numbers  # () m, of the ideal point
    harmonics: Harmonics  # of the Earth, in the axes of frame H
    moon: Numbers  # () m^3/s^2
    sun: Numbers  # () m^3/s^2
    pressure: Numbers  # () m^2/kg, reflection coefficient times area over mass

    @classmethod
    def create(
        cls,
        longitude: float = 0.0,
        *,
        harmonics: Harmonics = gravity.EGM96,
        moon: float = gravity.MU_MOON,
        sun: float = gravity.MU_SUN,
        pressure: float = 0.0,
        radius: float | None = None,
    ) -> "Station":
        """A satellite at a longitude.

        Parameters
        ----------
        longitude : () rad, east
        harmonics : of the Earth, such as `gravity.EGM96`, `gravity.OBLATE`, `gravity.SPHERE`
        moon, sun : () m^3/s^2, gravitational parameters
        pressure : () m^2/kg, reflection coefficient times area over mass
        radius : () m, of the ideal point; by default where gravity and C20 balance the Earth's rotation

        Raises
        ------
        ScenarioError
            NaN, negative strengths, a radius inside the Earth.
        """
        balanced = gravity.station_radius(EARTH_RATE, harmonics)
        return cls(
            radius=real("radius", balanced if radius is None else radius, low=gravity.EARTH_RADIUS),
            harmonics=harmonics.seen_from(float(real("longitude", longitude))),
            moon=real("moon", moon, low=0),
            sun=real("sun", sun, low=0),
            pressure=real("pressure", pressure, low=0),
        )

    def derivative(self, x: StationState, u: ArrayLike, env: SkyEnv) -> StationState:
        """Time derivative of the state under the acceleration u (3,) m/s^2."""
        u, v = jnp.asarray(u), jnp.asarray(x.velocity)
        r = jnp.asarray(x.position).at[0].add(self.radius)
        frame = 2 * cross(env.w, v) + cross(env.dw, r) + cross(env.w, cross(env.w, r))
        return StationState(position=v, velocity=self.acceleration(r, env) + u - frame, spent=jnp.abs(u))

    def acceleration(self, r: ArrayLike, env: SkyEnv) -> Array:
        """What acts at r (3,) m from the Earth's centre apart from thrusters: (3,) m/s^2."""
        return (
            gravity.earth(r, self.harmonics)
            + gravity.third_body(r, env.moon, self.moon)
            + gravity.third_body(r, env.sun, self.sun)
            + gravity.sunlight(r, env.sun, self.pressure)
        )

    def output(self, x: StationState, env: SkyEnv) -> Array:
        """(6,) position m and velocity m/s."""
        del env
        return jnp.concatenate([jnp.asarray(x.position), jnp.asarray(x.velocity)])

    def project(self, x: StationState) -> StationState:
        """The state as it is."""
        return x
