"""Margins: literature values, python-control as the oracle, and what they promise, kept."""

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import cubesat_model
from scipy.optimize import brentq

from synth.analysis.diskmargins import diskmargin
from synth.analysis.gap import gapmetric
from synth.analysis.norms import is_stable
from synth.analysis.stabilitymargins import allmargin, margin, margins
from synth.errors import ModelError
from synth.regulators.controller import proportional_derivative
from synth.systems.connect import delayed, feedback, series
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace


def transfer(numerator, denominator, dt=0.0) -> StateSpace:
    return StateSpace.of(control.ss(control.tf(numerator, denominator, dt)))


def gain(k, dt=0.0):
    return StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[k]], dt)


def test_disk_margin_of_the_introduction():
    """Seiler, Packard and Gahinet (2020), example L = 25 / (s^3 + 10 s^2 + 10 s + 10): GM 3.6, PM 29.1 deg, 0.46."""
    L = transfer([25], [1, 10, 10, 10])
    found, disk = margin(L), diskmargin(L)
    assert found.gain_up == pytest.approx(3.6, rel=1e-6)
    assert found.gain_down == 0
    assert found.phase_deg == pytest.approx(29.1, abs=0.05)
    assert disk.alpha == pytest.approx(0.46, abs=0.005)
    assert disk.gain == (pytest.approx(0.63, abs=0.005), pytest.approx(1.59, abs=0.01))
    assert np.rad2deg(disk.phase) == pytest.approx(25.8, abs=0.2)
    assert disk.frequency == pytest.approx(1.94, abs=0.02)


LOOPS = {
    "third order": transfer([25], [1, 10, 10, 10]),
    "unstable plant": transfer([6, 3], [1, 1, -2, 0]),
    "resonance": transfer([0.4, 0.004], [1, 0.05, 1, 0.02]),
    "double integrator with lead": transfer([2.0, 0.4], [0.05, 1, 0, 0]),
    "sampled": c2d(transfer([2.0, 0.4], [0.05, 1, 0, 0]), 0.2),
    "sampled resonance": c2d(transfer([0.4, 0.004], [1, 0.5, 1, 0.02]), 0.3),
}


@pytest.mark.parametrize("name", LOOPS)
def test_gain_and_phase_margin_against_python_control(name):
    L = LOOPS[name]
    assert is_stable(feedback(L, gain(1.0, L.dt)))
    found = margin(L)
    gains, phases, _, _, at_phase, _ = control.stability_margins(L.to_control(), returnall=True, method="poly")
    finite = gains[np.isfinite(gains) & (gains > 0)]
    if L.dt == 0:  # python-control passes over crossings at the Nyquist frequency
        assert found.gain_up == pytest.approx(min(finite[finite > 1], default=np.inf), rel=1e-5)
        assert found.gain_down == pytest.approx(max(finite[finite < 1], default=0.0), rel=1e-5)
    if not len(phases):
        assert (found.phase, found.delay) == (np.pi, np.inf)
        return
    assert found.phase_deg == pytest.approx(min(np.abs(phases)), rel=1e-4)
    assert found.phase_frequency == pytest.approx(at_phase[np.argmin(np.abs(phases))], rel=1e-4)
    assert found.delay == pytest.approx(min(np.deg2rad(phases) % (2 * np.pi) / at_phase), rel=1e-4)


@pytest.mark.parametrize("name", LOOPS)
def test_disk_margin_against_python_control(name):
    L = LOOPS[name]
    peak = diskmargin(L)
    grid = np.unique(np.append(np.geomspace(1e-3, 0.999 * np.pi / L.dt if L.dt else 1e3, 2000), peak.frequency))
    alpha = control.disk_margins(L.to_control(), grid)[0]
    assert peak.alpha == pytest.approx(alpha, rel=1e-4)


@pytest.mark.parametrize("name", LOOPS)
def test_the_loop_is_stable_up_to_its_gain_margin_and_not_beyond(name):
    L = LOOPS[name]
    found = margin(L)
    for limit, inside, outside in ((found.gain_up, 0.999, 1.001), (found.gain_down, 1.001, 0.999)):
        if 0 < limit < np.inf:
            assert is_stable(feedback(L, gain(inside * limit, L.dt)))
            assert not is_stable(feedback(L, gain(outside * limit, L.dt)))
    low, high = diskmargin(L).gain
    assert found.gain_up >= high * (1 - 1e-6)
    assert found.gain_down <= low * (1 + 1e-6)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_margins_of_random_loops_are_tight(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.3, 1.1) / np.abs(np.linalg.eigvals(A)).max()
    L = StateSpace(A, rng.normal(size=(n, 1)), 0.3 * rng.normal(size=(1, n)), [[0.1 * rng.normal()]], 1.0)
    found = margin(L)
    if found.phase == 0:
        assert not is_stable(feedback(L, gain(1.0, 1.0)))
        return
    for k in np.linspace(max(found.gain_down, 1e-3) * 1.0001, min(found.gain_up, 1e3) * 0.9999, 40):
        assert is_stable(feedback(L, gain(k, 1.0)))
    if found.gain_up < 1e3:
        assert not is_stable(feedback(L, gain(1.0001 * found.gain_up, 1.0)))
    if found.gain_down > 1e-3:
        assert not is_stable(feedback(L, gain(0.9999 * found.gain_down, 1.0)))


