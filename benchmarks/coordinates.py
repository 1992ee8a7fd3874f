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
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import scipy.linalg as sla

from synth import GeneralizedPlant, StateSpace, SynthError, augw, hinfsyn, verify
from synth.synthesis.hinfinity import make_route
from synth.synthesis.search import Search

try:
    import slycot
except ImportError:
    slycot = None

ABOVE, SAID = 5e-3, 1e-3
LARGEST_LMI = 8  # states up to which the LMIs are asked: they take seconds beyond
AS_IT_IS = "as it is"  # "unit" of the control of a plant that is not turned
Random = np.random.Generator


def four_block(G: StateSpace, rng: Random) -> GeneralizedPlant:
    """Weights of one decade to either side of one on every channel."""
    d, n, y, u = (np.diag(10 ** rng.uniform(-1, 1, k)) for k in (G.nu, G.ny, G.ny, G.nu))
    return GeneralizedPlant.four_block(G, Wdist=d, Wnoise=n, Wout=y, Wact=u)


def double_integrators(rng: Random) -> GeneralizedPlant:
    """One to three axes of 1/s^2 with a random inertia."""
    k = int(rng.integers(1, 4))
    J = rng.normal(size=(k, k))
    J = np.linalg.inv(J @ J.T + np.eye(k))
    A = np.block([[np.zeros((k, k)), np.eye(k)], [np.zeros((k, 2 * k))]])
    return four_block(StateSpace(A, np.vstack([0 * J, J]), np.eye(k, 2 * k), np.zeros((k, k))), rng)


def orbiting(rng: Random) -> GeneralizedPlant:
    """A rigid body in orbit: gravity-gradient stiffness at 1e-3 rad/s, both signs, roll and yaw coupled."""
    w0, (sx, sy, sz) = 1.1e-3, rng.uniform(-0.9, 0.9, 3)
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[4, 1], A[5, 2] = -4 * w0**2 * sx, -3 * w0**2 * sy, -(w0**2) * sz
    A[3, 5], A[5, 3] = w0 * (1 - sx), -w0 * (1 + sz)
    B = np.vstack([np.zeros((3, 3)), np.diag(10 ** rng.uniform(-2, 2, 3))])
    return four_block(StateSpace(A, B, np.eye(3, 6), np.zeros((3, 3))), rng)


def flexible(rng: Random) -> GeneralizedPlant:
    """A rigid axis and up to four modes with a damping of 1e-5 to 1e-2, sensor and actuator apart."""
    blocks, b, c = [np.array([[0.0, 1], [0, 0]])], [0.0, 1.0], [1.0, 0.0]
    for _ in range(int(rng.integers(1, 5))):
        w, zeta = 10 ** rng.uniform(-1, 1.5), 10 ** rng.uniform(-5, -2)
        blocks.append(np.array([[0, 1], [-(w**2), -2 * zeta * w]]))
        b, c = [*b, 0.0, rng.normal()], [*c, rng.normal(), 0.0]
    return four_block(StateSpace(sla.block_diag(*blocks), np.array([b]).T, [c], [[0.0]]), rng)


def lags(rng: Random) -> GeneralizedPlant:
    """One to eight lags over six decades, some in the right half plane, dense B and C."""
    n, m = int(rng.integers(1, 9)), int(rng.integers(1, 3))
    poles = -(10 ** rng.uniform(-3, 3, n)) * np.where(rng.random(n) < 0.2, -1, 1)
    gain = np.sqrt(np.abs(poles))[:, None]
    return four_block(StateSpace(np.diag(poles), gain * rng.normal(size=(n, m)), (gain * rng.normal(size=(n, m))).T,
                                 np.zeros((m, m))), rng)  # fmt: skip


def jordan(rng: Random) -> GeneralizedPlant:
    """One Jordan block of up to five states, in the left or the right half plane or at the origin."""
    n, p = int(rng.integers(2, 6)), float(rng.choice([0.0, rng.uniform(-2, 0.5)]))
    A = p * np.eye(n) + np.eye(n, k=1)
    return four_block(StateSpace(A, np.eye(n)[:, -1:], np.eye(1, n), [[0.0]]), rng)


