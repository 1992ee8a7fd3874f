"""Designs for all times: the flexible satellite, random plants, files, the gate, and what must be refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastsampling import fast_sampled, random_loop

from synth import (
    AssumptionError,
    Design,
    GeneralizedPlant,
    ModelError,
    Requirements,
    StateSpace,
    accept,
    augw,
    c2d,
    d2c,
    export,
    gang_of_four,
    hinfnorm,
    hinfsyn,
    sdhinfnorm,
    sdhinfsyn,
    system,
)
from synth.analysis.sampleddata import is_sample
from synth.command.look import facts
from synth.delivery.modelfiles import read, save_system
from synth.synthesis.plantdata import from_dict, to_dict

H = 2.0  # s


def satellite(h: float) -> GeneralizedPlant:
    """One axis of a satellite with a panel (1.2 rad/s, 0.5 % damping): z = [kp angle; u/2], noise of 0.01 a sample."""
    J, coupling, w, damping = 500.0, 14.0, 1.2, 0.005
    M = np.array([[J, coupling], [coupling, 1.0]])
    stiff, damped, torque = np.diag([0, w**2]), np.diag([0, 2 * damping * w]), np.array([[1.0], [0.0]])
    Z, I = np.zeros, np.eye
    A = np.block([[Z((2, 2)), I(2)], [-np.linalg.solve(M, stiff), -np.linalg.solve(M, damped)]])
    B = np.vstack([Z((2, 1)), np.linalg.solve(M, torque)])
    return GeneralizedPlant(
        A=A, B1=np.hstack([B, Z((4, 1))]), B2=B, C1=np.vstack([J * 0.1**2 * I(4)[:1], Z((1, 4))]), D11=Z((2, 2)),
        D12=[[0], [0.5]], C2=I(4)[:1], D21=[[0, 0.01 * h**0.5]], D22=0, w=("torque", "noise"), u=("wheel",),
    )  # fmt: skip


@pytest.fixture(scope="module")
def designs() -> tuple[Design, Design]:
    """For the samples, and for all times."""
    return hinfsyn(c2d(satellite(H), H)), sdhinfsyn(satellite(H), H)


def test_a_design_for_the_samples_of_a_flexible_satellite_is_worse_between_them(designs):
    held, sampled = designs
    assert held.gamma == pytest.approx(0.7597, abs=2e-4)
    assert held.intersample is not None
    assert held.intersample.lower > 1.1
    assert hinfnorm(fast_sampled(satellite(H), held.controller, 32, held=(1,)))[0] == pytest.approx(
        held.intersample.upper, rel=2e-3
    )
    assert sampled.gamma == pytest.approx(0.7637, abs=7e-4)
    assert sampled.gamma * (1 - 2e-3) <= sampled.info.optimum <= sampled.gamma
    assert sampled.gamma == sampled.intersample.upper == sdhinfnorm(satellite(H), sampled.controller).upper
    assert sampled.plant.continuous is not None
    for h in (0.25, 0.5):  # sampled often, both are good
        plant = c2d(satellite(h), h)
        assert hinfsyn(plant).intersample.upper < 1.03 * sdhinfsyn(satellite(h), h).gamma


def test_what_is_between_the_samples_is_told(designs, tmp_path):
    held, sampled = designs
    assert "between the samples: 1.2" in repr(held)
    assert any("60." in text and "sdhinfsyn(plant.continuous, h)" in text for text in held.warnings)
    assert held.facts["norm between the samples"].startswith("1.21")
    assert facts(held)["intersample_norm"] == held.intersample.upper
    export(held, "c", tmp_path, name="held", allow_unstable=True)
    assert repr(held.intersample.upper) in (tmp_path / "held.h").read_text()
    assert "between the samples too" in repr(sampled)
    assert not any("between" in text for text in sampled.warnings)
    assert "verified norm between the samples too" in sampled.facts
    assert hinfsyn(replace(held.plant, continuous=None)).intersample is None
    other = replace(held.plant, B1=2 * held.plant.B1)  # no sample of it any more
    assert hinfsyn(other).intersample is None


def test_the_gate_judges_what_is_between_the_samples(designs):
    def line(found):
        return next(c for c in found.conditions if c.name == "between the samples")

    held, sampled = designs
    found = line(accept(held))
    assert found.verdict == "FAIL"
    assert found.ratio == pytest.approx(held.intersample.upper / held.gamma)
    assert "at most 1.05" in found.note
    assert line(accept(held, requirements=Requirements(intersample_ratio=None))).passed
    assert line(accept(held, requirements=Requirements(intersample_ratio=1.7))).passed
    good = accept(sampled)
    assert good.passed
    assert line(good).ratio == pytest.approx(1, abs=1e-5)
    assert next(iter(good.conditions)).verdict == "-"  # of the samples, whose level is not known
    bare = accept(held.controller, satellite(H), level=0.76)  # a discrete controller on the continuous plant
    assert line(bare).norm == pytest.approx(held.intersample.upper, rel=1e-5)
    assert line(accept(held.controller, satellite(H))).verdict == "not judged"


def test_files_keep_the_continuous_plant(designs, tmp_path):
    for design in designs:
        found = Design.load(design.save(tmp_path / "design.json"))
        assert found.gamma == design.gamma
        assert found.intersample.upper == pytest.approx(design.intersample.upper, rel=1e-6)
        np.testing.assert_array_equal(found.plant.continuous.A, satellite(H).A)
    with pytest.raises(ModelError, match="not its continuous plant, sampled"):
        from_dict(to_dict(designs[0].plant) | {"B1": (2 * designs[0].plant.B1).tolist()})
    save_system(tmp_path / "plant.json", designs[0].plant)
    found = read(tmp_path / "plant.json")
    assert hinfsyn(found).intersample.upper == pytest.approx(designs[0].intersample.upper, rel=1e-6)
    proved = designs[1].certify()
    assert proved.intersample.upper == pytest.approx(designs[1].gamma, rel=1e-5)
    assert proved.upper == pytest.approx(hinfnorm(designs[1].closed_loop)[0], rel=1e-5)


@pytest.mark.parametrize(
    "build",
    [
        lambda G: GeneralizedPlant.tracking(G, Wproc=0.1, Wdist=[0.1], Werr=1, Wact=[[0.1]], Wr=1),
        lambda G: GeneralizedPlant.four_block(G, Wdist=1, Wnoise=0.1, Wout=1, Wact=0.1),
        lambda G: augw(G, 0.5, 0.1, W3=0.2),
        gang_of_four,
    ],
)
def test_what_is_built_of_a_sampled_part_with_gains_remembers_the_continuous_one(build, tmp_path):
    """It is what c2d makes of the plant that is built likewise in continuous time; weights that are gains stay so."""
    G = StateSpace([[0, 1], [-1.3, -0.05]], [[0], [1.2]], [[1, 0.2]], 0, u=("torque",), y=("angle",))
    P, Q = build(c2d(G, 0.5)), build(G)
    assert is_sample(P, Q)
    found = hinfsyn(P)
    assert found.plant.continuous.w == Q.w
    norm = sdhinfnorm(Q, found.controller, held=np.flatnonzero(Q.D21.any(axis=0)).tolist())
    assert found.intersample.upper == pytest.approx(norm.upper, rel=1e-9)
    assert found.facts["norm between the samples"] == f"{norm.upper:.7g}"
    assert norm.lower < found.certify().intersample.upper < norm.upper * (1 + 1e-5)
    assert Design.load(found.save(tmp_path / "design.json")).intersample == found.intersample
    for other in (replace(P, A=P.A * 1.01), build(replace(c2d(G, 0.5), B=[[0.0], [2.0]]))):  # changed since
        assert hinfsyn(other).intersample is None
    assert build(d2c(c2d(G, 0.5))).continuous is None


def test_what_is_built_with_discrete_weights_says_that_nothing_is_known_between_the_samples():
    G, h = system([1.0], [1.0, 0.3, 1.0]), 0.5
    found = hinfsyn(augw(c2d(G, h), c2d(system([1.0], [1.0, 0.1]), h), 0.1))
    assert found.intersample is None
    assert "then c2d(P, h)" in found.facts["norm between the samples"]
    better = hinfsyn(c2d(augw(G, system([1.0], [1.0, 0.1]), 0.1), h))
    assert better.intersample is not None


@pytest.mark.parametrize("delay", [0.2, 1.0, H])
def test_designs_for_a_hold_that_is_late(designs, delay, tmp_path):
    """Exact: the state of a late hold is the u before. What was designed without the delay is worse with it."""
    found = sdhinfsyn(satellite(H), H, delay=delay)
    norm = sdhinfnorm(satellite(H), found.controller, delay=delay, held=["noise"])
    assert found.gamma == pytest.approx(norm.upper, rel=1e-6)
    assert found.gamma <= found.info.optimum * (1 + 2e-3)
    assert designs[1].gamma < found.gamma
    assert found.gamma < sdhinfnorm(satellite(H), designs[1].controller, delay=delay, held=["noise"]).upper
    assert found.controller.n == 5
    assert found.plant.delay == delay
    again = Design.load(found.save(tmp_path / "design.json"))
    assert again.gamma == found.gamma
    assert again.intersample.upper == pytest.approx(found.gamma, rel=1e-6)
    assert found.facts["delay of the hold"] == f"{delay:g} s"
    assert norm.lower < found.certify().intersample.upper < norm.upper * (1 + 1e-5)
    line = next(c for c in accept(found).conditions if c.name == "between the samples")
    assert line.norm == pytest.approx(found.gamma, rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_designs_for_late_holds_are_best_on_random_plants(seed):
    """Within the tolerance of a level that no controller reaches, where the design without delay may be unstable."""
    P, K = random_loop(seed)
    P = replace(P, D21=np.array([[0.0, 0.3]]))
    delay = K.dt * np.random.default_rng(seed).uniform()
    found = sdhinfsyn(P, K.dt, delay=delay)
    assert found.gamma <= found.info.optimum * (1 + 2e-3)
    other = sdhinfsyn(P, K.dt).controller
    assert found.gamma <= sdhinfnorm(P, other, delay=delay, held=[1]).upper * (1 + 1e-3)


def test_a_w_that_is_held_is_slower_and_does_less(designs, tmp_path):
    found = sdhinfsyn(satellite(H), H, held=["torque"])
    assert found.plant.held == ("torque",)
    assert found.gamma < designs[1].gamma
    assert found.gamma == pytest.approx(designs[0].gamma, rel=1e-3)  # all held: what c2d makes of them
    again = Design.load(found.save(tmp_path / "design.json"))
    assert again.plant.held == ("torque",)
    assert again.intersample.upper == pytest.approx(found.gamma, rel=1e-6)
    with pytest.raises(ModelError, match="there is no held w 'wind'"):
        sdhinfsyn(satellite(H), H, held="wind")
    with pytest.raises(ModelError, match="is no w of the plant"):
        replace(found.plant, held=("wind",))
    with pytest.raises(ModelError, match="delay and held are about"):
        replace(found.plant, continuous=None)
    with pytest.raises(ModelError, match=r"delay is 2\.5 s, more than the period"):
        sdhinfsyn(satellite(H), H, delay=2.5)


def test_designs_for_plants_that_were_sampled_with_a_late_hold_know_it():
    P = c2d(satellite(H), H, delay=[0, 0, 0.7])
    assert (P.continuous is not None, P.delay) == (True, 0.7)
    found = hinfsyn(P)
    norm = sdhinfnorm(satellite(H), found.controller, delay=0.7, held=["noise"])
    assert found.intersample.upper == pytest.approx(norm.upper, rel=1e-6)
    for other in ([0.7, 0.7, 0.7], [0.1, 0, 0.7]):  # whose w are late
        assert c2d(satellite(H), H, delay=other).continuous is None
    assert c2d(satellite(H), H, output_delay=[0, 0, 0.7]).continuous is None


@pytest.mark.parametrize("seed", range(4))
def test_no_design_for_the_samples_is_better_between_them(seed):
    """On random plants, with noise on y; its norm is what fast sampling comes to."""
    P, K = random_loop(seed)
    P = replace(P, B1=np.hstack([P.B1, np.zeros((3, 1))]), D11=np.zeros((2, 3)), D21=[[0, 0, 0.3]], w=())
    design = sdhinfsyn(P, K.dt)
    assert design.gamma <= 1.002 * hinfsyn(c2d(P, K.dt)).intersample.upper
    assert design.gamma <= (1 + 2e-3) * sdhinfnorm(P, K).upper
    assert design.info.optimum >= design.gamma * (1 - 2.1e-3)
    fast = hinfnorm(fast_sampled(P, design.controller, 32, held=(2,)))[0]
    assert fast <= design.gamma * (1 + 1e-6)
    assert fast == pytest.approx(design.gamma, rel=2e-3)


def test_units_and_time_do_not_matter(designs):
    P, expected = satellite(H), designs[1].gamma
    t = 1e3  # ms
    moved = replace(
        P, A=P.A / t, B1=1e-3 * P.B1 / t, B2=P.B2 / t * 1e4, C1=1e5 * P.C1, D12=1e9 * P.D12, C2=57.3 * P.C2,
        D21=57.3e-3 * P.D21,
    )  # fmt: skip
    assert sdhinfsyn(moved, H * t).gamma == pytest.approx(1e2 * expected, rel=2e-3)


def test_sampling_a_generalised_plant_keeps_it_one():
    P = satellite(H)
    sampled = c2d(P, H)
    assert isinstance(sampled, GeneralizedPlant)
    assert sampled.continuous is P
    assert sampled.w == P.w
    expected = c2d(P.system, H)
    np.testing.assert_array_equal(sampled.system.B, expected.B)
    tustin = c2d(P, H, "tustin")
    assert tustin.continuous is None
    assert tustin.u == P.u
    np.testing.assert_array_equal(tustin.system.A, c2d(P.system, H, "tustin").A)
    with pytest.raises(ModelError, match="already discrete"):
        c2d(sampled, H)
    with pytest.raises(ModelError, match="continuous is"):
        replace(sampled, continuous=sampled)


def test_what_cannot_be_designed_for_is_refused():
    P = satellite(H)
    with pytest.raises(ModelError, match="P is discrete"):
        sdhinfsyn(c2d(P, H), H)
    with pytest.raises(ModelError, match="h is 0"):
        sdhinfsyn(P, 0)
    with pytest.raises(ModelError, match="both are needed"):
        sdhinfsyn(P.system, H)
    assert sdhinfsyn(P.system, 1.0, 1, 1).gamma == pytest.approx(sdhinfsyn(P, 1.0).gamma, rel=2e-3)
    # a mode at the sampling rate, without damping: the samples do not see it
    G = StateSpace([[0, 2 * np.pi], [-2 * np.pi, 0]], [[0], [1]], [[1, 0]], 0)
    hidden = GeneralizedPlant(
        A=G.A, B1=np.hstack([G.B, 0 * G.B]), B2=G.B, C1=np.vstack([G.C, 0 * G.C]), D11=np.zeros((2, 2)), D12=[[0], [1]],
        C2=G.C, D21=[[0, 1]], D22=0,
    )  # fmt: skip
    with pytest.raises(AssumptionError):
        sdhinfsyn(hidden, 1.0)


def test_the_program_of_the_page_runs(capsys):
    page = (Path(__file__).parents[3] / "docs" / "sampled_data.md").read_text()
    names: dict = {}
    exec(compile(page.split("```python\n")[1].split("```")[0], "sampled_data.md", "exec"), names)
    assert "warning: between the samples" in capsys.readouterr().out
    assert names["better"].gamma < 0.6 * names["design"].intersample.lower
