"""Order reduction of systems: truncation, residualisation, coprime factors and frequency weights.

In balanced coordinates the states with the smallest Hankel singular values are left out. Truncated, the response is
exact at infinity; residualised ("matchdc"), at rest:

    F x = (A - s0 I) x,  s0 = 0 or z0 = 1,   Fr = (Ti F^-1 T)^-1,   Br = Fr Ti F^-1 B,   Cr = C F^-1 T Fr

which is the truncation of the reciprocal system, so that no small block is inverted. Both are within twice the sum of
the values left out, and modes on or beyond the stability boundary stay as they are. Coprime factors are truncated in
coordinates in which both Riccati solutions are diagonal and equal, unstable modes with the others: they may move, by
no more than the gap says. With weights the Gramians are those of G behind the input weight and before the output one.

References: Moore (1981), IEEE TAC 26, 17; Liu and Anderson (1989), Int. J. Control 50, 1379 (singular perturbation);
Enns (1984), 23rd CDC, 127 (frequency weights); McFarlane, Glover and Vidyasagar (1990), IEEE TAC 35, 369 and Jonckheere
and Silverman (1983), IEEE TAC 28, 953 (normalised coprime factors).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from synth.analysis.coprime import gang_of_four, solutions
from synth.analysis.gap import gapmetric
from synth.analysis.hankel import Parts, all_values, balancing, joined, meaningful, parts, projected, shown_pole
from synth.analysis.norms import hinfnorm, in_principal_axes, is_stable
from synth.analysis.precondition import check_assumptions
from synth.analysis.truncation import Balancing, bounds, gramian_factors
from synth.checks import as_number, as_whole, shown
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.systems.modes import crosses
from synth.systems.statespace import StateSpace, as_system, common_timebase, repeated, retimed

TRUNCATE, MATCHDC, COPRIME = METHODS = ("truncate", "matchdc", "coprime")


@dataclass(frozen=True, eq=False, repr=False)
class Reduction:
    """A reduced system and what leaving states out cost; functions that take a system take it as `system`."""

    system: StateSpace
    method: str  # "truncate", "matchdc" or "coprime"
    singular_values: np.ndarray  # (n,) of the system given, inf for modes that stay
    error: float  # measured: H-infinity norm of the (weighted) difference; of "coprime" the gap
    bound: float | None  # on it, beforehand: twice the sum of the values left out; None with weights, which have none

    @property
    def order(self) -> int:
        """Number of states that are left."""
        return self.system.n

    A = property(lambda self: self.system.A, doc="(order, order)")
    B = property(lambda self: self.system.B, doc="(order, m)")
    C = property(lambda self: self.system.C, doc="(p, order)")
    D = property(lambda self: self.system.D, doc="(p, m)")
    dt = property(lambda self: self.system.dt, doc="s, of the system given")

    def __repr__(self) -> str:
        what = "gap" if self.method == COPRIME else "error"
        bound = "" if self.bound is None else f", bound {self.bound:.3g}"
        return (
            f"Reduction(order {self.order} of {len(self.singular_values)} by {self.method!r}; "
            f"measured {what} {self.error:.3g}{bound})"
        )

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Hankel singular values, with a line behind those that were kept; see `synth.hsvplot`."""
        from synth.delivery.hankelplots import reduction_plot

        return reduction_plot(self, ax, **style)


class Problem(NamedTuple):
    """What is reduced: modes that stay, the others in coordinates to be cut, and the weights of the error."""

    parts: Parts
    balancing: Balancing
    before: StateSpace | None = None  # input weight
    after: StateSpace | None = None  # output weight

    def reduced(self, k: int, method: str) -> StateSpace:
        """With the first k balanced states."""
        return joined(self.parts.kept, cut(self.parts.stable, self.balancing, k, method))

    def error(self, reduced: StateSpace) -> float:
        """H-infinity norm of the weighted difference from the stable part."""
        fixed = self.parts.kept.n
        H = replace(reduced, A=reduced.A[fixed:, fixed:], B=reduced.B[fixed:], C=reduced.C[:, fixed:])
        E = self.parts.stable - H
        E = E if self.before is None else E * self.before
        return hinfnorm(E if self.after is None else self.after * E)[0]


def cut(G: StateSpace, balancing: Balancing, k: int, method: str) -> StateSpace:
    """The first k states of a balanced system, truncated or residualised.

    Raises
    ------
    LinAlgError : a pole is at rest, where "matchdc" has no response to match.
    """
    T, Ti = balancing.projection(k)
    if method != MATCHDC or not G.n:
        return projected(G, T, Ti)
    F = G.A - np.eye(G.n) if G.discrete else G.A
    X = np.linalg.solve(F, np.hstack([T, G.B]))
    V, Y = X[:, :k], X[:, k:]
    Fr = np.linalg.inv(Ti @ V)
    B, C = Fr @ (Ti @ Y), G.C @ V @ Fr
    A = Fr + np.eye(k) if G.discrete else Fr
    return replace(G, A=A, B=B, C=C, D=G.D - G.C @ Y + C @ (Ti @ Y))


