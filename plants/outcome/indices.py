"""Pointing indices of a paper's table, wheel effort and settling time of a run.

Errors are 3-2-1 Euler angles of an error rotation, per axis:

    APE  absolute performance error      true attitude against the desired
    control error                        estimated attitude against the desired
    AKE  absolute knowledge error        true attitude against the estimated
    PSE  performance stability error     APE(t) - APE(t - delta_t), the paper's own

APE and AKE are those of ECSS-E-ST-60-10C, whose indices over windows are in `ecss`.

The temporal interpretation holds: an index is the level that the magnitude of the error does not exceed for the
given share of the time, here the smallest recorded value with that property. Pecorilla and Stesina (2024), table 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.stats import beta, norm
from scipy.stats import t as student

from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation import blocks
from plants.simulation.loop import Run
from plants.simulation.programs import Program

GRID = 4001  # levels at which a bootstrap looks
STATIC = {"static": True}  # settings: the same for all runs that are put together


@dataclass(frozen=True, kw_only=True)
class Indices:
    """Pointing indices of a run; of several runs when the arrays have a leading axis of runs.

    A run that failed, or did not reach the window, has infinite indices: it meets no requirement.
    """

    ape: np.ndarray  # (..., 3) rad, roll pitch yaw
    control_error: np.ndarray  # (..., 3) rad
    ake: np.ndarray  # (..., 3) rad
    pse: np.ndarray  # (..., 3) rad per delta_t
    settling_time: np.ndarray  # (...) s, after which the true attitude error stays below `threshold`
    torque_rms: np.ndarray  # (..., m) N m, of every wheel motor over the whole run
    effort: np.ndarray  # (..., m) N m s, integral of |torque| over the whole run
    momentum_peak: np.ndarray  # (..., m) N m s, largest |integral of torque|, counted from the start
    start: float = field(metadata=STATIC)  # s, beginning of the window of the four errors
    end: float = field(metadata=STATIC)  # s, its end
    delta_t: float = field(metadata=STATIC)  # s, of the PSE
    share: float = field(metadata=STATIC)  # () of the time
    threshold: float = field(metadata=STATIC)  # rad, angle of the whole error rotation

    def __str__(self) -> str:
        """A table in degrees; of several runs the median and the worst."""
        head = (
            f"{self.share:.0%} of the time, {self.start:g} to {self.end:g} s; PSE over {self.delta_t:g} s\n"
            f"{'deg':16}{'roll':>10}{'pitch':>10}{'yaw':>10}"
        )
        lines = [head]
        for name, value in (
            ("APE", self.ape),
            ("control error", self.control_error),
            ("AKE", self.ake),
            ("PSE", self.pse),
        ):
            lines += _lines(name, np.degrees(value), "{:10.4f}")
        lines += _lines("torque rms uNm", 1e6 * self.torque_rms, "{:10.3f}")
        lines += _lines("effort mNms", 1e3 * self.effort, "{:10.3f}")
        lines += _lines("momentum mNms", 1e3 * self.momentum_peak, "{:10.4f}")
        label = f"settles to {np.degrees(self.threshold):g} deg, s"
        return "\n".join([*lines, *_lines(label, self.settling_time[..., None], "{:10.1f}")])


def indices(
    runs: Run | Sequence[Run],
    *,
    start: float = 300.0,
    delta_t: float = 1.0,
    share: float = 0.95,
    threshold: float = np.radians(1.0),
) -> Indices:
    """Pointing indices of one run, or of several with a leading axis.

    Parameters
    ----------
    runs : Run or sequence of Run
        Outputs, estimates and references are (6,), beginning with the vector part of a quaternion.
    start : () s, where the window of the four errors begins; it ends with the run
    delta_t : () s, of the PSE; a whole number of samples
    share : () of the time, in (0, 1]
    threshold : () rad, for the settling time

    Raises
    ------
    ScenarioError
        A window beyond the end of every run, a delta_t that is not a whole number of samples, a share outside
        (0, 1], outputs that are not attitudes.
    """
    if not 0 < share <= 1:
        raise ScenarioError(f"share = {share}: give a part of the time in (0, 1]")
    if not isinstance(runs, Run):
        if not runs:
            raise ScenarioError("runs: got none; give at least one")
        parts = [indices(run, start=start, delta_t=delta_t, share=share, threshold=threshold) for run in runs]
        return blocks.join(parts)
    if runs.outputs.ndim != 2 or runs.outputs.shape[1] < 3:
        raise ScenarioError(f"outputs have shape {runs.outputs.shape}: attitudes (N, 3) or (N, 6) are needed")
    if not 0 <= start < runs.duration:
        raise ScenarioError(f"start = {start} s is outside the run, which lasts {runs.duration} s")
    if not runs.ok:
        worst, never = np.full(3, np.inf), np.full(runs.inputs.shape[1], np.inf)
        levels, settling, loads = (worst,) * 4, np.array(np.inf), (never,) * 3
    else:
        levels, settling = _levels(runs, start, delta_t, share, threshold)
        loads = _loads(runs.inputs, _period(runs))
    return Indices(
        ape=levels[0],
        control_error=levels[1],
        ake=levels[2],
        pse=levels[3],
        settling_time=settling,
        torque_rms=loads[0],
        effort=loads[1],
        momentum_peak=loads[2],
        start=start,
        end=runs.duration,
        delta_t=delta_t,
        share=share,
        threshold=threshold,
    )


class Errors(NamedTuple):
    """Errors of a run over time, 3-2-1 Euler angles."""

    ape: np.ndarray  # (N, 3) rad, true against desired
    control_error: np.ndarray  # (N, 3) rad, estimated against desired
    ake: np.ndarray  # (N, 3) rad, true against estimated
    angle: np.ndarray  # (N,) rad, of the whole rotation from desired to true


def pointing_errors(run: Run) -> Errors:
    """What the indices of a run are percentiles of."""
    with jax.enable_x64(True):
        return Errors(
            *(np.asarray(a) for a in _angles(run.outputs[:, :3], run.estimates[:, :3], run.references[:, :3]))
        )


@Program
def error(a: ArrayLike, b: ArrayLike) -> Array:
    """Quaternion of the rotation from b to a, given as vector parts (N, 3); traceable."""

    def whole(v: ArrayLike) -> Array:
        v = jnp.asarray(v)
        return jnp.concatenate([jnp.sqrt(jnp.maximum(1 - attitude.dot(v, v), 0.0))[:, None], v], axis=-1)

    return attitude.compose(whole(a), attitude.conjugate(whole(b)))


def quantile(errors: np.ndarray, share: float) -> np.ndarray:
    """Smallest recorded |error| that is not exceeded for the given share of the time: (N, ...) -> (...)."""
    return np.quantile(np.abs(errors), share, axis=0, method="inverted_cdf")


def stability(errors: np.ndarray, lag: int) -> np.ndarray:
    """error(t) - error(t - lag), angles taken the short way round: (N, ...) -> (N - lag, ...) rad."""
    return _short(errors[lag:] - errors[:-lag])


def windows(errors: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over consecutive windows (MPE), and what is left of every sample (RPE), of angles (N, ...) rad.

    Parameters
    ----------
    errors : (N, ...) rad; angles are taken the short way round within a window
    length : samples of a window; at the end what does not fill one is left out

    Returns
    -------
    mean : (windows, ...) rad
    relative : (windows length, ...) rad

    Raises
    ------
    ScenarioError
        A length that is not a whole number of at least 1, fewer samples than one window.
    """
    if not isinstance(length, int | np.integer) or not 1 <= length <= len(errors):
        raise ScenarioError(f"length = {length!r}: give a whole number of samples from 1 to {len(errors)}")
    parts = errors[: len(errors) // length * length].reshape(-1, length, *errors.shape[1:])
    moved = _short(parts - parts[:, :1])
    shift = moved.mean(axis=1, keepdims=True)
    return _short(parts[:, 0] + shift[:, 0]), (moved - shift).reshape(-1, *errors.shape[1:])


def pooled_level(
    errors: Sequence[np.ndarray], share: float = 0.95, *, confidence: float = 0.95, resamples: int = 2000, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The level of |error| over all samples of all runs, and its bootstrap interval: (level, low, high), (...) each.

    Runs are drawn, not samples, because the samples of a run depend on each other. Percentiles, expanded for few runs
    as by Student's t: Hesterberg (2015), The American Statistician 69(4).

    Parameters
    ----------
    errors : of every run, (N, ...) with the same N
    share : () of all samples, in (0, 1]
    confidence : () of the interval, in (0, 1)
    resamples, seed : of the bootstrap

    Raises
    ------
    ScenarioError
        Fewer than two runs, runs of different lengths, a share or a confidence outside its range.
    """
    if len(errors) < 2:
        raise ScenarioError(f"errors: got {len(errors)} run; an interval over runs needs two at least")
    if not (0 < share <= 1 and 0 < confidence < 1):
        raise ScenarioError(f"share = {share}, confidence = {confidence}: give parts of (0, 1]")
    if len({np.shape(run) for run in errors}) > 1:
        raise ScenarioError("errors: the runs have samples of different shapes; give all the same number of samples")
    sizes = np.array([np.abs(run) for run in errors])
    few = np.sqrt(len(sizes) / (len(sizes) - 1))
    tail = norm.cdf(few * student.ppf((1 - confidence) / 2, len(sizes) - 1))
    draws = np.random.default_rng(seed).multinomial(len(sizes), np.full(len(sizes), 1 / len(sizes)), resamples)
    levels = np.quantile(sizes.reshape(-1, *sizes.shape[2:]), np.linspace(0, 1, GRID), axis=0, method="inverted_cdf")
    found = np.empty((3, *sizes.shape[2:]))
    for at in np.ndindex(sizes.shape[2:]):
        column, grid = np.sort(sizes[(..., *at)], axis=1), levels[(slice(None), *at)]
        below = np.array([np.searchsorted(run, grid, side="right") for run in column]) / column.shape[1]  # (runs, GRID)
        drawn = grid[np.argmax(draws @ below / len(sizes) >= share - 1e-12, axis=1)]
        found[(slice(None), *at)] = (
            quantile(sizes[(..., *at)].ravel(), share),
            *np.quantile(drawn, [tail, 1 - tail]),
        )
    return found[0], found[1], found[2]


def settling_time(time: np.ndarray, angle: np.ndarray, threshold: float) -> float:
    """First time (s) from which the angle (N,) stays below the threshold; infinite if it ends above."""
    above = np.flatnonzero(~(angle < threshold))
    if above.size == 0:
        return float(time[0])
    return float(time[above[-1] + 1]) if above[-1] + 1 < len(time) else np.inf


def step_response(time: np.ndarray, values: np.ndarray, target: ArrayLike, band: float = 0.02) -> tuple[Any, Any]:
    """Settling time and overshoot of k steps from zero to their targets, recorded together.

    Parameters
    ----------
    time : (N,) s
    values : (N, k)
    target : (k,) not zero, in the unit of the values
    band : () of the target, within which a value has settled

    Returns
    -------
    settling : (k,) s, infinite for a value that ends outside its band
    overshoot : (k,) of the target, at least zero
    """
    reached = values / np.asarray(target)
    settling = np.array([settling_time(time, column, band) for column in np.abs(reached - 1).T])
    return settling, np.maximum(reached.max(axis=0) - 1, 0.0)


def clopper_pearson(successes: ArrayLike, runs: ArrayLike, confidence: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
    """Exact interval of a probability from `successes` (...) in `runs` (...) independent runs: (low, high), (...).

    It covers the truth with at least the given confidence. Clopper and Pearson (1934), Biometrika 26.

    Raises
    ------
    ScenarioError
        Counts that are not whole numbers with 0 <= successes <= runs, no runs, a confidence outside (0, 1).
    """
    k, n = np.asarray(successes, float), np.asarray(runs, float)
    if not ((k >= 0) & (k <= n) & (n >= 1) & (k % 1 == 0) & (n % 1 == 0)).all():
        raise ScenarioError(
            f"successes = {successes} of runs = {runs}: give whole numbers, 0 <= successes <= runs >= 1"
        )
    if not 0 < confidence < 1:
        raise ScenarioError(f"confidence = {confidence}: give a probability in (0, 1)")
    tail = (1 - confidence) / 2
    low = np.where(k == 0, 0.0, beta.ppf(tail, np.maximum(k, 1), n - k + 1))
    return low, np.where(k == n, 1.0, beta.ppf(1 - tail, k + 1, np.maximum(n - k, 1)))


def _short(angles: np.ndarray) -> np.ndarray:
    """Angles in [-pi, pi)."""
    return (angles + np.pi) % (2 * np.pi) - np.pi


def _levels(run: Run, start: float, delta_t: float, share: float, threshold: float) -> Any:
    """The four indices and the settling time of a sound run."""
    lag = delta_t / _period(run)
    if round(lag) < 1 or not np.isclose(lag, round(lag), rtol=0, atol=1e-6) or round(lag) >= len(run.time):
        raise ScenarioError(
            f"delta_t = {delta_t} s: give a whole number of samples of {_period(run)} s, shorter than the run"
        )
    ape, control_error, ake, angle = pointing_errors(run)
    window = run.time >= start - 1e-9
    drift = stability(ape, round(lag))[window[round(lag) :]]
    levels = tuple(quantile(e, share) for e in (ape[window], control_error[window], ake[window], drift))
    return levels, np.array(settling_time(run.time, angle, threshold))


@Program
def _angles(true: Any, known: Any, desired: Any) -> Any:
    """Euler angles (N, 3) rad of APE, control error and AKE, and the whole angle (N,) rad of APE."""
    miss = error(true, desired)
    to_euler = attitude.to_euler
    return to_euler(miss), to_euler(error(known, desired)), to_euler(error(true, known)), attitude.angle(miss)


def _loads(torque: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rms torque, integral of |torque| and peak of |integral of torque| for a torque (N, m) held for h s."""
    effort = h * np.abs(torque).sum(axis=0)
    return np.sqrt(np.mean(torque**2, axis=0)), effort, np.max(np.abs(h * np.cumsum(torque, axis=0)), axis=0)


def _period(run: Run) -> float:
    """Sampling period of a run, s."""
    return float(run.time[1] - run.time[0])


def _lines(name: str, value: np.ndarray, form: str) -> list[str]:
    """Table lines of one quantity: one run as it is, several as median and worst."""
    if value.ndim == 1:
        return [f"{name:16}" + "".join(form.format(v) for v in value)]
    rows = ((f"{name}, median", np.median(value, axis=0)), ("  worst", value.max(axis=0)))
    return [f"{label:24}" + "".join(form.format(v) for v in row) for label, row in rows]
