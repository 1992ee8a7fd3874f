"""Figures of the reports, judged by the data of their lines."""

import numpy as np

from plants.outcome import figures


def test_histories_differ_by_more_than_colour():
    time = np.arange(3000.0)
    series = {name: (time, np.outer(time, [1.0, k])) for k, name in enumerate(("one", "two"), 1)}
    fig = figures.histories(series, ("a", "b"), until=100.0, scale="log")
    first, second = fig.axes
    for k, name in enumerate(series):
        line = second.lines[k]
        assert line.get_label() == name
        np.testing.assert_array_equal(line.get_data(), [time[:101], (k + 1) * time[:101]])
    assert len({line.get_linestyle() for line in second.lines}) == 2
    assert len({line.get_color() for line in second.lines}) == 2
    assert not second.lines[0].get_rasterized()
    assert figures.histories(series, ("a", "b")).axes[0].lines[0].get_rasterized()  # too many points for SVG
    assert (first.get_ylabel(), second.get_xlabel(), second.get_yscale()) == ("a", "time, s", "log")


def test_few_runs_are_seen_and_many_shade():
    def alpha(runs: int) -> float:
        time = np.arange(3.0)
        fig = figures.spread([(time, time[:, None])] * runs, ("x",), until=2.0)
        assert len(fig.axes[0].lines) == runs
        return fig.axes[0].lines[0].get_alpha()

    assert alpha(3) == 1.0
    assert alpha(40) == 0.4


def test_every_run_and_its_requirement_stand_in_levels():
    values = {"APE": np.array([[1.0, 2.0], [3.0, np.inf]])}
    (ax,) = figures.levels(["a", "b"], values, {"APE": 2.5}, "deg").axes
    *dots, bound = ax.lines
    np.testing.assert_array_equal([dot.get_ydata() for dot in dots], values["APE"])
    np.testing.assert_array_equal(bound.get_ydata(), [2.5, 2.5])
    assert [text.get_text() for text in ax.get_xticklabels()] == ["a", "b"]
    assert ax.get_title() == "APE, deg"


def test_bars_of_what_sums_are_made_of_end_at_a_hundred():
    panels = {axis: {"one": np.array([1.0, 3.0]), "none": np.zeros(2)} for axis in ("roll", "yaw")}
    first, second = figures.composition(panels, ["noise", "mean"]).axes
    assert (first.get_title(), second.get_title()) == ("roll", "yaw")
    noise, mean = first.containers
    assert [bar.get_width() for bar in noise] == [25.0, 0.0]
    assert [bar.get_x() + bar.get_width() for bar in mean] == [100.0, 0.0]
    assert (noise.get_label(), mean.get_label()) == ("noise", "mean")
