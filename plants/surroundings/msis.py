"""NRLMSISE-00 through pymsis, an extra: `pip install 'convex-synth[msis]'`.

Air that knows day, night, season and the activity of Sun and field: Picone, Hedin, Drob and Aikin (2002), J. Geophys.
Res. 107 (A12). Of the models in pymsis this is the one without terms of its own (NRLMSIS 2 is for academic research).
It is called along a finished orbit, so it gives the density of `Environment.along`, not that of a `DragForce`.
"""

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from jax.typing import ArrayLike

from plants.checks import positive, real
from plants.errors import ScenarioError
from plants.surroundings.atmosphere import stay_between
from plants.surroundings.ephemeris import utc_of
from plants.surroundings.ground import ground_track

LOWEST, HIGHEST = 100e3, 1000e3  # () m above the ellipsoid
NRLMSISE_00 = 0  # as pymsis numbers its models


@dataclass(frozen=True, kw_only=True)
class Msis:
    """Air of NRLMSISE-00 under constant activity; build it with `create`."""

    f107: float  # () 1e-22 W/(m^2 Hz), solar flux at 10.7 cm on the day before
    f107_average: float  # () the same, mean over 81 days
    ap: float  # () daily geomagnetic index

    @classmethod
    def create(cls, f107: ArrayLike = 140.0, f107_average: ArrayLike | None = None, ap: ArrayLike = 15.0) -> "Msis":
        """Checked air; the default is a mean Sun and field.

        Parameters
        ----------
        f107 : () 1e-22 W/(m^2 Hz), solar flux at 10.7 cm: 70 is quiet, 220 active
        f107_average : () its mean over 81 days, by default `f107`
        ap : () geomagnetic index

        Raises
        ------
        ScenarioError
            NaN, a flux that is not positive, a negative index; pymsis is not installed.
        """
        try:
            import pymsis  # noqa: F401  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise ScenarioError("Msis needs pymsis: pip install 'convex-synth[msis]'") from error
        average = f107 if f107_average is None else f107_average
        return cls(
            f107=float(positive("f107", f107)),
            f107_average=float(positive("f107_average", average)),
            ap=float(real("ap", ap, low=0)),
        )

    def along(self, r: np.ndarray, epoch: datetime | None, times: np.ndarray) -> np.ndarray:
        """Density (..., n) kg/m^3; ScenarioError without an epoch, or below 100 or above 1000 km."""
        import pymsis  # pyright: ignore[reportMissingImports]

        if epoch is None:
            raise ScenarioError("epoch is missing: the air of Msis depends on where the Sun is")
        stay_between(LOWEST, HIGHEST, r, times)
        track = ground_track(r, epoch, times)
        start = np.datetime64(utc_of(epoch, float(times[-1])), "us")
        dates = start + np.round(np.asarray(times) * 1e6).astype("timedelta64[us]")
        n = track.altitude.size
        out = pymsis.calculate(
            np.broadcast_to(dates, track.altitude.shape).ravel(),
            np.degrees(track.longitude).ravel(),
            np.degrees(track.latitude).ravel(),
            track.altitude.ravel() / 1e3,
            np.full(n, self.f107),
            np.full(n, self.f107_average),
            np.full((n, 7), self.ap),
            version=NRLMSISE_00,
        )
        return np.asarray(out)[:, pymsis.Variable.MASS_DENSITY].astype(float).reshape(track.altitude.shape)
