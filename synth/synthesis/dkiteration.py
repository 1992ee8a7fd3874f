"""`musyn`: controllers for a small structured singular value, by D-K iteration.

    K step    hinfsyn of the plant with D on its z and D^-1 on its w
    D step    scalings of the new loop N by frequency (`mucover`: they show the bound of mu(N) between frequencies too),
              and stable systems without unstable zeros whose magnitude is near theirs (`magnitudes`)

Neither step can see that the other has more to give, so the iteration ends somewhere, not at the optimum. Every
controller on the way was verified by `hinfsyn`, every bound of mu holds between frequencies, and the best is kept.

References: Doyle (1985), CDC; Balas, Doyle, Glover, Packard and Smith (1993), mu-Analysis and Synthesis Toolbox.
"""

from __future__ import annotations

import time
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
from synth.synthesis.hinfinity import as_plant, hinfsyn
from synth.systems.connect import series
from synth.systems.generalized import GeneralizedPlant, beside
from synth.systems.magnitudes import fitted
from synth.systems.sampled import cayley, inverse_cayley
from synth.systems.statespace import StateSpace, repeated
from synth.threads import one_thread

ABOVE = 3e-3  # relative: the level whose analytic centres are the scalings that are fitted
LIGHT = 0.02  # part of the largest stiffness below which a scaling may be anything
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
    loosened = structure.loosened
    scalings = [StateSpace.gain([[1.0]], plant.dt)] * len(loosened.blocks)
    history: list[Iterate] = []
    best: _Round | None = None
    fine, ended = max(FIRST, tol), ""
    rounds = iterations if len(loosened.blocks) > 1 else 1  # of one block no scaling matters
    while len(history) < rounds and fine >= tol:
        if best is not None:
            scalings = fit(best.loop, best.found, loosened, order, fine)
        try:
            one = _round(plant, loosened, scalings, fine)
        except FAILURES as error:
            if best is None:
                raise
            ended = f"round {len(history) + 1}: {error}"
            fine /= FINER
            continue
        history.append(Iterate(one.step.gamma, one.mu, one.step.controller.n, tuple(D.n for D in scalings[:-1])))
        gained = best is None or one.mu < best.mu * (1 - fine / FINER)
        best = one if best is None or one.mu < best.mu else best
        if not gained:
            fine /= FINER
    assert best is not None
    return _finished(plant, structure, best, history, ended, time.perf_counter() - started)


class _Round(NamedTuple):
    """A K step and what was seen of its loop."""

    step: Design  # of the scaled plant
    loop: StateSpace  # the plant and its controller
    found: Cover  # its scalings over frequency, of a discrete loop by the Cayley map of rate 1
    mu: float  # upper bound, all blocks complex and each on its own


def _round(plant: GeneralizedPlant, blocks: Structure, scalings: list[StateSpace], fine: float) -> _Round:
    """A controller a little above the best level, where it is less extreme, for the next scalings depend on it."""
    step = hinfsyn(scaled(plant, blocks, scalings), tol=fine)
    optimum = min(step.info.optimum or step.gamma, step.gamma)
    try:
        step = hinfsyn(step.plant, gamma=optimum * (1 + fine), tol=fine)
    except FAILURES:  # then the first one it is
        pass
    loop = plant.close(step.controller)
    found = cover(inverse_cayley(loop, 1.0) if loop.discrete else loop, blocks, ABOVE)
    return _Round(step, loop, found, min(found.upper, step.gamma))


def scaled(plant: GeneralizedPlant, blocks: Structure, scalings: list[StateSpace]) -> GeneralizedPlant:
    """The plant with D on its z and D^-1 on its w, a system of one signal for every block."""
    _, _, nu, _, ny = plant.sizes
    bare = StateSpace(*plant.system.matrices, plant.dt)
    return GeneralizedPlant.partition(_between(bare, blocks, scalings, ny, nu), ny, nu)


def _between(G: StateSpace, blocks: Structure, scalings: list[StateSpace], ny: int = 0, nu: int = 0) -> StateSpace:
    """D G D^-1; the last `ny` outputs and `nu` inputs are left as they are."""
    sides = list(zip(blocks.blocks, scalings, strict=True))
    after = [repeated(D, block.size[1]) for block, D in sides]
    before = [repeated(D.inverse(), block.size[0]) for block, D in sides]
    after, before = (
        beside([*some, *([StateSpace.gain(np.eye(k), G.dt)] if k else [])]) for some, k in ((after, ny), (before, nu))
    )
    return series(series(before, G), after)


def fit(loop: StateSpace, found: Cover, blocks: Structure, order: int, fine: float) -> list[StateSpace]:
    """Systems near the scalings of a loop, of the lowest order with which its scaled norm is near their level."""
    omega = np.array(sorted(w for w in found.centres if 0 < w < np.inf))
    at = response(inverse_cayley(loop, 1.0) if loop.discrete else loop)
    first = [block.columns.start for block in blocks.blocks]
    d = np.array([np.sqrt(np.real(found.centres[w][0].diagonal()[first])) for w in omega])
    d = d / d[:, -1:]
    cone = Cone(blocks)
    weights = np.array([cone.stiffness(at(w), found.upper, found.centres[w]) for w in omega])
    best: tuple[float, list[StateSpace]] = np.inf, [StateSpace.gain([[1.0]], loop.dt)] * len(first)
    kept = (weights >= LIGHT * weights.max(axis=0))[:, :-1].any(axis=1)
    omega, d, weights = omega[kept], d[kept], weights[kept]
    for k in range(order + 1):
        sides = zip(d.T[:-1], weights.T[:-1], strict=True)
        scalings = [
            *(fitted(omega, magnitude, weight, k) for magnitude, weight in sides),
            StateSpace.gain([[1.0]], 0.0),
        ]
        values = np.abs([D.frequency_response(omega)[:, 0, 0] for D in scalings]).T
        norm = max(float(np.linalg.norm(blocks.scaled(at(w), x), 2)) for w, x in zip(omega, values, strict=True))
        if norm < best[0] * (1 - fine / FINER):
            best = norm, [cayley(D, 1.0, loop.dt) if loop.discrete else D for D in scalings]
        if norm < found.upper * (1 + fine):
            break
    return best[1]


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
