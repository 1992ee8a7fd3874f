"""The figures of the geostationary study: counterparts of the thesis's 6.1 to 6.8, and the fuel against the bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import geo_controllers as design
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from plants import Section, drawings, figures
from plants.missions.geo import DAY
from plants.outcome.report import BOUND, STYLE

if TYPE_CHECKING:
    from geo import Flight, Study

AXES = ("x", "y", "z")  # radial, along the track, normal to the plane
FLOOR = 1e-4  # m, below which a logarithm shows nothing
SHOWN = (design.THESIS_LQR, design.MIXED, design.LQR, design.FUEL)


def distance(flights: Mapping[str, Flight], box: float, settle: float) -> Figure:
    """The error in each axis on a logarithmic scale, with the box it is to be in from `settle` s on."""
    series = {name: (flight.time, np.maximum(np.abs(flight.position), FLOOR)) for name, flight in flights.items()}
    fig = figures.histories(series, [f"|{axis}|, m" for axis in AXES], until=3 * settle, scale="log")
    for ax in fig.axes:
        ax.plot([settle, 3 * settle], [box, box], color=BOUND, ls="--", lw=0.9)
    return fig


def forces(flights: Mapping[str, Flight], until: float) -> Figure:
    """Thrust in each axis, one column for each controller, each with its own scale."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(2.2 * len(flights) + 0.6, 5.0), layout="constrained")
        axes = fig.subplots(3, len(flights), sharex=True, squeeze=False)
        for j, (name, flight) in enumerate(flights.items()):
            shown = flight.time <= until
            axes[0, j].set_title(name, fontsize="small")
            for i, label in enumerate(AXES):
                axes[i, j].step(flight.time[shown] / design.MINUTE, flight.force[shown, i], where="post", lw=0.8)
                axes[i, j].set_ylabel(f"F{label}, N")
            axes[-1, j].set_xlabel("time, min")
        return fig


def far(flights: Mapping[str, Flight]) -> Figure:
    """Distance from the ideal point, 1 km and 1 N."""
    series = {name: (f.time, np.linalg.norm(f.position, axis=1, keepdims=True)) for name, f in flights.items()}
    return figures.histories(series, ["distance, m"], scale="log")


def keeping(flights: Mapping[float, Flight], boxes: Sequence[float]) -> Figure:
    """Days in boxes: position over the half-width of the box, and fuel."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(8.0, 6.0), layout="constrained")
        rows: Any = fig.subplots(4, 1, sharex=True)
        for box in boxes:
            flight = flights[box]
            days = flight.time / DAY
            for i, label in enumerate(AXES):
                rows[i].plot(days, flight.position[:, i] / box, lw=0.8, label=f"+-{box:g} m", rasterized=True)
                rows[i].set_ylabel(f"{label} / box")
            rows[3].plot(days, np.cumsum(np.abs(flight.acceleration).sum(axis=1)) * flight.step, lw=1.0)
        rows[3].set_ylabel("delta-v, m/s")
        rows[3].set_xlabel("time, days")
        fig.legend(*rows[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        return fig


def sections(found: Study) -> list[Section]:
    """What there is to see of the flights that were made."""
    drawn = []
    chosen = {name: found.chapter6[name] for name in SHOWN if name in found.chapter6}
    if chosen:
        drawn.append(
            (
                distance(chosen, found.box, found.settle),
                "From 100 m in each axis (figures 6.1 and 6.3). Dashed: 10 cm, from 100 minutes on.",
            )
        )
        drawn.append((forces(chosen, found.settle), "Thrust on 1000 kg (figures 6.2 and 6.4), each on its own scale."))
    if found.saturated:
        drawn.append((far(found.saturated), "From 1 km in each axis with 1 N (figures 6.5 and 6.7)."))
    if found.kept:
        drawn.append(
            (
                keeping(found.kept, list(found.kept)),
                "Keeping a box with Moon, Sun, the Earth's shape and "
                "solar pressure. Position in half-widths of the box; delta-v of all axes.",
            )
        )
    return [drawings("Figures", drawn)] if drawn else []
