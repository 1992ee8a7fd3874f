"""NEES and NIS: right filters lie in the band, wrong ones are told from them, whatever the units."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.errors import ScenarioError
from plants.outcome.consistency import nees, nis


def errors(seed, runs=50, times=400, n=3):
    """Errors with their true covariances, different at every time."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(times, n, n))
    e = np.einsum("tij,rtj->rti", root, rng.normal(size=(runs, times, n)))
    return e, np.broadcast_to(root @ np.swapaxes(root, 1, 2), (runs, times, n, n))


def test_a_right_filter_lies_in_the_band_as_often_as_it_should():
    e, P = errors(0)
    found = nees(e, P)
    assert found.inside == pytest.approx(0.95, abs=0.03)
    assert found.mean == pytest.approx(1, abs=0.02)
    assert found.verdict == "consistent"
    assert nees(e, P, confidence=0.5).inside == pytest.approx(0.5, abs=0.08)


@pytest.mark.parametrize(("factor", "verdict"), [(0.5, "too sure"), (2.0, "too cautious")])
def test_a_wrong_covariance_is_found(factor, verdict):
    e, P = errors(1)
    found = nees(e, factor * P)
    assert found.mean == pytest.approx(1 / factor, rel=0.05)
    assert found.inside < 0.05
    assert found.verdict == verdict


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 100), st.floats(-6, 6))
def test_units_do_not_matter(seed, exponent):
    e, P = errors(seed, runs=5, times=7)
    D = np.diag(10.0 ** (exponent * np.array([1, -1, 0.5])))
    np.testing.assert_allclose(nees(e @ D, D @ P @ D).average, nees(e, P).average, rtol=1e-6)


def test_innovations_of_any_number_of_scalars():
    rng = np.random.default_rng(2)
    rows = rng.integers(0, 4, size=(40, 300))
    rows[:, 7] = 0
    values = np.where(rows > 0, rng.chisquare(np.maximum(rows, 1)), 0.0)
    found = nis(values, rows)
    assert np.isnan(found.average[7])
    assert found.inside == pytest.approx(0.95, abs=0.04)
    assert found.mean == pytest.approx(1, abs=0.03)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda e, P: nees(e[0], P), "errors"),
        (lambda e, P: nees(e, P[:, :3]), "covariances"),
        (lambda e, P: nees(e, -P), "positive definite"),
        (lambda e, P: nees(e * np.nan, P), "errors"),
        (lambda e, P: nees(e, P, confidence=95), "confidence"),
        (lambda e, P: nis(e[..., 0], np.ones((5, 7))), "values"),
        (lambda e, P: nis(np.zeros((5, 7)), np.zeros((5, 7))), "nothing to average"),
    ],
)
def test_bad_numbers_are_named(call, match):
    with pytest.raises(ScenarioError, match=match):
        call(*errors(3, runs=5, times=7))
