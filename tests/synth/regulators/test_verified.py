"""Regulators verified on the data given: residual, coordinates and units, indefinite and singular weights, refusals."""

import control
import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import care, dare, dlqr, lqr, lqrd
from synth.errors import AssumptionError, ModelError, NumericalError

SEEDS = st.integers(0, 2**32 - 1)
RESIDUAL = 1e-12


def problem(seed, n, m, *, discrete):
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((2, n))
    return (0.6 * A if discrete else A), B, C.T @ C, np.diag(rng.uniform(0.1, 10, m)), rng


def symmetric(M):
    return (M + M.T) / 2


def changed(A, B, Q, T):
    """The problem in the coordinates x_new = T x."""
    Ti = np.linalg.inv(T)
    return T @ A @ Ti, T @ B, symmetric(Ti.T @ Q @ Ti), Ti


@pytest.mark.parametrize(("solve", "discrete"), [(lqr, False), (dlqr, True)])
@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(1, 7), st.integers(1, 3), st.floats(-6, 6))
def test_gain_goes_with_the_coordinates_and_units(solve, discrete, seed, n, m, decades):
    A, B, Q, R, rng = problem(seed, n, m, discrete=discrete)
    reference = solve(A, B, Q, R)
    T = np.diag(10.0 ** rng.uniform(-abs(decades), abs(decades), n)) @ np.linalg.qr(rng.standard_normal((n, n)))[0]
    A2, B2, Q2, Ti = changed(A, B, Q, T)
    u = 10.0 ** rng.uniform(-3, 3, m)
    found = solve(A2, B2 * u, Q2, R * np.outer(u, u))
    assert max(reference.residual, found.residual) < RESIDUAL
    K = u[:, None] * found.K @ T
    digits = 1e-14 * max(reference.condition, found.condition, 1e2)
    np.testing.assert_allclose(K, reference.K, rtol=0, atol=digits * np.abs(reference.K).max())
    assert Ti.shape == (n, n)


def unmoved(A, B, C, discrete):
    A[0], B[0] = 0, 0
    A[0, 0] = 1.3 if discrete else 0.5


def unseen(A, B, C, discrete):
    A[:, 0], C[:, 0] = 0, 0
    A[0, 0] = float(discrete)


def unseen_chain(A, B, C, discrete):
    A[:, :2], C[:, :2] = 0, 0
    A[:2, :2] = np.eye(2, k=1) + discrete * np.eye(2)


@pytest.mark.parametrize(("solve", "door", "discrete"), [(lqr, care, False), (dlqr, dare, True)])
@pytest.mark.parametrize("spoil", [unmoved, unseen, unseen_chain])
@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(3, 7), st.integers(1, 2), st.sampled_from(["turned", "scaled", "companion"]))
def test_no_gain_leaves_for_data_without_one(spoil, solve, door, discrete, seed, n, m, coordinates):
    rng = np.random.default_rng(seed)
    A, B, C = 0.5 * rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((n, n))
    spoil(A, B, C, discrete)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    if coordinates == "scaled":
        T = np.diag(10.0 ** rng.uniform(-4, 4, n)) @ T
    if coordinates == "companion":  # zeros become small numbers
        T = np.linalg.inv(np.stack([np.linalg.matrix_power(A, k) @ T[0] for k in range(n)], 1))
    A, B, Q, _ = changed(A, B, C.T @ C, T)
    with pytest.raises((AssumptionError, NumericalError)):
        solve(A, B, Q, np.eye(m))
    assert not door(A, B, Q).ok


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(2, 6), st.floats(-8, -4))
def test_a_weakly_seen_integrator_has_a_gain(seed, n, decade):
    """The weight q of an integrator x1 alone: K1^2 = q where the others neither drive it nor are driven."""
    rng = np.random.default_rng(seed)
    A, B, T = np.diag(-rng.uniform(0.5, 2, n)), np.zeros((n, 2)), np.linalg.qr(rng.standard_normal((n, n)))[0]
    A[0], B[0, 0], B[1:, 1] = 0, 1, 1
    Q = np.diag([10.0**decade, *rng.uniform(0.5, 2, n - 1)])
    A2, B2, Q2, _ = changed(A, B, Q, T)
    found = lqr(A2, B2, Q2, np.eye(2))
    digits = 1e-14 * max(found.condition, 1e2)
    np.testing.assert_allclose((found.K @ T)[0, 0], 10 ** (decade / 2), rtol=0, atol=digits * np.abs(found.K).max())
    assert care(A2, B2, Q2).ok


