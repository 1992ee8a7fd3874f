"""Forces on an orbit: against an integration of their formulas in NumPy, closed forms of theory, mistakes."""

from dataclasses import dataclass
from datetime import datetime

import erfa
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import lpmv

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.surroundings import gravity, orbit
from plants.surroundings.atmosphere import Atmosphere, LayeredAtmosphere
from plants.surroundings.disturbances import SOLAR_PRESSURE
from plants.surroundings.environment import Environment
from plants.surroundings.ephemeris import EARTH_RATE, Ephemeris
from plants.surroundings.forces import DragForce, EarthShape, MoonGravity, PressureForce, SunGravity
from plants.surroundings.orbit import EARTH_RADIUS, J2, MU, Oblateness, Orbit

EPOCH = datetime(2024, 3, 20, 9)
LOW = orbit.circular(470e3, np.deg2rad(51.6), 2.0, 0.4)
HIGH = orbit.keplerian(24500e3, 0.72, 0.4, 1.0, 2.0, -1.0)
AIR = LayeredAtmosphere(highest=np.inf)
EVERYTHING = (EarthShape(), MoonGravity(), SunGravity(), DragForce.create(0.02, AIR), PressureForce.create(0.03))
TIMES = np.arange(0.0, 6001.0, 10.0)  # s


def dates(t):
    utc = erfa.dtf2d("UTC", 2024, 3, 20, 9, 0, 0.0)
    tt = erfa.taitt(*erfa.utctai(*utc))
    return utc[0], utc[1] + t / 86400, tt[0], tt[1] + t / 86400


def to_earth(t):
    utc1, utc2, tt1, tt2 = dates(t)
    return erfa.rz(erfa.era00(utc1, utc2), erfa.c2i06a(tt1, tt2))


def legendre_potential(r):
    """Degree 2 and 3 of EGM96 by the Legendre functions of SciPy; r in axes of the Earth."""
    distance, longitude = np.linalg.norm(r), np.arctan2(r[1], r[0])
    total = 0.0
    for degree, m, c, s in zip(gravity.DEGREES, gravity.ORDERS, gravity.EGM96.cosine, gravity.EGM96.sine, strict=True):
        P = (-1) ** m * lpmv(m, degree, r[2] / distance)
        wave = c * np.cos(m * longitude) + s * np.sin(m * longitude)
        total += MU / distance * (EARTH_RADIUS / distance) ** degree * P * wave
    return total


def harmonics(t, r):
    """By differences over 100 m."""
    W, e = to_earth(t), 50.0 * np.eye(3)
    return W.T @ [(legendre_potential(W @ r + d) - legendre_potential(W @ r - d)) / 100.0 for d in e]


def third(t, r, body, mu):
    d = body - r
    return mu * (d / np.linalg.norm(d) ** 3 - body / np.linalg.norm(body) ** 3)


def moon(t):
    return erfa.DAU * erfa.moon98(*dates(t)[2:])["p"]


def sun(t):
    return -erfa.DAU * erfa.epv00(*dates(t)[2:])[0]["p"]


def everything(t, state):
    """Right-hand side with all of `EVERYTHING`, no line of it from `plants` but the tables of air and harmonics."""
    r, v = state[:3], state[3:]
    distance = np.linalg.norm(r)
    flow = v - np.cross([0, 0, EARTH_RATE], r)
    height = distance - EARTH_RADIUS * (1 - (r[2] / distance) ** 2 / 298.257223563)
    air = float(AIR.at(np.array([EARTH_RADIUS + height, 0.0, 0.0])))
    away = r - sun(t)
    ahead = np.linalg.norm(away)
    limb = np.arccos(r @ away / distance / ahead) - np.arcsin(EARTH_RADIUS / distance)  # Sun above the Earth's limb
    x = np.clip(limb / (6.957e8 / erfa.DAU), -1, 1)
    a = (
        -MU / distance**3 * r + harmonics(t, r) + third(t, r, moon(t), 4.902800e12)
        + third(t, r, sun(t), 1.32712442099e20) - 0.5 * 0.02 * air * np.linalg.norm(flow) * flow
        + 0.03 * 4.54e-6 * (erfa.DAU / ahead) ** 2 * (0.5 + 0.25 * x * (3 - x**2)) * away / ahead
    )  # fmt: skip
    return np.concatenate([v, a])


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def flights():
    """Both orbits under everything, in one program."""
    return orbit.propagate(Orbit(np.stack([LOW.r, HIGH.r]), np.stack([LOW.v, HIGH.v])), TIMES, EVERYTHING, EPOCH)


