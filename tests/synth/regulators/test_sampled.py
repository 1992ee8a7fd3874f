"""Sampled-data regulators: the cost between samples, gains of the air-bearing study, SDRE of sampled models."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg as sla

from synth.errors import ModelError, NumericalError
from synth.regulators.regulator import lqr, lqrd, sampled_cost
from synth.regulators.sdc import EulerModel, MrpModel
from synth.regulators.sdre import SdreSampled, sampled_gain

INERTIA = np.diag([1.17, 1.17, 1.13])  # kg m^2, the air-bearing study, as all numbers here
Q, R = np.diag([1.0, 1, 1, 100, 100, 100]), 0.001 * np.eye(3)
A = np.block([[np.zeros((3, 3)), np.eye(3)], [np.zeros((3, 6))]])
B = np.vstack([np.zeros((3, 3)), np.linalg.inv(INERTIA)])
TARGET = np.radians([50, 20, -30])


def radius(K, dt):
    F, G, *_ = sampled_cost(A, B, Q, R, dt)
    return np.abs(np.linalg.eigvals(F - G @ K)).max()


def test_sampled_cost_is_the_integral():
    """Against Gauss-Legendre quadrature of the motion from a random state under a held command."""
    rng = np.random.default_rng(1)
    A, B = rng.standard_normal((4, 4)), rng.standard_normal((4, 2))
    W = rng.standard_normal((6, 6))
    W = W @ W.T
    Q, R = W[:4, :4], W[4:, 4:]
    cost, x, u, dt = sampled_cost(A, B, Q, R, 0.7), rng.standard_normal(4), rng.standard_normal(2), 0.7
    M = np.block([[A, B], [np.zeros((2, 6))]])
    nodes, weights = np.polynomial.legendre.leggauss(20)
    total = 0.0
    for t, weight in zip(dt / 2 * (nodes + 1), dt / 2 * weights, strict=True):
        z = (sla.expm(M * t) @ np.concatenate([x, u]))[:4]
        total += weight * (z @ Q @ z + u @ R @ u)
    assert x @ cost.Q @ x + u @ cost.R @ u + 2 * x @ cost.N @ u == pytest.approx(total, rel=1e-12)
    end = sla.expm(M * dt) @ np.concatenate([x, u])
    np.testing.assert_allclose(cost.F @ x + cost.G @ u, end[:4], rtol=1e-12)


def test_gains_of_the_air_bearing_study():
    """31.6 / 316 in continuous time, 1.47 / 14.8 at 0.1 s; held for 0.1 s the former have spectral radius 27."""
    K, _, poles = lqr(A, B, Q, R)
    assert K[0, [0, 3]] == pytest.approx([31.62, 316.3], rel=1e-3)
    assert sorted(poles.real)[:1] == pytest.approx([-279.8], rel=1e-3)
    sampled, _, E = lqrd(A, B, Q, R, 0.1)
    assert sampled[0, [0, 3]] == pytest.approx([1.4717, 14.8336], rel=1e-4)
    assert np.abs(E).max() == pytest.approx(radius(sampled, 0.1), rel=1e-9)
    assert radius(K, 0.1) == pytest.approx(27.1, rel=1e-2)
    assert radius(K, 0.007) < 1 < radius(K, 0.01)


def test_fast_modes_and_long_periods():
    """A lag of 2 ms in a period of 3 s: one exponential of both would overflow."""
    k, dt = 500.0, 3.0
    K, S, _ = lqrd([[-k]], [[k]], [[1.0]], [[1.0]], dt)
    # x = u + (x0 - u) exp(-k t): the integrals of x^2 + u^2 over the period
    e1, e2 = (1 - np.exp(-k * dt)) / k, (1 - np.exp(-2 * k * dt)) / (2 * k)
    Qd, Nd, Rd, F = e2, e1 - e2, 2 * dt - 2 * e1 + e2, np.exp(-k * dt)
    P = sla.solve_discrete_are(F, 1 - F, Qd, Rd, s=Nd)
    gain = ((1 - F) * P * F + Nd) / (Rd + (1 - F) ** 2 * P)
    assert K[0, 0] == pytest.approx(gain.item(), rel=1e-9)
    assert S[0, 0] == pytest.approx(P.item(), rel=1e-9)


def test_short_periods_lead_to_the_continuous_regulator():
    K, S, _ = lqr(A, B, Q, R)
    sampled, cost, _ = lqrd(A, B, Q, R, 1e-6)
    np.testing.assert_allclose(sampled, K, rtol=0, atol=2e-4 * np.abs(K).max())
    np.testing.assert_allclose(cost, S, rtol=0, atol=2e-4 * np.abs(S).max())


@pytest.mark.slow
def test_sampled_gain_is_lqrd_at_every_state():
    model, rng = EulerModel.create(INERTIA, TARGET), np.random.default_rng(2)
    Y = np.vstack([model.target(), rng.uniform(-1, 1, (7, 9)) * ([1.2] * 3 + [0.3] * 3 + [0.2] * 3)])
    with jax.enable_x64(True):
        factors = jax.vmap(lambda y: model.factorise(y, 1.0))(jnp.asarray(Y))
        gains, ok = jax.vmap(lambda A, B: sampled_gain(A, B, Q, R, 0.1))(*factors[1:])
    assert ok.all()
    for a, b, K in zip(*factors[1:], gains, strict=True):
        np.testing.assert_allclose(K, lqrd(np.asarray(a), np.asarray(b), Q, R, 0.1)[0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(gains[0], SdreSampled.create(model, 0.1, Q=Q, R=R).gain, rtol=0, atol=1e-8)


def test_euler_model_is_the_dynamics():
    """I dw = (I w + h) x w + u and E of the 3-2-1 angles, written out with the cross product of NumPy."""
    rng = np.random.default_rng(3)
    J = np.array([[1.17, 0.02, -0.01], [0.02, 1.3, 0.03], [-0.01, 0.03, 0.9]])
    model = EulerModel.create(J, TARGET)
    y, u = rng.uniform(-1, 1, 9), rng.uniform(-1, 1, 3)
    with jax.enable_x64(True):
        x, a, b = map(np.asarray, model.factorise(jnp.asarray(y), 1.0))
    w, (s1, s2, _), (c1, c2, _) = y[3:6], np.sin(y[:3]), np.cos(y[:3])
    E = np.array([[1, s1 * s2 / c2, c1 * s2 / c2], [0, c1, -s1], [0, s1 / c2, c1 / c2]])
    dw = np.linalg.solve(J, np.cross(J @ w + y[6:], w) + u)
    np.testing.assert_allclose(x, np.concatenate([y[:3] - TARGET, w]))
    np.testing.assert_allclose(a @ x + b @ u, np.concatenate([E @ w, dw]), rtol=1e-12)


def test_what_is_refused():
    with pytest.raises(ModelError, match="dt is 0"):
        lqrd(A, B, Q, R, 0)
    with pytest.raises(NumericalError, match="the fastest mode of A, 2000 rad/s"):
        lqrd([[2000.0]], [[1.0]], [[1.0]], [[1.0]], 1.0)
    with pytest.raises(ModelError, match=r"pitch 1\.5708 rad"):
        EulerModel.create(INERTIA, [0, np.pi / 2, 0])
    with pytest.raises(ModelError, match="roll, pitch and yaw"):
        EulerModel.create(INERTIA, [0, 1])


@pytest.mark.parametrize(("size", "time"), [(1.0, 1.0), (1e-3, 1.0), (1e5, 1.0), (1.0, 1e3), (1e-5, 1e-3), (1e4, 1e3)])
@pytest.mark.parametrize("R", [1e-6, 1.0, 1e8])
def test_riccati_laws_of_long_periods_have_a_solution_in_any_unit(size, time, R):
    """At rest at the target the law's own gain is that of `lqrd`; a large R made JAX's exponential give up."""
    J = size * np.array([[3, 0.2, 0], [0.2, 4, 0.1], [0, 0.1, 5]])
    Q = np.diag([1, 1, 1, time**2, time**2, time**2])
    law = SdreSampled.create(MrpModel.create(J), 0.3 * time, Q=Q, R=R * time**4 / size**2)
    with jax.enable_x64(True):
        y = jax.numpy.asarray(law.model.target())
        state, u = law.step(law.init(), y, y)
    assert int(state.failures) == 0
    scale = np.repeat([1.0, 1 / time], 3)
    found, expected = np.asarray(state.gain) * scale, law.gain * scale
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()
    assert not np.asarray(u).any()
