"""The picture of a design for people who look rather than read.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from synth.delivery.curves import frequencies
from synth.delivery.frequencyplots import sigma
from synth.errors import ModelError

if TYPE_CHECKING:
    from synth.synthesis.design import Design

LEAST = 4.0  # ratio of the ends of an axis of singular values
PEAK = 1e3  # times the highest frequency: a peak beyond is not shown


def design_plot(design: Design, ax: Any = None, *, label: str | None = None, **style: Any) -> np.ndarray:
    """Singular values of the closed loop with gamma and the verified norm, and of the controller.

    Parameters
    ----------
    design : to look at
    ax : two axes, for closed loop and controller; new ones by default. Several designs may share them
    label : of this design in the legend
    style : of the lines, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    (2,) of matplotlib.axes.Axes

    Raises
    ------
    ModelError : `ax` is not two axes.
    """
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")[1]
    ax = np.ravel(ax)
    if ax.size != 2:
        raise ModelError(f"ax holds {ax.size} axes; pass two, for the closed loop and for the controller")
    loop, controller = ax
    grid = frequencies(design.closed_loop, design.controller)
    if 0 < design.info.frequency <= PEAK * grid[-1]:  # else the peak is at zero or at infinity
        grid = np.union1d(grid, design.info.frequency)
    sigma(design.closed_loop, loop, omega=grid, label=label or "closed loop", **style)
    color = loop.lines[-1].get_color()  # one for each design
    name = f"{label}, " if label else ""
    loop.axhline(design.gamma, color=color, ls=":", label=f"{name}verified norm {design.gamma:.6g}")
    if design.info.optimum is not None and design.info.shifted_norm is None:  # else it is of another problem
        loop.axhline(design.info.optimum, color=color, ls="--", label=f"{name}optimum {design.info.optimum:.6g}")
    sigma(design.controller, controller, omega=grid, label=label or "controller", **{"color": color, **style})
    for each in ax:  # an optimal loop is flat to the last digits, which are not worth a picture
        low, high = each.get_ylim()
        if 0 < low < high < LEAST * low:
            middle = np.sqrt(low * high)
            each.set_ylim(middle / np.sqrt(LEAST), middle * np.sqrt(LEAST))
    loop.set_title("closed loop, w to z")
    controller.set_title("controller, y to u")
    for each in ax:
        each.legend(fontsize="small")
    return ax
