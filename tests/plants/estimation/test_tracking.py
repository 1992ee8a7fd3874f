"""Tracking of a geostationary satellite: what the measurements show, and a filter that is as good as it says."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from plants.dynamics.relative import StationState
from plants.errors import ScenarioError
from plants.estimation.tracking import StationEkf, observability
from plants.missions import geo
from plants.simulation.simulate import simulate_many

DAY = 86400.0
THREE = geo.tracking(geo.TRACKING_NOISE[:3])
R1 = float(geo.satellite().radius)


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def test_measurements_are_those_of_the_thesis():
    """3.13: r2^2 - r1^2 over 2 r1, r2 r2' over r1, r2 sin(latitude); and the arc to the ideal point."""
    p, v = np.array([3000.0, -8000.0, 2000.0]), np.array([0.3, -0.2, 0.5])
    r = p + np.array([R1, 0, 0])
    _, y = geo.tracking().measure((), StationState(p, v, np.zeros(3)), None, jnp.zeros(4), 0.0)
    expected = [(r @ r - R1**2) / (2 * R1), r @ v / R1, r[2], R1 * np.arctan2(r[1], r[0])]
    np.testing.assert_allclose(y, expected, rtol=1e-9)


def test_slope_of_the_measurements_is_the_printed_one():
    """3.22, in the order of position and velocity and scaled."""
    x, y, z, vx, vy, vz = state = np.array([3000.0, -8000.0, 2000.0, 0.3, -0.2, 0.5])
    C = [
        [2 * (R1 + x), 2 * y, 2 * z, 0, 0, 0],
        [vx, vy, vz, R1 + x, y, z],
        [0, 0, 1, 0, 0, 0],
    ]
    np.testing.assert_allclose(jax.jacfwd(THREE.expected)(state), np.array(C) / [[2 * R1], [R1], [1]], rtol=1e-12)


@pytest.mark.parametrize("y", [0.0, 100.0, 10e3])
def test_without_the_longitude_a_turn_about_the_pole_is_not_seen(y):
    """At y = 0 the scaled singular value is zero; elsewhere too, along the circle instead of along y."""
    seen = observability(geo.oblate(), THREE, geo.sky(DAY), [0, y, 0, 0, 0, 0], h=60.0, samples=1440)
    assert seen.hidden() == ["y (east)"]
    assert seen.deviations[0] > 5e5  # m: to first order the moving pole shows it a little
    assert seen.deviations[1] < 10.0
    np.testing.assert_allclose(np.abs(seen.directions[0, :3]), [y / R1, 1, 0], rtol=0, atol=1e-6)


def test_with_the_longitude_all_is_seen():
    seen = observability(geo.oblate(), geo.tracking(), geo.sky(DAY), np.zeros(6), h=60.0, samples=1440)
    assert seen.hidden() == []
    assert seen.deviations.max() < 10.0
    assert (np.diff(seen.deviations) <= 0).all()


def test_a_filter_that_cannot_see_is_refused_by_name():
    with pytest.raises(ScenarioError, match=r"do not show y \(east\).*measure the longitude"):
        geo.ekf(geo.sky(DAY), sensors=THREE)


def seen(x, env, sensors, navigator):
    """What is recorded."""
    del x, env, sensors
    return navigator.x, navigator.P


def tracked(run, model, walk, duration=DAY, guess=np.zeros(6)):  # noqa: B008
    loop, scenario = geo.case(geo.Coast(dt=geo.SAMPLE), np.zeros(6), duration, run=run)
    filtered = geo.ekf(scenario.environment, model=model, walk=walk, guess=guess)
    return replace(loop, sensors=geo.tracking(), navigator=filtered), scenario


@pytest.fixture(scope="module")
def flights():
    """A day of free drift: twelve filters that know Moon and Sun, three that do not, six that know all."""
    known = [tracked(i, geo.satellite(), geo.WALK) for i in range(12)]
    unknown = [tracked(i, geo.oblate(), geo.TIDE_WALK) for i in range(3)]
    all_known = [tracked(i, geo.satellite(), 0.0) for i in range(6)]
    all_known = [(replace(loop, navigator=replace(loop.navigator, deviation=np.r_[loop.navigator.deviation[:6],
                  np.zeros(3)])), scenario) for loop, scenario in all_known]  # fmt: skip
    runs = simulate_many([*known, *unknown, *all_known], record=seen)
    assert all(run.ok for run in runs)
    return runs[:12], runs[12:15], runs[15:]


