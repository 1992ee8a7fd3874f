"""Reduced systems against SLICOT's published examples, slycot, and the theorems that bound their errors."""

from __future__ import annotations

import numpy as np
import pytest
from families import KINDS, PLANTS, flexible_axis, move
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import aircraft_slicot

from synth import ModelError, NumericalError, StateSpace, balreal, c2d, gapmetric, hinfnorm, hsvd, reduce, system
from synth.analysis.differences import split
from synth.analysis.hankel import balancing, grid, projected
from synth.analysis.norms import is_stable

QUIET = {"deadline": None, "derandomize": True, "database": None}
METHODS = ("truncate", "matchdc")

# SLICOT's documentation, examples of AB09AD, AB09BD and AB09MD: the reduced matrices to four places
AB09AD = StateSpace(
    [[1.3451, 5.0399, 0, 0, 4.5315], [-4.0214, -3.6604, 0, 0, -0.9056], [0, 0, 0.5124, 1.7910, 0],
     [0, 0, -4.2167, -2.9900, 0], [1.2402, 1.6416, 0, 0, -0.0586]],
    [[-0.3857, 0.3857], [-3.1753, 3.1753], [-0.7447, -0.7447], [-3.6872, -3.6872], [1.8197, -1.8197]],
    [[-0.6704, 0.1828, -0.6582, 0.2222, -0.0104], [0.1089, 0.4867, 0, 0, 0.8651],
     [0.6704, -0.1828, -0.6582, 0.2222, 0.0104]],
    np.zeros((3, 2)),
)  # fmt: skip
AB09BD = StateSpace(
    [[1.3960, 5.1248, 0, 0, 4.4331], [-4.1411, -3.8605, 0, 0, -0.6738], [0, 0, 0.5847, 1.9230, 0],
     [0, 0, -4.3823, -3.2922, 0], [1.3261, 1.7851, 0, 0, -0.2249]],
    [[-0.2901, 0.2901], [-3.4004, 3.4004], [-0.6379, -0.6379], [-3.9315, -3.9315], [1.9813, -1.9813]],
    [[-0.6570, 0.2053, -0.6416, 0.2526, -0.0364], [0.1094, 0.4875, 0, 0, 0.8641],
     [0.6570, -0.2053, -0.6416, 0.2526, 0.0364]],
    [[0.0498, -0.0007], [0.0010, -0.0010], [-0.0007, 0.0498]],
)  # fmt: skip
AB09MD = StateSpace(
    [[0.5124, 0, 1.7910], [0, -1.4460, 0], [-4.2167, 0, -2.9900]],
    [[-0.7447, -0.7447], [1.9275, -1.9275], [-3.6872, -3.6872]],
    [[-0.6582, -0.5771, 0.2222], [0, 0.4131, 0], [-0.6582, 0.5771, 0.2222]],
    np.zeros((3, 2)),
)  # of the part with real parts of poles below -0.6; the other one stays


def apart(G, H) -> float:
    """The largest difference of two responses relative to the largest response."""
    G, H = system(G), system(H)
    F = G.frequency_response(grid(G))
    return float(np.abs(F - H.frequency_response(grid(G))).max() / np.abs(F).max())


@pytest.mark.parametrize(("method", "published"), [("truncate", AB09AD), ("matchdc", AB09BD)])
def test_slicot_examples_of_ab09ad_and_ab09bd(method, published):
    found = reduce(aircraft_slicot(), error=0.1, method=method)
    assert found.order == 5
    assert apart(published, found) < 5e-4
    np.testing.assert_allclose(found.bound, 2 * (0.0253 + 0.0246), atol=2e-4)
    assert 0.0253 <= found.error <= found.bound


def test_slicot_example_of_ab09md():
    G = aircraft_slicot()
    values = G.poles()
    stable, kept = split(G, (values, values.real >= -0.6))
    np.testing.assert_allclose(hsvd(stable), [1.9178, 0.8621, 0.7666, 0.0336, 0.0246], atol=5e-5)
    np.testing.assert_allclose(np.sort_complex(kept.poles()), [-0.5181 - 3.126j, -0.5181 + 3.126j], atol=5e-4)
    assert apart(AB09MD, reduce(stable, 3)) < 5e-4


CONTROLLER = system([[-26.4, 6.4023, 4.3868], [32, 0, 0], [0, 8, 0]], [16, 0, 0], [9.2994, 1.1624, 0.1090], 0)
BEHIND = system(  # (I + G K)^-1 G of G = diag(-1, 2, -3) with a coupling of 4
    np.block([[np.array([[-1, 0, 4], [0, 2, 0], [0, 0, -3.0]]), -np.ones((3, 1)) @ CONTROLLER.C],
              [CONTROLLER.B @ np.ones((1, 3)), CONTROLLER.A]]),
    [1, 1, 1, 0, 0, 0], [1, 1, 1, 0, 0, 0], 0,
)  # fmt: skip


