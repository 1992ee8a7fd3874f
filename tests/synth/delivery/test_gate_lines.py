"""Every line of the gate can fail, alone, and says by how much; a table of loops that each miss one requirement."""

import re
from dataclasses import replace

import numpy as np
import pytest

import synth
from synth import GeneralizedPlant, Requirements, StateSpace, UncertainSystem, accept, gang_of_four, ureal
from synth.__main__ import main
from synth.analysis.norms import hinfnorm
from synth.delivery import boxconditions
from synth.delivery.boxconditions import STABLE
from synth.delivery.processor import PRECISIONS
from synth.errors import ModelError

NOTHING = Requirements(
    ratio=1e9, intersample_ratio=None, delay_margin_samples=None, disk_margin=None, rounding_ratio=None, box_margin=None
)
PLANT = StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], 1.0)
GAIN = 0.6  # u = -0.6 y: one pole at 0.6


def asks(**required):
    return replace(NOTHING, **required)


def static(k):
    return StateSpace.gain([[-k]], 1.0)


def cancelling(size):
    """u = -0.6 y, and two states of the same time constant whose difference exact arithmetic does not have."""
    return StateSpace(0.5 * np.eye(2), [[3.0], [1.0]], [[size, -3 * size]], [[-GAIN]], 1.0)


def uncertain(a=0.3, b=0.0, **channels):
    """x+ = a x + b u (+ w), a and b within so much of 1.2 and 1."""
    a = ureal("a", 1.2, plusminus=a)
    b = ureal("b", 1.0, plusminus=b) if b else 1.0
    return UncertainSystem(None, [[a]], channels.get("B", [[b]]), channels.get("C", [[1.0]]), dt=1.0)


def norm(K, P):
    return hinfnorm(P.close(K))[0]


