"""The worst flight in a box of dispersions: found by climbing, beside a Monte Carlo that only draws.

Corners of the box and draws from it are flown first. From the worst of them climbs go up the slopes of the objective:
each looks along z(t) = P(z + t s), P the projection on the box and s the slope or its signs, at several t at once. A
large t puts every coordinate at its bound, where the worst of most boxes lies; a small one approaches a worst inside.
A climb that does not rise any more gives its place to the next of the first flights. All steps go up, so that nothing
worse was flown than what is found, whatever saturations, deadbands and pulses do to the slopes.

What is reported is a flight, not a probability, and no proof that there is no worse one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from plants.errors import ScenarioError
from plants.simulation import blocks, simulate
from plants.simulation.batch import Case
from plants.simulation.loop import Run
from plants.simulation.sensitivity import Box, Objective, Response

RISE = 1e-4  # of the spread of the first flights: a climb that rises less has ended
SHRINK = 0.25  # from one t of a path to the next
FARTHEST = 4.0  # t of the steepest coordinate, so that others reach their bounds as well
PATH = 8  # points of a path at least
SAME = 1e-9  # of an objective: what batch and single flight may differ by
REPLAYS = 8  # at most


class Parameter(NamedTuple):
    """A number that was free."""

    lower: float
    value: float
    upper: float

    def __str__(self) -> str:
        """The value, and whether it is a bound."""
        bound = {self.lower: " (lower bound)", self.upper: " (upper bound)"}
        return f"{self.value:.6g}{bound.get(self.value, '')}"


@dataclass(frozen=True, kw_only=True)
class WorstFlights:
    """The worst flight found, and what it took; k climbs were begun."""

    worst: Any  # dispersion, like a bound of the box
    run: Run  # `simulate(*case(worst, shared))`, bit for bit
    value: float  # objective of that run, infinite if it failed
    parameters: dict[str, Parameter]  # the free numbers of `worst` by path, such as ".inertia[0]"
    ends: Any  # dispersions at which the climbs ended, worst first, leaves (k, ...)
    values: np.ndarray  # (k,) objective there
    beside: np.ndarray | None  # (m,) objective of the Monte Carlo beside it
    beside_run: Run | None  # its worst flight
    flights: int  # flown in the search, replays included, the Monte Carlo not
    tangents: int  # directions of forward mode carried along, each at about the cost of one or two flights
    slopes: str  # "forward mode" or "differences of flights", and why if there was no choice
    complete: bool  # False if interrupted

    def __str__(self) -> str:
        """What was found, where, and what it took."""
        fate = f"{self.value:.6g}"
        if not self.run.ok:
            fate = f"fails at {self.run.failed_at:g} s in the {self.run.culprit}"
        state = "" if self.complete else " (INTERRUPTED)"
        lines = [
            f"worst flight found{state}: {fate}",
            f"  {self.flights} flights and {self.tangents} tangents; slopes by {self.slopes}",
        ]
        if self.beside is not None:
            lines.append(f"  worst of the {len(self.beside)} flights beside it: {self.beside.max():.6g}")
        return "\n".join([*lines, *(f"  {name} = {p}" for name, p in self.parameters.items())])


def worst_flights(
    case: Case,
    box: Any,
    objective: Objective,
    shared: Any = None,
    *,
    beside: Any = None,
    record: simulate.Record | None = None,
    seed: int = 0,
    flights: int = 128,
    rounds: int = 8,
    compiled: bool | None = None,
    forward: bool | None = None,
    memory: int = 256 << 20,
    progress: bool = True,
) -> WorstFlights:
    """Search a box of dispersions for the flight with the largest objective.

    Parameters
    ----------
    case : ``case(d, shared) -> (loop, scenario)``, as in `campaign.campaign`; any Python, it is not traced
    box : (lower, upper), two dispersions; numbers equal in both stay as they are
    objective : ``objective(run) -> () number``, larger is worse, of a sound `Run`; a flight that fails counts as
        infinite. Written with `jax.numpy` it is differentiated; `run.time` and `run.duration` are concrete, so that
        ``run.outputs[run.time >= 300]`` will do. Pass a module-level function: a new lambda compiles anew
    shared : second argument of `case`
    beside : dispersions (m, ...) of a Monte Carlo to compare with, see `campaign.draw`; not used by the search
    record : as in `simulate.simulate`
    seed : of the first flights and of the search; the same seed finds the same flight
    flights : flown first: corners of the box, all of them if half as many will do, and uniform draws
    rounds : of the climbs; each takes their slopes, n tangents or flights a climb for n free numbers, and then flies
        64 flights along them (8 climbs; fewer of both if `memory` asks for it)
    compiled : as in `simulate.simulate`
    forward : True for slopes in forward mode, which are exact, cost one to two flights for each free number and a
        compilation; False for differences of flights, which cost one; by default forward mode wherever JAX can
        trace controller and objective
    memory : bytes for the rows of a batch
    progress : show a bar if it takes more than two seconds

    Returns
    -------
    WorstFlights
        After Ctrl-C what was found by then, with ``complete`` False.

    Raises
    ------
    ScenarioError
        Bounds that are no box (the message names the number), a box that does not reach loop and scenario, unusable
        numbers of a case (the message has its dispersion), an objective that is no number, no flights, forward mode
        where there is none.

    Notes
    -----
    Every flight has the noise of the scenario's own `seed` and `run`: the worst for this noise. One flight that fails
    ends the search, since nothing is worse.
    """
    for name, value, least in (("flights", flights, 1), ("rounds", rounds, 0), ("memory", memory, 1)):
        if not isinstance(value, int) or value < least:
            raise ScenarioError(f"{name} = {value!r}: give a whole number of at least {least}")
    space = Box.between(box)
    response = Response.of(
        case, shared, space, objective, record=record, compiled=compiled, forward=forward, memory=memory
    )
    with tqdm(desc="flights", total=flights, delay=2.0, disable=not progress) as bar:
        search = _search(response, np.random.default_rng(seed), flights, rounds, bar)
    ends = sorted(search.ends, key=_height, reverse=True)
    z, run, value, replays = _replayed(response, ends)
    others, other = (None, None) if beside is None else response.beside(beside)
    reason = f" ({response.obstacle})" if response.obstacle else ""
    bounds = zip(space.names, space.low, space.numbers(z), space.high, strict=True)
    return WorstFlights(
        worst=space.at(z),
        run=run,
        value=value,
        parameters={name: Parameter(*map(float, numbers)) for name, *numbers in bounds},
        ends=blocks.join([space.at(end.z) for end in ends]),
        values=np.array([end.value for end in ends]),
        beside=others,
        beside_run=other,
        flights=search.flights + replays,
        tangents=search.tangents,
        slopes="forward mode" if response.forward else f"differences of flights{reason}",
        complete=search.complete,
    )


class _Point(NamedTuple):
    """A flight of the search."""

    z: np.ndarray  # (n,) in the box
    value: float


class _Search(NamedTuple):
    """What a search leaves behind."""

    ends: list[_Point]  # of every climb
    flights: int
    tangents: int
    complete: bool


def _search(response: Response, rng: np.random.Generator, flights: int, rounds: int, bar: tqdm) -> _Search:
    """First flights, then rounds of climbs."""

    def fly(points: np.ndarray) -> list[_Point]:
        values = response.values(points)
        bar.update(len(points))
        return list(map(_Point, points, values.tolist()))

    waiting = sorted(fly(_first(flights, len(response.box.names), rng)), key=_height)  # the best is the next
    finite = [p.value for p in waiting if np.isfinite(p.value)]
    rise = RISE * float(np.ptp(finite)) if finite else 0.0
    spent, tangents, complete = flights, 0, False
    ends: list[_Point] = []
    going: list[_Point] = []
    try:
        for left in range(rounds, -1, -1):
            while waiting and len(going) < response.climbs:
                going.append(waiting.pop())
            if not left or going[0].value == np.inf or going[-1].value == np.inf:
                break
            slopes = response.slopes(np.array([p.z for p in going]), np.array([p.value for p in going]))
            width = max(PATH, response.lanes // len(going))
            bar.total = bar.n + left * width * len(going)
            flown = fly(np.concatenate([_path(p.z, s, width, rng) for p, s in zip(going, slopes, strict=True)]))
            spent += len(flown) + (0 if response.forward else slopes.size)
            tangents += slopes.size if response.forward else 0
            tops = [max(flown[a : a + width], key=_height) for a in range(0, len(flown), width)]
            ends += [
                max(p, top, key=_height) for p, top in zip(going, tops, strict=True) if top.value <= p.value + rise
            ]
            going = [top for p, top in zip(going, tops, strict=True) if top.value > p.value + rise]
        complete = True
    except KeyboardInterrupt:
        bar.write("interrupted: what was found by then is kept")
    return _Search([*ends, *(going or waiting[-1:])], spent, tangents, complete)


def _height(point: _Point) -> float:
    return point.value


def _first(flights: int, n: int, rng: np.random.Generator) -> np.ndarray:
    """Where to begin: (flights, n), half of it corners, all of them if they are so few, and the rest uniform."""
    corners = min(flights // 2, 2 ** min(n, 62))
    if corners == 2**n:
        signs = np.arange(corners)[:, None] >> np.arange(n) & 1
    else:
        signs = rng.integers(0, 2, (corners, n))
    return np.concatenate([signs.astype(float), rng.uniform(size=(flights - corners, n))])


def _path(z: np.ndarray, slope: np.ndarray, width: int, rng: np.random.Generator) -> np.ndarray:
    """Points to look at from z, (width, n): along the slope's signs, along the slope, and one number changed at random.

    Where the slope is zero, as in a deadband, a random direction takes its place.
    """
    steepest = np.abs(slope).max()
    direction = slope / steepest if steepest > 0 else rng.uniform(-1, 1, len(z))
    t = SHRINK ** np.arange(width)[:, None]
    signs = (width - 1) // 2
    points = np.clip(
        z + np.concatenate([t[:signs] * np.sign(direction), FARTHEST * t[: width - signs] * direction]), 0, 1
    )
    points[-1] = z
    j = rng.integers(len(z))
    points[-1, j] = rng.uniform() if z[j] in (0.0, 1.0) else rng.integers(2)
    return points


def _replayed(response: Response, ends: Sequence[_Point]) -> tuple[np.ndarray, Run, float, int]:
    """The worst end flown by `simulate`, its value, and how many were flown.

    The next ones are flown as well if rounding, which differs between a batch and a flight alone, has put one of them
    above it, as it may where a flight hangs on the last bit.
    """
    best: tuple[np.ndarray, Run, float] | None = None
    count = 0
    for end in ends[:REPLAYS]:
        if best is not None and best[2] >= end.value - SAME * abs(end.value):
            break
        run, value = response.fly(end.z)
        count += 1
        if best is None or value > best[2]:
            best = end.z, run, value
    assert best is not None
    return *best, count
