"""Pictures of systems, judged by the data of their lines against python-control."""

import control
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import synth
from synth import ModelError, bode, c2d, impulse, mixsyn, nichols, nyquist, pzmap, sigma, step, system
from synth.delivery.curves import loop_of

FREQUENCY = (bode, nichols, nyquist, sigma)
PICTURES = (*FREQUENCY, step, impulse, pzmap)
G = system([1], [1, 0.1, 1, 0])
TWO = system(
    ([[[1], [1]], [[2, 1], [1]]], [[[1, 1], [1, 0.2, 1]], [[1, 2, 1], [1, 3]]]), u=["tx", "ty"], y=["q1", "q2"]
)


@pytest.fixture(autouse=True)
def _closed():
    mpl.use("Agg")
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def design():
    return mixsyn(([200], [0.025, 1.0025, 10.1, 1]), ([0.667, 10], [1, 1e-3]), 1)


def test_bode_is_that_of_python_control():
    gain, phase = bode(G)
    omega, decibels = gain.lines[0].get_data()
    magnitude, angle, _ = control.frequency_response(G.to_control(), omega)
    np.testing.assert_allclose(decibels, 20 * np.log10(magnitude), atol=1e-6)
    np.testing.assert_allclose(phase.lines[0].get_ydata(), np.degrees(np.unwrap(angle)), atol=1e-6)
    assert (gain.get_ylabel(), phase.get_ylabel(), phase.get_xlabel()) == ("gain, dB", "phase, deg", "frequency, rad/s")
    assert set(np.diff(phase.get_yticks())) <= {15.0, 30.0, 45.0, 90.0}


def test_nyquist_is_the_response_and_its_mirror_image_about_minus_one():
    ax = nyquist(G, omega=np.geomspace(0.1, 10, 50))
    L = control.frequency_response(G.to_control(), np.geomspace(0.1, 10, 50)).complex
    upper, lower = ax.lines[0].get_xydata(), ax.lines[1].get_xydata()
    np.testing.assert_allclose(upper, np.transpose([L.real, L.imag]), atol=1e-12)
    np.testing.assert_allclose(lower, np.transpose([L.real, -L.imag]), atol=1e-12)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert left < -1 < right
    assert bottom < 0 < top


def test_nichols_is_bode_without_frequency():
    gain, phase = bode(G)
    ax = nichols(G)
    np.testing.assert_allclose(ax.lines[0].get_xdata(), phase.lines[0].get_ydata())
    np.testing.assert_allclose(ax.lines[0].get_ydata(), gain.lines[0].get_ydata())


def test_light_resonances_have_points_of_their_own():
    light = system([1], [1, 2e-5, 1])
    gain, _ = bode(light)
    assert max(gain.lines[0].get_ydata()) == pytest.approx(20 * np.log10(1 / 2e-5), abs=0.1)
    ax = nyquist(light)
    steps = np.abs(np.diff(np.unwrap(np.angle(ax.lines[0].get_xdata() + 1j * ax.lines[0].get_ydata()))))
    assert steps.max() < 0.2  # rad: no corners


@pytest.mark.parametrize("picture", FREQUENCY)
def test_discrete_curves_end_at_nyquist(picture):
    axes = np.ravel(picture(c2d(G, 0.5)))
    if picture in (bode, sigma):
        assert axes[0].lines[0].get_xdata()[-1] == pytest.approx(np.pi / 0.5)
        assert any("nyquist" in str(c.get_label()) for c in axes[0].collections)
    else:
        end = c2d(G, 0.5).frequency_response(np.pi / 0.5)[0, 0]
        last = axes[0].lines[0].get_xydata()[-1]
        found = last[0] + 1j * last[1] if picture is nyquist else 10 ** (last[1] / 20)
        assert abs(found) == pytest.approx(abs(end), rel=1e-6)


