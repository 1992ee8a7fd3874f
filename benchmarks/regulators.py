"""Regulators and Riccati equations beside python-control and SLICOT, CPU time, in one process.

    python benchmarks/regulators.py

lqr       of a CubeSat (n = 6) over python-control's `lqr`, which calls SLICOT
first     one `care` of order 12 in a fresh process: nothing is compiled, JAX is not imported
batch     512 equations by `care` and `dare` over slycot's sb02md one after another, without building its arguments

Targets: lqr at most 2, first at most 2 ms, batches at most 1. Measured on one core: lqr 1.7 to 1.95; first 1.5 to 1.7
ms; batches .6 to 1.0 but for care at n = 2 (.8 to 1.3), dare at n = 20 and 30 (1.05 to 1.2) and, with one weighted
direction, care at n = 30 (1.0 to 1.2) and dare at n = 30 (2.0 to 2.5): doubling from nothing starts poorly where
unstable modes are hardly seen.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial

import control
import numpy as np
import slycot

from synth import care, dare, lqr

FIRST = """
import sys, time, numpy as np
from synth import care
rng = np.random.default_rng(0)
A, B, Q = rng.standard_normal((12, 12)), rng.standard_normal((12, 4)), np.eye(12)
start = time.perf_counter()
assert care(A, B, Q).ok
print(1e3 * (time.perf_counter() - start), "jax" in sys.modules)
"""


def best(function: Callable[[], object], count: int, repeats: int = 7) -> float:
    """Least CPU time of one call, s."""
    function()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(count):
            function()
        times.append((time.process_time() - start) / count)
    return min(times)


def cubesat() -> tuple[np.ndarray, ...]:
    """Attitude and rate about three axes with gravity gradient, unit weights."""
    inertia = np.diag([0.01, 0.02, 0.015])
    coupling = 1e-3 * np.arange(9).reshape(3, 3)
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-1e-6 * np.eye(3), coupling]])
    return A, np.vstack([np.zeros((3, 3)), np.linalg.inv(inertia)]), np.eye(6), np.eye(3)


def single() -> None:
    """One regulator, and the first equation of a process."""
    problem = cubesat()
    ours, theirs = best(lambda: lqr(*problem), 300), best(lambda: control.lqr(*problem), 300)
    print(f"lqr n = 6    {1e6 * ours:8.0f} us {1e6 * theirs:8.0f} us   ratio {ours / theirs:5.2f}")
    runs = [subprocess.run([sys.executable, "-c", FIRST], capture_output=True, text=True, check=True) for _ in range(3)]
    first = min(float(run.stdout.split()[0]) for run in runs)
    print(f"first care, n = 12   {first:6.2f} ms, JAX imported: {runs[0].stdout.split()[1]}")


def batches(count: int = 512) -> None:
    """Many equations at once."""
    rng = np.random.default_rng(0)
    for n in (2, 4, 6, 9, 12, 20, 30):
        A, B = rng.standard_normal((count, n, n)), rng.standard_normal((count, n, max(n // 2, 1)))
        G = B @ B.mT
        for rank in (1, n):
            C = rng.standard_normal((count, rank, n))
            Q = C.mT @ C
            for door, kind, size in ((care, "C", 1.0), (dare, "D", 0.6)):
                ours = best(partial(door, size * A, B, Q), 1, 3)
                given = [(n, a.copy(), g, q, kind) for a, g, q in zip(size * A, G, Q, strict=True)]
                start = time.process_time()
                for arguments in given:
                    slycot.sb02md(*arguments, sort="S" if kind == "C" else "U")
                theirs = time.process_time() - start
                each, other = 1e6 * ours / count, 1e6 * theirs / count
                print(f"{door.__name__} n = {n:2} rank {rank:2} {each:8.1f} us {other:8.1f} us   {ours / theirs:5.2f}")


if __name__ == "__main__":
    single()
    batches()
