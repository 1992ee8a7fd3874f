"""Seconds of the CubeSat's 1000 s closed loop: compilation apart, one run and a batch of 30, ratios to plant only.

CPU seconds stand beside wall seconds, because on a busy machine only the former mean anything.
What a million flights of this length cost follows from the last column: 44 ms of one core each with the Kalman filter
in batches of 256, 12 hours; the first call's price is in `benchmarks/first.py`. It has not been measured on a GPU.

    python benchmarks/simulator.py [--runs 30] [--seconds 1000] [--repeats 3]
"""

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from plants import campaign, cubesat3u, draw, indices, replay_case, simulate
from plants.simulation.simulate import Loop, Scenario


@dataclass(frozen=True)
class ProportionalDerivative:
    gain: np.ndarray  # (3, 6) N m, N m s
    dt: float = cubesat3u.CONTROL_PERIOD

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.gain @ (r - y)


@dataclass(frozen=True)
class Untraceable(ProportionalDerivative):
    """The same in NumPy only, as a quadratic program in a C library is."""

    def step(self, s, y, r):
        return s, np.asarray(self.gain @ (np.asarray(r) - np.asarray(y)))


def clocked(work: Callable[[], Any], repeats: int) -> tuple[float, float, float]:
    """Seconds of the first call beyond a later one, and wall and CPU seconds of the best later one."""
    start = time.perf_counter()
    work()
    first, wall, cpu = time.perf_counter() - start, [], []
    for _ in range(repeats):
        a, b = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - a)
        cpu.append(time.process_time() - b)
    return first - min(wall), min(wall), min(cpu)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=1000.0)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    I, wn, zeta = np.diag(cubesat3u.INERTIA), 0.17, 0.8
    gain = np.hstack([2 * wn**2 * I, 2 * zeta * wn * I])
    surroundings = cubesat3u.environment(args.seconds)
    navigators = {
        "plant only": None,
        "sensors, SVD": cubesat3u.svd(),
        "sensors, EKF": cubesat3u.ekf(),
        "sensors, EKF direct": cubesat3u.direct_ekf(),
    }

    def case(d: cubesat3u.Dispersion, shared: Any) -> tuple[Loop, Scenario]:
        navigator, controller = shared
        loop = Loop(
            plant=cubesat3u.body(d.inertia),
            controller=controller,
            sensors=None if navigator is None else cubesat3u.suite(),
            navigator=navigator,
            actuator=cubesat3u.wheels(),
        )
        return loop, Scenario(
            initial=cubesat3u.initial_state(surroundings, d.angles, d.rates),
            dt=cubesat3u.CONTROL_PERIOD,
            periods=round(args.seconds / cubesat3u.CONTROL_PERIOD),
            samples=cubesat3u.SAMPLES,
            environment=surroundings,
        )

    drawn = draw(cubesat3u.disperse, args.runs, 0)
    rows = [(f"{name}, compiled", nav, ProportionalDerivative(gain)) for name, nav in navigators.items()]
    rows.append(("sensors, EKF, stepped", navigators["sensors, EKF"], Untraceable(gain)))
    print(f"{'seconds':30}{'compile':>9}{'1 run':>8}{'cpu':>8}{'ratio':>7}{'compile':>10}{args.runs:>5} runs{'cpu':>7}")
    base = 0.0
    for name, navigator, controller in rows:
        single = replay_case(case, drawn, 0, (navigator, controller))
        one = clocked(lambda pair=single: simulate(*pair), args.repeats)
        many = clocked(
            lambda shared=(navigator, controller): campaign(
                case, drawn, shared, measure=lambda run: indices(run, start=0.3 * args.seconds), progress=False
            ),
            args.repeats,
        )
        base = base or one[2]
        print(
            f"{name:30}{one[0]:9.2f}{one[1]:8.3f}{one[2]:8.3f}{one[2] / base:7.2f}"
            f"{many[0]:10.2f}{many[1]:10.2f}{many[2]:7.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
