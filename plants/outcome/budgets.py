"""Pointing budgets in closed form: what noise, constants and their uncertainty leave of a stable linear loop.

    x(k+1) = A x(k) + B w(k),   e(k) = C x(k) + D w(k)

w is white noise plus constants, e the errors. With <e> the mean of e over a window of N samples,

    APE  absolute performance error   e
    MPE  mean performance error       <e>
    RPE  relative performance error   e - <e>, at every sample of the window
    PSE  performance stability error  e(k) - e(k - d), the drift over delta_t

and AKE, MKE, RKE in the same way when e is what is not known. ECSS-E-ST-60-10C (2008), section 3.2; ESA pointing error
engineering handbook, ESSB-HB-E-003 (2011); Pittelkau (2003), AAS 03-559, for the windows.

The covariance of the state solves a Lyapunov equation. The mean of a window is carried along as the row that weighs
the state at its beginning and all noise since: variances are exact for sampled windows, without an integral over
frequencies. Noise is Gaussian; a level is what |error| does not exceed for a share of all instants and, where constants
are random, of all runs (the mixed interpretation of the standard; without them its temporal and its ensemble
interpretation agree). Of this level `indices` measures a sample.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm
from scipy.special import ndtr, ndtri

from plants.checks import positive, real, whole
from plants.errors import ScenarioError

DOUBLINGS = 64  # of the sum that solves a Lyapunov equation, at most
RESIDUAL = 1e-8  # () of a Lyapunov equation, relative to the standard deviations of its states
BISECTIONS = 60  # of a level


class Levels(NamedTuple):
    """One number for each of the four errors, each (..., p)."""

    ape: np.ndarray
    mpe: np.ndarray
    rpe: np.ndarray
    pse: np.ndarray


class Spread(NamedTuple):
    """How one error is distributed: an equal share of the time for each of k instants, Gaussian at each."""

    mean: np.ndarray  # (..., k, p)
    variance: np.ndarray  # (..., k, sources, p)  of each source; they add up

    def level(self, share: float = 0.95) -> np.ndarray:
        """What |error| does not exceed for the given share in (0, 1), (..., p)."""
        if not 0 < share < 1:
            raise ScenarioError(f"share = {share}: give a part in (0, 1); a Gaussian error has no largest value")
        return _level(np.abs(self.mean), np.sqrt(self.variance.sum(axis=-2)), share)

    def pooled(self) -> "Spread":
        """The first leading axis as further instants."""
        return Spread(_pooled(self.mean, -2), _pooled(self.variance, -3))


@dataclass(frozen=True, kw_only=True)
class Budget:
    """The four errors of one loop, or of many with leading axes (...)."""

    ape: Spread
    mpe: Spread
    rpe: Spread
    pse: Spread
    sources: tuple[str, ...]

    def levels(self, share: float = 0.95) -> Levels:
        """Levels at the given share in (0, 1), comparable with those of `indices`."""
        return Levels(*(spread.level(share) for spread in self._spreads()))

    def contributions(self) -> Levels:
        """Mean squares by source, each (..., sources + 1, p): variance of every source, then the mean's square."""
        return Levels(*(
            np.concatenate([s.variance.mean(axis=-3), np.mean(s.mean**2, axis=-2)[..., None, :]], axis=-2)
            for s in self._spreads()
        ))  # fmt: skip

    def pooled(self) -> "Budget":
        """The loops along the first leading axis as instants of one: of a loop that changes slowly."""
        ape, mpe, rpe, pse = (spread.pooled() for spread in self._spreads())
        return Budget(ape=ape, mpe=mpe, rpe=rpe, pse=pse, sources=self.sources)

    def _spreads(self) -> tuple[Spread, ...]:
        return self.ape, self.mpe, self.rpe, self.pse


