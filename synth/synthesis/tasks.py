"""What `synthesize` was asked for, checked, and what is told of the result."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.analysis.norms import Verification
from synth.checks import shown
from synth.errors import ModelError
from synth.synthesis.specifications import Bound, Disc, Norm, StrictlyProper
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

DIRECT = "direct"  # descent, and LMIs where it finds nothing
FORMS = (DIRECT, "extended", "standard")


@dataclass(frozen=True)
class Told:
    """One specification of a result."""

    name: str
    level: float | None  # that was asked for; None for what was minimised
    claimed: float | None  # by the LMI, whose bound may be wider than `level`; no proof; None where none was needed
    measured: float
    alone: float | None  # the least value of any controller, without the other specifications, where it is known


@dataclass(frozen=True)
class Task:
    """What was asked for, checked."""

    plant: GeneralizedPlant
    minimize: Norm
    bounds: tuple[Bound, ...]
    disc: Disc | None
    proper: bool
    method: str

    @classmethod
    def of(cls, plant: GeneralizedPlant, minimize: Any, subject_to: Any, method: str) -> Task:
        """What `synthesize` was called with.

        Raises
        ------
        ModelError : it is no specification, or none for this plant.
        """
        if not isinstance(minimize, Norm) or type(minimize) is Norm:
            raise ModelError(f"minimize is {shown(minimize)}; pass Hinf(...), H2(...), GeneralisedH2(...) or Peak(...)")
        if not isinstance(subject_to, list | tuple) or not all(
            isinstance(item, Bound | Disc | StrictlyProper) for item in subject_to
        ):
            raise ModelError(
                f"subject_to is {shown(subject_to)}; pass a list of bounds such as H2(...) <= 2, Disc(centre, radius), "
                "StrictlyProper()"
            )
        bounds = tuple(item for item in subject_to if isinstance(item, Bound))
        discs = [item for item in subject_to if isinstance(item, Disc)]
        if len(discs) > 1:
            raise ModelError(f"subject_to has {len(discs)} discs; pass one that lies in all of them")
        proper = any(isinstance(item, StrictlyProper) for item in subject_to)
        if not len(plant.A):
            raise ModelError("P has no states; hinfsyn and h2syn know the best gain")
        for norm in (minimize, *(bound.norm for bound in bounds)):
            norm.numbers(plant)
            if method != DIRECT and not norm.by_lmi:
                raise ModelError(f"{name_of(norm, plant)} has no LMI; leave method = {method!r} away")
            if not plant.dt and not norm.anytime and (method != DIRECT or not norm.continuous):
                remedy = f'leave method = "{method}" away' if norm.continuous else "sample P by c2d"
                raise ModelError(
                    f"{name_of(norm, plant)} is a specification of discrete time here, and P is continuous: {remedy}"
                )
            if not plant.dt and norm.continuous and not norm.anytime and norm.channel(plant).D11.any():
                raise ModelError(
                    f"{name_of(norm, plant)} is infinite in continuous time for a plant with a direct term D11: "
                    "leave those z or w away, or let the disturbance pass a filter"
                )
        if proper and not plant.dt and method != DIRECT:
            raise ModelError(
                f"StrictlyProper() is of discrete time for LMIs, and P is continuous: leave method = {method!r} away"
            )
        return cls(plant, minimize, bounds, discs[0] if discs else None, proper, method)

    @property
    def by_lmis(self) -> bool:
        """Whether the LMIs know all that was asked for."""
        norms = (self.minimize, *(bound.norm for bound in self.bounds))
        return all(n.by_lmi and (self.plant.dt or n.anytime) for n in norms) and bool(self.plant.dt or not self.proper)

    def free(self, plant: GeneralizedPlant) -> np.ndarray:
        """(nu, ny), which entries of the controller's direct term no norm makes zero."""
        _, _, nu, _, ny = plant.sizes
        free = np.ones((nu, ny), bool) * (not self.proper)
        for norm in (self.minimize, *(bound.norm for bound in self.bounds)):
            if not plant.dt and not norm.anytime:  # infinite with a direct term
                z, w = norm.numbers(plant)
                free &= ~np.outer(plant.D12[z].any(axis=0), plant.D21[:, w].any(axis=1))
        return free

    def values(self, closed_loop: StateSpace) -> list[float]:
        """The measured value of every norm, the minimised one first."""
        return [norm.measured(self.plant, closed_loop) for norm in (self.minimize, *(b.norm for b in self.bounds))]


def name_of(norm: Norm, plant: GeneralizedPlant) -> str:
    """A norm as it was asked for."""
    z, w = norm.numbers(plant)
    parts = [("w", w, plant.w), ("z", z, plant.z)]
    listed = ", ".join(f"{key}={[names[i] for i in k]}" for key, k, names in parts if len(k) < len(names))
    return f"{type(norm).__name__}({listed})"


@dataclass(frozen=True)
class Found:
    """A controller that meets all specifications, measured."""

    controller: StateSpace
    closed_loop: StateSpace
    verified: Verification
    values: list[float]
    claimed: float | None  # of the minimised norm
    status: str
    part: float  # factor by which the bounds in its LMIs were wider
