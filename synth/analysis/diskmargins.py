"""Disk margins: gains and phases of every channel that may change together, each on its own.

A channel is multiplied by a complex f in the disk D(alpha, skew):

    f = (2 + (1 - skew) delta) / (2 - (1 + skew) delta),   |delta| < alpha

The loop stays stable for all of them exactly when alpha is at most 1 / mu(S + (skew - 1)/2 I), S = (I + L)^-1, with the
structured singular value mu of `structured`: its bound is exact for up to three channels and does not depend on the
units of the signals. With skew 0 gains and their inverses count alike, S - T for one channel; 1 is the margin of S
(changes that divide), -1 that of T (changes that multiply).

References: Seiler, Packard and Gahinet (2020), An Introduction to Disk Margins, IEEE Control Systems 40(5), 78;
Blight, Dailey and Gangsaas (1994), Int. J. Control 59, 155.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from synth.analysis.norms import balance, hinfnorm, is_stable
from synth.analysis.structured import best_scaling, destabilising, structured_norm
from synth.checks import as_array, as_number, as_sign, numerical
from synth.errors import ModelError, NumericalError
from synth.systems.connect import feedback
from synth.systems.sampled import cayley, pole_rate
from synth.systems.statespace import StateSpace, as_system

HUGE = 1e100  # size of a disk that holds whatever one will
ROUNDED = 1e-12  # relative: an end of the frequencies that is as high as the peak is the peak
AGREES = 1e-3  # relative difference of mu on the mapped loop and on the given one that is accepted


@dataclass(frozen=True, eq=False)
class DiskMargin:
    """Gain and phase that may change together, in every channel at once."""

    alpha: float  # size of the disk, 0 for an unstable loop
    frequency: float  # rad/s, where it is smallest
    skew: float = 0.0  # of the disk
    factors: np.ndarray = field(default_factory=lambda: np.zeros(0, complex), repr=False)
    """(m,) complex factors of the channels with which the loop has a pole at that frequency: of size `alpha` for up to
    three channels, of the least size found for more."""

    @property
    def gain(self) -> tuple[float, float]:
        """Gains that each channel bears, down to 0 and up to inf."""
        size = min(self.alpha, HUGE)
        low = max(2 - (1 - self.skew) * size, 0.0) / abs(2 + (1 + self.skew) * size)
        above = 2 - (1 + self.skew) * size
        return low, (2 + (1 - self.skew) * size) / above if above > 0 else np.inf

    @property
    def gain_db(self) -> float:
        """The smaller of both, in decibels."""
        low, high = self.gain
        return float(min(20 * np.log10(high), -20 * np.log10(low) if low > 0 else np.inf))

    @property
    def phase(self) -> float:
        """Phase that each channel bears, rad."""
        size = min(self.alpha, HUGE)
        square = 4 + (1 - self.skew**2) * size**2
        sine = size / np.sqrt(square) if square > 0 else np.inf
        return float(2 * np.arcsin(min(sine, 1.0)))

    @property
    def phase_deg(self) -> float:
        """Phase that each channel bears, in degrees."""
        return float(np.rad2deg(self.phase))


@numerical
def diskmargin(L: Any, sign: int = -1, *, skew: float = 0.0) -> DiskMargin:
    """Disk margin of a square loop, all of its channels at once, each changed on its own.

    Parameters
    ----------
    L : (m x m) loop transfer matrix, in any form that `system` takes
    sign : -1 for negative feedback (default), +1 for positive
    skew : sigma of the disk: 0 balances gains above and below one, 1 takes S alone, -1 T alone

    Returns
    -------
    DiskMargin : guaranteed up to a relative 1e-7; the largest such disk for up to three channels

    Raises
    ------
    ModelError : L is not square, `sign` is neither -1 nor 1, `skew` is no number.
    NumericalError : rounding hides the loop.

    Reference: Seiler, Packard and Gahinet (2020), IEEE Control Systems 40(5), 78, theorem 1 and section "MIMO".
    """
    G, skew = _checked(L, sign, skew)
    H = _changes(G, skew)
    if not is_stable(H):
        return DiskMargin(0.0, np.nan, skew, np.ones(G.nu, complex))
    if G.nu == 1:
        mu, frequency = hinfnorm(H)
    else:
        rate = 0.0 if H.discrete else pole_rate(H.poles())
        peak = structured_norm(H if H.discrete else cayley(H, rate))
        mu = peak.value
        frequency = peak.angle / H.dt if H.discrete else float(rate * np.tan(peak.angle / 2))
    for end in (0.0, np.pi / H.dt if H.discrete else np.inf):
        if best_scaling(_at(H, end)).norm >= mu * (1 - ROUNDED):
            frequency = end
    if mu == 0:
        return DiskMargin(np.inf, frequency, skew, np.full(G.nu, np.nan, complex))
    M = _at(H, frequency)
    given = best_scaling(M).norm
    if abs(given - mu) > AGREES * mu:
        raise NumericalError(
            f"the disk margin is {1 / mu:.6g} on the balanced loop and {1 / given:.6g} on the given one, at "
            f"{frequency:.4g} rad/s: rounding hides the loop; bring its states to better units"
        )
    delta = destabilising(M)
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = (2 + (1 - skew) * delta) / (2 - (1 + skew) * delta)
    return DiskMargin(1 / given, frequency, skew, factors)


def diskmargin_at(L: Any, omega: Any, sign: int = -1, *, skew: float = 0.0) -> np.ndarray:
    """Size of the disk at frequencies, (k,): `diskmargin` is the smallest over all of them.

    Parameters
    ----------
    L, sign, skew : as of `diskmargin`
    omega : (k,) rad/s, not negative

    Raises
    ------
    ModelError : as `diskmargin`; a frequency is negative, or above the Nyquist frequency of a discrete loop.
    """
    G, skew = _checked(L, sign, skew)
    omega = np.atleast_1d(as_array("omega", omega, "pass frequencies in rad/s"))
    highest = np.pi / G.dt * (1 + 1e-12) if G.discrete else np.inf
    if omega.ndim > 1 or omega.min(initial=0.0) < 0 or omega.max(initial=0.0) > highest:
        raise ModelError(
            f"omega reaches from {omega.min():g} to {omega.max():g} rad/s; pass a row from 0 to {highest:g}"
        )
    H = _changes(G, skew)
    if not is_stable(H):
        return np.zeros(len(omega))
    with np.errstate(divide="ignore"):
        return 1 / np.array([best_scaling(_at(H, w)).norm for w in omega])


def negative(L: Any, sign: int) -> StateSpace:
    """The loop for negative feedback."""
    L = as_system("L", L)
    return L if as_sign(sign) == -1 else -L


def _checked(L: Any, sign: int, skew: Any) -> tuple[StateSpace, float]:
    """The loop for negative feedback, and the skew."""
    G = negative(L, sign)
    if G.ny != G.nu:
        raise ModelError(f"L is {G.ny} x {G.nu}; a loop has as many outputs as inputs")
    return G, as_number("skew", skew, "a number, 0 for gains up and down alike")


def _changes(G: StateSpace, skew: float) -> StateSpace:
    """S + (skew - 1)/2 I, what the changes delta of the channels see of a loop."""
    T = feedback(G, StateSpace.gain(np.eye(G.nu), G.dt))
    return StateSpace(T.A, T.B, -T.C, (1 + skew) / 2 * np.eye(G.nu) - T.D, T.dt)


def _at(H: StateSpace, frequency: float) -> np.ndarray:
    """A stable system at a frequency in rad/s, (m, m)."""
    if not H.n or not np.isfinite(frequency):
        return H.D.astype(complex)
    return balance(H).matrices.at(np.exp(1j * frequency * H.dt) if H.discrete else 1j * frequency)
