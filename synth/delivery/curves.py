"""What the pictures of systems share: which systems are shown, on which axes, over which frequencies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy.linalg as sla

from synth.checks import as_array
from synth.checks import shown as describe
from synth.errors import ModelError
from synth.synthesis.design import Design
from synth.systems.connect import series
from synth.systems.statespace import StateSpace, as_system

POINTS = 400  # frequencies of a curve
LIGHT = 0.3  # damping below which a resonance gets points of its own
DECADES = 2.0  # shown below the slowest pole and, in continuous time, above the fastest
TURN = 0.25  # |log| of the ratio of neighbouring responses above which a point is put between them
ROUNDS = 16  # of such points
DETOUR = 1e-5  # of its frequency: radius of the half circle round a pole or zero on the stability boundary
UNDAMPED = 1e-9  # damping below which a zero counts as one on the boundary
JORDAN = 1e-6  # of the norm of A: what rounding moves a double pole at most


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
    elif _is_row(systems):
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


def _is_row(value: Any) -> bool:
    """Whether a list or tuple holds systems: lists of numbers are gains, tuples of arrays are one system."""
    if isinstance(value, tuple):
        return bool(value) and not any(np.isscalar(x) or isinstance(x, list | tuple | np.ndarray) for x in value)
    numbers = (list, np.ndarray)
    return isinstance(value, list) and not all(
        np.isscalar(row) or (isinstance(row, numbers) and all(np.isscalar(x) for x in row)) for row in value
    )


def lines_style(style: dict[str, Any]) -> dict[str, Any]:
    """The style with matplotlib's long names: `c` is `color`, `ls` is `linestyle`."""
    from matplotlib.cbook import normalize_kwargs
    from matplotlib.lines import Line2D

    return normalize_kwargs(style, Line2D)


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
    if not all(hasattr(each, "plot") for each in given):
        raise ModelError(f"ax is {describe(ax)}; pass {rows * columns} axes of matplotlib")
    if given.size != rows * columns:
        raise ModelError(f"ax holds {given.size} axes; pass {rows * columns}: {rows} rows of {columns}")
    return given.reshape(rows, columns)


def frequencies(*systems: StateSpace) -> np.ndarray:
    """A logarithmic grid (N,) in rad/s about the poles of all systems; discrete ones reach to Nyquist."""
    found = [(G, *_modes(G)) for G in systems]
    speeds = np.concatenate([np.abs(poles)[np.abs(poles) > blur] for _, poles, blur in found])
    speeds = np.minimum(speeds, max((_nyquist(G) for G in systems), default=np.inf))
    slowest, fastest = (speeds.min(), speeds.max()) if speeds.size else (1.0, 1.0)
    high = max(fastest * 10**DECADES if np.isinf(_nyquist(G)) else _nyquist(G) for G in systems)
    return np.geomspace(min(slowest * 10**-DECADES, 1e-3 * high), high, POINTS)


def unit_of_time(systems: list[tuple[str | None, StateSpace]]) -> str:
    """What times and frequencies are counted in: "s", or "sample" where nobody said the sampling time.

    Raises
    ------
    ModelError : that of some is unspecified, and others have a timebase.
    """
    unspecified = {G.dt is True for _, G in systems}
    if len(unspecified) > 1:
        raise ModelError("one system has dt = True and another a timebase; say the sampling time: system(G, dt=0.1)")
    return "sample" if True in unspecified else "s"


def singular_values(G: StateSpace, omega: np.ndarray) -> np.ndarray:
    """Singular values of the frequency response at omega (N,) rad/s: (N, min(nu, ny)), largest first."""
    return np.array([np.linalg.svd(G.frequency_response(w), compute_uv=False) for w in omega])


def responses(
    systems: list[tuple[str | None, StateSpace]], omega: Any
) -> list[tuple[str | None, StateSpace, np.ndarray, np.ndarray]]:
    """Label, system, frequencies (N,) and response (N, p, m) of each; discrete ones end at Nyquist.

    The frequencies are those asked for, with nan where a pole stands on one, or those that the curves need.

    Raises
    ------
    ModelError : `omega` is no grid, or begins beyond the Nyquist frequency of a system.
    """
    if omega is None:
        grid = frequencies(*(G for _, G in systems))
        return [(label, G, *_curve(G, grid)) for label, G in systems]
    grid, found = as_array("omega", omega, "pass frequencies in rad/s"), []
    if grid.ndim != 1 or grid.size < 2 or np.any(grid <= 0) or np.any(np.diff(grid) <= 0):
        raise ModelError(f"omega has shape {grid.shape}; pass rising frequencies above zero, in rad/s")
    for label, G in systems:
        own = grid[grid <= _nyquist(G) * (1 + 1e-12)]
        if not own.size:
            raise ModelError(
                f"omega begins at {grid[0]:g} rad/s, beyond the Nyquist frequency of the system; pass frequencies "
                f"up to {_nyquist(G):g} rad/s"
            )
        found.append((label, G, own, _response(G, own)))
    return found


def closing(G: StateSpace, start: float) -> np.ndarray:
    """The response (K, p, m) along the quarter circle from the real axis to `start` rad/s, right of poles at rest.

    Empty when no pole is there.
    """
    poles, _ = _modes(G)
    turn = np.exp(1j * np.linspace(0, np.pi / 2, 91)) if np.any(np.abs(poles) < start) else np.empty(0)
    return _response(G, -1j * start * turn)