@settings(max_examples=25, deadline=None)
@given(SEEDS, st.integers(1, 6), st.integers(1, 3))
def test_indefinite_weights_are_solved_where_a_solution_exists(seed, n, m):
    """Q is made from a symmetric X of any signature that stabilises."""
    rng = np.random.default_rng(seed)
    B, X, closed = rng.standard_normal((n, m)), symmetric(rng.standard_normal((n, n))), rng.standard_normal((n, n))
    closed -= (np.linalg.eigvals(closed).real.max() + 0.5) * np.eye(n)
    N = rng.standard_normal((n, m))
    K = B.T @ X + N.T
    A = closed + B @ K
    Q = symmetric(K.T @ K - A.T @ X - X @ A)
    found = lqr(A, B, Q, np.eye(m), N)
    assert found.residual < RESIDUAL
    np.testing.assert_allclose(found.S, X, rtol=0, atol=1e-13 * max(found.condition, 1e2) * np.abs(X).max())


def test_indefinite_weights_without_a_minimum_are_refused_with_the_frequency():
    with pytest.raises(AssumptionError, match=r"earns more than it costs") as error:
        lqr([[0, 1], [-1, -0.1]], [0, 1], [-1, 0], 1)
    assert error.value.assumption == "a cost that is bounded below"
    assert not care([[0, 1], [-1, -0.1]], [[0], [1]], np.diag([-1.0, 0.0])).ok


def test_a_command_without_any_cost_is_named():
    with pytest.raises(AssumptionError, match="costs nothing") as error:
        dlqr(np.diag([0.5, 2.0]), [[1, 1], [1, 1]], np.eye(2), np.zeros((2, 2)))
    assert error.value.assumption == "R + B'S B positive definite"


@pytest.mark.parametrize(("solve", "discrete"), [(lqr, False), (dlqr, True)])
@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 6), st.integers(1, 3))
def test_descriptor_is_its_inverse_applied(solve, discrete, seed, n, m):
    A, B, Q, R, rng = problem(seed, n, m, discrete=discrete)
    E = rng.standard_normal((n, n)) + 2 * np.eye(n)
    N = 0.1 * rng.standard_normal((n, m))
    Q = Q + N @ np.linalg.solve(R, N.T)
    expected, found = solve(np.linalg.solve(E, A), np.linalg.solve(E, B), Q, R, N), solve(A, B, Q, R, N, E=E)
    digits = 1e-14 * max(expected.condition, found.condition, 1e2) * np.linalg.cond(E)
    np.testing.assert_allclose(found.K, expected.K, rtol=0, atol=digits * np.abs(expected.K).max())
    S = E.T @ found.S @ E
    np.testing.assert_allclose(S, expected.S, rtol=0, atol=digits * np.abs(expected.S).max())
    door = dare if discrete else care
    np.testing.assert_allclose(door(A, B, Q, R, N=N, E=E).X, found.S, rtol=0, atol=digits * np.abs(found.S).max())


def test_descriptor_agrees_with_scipy():
    A, B, Q, R, rng = problem(5, 4, 2, discrete=False)
    E = rng.standard_normal((4, 4)) + 2 * np.eye(4)
    np.testing.assert_allclose(lqr(A, B, Q, R, E=E).S, sla.solve_continuous_are(A, B, Q, R, e=E), rtol=1e-9)
    np.testing.assert_allclose(dlqr(A, B, Q, R, E=E).S, sla.solve_discrete_are(A, B, Q, R, e=E), rtol=1e-9)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.integers(1, 6))
def test_deadbeat_without_a_weight_of_the_command(seed, n):
    """R = 0, Q = C'C of relative degree one: the outputs vanish after a sample, S = Q, and zeros are the poles."""
    rng = np.random.default_rng(seed)
    A, B, Q = rng.standard_normal((n, n)), rng.standard_normal((n, n)) + 3 * np.eye(n), np.eye(n)
    found = dlqr(A, B, Q, np.zeros((n, n)))
    np.testing.assert_allclose(found.S, Q, rtol=0, atol=1e-14 * max(found.condition, 1e2))
    np.testing.assert_allclose(A - B @ found.K, 0, atol=1e-12 * max(found.condition, 1e2))


