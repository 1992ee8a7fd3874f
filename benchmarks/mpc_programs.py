"""Random predictive programs against exact optima: python benchmarks/mpc_programs.py [FIRST LAST]

Unstable modes to 1.5 a sample, horizons to 100, both forms, delays, soft limits (`tests/exactmpc.py`). The first
command of each is compared with the optimum in long arithmetic: the largest difference in units of the limits, how many
were wrong (above 1e-7), reported as a NumericalError, or not decided because the reference gave up, and how many were
answered by another route than DAQP. Target: none wrong. A thousand take some ten CPU minutes.
"""

import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "synth" / "predictive"))

from test_unstable import exact, random_step

from synth.errors import NumericalError

WRONG = 1e-7

if __name__ == "__main__":
    first, last = (int(a) for a in sys.argv[1:3]) if len(sys.argv) > 2 else (1000, 2000)
    counts, worst, slowest = Counter(), 0.0, 0.0
    for seed in range(first, last):
        controller, state, x, r = random_step(seed)
        started = time.process_time()
        try:
            after, u = controller.step(state, x, r)
        except NumericalError:
            counts["reported"] += 1
            print(f"{seed}: reported", flush=True)
            continue
        finally:
            slowest = max(slowest, time.process_time() - started)
        counts["by another route than DAQP"] += after.fallbacks
        try:
            off = float(np.abs((u - exact(controller, state, x, r)) / controller.problem.unit).max())
        except (ArithmeticError, NumericalError):
            counts["not decided"] += 1
            continue
        counts["judged"] += 1
        counts["wrong"] += off > WRONG
        worst = max(worst, off)
        if off > WRONG:
            print(f"{seed}: off by {off:.1e} of the limits", flush=True)
    print(
        f"programs {first} to {last - 1}: {dict(counts)}, largest difference {worst:.1e}, slowest step {slowest:.2g} s"
    )
