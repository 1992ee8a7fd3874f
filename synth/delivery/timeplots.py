"""Pictures over time, `step` and `impulse`, and of poles and zeros, `pzmap`, of systems and designs.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.delivery.curves import axes_for, shown
from synth.systems.responses import Response, time_grid
from synth.systems.statespace import StateSpace


def step(systems: Any, ax: Any = None, *, time: Any = None, label: str | None = None, **style: Any) -> Any:
    """Responses to unit steps, from rest; a column for each input, a row for each output.

    Parameters
    ----------
    systems : a system in any form that `synth.system` takes, a Design (its closed loop from w to z), or a list or a
        dict of them, whose keys are the labels
    ax : p m axes to draw on; new ones by default
    time : end in s, or a grid from 0; until the slowest mode has settled by default
    label : for the legend
    style : of the lines, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    matplotlib.axes.Axes for one input and one output, else (p, m) of them

    Raises
    ------
    ModelError : what is given is no system, or does not fit the axes.
    """
    found = shown(systems, label, loops=False)
    end = _end(found, time)
    return _responses([(name, G.step_response(end)) for name, G in found], ax, style)


def impulse(systems: Any, ax: Any = None, *, time: Any = None, label: str | None = None, **style: Any) -> Any:
    """Responses to impulses of area one; parameters, returns and raises as `step`."""
    found = shown(systems, label, loops=False)
    end = _end(found, time)
    return _responses([(name, G.impulse_response(end)) for name, G in found], ax, style)


def pzmap(systems: Any, ax: Any = None, *, label: str | None = None, **style: Any) -> Any:
    """Poles (crosses) and transmission zeros (circles), with the stability boundary.

    Parameters
    ----------
    systems, ax, label : as in `step`, on one axes
    style : of the markers, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError : what is given is no system.
    """
    found = shown(systems, label, loops=False)
    ((axes,),) = axes_for(ax, 1, 1, size=(4.8, 4.2))
    for name, G in found:
        poles, zeros = G.poles(), G.zeros()
        (line,) = axes.plot(np.real(poles), np.imag(poles), "x", label=name or "poles", **{"ms": 8, **style})
        axes.plot(
            np.real(zeros), np.imag(zeros), "o", label=None if name else "zeros",
            **{"ms": 8, "mfc": "none", "color": line.get_color(), **style},
        )  # fmt: skip
    axes.axhline(0, color="0.7", lw=0.6)
    axes.axvline(0, color="0.7" if all(G.discrete for _, G in found) else "0.4", lw=0.6)
    if any(G.discrete for _, G in found):
        angle = np.linspace(0, 2 * np.pi, 181)
        axes.plot(np.cos(angle), np.sin(angle), color="0.4", lw=0.8, ls="--", gid="unit circle")
        axes.set(aspect="equal", xlabel="real part", ylabel="imaginary part")
    else:
        axes.set(xlabel="real part, rad/s", ylabel="imaginary part, rad/s")
    axes.margins(0.15)
    axes.legend(fontsize="small")
    return axes


def _end(found: list[tuple[str | None, StateSpace]], time: Any) -> Any:
    """The time asked for, or what the slowest of the systems needs."""
    return time if time is not None else max(float(time_grid(G.A, G.dt, None)[-1]) for _, G in found)


def _responses(found: list[tuple[str | None, Response]], ax: Any, style: dict[str, Any]) -> Any:
    """All responses on the same axes, one colour for each system."""
    p, m = found[0][1].values.shape[1:]
    axes = axes_for(ax, p, m, size=(6.0, 2.4 if p > 1 else 3.6))
    for name, response in found:
        before = len(axes[0, 0].lines)
        response.plot(axes, label=name, **style)
        color = axes[0, 0].lines[before].get_color()
        for each in axes.ravel():
            each.lines[-1].set_color(style.get("color", color))
    for each in axes.ravel():
        each.grid(True, alpha=0.3, lw=0.6)
    if len(found) > 1 and any(name for name, _ in found):
        axes[0, 0].legend(fontsize="small")
    return axes[0, 0] if p * m == 1 else axes
