"""From discrete to continuous time: `d2c`, the way back of every method of `c2d` but "impulse"."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from synth.checks import as_choice, check_period, numerical
from synth.errors import ModelError, NumericalError
from synth.systems.exponential import expm
from synth.systems.holds import bilinear_rate, within
from synth.systems.matched import check_logarithm, unmatched
from synth.systems.modes import doubts
from synth.systems.realization import Matrices, rescaled, state_scales
from synth.systems.sampled import inverse_cayley
from synth.systems.statespace import StateSpace, as_system

AGREES = 1e-6  # relative error of A sampled again


@numerical
def d2c(G: Any, method: str = "zoh", *, prewarp: float | None = None) -> StateSpace:
    """Discrete to continuous: the system that `c2d(_, G.dt, method)` samples to G.

    Parameters
    ----------
    G : discrete system, in any form that `system` takes
    method : "zoh" and "foh", by the principal logarithm of A, whose system swings by less than half a turn a sample
        (|Im s| < pi/dt); "tustin", "midpoint"; "matched", of one input and one output, for which zeros at -1 are
        infinite ones
    prewarp : rad/s, as of `c2d`

    Raises
    ------
    ModelError : G is continuous or its sampling time is not said; "zoh", "foh" and "matched": a pole at 0 (a delay) or
        below (it changes sign every sample), which no real system of this order has; "tustin", "midpoint": one at -1.
    NumericalError : a pole is 0 to rounding, or the logarithm of A, sampled again, is not A.

    Reference: Higham (2008), Functions of Matrices, chapter 11 (logarithm).
    """
    G = as_system("G", G)
    if not G.discrete:
        raise ModelError("the system G is already continuous; d2c takes a discrete one")
    check_period("G", G.dt)
    as_choice("method", method, ("zoh", "foh", "tustin", "midpoint", "matched"))
    rate = bilinear_rate(method, G.dt, prewarp)
    if method == "matched":
        return unmatched(G)
    if G.n == 0:
        return replace(G, dt=0.0)
    if method in ("zoh", "foh"):
        return _released(G, method)
    try:
        mapped = inverse_cayley(G, rate)
    except ModelError:
        raise ModelError(
            "G has a pole at z = -1, which method='" + method + "' sends to infinity; take that part out of G"
        ) from None
    if method == "midpoint":
        return replace(G, A=mapped.A, B=(G.B - G.dt / 2 * mapped.A @ G.B) / G.dt, dt=0.0)
    return replace(mapped, u=G.u, y=G.y, units=G.units)


def _released(G: StateSpace, method: str) -> StateSpace:
    """By the logarithm of A; B and D are linear in what they were before."""
    scales, n, dt = state_scales(G.matrices), G.n, G.dt
    A, B, C, D = rescaled(G.matrices, scales)
    if np.tril(A, -1).any() and np.triu(A, 1).any():  # of triangular matrices the poles are known to every digit
        values, doubt = doubts(A)
        if np.any(np.abs(values) <= doubt):
            raise NumericalError(
                f"method is {method!r} and G has a pole that is 0 to rounding, which is a delay, or "
                "a mode that has died within a sample: no logarithm finds it; pass method='tustin', or take it out"
            )
    check_logarithm(method, "pole", G.poles())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of inaccuracy, which is measured below
        L = np.real(np.asarray(sla.logm(A)))
    if not np.isfinite(L).all() or np.linalg.norm(expm(L) - A) > AGREES * np.linalg.norm(A):
        raise NumericalError(
            f"method is {method!r} and the logarithm of A, sampled again, is not A: its poles, of moduli from "
            f"{np.abs(G.poles()).min():.3g} to {np.abs(G.poles()).max():.3g}, are too far apart; pass method='tustin', "
            "or take out what has died within a sample"
        )
    A0 = L / dt
    held = within(Matrices(A0, np.eye(n), np.eye(n), np.zeros((n, n))), dt, method, np.zeros(n), 1.0)
    B0 = np.linalg.solve(held.B[1] + A @ held.B[2], B)
    found = Matrices(A0, B0, C, D - C @ held.B[2] @ B0)
    return replace(G, **rescaled(found, 1 / scales)._asdict(), dt=0.0)
