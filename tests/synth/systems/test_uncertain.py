"""Uncertain parameters, polynomials in them and uncertain systems: exact, and the certain system at every point."""

import pickle
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, UncertainSystem, ureal
from synth.systems.parameters import Expression

OMEGA = np.array([0.03, 0.7, 2.9])
NUMBERS = st.floats(-1e3, 1e3)


def response(G):
    return G.frequency_response(OMEGA)


def random_system(seed: int, dt: float = 0.0, ny: int = 2, nu: int = 2, direct: bool = True) -> UncertainSystem:
    """Three states, two parameters, one of them squared."""
    rng = np.random.default_rng(seed)
    a, b = ureal("a", 1.0, percentage=20), ureal("b", -0.5, range=(-0.6, 0.1))
    A = rng.normal(size=(3, 3)) * 0.3 - (0 if dt else 1) * np.eye(3)
    D = (rng.normal(size=(ny, nu)) * 0.3 + 0.2 * b) if direct else 0
    return UncertainSystem(
        E=np.eye(3) + 0.1 * rng.normal(size=(3, 3)) * (a - 1), A=A + 0.1 * rng.normal(size=(3, 3)) * a * a * b,
        B=rng.normal(size=(3, nu)), C=rng.normal(size=(ny, 3)) * a, D=D, dt=dt,
    )  # fmt: skip


def points(G: UncertainSystem, n: int = 3):
    return [values for values, _ in G.sample(n, 5)] + [{}]


@given(NUMBERS, NUMBERS, st.integers(0, 4), NUMBERS, NUMBERS)
def test_expressions_are_polynomials_with_exact_coefficients(c, d, k, x, y):
    a, b = ureal("a", 0.0, range=(-1e3, 1e3)), ureal("b", 0.0, range=(-1e3, 1e3))
    found = (c * a - b / 4 + d) ** k * (1 - b) + np.float64(c) * b
    exact = {"a": Fraction(x), "b": Fraction(y)}
    C, D, X, Y = (Fraction(v) for v in (c, d, x, y))
    assert found.exactly(exact) == (C * X - Y / 4 + D) ** k * (1 - Y) + C * Y


def test_numbers_arrays_and_expressions_mix():
    J = ureal("J", 2.0, percentage=10)
    for M in (J * np.eye(2), np.eye(2) * J, np.eye(2) + J - J * np.ones((2, 2)) + (J - 1) * np.eye(2)):
        assert M.shape == (2, 2)
        assert all(isinstance(entry, Expression) for entry in M.flat)
        assert M[0, 0].nominal == 2.0
        assert M[0, 1].is_zero
    assert (J - J).is_zero
    assert not (J - J).parameters
    assert repr(pickle.loads(pickle.dumps(J * J + 1))) == "J^2 + 1"