def reduced(
    G: StateSpace, order: int | None, error: float | None, method: str, before: Any = None, after: Any = None
) -> Reduction:
    """A system with fewer states: see `synth.reduce`, whose doors were passed except for the weights and numbers."""
    if (order is None) == (error is None):
        raise ModelError(
            f"order is {shown(order)} and error is {shown(error)}; pass one of them: the states that are left, or the "
            "largest H-infinity norm of the difference"
        )
    if error is not None:
        error = as_number("error", error, "the absolute H-infinity error that is allowed, positive", above=0)
    weights = as_weight_of("input_weight", before, G, G.nu), as_weight_of("output_weight", after, G, G.ny)
    if method == COPRIME:
        if weights != (None, None):
            raise ModelError(f'method is "coprime", which takes no weights; pass one of {METHODS[:2]} with them')
        return _coprime(G, order, error)
    problem = _weighted(parts(G), *weights)
    fixed, sigma = problem.parts.kept.n, problem.balancing.sigma
    tails = bounds(sigma)
    if order is not None:
        order = as_whole("order", order, f"a number of states from {fixed} to the {G.n} of G", least=0, most=G.n)
        if order < fixed:
            raise ModelError(
                f'order is {order}, but {fixed} modes are not stable and stay with method "{method}" (one is at '
                f'{shown_pole(problem.parts.kept.poles()[0])}); pass order={fixed} or more, or method="coprime"'
            )
    for k in _orders(sigma, None if order is None else order - fixed, error):
        found = problem.reduced(k, method)
        stays = _is_stable(found, fixed)
        measured = problem.error(found) if stays else np.inf
        if order is not None and not stays:
            raise NumericalError(
                f"order is {order}: what is left is not stable, though the stable part of G is; values {k} and "
                f"{k + 1} of it are too near each other, or two-sided weights forbid the cut: pass another order"
            )
        if stays and (error is None or measured <= error):
            bound = None if weights != (None, None) else float(tails[k])
            values = all_values(problem.parts.kept, problem.parts.stable, sigma)
            return Reduction(_named(found, G), method, values, float(measured), bound)
    raise NumericalError(f"error is {error:g}, which rounding does not allow to be told; pass a larger one")


def _orders(sigma: np.ndarray, k: int | None, error: float | None) -> Iterator[int]:
    """Numbers of balanced states to try: as many as were asked for, or from what the largest value left out allows."""
    most = meaningful(sigma)
    if k is not None or error is None:
        yield min(k or 0, most)
        return
    yield from range(int(np.sum(sigma[:most] > error)), most + 1)


def _is_stable(G: StateSpace, fixed: int) -> bool:
    """Whether the states behind the first, which stay, are stable by more than rounding."""
    H = StateSpace(G.A[fixed:, fixed:], G.B[fixed:], G.C[:, fixed:], G.D, G.dt)
    return is_stable(H) and not crosses(H.A, discrete=H.discrete)


def _named(found: StateSpace, G: StateSpace) -> StateSpace:
    return replace(found, u=G.u, y=G.y, units=G.units)


def as_weight_of(name: str, W: Any, G: StateSpace, size: int) -> StateSpace | None:
    """A stable weight in the timebase of a system, of one channel or of all; None where none is given."""
    if W is None:
        return None
    W = repeated(as_system(name, W, G.dt), size)
    W = retimed(W, common_timebase(G, W, ("G", name)))
    if (W.nu if name == "output_weight" else W.ny) != size:
        raise ModelError(f"{name} is {W.ny} x {W.nu}; pass one that fits the {size} signals of G, or of one signal")
    if not is_stable(W):
        worst = shown_pole(max(W.poles(), key=abs))
        raise ModelError(f"{name} has the pole {worst} and is not stable; pass a stable one of the same gain")
    return W


def _weighted(found: Parts, before: StateSpace | None, after: StateSpace | None) -> Problem:
    """The stable part balanced behind and before its weights."""
    G, reached, seen = found.stable, None, None
    if before is not None:  # states of the weight come first in G W, those of G in V G
        reached = gramian_factors(G * before)[0][before.n :]
    if after is not None:
        seen = gramian_factors(after * G)[1][: G.n]
    return Problem(found, balancing(G, reached, seen), before, after)


def coprime_balancing(G: StateSpace) -> Balancing:
    """Coordinates in which the Riccati solutions of the normalised coprime factors are diagonal and equal.

    Its singular values s are those of LQG balancing; the Hankel singular values of the factors are s/(1 + s^2)^1/2.

    Raises
    ------
    AssumptionError, NumericalError : a mode cannot be stabilised; a Riccati equation was not solved.
    """
    check_assumptions(gang_of_four(G))
    s = solutions(G)
    return Balancing.of(_root(s.Z), _root(s.X))


def _root(M: np.ndarray) -> np.ndarray:
    """L with L L' = M, for a positive semidefinite M."""
    e, V = np.linalg.eigh(M)
    return V * np.sqrt(np.maximum(e, 0.0))


def _coprime(G: StateSpace, order: int | None, error: float | None) -> Reduction:
    """Truncated normalised coprime factors; the error is the gap, the bound one on it."""
    if order is not None:
        order = as_whole("order", order, f"a number of states from 0 to the {G.n} of G", least=0, most=G.n)
    H = in_principal_axes(G)
    b = coprime_balancing(H)
    sigma = b.sigma / np.sqrt(1 + b.sigma**2)
    tails = np.minimum(bounds(sigma), 1.0)
    for k in _orders(sigma, order, error):
        found = _named(cut(H, b, k, TRUNCATE), G)
        try:
            measured = gapmetric(G, found).gap
        except AssumptionError:  # the cut lost a mode that must be moved
            measured = 1.0
        if error is None or measured <= error:
            return Reduction(found, COPRIME, np.pad(sigma, (0, G.n - len(sigma))), measured, float(tails[k]))
    raise NumericalError(f"error is {error:g}, below what double precision can tell of a gap; pass a larger one")
