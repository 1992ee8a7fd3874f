"""Pictures of attitudes, judged by labels, units and the data of their lines; no flight is needed."""

import dataclasses
import warnings

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from attitude_runs import Recorded, attitude_run, turn

from plants.dynamics.satellite import SatelliteState
from plants.errors import ScenarioError
from plants.outcome.attitudeplots import attitude_plot, wheel_speed_plot


@pytest.fixture(autouse=True)
def _closed():
    mpl.use("Agg")
    yield
    plt.close("all")


def by_label(axes):
    return {ax.get_ylabel().replace("\n", " "): ax for ax in axes}


def data(ax):
    return {line.get_label(): line.get_ydata() for line in ax.lines}


def test_everything_is_in_the_units_that_it_is_labelled_with():
    run = attitude_run()
    axes = run.plot()
    assert axes[-1].get_xlabel() == "time, s"
    assert list(by_label(axes)) == [
        "pointing error, deg", "estimate error, deg", "inertial rate, deg/s", "commanded torque, mN m",
        "wheel torque, mN m", "wheel speed, rpm",
    ]  # fmt: skip  # two axes share the first label
    total, each = axes[:2]
    np.testing.assert_allclose(data(total)["angle"], 20 * np.exp(-run.time), rtol=1e-7)
    np.testing.assert_allclose(data(each)["yaw"], 20 * np.exp(-run.time), rtol=1e-7)
    np.testing.assert_allclose(data(each)["roll"], 0, atol=1e-12)
    shown = by_label(axes)
    np.testing.assert_allclose(data(shown["estimate error, deg"])["roll"], -0.1, rtol=1e-6)
    np.testing.assert_array_equal(data(shown["inertial rate, deg/s"])["y"], np.degrees(run.states.w[:, 1]))
    np.testing.assert_array_equal(data(shown["commanded torque, mN m"])["z"], 1e3 * run.commands[:, 2])
    np.testing.assert_array_equal(data(shown["wheel torque, mN m"])["motor 1"], 1e3 * run.inputs[:, 1])
    np.testing.assert_allclose(data(shown["wheel speed, rpm"])["wheel 2"], run.states.wheels[:, 2] * 30 / np.pi)
    assert shown["commanded torque, mN m"].lines[0].get_drawstyle() == "steps-post"


def test_levels_are_lines_in_the_units_of_their_axes():
    axes = attitude_run().plot(requirement=np.radians(0.1), speed_limit=200.0, torque_limit=2e-3)
    angle, each, *_, motors, wheels = axes
    assert data(angle)["requirement"][0] == pytest.approx(0.1)
    assert sorted(line.get_ydata()[0] for line in each.lines[3:]) == pytest.approx([-0.1, 0.1])
    assert [line.get_ydata()[0] for line in motors.lines[3:]] == pytest.approx([2.0, -2.0])
    assert [line.get_ydata()[0] for line in wheels.lines[3:]] == pytest.approx([200 * 30 / np.pi, -200 * 30 / np.pi])
    assert [angle.get_yscale(), each.get_yscale(), wheels.get_yscale()] == ["log", "symlog", "linear"]


def test_a_moment_without_an_error_does_not_rule_the_scale():
    run = attitude_run(400)
    error = np.c_[turn(np.where(np.arange(400) == 7, 1e-15, 0.01), [1, 0, 0]), np.zeros((400, 3))]
    ax = dataclasses.replace(run, extra={"error": error}).plot(requirement=1e-4)[0]
    low, high = ax.get_ylim()
    assert np.degrees(1e-5) < low < np.degrees(1e-4)
    assert np.degrees(0.01) < high < 10


def test_without_a_navigator_there_is_no_error_of_an_estimate():
    run = attitude_run()
    axes = dataclasses.replace(run, estimates=run.outputs).plot()
    assert "estimate error, deg" not in by_label(axes)


@pytest.mark.parametrize(
    ("wheels", "gimbals", "thrusters", "dipoles"),
    [(4, 0, 0, 3), (4, 0, 3, 3), (3, 0, 3, 0), (0, 4, 3, 0), (0, 0, 0, 3), (0, 0, 3, 3), (0, 0, 3, 0)],
)
def test_the_parts_of_the_input_of_a_satellite(wheels, gimbals, thrusters, dipoles):
    run = attitude_run(wheels=wheels)
    n = len(run.time)
    states = SatelliteState(*run.states, np.zeros((n, 0)), np.zeros((n, gimbals)))
    inputs = np.random.default_rng(0).standard_normal((n, wheels + gimbals + dipoles + thrusters))
    commands = np.c_[run.commands, np.ones((n, dipoles))]
    run = dataclasses.replace(run, states=states, inputs=inputs, commands=commands)
    shown = by_label(run.plot())
    at = 0
    for label, size, first, scale in (
        ("wheel torque, mN m", wheels, "motor 0", 1e3), ("gimbal rate, deg/s", gimbals, "gimbal 0", 180 / np.pi),
        ("acting dipole, A m²", dipoles, "x", 1.0), ("acting torque, mN m", thrusters, "x", 1e3),
    ):  # fmt: skip
        assert (label in shown) == (size > 0)
        if size:
            np.testing.assert_allclose(data(shown[label])[first], scale * inputs[:, at])
        at += size
    assert ("commanded dipole, A m²" in shown) == (dipoles > 0)


