"""Pictures of runs and campaigns, judged by the data of their lines; no flight is needed."""

import dataclasses
from typing import NamedTuple

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

from plants.errors import ScenarioError
from plants.outcome.plots import campaign_plot, run_plot
from plants.simulation.campaign import Campaign
from plants.simulation.loop import Run


class Outcome(NamedTuple):
    angle: np.ndarray  # (n, 2) rad
    time: np.ndarray  # (n,) s
    settled: np.ndarray  # (n,) bool


@pytest.fixture(autouse=True)
def _closed():
    mpl.use("Agg")
    yield
    plt.close("all")


@pytest.fixture
def run():
    time = np.arange(5.0)
    outputs, commands = np.outer(time, [1.0, -2.0]), np.cos(time)[:, None]
    return Run(
        duration=5.0, time=time, states=None, outputs=outputs, estimates=outputs, references=outputs + 1,
        commands=commands, inputs=commands, extra=None, ok=True, failed_at=None, culprit="", compiled=True,
    )  # fmt: skip


@pytest.fixture
def campaign():
    n = 4
    results = Outcome(
        np.array([[3.0, 1], [1, 2], [2, 3], [np.inf, 4]]), np.array([30.0, 10, 20, np.inf]), np.arange(n) < 3
    )
    return Campaign(
        index=np.arange(n), ok=results.settled, failed_at=np.full(n, np.nan), culprit=np.full(n, ""), results=results,
        dispersed=None, applied=None, varied=(), kept={}, complete=True,
    )  # fmt: skip


def test_outputs_reference_and_commands_of_a_run(run):
    axes = run_plot(run)
    assert [ax.get_ylabel() for ax in axes] == ["y0", "y1", "u0"]
    assert axes[-1].get_xlabel() == "time, s"
    for i in range(2):
        output, reference = axes[i].lines
        np.testing.assert_array_equal(output.get_data(), [run.time, run.outputs[:, i]])
        np.testing.assert_array_equal(reference.get_ydata(), run.references[:, i])
        assert (reference.get_linestyle(), reference.get_color()) == ("--", output.get_color())
    np.testing.assert_array_equal(axes[2].lines[0].get_ydata(), run.commands[:, 0])
    assert axes[2].lines[0].get_drawstyle() == "steps-post"
    assert [t.get_text() for t in axes[0].get_legend().get_texts()] == ["output", "reference"]


def test_chosen_columns_on_the_callers_axes_in_the_callers_style(run):
    with mpl.rc_context({"lines.linewidth": 7.0}):
        fig, axes = plt.subplots(2)
        before = dict(mpl.rcParams)
        returned = run_plot(run, axes, outputs=[1], commands=[0], names=("q, 1", "T, N m"), label="PD")
        assert dict(mpl.rcParams) == before
    assert list(returned) == list(axes)
    assert plt.get_fignums() == [fig.number]
    assert axes[0].lines[0].get_linewidth() == 7.0
    assert axes[0].lines[0].get_label() == "PD"
    np.testing.assert_array_equal(axes[0].lines[0].get_ydata(), run.outputs[:, 1])
    assert axes[1].get_ylabel() == "T, N m"


def test_outputs_alone(run):
    (ax,) = run_plot(run, outputs=[0], commands=[])
    assert ax.get_legend() is not None


def test_a_failed_run_says_so(run):
    failed = dataclasses.replace(run, ok=False, failed_at=2.5, culprit="controller")
    assert run_plot(failed)[0].get_title() == "failed at 2.5 s: controller"
    assert run_plot(run)[0].get_title() == ""


def test_distributions_count_failed_runs(campaign):
    axes = dict(zip(("angle", "time", "settled"), campaign_plot(campaign), strict=True))
    assert [ax.get_title() for ax in axes.values()] == ["angle", "time", "settled"]
    (line,) = axes["time"].lines
    np.testing.assert_array_equal(line.get_xdata(), [10, 10, 20, 30])
    np.testing.assert_array_equal(line.get_ydata(), [0, 0.25, 0.5, 0.75])  # the failed run never arrives
    assert [line.get_ydata()[-1] for line in axes["angle"].lines] == [0.75, 1.0]
    assert [bar.get_height() for bar in axes["settled"].patches] == [0.75]


def test_campaigns_share_axes(campaign):
    _, ax = plt.subplots()
    for name in ("one", "two"):
        assert list(campaign_plot(campaign, ax, results=["time"], label=name)) == [ax]
    assert [line.get_label() for line in ax.lines] == ["one", "two"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"outputs": [2]}, "columns 0 to 1"),
        ({"commands": [-1]}, "columns 0 to 0"),
        ({"names": ("a",)}, "give 3"),
        ({"outputs": [], "commands": []}, "at least one"),
    ],
)
def test_what_a_run_has_not_is_refused(run, options, message):
    with pytest.raises(ScenarioError, match=message):
        run_plot(run, **options)


def test_what_a_campaign_has_not_is_refused(campaign):
    with pytest.raises(ScenarioError, match="no 'ape'; it has angle, time, settled"):
        campaign_plot(campaign, results=["ape"])
    with pytest.raises(ScenarioError, match="holds 1 axes: 3"):
        campaign_plot(campaign, plt.subplots()[1])
