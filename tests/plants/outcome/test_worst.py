"""The section on the worst flight: both worsts, what they took, a flight that fails, an interruption."""

import html
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from flown import Pendulum, Swing, pd

from plants.outcome import report, worst
from plants.outcome.study import Study
from plants.simulation.loop import Loop, Scenario
from plants.simulation.sensitivity import Response


class Start(NamedTuple):
    angle: Any
    rate: Any


def case(start, bound):
    loop = Loop(plant=Pendulum(), controller=pd(1.0, 0.2))
    return loop, Scenario(initial=Swing(start.angle, start.rate), dt=0.05, periods=30, bound=bound)


def fastest(run):
    return jnp.abs(run.outputs[:, 1]).max()


def question(bound=1e9, scale="linear"):
    return worst.Question(
        case=case,
        box=(Start(-1.0, -1.0), Start(1.0, 1.0)),
        objective=fastest,
        shared=bound,
        drawn=Start(np.linspace(0, 0.5, 5), np.zeros(5)),
        name="rate of <pendulum>",
        unit="rad/s",
        history=lambda run: np.abs(run.outputs[:, 1]) + 1e-3,
        label="rate, rad/s",
        spelled=lambda start: f"{start.angle:.1f} rad, {start.rate:.1f} rad/s",
        scale=scale,
    )


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_both_worsts_are_told_and_drawn(scale):
    answers = []
    worst.ask(question(scale=scale), answers, flights=16, rounds=2, progress=False)
    (table,) = worst.tables(answers)
    found = answers[0].found
    assert found.value > found.beside.max()
    row = table.rows[0]
    assert [row[1], row[2], row[3]] == [f"{found.beside.max():.4g}", "5", f"{found.value:.4g}"]
    assert f"begins at {question().spelled(found.worst)}" in table.text()
    section = table.section()
    assert section.body.count("<figure>") == 1
    assert html.escape("rate of <pendulum>") in section.body
    assert "mathdefault" not in section.body
    assert worst.FOUND in section.body
    assert "probability" in report.page("title", "", [section], [])


def test_a_flight_that_fails_is_told():
    answers = []
    worst.ask(question(bound=2.5), answers, flights=16, rounds=2, progress=False)
    (table,) = worst.tables(answers)
    assert table.rows[0][3].startswith("fails at ")
    assert table.rows[0][3].endswith("s (plant)")
    table.section()


def test_an_interruption_is_told_and_goes_on(monkeypatch):
    def interrupted(self, points, values):
        raise KeyboardInterrupt

    monkeypatch.setattr(Response, "slopes", interrupted)
    found = Study()
    with pytest.raises(KeyboardInterrupt):
        worst.ask(question(), found.worst, flights=16, progress=False)
    (table,) = worst.tables(found.worst)
    assert "interrupted" in table.note


def test_without_an_answer_there_is_no_table():
    assert worst.tables([]) == []
