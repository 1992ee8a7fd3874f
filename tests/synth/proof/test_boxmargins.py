"""Margins over a box: published loops, bounds that meet, and no proof against a sample."""

import itertools

import numpy as np
import pytest
from flint import arb
from hypothesis import given, settings
from hypothesis import strategies as st
from uncertain import de_gaston_safonov, two_masses

import synth
from synth import ModelError, UncertainSystem, diskmargin, margin, margins, series, system, ureal
from synth.analysis import stabilitymargins
from synth.analysis.diskmargins import DiskMargin
from synth.analysis.stabilitymargins import Margin, Margins
from synth.proof.boxmargins import CORNER, COVER


def servo(percentage: float = 20) -> UncertainSystem:
    """k / (s^2 + 2 z s)/(s + 5), continuous."""
    k, z = ureal("k", 1.0, percentage=percentage), ureal("z", 0.3, plusminus=0.1)
    return UncertainSystem(A=[[0, 1, 0], [0, -2 * z, 1], [0, 0, -5]], B=[0, 0, k / 2], C=[1, 0, 0])


def open_two_masses() -> UncertainSystem:
    """The loop of `two_masses`, cut."""
    m1, m2, k = (ureal(name, 1.0, percentage=20) for name in ("m1", "m2", "k"))
    E = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, m1, 0], [0, 0, 0, m2]]
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-k, k, 0, 0], [k, -k, 0, 0]]
    lead = system([1, 1], [0.001, 1])
    return series(100 * lead * lead * lead, UncertainSystem(E, A, [0, 0, 1, 0], [0, 1, 0, 0]))


def satellite(percentage: float = 10) -> UncertainSystem:
    """MathWorks' spinning satellite, its rate uncertain; both loops closed with a gain of one."""
    p = ureal("p", 10.0, percentage=percentage)
    return UncertainSystem(A=[[0, p], [-p, 0]], B=np.eye(2), C=[[1, p], [-p, 1]])


def sampled(L: UncertainSystem, count: int, seed: int = 0) -> list[synth.StateSpace]:
    return [H for _, H in (*L.sample(count, seed), *L.gridded(2))]


def check(found: Margin, L: UncertainSystem, count: int = 60) -> None:
    """No sample is below what is proved, and what is reached is."""
    kept = [stabilitymargins.margin(H) for H in sampled(L, count)]
    assert found.gain_up <= min(m.gain_up for m in kept)
    assert found.gain_down >= max(m.gain_down for m in kept)
    assert found.phase <= min(m.phase for m in kept)
    assert found.delay <= min(m.delay for m in kept)
    for name, worst in found.worst.items():
        if worst.certificate is not None:
            worst.certificate.check()
        if worst.parameters:
            reached = getattr(stabilitymargins.margin(L.at(worst.parameters)), name)
            assert reached == pytest.approx(worst.lower if name == "gain_down" else worst.upper, rel=1e-4)


@pytest.mark.parametrize("dt", [0.0, 0.3])
def test_the_margins_of_a_servo_meet_what_samples_reach(dt):
    L = synth.c2d(servo(), dt, "tustin") if dt else servo()
    found = margin(L)
    assert isinstance(found, Margin)
    check(found, L)
    worst = found.worst
    assert worst["gain_up"].upper == pytest.approx(18.0)  # z (25 + 5 z) of the least damped, over 0.6
    assert worst["phase"].upper / found.phase < 1 + 2e-5
    assert worst["gain_up"].upper / found.gain_up < 1 + 2e-5
    assert found.gain_down <= 1 / 100  # nothing was found at all
    assert worst["delay"].upper / found.delay < 1.35
    assert found.gain_db == pytest.approx(20 * np.log10(18), rel=1e-4)


@pytest.mark.slow
def test_the_margins_of_the_two_masses():
    L = open_two_masses()
    found, disk = margin(L), diskmargin(L)
    check(found, L)
    assert found.worst["phase"].upper / found.phase < 1 + 2e-5
    assert disk.phase < found.phase
    assert disk.gain[1] < found.gain_up
    assert two_masses().parameters == L.parameters


@pytest.mark.parametrize("skew", [-1.0, 0.0, 1.0])
def test_the_disk_margin_of_one_channel_meets_what_samples_reach(skew):
    L = servo()
    found = diskmargin(L, skew=skew)
    assert isinstance(found, DiskMargin)
    assert found.alpha <= min(diskmargin(H, skew=skew).alpha for H in sampled(L, 40))
    assert diskmargin(L.at(found.worst.parameters), skew=skew).alpha == pytest.approx(found.alpha, rel=1e-4)
    assert found.worst.gap < 2e-5
    found.worst.certificate.check()
    assert diskmargin(UncertainSystem(L.E, L.A, -L.B, L.C), 1, skew=skew).alpha == pytest.approx(found.alpha)


def test_several_channels_are_bounded_by_scaled_gains():
    L = satellite()
    found = diskmargin(L)
    assert found.alpha <= min(diskmargin(H).alpha for H in sampled(L, 30))
    assert found.worst.upper < found.alpha * 1.05
    found.worst.certificate.check()
    T, far = np.diag([1e3, 1.0]), np.diag([1e-3, 1.0])  # other units of the channels
    moved = UncertainSystem(L.E, L.A, L.B @ far, T @ L.C, T @ L.D @ far)
    assert diskmargin(moved).alpha > 0.9 * found.alpha


