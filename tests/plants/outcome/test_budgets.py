"""Pointing budgets against spectral integrals, closed formulas and long simulations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.stats import norm

from plants.errors import ScenarioError
from plants.outcome.budgets import budget, lyapunov, sampled_loop, spectral_radius
from plants.outcome.indices import pooled_level, windows

ERRORS = ("ape", "mpe", "rpe", "pse")


def loop(seed, n=5, m=3, q=2, radius=0.95):
    """A random stable loop with the given spectral radius."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    return (A * (radius / spectral_radius(A)), *(rng.normal(size=s) for s in ((n, m), (q, n), (q, m))))


def lifted(A, B, C, D, s):
    """The loop of s periods at once, its errors and its inputs one below the other."""
    powers = [np.linalg.matrix_power(A, k) for k in range(s + 1)]
    answer = [D, *(C @ powers[k] @ B for k in range(s - 1))]
    zero = np.zeros_like(D)
    return (
        powers[s],
        np.hstack([powers[s - 1 - k] @ B for k in range(s)]),
        np.vstack([C @ powers[k] for k in range(s)]),
        np.block([[answer[i - j] if i >= j else zero for j in range(s)] for i in range(s)]),
    )


def weighted_spectra(A, B, C, D, span, lag, points=1 << 12):
    """Variance by input from the error's spectrum, for each index's weight: ESSB-HB-E-003, sampled."""
    w = 2 * np.pi * np.arange(points) / points
    G = (
        C @ np.linalg.solve(np.exp(1j * w)[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (points, *B.shape)))
        + D
    )
    mean = np.abs(np.exp(1j * np.outer(w, np.arange(span))).mean(axis=1)) ** 2
    weights = {"ape": np.ones(points), "mpe": mean, "rpe": 1 - mean, "pse": 2 - 2 * np.cos(lag * w)}
    return {index: np.mean(np.abs(G) ** 2 * weight[:, None, None], axis=0).T for index, weight in weights.items()}


@given(seed=st.integers(0, 2**16), span=st.integers(1, 12), lag=st.integers(1, 12), radius=st.floats(0.0, 0.99))
@settings(max_examples=20, deadline=None)
def test_variances_are_the_weighted_integrals_of_the_spectrum(seed, span, lag, radius):
    matrices = loop(seed, radius=radius)
    found = budget(*matrices, 0.1, window=0.1 * span, delta_t=0.1 * lag)
    for index, expected in weighted_spectra(*matrices, span, lag).items():
        variance = getattr(found, index).variance.mean(axis=0)
        np.testing.assert_allclose(variance, expected, rtol=1e-6, atol=1e-12 * expected.max() + 1e-14)


def test_levels_lie_within_the_interval_of_a_simulation():
    """1e5 samples in 200 runs, with a bias, a constant drawn for each run, and a window of ten samples."""
    A, B, C, D = loop(3, radius=0.9)
    runs, steps, span, lag = 200, 500, 10, 4
    noise, constant, random = np.array([[1.0, 0.5, 0.0], [0.0, 0.1, 0.3], [0.2, 0.0, 0.1]]) / 100
    rng = np.random.default_rng(11)
    w = rng.normal(size=(steps + 200, runs, 3)) * noise + rng.normal(size=(runs, 3)) * random + constant
    x, e = np.zeros((runs, 5)), []
    for now in w:
        e.append(x @ C.T + now @ D.T)
        x = x @ A.T + now @ B.T
    errors = np.moveaxis(e[200:], 1, 0)
    means, rest = zip(*(windows(run, span) for run in errors), strict=True)
    measured = {"ape": errors, "mpe": means, "rpe": rest, "pse": errors[:, lag:] - errors[:, :-lag]}
    found = budget(A, B, C, D, 0.1, window=1.0, delta_t=0.4, noise=noise, constant=constant, random=random)
    for index, level in zip(ERRORS, found.levels(0.95), strict=True):
        _, low, high = pooled_level(measured[index], 0.95, resamples=1000)
        assert ((low < level) & (level < high)).all(), index
        assert (high - low < 0.15 * level).all(), index  # the interval says something


