"""Pade approximants and their error."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, pade, pade_error


@pytest.mark.parametrize("n", range(1, 9))
def test_it_is_the_approximant_of_python_control(n):
    num, den = control.pade(0.7, n)
    omega = np.geomspace(0.01, 50, 30)
    s = 1j * omega
    expected = np.polyval(num, s) / np.polyval(den, s)
    np.testing.assert_allclose(pade(0.7, n).frequency_response(omega)[:, 0, 0], expected, rtol=1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 60), st.floats(1e-6, 1e4), st.floats(0, 4))
def test_all_pass_balanced_and_as_far_as_it_says(n, T, decades):
    """At every order and in every unit of time; both Gramians are the identity."""
    P = pade(T, n)
    I = np.eye(n)
    np.testing.assert_allclose(T * (P.A + P.A.T + P.B @ P.B.T), 0 * I, atol=1e-9 * n**2)
    np.testing.assert_allclose(T * (P.A + P.A.T + P.C.T @ P.C), 0 * I, atol=1e-9 * n**2)
    assert P.poles().real.max() < 0
    omega = np.linspace(0, n * 10 ** (decades - 2), 200) / T
    error = np.abs(np.exp(-1j * omega * T) - P.frequency_response(omega)[:, 0, 0])
    stated = pade_error(T, n, omega)
    assert np.all(np.diff(stated) >= -1e-12)
    bound = np.maximum.accumulate(error)
    assert np.all(bound <= stated + 1e-9 * (1 + omega * T))
    tight = stated < 1.9
    np.testing.assert_allclose(error[tight], stated[tight], rtol=1e-6, atol=1e-9 * (1 + n * 10 ** (decades - 2)))


def test_sampled_loops_need_none():
    """A loop with a high approximant sampled fast is the loop whose delay is exact."""
    G, dt = synth.system([1.0], [1.0, 1.0]), 0.1
    exact, near = (synth.c2d(G, dt, delay=0.237), synth.c2d(G * pade(0.237, 12), dt))
    omega = np.geomspace(0.01, 3, 10)
    np.testing.assert_allclose(exact.frequency_response(omega), near.frequency_response(omega), rtol=2e-2)


def test_no_delay_and_what_is_refused():
    assert pade(0, 3).n == 0
    assert pade(0, 3).D[0, 0] == 1
    with pytest.raises(ModelError, match="delay is -1"):
        pade(-1, 3)
    with pytest.raises(ModelError, match="n is 0"):
        pade(1, 0)
    with pytest.raises(ModelError, match="omega has -2"):
        pade_error(1, 2, [1, -2])
