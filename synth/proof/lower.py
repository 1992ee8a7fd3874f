"""The lower bound's witness, found in floating-point arithmetic: nothing here needs to be rigorous.

At a level just below the optimum, of control and of estimation: policy iteration for the disturbance, each step
answering w = F x with the best control, a Riccati equation that leaves out next to nothing of the cost, and improving
F; and from there, where that is slow or a zero on the stability boundary bars it, doubling in balls. It ends when both
sides couple too strongly, or when on one side a disturbance gains or a cost that must grow falls.

Reference: Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from synth.analysis.precondition import Conditioned, precondition
from synth.equations.doubling import double, solve_riccati
from synth.equations.hinf_riccati import RiccatiRoute, dual
from synth.proof import balls
from synth.proof.balls import Coupling, Fall, Impulse, LowerWitness, Step
from synth.proof.matrices import exact, identity, inverse_factor, reduced, rounded, symmetric
from synth.proof.reasons import obstacles
from synth.proof.upper import FAILURES, REFINED, rates
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import design_rate, discretised, inverse_cayley, pole_rate

DISTANCES = (2e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.3)  # of the level below the Riccati equations' optimum
FALSE = 0.99  # part of a norm that was reached: an optimum below it may be a false claim
LEFT_OUT = 1e-20  # cost left out, relative to X
CONVERGED = 1e-9  # relative change of a policy iteration or a doubling; both are quadratic
ROUNDING = 1e-13  # relative, of a Newton step that was the last one
MAX_POLICIES = 30
MAX_DOUBLINGS = 60
NOTHING = 1e-6  # part of the level of quadratic control: an optimum that counts as zero
NOT_FOUND = "no contradiction was found near the optimum of the Riccati equations"


class Place(NamedTuple):
    """Coordinates of a witness."""

    T: np.ndarray  # (n, n) states of the plant, x = T x_new
    w: float  # factor on the gains from w
    z: float  # factor on the gains to z
    rate: float  # rad/s of the map to discrete time, 0 for discrete time as it is


Side = tuple[GeneralizedPlant, balls.Half, np.ndarray]  # a plant or its dual, in doubles and in balls, and a start


class Climb(NamedTuple):
    """How far one side came."""

    steps: tuple[Step, ...]
    doubled: int
    X: arb_mat  # (n, n) what P exceeds there
    w: np.ndarray | None = None  # (nw) a disturbance that gains, where there is one
    v: np.ndarray | None = None  # (n) a state whose cost falls, where there is one


def find_lower(
    P: GeneralizedPlant, upper: float, level: float | None, bits: int
) -> tuple[tuple[float, LowerWitness] | None, str]:
    """The highest of a few levels below the optimum (or the one given) with its witness, or None and the reason."""
    scaled, failure = np.inf, ""
    with np.errstate(all="ignore"), ctx.workprec(bits):
        for rate in rates(P.dt, _design_rate(P)):
            try:
                found, scaled = _lower(P, upper, level, bits, rate)
            except FAILURES as error:
                failure = str(error)
                continue
            if found is not None:
                return found, ""
        return None, _reason(P, scaled, failure)


def _reason(P: GeneralizedPlant, scaled: float, failure: str) -> str:
    """Why nothing was found, as far as it is known."""
    if scaled < NOTHING:
        return "the optimum is zero, or so small beside that of quadratic control that it cannot be told from zero"
    try:
        found = obstacles(P)
    except FAILURES:
        found = []
    if found:
        return f"no strict inequality on one side, as rank is lost on the stability boundary: {'; '.join(found)}"
    return f"{NOT_FOUND}: {failure}" if failure else NOT_FOUND


def _design_rate(P: GeneralizedPlant) -> float:
    """The rate of a generalised plant, also of a discrete one; its own where it has none in continuous time."""
    try:
        if P.dt == 0:
            return design_rate(P)
        return design_rate(GeneralizedPlant.partition(inverse_cayley(P.system, 2 / P.dt), P.sizes[4], P.sizes[2]))
    except FAILURES:  # a pole at -1
        return 2 / P.dt if P.dt else pole_rate(P.system.poles())


def _lower(
    P: GeneralizedPlant, upper: float, level: float | None, bits: int, rate: float
) -> tuple[tuple[float, LowerWitness] | None, float]:
    """`find_lower` in the discrete time of one rate, and the optimum over the level of quadratic control."""
    discrete, _ = discretised(P, rate or None)
    c = precondition(discrete)
    before, after = np.linalg.norm(np.linalg.solve(c.T, discrete.B1)), np.linalg.norm(c.plant.B1)
    w = float(after / before) if before and after else 1.0  # `precondition` shares its scale between w and z
    z = 1 / (c.scale * w)
    place = Place(c.T, w, z, rate)
    halves = balls.in_coordinates(P, *place)
    floating = _rounded(halves, c)
    route = RiccatiRoute.of(floating)
    scaled = route.minimise()[0]
    sides = (floating, halves[0], route.X), (dual(floating), halves[1], route.Y)

    def highest(levels: Iterable[float]) -> tuple[float, LowerWitness] | None:
        return next(((g, f) for g in levels if (f := _refuted(P, g, place, sides, bits))), None)

    if level is not None:
        return highest([level]), scaled
    optimum = min(scaled * c.scale, upper)
    found = highest(optimum * (1 - d) for d in DISTANCES)
    if optimum < FALSE * upper:  # a claim may be wrong
        found = highest(upper * (1 - d) for d in DISTANCES if upper * (1 - d) > optimum) or found
    return found, scaled


def _refuted(
    P: GeneralizedPlant, level: float, place: Place, sides: tuple[Side, Side], bits: int
) -> LowerWitness | None:
    """Why no controller reaches a level, or None where nothing was found."""
    g = arb(level) * arb(place.w) * arb(place.z)  # exactly: strictness is far smaller than rounding
    for control, estimation in _ways(sides, g):
        try:
            for end in _ends(control, estimation, sides, g):
                # of a contradiction on one side the other one is no part
                used = [isinstance(end, Coupling) or end.dual == is_dual for is_dual in (False, True)]
                steps = [side.steps if here else () for side, here in zip((control, estimation), used, strict=True)]
                doubled = (control.doubled * used[0], estimation.doubled * used[1])
                witness = LowerWitness(*place, steps[0], steps[1], end, doubled)
                if balls.proves_lower(P, witness, level, bits):
                    return witness
        except FAILURES:
            continue
    return None


def _rounded(halves: tuple[balls.Half, balls.Half], c: Conditioned) -> GeneralizedPlant:
    """The conditioned plant once more, from balls, so that it agrees with them to the last digit."""
    control, estimation = halves
    A, B1, B2, C1, D11, D12 = (rounded(M) for M in control)
    C2, D21 = rounded(estimation.B2).T, rounded(estimation.D12).T
    return replace(c.plant, A=A, B1=B1, B2=B2 @ c.Su, C1=C1, D11=D11, D12=D12 @ c.Su, C2=c.Sy @ C2, D21=c.Sy @ D21)


def _ways(sides: tuple[Side, Side], g: arb) -> Iterator[tuple[Climb, Climb]]:
    """Ways up on both sides, dearer ones only when they are asked for: by policies, doubled from there and from 0."""
    policies = [_climb(*side, g) for side in sides]
    yield policies[0], policies[1]
    further = [_double(P, half, climb.steps, g) for (P, half, _), climb in zip(sides, policies, strict=True)]
    yield further[0], further[1]
    start = [
        _double(P, half, (), g) if climb.steps else climb for (P, half, _), climb in zip(sides, further, strict=True)
    ]
    yield start[0], start[1]
    yield further[0], start[1]
    yield start[0], further[1]


def _climb(P: GeneralizedPlant, half: balls.Half, start: np.ndarray, g: arb) -> Climb:
    """Policy iteration for w on one side, up to the game Riccati solution or to a disturbance that gains."""
    n, nw = P.B1.shape
    level, F, X, steps = float(g), np.zeros((nw, n)), np.zeros((n, n)), []
    for _ in range(MAX_POLICIES):
        C = P.C1 + P.D11 @ F
        answer = solve_riccati(
            P.A + P.B1 @ F, P.B2, C.T @ C - level**2 * F.T @ F, P.D12.T @ P.D12, C.T @ P.D12, start=start
        )
        try:
            step = None if answer is None else _step(half, steps[-1] if steps else None, F, answer.X, g)
            w, F = (None, F) if step is None else _answer(P, step.X, level)
        except FAILURES:
            step = w = None
        if step is None:
            break
        grown = np.linalg.norm(step.X - X)
        X = start = step.X
        steps.append(step)
        if w is not None:
            return Climb(tuple(steps), 0, balls.solution(step), w)
        if grown < CONVERGED * np.linalg.norm(X):
            break
    return Climb(tuple(steps), 0, balls.solution(steps[-1]) if steps else exact(X))


def _double(P: GeneralizedPlant, half: balls.Half, steps: tuple[Step, ...], g: arb) -> Climb:
    """Ever more iterates on one side, until they converge, or to a disturbance that gains or a fall."""
    last = start = balls.solution(steps[-1]) if steps else exact(np.zeros((len(P.A),) * 2))
    done, level = 0, float(g)
    try:
        for count, X in enumerate(islice(balls.iterates(half, start, g), MAX_DOUBLINGS), 1):
            F, grown = rounded(X), rounded(X - last)
            e, V = np.linalg.eigh((grown + grown.T) / 2)
            v = V[:, 0] if e[0] < 0 and balls.falls(balls.Reached(last, X), V[:, 0]) else None
            w, _ = _answer(P, F, level)
            last, done = X, count
            if w is not None or v is not None or np.linalg.norm(grown) < CONVERGED * np.linalg.norm(F):
                return Climb(steps, count, X, w, v)
    except FAILURES:  # what was reached before is proved
        pass
    return Climb(steps, done, last)


def _answer(P: GeneralizedPlant, X: np.ndarray, level: float) -> tuple[np.ndarray | None, np.ndarray]:
    """A disturbance that gains on x'X x, if there is one, else the feedback F of the worst one, w = F x."""
    nw = P.B1.shape[1]
    B, D = np.hstack([P.B1, P.B2]), np.hstack([P.D11, P.D12])
    R, S = D.T @ D + B.T @ X @ B, P.C1.T @ D + P.A.T @ X @ B
    R[:nw, :nw] -= level**2 * np.eye(nw)
    e, V = np.linalg.eigh(R[:nw, :nw] - R[:nw, nw:] @ np.linalg.solve(R[nw:, nw:], R[nw:, :nw]))
    return (V[:, -1] if e[-1] > 0 else None), -np.linalg.solve(R, S.T)[:nw]


