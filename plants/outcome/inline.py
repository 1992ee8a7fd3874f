"""Figures of a page: inline SVG in the page's own ink, which can be enlarged, and the data of their lines as CSV."""

from __future__ import annotations

import html
import io
import re
from typing import Any
from urllib.parse import quote

import matplotlib as mpl
import numpy as np
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

INK = "#010203"  # stands for the page's text colour while a figure is drawn
COLOURS = ("#2b7fc3", "#c9660c", "#2b8f4b", "#c2459b", "#8467d0", "#8c7718", "#7a7a7a")
BOUND = "#d23f38"  # of requirements in figures
LARGEST = 1.35  # width of a figure on the page over the width it was drawn for
STYLE: dict[Any, Any] = {
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.prop_cycle": cycler(color=COLOURS),
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


def figure(fig: Figure, caption: str, *, salt: str, alternative: str = "", data: str = "") -> str:
    """A matplotlib figure as inline SVG.

    Parameters
    ----------
    fig : drawn with `STYLE`
    caption : below it
    salt : different for each figure of a page, keeps its ids apart
    alternative : what is read aloud in place of the picture; by default that it is one, with its caption
    data : the file beside the page that holds its `csv`; none is offered by default
    """
    for text in fig.findobj(Text):
        if isinstance(text, Text) and "mathdefault" not in text.get_text():  # which is a number beside an axis
            text.set_parse_math(False)  # names are shown as they are
    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": salt, **STYLE}):
        fig.savefig(
            buffer,
            format="svg",
            metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")),
            bbox_inches="tight",
            dpi=150,
        )
    svg = buffer.getvalue()
    svg = svg[svg.index("<svg") :].replace(INK, "currentColor")
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)  # nothing refers to groups, whose names are the same in all figures
    label = html.escape(alternative or f"Figure: {caption}", quote=True)
    width = float(svg.split('width="')[1].split("pt")[0])
    opening = f'<svg role="img" aria-label="{label}" style="max-width:{LARGEST * width:.0f}pt" '
    svg = svg.replace("<svg ", opening, 1)
    frame = f'<div class="scroll" role="group" aria-label="figure, may scroll" tabindex="0">{svg}</div>'
    tools = '<label class="tool"><input type="checkbox"> enlarge</label>'
    if data:
        tools += f' <a class="tool" href="{quote(data)}" download>data (CSV)</a>'
    return f"<figure>{frame}<figcaption>{html.escape(caption)} {tools}</figcaption></figure>"


def csv(fig: Figure) -> str:
    """The data of all lines of a figure: a column for each x that differs from the last, then its lines.

    A column is named "panel: line" after the label or title of its axes; lines that end earlier leave cells empty.
    Levels across the axes, such as requirements, are not lines of data. Empty if there are no lines.
    """
    columns: list[tuple[str, np.ndarray]] = []
    shared: np.ndarray | None = None
    for k, ax in enumerate(fig.axes, 1):
        panel = ", ".join(filter(None, (ax.get_title(), ax.get_ylabel()))) or f"panel {k}"
        lines = [line for line in ax.lines if line.get_transform() == ax.transData]
        for j, line in enumerate(lines, 1):
            x, y = (np.asarray(v, float) for v in line.get_data(orig=True))
            if shared is None or not np.array_equal(shared, x, equal_nan=True):
                columns.append((_below(fig, ax), x))
                shared = x
            label = str(line.get_label())
            columns.append((f"{panel}: {f'line {j}' if label.startswith('_') else label}", y))
    if not columns:
        return ""
    rows = np.full((max(len(v) for _, v in columns), len(columns)), np.nan)
    for j, (_, values) in enumerate(columns):
        rows[: len(values), j] = values
    head = ",".join('"' + name.replace('"', '""').replace("\n", " ") + '"' for name, _ in columns)
    body = (",".join("" if np.isnan(v) else f"{v:.7g}" for v in row) for row in rows)
    return "\n".join([head, *body]) + "\n"


def _below(fig: Figure, ax: Axes) -> str:
    """The label of the x axis, which axes above each other share."""
    return ax.get_xlabel() or next((a.get_xlabel() for a in fig.axes if a.get_xlabel()), "x")
