"""Time of `synth --help`, whole process, over that of an empty Python.

    python benchmarks/command.py

Target: under 0.3 s, that is, hardly more than Python itself.
"""

import statistics
import subprocess
import sys
import time


def seconds(*arguments: str) -> float:
    """Median of nine runs."""
    runs = []
    for _ in range(9):
        start = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        runs.append(time.perf_counter() - start)
    return statistics.median(runs)


def main() -> None:
    empty = seconds("-c", "pass")
    print(f"{'python -c pass':24}{empty:8.3f} s")
    for command in ("", "info", "verify", "export", "compare", "design"):
        taken = seconds("-m", "synth", *([command] if command else []), "--help")
        print(f"{f'synth {command} --help':24}{taken:8.3f} s{taken / empty:8.1f} times that")


if __name__ == "__main__":
    main()
