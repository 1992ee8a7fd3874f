"""What people look at after a flight of a body with an attitude: degrees, mN m, rpm, and the mode of the mission."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Patch

from plants.checks import positive
from plants.errors import ScenarioError
from plants.outcome.indices import pointing_errors
from plants.outcome.inline import BOUND, COLOURS
from plants.outcome.plots import axes_for, run_plot

if TYPE_CHECKING:
    from plants.simulation.loop import Run

RPM = np.pi / 30  # rad/s
SAME = 1e-9  # rad, rad/s: estimates that are closer to the outputs are the outputs
AXES = ("x", "y", "z")
ANGLES = ("roll", "pitch", "yaw")
LEAST = 0.01  # share of the samples that may lie below a logarithmic scale
FAR = 20  # times the requirement, from which errors are shown on a scale that is logarithmic beyond it


@dataclass(frozen=True)
class Panel:
    """What one axes shows."""

    label: str  # with the unit
    values: np.ndarray  # (N, k)
    names: Sequence[str]  # (k,)
    bounds: Sequence[float] = ()  # levels that are drawn as dashed lines
    bound: str = ""  # what they are
    held: bool = False  # from sample to sample
    log: bool = False


def flight_plot(run: Run, ax: Any = None, **options: Any) -> np.ndarray:
    """`attitude_plot` of a body with an attitude, `run_plot` of any other run.

    Raises
    ------
    ScenarioError
        An option that the picture has not, and what these refuse.
    """
    draw: Callable[..., np.ndarray] = attitude_plot if has_attitude(run) else run_plot
    known = list(inspect.signature(draw).parameters)[2:]
    wrong = [name for name in options if name not in known]
    if wrong:
        kind = "with" if draw is attitude_plot else "without"
        raise ScenarioError(f"{wrong[0]} is no option for a run {kind} an attitude; there are {', '.join(known)}")
    return draw(run, ax, **options)


def has_attitude(run: Run) -> bool:
    """Whether the plant is a body with a quaternion, whose outputs begin with the vector part of an error."""
    shapes = [np.shape(getattr(run.states, name, ())) for name in ("q", "w")]
    n = len(run.time)
    return shapes == [(n, 4), (n, 3)] and run.outputs.ndim == 2 and run.outputs.shape[1] >= 6


def attitude_plot(
    run: Run,
    ax: Any = None,
    *,
    panels: Sequence[str] | None = None,
    requirement: float | None = None,
    speed_limit: float | None = None,
    torque_limit: float | None = None,
    modes: Sequence[str] = (),
) -> np.ndarray:
    """Pointing error, error of the estimate, rates, torques, dipole moments and wheel speeds against time.

    The pointing error is that of the true attitude against the commanded one: what `commanded_record` has recorded, the
    output against the reference otherwise. Where it exceeds 20 times the requirement, its scale is logarithmic beyond.

    Parameters
    ----------
    run : of a plant whose state has q (N, 4) and w (N, 3), and may have wheels (N, n)
    ax : one axes for each panel shown; new ones by default
    panels : of "angle", "axes", "estimate", "rate", "torque", "motors", "gimbals", "acting", "dipole", "acting dipole"
        and "wheels"; by default all that the run has: an estimate where it differs from the output, a dipole moment
        where commands have six entries
    requirement : () rad, of the pointing error
    speed_limit : () rad/s, of the wheels
    torque_limit : () N m, of the wheels' motors
    modes : names of the modes by index, where `run.extra` has a field `mode`; they colour the background

    Returns
    -------
    (k,) of matplotlib.axes.Axes

    Raises
    ------
    ScenarioError
        A run without attitude, a panel that it has not, levels that are not positive, fewer names than modes.
    """
    demand_attitude(run)
    found = _panels(run, requirement, speed_limit, torque_limit)
    wrong = [name for name in panels or () if name not in found]
    if wrong:
        raise ScenarioError(f"panels: the run has no {wrong[0]!r}; it has {', '.join(found)}")
    shown = [found[name] for name in (found if panels is None else panels)]
    bands = _bands(run, modes)
    axes = axes_for(ax, len(shown), rows=len(shown))
    for each, panel in zip(axes, shown, strict=True):
        _draw(each, run.time, panel)
        for start, end, mode in bands:
            each.axvspan(start, end, color=COLOURS[mode % len(COLOURS)], alpha=0.12, lw=0, zorder=0)
    axes[-1].set_xlabel("time, s")
    _tell_modes(axes[0], bands, modes)
    if ax is None:
        axes[0].figure.align_ylabels(axes)
    if not run.ok:
        axes[0].set_title(f"failed at {run.failed_at:g} s: {run.culprit}")
    return axes


def wheel_speed_plot(run: Run, ax: Any = None, *, limit: float | None = None) -> Any:
    """Speeds of the wheels in rpm against time, with their limit () rad/s: one axes.

    Raises
    ------
    ScenarioError
        A run whose state has no wheels (N, n), a limit that is not positive.
    """
    speeds = np.asarray(getattr(run.states, "wheels", np.zeros(0)))
    if speeds.ndim != 2 or not speeds.shape[1]:
        raise ScenarioError(f"the run has no wheels: its states are {_fields(run.states)}")
    (axes,) = axes_for(ax, 1, rows=1)
    _draw(axes, run.time, _wheels(speeds, limit, "limit"))
    axes.set_xlabel("time, s")
    return axes


def demand_attitude(run: Run) -> None:
    """Raise ScenarioError for a run without attitude."""
    if not has_attitude(run):
        raise ScenarioError(
            f"the run has no attitude: its states are {_fields(run.states)}, q (N, 4) and w (N, 3) with outputs (N, 6) "
            "are needed; run_plot draws any run"
        )


def _panels(
    run: Run, requirement: float | None, speed_limit: float | None, torque_limit: float | None
) -> Mapping[str, Panel]:
    """All that a run has, by name."""
    ape, _, ake, angle = pointing_errors(run)
    told = np.asarray(_field(run.extra, "error", np.zeros(0)))
    if told.shape == (len(run.time), 6):  # against the frame of the mode
        commanded = dataclasses.replace(run, outputs=told, references=np.zeros_like(told))
        ape, _, _, angle = pointing_errors(commanded)
    level = _level("requirement", requirement)
    bounds = [float(np.degrees(a)) for a in level]
    what = "requirement" if level else ""
    found = {
        "angle": Panel("pointing error, deg", np.degrees(angle)[:, None], ["angle"], bounds, what, log=True),
        "axes": Panel(
            "pointing error, deg", np.degrees(ape), ANGLES, [sign * b for b in bounds for sign in (1, -1)], what
        ),
    }
    if len(run.time) and np.abs(run.estimates - run.outputs).max() > SAME:
        found["estimate"] = Panel("estimate error, deg", np.degrees(ake), ANGLES)
    found["rate"] = Panel("inertial rate, deg/s", np.degrees(run.states.w), AXES)
    return found | _efforts(run, _level("torque_limit", torque_limit)) | _speeds(run, speed_limit)


def _efforts(run: Run, limit: Sequence[float]) -> dict[str, Panel]:
    """Torques and dipole moments as asked for, and as they act: the input of `RigidBody` or of `Satellite`."""
    n = np.shape(getattr(run.states, "wheels", np.zeros((0, 0))))[-1]
    gimbals = np.shape(_field(run.states, "gimbals", np.zeros((0, 0))))[-1]
    asked, motors, rates, rest = run.commands, *np.split(run.inputs, [n, n + gimbals], axis=1)
    dipoles = asked.shape[1] == 6  # torque, dipole moment
    magnetic = 3 * (dipoles and hasattr(run.states, "gimbals"))  # `Satellite` makes the torque of a dipole itself
    dipole, torque = rest[:, :magnetic], rest[:, magnetic:]
    bounds = [sign * 1e3 * a for a in limit for sign in (1, -1)]
    found = {}
    if asked.shape[1] in (3, 6):
        found["torque"] = Panel("commanded torque, mN m", 1e3 * asked[:, :3], AXES, held=True)
    if n and motors.shape[1] == n:
        names = [f"motor {i}" for i in range(n)]
        found["motors"] = Panel("wheel torque, mN m", 1e3 * motors, names, bounds, "limit" if bounds else "", held=True)
    if gimbals and rates.shape[1] == gimbals:
        found["gimbals"] = Panel(
            "gimbal rate, deg/s", np.degrees(rates), [f"gimbal {i}" for i in range(gimbals)], held=True
        )
    if torque.shape[1] == 3:
        found["acting"] = Panel("acting torque, mN m", 1e3 * torque, AXES, held=True)
    if dipoles:
        found["dipole"] = Panel("commanded dipole, A m²", asked[:, 3:], AXES, held=True)
    if dipole.shape[1] == 3:
        found["acting dipole"] = Panel("acting dipole, A m²", dipole, AXES, held=True)
    return found


def _speeds(run: Run, limit: float | None) -> dict[str, Panel]:
    """Wheel speeds, if there are wheels."""
    speeds = np.asarray(getattr(run.states, "wheels", np.zeros((0, 0))))
    return {"wheels": _wheels(speeds, limit, "speed_limit")} if speeds.ndim == 2 and speeds.shape[1] else {}


def _wheels(speeds: np.ndarray, limit: float | None, name: str) -> Panel:
    bounds = [sign * a / RPM for a in _level(name, limit) for sign in (1, -1)]
    names = [f"wheel {i}" for i in range(speeds.shape[1])]
    return Panel("wheel speed, rpm", speeds / RPM, names, bounds, "limit" if bounds else "")


def _draw(ax: Any, time: np.ndarray, panel: Panel) -> None:
    """Lines with their names at the right of the axes, where they hide nothing."""
    for name, column in zip(panel.names, panel.values.T, strict=True):
        ax.plot(time, column, label=name, drawstyle="steps-post" if panel.held else "default")
    for i, bound in enumerate(panel.bounds):
        ax.axhline(bound, color=BOUND, ls="--", lw=1.0, label=None if i else panel.bound)
    peak = np.max(np.abs(panel.values), initial=0.0, where=np.isfinite(panel.values))
    there = panel.values[panel.values > 0]
    if panel.log and there.size:
        ax.set_yscale("log")
        ax.set_ylim(bottom=0.5 * min([np.quantile(there, LEAST), *panel.bounds]))  # not a moment at 1e-13 deg
        ax.yaxis.set_major_formatter("{x:g}")
    elif panel.bounds and panel.bound == "requirement" and peak > FAR * panel.bounds[0]:
        ax.set_yscale("symlog", linthresh=panel.bounds[0])
        ends = [10.0 ** np.floor(np.log10(peak)), panel.bounds[0]]
        ax.set_yticks([ends[0], ends[1], 0.0, -ends[1], -ends[0]])
        ax.yaxis.set_major_formatter("{x:g}")
    ax.set_ylabel(panel.label.replace(", ", ",\n"), fontsize="small")
    ax.tick_params(labelsize="small")
    if len(panel.names) > 1 or panel.bounds:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), fontsize="small", frameon=False, borderaxespad=0.3)
    if len(time) > 1:
        ax.set_xlim(time[0], time[-1])


def _bands(run: Run, names: Sequence[str]) -> list[tuple[float, float, int]]:
    """Start and end, s, and index of every stay in a mode."""
    mode = _field(run.extra, "mode", None)
    if mode is None or not len(run.time):
        if names and mode is None:
            raise ScenarioError("modes: run.extra has no field mode; simulate with record=plants.commanded_record")
        return []
    mode = np.asarray(mode)
    if mode.shape != run.time.shape or not (mode == np.round(mode)).all() or (mode < 0).any():
        raise ScenarioError(f"run.extra.mode of shape {mode.shape} is no index for each of {len(run.time)} samples")
    mode = mode.astype(int)
    if names and len(names) <= mode.max():
        raise ScenarioError(f"modes = {list(names)}: the run was in mode {mode.max()}, give a name for each from 0")
    begins = np.flatnonzero(np.r_[True, np.diff(mode) != 0])
    ends = np.r_[run.time[begins[1:]], run.time[-1]]
    return [(float(run.time[k]), float(end), int(mode[k])) for k, end in zip(begins, ends, strict=True)]


def _tell_modes(ax: Any, bands: Sequence[tuple[float, float, int]], names: Sequence[str]) -> None:
    """The colours of the modes above the axes, in the order of their first stay."""
    order = list(dict.fromkeys(mode for _, _, mode in bands))
    if not order:
        return
    patches = [
        Patch(color=COLOURS[m % len(COLOURS)], alpha=0.3, lw=0, label=names[m] if names else f"mode {m}") for m in order
    ]
    lines = ax.get_legend()
    place = {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "fontsize": "small", "frameon": False}
    ax.legend(handles=patches, ncols=min(5, len(order)), borderaxespad=0.2, **place)
    if lines is not None:
        ax.add_artist(lines).set_clip_on(False)  # so that the layout makes room for it


def _level(name: str, value: float | None) -> list[float]:
    """A level as a list of one, checked, or of none."""
    return [] if value is None else [float(positive(name, value))]


def _field(tree: Any, name: str, otherwise: Any) -> Any:
    """A field of a tuple or a dict."""
    return tree.get(name, otherwise) if isinstance(tree, Mapping) else getattr(tree, name, otherwise)


def _fields(states: Any) -> str:
    """What a state is made of, in words."""
    return ", ".join(getattr(states, "_fields", ())) or "without names"
