"""Exported controllers replayed in C beside exact arithmetic, that of long doubles, on inputs that try them hard."""

import ctypes
from pathlib import Path

import numpy as np
from exported import gcc
from scipy.linalg import solve_discrete_lyapunov

import synth
from synth.systems.statespace import StateSpace

TYPES = {"double": "double", "float32": "float"}
SLOW = 1e-4  # distance of a pole from the unit circle, from which errors need more samples than `trying` has
NEAR = 50  # times what was measured, which a bound may be
BESIDE = """
typedef int (*step_function)(void *, const REAL *, REAL *);

/* The largest |u - exact u| over the steps; y has `samples` rows, which are repeated. Of some `choices` for each
 * sample, smaller by up to a thousandth, that one is taken whose rounding makes e'W e of the states' error largest. */
void beside(step_function step, int n, int p, int m, const double *A, const double *B, const double *C,
            const double *D, const double *W, const double *y, long samples, long steps, int choices, double *worst)
{
    REAL state[256] = { 0 }, tried[256], chosen[256], in[64], u[64];
    double now[64];
    long double x[256] = { 0 }, next[256], after[256];
    unsigned int seed = 1;
    for (int i = 0; i < m; ++i) worst[i] = 0;
    for (long k = 0; k < steps; ++k) {
        long double most = -1;
        for (int c = 0; c < choices; ++c) {
            for (int j = 0; j < p; ++j) {
                seed = seed * 1664525u + 1013904223u;
                now[j] = y[(k % samples) * p + j] * (1 - (c ? 1e-3 * (seed >> 8) / 16777216.0 : 0));
                in[j] = (REAL)now[j];
            }
            for (int i = 0; i < n + m; ++i) tried[i] = state[i];
            step(tried, in, u);
            for (int i = 0; i < m; ++i) {
                long double v = 0;
                for (int j = 0; j < n; ++j) v += (long double)C[i * n + j] * x[j];
                for (int j = 0; j < p; ++j) v += (long double)D[i * p + j] * now[j];
                double off = (double)(v > u[i] ? v - u[i] : u[i] - v);
                if (!(off <= worst[i])) worst[i] = off;
            }
            for (int i = 0; i < n; ++i) {
                next[i] = 0;
                for (int j = 0; j < n; ++j) next[i] += (long double)A[i * n + j] * x[j];
                for (int j = 0; j < p; ++j) next[i] += (long double)B[i * p + j] * now[j];
            }
            long double size = 0;
            for (int i = 0; i < n && choices > 1; ++i)
                for (int j = 0; j < n; ++j) size += (tried[i] - next[i]) * W[i * n + j] * (tried[j] - next[j]);
            if (size > most) {
                most = size;
                for (int i = 0; i < n + m; ++i) chosen[i] = tried[i];
                for (int i = 0; i < n; ++i) after[i] = next[i];
            }
        }
        for (int i = 0; i < n + m; ++i) state[i] = chosen[i];
        for (int i = 0; i < n; ++i) x[i] = after[i];
    }
}
"""


def difference(
    source: Path, K: StateSpace, real: str, inputs: np.ndarray, steps: int, *, choices: int = 1
) -> np.ndarray:
    """The largest |u - exact u| (m,) of the exported C and of K with its doubles, on inputs (samples, p) repeated.

    With several choices the inputs are bent to what rounds worst.
    """
    beside = source.with_name("beside.c")
    beside.write_text(BESIDE)
    library = source.with_suffix(".so")
    if not library.exists():
        gcc("-std=c99", "-O2", f"-DREAL={real}", "-fPIC", "-shared", "-o", library, source, beside)
    loaded, numbers = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    step = ctypes.cast(getattr(loaded, f"{source.stem}_step"), ctypes.c_void_p)
    W = solve_discrete_lyapunov(K.A.T, K.C.T @ K.C) if K.n else np.zeros((0, 0))
    arrays = [np.ascontiguousarray(M, float) for M in (*K.matrices, W, inputs)]
    worst = np.zeros(K.ny)
    loaded.beside.argtypes = [
        ctypes.c_void_p, *[ctypes.c_int] * 3, *[numbers] * 6, *[ctypes.c_long] * 2, ctypes.c_int, numbers,
    ]  # fmt: skip
    pointers = [M.ctypes.data_as(numbers) for M in arrays]
    sizes = (len(inputs), steps, choices)
    loaded.beside(step, K.n, K.nu, K.ny, *pointers, *sizes, worst.ctypes.data_as(numbers))
    return worst


