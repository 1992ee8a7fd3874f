"""`diskmarginplot`: the gain and the phase that a loop bears in every channel at once, against frequency."""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.analysis.diskmargins import DiskMargin, diskmargin, diskmargin_at
from synth.checks import as_array
from synth.delivery.curves import axes_for, frequencies, light_grid, lines_style, nyquist_line, shown, unit_of_time
from synth.errors import ModelError
from synth.systems.connect import feedback

MOST = 40.0  # dB, shown of a gain margin


def diskmarginplot(
    systems: Any, ax: Any = None, *, omega: Any = None, skew: float = 0.0, label: str | None = None, **style: Any
) -> np.ndarray:
    """Disk margins against frequency: the gain, either way, and the phase that each channel bears; a dot is the least.

    Parameters
    ----------
    systems : a square loop for negative feedback in any form that `synth.system` takes, a Design (its loop, cut at the
        plant's input), or a list, tuple or dict of them; the keys of a dict are the labels
    ax : two axes, for gain and phase; new ones by default
    omega : (N,) rad/s; chosen about the poles of the closed loop by default
    skew : as of `diskmargin`
    label : for the legend
    style : of the lines, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    (2,) of matplotlib.axes.Axes, gain in decibels and phase in degrees

    Raises
    ------
    ModelError : what is given is no square loop, is unstable when closed, or does not fit the axes.
    """
    found, style = shown(systems, label, loops=True), lines_style(style)
    if found[0][1].ny != found[0][1].nu:
        raise ModelError(f"systems are {found[0][1].ny} x {found[0][1].nu}; a loop has as many outputs as inputs")
    margins = [diskmargin(L, skew=skew) for _, L in found]
    if unstable := [name or "systems" for (name, _), kept in zip(found, margins, strict=True) if kept.alpha == 0]:
        raise ModelError(f"{', '.join(unstable)} is unstable when it is closed (negative feedback): nothing is borne")
    grids = [_grid(L, least.frequency, omega) for (_, L), least in zip(found, margins, strict=True)]
    axes = axes_for(ax, 2, 1, size=(6.0, 2.2))[:, 0]
    for (name, L), least, own in zip(found, margins, grids, strict=True):
        kept = [DiskMargin(alpha, w, skew) for alpha, w in zip(diskmargin_at(L, own, skew=skew), own, strict=True)]
        for each, value in ((axes[0], _gain_db), (axes[1], _phase_deg)):
            (line,) = each.plot(own, [value(margin) for margin in kept], label=name, **style)
            if own[0] <= least.frequency <= own[-1]:
                each.plot([least.frequency], [value(least)], "o", color=line.get_color(), ms=5)
    for each, text in zip(axes, ("gain, dB", "phase, deg"), strict=True):
        each.set(xscale="log", ylabel=text)
        each.set_ylim(bottom=0)
        nyquist_line(each, found)
        light_grid(each)
    axes[0].set_title("borne by every channel at once, either way")
    axes[1].set_xlabel(f"frequency, rad/{unit_of_time(found)}")
    if any(name for name, _ in found):
        axes[0].legend()
    return axes


def _grid(L: Any, least: float, omega: Any) -> np.ndarray:
    """The frequencies asked for, or some about the poles of the closed loop with that of the margin among them."""
    if omega is not None:
        grid = as_array("omega", omega, "pass frequencies in rad/s")
        if grid.ndim != 1 or grid.size < 2 or np.any(grid <= 0) or np.any(np.diff(grid) <= 0):
            raise ModelError(f"omega has shape {grid.shape}; pass rising frequencies above zero, in rad/s")
        return grid
    grid = frequencies(feedback(L, np.eye(L.nu)))
    return np.union1d(grid, [least] if grid[0] < least < grid[-1] else [])


def _gain_db(margin: DiskMargin) -> float:
    return min(margin.gain_db, MOST)


def _phase_deg(margin: DiskMargin) -> float:
    return margin.phase_deg
