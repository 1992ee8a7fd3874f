"""One self-contained HTML page for a study: requirements, claims, figures, controllers, files, provenance.

The page is read on a phone and on paper as well: wide tables scroll or turn into stacked rows, light and dark follow
the reader's setting, and what is met or not is said by a sign and a word, not by colour alone. Figures are inline SVG
whose ink is the page's own text colour; artists marked `rasterized` become pictures inside. Nothing is fetched from
anywhere, and nothing is a program.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from itertools import count
from types import MappingProxyType
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from plants.outcome.inline import BOUND as BOUND
from plants.outcome.inline import COLOURS as COLOURS
from plants.outcome.inline import INK as INK
from plants.outcome.inline import STYLE as STYLE
from plants.outcome.inline import figure as figure
from plants.outcome.page_style import CSS

POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"  # of the browser: no program, nothing fetched
SIGNS = {"pass": ("&#10003;", "met"), "fail": ("&#10007;", "not met")}  # sign, and the word that is read aloud
VERDICTS = {"holds": ("pass", "&#10003;"), "does not hold": ("fail", "&#10007;"), "drawn": ("pass", "&#10003;")}
VERDICTS |= dict.fromkeys(("not measured", "not decided", "left out"), ("none", "&#8211;"))
NUMBER = re.compile(r"(?P<whole>[+-]?\d+)(?P<decimals>\.\d+)?(e[+-]\d+)?( ?[%a-zA-Z]{1,3}|/\d+)?")
WORD = 10  # letters of a word that may stand among numbers, such as "never"
DEPENDS = ("part", "&#8776;")  # of a verdict that depends on something


class Html(str):
    """Text that is HTML already; other text is escaped."""


class Claim(NamedTuple):
    """A statement of a paper and what became of it when measured."""

    text: str
    source: str  # section, table or figure
    verdict: str  # "holds", "does not hold", "depends on ...", "not decided", "not measured", "drawn", "left out"
    measured: str  # the figures behind the verdict
    printed: str = ""  # the paper's own figure
    rule: str = ""  # when it holds, in words
    why: str = ""  # why the verdict is what it is


class Requirement(NamedTuple):
    """A figure and its limit; a NaN meets nothing."""

    name: str
    value: float
    bound: float
    unit: str
    least: bool = False  # the bound is a least value, not a largest

    @property
    def met(self) -> bool:
        """Whether the value is on the right side of the bound, or on it."""
        return bool(self.value >= self.bound) if self.least else bool(self.value <= self.bound)

    @property
    def margin(self) -> float:
        """What is left up to the bound, % of the bound; negative if it is not met."""
        left = self.value - self.bound if self.least else self.bound - self.value
        return 100 * left / abs(self.bound) if self.bound else float("nan")

    @property
    def required(self) -> str:
        """The bound in words."""
        return f"{'at least' if self.least else 'at most'} {self.bound:.4g} {self.unit}".rstrip()

    def __str__(self) -> str:
        """For the terminal."""
        verdict = f"margin {percent(self.margin)}, {'met' if self.met else 'NOT MET'}"
        return f"{self.name} {self.value:.4g} {self.unit} ({self.required}): {verdict}"


class Card(NamedTuple):
    """A controller at a glance: any facts, and the files beside the page."""

    name: str
    facts: Sequence[tuple[str, Any]]  # such as ("verified norm", "0.9994")
    files: Sequence[tuple[str, str]] = ()  # (file beside the page, what it is)
    note: str = ""


class Section(NamedTuple):
    """A heading, the HTML below it, and the files beside the page that it offers."""

    title: str
    body: str
    files: Mapping[str, str] = MappingProxyType({})  # name -> text


def paragraph(text: str) -> str:
    """Plain text as HTML."""
    return f"<p>{html.escape(text)}</p>"


def table(
    headers: Sequence[str],
    rows: Sequence[Sequence[Any]],
    *,
    marks: Sequence[Sequence[str]] = (),
    label: str = "",
    stacked: bool = False,
) -> str:
    """A table whose first column names its rows.

    Parameters
    ----------
    headers : of the columns
    rows : of text, or of `Html`
    marks : for each cell "pass", "fail" or "": a colour and a sign
    label : what the table is, read aloud; the first header by default
    stacked : on a phone every row becomes a block of "header: value" lines, for tables of sentences; other tables
        scroll sideways there
    """
    # the roles are those of the elements, but a table that is not displayed as one would lose them
    columns = [_aligned([row[j] for row in rows]) for j in range(1, len(headers))]
    kinds = ["", *(' class="number"' if column else "" for column in columns)]
    heads = zip(headers, kinds, strict=True)
    head = "".join(f'<th role="columnheader" scope="col"{kind}>{_text(h)}</th>' for h, kind in heads)
    lines = []
    for i, row in enumerate(rows):
        classes = marks[i] if marks else [""] * len(row)
        first = f'<th role="rowheader" scope="row">{_text(row[0])}</th>'
        cells = [
            _cell(column[i] if column else value, f"{mark} number".strip() if column else mark, header)
            for value, mark, header, column in zip(row[1:], classes[1:], headers[1:], columns, strict=True)
        ]
        lines.append(f'<tr role="row">{first}{"".join(cells)}</tr>')
    name = html.escape(label or f"Table: {headers[0]}", quote=True)
    kind = "stacked" if stacked else "wide"
    return (
        f'<div class="scroll" role="region" aria-label="{name}" tabindex="0"><table class="{kind}" role="table">'
        f'<thead role="rowgroup"><tr role="row">{head}</tr></thead><tbody role="rowgroup">{"".join(lines)}</tbody>'
        "</table></div>"
    )


def text_table(headers: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Aligned columns for the terminal."""
    widths = [max(len(str(row[j])) for row in (headers, *rows)) for j in range(len(headers))]
    return "\n".join("  ".join(str(v).ljust(w) for v, w in zip(row, widths, strict=True)) for row in (headers, *rows))


