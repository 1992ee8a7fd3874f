"""Pictures of systems, judged by the data of their lines against python-control."""

import control
import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import synth
from synth import ModelError, bode, c2d, impulse, mixsyn, nichols, nyquist, pzmap, sigma, step, system
from synth.delivery.curves import closing, frequencies, loop_of, responses

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


def test_undamped_structures_have_the_phase_of_their_damped_neighbours():
    panels = system([1, 0, 1], [1, 0, 4, 0, 0])  # rigid body with a panel: zeros at j, poles at 2 j
    omega, phase = bode(panels)[1].lines[0].get_data()
    for low, high, level in ((0.1, 0.99, -180), (1.01, 1.99, 0), (2.01, 20, -180)):
        np.testing.assert_allclose(phase[(omega > low) & (omega < high)], level, atol=1e-3)
    for discrete in (c2d(system([1], [1, 0, 4]), 0.1), system([1], [1, 1], dt=0.1)):  # the second has a pole at z = -1
        gains = sigma(discrete).lines[0].get_ydata()
        assert np.isfinite(gains).all()
        assert max(gains) > 1e3


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize(
    ("num", "den"),
    [
        ([1], [1, 1, 0]),  # one integrator
        ([10], [1, 0.4, 1, 0]),  # unstable when closed
        ([2, 1], [0.1, 1, 0, 0]),  # two integrators
        ([1], [1, 1, 0, 0]),
        ([1, 0.5], [1, 0.1, 4, 0.4, 0]),
        ([0.3, 1], [1, 0, 4]),  # undamped
        ([3], [1, -1]),  # unstable plant
    ],
)
def test_turns_round_minus_one_count_unstable_closed_loop_poles(num, den, dt):
    L = system(num, den) if not dt else c2d(system(num, den), dt)
    ((_, _, grid, response),) = responses([(None, L)], None)
    half = 1 + np.append(closing(L, grid[0])[:, 0, 0], response[:, 0, 0])  # the other half is its mirror image
    turns = np.unwrap(np.angle(half))
    closed = synth.feedback(L, 1).poles()
    outside, boundary = (np.abs, 1.0) if dt else (np.real, 0.0)
    unstable = [np.sum(outside(poles) > boundary + 1e-6) for poles in (closed, L.poles())]
    assert (turns[0] - turns[-1]) / np.pi == pytest.approx(unstable[0] - unstable[1], abs=0.05)


def test_curves_that_go_far_close_on_a_circle():
    ax = nyquist({"integrator": system([1], [1, 1, 0]), "lag": system([5], [1, 1])})
    far = np.array(ax.lines[4].get_xydata())
    angles = np.degrees(np.angle(far[:, 0] + 1j * far[:, 1]))
    sound = np.isfinite(angles)
    np.testing.assert_allclose(np.hypot(*far[sound].T), 3.0)
    assert angles[sound].max() == pytest.approx(0, abs=1e-9)  # from the real axis
    assert angles[sound].min() < -90  # to the curve
    assert np.isfinite(ax.lines[5].get_xdata()).any()  # the lag, beside it, closes too
    assert len(nyquist(system([5], [1, 1])).lines) == 4  # alone it is shown whole: two halves, the unit circle, -1


def test_the_range_of_frequencies_does_not_depend_on_coordinates():
    G = system([1], [1, 1, 0, 0])
    T = np.random.default_rng(3).normal(size=(3, 3))
    np.testing.assert_allclose(frequencies(G.transform(T)), frequencies(G), rtol=1e-6)


def test_each_sampling_time_ends_at_its_own_nyquist_frequency():
    lag = system([1], [1, 1])
    gain, _ = bode({"continuous": lag, "fast": c2d(lag, 0.1), "slow": c2d(lag, 1.0)})
    ends = [line.get_xdata()[-1] for line in gain.lines]
    np.testing.assert_allclose(ends, [100.0, np.pi / 0.1, np.pi], rtol=1e-9)