def test_the_margins_of_a_plant_and_a_controller():
    P = UncertainSystem(*(getattr(servo(), name) for name in "EABC"))
    found = margins(P, 1.0)
    assert isinstance(found, Margins)
    assert found.input[0].phase == pytest.approx(found.output[0].phase)
    assert found.disk_inputs[0].alpha == pytest.approx(found.disk)
    kept = [stabilitymargins.margins(H, 1.0) for H in sampled(P, 8)]
    assert found.ncf <= min(m.ncf for m in kept) <= found.worst_ncf.upper
    assert found.worst_ncf.gap < 2e-5
    for one in ("gain_db", "phase_deg", "delay", "disk"):
        assert getattr(found, one) <= min(getattr(m, one) for m in kept)
    assert found.disk_both.alpha <= min(m.disk_both.alpha for m in kept)
    assert margins(P, -1.0, sign=1).phase_deg == pytest.approx(found.phase_deg)


def test_a_loop_that_is_unstable_in_its_box_has_no_margin():
    L = servo(20)
    wide = ureal("k", 1.0, range=(0.1, 40.0))
    G = UncertainSystem(L.E, L.A, [0, 0, wide / 2], L.C)
    disk = diskmargin(G)
    assert disk.alpha == 0
    assert disk.worst.eigenvalue.real >= 0
    assert margin(G).gain_up == 1.0
    assert margin(G).phase == margin(G).delay == 0
    unstable = margin(UncertainSystem(L.E, L.A, [0, 0, 20 * wide], L.C))
    assert (unstable.gain_up, unstable.gain_down, unstable.phase, unstable.delay) == (1, 1, 0, 0)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
def test_no_margin_is_contradicted_by_a_sample(seed):
    """Random loops of two or three states, one or two parameters, with and without a direct term."""
    rng = np.random.default_rng(seed)
    n, dt = int(rng.integers(2, 4)), float(rng.choice([0.0, 0.5]))
    A = rng.normal(size=(n, n))
    poles = np.linalg.eigvals(A)
    A = A * (0.9 / np.abs(poles).max()) if dt else A - (poles.real.max() + 0.3) * np.eye(n)
    a, b = ureal("a", 1.0, percentage=10), ureal("b", 1.0, percentage=20)
    uncertain = A.astype(object)
    uncertain[0, -1] = uncertain[0, -1] * a
    D = float(rng.choice([0.0, 0.2]))
    G = UncertainSystem(None, uncertain, rng.normal(size=(n, 1)) * b, rng.normal(size=(1, n)), D, dt)
    size = synth.hinfnorm(G.nominal)[0]
    L = UncertainSystem(G.E, G.A, G.B, G.C * (0.7 / size), G.D * (0.7 / size), dt)
    check(margin(L), L, 25)
    disk = diskmargin(L)
    assert disk.alpha <= min(diskmargin(H).alpha for H in sampled(L, 25))


def test_the_weight_covers_all_delays_around_their_middle():
    r"""|e^(-j x') - (1 - j x/4)/(1 + j x/4)| <= |W| for 0 <= x' <= x, in balls."""
    c, g = arb(str(COVER)), arb(CORNER)
    edges = np.geomspace(1 / 16, 8, 16_000)
    for low, high in itertools.pairwise(map(float, edges)):
        x = arb((low + high) / 2, (high - low) / 2)
        y = x - 2 * (x / 4).atan()
        farthest = 2 * (y / 2).sin() if y < arb.pi() else arb(2)
        assert farthest < c * x / 2 / (1 + (x / g) ** 2).sqrt()
    x = arb(8)  # from there on W is above 2; below the first y < x/2 + x^3/96
    assert c * x / 2 / (1 + (x / g) ** 2).sqrt() > 2
    x = arb(float(edges[0]))
    assert arb(1) / 2 + x * x / 96 < c / 2 / (1 + (x / g) ** 2).sqrt()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: margin(satellite()), "2 x 2"),
        (lambda: diskmargin(UncertainSystem(A=[[-ureal("a", 1.0, percentage=10)]], B=[[1, 1]], C=[[1]])), "1 x 2"),
        (lambda: margin(UncertainSystem(A=-1, B=1, C=1)), "no uncertain parameters"),
        (lambda: diskmargin(servo(), skew="much"), "skew"),
        (lambda: margins(servo(), np.eye(2)), "K is 2 x 2"),
        (lambda: synth.stability_margin(de_gaston_safonov(), growing="d9"), "d1, d2, d3"),
    ],
)
def test_what_is_wrong_is_named(call, message):
    with pytest.raises(ModelError, match=message):
        call()


def test_some_ranges_grow_while_the_others_stay():
    """De Gaston's and Safonov's loop: what d1 bears alone, at its worst for the others."""
    G = de_gaston_safonov()
    found = synth.stability_margin(G, growing="d1")
    box = found.certificate.system.parameters
    assert (box["d2"].low, box["d2"].high) == (-1, 1)
    assert box["d1"].high == pytest.approx(found.lower)
    assert found.gap < 2e-5
    assert synth.stability_margin(G).lower < found.lower
    found.certificate.check()
    for d1 in (-found.lower, found.lower):
        values = [G.at({"d1": d1, "d2": x, "d3": y}, within=False) for x in (-1, 0, 1) for y in (-1, 0, 1)]
        assert max(H.poles().real.max() for H in values) < 0
    every = synth.stability_margin(G, growing=("d1", "d2", "d3"))
    assert every.lower == synth.stability_margin(G).lower