def one(force, r, v, t=0.0):
    return np.asarray(force.acceleration(np.asarray(r), np.asarray(v), Ephemeris.over(EPOCH, 86400.0).at(t)))


@pytest.mark.slow
@pytest.mark.parametrize("lane", [0, 1])
def test_an_adaptive_integration_of_the_formulas_ends_at_the_same_place(flights, lane):
    """DOP853 in steps that do not jump over the edge of the shadow (free ones end 20 mm away, steps of 15 s 1 mm)."""
    start = (LOW, HIGH)[lane]
    exact = solve_ivp(everything, (0.0, 6000.0), np.concatenate(start), "DOP853", rtol=1e-13, atol=1e-9, max_step=10)
    assert np.linalg.norm(flights.r[lane, -1] - exact.y[:3, -1]) < 3e-4  # m
    kepler = orbit.propagate(start, TIMES, ())
    assert np.linalg.norm(flights.r[lane, -1] - kepler.r[-1]) > 1e3  # the forces do act


@pytest.mark.parametrize("t", [0.0, 40000.0, 86399.0])
def test_shape_of_the_earth_turns_with_it(t):
    for r in (LOW.r, HIGH.r, -1.3 * LOW.v * 1e3):
        np.testing.assert_allclose(one(EarthShape(), r, LOW.v, t), harmonics(t, r), rtol=0, atol=3e-10)


def test_shape_without_tesserals_is_nearly_the_oblateness():
    """They differ by the precession since 2000, 0.13 deg."""
    shape = EarthShape(gravity.OBLATE)
    np.testing.assert_allclose(one(shape, LOW.r, LOW.v), Oblateness().acceleration(LOW.r, LOW.v), rtol=0, atol=1e-4)
    difference = np.linalg.norm(one(shape, LOW.r, LOW.v) - Oblateness().acceleration(LOW.r, LOW.v))
    assert 1e-6 < difference < 1e-4


@pytest.mark.parametrize("t", [0.0, 5000.0, 86399.0])
def test_third_bodies_are_where_erfa_sees_them(t):
    """And the tide stretches towards the body and squeezes across it."""
    for force, body, mu in ((MoonGravity(), moon(t), gravity.MU_MOON), (SunGravity(), sun(t), gravity.MU_SUN)):
        np.testing.assert_allclose(one(force, HIGH.r, HIGH.v, t), third(t, HIGH.r, body, mu), rtol=1e-7)
        d = np.linalg.norm(body)
        along = body / d * 7e6
        across = np.cross(along, [0.0, 0.0, 1.0])
        tide, next_order = mu / d**3, 4 * 7e6 / d
        assert np.linalg.norm(one(force, along, along, t) - 2 * tide * along) < next_order * tide * 7e6
        assert np.linalg.norm(one(force, across, across, t) + tide * across) < next_order * tide * 7e6


def test_sunlight_pushes_away_from_the_sun_and_not_in_the_shadow():
    force = PressureForce.create(0.03)
    to_sun = sun(0.0) / np.linalg.norm(sun(0.0))
    lit = one(force, 7e6 * to_sun, LOW.v)
    pressure = 0.03 * SOLAR_PRESSURE * (erfa.DAU / np.linalg.norm(sun(0.0))) ** 2
    np.testing.assert_allclose(lit, -pressure * to_sun, rtol=1e-4)
    assert pressure == pytest.approx(0.03 * 4.54e-6, rel=0.034)
    np.testing.assert_array_equal(one(force, -7e6 * to_sun, LOW.v), 0.0)


