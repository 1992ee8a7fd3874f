"""Star tracker: statistics in its own axes, what blinds it, its rate and its delay."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.instruments import ARCSEC, SensorSuite, mounting_of
from plants.hardware.startracker import StarTracker
from plants.surroundings.environment import FreeSpace

REST = BodyState(q=np.array([1.0, 0, 0, 0]), w=np.zeros(3), wheels=np.zeros(0))


def read(tracker, x, env, noise, h):
    """Readings at the samples whose noise is given, h s apart."""

    def step(s, n):
        return tracker.measure(s, x, env, n[1:], jnp.where(n[0] > 0, h, 0.0))

    with jax.enable_x64(True):
        table = np.hstack([np.arange(len(noise))[:, None], noise])
        return jax.tree.map(np.asarray, jax.lax.scan(step, tracker.init(), jnp.asarray(table))[1])


def test_noise_is_about_the_axes_of_the_tracker():
    boresight = np.array([0.6, 0.0, 0.8])
    tracker = StarTracker.create(cross_noise=10 * ARCSEC, boresight_noise=90 * ARCSEC, boresight=boresight)
    n = 20_000
    with jax.enable_x64(True):
        x = REST._replace(q=np.asarray(attitude.from_euler(np.array([0.4, -0.3, 2.0]))))
        y = read(tracker, x, FreeSpace().at(0.0), np.random.default_rng(0).normal(size=(n, 3)), 0.1)
        body = attitude.compose(attitude.conjugate(tracker.mounting), y.q)
        error = np.asarray(attitude.to_vector(attitude.compose(body, attitude.conjugate(x.q))))  # about body axes
    along = error @ boresight
    across = error - along[:, None] * boresight
    assert along.std() / ARCSEC == pytest.approx(90, rel=4 / np.sqrt(2 * n))
    assert np.sqrt(np.mean(across**2) * 3 / 2) / ARCSEC == pytest.approx(10, rel=4 / np.sqrt(4 * n))
    np.testing.assert_allclose(error.mean(axis=0), 0, atol=4 * 90 * ARCSEC / np.sqrt(n))
    assert (y.valid == 1).all()


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_boresight_is_the_z_axis_of_the_mounting(v):
    b = np.array(v) / np.linalg.norm(v)
    with jax.enable_x64(True):
        np.testing.assert_allclose(attitude.rotate(mounting_of(b), b), [0, 0, 1], atol=1e-12)


def seen(tracker, env, angle):
    """Whether it sees stars with its boresight `angle` rad from the x axis of N, towards z."""
    q = Rotation.from_rotvec([0, np.pi / 2 - angle, 0]).inv().as_quat()[[3, 0, 1, 2]]  # A(q) x = towards the boresight
    with jax.enable_x64(True):
        x = REST._replace(q=np.asarray(attitude.conjugate(q)))
        boresight = np.asarray(attitude.rotate(attitude.conjugate(x.q), jnp.array([0.0, 0.0, 1.0])))
        assert boresight @ [1, 0, 0] == pytest.approx(np.cos(angle))
        return float(tracker.sight(x, env))


@pytest.mark.parametrize("sunlit", [1.0, 0.0])
def test_sun_within_its_exclusion_blinds_unless_the_earth_hides_it(sunlit):
    tracker = StarTracker.create(cross_noise=1e-5, sun_exclusion=0.5)
    with jax.enable_x64(True):
        env = FreeSpace().at(0.0)._replace(sun=jnp.array([1.0, 0, 0]), sunlit=jnp.asarray(sunlit))
    assert seen(tracker, env, 0.49) == (sunlit == 0)
    assert seen(tracker, env, 0.51) == 1


def test_limb_of_the_earth_within_its_exclusion_blinds():
    tracker = StarTracker.create(cross_noise=1e-5, earth_exclusion=0.3)
    with jax.enable_x64(True):
        env = FreeSpace().at(0.0)._replace(r=jnp.array([-7000e3, 0, 0]))  # the Earth lies along x
    limb = np.arcsin(6378.137 / 7000)
    assert seen(tracker, env, limb + 0.29) == 0
    assert seen(tracker, env, limb + 0.31) == 1


def test_what_is_not_modelled_is_not_taken_for_dark_or_for_bright():
    with jax.enable_x64(True):
        for limit in ({"sun_exclusion": 0.5}, {"earth_exclusion": 0.3}):
            assert np.isnan(StarTracker.create(cross_noise=1e-5, **limit).sight(REST, FreeSpace().at(0.0)))


def test_stars_smear_above_the_largest_rate():
    tracker = StarTracker.create(cross_noise=1e-5, fastest=0.02)
    with jax.enable_x64(True):
        for w, clear in (([0.0, 0.0, 0.019], 1), ([0.015, 0.015, 0.0], 0)):
            y = tracker.measure(tracker.init(), REST._replace(w=np.array(w)), FreeSpace().at(0.0), jnp.zeros(3), 0.1)[1]
            assert float(y.valid) == clear
            assert (np.asarray(y.q) != 0).any() == clear


@pytest.mark.parametrize(("period", "h"), [(1.0, 0.25), (0.5, 0.5), (0.2, 0.5), (0.7, 0.2), (1 / 3, 0.1)])
def test_fixes_come_at_the_rate_of_the_tracker_or_of_the_samples(period, h):
    tracker = StarTracker.create(cross_noise=0.0, period=period)
    y = read(tracker, REST, FreeSpace().at(0.0), np.zeros((500, 3)), h)
    assert y.valid[0] == 1
    assert y.valid.mean() == pytest.approx(min(h / period, 1), abs=0.005)
    np.testing.assert_array_equal(y.valid, y.exposed)


@pytest.mark.parametrize(
    ("period", "delay", "h"), [(1.0, 0.5, 0.25), (0.5, 1.25, 0.25), (0.4, 0.33, 0.1), (0.5, 3.0, 0.5)]
)
def test_a_fix_is_of_the_attitude_when_it_was_exposed(period, delay, h):
    """The body turns about z; every fix, less what it has turned since, is where it is now."""
    tracker = StarTracker.create(cross_noise=1e-9, period=period, delay=delay)
    spin = 0.1

    def step(s, k):
        x = SimpleNamespace(q=attitude.from_vector(spin * h * k * jnp.array([0.0, 0, 1])), w=jnp.zeros(3))
        s, y = tracker.measure(s, x, FreeSpace().at(0.0), jnp.zeros(3), jnp.where(k > 0, h, 0.0))
        return s, (y, attitude.to_vector(attitude.compose(x.q, attitude.conjugate(y.q + (1 - y.valid)))))

    with jax.enable_x64(True):
        y, turned = jax.tree.map(np.asarray, jax.lax.scan(step, tracker.init(), jnp.arange(60))[1])
    given = y.valid > 0
    late = np.ceil(delay / h - 1e-9) * h
    assert not given[: round(late / h)].any()
    assert given.sum() >= y.exposed.sum() - np.ceil(late / period)
    np.testing.assert_allclose(y.age[given], late, atol=1e-9)
    np.testing.assert_allclose(turned[given, 2], spin * late, atol=1e-7)
    np.testing.assert_array_equal(y.q[~given], 0)


def test_a_misaligned_tracker_reads_so():
    with jax.enable_x64(True):
        tracker = StarTracker.create(cross_noise=0.0, misalignment=[1e-3, -2e-3, 3e-3])
        y = tracker.measure(tracker.init(), REST, FreeSpace().at(0.0), jnp.zeros(3), 0.0)[1]
        np.testing.assert_allclose(attitude.to_vector(y.q), [1e-3, -2e-3, 3e-3], atol=1e-15)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("cross_noise", -1.0), ("boresight_noise", np.nan), ("boresight", [0.0, 0.0, 2.0]), ("mounting", np.ones(4)),
        ("misalignment", np.zeros(2)), ("period", -1.0), ("delay", 0.3), ("sun_exclusion", -0.1),
        ("earth_exclusion", np.inf), ("fastest", 0.0),
    ],
)  # fmt: skip
def test_bad_numbers_are_named(field, value):
    with pytest.raises(ScenarioError, match=field):
        StarTracker.create(**{"cross_noise": 1e-5, field: value})


def test_boresight_and_mounting_are_one_too_many():
    with pytest.raises(ScenarioError, match="boresight and mounting"):
        StarTracker.create(cross_noise=1e-5, boresight=[1.0, 0, 0], mounting=[1.0, 0, 0, 0])


@pytest.mark.parametrize("wrong", [[], None, [StarTracker], [3.0], [{"noise": 1.0}]])
def test_a_suite_is_of_instruments(wrong):
    with pytest.raises(ScenarioError, match="instruments"):
        SensorSuite.create(wrong)


def test_a_suite_deals_the_noise_in_order():
    a = StarTracker.create(cross_noise=1e-3)
    suite = SensorSuite.create([a, a])
    with jax.enable_x64(True):
        noise = jnp.arange(6.0)
        _, both = suite.measure(suite.init(), REST, FreeSpace().at(0.0), noise, 0.0)
        for reading, part in zip(both, (noise[:3], noise[3:]), strict=True):
            np.testing.assert_array_equal(reading.q, a.measure(a.init(), REST, FreeSpace().at(0.0), part, 0.0)[1].q)
    assert suite.channels == 6
