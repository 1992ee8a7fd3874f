"""Claims of a paper, the rules by which they are judged, and what became of them.

A rule is data: a quantity, a relation and a bound, written once. A claim is judged by readings, one for each case in
which the quantity was measured, with an interval where it is a matter of chance:

    Rule("control error over that of EKF + Hinf", "<", 1)
    [Reading("MPC velocity", 0.42, 0.38, 0.47), Reading("MPC position", 1.8, 1.6, 2.1)]

The claim holds if every reading is on its side of the bound with the whole of its interval, it does not if none is; if
some are it depends on the case, and an interval with the bound inside decides nothing.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isnan, nan
from operator import ge, gt, le, lt
from typing import Any, Literal, NamedTuple

from plants.errors import ScenarioError
from plants.outcome.report import Claim

Verdict = tuple[str, str]  # "holds", "does not hold", "depends on ..." or "not measured", and the figures behind it
OPPOSITE = {"<": ge, "<=": gt, ">": le, ">=": lt}
RELATIONS = {"<": (lt, "below"), "<=": (le, "at most"), ">": (gt, "above"), ">=": (ge, "at least")}
DRAWN, LEFT_OUT = "drawn", "left out"  # what becomes of a figure or table that states nothing
KINDS = ("holds", "depends on something", "does not hold", "not decided", "not measured", DRAWN, LEFT_OUT)


class Reading(NamedTuple):
    """What was measured in one case."""

    what: str  # the case, such as "MPC velocity"; "" if there is only one
    value: float
    low: float = nan  # ends of the interval of the value, 95 %; without them the value decides alone
    high: float = nan
    text: str = ""  # further figures

    def said(self, unit: str) -> str:
        """For the table."""
        value = f"{self.value:.4g}"
        if not isnan(self.low + self.high):
            value += f" ({self.low:.3g} to {self.high:.3g})"
        value = f"{value} {unit}".rstrip()
        return " ".join(part for part in (self.what, value, f"[{self.text}]" if self.text else "") if part)


@dataclass(frozen=True)
class Rule:
    """On which side of which bound a quantity has to be for a claim to hold.

    Raises
    ------
    ScenarioError
        The relation is none of "<", "<=", ">", ">=", or the bound is not a number.
    """

    quantity: str  # in words, such as "attitude knowledge error"
    relation: Literal["<", "<=", ">", ">="]
    bound: float
    unit: str = ""

    def __post_init__(self) -> None:
        if self.relation not in RELATIONS:
            raise ScenarioError(f"relation of the rule for {self.quantity}: {self.relation!r} is none of <, <=, >, >=")
        if isnan(self.bound):
            raise ScenarioError(f"bound of the rule for {self.quantity}: give a number")

    def __str__(self) -> str:
        return f"{self.quantity} {RELATIONS[self.relation][1]} {self.bound:.4g} {self.unit}".rstrip()

    def met(self, reading: Reading) -> bool | None:
        """Whether it is; None if the interval of the reading has the bound inside. A NaN meets nothing."""
        inside, outside = RELATIONS[self.relation][0], OPPOSITE[self.relation]
        if isnan(reading.low) or isnan(reading.high):
            return inside(reading.value, self.bound)
        ends = (reading.low, reading.high)
        if all(inside(end, self.bound) for end in ends):
            return True
        return False if all(outside(end, self.bound) for end in ends) else None

    def judge(self, readings: Sequence[Reading], depends: str) -> Verdict:
        """The verdict on readings of all cases, and the figures behind it; `depends` names what tells the cases apart.

        Raises
        ------
        IndexError
            There is no reading.
        """
        if not readings:
            raise IndexError(self.quantity)
        found = {self.met(reading) for reading in readings}
        verdict = {True: "holds", False: "does not hold", None: "not decided"}
        word = f"depends on {depends}" if {True, False} <= found else verdict[None if None in found else found.pop()]
        return word, "; ".join(reading.said(self.unit) for reading in readings)


class Statement(NamedTuple):
    """A claim of a paper, and the function that judges it by what was measured."""

    text: str
    source: str  # section, table or figure
    judge: Callable[[], Any]  # gives a Verdict, or with a rule the readings: Sequence[Reading]
    rule: Rule | None = None
    printed: str = ""  # the paper's own figure
    depends: str = "the case"  # what tells the readings apart
    why: str = ""  # why the verdict is what it is, a sentence


def judged(statements: Sequence[Statement]) -> list[Claim]:
    """Every claim with its verdict; those whose runs are missing are "not measured"."""
    claims = []
    for s in statements:
        try:
            verdict, measured = s.rule.judge(s.judge(), s.depends) if s.rule else s.judge()
        except (KeyError, IndexError) as missing:
            verdict, measured = "not measured", f"interrupted before {missing.args[0]}"
        claims.append(Claim(s.text, s.source, verdict, measured, s.printed, str(s.rule or ""), s.why))
    return claims


def either(first: bool, second: bool, dependence: str) -> str:
    """The verdict "holds" when it does in both cases, "depends on ..." when in one."""
    if first and second:
        return "holds"
    return f"depends on {dependence}" if first or second else "does not hold"


def drawn(source: str, text: str, where: str) -> Claim:
    """A figure or a table of the paper that states nothing, and `where` in the report its counterpart is."""
    return Claim(text, source, DRAWN, where)


def left_out(source: str, text: str, why: str) -> Claim:
    """A figure, a table or a claim of the paper without a counterpart, and the reason."""
    return Claim(text, source, LEFT_OUT, "", why=why)


def counted(claims: Sequence[Claim]) -> Counter[str]:
    """How many lines there are of each of `KINDS`."""
    return Counter(KINDS[1] if claim.verdict.startswith("depends") else claim.verdict for claim in claims)


def stored_claims(paper: str, claims: Sequence[Claim], settings: str, complete: bool) -> str:
    """The claims of a paper as JSON, which `claimspage.read_claims` reads."""
    rows = [claim._asdict() for claim in claims]
    return json.dumps({"paper": paper, "settings": settings, "complete": complete, "claims": rows}, indent=1) + "\n"
