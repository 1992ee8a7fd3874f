import jax
import numpy as np
import pytest
import scipy.linalg as sla

from synth.equations import are, riccati
from synth.errors import ModelError

GAIN = 1e-10  # relative, against SciPy


def random_pairs(count, n=6, m=3, seed=0, rank=None):
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((count, n, n)), rng.standard_normal((count, n, m))
    C = rng.standard_normal((count, n if rank is None else rank, n))
    return A, B, C.mT @ C


def rate_of(A, B, Q):
    return riccati.closed_loop_rate(A, B @ B.mT, Q)


def relative(actual, expected):
    return np.linalg.norm(actual - expected, axis=(-2, -1)) / np.linalg.norm(expected, axis=(-2, -1))


def scipy_care(A, B, Q):
    return np.array([sla.solve_continuous_are(a, b, q, np.eye(B.shape[-1])) for a, b, q in zip(A, B, Q, strict=True)])


def test_gain_agrees_with_scipy_on_a_thousand_pairs():
    A, B, Q = random_pairs(1000)
    s = are.care(A, B, Q)
    assert s.ok.all()
    assert relative(B.mT @ s.X, B.mT @ scipy_care(A, B, Q)).max() < GAIN
    assert np.linalg.eigvals(A - B @ B.mT @ s.X).real.max() < 0


def test_one_weighted_direction_is_enough():
    A, B, Q = random_pairs(300, rank=1, seed=1)
    s = are.care(A, B, Q)
    assert s.ok.all()
    assert relative(B.mT @ s.X, B.mT @ scipy_care(A, B, Q)).max() < GAIN


@pytest.mark.parametrize(("n", "m"), [(2, 1), (4, 3)])
def test_other_orders_and_a_weight_of_the_command(n, m):
    A, B, Q = random_pairs(20, n, m, seed=n)
    F = np.random.default_rng(n).standard_normal((m, m))
    R = F @ F.T + np.eye(m)
    s = are.care(A, B, Q, R)
    expected = np.array([sla.solve_continuous_are(a, b, q, R) for a, b, q in zip(A, B, Q, strict=True)])
    assert s.ok.all()
    assert relative(s.X, expected).max() < GAIN


def test_double_integrator_by_hand():
    """Unit weights on 1/s^2: X = [[sqrt 3, 1], [1, sqrt 3]]."""
    s = are.care([[0, 1], [0, 0]], [[0], [1]], np.eye(2))
    assert s.X.shape == (2, 2)
    np.testing.assert_allclose(s.X, [[np.sqrt(3), 1], [1, np.sqrt(3)]], rtol=1e-13)


def test_expensive_control_mirrors_the_unstable_pole():
    """x' = x + u with hardly any weight on x: the Cayley rate would be A's own pole, were it not moved away."""
    q = 1e-9
    np.testing.assert_allclose(are.care([[1.0]], [[1.0]], [[q]]).X, [[1 + np.sqrt(1 + q)]], rtol=1e-13)
    assert are.care([[-1.0]], [[1.0]], [[0.0]]).X == 0.0
    np.testing.assert_allclose(are.care([[1.0]], [[1.0]], [[0.0]]).X, 2.0, rtol=1e-13)  # unseen, yet mirrored to -1
    assert not are.care([[0.0]], [[1.0]], [[0.0]]).ok  # the boundary has no mirror image


def test_no_solution_is_a_value_and_leaves_its_neighbours_alone():
    A, B, Q = random_pairs(40, seed=2)
    alone = are.care(A[5], B[5], Q[5])
    A[3] = np.diag([1.0, -1, -2, -3, -4, -5])  # an unstable mode that no input moves
    B[3, 0] = 0
    A[8], Q[8] = 0.0, 0.0  # integrators that are not weighted
    s = are.care(A, B, Q)
    assert np.flatnonzero(~s.ok).tolist() == [3, 8]
    np.testing.assert_array_equal(s.X[5], alone.X)


def test_a_poor_rate_costs_steps_but_no_accuracy():
    A, B, Q = random_pairs(50, seed=3)
    with jax.enable_x64(True):
        factors = np.tile([1e-3, 30.0], 25)
        s = jax.jit(jax.vmap(riccati.stabilising))(A, B @ B.mT, Q, factors * rate_of(A, B, Q))
    assert np.all(s.ok)
    assert relative(np.asarray(s.X), scipy_care(A, B, Q)).max() < GAIN