@pytest.mark.parametrize(
    ("given_range", "low", "high"),
    [
        ({"percentage": 20}, -4.8, -3.2), ({"percentage": (-10, 50)}, -4.4, -2.0), ({"plusminus": 0.5}, -4.5, -3.5),
        ({"plusminus": (-1, 0.25)}, -5.0, -3.75), ({"range": [-5, -3.5]}, -5.0, -3.5),
    ],
)  # fmt: skip
def test_ranges(given_range, low, high):
    p = ureal("x", -4.0, **given_range).parameters["x"]
    assert p.range == (low, high)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda J: 1 / J, "mass matrix E"),
        (lambda J: J**-1, "mass matrix E"),
        (lambda J: np.eye(2) / J, "mass matrix E"),
        (lambda J: J + ureal("J", 2.0, range=(0, 3)), "given twice"),
        (lambda J: [[J, np.nan]], "finite"),
        (lambda J: [[J], [1, 2]], "A"),
        (lambda J: ureal("w", 1.0), "one of range, percentage and plusminus"),
        (lambda J: ureal("w", 1.0, range=(0, 1), percentage=3), "range and percentage"),
        (lambda J: ureal("w", 5.0, range=(0, 1)), "holds the nominal value"),
        (lambda J: ureal("w", 0.0, percentage=10), "width"),
        (lambda J: ureal(" ", 0.0, plusminus=10), "name"),
        (lambda J: UncertainSystem(A=[[J, 1], [0, 1]], B=[1, 2, 3], C=[1, 0]), "B has shape"),
        (lambda J: UncertainSystem(J - 2, A=J, B=1, C=1), "E is singular"),
        (lambda J: UncertainSystem(J, A=J, B=1, C=1).at({"K": 1}), "no parameter"),
        (lambda J: UncertainSystem(J, A=J, B=1, C=1).at({"J": 3.0}), "outside"),
        (lambda J: UncertainSystem(J, A=J, B=1, C=1, dt=1).feedback(synth.system(2, dt=2)), "timebase"),
        (lambda J: UncertainSystem(J, A=J, B=1, C=1).feedback(np.ones((2, 3))), "3"),
        (lambda J: UncertainSystem(J, A=J, B=1, C=1, D=1).feedback(-1.0), "not well posed"),
    ],
)
def test_what_is_wrong_is_named(call, message):
    J = ureal("J", 2.0, percentage=10)
    with pytest.raises(ModelError, match=message):
        UncertainSystem(A=call(J), B=[1, 0], C=[1, 0])


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([0.0, 0.5]))
def test_connections_commute_with_choosing_the_parameters(seed, dt):
    G, H = random_system(seed, dt), random_system(seed + 1, dt)
    K = synth.system(0.2 * H.nominal.A, H.nominal.B, H.nominal.C, 0.1 * H.nominal.D, dt=dt)
    for found, expected in (
        (G.series(H), lambda v: synth.series(G.at(v), H.at(v))),
        (synth.series(K, G), lambda v: synth.series(K, G.at(v))),
        (G.feedback(H), lambda v: synth.feedback(G.at(v), H.at(v))),
        (synth.feedback(G, 0.5, 1), lambda v: synth.feedback(G.at(v), 0.5, 1)),
        (synth.feedback(K, G), lambda v: synth.feedback(K, G.at(v))),
        (synth.lft(G, synth.system(0.3, dt=dt)), lambda v: synth.lft(G.at(v), synth.system(0.3, dt=dt))),
    ):
        for v in points(found):
            np.testing.assert_allclose(response(found.at(v)), response(expected(v)), rtol=1e-9, atol=1e-11)


def test_a_loop_without_direct_terms_gets_no_algebraic_states():
    G = random_system(3, direct=False)
    assert G.feedback(0.5).n == 3
    assert random_system(3).feedback(0.5).n == 5
    assert random_system(3).feedback(0.5).nominal.n == 3


def test_close_takes_a_design():
    P = synth.augw(synth.system([1], [1, 1]), 1.0, 0.1)
    design = synth.hinfsyn(P.system, 1, 1)
    M = P.system.matrices
    uncertain = UncertainSystem(ureal("m", 1.0, percentage=10) * np.eye(len(M.A)), *M)
    np.testing.assert_allclose(response(uncertain.close(design).nominal), response(design.closed_loop), atol=1e-12)


def test_samples_and_grids():
    G = random_system(0)
    assert [v for v, _ in G.sample(4, 7)] == [v for v, _ in G.sample(4, 7)]
    assert all(p.low <= v[n] <= p.high for v, _ in G.sample(50, 1) for n, p in G.parameters.items())
    grid = G.gridded(3)
    assert len(grid) == 9
    assert {v["b"] for v, _ in grid} == {-0.6, -0.25, 0.1}
    with pytest.raises(ModelError, match="points"):
        G.gridded(1000)


@pytest.mark.parametrize("seed", range(3))
def test_tustins_map_is_exact_in_the_parameters(seed):
    G = random_system(seed)
    for H in (G, G.feedback(0.3)):  # with algebraic states
        found = synth.c2d(H, 0.2, "tustin")
        for v in points(H):
            expected = synth.c2d(H.at(v), 0.2, "tustin")
            np.testing.assert_allclose(response(found.at(v)), response(expected), rtol=1e-9, atol=1e-11)
            poles = np.sort_complex(found.at(v).poles())
            np.testing.assert_allclose(poles, np.sort_complex(expected.poles()), rtol=1e-8)
    with pytest.raises(ModelError, match="tustin"):
        synth.c2d(G.feedback(0.3), 0.2)  # a hold of algebraic states


