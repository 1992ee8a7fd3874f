"""Hankel singular values, Gramians, balanced and minimal realisations against published values and definitions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg as sla
from families import KINDS, LOST, PLANTS, holding
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import aircraft_slicot

from synth import AssumptionError, StateSpace, balreal, c2d, gramians, hinfnorm, hsvd, minreal, system
from synth.analysis.differences import blur
from synth.analysis.hankel import grid
from synth.analysis.norms import in_principal_axes

DRAWS = (st.sampled_from(sorted(PLANTS)), st.integers(0, 2**32 - 1))
QUIET = {"deadline": None, "derandomize": True, "database": None}


def response(G) -> np.ndarray:
    return system(G).frequency_response(grid(system(G)))


def test_slicot_example_of_ab13ad():
    expected = [2.5139, 2.0846, 1.9178, 0.7666, 0.5473, 0.0253, 0.0246]  # as documented, to four places
    np.testing.assert_allclose(hsvd(aircraft_slicot()), expected, atol=5e-5)


def test_matlab_examples_of_balreal():
    """MathWorks, balreal: poles that nearly cancel, and 1/(s^2 - 1), whose unstable part stays."""
    G = system({"zeros": [-10, -20.01], "poles": [-5, -9.9, -20.1], "gain": 1.0})
    np.testing.assert_allclose(balreal(G).singular_values, [0.1006, 0.0001, 0.0], atol=5e-5)
    found = balreal(([1], [1, 0, -1]))
    np.testing.assert_allclose(found.singular_values, [np.inf, 0.25])
    np.testing.assert_allclose(response(found.system), response(([1], [1, 0, -1])))


@pytest.mark.parametrize("a", [0.0, 0.3, -0.9, 1 - 1e-6])
def test_one_pole_in_closed_form(a):
    """1/(z - a): 1/(1 - a^2); k/(s + p): k/(2 p)."""
    np.testing.assert_allclose(hsvd(StateSpace([[a]], [[1]], [[1]], [[0]], 0.1)), [1 / (1 - a * a)], rtol=1e-9)
    p = 1 - a
    np.testing.assert_allclose(hsvd(([3.0], [1, p])), [1.5 / p], rtol=1e-12)


def test_gramians_solve_their_equations():
    G = aircraft_slicot()
    W, M = gramians(G)
    np.testing.assert_allclose(G.A @ W + W @ G.A.T, -G.B @ G.B.T, atol=1e-12)
    np.testing.assert_allclose(G.A.T @ M + M @ G.A, -G.C.T @ G.C, atol=1e-12)
    H = c2d(G, 0.1)
    W, M = gramians(H)
    np.testing.assert_allclose(W, sla.solve_discrete_lyapunov(H.A, H.B @ H.B.T), atol=1e-10)
    np.testing.assert_allclose(M, sla.solve_discrete_lyapunov(H.A.T, H.C.T @ H.C), atol=1e-10)
    with pytest.raises(AssumptionError, match="not stable"):
        gramians(([1], [1, 0]))


@pytest.mark.parametrize("discrete", [False, True])
def test_slycot_has_the_same_values(discrete):
    slycot = pytest.importorskip("slycot", reason="slycot (SLICOT) is the oracle of this test")
    for seed in range(10):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(2, 12))
        A = rng.standard_normal((n, n)) / np.sqrt(n)
        values = np.linalg.eigvals(A)
        A = 0.95 * A / np.abs(values).max() if discrete else A - (values.real.max() + 0.1) * np.eye(n)
        B, C = rng.standard_normal((n, 2)), rng.standard_normal((3, n))
        expected = slycot.ab09ad("D" if discrete else "C", "B", "N", n, 2, 3, A, B, C, nr=n)[-1]
        np.testing.assert_allclose(hsvd((A, B, C, 0, 0.5 * discrete)), expected, rtol=1e-9, atol=1e-13 * expected[0])


@settings(max_examples=40, **QUIET)
@given(*DRAWS, st.sampled_from(KINDS), st.floats(-3, 3))
def test_coordinates_and_the_unit_of_time_change_nothing(family, seed, kind, decades):
    rng = np.random.default_rng(seed)
    G = PLANTS[family](rng)
    sigma = hsvd(G)
    finite = np.isfinite(sigma)
    top = sigma[finite].max(initial=0.0) or 1.0

    def loss(H: StateSpace) -> float:
        """What other coordinates have lost of the values already."""
        try:
            moved = hsvd(H)
        except Exception:
            return np.inf
        if not np.array_equal(np.isfinite(moved), finite):
            return np.inf
        return float(np.abs(moved[finite] - sigma[finite]).max(initial=0.0)) / top

    move = holding(kind, G, rng, loss, 10**decades)
    found = hsvd(move(G))
    np.testing.assert_array_equal(np.isfinite(found), finite)
    np.testing.assert_allclose(found[finite], sigma[finite], rtol=1e-6, atol=10 * LOST * top)


@pytest.mark.parametrize("family", ["flexible", "orbiting", "double integrators", "integrator chain", "modal"])
@pytest.mark.parametrize("part", [1e-6, 1e-4, 1e-2])
def test_fast_sampling_keeps_the_values(family, part):
    """Undamped modes and integrators stay what they are, however many samples they take."""
    for seed in range(10):
        G = PLANTS[family](np.random.default_rng([9, seed]))
        expected = hsvd(G)
        found = hsvd(c2d(G, part / max(np.abs(G.poles()).max(), 1e-3)))
        finite = np.isfinite(expected)
        np.testing.assert_array_equal(np.isfinite(found), finite)
        top = expected[finite].max(initial=0.0)
        np.testing.assert_allclose(found[finite], expected[finite], rtol=0.05, atol=1e-6 * top)


@settings(max_examples=30, **QUIET)
@given(*DRAWS)
def test_balanced_realisations_are_the_same_system(family, seed):
    G = PLANTS[family](np.random.default_rng(seed))
    found = balreal(G)
    E = np.linalg.norm(response(G) - found.system.frequency_response(grid(G)), 2, axis=(1, 2))
    assert np.all(E <= 1e-7 * np.linalg.norm(response(G), 2, axis=(1, 2)) + 1e-9 * np.abs(G.D).max(initial=0.0))
    k = int(np.isinf(found.singular_values).sum())
    H = found.system
    if H.n > k:
        W, M = gramians(StateSpace(H.A[k:, k:], H.B[k:], H.C[:, k:], H.D, H.dt))
        finite = found.singular_values[k:]
        for gramian in (W, M):
            np.testing.assert_allclose(gramian, np.diag(finite), atol=1e-3 * finite[0])
            np.testing.assert_allclose(np.diag(gramian)[0], finite[0], rtol=1e-6)


@settings(max_examples=30, **QUIET)
@given(*DRAWS, st.integers(1, 3))
def test_what_was_added_is_left_out_again(family, seed, added):
    """States that no input reaches, and others that no output sees, among the others by a turn."""
    rng = np.random.default_rng(seed)
    G = in_principal_axes(PLANTS[family](rng))  # in others the turn below mixes states of many decades
    size = np.abs(G.A).max() or 1.0
    rate = 0.5 if G.discrete else -size * rng.uniform(0.5, 2)
    blind = sla.block_diag(G.A, rate * np.diag(rng.uniform(0.1, 1, 2 * added)))
    blind[: G.n, G.n : G.n + added] = size * rng.standard_normal((G.n, added))  # seen, not reached
    blind[G.n + added :, : G.n] = size * rng.standard_normal((added, G.n))  # reached, not seen
    B = np.vstack([G.B, np.zeros((added, G.nu)), rng.standard_normal((added, G.nu))])
    C = np.hstack([G.C, rng.standard_normal((G.ny, added)), np.zeros((G.ny, added))])
    Q = np.linalg.qr(rng.standard_normal((G.n + 2 * added,) * 2))[0]
    H = StateSpace(Q.T @ blind @ Q, Q.T @ B, C @ Q, G.D, G.dt)
    found = minreal(H, 1e-6)
    assert found.n <= G.n
    omega = grid(G)
    own = np.linalg.norm(G.frequency_response(omega), 2, axis=(1, 2))
    off = np.linalg.norm(G.frequency_response(omega) - found.frequency_response(omega), 2, axis=(1, 2))
    assert np.all(off <= 2e-6 * own + 2 * blur(H, omega))  # and what rounding of the turned matrices makes of it


def test_minimal_realisations():
    assert minreal(([1, 1], [1, 3, 2])).n == 1  # (s + 1)/((s + 1)(s + 2))
    G = aircraft_slicot()
    found = minreal(G * system([1, 2], [1, 3]) * system([1, 3], [1, 2]))
    assert found.n == 7
    assert hinfnorm(G - found)[0] < 1e-10
    assert minreal(system([1.0], [1, 0, 0])).n == 2
