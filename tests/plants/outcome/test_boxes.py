"""What a study asks about boxes of parameters: bounds on both sides, certificates beside the page, honest rounding."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import synth
from plants import LinearModel, UncertainModel
from plants.outcome import boxes
from plants.outcome.boxes import Question, rounded
from synth import StateSpace
from synth.proof.boxcertificate import BoxCertificate

DT, J = 0.2, 2.0


def linear(p):
    return LinearModel(np.array([[0, 1], [0, 0.0]]), np.array([[0], [1 / p[0]]]), np.eye(2), np.zeros((2, 1)))


def model(within):
    """J th'' = u."""
    E = np.array([np.diag([1, J]), np.diag([0.0, 1])])
    A, B = np.array([[[0, 1], [0, 0.0]], np.zeros((2, 2))]), np.array([[[0], [1.0]], np.zeros((2, 1))])
    nominal = np.array([J])
    return UncertainModel(
        ("J",), nominal, nominal * (1 - within), nominal * (1 + within), np.array([[0], [1]]), E, A, B, 0
    )


def question(name, gain, gains=(0.1, 0.5), within=0.5):
    law = StateSpace.gain(-np.array([gain]), DT)
    return Question(name, name, model(within), linear, law, np.array([[1.0, 0.0]]), gains)


SOFT, HARD = question("soft", (1.0, 2.0)), question("hard", (3.0, 13.0))


@pytest.fixture(scope="module")
def answers():
    found = []
    boxes.ask([SOFT, HARD], found, synth)
    return found


def test_what_is_proved_encloses_what_the_simulators_plant_has(answers):
    """An axis of a body is sampled exactly: what is proved of the model is above every sample of the plant itself."""
    soft, hard = answers
    for part, bounds in soft.gains.items():
        assert bounds.lower <= bounds.upper <= bounds.lower * (1 + 2e-3)
        assert soft.there[part] == pytest.approx(bounds.lower, rel=1e-6)
        for scale in np.linspace(1 - part, 1 + part, 9):
            G = synth.c2d(StateSpace(*linear([J * scale])), DT)
            loop = synth.series(synth.feedback(G, SOFT.law, 1), SOFT.shown)
            assert synth.hinfnorm(loop)[0] <= bounds.upper
    assert soft.norm == pytest.approx(1.0, rel=0.2)
    assert soft.stable <= 1.0  # a mass that vanishes ends stability
    # a hold makes the rate gain unstable from k dt / J = 2 on, a little sooner with the position's
    assert 0.2 < hard.stable <= hard.lost < 0.4
    assert hard.lost == pytest.approx(hard.stable, rel=2e-3)
    assert hard.gains[0.5].lower == np.inf
    assert hard.there[0.5] == np.inf


def test_pages_name_what_is_proved_and_offer_the_certificates(answers, tmp_path):
    stability, gain = boxes.tables(answers, tmp_path, quantity="Gain, rad per N m", model="Of a body.")
    assert [row[0] for row in stability.rows] == ["soft", "hard"]
    assert [row[:2] for row in gain.rows] == [(n, b) for n in ("soft", "hard") for b in ("±10 %", "±50 %")]
    assert gain.rows[3][3:5] == ("nothing", "not stable")
    assert "J -" in gain.rows[3][5]
    files = [name for table in (stability, gain) for name, _ in table.files]
    assert sorted(files) == sorted(path.name for path in tmp_path.iterdir())
    assert len(files) == 2 + 3  # none of a gain that is not bounded
    for name in files:
        BoxCertificate.load(tmp_path / name).check()
        assert f'href="{name}"' in stability.section().body + gain.section().body
    (sentence,) = boxes.findings(answers, "inertia")
    assert sentence.startswith("With all inertia off at once, soft is proved stable within ±89.9 % of each")
    assert "hard within ±34.9 %, and is not at ±35 %" in sentence
    assert "s of the processor" in stability.note


def test_without_answers_there_is_nothing(tmp_path):
    assert boxes.tables([], tmp_path, quantity="", model="") == []
    assert boxes.findings([], "inertia") == []
    only = []
    boxes.ask([question("soft", (1.0, 2.0), ())], only, synth)
    assert len(boxes.tables(only, tmp_path, quantity="", model="")) == 1


@given(st.floats(1e-9, 1e9), st.integers(1, 6))
def test_a_bound_is_rounded_to_the_side_on_which_it_holds(value, digits):
    down, up = (float(rounded(value, digits, up=up)) for up in (False, True))
    assert down <= value <= up
    assert up - down <= 1.0001 * 10 ** (np.floor(np.log10(value)) + 1 - digits)
