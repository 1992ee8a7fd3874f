"""Regulators, filters and LQG of continuous plants under a sampling processor: against integrals over the motion."""

from __future__ import annotations

import control
import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, NumericalError, StateSpace, kalmd, lqg, lqgd, lqrd
from synth.analysis.sampleddata import lifted, wide
from synth.errors import AssumptionError

EACH = settings(max_examples=20, deadline=None)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(24)
CONDITION = 1e7
KINDS = st.sampled_from(["dense", "integrators", "stiff"])


def plant(seed: int, kind: str) -> tuple[np.random.Generator, StateSpace]:
    rng = np.random.default_rng(seed)
    n, m, p = (int(k) for k in rng.integers(1, (5, 3, 3)))
    A = rng.standard_normal((n, n))
    if kind == "integrators":
        A = np.eye(n, k=1)
    if kind == "stiff":
        A = np.diag(-(10.0 ** rng.uniform(-1, 1.5, n)))
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return rng, StateSpace(T @ A @ T.T, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)))


def weight(rng: np.random.Generator, size: int) -> np.ndarray:
    M = rng.standard_normal((size, size + 1))
    return M @ M.T


def well_posed(A: np.ndarray, B: np.ndarray, W: np.ndarray) -> bool:
    """Whether the continuous problem has digits to compare: a regulator of condition below 1e7."""
    n = len(A)
    try:
        return synth.lqr(A, B, W[:n, :n], W[n:, n:], W[:n, n:]).condition < CONDITION
    except (AssumptionError, NumericalError):
        return False


def over_a_period(A: np.ndarray, dt: float, integrand) -> np.ndarray:
    """The integral of integrand(e^(A t), t) over a period, in quarters, by Gauss-Legendre quadrature."""
    parts = [(k + (NODES + 1) / 2) * dt / 4 for k in range(4)]
    return sum(w * dt / 8 * integrand(sla.expm(A * t), t) for ts in parts for t, w in zip(ts, WEIGHTS, strict=True))


def extended(G: StateSpace) -> np.ndarray:
    """Of state and held input."""
    return np.block([[G.A, G.B], [np.zeros((G.nu, G.n + G.nu))]])


@EACH
@given(st.integers(0, 10_000), KINDS, st.floats(0.02, 1.0))
def test_the_cost_of_lqrd_is_the_integral_along_the_motion(seed, kind, dt):
    """x'S x, with a cross weight, and no other gain near it does better."""
    rng, G = plant(seed, kind)
    W = weight(rng, G.n + G.nu)
    Q, R, N = W[: G.n, : G.n], W[G.n :, G.n :], W[: G.n, G.n :]
    assume(well_posed(G.A, G.B, W))
    K, S, E = lqrd(G.A, G.B, Q, R, dt, N)
    M = extended(G)
    F, H = np.split(sla.expm(M * dt)[: G.n], [G.n], axis=1)
    J = over_a_period(M, dt, lambda X, _: X.T @ W @ X)

    def cost(K: np.ndarray) -> np.ndarray:
        I = np.vstack([np.eye(G.n), -K])
        return sla.solve_discrete_lyapunov((F - H @ K).T, I.T @ J @ I)

    np.testing.assert_allclose(S, cost(K), rtol=0, atol=1e-6 * np.abs(S).max())
    assert np.abs(E).max() < 1
    moved = K + 1e-3 * np.abs(K).max() * rng.standard_normal(K.shape)
    if np.abs(np.linalg.eigvals(F - H @ moved)).max() < 1:
        assert np.linalg.eigvalsh(cost(moved) - S).min() > -1e-8 * np.abs(S).max()
    by_system = lqrd(G, Q, R, dt, N)
    np.testing.assert_array_equal(by_system[0], K)


