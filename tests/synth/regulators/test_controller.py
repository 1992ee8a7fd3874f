import pickle

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth.errors import ModelError
from synth.regulators.controller import LinearController, proportional_derivative, state_feedback
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

INERTIA = np.array([0.0546, 0.0546, 0.0074])  # kg m^2


def random_system(n, m, p, seed=0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, rng.standard_normal((n, p)), rng.standard_normal((m, n)), rng.standard_normal((m, p)), 0.5)


def test_linear_controller_is_the_system_driven_by_the_error():
    K = random_system(4, 2, 3)
    rng = np.random.default_rng(1)
    y, r = rng.standard_normal((20, 3)), rng.standard_normal((20, 3))
    expected = control.forced_response(K.to_control(), U=(r - y).T).outputs
    controller = LinearController.of(K)
    state, commands = controller.init(), []
    for yk, rk in zip(y, r, strict=True):
        state, u = controller.step(state, yk, rk)
        commands.append(u)
    np.testing.assert_allclose(np.array(commands).T, expected, rtol=1e-12, atol=1e-12)


def test_step_leaves_its_arguments_alone_and_repeats_to_the_bit():
    controller = LinearController.of(random_system(4, 2, 3))
    state, y, r = np.ones(4), np.ones(3), np.zeros(3)
    first = controller.step(state, y, r)
    second = controller.step(state, y, r)
    np.testing.assert_array_equal(state, np.ones(4))
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)


def test_same_lines_run_compiled():
    jax = pytest.importorskip("jax", reason="the compiled simulator needs JAX")
    controller = LinearController.of(random_system(4, 2, 3))
    state, y, r = np.arange(4.0), np.array([0.1, -0.2, 0.3]), np.zeros(3)
    expected = controller.step(state, y, r)
    with jax.enable_x64(True):
        fields = (controller.A, controller.B, controller.C, controller.D)

        @jax.jit
        def step(fields, state, y, r):
            return LinearController(*fields, dt=0.5).step(state, y, r)

        actual = step(fields, state, y, r)
        for a, b in zip(actual, expected, strict=True):
            np.testing.assert_allclose(np.asarray(a), b, rtol=1e-14, atol=1e-14)


def test_of_accepts_control_and_pickles():
    K = random_system(3, 1, 2)
    a, b = LinearController.of(K.to_control()), pickle.loads(pickle.dumps(LinearController.of(K)))
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(a, name), getattr(K, name))
        np.testing.assert_array_equal(getattr(b, name), getattr(K, name))
    assert a.dt == b.dt == 0.5


def test_continuous_controller_is_refused():
    with pytest.raises(ModelError, match=r"dt = 0\.0.*c2d"):
        LinearController.of(StateSpace(-np.eye(1), np.eye(1), np.eye(1), np.zeros((1, 1))))


def test_state_feedback_is_a_gain_on_the_error():
    controller = state_feedback([[1.0, 2.0]], 0.5)
    state, u = controller.step(controller.init(), np.array([1.0, 1.0]), np.array([0.0, 2.0]))
    assert state.shape == (0,)
    np.testing.assert_array_equal(u, [1.0])


def test_proportional_derivative_gives_the_poles_asked_for():
    wn, zeta, dt = 0.17, 0.8, 0.5
    K = proportional_derivative(INERTIA, wn, zeta, dt).D
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3) / 2
    B = np.vstack([np.zeros((3, 3)), np.diag(1 / INERTIA)])
    expected = np.repeat(wn * (-zeta + 1j * np.sqrt(1 - zeta**2) * np.array([-1, 1])), 3)
    poles = np.linalg.eigvals(A - B @ K)
    np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(expected), rtol=1e-7)

    G = c2d(StateSpace(A, B, np.eye(6), np.zeros((6, 3))), dt)
    assert np.abs(np.linalg.eigvals(G.A - G.B @ K)).max() < 1


def test_proportional_derivative_takes_a_full_inertia_matrix():
    J = np.diag(INERTIA)
    np.testing.assert_array_equal(
        proportional_derivative(J, 0.17, 0.8, 0.5).D, proportional_derivative(INERTIA, 0.17, 0.8, 0.5).D
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wn": 0.0}, "wn is 0.0"),
        ({"zeta": -1.0}, "zeta is -1.0"),
        ({"zeta": np.nan}, "zeta is nan"),
        ({"inertia": [1.0, 1.0, -1.0]}, "inertia is"),
        ({"inertia": np.array([[1.0, 0.5, 0], [0, 1, 0], [0, 0, 1]])}, "inertia is"),
        ({"dt": 0.0}, "dt = 0.0"),
    ],
)
def test_bad_values_are_named(change, message):
    with pytest.raises(ModelError, match=message):
        proportional_derivative(**({"inertia": INERTIA, "wn": 0.17, "zeta": 0.8, "dt": 0.5} | change))


@given(order=st.integers(0, 6), more=st.integers(0, 6), seed=st.integers(0, 2**32 - 1))
def test_padding_changes_nothing(order, more, seed):
    rng = np.random.default_rng(seed)
    K = LinearController(*(rng.standard_normal(s) for s in ((order, order), (order, 3), (2, order), (2, 3))), dt=0.5)
    wide = K.padded(order + more)
    narrow, padded = K.init(), wide.init()
    for _ in range(5):
        y = rng.standard_normal(3)
        narrow, u = K.step(narrow, y, np.zeros(3))
        padded, v = wide.step(padded, y, np.zeros(3))
        np.testing.assert_allclose(v, u, rtol=0, atol=1e-13 * max(1, np.abs(u).max()))
        np.testing.assert_array_equal(padded[order:], 0)
    assert wide.dt == K.dt


@pytest.mark.parametrize("states", [3, -1, 4.0, None])
def test_padding_to_fewer_states_is_refused(states):
    with pytest.raises(ModelError, match="at least 4"):
        LinearController.of(random_system(4, 2, 3)).padded(states)