def test_step_and_impulse_are_those_of_the_responses():
    ax = step(G, time=8.0)
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), G.step_response(8.0).values[:, 0, 0])
    stairs = impulse(c2d(G, 0.5), time=8.0).lines[0]
    assert stairs.get_drawstyle() == "steps-post"
    assert len(stairs.get_xdata()) == 17


def test_poles_and_zeros():
    ax = pzmap(TWO)
    poles, zeros = ax.lines[0], ax.lines[1]
    np.testing.assert_allclose(np.sort(poles.get_xdata()), np.sort(TWO.poles().real))
    np.testing.assert_allclose(np.sort(zeros.get_xdata()), np.sort(TWO.zeros().real))
    assert any(line.get_gid() == "unit circle" for line in pzmap(c2d(TWO, 0.1)).lines)


@pytest.mark.parametrize("picture", PICTURES)
def test_lists_and_dicts_share_axes_and_have_labels(picture):
    named = picture({"first": G, "second": 0.5 * G})
    labels = [line.get_label() for line in np.ravel(named)[0].lines if not line.get_label().startswith("_")]
    assert labels == ["first", "second"]
    assert np.ravel(named)[0].get_legend() is not None
    listed = np.ravel(picture([G, 2 * G, 3 * G], label="G"))[0]
    assert [line.get_label() for line in listed.lines if line.get_label().startswith("G")] == ["G 0", "G 1", "G 2"]


@pytest.mark.parametrize("picture", PICTURES)
def test_many_channels_many_axes(picture):
    axes = np.asarray(picture(TWO))
    if picture not in (sigma, pzmap):
        assert axes.shape == ((4, 2) if picture is bode else (2, 2))
        titles = " ".join(ax.get_title() + ax.get_ylabel() for ax in axes.ravel())
        assert all(name in titles for name in ("tx", "ty", "q1", "q2"))


@pytest.mark.parametrize("picture", PICTURES)
def test_on_the_callers_axes_in_the_callers_style(picture):
    count = 2 if picture is bode else 1
    with mpl.rc_context({"lines.linewidth": 7.0}):
        fig, axes = plt.subplots(count)
        before = dict(mpl.rcParams)
        returned = picture(control.tf([1], [1, 1]), axes, color="red", label="lag")
        assert dict(mpl.rcParams) == before
    assert list(np.ravel(returned)) == list(np.ravel(axes))
    assert plt.get_fignums() == [fig.number]
    assert np.ravel(axes)[0].lines[0].get_color() == "red"
    with pytest.raises(ModelError, match="ax holds 3 axes; pass"):
        picture(G, plt.subplots(3)[1])


@pytest.mark.parametrize("picture", PICTURES)
def test_designs_show_their_loop_or_their_closed_loop(picture, design):
    expected = loop_of(design) if picture in (bode, nichols, nyquist) else design.closed_loop
    found, reference = np.ravel(picture(design)), np.ravel(picture(expected))
    np.testing.assert_allclose(found[0].lines[0].get_xydata(), reference[0].lines[0].get_xydata())


def test_the_loop_of_a_design_is_the_one_of_its_margins(design):
    G, K = system([200], [0.025, 1.0025, 10.1, 1]), design.controller
    np.testing.assert_allclose(
        loop_of(design).frequency_response([0.1, 3.0]), (G * K).frequency_response([0.1, 3.0]), rtol=1e-9
    )
    assert synth.margin(loop_of(design)).phase == pytest.approx(synth.margin(G * K).phase, rel=1e-6)


@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.parametrize("wrong", [None, "x", [], {}, [1, "x"], [G, TWO], control.frd([1, 2, 3], [1, 2, 3])])
def test_what_cannot_be_drawn_is_refused(picture, wrong):
    with pytest.raises(ModelError, match=r".{20}"):
        picture(wrong)


def test_bad_grids_are_refused():
    for grid in ("x", [1.0], [2.0, 1.0], [0.0, 1.0], [[1.0, 2.0]]):
        with pytest.raises(ModelError, match="omega"):
            bode(G, omega=grid)
    with pytest.raises(ModelError, match="time"):
        step(G, time=-1.0)
