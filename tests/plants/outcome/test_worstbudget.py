"""The worst budget over a box: found at corners and inside, never below what a grid finds."""

import numpy as np
import pytest
from scipy.stats import norm

from plants.errors import ScenarioError
from plants.outcome.budgets import budget
from plants.outcome.worstbudget import worst_budget

OPTIONS = {"window": 1.0, "delta_t": 0.5}


def oscillator(points):
    """x'' = -w^2 x - 2 z w x' sampled roughly, for (w, z): two errors, angle and rate."""
    w, z = np.asarray(points).T
    h, zero, one = 0.1, np.zeros(len(points)), np.ones(len(points))
    A = np.moveaxis(np.array([[one, h * one], [-h * w**2, 1 - 2 * h * z * w]]), -1, 0)
    B = np.moveaxis(np.array([[zero, zero], [h * one, h * w**2]]), -1, 0)
    return A, B, np.broadcast_to(np.eye(2), A.shape), np.zeros_like(B)


@pytest.mark.parametrize("index", ["ape", "mpe", "rpe", "pse"])
def test_no_point_of_a_grid_is_worse(index):
    low, high = [0.5, 0.4], [2.0, 1.0]
    found = worst_budget(oscillator, low, high, 0.1, index=index, **OPTIONS)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), axis=-1).reshape(-1, 2)
    levels = getattr(budget(*oscillator(grid), 0.1, **OPTIONS).levels(), index)
    assert found.level >= levels.max() * (1 - 1e-4)
    again = budget(*(M[0] for M in oscillator(found.parameters[None])), 0.1, **OPTIONS)
    assert getattr(again.levels(), index).max() == pytest.approx(found.level, rel=1e-12)
    assert found.budget is not None
    assert getattr(found.budget.levels(), index).max() == pytest.approx(found.level, rel=1e-12)
    assert (found.parameters >= low).all()
    assert (found.parameters <= high).all()
    assert found.level >= found.nominal
    assert found.evaluated < 1000


def test_the_worst_may_lie_inside():
    """Noise through a gain that is largest in the middle of one edge, seen in the second error only."""

    def loops(points):
        a, b = np.asarray(points).T
        D = np.stack([np.ones_like(a), 2 - (a - 0.3) ** 2 - 0.1 * b], axis=-1)[..., None]
        n = len(points)
        return np.zeros((n, 1, 1)), np.zeros((n, 1, 1)), np.zeros((n, 2, 1)), D

    found = worst_budget(loops, [-1, 0], [1, 1], 0.5, axes=[1], **OPTIONS)
    np.testing.assert_allclose(found.parameters, [0.3, 0.0], atol=0.01)
    assert found.budget is not None
    corners = worst_budget(loops, [-1, 0], [1, 1], 0.5, axes=[1], smallest=1.0, **OPTIONS)
    assert corners.evaluated == 5
    assert corners.parameters.tolist() in ([0.0, 0.5], [1.0, 0.0])
    first = worst_budget(loops, [-1, 0], [1, 1], 0.5, axes=[0], **OPTIONS)
    assert first.level == pytest.approx(1.959964, rel=1e-6)


def test_an_unstable_corner_is_the_worst():
    found = worst_budget(oscillator, [0.5, -0.5], [2.0, 1.0], 0.1, **OPTIONS)
    assert found.level == np.inf
    assert found.parameters[1] == -0.5
    assert found.budget is None
    assert np.isfinite(found.nominal)


def test_instants_of_one_loop_are_pooled():
    """Loops of three instants each: the level is that of the mixture."""

    def loops(points):
        gains = np.asarray(points)[:, :, None, None] * np.array([1.0, 2.0, 3.0])[:, None, None]
        return np.zeros((len(points), 3, 1, 1)), np.ones_like(gains), np.zeros_like(gains), gains

    found = worst_budget(loops, [1.0], [2.0], 0.5, **OPTIONS)
    assert found.parameters == pytest.approx([2.0])
    gains = np.array([2.0, 4.0, 6.0])
    assert np.mean(norm.cdf(found.level / gains) - norm.cdf(-found.level / gains)) == pytest.approx(0.95)


@pytest.mark.parametrize(("change", "message"), [
    ({"low": [2.0], "high": [1.0]}, "give low <= high"),
    ({"low": [1.0, 2.0], "high": [3.0]}, "give low <= high"),
    ({"low": [0.0] * 13, "high": [1.0] * 13}, "at most 12"),
    ({"index": "ake"}, "give one of ape, mpe, rpe, pse"),
    ({"starts": 0}, "starts = 0"),
    ({"smallest": 0.0}, "smallest = 0"),
    ({"share": 1.0}, "share"),
])  # fmt: skip
def test_unusable_boxes_are_refused(change, message):
    given = {"low": [0.5, 0.4], "high": [2.0, 1.0]} | change
    with pytest.raises(ScenarioError, match=message):
        worst_budget(oscillator, given.pop("low"), given.pop("high"), 0.1, **given, **OPTIONS)