@pytest.mark.parametrize(("inclination", "eccentricity"), [(0.6, 0.1), (np.arccos(np.sqrt(0.2)), 0.1), (2.3, 0.25)])
def test_oblateness_turns_node_and_perigee_as_theory_says(inclination, eccentricity):
    """Secular rates of first order, Vallado (2013), eqs. 9-37 and 9-39; the perigee stands still at 63.43 deg."""
    a = 9.8e6
    start = orbit.keplerian(a, eccentricity, inclination, 0.3, 1.0, 0.0)
    period, turns = 2 * np.pi * np.sqrt(a**3 / MU), 10
    flown = orbit.propagate(start, np.linspace(0.0, turns * period, 10001))
    got = orbit.elements(flown)
    scale = 2 * np.pi * J2 * (EARTH_RADIUS / (a * (1 - eccentricity**2))) ** 2  # rad, in one turn
    perigees = np.flatnonzero(np.diff(np.sign(got.true_anomaly)) > 0)
    last = perigees[-1]  # at a perigee the short-period terms are those of the start
    node = (np.unwrap(got.raan)[last] - 0.3) / len(perigees)
    perigee = (np.unwrap(got.argument_of_perigee)[last] - 1.0) / len(perigees)
    assert node == pytest.approx(-1.5 * scale * np.cos(inclination), rel=0.01)
    assert perigee == pytest.approx(0.75 * scale * (5 * np.cos(inclination) ** 2 - 1), rel=0.02, abs=0.02 * scale)


@pytest.mark.parametrize("ballistic", [0.01, 0.1])
def test_drag_lowers_a_circular_orbit_as_its_power_says(ballistic):
    """da/dt = -rho (w/v)^2 v a Cd A/m on the equator, w the speed through air that turns with the Earth."""
    start = orbit.keplerian(EARTH_RADIUS + 300e3, 0.0, 0.0)
    a, air = EARTH_RADIUS + 300e3, Atmosphere(3e-11, 300e3, 1e12)
    flown = orbit.propagate(start, TIMES, (DragForce.create(ballistic, air),), EPOCH)
    v = np.sqrt(MU / a)
    rate = -3e-11 * (v - EARTH_RATE * a) ** 2 / v * a * ballistic
    fallen = orbit.elements(Orbit(flown.r[-1], flown.v[-1])).semi_major_axis - a
    assert fallen == pytest.approx(rate * TIMES[-1], rel=1e-3)
    assert orbit.elements(Orbit(flown.r[-1], flown.v[-1])).inclination < 1e-12


def test_energy_and_momentum_change_by_what_the_forces_do(flights):
    """Work and torque of the formulas along the flight, summed by Simpson's rule."""
    r, v = flights.r[0], flights.v[0]
    beyond = np.array([everything(t, np.concatenate(s))[3:] for t, *s in zip(TIMES, r, v, strict=True)])
    beyond += MU / np.linalg.norm(r, axis=1, keepdims=True) ** 3 * r
    weights = np.where(np.arange(len(r)) % 2, 4.0, 2.0)
    weights[[0, -1]] = 1.0
    weights *= (TIMES[1] - TIMES[0]) / 3
    energy = 0.5 * np.sum(v * v, axis=1) - MU / np.linalg.norm(r, axis=1)
    work = weights @ np.sum(beyond * v, axis=1)
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-4)
    turn = weights @ np.cross(r, beyond)
    np.testing.assert_allclose(np.cross(r[-1], v[-1]) - np.cross(r[0], v[0]), turn, rtol=1e-4, atol=1e3)


def test_an_orbit_does_not_feel_its_companions(flights):
    for lane, start in enumerate((LOW, HIGH)):
        alone = orbit.propagate(start, TIMES, EVERYTHING, EPOCH)
        np.testing.assert_allclose(alone.r, flights.r[lane], rtol=0, atol=1e-5)  # m


