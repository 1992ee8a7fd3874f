"""Hankel singular values, Gramians, balanced and minimal realisations, of unstable systems too.

A system is the sum of a stable part and of the modes on or beyond the stability boundary, told from each other by more
than rounding. The stable part has Gramians W = L L' and M M', of which only the factors are computed: the Hankel
singular values are the singular values of M'L. The other modes have infinite ones.

References: Moore (1981), IEEE TAC 26, 17; Tombs and Postlethwaite (1987), Int. J. Control 46, 1319 (square roots);
Zhou, Salomon and Wu (1999), Int. J. Robust and Nonlinear Control 9, 183 (unstable systems).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg as sla

from synth.analysis.differences import Poles, blur, integrators, persistent, split
from synth.analysis.norms import in_principal_axes
from synth.analysis.truncation import Balancing, gramian_factors
from synth.checks import as_number, numerical
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.systems.modes import doubts
from synth.systems.realization import RANKS, minimal
from synth.systems.statespace import StateSpace, as_system
from synth.threads import one_thread

NEGLIGIBLE = 1e-13  # of the largest singular value: a state that rounding made
AGREES = 1e-6  # of the response: what the sum of the parts may be off
POINTS, DECADES = 50, 1.0  # of the frequencies of a comparison, and how far beyond the poles they go
SAME = 1e-8  # of the response at a frequency: what a minimal realisation may be off by default


class Parts(NamedTuple):
    """G = kept + stable."""

    stable: StateSpace  # with the direct term
    kept: StateSpace  # modes on or beyond the stability boundary, for all that rounding lets one know


class Gramians(NamedTuple):
    """Symmetric, positive semidefinite (n, n), in the coordinates of the system."""

    reachability: np.ndarray  # A W + W A' + B B' = 0, or A W A' - W + B B' = 0
    observability: np.ndarray  # A'M + M A + C'C = 0, or A'M A - M + C'C = 0


class Balanced(NamedTuple):
    """A balanced realisation and its Hankel singular values."""

    system: StateSpace  # modes with infinite values first
    singular_values: np.ndarray  # (order), largest first


def parts(G: StateSpace, which: Callable[..., Poles] = persistent) -> Parts:
    """The stable part of a system in good coordinates, and the modes that no reduction may touch, or other ones.

    Raises
    ------
    NumericalError : modes on both sides of the stability boundary are too near each other to be told apart.
    """
    G = in_principal_axes(G)
    chosen = which(G.A, discrete=G.discrete)
    if not chosen[1].any():
        return Parts(G, StateSpace.gain(np.zeros_like(G.D), G.dt))
    found = Parts(*split(G, chosen))
    *sizes, off = _responses(G, *found)
    if np.any(off > AGREES * sum(sizes) + blur(G, grid(G))):
        raise NumericalError(
            "modes on or beyond the stability boundary cannot be told from stable ones next to them; take slow modes "
            'for integrators, or reduce with method="coprime", which does not part them'
        )
    return found


def _responses(G: StateSpace, *summands: StateSpace) -> list[np.ndarray]:
    """Norms (k,) of the responses of a system and of its summands on a grid, and of the difference last."""
    omega = grid(G)
    found = [H.frequency_response(omega) for H in (G, *summands)]
    return [np.linalg.norm(F, 2, axis=(1, 2)) for F in (*found, found[0] - sum(found[1:]))]


def grid(G: StateSpace) -> np.ndarray:
    """Frequencies (k,) in rad/s about the poles of a system that are none of rest."""
    values, doubt = doubts(G.A)
    moving = ~integrators(G.A, values, discrete=G.discrete) & (np.abs(values) > doubt)
    values, doubt = values[moving], doubt[moving]
    if G.discrete:
        values, doubt = np.log(values) / G.dt, doubt / np.abs(values) / G.dt
    moduli = np.abs(values)[np.abs(values) > doubt]
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    top = min(high * 10**DECADES, 3.0 / G.dt) if G.discrete else high * 10**DECADES
    return np.geomspace(min(low * 10**-DECADES, 1e-3 * top), top, POINTS)


def balancing(stable: StateSpace, reached: np.ndarray | None = None, seen: np.ndarray | None = None) -> Balancing:
    """Of a stable system, from its Gramians or from factors of others, (n, r) and (n, q).

    Raises
    ------
    NumericalError : a pole is so near the stability boundary that rounding crosses it.
    """
    if reached is None or seen is None:
        own = gramian_factors(stable)
        reached, seen = (mine if given is None else given for mine, given in zip(own, (reached, seen), strict=True))
    if not (np.isfinite(reached).all() and np.isfinite(seen).all()):
        raise NumericalError(
            "a pole is so near the stability boundary that double precision has no Gramians; move it onto the boundary "
            "or away from it, or bring the model to better units"
        )
    return Balancing.of(reached, seen)


def meaningful(sigma: np.ndarray) -> int:
    """How many singular values rounding has not made."""
    return int(np.sum(sigma > NEGLIGIBLE * sigma.max(initial=0.0)))


def all_values(kept: StateSpace, stable: StateSpace, sigma: np.ndarray) -> np.ndarray:
    """Hankel singular values of all states, (n,): inf for those that stay, 0 for those not reached or not seen."""
    return np.concatenate([np.full(kept.n, np.inf), np.pad(sigma, (0, stable.n - len(sigma)))])


def projected(G: StateSpace, T: np.ndarray, Ti: np.ndarray) -> StateSpace:
    """The system on x = T x_new, with Ti T = I: truncation of all other states."""
    return replace(G, A=Ti @ G.A @ T, B=Ti @ G.B, C=G.C @ T)


def joined(kept: StateSpace, stable: StateSpace) -> StateSpace:
    """The sum, states of the first part first."""
    if not kept.n:
        return stable
    A = np.asarray(sla.block_diag(kept.A, stable.A)).reshape(kept.n + stable.n, -1)
    return replace(stable, A=A, B=np.vstack([kept.B, stable.B]), C=np.hstack([kept.C, stable.C]))


@one_thread
@numerical
def hsvd(G: Any) -> np.ndarray:
    """Hankel singular values (n,), largest first, continuous or discrete; inf for modes that are not stable.

    Parameters
    ----------
    G : in any form that `system` takes

    Raises
    ------
    ModelError : G is no system.
    NumericalError : stable and other modes are too near each other for doubles.

    Reference: Moore (1981), IEEE TAC 26, 17.

    Examples
    --------
    >>> from synth import hsvd
    >>> [round(float(s), 6) for s in hsvd(([1], [1, 1]))]  # 1/(s + 1)
    [0.5]
    """
    found = parts(as_system("G", G))
    return all_values(found.kept, found.stable, balancing(found.stable).sigma)


@one_thread
@numerical
def balreal(G: Any) -> Balanced:
    """Balanced realisation: both Gramians of the stable part are diagonal and equal to the Hankel singular values.

    Parameters
    ----------
    G : in any form that `system` takes, continuous or discrete

    Returns
    -------
    Balanced : system, singular_values. Modes that are not stable come first and are not balanced; states whose value
        is rounding (1e-13 of the largest), not reached or not seen, are left out

    Raises
    ------
    ModelError : G is no system.
    NumericalError : stable and other modes are too near each other for doubles.
    """
    found = parts(as_system("G", G))
    b = balancing(found.stable)
    k = meaningful(b.sigma)
    small = projected(found.stable, *b.projection(k))
    return Balanced(joined(found.kept, small), all_values(found.kept, small, b.sigma[:k]))


@one_thread
@numerical
def gramians(G: Any) -> Gramians:
    """Reachability and observability Gramian of a stable system, continuous or discrete, in its own coordinates.

    Parameters
    ----------
    G : in any form that `system` takes

    Raises
    ------
    ModelError : G is no system.
    AssumptionError : G is not stable by more than rounding, so that the integrals diverge.
    """
    G = as_system("G", G)
    values, mask = persistent(G.A, discrete=G.discrete)
    if mask.any():
        raise AssumptionError(
            "a stable system",
            f"G has no Gramians: the pole {shown_pole(values[mask][0])} is not stable; take the stable part, or see "
            "hsvd and balreal, which part it",
            tuple(map(complex, values[mask])),
        )
    b = balancing(G)
    return Gramians(b.reached @ b.reached.T, b.seen @ b.seen.T)


def shown_pole(value: complex) -> str:
    """For messages."""
    return f"{value.real:.4g}" if value.imag == 0 else f"{value:.4g}"


@one_thread
@numerical
def minreal(G: Any, tol: float = SAME) -> StateSpace:
    """Minimal realisation: without states that inputs do not reach or outputs do not see.

    Parameters
    ----------
    G : in any form that `system` takes, continuous or discrete, stable or not
    tol : by how much the response may differ, relative to it at every frequency, besides what rounding of A makes of it

    Returns
    -------
    StateSpace with the fewest states that two orthogonal staircases find within `tol`; G in other coordinates where
    nothing cancels

    Raises
    ------
    ModelError : G is no system, or tol no number from 1e-13 to 1e-2.

    Reference: Van Dooren (1981), IEEE TAC 26, 111.
    """
    G = as_system("G", G)
    tol = as_number("tol", tol, "a relative difference from 1e-13 to 1e-2", least=1e-13)
    if tol > 1e-2:
        raise ModelError(f"tol is {tol:g}; pass a relative difference from 1e-13 to 1e-2, or see reduce for more")
    turned = in_principal_axes(G)
    rounded = blur(turned, grid(turned))
    for found in sorted(_smaller(turned, (tol, *RANKS)), key=lambda H: H.n):
        own, _, off = _responses(turned, found)
        if np.all(off <= tol * own + rounded):
            return found
    return turned


def _smaller(G: StateSpace, ranks: tuple[float, ...]) -> Iterator[StateSpace]:
    """By staircases, of all or of what is not stable, and singular values of the rest; `ranks` count as nothing."""

    def staircase(H: StateSpace, rank: float) -> StateSpace:
        return replace(H, **minimal(H.matrices, rank)._asdict())

    yield from (staircase(G, rank) for rank in ranks)
    try:
        stable, kept = parts(G)
        b = balancing(stable)
    except NumericalError:
        return
    small = projected(stable, *b.projection(meaningful(b.sigma)))
    yield from (joined(staircase(kept, rank), small) for rank in ranks)
