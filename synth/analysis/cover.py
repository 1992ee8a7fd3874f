"""`ucover`: one nominal model and unmodelled dynamics below a weight, for a set of models.

    input multiplicative     G = G0 (I + w Delta)     w Delta = G0^-1 (G - G0)
    output multiplicative    G = (I + w Delta) G0     w Delta = (G - G0) G0^-1
    additive                 G = G0 + w Delta         w Delta = G - G0

The weight w, stable with stable zeros, is fitted over the largest |w Delta| and raised by the H-infinity norm of Delta,
confirmed by two methods: the models are covered at all frequencies, not at those of a grid (`differences`). How far the
responses are off the systems so judged, through rounding, is looked at on a grid, and is part of the norm.

An unstable Delta matters to loops only if G has another number of unstable poles than G0: else det(I + L) winds as it
does without Delta wherever ||w Delta T|| < 1, so that every bound that holds frequency by frequency holds for G
(Nyquist). Discrete systems go through the Cayley map.

References: Doyle and Stein (1981), IEEE TAC 26, 4; Vinnicombe (2001), Uncertainty and Feedback, section 1.5 (poles);
Skogestad and Postlethwaite (2005), section 7.4. The name is that of MATLAB's `ucover`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from synth.analysis.coprime import gang_of_four
from synth.analysis.differences import (
    ADDITIVE,
    FLOOR,
    INPUT,
    KINDS,
    OUTPUT,
    Difference,
    check_poles,
    difference,
    frequencies,
    prepared,
)
from synth.analysis.gap import members, nugap
from synth.analysis.norms import verify
from synth.analysis.precondition import check_assumptions
from synth.checks import as_choice, as_whole, numerical
from synth.errors import AssumptionError, VerificationError
from synth.systems.magnitudes import fitted
from synth.systems.sampled import cayley
from synth.systems.statespace import StateSpace, repeated
from synth.systems.uncertain import UncertainSystem
from synth.systems.unmodelled import Dynamics, ultidyn
from synth.threads import one_thread

PRICES = 4.0, 32.0  # of being below the errors, beside being above them: of fits of which the better is kept
ABOVE = 1e-6  # relative, by which the weight is raised beyond what was measured


class Covered(NamedTuple):
    """A nominal model, the weight of the dynamics around it, and how they cover a set of models."""

    nominal: StateSpace
    weight: StateSpace  # of one signal; stable, with stable zeros
    kind: str
    norms: np.ndarray  # (k,) verified norm of Delta of every model, at most 1, all frequencies
    stable: np.ndarray  # (k,) whether Delta is stable; else it has the gain, and the model the unstable poles for loops

    def dynamics(self, name: str = "Delta") -> Dynamics:
        """The weighted block, for `worst_gain(..., dynamics=...)` of a loop with `plant`."""
        G = self.nominal
        shape = {INPUT: (G.nu, G.nu), OUTPUT: (G.ny, G.ny), ADDITIVE: (G.ny, G.nu)}[self.kind]
        return ultidyn(name, shape, weight=self.weight)

    @property
    def plant(self) -> UncertainSystem:
        """The nominal model with the ends of the dynamics: their outputs are its first inputs, and the reverse.

        It has no parameters yet; what it is joined with by `series`, `feedback` or `lft` may have some.
        """
        G = self.nominal
        p, m, n = G.ny, G.nu, G.n
        I, O = np.eye, np.zeros
        if self.kind == OUTPUT:
            B, C = np.hstack([O((n, p)), G.B]), np.vstack([G.C, G.C])
            D = np.block([[O((p, p)), G.D], [I(p), G.D]])
        else:
            before = self.kind == INPUT  # the dynamics come before the plant
            B, C = np.hstack([G.B if before else O((n, p)), G.B]), np.vstack([O((m, n)), G.C])
            D = np.block([[O((m, m if before else p)), I(m)], [G.D if before else I(p), G.D]])
        return UncertainSystem(None, G.A, B, C, D, G.dt)


@one_thread
@numerical
def ucover(models: Any, nominal: Any, order: int, kind: str = INPUT) -> Covered:
    """A nominal model and a weight for unmodelled dynamics around it that cover a set of models.

    Parameters
    ----------
    models : list of (p x m) plants, each in any form that `system` takes, or an UncertainSystem, of which the nominal
        model, vertices and samples are taken: not the whole box
    nominal : the model in the middle, (p x m), in any such form, square and invertible for multiplicative kinds; None
        for the model that `nugap` chooses
    order : of the weight
    kind : "input multiplicative" G0 (I + w Delta), "output multiplicative" (I + w Delta) G0, "additive" G0 + w Delta

    Returns
    -------
    Covered : unpacks as nominal, weight, kind, norms, stable; `dynamics()` and `plant` are for loops

    Raises
    ------
    ModelError : no models, sizes or timebases that differ, another kind, no order.
    AssumptionError : no weight covers a model, which is named: it has not as many unstable poles as the nominal one, a
        pole on the stability boundary that the nominal one does not share, or falls off more slowly; the nominal model
        of a multiplicative kind has no inverse; or a model has an unstable mode that is not reached or not seen.
    NumericalError : rounding hides what models and nominal share.
    VerificationError : the norms of a cover could not be confirmed.

    References: Skogestad and Postlethwaite (2005), section 7.4; the name is that of MATLAB's `ucover`.

    Examples
    --------
    >>> from synth import UncertainSystem, system, ucover, ureal, worst_gain
    >>> models = [system([k], [tau, 1, 0]) for k in (0.8, 1.2) for tau in (0.1, 0.3)]
    >>> found = ucover(models, system([1], [0.2, 1, 0]), order=1)
    >>> k = ureal("k", 1.0, percentage=20)  # of a controller u = -20 k / (s + 20) y
    >>> loop = found.plant.lft(UncertainSystem(A=[[-20]], B=[20 * k], C=[-1]))
    >>> bool(worst_gain(loop, dynamics=found.dynamics()).upper < 1)  # stable with all models and every k
    True
    """
    order = as_whole("order", order, "the order of the weight", least=0, most=20)
    kind = as_choice("kind", kind, KINDS)
    *plants, middle = members(models, nugap(models).nominal if nominal is None else nominal)
    there = [prepared(G) for G in (*plants, middle)]
    check_poles(there)
    for name, G in zip([*(f"models[{i}]" for i in range(len(plants))), "nominal"], there, strict=True):
        try:
            check_assumptions(gang_of_four(G))
        except AssumptionError as error:
            raise AssumptionError(error.assumption, f"{name}: {error}", error.modes) from None
    errors = [difference(G, there[-1], kind, i, middle.dt) for i, G in enumerate(there[:-1])]
    W = _above([E.system for E in errors], order)
    norms = np.array([_norm(E, W) for E in errors])
    highest = float(norms.max()) * (1 + ABOVE)
    if highest > 0:
        W = StateSpace(W.A, W.B, W.C * highest, W.D * highest, 0.0)
        norms = norms / highest
    stable = np.array([E.stable for E in errors])
    return Covered(middle, cayley(W, 1.0, middle.dt) if middle.discrete else W, kind, norms, stable)


def _norm(E: Difference, W: StateSpace) -> float:
    """H-infinity norm of E / W, confirmed from above, and what rounding was found to hide of it.

    Raises
    ------
    VerificationError : it could not be confirmed, or a frequency was met at which E / W is above it.
    """
    ratio = E.system * repeated(W.inverse(), E.system.nu)
    level = verify(ratio).norm
    met = float(np.linalg.norm(ratio.frequency_response(E.omega), 2, axis=(1, 2)).max())
    if met > level * (1 + ABOVE):
        raise VerificationError(
            f"the norm of an error over the weight was confirmed as {level:.6g}, and {met:.6g} was met: the models are "
            "too ill-conditioned to be judged; pass a lower order, or models of fewer states"
        )
    return level + float(np.max(E.hidden / np.abs(W.frequency_response(E.omega)[:, 0, 0])))


def _above(errors: list[StateSpace], order: int) -> StateSpace:
    """The system that is least above the largest of the errors, in the mean of logarithms, once raised to cover it."""
    omega = frequencies(errors)
    largest = np.max([np.linalg.norm(E.frequency_response(omega), 2, axis=(1, 2)) for E in errors], axis=0)
    if not largest.max() > 0:
        return StateSpace.gain([[1.0]], 0.0)
    unit, top = float(np.exp(np.log(omega).mean())), float(largest.max())  # in which the fit does not see the user's
    omega, largest = omega / unit, np.maximum(largest / top, FLOOR)
    best = np.inf, StateSpace.gain([[1.0]], 0.0)
    for price in PRICES:
        W = fitted(omega, largest, np.ones_like(omega), order, price)
        off = np.log(np.abs(W.frequency_response(omega)[:, 0, 0]) / largest)
        if off.mean() - off.min() < best[0]:
            best = float(off.mean() - off.min()), W
    A, B, C, D = best[1].matrices
    return StateSpace(A * unit, B * unit, C * top, D * top, 0.0)
