"""Transfer matrices become minimal, balanced matrices whose response is that of the polynomials."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import ModelError, hinfnorm, system
from synth.systems.realization import Matrices, in_principal_axes


def exact(num, den, s):
    return np.array(
        [
            [np.polyval(n, s) / np.polyval(d, s) for n, d in zip(*rows, strict=True)]
            for rows in zip(num, den, strict=True)
        ]
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.1]), st.integers(1, 3), st.integers(1, 3))
def test_responses_are_those_of_the_polynomials(seed, dt, p, m):
    rng = np.random.default_rng(seed)
    orders = rng.integers(0, 5, (p, m))
    scale = 1.0 if dt else 10.0 ** rng.uniform(-4, 4)
    roots = [[rng.normal(size=k) * (0.5 if dt else scale) - (0 if dt else scale) for k in row] for row in orders]
    den = [[np.atleast_1d(np.poly(r)) for r in row] for row in roots]
    num = [[np.atleast_1d(np.poly(rng.normal(size=len(d) - 1) * scale)) * rng.normal() for d in row] for row in den]
    G = system((num, den, dt))
    points = np.exp(1j * np.linspace(0.1, 3.0, 7)) if dt else 1j * scale * np.geomspace(0.1, 10, 7)
    for s in points:
        np.testing.assert_allclose(
            G.matrices.at(s), exact(num, den, s), rtol=1e-6, atol=1e-9 * np.abs(G.D).max(initial=1)
        )


@pytest.mark.parametrize(
    ("num", "den", "order"),
    [
        ([[[1], [2]], [[3], [4]]], [[[1, 1]] * 2] * 2, 2),  # residue of rank two
        ([[[1], [2]], [[2], [4]]], [[[1, 1]] * 2] * 2, 1),  # residue of rank one
        ([[[1], [1]]], [[[1, 0], [1, 0]]], 1),  # one integrator for two inputs
        ([[[1]], [[1]]], [[[1, 0, 0]], [[1, 0, 0]]], 2),  # one double integrator for two outputs
        ([[[1, 1]]], [[[1, 3, 2]]], 1),  # (s + 1)/((s + 1)(s + 2))
        ([[[1], [0]], [[0], [1]]], [[[1, 0, 0], [1]], [[1], [1, 0, 0]]], 4),  # two axes
        ([[[5]]], [[[2]]], 0),
    ],
)
def test_realisations_are_minimal(num, den, order):
    assert system((num, den)).n == order


def test_one_denominator_for_all_and_the_forms_of_scipy():
    G = system([[1.0], [2.0, 0.0]], [1.0, 3.0, 2.0])  # rows of numerators over one denominator
    assert (G.ny, G.nu, G.n) == (2, 1, 2)
    np.testing.assert_allclose(G.matrices.at(1j)[:, 0], [1 / (1 + 3j), 2j / (1 + 3j)], rtol=1e-12)


def test_coordinates_are_balanced_whatever_the_time_unit():
    for rate in (1e-5, 1.0, 1e6):
        G = system([rate**2], [1.0, 0.4 * rate, rate**2])
        assert np.abs(G.A).max() < 10 * rate
        assert hinfnorm(G)[0] == pytest.approx(1 / (0.4 * np.sqrt(1 - 0.04)), rel=1e-9)


def size(G):
    """Of A, B and C in units of the fastest pole, which is 2 to 3 in what is drawn below."""
    return np.sqrt(sum(np.linalg.norm(M) ** 2 for M in G[:3]))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6), st.floats(0, 4))
def test_turns_do_not_hide_bad_coordinates(seed, n, decades):
    """A stable lag of every state, scaled and turned: as small again as before, the response kept."""
    rng = np.random.default_rng(seed)
    A, B, C = rng.normal(size=(n, n)) / np.sqrt(n) - 2 * np.eye(n), rng.normal(size=(n, 2)), rng.normal(size=(2, n))
    d, Q = 10 ** rng.uniform(-decades / 2, decades / 2, n), np.linalg.qr(rng.normal(size=(n, n)))[0]
    D = np.eye(2)
    moved = Matrices(Q.T @ (A * d / d[:, None]) @ Q, Q.T @ (B / d[:, None]), (C * d) @ Q, D)
    found = in_principal_axes(moved)
    assert size(found) <= 4 * size((A, B, C))
    for s in (0, 1j, 10j):
        np.testing.assert_allclose(found.at(s), Matrices(A, B, C, D).at(s), atol=1e-15 * 10 ** (2 * decades + 2))


def test_good_coordinates_are_only_scaled():
    G = system(np.diag([-1e-4, 1.0, -1e4]), np.diag([1e-2, 1.0, 1e2]), np.eye(3), np.zeros((3, 3)))
    assert all(np.count_nonzero(M) == 3 for M in in_principal_axes(G.matrices)[:3])


@pytest.mark.parametrize("entry", [0.0, 1e-300, 1e300])
@pytest.mark.parametrize("n", [0, 1, 3])
def test_coordinates_of_nothing_and_of_too_much(n, entry):
    G = Matrices(np.full((n, n), entry), np.zeros((n, 1)), np.full((1, n), entry), np.zeros((1, 1)))
    assert all(np.isfinite(M).all() for M in in_principal_axes(G))


def test_zeros_and_poles_keep_digits_that_coefficients_lose():
    poles = -np.geomspace(1e-3, 1e3, 20)
    G = system({"zeros": [], "poles": poles, "gain": np.prod(poles)})
    for w in (1e-4, 0.1, 30.0):
        assert G.matrices.at(1j * w)[0, 0] == pytest.approx(np.prod(poles / (poles - 1j * w)), rel=1e-9)


def test_what_double_precision_cannot_hold_is_refused_with_the_error():
    with pytest.raises(ModelError, match=r"cannot be realised.* off by .* pass zeros, poles and gain"):
        system([1.0], np.poly(-np.geomspace(1e-6, 1e6, 40)))


@pytest.mark.parametrize(
    ("description", "message"),
    [
        (([1, 0], [1]), "improper in entry \\(0, 0\\): the numerator has degree 1, the denominator 0"),
        (([1], [0]), "denominator 0"),
        (([1], []), "empty polynomial"),
        (([[[1]]], [[[1, 1], [1]]]), "1 x 1 numerators and 1 x 2 denominators"),
        (([1], ["a"]), "polynomial of the system"),
        ({"zeros": [1, 2], "poles": [3], "gain": 1}, "2 zeros and 1 poles: it is improper"),
        ({"zeros": [1j], "poles": [3, 4], "gain": 1}, "without their conjugates"),
        ({"zeros": [], "poles": [3], "gain": "k"}, "gain of the system is 'k'"),
        ({"zeros": [], "poles": [3]}, "has no gain"),
        ({"num": [1]}, "has no den"),
    ],
)
def test_what_is_wrong_is_named(description, message):
    with pytest.raises(ModelError, match=message):
        system(description)
