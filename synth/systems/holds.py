"""Systems sampled exactly, for inputs that are known between the samples, with delays of any length.

    zoh       u is held from sample to sample
    foh       u runs straight from one sample to the next (triangle hold): of proper systems, D included
    impulse   u is a train of impulses of area dt u_k: y_k = dt g(k dt), with g(0) = C B, the limit from above

An input m + f samples late shows the plant, within a period, u_(k-m-1) up to the part f, and u_(k-m) from then on (or
the two straight lines between these and u_(k-m+1)). An output that is late by a part of a sample is what the plant had
between two samples. Both follow from one exponential for each part, and whole samples are lines of states; nothing is
approximated. The triangle hold sees the next sample, u_+; with x = w + H u_0 it is gone, H its effect on x.

References: Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, sections 4.3 (delays) and 6.3
(holds); Van Loan (1978), IEEE TAC 23, 395.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_number, shown
from synth.errors import ModelError
from synth.systems.delays import WHOLE, Late, lagged
from synth.systems.exponential import expm
from synth.systems.realization import Matrices, rescaled, state_scales
from synth.systems.statespace import StateSpace

HOLDS = ("zoh", "foh", "impulse")


class Within(NamedTuple):
    """State and input after a part of a period: x(t) = F x + sum of B[i] u[i], v(t) = sum of V[i] u[i]."""

    F: np.ndarray  # (n, n)
    B: np.ndarray  # (3, n, m) of u_-, u_0, u_+
    V: np.ndarray  # (3, m) likewise


def held(G: StateSpace, dt: float, method: str, arrival: Late, departure: Late) -> StateSpace:
    """A continuous system sampled exactly, with delays of its inputs and outputs.

    Raises
    ------
    ModelError : the method is "impulse" and D is not zero.
    """
    if method == "impulse" and G.D.any():
        raise ModelError(
            "method is 'impulse' and D is not zero: its impulse response has an impulse, which has no samples; pass G "
            "without its direct term and add that to the sampled system, or method='zoh' or 'foh'"
        )
    scales = state_scales(G.matrices)
    M = rescaled(G.matrices, scales)
    f, g = arrival.part, departure.part
    F, B, _ = within(M, dt, method, f, 1.0)
    ahead = B[2]
    C, D = np.zeros_like(M.C), np.zeros((3, *M.D.shape))
    for late in np.unique(g):
        rows, at = g == late, within(M, dt, method, f, 1.0 - late if late else 0.0)
        C[rows] = M.C[rows] @ at.F
        D[:, rows] = M.C[rows] @ at.B + M.D[rows] * at.V[:, None, :]
    D[1] += C @ ahead
    old = np.flatnonzero(f)  # inputs of which the sample before still acts
    A, E, C, _ = rescaled(Matrices(F, np.hstack([B[1] + F @ ahead, B[0][:, old]]), C, D[1]), 1 / scales)
    between = np.flatnonzero(g)
    sampled = StateSpace(
        A, E, np.vstack([C, np.zeros((len(between), G.n))]),
        np.block([[D[1], D[0][:, old]], [D[2][between], np.zeros((len(between), len(old)))]]), dt,
    )  # fmt: skip
    if len(between):  # what was there before this sample waits for it, and has what this one adds
        I, rows = np.eye(G.ny), range(G.ny + len(between))
        wait = lagged(len(rows), rows, [*(g > 0).astype(int), *np.zeros(len(between), int)], dt)
        sampled = StateSpace.gain(np.hstack([I, I[:, between]]), dt) * wait * sampled
    return _in_line(sampled, G, [*range(G.nu), *old], [*arrival.whole, *arrival.whole[old] + 1], departure)


def waiting(G: StateSpace, method: str, arrival: Late, departure: Late) -> StateSpace:
    """A discrete system with delays of whole samples.

    Raises
    ------
    ModelError : a delay has a part of a sample, which this method does not know.
    """
    for name, late in (("delay", arrival), ("output_delay", departure)):
        if late.part.any():
            raise ModelError(
                f"{name} is {np.add(*late).tolist()} samples of dt = {G.dt:g} s, and method {method!r} has whole ones "
                "only; pass a method that is exact (zoh, foh, impulse), or whole samples"
            )
    return _in_line(G, G, range(G.nu), arrival.whole, departure)


def _in_line(sampled: StateSpace, G: StateSpace, channels: Iterable[Any], lags: Iterable[Any], departure: Late):
    """The sampled system between lines of whole samples, with the names of G."""
    channels, lags = list(channels), list(lags)
    if channels != list(range(G.nu)) or any(lags):
        sampled = sampled * lagged(G.nu, channels, lags, sampled.dt)
    if departure.whole.any():
        sampled = lagged(G.ny, range(G.ny), departure.whole, sampled.dt) * sampled
    return replace(sampled, u=G.u, y=G.y, units=G.units)


def bilinear_rate(method: str, dt: float, prewarp: Any = None) -> float:
    """The rate in rad/s of the bilinear map that keeps the response at `prewarp` rad/s, at rest without it."""
    if prewarp is None:
        return 2 / dt
    if method != "tustin":
        raise ModelError(f"prewarp is {shown(prewarp)} and method {method!r}; it belongs to method='tustin'")
    told = f"a frequency in rad/s between 0 and pi/dt = {np.pi / dt:g}"
    w = as_number("prewarp", prewarp, told, above=0)
    if w * dt >= np.pi:
        raise ModelError(f"prewarp is {w:g} rad/s; pass {told}")
    return float(w / np.tan(w * dt / 2))


def within(M: Matrices, dt: float, method: str, f: np.ndarray, t: float) -> Within:
    """The part t of a period after a sample, the inputs parts f of a sample late, (m,)."""
    n, m = M.B.shape
    B, V = np.zeros((3, n, m)), np.zeros((3, m))
    for late in np.unique(f):
        j, after = f == late, t - late if abs(t - late) > WHOLE else 0.0
        E, constant, ramp = _moved(M.A, M.B[:, j], dt, max(after, 0.0))
        if method == "impulse":
            B[1][:, j] = dt * E @ M.B[:, j] if after >= 0 else 0.0
            continue
        line = method == "foh"
        _, first, rise = _moved(M.A, M.B[:, j], dt, min(t, late))
        B[0][:, j] = E @ (late * first - rise if line else first)
        B[1][:, j] = E @ ((1 - late) * first + rise) if line else 0.0
        if after >= 0:
            B[1][:, j] += constant - ramp if line else constant
            B[2][:, j] = ramp if line else 0.0
            V[1:, j] = [[1 - after], [after]] if line else [[1.0], [0.0]]
        else:
            V[:2, j] = [[-after], [1 + after]] if line else [[1.0], [0.0]]
    return Within(_moved(M.A, M.B[:, :0], dt, t)[0], B, V)


def _moved(A: np.ndarray, B: np.ndarray, dt: float, part: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """exp(A t) at the part t of a period, and what inputs of one, and those that rise to one in a period, leave."""
    n, m = B.shape
    M = np.zeros((n + 2 * m, n + 2 * m))
    M[:n, :n], M[:n, n : n + m], M[n : n + m, n + m :] = dt * A, dt * B, np.eye(m)
    E = expm(part * M)
    return E[:n, :n], E[:n, n : n + m], E[:n, n + m :]
