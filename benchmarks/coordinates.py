"""Continuous plants in random coordinates: python benchmarks/coordinates.py [plants per class] [first seed]

Eight classes of generalised plants with 1 to 12 states, in coordinates x = T x', T a random orthogonal matrix, half of
them with states in units of 1e-3 to 1e3 besides, and with a random unit of time. Each is designed by default
(`hinfsyn(P)`), in those coordinates. Then everything else is asked: both routes at the natural rate and a decade to
either side of it, on the plant in its own exact coordinates, and SLICOT's sb10ad where slycot is installed. Every
controller, SLICOT's too, is closed with the plant and measured by `verify`.

    unstable   designs whose loop, closed again in the exact coordinates, is not stable
    above      designs whose norm is more than 0.5 % above the best that anything reached
    refused    plants that were refused; each is printed, with the reason
    worst      the largest norm over the best
    silent     designs above 0.1 % that do not say so in `info.status`
    s          median CPU seconds of a design
"""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from families import AS_IT_IS, CLASSES, Random

from synth import GeneralizedPlant, StateSpace, SynthError, hinfsyn, verify
from synth.synthesis.hinfinity import make_route
from synth.synthesis.search import Search

try:
    import slycot
except ImportError:
    slycot = None

ABOVE, SAID = 5e-3, 1e-3
LARGEST_LMI = 8  # states up to which the LMIs are asked: they take seconds beyond


def in_coordinates(P: GeneralizedPlant, rng: Random) -> tuple[GeneralizedPlant, float]:
    """The plant in random coordinates and another unit of time, and that unit in seconds."""
    G, (n, _, nu, _, ny) = P.system, P.sizes
    T = np.eye(n) if AS_IT_IS in P.units.values() else np.linalg.qr(rng.standard_normal((n, n)))[0]
    if rng.random() < 0.5:
        T = T @ np.diag(10 ** rng.uniform(-3, 3, n))
    unit = 10 ** rng.uniform(-3, 3)
    A = np.linalg.solve(T, G.A @ T)
    moved = StateSpace(unit * A, np.linalg.solve(T, np.sqrt(unit) * G.B), np.sqrt(unit) * G.C @ T, G.D)
    return GeneralizedPlant.partition(moved, ny, nu), unit


def back(K: StateSpace, unit: float) -> StateSpace:
    """The controller in seconds."""
    return StateSpace(K.A / unit, K.B / np.sqrt(unit), K.C / np.sqrt(unit), K.D)


def others(P: GeneralizedPlant, ours: float) -> Iterator[tuple[str, float]]:
    """Norms that other routes, rates and SLICOT reach."""
    rates = [None, *list(Search(P, 1e-3, make_route).rates())[:2]]
    for method in ("riccati", "lmi"):
        for rate in rates if method == "riccati" or len(P.A) <= LARGEST_LMI else ():
            alone = Search(P, 1e-3, make_route)
            alone.attempt(method, rate)
            if alone.best is not None:
                yield f"{method} at {rate or 'the natural rate'}", alone.best.measured.norm
    if slycot is not None:
        yield "sb10ad", slicot(P, ours)


def slicot(P: GeneralizedPlant, ours: float) -> float:
    """The norm that the controller of sb10ad, bisecting from twice ours, reaches; infinite when it does not verify."""
    n, nw, nu, nz, ny = P.sizes
    G = P.system
    try:
        _, Ak, Bk, Ck, Dk, *_ = slycot.sb10ad(n, nw + nu, nz + ny, nu, ny, 2 * ours, G.A, G.B, G.C, G.D, 1, 1e-5, 0.0)
        return verify(P.close(StateSpace(Ak, Bk, Ck, Dk))).norm
    except (slycot.exceptions.SlycotArithmeticError, SynthError):
        return np.inf


def main(count: int = 63, first: int = 0) -> None:
    print(
        f"{'class':>20} {'plants':>6} {'unstable':>8} {'above':>5} {'refused':>7} {'silent':>6} {'worst':>9} {'s':>6}"
    )
    total = np.zeros(5, int)
    for kind, make in enumerate(CLASSES):
        counts, worst, seconds = np.zeros(5, int), 1.0, []
        for seed in range(first, first + count):
            rng = np.random.default_rng([kind, seed])
            P = make(rng)
            moved, unit = in_coordinates(P, rng)
            counts[0] += 1
            started = time.process_time()
            try:
                design = hinfsyn(moved)
            except SynthError as error:
                counts[3] += 1
                print(f"    refused: {make.__name__}, seed {seed}: {type(error).__name__}: {str(error)[:150]}")
                continue
            seconds.append(time.process_time() - started)
            try:
                verify(P.close(back(design.controller, unit)))
            except SynthError:
                counts[1] += 1
            best = min([(norm, name) for name, norm in others(P, design.gamma)], default=(np.inf, ""))
            ratio = design.gamma / best[0]
            worst = max(worst, ratio)
            counts[4] += ratio > 1 + SAID and not design.info.warnings
            if ratio > 1 + ABOVE:
                counts[2] += 1
                print(f"    above: {make.__name__}, seed {seed}: {design.gamma:.7g} against {best[0]:.7g} by {best[1]}")
        total += counts
        print(f"{make.__name__:>20} {counts[0]:6d} {counts[1]:8d} {counts[2]:5d} {counts[3]:7d} {counts[4]:6d}"
              f" {worst - 1:9.1e} {np.median(seconds):6.3f}", flush=True)  # fmt: skip
    print(f"{'all':>20} {total[0]:6d} {total[1]:8d} {total[2]:5d} {total[3]:7d} {total[4]:6d}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
