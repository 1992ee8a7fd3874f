"""Where a body axis points, on a map and on a sphere, and where a satellite passes over the Earth."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jax.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.outcome.attitudeplots import demand_attitude
from plants.outcome.inline import BOUND
from plants.surroundings.ground import ground_track

if TYPE_CHECKING:
    from plants.simulation.loop import Run

FRAMES = {"N": "inertial frame N", "O": "frame O"}
POINTS = 2000  # of a ground track: more are not seen


def body_axis(run: Run, axis: ArrayLike, frame: str = "N") -> np.ndarray:
    """Direction of a body axis over time, (N, 3) unit vectors in the axes of a frame.

    Parameters
    ----------
    run : of a body with an attitude
    axis : (3,) of length one, body axes
    frame : "N", or "O": that which the outputs are relative to, in a guided environment the commanded one

    Raises
    ------
    ScenarioError
        A run without attitude, an axis that is not of length one, another frame.
    """
    demand_attitude(run)
    a = real("axis", axis, (3,))
    length = float(np.linalg.norm(a))
    if abs(length - 1) > 1e-6:
        raise ScenarioError(f"axis = {a.tolist()} has length {length:.7g}: give a direction of length 1")
    if frame not in FRAMES:
        raise ScenarioError(f"frame = {frame!r}: give one of {', '.join(map(repr, FRAMES))}")
    with jax.enable_x64(True):
        q = attitude.from_vector_part(run.outputs[:, :3]) if frame == "O" else run.states.q
        return np.asarray(attitude.rotate(attitude.conjugate(q), np.broadcast_to(a, (len(run.time), 3))))


def attitude_sphere(run: Run, axis: ArrayLike, *, frame: str = "N", ax: Any = None) -> np.ndarray:
    """Where a body axis points over time: on a map of all directions (Mollweide) and on a sphere, coloured by time.

    The map has the azimuth from x to y across and the elevation to z up, in degrees. A circle is the start, a square
    the end.

    Parameters
    ----------
    run, axis, frame : as for `body_axis`
    ax : two axes, of the projections "mollweide" and "3d"; new ones by default

    Returns
    -------
    (2,) of matplotlib.axes.Axes, the map first

    Raises
    ------
    ScenarioError
        As `body_axis`; a run without samples, axes of other projections.
    """
    points = body_axis(run, axis, frame)
    if not len(points):
        raise ScenarioError(f"the run has no samples to show: it failed at {run.failed_at:g} s ({run.culprit})")
    chart, ball = _axes(ax)
    azimuth, elevation = np.arctan2(points[:, 1], points[:, 0]), np.arcsin(np.clip(points[:, 2], -1, 1))
    dots = chart.scatter(azimuth, elevation, c=run.time, s=5, lw=0, zorder=3, rasterized=True)
    chart.plot(*_broken(azimuth, elevation), color="0.5", lw=0.7)
    for k, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        style = {"marker": marker, "s": 45, "facecolors": "none", "edgecolors": BOUND, "label": name, "zorder": 4}
        chart.scatter(azimuth[k], elevation[k], **style)
        ball.scatter(*points[k], **style)
    chart.grid(alpha=0.4)
    chart.set_xticks(np.radians([-120, -60, 0, 60, 120]))
    chart.set_yticks(np.radians([-60, -30, 0, 30, 60]))
    chart.tick_params(labelsize="small")
    chart.set_title(f"body axis {_told(axis)} in {FRAMES[frame]}, azimuth and elevation", fontsize="medium", pad=12)
    chart.legend(loc="lower left", bbox_to_anchor=(0.0, -0.2), fontsize="small", frameon=False)
    chart.figure.colorbar(dots, ax=ball, shrink=0.7, label="time, s")
    _sphere(ball)
    ball.plot(*points.T, color="0.5", lw=0.7)
    ball.scatter(*points.T, c=run.time, s=5, lw=0)
    return np.array([chart, ball], object)


def ground_track_plot(orbit: Any, epoch: datetime, times: ArrayLike, ax: Any = None) -> Any:
    """Map of the Earth with the track below a satellite, in degrees, without coast lines: one axes.

    Parameters
    ----------
    orbit : positions (n, 3) m in frame N at the times, or an environment with `at(t)`
    epoch : UTC of time 0, that with which the environment was made
    times : (n,) s, such as ``run.time``; at most 2000 of them are drawn
    ax : axes; a new one by default

    Raises
    ------
    ScenarioError
        As `plants.surroundings.ground.ground_track`; several orbits.
    """
    t = real("times", times, (None,))
    some = slice(None, None, -(-len(t) // POINTS) or 1)
    if not hasattr(orbit, "at"):
        orbit = real("orbit", orbit, (len(t), 3))[some]
    t = t[some]
    track = ground_track(orbit, epoch, t)
    latitude, longitude = np.degrees(track.latitude), np.degrees(track.longitude)
    if ax is None:
        import matplotlib.pyplot as plt

        ax = plt.subplots(figsize=(8.0, 4.4), layout="constrained")[1]
    (line,) = ax.plot(*_broken(longitude, latitude, 360.0), lw=1.2)
    for k, marker, name in ((0, "o", "start"), (-1, "s", "end")):
        ax.plot(longitude[k], latitude[k], marker, mfc="none", color=line.get_color(), label=name)
    ax.set(xlim=(-180, 180), ylim=(-90, 90), xlabel="longitude, deg", ylabel="latitude, deg", aspect="equal")
    ax.set_xticks(range(-180, 181, 60))
    ax.set_yticks(range(-90, 91, 30))
    ax.grid(alpha=0.4)
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, fontsize="small", frameon=False, borderaxespad=0.2)
    return ax


def _broken(across: np.ndarray, up: np.ndarray, turn: float = 2 * np.pi) -> tuple[np.ndarray, np.ndarray]:
    """The line, with a gap (NaN) wherever it leaves the map at one side and comes back at the other."""
    gaps = np.flatnonzero(np.abs(np.diff(across)) > turn / 2) + 1
    return np.insert(across, gaps, np.nan), np.insert(up, gaps, np.nan)


def _axes(ax: Any) -> Sequence[Any]:
    """The caller's two axes, checked, or new ones."""
    if ax is None:
        import matplotlib.pyplot as plt

        fig = plt.figure(figsize=(10.0, 4.4), layout="constrained")
        left, right = fig.add_gridspec(1, 2, width_ratios=(3, 2))
        return fig.add_subplot(left, projection="mollweide"), fig.add_subplot(right, projection="3d")
    axes = list(np.ravel(ax))
    names = [each.name for each in axes]
    if names != ["mollweide", "3d"]:
        raise ScenarioError(f"ax has the projections {names}: give two axes, of 'mollweide' and '3d'")
    return axes


