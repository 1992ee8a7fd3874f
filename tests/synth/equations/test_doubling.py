"""Riccati equations by doubling: against SciPy, against closed forms, and refusal where no solution exists."""

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.equations.doubling import bounded_real, double, is_nonnegative, is_positive, solve_riccati
from synth.systems.statespace import StateSpace

seeds = st.integers(0, 10**6)


def random_lqr(seed: int, n: int, m: int):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(n, n)), rng.normal(size=(n, m))
    A *= rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    M = rng.normal(size=(n + m, n + m))
    W = M @ M.T
    return A, B, W[:n, :n], W[n:, n:], W[:n, n:]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds, n=st.integers(1, 12), m=st.integers(1, 4))
def test_regulator_equation_agrees_with_scipy(seed, n, m):
    A, B, Q, R, S = random_lqr(seed, n, m)
    solution = solve_riccati(A, B, Q, R, S)
    X = sla.solve_discrete_are(A, B, Q, R, s=S)
    assert np.linalg.norm(solution.X - X) <= 1e-8 * (np.linalg.norm(X) + np.linalg.norm(Q))
    assert np.abs(np.linalg.eigvals(A + B @ solution.F)).max() < 1
    assert solution.residual < 1e-11


@settings(max_examples=30, deadline=None, derandomize=True)
@given(seed=seeds, n=st.integers(1, 8))
def test_any_nearby_start_leads_to_the_same_solution(seed, n):
    A, B, Q, R, S = random_lqr(seed, n, 2)
    X = solve_riccati(A, B, Q, R, S).X
    shift = 1e-2 * np.linalg.norm(X) * np.eye(n)
    for start in (X, X + shift, 2 * X):
        again = solve_riccati(A, B, Q, R, S, start=start).X
        assert np.linalg.norm(again - X) <= 1e-9 * (np.linalg.norm(X) + np.linalg.norm(Q))


def test_scalar_equation_has_its_textbook_solution():
    # x = a^2 x + q - a^2 x^2 b^2/(r + b^2 x) with a = 2, b = q = r = 1: x^2 - 4x - 1 = 0
    solution = solve_riccati(np.array([[2.0]]), np.eye(1), np.eye(1), np.eye(1))
    assert solution.X[0, 0] == pytest.approx(2 + np.sqrt(5), rel=1e-14)


def test_unreachable_unstable_mode_has_no_stabilising_solution():
    A, B = np.diag([2.0, 0.5]), np.array([[0.0], [1.0]])
    assert solve_riccati(A, B, np.eye(2), np.eye(1)) is None


def test_undetectable_unit_mode_has_no_stabilising_solution():
    assert solve_riccati(np.eye(1), np.eye(1), np.zeros((1, 1)), np.eye(1)) is None


def test_singular_weights_are_refused_not_raised():
    O = np.zeros((2, 2))
    assert solve_riccati(np.eye(2), np.eye(2), O, O) is None
    assert double(1e200 * np.eye(2), 1e200 * np.eye(2), np.eye(2)) is None


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, 0.999])
def test_bounded_real_brackets_the_norm_of_a_lag(pole):
    G = StateSpace([[pole]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    norm = 1 / (1 - pole)
    assert bounded_real(G, norm * (1 - 1e-7)) is None
    assert bounded_real(G, norm * (1 + 1e-7)) is not None


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=seeds, n=st.integers(1, 10), scale=st.sampled_from([1e-6, 1.0, 1e6]))
def test_bounded_real_decides_like_a_dense_sweep_and_its_certificate_checks(seed, n, scale):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    G = StateSpace(A, scale * rng.normal(size=(n, 2)), rng.normal(size=(3, n)), scale * rng.normal(size=(3, 2)), 1.0)
    angles = np.concatenate([np.linspace(0, np.pi, 1500), np.abs(np.angle(G.poles()))])
    peak = max(np.linalg.norm(G.frequency_response(w), 2) for w in angles)
    assert bounded_real(G, 0.999 * peak) is None
    level = 1.01 * peak
    X = bounded_real(G, level)
    assert X is not None
    # the bounded-real matrix with X is negative semidefinite: energy gain below the level from every start
    AB, CD = np.hstack([G.A, G.B]), np.hstack([G.C, G.D])
    M = AB.T @ X @ AB + CD.T @ CD - sla.block_diag(X, level**2 * np.eye(2))
    assert np.linalg.eigvalsh(M)[-1] <= 1e-9 * np.linalg.norm(M)


def test_bounded_real_refuses_unstable_and_handles_static_systems():
    assert bounded_real(StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], 1.0), 1e6) is None
    static = StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[2.0]], 1.0)
    assert bounded_real(static, 2.1) is not None
    assert bounded_real(static, 1.9) is None


def test_definiteness_is_decided_relative_to_the_size():
    assert is_positive(1e-200 * np.eye(2))
    assert not is_positive(np.diag([1.0, 0.0]))
    assert not is_positive(np.diag([1.0, -1e-3]))
    assert is_nonnegative(np.diag([1e8, -1e-3]))
    assert not is_nonnegative(np.diag([1.0, -1e-3]))
