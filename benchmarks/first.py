"""What a user waits for the first flight of a process: the CubeSat for 1000 s, with an empty and with a filled cache.

    python benchmarks/first.py

Every row is two fresh processes that share a cache folder of their own. CPU seconds of all threads; the ratio is that
of the first call, cold and warm, to a later one.
"""

import os
import subprocess
import sys
import tempfile

FLIGHT = """
import sys, time
import numpy as np
import synth
from plants import Loop, Scenario, cubesat3u, simulate_many
imported = time.process_time()
name, lanes, compiled = sys.argv[1], int(sys.argv[2]), sys.argv[3] == "compiled"
navigator = {"SVD": cubesat3u.svd, "EKF": cubesat3u.ekf}[name]()
surroundings = cubesat3u.environment(1000.0)
controller = synth.proportional_derivative(cubesat3u.INERTIA, 0.17, 0.8, cubesat3u.CONTROL_PERIOD)
loop = Loop(plant=cubesat3u.body(), controller=controller, sensors=cubesat3u.suite(), navigator=navigator,
            actuator=cubesat3u.wheels())
cases = [(loop, Scenario(initial=cubesat3u.initial_state(surroundings), dt=cubesat3u.CONTROL_PERIOD, periods=2000,
                         samples=cubesat3u.SAMPLES, environment=surroundings, run=run)) for run in range(lanes)]
built = time.process_time()
seconds = [imported, built - imported]
for _ in range(3):
    start = time.process_time()
    simulate_many(cases, compiled=compiled, progress=False)
    seconds.append(time.process_time() - start)
print(*seconds)
"""


def measured(folder: str, *arguments: str) -> list[float]:
    """Seconds of import, set-up, first call and best later call, in a process of its own."""
    environment = os.environ | {"CONVEX_SYNTH_CACHE": folder}
    started = [sys.executable, "-c", FLIGHT, *arguments]
    out = subprocess.run(started, env=environment, check=True, capture_output=True, text=True).stdout
    seconds = [float(word) for word in out.split()]
    return [*seconds[:3], min(seconds[3:])]


def main() -> None:
    names = ("import", "set-up", "cold", "warm", "later", "cold/later", "warm/later")
    print(f"{'CPU seconds':24}" + "".join(f"{name:>12}" for name in names))
    for row in (("SVD", "1", "compiled"), ("EKF", "1", "compiled"), ("EKF", "30", "compiled"), ("EKF", "1", "stepped")):
        with tempfile.TemporaryDirectory() as folder:
            cold, (imported, built, warm, later) = measured(folder, *row)[2], measured(folder, *row)
        seconds = (imported, built, cold, warm, later, cold / later, warm / later)
        print(f"{' '.join(row):24}" + "".join(f"{value:12.2f}" for value in seconds), flush=True)


if __name__ == "__main__":
    main()