def claims_table(claims: Sequence[Claim]) -> str:
    """Every claim with its verdict and the figures behind it."""
    rows = []
    for claim in claims:
        mark, sign = VERDICTS.get(claim.verdict, DEPENDS)
        verdict = Html(
            f'<span class="verdict {mark}"><span aria-hidden="true">{sign}</span> {html.escape(claim.verdict)}</span>'
        )
        readings = claim.measured.split("; ") if claim.rule else [claim.measured]  # a line for each case
        details = (("printed", claim.printed), ("holds if", claim.rule), ("why", claim.why))
        lines = [html.escape(reading) for reading in readings if reading]
        lines += [f'<span class="detail">{html.escape(f"{name}: {text}")}</span>' for name, text in details if text]
        rows.append((claim.text, claim.source, verdict, Html("<br>".join(lines))))
    return table(("claim", "where", "verdict", "measured"), rows, label="Claims and verdicts", stacked=True)


def requirements_table(requirements: Sequence[Requirement]) -> str:
    """Value, requirement and margin of each; the bar is the part of the requirement that is used up."""
    rows = []
    for r in requirements:
        mark = "pass" if r.met else "fail"
        sign, word = SIGNS[mark]
        used = r.bound / r.value if r.least and r.value else r.value / r.bound if r.bound else np.nan
        width = 100 * float(np.clip(used, 0, 1)) if np.isfinite(used) else 100.0
        bar = f'<span class="bar {mark}" aria-hidden="true"><span style="width:{width:.0f}%"></span></span>'
        verdict = f'<span class="verdict {mark}"><span aria-hidden="true">{sign}</span> {word}</span>'
        rows.append((
            r.name, f"{r.value:.4g} {r.unit}", r.required,
            Html(f'{percent(r.margin)} {bar} <span class="detail">{_used(used)}</span>'), Html(verdict),
        ))  # fmt: skip
    headers = ("requirement", "measured", "required", "margin left", "verdict")
    return table(headers, rows, label="Requirements and margins", stacked=True)


def definitions(words: Mapping[str, str]) -> str:
    """Short forms and what they stand for."""
    rows = "".join(f"<div><dt>{_text(short)}</dt><dd>{_text(text)}</dd></div>" for short, text in words.items())
    return f'<dl class="definitions">{rows}</dl>'


def cards(cards: Sequence[Card]) -> str:
    """Controllers side by side."""
    found = []
    for card in cards:
        facts = "".join(f"<div><dt>{_text(k)}</dt><dd>{_text(v)}</dd></div>" for k, v in card.facts)
        note = paragraph(card.note) if card.note else ""
        found.append(
            f'<article class="card"><h3>{_text(card.name)}</h3><dl>{facts}</dl>{note}'
            f"{links(card.files) if card.files else ''}</article>"
        )
    return f'<div class="cards">{"".join(found)}</div>'


