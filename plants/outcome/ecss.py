"""Pointing error indices of ECSS-E-ST-60-10C over windows, by the three statistical interpretations.

Of the performance error e (true attitude against the desired) and, with K for P, of the knowledge error (true against
estimated), <e> being its mean over a window:

    APE, AKE   e                          at every instant
    MPE, MKE   <e>                        mean
    RPE, RKE   e - <e>                    relative: at every instant of the window
    PDE, KDE   <e>_2 - <e>_1              drift: windows of one observation
    PRE, KRE   <e>_2 - <e>_1              reproducibility: windows of different observations

Axes are 3-2-1 Euler angles of the error rotation, taken the short way round. The half-cone of a line of sight is the
angle between directions: the true one against the desired, or one of them or their mean direction over a window.

The level of an index is what is not exceeded for a share of the cases:

    temporal   share of the time, for the worst run
    ensemble   share of the runs, at the worst time
    mixed      share of all samples of all runs

The PSE of `indices` is Pecorilla's and Stesina's own: a difference of samples, not of means.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import numpy as np
from jax.typing import ArrayLike
from scipy.stats import binom

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.outcome.indices import error, pointing_errors, quantile, windows
from plants.outcome.study import Table
from plants.simulation.loop import Run

Interpretation = Literal["temporal", "ensemble", "mixed"]
INTERPRETATIONS = {
    "temporal": "{share:.0%} of the time, in the worst of {runs} runs",
    "ensemble": "{share:.0%} of {runs} runs, at the worst time (confidence {confidence:.0%})",
    "mixed": "{share:.0%} of all samples of {runs} runs",
}
AXES = ("roll", "pitch", "yaw")
TITLE = "Pointing by ECSS-E-ST-60-10C"


@dataclass(frozen=True, kw_only=True)
class EcssIndices:
    """Levels of the indices, (3,) rad each about roll, pitch and yaw, or (4,) with the half-cone."""

    levels: Mapping[str, np.ndarray]  # by "APE", "MPE", "RPE", "PDE", "PRE", "AKE", ...
    interpretation: str
    share: float  # ()
    runs: int
    confidence: float  # that the share of all systems is within the level, by the runs there are; of "ensemble" only
    start: float  # s
    window: float  # s

    def __getitem__(self, name: str) -> np.ndarray:
        """The level of one index, such as ``found["RPE"]``."""
        return self.levels[name]

    @property
    def rule(self) -> str:
        """What the levels are, in words."""
        words = INTERPRETATIONS[self.interpretation]
        return words.format(share=self.share, runs=self.runs, confidence=self.confidence)

    def table(
        self, title: str = "Pointing by ECSS-E-ST-60-10C", unit: float = np.radians(1), name: str = "deg"
    ) -> Table:
        """For the terminal and the page; `unit` is one `name` in rad."""
        width = len(next(iter(self.levels.values())))
        rows = [(index, *(f"{v:.4g}" for v in level / unit)) for index, level in self.levels.items()]
        note = f"{self.rule}; from {self.start:g} s on, windows of {self.window:g} s."
        return Table(title, (f"index, {name}", *(*AXES, "half-cone")[:width]), rows, note=note)

    def __str__(self) -> str:
        return self.table().text()


def ecss_indices(
    runs: Run | Sequence[Run],
    *,
    window: float,
    start: float,
    drift: float | None = None,
    repeat: float | None = None,
    line_of_sight: ArrayLike | None = None,
    share: float = 0.95,
    interpretation: Interpretation = "temporal",
) -> EcssIndices:
    """Pointing error indices of one run, or of several of the same length.

    Parameters
    ----------
    runs : Run or sequence of Run
        Outputs, estimates and references begin with the vector part of a quaternion.
    window : () s, over which means are taken; a whole number of samples
    start : () s, of the first window; what does not fill a window at the end is left out
    drift : () s, from one window to the other in the PDE, a whole number of windows; the next one by default
    repeat : () s, likewise between observations, such as an orbit; without it there is no PRE
    line_of_sight : (3,) in the body, of any length: adds the half-cone, for a payload along it
    share : () in (0, 1]
    interpretation : "temporal", "ensemble" or "mixed"

    Raises
    ------
    ScenarioError
        No runs, runs of different lengths, a time that is not a whole number of samples or windows or does not fit
        into the run, a share or an interpretation that is none, a line of sight without direction.
    """
    many = [runs] if isinstance(runs, Run) else list(runs)
    if not many:
        raise ScenarioError("runs: got none; give at least one")
    if interpretation not in INTERPRETATIONS:
        raise ScenarioError(f"interpretation = {interpretation!r}: give one of {', '.join(INTERPRETATIONS)}")
    if not 0 < share <= 1:
        raise ScenarioError(f"share = {share}: give a part of (0, 1]")
    sound = [run for run in many if run.ok]
    if len({len(run.time) for run in sound}) > 1:
        raise ScenarioError("runs: they have different numbers of samples; give runs of one length and period")
    direction = None if line_of_sight is None else _direction(line_of_sight)
    lost = [np.inf] * (len(many) - len(sound))
    if not sound:
        names = ("APE", "MPE", "RPE", "PDE", *(("PRE",) if repeat else ()))
        never = np.full(3 if direction is None else 4, np.inf)
        levels = {name: never for kind in (names, [_known(n) for n in names]) for name in kind}
    else:
        steps = _steps(sound[0], window, start, drift, repeat)
        found = [_errors(run, direction, *steps) for run in sound]
        levels = {name: _level(np.stack([f[name] for f in found]), lost, share, interpretation) for name in found[0]}
    n, rank = len(many), int(np.ceil(share * len(many) - 1e-9))
    return EcssIndices(
        levels=levels, interpretation=interpretation, share=share, runs=n,
        confidence=float(binom.cdf(rank - 1, n, share)), start=start, window=window,
    )  # fmt: skip


def _level(errors: np.ndarray, lost: Sequence[float], share: float, interpretation: str) -> np.ndarray:
    """The level of (runs, N, k) errors, (k,) rad."""
    size = np.abs(errors)
    if interpretation == "mixed":
        rows = np.full((len(lost) * size.shape[1], size.shape[2]), np.inf)
        return quantile(np.concatenate([size.reshape(-1, size.shape[2]), rows]), share)
    each = size.max(axis=1) if interpretation == "ensemble" else np.array([quantile(run, share) for run in size])
    each = np.concatenate([each, np.full((len(lost), each.shape[1]), np.inf)])
    return quantile(each, share) if interpretation == "ensemble" else each.max(axis=0)


def _steps(run: Run, window: float, start: float, drift: float | None, repeat: float | None) -> tuple[int, ...]:
    """Samples of a window, first sample, windows of drift and repeat (0 for none)."""
    h = float(run.time[1] - run.time[0])
    length, first = _whole("window", window, h, "samples"), int(np.argmax(run.time >= start - 1e-9))
    if not 0 <= start < run.duration or run.time[-1] < start - 1e-9:
        raise ScenarioError(f"start = {start} s is outside the run, which lasts {run.duration} s")
    count = (len(run.time) - first) // length
    if count < 1:
        raise ScenarioError(f"window = {window} s: from {start:g} s on the run lasts {len(run.time) * h - start:g} s")
    apart = []
    for name, value in (("drift", drift), ("repeat", repeat)):
        lag = 0 if value is None else _whole(name, value, window, "windows")
        if lag >= count:
            raise ScenarioError(f"{name} = {value} s: the run has {count} windows of {window:g} s from {start:g} s on")
        apart.append(lag)
    return length, first, apart[0] or (1 if count > 1 else 0), apart[1]


def _whole(name: str, value: float, of: float, what: str) -> int:
    """How many times `of` a time is."""
    ratio = value / of
    if not np.isfinite(ratio) or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-6:
        raise ScenarioError(f"{name} = {value} s: give a whole number of {what} of {of:g} s")
    return round(ratio)


def _errors(
    run: Run, direction: np.ndarray | None, length: int, first: int, drift: int, repeat: int
) -> dict[str, np.ndarray]:
    """Errors by index, (..., 3 or 4) rad each."""
    by_axis, last = pointing_errors(run), first + (len(run.time) - first) // length * length
    found: dict[str, np.ndarray] = {}
    for angles, against, knowledge in ((by_axis.ape, run.references, False), (by_axis.ake, run.estimates, True)):
        parts = _of_angles(angles[first:last], length, drift, repeat)
        if direction is not None:
            with jax.enable_x64(True):
                miss = error(run.outputs[first:last, :3], against[first:last, :3])
                seen = np.asarray(attitude.rotate(attitude.conjugate(miss), np.broadcast_to(direction, (len(miss), 3))))
            cones = _of_directions(seen, direction, length, drift, repeat)
            parts = {name: np.column_stack([part, cones[name]]) for name, part in parts.items()}
        found |= {(_known(name) if knowledge else name): part for name, part in parts.items()}
    return found


def _known(name: str) -> str:
    """The index of knowledge that belongs to one of performance: AKE to APE, RKE to RPE, KDE to PDE."""
    return f"K{name[1:]}" if name in ("PDE", "PRE") else f"{name[0]}KE"


def _of_angles(angles: np.ndarray, length: int, drift: int, repeat: int) -> dict[str, np.ndarray]:
    """Indices of angles (N, 3) rad."""
    mean, relative = windows(angles, length)
    found = {"APE": angles, "MPE": mean, "RPE": relative}
    for name, lag in (("PDE", drift), ("PRE", repeat)):
        if lag:
            found[name] = (mean[lag:] - mean[:-lag] + np.pi) % (2 * np.pi) - np.pi
    return found


def _of_directions(seen: np.ndarray, wanted: np.ndarray, length: int, drift: int, repeat: int) -> dict[str, np.ndarray]:
    """Indices of unit directions (N, 3) against the one wanted: half-cones, rad."""
    parts = seen.reshape(-1, length, 3)
    mean = parts.mean(axis=1)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    relative = _between(parts, mean[:, None]).ravel()
    found = {"APE": _between(seen, wanted), "MPE": _between(mean, wanted), "RPE": relative}
    return found | {n: _between(mean[k:], mean[:-k]) for n, k in (("PDE", drift), ("PRE", repeat)) if k}


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle between unit vectors, rad; accurate for small ones as well."""
    return 2 * np.arctan2(np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1))


def _direction(line: Any) -> np.ndarray:
    """As a unit vector."""
    v = np.asarray(line, float)
    if v.shape != (3,) or not np.isfinite(v).all() or not v.any():
        raise ScenarioError(f"line_of_sight = {line}: give a direction in the body, (3,) and not zero")
    return v / np.linalg.norm(v)