def _sphere(ax: Any) -> None:
    """Circles of a unit sphere and its three axes."""
    turn = np.linspace(0, 2 * np.pi, 73)
    for height in np.radians([-60, -30, 0, 30, 60]):
        c = np.cos(height)
        ax.plot(c * np.cos(turn), c * np.sin(turn), np.full_like(turn, np.sin(height)), color="0.85", lw=0.6)
    for side in np.radians(range(0, 180, 30)):
        ax.plot(np.cos(turn) * np.cos(side), np.cos(turn) * np.sin(side), np.sin(turn), color="0.85", lw=0.6)
    for k, name in enumerate("xyz"):
        tip = 1.25 * np.eye(3)[k]
        ax.plot(*np.stack([np.zeros(3), tip]).T, color="0.4", lw=0.8)
        ax.text(*(1.1 * tip), name, color="0.3", ha="center", va="center")
    ax.set_box_aspect((1, 1, 1), zoom=1.4)
    ax.set_axis_off()


def _told(axis: ArrayLike) -> str:
    """A direction in words."""
    a = np.asarray(axis, float)
    for k, name in enumerate("xyz"):
        for sign, mark in ((1, "+"), (-1, "-")):
            if np.allclose(a, sign * np.eye(3)[k], rtol=0, atol=1e-9):
                return mark + name
    return "(" + ", ".join(f"{x:.3g}" for x in a) + ")"