def test_badly_scaled_example_of_petkov():
    """CAREX 12, BB01AD 2.6 at 1e6: 8.6e-4 off before the refinement. Petkov, Christov and Konstantinov (1987)."""
    e = 1e6
    V = np.eye(3) - 2 / 3
    s = e * e
    x = [s + np.hypot(s, 1), 2 * s + np.sqrt(4 * s**2 + e), 3 * s + e * np.sqrt(9 * s + 1)]
    X = V * x @ V
    A, Q, R = symmetric(V * [e, 2 * e, 3 * e] @ V), symmetric(V * [1 / e, 1, e] @ V), e * np.eye(3)
    np.testing.assert_allclose(lqr(A, np.eye(3), Q, R).S, X, rtol=0, atol=1e-14 * np.abs(X).max())
    s = care(A, np.eye(3), Q, R)
    assert s.ok
    np.testing.assert_allclose(s.X, X, rtol=0, atol=1e-14 * np.abs(X).max())


@pytest.mark.parametrize("ratio", [1e6, 1e9, 1e12])
def test_a_mode_decays_however_fast_its_neighbour_is(ratio):
    A, B, Q = np.diag([-1.0, -ratio]), np.ones((2, 1)), np.diag([0.0, 1.0])
    found = lqr(A, B, Q, 1)
    np.testing.assert_allclose(found.E, [-1, -ratio], rtol=1e-6)
    assert found.residual < RESIDUAL
    assert care(A, B, Q).ok


@pytest.mark.parametrize("seed", range(24))
def test_cheap_discrete_control_in_batches(seed):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((8, 3, 3)), 1e4 * rng.standard_normal((8, 3, 2))
    C = rng.standard_normal((8, 3, 3))
    s = dare(A, B, C.mT @ C)
    assert s.ok.all()
    for a, b, c, X in zip(A, B, C, s.X, strict=True):
        found = dlqr(a, b, c.T @ c, np.eye(2))
        digits = 1e-13 * max(found.condition, 1e2)
        np.testing.assert_allclose(X, found.S, rtol=0, atol=digits * np.abs(X).max())


@pytest.mark.parametrize("n", [1, 2, 6, 12])
def test_batches_agree_with_slycot(n):
    slycot = pytest.importorskip("slycot", reason="the oracle is not installed")
    rng = np.random.default_rng(n)
    A, B = rng.standard_normal((20, n, n)), rng.standard_normal((20, n, max(n // 2, 1)))
    C = rng.standard_normal((20, 1, n))
    for door, kind, order in ((care, "C", "S"), (dare, "D", "U")):  # of discrete ones it orders the inverse
        s = door(A, B, C.mT @ C)
        assert s.ok.all()
        for a, b, c, X in zip(A, B, C, s.X, strict=True):
            expected = slycot.sb02md(n, a.copy(), b @ b.T, c.T @ c, kind, sort=order)[0]
            np.testing.assert_allclose(X, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_indefinite_example_of_python_control():
    """mateqn_test.py, test_care_g: Q has negative eigenvalues."""
    A, Q = np.array([[-2.0, -1], [-1, -1]]), np.array([[0.0, 0], [0, 1]])
    B, R, S = np.array([[1.0, 0], [0, 4]]), np.array([[2.0, 0], [0, 1]]), np.array([[0.0, 0], [0, 0]])
    X, _, K = control.care(A, B, Q, R, S, np.eye(2))
    found = lqr(A, B, Q, R, S)
    np.testing.assert_allclose(found.S, X, rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.K, K, rtol=0, atol=1e-10)


def test_a_regulator_is_three_values_that_know_how_good_they_are():
    found = lqr([[0, 1], [0, 0]], [0, 1], 1, 1)
    K, S, E = found
    assert len(found) == 3
    assert K is found.K
    assert S is found.S
    assert E is found.E
    assert found.residual < 1e-15
    assert 1 < found.condition < 100
    sampled = lqrd([[0, 1], [0, 0]], [0, 1], 1, 1, 0.1)
    assert sampled.residual < 1e-14
    with pytest.raises(ModelError, match="E is singular"):
        dlqr(np.eye(2), np.eye(2), 1, 1, E=[[1, 2], [2, 4]])