FOUR = gang_of_four(PLANT)
LEVEL = norm(static(GAIN), FOUR)
INTEGRATOR = StateSpace([[1.0]], [[0.05]], [[-1.0]], [[-GAIN]], 1.0)
FAST = StateSpace([[1.5]], [[1.0]], [[1.0]], [[0.0]], 1.0)
RINGING = GeneralizedPlant.partition(  # at 5 rad/s, sampled once a period: w to its rate, u to a lag that is measured
    StateSpace(
        [[0, 1, 0], [-25, -1, 0], [0, 0, -1]], [[0, 0], [1, 0], [0, 1]], [[0, 5, 1], [0, 0, 1]], np.zeros((2, 2))
    ), 1, 1
)  # fmt: skip
LIGHT, WEAK = synth.c2d(RINGING, 2 * np.pi / 5), StateSpace.gain([[-0.1]], 2 * np.pi / 5)
WORST = {
    # line -> K, plant, what is asked, other arguments, what the note says
    "designed": (static(GAIN), FOUR, asks(ratio=1.01), {"level": LEVEL / 1.5}, "1.5 times the level; at most 1.01"),
    "between the samples": (
        WEAK, LIGHT, asks(intersample_ratio=1.05), {"level": norm(WEAK, LIGHT)}, "times the level; at most 1.05"
    ),
    "one sample of delay": (static(GAIN), FOUR, asks(delay_ratio=1.05), {"level": LEVEL}, "the level; at most 1.05"),
    "float32 numbers": (static(0.7), FOUR, asks(ratio=1 + 1e-10), {}, "times the norm before rounding"),
    "float32 arithmetic": (cancelling(2.0**21), FOUR, NOTHING, {}, r"differ by at most [\d.e-]+ of .*, and .*at most"),
    "rounding (float32)": (cancelling(2.0**14), FOUR, asks(rounding_ratio=1e-2), {}, "of the peaks of u.*at most 0.01"),
    "rounding (double)": (
        cancelling(2.0**14), FOUR, asks(rounding_ratio=1e-13), {"precision": "double"}, "at most 1e-13"
    ),
    "rounding (q15)": (static(GAIN), FOUR, asks(rounding_ratio=1e-6), {"precision": "q15"}, "at most 1e-06"),
    "q15 numbers": (INTEGRATOR, FOUR, NOTHING, {"precision": "q15"}, "no scaling for q15"),
    "saturation": (
        static(0.8), gang_of_four(FAST), NOTHING, {"umin": -1, "umax": 1, "overload": 2.1},
        "not back after .* is left from .*at most 0.01",
    ),
    "gain margin": (static(GAIN), FOUR, asks(gain_margin_db=20), {}, "9.542 dB .*required 20"),
    "phase margin": (static(GAIN), FOUR, asks(phase_margin_deg=90), {}, "56.25 deg .*required 90"),
    "delay margin": (static(GAIN), FOUR, asks(delay_margin_samples=9), {}, "1.88 samples .*required 9"),
    "disk margin": (static(GAIN), FOUR, asks(disk_margin=1.9), {}, "1 .*required 1.9"),
    "ncf margin": (static(GAIN), FOUR, asks(ncf_margin=0.9), {}, "0.3363 .*required 0.9"),
    "stability over the box": (
        static(GAIN), uncertain(0.5), asks(box_margin=1.0), {}, "unstable on 0.8 times it, with a = 1.6; required 1"
    ),
    "one sample of delay over the box": (
        static(0.8), uncertain(0.01, 0.5), asks(box_margin=1.0), {}, "unstable on 0.5 times it.*b = 1.25; required 1"
    ),
    "gain over the box": (
        static(GAIN), uncertain(B=[[1.0, 1.0]], C=[[1.0], [1.0]]), asks(box_gain_ratio=2.0), {"level": 2.5},
        "10 is reached with a = 1.5; 4.*times the level; at most 2",
    ),
    "disk margin over the box": (static(GAIN), uncertain(), asks(disk_margin=0.6), {}, "reached with a = 1.5"),
    "gain margin over the box": (static(0.9), uncertain(), asks(gain_margin_db=6.0), {}, "5.105 reached with a = 1.5"),
    "phase margin over the box": (static(GAIN), uncertain(), asks(phase_margin_deg=40), {}, "26.* with a = 1.5"),
    "delay margin over the box": (static(0.9), uncertain(), asks(delay_margin_samples=1.14), {}, "1.132 reached with"),
    "ncf margin over the box": (static(GAIN), uncertain(), asks(ncf_margin=0.3), {}, "reached with a = 1.5"),
}  # fmt: skip


@pytest.mark.parametrize("line", WORST)
def test_one_line_fails_and_says_by_how_much(line):
    K, plant, asked, options, note = WORST[line]
    found = accept(K, plant, requirements=asked, **options)
    assert [c.name for c in found.failed] == [line]
    assert not found.passed
    assert line in found.verdict
    assert re.search(note, found.failed[0].note), found.failed[0].note


def test_what_is_measured_in_another_form_fails_first_there():
    """A hold, or a sample of delay more, that the loop does not bear: the lines after it see the same loop."""
    lag = synth.system([-5.0], [1.0])
    held = accept(lag, gang_of_four(synth.system([1.0], [1.0, 0.0])), dt=0.5, requirements=NOTHING)
    assert held.failed[0].name == "zero-order hold"
    assert "spectral radius 1.5" in held.failed[0].note
    unit = accept(static(0.4), FOUR, level=norm(static(0.4), FOUR) / 2, form="fmu", requirements=asks(delay_ratio=1.05))
    assert [c.name for c in unit.failed] == ["co-simulation unit", "one sample of delay"]
    assert "times the level; at most 1.05" in unit.failed[0].note


