"""Every specification on loops without unknowns, where its least level is known from elsewhere."""

import cvxpy as cp
import numpy as np
import pytest
import scipy.linalg as sla

from synth import NumericalError, StateSpace, h2norm, hinfnorm
from synth.lmi.disc import disc
from synth.lmi.generalised_h2 import generalised_h2
from synth.lmi.h2 import h2
from synth.lmi.hinf import hinf
from synth.lmi.loops import Loop
from synth.lmi.peak import peak
from synth.lmi.solve import solve

FORMS = pytest.mark.parametrize("extended", [False, True])


def a_system(rng, radius: float = 0.9) -> StateSpace:
    n, m, p = rng.integers(2, 5), rng.integers(1, 4), rng.integers(1, 4)
    A = rng.standard_normal((n, n))
    A *= radius * rng.uniform(0.5, 1) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(A, *(rng.standard_normal(shape) for shape in ((n, m), (p, n), (p, m))), 1.0)


def analysed(G: StateSpace, extended: bool) -> Loop:
    P = cp.Variable((G.n, G.n), symmetric=True)
    X = cp.Variable((G.n, G.n)) if extended else P
    return Loop(P, X, G.A @ X, G.B, G.C @ X, G.D)


def least(lmis, g) -> float:
    solve(g, lmis)
    return float(g.value)


@FORMS
def test_norms(extended):
    rng = np.random.default_rng(1)
    for _ in range(4):
        G = a_system(rng)
        g, loop = cp.Variable(), analysed(G, extended)
        covariance = G.C @ sla.solve_discrete_lyapunov(G.A, G.B @ G.B.T) @ G.C.T + G.D @ G.D.T
        assert least(h2(loop, g, g), g) == pytest.approx(h2norm(G), rel=1e-6)
        assert least(h2(loop, 1.0, g), g) == pytest.approx(h2norm(G) ** 2, rel=1e-6)
        assert least(generalised_h2(loop, g, g), g) == pytest.approx(np.linalg.norm(covariance, 2) ** 0.5, rel=1e-6)
        assert least([hinf(loop, g)], g) == pytest.approx(hinfnorm(G)[0], rel=1e-6)
        a = 0.7
        assert least([hinf(loop, a, g)], g) == pytest.approx(hinfnorm(G)[0] ** 2 / a, rel=1e-6)


@FORMS
def test_a_disc_is_decided_by_the_poles(extended):
    rng = np.random.default_rng(2)
    for _ in range(6):
        G, centre = a_system(rng, 2.0), rng.uniform(-1, 1)
        radius = np.abs(G.poles() - centre).max()
        X = cp.Variable()
        for factor, inside in ((0.99, False), (1.01, True)):
            loop = analysed(G, extended)
            lmis = [disc(loop, centre, factor * radius), loop.P - np.eye(G.n), X * np.eye(G.n) - loop.P]
            if inside:
                assert least(lmis, X) < 1e6
            else:
                with pytest.raises(NumericalError):
                    solve(X, lmis)


@FORMS
def test_the_bound_of_peaks_is_one(extended):
    """It is above what inputs of size one do, and exact for a first-order lag."""
    rng = np.random.default_rng(3)
    lag = StateSpace([[0.6]], [[1.0]], [[0.4]], [[0.0]], 1.0)
    g, m = cp.Variable(), cp.Variable()
    assert least(peak(analysed(lag, extended), 0.4, g, m), g) == pytest.approx(1.0, rel=1e-6)
    for _ in range(4):
        G = a_system(rng)
        most = 1 - np.abs(G.poles()).max() ** 2
        bound = min(least(peak(analysed(G, extended), a * most, g, m), g) for a in (0.2, 0.5, 0.8))
        responses = [G.D, *(G.C @ np.linalg.matrix_power(G.A, k) @ G.B for k in range(200))]
        for z in np.eye(G.ny):  # the worst input for the peak of one output
            assert sum(np.linalg.norm(z @ h) for h in responses) <= bound * (1 + 1e-6)


def test_a_channel_is_that_of_the_system():
    G = a_system(np.random.default_rng(4))
    G = StateSpace(G.A, np.hstack([G.B] * 2), np.vstack([G.C] * 2), np.tile(G.D, (2, 2)) + 1.0, 1.0)
    z, w = [1], [1, 0]
    part = StateSpace(G.A, G.B[:, w], G.C[z], G.D[np.ix_(z, w)], 1.0)
    g = cp.Variable()
    assert least(h2(analysed(G, True).channel(z, w), g, g), g) == pytest.approx(h2norm(part), rel=1e-6)
