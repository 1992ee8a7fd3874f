"""Motion relative to a geostationary point: printed linear models, an inertial integration by SciPy, conserved energy.

Drift figures: an independent propagator with IAU frames and EGM2008 agreed to 50 m; they are rounded to 100 m.
"""

from dataclasses import replace
from datetime import datetime

import erfa
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import lpmv

from plants.dynamics.relative import EARTH_RATE, Sky, Station
from plants.errors import ScenarioError
from plants.missions import geo
from plants.simulation.loop import Loop, Scenario
from plants.simulation.simulate import simulate_many
from plants.surroundings import gravity, orbit

EPOCH = datetime(2007, 6, 21)
DAY = 86400.0
N = EARTH_RATE


STILL = gravity.SPHERE
ALONE = {"moon": 0.0, "sun": 0.0, "pressure": 0.0}


def drift(plant, above, start=np.zeros(6), days=2):  # noqa: B008
    scenario = Scenario(initial=geo.at_rest(start), dt=600.0, periods=round(days * 144) + 1, environment=above)
    return Loop(plant=plant, controller=geo.Coast(dt=600.0)), scenario


@pytest.fixture(scope="module")
def flights():
    """Two days from rest or a start, one compiled batch."""
    above = Sky.over(0.0, EPOCH, 3 * DAY)
    fixed = above.with_fixed_pole()
    start = np.array([1e3, -2e3, 1.5e3, 0.2, -0.1, 0.3])
    cases = {
        "all": drift(geo.satellite(), above),
        "J2": drift(Station.create(harmonics=gravity.OBLATE, **ALONE), fixed),
        "J2, Kepler's radius": drift(Station.create(harmonics=gravity.OBLATE, **ALONE, radius=42164172.37), fixed),
        "Earth": drift(Station.create(0.7, **ALONE), fixed, start),
        "sphere": drift(Station.create(harmonics=STILL, **ALONE), fixed, start),
        "dark": drift(replace(geo.satellite(), pressure=np.zeros(())), above),
    }
    runs = simulate_many(list(cases.values()))
    assert all(run.ok for run in runs)
    return dict(zip(cases, runs, strict=True))


def test_hill_model_is_the_printed_one():
    """The thesis's 1.6 linearised: x'' = 2 n y' + 3 n^2 x, y'' = -2 n x', z'' = -n^2 z."""
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * N**2, 2 * N, -2 * N, -(N**2)
    model = geo.hill_model()
    np.testing.assert_allclose(model.A, A, rtol=1e-9, atol=1e-20)
    np.testing.assert_array_equal(model.B, np.eye(6)[:, 3:])


def test_oblate_model_is_that_of_schweighart_and_sedwick():
    """Equation 3.14 as corrected: c = sqrt(1 + s) without mu, c in both Coriolis terms, A(4,5) = 0, B is 6 x 3.

    n is the rate of a sphere at that radius, so that the frame turns at n c: the Earth's rate.
    """
    r = gravity.station_radius(N, gravity.OBLATE)
    s = 3 * orbit.J2 * orbit.EARTH_RADIUS**2 / (8 * r**2) * (1 + 3 * np.cos(0.0))
    n, c = np.sqrt(orbit.MU / r**3), np.sqrt(1 + s)
    assert c == pytest.approx(1.0000186, abs=1e-7)
    assert n * c == pytest.approx(N, rel=1e-12)
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = (5 * c**2 - 2) * n**2, 2 * n * c, -2 * n * c, -(3 * c**2 - 2) * n**2
    np.testing.assert_allclose(geo.oblate_model().A, A, rtol=1e-9, atol=1e-20)


def test_free_drift(flights):
    """All perturbations, two days from 2007-06-21 at longitude 0: 2.2, 15.5 and 2.0 km."""
    np.testing.assert_allclose(np.abs(flights["all"].outputs[:, :3]).max(axis=0), [2200, 15500, 2000], rtol=0, atol=100)


def test_oblateness_alone_keeps_the_ideal_point_at_its_own_radius_only(flights):
    """At Kepler's 42164.17 km the satellite is 39.4 km away after two days."""
    assert np.abs(flights["J2"].outputs[:, :3]).max() < 1e-5
    away = np.linalg.norm(flights["J2, Kepler's radius"].outputs[-1, :3])
    assert away == pytest.approx(39400, abs=100)


