"""What a discrete controller does to a continuous plant at all times, the samples and what is between them.

    w ──> P ──> z        u = hold of K(sampled y), positive feedback
          ^ │            the hold takes a new value `delay` s after the sample
        u └─┘ y

H-infinity: the largest ratio of the energies of z and w. At a level the plant over one period is a discrete plant
(`equations/lifting.py`) that has, closed by K, a norm below one exactly when the loop has one below the level; so the
judge of discrete systems decides, and the level is moved until its answer is one, from either side.

H2: the root of the mean power of z, over time, where w is white noise of unit intensity.

References: Bamieh and Pearson (1992), IEEE TAC 37, 418 (H-infinity), and Systems & Control Letters 19, 1 (H2);
Chen and Francis (1995), Optimal Sampled-Data Control Systems, chapters 12 and 13.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from synth.analysis.norms import h2norm, is_stable, verify
from synth.checks import as_indices, as_number, check_period, numerical, timebase_told
from synth.equations.lifting import Lifting
from synth.errors import ModelError, NumericalError, SynthError, VerificationError
from synth.systems.connect import delayed
from synth.systems.delays import as_late
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system
from synth.systems.timebase import retimed
from synth.threads import one_thread

STEPS = 100  # of the level, until both bounds are near enough; about eight are used
TOLERANCE = 1e-6  # relative distance of the bounds
SAME = 1e-9  # relative difference of sampling times and of matrices that is none


class SampledNorm(NamedTuple):
    """The H-infinity norm of a sampled loop, between two bounds; unpacks as lower, upper, frequency."""

    lower: float  # a w was found that z is larger than by this factor
    upper: float  # no w has a larger one
    frequency: float  # rad/s, up to pi/h, of the worst w, which has those beside it too that look the same when sampled


@one_thread
@numerical
def sdhinfnorm(
    P: Any, K: Any, h: float | None = None, *, delay: float = 0.0, held: Any = None, tol: float = TOLERANCE
) -> SampledNorm:
    """H-infinity norm of a continuous plant with a discrete controller, between the samples too.

    Parameters
    ----------
    P : continuous GeneralizedPlant, or a system in any form that `system` takes whose last inputs are u and last
        outputs y, as many as K has; D11 and D22 may be nonzero
    K : discrete controller u = K y (positive feedback), in any form that `system` takes
    h : sampling time in s; that of K when left out
    delay : s from the sample to the new value of the hold, from 0 to h: exact, no Pade approximation
    held : names or numbers of those w that are constant over a period, as a reference that a computer gives. The others
        are any signals, and must not reach a sampler directly; one that acts on y alone is a sequence of noise anyway
    tol : relative distance of the bounds; rounding may keep them farther apart

    Returns
    -------
    SampledNorm : lower <= norm <= upper, in floating point; both inf for an unstable loop. A w that is held counts with
        the energy of the signal that it is, h |w|^2 a period: for slow signals the norm is that of the loop of
        `c2d(P, h)`, and above it where something happens between the samples

    Raises
    ------
    ModelError : P is discrete, K is not, sampling times disagree, sizes do not fit, or a free w has a direct way to y:
        its samples may be anything, and there is no norm.
    VerificationError : the loop is stable, but too ill-conditioned to be judged.

    Reference: Bamieh and Pearson (1992), IEEE TAC 37, 418.
    """
    lifting, K = sampled_loop(P, K, h, delay, held)
    return bounds(lifting, K, as_number("tol", tol, "a relative distance of the bounds, 1e-6 for example", above=0))


@one_thread
@numerical
def sdh2norm(P: Any, K: Any, h: float | None = None, *, delay: float = 0.0, held: Any = None) -> float:
    """H2 norm of a continuous plant with a discrete controller: root of the mean power of z for white noise w.

    The mean is one over time, between the samples too. A w that is held is white noise from sample to sample, of
    variance 1/h, which is of unit intensity as well. inf for an unstable loop, and where a w that is not held acts
    directly on z.

    Parameters, and what is raised: as of `sdhinfnorm`.

    References: Bamieh and Pearson (1992), Systems & Control Letters 19, 1; Chen and Francis (1995), chapter 12.
    """
    lifting, K = sampled_loop(P, K, h, delay, held)
    plant, within = wide(lifting)
    loop = plant.close(K)
    if lifting.direct or not is_stable(loop):
        return np.inf
    level = lifting.wide  # of the samples' w and z; they are over its root
    return float(level * np.sqrt((h2norm(loop) ** 2 + within) / lifting.h))


def sampled_loop(P: Any, K: Any, h: float | None, delay: float, held: Any) -> tuple[Lifting, StateSpace]:
    """The plant over a period, and the controller, checked."""
    if h is not None:
        h = as_number("h", h, "the sampling time in s, positive, or None for that of K", above=0)
    K = as_system("K", K, h)
    if h is None:
        check_period("K", K.dt)
        if not K.discrete:
            raise ModelError("K is continuous; pass a discrete controller: c2d(K, h, 'tustin') is one")
        h = float(K.dt)
    K = retimed(K, h)
    if not abs(K.dt - h) <= SAME * h:
        raise ModelError(f"h is {h:g} s and K has {timebase_told(K.dt)}; pass the sampling time that K was made for")
    if not isinstance(P, GeneralizedPlant):
        G = as_system("P", P)
        if G.ny <= K.nu or G.nu <= K.ny:
            raise ModelError(
                f"P is {G.ny} x {G.nu}, which leaves no z or no w beside a controller K of {K.ny} x {K.nu}"
            )
        P = GeneralizedPlant.partition(G, K.nu, K.ny)
    _, _, m, _, p = P.sizes
    if (K.ny, K.nu) != (m, p):
        raise ModelError(f"the controller K is {K.ny} x {K.nu} where {m} x {p} is needed (controls x measurements)")
    return lifted(P, h, delay, held), K


def lifted(P: GeneralizedPlant, h: float, delay: float, held: Any, *, noisy: bool = False) -> Lifting:
    """A continuous plant over a period, checked; `held` as of `sdhinfnorm`, noisy: and all that reach a sampler."""
    if P.dt:
        raise ModelError(
            f"P is discrete ({timebase_told(P.dt)}); pass the continuous plant, nothing is between samples"
        )
    delay = as_number("delay", delay, f"a time in s from 0 to h = {h:g}; whole samples belong into K", least=0)
    if delay > h:
        raise ModelError(f"delay is {delay:g} s, more than the period of {h:g} s; put whole samples of it into K")
    sampled = np.flatnonzero(P.D21.any(axis=0)).tolist()
    alone = [j for j in sampled if noisy or (not P.B1[:, j].any() and not P.D11[:, j].any())]
    named = [] if held is None else as_indices("held w", held, P.w)
    if free := sorted({*sampled} - {*alone, *named}):
        names = ", ".join(repr(P.w[j]) for j in free)
        raise ModelError(
            f"w {names} reaches a sampler directly (D21), and the samples of any signal of finite energy may be of any "
            f"size: put an anti-aliasing filter before the sampler into P, or say held=[{names}] if it is constant "
            "between the samples"
        )
    return Lifting.of(P, h, delay, tuple(sorted({*alone, *named})))


def intersample(P: GeneralizedPlant, K: StateSpace, delay: float = 0.0) -> SampledNorm | None:
    """Bounds of the norm that a controller of a sampled plant has between the samples, a w that reaches y held.

    None where the plant remembers no continuous one, or has been changed since, and where it cannot be told. `delay` is
    that of the hold in s beside the plant's.
    """
    try:
        found = remembered(P, P.delay + delay)
        return None if found is None else bounds(found[0], late(K, found[1]), TOLERANCE)
    except (SynthError, np.linalg.LinAlgError):
        return None


def remembered(P: GeneralizedPlant, delay: float) -> tuple[Lifting, int] | None:
    """What `c2d` sampled, over a period, for a hold that takes a new u `delay` s after the sample; and whole samples.

    None where the plant remembers no continuous one, or has been changed since.
    """
    if P.continuous is None or not is_sample(P, P.continuous):
        return None
    lag = as_late("delay", delay, 1, P.dt)
    return lifted(P.continuous, P.dt, float(lag.part[0]) * P.dt, P.held, noisy=True), int(lag.whole[0])


def late(K: StateSpace, samples: int) -> StateSpace:
    """A controller whose u comes so many samples later."""
    for _ in range(samples):
        K = delayed(K)
    return K


def is_sample(P: GeneralizedPlant, origin: GeneralizedPlant) -> bool:
    """Whether a discrete plant is what `c2d` makes of a continuous one, to rounding."""
    _, nw, nu, *others = origin.sizes
    if P.dt is True or P.sizes[1:] != (nw, nu, *others):
        return False
    try:
        ours, theirs = P.system, c2d(origin, P.dt, delay=np.repeat([0.0, P.delay], [nw, nu])).system
    except (SynthError, np.linalg.LinAlgError):
        return False
    pairs = [(getattr(ours, name), getattr(theirs, name)) for name in "ABCD"]
    return ours.n == theirs.n and all(
        np.abs(M - N).max(initial=0.0) <= SAME * np.abs(N).max(initial=0.0) for M, N in pairs
    )


def wide(lifting: Lifting) -> tuple[GeneralizedPlant, float]:
    """The discrete plant of the H2 norm, at the level `lifting.wide`, and what happens within a period of it."""
    found = lifting.at(lifting.wide)
    if found is None:
        raise NumericalError("the numbers of the plant are too far apart for doubles; choose other units")
    return found[0], found[1].within


def bounds(lifting: Lifting, K: StateSpace, tol: float) -> SampledNorm:
    """Lower and upper bound of the norm of the loop, by moving the level."""
    plant, within = wide(lifting)
    loop = plant.close(K)
    if not is_stable(loop):
        poles = loop.poles()
        return SampledNorm(np.inf, np.inf, float(abs(np.angle(poles[np.abs(poles).argmax()])) / lifting.h))
    level = float(lifting.wide * (verify(loop).norm + np.sqrt(within)) + lifting.direct)  # of the parts together
    if level == 0:
        return SampledNorm(0.0, 0.0, 0.0)
    lower, upper = _Answer(lifting.direct, np.inf, 0.0, 0.0), _Answer(np.inf, 0.0, 0.0, 0.0)
    for step in range(STEPS):
        answer = _asked(lifting, K, level)
        if answer.peak >= 1:
            lower = max(lower, answer)
        elif answer.norm <= 1:
            upper = min(upper, answer)
        else:  # within rounding of the norm
            lower, upper = _beside(lifting, K, level, tol, (lower, upper))
            break
        if upper.level <= lower.level * (1 + tol):
            break
        level = _next(lower, upper, tol, step % 3 == 2)
    return SampledNorm(lower.level, upper.level, upper.frequency)


class _Answer(NamedTuple):
    """What the judge says of the discrete loop at a level."""

    level: float
    peak: float  # of the largest singular value: 1 or more where the level is not above the norm
    norm: float  # 1 or less where it is
    frequency: float


def _asked(lifting: Lifting, K: StateSpace, level: float) -> _Answer:
    """The discrete loop at a level, measured; neither peak nor norm says anything where it cannot be."""
    found = lifting.at(level)
    if found is None:
        return _Answer(level, np.inf, np.inf, 0.0)
    loop = found[0].close(K)
    if not is_stable(loop):
        return _Answer(level, np.inf, np.inf, 0.0)
    try:
        measured = verify(loop)
    except VerificationError:
        return _Answer(level, 0.0, np.inf, 0.0)
    return _Answer(level, measured.peak, measured.norm, measured.frequency)


def _next(lower: _Answer, upper: _Answer, tol: float, middle: bool) -> float:
    """The level to ask at: beside the root of the line through both answers, in logarithms, or between the bounds."""
    a, b = lower.level, upper.level
    if b == np.inf:
        return 2 * a
    if middle and b > 2 * a:
        return np.sqrt(a * b) if a else b / 4
    root = b * upper.peak  # the norm, if the discrete one went with the level
    if np.isfinite(lower.peak):
        root = b * upper.peak ** (np.log(b / a) / np.log(lower.peak / upper.peak))
    elif middle:
        root = np.sqrt(a * b)
    root = float(np.clip(root, a, b))
    return root * (1 + tol / 4) if b > root * (1 + tol / 2) else root * (1 - tol / 4)


def _beside(
    lifting: Lifting, K: StateSpace, level: float, tol: float, found: tuple[_Answer, _Answer]
) -> tuple[_Answer, _Answer]:
    """Bounds beside a level at which rounding hides the answer, as near as there are any."""
    lower, upper = found
    for wanted in (1, -1):
        away = tol / 4
        while away < 1:
            other = level * (1 + wanted * away)
            if not lower.level < other < upper.level:
                break
            answer = _asked(lifting, K, other)
            if answer.peak >= 1:
                lower = max(lower, answer)
            elif answer.norm <= 1:
                upper = min(upper, answer)
            away *= 4
    if upper.level == np.inf:
        raise VerificationError(
            f"the sampled loop is too ill-conditioned to be judged: rounding hides if its norm is below {level:.6g}"
        )
    return lower, upper
