import control
import numpy as np
import pytest

from synth.errors import AssumptionError, ModelError
from synth.regulators.regulator import dlqr, lqg, lqr
from synth.systems.connect import feedback
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace


def problem(n=5, m=2, p=2, seed=0):
    rng = np.random.default_rng(seed)
    F, H = rng.standard_normal((n + m, n + m)), rng.standard_normal((n + p, n + p))
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, m)), rng.standard_normal((p, n))
    return A, B, C, F @ F.T + np.eye(n + m), H @ H.T + np.eye(n + p)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("ours", "theirs"), [(lqr, control.lqr), (dlqr, control.dlqr)])
def test_agrees_with_python_control(ours, theirs, seed):
    A, B, _, W, _ = problem(seed=seed)
    Q, R, N = W[:5, :5], W[5:, 5:], W[:5, 5:]
    for weights in ((Q, R), (Q, R, N)):
        for a, b in zip(ours(A, B, *weights)[:2], theirs(A, B, *weights)[:2], strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7 * np.abs(b).max())
        K, S, E = ours(A, B, *weights)
        np.testing.assert_allclose(np.sort_complex(E), np.sort_complex(np.linalg.eigvals(A - B @ K)), rtol=1e-9)
        np.testing.assert_array_equal(S, S.T)


def test_double_integrator_by_hand():
    K, S, E = lqr([[0, 1], [0, 0]], [[0], [1]], np.eye(2), [[1]])
    np.testing.assert_allclose(K, [[1, np.sqrt(3)]], rtol=1e-12)
    np.testing.assert_allclose(S, [[np.sqrt(3), 1], [1, np.sqrt(3)]], rtol=1e-12)
    np.testing.assert_allclose(E.real, -np.sqrt(3) / 2, rtol=1e-12)


def test_cost_is_the_quadratic_form_of_the_solution():
    A, B, _, W, _ = problem(seed=7)
    Q, R = W[:5, :5], W[5:, 5:]
    A = A / 2
    K, S, _ = dlqr(A, B, Q, R)
    x0 = np.arange(1.0, 6.0)
    x, cost = x0, 0.0
    for _ in range(2000):
        u = -K @ x
        cost += x @ Q @ x + u @ R @ u
        x = A @ x + B @ u
    assert cost == pytest.approx(x0 @ S @ x0, rel=1e-9)


def test_unreachable_mode_is_named():
    with pytest.raises(AssumptionError, match=r"eigenvalue 2 ") as error:
        lqr(np.diag([2.0, -1.0]), [[0.0], [1.0]], np.eye(2), [[1.0]])
    assert error.value.assumption == "(A, B) stabilisable"
    with pytest.raises(AssumptionError, match=r"eigenvalue 2 "):
        dlqr(np.diag([2.0, 0.1]), [[0.0], [1.0]], np.eye(2), [[1.0]])


def test_unseen_mode_on_the_boundary_is_named():
    with pytest.raises(AssumptionError, match="eigenvalue 0") as error:
        lqr(np.zeros((2, 2)), np.eye(2), np.diag([1.0, 0.0]), np.eye(2))
    assert error.value.modes == (0j,)
    with pytest.raises(AssumptionError, match="eigenvalue 1"):
        dlqr(np.eye(2), np.eye(2), np.diag([1.0, 0.0]), np.eye(2))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"R": [[0.0]]}, "R has the eigenvalue 0"),
        ({"Q": [[1.0, 1.0], [0.0, 1.0]]}, "Q is not symmetric"),
        ({"A": np.full((2, 2), np.nan)}, r"A\[0, 0\] is nan"),
        ({"B": np.ones((3, 1))}, "A is 2 x 2 where 3 x 3"),
        ({"R": [[-1.0]]}, "R has the eigenvalue -1"),
        ({"E": np.ones((2, 2))}, "E is singular"),
        ({"E": np.eye(3)}, "E is 3 x 3 where 2 x 2"),
    ],
)
def test_bad_data_is_named(change, message):
    with pytest.raises(ModelError, match=message):
        lqr(**({"A": np.zeros((2, 2)), "B": np.ones((2, 1)), "Q": np.eye(2), "R": [[1.0]]} | change))


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_lqg_separates(dt):
    """The loop's poles are those of the regulator and those of the filter."""
    A, B, C, W, V = problem(seed=3)
    G = StateSpace(A, B, C, np.full((2, 2), 0.3))
    G = c2d(G, dt) if dt else G
    K = lqg(G, W, V)
    solve = dlqr if dt else lqr
    regulator = solve(G.A, G.B, W[:5, :5], W[5:, 5:], W[:5, 5:])[2]
    estimator = solve(G.A.T, G.C.T, V[:5, :5], V[5:, 5:], V[:5, 5:])[2]
    loop = feedback(G, StateSpace(K.A, K.B, -K.C, K.D, K.dt))
    expected = np.sort_complex(np.concatenate([regulator, estimator]))
    np.testing.assert_allclose(np.sort_complex(loop.poles()), expected, rtol=1e-6)
    assert K.dt == G.dt


def test_lqg_filter_agrees_with_python_control():
    A, B, C, W, V = problem(seed=4)
    V[:5, 5:], V[5:, :5] = 0, 0  # it has no correlated noises
    K = lqg(StateSpace(A, B, C, np.zeros((2, 2))), W, V)
    L = control.lqe(A, np.eye(5), C, V[:5, :5], V[5:, 5:])[0]
    np.testing.assert_allclose(K.B, L, rtol=1e-7)
