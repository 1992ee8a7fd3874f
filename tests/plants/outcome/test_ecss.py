"""Window indices and interpretations of ECSS against sequences worked out by hand and against their definitions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from attitude_runs import run
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.outcome.ecss import ecss_indices

ROUNDING = 1e-9
DEG = np.radians(1)


def flat(values, axis=1):
    """Angles (N, 3) rad about one axis."""
    angles = np.zeros((len(values), 3))
    angles[:, axis] = values
    return angles


def test_windows_by_hand():
    """Windows of four samples: levels 1, 2, 4 deg with a ripple of .1 deg."""
    ripple = np.tile([0.1, -0.1, 0.1, -0.1], 3)
    angles = flat(DEG * (np.repeat([1.0, 2.0, 4.0], 4) + ripple))
    known = flat(DEG * np.repeat([1.0, 2.0, 4.0], 4))
    found = ecss_indices(run(angles, known), window=2.0, start=0.0, repeat=4.0, share=1.0)
    expected = {"APE": 4.1, "MPE": 4.0, "RPE": 0.1, "PDE": 2.0, "PRE": 3.0,
                "AKE": 0.1, "MKE": 0.0, "RKE": 0.1, "KDE": 0.0, "KRE": 0.0}  # fmt: skip
    assert list(found.levels) == list(expected)
    for name, level in expected.items():
        np.testing.assert_allclose(found[name] / DEG, [0, level, 0], atol=ROUNDING, err_msg=name)


def test_interpretations_by_hand():
    """Ten runs with constant errors of 1 .. 10 deg, of which each has one sample in ten of twice the size."""
    many = []
    for k in range(1, 11):
        values = np.full(100, k * DEG)
        values[::10] *= 2
        many.append(run(flat(values)))

    def level(interpretation, share):
        found = ecss_indices(many, window=5.0, start=0.0, share=share, interpretation=interpretation)
        return found["APE"][1] / DEG

    assert level("temporal", 0.9) == pytest.approx(10)  # of the worst run
    assert level("temporal", 0.91) == pytest.approx(20)
    assert level("ensemble", 0.9) == pytest.approx(18)  # worst time of the ninth run
    assert level("mixed", 0.9) == pytest.approx(10)
    assert level("mixed", 1.0) == pytest.approx(20)


def test_the_confidence_of_an_ensemble_is_that_of_its_order_statistic():
    """59 runs without a failure show 95 % with 95 % confidence: 1 - .95^59 = .9515 (Wilks 1941)."""
    many = [run(flat(np.full(4, DEG)))] * 59
    found = ecss_indices(many, window=1.0, start=0.0, interpretation="ensemble")
    assert found.confidence == pytest.approx(sum_of_binomial(57, 59, 0.95))
    all_of_them = ecss_indices(many, window=1.0, start=0.0, share=0.999, interpretation="ensemble")
    assert all_of_them.confidence == pytest.approx(1 - 0.999**59)


def sum_of_binomial(most, n, p):
    """Probability of at most that many successes: the level is the 57th of 59, so 56 or fewer must lie below."""
    from math import ceil, comb

    rank = ceil(p * n)
    assert rank == most
    return sum(comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(rank))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.001, 2.5), st.integers(1, 7))
def test_parts_make_up_the_whole(seed, size, length):
    """APE = MPE + RPE in every sample, and no half-cone depends on the axes of the body or of the reference."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(size * rng.normal(size=(21, 3)))
    angles = turns.as_euler("ZYX")[:, ::-1]
    line = rng.normal(size=3)
    found = ecss_indices(run(angles), window=0.5 * length, start=0.0, line_of_sight=line, share=1.0)
    unit = line / np.linalg.norm(line)
    counted = turns[: 21 // length * length]  # whole windows
    cone = np.arccos(np.clip(counted.inv().apply(unit) @ unit, -1, 1)).max()
    assert found["APE"][3] == pytest.approx(cone, abs=1e-7)
    assert found["APE"][3] <= found["MPE"][3] + found["RPE"][3] + ROUNDING  # the triangle of directions
    turn = Rotation.random(rng=rng)  # the same errors in other axes
    turned = (turn * turns * turn.inv()).as_euler("ZYX")[:, ::-1]
    other = ecss_indices(run(turned), window=0.5 * length, start=0.0, line_of_sight=turn.apply(unit), share=1.0)
    for name in ("APE", "MPE", "RPE"):
        assert other[name][3] == pytest.approx(found[name][3], abs=1e-6)


def test_the_half_cone_of_an_axis_ignores_turns_about_it():
    found = ecss_indices(run(flat([0.3] * 8, axis=2)), window=1.0, start=0.0, line_of_sight=[0, 0, -2], share=1.0)
    np.testing.assert_allclose(found["APE"], [0, 0, 0.3, 0], atol=ROUNDING)


def test_a_desired_attitude_that_moves_counts_as_zero():
    moving = np.cumsum(np.full((12, 3), 0.2), axis=0)
    found = ecss_indices(run(moving, desired=moving), window=1.0, start=0.0, line_of_sight=[1, 0, 0])
    for level in found.levels.values():
        np.testing.assert_allclose(level, 0, atol=1e-7)


@pytest.mark.parametrize("interpretation", ["temporal", "ensemble", "mixed"])
def test_a_failed_run_counts(interpretation):
    good = run(flat(np.full(8, DEG)))
    bad = replace(good, ok=False, failed_at=1.0, outputs=good.outputs[:2], time=good.time[:2])
    for runs, sound in (([good, bad], False), ([bad], False), ([good] * 99 + [bad], interpretation != "temporal")):
        found = ecss_indices(runs, window=1.0, start=0.0, interpretation=interpretation)
        assert np.isfinite(found["MKE"]).all() == sound


def test_the_table_says_what_it_shows():
    found = ecss_indices([run(flat(np.full(8, DEG)))] * 3, window=1.0, start=2.0, line_of_sight=[1, 0, 0])
    text = str(found)
    for part in ("half-cone", "95% of the time, in the worst of 3 runs", "windows of 1 s", "PDE"):
        assert part in text
    assert "PRE" not in text


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"window": 0.7}, r"window = 0.7 s: give a whole number of samples of 0.5 s"),
        ({"window": 50.0}, r"window = 50.0 s: from 0 s on the run lasts 4 s"),
        ({"start": 9.0}, r"start = 9.0 s is outside the run, which lasts 4.0 s"),
        ({"drift": 1.5}, r"drift = 1.5 s: give a whole number of windows of 1 s"),
        ({"repeat": 40.0}, r"repeat = 40.0 s: the run has 4 windows of 1 s"),
        ({"share": 0.0}, "share = 0.0"),
        ({"interpretation": "average"}, "interpretation = 'average': give one of temporal, ensemble, mixed"),
        ({"line_of_sight": [0, 0, 0]}, "line_of_sight"),
    ],
)
def test_what_does_not_fit_is_refused(changes, named):
    with pytest.raises(ScenarioError, match=named):
        ecss_indices(run(flat(np.zeros(8))), **({"window": 1.0, "start": 0.0} | changes))


def test_runs_of_different_lengths_are_refused():
    with pytest.raises(ScenarioError, match="different numbers of samples"):
        ecss_indices([run(flat(np.zeros(8))), run(flat(np.zeros(9)))], window=1.0, start=0.0)
    with pytest.raises(ScenarioError, match="got none"):
        ecss_indices([], window=1.0, start=0.0)