def test_a_design_is_judged_over_the_box_of_a_plain_plant_beside_its_own():
    """The other lines are those of the design's own plant; a continuous plant is held at the period of the design."""
    k = ureal("k", 1.0, percentage=20)
    design = synth.hinfsyn(synth.c2d(gang_of_four(synth.system([1.0], [1.0, 1.0])), 0.2))
    found = accept(design, UncertainSystem(None, [[-1.0]], [[k]], [[1.0]]))
    own, box = accept(design), [c for c in found.conditions if "over the box" in c.name]
    assert [c for c in found.conditions if c not in box] == list(own.conditions)
    assert {c.name for c in box} >= {STABLE, "one sample of delay over the box", "disk margin over the box"}
    assert all(c.passed for c in box)
    whole = accept(
        design, UncertainSystem(None, [[-1.0]], [[0.0, k, k]], [[1.0], [0.0], [1.0]], [[1, 0, 0], [0, 0, 1], [1, 0, 0]])
    )
    assert "gain over the box" in [c.name for c in whole.conditions]


def test_no_margin_is_kept_where_the_loop_is_unstable():
    """Though nothing is asked of the size of the box, a margin that is required is none at an unstable point in it."""
    found = accept(static(GAIN), uncertain(0.5), requirements=asks(disk_margin=0.1))
    assert [c.name for c in found.failed] == ["disk margin over the box"]
    assert "not proved stable on the box" in found.failed[0].note


def test_signals_that_w_does_not_move_have_no_peaks_to_miss():
    """w acts on what neither z nor y nor u sees: rounding then is a part of nothing, and is not said to be all."""
    P = GeneralizedPlant(
        [[0.5, 0.0], [0.0, 0.3]], [[0.0], [1.0]], [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]], [[0.0]], [[1.0, 0.0]], [[0.0]],
        [[0.0]], dt=1.0,
    )  # fmt: skip
    for precision in PRECISIONS:
        found = accept(StateSpace([[0.2]], [[1.0]], [[0.1]], [[-0.1]], 1.0), P, precision=precision)
        assert next(c for c in found.conditions if c.name == f"rounding ({precision})").passed


def test_the_command_judges_numbers_of_a_kind(tmp_path, capsys):
    synth.hinfsyn(synth.c2d(gang_of_four(synth.system([1.0], [1.0, 1.0])), 0.2)).save(tmp_path / "design.json")
    call = ["verify", str(tmp_path / "design.json"), "--precision", "q15", "--inputs", "2.5"]
    assert main(call) == 0
    assert "at any time with |y| <= 2.5" in capsys.readouterr().out
    assert main([*call, "--rounding-ratio", "1e-9"]) == 1
    assert "at most 1e-09 is required" in capsys.readouterr().out


@pytest.mark.parametrize(
    "wrong", [{"precision": "q7"}, {"inputs": -1.0}, {"inputs": [1.0, 2.0]}, {"plant": uncertain(B=[[1.0, 0.0]])}]
)
def test_wrong_arguments_are_named(wrong):
    with pytest.raises(ModelError, match=r"precision is|inputs is|P is 1 x 2"):
        accept(**{"design": static(GAIN), "plant": FOUR, **wrong})
    with pytest.raises(ModelError, match="fixed point has none"):
        accept(INTEGRATOR, FOUR, umin=-1, umax=1, antiwindup=[[0.5]], precision="q15")


def test_what_no_proof_reaches_is_not_judged(monkeypatch):
    """A proof that was not begun, and one that is impossible, say so and fail nothing."""
    monkeypatch.setattr(boxconditions, "PATIENCE", 0.0)
    found = accept(static(GAIN), uncertain(), requirements=asks(disk_margin=0.3, ncf_margin=0.2))
    late = [c for c in found.conditions if "not reached within 0 s" in c.note]
    assert [c.name for c in late] == ["disk margin over the box", "ncf margin over the box"]
    assert "not judged: disk margin over the box" in found.verdict
    large = StateSpace(0.5 * np.eye(21), np.ones((21, 1)), -0.01 * np.ones((1, 21)), [[-GAIN]], 1.0)
    line = next(c for c in accept(large, FOUR, requirements=NOTHING).conditions if c.name == "rounding (float32)")
    assert (line.passed, "pass inputs" in line.note) == (None, True)
