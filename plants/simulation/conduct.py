"""How a campaign or a sweep is carried through: engine, store, progress, interruption.

What it takes is a function that makes a `Batch` of some indices. A batch is stored when it arrives; Ctrl-C and SIGTERM
end the flights, not the program; SIGKILL takes what was not stored yet.
"""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks, engines, records
from plants.simulation.flights import Batch, form
from plants.simulation.loop import Run
from plants.simulation.progress import Bar
from plants.simulation.store import Store


class Conducted(NamedTuple):
    """Batches in the order of their first index, and whether that is all."""

    batches: list[Batch]
    complete: bool


_none = np.zeros(0)
NOTHING = Batch(_none.astype(int), _none.astype(bool), _none, _none.astype(str), None, None, frozenset(), {}, {})


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems and shutdowns send, ends flights as Ctrl-C does."""


def conduct(
    work: Callable[[Sequence[int]], Batch],
    count: int,
    dispersed: Any,
    *,
    batch: int,
    workers: int,
    processes: bool = False,
    scheduler: str | None = None,
    store: Path | str | None = None,
    resume: bool = False,
    what: Callable[[], Mapping[str, Any]],
    refly: Callable[[int], Run] | None = None,
    keep: Sequence[int] = (),
    bar: Bar,
    on_batch: Callable[[int], None] | None = None,
) -> Conducted:
    """Batches of all indices below `count`, those from the store among them.

    Parameters
    ----------
    work : makes a batch; `engines.carry_out` says where
    dispersed : pytree (count, ...) that is written beside the results
    what : makes the manifest's description; called if there is a store
    refly : one run, for trajectories in `keep` that the store has not

    Raises
    ------
    StoreError, EngineError
        As `Store.writing` and `engines.carry_out`.
    ScenarioError
        All runs of the first batch ended in an exception.
    """
    done: list[Batch] = []
    complete = False
    with contextlib.ExitStack() as stack:
        stack.enter_context(terminable())
        opened = None
        try:
            if store is not None:
                opened = stack.enter_context(Store.writing(store, what(), resume=resume))
                for line in opened.damaged:
                    bar.tell(line)
                done += _from(opened, work, refly, keep)
            flown = {int(i) for part in done for i in (*part.index, *part.errors)}
            bar.already(len(flown))
            missing = [index for index in range(count) if index not in flown]
            chunks = [missing[a : a + batch] for a in range(0, len(missing), batch)]
            found = engines.carry_out(work, chunks, workers=workers, processes=processes, scheduler=scheduler)
            with closing(found) as outcomes:
                for chunk, outcome in outcomes:
                    part = _of_one_form(_lost(chunk, outcome) if isinstance(outcome, engines.Lost) else outcome, done)
                    if not len(part.index) and not any(len(other.index) for other in done) and part.errors:
                        index, text = next(iter(part.errors.items()))
                        raise ScenarioError(f"every run of the first batch ended in an exception; run {index}:\n{text}")
                    if opened is not None and not isinstance(outcome, engines.Lost):
                        records.write(opened, part, dispersed)
                    done.append(part)
                    bar.update(len(chunk))
                    if on_batch is not None:
                        on_batch(sum(len(other.index) + len(other.errors) for other in done))
            complete = True
        except KeyboardInterrupt:
            safe = f"in {store}: resume to fly the others" if store is not None else "kept"
            bar.tell(f"interrupted: the finished runs are {safe}")
    return Conducted(sorted(done, key=lambda part: min([*part.index, *part.errors], default=0)), complete)


def chained(batches: Sequence[Batch], name: str) -> Any:
    """A field of all batches as one, rows in the order of the index; None where no batch has it."""
    sound = [part for part in batches if len(part.index)]
    if not sound:
        return getattr(NOTHING, name)
    order = np.argsort(np.concatenate([part.index for part in sound]))
    fields = [getattr(part, name) for part in sound]
    blocks.register(fields[0])
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[order], *fields)


@contextlib.contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM raises `Terminated` meanwhile, where nobody else handles it."""
    own = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL

    def end(*_: Any) -> None:
        raise Terminated

    if own:
        signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        if own:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _from(store: Store, work: Callable[[Sequence[int]], Batch], refly: Any, keep: Sequence[int]) -> list[Batch]:
    """What a store holds, after one of its runs was flown again and came out the same."""
    if not len(store.index):
        return []
    first = records.first_sound(store)
    if first is None:
        return [NOTHING._replace(errors=records.errors(store))]
    again = work([first])
    records.check_again(store, again)
    stored = records.read(store, again)
    wanted = [int(index) for index in stored.index if index in set(keep)]
    if refly is not None and wanted:
        like, kept = refly(first), set(store.kept)
        for index in wanted:
            stored.kept[index] = records.read_run(store, index, like) if index in kept else refly(index)
    return [stored]


def _lost(chunk: Sequence[int], lost: engines.Lost) -> Batch:
    """A batch of which nothing came back."""
    return NOTHING._replace(errors=dict.fromkeys(chunk, lost.reason))


def _of_one_form(part: Batch, done: Sequence[Batch]) -> Batch:
    """The batch, if its results can stand in one array with those of the others; else all of its runs have failed."""
    first = next((other for other in done if len(other.index)), None)
    if first is None or not len(part.index):
        return part
    (structure, now), (wanted, then) = form(part.results), form(first.results)
    if structure == wanted and [s[1:] for s in now] == [s[1:] for s in then]:
        return part
    shapes, others = [s[1:] for s in now], [s[1:] for s in then]
    text = f"measure returned shapes {shapes}, for run {first.index[0]} {others}: return one form"
    return NOTHING._replace(errors={**part.errors, **{int(i): text for i in part.index}})