def test_slicot_examples_of_ab09id_and_sb16ad():
    """A controller with an unstable pole, weighted by the loop it makes; both examples have these values."""
    found = reduce(CONTROLLER, 2, output_weight=BEHIND)
    np.testing.assert_allclose(found.singular_values, [np.inf, 3.8253, 0.2005], atol=5e-5)
    published = system([[9.19, 0], [0, -34.5297]], [11.9593, 16.9329], [2.8955, 6.9152], 0)
    assert apart(published, found) < 5e-4
    assert found.bound is None


def test_slicot_example_of_sb16cd():
    """Gramians of A + B F from the injection and of A + G C to the output cut an observer-based controller."""
    modes = [(0.015, 0.765), (0.028, 1.41), (0.04, 1.85)]
    A = np.zeros((8, 8))
    A[0, 1] = 1
    for i, (decay, w) in enumerate(modes):
        A[2 * i + 2 : 2 * i + 4, 2 * i + 2 : 2 * i + 4] = [[-decay, w], [-w, -decay]]
    B = np.array([[0.026, -0.251, 0.033, -0.886, -4.017, 0.145, 3.604, 0.28]]).T
    C = np.array([[-0.996, -0.105, 0.261, 0.009, -0.001, -0.043, 0.002, -0.026]])
    F = np.array(
        [
            [
                4.472135954999638e-002,
                6.610515358414598e-001,
                4.698598960657579e-003,
                3.601363251422058e-001,
                1.032530880771415e-001,
                -3.754055214487997e-002,
                -4.268536964759344e-002,
                3.287284547842979e-002,
            ]
        ]
    )
    L = np.array(
        [
            [
                4.108939884667451e-001,
                8.684600000000012e-002,
                3.852317308197148e-004,
                -3.619366874815911e-003,
                -8.803722876359955e-003,
                8.420521094001852e-003,
                1.234944428038507e-003,
                4.263205617645322e-003,
            ]
        ]
    ).T
    reached = balancing(StateSpace(A + B @ F, L, C, [[0]])).reached
    seen = balancing(StateSpace(A + L @ C, B, C, [[0]])).seen
    b = balancing(StateSpace(A, L, F, [[0]]), reached, seen)
    np.testing.assert_allclose(b.sigma, [3.3073, 0.7274, 0.1124, 0.0784, 0.0242, 0.0182, 0.0101, 0.0094], atol=5e-5)
    found = projected(StateSpace(A + B @ F + L @ C, L, F, [[0]]), *b.projection(2))
    published = system([[-0.4334, 0.4884], [-0.1950, -0.1093]], [-0.4231, -0.1785], [-0.0326, -0.2307], 0)
    assert min(apart(published, found), apart(published, -found)) < 5e-3


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("discrete", [False, True])
def test_slycot_reduces_to_the_same_system(method, discrete):
    """AB09MD and AB09ND, job "N" (with "B" the gain at rest is lost in discrete time), unstable poles too."""
    slycot = pytest.importorskip("slycot", reason="slycot (SLICOT) is the oracle of this test")
    dico, alpha = ("D", 1.0) if discrete else ("C", 0.0)
    for seed in range(10):
        G = drawn(seed, discrete)
        n, m, p = G.n, G.nu, G.ny
        sigma, order = hsvd(G), n - 2
        if np.isinf(sigma).sum() > order:
            continue
        if method == "truncate":
            nr, A, B, C, ns, hsv = slycot.ab09md(dico, "N", "N", n, m, p, G.A, G.B, G.C, alpha, nr=order)
            D = G.D
        else:
            nr, A, B, C, D, ns, hsv = slycot.ab09nd(dico, "N", "N", n, m, p, G.A, G.B, G.C, G.D, alpha, nr=order)
        np.testing.assert_allclose(sigma[np.isfinite(sigma)], hsv[:ns], rtol=1e-8)
        published = StateSpace(A[:nr, :nr], B[:nr], C[:, :nr], D, G.dt)
        assert apart(published, reduce(G, order, method=method)) < 1e-8


def drawn(seed: int, discrete: bool) -> StateSpace:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(4, 9))
    A = rng.standard_normal((n, n)) / np.sqrt(n) - (0 if discrete else 0.4 * np.eye(n))
    return StateSpace(A, rng.standard_normal((n, 2)), rng.standard_normal((2, n)), np.zeros((2, 2)), 0.1 * discrete)


