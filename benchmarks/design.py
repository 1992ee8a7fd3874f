"""Time of verified H-infinity designs, from call to verified controller, and of `import synth`.

    python benchmarks/design.py

The CubeSat plant is that of Pecorilla and Stesina (2024), table 4. Targets: the default method under 2 s on two cores,
`import synth` under 0.6 s.
"""

import statistics
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from literature import GAMMA_PECORILLA2024, cubesat_pecorilla2024

from synth import hinfsyn


def main() -> None:
    start = time.perf_counter()
    first = hinfsyn(cubesat_pecorilla2024())
    print(f"first design of a process, default method: {time.perf_counter() - start:.2f} s ({first.info.method})")
    print(f"\n{'CubeSat, n = 6':16}{'median s':>10}{'optimum/gamma* - 1':>20}{'norm/gamma* - 1':>18}")
    for method in ("auto", "lmi", "riccati", "standard", "extended"):
        designs, seconds = [], []
        for _ in range(5):
            start = time.perf_counter()
            designs.append(hinfsyn(cubesat_pecorilla2024(), method=method))
            seconds.append(time.perf_counter() - start)
        error, loss = (v / GAMMA_PECORILLA2024 - 1 for v in (designs[0].info.optimum, designs[0].gamma))
        print(f"{method:16}{statistics.median(seconds):10.3f}{error:20.1e}{loss:18.1e}")
    opened = []
    for _ in range(5):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import synth"], check=True)
        opened.append(time.perf_counter() - start)
    print(f"\nimport synth, whole process: {statistics.median(opened):.2f} s")


if __name__ == "__main__":
    main()
