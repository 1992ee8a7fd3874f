"""Pictures of a run and of a campaign for people who look rather than read.

They are drawn on the caller's axes, or on new ones, in the caller's style; those of the reports are in
`plants.outcome.figures`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks

if TYPE_CHECKING:
    from plants.simulation.campaign import Campaign
    from plants.simulation.loop import Run

COLUMNS = 3  # axes side by side in the picture of a campaign


def run_plot(
    run: Run,
    ax: Any = None,
    *,
    outputs: Sequence[int] | None = None,
    commands: Sequence[int] | None = None,
    names: Sequence[str] = (),
    label: str | None = None,
) -> np.ndarray:
    """Outputs with their reference, and commands, against time.

    Parameters
    ----------
    run : to look at
    ax : one axes for each output and command shown; new ones by default. Several runs may share them
    outputs, commands : columns to show, all by default
    names : of what is shown, with units; y0, y1, ..., u0, u1, ... by default
    label : of this run in the legend

    Returns
    -------
    (k,) of matplotlib.axes.Axes, outputs first

    Raises
    ------
    ScenarioError
        A column that the run has not, names or axes that do not fit.
    """
    shown = _columns("outputs", outputs, run.outputs.shape[1])
    sent = _columns("commands", commands, run.commands.shape[1])
    names = tuple(names) or (*(f"y{i}" for i in shown), *(f"u{i}" for i in sent))
    if len(names) != len(shown) + len(sent):
        raise ScenarioError(f"names has {len(names)} entries: give {len(shown) + len(sent)}, outputs first")
    axes = axes_for(ax, len(names), rows=len(names))
    for each, i in zip(axes, shown, strict=False):
        line = each.plot(run.time, run.outputs[:, i], label=label or "output")[0]
        named = "reference" in each.get_legend_handles_labels()[1]  # of another run
        each.plot(run.time, run.references[:, i], "--", color=line.get_color(), label=None if named else "reference")
    for each, i in zip(axes[len(shown) :], sent, strict=True):
        each.step(run.time, run.commands[:, i], where="post", label=label or "command")
    for each, name in zip(axes, names, strict=True):
        each.set_ylabel(name)
    axes[-1].set_xlabel("time, s")
    for first in {0, len(shown)} - {len(axes)}:
        axes[first].legend(fontsize="small")
    if not run.ok:
        axes[0].set_title(f"failed at {run.failed_at:g} s: {run.culprit}")
    return axes


def campaign_plot(
    campaign: Campaign, ax: Any = None, *, results: Sequence[str] | None = None, label: str | None = None
) -> np.ndarray:
    """For each result the share of the runs that do not exceed a level: the empirical distribution.

    A run that failed has infinite indices, so that its curve ends below one. Results of yes and no are bars.

    Parameters
    ----------
    campaign : to look at
    ax : one axes for each result shown; new ones by default. Several campaigns may share them
    results : names to show, such as "ape"; all numbers and truth values by default
    label : of this campaign in the legend

    Returns
    -------
    (k,) of matplotlib.axes.Axes

    Raises
    ------
    ScenarioError
        No finished runs, a result that the campaign has not, axes that do not fit.
    """
    found = named_results(campaign)
    unknown = [name for name in results or () if name not in found]
    if unknown:
        raise ScenarioError(f"results: the campaign has no {unknown[0]!r}; it has {', '.join(found)}")
    chosen = {name: found[name] for name in results or found}
    axes = axes_for(ax, len(chosen), rows=-(-len(chosen) // COLUMNS))
    for each, (name, values) in zip(axes, chosen.items(), strict=True):
        if values.dtype == bool:
            share = values.reshape(len(values), -1).mean(axis=0)
            each.bar([_join(label, str(i)) if share.size > 1 else label or "runs" for i in range(share.size)], share)
        else:
            for i, column in enumerate(values.reshape(len(values), -1).T):
                _distribution(each, column, _join(label, str(i)) if values.ndim > 1 else label)
            each.locator_params(axis="x", nbins=4)
            if each.get_legend_handles_labels()[1]:
                each.legend(fontsize="small")
        each.set(title=name, ylim=(-0.02, 1.02))
    for each in axes[::COLUMNS]:
        each.set_ylabel("share of runs")
    return axes


def named_results(campaign: Campaign) -> dict[str, np.ndarray]:
    """The results of a campaign by name, each (n, ...); a name is the path without what leads to all of them.

    Raises
    ------
    ScenarioError
        The campaign has no finished runs.
    """
    if campaign.results is None:
        raise ScenarioError("results: the campaign has no finished run to look at")
    blocks.register(campaign.results)
    leaves = jax.tree_util.tree_flatten_with_path(campaign.results)[0]
    return {jax.tree_util.keystr(path).strip(".") or "result": np.asarray(leaf) for path, leaf in leaves}


def _distribution(ax: Any, values: np.ndarray, label: str | None) -> None:
    """Steps of 1/n at the finite ones of n values."""
    finite = np.sort(values[np.isfinite(values)])
    share = np.arange(1, len(finite) + 1) / len(values)
    x, y = (np.r_[finite[:1], finite], np.r_[0.0, share]) if len(finite) else (finite, share)
    ax.step(x, y, where="post", label=label)


def _columns(name: str, chosen: Sequence[int] | None, size: int) -> list[int]:
    """The columns asked for, checked."""
    columns = list(range(size)) if chosen is None else list(chosen)
    wrong = [i for i in columns if not 0 <= i < size]
    if wrong:
        raise ScenarioError(f"{name} = {list(columns)}: the run has columns 0 to {size - 1}")
    return columns


def axes_for(ax: Any, count: int, rows: int) -> np.ndarray:
    """The caller's axes, checked, or new ones."""
    if count < 1:
        raise ScenarioError("nothing to show: choose at least one output, command or result")
    if ax is None:
        import matplotlib.pyplot as plt

        columns = -(-count // rows)
        size = (3.2 * columns, 2.6 * rows) if columns > 1 else (7.0, 0.8 + 1.3 * rows)
        fig, grid = plt.subplots(rows, columns, sharex=columns == 1, figsize=size, squeeze=False, layout="constrained")
        for spare in grid.ravel()[count:]:
            fig.delaxes(spare)
        return grid.ravel()[:count]
    axes = np.ravel(ax)
    if axes.size != count:
        raise ScenarioError(f"ax holds {axes.size} axes: {count} are needed, one for each thing shown")
    return axes


def _join(label: str | None, name: str) -> str:
    """A name within a labelled group."""
    return f"{label}, {name}" if label else name