@pytest.mark.parametrize("discrete", [False, True])
def test_residualised_by_definition(discrete):
    """Balanced, with the derivative (the change from sample to sample) of the last states set to zero."""
    for seed in range(10):
        G = drawn(seed, discrete)
        H, sigma = balreal(G)
        fixed, k = int(np.isinf(sigma).sum()), G.n - 2
        if fixed > k:
            continue
        F = H.A - np.eye(H.n) * discrete
        X = np.linalg.solve(F[k:, k:], np.hstack([F[k:, :k], H.B[k:]]))
        A = H.A[:k, :k] - F[:k, k:] @ X[:, :k]
        expected = StateSpace(
            A, H.B[:k] - F[:k, k:] @ X[:, k:], H.C[:, :k] - H.C[:, k:] @ X[:, :k], -H.C[:, k:] @ X[:, k:], G.dt
        )
        assert apart(expected, reduce(G, k, method="matchdc")) < 1e-9


@settings(max_examples=40, **QUIET)
@given(st.sampled_from(sorted(PLANTS)), st.integers(0, 2**32 - 1), st.sampled_from(METHODS), st.integers(0, 8))
def test_errors_are_within_the_bounds(family, seed, method, k):
    """No system of that order is nearer than the first value left out; none of these farther than twice their sum."""
    G = PLANTS[family](np.random.default_rng(seed))
    sigma = hsvd(G)
    fixed, finite = int(np.isinf(sigma).sum()), sigma[np.isfinite(sigma)]
    found = reduce(G, min(fixed + k, G.n), method=method)
    rounding = 1e-9 * (finite.max(initial=0.0) + np.abs(G.D).max())
    assert found.error <= found.bound * (1 + 1e-6) + rounding
    assert found.error >= np.append(finite, 0.0)[found.order - fixed] * (1 - 1e-6) - rounding
    H = found.system
    assert np.array_equal(np.isinf(hsvd(H)), np.isinf(sigma)[: H.n])  # stable modes stay stable, the others stay
    if method == "truncate":
        np.testing.assert_array_equal(H.D, G.D)


@settings(max_examples=25, **QUIET)
@given(st.sampled_from(["modal", "dense", "sampled", "lags"]), st.integers(0, 2**32 - 1), st.floats(0.02, 0.9))
def test_the_error_asked_for_is_kept_with_the_fewest_states(family, seed, part):
    G = PLANTS[family](np.random.default_rng(seed))
    sigma = hsvd(G)
    finite = sigma[np.isfinite(sigma)]
    if not finite.size:
        return
    wanted = part * 2 * finite.sum()
    found = reduce(G, error=wanted)
    assert found.error <= wanted
    if found.order > np.isinf(sigma).sum():
        try:
            assert reduce(G, found.order - 1).error > wanted
        except NumericalError:
            pass


@settings(max_examples=25, **QUIET)
@given(
    st.sampled_from(["modal", "dense", "sampled", "flexible", "orbiting"]), st.integers(0, 2**32 - 1),
    st.sampled_from(KINDS), st.floats(-3, 3), st.sampled_from(METHODS),
)  # fmt: skip
def test_coordinates_and_the_unit_of_time_change_nothing(family, seed, kind, decades, method):
    rng = np.random.default_rng(seed)
    G = PLANTS[family](rng)
    sigma = hsvd(G)
    fixed, finite = int(np.isinf(sigma).sum()), sigma[np.isfinite(sigma)]
    gaps = np.flatnonzero(finite[1:] < 0.9 * finite[:-1])  # between others the cut depends on rounding
    if not gaps.size:
        return
    order = fixed + 1 + int(gaps[0])
    there = move("turned" if "scaled" in kind and family == "flexible" else kind, G.n, rng, 10**decades)
    try:
        moved = hsvd(there(G))
    except NumericalError:
        return
    if not np.allclose(moved, sigma, rtol=1e-8, atol=1e-9 * finite[0]):
        return  # doubles do not hold the system there
    found, expected = reduce(there(G), order, method=method), reduce(G, order, method=method)
    np.testing.assert_allclose(found.error, expected.error, rtol=1e-4, atol=1e-8 * finite[0])
    unit = 1.0 if G.discrete else 10**decades
    omega = grid(system(expected))
    F = system(expected).frequency_response(omega)
    H = system(found).frequency_response(omega * (10**decades if G.discrete else unit))
    assert np.abs(F - H).max() <= 1e-5 * np.abs(F).max()