def test_the_torque_on_a_body_without_wheels():
    run = attitude_run(wheels=0)
    assert "acting torque, mN m" in by_label(run.plot())
    shown = by_label(dataclasses.replace(run, commands=np.ones((len(run.time), 6))).plot())  # its actuator has a field
    assert "acting torque, mN m" in shown
    assert "acting dipole, A m²" not in shown


def test_modes_colour_the_background_and_count_from_their_frame():
    n = 40
    mode = np.repeat([0, 2, 1, 2], 10)
    error = np.c_[turn(np.full(n, np.radians(3.0)), [1, 0, 0]), np.zeros((n, 3))]
    run = attitude_run(n, extra=Recorded(mode, error))
    axes = run.plot(modes=("detumbling", "slew", "nadir"))
    assert [t.get_text() for t in axes[0].get_legend().get_texts()] == ["detumbling", "nadir", "slew"]
    for ax in axes:
        starts = [patch.get_x() for patch in ax.patches]
        assert starts == run.time[::10].tolist()
        assert [p.get_x() + p.get_width() for p in ax.patches] == pytest.approx([*starts[1:], run.time[-1]])
    np.testing.assert_allclose(data(axes[0])["angle"], 3.0)
    np.testing.assert_allclose(data(axes[1])["roll"], 3.0)
    as_dict = dataclasses.replace(run, extra={"mode": mode.astype(float)}).plot()
    assert [t.get_text() for t in as_dict[0].get_legend().get_texts()] == ["mode 0", "mode 2", "mode 1"]


def test_chosen_panels_on_the_callers_axes():
    fig, axes = plt.subplots(2)
    assert list(attitude_run().plot(axes, panels=["wheels", "angle"])) == list(axes)
    assert plt.get_fignums() == [fig.number]
    assert list(by_label(axes)) == ["wheel speed, rpm", "pointing error, deg"]


@pytest.mark.parametrize("n", [0, 1, 2])
def test_short_and_failed_runs(n):
    run = attitude_run(n, ok=False, failed_at=1.0, culprit="plant")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        axes = run.plot(requirement=1e-3)
        axes[0].figure.canvas.draw()
    assert axes[0].get_title() == "failed at 1 s: plant"


@pytest.mark.parametrize("size", [(5, 4), (8, 12), (14, 6)])
def test_no_writing_overlaps_at_any_size(size):
    mode = np.repeat([0, 1], 20)
    run = attitude_run(extra={"mode": mode})
    fig, axes = plt.subplots(3, 1, figsize=size, layout="constrained")
    run.plot(axes, panels=["axes", "rate", "wheels"], requirement=0.001, speed_limit=1e3)
    fig.canvas.draw()
    page = fig.bbox
    boxes = [t.get_window_extent() for ax in axes for leg in ax.findobj(mpl.legend.Legend) for t in leg.get_texts()]
    labels = [ax.yaxis.label.get_window_extent() for ax in axes]
    ticks = [t.get_window_extent() for ax in axes for t in ax.get_yticklabels() if t.get_text() and inside(ax, t)]
    for k, box in enumerate([*boxes, *labels, *ticks]):
        assert page.x0 <= box.x0 <= box.x1 <= page.x1
        assert not [other for other in [*boxes, *labels, *ticks][k + 1 :] if box.shrunk(0.9, 0.9).overlaps(other)]


def inside(ax, tick):
    low, high = sorted(ax.get_ylim())
    return low <= tick.get_position()[1] <= high


def test_other_plants_keep_generic_names():
    run = attitude_run(states=None)
    assert [ax.get_ylabel() for ax in run.plot()] == [*(f"y{i}" for i in range(6)), "u0", "u1", "u2"]
    with pytest.raises(ScenarioError, match="requirement is no option for a run without an attitude"):
        run.plot(requirement=0.1)


def test_wheel_speeds_alone():
    run = attitude_run()
    ax = wheel_speed_plot(run, limit=100.0)
    assert (ax.get_ylabel(), ax.get_xlabel()) == ("wheel speed,\nrpm", "time, s")
    assert data(ax)["limit"][0] == pytest.approx(100 * 30 / np.pi)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"requirement": -0.1}, "requirement must be positive"),
        ({"requirement": np.nan}, "requirement must be finite"),
        ({"requirement": [0.1, 0.2]}, "requirement must have shape"),
        ({"speed_limit": 0}, "speed_limit must be positive"),
        ({"torque_limit": "2 mN m"}, "torque_limit must be real"),
        ({"panels": ["dipole"]}, "no 'dipole'; it has angle, axes"),
        ({"panels": []}, "nothing to show"),
        ({"modes": ("a",)}, "no field mode"),
        ({"outputs": [0]}, "outputs is no option for a run with an attitude; there are panels"),
    ],
)
def test_what_a_run_has_not_is_refused(options, message):
    with pytest.raises(ScenarioError, match=message):
        attitude_run().plot(**options)


def test_runs_that_do_not_fit_are_refused():
    run = attitude_run()
    with pytest.raises(ScenarioError, match="no attitude: its states are without names"):
        attitude_plot(dataclasses.replace(run, states=None))
    with pytest.raises(ScenarioError, match="the run has no wheels"):
        wheel_speed_plot(attitude_run(wheels=0))
    with pytest.raises(ScenarioError, match="was in mode 1, give a name"):
        attitude_plot(attitude_run(extra={"mode": np.repeat([0, 1], 20)}), modes=("a",))
    with pytest.raises(ScenarioError, match="no index for each of 40"):
        attitude_plot(attitude_run(extra={"mode": np.zeros((40, 2))}))
