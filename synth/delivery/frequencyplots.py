"""Pictures over frequency: `bode`, `sigma`, `nyquist`, `nichols`, of systems, loops and designs.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from synth.delivery.curves import (
    axes_for,
    closing,
    light_grid,
    lines_style,
    nyquist_line,
    responses,
    shown,
    unit_of_time,
)

LEVELS = (-20, -12, -6, -3, -1, 0, 1, 3, 6, 12)  # dB, of the closed loop in a Nichols picture
HEIGHT = 60.0  # dB, that a Nichols picture shows at most
WHOLE = 8.0  # |L| up to which a Nyquist picture shows the whole curve
REACH = 3.0  # |L| that it shows of a curve that goes beyond


def sigma(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """Singular values against frequency.

    Parameters
    ----------
    systems : a system in any form that `synth.system` takes, a Design (its closed loop from w to z), or a list, tuple
        or dict of them; the keys of a dict are the labels
    ax : axes to draw on; new ones by default
    omega : (N,) rad/s; chosen about the poles by default, with those on the stability boundary (and zeros) passed on
        their right, where a curve without end is cut. Discrete systems end at their Nyquist frequency
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
    drawn, style = responses(found, omega), lines_style(style)
    ((axes,),) = axes_for(ax, 1, 1, size=(6.0, 3.6))
    for name, _, grid, response in drawn:
        gains = np.full((len(grid), min(response.shape[1:])), np.nan)
        sound = np.isfinite(response).all(axis=(1, 2))
        gains[sound] = np.linalg.svd(response[sound], compute_uv=False)
        first, *others = gains.T
        (line,) = axes.plot(grid, first, label=name, **style)
        for values in others:
            axes.plot(grid, values, **{"color": line.get_color(), **style})
    nyquist_line(axes, found)
    some = any(np.any(np.asarray(line.get_ydata()) > 0) for line in axes.lines)  # a zero has no logarithm
    axes.set(xscale="log", yscale="log" if some else "linear", ylabel="singular values")
    axes.set_xlabel(f"frequency, rad/{unit_of_time(found)}")
    light_grid(axes)
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
    drawn, style = responses(found, omega), lines_style(style)
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
            light_grid(each)
    for each in axes[-1]:
        each.set_xlabel(f"frequency, rad/{unit_of_time(found)}")
    _legend(axes[0, 0], found)
    return axes[:, 0] if m == p == 1 else axes


