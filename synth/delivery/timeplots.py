"""Pictures over time, `step` and `impulse`, and of poles and zeros, `pzmap`, of systems and designs.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from synth.delivery.curves import axes_for, light_grid, lines_style, shown, unit_of_time
from synth.errors import ModelError
from synth.systems.responses import Response, time_grid
from synth.systems.statespace import StateSpace

SETTLED = 0.01  # of the range of a response: what is left of its motion when it has settled


def step(systems: Any, ax: Any = None, *, time: Any = None, label: str | None = None, **style: Any) -> Any:
    """Responses to unit steps, from rest; a column for each input, a row for each output.

    Parameters
    ----------
    systems : a system in any form that `synth.system` takes, a Design (its closed loop from w to z), or a list,
        tuple or dict of them; the keys of a dict are the labels
    ax : p m axes to draw on; new ones by default
    time : end in s, or a grid from 0; until all responses have settled to a hundredth by default
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
    return _responses(found, StateSpace.step_response, time, ax, style)


def impulse(systems: Any, ax: Any = None, *, time: Any = None, label: str | None = None, **style: Any) -> Any:
    """Responses to impulses of area one; parameters, returns and raises as `step`."""
    found = shown(systems, label, loops=False)
    return _responses(found, StateSpace.impulse_response, time, ax, style)


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
    ModelError : what is given is no system, or one is continuous and another discrete.
    """
    found = shown(systems, label, loops=False)
    if len({G.discrete for _, G in found}) > 1:
        raise ModelError("systems are continuous and discrete; their poles lie in different planes, draw one each")
    ((axes,),), style = axes_for(ax, 1, 1, size=(4.8, 4.2)), lines_style(style)
    roots = [(name, G.poles(), G.zeros()) for name, G in found]
    for name, poles, zeros in roots:
        plain: dict[str, Any] = {"linestyle": "none", "markersize": 8}
        crosses = {**plain, "marker": "x", **style}
        (line,) = axes.plot(np.real(poles), np.imag(poles), label=name or "poles", **crosses)
        circles = {**plain, "marker": "o", "markerfacecolor": "none", "color": line.get_color(), **style}
        axes.plot(np.real(zeros), np.imag(zeros), label=None if name else "zeros", **circles)
    axes.axhline(0, color="0.7", lw=0.6)
    axes.axvline(0, color="0.7" if found[0][1].discrete else "0.4", lw=0.6)
    size = max(np.abs(each).max(initial=0.0) for _, *both in roots for each in both)
    axes.update_datalim(0.1 * (size or 1.0) * np.array([[-1, -1], [1, 1]]))  # rounding does not make the scale
    if found[0][1].discrete:
        angle = np.linspace(0, 2 * np.pi, 181)
        axes.plot(np.cos(angle), np.sin(angle), color="0.4", lw=0.8, ls="--", gid="unit circle")
        axes.set(aspect="equal", xlabel="real part", ylabel="imaginary part")
    else:
        axes.set(xlabel="real part, rad/s", ylabel="imaginary part, rad/s")
    axes.margins(0.15)
    axes.legend(fontsize="small")
    return axes


def _settling(G: StateSpace, answer: Callable[[StateSpace, Any], Response]) -> float:
    """The time in s that shows a response: slow modes of which little is seen do not stretch it."""
    end = float(time_grid(G.A, G.dt, None)[-1])
    for _ in range(4):  # a short motion is seen roughly at first
        found = answer(G, end)
        left = np.abs(found.values - found.values[-1])
        moving = np.any(left > SETTLED * left.max(axis=0), axis=(1, 2))
        if not moving.any():
            return end
        last = found.time[1:][moving[:-1]][-1]  # the first time at rest
        if last > end / 3 or 2 * last < 10 * G.dt:
            return end
        end = 2 * last
    return end


def _responses(
    found: list[tuple[str | None, StateSpace]],
    answer: Callable[[StateSpace, Any], Response],
    time: Any,
    ax: Any,
    style: dict[str, Any],
) -> Any:
    """All responses on the same axes over the same time, one colour for each system."""
    unit_of_time(found)
    end = time if time is not None else max(_settling(G, answer) for _, G in found)
    answers = [(name, answer(G, end)) for name, G in found]
    p, m = found[0][1].ny, found[0][1].nu
    axes, style = axes_for(ax, p, m, size=(6.0, 2.4 if p > 1 else 3.6)), lines_style(style)
    for name, response in answers:
        before = len(axes[0, 0].lines)
        response.plot(axes, label=name, **style)
        for each in axes.ravel():
            each.lines[-1].set_color(axes[0, 0].lines[before].get_color())
            light_grid(each)
    if len(found) > 1 and any(name for name, _ in found):
        axes[0, 0].legend(fontsize="small")
    return axes[0, 0] if p * m == 1 else axes