def _step(half: balls.Half, last: Step | None, F: np.ndarray, X: np.ndarray, g: arb) -> Step | None:
    """The step to X, refined, with its factors, or None when an inequality does not hold."""
    new, M = _refined(half, F, X, g)
    X, rest = _two_doubles(new)
    after = inverse_factor(M)
    if after is None or last is None:  # the first one needs no factor at X = 0
        return None if after is None else Step(F, X, rest, np.zeros((0, 0)), after)
    before = inverse_factor(balls.subsolution(half, balls.solution(last), F, g))
    return None if before is None else Step(F, X, rest, before, after)


def _refined(half: balls.Half, F: np.ndarray, X: np.ndarray, g: arb) -> tuple[arb_mat, arb_mat]:
    """The solution near X that leaves `LEFT_OUT` of the cost, and its inequality: Newton's steps in balls."""
    n = len(X)
    new = symmetric(X)
    A, B = rounded(half.A + half.B1 * exact(F)), rounded(half.B2)
    left = LEFT_OUT * max(1.0, float(np.linalg.norm(X))) * np.eye(n)
    for _ in range(REFINED):
        S, K = reduced(balls.subsolution(half, new, F, g), n)
        change = double(A + B @ K, np.zeros((n, n)), S - left)
        if change is None:
            break
        X, rest = _two_doubles(new + exact(change))
        new = symmetric(X) + symmetric(rest)
        if np.linalg.norm(change) < ROUNDING * np.linalg.norm(X):
            break
    return new, balls.subsolution(half, new, F, g)


