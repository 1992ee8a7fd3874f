"""The worst flight found by climbing against ten times as many random flights of the same box, four studies.

    python benchmarks/worst_flights.py [--seeds 3] [--study cubesat3u ...]

Both sides fly the same compiled program in batches of the same width, without compilation, which is named apart; times
are CPU seconds, because on a busy machine only those mean anything. The random flights are as many as it takes to be at
least ten times the flights of the search and three times its time. The objectives are those of the reports.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

sys.path.extend(map(str, (Path(__file__).resolve().parents[1] / "examples").iterdir()))

import airbearing as airbearing_study
import airbearing_worst
import amazonia1 as amazonia1_study
import amazonia1_worst
import cubesat3u as cubesat3u_study
import cubesat3u_worst
import geo_worst

import synth
from plants import amazonia1, draw, geo, worst_flights
from plants.outcome.worst import Question
from plants.simulation.sensitivity import Box, Response

STUDIES = ("cubesat3u", "amazonia1", "airbearing", "geo")


def question(name: str) -> Question:
    """That of the report."""
    if name == "cubesat3u":
        controller = synth.LinearController.of(cubesat3u_study.hinfinity().controller)
        return cubesat3u_worst.question(controller, cubesat3u_study.starts(1, 0))
    if name == "amazonia1":
        controllers = amazonia1_study.controllers(amazonia1_worst.PERIOD)
        return amazonia1_worst.question(controllers[amazonia1_study.LQR], draw(amazonia1.disperse, 1, 0))
    if name == "airbearing":
        gain = airbearing_study.configurations(airbearing_worst.DURATION)[airbearing_study.LQR].gain
        return airbearing_worst.question(synth.state_feedback(gain, airbearing_study.PERIOD), 1, 0)
    return geo_worst.question(geo.RATE, 1, 0)


def clocked(work: Callable[[], Any]) -> tuple[Any, float]:
    """Its result and CPU seconds."""
    start = time.process_time()
    return work(), time.process_time() - start


def compare(name: str, seeds: int, forward: bool) -> None:
    """One line for each seed."""
    q = question(name)

    def search(seed: int, **options: Any) -> Any:
        return worst_flights(
            q.case, q.box, q.objective, q.shared, seed=seed, forward=forward, progress=False, **options
        )  # fmt: skip

    _, first = clocked(lambda: search(0, flights=16, rounds=1))
    _, again = clocked(lambda: search(0, flights=16, rounds=1))
    space = Box.between(q.box)
    response = Response.of(
        q.case, q.shared, space, q.objective, record=None, compiled=None, forward=forward, memory=256 << 20
    )  # fmt: skip
    method = "forward mode" if forward else "differences"
    print(f"{name}, {len(space.names)} parameters, {method}: compiled in {first - again:.1f} CPU s", flush=True)
    for seed in range(seeds):
        found, spent = clocked(lambda seed=seed: search(seed))
        rng, best, runs, seconds = np.random.default_rng(1000 + seed), -np.inf, 0, 0.0
        while runs < 10 * found.flights or seconds < 3 * spent:
            points = rng.uniform(size=(response.lanes, len(space.names)))
            values, more = clocked(lambda points=points: response.values(points))
            best, runs, seconds = max(best, float(values.max())), runs + len(values), seconds + more
        tangents = f" and {found.tangents} tangents" if forward else ""
        print(
            f"  {q.unit}: found {found.value:.5g} by {found.flights} flights{tangents} in {spent:.2f} s; "
            f"random {best:.5g} by {runs} flights in {seconds:.2f} s; "
            f"worse by {found.value / best - 1:+.1%} in {spent / seconds:.2f} of the time",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--study", nargs="+", choices=STUDIES, default=STUDIES)
    options = parser.parse_args()
    for name in options.study:
        for forward in (True, False):
            compare(name, options.seeds, forward)


if __name__ == "__main__":
    main()
