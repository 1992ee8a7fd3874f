"""Gains between the samples: those of a slow loop are the sampled ones, those of a fast mode are not."""

import numpy as np
import pytest

import synth
from plants.outcome import intersample
from plants.outcome.boxes import Question
from plants.simulation.linearize import LinearModel
from plants.simulation.uncertain import UncertainModel


def question(dt: float) -> Question:
    """A rigid body under PD, beside a mode at 2 pi rad/s that its output sees and its law does not."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1
    A[3, 2:] = -((2 * np.pi) ** 2), -0.1
    B, C = np.array([[0.0], [1.0], [0.0], [30.0]]), np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [1.0, 0, 1.0, 0]])
    linear = LinearModel(A, B, C, np.zeros((3, 1)))
    law = synth.StateSpace.gain([[-0.04, -0.3, 0.0]], dt)
    one, none = np.ones(1), np.zeros((1, 1))
    model = UncertainModel(("mass",), one, one, one, none, none, none, none)
    return Question("PD", "pd", model, lambda p: linear, law, np.array([[0.0, 0.0, 1.0]]))


def test_slow_samples_do_not_see_a_mode_of_their_own_period():
    """Sampled once a period, the mode stands still; at all times it swings."""
    sampled, always = intersample.gains(question(1.0), synth)
    assert always > 1.2 * sampled
    sampled, always = intersample.gains(question(0.01), synth)
    assert always == pytest.approx(sampled, rel=1e-2)
    assert always >= sampled * (1 - 1e-6)


def test_the_table():
    (table,) = intersample.tables([question(1.0)], synth, quantity="Gain, rad per N m")
    assert table.title == "Between the samples"
    (row,) = table.rows
    assert row[:2] == ("PD", "1")
    assert row[-1].startswith("+")
    assert intersample.tables([], synth, quantity="") == []
