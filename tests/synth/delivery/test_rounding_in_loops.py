"""The bound that the gate proves of a loop holds for signals that try hard, in coordinates and units of any size."""

import numpy as np
import pytest

import synth
from synth.delivery.processor import PRECISIONS
from synth.delivery.rounding import in_loop, loop_peaks
from synth.regulators.fixed import FORMATS, FixedController
from synth.regulators.sequential import SequentialController

NEAR = 200  # times what is measured over the few thousand samples of these tests


def loop(seed, stable=True):
    """A plant with w and z, and a controller that stabilises it, in units of any size."""
    rng = np.random.default_rng(seed)
    n, m, p = rng.integers(2, 5), rng.integers(1, 3), rng.integers(1, 3)
    A = rng.normal(size=(n, n))
    A *= (0.95 if stable else 1.05) / np.abs(np.linalg.eigvals(A)).max()
    G = synth.StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), np.zeros((p, m)), 1.0)
    design = synth.ncfsyn(G)
    K, T = design.closing, np.diag(10.0 ** rng.uniform(-2, 2, design.closing.n))
    u, y = 10.0 ** rng.integers(-4, 5, m), 10.0 ** rng.integers(-4, 5, p)
    G = synth.StateSpace(G.A, G.B / u, y[:, None] * G.C, np.zeros((p, m)), 1.0)
    B, C, D = K.B / y, u[:, None] * K.C, u[:, None] * K.D / y
    return synth.gang_of_four(G), synth.StateSpace(np.linalg.solve(T, K.A @ T), np.linalg.solve(T, B), C @ T, D, 1.0)


def trying(P, K, samples):
    """Signals w (several, samples, nw) that drive each command to its peak, and signs at random."""
    seen = synth.GeneralizedPlant(
        P.A, P.B1, P.B2, np.zeros((K.ny, len(P.A))), np.zeros((K.ny, P.B1.shape[1])), np.eye(K.ny), P.C2, P.D21, P.D22,
        dt=P.dt,
    )  # fmt: skip
    T = seen.close(K)
    h, X = np.zeros((samples, T.ny, T.nu)), T.B
    h[0] = T.D
    for k in range(1, samples):
        h[k], X = T.C @ X, T.A @ X
    rng = np.random.default_rng(0)
    driven = [np.sign(h[::-1, i]) for i in range(T.ny)]
    return np.array([*driven, *rng.choice([-1.0, 1.0], (3, samples, T.nu))])


def run(P, K, controller, w):
    """Commands (samples, m) of a controller in numbers of its kind, and those of K in long doubles; y of the latter."""
    A, B1, B2, C2, D21 = (M.astype(np.longdouble) for M in (P.A, P.B1, P.B2, P.C2, P.D21))
    a, b, c, d = (M.astype(np.longdouble) for M in K.matrices)
    x, X, xk = (np.zeros(size, np.longdouble) for size in (len(A), len(A), K.n))
    state = controller.init()
    rounded, exact, seen = [], [], []
    for now in w:
        y, Y = C2 @ x + D21 @ now, C2 @ X + D21 @ now
        state, u = controller.update(state, y.astype(float))
        U = c @ xk + d @ Y
        xk, X, x = a @ xk + b @ Y, A @ X + B1 @ now + B2 @ U, A @ x + B1 @ now + B2 @ u.astype(np.longdouble)
        rounded.append(u)
        exact.append(U)
        seen.append(Y)
    return np.array(rounded), np.array(exact, float), np.array(seen, float)


def exported(K, precision, Y):
    if precision in FORMATS:
        return FixedController.of(K, precision, Y)
    return SequentialController.of(K, dtype={"double": "double", "float32": "float"}[precision], allow_unstable=True)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("seed", range(4))
def test_the_bound_in_the_loop_holds(seed, precision):
    P, K = loop(seed, stable=seed % 2 == 0)
    if precision in FORMATS and np.abs(np.linalg.eigvals(K.A)).max(initial=0.0) >= 1:
        pytest.skip("fixed point is of stable controllers")
    Y, U = loop_peaks(P, K)
    found, peaks = in_loop(P, K, precision)
    off, largest = np.zeros(K.ny), np.zeros(K.ny)
    for w in trying(P, K, 400):
        u, exact, y = run(P, K, exported(K, precision, found.inputs), w)
        assert (np.abs(y) <= Y).all()
        off = np.maximum(off, np.abs(u - exact).max(axis=0))
        largest = np.maximum(largest, np.abs(exact).max(axis=0))
    assert (largest <= U * (1 + 1e-9)).all()
    assert (largest >= 0.9 * U).all()  # the peaks are reached
    assert (peaks == U).all()
    assert (off <= found.command).all()
    assert (found.command <= NEAR * off).all()


def test_slow_states_cost_what_the_loop_shows_of_them():
    """A pole 1e-4 from the unit circle: bounds of y alone let its state grow a hundred times as far as u does."""
    P = synth.c2d(synth.gang_of_four(synth.system([1.0], [1.0, 0.0])), 1e-2)
    K = synth.c2d(synth.system([-1.0, -1.0], [1.0, 1e-2]), 1e-2)
    found, peaks = in_loop(P, K, "float32")
    loose = synth.rounding(K, inputs=found.inputs, plant=P)
    assert (found.command <= 1e-3 * peaks).all()
    assert (found.command <= 0.1 * loose.command).all()
