"""Chapters 1 and 2: what acts on the satellite, and where it goes when nobody holds it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import geo_controllers as design
import jax
import numpy as np

from plants import Loop, Reading, Rule, Scenario, Statement, Station, Table, geo, simulate_many
from plants.missions.geo import DAY, PRESSURE
from plants.surroundings import gravity, orbit
from plants.surroundings.disturbances import SOLAR_PRESSURE

if TYPE_CHECKING:
    from geo_flights import Study

DAYS, STEP = 2, 600.0  # section 2.3; s, between two rows
KEPLER = float((gravity.MU / geo.RATE**2) ** (1 / 3))  # m, where a sphere's gravity turns with the Earth
J2, J2_KEPLER, MOON, SUN, ALL = "J2", "J2, at Kepler's radius", "Moon", "Sun", "all"
LIGHT, EARTH = "sunlight", "Earth to degree 3"
OURS = "our date, longitude, area: the thesis says the 21st of June"
SAME = 1.0  # m, over two days: "never differs"
MEAN_MOON, POINTS = 384.4e6, 200  # m; instants at which directions are compared


class Drift(NamedTuple):
    """Two days without thrust from rest at the ideal point."""

    time: np.ndarray  # (N,) s
    position: np.ndarray  # (N, 3) m, from the ideal point
    radius: float  # m, of the ideal point

    @property
    def largest(self) -> np.ndarray:
        """(3,) m."""
        return np.abs(self.position).max(axis=0)

    @property
    def radial(self) -> np.ndarray:
        """(N, 1) m, r2 - r1: what the thesis draws."""
        return np.linalg.norm(self.position + self.radius * np.eye(3)[0], axis=1, keepdims=True) - self.radius


def satellites() -> dict[str, tuple[Station, bool]]:
    """(what acts, whether the pole moves) by name."""
    alone: dict[str, Any] = {"moon": 0.0, "sun": 0.0}
    bodies = {"moon": gravity.MU_MOON, "sun": gravity.MU_SUN}
    sphere = {"harmonics": gravity.SPHERE}
    return {
        J2: (Station.create(harmonics=gravity.OBLATE, **alone), False),
        J2_KEPLER: (Station.create(harmonics=gravity.OBLATE, radius=KEPLER, **alone), False),
        EARTH: (Station.create(**alone), False),
        MOON: (Station.create(**sphere, **alone | {"moon": bodies["moon"]}), False),
        SUN: (Station.create(**sphere, **alone | {"sun": bodies["sun"]}), False),
        LIGHT: (Station.create(**sphere, **alone, pressure=PRESSURE), False),
        ALL: (geo.satellite(), True),
    }


def drift(found: Study) -> None:
    """Every force alone, and all."""
    above, periods = geo.sky((DAYS + 1) * DAY), round(DAYS * DAY / STEP) + 1
    cases = {}
    for name, (plant, moves) in satellites().items():
        sky = above if moves else above.with_fixed_pole()
        scenario = Scenario(initial=geo.at_rest(), dt=STEP, periods=periods, environment=sky)
        cases[name] = Loop(plant=plant, controller=geo.Coast(dt=STEP)), scenario
    for (name, (loop, _)), run in zip(cases.items(), simulate_many([*cases.values()]), strict=True):
        found.drift[name] = Drift(run.time, run.outputs[:, :3], float(np.asarray(loop.plant.radius)))  # type: ignore[attr-defined]


def drift_table(found: Study) -> Table:
    """How far, by each force."""
    rows = [
        (name, f"{d.radius / 1e3:.3f}", *(f"{x / 1e3:.3f}" for x in (*d.largest, np.abs(d.radial).max())))
        for name, d in found.drift.items()
    ]
    return Table(
        "Two days without thrust",
        ("what acts", "ideal radius, km", "radial, km", "along, km", "normal, km", "radius error, km"),
        rows,
        note="Largest distance from the ideal point over two days from rest there, from 2007-06-21 at longitude 0, "
        "each force alone (J2: with the sphere's attraction) and all of them; Cr A/m = 0.026 m2/kg. The pole moves in "
        "the last row. Figures 2.4, 2.9, 2.10 and 2.12 draw the radius error.",
    )


def statements(found: Study) -> list[Statement]:
    """The claims of chapters 1 and 2."""

    def hill() -> list[Reading]:
        A, printed = geo.hill_model().A, design.relative_motion(found.rate).A
        return [Reading("", float(np.abs(A - printed).max() / np.abs(printed[3:, :3]).max()))]

    def balance() -> list[Reading]:
        mu, r = gravity.MU / 1e9, KEPLER / 1e3  # km^3/s^2, km
        printed = -((mu * r / r**2) ** 1.5) + mu / r**2
        corrected = -mu * r / r**3 + mu / r**2
        return [Reading("as printed", abs(printed)), Reading("corrected", abs(corrected))]

    def strengths() -> list[Reading]:
        moon = np.linalg.norm(_bodies()[0][0])
        sizes = (
            ("Moon at 384 400 km", gravity.MU_MOON / MEAN_MOON**3, 8.6e-14),
            ("Moon that day", gravity.MU_MOON / moon**3, 8.6e-14),
            ("Sun at 1 au", gravity.MU_SUN / gravity.AU**3, 3.96e-14),
        )
        return [Reading(name, abs(size / printed - 1), text=f"{size:.3g} per s2") for name, size, printed in sizes]

    def flux() -> list[Reading]:
        return [Reading("", abs(SOLAR_PRESSURE / 4.5e-6 - 1), text=f"{SOLAR_PRESSURE:.3g} N/m2")]

    def printed_c() -> list[Reading]:
        r, Re = KEPLER / 1e3, orbit.EARTH_RADIUS / 1e3  # km
        s = 3 * orbit.J2 * Re**2 / (8 * r**2) * 4
        kinds = {
            "without mu": s,
            "with mu, km and s": s * gravity.MU / 1e9,
            "with mu, km and min": s * gravity.MU / 1e9 * 3600,
        }
        return [Reading(name, abs(np.sqrt(3 * (1 + x) - 2) - 1)) for name, x in kinds.items()]

    def never() -> list[Reading]:
        return [
            Reading(f"ideal radius {d.radius / 1e3:.2f} km", float(d.largest.max()))
            for d in (found.drift[name] for name in (J2, J2_KEPLER))
        ]

    def towards() -> list[Reading]:
        angles = []
        for body, mu in zip(_bodies(), (gravity.MU_MOON, gravity.MU_SUN), strict=True):
            r = np.array([float(geo.satellite().radius), 0, 0])
            with jax.enable_x64(True):
                pull = np.array([gravity.third_body(r, b, mu) for b in body])
            cosine = (pull * body).sum(axis=1) / np.linalg.norm(pull, axis=1) / np.linalg.norm(body, axis=1)
            angles.append(float(np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max()))
        return [Reading(*pair) for pair in zip(("Moon", "Sun"), angles, strict=True)]

    return [
        Statement(
            "Relative motion about a circular orbit is Hill's (1.13)",
            "section 1.6",
            hill,
            Rule("entries of the derived linear model against the printed", "<=", 1e-6),
        ),
        Statement(
            "The nonlinear equations (1.6)",
            "section 1.5",
            balance,
            Rule("acceleration at rest at the ideal point", "<=", 1e-12, "km/s2"),
            depends="the exponent",
            why="3/2 belongs to the distance alone, not to the fraction",
        ),
        Statement(
            "mu / r^3 of Moon and Sun are 8.6e-14 and 3.96e-14 per s^2",
            "section 2.2.2",
            strengths,
            Rule("difference to the printed, relative", "<=", 0.02),
            printed="8.6e-14, 3.96e-14",
            depends="the Moon's distance",
            why="it changes by 12 % in a month, and its cube by 40 %",
        ),
        Statement(
            "The momentum flux of sunlight is 4.5e-6 kg/m/s^2 (2.12)",
            "section 2.2.3",
            flux,
            Rule("difference to the printed, relative", "<=", 0.02),
            printed="4.5e-6",
        ),
        Statement(
            "c of the equations with J2 (2.18, 3.15)",
            "section 2.3.1",
            printed_c,
            Rule("rate of the motion normal to the plane against n, relative", "<=", 0.01),
            depends="mu in c",
            why="mu does not belong into c: with it c is no pure number and changes with the unit of time",
        ),
        Statement(
            "With x = y = z = 0 the orbit under J2 never differs from the ideal one",
            "section 2.3.1",
            never,
            Rule("largest distance in two days", "<=", SAME, "m"),
            printed="0",
            depends="the radius of the ideal point",
            why="where J2 is in the balance of the orbit it holds; 42164.17 km is the balance of a sphere",
        ),
        Statement(
            "Moon and Sun push towards where they stand (2.22, 2.23, 2.26)",
            "section 2.3.2",
            towards,
            Rule(
                "angle between the acceleration relative to the Earth and the body, largest in two days",
                "<=",
                10,
                "deg",
            ),
            why="what is felt is the difference to what the Earth feels: a tide, away from the body on the far side",
        ),
    ]


def _bodies() -> Sequence[np.ndarray]:
    """Moon and Sun (POINTS, 3) m over two days, axes of the local frame."""
    above = geo.sky(DAYS * DAY + 1.0)
    with jax.enable_x64(True):
        env = jax.vmap(above.at)(np.linspace(0, DAYS * DAY, POINTS))
    return np.asarray(env.moon), np.asarray(env.sun)


def findings(found: Study) -> list[str]:
    """What chapter 2 does not say."""
    try:
        kepler, every, shape = (found.drift[name] for name in (J2_KEPLER, ALL, EARTH))
    except KeyError:
        return []
    return [
        f"Free drift: in two days all perturbations carry the satellite {every.largest[1] / 1e3:.1f} km along the "
        f"track, the Earth's shape beyond J2 {shape.largest[1]:.0f} m, which the thesis leaves out. Its ideal point, "
        f"at the radius of a sphere, is {every.radius - kepler.radius:.0f} m too low for an Earth with J2, which "
        f"alone makes {kepler.largest[1] / 1e3:.1f} km."
    ]
