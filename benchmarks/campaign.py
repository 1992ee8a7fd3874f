"""What campaigns cost: the Monte Carlo of Amazonia-1 (both controllers of the paper), memory at 100 000 runs.

    python benchmarks/campaign.py [--runs 100] [--many 100000]

Each part runs in a process of its own, so that peak memory is its own. CPU seconds stand beside wall seconds, because
on a busy machine only the former mean anything. The memory part flies an LQR for 90 s and keeps every sample, which
makes as many rows as 1800 s with one row per second: batches and memory are those of the whole flight, only the time is
not. `benchmarks/sdre.py` has the ratios to a plain NumPy and SciPy loop.
"""

import argparse
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples" / "amazonia1"))

import amazonia1 as study

from plants import amazonia1, campaign


def case(start: Any, shared: Any) -> Any:
    """A flight with every sample kept."""
    return amazonia1.manoeuvre(start, shared.controller, duration=shared.duration)


def monte_carlo(name: str, runs: int, workers: int) -> dict[str, float]:
    """The runs of the CILAMCE paper with one controller, compilation included and apart."""
    shared = study.Shared(study.controllers()[name], amazonia1.DURATION)
    drawn = amazonia1.monte_carlo(runs)
    batch = -(-runs // 2)

    def fly(duration: float) -> tuple[float, float]:
        wall, cpu = time.perf_counter(), time.process_time()
        campaign(
            study.case, drawn, shared._replace(duration=duration), measure=study.measure, batch=batch,
            workers=workers, progress=False,
        )  # fmt: skip
        return time.perf_counter() - wall, time.process_time() - cpu

    first = fly(amazonia1.DURATION)
    later = fly(amazonia1.DURATION)
    steps = runs * round(amazonia1.DURATION / amazonia1.PERIOD)
    return {
        "seconds, compiled anew": first[0], "seconds": later[0], "CPU seconds": later[1],
        "samples/s": steps / later[0], "samples/CPU s": steps / later[1],
    }  # fmt: skip


def memory(runs: int) -> dict[str, float]:
    """As many initial conditions as asked for, in the batches of a whole flight."""
    shared = study.Shared(study.controllers()[study.LQR], 90.0)
    widths: list[int] = []
    wall = time.perf_counter()
    flown = campaign(
        case, amazonia1.starts(amazonia1.region(runs)), shared, measure=study.measure, read=amazonia1.applied,
        progress=False, on_batch=widths.append,
    )  # fmt: skip
    assert len(flown.index) == runs
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # kB on Linux
    return {"seconds": time.perf_counter() - wall, "runs in a batch": widths[0], "peak memory, GiB": peak}


def apart(work: Callable[..., dict[str, float]], *arguments: Any) -> dict[str, float]:
    """The result of a function that runs in a fresh process."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--many", type=int, default=100_000)
    options = parser.parse_args()

    def show(title: str, found: dict[str, float]) -> None:
        print(f"{title:48}" + "  ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)

    for name, workers in ((study.SDRE, 1), (study.SDRE, 2), (study.LITERAL, 2)):
        show(f"{name}, {options.runs} runs, {workers} threads", apart(monte_carlo, name, options.runs, workers))
    show(f"LQR, {options.many} initial conditions", apart(memory, options.many))


if __name__ == "__main__":
    main()
