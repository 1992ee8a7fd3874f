"""The figures that studies share, in one column: histories, errors against their bounds, spreads over many runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from plants.outcome.indices import clopper_pearson
from plants.outcome.inline import BOUND, COLOURS, STYLE

Series = Mapping[str, tuple[np.ndarray, np.ndarray]]  # name -> time (N,) s, values (N, k)
DASHES = ("-", "--", "-.", ":")  # histories that coincide are told apart, also without colours
DENSE = 2000  # points above which a line becomes a picture inside the SVG
WIDTH = 4.7  # in, of every figure: one column, which a phone can show as well
LETTERS = 72  # that fit beside each other in a legend
WIDEST, THINNEST = 2.2, 1.0  # pt, of the first and the last line, so that one that covers another leaves an edge
FAR = 2.0  # times the largest value: a bound beyond it is named, not drawn, so that the signal fills its axes


def histories(series: Series, rows: Sequence[str], *, until: float | None = None, scale: str = "linear") -> Figure:
    """One row of axes for each of the k values, one colour for each name; time in s, up to `until`; scale of y."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 1.0 + 1.35 * len(rows)), layout="constrained")
        axes = fig.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        widths = np.linspace(WIDEST, THINNEST, len(series)) if len(series) > 1 else [THINNEST]
        for (name, (time, values)), dashes, lw in zip(series.items(), cycle(DASHES), widths):
            shown = slice(None) if until is None else time <= until
            for ax, column in zip(axes, values.T, strict=True):
                dense = len(time[shown]) > DENSE
                ax.plot(time[shown], column[shown], ls=dashes, lw=lw, label=name, rasterized=dense)
        for ax, label in zip(axes, rows, strict=True):
            ax.set_ylabel(label)
            ax.set_yscale(scale)
            if scale == "log":
                ax.yaxis.set_major_formatter("{x:g}")  # powers as markup would be shown as they are written
        axes[-1].set_xlabel("time, s")
        fig.align_ylabels(axes)
        _legend(fig, *axes[0].get_legend_handles_labels())
        return fig


def against_bound(series: Series, rows: Sequence[str], bound: float, unit: str) -> Figure:
    """One row of axes for each of the k values, one colour for each name, the largest behind, the bound dashed."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 1.0 + 1.35 * len(rows)), layout="constrained")
        axes = fig.subplots(len(rows), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        colours = dict(zip(series, cycle(COLOURS)))
        largest = max(np.abs(values).max() for _, values in series.values())
        for name in sorted(series, key=lambda n: -np.square(series[n][1]).mean()):
            time, values = series[name]
            for ax, column in zip(axes, values.T, strict=True):
                ax.plot(time, column, lw=0.7, label=name, color=colours[name], rasterized=len(time) > DENSE)
        top = 1.15 * (bound if largest < bound <= FAR * largest else largest)
        for ax, label in zip(axes, rows, strict=True):
            ax.set_ylabel(f"{label}, {unit}" if unit else label)
            ax.set_ylim(-top, top)
            for level in (-bound, bound):
                ax.axhline(level, color=BOUND, ls="--", lw=0.9)
        axes[-1].set_xlabel("time, s" if bound <= top else f"time, s; required: {bound:g} {unit}, beyond the axes")
        fig.align_ylabels(axes)
        _legend(fig, *axes[0].get_legend_handles_labels())
        return fig


def spread(runs: Sequence[tuple[np.ndarray, np.ndarray]], rows: Sequence[str], *, until: float) -> Figure:
    """All runs in thin lines, one row of axes for each of the k values."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 1.0 + 1.35 * len(rows)), layout="constrained")
        axes = fig.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
        alpha = float(np.clip(10 / max(len(runs), 1), 0.4, 1.0))  # many lines shade, few are seen
        for time, values in runs:
            shown = time <= until
            for ax, column in zip(axes, values.T, strict=True):
                ax.plot(time[shown], column[shown], color=COLOURS[0], alpha=alpha, lw=0.8, rasterized=True)
        for ax, label in zip(axes, rows, strict=True):
            ax.set_ylabel(label)
        axes[-1].set_xlabel("time, s")
        fig.align_ylabels(axes)
        return fig


