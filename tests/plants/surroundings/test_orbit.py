"""Orbits: the Basilisk trajectory, the J2 potential, and the orbital frame."""

from pathlib import Path

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.surroundings import orbit
from plants.surroundings.orbit import J2, MU, Orbit

DATA = Path(__file__).parents[2] / "data"
LOW = orbit.circular(470e3, np.deg2rad(51.6), 2.0, 0.4)


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def test_trajectory_of_basilisk():
    start, flown = (np.load(DATA / f"basilisk_{n}.npz") for n in ("initial_conditions", "rigid_body_wheels"))
    assert (start["MU"], start["RE"], start["J2"]) == (MU, orbit.EARTH_RADIUS, J2)
    r, v = orbit.propagate(Orbit(start["r"], start["v"]), flown["t"])
    np.testing.assert_allclose(r, flown["r"], rtol=0, atol=1e-6)  # m
    np.testing.assert_allclose(v, flown["v"], rtol=0, atol=1e-9)  # m/s


def test_acceleration_is_the_gradient_of_the_potential():
    """Two-body and J2 potential, Vallado (2013), eq. 8-19."""

    def potential(r):
        distance = jax.numpy.linalg.norm(r)
        legendre = 1.5 * (r[2] / distance) ** 2 - 0.5
        return MU / distance * (1 - J2 * (orbit.EARTH_RADIUS / distance) ** 2 * legendre)

    for r in np.random.default_rng(2).normal(size=(5, 3)) * 4e6 + 3e6:
        np.testing.assert_allclose(orbit.acceleration(r), jax.grad(potential)(r), rtol=1e-12)


def test_energy_and_polar_momentum_last():
    """J2 is symmetric about the axis and conservative."""
    r, v = orbit.propagate(LOW, np.arange(0, 6001.0, 50))
    sine = r[:, 2] / np.linalg.norm(r, axis=1)
    oblate = J2 * (orbit.EARTH_RADIUS / np.linalg.norm(r, axis=1)) ** 2 * (1.5 * sine**2 - 0.5)
    energy = 0.5 * np.sum(v**2, axis=1) - MU / np.linalg.norm(r, axis=1) * (1 - oblate)
    polar = np.cross(r, v)[:, 2]
    np.testing.assert_allclose(energy, energy[0], rtol=1e-12)
    np.testing.assert_allclose(polar, polar[0], rtol=1e-12)


def test_node_drifts_as_first_order_theory_says():
    """RAAN rate -3/2 J2 w0 (Re/r)^2 cos i, to first order in J2 (Vallado, eq. 9-38)."""
    period = 2 * np.pi / float(orbit.rate(LOW.r))
    turns = 4
    r, v = orbit.propagate(LOW, np.linspace(0, turns * period, 2000))
    normal = np.cross(r, v)
    raan = np.unwrap(np.arctan2(normal[:, 0], -normal[:, 1]))
    expected = -1.5 * J2 * (orbit.EARTH_RADIUS / np.linalg.norm(LOW.r)) ** 2 * np.cos(np.deg2rad(51.6)) * 2 * np.pi
    assert (raan[-1] - raan[0]) / turns == pytest.approx(expected, rel=5e-3)


def test_circular_orbit_has_the_elements_it_was_given():
    r, v = LOW
    normal = np.cross(r, v) / np.linalg.norm(r) / np.linalg.norm(v)
    node = np.array([np.cos(2.0), np.sin(2.0), 0])
    assert np.linalg.norm(r) == pytest.approx(orbit.EARTH_RADIUS + 470e3, rel=1e-15)
    assert np.linalg.norm(v) == pytest.approx(np.linalg.norm(r) * float(orbit.rate(r)), rel=1e-15)
    assert abs(r @ v) < 1e-15 * np.linalg.norm(r) * np.linalg.norm(v)
    assert normal[2] == pytest.approx(np.cos(np.deg2rad(51.6)), rel=1e-14)
    assert abs(normal @ node) < 1e-15
    assert r @ node / np.linalg.norm(r) == pytest.approx(np.cos(0.4), rel=1e-14)
    assert r[2] > 0  # past the ascending node
    many = orbit.circular(470e3, np.deg2rad(51.6), [1.0, 2.0], 0.4)
    np.testing.assert_array_equal(many.r[1], r)


