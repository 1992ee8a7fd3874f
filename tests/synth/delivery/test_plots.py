"""Pictures of a design, judged by the data of their lines."""

import html
from dataclasses import replace

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

from synth import GeneralizedPlant, StateSpace, c2d, hinfsyn, ncfsyn, sigma
from synth.delivery.curves import frequencies
from synth.errors import ModelError


@pytest.fixture(scope="module")
def design():
    double_integrator = StateSpace([[0, 1], [0, 0]], [[0], [1]], np.eye(2), np.zeros((2, 1)))
    return hinfsyn(
        GeneralizedPlant.tracking(
            c2d(double_integrator, 0.1),
            Wproc=[[0.1]],
            Wdist=0.01 * np.eye(2),
            Werr=np.diag([1.0, 0.1]),
            Wact=[[0.5]],
            Wr=0.1 * np.eye(2),
        )
    )


@pytest.fixture(autouse=True)
def _closed():
    mpl.use("Agg")
    yield
    plt.close("all")


def test_a_first_order_lag_has_its_gain():
    ax = sigma(StateSpace([[-2.0]], [[1.0]], [[2.0]], [[0.0]]), label="lag")
    (line,) = ax.lines
    omega, gain = line.get_data()
    np.testing.assert_allclose(gain, 2 / np.hypot(2, omega), rtol=1e-12)
    assert omega[0] < 0.1 < 20 < omega[-1]
    assert line.get_label() == "lag"
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")


def test_discrete_curves_end_at_nyquist(design):
    assert frequencies(design.closed_loop, design.controller)[-1] == pytest.approx(np.pi / 0.1)


def test_systems_without_poles_are_flat():
    ax = sigma(StateSpace(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[3.0]]))
    assert set(ax.lines[0].get_ydata()) == {3.0}


def test_closed_loop_touches_the_verified_norm_and_stays_below_it(design):
    loop, controller = design.plot()
    curves = [line for line in loop.lines if len(line.get_xdata()) > 2]
    levels = {line.get_label().split(" 0")[0]: line.get_ydata()[0] for line in loop.lines if line not in curves}
    assert levels == {"optimum": design.info.optimum, "verified norm": design.gamma}
    assert len(curves) == min(design.closed_loop.nu, design.closed_loop.ny)
    peak = max(line.get_ydata().max() for line in curves)
    assert peak <= design.verified_norm
    assert peak == pytest.approx(design.verified_norm, rel=1e-6)
    omega = controller.lines[0].get_xdata()
    gains = np.array([line.get_ydata() for line in controller.lines])
    middle = len(omega) // 2
    expected = np.linalg.svd(design.controller.frequency_response(omega[middle]), compute_uv=False)
    np.testing.assert_allclose(gains[:, middle], expected)
    assert controller.get_xlabel() == "frequency, rad/s"


def test_a_loop_shaping_design_in_continuous_time():
    shaped = ncfsyn(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]))
    loop, controller = shaped.plot()
    curves = [line.get_ydata() for line in loop.lines if len(line.get_xdata()) > 2]
    assert np.max(curves) == pytest.approx(shaped.verified_norm, rel=1e-6)
    assert np.max(curves) <= shaped.verified_norm
    omega = controller.lines[0].get_xdata()
    assert (np.diff(omega) > 0).all()


def test_a_peak_at_infinity_does_not_stretch_the_picture():
    shaped = ncfsyn(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]))
    assert shaped.facts["peak at"].endswith(" rad/s")
    flat = replace(shaped, info=replace(shaped.info, frequency=1e16))  # what the judge says of a peak of D
    assert flat.facts["peak at"] == "infinity"
    assert flat.plot()[0].lines[0].get_xdata()[-1] < 1e6


def test_the_callers_axes_and_style_are_used(design):
    with mpl.rc_context({"lines.linewidth": 7.0, "axes.facecolor": "yellow"}):
        fig, axes = plt.subplots(2, 1)
        before = dict(mpl.rcParams)
        returned = design.plot(axes, label="first")
        design.plot(axes, label="second", alpha=0.5)
        assert dict(mpl.rcParams) == before
    assert list(returned) == list(axes)
    assert plt.get_fignums() == [fig.number]
    assert axes[0].lines[0].get_linewidth() == 7.0
    assert axes[0].get_facecolor() == mpl.colors.to_rgba("yellow")
    colours = {line.get_label(): line.get_color() for line in axes[1].lines}
    assert colours["first"] != colours["second"]
    assert [text.get_text() for text in axes[1].get_legend().get_texts()] == ["first", "second"]


def test_one_axes_is_refused(design):
    with pytest.raises(ModelError, match="pass two"):
        design.plot(plt.subplots()[1])


def test_facts_in_a_notebook(design):
    page = design._repr_html_()
    assert design.facts["verified norm"] == f"{design.verified_norm:.7g}"
    assert design.facts["sampling time"] == "0.1 s"
    assert design.facts["plant sha256"] == design.plant.system.digest()[:16]
    for name, value in design.facts.items():
        assert f"<th>{name}</th><td>{html.escape(value)}</td>" in page
