"""Riccati equations inside closed loops against NumPy and SciPy: python benchmarks/sdre.py [--runs 100] [--steps 2000]

Amazonia-1 (Romero and Souza 2022) with modified Rodrigues parameters: order 6, three commands, Runge-Kutta in steps of
0.05 s.

    Riccati   microseconds for one equation, among 1024: SciPy's solve_continuous_are, the doubling from nothing, the
              pair with its dual, and the continuation of the last sample's solution
    loop      steps of a run per second, a Riccati equation in every step: the plain NumPy and SciPy loop, and
              jit(vmap(scan)) of all runs on one thread
    two       the same as two halves in two threads, in wall seconds: how it scales on two cores

Rates are per CPU second of this process, apart from the last; the fastest of the repetitions counts.
"""

import argparse
import os
import time
from concurrent.futures import ThreadPoolExecutor

os.environ["OPENBLAS_NUM_THREADS"] = os.environ["OMP_NUM_THREADS"] = "1"
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"

import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg as sla

from synth import MrpModel, Sdre
from synth.equations.riccati import continued, stabilising, stabilising_pair

INERTIA = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]]) - 0.01911 * np.eye(3)  # kg m^2
TORQUE, DT = 0.075, 0.05  # N m, s
MODEL = MrpModel.create(INERTIA)
CONTROLLER = Sdre.create(MODEL, DT)
NOTHING = np.zeros(10)
jax.tree_util.register_dataclass(MrpModel)
jax.tree_util.register_dataclass(Sdre)


def fastest(work, clock=time.process_time, repeats=5):
    """Seconds of the best of some calls, after one that compiles."""
    jax.block_until_ready(work())
    spent = []
    for _ in range(repeats):
        start = clock()
        jax.block_until_ready(work())
        spent.append(clock() - start)
    return min(spent)