@pytest.mark.parametrize("seed", range(3))
def test_the_midpoint_rule_is_that_of_every_system_and_keeps_the_degrees(seed):
    G = random_system(seed)
    found = synth.c2d(G, 0.2, "midpoint")
    for v in points(G):
        expected = synth.c2d(G.at(v), 0.2, "midpoint")
        np.testing.assert_allclose(response(found.at(v)), response(expected), rtol=1e-9, atol=1e-11)
    degrees = [max(k for e in M.flat for m in e.terms for _, k in m) for M in (G.E, G.A, found.E, found.A)]
    assert max(degrees[2:]) <= max(degrees[:2])
    with pytest.raises(ModelError, match="algebraic"):
        synth.c2d(G.feedback(0.3), 0.2, "midpoint")


def test_the_midpoint_rule_is_the_hold_of_a_body_at_rest_and_of_third_order_elsewhere():
    J = ureal("J", 2.0, percentage=40)
    body = UncertainSystem([[1, 0], [0, J]], [[0, 1], [0, 0]], [0, 1], [1, 0])
    for v, H in body.gridded(5):
        held, ours = synth.c2d(H, 0.7), synth.c2d(body, 0.7, "midpoint").at(v)
        np.testing.assert_allclose(np.hstack([ours.A, ours.B]), np.hstack([held.A, held.B]), rtol=1e-14)
    G = random_system(1).nominal
    off = [np.abs(synth.c2d(G, h, "midpoint").A - synth.c2d(G, h).A).max() for h in (1e-2, 5e-3)]
    assert off[0] / off[1] == pytest.approx(8.0, rel=0.05)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_hold_equivalent_of_bodies_is_exact_in_their_masses(seed):
    """Chains of integrators behind coupled masses, with parameters in B and C too."""
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(1, 4)), float(10 ** rng.uniform(-2, 1))
    m, b = ureal("m", 1.5, percentage=40), ureal("b", 1.0, percentage=10)
    V = rng.normal(size=(n, n))
    M = (np.eye(n) + V @ V.T).astype(object)
    M[0, 0] = M[0, 0] + m
    I, Z = np.eye(n), np.zeros((n, n))
    order = rng.permutation(2 * n)
    E, A = np.block([[I, Z], [Z, M]])[np.ix_(order, order)], np.block([[Z, I], [Z, Z]])[np.ix_(order, order)]
    G = UncertainSystem(E, A, np.vstack([Z, I])[order] * b, np.hstack([b * I, rng.normal() * I])[:, order])
    found = synth.c2d(G, dt)
    for v, H in G.sample(3, seed):
        np.testing.assert_allclose(response(found.at(v)), response(synth.c2d(H, dt)), rtol=1e-8)
        assert found.at(v).n == 2 * n


def test_the_hold_equivalent_with_certain_poles_and_of_what_has_none():
    k, c = ureal("k", 1.0, percentage=40), ureal("c", 1.0, percentage=10)
    G = UncertainSystem([[2, 0], [0.5, 1]], [[0, 1], [-1, -0.1]], [0, k], [1, c])
    for v, H in G.sample(3):
        np.testing.assert_allclose(response(synth.c2d(G, 0.3).at(v)), response(synth.c2d(H, 0.3)), rtol=1e-10)
    with pytest.raises(ModelError, match="tustin"):
        synth.c2d(UncertainSystem([[k, 0], [0, 0]], [[0, 1], [0, 1]], [1, 1], [1, 0]), 0.3)


def test_a_sampled_body_is_proved_over_its_inertia():
    J = ureal("J", 2.0, percentage=30)
    G = synth.c2d(UncertainSystem([[1, 0], [0, J]], [[0, 1], [0, 0]], [0, 1], [1, 0]), 0.1)
    K = synth.system([[0.0]], [[1.0]], [[1.0]], [[-1.4]], dt=0.1)  # -(1.4 - 1/z)
    found = synth.worst_gain(G.feedback(K, 1))
    assert found.gap < 2e-5
    worst = [synth.hinfnorm(H.feedback(K, 1))[0] for _, H in G.gridded(9)]
    assert max(worst) <= found.upper < max(worst) * (1 + 1e-3)
