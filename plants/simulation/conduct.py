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
from plants.simulation.batch import Batch, form
from plants.simulation.loop import Run
from plants.simulation.progress import Bar
from plants.simulation.store import Store

FEW = 8  # runs: when so many have ended in an exception, and no other in anything else, the mistake is in all of them


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
        The first eight runs, or all, ended in an exception.
    """
    done: list[Batch] = []
    complete = False
    with contextlib.ExitStack() as stack:
        signals = stack.enter_context(terminable())
        try:
            opened = None
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
                    _check_some_sound([*done, part], count)
                    with signals.later():
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


class Signals:
    """What came of SIGTERM and Ctrl-C: `Terminated` or KeyboardInterrupt, at once or when it does no harm."""

    def __init__(self) -> None:
        self._come: type[KeyboardInterrupt] | None = None
        self._later = False

    def __call__(self, number: int, _: Any) -> None:
        """The handler."""
        again = self._come is not None
        self._come = Terminated if number == signal.SIGTERM else KeyboardInterrupt
        if not self._later and not (again and number == signal.SIGTERM):  # it is ending already
            raise self._come

    @contextlib.contextmanager
    def later(self) -> Iterator[None]:
        """A finished batch is stored and counted, or neither; one that came before and was swallowed is told too."""
        self._later = True
        try:
            yield
        finally:
            self._later = False
        if self._come is not None:
            raise self._come


@contextlib.contextmanager
def terminable() -> Iterator[Signals]:
    """SIGTERM and Ctrl-C are told to `Signals` meanwhile, where nobody else handles them."""
    told, usual = Signals(), {signal.SIGTERM: signal.SIG_DFL, signal.SIGINT: signal.default_int_handler}
    main = threading.current_thread() is threading.main_thread()
    own = {number: before for number, before in usual.items() if main and signal.getsignal(number) == before}
    for number in own:
        signal.signal(number, told)
    try:
        yield told
    finally:
        for number, before in own.items():
            signal.signal(number, before)


def _check_some_sound(parts: Sequence[Batch], count: int) -> None:
    """Raise ScenarioError where the first runs all ended in an exception: it is not theirs."""
    errors = {index: text for part in parts for index, text in part.errors.items()}
    if len(errors) >= min(FEW, count) and not any(len(part.index) for part in parts):
        index = min(errors)
        raise ScenarioError(
            f"every one of the first {len(errors)} runs ended in an exception; run {index}:\n{errors[index]}"
        )


def _from(store: Store, work: Callable[[Sequence[int]], Batch], refly: Any, keep: Sequence[int]) -> list[Batch]:
    """What a store holds, after one of its runs was flown again and came out the same."""
    table = store.table()
    if not len(table):
        return []
    first = records.first_sound(table)
    if first is None:
        return [NOTHING._replace(errors=records.errors(table))]
    again = work([first])
    stored = records.read(store, table, again)
    records.check_again(store, stored, again)
    wanted = [int(index) for index in stored.index if index in set(keep)]
    if refly is not None and wanted:
        like, kept = refly(first), set(store.kept)
        for index in wanted:
            if index not in kept:
                records.write_run(store, index, refly(index))
            stored.kept[index] = records.read_run(store, index, like)
    return [stored]


def _lost(chunk: Sequence[int], lost: engines.Lost) -> Batch:
    """A batch of which nothing came back."""
    return NOTHING._replace(errors=dict.fromkeys(chunk, lost.reason))


def _of_one_form(part: Batch, done: Sequence[Batch]) -> Batch:
    """The batch, if its results can stand in one array with those of the others; else all of its runs have failed."""
    first = next((other for other in done if len(other.index)), None)
    if first is None or not len(part.index):
        return part
    (structure, now, text), (wanted, then, texts) = form(part.results), form(first.results)
    shapes, others = [s[1:] for s in now], [s[1:] for s in then]
    if (structure, shapes, text) == (wanted, others, texts):
        return part
    text = f"measure returned shapes {shapes}, for run {first.index[0]} {others}: return one form"
    return NOTHING._replace(errors={**part.errors, **{int(i): text for i in part.index}})