def _two_doubles(X: arb_mat) -> tuple[np.ndarray, np.ndarray]:
    """Doubles with the sum X, and what one of them leaves of it."""
    first = rounded(X)
    return first, rounded(X - exact(first))


def _ends(control: Climb, estimation: Climb, sides: tuple[Side, Side], g: arb) -> Iterator[Coupling | Impulse | Fall]:
    """What the two sides may contradict the level with."""
    for is_dual, climb in enumerate((control, estimation)):
        if climb.w is not None:
            factor = inverse_factor(balls.impulse(sides[is_dual][1], climb.X, climb.w, g))
            if factor is not None:
                yield Impulse(climb.w, bool(is_dual), factor)
        if climb.v is not None:
            yield Fall(climb.v, bool(is_dual))
    X, Y = rounded(control.X), rounded(estimation.X)
    e = np.linalg.eigvalsh(X)
    shift = max(-2 * float(e[0]), 1e-13 * float(e[-1]))
    if not shift > 0:
        return
    I = np.eye(len(X))
    L = np.linalg.cholesky(X + shift * I)
    e, V = np.linalg.eigh(L.T @ np.linalg.solve(float(g) ** 2 * I + shift * Y, Y) @ L)
    factor = inverse_factor(control.X + arb(shift) * identity(len(X)))
    if e[-1] > 1 and factor is not None:
        yield Coupling(np.linalg.solve(L.T, V[:, -1]), shift, factor)