@pytest.mark.parametrize("name", ["Earth", "sphere", "J2, Kepler's radius"])
def test_jacobi_integral(flights, name):
    """Energy in the turning frame, of a potential that stands still in it."""
    plant = {"Earth": Station.create(0.7, **ALONE), "sphere": Station.create(harmonics=STILL, **ALONE)}.get(
        name, Station.create(harmonics=gravity.OBLATE, **ALONE, radius=42164172.37)
    )
    p, v = np.split(flights[name].outputs, 2, axis=1)
    r = p + np.array([float(plant.radius), 0, 0])
    with jax.enable_x64(True):
        beyond = np.asarray(jax.vmap(plant.harmonics.potential)(r))
    energy = (v**2).sum(1) / 2 - N**2 * (r[:, :2] ** 2).sum(1) / 2 - orbit.MU / np.linalg.norm(r, axis=1) - beyond
    assert np.abs(energy - energy[0]).max() < 1e-6  # of 1.4e7 m^2/s^2; 1 cm of the semi-major axis is 1e-3


def test_kepler_limit(flights):
    """Around a sphere the orbit is an ellipse: Kepler's equation, turned into frame H."""
    run = flights["sphere"]
    r1 = gravity.station_radius(N, STILL)
    r0 = run.outputs[0, :3] + [r1, 0, 0]
    v0 = run.outputs[0, 3:] + np.cross([0, 0, N], r0)
    a = 1 / (2 / np.linalg.norm(r0) - v0 @ v0 / orbit.MU)
    n, root = np.sqrt(orbit.MU / a**3), r0 @ v0 / np.sqrt(orbit.MU * a)
    for t, y in zip(run.time[::36], run.outputs[::36], strict=True):
        q = 1 - np.linalg.norm(r0) / a

        def kepler(E, q=q, t=t):  # change of the eccentric anomaly
            return E - q * np.sin(E) + root * (1 - np.cos(E)) - n * t

        E = brentq(kepler, n * t - 1, n * t + 1, xtol=1e-15, rtol=1e-15)
        f = 1 - a / np.linalg.norm(r0) * (1 - np.cos(E))
        g = t - (E - np.sin(E)) / n
        c, s = np.cos(N * t), np.sin(N * t)
        r = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) @ (f * r0 + g * v0)
        bound = 1e-6 + (N * 600.0) ** 4 / 120 * N * t * np.linalg.norm(y[:3])  # of RK4 per radian, steps of 600 s
        np.testing.assert_allclose(y[:3], r - [r1, 0, 0], rtol=0, atol=bound)


def test_against_an_inertial_integration_with_erfa_in_every_step(flights):
    """DOP853 in the GCRS with the IAU frame, epv00 and moon98 at every evaluation, differenced against the point.

    It shares the coefficients and the radius with the plant, and no formula.
    """
    tai = erfa.utctai(*erfa.dtf2d("UTC", EPOCH.year, EPOCH.month, EPOCH.day, 0, 0, 0.0))
    tt, utc = erfa.taitt(*tai), erfa.dtf2d("UTC", EPOCH.year, EPOCH.month, EPOCH.day, 0, 0, 0.0)
    radius, cr = float(geo.satellite().radius), geo.PRESSURE

    def frame(t):
        return erfa.c2t06a(tt[0], tt[1] + t / DAY, utc[0], utc[1] + t / DAY, 0.0, 0.0)

    def body(r, at, mu):
        return mu * ((at - r) / np.linalg.norm(at - r) ** 3 - at / np.linalg.norm(at) ** 3)

    def rates(t, state):
        r, v = np.split(state, 2)
        M = frame(t)
        earth, _ = erfa.epv00(tt[0], tt[1] + t / DAY)
        sun, moon = -erfa.DAU * earth["p"], erfa.DAU * erfa.moon98(tt[0], tt[1] + t / DAY)["p"]
        away = r - sun
        light = 4.54e-6 * cr * erfa.DAU**2 / np.linalg.norm(away) ** 3 * away  # no eclipses in June
        return np.concatenate([v, M.T @ spherical_gradient(M @ r) + body(r, moon, 4.9028e12)
                               + body(r, sun, 1.32712442099e20) + light])  # fmt: skip

    def ideal(t):
        return frame(t).T @ [radius, 0, 0]

    h = 20.0  # s, of a five-point difference
    v0 = (8 * (ideal(h) - ideal(-h)) - (ideal(2 * h) - ideal(-2 * h))) / (12 * h)
    run = flights["all"]
    some = run.time[::48]
    flown = solve_ivp(rates, (0, some[-1]), [*ideal(0.0), *v0], "DOP853", some, rtol=1e-12, atol=1e-6).y[:3].T
    for t, r, y in zip(some, flown, run.outputs[::48], strict=True):
        np.testing.assert_allclose(frame(t) @ (r - ideal(t)), y[:3], rtol=0, atol=0.1)