def test_pair_solves_the_dual_too():
    A, B, Q = random_pairs(200, seed=4)
    G = B @ B.mT
    with jax.enable_x64(True):
        X, Z, ok = map(np.asarray, jax.jit(jax.vmap(riccati.stabilising_pair))(A, G, Q, rate_of(A, B, Q)))
    roots = np.linalg.cholesky(Q)
    assert ok.all()
    assert relative(X, scipy_care(A, B, Q)).max() < GAIN
    dual = np.array([sla.solve_continuous_are(a.T, c, g, np.eye(6)) for a, c, g in zip(A, roots, G, strict=True)])
    assert relative(Z, dual).max() < 10 * GAIN  # SciPy's own error: the duals are larger


def test_a_guess_is_continued_and_a_bad_one_replaced():
    A, B, Q = random_pairs(100, seed=5)
    G, rate, expected = B @ B.mT, rate_of(A, B, Q), scipy_care(A, B, Q)
    rng = np.random.default_rng(5)
    guesses = expected + 1e-4 * np.abs(expected).max() * rng.standard_normal(expected.shape)
    guesses[::4] = 0.0
    guesses[1::4] = np.nan
    guesses[2::4] *= -1.0
    with jax.enable_x64(True):
        s = jax.jit(jax.vmap(riccati.continued))(A, G, Q, rate, guesses)
    assert np.all(s.ok)
    assert relative(B.mT @ np.asarray(s.X), B.mT @ expected).max() < GAIN


def test_result_does_not_depend_on_the_batch():
    A, B, Q = random_pairs(70, seed=6)
    whole = are.care(A, B, Q).X
    for part in (slice(0, 1), slice(10, 17), slice(20, 60)):
        np.testing.assert_array_equal(are.care(A[part], B[part], Q[part]).X, whole[part])


@pytest.mark.slow
def test_batches_of_batches_and_shared_operands():
    A, B, Q = random_pairs(6, seed=7)
    G, rate = B @ B.mT, rate_of(A, B, Q)
    expected = are.care(A, B, Q).X
    with jax.enable_x64(True):
        grid = jax.vmap(jax.vmap(riccati.stabilising))(*(a.reshape(2, 3, *a.shape[1:]) for a in (A, G, Q, rate)))
        shared = jax.vmap(riccati.stabilising, (None, None, 0, None))(A[0], G[0], Q, rate[0])
    np.testing.assert_allclose(np.asarray(grid.X).reshape(6, 6, 6), expected, rtol=1e-11)
    np.testing.assert_allclose(shared.X[0], expected[0], rtol=1e-11)
    np.testing.assert_allclose(are.care(A[0], B[0], Q).X[0], expected[0], rtol=1e-11)


def test_discrete_agrees_with_scipy():
    A, B, Q = random_pairs(300, seed=8)
    A *= 0.6
    s = are.dare(A, B, Q)
    assert s.ok.all()
    expected = np.array([sla.solve_discrete_are(a, b, q, np.eye(3)) for a, b, q in zip(A, B, Q, strict=True)])
    assert relative(s.X, expected).max() < GAIN
    assert not are.dare([[2.0]], [[0.0]], [[1.0]]).ok


def test_the_callers_jax_is_left_as_it_was():
    before = jax.config.jax_enable_x64
    are.care([[0.0]], [[1.0]], [[1.0]])
    assert jax.config.jax_enable_x64 == before


def test_single_precision_is_refused():
    A, B, Q = random_pairs(1)
    with jax.enable_x64(False), pytest.raises(ModelError, match=r"float32.*enable_x64"):
        riccati.stabilising(A[0], B[0] @ B[0].T, Q[0], 1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A": np.eye(3)}, r"A has shape \(3, 3\).*needs 2 x 2"),
        ({"Q": np.full((2, 2), np.nan)}, "Q is no array of finite"),
        ({"R": np.eye(3)}, r"R has shape \(3, 3\)"),
        ({"B": [1.0, 2.0]}, "B is no array"),
        ({"Q": np.array([[1.0, 1.0], [0.0, 1.0]])}, "Q is not symmetric: asymmetry 1"),
        ({"R": np.zeros((1, 1))}, "R is not symmetric positive definite: eigenvalue 0"),
        ({"N": np.ones((1, 2))}, r"N has shape \(1, 2\).*needs 2 x 1"),
        ({"E": np.ones((2, 2))}, "E is singular"),
    ],
)
def test_bad_data_is_named(change, message):
    with pytest.raises(ModelError, match=message):
        are.care(**({"A": np.eye(2), "B": np.ones((2, 1)), "Q": np.eye(2)} | change))