def test_environment_flies_the_forces_and_its_frame_turns_with_them(flights):
    surroundings = Environment.along(LOW, EPOCH, 5980.0, forces=EVERYTHING)
    along = jax.jit(lambda t: jax.jvp(surroundings.at, (t,), (1.0,)))
    for t in (500.0, 3000.0):
        env, slope = along(t)
        np.testing.assert_allclose(env.r, flights.r[0, int(t / 10)], rtol=0, atol=1e-5)
        np.testing.assert_allclose(slope.q_ON, attitude.kinematics(env.q_ON, env.w_ON), rtol=0, atol=1e-11)
    old = Environment.along(LOW, EPOCH, 5980.0).at(3000.0)
    assert np.linalg.norm(old.r - env.r) > 50.0


@pytest.mark.parametrize("force", [*EVERYTHING, Oblateness()], ids=lambda force: type(force).__name__)
def test_a_force_twice_is_refused(force):
    with pytest.raises(ScenarioError, match="more than once"):
        orbit.propagate(LOW, TIMES, (force, force), EPOCH)


@pytest.mark.parametrize(
    ("forces", "epoch", "message"),
    [
        ((Oblateness(), EarthShape()), EPOCH, "the Earth's shape more than once"),
        ((MoonGravity(),), None, "epoch is missing: MoonGravity"),
        ((MoonGravity,), EPOCH, "objects such as.*MoonGravity"),
        (("J2",), EPOCH, "objects such as Oblateness"),
        ("J2", EPOCH, "forces must be a tuple"),
        (Oblateness(), EPOCH, "forces must be a tuple"),
        ((SunGravity(),), datetime(2031, 1, 1), "epoch"),
    ],
)
def test_wrong_forces_are_refused(forces, epoch, message):
    with pytest.raises(ScenarioError, match=message):
        orbit.propagate(LOW, TIMES, forces, epoch)


def test_numbers_of_forces_are_checked():
    for wrong in (-1.0, np.nan, "much", [1.0, 2.0]):
        with pytest.raises(ScenarioError, match="ballistic"):
            DragForce.create(wrong)
        with pytest.raises(ScenarioError, match="coefficient"):
            PressureForce.create(wrong)
    with pytest.raises(ScenarioError, match="can be compiled"):
        DragForce.create(0.01, 1e-12)


def test_an_orbit_that_comes_down_is_refused():
    """In air: below the layers; without: on the ground."""
    falling = Orbit(LOW.r, 0.9 * LOW.v)
    with pytest.raises(ScenarioError, match=r"km high at .* from 100 to 1000 km"):
        orbit.propagate(falling, TIMES, (Oblateness(), DragForce.create(0.02)), EPOCH)
    with pytest.raises(ScenarioError, match="on the ground at"):
        orbit.propagate(falling, TIMES)
    with pytest.raises(ScenarioError, match="on the ground at"):
        Environment.along(falling, EPOCH, 5980.0)


@dataclass(frozen=True)
class Thrust:
    """Along the velocity."""

    strength: float  # () m/s^2

    def acceleration(self, r, v, heavens):
        return self.strength * v / jax.numpy.linalg.norm(v)


def test_a_force_of_the_users_own_is_enough():
    """A slow spiral: da/dt = 2 a f / v, or 1/v falls linearly."""
    flown = orbit.propagate(LOW, TIMES, (Thrust(1e-5),), EPOCH)
    v0, a = np.linalg.norm(LOW.v), orbit.elements(Orbit(flown.r[-1], flown.v[-1])).semi_major_axis
    assert np.sqrt(MU / a) == pytest.approx(v0 - 1e-5 * TIMES[-1], rel=1e-6)


def test_a_list_will_do_and_nothing_is_keplers_motion():
    got = orbit.elements(orbit.propagate(HIGH, TIMES, []))
    for name, value, first in zip(got._fields, got, orbit.elements(HIGH), strict=True):
        if name != "true_anomaly":
            np.testing.assert_allclose(value, first, rtol=1e-9, atol=1e-10, err_msg=name)