def budget(
    A: ArrayLike,
    B: ArrayLike,
    C: ArrayLike,
    D: ArrayLike,
    dt: float,
    *,
    window: float,
    delta_t: float,
    noise: ArrayLike = 1.0,
    constant: ArrayLike = 0.0,
    random: ArrayLike = 0.0,
    sources: Sequence[str] = (),
    samples: int = 1,
) -> Budget:
    """The pointing budget of a stable loop, or of many at once.

    Parameters
    ----------
    A, B, C, D : (..., n, n), (..., n, m), (..., q, n), (..., q, m) of the closed loop; leading axes broadcast
    dt : () s, period of the model
    window : () s, of MPE and RPE, a whole number of periods
    delta_t : () s, of the PSE, a whole number of periods
    noise : (m,) 1 sigma of each input's white noise, independent between inputs and between periods
    constant : (m,) about which each input varies
    random : (m,) 1 sigma of a further constant of each input, another one in every run
    sources : m names; inputs of one name are one source of the budget; "0", "1", ... by default
    samples : errors in a period: q = samples p, those of its first instant first. For loops whose errors are recorded
        more often than they are controlled; windows begin with a period

    Returns
    -------
    Budget
        Of (..., p) errors, in their unit.

    Raises
    ------
    ScenarioError
        Shapes that do not fit, numbers that are not finite, a window that is not a whole number of periods, a loop
        that is not stable or so nearly not that its covariance is lost in rounding.
    """
    A, B, C, D = _matrices(A, B, C, D)
    n, m = B.shape[-2:]
    span, lag = whole("window", window, dt, "periods"), whole("delta_t", delta_t, dt, "periods")
    noise, random = _inputs("noise", noise, m, low=0.0), _inputs("random", random, m, low=0.0)
    constant, (names, member) = _inputs("constant", constant, m), _grouped(sources, m)
    if not isinstance(samples, int) or samples < 1 or C.shape[-2] % samples:
        raise ScenarioError(f"samples = {samples!r}: it must divide the {C.shape[-2]} rows of C")
    radius = spectral_radius(A).max(initial=0.0)
    if radius >= 1:
        raise ScenarioError(
            f"A: the loop is not stable, its spectral radius is {radius:.9g}; close the loop, or leave out states "
            "that no error depends on, such as the constant a filter estimates"
        )

    def phased(rows: np.ndarray) -> np.ndarray:
        return rows.reshape(*rows.shape[:-2], samples, C.shape[-2] // samples, rows.shape[-1])

    def power(rows: np.ndarray) -> np.ndarray:
        """Squares of (..., k, p, m), by source: (..., k, sources, p)."""
        return np.swapaxes(rows**2 @ member.T, -1, -2)

    noisy = B * noise
    driven = noisy[..., None, :, :] * member[:, None, :]
    L = _root(lyapunov(A[..., None, :, :], driven @ np.swapaxes(driven, -1, -2)))

    def variance(rows: np.ndarray) -> np.ndarray:
        """Of (..., k, p, n) times the state, by source: (..., k, sources, p)."""
        return np.sum((rows[..., None, :, :] @ L[..., None, :, :, :]) ** 2, axis=-1)

    # e(k) = F[k] x(0) + sum of H[k - i] w(i) over i = 0 ... k
    rows = [C]
    for _ in range(max(span - 1, lag)):
        rows.append(rows[-1] @ A)
    F, H = [phased(r) for r in rows], [phased(r) for r in (D * noise, *(r @ noisy for r in rows[:-1]))]
    apart = list(_apart(F, H, variance, power))
    average = np.sum([r.mean(axis=-3, keepdims=True) for r in F[:span]], axis=0) / span
    tails = np.cumsum([r.mean(axis=-3, keepdims=True) for r in H[:span]], axis=0) / span
    same = np.arange(samples) * (samples + 1)  # of the pairs of instants in a period
    static = phased(C @ np.linalg.solve(np.eye(n) - A, B) + D)
    level = static.mean(axis=-3, keepdims=True)

    def spread(part: np.ndarray, answer: np.ndarray) -> Spread:
        """Of an error with the given variances by noise and the given answer (..., k, p, m) to constants."""
        answer = np.tile(answer, (part.shape[-3] // answer.shape[-3], 1, 1))
        return Spread(answer @ constant, part + power(answer * random))

    return Budget(
        ape=spread(variance(F[0]) + power(H[0]), static),
        mpe=spread(variance(average) + np.sum([power(r) for r in tails], axis=0), level),
        rpe=spread(_relative(np.stack(apart[:span]), samples), static - level),
        pse=spread(apart[lag][..., same, :, :], 0 * static),
        sources=names,
    )


def spectral_radius(A: ArrayLike) -> np.ndarray:
    """Largest |eigenvalue| of each of (..., n, n): below 1 the loop is stable."""
    return np.abs(np.linalg.eigvals(np.asarray(A, float))).max(axis=-1, initial=0.0)


def lyapunov(A: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """X = A X A' + Q for stable A, (..., n, n), doubling the terms of its sum until they add nothing. Smith (1968).

    Raises
    ------
    ScenarioError
        X is lost in rounding: its residual is not small beside the standard deviations of the states.
    """
    X, power = Q, A
    with np.errstate(over="ignore", invalid="ignore"):  # judged by the residual
        for _ in range(DOUBLINGS):
            X, last = X + power @ X @ np.swapaxes(power, -1, -2), X
            power = power @ power
            if np.array_equal(X, last):
                break
        size = np.sqrt(np.maximum(np.diagonal(X, axis1=-2, axis2=-1), 0.0))
        residual = np.abs(A @ X @ np.swapaxes(A, -1, -2) + Q - X)
    if not (residual <= RESIDUAL * size[..., :, None] * size[..., None, :]).all():
        raise ScenarioError(
            f"A: with a spectral radius of {spectral_radius(A).max():.12g}, or states so far from normal, the "
            "covariance is lost in rounding"
        )
    return X


def sampled_loop(A: ArrayLike, B: ArrayLike, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """A continuous loop dx/dt = A x + B w at its sampling instants, exactly, for `budget`.

    Parameters
    ----------
    A, B : (n, n), (n, m); w is white noise of unit density, E w(t) w(s)' = I delta(t - s)
    dt : () s, between samples; the finer, the nearer the windows are to those of continuous time

    Returns
    -------
    Ad, Bd : (n, n), (n, n); the inputs of Bd have unit variance and are no longer those of B

    Raises
    ------
    ScenarioError
        Shapes that do not fit, numbers that are not finite, a dt that is not positive.

    Notes
    -----
    Van Loan (1978), IEEE TAC 23(3), for a step so short that nothing grows; then the step is doubled.
    """
    n, m = len(np.atleast_2d(A)), np.atleast_2d(B).shape[-1]
    A, B, *_ = _matrices(A, B, np.zeros((0, n)), np.zeros((0, m)))
    halvings = max(0, int(np.ceil(np.log2(max(float(positive("dt", dt)) * np.linalg.norm(A, 1), 1e-300)))))
    block = expm(np.block([[-A, B @ B.T], [np.zeros((n, n)), A.T]]) * (dt / 2**halvings))
    Ad = block[n:, n:].T
    Q = Ad @ block[:n, n:]
    for _ in range(halvings):
        Ad, Q = Ad @ Ad, Q + Ad @ Q @ Ad.T
    return Ad, _root(Q)


def _apart(
    F: Sequence[np.ndarray], H: Sequence[np.ndarray], variance: Callable[..., Any], power: Callable[..., Any]
) -> Iterator[np.ndarray]:
    """Variances of e(k, r) - e(0, s) for k = 0, 1, ..., each (..., s r, sources, p) for the instants s, r of a period.

    Differences are taken of rows, not of variances, which for a slow error agree in all digits.
    """
    since = 0 * power(H[0])  # of the noise that came after the first sample
    for f, h in zip(F, H, strict=True):
        state, first = (_flat(a[..., None, :, :, :] - b[..., None, :, :]) for a, b in ((f, F[0]), (h, H[0])))
        copies = (1,) * (since.ndim - 3) + (since.shape[-3], 1, 1)
        yield variance(state) + power(first) + np.tile(since, copies)
        since = since + power(h)


def _relative(apart: np.ndarray, samples: int) -> np.ndarray:
    """Variances of e - <e> at the instants of a window, (..., N samples, sources, p), from those of differences.

    With v the variance of differences, that of e(i) - <e> is mean_j v(i, j) - mean_ij v(i, j) / 2.
    """
    span = len(apart)
    pairs = apart.reshape(*apart.shape[:-3], samples, samples, *apart.shape[-2:])
    before, after = pairs.sum(axis=-4), pairs.sum(axis=-3)  # from all earlier instants, to all later ones
    after[0] = 0.0  # those of the same period are counted once
    total = np.cumsum(before, axis=0) + np.cumsum(after, axis=0)[::-1]
    each = np.moveaxis(total, 0, -4) / (span * samples)
    each = each.reshape(*each.shape[:-4], span * samples, *each.shape[-2:])
    return np.maximum(each - each.mean(axis=-3, keepdims=True) / 2, 0.0)  # rounding


def _level(mean: np.ndarray, sigma: np.ndarray, share: float) -> np.ndarray:
    """Least x with P(|e| <= x) >= share for |means| and deviations (..., k, p): (..., p)."""
    high = (mean + ndtri((1 + share) / 2) * sigma).max(axis=-2)
    low = np.zeros_like(high)
    scale = np.where(sigma > 0, sigma, 1.0)
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        x = middle[..., None, :]
        within = np.where(sigma > 0, ndtr((x - mean) / scale) - ndtr((-x - mean) / scale), x >= mean)
        enough = within.mean(axis=-2) >= share
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    return high


def _root(X: np.ndarray) -> np.ndarray:
    """L with L L' = X for X >= 0, (..., n, n), whatever the units of the states."""
    size = np.sqrt(np.maximum(np.diagonal(X, axis1=-2, axis2=-1), 0.0))
    unit = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(X / (unit[..., :, None] * unit[..., None, :]))
    return size[..., :, None] * vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]  # rounding


def _flat(rows: np.ndarray) -> np.ndarray:
    """(..., s, r, p, n) -> (..., s r, p, n)."""
    return rows.reshape(*rows.shape[:-4], rows.shape[-4] * rows.shape[-3], *rows.shape[-2:])


def _pooled(part: np.ndarray, axis: int) -> np.ndarray:
    """The first leading axis put in front of the given one and joined with it."""
    if part.ndim == -axis:
        raise ScenarioError("the budget is that of one loop: there is nothing to pool")
    moved = np.moveaxis(part, 0, axis - 1)
    return moved.reshape(*moved.shape[: axis - 1], -1, *moved.shape[axis + 1 :])


def _matrices(*given: ArrayLike) -> list[np.ndarray]:
    """A, B, C, D as float64 with common leading axes, checked."""
    found = []
    for name, value in zip("ABCD", given, strict=True):
        array = np.asarray(value)
        if array.ndim < 2 or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise ScenarioError(f"{name} has shape {array.shape}, type {array.dtype}: give finite real (..., i, j)")
        found.append(array.astype(float))
    A, B, C, D = (a.shape[-2:] for a in found)
    if not (A[0] == A[1] == B[0] == C[1] and D == (C[0], B[1])):
        raise ScenarioError(f"A, B, C, D have shapes {A}, {B}, {C}, {D}: give (n, n), (n, m), (q, n), (q, m)")
    try:
        leading = np.broadcast_shapes(*(a.shape[:-2] for a in found))
    except ValueError as error:
        shapes = [a.shape for a in found]
        raise ScenarioError(f"A, B, C, D have shapes {shapes}: their leading axes must broadcast") from error
    return [np.broadcast_to(a, leading + a.shape[-2:]) for a in found]


def _inputs(name: str, value: ArrayLike, m: int, low: float | None = None) -> np.ndarray:
    """A number for each of the m inputs."""
    return real(name, np.full(m, value) if np.ndim(value) == 0 else value, (m,), low=low)


def _grouped(sources: Sequence[str], m: int) -> tuple[tuple[str, ...], np.ndarray]:
    """The different sources in order, and which input is whose, (sources, m) of 0 and 1."""
    names = tuple(sources) or tuple(map(str, range(m)))
    if isinstance(sources, str) or len(names) != m:
        raise ScenarioError(f"sources = {sources!r}: give one name for each of the {m} inputs")
    different = tuple(dict.fromkeys(names))
    return different, np.array([[float(name == source) for name in names] for source in different])
