"""One self-contained HTML page for a study: requirements, claims, figures, files, provenance.

Figures are inline SVG whose ink is the page's own text colour, so that they follow light and dark; artists marked
`rasterized` become pictures inside. Nothing is fetched from anywhere.
"""

from __future__ import annotations

import html
import io
from collections.abc import Sequence
from typing import Any, NamedTuple

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure

INK = "#010203"  # stands for the page's text colour while a figure is drawn
STYLE: dict[Any, Any] = {
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=["#2b7fc3", "#e07b1a", "#2f9e52", "#c2459b", "#8a6fd1", "#a08a2a", "#7a7a7a"]),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": "medium",
    "figure.facecolor": "none",
    "font.size": 9,
    "grid.alpha": 0.25,
    "grid.color": "#888888",
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "savefig.facecolor": "none",
    "svg.fonttype": "none",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
}


class Claim(NamedTuple):
    """A statement of a paper and what became of it when measured."""

    text: str
    source: str  # section, table or figure
    verdict: str  # "holds", "does not hold", "depends on ...", "not measured"
    measured: str  # the figures behind the verdict


class Section(NamedTuple):
    """A heading and the HTML below it."""

    title: str
    body: str


def paragraph(text: str) -> str:
    """Plain text as HTML."""
    return f"<p>{html.escape(text)}</p>"


def table(headers: Sequence[str], rows: Sequence[Sequence[Any]], *, marks: Sequence[Sequence[str]] = ()) -> str:
    """A table; `marks` gives each cell a class: "pass", "fail" or ""."""
    head = "".join(f"<th>{html.escape(h)}</th>" for h in headers)
    lines = []
    for i, row in enumerate(rows):
        classes = marks[i] if marks else [""] * len(row)
        cells = (f'<td class="{c}">{html.escape(str(v))}</td>' for v, c in zip(row, classes, strict=True))
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table></div>'


def text_table(headers: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Aligned columns for the terminal."""
    widths = [max(len(str(row[j])) for row in (headers, *rows)) for j in range(len(headers))]
    return "\n".join("  ".join(str(v).ljust(w) for v, w in zip(row, widths, strict=True)) for row in (headers, *rows))


def claims_table(claims: Sequence[Claim]) -> str:
    """Every claim with its verdict and the figures behind it."""
    marks = {"holds": "pass", "does not hold": "fail"}
    rows = [(c.text, c.source, c.verdict, c.measured) for c in claims]
    return table(
        ("claim", "where", "verdict", "measured"), rows, marks=[["", "", marks.get(c.verdict, ""), ""] for c in claims]
    )


def figure(fig: Figure, caption: str, *, salt: str) -> str:
    """A matplotlib figure as inline SVG; `salt`, different for each figure of a page, keeps its ids apart."""
    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": salt, **STYLE}):
        fig.savefig(buffer, format="svg", metadata={"Date": None}, bbox_inches="tight", dpi=150)
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    label = html.escape(caption, quote=True)
    svg = svg.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
    return f"<figure>{svg}<figcaption>{html.escape(caption)}</figcaption></figure>"


def links(files: Sequence[tuple[str, str]]) -> str:
    """A list of files beside the page: (name, what it is)."""
    rows = (f'<li><a href="{html.escape(n, quote=True)}">{html.escape(n)}</a>: {html.escape(t)}</li>' for n, t in files)
    return f"<ul>{''.join(rows)}</ul>"


def page(title: str, subtitle: str, sections: Sequence[Section], provenance: Sequence[str]) -> str:
    """The whole page."""
    body = "".join(f"<section><h2>{html.escape(s.title)}</h2>{s.body}</section>" for s in sections)
    foot = "".join(f"<li>{html.escape(line)}</li>" for line in provenance)
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>{html.escape(title)}</title><style>{CSS}</style></head><body><main>"
        f'<header><h1>{html.escape(title)}</h1><p class="subtitle">{html.escape(subtitle)}</p></header>'
        f"{body}<footer><ul>{foot}</ul></footer></main></body></html>\n"
    )


CSS = """
:root { color-scheme: light dark; --back: #ffffff; --ink: #1c2430; --soft: #5c6878; --line: #d8dee6; --card: #f6f8fa;
  --good: #1a7f42; --bad: #c0322b; }
@media (prefers-color-scheme: dark) { :root { --back: #12161c; --ink: #e4e9f0; --soft: #9aa7b8; --line: #303a47;
  --card: #1a2029; --good: #56c27e; --bad: #f0807a; } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: 68rem; margin: 0 auto; padding: 1.5rem 1rem 3rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; padding-top: .6rem; border-top: 1px solid var(--line); }
.subtitle, figcaption, footer { color: var(--soft); }
a { color: inherit; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: .35rem .7rem .35rem 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); white-space: nowrap; }
td.pass { color: var(--good); } td.fail { color: var(--bad); }
figure { margin: 1.2rem 0; padding: .8rem; background: var(--card); border-radius: .5rem; }
figure svg { width: 100%; height: auto; color: var(--ink); }
figcaption { font-size: .88rem; margin-top: .4rem; }
pre { overflow-x: auto; background: var(--card); padding: .8rem; border-radius: .5rem; font-size: .85rem; }
footer { margin-top: 3rem; font-size: .8rem; border-top: 1px solid var(--line); }
footer ul { padding-left: 1.1rem; }
"""
