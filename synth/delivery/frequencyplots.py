"""Pictures over frequency: `bode`, `sigma`, `nyquist`, `nichols`, of systems, loops and designs.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.delivery.curves import axes_for, nyquist_line, responses, shown

LEVELS = (-20, -12, -6, -3, -1, 0, 1, 3, 6, 12)  # dB, of the closed loop in a Nichols picture
REACH = 3.0  # |L| that a Nyquist picture shows beyond -1, when the curve goes that far


def sigma(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """Singular values against frequency.

    Parameters
    ----------
    systems : a system in any form that `synth.system` takes, a Design (its closed loop from w to z), or a list or a
        dict of them, whose keys are the labels
    ax : axes to draw on; new ones by default
    omega : (N,) rad/s; chosen about the poles by default. Discrete systems end at their Nyquist frequency
    label : for the legend
    style : of the lines, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ModelError : what is given is no system, or does not fit the axes.
    """
    found = shown(systems, label, loops=False)
    drawn = responses(found, omega)
    ((axes,),) = axes_for(ax, 1, 1, size=(6.0, 3.6))
    for name, _, grid, response in drawn:
        first, *others = np.linalg.svd(response, compute_uv=False).T
        (line,) = axes.plot(grid, first, label=name, **style)
        for values in others:
            axes.plot(grid, values, **{"color": line.get_color(), **style})
    nyquist_line(axes, found)
    some = any(np.any(np.asarray(line.get_ydata()) > 0) for line in axes.lines)  # a zero has no logarithm
    axes.set(xscale="log", yscale="log" if some else "linear", xlabel="frequency, rad/s", ylabel="singular values")
    _legend(axes, found)
    return axes


def bode(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> np.ndarray:
    """Gain in decibels and phase in degrees against frequency.

    Parameters
    ----------
    systems : as in `sigma`; of a Design its loop for negative feedback, cut at the plant's input
    ax : 2 p m axes; a row of gains and a row of phases for each of p outputs, a column for each of m inputs
    omega, label, style : as in `sigma`

    Returns
    -------
    (2,) of matplotlib.axes.Axes, gain and phase, for one input and one output; (2 p, m) for more

    Raises
    ------
    ModelError : as `sigma`.
    """
    found = shown(systems, label, loops=True)
    drawn = responses(found, omega)
    p, m = found[0][1].ny, found[0][1].nu
    axes = axes_for(ax, 2 * p, m, size=(6.0, 2.2))
    colors = _draw(axes[0::2], drawn, style, lambda omega, L: (omega, _decibels(L)))
    _draw(axes[1::2], drawn, style, lambda omega, L: (omega, _degrees(L)), colors)
    names = found[0][1]
    for i, j in np.ndindex(p, m):
        gain, phase = axes[2 * i, j], axes[2 * i + 1, j]
        channel = f"{names.u[j]} to {names.y[i]}" if p * m > 1 else ""
        gain.set(xscale="log", ylabel="gain, dB" if j == 0 else "", title=channel)
        phase.set(xscale="log", ylabel="phase, deg" if j == 0 else "")
        _right_angles(phase.yaxis)
        for each in (gain, phase):
            nyquist_line(each, found)
            each.grid(True, alpha=0.3, lw=0.6)
    for each in axes[-1]:
        each.set_xlabel("frequency, rad/s")
    _legend(axes[0, 0], found)
    return axes[:, 0] if m == p == 1 else axes


def nyquist(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """The loop in the complex plane, for negative feedback: -1 is the point to go round.

    Solid for positive frequencies, dashed for their mirror image; the arc at infinity that belongs to a pole on the
    stability boundary is not drawn.

    Parameters
    ----------
    systems : as in `bode`
    ax : p m axes, outputs in rows and inputs in columns
    omega, label, style : as in `sigma`

    Returns
    -------
    matplotlib.axes.Axes for one input and one output, else (p, m) of them

    Raises
    ------
    ModelError : as `sigma`.
    """
    found = shown(systems, label, loops=True)
    drawn = responses(found, omega)
    p, m = found[0][1].ny, found[0][1].nu
    axes = axes_for(ax, p, m, share=False, size=(4.6, 4.2))
    colors = _draw(axes, drawn, style, lambda omega, L: (np.real(L), np.imag(L)))
    width = 0.6 * axes[0, 0].lines[-1].get_linewidth()
    mirrored = {**style, "ls": "--", "lw": width}
    _draw(axes, drawn, mirrored, lambda omega, L: (np.real(L), -np.imag(L)), colors, labels=False)
    names = found[0][1]
    for i, j in np.ndindex(p, m):
        each = axes[i, j]
        angle = np.linspace(0, 2 * np.pi, 181)
        each.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8, ls=":")
        each.plot([-1], [0], "+", color="red", ms=10, mew=1.6)
        _within_reach(each)
        each.set(xlabel="real part" if i == p - 1 else "", ylabel="imaginary part" if j == 0 else "", aspect="equal")
        each.set_title(f"{names.u[j]} to {names.y[i]}" if p * m > 1 else "")
        each.grid(True, alpha=0.3, lw=0.6)
    _legend(axes[0, 0], found)
    return axes[0, 0] if p * m == 1 else axes


def nichols(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """Gain in decibels against phase in degrees, with the gains of the closed loop as a grid.

    Parameters, returns and raises as `nyquist`.
    """
    found = shown(systems, label, loops=True)
    drawn = responses(found, omega)
    p, m = found[0][1].ny, found[0][1].nu
    axes = axes_for(ax, p, m, share=False, size=(5.2, 4.2))
    _draw(axes, drawn, style, lambda omega, L: (_degrees(L), _decibels(L)))
    names = found[0][1]
    for i, j in np.ndindex(p, m):
        each = axes[i, j]
        _closed_loop_grid(each)
        each.plot([-180], [0], "+", color="red", ms=10, mew=1.6)
        each.set(xlabel="phase, deg" if i == p - 1 else "", ylabel="gain, dB" if j == 0 else "")
        _right_angles(each.xaxis)
        each.set_title(f"{names.u[j]} to {names.y[i]}" if p * m > 1 else "")
    _legend(axes[0, 0], found)
    return axes[0, 0] if p * m == 1 else axes


def _draw(axes: Any, drawn: Any, style: dict, curve: Any, colors: Any = None, *, labels: bool = True) -> list[Any]:
    """One line for every response on its own axes, one colour for every system; the colours used."""
    used = []
    for k, (name, _, grid, response) in enumerate(drawn):
        color = style.get("color", colors[k] if colors else None)
        for i, j in np.ndindex(*response.shape[1:]):
            own = style if color is None else {**style, "color": color}
            (line,) = axes[i, j].plot(*curve(grid, response[:, i, j]), label=name if labels else None, **own)
            color = line.get_color()
        used.append(color)
    return used


def _decibels(response: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(response))


def _degrees(response: np.ndarray) -> np.ndarray:
    """The phase without jumps, beginning between -360 and 0."""
    phase = np.full(len(response), np.nan)
    sound = np.isfinite(response)
    if sound.any():
        phase[sound] = np.degrees(np.unwrap(np.angle(response[sound])))
        phase -= 360 * np.ceil(np.round(phase[sound][0] / 360, 6))
    return phase


def _right_angles(axis: Any) -> None:
    """Ticks of a phase at parts or multiples of a right angle, seven at most."""
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_view_interval()
    fitting = (step for step in (5, 15, 30, 45, 90, 180, 360) if (high - low) / step <= 7)
    axis.set_major_locator(MultipleLocator(next(fitting, 720)))


def _within_reach(ax: Any) -> None:
    """Limits about -1 and the curves, where these do not run away to infinity."""
    points = [line.get_xydata() for line in ax.lines]
    both = np.vstack([xy[np.isfinite(xy).all(axis=1)] for xy in points if len(xy)])
    near = both[np.hypot(both[:, 0] + 1, both[:, 1]) <= REACH + 1]
    low, high = near.min(axis=0), near.max(axis=0)
    pad = 0.08 * max(high - low)
    ax.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))


def _closed_loop_grid(ax: Any) -> None:
    """Lines of |L / (1 + L)| within the limits that the curves have made, and the limits about -180 degrees."""
    low, high = ax.get_xlim()
    low, high = min(low, -225.0), max(high, -135.0)
    bottom, top = max(ax.get_ylim()[0], -60.0), min(ax.get_ylim()[1], 60.0)
    bottom, top = min(bottom, -20.0), max(top, 20.0)
    phase, gain = np.meshgrid(np.linspace(low, high, 241), np.linspace(bottom, top, 161))
    L = 10 ** (gain / 20) * np.exp(1j * np.radians(phase))
    with np.errstate(divide="ignore"):
        closed = 20 * np.log10(np.abs(L / (1 + L)))
    lines = ax.contour(phase, gain, closed, levels=LEVELS, colors="0.75", linewidths=0.6)
    lines.set_linestyle("dotted")
    ax.clabel(lines, fmt="%g dB", fontsize="x-small", colors="0.5")
    ax.set(xlim=(low, high), ylim=(bottom, top))


def _legend(ax: Any, found: list) -> None:
    if len(found) > 1 and any(name for name, _ in found):
        ax.legend(fontsize="small")