def companion(rng: Random) -> GeneralizedPlant:
    """A companion form of up to five poles about 1 to 1e5 rad/s, as transfer functions come; mixed sensitivity.

    Those that will be turned are of poles about 1 in units of w0: turned companion forms of fast poles hold no digit.
    """
    n, w0, turned = int(rng.integers(2, 6)), 10 ** rng.uniform(0, 5), rng.random() < 0.5
    unit = w0 if turned else 1.0
    den = np.poly(-w0 / unit * rng.uniform(0.3, 3, n))
    A = np.zeros((n, n))
    A[:-1, 1:], A[-1] = np.eye(n - 1), -den[::-1][:n]
    G = StateSpace(unit * A, unit * np.eye(n)[:, -1:], den[-1] * np.eye(1, n), [[0.0]])
    P = augw(G, integrating(rng, 0.3 * w0, 10 ** rng.uniform(-4, -2) * w0), float(10 ** rng.uniform(-1.5, 0.5)))
    return P if turned else replace(P, units={P.u[0]: AS_IT_IS})


def servo(rng: Random) -> GeneralizedPlant:
    """Mixed sensitivity of k/((s + a)(s + b)) with a quasi-integrating weight: poles down to 1e-8 rad/s."""
    a, b, pole = 10 ** rng.uniform(-2, 0.5), 10 ** rng.uniform(-5, -1), 10 ** rng.uniform(-8, -1)
    A = [[-a, 0], [1, -b]]
    G = StateSpace(A, [[10 ** rng.uniform(-0.5, 1.5)], [0.0]], [[0.0, 1]], [[0.0]])
    return augw(G, integrating(rng, 10 ** rng.uniform(-0.5, 1), pole), float(10 ** rng.uniform(-1, 0.5)))


def dense(rng: Random) -> GeneralizedPlant:
    """All nine matrices random, direct terms too."""
    n, nw, nu, nz, ny = (int(rng.integers(*pair)) for pair in ((1, 13), (2, 5), (1, 3), (2, 5), (1, 3)))
    nw, nz = max(nw, ny + 1), max(nz, nu + 1)
    r = rng.standard_normal
    A = r((n, n)) / np.sqrt(n) - rng.uniform(-0.5, 1) * np.eye(n)
    return GeneralizedPlant(A, r((n, nw)), r((n, nu)), r((nz, n)), 0.3 * r((nz, nw)), r((nz, nu)), r((ny, n)),
                            r((ny, nw)), 0.3 * r((ny, nu)))  # fmt: skip


def integrating(rng: Random, bandwidth: float, pole: float) -> StateSpace:
    """The weight (s/M + w)/(s + pole), with M from 1.2 to 2."""
    M = rng.uniform(1.2, 2)
    return StateSpace([[-pole]], [[1.0]], [[bandwidth - pole / M]], [[1 / M]])


CLASSES: tuple[Callable[[Random], GeneralizedPlant], ...] = (
    double_integrators, orbiting, flexible, lags, jordan, companion, servo, dense,
)  # fmt: skip


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


def others(P: GeneralizedPlant) -> Iterator[tuple[str, float]]:
    """Norms that other routes, rates and SLICOT reach."""
    rates = [None, *list(Search(P, 1e-3, make_route).rates())[:2]]
    for method in ("riccati", "lmi"):
        for rate in rates if method == "riccati" or len(P.A) <= LARGEST_LMI else ():
            alone = Search(P, 1e-3, make_route)
            alone.attempt(method, rate)
            if alone.best is not None:
                yield f"{method} at {rate or 'the natural rate'}", alone.best.measured.norm
    if slycot is not None:
        yield "sb10ad", slicot(P)


def slicot(P: GeneralizedPlant) -> float:
    """The norm that the controller of sb10ad reaches; infinite when there is none, or it does not verify."""
    n, nw, nu, nz, ny = P.sizes
    G = P.system
    try:
        _, Ak, Bk, Ck, Dk, *_ = slycot.sb10ad(n, nw + nu, nz + ny, nu, ny, 1e7, G.A, G.B, G.C, G.D, 3, 1e-6, 0.0)
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
            best = min([(norm, name) for name, norm in others(P)], default=(np.inf, ""))
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
