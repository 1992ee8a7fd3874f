"""What campaigns cost: the Monte Carlo of Amazonia-1 (both controllers of the paper), many flights, memory, engines.

    python benchmarks/campaign.py [--runs 100] [--many 100000] [--period 0.5]

Each part runs in a process of its own, so that peak memory is its own. CPU seconds stand beside wall seconds, because
on a busy machine only the former mean anything. The part of many flies the initial conditions of the region of
attraction for the study's 1800 s with an LQR, by threads and by processes, into a store: runs per second, the largest
memory of the process and of one of its workers, the size on disk, and what a million would take. The MPC of the
CubeSat, stepped from Python, shows what processes are for. `benchmarks/sdre.py` has the ratios to a plain NumPy and
SciPy loop.
"""

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples" / "amazonia1"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples" / "cubesat3u"))

import amazonia1 as study
import cubesat3u

import plants.missions.cubesat3u
from plants import Store, amazonia1, campaign


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


def peak(who: int) -> float:
    """Largest memory so far of this process, or of one of its children, GiB."""
    return resource.getrusage(who).ru_maxrss / 2**20  # kB on Linux


def many(runs: int, period: float, processes: bool) -> dict[str, float]:
    """As many initial conditions as asked for, whole flights into a store."""
    shared = study.Shared(study.controllers(period)[study.LQR], amazonia1.DURATION)
    starts = amazonia1.starts(amazonia1.region(runs))
    before = peak(resource.RUSAGE_SELF)
    with tempfile.TemporaryDirectory() as folder:
        wall, cpu = time.perf_counter(), cpu_seconds()
        flown = campaign(
            study.case, starts, shared, measure=study.measure, read=amazonia1.applied, store=folder,
            processes=processes, progress=False,
        )  # fmt: skip
        wall, cpu = time.perf_counter() - wall, cpu_seconds() - cpu
        assert flown.complete
        assert len(flown.index) == len(Store(folder).index) == runs
        size = sum(path.stat().st_size for path in Path(folder).rglob("*.parquet"))
    return {
        "runs/s": runs / wall, "runs/CPU s": runs / cpu, "a million, h": 1e6 / runs * wall / 3600,
        "GiB before": before, "GiB": peak(resource.RUSAGE_SELF), "GiB of a worker": peak(resource.RUSAGE_CHILDREN),
        "MB on disk": size / 1e6,
    }  # fmt: skip


def stepped(runs: int, processes: bool) -> dict[str, float]:
    """Flights of 100 s whose controller is a quadratic program, stepped from Python."""
    _, controllers = cubesat3u.design_controllers()
    surroundings = plants.missions.cubesat3u.environment(100.0)
    shared = cubesat3u.Shared(surroundings, controllers["MPC velocity"], plants.missions.cubesat3u.ekf(), 200)
    wall = time.perf_counter()
    campaign(
        cubesat3u.case, cubesat3u.starts(runs - 1, 0), shared, measure=final, processes=processes, batch=16,
        progress=False,
    )  # fmt: skip
    return {"seconds, compilation included": time.perf_counter() - wall}


def final(run: Any) -> Any:
    """The last output."""
    return run.outputs[-1]


def cpu_seconds() -> float:
    """Of this process and of its children that have ended."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def apart(work: Callable[..., dict[str, float]], *arguments: Any) -> dict[str, float]:
    """The result of a function that runs in a fresh process."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(work, *arguments).result()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--many", type=int, default=100_000)
    parser.add_argument("--period", type=float, default=0.5, help="of control in the part of many, s")
    options = parser.parse_args()

    def show(title: str, found: dict[str, float]) -> None:
        print(f"{title:48}" + "  ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)

    for name, workers in ((study.SDRE, 1), (study.SDRE, 2), (study.LITERAL, 2)):
        show(f"{name}, {options.runs} runs, {workers} threads", apart(monte_carlo, name, options.runs, workers))
    for processes in (False, True):
        engine = "processes" if processes else "threads"
        show(f"LQR, {options.many} flights, {engine}", apart(many, options.many, options.period, processes))
        show(f"CubeSat, MPC, 64 flights, {engine}", apart(stepped, 64, processes))


if __name__ == "__main__":
    main()
