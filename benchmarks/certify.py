"""What proofs cost: python benchmarks/certify.py

For the CubeSat of Pecorilla and Stesina (2024) and chains of masses and springs (`tests/literature.py`), designed by
Riccati equations:

    upper    seconds to find and prove the upper bound, ball arithmetic of 128 bits
    lower    seconds for the lower bound, from the plant alone
    check    seconds to prove both again from the witnesses
    / design the sum of upper and lower over the design, in the same run
    gap      upper / lower - 1 of what is proved;  below: distance of the proved lower bound from the optimum found
    steps    sub-solutions of control and estimation that lead there;  kB: size of the certificate's file

The fastest of the repetitions counts. Small matrices lose by threads: compare OPENBLAS_NUM_THREADS=1.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from literature import cubesat_pecorilla2024, mass_spring_chain

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


if __name__ == "__main__":
    main()
