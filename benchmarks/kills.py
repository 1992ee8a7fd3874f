"""A campaign that is killed two hundred times and yet is whole: nothing lost, nothing flown into it twice.

    python benchmarks/kills.py [--kills 200] [--runs 12000] [--seed 1]

12 000 short flights go into a store. Again and again the process that flies, or one of its workers, gets a SIGKILL or
a SIGTERM while it starts, while it flies or while it writes a chunk, and the campaign is resumed. When it is through,
every run must be there exactly once and be equal, bit for bit, to that of a campaign that nobody disturbed. A life is a
fork of this script that has imported all and done nothing, and finds its programs compiled: the time goes into flying.
"""

import argparse
import os
import random
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

import jax
import numpy as np
from dispersed import Damper, case, last, sample
from processes import workers

from plants.simulation import campaign
from plants.simulation.store import Store

BATCH = 16  # runs; many chunks
PAUSE = 0.02  # s after each chunk, or a slow killer would come too late
PATIENCE = 120.0  # s until a moment has come
MOMENTS = ("starting", "flying", "writing")


class Kill(NamedTuple):
    """Who gets which signal when."""

    worker: bool  # else the process that flies
    signal: signal.Signals
    moment: str


def drawn(rng: random.Random) -> Kill:
    """A kill; one in seven lives flies in processes."""
    return Kill(rng.random() < 1 / 7, rng.choice([signal.SIGKILL, signal.SIGKILL, signal.SIGTERM]), rng.choice(MOMENTS))


def remember(folder: Path) -> None:
    """Keep compiled programs in a folder, of this process and of those that it starts."""
    for name, value in (
        ("jax_compilation_cache_dir", str(folder)),
        ("jax_persistent_cache_min_compile_time_secs", 0),
        ("jax_persistent_cache_min_entry_size_bytes", -1),
    ):
        jax.config.update(name, value)
        os.environ[name.upper()] = str(value)


def fly(store: Path | None, dispersed: Any, processes: bool = False, pause: float = PAUSE) -> campaign.Campaign:
    """The campaign, or what is missing of it."""
    return campaign.campaign(
        case, dispersed, Damper(1.0), measure=last, batch=BATCH, workers=2, processes=processes, store=store,
        resume=True, progress=False, on_batch=lambda done: time.sleep(pause),
    )  # fmt: skip


def life(work: Callable[[], campaign.Campaign]) -> int:
    """The process id of a fork that does the work and ends with 0 if it was complete, 143 if not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # JAX has imported, but started no threads yet
        pid = os.fork()
    if pid:
        return pid
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)  # what killed processes say
    code = 1
    try:
        code = 0 if work().complete else 143
    finally:
        os._exit(code)


def ended(pid: int, wait: bool = False) -> int | None:
    """How a life ended, None if it lives."""
    got, status = os.waitpid(pid, 0 if wait else os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if got else None


def moment(kill: Kill, pid: int, chunks: Path, share: float, rng: random.Random) -> int | None:
    """Wait for the moment of a kill; how the life ended, if it did before."""
    begun, before = time.monotonic(), len(list(chunks.glob("*.parquet")))
    delay, wanted = rng.uniform(0, 3), before + rng.uniform(0.5, 1.5) * share
    while time.monotonic() - begun < PATIENCE:
        code = ended(pid)
        if code is not None:
            return code
        if kill.moment == "starting" and time.monotonic() - begun > delay:
            break
        if kill.moment != "starting" and len(list(chunks.glob("*.parquet"))) >= wanted:
            if kill.moment == "flying":
                time.sleep(rng.uniform(0, 0.05))
                break
            if any(chunks.glob(".*.partial")):
                break
        time.sleep(0 if kill.moment == "writing" else 0.002)
    return None


def disturbed(folder: Path, dispersed: Any, kills: int, rng: random.Random) -> tuple[Counter, int, int]:
    """Kills that were done, lives, and chunks that were found damaged."""
    done, lives, chunks = Counter(), 0, folder / "chunks"
    todo = -(-len(dispersed.length) // BATCH)
    while True:
        kill = drawn(rng)
        pid = life(lambda kill=kill: fly(folder, dispersed, processes=kill.worker))
        lives += 1
        code = None
        while code is None and done.total() < kills:
            share = (todo - len(list(chunks.glob("*.parquet")))) / (kills - done.total() + 1)
            code = moment(kill, pid, chunks, share, rng)
            if code is not None:
                break
            at = rng.choice(workers(pid) or [pid]) if kill.worker else pid
            try:
                os.kill(at, kill.signal)
            except ProcessLookupError:
                continue
            who = "process" if at == pid else "worker"
            done[f"{who}, {kill.signal.name}, {kill.moment}"] += 1
            if done.total() % 20 == 0:
                print(f"{done.total()} kills, {len(list(chunks.glob('*.parquet')))} of {todo} chunks", file=sys.stderr)
            if at == pid:
                code = ended(pid, wait=True)
            kill = drawn(rng)._replace(worker=kill.worker and rng.random() < 0.8)
        code = ended(pid, wait=True) if code is None else code
        if code not in (0, 143, -signal.SIGKILL, -signal.SIGTERM):
            raise SystemExit(f"life {lives} ended with {code}")
        if code == 0 and done.total() >= kills:
            return done, lives, len(list(chunks.glob("*.damaged")))


def compared(store: Store, alone: Store) -> tuple[int, int, int]:
    """Runs that are lost, doubled, and otherwise than undisturbed."""
    files = sorted((store.folder / "chunks").glob("*.parquet"))
    counted = Counter(int(i) for path in files for i in store._read(path, ["index"]).column("index").to_numpy())
    one, other = store.columns(), alone.columns()
    assert one.keys() == other.keys()
    differs = np.zeros(len(other["index"]), bool)
    for name in other if len(one["index"]) == len(other["index"]) else ():
        a, b = (np.ascontiguousarray(columns[name]).reshape(len(differs), -1) for columns in (one, other))
        differs |= (a.view(np.uint8) != b.view(np.uint8)).reshape(len(differs), -1).any(1)
    return len(other["index"]) - len(counted), sum(n - 1 for n in counted.values()), int(differs.sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--runs", type=int, default=12_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    dispersed = campaign.draw(sample, options.runs, 5)
    with tempfile.TemporaryDirectory() as folder:
        remember(Path(folder) / "programs")
        begun = time.monotonic()
        if ended(life(lambda: fly(Path(folder) / "alone", dispersed, pause=0.0)), wait=True):
            raise SystemExit("the undisturbed campaign did not end")
        alone = time.monotonic() - begun
        begun = time.monotonic()
        done, lives, damaged = disturbed(Path(folder) / "killed", dispersed, options.kills, random.Random(options.seed))
        took = time.monotonic() - begun
        lost, doubled, other = compared(Store(Path(folder) / "killed"), Store(Path(folder) / "alone"))
    for name, number in sorted(done.items()):
        print(f"{number:5} {name}")
    print(f"{done.total()} kills, {lost} lost, {doubled} doubled")
    print(f"{other} runs otherwise than undisturbed, {damaged} chunks damaged")
    print(f"{options.runs} runs in {lives} lives and {took:.0f} s; undisturbed {alone:.0f} s")
    sys.exit(bool(lost or doubled or other))


if __name__ == "__main__":
    main()
