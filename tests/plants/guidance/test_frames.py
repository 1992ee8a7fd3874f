"""Commanded frames: what points where, and rates that are the derivatives of attitudes."""

from datetime import datetime, timedelta

import erfa
import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.guidance.directions import Fixed, Forward, OrbitNormal, ToEarth, ToSun, ToTarget
from plants.guidance.frames import Inertial, Nadir, Offset, Pointing, Profile
from plants.surroundings.environment import Environment
from plants.surroundings.ephemeris import julian
from plants.surroundings.orbit import circular

EPOCH = datetime(2026, 3, 20, 6)
X, Z = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
MUNICH = {"latitude": np.radians(48.14), "longitude": np.radians(11.58), "altitude": 520.0}


@pytest.fixture(scope="module")
def environment():
    return Environment.along(circular(500e3, np.radians(97.4), 1.0, 0.5), EPOCH, 6000.0)


def guidances():
    target = ToTarget.create(**MUNICH, epoch=EPOCH)
    slow = Rotation.from_rotvec(np.linspace(0, 2, 61)[:, None] * [0.3, -0.5, 1.0]).as_quat(scalar_first=True)
    return {
        "nadir": Nadir(),
        "Earth": Pointing.create(Z, ToEarth(), second_axis=X, second_to=Forward()),
        "target": Pointing.create(Z, target, second_axis=X, second_to=Forward()),
        "sun": Pointing.create([0.6, 0.8, 0.0], ToSun(), second_axis=Z, second_to=ToEarth()),
        "normal": Pointing.create(X, OrbitNormal(), second_axis=Z, second_to=ToSun()),
        "star": Pointing.create(X, Fixed.create([3.0, -1.0, 2.0]), second_axis=Z, second_to=ToEarth()),
        "inertial": Inertial.create([0.5, 0.5, -0.5, 0.5]),
        "tilted": Offset.create([0.8, 0.0, 0.6, 0.0], Nadir()),
        "profile": Profile.create(slow, step=100.0),
    }


@pytest.fixture(scope="module")
def frames(environment):
    """Attitudes and rates (times, ...) of each guidance, at times and 0.05 s before and after."""
    t = np.linspace(100.0, 5900.0, 40)[:, None] + [-0.05, 0.0, 0.05]
    with jax.enable_x64(True):
        made = {
            name: jax.jit(jax.vmap(jax.vmap(lambda t, g=g: g.frame(t, environment.at(t)))))(t)
            for name, g in guidances().items()
        }
        return {name: tuple(np.asarray(a) for a in pair) for name, pair in made.items()}


@pytest.mark.parametrize("name", guidances())
def test_rates_are_the_derivatives_of_attitudes(frames, name):
    q, w = frames[name]
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1, atol=1e-9)
    with jax.enable_x64(True):
        turn = attitude.to_vector(attitude.compose(q[:, 2], attitude.conjugate(q[:, 0])))
    left_out = 3e-7 if name in ("sun", "normal") else 2e-9  # the motion of the Sun, 2e-7 rad/s
    np.testing.assert_allclose(np.asarray(turn) / 0.1, w[:, 1], atol=left_out)


def test_the_earth_pointing_frame_is_the_orbital_one(frames):
    for a, b in zip(frames["Earth"], frames["nadir"], strict=True):
        b = b * np.sign(np.sum(a * b, axis=-1, keepdims=True)) if a.shape[-1] == 4 else b
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_the_axis_looks_at_the_place_on_the_ground(environment, frames):
    t = np.linspace(100.0, 5900.0, 40)
    utc1, utc2, tt1, tt2 = julian(EPOCH, t)
    place = np.array(erfa.gd2gc(1, MUNICH["longitude"], MUNICH["latitude"], MUNICH["altitude"]))
    in_space = np.swapaxes(erfa.c2t06a(tt1, tt2, utc1, utc2, 0.0, 0.0), -1, -2) @ place
    with jax.enable_x64(True):
        r = np.asarray(jax.vmap(environment.at)(t).r)
        seen = np.asarray(attitude.rotate(frames["target"][0][:, 1], in_space - r))
    off = np.linalg.norm(seen[:, :2], axis=1) / seen[:, 2]
    assert (seen[:, 2] > 0).all()
    assert off.max() < 2e-6


def test_the_second_axis_is_as_near_as_it_can_be(environment, frames):
    t = np.linspace(100.0, 5900.0, 40)
    with jax.enable_x64(True):
        env = jax.vmap(environment.at)(t)
        sun, down = (np.asarray(attitude.rotate(frames["sun"][0][:, 1], v)) for v in (env.sun, -env.r))
    np.testing.assert_allclose(sun, np.tile([0.6, 0.8, 0.0], (40, 1)), atol=1e-9)
    across = down - (down @ [0.6, 0.8, 0.0])[:, None] * [0.6, 0.8, 0.0]
    np.testing.assert_allclose(
        across / np.linalg.norm(across, axis=1)[:, None], np.tile([0, 0, 1.0], (40, 1)), atol=1e-9
    )


@settings(deadline=None, max_examples=25)
@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.floats(0.1, 1e4))
def test_a_profile_goes_through_its_attitudes_whatever_their_signs(axis, step):
    q = Rotation.from_rotvec(np.linspace(0, 1, 12)[:, None] * axis).as_quat(scalar_first=True)
    profile = Profile.create(q * np.where(np.arange(12) % 3, 1, -1)[:, None], step=step)
    with jax.enable_x64(True):
        at, w = jax.vmap(lambda t: profile.frame(t, None))(step * np.arange(12.0))
    np.testing.assert_allclose(np.abs(np.sum(np.asarray(at) * q, axis=1)), 1, atol=1e-12)
    np.testing.assert_allclose(np.asarray(w)[5], np.array(axis) / (11 * step), atol=2e-3 / step)
    with jax.enable_x64(True):
        assert np.isnan(np.asarray(profile.frame(12 * step, None)[0])).all()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Inertial.create([2.0, 0, 0, 0]), "q = .* has length 2: divide it"),
        (lambda: Fixed.create([0, 0, 0]), "vector = .* no direction"),
        (lambda: Pointing.create([1, 1, 0], ToSun(), second_axis=Z, second_to=ToEarth()), "axis = .* length 1.41"),
        (lambda: Pointing.create(Z, ToSun(), second_axis=[0, 0, -1], second_to=ToEarth()), "second_axis .* parallel"),
        (lambda: ToTarget.create(latitude=48.0, longitude=0.0, epoch=EPOCH), "latitude"),
        (lambda: ToTarget.create(latitude=0.4, longitude=0.0, epoch=EPOCH - timedelta(40000)), "epoch"),
        (lambda: Profile.create(np.eye(4)[:3], step=1.0), "attitudes: got 3"),
        (lambda: Profile.create(np.eye(4), step=1.0), "attitudes 0 and 1 are more than 90 deg apart"),
        (lambda: Profile.create(np.tile([1.0, 0, 0, 0], (4, 1)), step=0.0), "step"),
        (lambda: Offset.create([0.0, 0, 0, 0], Nadir()), "turn = .* has length 0"),
    ],
)
def test_mistakes_are_named(make, told):
    with pytest.raises(ScenarioError, match=told):
        make()