@EACH
@given(st.integers(0, 10_000), KINDS, st.floats(0.02, 1.0))
def test_kalmd_is_the_filter_of_the_sampled_noises(seed, kind, dt):
    """Covariances that the motion of the error keeps; gains as python-control has them for those noises."""
    rng, G = plant(seed, kind)
    q = G.nu
    known = rng.standard_normal((G.n, 2))
    plant_and_noise = StateSpace(G.A, np.hstack([known, G.B]), G.C, np.hstack([rng.standard_normal((G.ny, 2)), G.D]))
    Qn, Rn = weight(rng, q), weight(rng, G.ny)
    assume(well_posed(G.A.T, G.C.T, sla.block_diag(G.B @ Qn @ G.B.T, Rn)))
    kest, L, P, M, Z = kalmd(plant_and_noise, Qn, Rn, dt)
    F = sla.expm(G.A * dt)
    Wd = over_a_period(G.A, dt, lambda X, _: X @ G.B @ Qn @ G.B.T @ X.T)
    V, size = Rn / dt, np.abs(P).max()
    np.testing.assert_allclose(F @ Z @ F.T + Wd, P, rtol=0, atol=1e-6 * size)
    I = np.eye(G.n) - M @ G.C
    np.testing.assert_allclose(I @ P @ I.T + M @ V @ M.T, Z, rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(F @ M, L, rtol=0, atol=1e-7 * np.abs(L).max())
    theirs = control.dlqe(F, np.eye(G.n), G.C, (Wd + Wd.T) / 2, V)
    np.testing.assert_allclose(L, theirs[0], rtol=0, atol=1e-5 * np.abs(L).max())
    # the system is that recursion
    H = synth.c2d(StateSpace(G.A, known, G.C, plant_and_noise.D[:, :2]), dt)
    x, state = np.zeros(G.n), np.zeros(G.n)
    for _ in range(4):
        u, y = rng.standard_normal(2), rng.standard_normal(G.ny)
        z = np.concatenate([u, y])
        out, state = kest.C @ state + kest.D @ z, kest.A @ state + kest.B @ z
        after = x + M @ (y - G.C @ x - H.D @ u)
        np.testing.assert_allclose(out[G.ny :], after, rtol=1e-7, atol=1e-9 * np.abs(after).max())
        np.testing.assert_allclose(out[: G.ny], G.C @ after + H.D @ u, rtol=1e-6, atol=1e-8 * np.abs(out).max())
        x = H.A @ x + H.B @ u + L @ (y - G.C @ x - H.D @ u)


def test_kalmd_of_a_lag():
    """dx = -a x + w: the scalar Riccati equation, solved by hand."""
    a, q, r, dt = 2.0, 3.0, 0.5, 0.1
    _, L, P, M, Z = kalmd(([[-a]], [[1.0]], [[1.0]], [[0.0]]), q, r, dt)
    f, w, v = np.exp(-a * dt), q * (1 - np.exp(-2 * a * dt)) / (2 * a), r / dt
    b = v * (1 - f**2) - w
    p = (-b + np.sqrt(b**2 + 4 * w * v)) / 2
    assert P[0, 0] == pytest.approx(p, rel=1e-12)
    assert M[0, 0] == pytest.approx(p / (p + v), rel=1e-12)
    assert L[0, 0] == pytest.approx(f * p / (p + v), rel=1e-12)
    assert Z[0, 0] == pytest.approx(p * v / (p + v), rel=1e-12)


def mean_cost(G: StateSpace, K: StateSpace, W: np.ndarray, V: np.ndarray, dt: float) -> float:
    """The mean over all time of [x; u]'W[x; u] in the loop of plant and controller; inf where it is unstable."""
    n, M = G.n, extended(G)
    F, H = np.split(sla.expm(M * dt)[:n], [n], axis=1)
    noise = V[:n, :n]
    Wd = over_a_period(G.A, dt, lambda X, _: X @ noise @ X.T)
    # y = C x + D u + v, u = Ck xk + Dk y;  K has a direct term only where D is zero
    first = np.hstack([K.D @ G.C, K.C])
    A = np.block([[F, np.zeros((n, K.n))], [K.B @ G.C, K.A]]) + np.vstack([H, K.B @ G.D]) @ first
    B = np.vstack([H @ K.D, K.B @ (np.eye(G.ny) + G.D @ K.D)])
    if np.abs(np.linalg.eigvals(A)).max() >= 1:
        return np.inf
    added = sla.block_diag(Wd, np.zeros((K.n, K.n))) + B @ (V[n:, n:] / dt) @ B.T
    S = sla.solve_discrete_lyapunov(A, added)
    T = np.vstack([np.eye(n, n + K.n), first])
    X = T @ S @ T.T  # of [x; u] at the samples
    X[n:, n:] += K.D @ (V[n:, n:] / dt) @ K.D.T
    held = over_a_period(M, dt, lambda E, _: E.T @ W @ E)
    between = over_a_period(G.A, dt, lambda E, t: (dt - t) * E.T @ W[:n, :n] @ E)
    return float(np.trace(held @ X) + np.trace(between @ noise)) / dt


@EACH
@given(st.integers(0, 10_000), KINDS, st.floats(0.02, 1.0), st.booleans())
def test_no_sampled_controller_near_that_of_lqgd_costs_less(seed, kind, dt, current):
    """The mean cost over the continuous motion, with cross weights; the present measurement helps."""
    rng, G = plant(seed, kind)
    if not current:
        G = StateSpace(G.A, G.B, G.C, rng.standard_normal(G.D.shape))
    W = weight(rng, G.n + G.nu)
    V = sla.block_diag(weight(rng, G.n), weight(rng, G.ny))
    assume(well_posed(G.A, G.B, W) and well_posed(G.A.T, G.C.T, V))
    K = lqgd(G, W, V, dt, current=current)
    least = mean_cost(G, K, W, V, dt)
    assert least < np.inf
    if current:
        assert least <= mean_cost(G, lqgd(G, W, V, dt), W, V, dt) * (1 + 1e-9)
    for _ in range(4):
        matrices = [M * (1 + 3e-3 * rng.standard_normal(M.shape)) for M in K.matrices]
        assert mean_cost(G, StateSpace(*matrices, dt), W, V, dt) >= least * (1 - 1e-8)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), KINDS, st.floats(0.02, 1.0), st.booleans())