@given(seed=st.integers(0, 2**16), s=st.integers(1, 4), span=st.integers(1, 4), lag=st.integers(1, 4))
@settings(max_examples=20, deadline=None)
def test_a_loop_of_many_samples_in_a_period_is_the_loop_of_one(seed, s, span, lag):
    A, B, C, D = loop(seed)
    options = {"window": float(s * span), "delta_t": float(s * lag)}
    noise, constant = np.array([[1.0, 2.0, 0.0], [0.0, 0.3, 1.0]])
    one = budget(A, B, C, D, 1.0, noise=noise, constant=constant, **options)
    many = budget(
        *lifted(A, B, C, D, s), s, noise=np.tile(noise, s), constant=np.tile(constant, s), samples=s,
        sources=list("012") * s, **options,
    )  # fmt: skip
    assert many.sources == one.sources == ("0", "1", "2")
    for index in ERRORS:
        a, b = getattr(one, index), getattr(many, index)
        for x, y in ((a.mean, b.mean), (a.variance, b.variance)):
            np.testing.assert_allclose(y, np.broadcast_to(x, y.shape), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(many.levels(), one.levels(), rtol=1e-9)


@given(seed=st.integers(0, 2**16), decades=st.integers(0, 8), unit=st.floats(1e-6, 1e6), second=st.floats(1e-3, 1e3))
@settings(max_examples=20, deadline=None)
def test_coordinates_units_and_clock_do_not_matter(seed, decades, unit, second):
    A, B, C, D = loop(seed)
    rng = np.random.default_rng(seed)
    t = 10.0 ** rng.uniform(-decades, decades, len(A))
    one = budget(A, B, C, D, 0.1, window=0.5, delta_t=0.2, constant=1.0, random=0.1)
    other = budget(
        A * t[:, None] / t, B * t[:, None], unit * C / t, unit * D, 0.1 * second, window=0.5 * second,
        delta_t=0.2 * second, constant=1.0, random=0.1,
    )  # fmt: skip
    for a, b in zip(one.levels(), other.levels(), strict=True):
        np.testing.assert_allclose(b, unit * a, rtol=1e-7)


def test_many_loops_at_once_are_each_as_alone_and_pool_to_their_mixture():
    loops = [loop(seed) for seed in range(4)]
    options = {"window": 3.0, "delta_t": 2.0, "constant": [0.0, 1.0, 0.0]}
    together = budget(*map(np.stack, zip(*loops, strict=True)), 1.0, **options)
    alone = [budget(*one, 1.0, **options) for one in loops]
    for index in range(4):
        np.testing.assert_allclose(together.levels()[index], [b.levels()[index] for b in alone], rtol=1e-9)
    pooled = together.pooled()
    for index in ERRORS:
        level, spreads = getattr(pooled, index).level(0.9), [getattr(b, index) for b in alone]
        inside = np.mean([
            norm.cdf((level - s.mean) / np.sqrt(s.variance.sum(axis=-2)))
            - norm.cdf((-level - s.mean) / np.sqrt(s.variance.sum(axis=-2))) for s in spreads
        ], axis=(0, 1))  # fmt: skip
        np.testing.assert_allclose(inside, 0.9, rtol=1e-9)
    with pytest.raises(ScenarioError, match="nothing to pool"):
        pooled.pooled()


@pytest.mark.parametrize("slow", [1e-3, 1e-6, 1e-10])
def test_small_drifts_of_large_slow_errors_keep_their_digits(slow):
    """A first-order process of unit variance: v(d) = 2 (1 - a^d), and the window's mean from the same sums."""
    a, span, lag = 1 - slow, 50, 3
    found = budget([[a]], [[np.sqrt(-np.expm1(2 * np.log1p(-slow)))]], [[1.0]], [[0.0]], 1.0, window=50.0, delta_t=3.0)
    v = -2 * np.expm1(np.arange(span) * np.log1p(-slow))
    assert found.ape.variance[0, 0, 0] == pytest.approx(1.0, rel=1e-5)
    assert found.pse.variance[0, 0, 0] == pytest.approx(v[lag], rel=1e-4)
    pooled = sum((span - k) * v[k] for k in range(span)) / span**2
    assert found.rpe.variance.mean() == pytest.approx(pooled, rel=1e-4)


def test_constants_and_contributions():
    """A static error: what is constant stays in APE and MPE, a constant drawn for each run spreads them."""
    found = budget(
        np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((1, 0)), [[1.0, 2.0, 1.0]], 1.0, window=4.0, delta_t=2.0,
        noise=[3.0, 0.0, 1.0], constant=[0.0, 0.5, 0.0], random=[0.0, 2.0, 0.0], sources=["a", "b", "a"],
    )  # fmt: skip
    assert found.sources == ("a", "b")
    parts = found.contributions()
    np.testing.assert_allclose(parts.ape[:, 0], [10.0, 16.0, 1.0])
    np.testing.assert_allclose(parts.mpe[:, 0], [2.5, 16.0, 1.0])
    np.testing.assert_allclose(parts.rpe[:, 0], [7.5, 0.0, 0.0])
    np.testing.assert_allclose(parts.pse[:, 0], [20.0, 0.0, 0.0], atol=1e-15)
    level = found.levels(0.95).ape[0]
    assert norm.cdf((level - 1) / np.sqrt(26)) - norm.cdf((-level - 1) / np.sqrt(26)) == pytest.approx(0.95, rel=1e-9)
    still = budget(
        np.zeros((0, 0)),
        np.zeros((0, 1)),
        np.zeros((1, 0)),
        [[1.0]],
        1.0,
        window=1.0,
        delta_t=1.0,
        noise=0.0,
        constant=-2.0,
    ).levels()
    np.testing.assert_allclose([*still], [[2.0], [2.0], [0.0], [0.0]], rtol=1e-12)


def test_a_continuous_loop_is_sampled_exactly():
    """The Ornstein-Uhlenbeck process, and a stiff loop whose exponential of -A dt overflows."""
    Ad, Bd = sampled_loop([[-0.5]], [[2.0]], 0.1)
    assert Ad[0, 0] == pytest.approx(np.exp(-0.05))
    assert Bd[0, 0] ** 2 == pytest.approx(4 * (1 - np.exp(-0.1)))
    A = block_diag(-1e5, [[0.0, 1.0], [-1.0, -0.2]])
    Ad, Bd = sampled_loop(A, np.ones((3, 1)), 10.0)
    X = lyapunov(Ad, Bd @ Bd.T)
    np.testing.assert_allclose(A @ X + X @ A.T, -np.ones((3, 3)), atol=1e-6)
    fine = budget(*sampled_loop([[-0.5]], [[1.0]], 1e-3), [[1.0]], [[0.0]], 1e-3, window=2.0, delta_t=2.0)
    mean = 2 * (2 * 0.5 - 1 + np.exp(-1)) / 1.0  # of a window of 2 s: variance 2 (aT - 1 + exp(-aT)) / (aT)^2, aT = 1
    assert fine.mpe.variance[0, 0, 0] == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize(("change", "message"), [
    ({"A": [[1.0]]}, "spectral radius is 1;"),
    ({"A": [[1.1]]}, "not stable"),
    ({"A": [[0.9, 1e200], [0.0, 0.9]], "B": [[1.0], [1.0]], "C": [[1.0, 0.0]]}, "lost in rounding"),
    ({"A": np.eye(2)}, "have shapes"),
    ({"A": [[np.nan]]}, "A has shape"),
    ({"A": [[0.5j]]}, "A has shape"),
    ({"B": [1.0]}, "B has shape"),
    ({"A": np.full((2, 1, 1), 0.5), "B": np.ones((3, 1, 1))}, "must broadcast"),
    ({"window": 0.25}, r"window = 0.25 s: give a whole number of periods of 0.1 s"),
    ({"delta_t": 0.0}, "delta_t must be positive"),
    ({"dt": -1.0}, "periods must be positive"),
    ({"noise": [1.0, 2.0]}, "noise must have shape"),
    ({"noise": -1.0}, "noise must be at least 0"),
    ({"random": -1.0}, "random must be at least 0"),
    ({"constant": np.inf}, "constant must be finite"),
    ({"sources": ["a", "b"]}, "one name for each of the 1 inputs"),
    ({"sources": "a"}, "one name for each"),
    ({"samples": 2}, "must divide the 1 rows"),
])  # fmt: skip
def test_unusable_loops_are_refused(change, message):
    given = {"A": [[0.5]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "dt": 0.1, "window": 0.3, "delta_t": 0.2} | change
    with pytest.raises(ScenarioError, match=message):
        budget(**given)


@pytest.mark.parametrize("share", [0.0, 1.0, 1.5, np.nan])
def test_unusable_shares_are_refused(share):
    with pytest.raises(ScenarioError, match="share"):
        budget([[0.5]], [[1.0]], [[1.0]], [[0.0]], 1.0, window=1.0, delta_t=1.0).levels(share)
