"""What proofs cost: python benchmarks/certify.py

For the CubeSat of Pecorilla and Stesina (2024) and chains of masses and springs (`tests/literature.py`), designed by
Riccati equations:

    upper    seconds to find and prove the upper bound, ball arithmetic of 128 bits
    lower    seconds for the lower bound, from the plant alone
    check    seconds to prove both again from the witnesses
    / design the sum of upper and lower over the design, in the same run
    gap      upper / lower - 1 of what is proved;  below: distance of the proved lower bound from the optimum found
    steps    sub-solutions of control and estimation that lead there;  kB: size of the certificate's file

Then the plants of `tests/provable.py` and of COMPleib, designed in default settings: of how many both bounds are proved
within 1e-3, CPU seconds of `certify`, the reason for every other one.

The fastest of the repetitions counts. Small matrices lose by threads: compare OPENBLAS_NUM_THREADS=1.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from literature import compleib, cubesat_pecorilla2024, mass_spring_chain
from provable import drawn

from synth import hinfsyn
from synth.proof.certify import BITS, MARGINS, certify
from synth.proof.lower import find_lower
from synth.proof.upper import find_upper


def seconds(call, repeats: int) -> float:
    """Of the fastest call."""
    taken = []
    for _ in range(repeats):
        started = time.perf_counter()
        call()
        taken.append(time.perf_counter() - started)
    return min(taken)


def success(name: str, plants: dict) -> None:
    """How many are proved, and what it costs."""
    taken, gaps, missed = [], [], {}
    for key, P in plants.items():
        design = hinfsyn(P)
        started = time.process_time()
        certificate = certify(design)
        taken.append(time.process_time() - started)
        gaps.append(certificate.gap)
        if not certificate.gap < 1e-3:
            missed[key] = f"gap {certificate.gap:.1e} {certificate.note}"
    print(f"{name}: {len(plants) - len(missed)} of {len(plants)} within 1e-3, median gap {np.median(gaps):.1e};"
          f" CPU s median {np.median(taken):.3f}, most {max(taken):.2f}")  # fmt: skip
    for key, why in missed.items():
        print(f"    {key}: {why}")


def main() -> None:
    plants = {"cubesat": cubesat_pecorilla2024()} | {f"chain {n}": mass_spring_chain(n) for n in (20, 30, 50)}
    print(f"{'plant':>9} {'upper':>7} {'lower':>7} {'check':>7} {'/ design':>8} {'gap':>8} {'below':>8} {'steps':>6}"
          f" {'kB':>6}")  # fmt: skip
    for name, P in plants.items():
        repeats = 5 if P.sizes[0] < 30 else 1
        designing = seconds(lambda P=P: hinfsyn(P, method="riccati"), repeats)
        design = hinfsyn(P, method="riccati")
        K, level = design.controller, design.gamma * (1 + MARGINS[0])
        upper = seconds(lambda P=P, K=K, g=level: find_upper(P, K, g, BITS), repeats)
        lower = seconds(lambda P=P, g=level: find_lower(P, g, None, BITS), repeats)
        certificate = certify(design)
        check = seconds(lambda c=certificate, P=P, K=K: c.check(P, K), repeats)
        with tempfile.TemporaryDirectory() as folder:
            size = certificate.save(Path(folder) / "c.json").stat().st_size / 1e3
        w = certificate.lower_witness
        steps = f"{len(w.control)}+{len(w.estimation)}" if w else "-"
        ratio, below = (upper + lower) / designing, 1 - certificate.lower / design.info.optimum
        print(f"{name:>9} {upper:7.3f} {lower:7.3f} {check:7.3f} {ratio:8.2f} {certificate.gap:8.1e} {below:8.1e}"
              f" {steps:>6} {size:6.0f}", flush=True)  # fmt: skip
    success("random plants", {seed: drawn(seed) for seed in range(200)})
    success("COMPleib", {name: P for name, (P, _) in compleib().items()})


if __name__ == "__main__":
    main()
