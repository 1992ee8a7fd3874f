"""Worst cases of a study's loops over boxes of parameters: what is asked, and how the page shows what was proved.

The loop of a question is y = G(d) (u + v), u = K y, sampled with a held input by the midpoint rule: of which v is a
disturbance at the plant's input, and what is shown is a part of y. The proofs are `synth`'s, which this package does
not know: `ask` is handed it as a module. Certificates are written beside the page, where `synth verify` checks them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from plants.outcome.study import Table
from plants.simulation.linearize import LinearModel
from plants.simulation.uncertain import UncertainModel

STABILITY, GAIN = "Stability over boxes of parameters", "Worst gain over boxes of parameters"


class Bounds(Protocol):
    """What is known of a gain or of a stability margin from both sides, such as `synth.WorstCase`."""

    lower: float
    upper: float
    parameters: dict[str, float]
    note: str
    certificate: Any  # None where nothing is proved; otherwise it has `save`


class Question(NamedTuple):
    """A linear controller around an uncertain plant, all parameters of which have the same relative deviation."""

    controller: str
    stem: str  # of the names of its files
    model: UncertainModel  # of the plant; its box is what the stability margin counts in
    linear: Callable[[np.ndarray], LinearModel]  # of the simulator's plant with concrete parameters (n,)
    law: Any  # discrete system from y to u, positive feedback
    shown: np.ndarray  # (k, ny) of the output
    gains: Sequence[float] = ()  # relative deviations over which the worst gain is wanted

    @property
    def widest(self) -> float:
        """Relative deviation of the model's box."""
        return float(self.model.high[0] / self.model.nominal[0] - 1)


class Answer(NamedTuple):
    """What was found."""

    question: Question
    norm: float  # gain at the nominal parameters
    margin: Bounds
    gains: dict[float, Bounds]  # by relative deviation
    there: dict[float, float]  # gain at their worst parameters, of the simulator's plant with an exact hold
    seconds: float  # of the processor

    @property
    def stable(self) -> float:
        """Relative deviation up to which all loops are proved stable."""
        return self.margin.lower * self.question.widest

    @property
    def lost(self) -> float:
        """Relative deviation at which one is not."""
        return self.margin.upper * self.question.widest


def ask(
    questions: Sequence[Question], into: list[Answer], synth: Any, *, tol: float = 1e-3, boxes: int = 20_000
) -> None:
    """Prove what is asked; the answers are in `into`, also when Ctrl-C ends it.

    Parameters
    ----------
    synth : the module: `ureal`, `UncertainSystem`, `StateSpace`, `c2d`, `feedback`, `series`, `hinfnorm`,
        `worst_gain`, `stability_margin`
    tol : relative distance of bounds that is aimed at
    boxes : that a proof may need
    """

    def uncertain(q: Question, within: float) -> Any:
        G = synth.c2d(synth.UncertainSystem(*q.model.over(synth.ureal, within)), q.law.dt, "midpoint")
        return G.feedback(q.law, 1).series(q.shown)

    def measured(q: Question, parameters: dict[str, float]) -> float:
        p = np.array([parameters.get(name, x) for name, x in zip(q.model.names, q.model.nominal, strict=True)])
        G = synth.c2d(synth.StateSpace(*q.linear(p)), q.law.dt)
        return synth.hinfnorm(synth.series(synth.feedback(G, q.law, 1), q.shown))[0]

    for q in questions:
        begun = time.process_time()
        gains = {within: synth.worst_gain(uncertain(q, within), tol=tol, boxes=boxes) for within in q.gains}
        margin = synth.stability_margin(uncertain(q, q.widest), tol=tol, boxes=boxes)
        there = {within: measured(q, found.parameters) for within, found in gains.items()}
        into.append(Answer(q, measured(q, {}), margin, gains, there, time.process_time() - begun))


