"""Many dispersed runs of one case: bounded memory, results that depend on the run's index alone.

Run i draws its dispersion from the generator with SeedSequence(seed, spawn_key=(i,)) and its sensor noise from
(seed, i), so that neither batch size nor the number of workers changes a result, and any run can be flown again
alone with `replay_case`. Batches are cut so that their rows fit into a given memory; what `measure` makes of a run is
always kept, the run itself on request.
"""

import dataclasses
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import jax
import numpy as np
from tqdm import tqdm

from plants.errors import ScenarioError
from plants.simulation import blocks, simulate
from plants.simulation.loop import Loop, Run, Scenario, check_numbers

LANES = 256  # runs in a batch at most; beyond it a batch gains nothing
SAMPLE = 8  # runs looked at before the first batch, to see which numbers vary
RUN_INDEX = "[1].run"  # path of the run's index in (loop, scenario)

Case = Callable[[Any, Any], tuple[Loop, Scenario]]
Read = Callable[[Loop, Scenario], Any]


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

    def __str__(self) -> str:
        """One paragraph: how many runs, how many sound, what varied."""
        state = "complete" if self.complete else "INTERRUPTED"
        lines = [f"{len(self.index)} runs ({state}), {int(self.ok.sum())} sound; varied: {', '.join(self.varied)}"]
        blamed = [f"{name} {int((self.culprit == name).sum())}" for name in simulate.CULPRITS[1:]]
        return "\n".join(lines if self.ok.all() else [*lines, "failed in: " + ", ".join(blamed)])


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
    batch: int | None = None,
    memory: int = 256 << 20,
    workers: int = 2,
    compiled: bool | None = None,
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
    batch : runs flown at once by one worker; by default as many as `memory` allows, 256 at most
    memory : bytes for the rows of all workers together
    workers : threads that fly batches at the same time
    compiled : as in `simulate.simulate`
    progress : show a bar if it takes more than two seconds
    on_batch : called with the number of finished runs after every batch

    Returns
    -------
    Campaign
        After Ctrl-C the finished batches, with ``complete`` False.

    Raises
    ------
    ScenarioError
        No runs, unusable numbers (the message names the run), dispersions that did not reach the loop.
    """
    runs = count(dispersed)
    for name, value in (("batch", 1 if batch is None else batch), ("workers", workers), ("memory", memory)):
        if not isinstance(value, int) or value < 1:
            raise ScenarioError(f"{name} = {value!r}: give a whole number of at least 1")
    sampled = [replay_case(case, dispersed, index, shared, seed) for index in range(min(runs, SAMPLE))]
    if compiled is None:
        compiled = simulate.can_compile(*sampled[0])
    if batch is None:
        widest = int(np.clip(memory // (2 * workers * simulate.row_bytes(*sampled[0], record)), 1, LANES))
        turns = -(-runs // (widest * workers))  # of all workers, with batches of even width
        batch = -(-runs // (turns * workers))
    varied = _varied(sampled, compiled)
    if not varied and blocks.differing([_at(dispersed, index) for index in range(len(sampled))]):
        raise ScenarioError("dispersed: no number of loop or scenario varies with it; use d in case(d, shared)")

    def fly(chunk: range) -> _Batch:
        cases = [replay_case(case, dispersed, index, shared, seed) for index in chunk]
        own = _varied(cases, compiled)
        lanes = [*cases, *[cases[-1]] * (batch - len(cases))]  # one shape, one compilation
        flown = simulate.simulate_many(
            lanes, compiled=compiled, record=record, varying=varied | own | {RUN_INDEX}, progress=progress
        )[: len(cases)]
        return _Batch(
            chunk=chunk,
            fates=[(run.ok, np.nan if run.failed_at is None else run.failed_at, run.culprit) for run in flown],
            results=blocks.join([measure(run) for run in flown]),
            applied=None if read is None else _confirmed(read, cases, dispersed, chunk),
            varied=varied | own,
            kept={index: _copied(run) for index, run in zip(chunk, flown, strict=True) if index in keep},
        )

    done: list[_Batch] = []
    chunks = [range(a, min(a + batch, runs)) for a in range(0, runs, batch)]
    complete = False
    with tqdm(total=runs, desc="runs", delay=2.0, disable=not progress) as bar:
        try:
            with closing(_in_threads(fly, chunks, workers)) as flights:
                for flight in flights:
                    done.append(flight)
                    bar.update(len(flight.chunk))
                    if on_batch is not None:
                        on_batch(sum(len(flight.chunk) for flight in done))
            complete = True
        except KeyboardInterrupt:
            bar.write("interrupted: the finished runs are kept")
    return _collect(sorted(done, key=lambda flight: flight.chunk.start), dispersed, complete)


def replay_case(case: Case, dispersed: Any, index: int, shared: Any = None, seed: int = 0) -> tuple[Loop, Scenario]:
    """Loop and scenario of run `index` of a campaign, noise included: `simulate.simulate` flies it again.

    Raises
    ------
    ScenarioError
        The case cannot be built; the message names the run.
    """
    try:
        loop, scenario = case(_at(dispersed, index), shared)
    except ScenarioError as error:
        raise ScenarioError(f"run {index}: {error}") from error
    return loop, dataclasses.replace(scenario, seed=seed, run=index)


class _Batch(NamedTuple):
    """What one batch leaves behind."""

    chunk: range
    fates: list[tuple[bool, float, str]]  # ok, failed_at (s), culprit
    results: Any
    applied: Any
    varied: set[str]
    kept: dict[int, Run]


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


def _at(dispersed: Any, index: int) -> Any:
    """The dispersion of one run."""
    return jax.tree.map(lambda leaf: leaf[index], dispersed)


def _varied(cases: Sequence[tuple[Loop, Scenario]], compiled: bool) -> set[str]:
    """Paths of the numbers that differ between cases, apart from the run's index."""
    for loop, scenario in cases:
        check_numbers(loop, scenario)
    if not compiled:
        cases = [(dataclasses.replace(loop, controller=None), scenario) for loop, scenario in cases]
    return blocks.differing(cases) - {RUN_INDEX}


