"""Discrete time of unspecified sampling time, dt = True: it goes in and comes out, and is no second by accident."""

from __future__ import annotations

import operator

import control
import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

import synth
from synth import Design, GeneralizedPlant, LinearController, ModelError, StateSpace, system
from synth.delivery.modelfiles import read, save_system

A, B, C, D = np.array([[0.5, 0.2], [0.0, 0.8]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.3]]), np.zeros((1, 1))
NUM, DEN = [1.0, 0.5], [1.0, -1.3, 0.4]
FORMS = {
    "StateSpace": lambda dt: StateSpace(A, B, C, D, dt),
    "numpy's bool": lambda dt: StateSpace(A, B, C, D, np.bool_(True) if dt is True else dt),
    "control.ss": lambda dt: control.ss(A, B, C, D, dt),
    "control.tf": lambda dt: control.tf(NUM, DEN, dt),
    "scipy": lambda dt: signal.dlti(NUM, DEN, dt=dt),
    "(A, B, C, D, dt)": lambda dt: (A, B, C, D, dt),
    "(num, den, dt)": lambda dt: (NUM, DEN, dt),
    "mapping": lambda dt: {"num": NUM, "den": DEN, "dt": dt},
}


def unspecified(G) -> bool:
    return G.dt is True


@pytest.mark.parametrize("form", FORMS)
def test_it_comes_in_and_goes_out(form):
    G = system(FORMS[form](True))
    assert unspecified(G)
    assert G.discrete
    assert unspecified(G.to_control())
    assert unspecified(G.tf())
    assert unspecified(system(G.to_control()))
    one = system(FORMS[form](1.0))
    np.testing.assert_array_equal(G.poles(), one.poles())
    np.testing.assert_array_equal(G.frequency_response([0.1, 1.0]), one.frequency_response([0.1, 1.0]))  # rad/sample
    assert G.digest() != one.digest()
    assert unspecified(G[0, 0])
    assert unspecified(-G)
    assert unspecified(~G)
    assert unspecified(G.transform(np.eye(G.n)))
    assert unspecified(G**2)
    assert unspecified(G + 1)


def test_scipys_default_is_unspecified():
    assert unspecified(system(signal.dlti(NUM, DEN)))


COMBINED = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "feedback": synth.feedback,
    "series": synth.series,
    "method": lambda G, H: G.feedback(H),
    "lft": lambda G, H: synth.lft(synth.gang_of_four(G).system, H),
    "close": lambda G, H: synth.gang_of_four(G).close(H),
}


@pytest.mark.parametrize("name", COMBINED)
@given(dt=st.floats(1e-6, 1e3))
def test_with_a_sampling_time_it_takes_that(name, dt):
    """As python-control does it, in either order; with continuous time it does not go."""
    combine = COMBINED[name]
    known, open_one, other = (StateSpace(A, B, C, 0.5, t) for t in (dt, True, True))
    assert combine(known, open_one).dt == dt
    assert combine(open_one, known).dt == dt
    assert unspecified(combine(open_one, other))
    np.testing.assert_array_equal(combine(open_one, known).A, combine(known, known).A)
    with pytest.raises(ModelError, match="timebases"):
        combine(open_one, StateSpace(A, B, C, 0.5, 0.0))
    with pytest.raises(ModelError, match="timebases"):
        combine(StateSpace(A, B, C, 0.5, 0.0), open_one)
    assert unspecified(combine(open_one, 0.5))


def test_several_take_the_one_that_is_known():
    G, H = StateSpace(A, B, C, D, True), StateSpace(A, B, C, D, 0.25)
    assert synth.augw(G, W1=H, W2=1).dt == 0.25
    assert synth.augw(H, W1=G, W2=1).dt == 0.25
    assert unspecified(synth.augw(G, W1=G, W2=1))
    P = GeneralizedPlant.four_block(G, Wdist=1, Wnoise=1, Wout=H, Wact=1)
    assert P.dt == 0.25
    assert synth.margins(G, 0.1 * H).dt == 0.25
    with pytest.raises(ModelError, match="timebases"):
        synth.augw(G, W1=StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], 0.0))
    assert system(G, dt=0.25).dt == 0.25
    with pytest.raises(ModelError, match=r"timebase 0\.25 s and dt = True"):
        system(H, dt=True)


