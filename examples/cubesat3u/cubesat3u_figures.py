"""Counterparts of the figures 7 to 16 of Pecorilla and Stesina (2024)."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
from cubesat3u_claims import AXES, BOUNDS, INDICES, PAPER, PAPER_HINF, worst
from cubesat3u_modes import turned
from matplotlib.figure import Figure

from plants import Run, attitude, cubesat3u, figures, pointing_errors, report, stability, study
from plants.missions.cubesat3u import DEG, REQUIREMENTS
from plants.outcome.indices import error


def indices_figure(found: Any) -> Figure:
    """Every run's indices, worst axis, against the requirements, for all configurations flown."""
    done = {n: c for n, c in found.campaigns.items() if c.results is not None}
    values = {index: np.full((len(done), max(len(c.index) for c in done.values())), np.nan) for index in INDICES}
    for row, c in enumerate(done.values()):
        for index, key in INDICES.items():
            values[index][row, : len(c.index)] = worst(c.results, key)
    return figures.levels(list(done), values, BOUNDS, "deg")


def drawings(found: Any) -> list[report.Section]:
    """Counterparts of the paper's figures 7 to 16."""
    runs: dict[str, Run] = {n: found.campaigns[n].kept[0] for n in PAPER if n in found.nominal}
    j, period = cubesat3u.WHEEL_INERTIA[0], cubesat3u.CONTROL_PERIOD / cubesat3u.SAMPLES
    early = 100.0
    shown = [
        (figures.histories({n: (r.time, r.outputs[:, :3]) for n, r in runs.items()}, ("q1", "q2", "q3"), until=early),
         "Quaternion from the orbital frame, start of table 3 (the paper's figure 7)."),
        (figures.histories({n: (r.time, r.outputs[:, 3:] / DEG) for n, r in runs.items()},
                           tuple(f"w{a}, deg/s" for a in "xyz"), until=early),
         "Rate relative to the orbital frame (figure 8)."),
        (figures.histories(
            {n: (r.time, np.hstack([r.inputs / j, r.states.wheels])) for n, r in runs.items()},
            (*(f"acc. {a}, rad/s2" for a in "xyz"), *(f"speed {a}, rad/s" for a in "xyz")), until=early),
         "Reaction wheels: acceleration by the motor, and speed (figure 9)."),
    ]  # fmt: skip
    for number, (index, key) in enumerate((("AKE", "ake"), ("APE", "ape"), ("control error", "control_error")), 10):
        series = {n: (r.time[r.time >= found.window], getattr(pointing_errors(r), key)[r.time >= found.window] / DEG)
                  for n, r in runs.items()}  # fmt: skip
        shown.append((
            figures.against_bound(series, AXES, BOUNDS[index], "deg"),
            f"{index} in the steady state with its requirement (figure {number}).",
        ))  # fmt: skip
    lag = round(REQUIREMENTS.pse_interval / period)
    series = {}
    for n, r in runs.items():
        late = r.time[lag:] >= found.window
        series[n] = (r.time[lag:][late], stability(pointing_errors(r).ape, lag)[late] / DEG)
    shown.append((
        figures.against_bound(series, AXES, BOUNDS["PSE"], "deg"),
        f"PSE over {REQUIREMENTS.pse_interval:g} s with its requirement (figure 13).",
    ))  # fmt: skip
    many = [r for index, r in found.campaigns[PAPER_HINF].kept.items() if index > 0]
    spreads = [
        (figures.spread([(r.time, r.outputs[:, :3]) for r in many], ("q1", "q2", "q3"), until=early),
         f"Quaternion, {PAPER_HINF}, all runs of table 5, the filter started from zeros (figure 14)."),
        (figures.spread([(r.time, r.outputs[:, 3:] / DEG) for r in many], tuple(f"w{a}, deg/s" for a in "xyz"),
                        until=early), f"Rate relative to the orbital frame, {PAPER_HINF}, all runs (figure 15)."),
    ]  # fmt: skip
    if found.night:
        angles = {
            name: [(run.time, pointing_errors(run).angle / DEG) for run in flown.kept.values()]
            for name, flown in found.night.items()
        }
        spreads.append((
            figures.bundles(angles, "pointing error, deg", BOUNDS["APE"]),
            "Into the eclipse, after a third of the flight: vector solution against the vectors themselves.",
        ))  # fmt: skip
    beyond = [study.drawings("Figure 6: modes and attitudes far away", [far(found)])] if found.far else []
    return [study.drawings("Table 3: one run", shown), study.drawings("Table 5: Monte Carlo", spreads), *beyond]


def far(found: Any) -> tuple[Figure, str]:
    """How far the flights to another attitude than nadir are from it, and how fast they turn."""
    series = {}
    for name, run in found.far.items():
        wanted = np.broadcast_to(turned(float(name.split()[0]))[1:], run.outputs[:, :3].shape)
        with jax.enable_x64(True):
            angle = np.asarray(attitude.angle(error(run.outputs[:, :3], wanted)))
        rate = np.linalg.norm(run.outputs[:, 3:], axis=1)
        series[name] = (run.time, np.stack([angle, rate], axis=1) / DEG)
    caption = (
        "A desired attitude far from nadir, tracked by the difference of vector parts and by the error quaternion; the "
        "latter in the state machine: it stops a tumble, looks at nadir, and slews (figures 5 and 6)."
    )
    return figures.histories(series, ("angle to it, deg", "rate, deg/s")), caption
