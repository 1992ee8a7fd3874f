"""What the pictures of systems share: which systems are shown, on which axes, over which frequencies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from synth.checks import as_array
from synth.checks import shown as describe
from synth.errors import ModelError
from synth.synthesis.design import Design
from synth.systems.connect import series
from synth.systems.statespace import StateSpace, as_system

POINTS = 400  # frequencies of a curve
LIGHT = 0.3  # damping below which a resonance gets points of its own
DECADES = 2.0  # shown below the slowest pole and, in continuous time, above the fastest


def loop_of(design: Design) -> StateSpace:
    """The loop of a design for negative feedback, cut at the plant's input, (m x m): margins are read on it."""
    P = design.plant
    plant = StateSpace(P.A, P.B2, P.C2, P.D22, P.dt, P.u, P.y)
    return -series(plant, design.closing)


def shown(systems: Any, label: str | None, *, loops: bool) -> list[tuple[str | None, StateSpace]]:
    """Labels and systems of one, a list or a dict of them; of a Design its loop, or its closed loop from w to z.

    Raises
    ------
    ModelError : one of them is no system, or their numbers of signals differ.
    """
    if isinstance(systems, Mapping) and not {"A", "num", "den", "zeros", "poles"} & {*systems}:
        named = [(str(name), system) for name, system in systems.items()]
    elif isinstance(systems, list) and systems and not _is_matrix(systems):
        named = [(label and f"{label} {i}", system) for i, system in enumerate(systems)]
    else:
        named = [(label, systems)]
    if not named:
        raise ModelError("systems is empty; pass a system, or a list or dict of them")
    found = [(name, _as_shown(name, system, loops)) for name, system in named]
    sizes = {(G.ny, G.nu) for _, G in found}
    if len(sizes) > 1:
        raise ModelError(f"systems have {sorted(sizes)} outputs and inputs; only those of one size share axes")
    return found


def _as_shown(name: str | None, system: Any, loops: bool) -> StateSpace:
    if isinstance(system, Design):
        return loop_of(system) if loops else system.closed_loop
    return as_system(f"systems[{name!r}]" if name else "systems", system)


def _is_matrix(value: list) -> bool:
    """Whether a list is a matrix of numbers, that is, one gain."""
    return all(np.isscalar(row) or (isinstance(row, list) and all(np.isscalar(x) for x in row)) for row in value)


def axes_for(ax: Any, rows: int, columns: int, *, share: bool = True, size: tuple[float, float] = (6.0, 2.4)) -> Any:
    """The caller's axes as (rows, columns), or new ones.

    Raises
    ------
    ModelError : `ax` is not that many axes.
    """
    if ax is None:
        import matplotlib.pyplot as plt

        figsize = (max(size[0], 3.4 * columns), size[1] * rows)
        return plt.subplots(rows, columns, squeeze=False, sharex=share, layout="constrained", figsize=figsize)[1]
    try:
        given = np.ravel(np.asarray(ax, dtype=object))
    except Exception:  # whatever a foreign object raises
        raise ModelError(f"ax is {describe(ax)}; pass {rows * columns} axes of matplotlib") from None
    if given.size != rows * columns or not all(hasattr(each, "plot") for each in given):
        raise ModelError(f"ax holds {given.size} axes; pass {rows * columns}: {rows} rows of {columns}")
    return given.reshape(rows, columns)


def frequencies(*systems: StateSpace) -> np.ndarray:
    """A logarithmic grid (N,) in rad/s about the poles of all systems; up to Nyquist in discrete time."""
    speeds = np.concatenate([_speeds(G) for G in systems])
    speeds = speeds[speeds > 1e-9 * speeds.max(initial=0.0)]
    low, high = (speeds.min(), speeds.max()) if speeds.size else (1.0, 1.0)
    low, high = low * 10**-DECADES, high * 10**DECADES
    nyquist = min((np.pi / G.dt for G in systems if G.discrete), default=np.inf)
    high = min(high, nyquist) if np.isinf(nyquist) else nyquist
    return np.geomspace(min(low, 1e-3 * high), high, POINTS)


def singular_values(G: StateSpace, omega: np.ndarray) -> np.ndarray:
    """Singular values of the frequency response at omega (N,) rad/s: (N, min(nu, ny)), largest first."""
    return np.array([np.linalg.svd(G.frequency_response(w), compute_uv=False) for w in omega])


def grid_of(systems: list[tuple[str | None, StateSpace]], omega: Any) -> np.ndarray:
    """The frequencies asked for, or those about the poles and resonances of all systems."""
    if omega is None:
        grid = frequencies(*(G for _, G in systems))
        peaks = np.concatenate([_resonances(G) for _, G in systems])
        return np.union1d(grid, peaks[(peaks > grid[0]) & (peaks < grid[-1])])
    grid = as_array("omega", omega, "pass frequencies in rad/s")
    if grid.ndim != 1 or grid.size < 2 or np.any(grid <= 0) or np.any(np.diff(grid) <= 0):
        raise ModelError(f"omega has shape {grid.shape}; pass rising frequencies above zero, in rad/s")
    return grid


def responses(
    systems: list[tuple[str | None, StateSpace]], omega: Any
) -> list[tuple[str | None, StateSpace, np.ndarray, np.ndarray]]:
    """Label, system, frequencies (N,) and response (N, p, m) of each; discrete ones end at Nyquist."""
    grid, found = grid_of(systems, omega), []
    for label, G in systems:
        own = grid[grid <= np.pi / G.dt * (1 + 1e-12)] if G.discrete else grid
        with np.errstate(all="ignore"):
            found.append((label, G, own, _response(G, own)))
    return found


def _response(G: StateSpace, grid: np.ndarray) -> np.ndarray:
    """The response, nan where a pole stands on the very frequency."""
    out = np.full((len(grid), G.ny, G.nu), np.nan, complex)
    for k, w in enumerate(grid):
        try:
            out[k] = G.frequency_response(w)
        except np.linalg.LinAlgError:
            continue
    return out


def _speeds(G: StateSpace) -> np.ndarray:
    """Natural frequencies of the poles, rad/s."""
    poles = G.poles().astype(complex)
    if not G.discrete:
        return np.abs(poles)
    poles = poles[np.abs(poles) > 1e-12]
    return np.minimum(np.abs(np.log(poles)) / G.dt, np.pi / G.dt)


def _resonances(G: StateSpace) -> np.ndarray:
    """Frequencies about the light poles, which lie between the points of a grid, rad/s: even steps of their phase."""
    poles = G.poles().astype(complex)
    if G.discrete:
        poles = np.log(poles[np.abs(poles) > 1e-12]) / G.dt
    light = poles[(np.imag(poles) > 0) & (np.abs(np.real(poles)) < LIGHT * np.imag(poles))]
    turns = np.tan(np.linspace(-1.5, 1.5, 41))
    return (np.imag(light)[:, None] + np.abs(np.real(light))[:, None] * turns).ravel()


def nyquist_line(ax: Any, systems: list[tuple[str | None, StateSpace]]) -> None:
    """A thin line at the Nyquist frequency of each sampling time."""
    for dt in sorted({G.dt for _, G in systems if G.discrete}):
        across = ax.get_xaxis_transform()
        ax.vlines(np.pi / dt, 0, 1, transform=across, colors="0.6", lw=0.8, ls=":", label="_nyquist frequency")