def spherical_gradient(r):
    """The Earth's attraction at r (3,) in Earth-fixed axes, from derivatives in spherical coordinates."""
    distance, rho = np.linalg.norm(r), np.hypot(r[0], r[1])
    sine, longitude = r[2] / distance, np.arctan2(r[1], r[0])
    radial, north, east = -orbit.MU / distance**2, 0.0, 0.0
    for degree, m, c, s in zip(gravity.DEGREES, gravity.ORDERS, gravity.COSINES, gravity.SINES, strict=True):
        factor = np.prod([1.0 / k for k in range(degree - m + 1, degree + m + 1)]) * (2 * degree + 1) * (2 if m else 1)
        P, higher = (np.sqrt(factor) * (-1) ** k * lpmv(k, degree, sine) for k in (m, m + 1))
        slope = higher - m * r[2] / rho * P  # of P in the latitude
        scale = orbit.MU / distance**2 * (orbit.EARTH_RADIUS / distance) ** degree
        wave = c * np.cos(m * longitude) + s * np.sin(m * longitude)
        radial -= (degree + 1) * scale * P * wave
        north += scale * slope * wave
        east += scale * P * m * (s * np.cos(m * longitude) - c * np.sin(m * longitude)) * distance / rho
    up = r / distance
    e = np.array([-r[1], r[0], 0]) / rho
    return radial * up + north * np.cross(up, e) + east * e


def test_sunlight_in_two_days(flights):
    """1.2e-7 m/s^2, once around in a day: of the order of f / n^2 = 22 m in each radian, hundreds of metres in all."""
    away = np.abs(flights["all"].outputs[:, :3] - flights["dark"].outputs[:, :3]).max(axis=0)
    assert 50 < away[0] < 1000
    assert 100 < away[1] < 2000


def test_sky_is_that_of_erfa_between_its_points():
    longitude, times = 0.4, np.array([0.0, 1234.5, 100000.0, 172800.0])
    above = Sky.over(longitude, EPOCH, 172800.0)
    with jax.enable_x64(True):
        look = jax.jit(jax.vmap(above.at))
        got = jax.tree.map(np.asarray, look(times))
        before, after = (np.asarray(look(times[[1, 2, 2, 2]] + d).w)[:2] for d in (-5.0, 5.0))
    utc = erfa.dtf2d("UTC", 2007, 6, 21, 0, 0, 0.0)
    tt = erfa.taitt(*erfa.utctai(*utc))
    to_station = erfa.rz(longitude, np.eye(3))

    def frame(t):
        return to_station @ erfa.c2t06a(tt[0], tt[1] + t / DAY, utc[0], utc[1] + t / DAY, 0.0, 0.0)

    for i, t in enumerate(times):
        moon = erfa.DAU * erfa.moon98(tt[0], tt[1] + t / DAY)["p"]
        earth, _ = erfa.epv00(tt[0], tt[1] + t / DAY)
        np.testing.assert_allclose(got.moon[i], frame(t) @ moon, rtol=0, atol=1.0)
        np.testing.assert_allclose(got.sun[i], -erfa.DAU * (frame(t) @ earth["p"]), rtol=0, atol=1e2)
        turning = (frame(t + 50) - frame(t - 50)) @ frame(t).T / 100
        w = [turning[1, 2], turning[2, 0], turning[0, 1]]
        np.testing.assert_allclose(got.w[i, :2], w[:2], rtol=1e-3, atol=1e-15)  # the pole: 3e-12 rad/s
        assert got.w[i, 2] == pytest.approx(w[2], rel=3e-6)
    np.testing.assert_allclose((after - before)[:, :2] / 10, got.dw[1:3, :2], rtol=1e-3, atol=1e-22)
    with jax.enable_x64(True):
        outside = look(np.array([-1.0, 172801.0, 1e6, -1e6]))
    assert np.isnan(outside.moon).all()
    assert np.isnan(outside.w[:, :2]).all()


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: Sky.over(np.nan, EPOCH, 1.0), "longitude"),
        (lambda: Sky.over(0.0, EPOCH, 0.0), "duration"),
        (lambda: Sky.over(0.0, datetime(1950, 1, 1), 1.0), "1950"),
        (lambda: Station.create(np.inf), "longitude"),
        (lambda: Station.create(moon=-1.0), "moon"),
        (lambda: Station.create(pressure=-1.0), "pressure"),
        (lambda: Station.create(radius=42164.0), "radius"),
    ],
)
def test_bad_numbers(make, field):
    with pytest.raises(ScenarioError, match=field):
        make()
