"""Mixed sensitivity: textbook levels, an outside solver, the shift of the axis and what it guarantees."""

import control
import numpy as np
import pytest

import synth
from synth import AssumptionError, GeneralizedPlant, ModelError, StateSpace, hinfnorm, hinfsyn
from synth.synthesis.mixedsensitivity import augw, mixsyn, shifted
from synth.systems.connect import feedback
from synth.systems.sampled import c2d

N = 0.004375  # rad/min, of the geostationary orbit as the thesis has it


def tf(num, den):
    """A scalar transfer function as a StateSpace."""
    return StateSpace.of(control.ss(control.tf(num, den)))


def performance(M, wB, A):
    """(s/M + wB) / (s + wB A). Skogestad and Postlethwaite (2005), equation (2.105)."""
    return tf([1 / M, wB], [1, wB * A])


def geostationary():
    """Clohessy-Wiltshire motion in km and minutes, force per mass in, position out (the thesis, section 3)."""
    A = np.zeros((6, 6))
    A[0, 1] = A[2, 3] = A[4, 5] = 1
    A[1, 0], A[1, 3], A[3, 1], A[5, 4] = 3 * N**2, 2 * N, -2 * N, -(N**2)
    return StateSpace(A, np.eye(6)[:, 1::2], np.eye(6)[::2], np.zeros((3, 3)))


THESIS = {"W1": performance(2, 1, 0.03), "W2": 1.5, "W3": tf([1 / 20, 0.3], [1 / 40, 1])}  # its weights 6.4 to 6.6


@pytest.fixture(scope="module")
def thesis():
    return mixsyn(geostationary(), **THESIS, shift=0.1)


def test_disturbance_process_of_the_textbook():
    """Skogestad and Postlethwaite, example 2.17, first design: gamma 1.37."""
    G = tf([200], np.polymul([10, 1], np.polymul([0.05, 1], [0.05, 1])))
    design = mixsyn(G, performance(1.5, 10, 1e-4), 1.0)
    assert design.gamma == pytest.approx(1.37, abs=5e-3)
    assert design.verified_norm <= 1.01 * design.gamma


@pytest.mark.parametrize(("bandwidths", "gamma"), [((0.25, 0.25), 2.80), ((0.25, 25), 2.92)])
def test_right_half_plane_zero_of_the_textbook(bandwidths, gamma):
    """Skogestad and Postlethwaite, section 3.6, designs 1 and 2 for the plant with a zero at 0.5."""
    filtered = np.kron(np.eye(2), [[0, 1], [-5, -6]])  # each input through 1 / ((0.2 s + 1)(s + 1)), and its rate
    C = [[1, 0, 1, 0], [1, 2, 2, 0]]
    G = StateSpace(filtered, np.kron(np.eye(2), [[0], [5]]), np.array(C), np.zeros((2, 2)))
    W = [performance(1.5, wB, 1e-4) for wB in bandwidths]
    W1 = StateSpace(*(np.diag([getattr(w, M).item() for w in W]) for M in "ABCD"))
    assert mixsyn(G, W1, 1.0).gamma == pytest.approx(gamma, abs=6e-3)


def test_thesis_weights_with_a_shift(thesis):
    """Weights 6.4 to 6.6 and e = 0.1 rad/min: gamma 2.207."""
    assert thesis.info.optimum == pytest.approx(2.207, abs=5e-4)
    assert thesis.info.shift == 0.1
    assert thesis.info.shifted_norm == pytest.approx(thesis.info.optimum, rel=1e-3)


def test_what_the_shift_guarantees(thesis):
    """Poles left of -e, and the level with the weights W(s + e); with W(s) a norm that was measured."""
    G, e = geostationary(), 0.1
    assert feedback(G, thesis.controller).poles().real.max() < -e * (1 - 1e-6)
    earlier = {name: W if name == "W2" else shifted(W, -e) for name, W in THESIS.items()}
    assert hinfnorm(augw(G, **earlier).close(thesis.controller))[0] <= thesis.info.shifted_norm * (1 + 1e-7)
    assert thesis.verified_norm == pytest.approx(hinfnorm(augw(G, **THESIS).close(thesis.controller))[0], rel=1e-6)


def test_the_shifted_design_is_saved_and_read(thesis, tmp_path):
    again = synth.Design.load(thesis.save(tmp_path / "design.json"))
    assert (again.info.shift, again.info.shifted_norm) == (0.1, thesis.info.shifted_norm)
    assert again.facts["shift of the axis"] == "0.1 rad/s"


def test_poles_on_the_axis_are_refused_by_name():
    with pytest.raises(AssumptionError, match=r"P21.*shift=") as caught:
        mixsyn(geostationary(), **THESIS)
    assert caught.value.assumption == "P21 of full row rank on the stability boundary"
    assert len(caught.value.modes) == 6
    G = StateSpace([[-0.1]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(AssumptionError, match=r"shift = 0\.1.*another"):
        mixsyn(G, 1.0, 1.0, shift=0.1)


def test_shift_of_a_discrete_plant():
    """A sampled double integrator: the poles lie within exp(-e dt)."""
    G = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1.0]], [[1, 0]], [[0]]), 0.1)
    with pytest.raises(AssumptionError, match="shift="):
        mixsyn(G, 0.5, 0.1)
    design = mixsyn(G, 0.5, 0.1, shift=0.2)
    assert np.abs(feedback(G, design.controller).poles()).max() < np.exp(-0.02) * (1 + 1e-7)
    assert design.verified_norm <= design.info.shifted_norm * (1 + 1e-6)  # constant weights do not see the shift


