"""The figures of the geostationary study, as the thesis's are numbered, and the fuel of all against its bound."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import geo_controllers as design
import geo_drift as drift
import geo_filter as filters
import geo_limited as limited
import matplotlib as mpl
import numpy as np
from geo_flights import HOLD, Flight
from geo_sensitivity import OMEGA
from matplotlib.figure import Figure

from plants import Section, drawings, figures
from plants.missions.geo import DAY
from plants.outcome.inline import BOUND, COLOURS, STYLE

if TYPE_CHECKING:
    from geo_flights import Study

AXES = ("x", "y", "z")  # radial, along the track, normal to the plane
FLOOR = 1e-4  # m, below which a logarithm shows nothing
SHOWN = (design.THESIS_LQR, design.MIXED, design.LQR, design.FUEL)
SATURATED = (design.THESIS_LQR, design.MIXED, limited.MIXED_TOLD, limited.QUADRATIC)
Drawn = list[tuple[Figure, str]]


def bars(found: Study) -> Figure:
    """Fuel from 100 m in 1000 minutes of every controller, and the bound."""
    flights = dict(sorted(found.chapter6.items(), key=lambda item: -item[1].delta_v()))
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 0.9 + 0.3 * len(flights)), layout="constrained")
        ax: Any = fig.subplots()
        for k, flight in enumerate(flights.values()):
            met, fuel = flight.farthest(found.settle) <= found.box, flight.delta_v()
            ax.barh(k, fuel, color=COLOURS[0] if met else "none", edgecolor=COLOURS[0], height=0.7)
            ax.text(1.08 * fuel, k, f"{fuel:.2f}{'' if met else ', misses 10 cm'}", va="center", fontsize="small")
        if HOLD in found.bounds:
            ax.axvline(found.bounds[HOLD].lower, color=BOUND, ls="--", lw=0.9)
        ax.set_yticks(range(len(flights)), [*flights])
        ax.set_xscale("log")
        ax.set_xlim(0.03, 100)
        ax.xaxis.set_major_formatter("{x:g}")
        ax.set_xlabel("m/s from 100 m in 1000 minutes; dashed: no control needs less")
        ax.grid(axis="y", visible=False)
        return fig


def first(found: Study) -> tuple[Figure, str] | None:
    """The figure that says most."""
    caption = (
        "What bringing the satellite from 100 m within 10 cm costs; an empty bar does not get there in 100 minutes."
    )
    return (bars(found), caption) if found.chapter6 else None


def drifts(found: Study) -> Drawn:
    """Figures 2.4, 2.9, 2.10 and 2.12."""
    if drift.ALL not in found.drift:
        return []
    names = (drift.J2, drift.J2_KEPLER, drift.MOON, drift.SUN, drift.ALL)
    series = {
        name: (d.time, np.hstack([d.radial, d.position]) / 1e3)
        for name, d in ((name, found.drift[name]) for name in names)
    }
    rows = ["r2 - r1, km", *(f"{axis}, km" for axis in AXES)]
    return [
        (
            figures.histories(series, rows),
            "Two days without thrust from the ideal point (figures 2.4, 2.9, 2.10, 2.12).",
        )
    ]


def estimates(found: Study) -> Drawn:
    """Figures 3.3 to 3.6."""
    if filters.OURS_UNTOLD not in found.tracked:
        return []
    names = (filters.PAPER, filters.PAPER_TOLD, filters.OURS)
    series = {}
    for name in names:
        tracked = found.tracked[name]
        run = tracked.runs[0]
        radius = (run.estimates - run.outputs)[:, :1]  # to first order r2 is r1 + x
        error = np.abs(np.hstack([tracked.errors[0][:, :3], radius]))
        series[name] = run.time[::5], np.maximum(error[::5], FLOOR)
    rows = [f"|error of {what}|, m" for what in (*AXES, "r2")]
    caption = (
        "One of the filters after a first guess about 1 km off (figures 3.3 to 3.6, as errors): the three measurements "
        "of the thesis leave y where it was guessed."
    )
    return [(figures.histories(series, rows, scale="log"), caption)]


def from_near(found: Study) -> Drawn:
    """Figures 4.2 to 4.4 and 5.8 to 5.11."""
    picked = []
    if found.near:
        series = {name: (f.time, 100 * f.position) for name, f in found.near.items()}
        fig = figures.histories(series, [f"{axis}, cm" for axis in AXES], until=2 * found.settle)
        picked.append((fig, "From 1 m in each axis, 200 minutes, all perturbations (figures 4.3, 4.4, 5.10, 5.11)."))
    if found.peaks:
        picked += [
            (
                weights(found),
                "Largest singular values of S and T against the inverse of their weights (figures 5.8, 5.9).",
            ),
            (eigenvalues(found), "Eigenvalues of the regulator of section 4.4 and the unit circle (figure 4.2)."),
        ]
    return picked


def weights(found: Study) -> Figure:
    """S against 1 / wP, T against 1 / wI, of chapter 5 and chapter 6."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 5.6), layout="constrained")
        axes: Any = fig.subplots(2, 1, sharex=True)
        chapters = {"chapter 5": design.CHAPTER5, "chapter 6": design.CHAPTER6}
        for (name, w), colour in zip(chapters.items(), COLOURS, strict=False):
            wP, _, wI = design.thesis_weights(w)
            for ax, weight, label in zip(axes, (wP, wI), ("1 / wP", "1 / wI"), strict=True):
                gain = [abs(weight.frequency_response(f)[0, 0]) for f in OMEGA]
                ax.plot(OMEGA, 1 / np.array(gain), color=colour, ls=":", label=f"{label}, {name}")
        drawn = {design.MIXED5: COLOURS[0], design.MIXED: COLOURS[1], design.MIXED5_CHEAP: COLOURS[2]}
        for name, colour in drawn.items():
            for ax, curve in zip(axes, (found.peaks[name].S, found.peaks[name].T), strict=True):
                ax.plot(OMEGA, np.maximum(curve, 1e-6), color=colour, label=name)
        for ax, label in zip(axes, ("S", "T"), strict=True):
            ax.set(xscale="log", yscale="log", ylabel=label, ylim=(1e-4, 10))
            for each in (ax.xaxis, ax.yaxis):
                each.set_major_formatter("{x:g}")
            ax.legend(fontsize="small")
        axes[1].set_xlabel("frequency, rad/min")
        return fig


