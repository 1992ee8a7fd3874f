"""The worst flight of a study beside its Monte Carlo: what is asked, and how the report shows it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from plants.outcome import figures
from plants.outcome.study import Table
from plants.simulation.batch import Case
from plants.simulation.loop import Run
from plants.simulation.sensitivity import Objective
from plants.simulation.worstflights import WorstFlights, worst_flights

TITLE = "Worst flights beside the Monte Carlo"
BESIDE, FOUND = "worst of the Monte Carlo", "worst found"


class Question(NamedTuple):
    """What a study wants to know the worst of; the first seven fields are those of `worst_flights`."""

    case: Case
    box: Any  # (lower, upper)
    objective: Objective
    shared: Any
    drawn: Any  # dispersions (m, ...) of the Monte Carlo, from the same box
    name: str  # of the objective and its circumstances, in words
    unit: str  # of the objective
    history: Callable[[Run], np.ndarray]  # (N,) what the figure shows of a flight
    label: str  # of the history
    spelled: Callable[[Any], str]  # a dispersion in words
    scale: str = "linear"  # of the history


class Answer(NamedTuple):
    """What was found."""

    question: Question
    found: WorstFlights


def ask(question: Question, into: list[Answer], *, seed: int = 0, progress: bool = True, **options: Any) -> None:
    """The search, with the Monte Carlo flown beside it by the same program; options of `worst_flights`.

    The answer is in `into`, also when Ctrl-C ends the search, which raises `KeyboardInterrupt` as elsewhere in a study.
    Slopes come from differences of flights unless asked otherwise: one search takes less than forward mode compiles.
    """
    found = worst_flights(
        question.case, question.box, question.objective, question.shared, beside=question.drawn, seed=seed,
        **{"forward": False, "progress": progress, **options},
    )  # fmt: skip
    into.append(Answer(question, found))
    if not found.complete:
        raise KeyboardInterrupt


def tables(answers: Sequence[Answer]) -> list[Table]:
    """One table of all answers, none without any: both worsts, what they took, where they begin, both over time."""
    rows, notes, drawn = [], [], []
    for question, found in answers:
        beside, run = found.beside, found.beside_run
        assert beside is not None
        assert run is not None
        rows.append((
            f"{question.name}, {question.unit}", spelled(float(beside.max()), run), str(len(beside)),
            spelled(found.value, found.run), str(found.flights),
        ))  # fmt: skip
        notes.append(f"The worst found, {question.name}, begins at {question.spelled(found.worst)}.")
        notes += [] if found.complete else ["The search was interrupted."]
        flown = {name: r for name, r in ((BESIDE, run), (FOUND, found.run)) if len(r.time)}
        series = {name: (r.time, question.history(r)[:, None]) for name, r in flown.items()}
        fig = figures.histories(series, [question.label], scale=question.scale)
        drawn.append((fig, f"{question.name}: both flights."))
    note = " ".join([*notes, "A flight, not a probability: draws seldom meet it."])
    headers = ("largest", BESIDE, "draws", FOUND, "flights spent")
    return [Table(TITLE, headers, rows, note=note, drawn=drawn)] if rows else []


def spelled(value: float, run: Run) -> str:
    """A value, or how the flight failed."""
    return f"{value:.4g}" if run.ok else f"fails at {run.failed_at:.4g} s ({run.culprit})"
