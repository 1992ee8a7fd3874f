"""Covariance of the solution of Wahba's problem against sampling, and what it does in other units and axes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.estimation import wahba
from plants.geometry import attitude


def random_directions(seed, n):
    rng = np.random.default_rng(seed)
    b = rng.normal(size=(n, 3))
    return rng, b / np.linalg.norm(b, axis=1, keepdims=True), 10 ** rng.uniform(-4, -2.5, n)


@pytest.mark.parametrize(("n", "best"), [(2, True), (3, True), (5, True), (2, False), (4, False)])
def test_covariance_is_that_of_sampled_solutions(n, best):
    rng, b, sigma = random_directions(n, n)
    runs = 4000
    weights = 1 / sigma**2 if best else rng.uniform(0.2, 1, n)
    noisy = b + sigma[:, None] * rng.normal(size=(runs, n, 3))
    with jax.enable_x64(True):
        solve = jax.jit(jax.vmap(lambda v: attitude.to_vector(attitude.from_dcm(wahba.wahba_svd(v, b, weights)))))
        errors = np.asarray(solve(noisy))
        P = np.asarray(wahba.wahba_covariance(b, sigma, None if best else weights))
        np.testing.assert_allclose(P, wahba.wahba_covariance(3 * b, sigma, weights), rtol=1e-9)
    root = np.linalg.inv(np.linalg.cholesky(P))
    np.testing.assert_allclose(root @ np.cov(errors.T) @ root.T, np.eye(3), atol=5 / np.sqrt(runs))


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 1000), st.integers(2, 6), st.floats(0.1, 10))
def test_covariance_turns_with_the_axes_and_scales_with_the_noise(seed, n, scale):
    rng, b, sigma = random_directions(seed, n)
    R = Rotation.random(random_state=rng).as_matrix()
    with jax.enable_x64(True):
        P = np.asarray(wahba.wahba_covariance(b, sigma))
        turned = np.asarray(wahba.wahba_covariance(b @ R.T, scale * sigma))
    np.testing.assert_allclose(turned, scale**2 * R @ P @ R.T, rtol=0, atol=1e-9 * np.linalg.norm(turned))


def test_optimal_weights_are_best():
    rng, b, sigma = random_directions(7, 4)
    with jax.enable_x64(True):
        P = np.asarray(wahba.wahba_covariance(b, sigma))
        other = np.asarray(wahba.wahba_covariance(b, sigma, rng.uniform(0.1, 1, 4)))
    assert np.linalg.eigvalsh(other - P).min() > -1e-12 * np.linalg.norm(P)


def test_parallel_directions_say_so_and_bad_numbers_are_named():
    with jax.enable_x64(True):
        P = np.asarray(wahba.wahba_covariance([[1.0, 0, 0], [2.0, 0, 0]], [1e-3, 1e-3]))
    assert not np.isfinite(P).all()
    with pytest.raises(ScenarioError, match="deviations"):
        wahba.wahba_covariance(np.eye(3), [1e-3, 1e-3])
    with pytest.raises(ScenarioError, match="directions"):
        wahba.wahba_covariance(np.eye(2), [1e-3, 1e-3])


@settings(deadline=None, max_examples=60)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_rotation_vectors_against_scipy(turn):
    v = np.array(turn)
    with jax.enable_x64(True):
        q = np.asarray(attitude.from_vector(v))
        back = np.asarray(attitude.to_vector(q))
    truth = Rotation.from_rotvec(v)
    np.testing.assert_allclose(np.abs(q @ truth.as_quat()[[3, 0, 1, 2]]), 1, atol=1e-14)
    np.testing.assert_allclose(back, truth.as_rotvec(), atol=1e-9)


@pytest.mark.parametrize("size", [0.0, 1e-9, 5e-5, 1e-4, 9.9e-3, 1.01e-2, 1.0])
def test_rotation_vectors_are_smooth_where_the_series_takes_over(size):
    v = size * np.array([0.48, -0.6, 0.64])
    with jax.enable_x64(True):
        there = jax.jacfwd(attitude.from_vector)(jnp.asarray(v))
        back = jax.jacfwd(attitude.to_vector)(attitude.from_vector(v))
        np.testing.assert_allclose(back @ there, np.eye(3), atol=1e-10)
        np.testing.assert_allclose(attitude.to_vector(attitude.from_vector(v)), v, rtol=1e-13, atol=1e-18)