def errors(runs):
    """(runs, N, 6) in the second half of the day."""
    return np.array([(run.estimates - run.outputs)[720:] for run in runs])


def covariances(runs):
    """(runs, N, 6, 6)."""
    return np.array([run.extra[1][720:, :6, :6] for run in runs])


@pytest.mark.slow
def test_errors_are_as_large_as_the_filter_says(flights):
    """Normalised squared errors of six states are chi-square: mean 6, here of 12 runs at three instants."""
    e, P = errors(flights[0])[:, ::300], covariances(flights[0])[:, ::300]
    squares = np.einsum("rti,rtij,rtj->rt", e, np.linalg.inv(P), e)
    assert 4.0 < squares.mean() < 8.0  # +-2 standard deviations of 12 independent runs
    deviations = np.sqrt((e**2).mean((0, 1))), np.sqrt(np.diagonal(P, axis1=2, axis2=3).mean((0, 1)))
    np.testing.assert_allclose(*deviations, rtol=0.35)


@pytest.mark.slow
def test_errors_of_a_filter_that_knows_all(flights):
    """The reference reports rms of x 0.67, y 3.4, z 4.4 m for q = 1e-7 m/s^2; ours is within a third."""
    rms = np.sqrt((errors(flights[2])[..., :3] ** 2).mean((0, 1)))
    np.testing.assert_allclose(rms, [0.67, 3.4, 4.4], rtol=0.35)


@pytest.mark.slow
def test_tides_not_known_are_taken_up_by_the_unknown_acceleration(flights):
    """8e-6 m/s^2 of Moon and Sun: the estimate follows them, at the price of larger errors."""
    for run in flights[1]:
        true = geo.perturbation(run.time[720:])
        assert np.corrcoef(run.extra[0][720:, 6], true[:, 0])[0, 1] > 0.9
    assert np.sqrt((errors(flights[1])[..., :3] ** 2).mean()) < 40.0


@pytest.mark.slow
def test_covariance_is_the_solution_of_the_riccati_equation(flights):
    """The filter's P after a day against SciPy's stationary one for the linear model at the ideal point."""
    model, h = geo.oblate_model(), geo.SAMPLE
    A = np.zeros((9, 9))
    A[:6, :6], A[3:6, 6:] = model.A, np.eye(3)
    F = expm(A * h)
    H = np.zeros((4, 9))
    H[0, 0] = H[1, 3] = H[2, 2] = H[3, 1] = 1.0
    step = np.vstack([h**2 / 2 * np.eye(3), h * np.eye(3), np.zeros((3, 3))]) * geo.PUSH_NOISE
    Q = step @ step.T + np.diag([0.0] * 6 + [h * geo.TIDE_WALK**2] * 3)
    R = np.diag(geo.TRACKING_NOISE**2)
    scale = np.repeat([1.0, 1e-3, 1e-6], 3)  # SciPy wants numbers of one size
    P = solve_discrete_are((F * scale / scale[:, None]).T, (H * scale).T, Q / np.outer(scale, scale), R)
    P *= np.outer(scale, scale)
    P -= P @ H.T @ np.linalg.solve(H @ P @ H.T + R, H @ P)
    got = flights[1][0].extra[1][-1]
    np.testing.assert_allclose(np.diag(got), np.diag(P), rtol=0.01)


@pytest.mark.slow
def test_without_the_longitude_an_error_along_the_track_stays():
    """What `station_ekf` refuses, built by hand: two filters 100 m apart at the start stay so."""
    pair = []
    for offset in (0.0, 100.0):
        loop, scenario = tracked(0, geo.satellite(), 0.0, guess=np.array([0, offset, 0, 0, 0, 0]))
        blind = {**vars(loop.navigator), "sensors": THREE, "deviation": np.r_[[1e3] * 3, [0.1] * 3, [0.0] * 3]}
        pair.append((replace(loop, sensors=THREE, navigator=StationEkf(**blind)), scenario))
    one, other = simulate_many(pair)
    np.testing.assert_allclose((other.estimates - one.estimates)[-1, :3], [0, 100, 0], rtol=0, atol=1.0)