def test_whole_samples_of_delay_up_to_the_delay_margin():
    L = c2d(transfer([0.5, 0.1], [0.05, 1, 0, 0]), 0.05)
    samples = margin(L).delay / L.dt
    assert 1 < samples < 100

    def delayed(k):
        A, B, C = np.eye(k, k=-1), np.eye(k, 1), np.eye(1, k, k - 1)
        return StateSpace(
            np.block([[L.A, L.B @ C], [np.zeros((k, L.n)), A]]),
            np.vstack([np.zeros((L.n, 1)), B]),
            np.hstack([L.C, np.zeros((1, k))]),
            [[0.0]],
            L.dt,
        )

    assert is_stable(feedback(delayed(int(samples)), gain(1.0, L.dt)))
    assert not is_stable(feedback(delayed(int(samples) + 1), gain(1.0, L.dt)))


def test_loops_of_several_signals_one_at_a_time():
    """A diagonal loop has the margins of its entries, and the disk margin of the worst; signs turn with `sign`."""
    P = cubesat_model()
    D = -proportional_derivative([0.0546, 0.0546, 0.0074], 0.17, 0.8, P.dt).D
    K = StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((3, 0)), D, P.dt)
    positive = margins(P, K, sign=1)
    negative = margins(P, StateSpace(K.A, K.B, -K.C, -K.D, K.dt))
    assert (len(positive.input), len(positive.output)) == (3, 6)
    assert positive.gain_db == pytest.approx(negative.gain_db)
    assert positive.ncf == pytest.approx(negative.ncf)
    assert 0 < positive.disk <= 2
    for i, one in enumerate(positive.input):
        scaled = D.copy()
        scaled[i] *= 1.001 * one.gain_up
        closed = feedback(P, StateSpace(K.A, K.B, -K.C, -scaled, K.dt))
        assert not is_stable(closed)
    low, high = positive.disk_input.gain
    for factor in (1.001 * low, 0.999 * high):
        assert is_stable(feedback(P, StateSpace(K.A, K.B, -K.C, -factor * D, K.dt)))
    assert gapmetric(P, P).nugap < positive.ncf


def test_an_unstable_loop_has_no_margins():
    L = transfer([1], [1, -3])
    assert (margin(L).gain_db, margin(L).phase, margin(L).delay, diskmargin(L).alpha) == (0, 0, 0, 0)


def test_refusals():
    two = StateSpace(np.eye(2) / 2, np.eye(2), np.eye(2), np.zeros((2, 2)), 1.0)
    with pytest.raises(ModelError, match="L is 2 x 2"):
        margin(two)
    with pytest.raises(ModelError, match="sign is 0"):
        margin(LOOPS["sampled"], sign=0)
    with pytest.raises(ModelError, match="needs 2 x 2"):
        margins(two, gain(1.0, 1.0))


def test_a_loop_above_one_at_high_frequencies_bears_no_delay():
    """Every delay turns L = 2 + 1/(s + 1) to the critical side at some high frequency."""
    found = margin(transfer([2, 3], [1, 1]))
    assert (found.delay, found.delay_frequency) == (0, np.inf)
    assert (found.gain_up, found.gain_down, found.phase) == (np.inf, 0, np.pi)
    assert np.isnan([found.gain_frequency, found.phase_frequency]).all()


@pytest.mark.parametrize(("gain", "samples"), [(2.0, 1), (-3.0, 1), (0.9, np.inf)])
def test_a_sampled_gain_bears_no_sample_of_delay_above_one(gain, samples):
    """1 + g z^-k has all its roots at the modulus |g|^(1/k)."""
    assert margin(StateSpace.gain([[gain]], 0.1)).delay == pytest.approx(0.1 * samples)


def test_a_loop_above_one_at_the_nyquist_frequency_fails_at_a_whole_sample():
    """L = 1.2 (z + 0.2) / (z + 0.5): the count is that of the eigenvalues."""
    L = StateSpace([[-0.5]], [[1.0]], [[1.2 * (0.2 - 0.5)]], [[1.2]], 1.0)
    found = margin(L).delay
    radii = []
    for _ in range(int(found) + 1):
        radii.append(np.abs(feedback(L, StateSpace.gain([[1.0]], 1.0)).poles()).max())
        L = delayed(L)
    assert all(r < 1 for r in radii[:-1])
    assert radii[-1] >= 1


@pytest.mark.parametrize("fast", [1e1, 1e2, 1e3, 1e4])
@pytest.mark.parametrize("spring", [0.3, 1.0, 4.0])
def test_integrators_beside_fast_poles_hide_no_crossing(fast, spring):
    """Two masses, undamped, under three leads: L < 0 above the resonance where the leads give half a turn, twice."""
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-spring, spring, 0, 0], [spring, -spring, 0, 0]]
    lead = transfer([1, 1], [1 / fast, 1])
    L = series(100 * lead * lead * lead, StateSpace(A, [[0], [0], [1], [0]], [[0, 1, 0, 0]], [[0]]))

    def short(w):
        return 3 * (np.arctan(w) - np.arctan(w / fast)) - np.pi

    top = np.sqrt(fast)
    ends = ((1e-3, top), (top, 1e3 * fast)) if short(top) > 0 else ()
    expected = [brentq(short, *each) for each in ends]
    found = allmargin(L)
    inner = np.isfinite(found.gain_frequency) & (found.gain_frequency > 0)
    wanted = [w for w in expected if w > np.sqrt(2 * spring)]
    np.testing.assert_allclose(np.sort(found.gain_frequency[inner]), wanted, rtol=1e-5)
    np.testing.assert_allclose(
        found.gain[inner], [1 / abs(L.frequency_response([w]).ravel()[0]) for w in wanted], rtol=1e-4
    )
