"""Pictures of a design for people who look rather than read.

They are drawn on the caller's axes, or on new ones, in the caller's style. matplotlib is imported when a picture is
asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from synth.errors import ModelError
from synth.systems.statespace import StateSpace

if TYPE_CHECKING:
    from synth.synthesis.design import Design

POINTS = 400  # frequencies of a curve
PEAK = 1e3  # times the highest of them: a peak beyond is not shown
DECADES = 2.0  # shown below the slowest pole and, in continuous time, above the fastest


def frequencies(*systems: StateSpace) -> np.ndarray:
    """A logarithmic grid (N,) in rad/s about the poles of all systems; up to Nyquist in discrete time."""
    speeds = np.concatenate([_speeds(G) for G in systems])
    speeds = speeds[speeds > 1e-9 * speeds.max(initial=0.0)]
    low, high = (speeds.min(), speeds.max()) if speeds.size else (1.0, 1.0)
    low, high = low * 10**-DECADES, high * 10**DECADES
    nyquist = min((np.pi / G.dt for G in systems if G.discrete), default=np.inf)
    high = min(high, nyquist) if np.isinf(nyquist) else nyquist
    return np.geomspace(min(low, 1e-3 * high), high, POINTS)


def sigma(G: StateSpace, omega: np.ndarray) -> np.ndarray:
    """Singular values of the frequency response at omega (N,) rad/s: (N, min(nu, ny)), largest first."""
    return np.array([np.linalg.svd(G.frequency_response(w), compute_uv=False) for w in omega])


def sigma_plot(system: Any, ax: Any = None, *, omega: Any = None, label: str | None = None, **style: Any) -> Any:
    """Singular values of a system against frequency.

    Parameters
    ----------
    system : StateSpace, `control.StateSpace` or (A, B, C, D, dt)
    ax : axes to draw on; new ones by default
    omega : (N,) rad/s; chosen about the poles by default
    label : for the legend
    style : of the lines, as of `matplotlib.axes.Axes.plot`

    Returns
    -------
    matplotlib.axes.Axes
    """
    G = StateSpace.of(system)
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(layout="constrained")[1]
    grid = frequencies(G) if omega is None else np.asarray(omega, float)
    first, *others = sigma(G, grid).T
    (line,) = ax.plot(grid, first, label=label, **style)
    for values in others:
        ax.plot(grid, values, **{"color": line.get_color(), **style})
    ax.set(xscale="log", yscale="log", xlabel="frequency, rad/s", ylabel="singular values")
    return ax


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
    sigma_plot(design.closed_loop, loop, omega=grid, label=label or "closed loop", **style)
    color = loop.lines[-1].get_color()  # one for each design
    name = f"{label}, " if label else ""
    loop.axhline(design.gamma, color=color, ls="--", label=f"{name}gamma {design.gamma:.6g}")
    loop.axhline(design.verified_norm, color=color, ls=":", label=f"{name}verified norm {design.verified_norm:.6g}")
    sigma_plot(design.controller, controller, omega=grid, label=label or "controller", **{"color": color, **style})
    loop.set_title("closed loop, w to z")
    controller.set_title("controller, y to u")
    for each in ax:
        each.legend(fontsize="small")
    return ax


def _speeds(G: StateSpace) -> np.ndarray:
    """Natural frequencies of the poles, rad/s."""
    poles = G.poles().astype(complex)
    if not G.discrete:
        return np.abs(poles)
    poles = poles[np.abs(poles) > 1e-12]
    return np.minimum(np.abs(np.log(poles)) / G.dt, np.pi / G.dt)