def nyquist(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """The loop in the complex plane, for negative feedback: -1 is the point to go round.

    Solid for positive frequencies, dashed for their mirror image. What is far away, the arc at infinity round poles on
    the stability boundary too, is dotted on a circle at its angle, so that every curve closes and its turns round -1
    can be counted; with `omega` only what belongs to it is drawn.

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
    drawn, style = responses(found, omega), lines_style(style)
    p, m = found[0][1].ny, found[0][1].nu
    axes = axes_for(ax, p, m, share=False, size=(4.6, 4.2))
    colors = _draw(axes, drawn, style, lambda omega, L: (np.real(L), np.imag(L)))
    thin = {**style, "linestyle": "--", "linewidth": 0.6 * axes[0, 0].lines[-1].get_linewidth()}
    _draw(axes, drawn, thin, lambda omega, L: (np.real(L), -np.imag(L)), colors, labels=False)
    far, dotted = _far(drawn, arcs=omega is None), {**thin, "linestyle": ":"}
    for side in (1, -1):
        _draw(axes, far, dotted, lambda omega, L, side=side: (np.real(L), side * np.imag(L)), colors, labels=False)
    names = found[0][1]
    for i, j in np.ndindex(p, m):
        each = axes[i, j]
        angle = np.linspace(0, 2 * np.pi, 181)
        each.plot(np.cos(angle), np.sin(angle), color="0.6", lw=0.8, ls=":")
        each.plot([-1], [0], "+", color="red", ms=10, mew=1.6)
        _within_reach(each)
        each.set(xlabel="real part" if i == p - 1 else "", ylabel="imaginary part" if j == 0 else "", aspect="equal")
        each.set_title(f"{names.u[j]} to {names.y[i]}" if p * m > 1 else "")
        light_grid(each)
    _legend(axes[0, 0], found)
    return axes[0, 0] if p * m == 1 else axes


def nichols(systems: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """Gain in decibels against phase in degrees, with the gains of the closed loop as a grid.

    Parameters, returns and raises as `nyquist`.
    """
    found = shown(systems, label, loops=True)
    drawn, style = responses(found, omega), lines_style(style)
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


def _decibels(response: Any) -> Any:
    with np.errstate(divide="ignore"):
        return 20 * np.log10(np.abs(response))


def _degrees(response: np.ndarray) -> np.ndarray:
    """The phase without jumps, beginning between -360 and 0; nothing where the response is zero."""
    phase = np.full(len(response), np.nan)
    sound = np.isfinite(response) & (response != 0)
    if sound.any():
        phase[sound] = np.degrees(np.unwrap(np.angle(response[sound])))
        phase -= 360 * np.ceil(np.round(phase[sound][0] / 360, 6))
    return phase


def _far(drawn: list, *, arcs: bool) -> list:
    """What a Nyquist picture does not show of curves, at its angle on the circle that it shows, with nan for the rest.

    None where all curves of all channels are shown whole.
    """
    whole = np.max([np.nan_to_num(np.abs(response)).max(axis=0) for *_, response in drawn], axis=0) <= WHOLE
    found = []
    for name, G, grid, response in drawn:
        L = np.concatenate([closing(G, grid[0]), response]) if arcs else response
        size = np.abs(L)
        there = (size > REACH) & ~whole
        rim = np.divide(REACH * L, size, out=np.full_like(L, complex(np.nan, np.nan)), where=there)
        found.append((name, G, grid, rim))
    return [] if whole.all() else found


def _right_angles(axis: Any) -> None:
    """Ticks of a phase at parts or multiples of a right angle, seven at most."""
    from matplotlib.ticker import MultipleLocator

    low, high = axis.get_view_interval()
    fitting = (step for step in (5, 15, 30, 45, 90, 180, 360) if (high - low) / step <= 7)
    axis.set_major_locator(MultipleLocator(next(fitting, 720)))


def _within_reach(ax: Any) -> None:
    """Limits about -1 and the curves, as far as these are shown; a square, so that circles have room."""
    points = np.vstack([line.get_xydata() for line in ax.lines])
    points = points[np.isfinite(points).all(axis=1)]
    size = np.hypot(points[:, 0], points[:, 1])
    near = points[size <= (WHOLE if size.max() <= WHOLE else REACH * 1.001)]
    middle, half = (near.max(axis=0) + near.min(axis=0)) / 2, 0.55 * np.ptp(near, axis=0).max()
    ax.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))


def _closed_loop_grid(ax: Any) -> None:
    """Lines of |L / (1 + L)| about all curves of the axes, and the limits."""
    for old in [each for each in (*ax.lines, *ax.texts) if each.get_gid() == "closed loop"]:
        old.remove()
    points = np.vstack([line.get_xydata() for line in ax.lines])
    points = points[np.isfinite(points).all(axis=1) & (np.abs(points[:, 1]) <= HEIGHT)]
    corners = np.vstack([points, [[-225.0, -20.0], [-135.0, 20.0]]])
    (low, bottom), (high, top) = corners.min(axis=0), corners.max(axis=0)
    low, high, bottom, top = low - 8, high + 8, bottom - 2, top + 2
    around = np.linspace(0, 2 * np.pi, 723)[1:-1]
    lines: dict[str, Any] = {"color": "0.7", "lw": 0.6, "ls": ":", "gid": "closed loop", "zorder": 1, "label": "_grid"}
    text: dict[str, Any] = {"color": "0.45", "fontsize": "x-small", "gid": "closed loop", "clip_on": True}
    for level in LEVELS:
        M = 10 ** (level / 20)
        T = M * np.exp(1j * around)
        L = T / (1 - T)
        phase = np.degrees(np.unwrap(np.angle(L))) - 360
        turns = np.arange(np.floor((low - phase.max()) / 360), np.ceil((high - phase.min()) / 360) + 1)
        for turn in 360 * turns:
            ax.plot(phase + turn, _decibels(L), **lines)
        if 0 < level < max(LEVELS):  # ovals round -180 degrees: at the top; the smallest has no room
            ax.text(-180, _decibels(M / (M - 1)), f"{level} dB", ha="center", va="bottom", **text)
        elif level < 0:  # lines from left to right: at the right edge
            cosine = np.cos(np.radians(high))
            size = (M**2 * cosine + M * np.sqrt(M**2 * cosine**2 + 1 - M**2)) / (1 - M**2)
            ax.text(high - 2, _decibels(size), f"{level} dB", ha="right", va="bottom", **text)
    ax.set(xlim=(low, high), ylim=(bottom, top))


def _legend(ax: Any, found: list) -> None:
    if len(found) > 1 and any(name for name, _ in found):
        ax.legend(fontsize="small")