@pytest.mark.parametrize("dt", [0.0, 0.2])
def test_what_is_exact(dt):
    """Residualised the gain at rest; with both methods what integrators do far below the resonances."""
    G = aircraft_slicot() if not dt else c2d(aircraft_slicot(), dt)
    np.testing.assert_allclose(system(reduce(G, 4, method="matchdc")).dcgain(), G.dcgain(), rtol=1e-9)
    body = flexible_axis(np.random.default_rng(3))
    slow = 1e-4 * np.sort(np.abs(body.poles()))[2]
    body = c2d(body, dt) if dt else body
    expected = body.frequency_response(slow)
    for method in METHODS:
        found = reduce(body, body.n - 2, method=method).system
        np.testing.assert_allclose(found.frequency_response(slow), expected, rtol=1e-5)


@pytest.mark.parametrize("family", ["double integrators", "flexible", "orbiting", "modal", "sampled"])
def test_coprime_factors_reduce_unstable_systems_within_the_gap(family):
    for seed in range(2):
        G = PLANTS[family](np.random.default_rng([5, seed]))
        for k in range(1, G.n):
            found = reduce(G, k, method="coprime")
            assert found.error <= found.bound * (1 + 1e-6) + 1e-6
            np.testing.assert_allclose(gapmetric(G, found).gap, found.error, atol=1e-7)


def test_hankel_values_of_coprime_factors():
    """s/(1 + s^2)^1/2 of the LQG values s: those of the normalised factors, whose Gramians are X and Z (I + X Z)^-1."""
    G = system([1.0], [1, 0])  # 1/s: X = Z = 1
    np.testing.assert_allclose(reduce(G, 0, method="coprime").singular_values, [np.sqrt(0.5)])


def test_what_cannot_be_is_refused_by_name():
    G = system([1, 0.5], [1, 0.2, 1, 0, 0])
    for call, words in (
        (lambda: reduce(G), "order"),
        (lambda: reduce(G, 2, error=0.1), "error"),
        (lambda: reduce(G, 1), "not stable and stay"),
        (lambda: reduce(G, 5), "order"),
        (lambda: reduce(G, 3, loss=0.1), "loss"),
        (lambda: reduce(G, 3, method="coprime", input_weight=1.0), "coprime"),
        (lambda: reduce(G, 3, input_weight=G), "input_weight"),
        (lambda: reduce(G, 3, output_weight=np.eye(2)), "output_weight"),
        (lambda: reduce(G, error=-1.0), "error"),
    ):
        with pytest.raises(ModelError, match=words):
            call()


def test_weights_move_the_error_to_where_it_does_not_count():
    """With a low pass the error at low frequencies shrinks, and the weighted error is below that without weights."""
    G, W = aircraft_slicot(), system([0.05], [1, 0.05])
    plain, weighted = reduce(G, 4), reduce(G, 4, input_weight=W)
    assert is_stable(weighted.system)
    errors = [hinfnorm((G - system(H)) * W)[0] for H in (plain, weighted)]
    assert weighted.error < 0.9 * errors[0]
    np.testing.assert_allclose(weighted.error, errors[1], rtol=1e-5)


@settings(max_examples=25, **QUIET)
@given(st.sampled_from(["modal", "dense", "sampled", "flexible", "lags"]), st.integers(0, 2**32 - 1), st.integers(0, 2))
def test_weighted_remainders_are_stable_or_refused(family, seed, sides):
    """With one weight always stable (Enns); with two what is not stable is not returned."""
    rng = np.random.default_rng(seed)
    G = PLANTS[family](rng)
    sigma = hsvd(G)
    fixed = int(np.isinf(sigma).sum())

    def weight() -> StateSpace:
        A = rng.standard_normal((2, 2))
        values = np.linalg.eigvals(A)
        A = 0.9 * A / np.abs(values).max() if G.discrete else A - (values.real.max() + 0.1) * np.eye(2)
        return StateSpace(A, rng.standard_normal((2, 1)), rng.standard_normal((1, 2)), [[0.1]], G.dt)

    before, after = weight() if sides != 1 else None, weight() if sides != 0 else None
    for order in range(fixed, G.n + 1):
        try:
            found = reduce(G, order, input_weight=before, output_weight=after)
        except NumericalError:
            assert sides == 2
            continue
        assert np.isinf(hsvd(found)).sum() == fixed
        assert found.bound is None
        assert len(found.singular_values) == G.n


def test_pictures():
    found = reduce(system([1, 0.5], [1, 0.2, 1, 0, 0]), 3)
    axes = found.plot()
    (line,) = [each for each in axes.lines if each.get_marker() == "o"]
    np.testing.assert_allclose(line.get_ydata(), found.singular_values[2:])
    np.testing.assert_array_equal(line.get_xdata(), [3, 4])
    axes.figure.clear()