def test_lqgd_is_the_best_controller_of_the_lifted_plant(seed, kind, dt, current):
    """Lifting shares nothing with Van Loan's integrals: the cost is the same, and `h2syn` finds no less."""
    rng, G = plant(seed, kind)
    if not current:
        G = StateSpace(G.A, G.B, G.C, rng.standard_normal(G.D.shape))
    W, V, n, m, p = weight(rng, G.n + G.nu), sla.block_diag(weight(rng, G.n), weight(rng, G.ny)), G.n, G.nu, G.ny
    assume(well_posed(G.A, G.B, W) and well_posed(G.A.T, G.C.T, V))
    CD, noise = np.linalg.cholesky(W).T, np.linalg.cholesky(V)
    P = synth.GeneralizedPlant(
        A=G.A, B1=noise[:n], B2=G.B, C1=CD[:, :n], D11=np.zeros((n + m, n + p)), D12=CD[:, n:], C2=G.C, D21=noise[n:],
        D22=G.D,
    )  # fmt: skip
    K = lqgd(G, W, V, dt, current=current)
    norm = synth.sdh2norm(P, K)
    assert norm**2 == pytest.approx(mean_cost(G, K, W, V, dt), rel=1e-8)
    lifting = lifted(P, dt, 0.0, None)
    best = synth.h2syn(wide(lifting)[0], strictly_proper=not current).design.controller
    assert norm <= synth.sdh2norm(P, best) * (1 + 1e-8)


@EACH
@given(st.integers(0, 10_000), KINDS, st.floats(-4, 4))
def test_coordinates_and_units_do_not_matter(seed, kind, decades):
    """The controller and the filter of a plant in other states, and with time in other units."""
    rng, G = plant(seed, kind)
    W, V = weight(rng, G.n + G.nu), sla.block_diag(weight(rng, G.n), weight(rng, G.ny))
    dt, unit, n = 0.3, 10.0**decades, G.n
    T = np.diag(10.0 ** rng.uniform(-4, 4, n)) @ np.linalg.qr(rng.standard_normal((n, n)))[0]
    T = np.diag(10.0 ** rng.uniform(-4, 4, n)) if decades > 0 else T * 0 + np.linalg.qr(T)[0]
    H = StateSpace(unit * np.linalg.solve(T, G.A @ T), unit * np.linalg.solve(T, G.B), G.C @ T, G.D)
    U, back = sla.block_diag(T, np.eye(G.nu)), np.linalg.inv(T)
    moved = sla.block_diag(unit * back @ V[:n, :n] @ back.T, V[n:, n:] / unit)
    assume(well_posed(G.A, G.B, W) and well_posed(G.A.T, G.C.T, V))
    K = lqgd(G, W, V, dt, current=True)
    L = lqgd(H, U.T @ W @ U, (moved + moved.T) / 2, dt / unit, current=True)
    angles = np.geomspace(0.01, 3, 8)
    expected = K.frequency_response(angles / dt)
    found = L.frequency_response(angles * unit / dt)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


def test_short_periods_lead_to_the_continuous_controller():
    rng, G = plant(7, "dense")
    W, V = weight(rng, G.n + G.nu), sla.block_diag(weight(rng, G.n), weight(rng, G.ny))
    omega = np.geomspace(0.1, 10, 9)
    exact, near = lqg(G, W, V).frequency_response(omega), lqgd(G, W, V, 1e-5).frequency_response(omega)
    np.testing.assert_allclose(near, exact, rtol=0, atol=1e-3 * np.abs(exact).max())


def test_what_is_refused():
    G = StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 1.0]])
    with pytest.raises(ModelError, match="direct term from w to y"):
        kalmd(G, 1.0, 1.0, 0.1)
    with pytest.raises(AssumptionError, match="read sensor for actuator"):
        kalmd(([[1.0]], [[1.0]], [[0.0]], [[0.0]]), 1.0, 1.0, 0.1)
    with pytest.raises(ModelError, match="Qn has 3 rows and sys 2 inputs"):
        kalmd(G, [1, 1, 1], 1.0, 0.1)
    with pytest.raises(ModelError, match="Rn has the eigenvalue"):
        kalmd(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), 1.0, 0.0, 0.1)
    with pytest.raises(ModelError, match="sys is discrete already"):
        kalmd(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1), 1.0, 1.0, 0.1)
    with pytest.raises(ModelError, match="current is True and G has a direct term"):
        lqgd(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[1.0]]), np.eye(2), np.eye(2), 0.1, current=True)
    with pytest.raises(ModelError, match="QWV has a block between w and v"):
        lqgd(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), np.eye(2), np.eye(2) + 0.5, 0.1)
    with pytest.raises(ModelError, match="dt is"):
        lqrd([[0.0]], [[1.0]], 1.0, 1.0, np.zeros((1, 2)), 0.1)
