"""Pointing indices against sequences worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from attitude_runs import run
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest

from plants.errors import ScenarioError
from plants.outcome import indices

ROUNDING = 1e-12  # trigonometry there and back


def test_performance_error_is_the_95th_percentile_per_axis():
    """100 samples from 0.01 to 1.00 deg, signs mixed: not exceeded for 95 % of the time is 0.95 deg."""
    rng = np.random.default_rng(0)
    angles = np.zeros((100, 3))
    angles[:, 1] = rng.permutation(np.radians(0.01 * np.arange(1, 101))) * rng.choice([-1, 1], 100)
    result = indices.indices(run(angles), start=0.0, delta_t=0.5)
    np.testing.assert_allclose(result.ape, [0, np.radians(0.95), 0], atol=ROUNDING)
    np.testing.assert_allclose(result.control_error, result.ape, atol=ROUNDING)
    np.testing.assert_allclose(result.ake, 0, atol=ROUNDING)
    half = indices.indices(run(angles), start=0.0, delta_t=0.5, share=0.5)
    assert half.ape[1] == pytest.approx(np.radians(0.50), abs=ROUNDING)


def test_the_window_starts_where_it_says():
    angles = np.zeros((40, 3))
    angles[:20, 0], angles[20:, 0] = 0.3, 0.01
    result = indices.indices(run(angles), start=10.0, delta_t=0.5)
    assert result.ape[0] == pytest.approx(0.01, abs=ROUNDING)
    assert result.pse[0] == pytest.approx(0.0, abs=ROUNDING)  # one jump among twenty is within 5 %
    assert (result.start, result.end) == (10.0, 20.0)
    early = indices.indices(run(angles), start=9.5, delta_t=0.5, share=1.0)
    assert early.ape[0] == pytest.approx(0.3, abs=ROUNDING)
    assert early.pse[0] == pytest.approx(0.29, abs=ROUNDING)


def test_the_four_errors_tell_true_known_and_desired_apart():
    """Constant roll: true 3 deg, estimated 2 deg, desired 0.5 deg."""
    true, known, desired = (np.tile(np.radians([roll, 0, 0]), (20, 1)) for roll in (3.0, 2.0, 0.5))
    result = indices.indices(run(true, known, desired), start=0.0, delta_t=0.5)
    np.testing.assert_allclose(np.degrees(result.ape), [2.5, 0, 0], atol=1e-10)
    np.testing.assert_allclose(np.degrees(result.control_error), [1.5, 0, 0], atol=1e-10)
    np.testing.assert_allclose(np.degrees(result.ake), [1.0, 0, 0], atol=1e-10)


def test_errors_are_angles_of_the_error_rotation():
    """With 90 deg of yaw desired, a roll of the body is a roll of the error, which differences of angles get wrong."""
    desired = np.tile([0.0, 0.0, np.pi / 2], (10, 1))
    miss = Rotation.from_euler("ZYX", [0.0, 0.0, 0.01])  # 0.01 rad about the body's x axis
    q = (Rotation.from_euler("ZYX", [np.pi / 2, 0.0, 0.0]) * miss).as_quat(scalar_first=True)
    fake = replace(run(desired, desired=desired), outputs=np.tile([*q[1:], 0, 0, 0], (10, 1)))
    result = indices.indices(fake, start=0.0, delta_t=0.5)
    np.testing.assert_allclose(result.ape, [0.01, 0, 0], atol=ROUNDING)


def test_stability_is_the_change_over_delta_t():
    """A ramp of 0.02 deg/s in yaw: 0.02 deg over 1 s, 0.06 deg over 3 s."""
    angles = np.zeros((100, 3))
    angles[:, 2] = np.radians(0.02 * 0.5 * np.arange(100))
    for delta_t, expected in ((1.0, 0.02), (3.0, 0.06)):
        result = indices.indices(run(angles), start=10.0, delta_t=delta_t)
        np.testing.assert_allclose(np.degrees(result.pse), [0, 0, expected], atol=1e-10)
    np.testing.assert_allclose(indices.stability(np.array([3.1, -3.1]), 1), 2 * np.pi - 6.2, atol=ROUNDING)


def test_settling_is_the_last_crossing():
    angles = np.zeros((10, 3))
    angles[:, 0] = np.radians([20, 5, 0.5, 3, 0.9, 0.8, 0.1, 0.1, 0.1, 0.1])
    result = indices.indices(run(angles), start=3.0, delta_t=0.5)
    assert result.settling_time == 2.0
    assert indices.settling_time(np.arange(3.0), np.array([2.0, 0.1, 2.0]), 1.0) == np.inf
    assert indices.settling_time(np.arange(3.0), np.array([0.2, 0.1, 0.0]), 1.0) == 0.0
    assert indices.settling_time(np.arange(3.0), np.array([0.2, np.nan, 0.0]), 1.0) == 2.0


def test_wheel_effort():
    """+2 uNm for 5 s, then -1 uNm for 5 s on one axis; h = 0.5 s."""
    torque = np.zeros((20, 3))
    torque[:10, 1], torque[10:, 1] = 2e-6, -1e-6
    result = indices.indices(run(np.zeros((20, 3)), torque=torque), start=1.0)
    np.testing.assert_allclose(result.effort, [0, 15e-6, 0], rtol=1e-12)
    np.testing.assert_allclose(result.momentum_peak, [0, 10e-6, 0], rtol=1e-12)
    np.testing.assert_allclose(result.torque_rms, [0, np.sqrt(2.5) * 1e-6, 0], rtol=1e-12)


def test_a_failed_run_meets_no_requirement_and_a_batch_is_a_stack():
    good = run(np.full((40, 3), 0.01))
    bad = replace(good, ok=False, failed_at=1.0, culprit="plant", time=good.time[:2], outputs=good.outputs[:2])
    both = indices.indices([good, bad], start=5.0)
    assert both.ape.shape == (2, 3)
    np.testing.assert_array_equal(both.ape[0], indices.indices(good, start=5.0).ape)
    for name in ("ape", "control_error", "ake", "pse", "torque_rms", "effort", "momentum_peak"):
        assert np.isinf(getattr(both, name)[1]).all()
    assert both.settling_time[1] == np.inf
    assert both.start == 5.0


def test_the_table_states_units_window_and_interval():
    text = str(indices.indices(run(np.tile(np.radians([0.1, 0.2, 0.3]), (40, 1))), start=5.0))
    assert "95% of the time, 5 to 20 s; PSE over 1 s" in text
    assert "deg" in text
    assert "0.1000    0.2000    0.3000" in text
    many = str(indices.indices([run(np.full((40, 3), 0.01))] * 3, start=5.0))
    assert "median" in many
    assert "worst" in many


@pytest.mark.parametrize(
    ("message", "changes"),
    [
        ("share = 0", {"share": 0}),
        ("share = 1.5", {"share": 1.5}),
        ("start = 20.0", {"start": 20.0}),
        ("start = nan", {"start": np.nan}),
        ("delta_t = 0.7", {"delta_t": 0.7, "start": 0.0}),
        ("delta_t = 0.0", {"delta_t": 0.0, "start": 0.0}),
        ("delta_t = 30", {"delta_t": 30.0, "start": 0.0}),
    ],
)
def test_bad_settings_are_named(message, changes):
    with pytest.raises(ScenarioError, match=message):
        indices.indices(run(np.zeros((40, 3))), **changes)


def test_nothing_to_judge():
    with pytest.raises(ScenarioError, match="runs: got none"):
        indices.indices([])
    with pytest.raises(ScenarioError, match="outputs have shape"):
        indices.indices(replace(run(np.zeros((40, 3))), outputs=np.zeros((40, 2))), start=0.0)


def test_exact_binomial_interval():
    """Against SciPy's own, and its defining tails; all and nothing give one-sided intervals in closed form."""
    k, n = np.array([0, 1, 48, 99, 100]), np.full(5, 100)
    low, high = indices.clopper_pearson(k, n)
    for i in range(5):
        expected = binomtest(int(k[i]), 100).proportion_ci(0.95, method="exact")
        assert (low[i], high[i]) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert (low[0], high[-1]) == (0, 1)
    assert low[-1] == pytest.approx(0.025 ** (1 / 100))
    assert indices.clopper_pearson(50, 100, 0.5)[0] > low[2]
    for bad in ((5, 4), (-1, 4), (0, 0), (1.5, 4), (np.nan, 4)):
        with pytest.raises(ScenarioError, match="successes"):
            indices.clopper_pearson(*bad)
    with pytest.raises(ScenarioError, match="confidence"):
        indices.clopper_pearson(1, 2, 1.0)