def problem(dt) -> GeneralizedPlant:
    return synth.gang_of_four(StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], dt))


@pytest.mark.parametrize("make", [synth.hinfsyn, lambda P: synth.ncfsyn(StateSpace(P.A, P.B2, P.C2, P.D22, P.dt))])
def test_designs_keep_it(make, tmp_path):
    """The same controller as at one second, its frequencies in rad/sample, and still nobody's second when read back."""
    design, second = make(problem(True)), make(problem(1.0))
    assert design.gamma == second.gamma
    np.testing.assert_array_equal(design.controller.A, second.controller.A)
    assert unspecified(design.plant)
    assert unspecified(design.controller)
    assert unspecified(design.closed_loop)
    assert unspecified(design.K)
    again = Design.load(design.save(tmp_path / "design.json"))
    assert unspecified(again.plant)
    assert unspecified(again.controller)
    assert again.gamma == design.gamma
    design.save(tmp_path / "design.mat")
    assert "dt = True (unspecified)" in repr(design)
    assert "True (unspecified)" in design._repr_html_()
    assert design.margins.delay == second.margins.delay
    assert f"{second.margins.delay:.3g} samples" in repr(design)
    found = synth.accept(design)
    assert found.passed
    assert "at an unspecified sampling time" in found.verdict
    synth.export(design.controller, "json", tmp_path, name="plain")
    assert unspecified(read(tmp_path / "plain.json").system)
    with pytest.raises(ModelError, match="has dt = True, an unspecified sampling time; say it"):
        synth.export(design, "c", tmp_path)
    assert len(synth.export(system(design.controller, dt=0.1), "c", tmp_path)) == 2


def test_files_keep_it(tmp_path):
    for G in (StateSpace(A, B, C, D, True), problem(True)):
        assert unspecified(getattr(read(save_system(tmp_path / "g.json", G)), "system", G))
    import scipy.io

    scipy.io.savemat(tmp_path / "g.mat", {"A": A, "B": B, "C": C, "D": D, "dt": -1.0})  # MATLAB's way to say it
    assert unspecified(read(tmp_path / "g.mat").system)


def test_what_needs_seconds_says_so():
    G = StateSpace(A, B, C, D, True)
    for call in (
        lambda: LinearController.of(G),
        lambda: synth.state_feedback([[1.0]], True),
        lambda: synth.mpc(G, Q=[[1.0]], R=1.0, Np=5, Nc=2, umin=-1, umax=1),
        lambda: synth.fuel_mpc(G, box=1.0, umax=1.0, horizon=3),
    ):
        with pytest.raises(ModelError, match="unspecified sampling time; say it"):
            call()
    with pytest.raises(ModelError, match=r"already discrete \(dt = True"):
        synth.c2d(G, 0.1)
    with pytest.raises(ModelError, match="dt is True; pass the sampling time in seconds"):
        synth.c2d(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), True)


def test_pictures_count_in_samples():
    G, H = StateSpace(A, B, C, D, True), StateSpace(A, B, C, D, 0.1)
    assert synth.bode(G)[-1].get_xlabel() == "frequency, rad/sample"
    assert synth.sigma(G).get_xlabel() == "frequency, rad/sample"
    assert synth.step(G).get_xlabel() == "samples"
    assert synth.sigma(H).get_xlabel() == "frequency, rad/s"
    for draw in (synth.sigma, synth.step):
        with pytest.raises(ModelError, match="say the sampling time"):
            draw([G, H])
    plt.close("all")


def test_one_loop_measured_in_samples():
    """z / (z - 0.9) in units of a sample and of 10 ms: the delay margin is as many samples."""
    L = [1.0, 0.0], [1.0, -0.9]
    found, known = synth.margin((*L, True)), synth.margin((*L, 0.01))
    assert found.delay == pytest.approx(known.delay / 0.01, rel=1e-9)
    assert found.phase == pytest.approx(known.phase, rel=1e-12)
    assert synth.hinfnorm((*L, True)) == pytest.approx((10.0, 0.0))
