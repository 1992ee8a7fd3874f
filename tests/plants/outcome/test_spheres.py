"""Where body axes point and satellites pass, judged by the data shown."""

from datetime import datetime

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from attitude_runs import Body, attitude_run, turn
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.outcome.spheres import attitude_sphere, body_axis, ground_track_plot
from plants.surroundings.ground import ground_track

EPOCH = datetime(2026, 3, 20, 12)


@pytest.fixture(autouse=True)
def _closed():
    mpl.use("Agg")
    yield
    plt.close("all")


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_a_body_axis_is_where_the_active_rotation_takes_it(seed):
    rng = np.random.default_rng(seed)
    q = rng.standard_normal((7, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    run = attitude_run(7, states=Body(q, np.zeros((7, 3)), np.zeros((7, 0))))
    expected = Rotation.from_quat(q, scalar_first=True).apply(axis)
    np.testing.assert_allclose(body_axis(run, axis), expected, atol=1e-14)
    outputs = np.c_[np.sign(q[:, :1]) * q[:, 1:], np.zeros((7, 3))]
    run = attitude_run(7, outputs=outputs)
    np.testing.assert_allclose(body_axis(run, axis, "O"), expected, atol=6e-8)  # 2 sqrt(1 - |v|^2) within 4 eps


def test_map_and_sphere_show_the_same_directions():
    run = attitude_run()
    chart, ball = run.sphere_plot([1.0, 0, 0])
    assert (chart.name, ball.name) == ("mollweide", "3d")
    azimuth, elevation = chart.collections[0].get_offsets().T
    np.testing.assert_allclose(np.degrees(azimuth), 20 * np.exp(-run.time), rtol=1e-7)  # turned about z
    np.testing.assert_allclose(elevation, 0, atol=1e-12)
    np.testing.assert_array_equal(chart.collections[0].get_array(), run.time)
    assert "body axis +x in inertial frame N" in chart.get_title()


def test_a_line_is_broken_where_it_leaves_the_map():
    angle = np.radians(np.linspace(90, 270, 40))
    q = np.c_[np.cos(angle / 2), turn(angle, [0, 0, 1])]
    chart, _ = attitude_sphere(attitude_run(states=Body(q, np.zeros((40, 3)), np.zeros((40, 0)))), [1.0, 0, 0])
    azimuth = chart.lines[0].get_xdata()
    assert np.isnan(azimuth).sum() == 1
    assert np.nanmax(np.abs(np.diff(azimuth))) < np.radians(10)


def test_axes_of_the_caller():
    fig = plt.figure()
    axes = [fig.add_subplot(1, 2, 1, projection="mollweide"), fig.add_subplot(1, 2, 2, projection="3d")]
    assert list(attitude_sphere(attitude_run(), (0, 0, 1.0), ax=axes)) == axes
    with pytest.raises(ScenarioError, match="projections"):
        attitude_sphere(attitude_run(), (0, 0, 1.0), ax=plt.subplots(1, 2)[1])


@pytest.mark.parametrize(
    ("axis", "frame", "message"),
    [
        ((0, 0, 2.0), "N", "has length 2: give a direction of length 1"),
        ((0, 0), "N", "axis must have shape"),
        ((0, 0, np.nan), "N", "axis must be finite"),
        ("z", "N", "axis must be real"),
        ((0, 0, 1.0), "B", "give one of 'N', 'O'"),
    ],
)
def test_wrong_axes_are_refused(axis, frame, message):
    with pytest.raises(ScenarioError, match=message):
        attitude_sphere(attitude_run(), axis, frame=frame)


def test_runs_without_attitude_or_samples_are_refused():
    with pytest.raises(ScenarioError, match="no attitude"):
        attitude_run(states=None).sphere_plot((0, 0, 1.0))
    with pytest.raises(ScenarioError, match=r"no samples to show: it failed at 0.5 s \(sensors\)"):
        attitude_run(0, ok=False, failed_at=0.5, culprit="sensors").sphere_plot((0, 0, 1.0))


def test_a_ground_track_is_in_degrees_and_broken_at_the_date_line():
    times = 20.0 * np.arange(600)
    u = 2 * np.pi * times / 5677
    r = 6878e3 * np.stack([np.cos(u), np.sin(u) * 0.6, np.sin(u) * 0.8], axis=-1)
    ax = ground_track_plot(r, EPOCH, times)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("longitude, deg", "latitude, deg")
    longitude, latitude = ax.lines[0].get_data()
    there = ~np.isnan(longitude)
    track = ground_track(r, EPOCH, times)
    np.testing.assert_allclose(longitude[there], np.degrees(track.longitude))
    np.testing.assert_allclose(latitude[there], np.degrees(track.latitude))
    assert (~there).sum() == np.sum(np.abs(np.diff(track.longitude)) > np.pi) > 0
    assert len(ground_track_plot(np.repeat(r, 10, axis=0), EPOCH, np.arange(6000.0)).lines[0].get_xdata()) < 2100


def test_wrong_orbits_are_refused():
    with pytest.raises(ScenarioError, match="orbit must have shape"):
        ground_track_plot(np.zeros((3, 3)), EPOCH, np.arange(4.0))
    with pytest.raises(ScenarioError, match="times are empty"):
        ground_track_plot(np.zeros((0, 3)), EPOCH, [])