def measured(
    K: synth.Design | StateSpace, bounds: np.ndarray, precision: str, folder: Path, steps: int, seed: int = 0
) -> np.ndarray:
    """The largest |u - exact u| (m,) of a controller's exported C, on inputs within bounds that try it hard."""
    folder.mkdir(exist_ok=True)
    _, source = synth.export(K, "c", folder, dtype=TYPES[precision], self_test=False, force=True)
    system = K.controller if isinstance(K, synth.Design) else K
    inputs = trying(system, bounds, np.random.default_rng(seed))
    runs = [(inputs, steps, 1), (inputs, steps // 20, 16)]
    if np.abs(np.linalg.eigvals(system.A)).max(initial=0.0) > 1 - SLOW:  # states that take longer than all these
        gain = system.C @ np.linalg.solve(np.eye(system.n) - system.A, system.B) + system.D
        runs += [(sign[None] * bounds, steps, 16) for sign in np.unique(np.sign(gain), axis=0)]
    found = [difference(source, system, TYPES[precision], y, k, choices=choices) for y, k, choices in runs]
    return np.max(found, axis=0)


def trying(K: StateSpace, bounds: np.ndarray, rng: np.random.Generator, longest: int = 30_000) -> np.ndarray:
    """Inputs (samples, p) within bounds: those that drive every command and state to its peak, resonances, noise."""
    radius = np.abs(np.linalg.eigvals(K.A)).max(initial=0.5)
    length = int(np.clip(12 / (1 - min(radius, 0.99999)), 50, longest))
    rows, impulse = np.vstack([K.C, np.eye(K.n)]), K.B
    responses = np.zeros((length, len(rows), K.nu))
    for k in range(length):
        responses[length - 1 - k], impulse = rows @ impulse, K.A @ impulse
    parts = [np.sign(responses[:, i]) for i in range(len(rows))]
    time = np.arange(length)[:, None]
    for pole in np.linalg.eigvals(K.A):
        if np.angle(pole) > 0:
            for _ in range(10):  # of a whole period, so that errors come again as well
                period = max(2, round(2 * np.pi / np.angle(pole)))
                wave = np.sign(np.sin(2 * np.pi * (time + 0.5) / period + rng.uniform(0, 2 * np.pi, K.nu)))
                parts.append(wave * rng.uniform(0.5, 1, K.nu))
    parts += [np.tile(rng.uniform(-1, 1, K.nu), (length, 1)) for _ in range(40)]
    parts += [np.sign(rng.normal(size=K.nu)) * np.ones((length, 1)), rng.uniform(-1, 1, (length, K.nu))]
    return np.vstack(parts) * bounds


def random_controller(seed: int) -> StateSpace:
    """Stable, with rates from one sample to a few thousand, in units of any size, some entries 0 or 1."""
    rng = np.random.default_rng(seed)
    n, p, m = rng.integers(0, 7), rng.integers(1, 4), rng.integers(1, 3)
    blocks, A, k = [], np.zeros((n, n)), 0
    while k < n:
        radius = 1 - 10 ** rng.uniform(-3.3, -0.3)
        if k + 1 < n and rng.random() < 0.5:
            angle = rng.uniform(0.01, 3)
            turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
            A[k : k + 2, k : k + 2] = radius * turn
            blocks, k = [*blocks, 2], k + 2
        else:
            A[k, k], k = radius * rng.choice([-1, 1]), k + 1
    T = np.linalg.qr(rng.normal(size=(n, n)))[0] * 10 ** rng.uniform(-2, 2, n) if rng.random() < 0.7 else np.eye(n)
    B, C, D = rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p)) * rng.integers(n == 0, 2)
    return StateSpace(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, D, 0.1)