def links(files: Sequence[tuple[str, str]]) -> str:
    """A list of files beside the page: (name, what it is)."""
    rows = (f'<li><a href="{quote(n)}" download>{html.escape(n)}</a>: {html.escape(t)}</li>' for n, t in files)
    return f'<ul class="files">{"".join(rows)}</ul>'


def page(
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    provenance: Sequence[str],
    *,
    highlights: Sequence[tuple[str, str]] = (),
    summary: str = "",
) -> str:
    """The whole page.

    Parameters
    ----------
    title, subtitle : at its head
    sections : in order, listed in the contents
    provenance : lines at its foot
    highlights : (figure, what it counts), in large letters below the title
    summary : what a reader should take away, a sentence below the subtitle
    """
    names = _anchors([s.title for s in sections])
    body = "".join(
        f'<section aria-labelledby="{name}"><h2 id="{name}">{html.escape(s.title)}</h2>{s.body}</section>'
        for name, s in zip(names, sections, strict=True)
    )
    entries = [*zip(names, (s.title for s in sections), strict=True), ("provenance", "Provenance")]
    contents = "".join(f'<li><a href="#{name}">{html.escape(text)}</a></li>' for name, text in entries)
    tiles = "".join(f"<div><dt>{_text(what)}</dt><dd>{_text(figure)}</dd></div>" for figure, what in highlights)
    foot = "".join(f"<li>{html.escape(line)}</li>" for line in provenance)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title><style>{CSS}</style></head><body>"
        '<a class="skip" href="#content">Skip to the content</a>'
        f'<header><h1>{html.escape(title)}</h1><p class="subtitle">{html.escape(subtitle)}</p>'
        f"{f'<p class=summary>{html.escape(summary)}</p>' if summary else ''}"
        f"{f'<dl class=tiles>{tiles}</dl>' if tiles else ''}"
        f'<nav aria-label="Contents"><ul>{contents}</ul></nav></header>'
        f'<main id="content">{body}</main>'
        f'<footer><h2 id="provenance">Provenance</h2><ul>{foot}</ul></footer></body></html>\n'
    )


def _text(value: Any) -> str:
    """Anything as HTML."""
    return value if isinstance(value, Html) else html.escape(str(value))


def _aligned(column: Sequence[Any]) -> list[Html]:
    """The texts of a column of numbers, their decimals under each other; empty if the column is none."""
    texts = ["" if isinstance(value, Html) else str(value) for value in column]
    parts = [NUMBER.fullmatch(text) for text in texts]
    words = [text for text, part in zip(texts, parts, strict=True) if not part]
    if not any(parts) or any(isinstance(value, Html) for value in column) or any(len(w) > WORD for w in words):
        return []
    most = max(len(part["decimals"] or ".") - 1 for part in parts if part)  # decimals
    found = []
    for text, part in zip(texts, parts, strict=True):
        end = part.end("decimals" if part["decimals"] else "whole") if part else len(text)
        unseen = f".{'0' * most}"[len(part["decimals"] or "") :] if part and most else ""
        pad = f'<span class="pad" aria-hidden="true">{unseen}</span>' if unseen else ""
        found.append(Html(html.escape(text[:end]) + pad + html.escape(text[end:])))
    return found


def _cell(value: Any, mark: str, header: str) -> str:
    """A cell with its sign; the header is shown beside it when the row is stacked."""
    sign = ""
    if (word := mark.split(" ")[0]) in SIGNS:
        glyph, word = SIGNS[word]
        sign = f' <span class="sign" role="img" aria-label="{word}">{glyph}</span>'
    label = html.escape(header, quote=True)
    return f'<td role="cell" class="{mark}" data-label="{label}"><span>{_text(value)}{sign}</span></td>'


def percent(margin: float) -> str:
    """A margin in words that fit a column."""
    if not np.isfinite(margin):
        return "none" if margin < 0 else "undefined" if np.isnan(margin) else "unlimited"
    return f"{margin:+.0f} %"


def _used(part: float) -> str:
    """How much of a requirement is used up, beside its bar."""
    return f"{100 * part:.0f} % used" if np.isfinite(part) else ""


def _anchors(titles: Sequence[str]) -> list[str]:
    """A different id for each title."""
    found = ["content", "provenance"]  # ids that the page uses itself
    for title in titles:
        name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "section"
        again = (f"{name}-{k}" for k in count(2))
        found.append(name if name not in found else next(other for other in again if other not in found))
    return found[2:]