def bundles(flights: Mapping[str, Sequence[tuple[np.ndarray, np.ndarray]]], label: str, bound: float) -> Figure:
    """One row of axes for each name: all its flights (time (N,) s, value (N,)), logarithmic, and a bound."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 0.6 + 1.5 * len(flights)), layout="constrained")
        axes = fig.subplots(len(flights), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (name, lines) in zip(axes, flights.items(), strict=True):
            for time, value in lines:
                ax.plot(time, np.maximum(value, 1e-3 * bound), color=COLOURS[0], alpha=0.5, lw=0.7, rasterized=True)
            ax.axhline(bound, color=BOUND, ls="--", lw=0.9)
            ax.set_title(name)
            ax.set_ylabel(label)
            ax.set_yscale("log")
            ax.yaxis.set_major_formatter("{x:g}")
        axes[-1].set_xlabel("time, s")
        return fig


def levels(names: Sequence[str], values: Mapping[str, np.ndarray], bounds: Mapping[str, float], unit: str) -> Figure:
    """For each index a column of dots per configuration, one dot for each run, and its requirement.

    Parameters
    ----------
    names : configurations, in order
    values : index -> (configurations, runs)
    bounds : index -> requirement
    """
    with mpl.rc_context(STYLE):
        columns = min(2, len(values))
        down = -(-len(values) // columns)
        fig = Figure(figsize=(WIDTH, 3.2 * down), layout="constrained")
        axes: Any = fig.subplots(down, columns, squeeze=False).ravel()
        for ax in axes[len(values) :]:
            ax.remove()
        for ax, (index, table) in zip(axes, values.items(), strict=False):  # the last may be left over
            for j, row in enumerate(table):
                offset = np.linspace(-0.28, 0.28, len(row)) if len(row) > 1 else np.zeros(1)
                ax.plot(j + offset, row, ".", ms=4 if len(row) > 12 else 6)
            ax.axhline(bounds[index], color=BOUND, ls="--", lw=0.9)
            ax.set_title(f"{index}, {unit}")
            ax.set_yscale("log")
            ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ax.yaxis.set_major_formatter("{x:g}")
            ax.yaxis.set_minor_formatter(NullFormatter())
            ax.set_xticks(range(len(names)), names, rotation=60, ha="right", fontsize=7)
        return fig


def scatter(
    panels: Mapping[str, tuple[np.ndarray, np.ndarray, Mapping[str, np.ndarray]]],
    xlabel: str,
    ylabel: str,
    *,
    up: Sequence[float] = (),
    across: Sequence[float] = (),
    diagonal: bool = False,
) -> Figure:
    """Points, one panel below the other: title -> (x (N,), y (N,), group -> mask (N,)), a colour for each group.

    Dashed lines stand at the x of `up` and the y of `across`, and on y = x for `diagonal`.
    """
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 0.6 + 2.9 * len(panels)), layout="constrained")
        axes = fig.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        size = 7.0 if max(len(x) for x, _, _ in panels.values()) <= DENSE else 2.0
        for ax, (title, (x, y, groups)) in zip(axes, panels.items(), strict=True):
            for label, mask in groups.items():
                ax.plot(x[mask], y[mask], ".", ms=size, mew=0, label=label, rasterized=True)
            ax.set_title(title)
            ax.set_ylabel(ylabel)
            for level in up:
                ax.axvline(level, color=BOUND, ls="--", lw=0.9)
            for level in across:
                ax.axhline(level, color=BOUND, ls="--", lw=0.9)
            if diagonal:
                ax.axline((0, 0), slope=1, color="#888888", ls="--", lw=0.9)
        axes[-1].set_xlabel(xlabel)
        _legend(fig, *axes[0].get_legend_handles_labels(), markerscale=10 / size)
        return fig


def shares(
    edges: np.ndarray,
    counts: Mapping[str, np.ndarray],
    totals: np.ndarray,
    xlabel: str,
    *,
    up: Sequence[float] = (),
) -> Figure:
    """Share of runs in each bin, with its exact 95 % interval; dashed lines at the x of `up`.

    Parameters
    ----------
    edges : (k + 1,) of the bins
    counts : name -> (k,) runs that count
    totals : (k,) runs in the bin; empty bins are left out
    """
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(WIDTH, 3.4), layout="constrained")
        ax = fig.subplots()
        filled = totals > 0
        middle = (0.5 * (edges[1:] + edges[:-1]))[filled]
        for name, hits in counts.items():
            share = hits[filled] / totals[filled]
            low, high = clopper_pearson(hits[filled], totals[filled])
            ax.errorbar(
                middle, share, [share - low, high - share], fmt=".-", ms=4, capsize=2, elinewidth=0.8, label=name
            )
        for level in up:
            ax.axvline(level, color=BOUND, ls="--", lw=0.9)
        ax.set_xlabel(xlabel)
        ax.set_ylabel("share of runs")
        _legend(fig, *ax.get_legend_handles_labels())
        return fig


def composition(panels: Mapping[str, Mapping[str, np.ndarray]], parts: Sequence[str]) -> Figure:
    """Bars of what sums are made of, in per cent: title -> row -> (parts,), none negative."""
    with mpl.rc_context(STYLE):
        rows = max(len(panel) for panel in panels.values())
        fig = Figure(figsize=(WIDTH, 0.9 + (0.3 + 0.2 * rows) * len(panels)), layout="constrained")
        axes = fig.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, panel) in zip(axes, panels.items(), strict=True):
            table = np.array(list(panel.values()), float)
            total = table.sum(axis=1, keepdims=True)
            percent = 100 * table / np.where(total > 0, total, 1.0)
            left = np.cumsum(percent, axis=1) - percent
            for j, part in enumerate(parts):
                ax.barh(list(panel), percent[:, j], left=left[:, j], height=0.75, label=part)
            ax.set_title(title)
            ax.grid(False)
            ax.set_xlim(0, 100)
        axes[0].invert_yaxis()
        axes[-1].set_xlabel("%")
        _legend(fig, *axes[0].get_legend_handles_labels())
        return fig


def _legend(fig: Figure, handles: Sequence[Any], labels: Sequence[str], **options: Any) -> None:
    """Above the axes, with as many columns as the longest name leaves room for."""
    columns = LETTERS // (7 + max(map(len, labels), default=0))
    fig.legend(handles, labels, loc="outside upper left", ncols=max(1, min(4, columns, len(labels))), **options)
