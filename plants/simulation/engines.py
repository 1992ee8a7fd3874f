"""Where the work of a campaign is done: threads or processes of this machine, or the workers of a Dask cluster.

All three take a function of a chunk, and chunks of indices, and give (chunk, what came of it) as they come. A process
that dies, by SIGKILL or for want of memory, takes nothing along but what it was just working on, which is given to
another; a chunk that ends its process again and again, also alone, comes back as `Lost`.
"""

import contextlib
import functools
import os
import platform
import queue
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import islice
from typing import Any, NamedTuple, TypeVar

import jax

from plants.errors import EngineError, ScenarioError
from plants.simulation import versions

T = TypeVar("T")
Chunk = Sequence[int]
Work = Callable[[Chunk], T]
Outcomes = Generator[tuple[Chunk, Any], None, None]

TRIES = 5  # processes that a chunk may end before it is given up
PATIENCE = 30.0  # s, for a scheduler to answer and for its first worker
ABSENCE = 300.0  # s, for another worker when there is none any more
IDLE = 10  # s, after which a process without work ends
AHEAD = 3  # chunks in flight for each worker of a cluster


class Lost(NamedTuple):
    """A chunk that ended every process that worked on it."""

    reason: str


def check(workers: int | None, processes: bool, scheduler: str | None) -> int:
    """The number of workers, by default one for each processor that this process may use.

    Raises
    ------
    ScenarioError
        Not a whole number of at least 1, or both processes and a scheduler asked for.
    """
    if processes and scheduler is not None:
        raise ScenarioError(f"scheduler = {scheduler!r} and processes = True: give one of them")
    if workers is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ScenarioError(f"workers = {workers!r}: give a whole number of at least 1")
    return workers


def carry_out(
    work: Work[T], chunks: Sequence[Chunk], *, workers: int, processes: bool = False, scheduler: str | None = None
) -> Outcomes:
    """(chunk, its result or `Lost`) of every chunk, in the order in which they end.

    Parameters
    ----------
    work : picklable by cloudpickle, with what it encloses, unless threads do it
    chunks : what the function is called with, one after another
    workers : threads or processes of this machine; a cluster has its own
    processes : processes instead of threads
    scheduler : address of a Dask scheduler, such as "tcp://127.0.0.1:8786"

    Raises
    ------
    EngineError
        The cluster does not answer, has no worker, other versions, or was lost; work that cannot be pickled.
    """
    if scheduler is not None:
        return _on_cluster(work, chunks, scheduler)
    return _in_processes(work, chunks, workers) if processes else _in_threads(work, chunks, workers)


def _in_threads(work: Work[T], chunks: Sequence[Chunk], workers: int) -> Outcomes:
    """Compiled code leaves the interpreter free for the other threads."""
    waiting, pending = iter(chunks), {}
    with ThreadPoolExecutor(workers) as pool:
        try:
            while True:
                pending |= {pool.submit(work, chunk): chunk for chunk in islice(waiting, workers - len(pending))}
                if not pending:
                    return
                for future in wait(pending, timeout=0.5, return_when=FIRST_COMPLETED).done:
                    yield pending.pop(future), future.result()
        finally:
            for future in pending:
                future.cancel()


def _in_processes(work: Work[T], chunks: Sequence[Chunk], workers: int) -> Outcomes:
    """Processes of loky: they need no guard in the caller's script, and end when this one does."""
    from loky.process_executor import BrokenProcessPool, ProcessPoolExecutor

    payload, waiting, tries = _pickled(work), list(reversed(chunks)), {}

    def pool() -> Any:
        return ProcessPoolExecutor(workers, timeout=IDLE, initializer=_settle_in, initargs=(os.getpid(), payload))

    suspects: list[Chunk] = []  # of having ended a process; one at a time, so that it is known which
    executor = pool()
    pending: dict[Future, Chunk] = {}
    try:
        while waiting or suspects or pending:
            try:
                while len(pending) < (workers if waiting else 1) and (waiting or suspects):
                    line = waiting or suspects
                    pending[executor.submit(_called, line[-1])] = line[-1]
                    line.pop()
                for future in wait(pending, timeout=0.5, return_when=FIRST_COMPLETED).done:
                    outcome = future.result()
                    yield pending.pop(future), outcome
            except BrokenProcessPool as broken:
                alone = len(pending) == 1
                for future, chunk in pending.items():
                    if future.done() and not future.exception():
                        yield chunk, future.result()
                        continue
                    tries[chunk[0]] = tries.get(chunk[0], 0) + alone
                    if tries[chunk[0]] >= TRIES:
                        yield chunk, Lost(f"{TRIES} worker processes ended while it was worked on: {_reason(broken)}")
                    else:
                        suspects.append(chunk)
                pending.clear()
                executor.shutdown(wait=False, kill_workers=True)
                executor = pool()
    finally:
        executor.shutdown(wait=not pending, kill_workers=bool(pending))


