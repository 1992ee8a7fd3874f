"""Operators, indexing, zeros and responses of systems, against python-control and against transfer matrices."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from synth import ModelError, StateSpace, c2d, feedback, system

OMEGA = np.array([0.03, 0.7, 2.9])


def random(seed: int, n: int = 4, m: int = 2, p: int = 2, dt: float = 0.5) -> StateSpace:
    rng = np.random.default_rng(seed)
    A, D = rng.normal(size=(n, n)), rng.normal(size=(p, m)) + 2 * np.eye(p, m)
    A = A / (1.2 * np.abs(np.linalg.eigvals(A)).max()) - (0 if dt else 1.5) * np.eye(n)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), D, dt)


@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.5]))
def test_operators_are_those_of_transfer_matrices(seed, dt):
    G, H = random(seed, dt=dt), random(seed + 1, n=3, dt=dt)
    g, h = G.frequency_response(OMEGA), H.frequency_response(OMEGA)
    M, I = np.array([[1.0, 2.0], [0.5, -1.0]]), np.eye(2)
    for found, expected in (
        (G + H, g + h), (G - H, g - h), (G * H, g @ h), (G / H, g @ np.linalg.inv(h)), (-G, -g), (G**2, g @ g),
        (G**-1, np.linalg.inv(g)), (G**0, np.broadcast_to(I, g.shape)), (~G, g.conj().swapaxes(1, 2)),
        (G + 2.0, g + 2.0), (2.0 - G, 2.0 - g), (3 * G, 3 * g), (G * M, g @ M), (M * G, M @ g), (G + M, g + M),
        (M - G, M - g), (1 / G, np.linalg.inv(g)),
        (H.to_control() * G, h @ g), (G * H.to_control(), g @ h), (G + H.to_control(), g + h),
        (G.feedback(), np.linalg.solve(I + g, g)), (feedback(G, H, sign=1), np.linalg.solve(I - g @ h, g)),
    ):  # fmt: skip
        np.testing.assert_allclose(found.frequency_response(OMEGA), expected, rtol=1e-7, atol=1e-9)


def test_python_control_closes_our_systems_and_multiplies_them():
    G, PI = system([1], [1, 0.4, 1]), control.tf([1, 2], [1, 0])
    loop = control.feedback(G, PI)
    g, k = G.frequency_response(OMEGA)[:, 0, 0], PI(1j * OMEGA)
    np.testing.assert_allclose(loop.frequency_response(OMEGA)[:, 0, 0], g / (1 + g * k), rtol=1e-9)
    for product in (PI * G, G * PI):
        assert isinstance(product, StateSpace)
        np.testing.assert_allclose(product.frequency_response(OMEGA)[:, 0, 0], g * k, rtol=1e-9)


def test_one_signal_serves_every_channel():
    G, lag = random(3), c2d(system([1], [1, 1]), 0.5)
    expected = G.frequency_response(OMEGA) * lag.frequency_response(OMEGA)
    np.testing.assert_allclose((lag * G).frequency_response(OMEGA), expected, rtol=1e-9)
    np.testing.assert_allclose((G * lag).frequency_response(OMEGA), expected, rtol=1e-9)


def test_names_travel():
    G = system(random(1, m=2, p=3), u=["torque x", "torque y"], y=["q1", "q2", "q3"], units={"torque x": "N m"})
    assert G["q2", "torque y"].D[0, 0] == G.D[1, 1]
    part = G[["q3", 0], :1]
    assert (part.y, part.u, dict(part.units)) == (("q3", "q1"), ("torque x",), {"torque x": "N m"})
    np.testing.assert_array_equal(part.D, G.D[[2, 0], :1])
    there_and_back = system(G.to_control())
    assert (there_and_back.u, there_and_back.y) == (G.u, G.y)
    assert (system(2.0, dt=0.5) * G).u == G.u
    assert (G[:2, :].feedback(0.1)).y == ("q1", "q2")
    with pytest.raises(ModelError, match="no output 'q4'; there are q1, q2, q3"):
        G["q4", 0]
    with pytest.raises(ModelError, match="number from 0 to 1"):
        G[0, 2]


def same(found: np.ndarray, wanted: np.ndarray) -> bool:
    """The same numbers in any order."""
    return len(found) == len(wanted) and all(np.abs(found - w).min() < 1e-6 for w in wanted)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("shape", [(2, 2), (2, 3), (3, 2), (1, 1)])
def test_transmission_zeros_are_where_rank_is_lost(seed, shape):
    p, m = shape
    rng = np.random.default_rng(seed)
    wanted = np.array([-0.3, 0.7 + 0.2j, 0.7 - 0.2j])
    # a diagonal of zeros between two invertible mixings, a row or a column of zeros beside it
    parts = [system({"zeros": wanted, "poles": [-1, -2, -3.5], "gain": 1.0}), *(system([1], [1, 1]),) * (min(p, m) - 1)]
    D = (
        sum(np.eye(p, min(p, m))[:, [i]] * part * np.eye(min(p, m), m)[[i]] for i, part in enumerate(parts[1:], 1))
        + np.eye(p, min(p, m))[:, [0]] * parts[0] * np.eye(min(p, m), m)[[0]]
    )
    G = rng.normal(size=(p, p)) * D * rng.normal(size=(m, m))
    assert same(G.zeros(), wanted)


def test_zeros_agree_with_python_control():
    G = random(5, n=6, dt=0.0)
    assert same(G.zeros(), G.to_control().zeros())


def test_gain_at_rest_and_transfer_function():
    G = system(([[[1]], [[2, 1]]], [[[1, 0]], [[1, 3]]]))
    np.testing.assert_allclose(G.dcgain(), [[np.inf], [1 / 3]])
    assert c2d(system([2], [1, 1]), 0.1).dcgain() == pytest.approx(2.0)
    H = random(2, dt=0.0)
    np.testing.assert_allclose([H.tf()(1j * w) for w in OMEGA], H.frequency_response(OMEGA), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_responses_are_those_of_python_control(dt):
    G = random(4, dt=dt)
    G = G if dt else StateSpace(G.A, G.B, G.C, 0)  # an impulse through D has no picture
    time = np.arange(20) * (dt or 0.25)
    for ours, theirs in (
        (G.step_response(time), control.step_response(G.to_control(), time)),
        (G.impulse_response(time), control.impulse_response(G.to_control(), time)),
    ):
        np.testing.assert_allclose(ours.time, theirs.time)
        np.testing.assert_allclose(np.moveaxis(ours.values, 0, 2), theirs.outputs, rtol=1e-6, atol=1e-9)


def test_default_time_shows_the_answer():
    for G in (system([1], [1, 0.1, 1]), system([1], [100, 1]), system([1], [1, 0, 0]), system(3.0)):
        for H in (G, c2d(G, 0.2)):
            response = H.step_response()
            assert 10 <= len(response.time) <= 20_000
    settled = system([1], [1, 0.1, 1]).step_response().values[-1, 0, 0]
    assert settled == pytest.approx(1.0, abs=0.02)


def test_bad_operands_are_refused():
    G = random(1)
    for wrong, message in (
        (lambda: G + random(2, p=3), "cannot be added"),
        (lambda: G * "x", "no state-space system"),
        (lambda: G * c2d(system([1], [1, 1]), 0.1), "timebases"),
        (lambda: 1 / system([1], [1, 1]), "improper"),
        (lambda: G**0.5, "whole number"),
        (lambda: ~system([1], [1, 0], dt=0.1), "poles at infinity"),
        (lambda: G[0], "outputs and inputs"),
        (lambda: system(control.tf([1, 0], [1])), "improper"),
        (lambda: G.feedback(0.1, sign=0), "sign is 0"),
        (lambda: G.step_response([0.0, 0.3]), "no row of samples"),
    ):
        with pytest.raises(ModelError, match=message):
            wrong()


@pytest.mark.parametrize("seed", range(5))
def test_well_posed_loops_of_gains_in_any_units(seed):
    """u in units sixteen decades apart: I - Dk D22 is a similarity away from a tame matrix."""
    rng = np.random.default_rng(seed)
    D, K = rng.normal(size=(2, 3)), rng.normal(size=(3, 2))
    units = 10.0 ** rng.uniform(-8, 8, 3)
    expected = np.linalg.solve(np.eye(2) + D @ K, D)
    found = StateSpace.gain(D * units, 1.0).feedback(StateSpace.gain(K / units[:, None], 1.0))
    np.testing.assert_allclose(found.D, expected * units, rtol=1e-9, atol=1e-9 * np.abs(expected * units).min())
    with pytest.raises(ModelError, match="not well posed"):
        StateSpace.gain([[1.0]], 1.0).feedback(-1)