def measurements(count):
    rng = np.random.default_rng(0)
    q = rng.standard_normal((count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.hstack([q, rng.uniform(-0.01, 0.01, (count, 3)), np.zeros((count, 3))])


def motion(xp, y, u, inverse):
    """dy/dt with NumPy or JAX."""
    q0, q, w = y[0], y[1:4], y[4:7]
    dw = inverse @ (u - xp.cross(w, INERTIA @ w + y[7:]))
    return xp.concatenate([-0.5 * (w @ q)[None], 0.5 * (q0 * w + xp.cross(q, w)), dw, -u])


def moved(xp, y, u):
    """One Runge-Kutta step with the torque within its limit."""
    u = xp.clip(u, -TORQUE, TORQUE)
    k1 = motion(xp, y, u, MODEL.inverse)
    k2 = motion(xp, y + DT / 2 * k1, u, MODEL.inverse)
    k3 = motion(xp, y + DT / 2 * k2, u, MODEL.inverse)
    k4 = motion(xp, y + DT * k3, u, MODEL.inverse)
    y = y + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return y / xp.concatenate([xp.sqrt((y[:4] @ y[:4])[None]) * xp.ones(4), xp.ones(6)])


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def plain_loop(y, steps):
    """The loop as one writes it: NumPy, and SciPy's Riccati solver at every step."""
    O, I = np.zeros((3, 3)), np.eye(3)
    B = np.vstack([O, MODEL.inverse])
    for _ in range(steps):
        side = -1.0 if y[0] < 0 else 1.0
        s, w = side * y[1:4] / (1 + side * y[0]), y[4:7]
        upper = ((1 - s @ s) * I + 2 * cross(s) + 2 * np.outer(s, s)) / 4
        A = np.block([[O, upper], [O, MODEL.inverse @ (cross(y[7:]) - cross(w) @ INERTIA)]])
        u = -B.T @ sla.solve_continuous_are(A, B, np.eye(6), I) @ np.concatenate([s, w])
        y = moved(np, y, u)
    return y


@jax.jit
def compiled_loop(controller, starts, steps):
    """All runs at once, `jit(vmap(loop))`."""

    def one(y):
        def period(_, carry):
            y, state = carry
            state, u = controller.step(state, y, NOTHING)
            return moved(jnp, y, u), state

        state = jax.tree.map(jnp.asarray, controller.init())
        return jax.lax.fori_loop(0, steps, period, (y, state))

    return jax.vmap(one)(starts)


def riccati_table():
    count = 1024
    y = jnp.asarray(measurements(count))
    _, A, B = jax.vmap(lambda y: MODEL.factorise(y, MODEL.side(y)))(y)
    G, Q, shift = MODEL.inverse @ MODEL.inverse, np.eye(6), CONTROLLER.shift
    G = np.block([[np.zeros((3, 6))], [np.zeros((3, 3)), G]])
    sample = np.asarray(A[:100])

    def scipy():
        for a, b in zip(sample, np.asarray(B), strict=False):
            sla.solve_continuous_are(a, b, Q, np.eye(3))
        return ()

    reference = fastest(scipy) / len(sample) * 1e6
    cold = jax.jit(jax.vmap(lambda A: stabilising(A, G, Q, shift)))
    pair = jax.jit(jax.vmap(lambda A: stabilising_pair(A, G, Q, shift)))
    warm = jax.jit(jax.vmap(lambda A, X: continued(A, G, Q, shift, X)))
    X = cold(A).X
    near = jax.vmap(lambda A, y: A.at[:3, 3:].multiply(1 + 1e-3 * y[1]))(A, y)
    print(f"{'Riccati equation, n = 6':<38} {'us':>8} {'times SciPy':>12}")
    print(f"{'scipy.linalg.solve_continuous_are':<38} {reference:8.1f} {1:12.0f}")
    for name, work in {
        "doubling and Newton": lambda: cold(A),
        "the same with its dual": lambda: pair(A),
        "continued from a solution 1e-3 away": lambda: warm(near, X),
        "continued from the solution itself": lambda: warm(A, X),
    }.items():
        spent = fastest(work) / count * 1e6
        print(f"{name:<38} {spent:8.2f} {reference / spent:12.0f}", flush=True)


def loop_table(runs, steps):
    starts = measurements(runs)
    few = 300
    reference = few / fastest(lambda: plain_loop(starts[0], few), repeats=3)
    near = np.concatenate([[np.cos(0.01)], np.full(3, np.sin(0.01) / np.sqrt(3)), np.full(3, 1e-4), np.full(3, 0.1)])
    end, _ = compiled_loop(CONTROLLER, near[None], few)
    difference = np.abs(np.asarray(end[0]) - plain_loop(near, few)).max()
    one = runs * steps / fastest(lambda: compiled_loop(CONTROLLER, starts, steps), repeats=3)
    halves = np.array_split(starts, 2)
    with ThreadPoolExecutor(2) as pool:

        def both():
            return list(pool.map(lambda half: jax.block_until_ready(in_thread(half, steps)), halves))

        single = fastest(lambda: [in_thread(half, steps) for half in halves], time.perf_counter, 3)
        double = fastest(both, time.perf_counter, 3)
    print(f"\n{f'closed loop, {runs} runs of {steps} steps':<38} {'steps/s':>8} {'times NumPy':>12}")
    print(f"{'numpy and scipy':<38} {reference:8.0f} {1:12.0f}")
    print(f"{'jit(vmap(scan)), one thread':<38} {one:8.0f} {one / reference:12.0f}")
    print(f"{'two threads over one, wall':<38} {'':>8} {single / double:12.2f}")
    print(f"largest difference of the two loops near the target after {few} steps: {difference:.1e}")


def in_thread(starts, steps):
    """`compiled_loop`; a thread has a precision of its own."""
    with jax.enable_x64(True):
        return jax.block_until_ready(compiled_loop(CONTROLLER, starts, steps))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--steps", type=int, default=2000)
    args = parser.parse_args()
    with jax.enable_x64(True):
        riccati_table()
        loop_table(args.runs, args.steps)


if __name__ == "__main__":
    main()