def test_notches_and_ends_have_no_corners():
    for discrete in (c2d(system([1], [1, 0.4, 1]), 0.5), c2d(system([1, 2e-3, 1], [1, 2, 1]), 0.1)):
        phase = bode(discrete)[1].lines[0].get_ydata()
        assert np.abs(np.diff(phase)).max() < 15


def test_a_given_grid_on_a_pole_leaves_a_gap():
    undamped = system([[0, 1], [-1, 0]], [0, 1], [1, 0], 0)
    for picture in FREQUENCY:
        line = np.ravel(picture(undamped, omega=[0.5, 1.0, 2.0]))[0].lines[0]
        assert np.isnan(line.get_ydata()).tolist() == [False, True, False]
    with pytest.raises(ModelError, match=r"beyond the Nyquist frequency .* up to 31\.4"):
        bode(c2d(G, 0.1), omega=[100.0, 200.0])


@pytest.mark.parametrize("level", [-12, -3, 1, 6])
def test_lines_of_the_nichols_picture_are_levels_of_the_closed_loop(level):
    ax = nichols(system([1], [1, 1]))
    found = []
    for line in ax.lines:
        if line.get_gid() == "closed loop":
            phase, gain = line.get_data()
            L = 10 ** (gain / 20) * np.exp(1j * np.radians(phase))
            levels = 20 * np.log10(np.abs(L / (1 + L)))
            assert np.ptp(levels) < 1e-9
            found.append(levels.mean())
    assert min(abs(np.array(found) - level)) < 1e-9
    count = len(ax.texts)
    nichols(system([1], [1, 3, 3, 1, 0, 0]), ax)  # goes to -450 degrees
    assert ax.get_xlim()[0] < -390
    assert len(ax.texts) == count


def test_slow_modes_that_are_hardly_seen_do_not_stretch_time(design):
    loop, controller = (np.ravel(step(each))[0].lines[0].get_xdata() for each in (design, design.controller))
    assert loop[-1] < 5.0  # s: the loop answers in tenths, though the weight forgets in a thousand
    np.testing.assert_array_equal(controller, design.controller.step_response().time)  # here the slow mode is seen
    fast = system(([1], [0.01, 1])) + 1e-4 * system(([1], [100, 1]))
    line = step(fast).lines[0]
    assert 0.05 < line.get_xdata()[-1] < 0.3
    assert line.get_ydata()[-1] == pytest.approx(1.0, abs=0.01)


def test_rounding_does_not_make_the_scale_of_a_pole_map():
    ax = pzmap(system([1, 0, 1], [1, 0, 4, 0, 0]))
    assert ax.get_xlim()[0] < -0.2
    assert ax.get_xlim()[1] > 0.2
    with pytest.raises(ModelError, match="different planes"):
        pzmap([G, c2d(G, 0.1)])


@pytest.mark.parametrize("picture", PICTURES)
def test_styles_by_their_short_and_long_names(picture):
    for style in ({"c": "red", "lw": 3}, {"color": "red", "linewidth": 3}):
        line = np.ravel(picture(TWO, **style))[-1].lines[0]
        assert (line.get_color(), line.get_linewidth()) == ("red", 3)
    line = np.ravel(picture(G, linestyle="-.", marker="s"))[0].lines[0]
    assert (line.get_linestyle(), line.get_marker()) == ("-.", "s")


@pytest.mark.parametrize("picture", PICTURES)
def test_tuples_of_systems_and_of_matrices(picture, design):
    several = np.ravel(picture((G, control.tf([1], [1, 1])), label="G"))[0]
    assert [line.get_label() for line in several.lines if line.get_label().startswith("G")] == ["G 0", "G 1"]
    one, reference = np.ravel(picture(([1], [1, 1])))[0], np.ravel(picture(system([1], [1, 1])))[0]
    np.testing.assert_array_equal(one.lines[0].get_xydata(), reference.lines[0].get_xydata())
    with pytest.raises(ModelError, match="ax is 5; pass"):
        picture(G, 5)