def eigenvalues(found: Study) -> Figure:
    """In the unit circle."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 3.6), layout="constrained")
        ax: Any = fig.subplots()
        circle = np.exp(1j * np.linspace(-0.6, 0.6, 200))
        ax.plot(circle.real, circle.imag, color=BOUND, ls="--", lw=0.9)
        found_at = design.thesis_regulator(found.rate, 100)[1]
        ax.plot(found_at.real, found_at.imag, "x", ms=7)
        ax.set(xlabel="real", ylabel="imaginary", aspect="equal", xlim=(0.82, 1.02), ylim=(-0.1, 0.1))
        return fig


def distance(flights: Mapping[str, Flight], box: float, settle: float) -> Figure:
    """The error in each axis on a logarithmic scale, with the box it is to be in from `settle` s on."""
    series = {name: (flight.time, np.maximum(np.abs(flight.position), FLOOR)) for name, flight in flights.items()}
    fig = figures.histories(series, [f"|{axis}|, m" for axis in AXES], until=3 * settle, scale="log")
    for ax in fig.axes:
        ax.plot([settle, 3 * settle], [box, box], color=BOUND, ls="--", lw=0.9)
    return fig


def forces(flights: Mapping[str, Flight], until: float) -> Figure:
    """Thrust of all axes, one row for each controller, each with its own scale."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 0.8 + 1.4 * len(flights)), layout="constrained")
        rows = fig.subplots(len(flights), 1, sharex=True, squeeze=False)[:, 0]
        for ax, (name, flight) in zip(rows, flights.items(), strict=True):
            shown = flight.time <= until
            ax.set_title(name, fontsize="small")
            for label, force in zip(AXES, flight.force.T, strict=True):
                ax.step(flight.time[shown] / design.MINUTE, force[shown], where="post", lw=0.8, label=f"F{label}")
            ax.set_ylabel("N")
        rows[-1].set_xlabel("time, min")
        fig.legend(*rows[0].get_legend_handles_labels(), loc="outside upper left", ncols=3)
        return fig


def far(flights: Mapping[str, Flight], until: float | None = None) -> Figure:
    """Distance from the ideal point, 1 km and 1 N."""
    series = {name: (f.time, np.linalg.norm(f.position, axis=1, keepdims=True)) for name, f in flights.items()}
    return figures.histories(series, ["distance, m"], scale="log", until=until)


def keeping(found: Study) -> Figure:
    """Days in boxes: position over the half-width of the box, and fuel."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 6.4), layout="constrained")
        rows: Any = fig.subplots(4, 1, sharex=True)
        for name, kept in found.kept.items():
            flight = kept.flights[0]
            days = flight.time / DAY
            for i, label in enumerate(AXES):
                rows[i].plot(days, flight.position[:, i] / kept.box, lw=0.8, label=name, rasterized=True)
                rows[i].set_ylabel(f"{label} / box")
                rows[i].set_ylim(-1.4, 1.4)
            rows[3].plot(
                days, np.cumsum(np.abs(flight.acceleration).sum(axis=1)) * flight.step, lw=1.0, rasterized=True
            )
        rows[3].set_ylabel("delta-v, m/s")
        rows[3].set_xlabel("time, days")
        fig.legend(*rows[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
        return fig


def chapter6(found: Study) -> Drawn:
    """Figures 6.1 to 6.8, and the cures."""
    picked: Drawn = []
    chosen = {name: found.chapter6[name] for name in SHOWN if name in found.chapter6}
    if chosen:
        picked += [
            (
                distance(chosen, found.box, found.settle),
                "From 100 m in each axis (figures 6.1, 6.3). Dashed: 10 cm, from 100 minutes on.",
            ),
            (forces(chosen, found.settle), "Thrust on 1000 kg (figures 6.2, 6.4), each on its own scale."),
        ]
    limit = found.saturated | found.windup
    if all(name in limit for name in SATURATED):
        some = {name: limit[name] for name in SATURATED}
        picked += [
            (far(found.saturated), "From 1 km in each axis with 1 N (figures 6.5, 6.7)."),
            (
                far(some, 2.5 * found.settle),
                "The same with what is to cure the oscillation: anti-windup and predictive control.",
            ),
            (forces(some, 2.5 * found.settle), "Thrust with the limit of 1 N (figures 6.6, 6.8)."),
        ]
    return picked


def sections(found: Study) -> list[Section]:
    """What there is to see of the flights that were made."""
    boxes = (
        [
            (
                keeping(found),
                "Keeping a box with Moon, Sun, the Earth's shape and solar pressure, one seed of each. Position in "
                "half-widths of the box; delta-v of all axes.",
            )
        ]
        if found.kept
        else []
    )
    every = {
        "Free drift": drifts(found),
        "The filter": estimates(found),
        "Chapters 4 and 5": from_near(found),
        "Chapter 6": chapter6(found),
        "Boxes": boxes,
    }
    return [drawings(title, picked) for title, picked in every.items() if picked]