def _confirmed(read: Read, cases: Sequence[tuple[Loop, Scenario]], dispersed: Any, chunk: range) -> Any:
    """The dispersions read back from what flies, equal to those asked for."""
    applied = blocks.join([read(*pair) for pair in cases])
    asked = blocks.join([_at(dispersed, index) for index in chunk])
    if jax.tree.structure(applied) != jax.tree.structure(asked):
        raise ScenarioError("read must return the structure of one dispersion, one number for each asked for")
    for (path, flown), wanted in zip(
        jax.tree_util.tree_flatten_with_path(applied)[0], jax.tree.leaves(asked), strict=True
    ):
        wrong = ~np.isclose(flown, wanted, rtol=1e-9, atol=1e-12 * np.abs(wanted).max())
        if wrong.any():
            at = int(np.argwhere(wrong)[0][0])
            raise ScenarioError(
                f"dispersed{jax.tree_util.keystr(path)} was not applied in run {chunk[at]}: asked for {wanted[at]}, "
                f"flown with {flown[at]}"
            )
    return applied


def _copied(run: Run) -> Run:
    """A run that does not keep the memory of its batch."""
    arrays = ("time", "states", "outputs", "estimates", "references", "commands", "inputs", "extra")
    return dataclasses.replace(run, **{name: jax.tree.map(np.copy, getattr(run, name)) for name in arrays})


def _in_threads(
    work: Callable[[range], _Batch], chunks: Sequence[range], workers: int
) -> Generator[_Batch, None, None]:
    """Results as they come; compiled code leaves the interpreter free for the other threads."""
    waiting, pending = iter(chunks), set()
    with ThreadPoolExecutor(workers) as pool:
        try:
            while True:
                pending |= {pool.submit(work, chunk) for chunk in islice(waiting, workers - len(pending))}
                if not pending:
                    return
                finished, pending = wait(pending, timeout=0.5, return_when=FIRST_COMPLETED)
                for future in finished:
                    yield future.result()
        finally:
            for future in pending:
                future.cancel()


def _collect(done: Sequence[_Batch], dispersed: Any, complete: bool) -> Campaign:
    """The finished batches as one result."""
    index = np.array([i for flight in done for i in flight.chunk], int)
    fates = [fate for flight in done for fate in flight.fates]

    def chain(parts: list[Any]) -> Any:
        return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts) if parts else None

    return Campaign(
        index=index,
        ok=np.array([fate[0] for fate in fates], bool),
        failed_at=np.array([fate[1] for fate in fates], float),
        culprit=np.array([fate[2] for fate in fates], str),
        results=chain([flight.results for flight in done]),
        dispersed=jax.tree.map(lambda leaf: np.asarray(leaf)[index], dispersed),
        applied=chain([flight.applied for flight in done]),
        varied=tuple(sorted(set().union(*(flight.varied for flight in done)))),
        kept={i: run for flight in done for i, run in flight.kept.items()},
        complete=complete,
    )