def test_windows_split_an_error_into_its_means_and_the_rest():
    rng = np.random.default_rng(0)
    errors = np.radians(rng.normal(size=(23, 2)))
    mean, relative = indices.windows(errors, 5)
    parts = errors[:20].reshape(4, 5, 2)
    np.testing.assert_allclose(mean, parts.mean(axis=1), atol=1e-15)
    np.testing.assert_allclose(relative, (parts - parts.mean(axis=1, keepdims=True)).reshape(20, 2), atol=1e-15)
    turned, same = indices.windows(errors % (2 * np.pi) - np.pi, 5)  # half a turn on
    np.testing.assert_allclose(same, relative, atol=1e-14)
    np.testing.assert_allclose(np.cos(turned), -np.cos(mean), atol=1e-14)
    across, _ = indices.windows(np.radians([179.0, -179.0, -177.0]), 3)
    assert np.degrees(across) == pytest.approx([-179.0])
    for length in (0, 24, 2.5):
        with pytest.raises(ScenarioError, match="whole number of samples from 1 to 23"):
            indices.windows(errors, length)


def test_pooled_level_and_its_interval():
    """The interval of runs whose samples are all alike is that of as many independent numbers."""
    rng = np.random.default_rng(1)
    drawn = rng.normal(size=(400, 1, 1))
    level, low, high = indices.pooled_level(np.repeat(drawn, 50, axis=1))
    assert level[0] == np.quantile(np.abs(drawn), 0.95, method="inverted_cdf")
    a, b = np.sort(np.abs(drawn.ravel()))[[370, 389]]  # order statistics: P(371 <= Binomial(400, 0.95) < 390) = 0.97
    assert a * 0.98 < low[0] < level[0] < high[0] < b * 1.02
    with pytest.raises(ScenarioError, match="two at least"):
        indices.pooled_level([np.zeros(5)])
    with pytest.raises(ScenarioError, match="share = 2"):
        indices.pooled_level([np.zeros(5)] * 2, share=2)
    with pytest.raises(ScenarioError, match="different shapes"):
        indices.pooled_level([np.zeros(5), np.zeros(6)])


@pytest.mark.parametrize(("count", "least"), [(8, 80), (30, 90)])
def test_the_interval_covers_the_level_as_often_as_it_says(count, least):
    """Runs of correlated samples, a hundred times; of a handful the tails are not known so well."""
    rng, hits = np.random.default_rng(2), 0
    for _ in range(100):
        runs = rng.normal(size=(count, 1)) * 0.7 + rng.normal(size=(count, 40)) * np.sqrt(1 - 0.49)
        _, low, high = indices.pooled_level([*runs[..., None]], 0.9, resamples=400)
        hits += int(low[0] < 1.6448536 < high[0])
    assert hits >= least
