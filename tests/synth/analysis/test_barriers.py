"""Barriers: their slopes are those of finite differences, and they end where the norm is one."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import StateSpace, h2norm, hinfnorm
from synth.analysis import barriers
from synth.synthesis.specifications import GeneralisedH2, Peak

N, NW, NZ = 4, 2, 3
MEASURES = {
    "entropy": (partial(barriers.entropy, rate=1.5), lambda G: hinfnorm(G)[0]),
    "H2": (partial(barriers.covariance, trace=True), h2norm),
    "generalised H2": (partial(barriers.covariance, trace=False), GeneralisedH2().of),
    "peak": (barriers.peak, Peak().of),
}


def drawn(seed: int, dt: float) -> np.ndarray:
    """[A B; C D] of a stable system."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((N, N))
    poles = np.linalg.eigvals(A)
    A = (
        A * rng.uniform(0.2, 0.9) / np.abs(poles).max()
        if dt
        else A - (poles.real.max() + rng.uniform(0.1, 1)) * np.eye(N)
    )
    D = rng.standard_normal((NZ, NW)) * bool(dt)
    return np.block([[A, rng.standard_normal((N, NW))], [rng.standard_normal((NZ, N)), D]])


def as_system(M: np.ndarray, dt: float) -> StateSpace:
    return StateSpace(M[:N, :N], M[:N, N:], M[N:, :N], M[N:, N:], dt)


def scaled(M: np.ndarray, factor: float) -> np.ndarray:
    M = M.copy()
    M[N:] *= factor
    return M


@pytest.mark.parametrize(("name", "dt"), [(n, dt) for n in MEASURES for dt in (0.0, 0.5) if dt or n != "peak"])
@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), part=st.floats(0.05, 0.95))
def test_slopes_and_ends(name, dt, seed, part):
    """At a part of its norm the slope is that of differences; above one there is no value."""
    barrier, norm = MEASURES[name]
    M = drawn(seed, dt)
    level = norm(as_system(M, dt))
    M = scaled(M, part / level)
    value, slope = barrier(as_system(M, dt))
    step = 1e-7 * np.random.default_rng(seed).standard_normal(M.shape) * np.abs(M).max()
    step[N:, N:] *= bool(dt)
    ahead, behind = (barrier(as_system(M + sign * step, dt))[0] for sign in (1, -1))
    assert np.isfinite(value)
    if np.isfinite([ahead, behind]).all():
        size = np.linalg.norm(slope) * np.linalg.norm(step)
        assert abs((ahead - behind) / 2 - np.sum(slope * step)) <= 1e-3 * size + 1e-12
    assert barrier(as_system(scaled(M, 1.001 / part), dt))[0] == np.inf
    assert barrier(as_system(scaled(M, 0.999 / part), dt))[0] > value


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), dt=st.sampled_from([0.0, 0.5]))
def test_a_disc_ends_at_the_farthest_pole(seed, dt):
    M = drawn(seed, dt)
    G = as_system(M, dt)
    centre = -0.3
    farthest = float(np.abs(G.poles() - centre).max())
    assert barriers.within(G, centre, 0.999 * farthest)[0] == np.inf
    radius = 1.2 * farthest
    value, slope, by_radius = barriers.within(G, centre, radius)
    step = 1e-7 * np.random.default_rng(seed).standard_normal(M.shape)
    ahead, behind = (barriers.within(as_system(M + sign * step, dt), centre, radius)[0] for sign in (1, -1))
    assert abs((ahead - behind) / 2 - np.sum(slope * step)) <= 1e-3 * np.linalg.norm(slope) * 1e-6 + 1e-12
    e = 1e-6
    ends = [barriers.within(G, centre, radius * np.exp(sign * e))[0] for sign in (1, -1)]
    assert (ends[0] - ends[1]) / (2 * e) == pytest.approx(by_radius, rel=1e-4)
    assert value > 0


def test_nothing_outside():
    unstable = StateSpace([[1.1]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    for barrier, _ in MEASURES.values():
        assert barrier(unstable)[0] == np.inf
