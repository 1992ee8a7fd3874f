"""The structured singular value: bounds that meet, whatever the units, with SLICOT as the oracle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import StateSpace
from synth.analysis.structured import best_scaling, destabilising, structured_norm


def drawn(seed: int, m: int, zeros: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng([seed, m])
    M = rng.normal(size=(m, m)) + 1j * rng.normal(size=(m, m))
    return np.where(rng.random((m, m)) < zeros, 0, M)


def units(seed: int, m: int) -> np.ndarray:
    return 10 ** np.random.default_rng([seed, m, 1]).uniform(-8, 8, m)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 3), st.sampled_from([0.0, 0.3, 0.6]))
def test_bounds_meet_up_to_three_channels(seed, m, zeros):
    """The scaled norm from above, singular matrices from below; couplings one way only are scaled away."""
    M = drawn(seed, m, zeros)
    norm = best_scaling(M).norm
    size = np.linalg.norm(M, 2)
    if norm <= 1e-9 * size:  # nothing comes back to where it started
        assert np.abs(np.linalg.matrix_power(M, m)).max() <= 1e-8 * size**m
        return
    delta = destabilising(M)
    assert 1 / np.abs(delta).max() == pytest.approx(norm, rel=1e-6)
    assert np.linalg.svd(np.eye(m) - M * delta, compute_uv=False)[-1] < 1e-7 * (1 + size * np.abs(delta).max())


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 8))
def test_units_change_nothing(seed, m):
    M, d = drawn(seed, m), units(seed, m)
    assert best_scaling(M * d[:, None] / d).norm == pytest.approx(best_scaling(M).norm, rel=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 8))
def test_no_scaling_is_better_and_no_matrix_contradicts(seed, m):
    """Random scalings are worse, random changes inside the bound leave I - M Delta regular."""
    M, rng = drawn(seed, m), np.random.default_rng(seed)
    found = best_scaling(M)
    assert np.linalg.norm(M * found.D[:, None] / found.D, 2) == pytest.approx(found.norm, rel=1e-12)
    for size in (1e-3, 1e-2, 0.1, 1.0):
        D = found.D * np.exp(size * rng.normal(size=m))
        assert np.linalg.norm(M * D[:, None] / D, 2) >= found.norm * (1 - 1e-9)
    assert max(abs(np.linalg.eigvals(M * np.exp(2j * np.pi * rng.random(m))))) <= found.norm * (1 + 1e-9)
    assert 1 / np.abs(destabilising(M)).max() <= found.norm * (1 + 1e-9)


@pytest.mark.parametrize("m", [2, 3, 5, 8])
@pytest.mark.parametrize("seed", range(5))
def test_against_slicot(seed, m):
    slycot = pytest.importorskip("slycot", reason="slycot is not installed")
    M = drawn(seed, m)
    bound = slycot.ab13md(M, np.ones(m, int), np.full(m, 2))[0]
    assert best_scaling(M).norm == pytest.approx(bound, rel=1e-3)  # its own tolerance


@pytest.mark.parametrize("m", [2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
def test_the_peak_over_frequency_is_above_a_fine_grid_and_reached(seed, m):
    rng = np.random.default_rng([seed, m, 2])
    A = rng.normal(size=(6, 6))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    G = StateSpace(A, rng.normal(size=(6, m)), rng.normal(size=(m, 6)), rng.normal(size=(m, m)), 1.0)

    def mu(angle: float) -> float:
        return best_scaling(G.C @ np.linalg.solve(np.exp(1j * angle) * np.eye(6) - G.A, G.B) + G.D).norm

    peak = structured_norm(G)
    assert mu(peak.angle) == pytest.approx(peak.value, rel=1e-9)
    assert max(mu(angle) for angle in np.linspace(0, np.pi, 300)) <= peak.value * (1 + 1e-7)


@pytest.mark.parametrize("seed", range(20))
def test_rounding_errors_of_zero_couple_nothing(seed):
    """Blocks that see one another one way only, the way back a rounding error or none, in any units."""
    rng = np.random.default_rng([seed, 3])
    m = int(rng.integers(2, 4))
    A, B = drawn(seed, m), drawn(seed + 100, m)
    noise = 10.0 ** rng.uniform(-40, -18, (m, m)) * (rng.random((m, m)) < 0.5)
    M = np.block([[A, 10 ** rng.uniform(-3, 3) * drawn(seed + 200, m)], [noise, B]])
    d = units(seed, 2 * m)
    expected = max(best_scaling(A).norm, best_scaling(B).norm)
    assert best_scaling(M * d[:, None] / d).norm == pytest.approx(expected, rel=1e-7)