def _on_cluster(work: Work[T], chunks: Sequence[Chunk], address: str) -> Outcomes:
    """Workers of a cluster; what one of them was working on when it died is given to another."""
    try:
        import distributed
    except ImportError as missing:
        raise EngineError(f"scheduler = {address!r} needs Dask: pip install 'convex-synth[dask]'") from missing
    payload, here = _pickled(work), tuple(versions.of_packages().items())
    try:
        client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        raise EngineError(
            f"scheduler = {address!r} does not answer: start one with `dask scheduler`, which prints its address"
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise EngineError(
                f"scheduler = {address!r} has no worker after {PATIENCE:g} s: start one with `dask worker {address}`"
            ) from error
        try:
            _ask_all(client, here, address)
            # a task, which can be done again; scattered data is lost with its worker
            shared = client.submit(_itself, payload)
            waiting, pending, tries, seen = iter(chunks), {}, {}, time.monotonic()
            ended: queue.SimpleQueue[Any] = queue.SimpleQueue()  # futures

            def give(chunk: Chunk) -> None:
                future = client.submit(_called_there, shared, here, chunk, pure=False)
                pending[future] = chunk
                future.add_done_callback(ended.put)

            while True:
                hands = len(client.scheduler_info(n_workers=-1)["workers"])
                seen = time.monotonic() if hands else seen
                if time.monotonic() - seen > ABSENCE:
                    raise EngineError(
                        f"scheduler = {address!r} has had no worker for {ABSENCE:g} s: start one with `dask worker "
                        f"{address}`, then resume; what was flown by then is in the store"
                    )
                for chunk in islice(waiting, max(0, AHEAD * max(1, hands) - len(pending))):
                    give(chunk)
                if not pending:
                    return
                try:
                    future = ended.get(timeout=2.0)
                except queue.Empty:
                    continue  # there may be more workers now
                chunk = pending.pop(future)
                try:
                    outcome = future.result()
                except distributed.KilledWorker as killed:
                    tries[chunk[0]] = tries.get(chunk[0], 0) + 1
                    if tries[chunk[0]] < 2:
                        give(chunk)
                        continue
                    outcome = Lost(f"the workers that worked on it ended: {_reason(killed)}")
                yield chunk, outcome
        except ImportError as error:
            raise _foreign(address) from error
        except (distributed.CancelledError, OSError) as error:
            raise EngineError(
                f"scheduler = {address!r} was lost: what was flown by then is in the store; start the scheduler again "
                "and resume, here or there"
            ) from error


def _ask_all(client: Any, here: tuple[tuple[str, str], ...], address: str) -> None:
    """Raise EngineError where a worker would compute with other packages."""
    for worker, answer in client.run(_mismatch, here, on_error="return").items():
        if isinstance(answer, str) and answer:
            raise EngineError(f"worker {worker} {answer}")
        if isinstance(answer, Exception) and not isinstance(answer, OSError):  # which is a worker that ends just now
            raise _foreign(address) from answer


def _foreign(address: str) -> EngineError:
    return EngineError(f"scheduler = {address!r}: its workers cannot import plants: install convex-synth there")


def _mismatch(here: tuple[tuple[str, str], ...]) -> str:
    """In a worker: what it has in other versions than the machine that asks, "" if nothing."""
    theirs = versions.of_packages()
    other = [f"{name} {theirs.get(name)}, this machine {version}" for name, version in here if theirs[name] != version]
    advice = "results would differ; install the same versions, see requirements/run.txt"
    return f"has {'; '.join(other)}: {advice}" if other else ""


def _pickled(work: Any) -> bytes:
    import cloudpickle

    if "__mp_main__" in sys.modules:  # the caller's script in a process of its own, which no other can import
        cloudpickle.register_pickle_by_value(sys.modules["__mp_main__"])

    try:
        return cloudpickle.dumps(work)
    except Exception as error:
        raise EngineError(
            f"case, shared or measure cannot be sent to another process ({type(error).__name__}: {error}): "
            "use threads, or build what cannot be pickled inside case"
        ) from error


def _itself(payload: bytes) -> bytes:
    return payload


_payload = b""  # of this process, if it works for `_in_processes`


def _called(chunk: Chunk) -> Any:
    """In a process of ours: the work on one chunk."""
    return _unpickled(_payload)(chunk)


def _called_there(payload: bytes, here: tuple[tuple[str, str], ...], chunk: Chunk) -> Any:
    """In a worker of a cluster, which may have come later than the others: the same."""
    if other := _mismatch(here):
        raise EngineError(f"worker {platform.node()} {other}")
    return _unpickled(payload)(chunk)


_unpickling = threading.Lock()  # a worker of a cluster has several threads


def _unpickled(payload: bytes) -> Any:
    """The work; once in a process, so that its blocks stay the same objects."""
    with _unpickling:
        return _loaded(payload)


@functools.lru_cache(maxsize=2)
def _loaded(payload: bytes) -> Any:
    import cloudpickle

    try:
        with jax.enable_x64(True):  # or arrays of JAX would come out with 7 digits
            return cloudpickle.loads(payload)
    except Exception as error:
        raise EngineError(
            f"case, shared or measure cannot be had in another process ({type(error).__name__}: {error}): make their "
            "module importable there (PYTHONPATH of the workers), or build what cannot be pickled inside case"
        ) from error


def _settle_in(parent: int, payload: bytes) -> None:
    """In a new process: Ctrl-C is for the parent, without which there is nothing to do."""
    import signal

    global _payload
    _payload = payload
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _reason(error: BaseException) -> str:
    with contextlib.suppress(Exception):
        return str(error).strip().splitlines()[0][:200]
    return type(error).__name__
