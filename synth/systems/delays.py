"""Delays: lines of samples in discrete time, exact; Pade approximants in continuous time, with their error.

    P_n(s) = 1 - s T e1' (I + s T X)^-1 e1,  X = e1 e1'/2 + skew,  X[k, k-1] = -X[k-1, k] = 1 / (2 sqrt(4 k^2 - 1))

is the Pade approximant of e^(-s T) with n poles and n zeros, as the stability function of Gauss's Runge-Kutta methods.
Nothing is expanded into coefficients, and with x' = -X^-1 x / T + ... both Gramians are the identity.

Reference: Hairer and Wanner (1996), Solving Ordinary Differential Equations II, section IV.5 (X, the W-transformation).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_array, as_number, as_whole
from synth.errors import ModelError
from synth.systems.statespace import StateSpace

LONGEST = 5000  # samples of delay in all, each a state
WHOLE = 1e-9  # of a sample: a delay is that near to a whole number of them by rounding
HIGHEST = 100  # order of an approximant


class Late(NamedTuple):
    """Delays in samples, channel by channel."""

    whole: np.ndarray  # (m,) whole samples
    part: np.ndarray  # (m,) of a sample, in [0, 1)


def as_late(name: str, delay: Any, count: int, dt: float) -> Late:
    """Delays in s, one for all channels or one for each, in samples of `dt` s."""
    told = f"pass a time in s that is not negative, or {count} of them"
    late = as_array(name, delay, told)
    if late.shape not in ((), (count,)) or late.min() < 0:
        raise ModelError(f"{name} is {late.tolist()}; {told}")
    samples = np.broadcast_to(late / dt, (count,))
    near = np.abs(samples - np.round(samples)) <= WHOLE
    whole = np.where(near, np.round(samples), np.floor(samples))
    if not whole.sum() <= LONGEST:
        raise ModelError(
            f"{name} is {late.tolist()} s, {whole.sum():.6g} samples in all; at most {LONGEST} can be states"
        )
    return Late(whole.astype(int), np.where(near, 0.0, samples - whole))


def lagged(count: int, channels: Iterable[Any], lags: Iterable[Any], dt: float) -> StateSpace:
    """The discrete system of `count` inputs whose output i is input channels[i], lags[i] samples later."""
    channels, lags, length = list(channels), list(lags), np.zeros(count, int)
    np.maximum.at(length, channels, lags)
    ends, n = np.cumsum(length), int(length.sum())
    A, B = np.zeros((n, n)), np.zeros((n, count))
    C, D = np.zeros((len(channels), n)), np.zeros((len(channels), count))
    for j, (k, end) in enumerate(zip(length, ends, strict=True)):
        A[end - k : end, end - k : end] = np.eye(k, k=-1)
        B[end - k : end, j] = np.eye(k, 1)[:, 0]
    for i, (j, lag) in enumerate(zip(channels, lags, strict=True)):
        if lag:
            C[i, ends[j] - length[j] + lag - 1] = 1.0
        else:
            D[i, j] = 1.0
    return StateSpace(A, B, C, D, dt)


def pade(delay: Any, n: Any) -> StateSpace:
    """Pade approximant of e^(-s T) with n poles and n zeros: all-pass, stable, in balanced states.

    Discrete systems need none: `c2d(G, dt, delay=T)` is exact. How far it is from the delay: `pade_error`.

    Parameters
    ----------
    delay : T, () s, not negative; n : order, 1 to 100

    Returns
    -------
    StateSpace : continuous, one input, one output; the gain 1 for no delay

    Raises
    ------
    ModelError : the delay is negative, the order is no whole number in this range.

    Reference: Hairer and Wanner (1996), Solving Ordinary Differential Equations II, section IV.5.
    """
    T, n = _asked(delay, n)
    if T == 0:
        return StateSpace.gain([[1.0]], 0.0)
    M = np.linalg.inv(_gauss(n))
    return StateSpace(-M / T, M[:, :1] / np.sqrt(T), M[:1] / np.sqrt(T), np.array([[(-1.0) ** n]]), 0.0)


def pade_error(delay: Any, n: Any, omega: Any) -> np.ndarray:
    """The largest |e^(-j w T) - P_n(j w)| over all w up to `omega`, 2 at most: moduli are one, the phases differ.

    The phase lag of P_n falls behind w T ever more as w grows, so that the error is the largest at `omega`.

    Parameters
    ----------
    delay, n : as of `pade`; omega : frequencies in rad/s, not negative, of any shape

    Returns
    -------
    error : of the shape of omega, from 0 to 2; correct to 1e-14 (1 + omega T)

    Raises
    ------
    ModelError : as `pade`; a frequency is negative.
    """
    T, n = _asked(delay, n)
    w = as_array("omega", omega, "pass frequencies in rad/s, not negative")
    if w.min(initial=0.0) < 0:
        raise ModelError(f"omega has {w.min():g}; pass frequencies in rad/s, not negative")
    poles = 1 / np.linalg.eigvals(_gauss(n))  # of 1/P, times T: in the right half plane
    angle = np.arctan2(w[..., None] * T + poles.imag, poles.real) - np.arctan2(poles.imag, poles.real)
    return 2 * np.sin(np.clip(w * T - 2 * angle.sum(axis=-1), 0.0, np.pi) / 2)


def _asked(delay: Any, n: Any) -> tuple[float, int]:
    """The arguments of an approximant."""
    T = as_number("delay", delay, "a time in s that is not negative", least=0)
    return T, as_whole("n", n, "the order of the approximant, a whole number from 1 on", least=1, most=HIGHEST)


def _gauss(n: int) -> np.ndarray:
    """X, (n, n), of Gauss's method with n stages."""
    beside = 0.5 / np.sqrt(4.0 * np.arange(1, n) ** 2 - 1)
    X = np.diag(beside, -1) - np.diag(beside, 1)
    X[0, 0] = 0.5
    return X
