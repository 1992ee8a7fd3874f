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
    c2d,
    export,
    hinfnorm,
    hinfsyn,
    sdhinfnorm,
    sdhinfsyn,
)
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
