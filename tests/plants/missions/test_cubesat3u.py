"""The numbers of the CubeSat study: what the paper prints, and what follows from the hardware."""

import jax
import numpy as np
import pytest
from scipy.signal import cont2discrete

from plants.errors import ScenarioError
from plants.estimation import navigation
from plants.geometry import attitude
from plants.missions import cubesat3u
from plants.surroundings.disturbances import seen_from


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def surroundings():
    return cubesat3u.environment(1000.0)


@pytest.fixture(scope="module")
def along(surroundings):
    with jax.enable_x64(True):
        return jax.jit(jax.vmap(surroundings.at))(np.arange(0, 1001.0, 10))


def test_requirements_in_the_units_of_table_1():
    r = cubesat3u.REQUIREMENTS
    np.testing.assert_allclose(np.rad2deg(r[:4]), [0.65, 0.31, 0.31, 0.12], rtol=1e-15)
    assert np.rad2deg(r.pse) * 60 == pytest.approx(7.41, rel=0.03)  # table 1 prints both, to two digits


def test_initial_state_is_table_3(surroundings):
    x = cubesat3u.initial_state(surroundings)
    y = cubesat3u.body().output(x, surroundings.at(0.0))
    q = np.concatenate([[np.sqrt(1 - y[:3] @ y[:3])], y[:3]])
    np.testing.assert_allclose(np.rad2deg(attitude.to_euler(q)), [-15, 25, 10], rtol=0, atol=1e-9)
    np.testing.assert_allclose(y[3:], [0, 0.0011, 0], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(x.wheels, np.zeros(3))
    assert np.linalg.norm(x.w) < 0.4 * 1.1e-3  # as w_OB this reading leaves the body nearly at inertial rest
    assert {part.dtype for part in x} == {np.dtype(np.float64)}
    for change in ({"angles": [0, 0]}, {"rates": [0, np.nan, 0]}):
        with pytest.raises(ScenarioError, match=next(iter(change))):
            cubesat3u.initial_state(surroundings, **change)


def test_the_run_is_in_sunlight(along):
    np.testing.assert_array_equal(along.sunlit, np.ones(101))


def test_disturbances_have_the_size_their_formulas_give():
    """Largest over an orbit at 10 deg from nadir, bounded by the product of the extremes."""
    orbit = cubesat3u.environment(5640.0)
    with jax.enable_x64(True):
        along = jax.jit(jax.vmap(orbit.at))(np.arange(0, 5640.0, 10))
    turn = np.concatenate([[np.cos(np.deg2rad(5))], np.sin(np.deg2rad(5)) * np.ones(3) / np.sqrt(3)])

    @jax.jit
    @jax.vmap
    def sizes(env):
        seen = seen_from(attitude.compose(turn, env.q_ON), env)
        inertia = np.diag(cubesat3u.INERTIA)
        return {type(d).__name__: jax.numpy.linalg.norm(d.torque(seen, inertia)) for d in cubesat3u.disturbances()}

    largest = {name: float(size.max()) for name, size in sizes(along).items()}
    arm, side, end = np.linalg.norm(cubesat3u.MASS_CENTRE), 0.1 * 0.34, 0.1 * 0.1
    area = np.linalg.norm([side, side, end])
    rate = 2 * np.pi / 5640
    flow = 0.5 * 1.2e-12 * 7600.0**2
    bounds = {
        "ResidualDipole": 50e-6 * np.linalg.norm(cubesat3u.DIPOLE),
        "Drag": flow * 2.2 * arm * area,
        "GravityGradient": 1.5 * rate**2 * np.ptp(cubesat3u.INERTIA) * np.sin(np.deg2rad(20)),
        "SolarPressure": 4.54e-6 * 1.3 * arm * area,
    }
    assert bounds.keys() == largest.keys()
    for name, bound in bounds.items():
        assert 0.5 * bound < largest[name] < bound, name


def test_wheels_store_what_the_hardware_table_says():
    body, wheels = cubesat3u.body(), cubesat3u.wheels()
    np.testing.assert_allclose(body.wheel_inertia * wheels.speed_limit, 10.8e-3, rtol=1e-15)
    _, u = wheels.apply((), np.array([1.0, 0, -1.0]), cubesat3u.BodyState(None, None, np.zeros(3)))
    np.testing.assert_array_equal(u, [-1e-3, 0, 1e-3])


def test_linear_model_is_the_exact_hold_of_equation_12():
    model, continuous = cubesat3u.linear_model(), cubesat3u.continuous_model()
    Ad, Bd, Cd, Dd, _ = cont2discrete(tuple(continuous), 0.5)
    for got, expected in zip(model, (Ad, Bd, Cd, Dd), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-13)
    with pytest.raises(ScenarioError, match="dt"):
        cubesat3u.linear_model(0.0)


def test_dispersions_lie_within_table_5_and_fill_it():
    draws = [cubesat3u.disperse(0, i) for i in range(400)]
    inertia, mass, angles, rates, raan = (np.array(column) for column in zip(*draws, strict=True))
    for value, half in (
        (inertia / cubesat3u.INERTIA - 1, 0.1), (mass - 4.548, 1.0), (np.rad2deg(angles), 25.0),
        (np.rad2deg(rates), 0.3), (raan - np.pi, np.pi),
    ):  # fmt: skip
        assert np.abs(value).max() <= half
        assert np.abs(value).max() > 0.97 * half
        assert np.abs(value.mean(axis=0)).max() < 0.1 * half  # 3.5 standard errors
    assert np.abs(np.corrcoef(np.hstack([inertia, angles, rates]).T) - np.eye(9)).max() < 0.2


def test_a_run_depends_on_its_seed_and_index_only():
    def flat(seed, index):
        return np.hstack([np.ravel(part) for part in cubesat3u.disperse(seed, index)])

    np.testing.assert_array_equal(flat(7, 3), flat(7, 3))
    assert (flat(7, 3) != flat(7, 4)).all()
    assert (flat(7, 3) != flat(8, 3)).all()
    for seed, index in ((-1, 0), (0, -1), (0.5, 0)):
        with pytest.raises(ScenarioError, match="whole number"):
            cubesat3u.disperse(seed, index)


def test_blocks_of_the_study_fit_together():
    assert cubesat3u.suite().channels == 12
    assert cubesat3u.ekf().body.disturbances == ()
    assert len(cubesat3u.body().disturbances) == 4
    assert isinstance(cubesat3u.direct_ekf().vectors, navigation.VectorsThemselves)
    assert cubesat3u.ekf().window == cubesat3u.WINDOW
    assert cubesat3u.consistent_ekf().window == 1
    assert cubesat3u.svd().window == 5
