"""A plant with scalings D on its z and D^-1 on its w: the lowest level of the K step, and scalings that lower it.

The lowest level is a function of the coordinates of the scalings (`magnitudes`), and where the coupling of the Riccati
equations decides it, its slope costs little more than itself (`hinf_slope`). So scalings of a given order are improved
with the controller that goes with them, not one after the other: where alternating steps stop, this descent goes on.
The level is not convex in the scalings and has kinks, where two directions decide it.

References: Lin, Postlethwaite and Gu (1993), Automatica 29, 219 (mu-K iteration, for the same reason).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from synth.analysis.blocks import Structure
from synth.analysis.precondition import conditioned
from synth.equations.hinf_riccati import REGULARISATIONS, RiccatiRoute, regularised, search
from synth.equations.hinf_slope import slope
from synth.errors import SynthError
from synth.synthesis.descent import Descent
from synth.synthesis.search import RATES
from synth.systems.generalized import GeneralizedPlant
from synth.systems.magnitudes import box, matrices, order_of
from synth.systems.realization import Matrices
from synth.systems.sampled import design_rate, discretised, inverse_cayley
from synth.systems.statespace import StateSpace

Scales = list[np.ndarray]  # coordinates of a scaling for every block but the last, which has none
FAILS = (SynthError, np.linalg.LinAlgError)
EXACT = 1e-6  # relative, of a level
STEP = 1e-6  # of a coordinate, for the change of the plant
SPRING = 0.01  # of a logarithm of the level, against poles and zeros a factor e out of their range


@dataclass(frozen=True, eq=False)
class ScaledPlants:
    """One plant with all scalings that it may have."""

    plant: GeneralizedPlant
    blocks: Structure  # full ones only
    rate: float | None  # rad/s, of the map to discrete time with which the equations are solved, as of `discretised`
    epsilon: float  # their regularisation
    inner: GeneralizedPlant  # in that discrete time

    @classmethod
    def of(cls, plant: GeneralizedPlant, blocks: Structure) -> ScaledPlants:
        """With the rate and the regularisation that serve the plant without scalings best.

        Raises
        ------
        NumericalError : the equations have no solution at any level.
        """
        found, failure = [], None
        for rate in _rates(plant):
            try:
                inner, _ = discretised(plant, rate)
                c = conditioned(inner)
                route = RiccatiRoute.of(c.plant)
                for epsilon in (0.0, *REGULARISATIONS):
                    level = search(regularised(c.plant, epsilon), route.X, route.Y).high.gamma
                    own = cls(plant, blocks, rate, epsilon, inner)
                    if not epsilon and route.certain(level):
                        return own
                    found.append((level * c.scale, len(found), own))
            except FAILS as error:
                failure = error
        if not found:
            assert failure is not None
            raise failure
        return min(found)[-1]

    def scaled(self, scales: Scales) -> GeneralizedPlant:
        """The plant with D on its z and D^-1 on its w; a discrete one with D by the Cayley map of rate 1."""
        dt, D = self.plant.dt, [matrices(y) for y in scales]
        return self._parted(self._between(self.plant.system.matrices, [mapped(G, 1.0) for G in D] if dt else D), dt)

    def lowest(self, scales: Scales) -> float:
        """The lowest level of the scaled plant, inf where none was found; a claim, as of a `RiccatiRoute`."""
        return self._lowest(scales)[0]

    def descent(self, scales: Scales, omega: np.ndarray) -> Descent:
        """The descent of the logarithm of the lowest level, from scalings with the coordinates of all in one row.

        Poles and zeros far from the frequencies (k,) rad/s at which the scalings matter are drawn back: there the level
        hardly minds them, but the loop without scalings does.
        """
        level, (least, most) = (
            None,
            (np.concatenate(x) for x in zip(*(box(order_of(y), omega) for y in scales), strict=True)),
        )

        def function(x: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal level
            found, slope = self._sloped(split(x, scales), level)
            level = found if np.isfinite(found) else level
            beyond = x - np.clip(x, least, most)
            return float(np.log(found) + SPRING / 2 * beyond @ beyond), slope + SPRING * beyond

        return Descent(function, np.concatenate(scales))

    def slope(self, scales: Scales) -> Scales:
        """The derivatives of the logarithm of the lowest level by all coordinates."""
        return split(self._sloped(scales, None)[1], scales)

    def _lowest(
        self, scales: Scales, near: float | None = None, *, sloped: bool = False
    ) -> tuple[float, np.ndarray | None]:
        """The lowest level, and where known the derivative of its logarithm by the matrices of the inner plant."""
        try:
            c = conditioned(self._parted(self._inner(scales), self.inner.dt))
            route = RiccatiRoute.of(c.plant)
            P = regularised(c.plant, self.epsilon)
            found = search(P, route.X, route.Y, EXACT, near / c.scale if near else None).high
        except FAILS:
            return np.inf, None
        by = slope(P, found) if sloped else None
        if by is not None and self.epsilon:
            n, nw, nu, nz, ny = c.plant.sizes
            by = by[np.r_[: n + nz, len(by) - ny : len(by)]][:, np.r_[: n + nw, by.shape[1] - nu : by.shape[1]]]
        return found.gamma * c.scale, None if by is None else c.slope(by)

    def _sloped(self, scales: Scales, near: float | None) -> tuple[float, np.ndarray]:
        """The lowest level, and the derivative of its logarithm by all coordinates, zero where it is not known."""
        level, by = self._lowest(scales, near, sloped=True)
        if by is None:
            return level, np.zeros(sum(map(len, scales)))
        here = _stacked(self._inner(scales))
        return level, np.array([np.sum(by * (_stacked(self._inner(x)) - here)) for x in _moved(scales, STEP)]) / STEP

    def _inner(self, scales: Scales) -> Matrices:
        """The scaled plant in the discrete time of the equations."""
        rate, dt = self.rate or 1.0, self.plant.dt
        rate = rate * dt / 2 if dt and self.rate else rate
        return self._between(self._bare, [mapped(matrices(y), rate) for y in scales])

    def _between(self, G: Matrices, scales: list[Matrices]) -> Matrices:
        _, _, nu, _, ny = self.plant.sizes
        return between(G, self.blocks, scales, ny, nu)

    @cached_property
    def _bare(self) -> Matrices:
        return self.inner.system.matrices

    def _parted(self, G: Matrices, dt: float) -> GeneralizedPlant:
        _, _, nu, _, ny = self.plant.sizes
        return GeneralizedPlant.partition(StateSpace(*G, dt), ny, nu)


def split(x: np.ndarray, scales: Scales) -> Scales:
    """One row of coordinates as those of every scaling, of the orders of others."""
    return np.split(x, np.cumsum([len(y) for y in scales])[:-1])


def _moved(scales: Scales, step: float) -> Iterator[Scales]:
    """The scalings with every coordinate moved in turn."""
    x = np.concatenate(scales)
    return (split(x + step * e, scales) for e in np.eye(len(x)))


def _stacked(G: Matrices) -> np.ndarray:
    """[A B; C D]."""
    return np.block([[G.A, G.B], [G.C, G.D]])


def _rates(plant: GeneralizedPlant) -> Iterator[float | None]:
    """Rates in rad/s to be tried; None is the natural one of a discrete plant."""
    G, (_, _, nu, _, ny) = plant.system, plant.sizes
    if plant.dt:
        yield None
        try:
            plant = GeneralizedPlant.partition(inverse_cayley(G, 2 / G.dt), ny, nu)
        except SynthError:  # a pole at -1
            return
    natural = design_rate(plant)
    yield from (natural * factor for factor in (1.0, *RATES))


def between(G: Matrices, blocks: Structure, scales: list[Matrices], ny: int, nu: int) -> Matrices:
    """D G D^-1; the last `ny` outputs and `nu` inputs are left as they are."""
    sides = list(zip(blocks.blocks, [*scales, _gain(1)], strict=True))
    Al, Bl, Cl, Dl = _beside([*(_repeated(D, block.size[1]) for block, D in sides), _gain(ny)])
    Ar, Br, Cr, Dr = _beside([*(_repeated(_inverse(D), block.size[0]) for block, D in sides), _gain(nu)])
    (A, B, C, D), r, n, k = G, len(Ar), len(G.A), len(Al)
    O = np.zeros
    return Matrices(
        np.block([[Ar, O((r, n)), O((r, k))], [B @ Cr, A, O((n, k))], [Bl @ D @ Cr, Bl @ C, Al]]),
        np.vstack([Br, B @ Dr, Bl @ D @ Dr]),
        np.hstack([Dl @ D @ Cr, Dl @ C, Cl]),
        Dl @ D @ Dr,
    )


def _gain(size: int) -> Matrices:
    """So many signals as they are."""
    return Matrices(np.zeros((0, 0)), np.zeros((0, size)), np.zeros((size, 0)), np.eye(size))


def _inverse(G: Matrices) -> Matrices:
    """Of a system of one signal."""
    d = G.D[0, 0]
    return Matrices(G.A - G.B @ G.C / d, G.B / d, -G.C / d, 1 / G.D)


def _repeated(G: Matrices, size: int) -> Matrices:
    """For every one of several signals."""
    return _beside([G] * size)


def mapped(G: Matrices, rate: float) -> Matrices:
    """`cayley` of a scaling, whose poles are none of the rate."""
    E = np.linalg.inv(rate * np.eye(len(G.A)) - G.A)
    root = np.sqrt(2 * rate)
    return Matrices(E @ (rate * np.eye(len(G.A)) + G.A), root * E @ G.B, root * G.C @ E, G.D + G.C @ E @ G.B)


def _beside(systems: list[Matrices]) -> Matrices:
    """Systems that know nothing of each other, as one."""
    n, p, m = (sum(sizes) for sizes in zip(*((len(G.A), *G.D.shape) for G in systems), strict=True))
    A, B, C, D = np.zeros((n, n)), np.zeros((n, m)), np.zeros((p, n)), np.zeros((p, m))
    i = j = k = 0
    for G in systems:
        x, y, u = slice(i, i + len(G.A)), slice(j, j + len(G.D)), slice(k, k + G.D.shape[1])
        A[x, x], B[x, u], C[y, x], D[y, u] = G
        i, j, k = x.stop, y.stop, u.stop
    return Matrices(A, B, C, D)