def _curve(G: StateSpace, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies, dense where the response turns, and the response, with poles and zeros on the boundary passed."""
    poles, blur = _modes(G)
    zeros = np.concatenate([_continuous(G, G[i, j].zeros()) for i, j in np.ndindex(G.ny, G.nu)])
    roots = np.concatenate([poles, zeros])
    on = np.abs(np.real(roots)) <= np.concatenate([blur, UNDAMPED * np.abs(zeros)])
    heights = np.imag(roots)
    high = min(grid[-1], _nyquist(G))
    extra = _resonances(poles[~on[: len(poles)]])
    own = np.union1d(grid[grid < high], np.append(extra[(extra > grid[0]) & (extra < high)], high))
    path = _detours(own.astype(complex), roots, on & (heights > grid[0]) & (heights <= high * (1 + 1e-9)))
    path = path[np.real(path) <= high * (1 + 1e-12)]
    response = _response(G, path)
    for _ in range(ROUNDS):
        before, after = response[:-1], response[1:]
        sound = np.minimum(abs(before), abs(after)) > 1e-12 * np.abs(response).max()  # the rest is rounding
        ratio = np.divide(after, before, out=np.ones_like(after), where=sound)
        rough = np.any(np.abs(np.log(ratio)) > TURN, axis=(1, 2)) & np.isreal(path[1:]) & np.isreal(path[:-1])
        if not rough.any():
            break
        between = np.sqrt(path[:-1][rough] * path[1:][rough])
        at = np.flatnonzero(rough) + 1
        path = np.insert(path, at, between)
        response = np.insert(response, at, _response(G, between), axis=0)
    return np.real(path), response


def _detours(path: np.ndarray, roots: np.ndarray, on: np.ndarray) -> np.ndarray:
    """The frequencies with half circles about the roots on the boundary, on the right of each, as Nyquist's contour.

    There the curves are finite and their phase has no doubt: a pole turns it by -180 degrees, a zero by 180.
    """
    centers = np.sort(np.imag(roots[on]))
    for center in centers[np.diff(centers, prepend=-np.inf) > DETOUR * centers]:
        gaps = np.abs(roots - 1j * center)
        radius = min(DETOUR * center, 0.5 * gaps[gaps > 1e-2 * DETOUR * center].min(initial=np.inf))
        turn = np.exp(1j * np.linspace(-np.pi / 2, np.pi / 2, 21))
        path = np.concatenate([path[np.abs(path - center) > radius], center - 1j * radius * turn])
    return path[np.argsort(np.real(path), kind="stable")]


def _response(G: StateSpace, omega: np.ndarray) -> np.ndarray:
    """The response at frequencies that may be complex, right of the boundary; nan where a pole stands on one."""
    points = np.exp(1j * omega * G.dt) if G.discrete else 1j * omega
    poles = G.poles()
    out = np.full((len(omega), G.ny, G.nu), complex(np.nan, np.nan))
    for k, s in enumerate(points):
        if np.all(np.abs(s - poles) > 1e-14 * np.abs(s)):  # else rounding decides whether it is singular
            out[k] = G.C @ np.linalg.solve(s * np.eye(G.n) - G.A, G.B) + G.D
    return out


def _modes(G: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Poles (n,) as of continuous time, rad/s, and by how much rounding may have moved each.

    Wilkinson's condition numbers of the eigenvalues, bounded by what happens to double poles; so an integrator is one
    in any coordinates.
    """
    if not G.n:
        return np.empty(0, complex), np.empty(0)
    A = np.asarray(sla.matrix_balance(G.A, permute=False)[0])
    found: Any = sla.eig(A, left=True, right=True)
    poles, left, right = found
    angle = np.abs(np.sum(left.conj() * right, axis=0))
    eps = np.finfo(float).eps
    blur = np.linalg.norm(A, 2) * np.minimum(10 * eps / np.maximum(angle, eps), JORDAN)
    if not G.discrete:
        return poles, blur
    sound = np.abs(poles) > 1e-12  # the others are delays
    return _continuous(G, poles), blur[sound] / np.abs(poles[sound]) / G.dt


def _continuous(G: StateSpace, roots: np.ndarray) -> np.ndarray:
    """Poles or zeros as those of continuous time, rad/s."""
    roots = roots.astype(complex)
    return np.log(roots[np.abs(roots) > 1e-12]) / G.dt if G.discrete else roots


def _nyquist(G: StateSpace) -> float:
    return np.pi / G.dt if G.discrete else np.inf


def _resonances(poles: np.ndarray) -> np.ndarray:
    """Frequencies about the light poles, which lie between the points of a grid: even steps of their phase."""
    light = poles[(np.imag(poles) > 0) & (np.abs(np.real(poles)) < LIGHT * np.imag(poles))]
    turns = np.tan(np.linspace(-1.5, 1.5, 41))
    return (np.imag(light)[:, None] + np.abs(np.real(light))[:, None] * turns).ravel()


def light_grid(ax: Any) -> None:
    """Lines of a grid that stay behind the curves."""
    ax.grid(True, alpha=0.3, lw=0.6)


def nyquist_line(ax: Any, systems: list[tuple[str | None, StateSpace]]) -> None:
    """A thin line at the Nyquist frequency of each sampling time."""
    for dt in sorted({G.dt for _, G in systems if G.discrete}):
        across = ax.get_xaxis_transform()
        ax.vlines(np.pi / dt, 0, 1, transform=across, colors="0.6", lw=0.8, ls=":", label="_nyquist frequency")
