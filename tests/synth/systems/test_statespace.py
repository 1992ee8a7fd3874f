"""State-space arithmetic against transfer matrices, and the errors of bad models."""

import pickle

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth.errors import ModelError
from synth.systems.connect import feedback, lft, series
from synth.systems.sampled import apart, c2d, cayley, inverse_cayley, pole_rate
from synth.systems.statespace import StateSpace

OMEGA = (0.03, 0.7, 2.9)


def system(seed: int, n: int = 4, m: int = 2, p: int = 3, dt: float = 0.5) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)), dt)


@pytest.mark.parametrize("dt", [0.0, 0.5])
@pytest.mark.parametrize("omega", OMEGA)
def test_interconnections_are_those_of_transfer_matrices(dt, omega):
    G, K = system(1, m=2, p=3, dt=dt), system(2, m=3, p=2, dt=dt)
    g, k = G.frequency_response(omega), K.frequency_response(omega)
    np.testing.assert_allclose(series(G, K).frequency_response(omega), k @ g, rtol=1e-9)
    np.testing.assert_allclose(
        feedback(G, K).frequency_response(omega), np.linalg.solve(np.eye(3) + g @ k, g), rtol=1e-9
    )
    P = system(3, m=5, p=6, dt=dt)
    p = P.frequency_response(omega)
    inner = np.linalg.solve(np.eye(2) - k @ p[3:, 3:], k)
    np.testing.assert_allclose(
        lft(P, K, 3, 2).frequency_response(omega), p[:3, :3] + p[:3, 3:] @ inner @ p[3:, :3], rtol=1e-9
    )


def test_zero_order_hold_and_tustin_agree_with_python_control():
    G = system(4, dt=0.0)
    for method in ("zoh", "tustin"):
        ours, theirs = c2d(G, 0.3, method), control.sample_system(G.to_control(), 0.3, method)
        for omega in OMEGA:
            np.testing.assert_allclose(
                ours.frequency_response(omega), theirs(np.exp(1j * omega * 0.3)), rtol=1e-9, atol=1e-12
            )


@given(st.integers(0, 10_000), st.floats(0.1, 10.0))
def test_cayley_maps_frequencies_and_comes_back(seed, rate):
    G = system(seed, dt=0.0)
    if np.abs(G.poles() - rate).min() < 1e-3:
        return
    H = cayley(G, rate)
    omega = 0.8
    angle = 2 * np.arctan(omega / rate)
    np.testing.assert_allclose(H.frequency_response(angle), G.frequency_response(omega), rtol=1e-6, atol=1e-9)
    back = inverse_cayley(H, rate)
    np.testing.assert_allclose(back.frequency_response(omega), G.frequency_response(omega), rtol=1e-6, atol=1e-9)


def test_cayley_rate_keeps_away_from_poles():
    G = StateSpace(np.diag([2.0, 2.0]), np.eye(2), np.eye(2), np.zeros((2, 2)))
    for rate in (pole_rate(G.poles()), *(apart(r, G.poles()) for r in (2.0, 1.9, 2.4))):
        assert np.abs(rate - 2.0) >= 0.25 * 2.0
    with pytest.raises(ModelError, match="another rate"):
        cayley(G, 2.0)


def test_conversions_keep_every_bit():
    G = system(5)
    for other in (
        StateSpace.of(G.to_control()),
        StateSpace.of((G.A, G.B, G.C, G.D, G.dt)),
        pickle.loads(pickle.dumps(G)),
    ):
        assert other.digest() == G.digest()
    assert system(6).digest() != G.digest()
    T = np.random.default_rng(0).normal(size=(4, 4))
    np.testing.assert_allclose(G.transform(T).frequency_response(0.4), G.frequency_response(0.4), rtol=1e-8)


def test_systems_are_immutable():
    G = system(7)
    with pytest.raises(ValueError, match="read-only"):
        G.A[0, 0] = 1.0


I2 = np.eye(2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((I2, I2, I2, np.full((2, 2), np.nan)), r"D\[0, 0\] is nan"),
        ((I2, I2, np.array([[1, 0], [0, np.inf]]), I2), r"C\[1, 1\] is inf"),
        ((I2, np.eye(3), I2, I2), "B is 3 x 3 where 2 x 2 is needed"),
        ((np.ones((2, 3)), I2, I2, I2), "A is 2 x 3 where 2 x 2 is needed"),
        ((I2, I2, I2, I2, -1.0), "dt is -1.0"),
        ((I2, I2, I2, I2, None), "timebase is unspecified"),
        ((I2, I2, I2, I2, False), "timebase is unspecified"),
        ((I2, I2, I2, I2, "fast"), "dt is 'fast'"),
        (([["a"]], I2, I2, I2), "A is not a real matrix"),
    ],
)
def test_bad_models_are_named(arguments, message):
    with pytest.raises(ModelError, match=message):
        StateSpace(*arguments)


def test_mixed_timebases_and_ill_posed_loops_are_refused():
    with pytest.raises(ModelError, match=r"timebases 0\.5 and 0\.0"):
        series(system(1, m=2, p=2), system(2, m=2, p=2, dt=0.0))
    gain = StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), np.ones((2, 2)), 1.0)
    with pytest.raises(ModelError, match="not well posed"):
        lft(gain, StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), 1.0), 1, 1)
    with pytest.raises(ModelError, match="already discrete"):
        c2d(system(1), 0.1)
    with pytest.raises(ModelError, match="is no state-space system"):
        StateSpace.of("G(s)")
    with pytest.raises(ModelError, match="timebase is unspecified"):
        StateSpace.of(control.ss(I2, I2, I2, I2, None))
