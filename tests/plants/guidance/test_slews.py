"""Slews: from the attitude and the rate of the body to a frame that moves, within limits, without a bump."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from plants.geometry import attitude
from plants.guidance.slews import commanded, duration, path_from

vectors = hnp.arrays(float, 3, elements=st.floats(-1, 1))


def moving_frame(turn, rate, t):
    """A frame that turns at a constant rate (rad/s, in its axes)."""
    q = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(np.asarray(t) * rate)).as_quat(scalar_first=True)
    return q, np.asarray(rate)


@settings(deadline=None, max_examples=60)
@given(vectors, vectors, vectors, vectors, st.floats(1e-3, 1e-1), st.floats(1e-5, 1e-3))
def test_a_slew_begins_where_the_body_is_and_ends_in_the_frame(turn, rate, start, spin, fast, hard):
    rate, spin = 1e-3 * rate, 1e-2 * spin
    q = Rotation.from_rotvec(3.0 * start).as_quat(scalar_first=True)
    with jax.enable_x64(True):
        path = path_from(q, spin, moving_frame(turn, rate, 0.0), fast, hard)
        end = float(duration(path))
        first, w = map(np.asarray, commanded(path, 0.0, moving_frame(turn, rate, 0.0)))
        target = moving_frame(turn, rate, end * (1 + 1e-12))
        last, at_end = map(np.asarray, commanded(path, end * (1 + 1e-12), target))
    assert abs(first @ q) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(w, spin, atol=1e-12)
    assert abs(last @ target[0]) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(at_end, target[1], atol=1e-9)


@settings(deadline=None, max_examples=30)
@given(vectors, st.floats(1e-3, 1e-1), st.floats(1e-5, 1e-3))
def test_the_limits_are_kept_about_the_eigenaxis(turn, fast, hard):
    q = Rotation.from_rotvec(3.0 * turn).as_quat(scalar_first=True)
    frame = np.array([1.0, 0, 0, 0]), np.zeros(3)
    with jax.enable_x64(True):
        path = path_from(q, np.zeros(3), frame, fast, hard)
        t = np.linspace(0, float(duration(path)) + 1e-9, 400)
        attitudes, w = (np.asarray(a) for a in jax.vmap(lambda tau: commanded(path, tau, frame))(t))
        angle = np.asarray(attitude.angle(attitudes))
    across = np.linalg.norm(np.cross(w, path.turn), axis=1)
    assert across.max() < 1e-12
    assert np.linalg.norm(w, axis=1).max() <= fast * (1 + 1e-9)
    assert np.linalg.norm(np.diff(w, axis=0), axis=1).max() <= hard * (t[1] - t[0]) * (1 + 1e-9)
    assert (np.diff(angle) <= 1e-12).all()
    # nothing is faster within the limits: bang-bang, or as fast as allowed for part of the way
    whole = float(attitude.angle(q))
    peak = min(fast, np.sqrt(whole * hard))
    assert t[-1] == pytest.approx(0 if whole == 0 else whole / peak + peak / hard, rel=1e-5, abs=1e-8)


@settings(deadline=None, max_examples=30)
@given(vectors, vectors, vectors, vectors)
def test_rates_are_the_derivatives_of_attitudes(turn, rate, start, spin):
    rate, spin, dt = 1e-3 * rate, 1e-2 * spin, 1e-3
    q = Rotation.from_rotvec(3.0 * start).as_quat(scalar_first=True)
    with jax.enable_x64(True):
        path = path_from(q, spin, moving_frame(turn, rate, 0.0), 1e-2, 1e-4)
        for t in np.linspace(0.01, 1, 7) * float(duration(path)):
            pair = [np.asarray(commanded(path, t + d, moving_frame(turn, rate, t + d))[0]) for d in (-dt, dt)]
            step = attitude.to_vector(attitude.compose(pair[1], attitude.conjugate(pair[0])))
            w = commanded(path, t, moving_frame(turn, rate, t))[1]
            np.testing.assert_allclose(np.asarray(step) / (2 * dt), np.asarray(w), atol=2e-7)


def test_half_a_turn_and_no_turn_at_all_are_finite():
    frame = np.array([1.0, 0, 0, 0]), np.zeros(3)
    with jax.enable_x64(True):
        for q in ([0.0, 0, 1, 0], [1.0, 0, 0, 0], [-1.0, 0, 0, 0], [1e-17, 1, 0, 0]):
            path = path_from(np.array(q), np.array([1e-3, 0, 0]), frame, 1e-2, 1e-4)
            for tau in (-1.0, 0.0, 10.0, 1e9):
                assert all(np.isfinite(np.asarray(a)).all() for a in commanded(path, tau, frame))