def test_slow_poles_are_not_on_the_boundary():
    """A drift of a thousand seconds beside an actuator of a tenth of a millisecond is no integrator."""
    G = StateSpace(np.diag([-1e-3, -1e4]), [[1.0], [1.0]], [[1e-3, 5e3]], [[0.0]])
    design = mixsyn(G, performance(2, 0.5, 0.01), 1.0)
    assert design.verified_norm <= 1.01 * design.gamma


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_a_triple_integrator_is_on_the_boundary_in_any_coordinates(dt):
    T = np.random.default_rng(1).standard_normal((3, 3))
    G = StateSpace(np.diag([1.0, 1.0], 1), np.eye(3)[:, 2:], np.eye(3)[:1], np.zeros((1, 1))).transform(T)
    with pytest.raises(AssumptionError, match="poles on the stability boundary"):
        mixsyn(c2d(G, dt) if dt else G, 0.5, 1.0)


def test_channels_are_the_closed_loop_functions():
    """z = [W1 S; W2 K S; W3 T] at a frequency, for a plant that is not square."""
    rng = np.random.default_rng(3)
    G = StateSpace(-np.eye(3) - 0.3 * rng.random((3, 3)), rng.random((3, 2)), rng.random((3, 3)), rng.random((3, 2)))
    K = StateSpace(-2 * np.eye(1), rng.random((1, 3)), rng.random((2, 1)), 0.1 * rng.random((2, 3)))
    W1, W2, W3 = performance(2, 1, 0.1), rng.random((1, 2)), tf([1, 0.1], [0.01, 1])
    w = 0.7
    g, k = G.frequency_response(w), K.frequency_response(w)
    S = np.linalg.inv(np.eye(3) + g @ k)
    expected = np.vstack([W1.frequency_response(w) * S, W2 @ k @ S, W3.frequency_response(w) * (g @ k @ S)])
    np.testing.assert_allclose(augw(G, W1, W2, W3).close(K).frequency_response(w), expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(3, 2), (2, 3)])
@pytest.mark.parametrize("dt", [0.0, 0.5])
def test_tall_and_wide_plants(shape, dt):
    rng = np.random.default_rng(sum(shape))
    q, m = shape
    A = rng.standard_normal((3, 3))
    G = StateSpace(A - 0.5 * np.eye(3), rng.standard_normal((3, m)), rng.standard_normal((q, 3)), np.zeros((q, m)))
    design = mixsyn(c2d(G, dt) if dt else G, 0.5, 0.2, 0.1)
    assert design.verified_norm <= 1.01 * design.gamma
    assert (design.controller.ny, design.controller.nu) == (m, q)


@pytest.mark.filterwarnings("ignore:connect\\(\\) is deprecated:FutureWarning")
def test_an_outside_solver_agrees():
    """python-control's mixsyn (SLICOT sb10ad) on the disturbance process."""
    pytest.importorskip("slycot", reason="python-control needs slycot for H-infinity")
    G, W1, W2 = tf([1], [1, 1.2, 0.3]), performance(2, 0.5, 0.01), 0.3
    gamma = control.mixsyn(G.to_control(), W1.to_control(), control.ss([], [], [], [[W2]]))[2][0]
    assert mixsyn(G, W1, W2).gamma == pytest.approx(gamma, rel=2e-3)


@pytest.mark.filterwarnings("ignore:connect\\(\\) is deprecated:FutureWarning")
def test_augmented_plant_is_that_of_python_control():
    G, W1, W3 = tf([1, 3], [1, 1.2, 0.3]), performance(2, 0.5, 0.01), tf([1, 0.1], [0.01, 1])
    theirs = control.augw(G.to_control(), W1.to_control(), control.ss([], [], [], [[0.3]]), W3.to_control())
    ours = augw(G, W1, 0.3, W3).system
    for w in (0.01, 1.0, 30.0):
        np.testing.assert_allclose(ours.frequency_response(w), theirs(1j * w), atol=1e-10)


def test_bad_arguments_are_named():
    G = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    integrator = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    for arguments, message in (
        ((G,), "all None"),
        ((G, integrator), r"W1 has a pole at 0.*slow stable pole"),
        ((G, None, np.ones((1, 2))), "W2 has 2 inputs for 1"),
        ((G, None, None, c2d(integrator, 0.1)), "W3 does not fit"),
        ((G, np.nan), "W1"),
    ):
        with pytest.raises(ModelError, match=message):
            augw(*arguments)
    with pytest.raises(ModelError, match="shift is -1"):
        mixsyn(G, 1.0, shift=-1)


def test_four_block_needs_no_shift():
    """Undamped modes are no obstacle where every measurement has its own noise."""
    I = np.eye(3)
    P = GeneralizedPlant.four_block(geostationary(), Wdist=I, Wnoise=I, Wout=I, Wact=I)
    design = hinfsyn(P)
    assert design.verified_norm <= 1.01 * design.gamma
    assert feedback(geostationary(), design.controller).poles().real.max() < 0
    w = 0.3
    g, k = geostationary().frequency_response(w), design.controller.frequency_response(w)
    S = np.linalg.inv(I + g @ k)
    expected = np.block([[S @ g, -g @ k @ S], [-k @ S @ g, -k @ S]])
    np.testing.assert_allclose(design.closed_loop.frequency_response(w), expected, atol=1e-8)