def tables(answers: Sequence[Answer], out: Path, *, quantity: str, model: str) -> list[Table]:
    """Margins and gains, none without answers; the certificates are written into `out`.

    Parameters
    ----------
    out : folder of the page
    quantity : what the gains are, with their unit
    model : what the loops are models of, and how exactly, in sentences
    """
    if not answers:
        return []
    margins, gains = [], []
    for a in answers:
        lost = (rounded(100 * a.lost, 3, up=True), deviations(a, a.margin)) if a.margin.parameters else ("none", "")
        within = rounded(100 * a.stable, 3, up=False) if a.margin.certificate is not None else "not proved"
        margins.append((a.question.controller, within, *lost))
        for part, found in a.gains.items():
            gains.append((
                a.question.controller, percent(part), f"{a.norm:.5g}", proved(found),
                "not stable" if np.isinf(found.lower) else rounded(found.lower, 5, up=False), deviations(a, found),
                "not stable" if np.isinf(a.there[part]) else f"{a.there[part]:.5g}",
            ))  # fmt: skip
    why = "Proved, of the model and of every point of a box, is what a certificate says; synth verify proves it again."
    seconds = f"{sum(a.seconds for a in answers):.1f} s of the processor."
    each = f"How far off all parameters may be at once, each to either side. {model} {why}"
    both = [a.margin for a in answers], [found for a in answers for found in a.gains.values()]
    left = [" ".join(sorted({f"{found.note}.".capitalize() for found in several if found.note})) for several in both]
    named = (
        [(a.question, "margin", a.margin) for a in answers],
        [(a.question, f"{100 * part:.3g}", found) for a in answers for part, found in a.gains.items()],
    )
    files = [saved(several, out) for several in named]
    headers = ("controller", "proved stable within, %", "not stable at, %", "with")
    found = [Table(STABILITY, headers, margins, note=f"{each} {left[0]} {seconds}".replace("  ", " "), files=files[0])]
    if gains:
        headers = ("controller", "box", "nominal", "proved below", "reached", "with", "the simulator's plant there")
        note = f"{quantity}: the largest of all frequencies and parameters. {left[1]}".rstrip()
        found.append(Table(GAIN, headers, gains, note=note, files=files[1]))
    return found


def saved(named: Sequence[tuple[Question, str, Bounds]], out: Path) -> list[tuple[str, str]]:
    """Certificates in `out`, and what they are."""
    files = []
    for question, kind, found in named:
        if found.certificate is not None:
            path = out / f"box_{question.stem}_{kind}.json"
            found.certificate.save(path)
            what = "stability" if kind == "margin" else f"gain over ±{kind} %"
            files.append((path.name, f"certificate of {question.controller}: {what}"))
    return files


def proved(found: Bounds) -> str:
    """The level below which a gain is proved to be."""
    if np.isinf(found.lower):
        return "nothing"
    return rounded(found.upper, 5, up=True) if found.certificate is not None else "not proved"


def findings(answers: Sequence[Answer], whose: str) -> list[str]:
    """One sentence of what the answers say, none without a proof; `whose` parameters they are, such as "moments"."""
    answers = [a for a in answers if a.margin.certificate is not None]
    if not answers:
        return []
    most, least = max(answers, key=lambda a: a.stable), min(answers, key=lambda a: a.stable)
    lost = f", and is not at {percent(least.lost, up=True)}" if least.margin.parameters else ""
    if percent(most.stable) == percent(least.stable):
        text = f"every loop is proved stable within {percent(least.stable)} of each{lost.replace('is not', 'none is')}"
    else:
        text = (
            f"{most.question.controller} is proved stable within {percent(most.stable)} of each, "
            f"{least.question.controller} within {percent(least.stable)}{lost}"
        )
    grown = [
        (found.upper / a.norm - 1, part, a) for a in answers for part, found in a.gains.items() if found.certificate
    ]
    if grown:
        told = [min(grown, key=lambda g: g[0]), max(grown, key=lambda g: g[0])]
        grows = [f"{100 * g:.2g} % for {a.question.controller} over {percent(part)}" for g, part, a in told]
        text += f"; the worst gain is above the nominal one by at most {' and '.join(dict.fromkeys(grows))}"
    return [f"With all {whose} off at once, {text}."]


def percent(part: float, up: bool = False) -> str:
    """A relative deviation to both sides, three digits, rounded down or up."""
    return f"±{rounded(100 * part, 3, up=up)} %" if np.isfinite(part) else "any"


def rounded(value: float, digits: int, *, up: bool) -> str:
    """Significant digits, rounded to the side on which a bound still holds."""
    number = Decimal(value)
    last = number.adjusted() - digits + 1
    text = number.quantize(Decimal((0, (1,), last)), rounding=ROUND_CEILING if up else ROUND_FLOOR)
    return f"{float(text):.{digits}g}"


def deviations(answer: Answer, found: Bounds) -> str:
    """Parameters as deviations from their nominal values."""
    nominal = dict(zip(answer.question.model.names, answer.question.model.nominal, strict=True))
    off = {name: 100 * (value / nominal[name] - 1) for name, value in found.parameters.items()}
    return ", ".join(f"{name} {value:+.3g} %" for name, value in off.items())