def test_orbital_frame_points_to_nadir_and_against_the_normal():
    A = np.asarray(attitude.dcm(orbit.orbital_frame(*LOW)))
    r, v = (x / np.linalg.norm(x) for x in LOW)
    np.testing.assert_allclose(A @ r, [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(A @ np.cross(r, v), [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(A @ v, [1, 0, 0], atol=1e-15)


def test_orbital_frame_rate_is_the_derivative_of_the_frame():
    """dA/dt = -[w x] A along the trajectory, on an eccentric orbit under J2."""
    r, v = LOW.r * 1.05, LOW.v * 1.03 + 30.0
    a = orbit.acceleration(r)
    A, dA = jax.jvp(lambda r, v: attitude.dcm(orbit.orbital_frame(r, v)), (r, v), (v, a))
    w = orbit.orbital_frame_rate(r, v)
    assert abs(w[2]) > 1e-8  # J2 does turn the plane here
    np.testing.assert_allclose(dA, -attitude.cross_matrix(w) @ A, rtol=0, atol=1e-15)


def test_steps_shorter_than_the_longest_change_nothing():
    coarse = orbit.propagate(LOW, np.arange(0, 101.0, 10.0))
    fine = orbit.propagate(LOW, np.arange(0, 100.1, 0.5))
    np.testing.assert_allclose(coarse.r, fine.r[::20], rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("times", "message"),
    [([0.0], "uniform"), ([1.0, 2.0], "starts at 0"), ([0.0, 1.0, 3.0], "uniform"), ([0.0, np.nan], "times")],
)
def test_bad_grids_are_refused(times, message):
    with pytest.raises(ScenarioError, match=message):
        orbit.propagate(LOW, times)


def test_bad_orbits_are_refused():
    for altitude in (-1.0, np.nan):
        with pytest.raises(ScenarioError, match="altitude"):
            orbit.circular(altitude, 0.1)
    with pytest.raises(ScenarioError, match="raan"):
        orbit.circular(470e3, 0.1, np.nan)
    with pytest.raises(ScenarioError, match="inside the Earth"):
        orbit.propagate(Orbit(LOW.r / 2, LOW.v), [0.0, 1.0])
    with pytest.raises(ScenarioError, match="r must be finite"):
        orbit.propagate(Orbit(LOW.r * np.nan, LOW.v), [0.0, 1.0])


ANGLE = st.floats(-np.pi, np.pi)


@given(st.floats(6.6e6, 5e8), st.floats(0, 0.99), st.floats(0, np.pi), ANGLE, ANGLE, ANGLE)
def test_elements_and_states_are_each_others_inverse(perigee, eccentricity, inclination, raan, argument, anomaly):
    """The state always, also of circles and on the equator, where elements are not unique; else the elements too."""
    a = perigee / (1 - eccentricity)
    state = orbit.keplerian(a, eccentricity, inclination, raan, argument, anomaly)
    found = orbit.elements(state)
    again = orbit.keplerian(*found)
    loss = 1e-14 / (1 - eccentricity) ** 2  # of the energy where v is near that of escape
    np.testing.assert_allclose(again.r, state.r, rtol=0, atol=100 * loss * np.linalg.norm(state.r))
    np.testing.assert_allclose(again.v, state.v, rtol=0, atol=100 * loss * np.linalg.norm(state.v))
    assert found.semi_major_axis == pytest.approx(a, rel=10 * loss)
    assert found.eccentricity == pytest.approx(eccentricity, abs=1e-14)
    assert found.inclination == pytest.approx(inclination, abs=1e-7)
    if 1e-3 < inclination < np.pi - 1e-3 and eccentricity > 1e-3:
        for name, value in (("raan", raan), ("argument_of_perigee", argument), ("true_anomaly", anomaly)):
            assert abs(np.exp(1j * (getattr(found, name) - value)) - 1) < 1e-9, name


def test_keplerian_orbit_by_hand():
    """Perigee over the equator on the x axis, flown north; vis-viva; half a turn later the apogee."""
    a, e = 10e6, 0.3
    r, v = orbit.keplerian(a, e, np.pi / 2)
    np.testing.assert_allclose(r, [a * (1 - e), 0, 0], atol=1e-8)
    np.testing.assert_allclose(v, [0, 0, np.sqrt(MU / a * (1 + e) / (1 - e))], atol=1e-11)
    period = 2 * np.pi * np.sqrt(a**3 / MU)
    flown = orbit.propagate(Orbit(r, v), np.array([0.0, 0.5, 1.0]) * period, ())
    np.testing.assert_allclose(flown.r[1], [-a * (1 + e), 0, 0], atol=1e-3)
    np.testing.assert_allclose(flown.r[2], r, atol=1e-3)


def test_circular_is_the_ellipse_without_eccentricity():
    for one, two in zip(
        LOW, orbit.keplerian(orbit.EARTH_RADIUS + 470e3, 0.0, np.deg2rad(51.6), 2.0, 0.0, 0.4), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_elements_broadcast():
    many = orbit.keplerian([7e6, 8e6], 0.01, 0.3, np.zeros((3, 1)), 0.1, 0.2)
    assert many.r.shape == (3, 2, 3)
    assert orbit.elements(many).eccentricity.shape == (3, 2)
    np.testing.assert_array_equal(many.v[2, 1], orbit.keplerian(8e6, 0.01, 0.3, 0.0, 0.1, 0.2).v)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eccentricity": 1.0}, "eccentricity must lie in"), ({"eccentricity": -0.1}, "eccentricity must lie in"),
        ({"eccentricity": 0.2}, "perigee at 5.6e.06 m, inside the Earth"), ({"inclination": np.nan}, "inclination"),
        ({"semi_major_axis": 500e3}, "from its centre"), ({"true_anomaly": np.inf}, "true_anomaly"),
        ({"raan": "east"}, "raan"), ({"inclination": 51.6}, "inclination .* rad, got 51.6"),
        ({"raan": [1.0, 2.0], "inclination": [1.0, 2.0, 3.0]}, "broadcast"),
    ],
)  # fmt: skip
def test_bad_elements_are_refused(change, message):
    with pytest.raises(ScenarioError, match=message):
        orbit.keplerian(**({"semi_major_axis": 7e6, "eccentricity": 0.0, "inclination": 0.1} | change))


def test_what_is_no_orbit_is_refused():
    for wrong in (7e6, None, (LOW.r, LOW.v, 0.0), LOW.r):
        with pytest.raises(ScenarioError, match=r"must be an Orbit\(r, v\)"):
            orbit.propagate(wrong, [0.0, 1.0])
    with pytest.raises(ScenarioError, match="one shape"):
        orbit.propagate(Orbit(LOW.r, np.stack([LOW.v, LOW.v])), [0.0, 1.0])
    with pytest.raises(ScenarioError, match=r"v must have shape"):
        orbit.elements(Orbit(LOW.r, LOW.v[:2]))
    for altitude, inclination in (("low", 0.1), ([5e5, 6e5], 0.1), (5e5, 98.0), (5e5, -0.1)):
        with pytest.raises(ScenarioError, match=r"altitude|inclination"):
            orbit.circular(altitude, inclination)


def test_states_that_are_no_ellipse_have_no_elements():
    for v in (1.5 * LOW.v, 0 * LOW.v, LOW.r / 1e4):
        with pytest.raises(ScenarioError, match="no ellipse"):
            orbit.elements(Orbit(LOW.r, v))
    with pytest.raises(ScenarioError, match="v must be finite"):
        orbit.elements(Orbit(LOW.r, LOW.v * np.nan))
