"""Many dispersed runs of one case: bounded memory, runs that depend on their index alone, a store that outlives them.

Run i draws its dispersion from the generator with SeedSequence(seed, spawn_key=(i,)) and its sensor noise from
(seed, i); lanes are padded to a width at which they do not disturb each other. So on one machine neither the batch, nor
the workers, nor where they work changes a bit of a run, and `replay` flies it again. Batches are cut so that their rows
fit into a given memory; what `measure` makes of a run is always kept, the run itself on request.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks, engines, identity, simulate
from plants.simulation.batch import LANE, Case, Flights, Read, at, replay_case, varied
from plants.simulation.conduct import Conducted, chained, conduct
from plants.simulation.loop import Run
from plants.simulation.progress import Bar

LANES = 256  # runs in a batch at most; beyond it a batch gains nothing
SAMPLE = 8  # runs looked at before the first batch, to see which numbers vary
MEMORY = 256 << 20  # bytes
COPIES = 4  # of the rows of a batch, while they are made into runs


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """What came out of a campaign; the arrays have one row per finished run."""

    index: np.ndarray  # (n,) of the finished runs
    ok: np.ndarray  # (n,) bool
    failed_at: np.ndarray  # (n,) s, NaN if ok
    culprit: np.ndarray  # (n,) str, "" if ok
    results: Any  # what `measure` returned, every leaf with a leading axis (n, ...)
    dispersed: Any  # the dispersions asked for, leaves (n, ...)
    applied: Any  # the same read back from the loop and scenario that flew, None without `read`
    varied: tuple[str, ...]  # paths of the numbers of (loop, scenario) that differed between runs
    kept: dict[int, Run]  # full trajectories, by index
    complete: bool  # False if interrupted
    errors: dict[int, str] = dataclasses.field(
        default_factory=dict
    )  # tracebacks of the runs that ended in an exception, by index; they are not in `index`

    def __str__(self) -> str:
        """One paragraph: how many runs, how many sound, what varied, what went wrong."""
        state = "complete" if self.complete else "INTERRUPTED"
        lines = [f"{len(self.index)} runs ({state}), {int(self.ok.sum())} sound; varied: {', '.join(self.varied)}"]
        if not self.ok.all():
            blamed = [f"{name} {int((self.culprit == name).sum())}" for name in simulate.CULPRITS[1:]]
            lines.append("failed in: " + ", ".join(blamed))
        if self.errors:
            index, text = next(iter(self.errors.items()))
            lines.append(
                f"ended in an exception: {len(self.errors)}, the first run {index}: {text.strip().splitlines()[-1]}"
            )
        return "\n".join(lines)


def draw(sample: Callable[[int, int], Any], runs: int, seed: int) -> Any:
    """Dispersions of `runs` runs, leaves (runs, ...).

    Parameters
    ----------
    sample : ``sample(seed, index) -> pytree of numbers``, such as a NamedTuple. To give every run a stream of its
        own, draw from ``np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))``
    runs : number of runs
    seed : of the campaign

    Raises
    ------
    ScenarioError
        No runs.
    """
    if not isinstance(runs, int) or runs < 1:
        raise ScenarioError(f"runs = {runs!r}: give a whole number of at least 1")
    return blocks.join([sample(seed, index) for index in range(runs)])


def campaign(
    case: Case,
    dispersed: Any,
    shared: Any = None,
    *,
    measure: Callable[[Run], Any],
    read: Read | None = None,
    record: simulate.Record | None = None,
    seed: int = 0,
    keep: Sequence[int] = (),
    store: Path | str | None = None,
    resume: bool = False,
    batch: int | None = None,
    memory: int | None = None,
    workers: int | None = None,
    processes: bool = False,
    scheduler: str | None = None,
    compiled: bool | None = None,
    varying: Collection[str] = (),
    progress: bool = True,
    on_batch: Callable[[int], None] | None = None,
) -> Campaign:
    """Fly every dispersed case.

    Parameters
    ----------
    case : ``case(d, shared) -> (loop, scenario)`` for the dispersion d of one run; plain Python with concrete
        numbers. Pass what is expensive and common, such as the environment, in `shared`. The scenario's `seed`
        and `run` are set here.
    dispersed : pytree with leaves (runs, ...), see `draw`
    measure : ``measure(run) -> pytree of numbers`` kept for every run, for example `indices.indices`
    read : ``read(loop, scenario)`` returns the dispersion from the blocks that fly, shaped like d; it is compared
        with what was asked for. Without it the least is checked: that numbers vary at all if dispersions do.
    record : as in `simulate.simulate`
    seed : of the sensor noise
    keep : indices of runs whose trajectories are kept
    store : folder in which finished batches are kept on disk, see `store.Store`; what is there survives any end of
        this process
    resume : continue a store: what it holds is not flown again. It must be of the same study (hashes of the first
        cases, of the dispersions and of the code of case, measure, read and record; seed; versions), and a run of it,
        flown again, must come out as it did.
    batch : runs flown at once by one worker; by default as many as `memory` allows, 256 at most
    memory : bytes for the rows of all workers together, with their copies; by default 256 MiB, or what 8 runs take
    workers : threads or processes that fly batches at the same time, by default one for each processor, one thread
        for controllers that are stepped from Python
    processes : fly in processes instead of threads: better for controllers that are stepped from Python, and a
        process that dies loses nothing. `case`, `shared`, `measure` must be picklable by cloudpickle.
    scheduler : address of a Dask scheduler whose workers fly, instead of this machine; needs the extra "dask"
    compiled : as in `simulate.simulate`
    varying : paths of numbers to treat as different between runs even if they are not, so that this campaign flies the
        compiled program of another one: give ``other.varied``
    progress : show a bar if it takes more than two seconds
    on_batch : called with the number of finished runs after every batch

    Returns
    -------
    Campaign
        After Ctrl-C or SIGTERM the finished batches, with ``complete`` False. A run whose case, flight, `read` or
        `measure` raises an exception is in ``errors``, the others are not disturbed.

    Raises
    ------
    ScenarioError
        No runs, unusable numbers in the first cases (the message names the run), dispersions that did not reach the
        loop, first runs that all ended in an exception.
    StoreError
        The store is another study's, damaged, in use or cannot be written.
    EngineError
        The cluster cannot do the work.
    """
    runs = count(dispersed)
    for name, value in (("batch", 1 if batch is None else batch), ("memory", MEMORY if memory is None else memory)):
        if not isinstance(value, int) or value < 1:
            raise ScenarioError(f"{name} = {value!r}: give a whole number of at least 1")
    hands = engines.check(workers, processes, scheduler)
    flights, sampled = _flights(case, dispersed, shared, measure, read, record, seed, keep, compiled, varying)
    if workers is None and scheduler is None and not (flights.compiled or processes):
        hands = 1  # threads that step Python take turns: two need half as long again as one
    if batch is None:
        loop, scenario = sampled[0]
        row = simulate.row_bytes(loop, scenario, record)
        batch, hands = _width(runs, row, memory, hands)
    flights = _padded(flights, batch)

    def what() -> dict[str, Any]:
        return _described(flights, sampled, runs)

    with Bar(runs, shown=progress) as bar:
        conducted = conduct(
            flights, runs, dispersed,
            batch=batch, workers=hands, processes=processes, scheduler=scheduler, store=store, resume=resume, what=what,
            refly=flights.one, keep=sorted(flights.keep), bar=bar, on_batch=on_batch,
        )  # fmt: skip
    return _collect(conducted, dispersed)


def replay(
    case: Case,
    dispersed: Any,
    index: int,
    shared: Any = None,
    *,
    record: simulate.Record | None = None,
    seed: int = 0,
    compiled: bool | None = None,
    varying: Collection[str] = (),
) -> Run:
    """Run `index` of a campaign with all its rows, bit for bit as it was flown; arguments as of `campaign`.

    `simulate.simulate` flies it alone, which gives the same to rounding (3e-17 to 2e-13 seen).

    Raises
    ------
    ScenarioError
        As `campaign`.
    """
    runs = count(dispersed)
    if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < runs:
        raise ScenarioError(f"index = {index!r}: give a whole number from 0 to {runs - 1}")
    flights, _ = _flights(case, dispersed, shared, lambda run: 0, None, record, seed, (), compiled, varying)
    return flights.one(int(index))


def count(dispersed: Any) -> int:
    """Number of runs of `draw`n dispersions, the common length of their leaves.

    Raises
    ------
    ScenarioError
        No runs, arrays of different lengths, something that is no number.
    """
    blocks.register(dispersed)
    lengths = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(dispersed)}
    if len(lengths) != 1 or lengths <= {(), (0,)}:
        raise ScenarioError(
            f"dispersed has leading lengths {sorted(lengths)}: every array needs one row per run, at least one"
        )
    blocks.check_numbers(dispersed, "dispersed")
    return lengths.pop()[0]


def _flights(
    case: Case,
    dispersed: Any,
    shared: Any,
    measure: Any,
    read: Any,
    record: Any,
    seed: int,
    keep: Any,
    compiled: Any,
    apart: Any,
) -> tuple[Flights, list[Any]]:
    """The work of a campaign, eight lanes wide, and the first cases, which were checked."""
    runs = count(dispersed)
    sampled = [replay_case(case, dispersed, index, shared, seed) for index in range(min(runs, SAMPLE))]
    compiled = simulate.can_compile(*sampled[0]) if compiled is None else compiled
    varying = varied(sampled, compiled)
    if not varying and blocks.differing([at(dispersed, index) for index in range(len(sampled))]):
        raise ScenarioError("dispersed: no number of loop or scenario varies with it; use d in case(d, shared)")
    paths = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path(sampled[0])[0]}
    if unknown := sorted(set(apart) - paths):
        raise ScenarioError(f"varying: no number {unknown[0]!r} in (loop, scenario); such as {min(paths)!r}")
    flights = Flights(
        case=case, dispersed=dispersed, shared=shared, measure=measure, read=read, record=record, seed=seed,
        keep=frozenset(int(i) for i in keep), compiled=compiled, varying=varying, apart=frozenset(apart),
        lanes=LANE,
    )  # fmt: skip
    return flights, sampled


def _padded(flights: Flights, batch: int) -> Flights:
    """The same work in as many lanes as a batch needs, a multiple of eight."""
    return dataclasses.replace(flights, lanes=-(-batch // LANE) * LANE)


def _width(runs: int, row: int, memory: int | None, workers: int) -> tuple[int, int]:
    """Runs in a batch, even among the workers, and how many workers there is memory for."""
    least = LANE * COPIES * row
    if memory is not None and memory < least:
        raise ScenarioError(
            f"memory = {memory}: {LANE} runs of {row} bytes with their copies take {least}; give that much, or keep "
            "fewer rows (keep_every)"
        )
    room = max(MEMORY if memory is None else memory, least)
    workers = min(workers, max(1, room // least))
    widest = min(LANES, room // (COPIES * workers * row) // LANE * LANE)
    turns = -(-runs // (widest * workers))  # of all workers, with batches of even width
    even = -(-runs // (turns * workers))
    return min(widest, -(-even // LANE) * LANE), workers


def _described(flights: Flights, sampled: Sequence[Any], runs: int) -> dict[str, Any]:
    """What a campaign is, for its manifest."""
    loop, scenario = sampled[0]  # the others differ by their dispersions
    world = (loop.plant, loop.sensors, loop.navigator, loop.actuator, loop.delay, scenario)
    functions = {"case": flights.case, "measure": flights.measure, "read": flights.read, "record": flights.record}
    return {
        "what": "campaign",
        "study": f"{getattr(flights.case, '__module__', '')}.{getattr(flights.case, '__qualname__', flights.case)}",
        "runs": runs,
        "seed": flights.seed,
        "hashes": {
            "plant and scenario": identity.digest(world),
            "controller": identity.digest(loop.controller),
            "shared": identity.digest(flights.shared),
            "dispersions": identity.digest(jax.tree.leaves(flights.dispersed)),
            **{name: identity.digest(function) for name, function in functions.items()},
        },
        "code": {name: identity.source(function) for name, function in functions.items() if function is not None},
    }


def _collect(conducted: Conducted, dispersed: Any) -> Campaign:
    """The finished batches as one result."""
    parts = conducted.batches
    index = chained(parts, "index")
    return Campaign(
        index=index,
        ok=chained(parts, "ok"),
        failed_at=chained(parts, "failed_at"),
        culprit=chained(parts, "culprit"),
        results=chained(parts, "results"),
        dispersed=jax.tree.map(lambda leaf: np.asarray(leaf)[index], dispersed),
        applied=chained(parts, "applied"),
        varied=tuple(sorted(frozenset().union(*(part.varied for part in parts)))),
        kept={i: part.kept[i] for part in parts for i in sorted(part.kept)},
        complete=conducted.complete,
        errors={i: text for part in parts for i, text in sorted(part.errors.items())},
    )
