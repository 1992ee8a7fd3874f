"""Plants without states: Parrott's optimum, reached by a gain, whatever the ranks, the units and D22."""

import control
import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.stats import ortho_group

from synth import (
    AntiWindup,
    Design,
    GeneralizedPlant,
    InfeasibleError,
    ModelError,
    NumericalError,
    StateSpace,
    accept,
    augw,
    export,
    gang_of_four,
    hinfsyn,
    mixsyn,
    ncfsyn,
    system,
)
from synth.equations.parrott import direct_term, parrott


def static(D11, D12, D21, D22=None, dt: float = 0.0) -> GeneralizedPlant:
    D11, D12, D21 = (np.atleast_2d(np.asarray(M, float)) for M in (D11, D12, D21))
    (nz, nw), nu, ny = D11.shape, D12.shape[1], D21.shape[0]
    D22 = np.zeros((ny, nu)) if D22 is None else D22
    O = np.zeros
    return GeneralizedPlant(O((0, 0)), O((0, nw)), O((0, nu)), O((nz, 0)), D11, D12, O((ny, 0)), D21, D22, dt=dt)


@st.composite
def plants(draw, largest=4):
    """Any sizes, ranks down to zero, channels that act alike, units of u and y over sixteen decades, integers."""
    nz, nw, nu, ny = (draw(st.integers(1, largest)) for _ in range(4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    D11, D12, D21 = rng.normal(size=(nz, nw)), rng.normal(size=(nz, nu)), rng.normal(size=(ny, nw))
    size = 10.0 ** rng.integers(-6, 7)
    for M, kind in ((D12.T, draw(st.integers(0, 3))), (D21, draw(st.integers(0, 3)))):
        if kind == 1:
            M[:] = 0
        if kind == 2:
            M[0] = 0
        if kind == 3:
            M[-1] = M[0]
    if draw(st.booleans()):
        D11 = np.round(D11)
    U, Y = 10.0 ** rng.uniform(-8, 8, nu), 10.0 ** rng.uniform(-8, 8, (ny, 1))
    D22 = rng.normal(size=(ny, nu)) * U * Y / size if draw(st.booleans()) else None
    return static(D11 * size, D12 * U, D21 * Y, D22, draw(st.sampled_from([0.0, 1e-3, 1.0])))


@settings(max_examples=150, deadline=None)
@given(P=plants())
def test_the_optimum_is_reached_and_the_norm_is_that_of_the_matrix(P):
    bound, size = parrott(P), np.linalg.norm(P.D11, 2)
    try:
        design = hinfsyn(P)
    except NumericalError:
        assert bound <= 1e-12 * size  # an optimum of zero that D22 keeps from being attained
        assert P.D22.any()
        return
    K = design.controller.D
    loop = P.D11 + P.D12 @ K @ np.linalg.solve(np.eye(len(P.D22)) - P.D22 @ K, P.D21)
    assert np.linalg.norm(loop, 2) == pytest.approx(design.gamma, rel=1e-6, abs=1e-7 * size)
    assert design.gamma <= bound * (1 + 1e-3) + 1e-9 * size
    assert design.gamma >= bound * (1 - 1e-9)
    assert design.info.method == "parrott"
    assert design.info.optimum == pytest.approx(bound)


@settings(max_examples=25, deadline=None)
@given(P=plants(3), level=st.floats(1, 3))
def test_the_bound_is_the_least_norm_by_convex_optimisation(P, level):
    """The oracle: the norm of D11 + D12 Q D21 minimised over Q, in units in which all columns have length one."""

    def unit(M):
        size = np.linalg.norm(M, axis=0)
        return M / np.where(size > 0, size, 1)

    scale = np.linalg.norm(P.D11, 2) or 1.0
    D12, D21 = unit(P.D12), unit(P.D21.T).T
    Q = cp.Variable((D12.shape[1], D21.shape[0]))
    problem = cp.Problem(cp.Minimize(cp.sigma_max(P.D11 / scale + D12 @ Q @ D21)))
    problem.solve(solver=cp.CLARABEL)
    assert problem.value * scale == pytest.approx(parrott(P), rel=1e-4, abs=1e-5 * scale)
    gamma = level * parrott(P)
    assert np.linalg.norm(P.D11 + P.D12 @ direct_term(P, gamma) @ P.D21, 2) <= gamma + 1e-9 * scale


@settings(max_examples=25, deadline=None)
@given(P=plants(), seed=st.integers(0, 999))
def test_neither_coordinates_nor_units_change_the_level(P, seed):
    """w and z turned, u and y in other units, all of it larger."""
    rng = np.random.default_rng(seed)
    (nz, nw), (ny, nu) = P.D11.shape, P.D22.shape
    Z, W = (np.atleast_2d(ortho_group.rvs(k, random_state=seed)) if k > 1 else np.eye(1) for k in (nz, nw))
    U, Y = 10.0 ** rng.uniform(-6, 6, nu), 10.0 ** rng.uniform(-6, 6, (ny, 1))
    turned = static(3 * Z @ P.D11 @ W, 3 * Z @ P.D12 * U, P.D21 @ W * Y, P.D22 * U * Y, P.dt)
    assert parrott(turned) == pytest.approx(3 * parrott(P), rel=1e-6, abs=1e-9 * np.linalg.norm(P.D11))


@pytest.mark.parametrize("dt", [0.0, 0.1])
@pytest.mark.parametrize("method", ["auto", "riccati", "lmi"])
def test_a_static_design_is_a_design_like_others(dt, method, tmp_path):
    P = static([[2, 1], [1, 1]], [[1], [0]], [[1, 0]], dt=dt)
    design = hinfsyn(P, method=method)
    assert design.gamma == pytest.approx(np.sqrt(2), rel=1e-6)
    K, _, gamma, info = design
    assert isinstance(K, control.StateSpace)
    assert (K.nstates, gamma, info.slowest) == (0, design.gamma, np.inf)
    assert design.warnings == ()
    again = Design.load(design.save(tmp_path / "design.json"))
    assert again.controller.digest() == design.controller.digest()
    assert (again.info.slowest, again.info.spectral_radius) == (np.inf, info.spectral_radius)
    assert again.save(tmp_path / "again.json").read_bytes() == (tmp_path / "design.json").read_bytes()
    design.save(tmp_path / "design.mat")
    assert "gamma" in repr(design)
    assert "<table>" in design._repr_html_()
    found = accept(design, dt=None if dt else 0.1, umin=-1, umax=1)
    assert found.passed
    assert {c.verdict for c in found.conditions if c.name == "saturation"} == {"-"}
    assert design.margins is not None
    if dt:
        export(design, "c", tmp_path)
    with pytest.raises(ModelError, match="no states"):
        design.certify()


def test_a_level_that_is_asked_for():
    P = static([[2, 1], [1, 1]], [[1], [0]], [[1, 0]])
    optimum = np.sqrt(2)
    for factor in (1.001, 1.5, 10):
        design = hinfsyn(P, gamma=factor * optimum)
        assert optimum <= design.gamma <= factor * optimum
        assert design.info.level == factor * optimum
    with pytest.raises(InfeasibleError, match="was not reached") as caught:
        hinfsyn(P, gamma=0.9 * optimum)
    assert caught.value.best == pytest.approx(optimum, rel=1e-6)
    assert caught.value.lower == 0  # nothing was proved


def test_direct_terms_of_the_plant_that_the_best_gain_cannot_close():
    """1 + Q D22 = 0 at the optimum: a positive one is approached to the tolerance, one of zero needs a level."""
    P = static([[1.0]], [[1.0]], [[1.0]], np.eye(1))
    with pytest.raises(NumericalError, match=r"the optimum of zero is not attained: ask for a level with gamma="):
        hinfsyn(P)
    for gamma in (0.1, 1e-3):
        assert hinfsyn(P, gamma=gamma).gamma <= gamma
    P = static([[1.0, 0.0], [0.0, 0.5]], [[1.0], [0]], [[1.0, 0]], [[1.0]])
    assert hinfsyn(P).gamma == pytest.approx(0.5, rel=1e-3)
    P = static([[2.0, 1.0], [1.0, 1.0]], [[1.0], [0]], [[1.0, 0]], [[0.5]])
    assert hinfsyn(P).gamma <= np.sqrt(2) * (1 + 1e-3)


@pytest.mark.parametrize("seed", range(4))
def test_mixed_sensitivity_of_gains(seed):
    """A static plant with static weights, whose optimum a search over gains does not undercut."""
    rng = np.random.default_rng(seed)
    G, dt = rng.normal(size=(2, 2)), [0.0, 0.5][seed % 2]
    weights = {"W1": 2.0, "W2": [[1.0, 0.2]], "W3": 0.1}
    design = mixsyn(system(G, dt=dt), **weights)
    P = augw(system(G, dt=dt), **weights)

    def norm(k):
        K = np.reshape(k, (2, 2))
        return np.linalg.norm(P.D11 + P.D12 @ K @ np.linalg.inv(np.eye(2) - P.D22 @ K) @ P.D21, 2)

    assert norm(design.controller.D) == pytest.approx(design.gamma, rel=1e-6)
    starts = [np.zeros(4), design.controller.D.ravel(), rng.normal(size=4)]
    best = min(minimize(norm, k, method="Nelder-Mead", options={"maxiter": 4000}).fun for k in starts)
    assert design.gamma <= best * (1 + 1e-6)
    slower = mixsyn(system(G, dt=0.0), W1=control.tf([2], [1e-9, 1]), W2=weights["W2"], W3=0.1)
    assert slower.gamma == pytest.approx(mixsyn(system(G, dt=0.0), **weights).gamma, rel=1e-2)


@pytest.mark.parametrize("method", ["riccati", "lmi"])
@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_loop_shaping_of_gains(method, dt, tmp_path):
    """K = -D' makes a projection of the loop: level one, which nothing undercuts."""
    G = np.array([[2.0, 1.0, 0.3], [0.0, -1.0, 5.0]])
    design = ncfsyn(system(G, dt=dt), method=method)
    np.testing.assert_allclose(design.controller.D, -G.T, atol=1e-12)
    assert design.gamma == pytest.approx(1, rel=1e-6)
    assert design.info.optimum == 1
    optimal = hinfsyn(gang_of_four(system(G, dt=dt)))
    assert optimal.gamma == pytest.approx(1, rel=1e-6)
    assert Design.load(design.save(tmp_path / "ncf.json")).gamma == design.gamma
    weighted = ncfsyn(system(G, dt=dt), W1=2 * np.eye(3), W2=3.0, method=method)
    np.testing.assert_allclose(weighted.controller.D, -36 * G.T, rtol=1e-12)
    with pytest.raises(InfeasibleError):
        ncfsyn(system(G, dt=dt), gamma=0.99, method=method)
    if dt:
        assert AntiWindup.of(design, -1, 1).D.shape == (3, 2)


def test_one_gain_that_is_no_generalised_plant():
    with pytest.raises(ModelError, match="P is 1 x 1; a generalised plant has at least one w and one u"):
        hinfsyn(StateSpace.gain(2.0, 1.0), 1, 1)
