"""Time, Sun, Moon and the Earth's rotation.

Frame N is the GCRS. The Earth turns by IAU 2006/2000A precession-nutation and the Earth rotation angle, with UT1 = UTC
and no polar motion.
"""

from datetime import UTC, datetime, timedelta
from typing import NamedTuple

import erfa
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.errors import ScenarioError
from plants.surroundings import table

DAY = 86400.0  # () s
EARLIEST, LATEST = datetime(1972, 1, 1), datetime(2030, 1, 1)  # UTC with leap seconds; IGRF-14
EARTH_RATE = 2 * np.pi * 1.00273781191135448 / DAY  # () rad/s  of the Earth rotation angle, IERS (2010), eq. 5.15
STEP = 3600.0  # () s, of a table of Moon, Sun and pole: Moon and Sun within 0.1 m


class Heavens(NamedTuple):
    """Moon, Sun and the Earth's axes at one time."""

    moon: Array  # (3,) m from the Earth's centre, N
    sun: Array  # (3,) m from the Earth's centre, N
    to_earth: Array  # (3, 3) from N to axes that turn with the Earth (ITRS)


class Ephemeris(NamedTuple):
    """Table of Moon, Sun and pole every `STEP` s; build it with `Ephemeris.over`."""

    cubics: np.ndarray  # (n, 4, 15) Moon, Sun, axes of the celestial intermediate reference system
    angle: np.ndarray  # () rad, Earth rotation angle at the epoch
    duration: np.ndarray  # () s

    @classmethod
    def over(cls, epoch: datetime, duration: float) -> "Ephemeris":
        """Table for `duration` s from `epoch`; ScenarioError if that is not between 1972 and 2029."""
        times = STEP * np.arange(max(int(np.ceil(duration / STEP)) + 2, 5))
        utc1, utc2, _, _ = julian(epoch, times)
        columns = [moon_position(epoch, times), sun_position(epoch, times), pole(epoch, times).reshape(-1, 9)]
        return cls(
            cubics=table.splines(np.concatenate(columns, axis=-1)),
            angle=np.asarray(erfa.era00(utc1, utc2[0])),
            duration=np.asarray(float(duration)),
        )

    def at(self, t: ArrayLike) -> Heavens:
        """Moon, Sun and axes at t () s; all NaN outside [0, duration]."""
        row = table.value(*table.piece(self.cubics, STEP, self.duration, t))  # pyright: ignore[reportArgumentType]
        angle = self.angle + EARTH_RATE * jnp.asarray(t)
        return Heavens(moon=row[0:3], sun=row[3:6], to_earth=about_pole(angle, row[6:15].reshape(3, 3)))


def about_pole(angle: ArrayLike, v: Array) -> Array:
    """The vector v (3,), or the columns of a matrix (3, n), in axes turned by `angle` about z."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]])


def sun_position(epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Geocentric position of the Sun in m, frame N, at the times (n,) s after `epoch`: (n, 3). erfa.epv00."""
    _, _, tt1, tt2 = julian(epoch, times)
    heliocentric, _ = erfa.epv00(tt1, tt2)
    return -erfa.DAU * heliocentric["p"]


def moon_position(epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Geocentric position of the Moon in m, frame N, at the times (n,) s after `epoch`: (n, 3). erfa.moon98."""
    _, _, tt1, tt2 = julian(epoch, times)
    return erfa.DAU * erfa.moon98(tt1, tt2)["p"]


def pole(epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Turn from frame N to axes that follow the pole but not the Earth's rotation, (n, 3, 3). erfa.c2i06a."""
    _, _, tt1, tt2 = julian(epoch, times)
    return erfa.c2i06a(tt1, tt2)


def to_earth(epoch: datetime, times: np.ndarray) -> np.ndarray:
    """Turn from frame N to axes fixed to the Earth (ITRS) at the times (n,) s after `epoch`: (n, 3, 3). erfa.c2t06a."""
    utc1, utc2, tt1, tt2 = julian(epoch, times)
    return erfa.c2t06a(tt1, tt2, utc1, utc2, 0.0, 0.0)


def julian(epoch: datetime, times: np.ndarray) -> tuple[np.ndarray, ...]:
    """Two-part Julian dates, UTC and TT, at times (n,) s after the epoch."""
    utc = utc_of(epoch, float(times[-1]))
    seconds = utc.second + utc.microsecond * 1e-6
    utc1, utc2 = erfa.dtf2d("UTC", utc.year, utc.month, utc.day, utc.hour, utc.minute, seconds)
    tt1, tt2 = erfa.taitt(*erfa.utctai(utc1, utc2))
    return utc1, utc2 + times / DAY, tt1, tt2 + times / DAY


def utc_of(epoch: datetime, duration: float) -> datetime:
    """The epoch in UTC without time zone; ScenarioError if it, or the end of the run, is out of range."""
    if not isinstance(epoch, datetime):
        raise ScenarioError(f"epoch = {epoch!r}: give a datetime in UTC, such as datetime(2026, 3, 20, 12)")
    utc = epoch.astimezone(UTC).replace(tzinfo=None) if epoch.tzinfo else epoch
    if not EARLIEST <= utc <= LATEST - timedelta(seconds=duration):
        raise ScenarioError(
            f"epoch {epoch} with {duration:g} s to go must lie between {EARLIEST:%Y} (leap seconds) "
            f"and {LATEST:%Y} (IGRF-14): move it"
        )
    return utc
