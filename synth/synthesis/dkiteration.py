"""`musyn`: controllers for a small structured singular value, by D-K iteration.

    K step    hinfsyn of the plant with D on its z and D^-1 on its w
    D step    scalings of the new loop N by frequency (`mucover`: they show the bound of mu(N) between frequencies too),
              and stable systems without unstable zeros whose magnitude is near theirs (`magnitudes`)
    both      from there the lowest level of the K step, as a function of poles, zeros and gains of D, is lowered
              (`scaledplants`): neither of the two steps alone can see that the other has more to give

It ends at a local optimum. Every controller on the way was verified, every bound of mu holds between frequencies, and
the best is kept.

References: Doyle (1985), CDC; Balas, Doyle, Glover, Packard and Smith (1993), mu-Analysis and Synthesis Toolbox.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from synth.analysis.blocks import Structure, as_structure
from synth.analysis.mu import Mu, of_system
from synth.analysis.mucover import Cover, cover, response
from synth.analysis.norms import judge
from synth.analysis.scalings import Cone
from synth.checks import as_number, as_whole, numerical
from synth.errors import AssumptionError, InfeasibleError, NumericalError, VerificationError
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import as_plant, finished, hinfsyn, make_route
from synth.synthesis.scaledplants import ScaledPlants, Scales, split
from synth.synthesis.search import Search
from synth.systems.generalized import GeneralizedPlant
from synth.systems.magnitudes import coordinates, order_of, raised
from synth.systems.sampled import inverse_cayley
from synth.systems.statespace import StateSpace
from synth.threads import one_thread

ABOVE = 3e-3  # relative: the level whose analytic centres are the scalings that are fitted
LIGHT = 0.02  # part of the largest stiffness below which a scaling may be anything
CALLS = 30  # of the level in the descent of a round
PLACES = 8  # frequencies at which another pole and zero are tried
FIRST, FINER = 4e-3, 3.0  # how well rounds are solved and fitted at first, and the factor by which where they stall
FAILURES = (AssumptionError, InfeasibleError, NumericalError, VerificationError)  # of a round
TOLERANCE, ORDER, ITERATIONS = 3e-3, 5, 15


class Iterate(NamedTuple):
    """One round of the iteration."""

    level: float  # verified norm of the scaled plant with its controller: an upper bound of mu too
    mu: float  # upper bound of mu of the loop, all blocks complex, verified between frequencies
    order: int  # of the controller
    scalings: tuple[int, ...]  # orders of the scalings it was designed with, one for every block but the last


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MuDesign(Design):
    """A `Design` by D-K iteration, with the bounds of mu of its loop; `gamma` is its norm without scalings."""

    mu: Mu  # of the closed loop, for the blocks that were given
    mu_complex: Mu  # likewise with real blocks taken for complex ones, which is what was made small
    history: tuple[Iterate, ...]  # of all rounds

    @property
    def facts(self) -> dict[str, str]:
        """As of a `Design`, with the bounds of mu."""
        bounds = {"mu": f"{self.mu.lower:.5g} to {self.mu.upper:.5g}, verified between frequencies"}
        if self.mu is not self.mu_complex:
            bounds |= {"mu, all blocks complex": f"{self.mu_complex.lower:.5g} to {self.mu_complex.upper:.5g}"}
        rounds = ", ".join(f"{one.mu:.4g}" for one in self.history)
        return super().facts | bounds | {"mu of the rounds": rounds}

    def __repr__(self) -> str:
        text = f"       mu {self.mu.lower:.5g} to {self.mu.upper:.5g}, {len(self.history)} rounds of D-K iteration)"
        return "Mu" + super().__repr__().removesuffix(")") + "\n" + text


@one_thread
@numerical
def musyn(
    P: Any,
    nmeas: int | None = None,
    ncon: int | None = None,
    blocks: Any = None,
    *,
    iterations: int = ITERATIONS,
    order: int = ORDER,
    tol: float = TOLERANCE,
) -> MuDesign:
    """Controller K that makes the structured singular value of P closed by u = K y small.

    Parameters
    ----------
    P : GeneralizedPlant, or a system whose last inputs are u and last outputs y, continuous or discrete
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant
    blocks : structure between z and w as of `mussv`, with a full block for performance: Delta takes z to w, so the rows
        of the blocks are w. Real and repeated blocks are designed for as complex numbers, each on its own
    iterations : rounds at most; it ends earlier where nothing is gained
    order : highest order of a scaling, each of which the controller has as often as a block has rows and columns
    tol : relative, how well the last rounds are solved and fitted, and what counts as a gain

    Returns
    -------
    MuDesign : a `Design`, the best of all rounds, with `mu` and `history`

    Raises
    ------
    ModelError : blocks that mean nothing or do not fit, options that are none; and what `hinfsyn` raises, in the first
        round. Later ones that fail end the iteration, `info.status` says why.

    References: Doyle (1985), CDC; Skogestad and Postlethwaite (2005), section 8.12; docs/mu.md.
    """
    started = time.perf_counter()
    for name, count in (("nmeas", nmeas), ("ncon", ncon)):
        if count is not None:
            as_whole(name, count, "the number of signals, at least 1", least=1)
    plant = as_plant(P, nmeas, ncon)
    structure = as_structure("blocks", blocks, plant.D11.shape[0], plant.D11.shape[1], "P without u and y")
    iterations = as_whole("iterations", iterations, "how many rounds, at least 1", least=1, most=1000)
    order = as_whole("order", order, "the highest order of a scaling", least=0, most=20)
    tol = as_number("tol", tol, "a relative distance from the optimum, 1e-3 for example", above=0)
    problem = ScaledPlants.of(plant, structure.loosened)
    scales = [np.zeros(1)] * (len(problem.blocks.blocks) - 1)
    history: list[Iterate] = []
    best = last = None
    fine, ended, way = max(FIRST, tol), "", None
    rounds = iterations if scales else 1  # of one block no scaling matters
    while len(history) < rounds and fine >= tol:
        try:
            if last is not None:
                way = way if way and way.open else _Way.of(problem, last, way, order, fine)
                scales = way.on(fine)
            last = _round(problem, scales, fine)
        except FAILURES as error:
            if best is None:
                raise
            ended = f"round {len(history) + 1}: {error}"
            fine /= FINER
            continue
        history.append(Iterate(last.step.gamma, last.mu, last.step.controller.n, tuple(map(order_of, scales))))
        gained = best is None or last.mu < best.mu * (1 - fine / FINER)
        best = last if best is None or last.mu < best.mu else best
        if not gained:
            fine /= FINER
    assert best is not None
    return _finished(plant, structure, best, history, ended, time.perf_counter() - started)


class _Round(NamedTuple):
    """A K step and what was seen of its loop."""

    step: Design  # of the scaled plant
    scales: Scales  # it was designed with
    loop: StateSpace  # the plant and its controller
    found: Cover  # its scalings over frequency, of a discrete loop by the Cayley map of rate 1
    mu: float  # upper bound, all blocks complex and each on its own


def _round(problem: ScaledPlants, scales: Scales, fine: float) -> _Round:
    """A controller a little above the best level, where it is less extreme, for the next scalings depend on it."""
    scaled = problem.scaled(scales)
    try:
        step = _central(scaled, problem.rate, fine)
    except FAILURES:  # the LMIs are asked in the first round only: with dynamic scalings they are slow
        step = hinfsyn(scaled, tol=fine, method="riccati" if np.any(np.concatenate([*scales, [0.0]])) else "auto")
    loop = problem.plant.close(step.controller)
    found = cover(inverse_cayley(loop, 1.0) if loop.discrete else loop, problem.blocks, ABOVE)
    return _Round(step, scales, loop, found, min(found.upper, step.gamma))


def _central(plant: GeneralizedPlant, rate: float | None, fine: float) -> Design:
    """The central controller a little above the lowest level, by the Riccati equations at one rate.

    Raises
    ------
    NumericalError : there is none, or it does not keep its level.
    """
    started = time.perf_counter()
    search = Search(plant, fine, make_route)
    route, _ = search.route("riccati", rate)
    optimum, status = route.minimise()
    found = search.controllers("riccati", "riccati", route, rate, optimum * (1 + fine), status)
    if found is None or found.measured.norm > found.level * (1 + fine):
        raise NumericalError("the central controller does not keep its level", search.failures)
    return finished(search, found, started)


class _Way:
    """A descent of the level over scalings of given orders."""

    def __init__(self, problem: ScaledPlants, scales: Scales, omega: np.ndarray):
        self.scales, self.descent, self.open = scales, problem.descent(scales, omega), True

    @classmethod
    def of(cls, problem: ScaledPlants, last: _Round, before: _Way | None, order: int, fine: float) -> _Way:
        """A new one: from near the scalings of the last loop, or from where the one before ended, of a higher order.

        Of those near the scalings of the loop the lowest order is taken whose level is near the best of all orders.
        """
        wanted = _wanted(last.loop, last.found, problem.blocks)
        some = list(near(*wanted, order))
        levels = np.array([problem.lowest(scales) for scales in some])
        if before is None or np.log(levels.min()) < before.descent.value - fine:
            return cls(problem, some[int(np.argmax(levels <= levels.min() * (1 + fine)))], wanted[0])
        ended = split(before.descent.x, before.scales)
        if order_of(ended[0]) < order:
            return cls(problem, _raised(problem, ended, wanted[0]), wanted[0])
        return before

    def on(self, fine: float) -> Scales:
        """Some steps down; the way stays open while they gain something."""
        self.open = self.descent.run(CALLS, fine / FINER)
        return split(self.descent.x, self.scales)


def _raised(problem: ScaledPlants, scales: Scales, omega: np.ndarray) -> Scales:
    """The scalings with one pole and one zero more each, which cancel where the level minds most that they do."""
    found = []
    for x in np.linspace(np.log(omega[0]), np.log(omega[-1]), PLACES):
        more = [raised(y, x) for y in scales]
        found.append((more, [np.abs(g[-2:]).max() for g in problem.slope(more)]))
    best = np.argmax([slopes for _, slopes in found], axis=0)
    return [found[k][0][i] for i, k in enumerate(best)]


def _wanted(loop: StateSpace, found: Cover, blocks: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (k,) at which a loop minds its scalings, those (k, s) relative to the last, and how much (k, s)."""
    omega = np.array(sorted(w for w in found.centres if 0 < w < np.inf))
    at = response(inverse_cayley(loop, 1.0) if loop.discrete else loop)
    first = [block.columns.start for block in blocks.blocks]
    d = np.array([np.sqrt(np.real(found.centres[w][0].diagonal()[first])) for w in omega])
    cone, free = Cone(blocks), np.sqrt([block.size[0] for block in blocks.blocks])
    weights = np.array([cone.stiffness(at(w), found.upper, found.centres[w]) for w in omega]) / free - 1
    most = weights.max(axis=0)
    weights = np.where(most > 0, np.maximum(weights / np.where(most > 0, most, 1.0), LIGHT), 1.0)
    kept = (weights > LIGHT)[:, :-1].any(axis=1)
    return omega[kept], (d / d[:, -1:])[kept, :-1], weights[kept, :-1]


def near(omega: np.ndarray, magnitudes: np.ndarray, weights: np.ndarray, order: int) -> Iterator[Scales]:
    """Scalings of every order up to the highest, near magnitudes at frequencies, both (k, s)."""
    for k in range(order + 1):
        yield [coordinates(omega, *of, k) for of in zip(magnitudes.T, weights.T, strict=True)]


def _finished(
    plant: GeneralizedPlant, blocks: Structure, best: _Round, history: list[Iterate], ended: str, seconds: float
) -> MuDesign:  # fmt: skip
    """The design of the best round, with the bounds of its loop."""
    step, loop = best.step, best.loop
    closed_loop, measured = judge(plant, step.controller)
    mu_complex = of_system(loop, blocks.complexified)
    info = replace(
        step.info,
        method="D-K",
        status=ended or f"{len(history)} rounds",
        level=min(one.level for one in history),
        optimum=None,
        spectral_radius=measured.spectral_radius,
        frequency=measured.frequency,
        seconds=seconds,
    )
    return MuDesign(
        plant, step.controller, closed_loop, measured.norm, info,
        mu=mu_complex if blocks.is_complex else of_system(loop, blocks), mu_complex=mu_complex, history=tuple(history),
    )  # fmt: skip
