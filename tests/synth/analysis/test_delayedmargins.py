"""Margins of loops with a delay: by hand, against approximants of high order, and in other units."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, NumericalError, StateSpace, margin, pade
from synth.analysis.delayedmargins import unstable_roots

ORDER = 26  # of approximants, exact where w T is below some 20


def closed(G: StateSpace, T: float) -> np.ndarray:
    """Poles of the loop with an approximant."""
    return synth.feedback(synth.series(G, pade(T, ORDER))).poles()


def loop(seed: int, kind: str) -> tuple[StateSpace, float]:
    rng = np.random.default_rng(seed)
    T = 10 ** rng.uniform(-2, 0.7)
    if kind == "flexible":  # a rigid body with bending modes under PD
        G = synth.system([1.0], [1.0, 0.0, 0.0])
        for w in 10 ** rng.uniform(-0.5, 1, int(rng.integers(1, 3))):
            G = G + synth.system([0.3 * rng.standard_normal()], [1.0, 2 * 10 ** rng.uniform(-4, -1) * w, w**2])
        return 0.2 * synth.series(G, synth.system([2.0, 0.5], [0.05, 1.0])), min(T, 1.0)
    n = int(rng.integers(1, 6))
    A = rng.standard_normal((n, n)) - rng.uniform(-0.3, 1.5) * np.eye(n)
    if kind == "integrator":
        A[0] = 0.0
    D = rng.choice([0.0, 0.3]) if kind == "dense" else 0.0
    return StateSpace(A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)), [[D]]), T


@pytest.mark.parametrize(("k", "T"), [(1, 0.5), (0.2, 3), (10, 0.1), (1e-4, 100)])
def test_an_integrator_with_a_delay(k, T):
    found = margin(([k], [1, 0]), delay=T)
    assert found.gain_up == pytest.approx(np.pi / (2 * k * T), rel=1e-12)
    assert found.gain_down == 0
    assert found.phase == pytest.approx(np.pi / 2 - k * T, rel=1e-12)
    assert found.delay == pytest.approx(np.pi / (2 * k) - T, rel=1e-12)
    assert margin(([k], [1, 0]), delay=np.pi / (2 * k) * 1.001).delay == 0


def test_a_delay_that_stabilises():
    """x'' + x = k x(t - T), small k > 0: unstable with no delay but stable from any short one up to about pi."""
    L = synth.system([-0.1], [1.0, 0.0, 1.0])
    assert margin(L).delay == 0
    for T in (0.05, 1.0, 2.8):
        found = margin(L, delay=T)
        assert found.delay > 0
        assert closed(0.999 * L, T).real.max() < 0
    assert margin(L, delay=3.3).delay == 0


KINDS = st.sampled_from(["dense", "integrator", "flexible"])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), KINDS)
def test_loops_fail_where_it_is_said(seed, kind):
    """The count of unstable roots, and both sides of every margin, against approximants."""
    G, T = loop(seed, kind)
    poles = closed(G, T)
    assume(np.abs(poles.real).min() > 1e-6)
    assert unstable_roots(G, T) == np.sum(poles.real > 0)
    found = margin(G, delay=T)
    if poles.real.max() > 0:
        assert (found.gain_up, found.gain_down, found.phase, found.delay) == (1, 1, 0, 0)
        return

    def stable(gain: float, T: float) -> bool:
        return closed(gain * G, T).real.max() < 0

    if found.gain_up < 30:
        assert stable(found.gain_up * 0.998, T)
        assert not stable(found.gain_up * 1.002, T)
    if found.gain_down > 0:
        assert stable(found.gain_down * 1.002, T)
        assert not stable(found.gain_down * 0.998, T)
    if found.delay < 5:
        assert stable(1.0, T + 0.998 * found.delay)
        assert not stable(1.0, T + 1.002 * found.delay)
    if found.phase < np.pi:
        assert found.delay <= (found.phase + 2 * np.pi) / found.phase_frequency


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), KINDS, st.floats(-6, 6))
def test_units_and_coordinates_do_not_matter(seed, kind, decades):
    G, T = loop(seed, kind)
    rng, unit = np.random.default_rng(seed), 10.0**decades
    D = 10.0 ** rng.uniform(-4, 4, G.n)
    H = StateSpace(unit * G.A * D / D[:, None], unit * G.B / D[:, None], G.C * D, G.D)
    one, other = margin(G, delay=T), margin(H, delay=T / unit)
    assert other.gain_up == pytest.approx(one.gain_up, rel=1e-6)
    assert other.gain_down == pytest.approx(one.gain_down, rel=1e-6)
    assert other.phase == pytest.approx(one.phase, rel=1e-6, abs=1e-9)
    assert other.delay * unit == pytest.approx(one.delay, rel=1e-6)


def test_no_delay_and_delays_of_samples():
    G = synth.system([1.0, 2.0], [1.0, 0.3, 2.0, 0.0])
    assert margin(G, delay=0.0) == margin(G)
    H = synth.c2d(0.2 * G, 0.1)
    assert margin(H, delay=0.2).delay == pytest.approx(margin(H).delay - 0.2, rel=1e-9)
    with pytest.raises(ModelError, match="pass whole samples"):
        margin(H, delay=0.25)


def test_what_is_refused():
    G = synth.system([1.0], [1.0, 1.0])
    with pytest.raises(ModelError, match="delay is -1"):
        margin(G, delay=-1)
    with pytest.raises(ModelError, match="3 x 3"):
        margin(np.eye(3), delay=1)
    with pytest.raises(ModelError, match="L is uncertain"):
        margin(synth.UncertainSystem([[synth.ureal("J", 1.0, percentage=20)]], -1.0, 1.0, 1.0), delay=0.1)
    assert margin(synth.system([0.99e6], [1.0, 1e6]), delay=1e3).gain_up == pytest.approx(1 / 0.99, rel=1e-6)
    assert margin(synth.system([2.0, 1.0], [1.0, 3.0]), delay=0.1).delay == 0  # |D| is two: no delay is borne


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), KINDS)
def test_all_margins_bring_the_loop_to_the_critical_point(seed, kind):
    """Each of them, and the nearest are those of `margin`."""
    G, T = loop(seed, kind)
    found = synth.allmargin(G, delay=T)

    def turned(w: np.ndarray, T: float) -> np.ndarray:
        return np.array([G.matrices.at(1j * x)[0, 0] * np.exp(-1j * x * T) for x in w])

    for k, w in zip(found.gain, found.gain_frequency, strict=True):
        assert k * turned([w], T)[0] == pytest.approx(-1, abs=1e-6)
    at = turned(found.phase_frequency, T) * np.exp(-1j * found.phase)
    np.testing.assert_allclose(at, -np.ones(len(at)), atol=1e-6)
    for late, w in zip(found.delay, found.delay_frequency, strict=True):
        assert turned([w], T + late)[0] == pytest.approx(-1, abs=1e-6)
    assert found.stable == (unstable_roots(G, T) == 0)
    if found.stable:
        nearest = margin(G, delay=T)
        assert nearest.delay == min(found.delay, default=np.inf)
        assert nearest.phase == min(np.abs(found.phase), default=np.pi)
        if nearest.gain_up < np.inf and np.isfinite(nearest.gain_frequency) and not G.D.any():
            assert nearest.gain_up == min(found.gain[found.gain > 1])


def coupled(seed: int) -> tuple[StateSpace, StateSpace, float]:
    """Two axes that act on one another, under PD with a lag, and a delay that takes a part of the margins."""
    rng = np.random.default_rng(seed)
    I, Z = np.eye(2), np.zeros((2, 2))
    M = I + 0.4 * rng.uniform(-1, 1, (2, 2))
    P = StateSpace(np.block([[Z, I], [Z, Z]]), np.vstack([Z, M]), np.hstack([I, Z]), Z)
    lag, gain = 8.0, 0.25
    K = StateSpace(-lag * I, I, (gain - 1.2 * lag) * lag * I, 1.2 * lag * I)
    return P, K, float(rng.uniform(0.02, 0.15))


@pytest.mark.parametrize("seed", range(8))
def test_margins_of_coupled_loops_are_where_the_loop_with_its_delay_fails(seed):
    """det(I + L e^(-s T)) with the gain, phase or delay of one channel, evaluated without an approximant."""
    P, K, T = coupled(seed)
    found = synth.margins(P, K, delay=T)
    assert 0 < found.disk < synth.margins(P, K).disk

    def determinant(w: float, factor: complex, i: int, ends: str) -> complex:
        p, k = (G.matrices.at(1j * w) for G in (P, K))
        L = (k @ p if ends == "input" else p @ k) * np.exp(-1j * w * T)
        L[:, i] *= factor
        return np.linalg.det(np.eye(2) + L)

    for ends in ("input", "output"):
        for i, m in enumerate(getattr(found, ends)):
            gain = m.gain_up if abs(np.log(m.gain_up)) < abs(np.log(m.gain_down or 1e-300)) else m.gain_down
            assert abs(determinant(m.gain_frequency, gain, i, ends)) < 1e-6
            turned = [determinant(m.phase_frequency, np.exp(s * 1j * m.phase), i, ends) for s in (1, -1)]
            assert min(map(abs, turned)) < 1e-6
            w = m.delay_frequency
            assert abs(determinant(w, np.exp(-1j * w * m.delay), i, ends)) < 1e-6
    for m, order in ((found.disk_input, 1), (found.disk_output, -1)):
        w = m.frequency
        p, k = (G.matrices.at(1j * w) for G in (P, K))
        L = (k @ p if order == 1 else p @ k) * np.exp(-1j * w * T)
        assert abs(np.linalg.det(np.eye(2) + L @ np.diag(m.factors))) < 1e-6


def test_margins_of_one_loop_are_exact_and_the_disk_is_that_of_the_frequency_response():
    P, K, T = synth.system([1.0], [1.0, 0.4, 0.0]), synth.system([2.0, 1.0], [0.1, 1.0]), 0.3
    found, w = synth.margins(P, K, delay=T), np.geomspace(1e-3, 1e3, 200_001)
    assert found.input == found.output == (margin(synth.series(P, K), delay=T),)
    L = (P.frequency_response(w) * K.frequency_response(w))[:, 0, 0] * np.exp(-1j * w * T)
    assert found.disk == pytest.approx(1 / np.abs(1 / (1 + L) - 0.5).max(), rel=1e-6)
    H = synth.c2d(P, 0.1)
    late = synth.margins(H, 0.3, delay=0.2)
    assert late.delay == pytest.approx(synth.margins(H, 0.3).delay - 0.2, rel=1e-9)


def test_delays_that_no_approximant_is_near_to_are_refused_with_what_to_do():
    P, K, _ = coupled(0)
    with pytest.raises(NumericalError, match="sample the system with its delay, which is exact"):
        synth.margins(P, K, delay=1e3)
    with pytest.raises(ModelError, match="ever higher frequencies"):
        synth.margins(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[1.0]]), 0.5, delay=0.1)
    with pytest.raises(ModelError, match=r"delay is 0\.1 s and P is uncertain"):
        synth.margins(synth.UncertainSystem(1, -synth.ureal("k", 1.0, percentage=10), 1, 1, 0), 0.5, delay=0.1)
