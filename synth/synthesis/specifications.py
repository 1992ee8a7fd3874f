"""What `synthesize` is asked for: norms of channels, regions of poles; each with its LMI, and how it is measured.

What is measured shares nothing with the LMI: norms come from Gramians and from the judge, poles from eigenvalues.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from synth.analysis import barriers
from synth.analysis.barriers import Sloped
from synth.analysis.norms import balance, h2norm, is_stable, verify
from synth.analysis.truncation import gramian_factors
from synth.checks import as_number, shown
from synth.errors import ModelError, SynthError
from synth.synthesis.h2 import h2syn
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

PROVED = 1e-8  # of a peak gain may be left to doubt
MET = 1e-6  # relative: a bound that is missed by less is met

# loop and level -> value, derivative by [A B; C D], and by the logarithm of the level
Barrier = Callable[[StateSpace, float], tuple[float, np.ndarray, float]]
Channel = str | int | Sequence[str | int] | None  # names or numbers of signals; None for all


@dataclass(frozen=True)
class Norm:
    """A norm of the closed loop from the disturbances `w` to the outputs `z`; `norm <= level` is a specification."""

    w: Channel = None
    z: Channel = None
    anytime: ClassVar[bool] = False  # whether the Cayley map keeps it, so that its LMI serves in continuous time too
    continuous: ClassVar[bool] = True  # whether it can be measured in continuous time
    by_lmi: ClassVar[bool] = True  # whether it has one

    def __le__(self, level: float) -> Bound:
        return Bound(self, as_number("level", level, f"the level of {type(self).__name__}, a positive number", above=0))

    def numbers(self, P: GeneralizedPlant) -> tuple[list[int], list[int]]:
        """The numbers of its z and w in the plant.

        Raises
        ------
        ModelError : the plant has no such signal.
        """
        return _numbers("z", self.z, P.z), _numbers("w", self.w, P.w)

    def channel(self, P: GeneralizedPlant) -> GeneralizedPlant:
        """The plant with no other z and w."""
        z, w = self.numbers(P)
        return replace(
            P, B1=P.B1[:, w], C1=P.C1[z], D11=P.D11[np.ix_(z, w)], D12=P.D12[z], D21=P.D21[:, w],
            w=tuple(P.w[i] for i in w), z=tuple(P.z[i] for i in z), units={}, continuous=None,
        )  # fmt: skip

    def measured(self, P: GeneralizedPlant, closed_loop: StateSpace) -> float:
        """Its value on a closed loop of the plant."""
        z, w = self.numbers(P)
        return self.of(_between(closed_loop, z, w))

    def barrier(self, P: GeneralizedPlant, rate: float) -> Barrier:
        """Its barrier as a function of a closed loop and a level, see `barriers.py`; `rate` in rad/s."""
        z, w = self.numbers(P)

        def found(G: StateSpace, level: float) -> tuple[float, np.ndarray, float]:
            scaled = _between(StateSpace(G.A, G.B, G.C / level, G.D / level, G.dt), z, w)
            value, part = self.inside(scaled, rate)
            by_level = -float(np.sum(part[G.n :] * np.hstack([scaled.C, scaled.D])))
            part[G.n :] /= level
            slope = np.zeros((G.n + G.ny, G.n + G.nu))
            slope[np.ix_([*range(G.n), *(G.n + i for i in z)], [*range(G.n), *(G.n + j for j in w)])] = part
            return value, slope, by_level

        return found

    def alone(self, P: GeneralizedPlant, *, proper: bool = False) -> tuple[float, StateSpace] | None:
        """The least value that a controller reaches when nothing else is asked for, and that controller, if known.

        `proper` is whether it is to be strictly proper, which counts where the least value is known for such.
        """
        try:
            return self.least(self.channel(P), proper)
        except (SynthError, np.linalg.LinAlgError):
            return None

    def lmis(self, loop: Any, a: Any, b: Any) -> list[Any]:
        """The matrices that are positive semidefinite when the square of its value is at most a b."""
        raise NotImplementedError

    def of(self, G: StateSpace) -> float:
        """Its value on a stable system."""
        raise NotImplementedError

    def inside(self, G: StateSpace, rate: float) -> Sloped:
        """Its barrier at the level one, and the derivative by [A B; C D]; `rate` in rad/s."""
        raise NotImplementedError

    def least(self, P: GeneralizedPlant, proper: bool) -> tuple[float, StateSpace] | None:
        """The least value for a plant that is the channel, and the controller that has it."""
        raise NotImplementedError


class Hinf(Norm):
    """H-infinity norm: the largest gain of a sinusoid, continuous or discrete."""

    anytime = True

    def lmis(self, loop: Any, a: Any, b: Any) -> list[Any]:  # noqa: D102
        from synth.lmi.hinf import hinf

        return [hinf(loop, a, b)]

    def of(self, G: StateSpace) -> float:  # noqa: D102
        return verify(G).norm

    def inside(self, G: StateSpace, rate: float) -> Sloped:  # noqa: D102
        return barriers.entropy(G, rate)

    def least(self, P: GeneralizedPlant, proper: bool) -> tuple[float, StateSpace]:  # noqa: D102
        design = hinfsyn(P)
        return design.gamma if design.info.optimum is None else design.info.optimum, design.controller


class H2(Norm):
    """H2 norm: the root of the mean power of z for white noise in w, of covariance (continuous: intensity) one."""

    def lmis(self, loop: Any, a: Any, b: Any) -> list[Any]:  # noqa: D102
        from synth.lmi.h2 import h2

        return h2(loop, a, b)

    def of(self, G: StateSpace) -> float:  # noqa: D102
        return h2norm(G)

    def inside(self, G: StateSpace, rate: float) -> Sloped:  # noqa: D102
        return barriers.covariance(G, trace=True)

    def least(self, P: GeneralizedPlant, proper: bool) -> tuple[float, StateSpace]:  # noqa: D102
        design = h2syn(P, strictly_proper=proper)
        return design.optimum, design.controller


class GeneralisedH2(Norm):
    """Generalised H2 norm: the largest peak of |z| for a w of energy one."""

    def lmis(self, loop: Any, a: Any, b: Any) -> list[Any]:  # noqa: D102
        from synth.lmi.generalised_h2 import generalised_h2

        return generalised_h2(loop, a, b)

    def of(self, G: StateSpace) -> float:  # noqa: D102
        G = balance(G)
        if not is_stable(G) or (not G.dt and G.D.any()):
            return np.inf
        return float(np.linalg.norm(np.hstack([G.C @ gramian_factors(G)[0], G.D]), 2))

    def inside(self, G: StateSpace, rate: float) -> Sloped:  # noqa: D102
        return barriers.covariance(G, trace=False)

    def least(self, P: GeneralizedPlant, proper: bool) -> None:  # noqa: D102
        return None


class Peak(Norm):
    """Peak gain, discrete: the largest |z_i(k)| for a w of which no sample of a signal is larger than one.

    The worst-case peak gain, or l1 norm. It has no LMI, but a bound (`synth.lmi.peak`); descents lower it itself.
    """

    continuous = False
    by_lmi = False

    def inside(self, G: StateSpace, rate: float) -> Sloped:  # noqa: D102
        return barriers.peak(G)

    def of(self, G: StateSpace) -> float:
        """Proved to be no larger, see `synth.proof.peakgain`."""
        from synth.proof.balls import Balls
        from synth.proof.matrices import exact
        from synth.proof.peakgain import peak_gains

        gains = peak_gains(Balls(*(exact(M) for M in balance(G).matrices)), few=PROVED)
        return float(gains.sum(axis=1).max(initial=0.0))

    def least(self, P: GeneralizedPlant, proper: bool) -> None:  # noqa: D102
        return None


@dataclass(frozen=True)
class Bound:
    """A norm that is to be at most `level`."""

    norm: Norm
    level: float


@dataclass(frozen=True)
class Disc:
    """All poles of the closed loop in a disc; rad/s in continuous time.

    Parameters
    ----------
    centre : on the real axis
    radius : positive
    """

    centre: float = 0.0
    radius: float = 1.0

    def __post_init__(self):
        centre = as_number("centre", self.centre, "the centre of the disc on the real axis")
        radius = as_number("radius", self.radius, "the radius of the disc, positive", above=0)
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "radius", radius)

    def measured(self, closed_loop: StateSpace) -> float:
        """Distance of the farthest pole from the centre."""
        return float(np.abs(closed_loop.poles() - self.centre).max(initial=0.0))

    def barrier(self, closed_loop: StateSpace, level: float) -> tuple[float, np.ndarray, float]:
        """The barrier of a disc with the radius `level`."""
        return barriers.within(closed_loop, self.centre, level)

    def moved(self, rate: float) -> Disc:
        """Where the Cayley map z = (rate + s) / (rate - s) takes it.

        Raises
        ------
        ModelError : it reaches the rate, far in the right half plane.
        """
        low, high = self.centre - self.radius, self.centre + self.radius
        if high >= rate:
            raise ModelError(f"the disc reaches up to {high:.4g} rad/s; pass one in the left half plane")
        low, high = ((rate + s) / (rate - s) for s in (low, high))
        return Disc((low + high) / 2, (high - low) / 2)


@dataclass(frozen=True)
class StrictlyProper:
    """The controller has no direct term: the processor has a period to compute."""


def _between(G: StateSpace, z: list[int], w: list[int]) -> StateSpace:
    return StateSpace(G.A, G.B[:, w], G.C[z], G.D[np.ix_(z, w)], G.dt)


def _numbers(key: str, wanted: Channel, names: tuple[str, ...]) -> list[int]:
    if wanted is None:
        return list(range(len(names)))
    found = []
    for signal in [wanted] if isinstance(wanted, str) or not isinstance(wanted, Sequence) else wanted:
        number = names.index(signal) if isinstance(signal, str) and signal in names else signal
        if isinstance(number, bool) or not isinstance(number, int | np.integer) or not 0 <= number < len(names):
            raise ModelError(
                f"{key} has no signal {shown(signal)}; pass names or numbers from 0 on of {', '.join(names)}"
            )
        found.append(int(number))
    if not found or len(set(found)) < len(found):
        raise ModelError(f"{key} is {shown(wanted)}; name at least one signal, and each only once")
    return found
