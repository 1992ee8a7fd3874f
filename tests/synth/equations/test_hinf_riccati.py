"""The Riccati route: literature optima, central controllers at every level, irregular plants, peers."""

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import GAMMA_PECORILLA2024, compleib, cubesat_pecorilla2024, mass_spring_chain, random_plant

from synth.analysis.norms import hinfnorm, is_stable, verify
from synth.analysis.precondition import Conditioned, precondition
from synth.equations.hinf_riccati import (
    RiccatiRoute,
    central_controller,
    control_riccati,
    estimation_riccati,
    parrott,
    regularised,
    search,
    solve_level,
)
from synth.errors import NumericalError, VerificationError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import cayley, design_rate, inverse_cayley
from synth.systems.statespace import StateSpace

seeds = st.integers(0, 10**6)
sizes = {"n": st.integers(2, 8), "nu": st.integers(1, 3), "ny": st.integers(1, 3)}


def discretised(P: GeneralizedPlant) -> tuple[GeneralizedPlant, float]:
    rate = design_rate(P)
    _, _, nu, _, ny = P.sizes
    return GeneralizedPlant.partition(cayley(P.system, rate), ny, nu), rate


def first_verified(c: Conditioned, P: GeneralizedPlant) -> tuple[float, float, StateSpace]:
    """Optimal level, verified norm of the first controller within 0.1 % of its level, and that controller."""
    route = RiccatiRoute.of(c.plant)
    optimum, _ = route.minimise()
    for back in route.backoff:
        level = optimum * (1 + back) * c.scale
        for K in route.controllers(optimum * (1 + back)):
            try:
                controller = c.restore(K)
                norm = verify(P.close(controller)).norm
            except (VerificationError, NumericalError):
                continue
            if norm <= 1.001 * level:
                return optimum * c.scale, norm, controller
    raise AssertionError("no controller verified")


def swept_gain(G: StateSpace, points: int = 3000) -> float:
    """Largest singular value over a dense grid and the pole frequencies of a stable system."""
    poles = G.poles()
    omega = np.abs(np.angle(poles)) / G.dt if G.discrete else np.abs(poles.imag)
    grid = np.linspace(0, np.pi / G.dt, points) if G.discrete else np.geomspace(1e-6, 1e6, points)
    return max(np.linalg.norm(G.frequency_response(w), 2) for w in np.concatenate([[0.0], grid, omega, np.abs(poles)]))


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_cubesat_optimum_at_any_weight(factor):
    P = cubesat_pecorilla2024(factor)
    optimum, norm, K = first_verified(precondition(P), P)
    assert optimum == pytest.approx(GAMMA_PECORILLA2024 * factor**2, rel=1e-8)
    assert norm <= optimum * (1 + 1.1e-5)
    assert is_stable(P.close(K))
    assert swept_gain(P.close(K)) <= norm


@pytest.mark.parametrize("n", [8, 20, 50])
def test_chain_of_masses(n):
    P = mass_spring_chain(n)
    optimum, norm, K = first_verified(precondition(P), P)
    assert norm == pytest.approx(optimum, rel=1.1e-5)
    assert swept_gain(P.close(K), 500) == pytest.approx(norm, rel=1e-3)


@pytest.mark.parametrize("name", compleib())
def test_collection_of_continuous_plants_reaches_the_reference(name):
    P, reference = compleib()[name]
    Pd, rate = discretised(P)
    optimum, norm, K = first_verified(precondition(Pd), Pd)
    assert optimum == pytest.approx(reference, rel=1e-3)
    assert norm <= 1.01 * reference
    # independently: the controller of the continuous plant, a sweep over frequency
    loop = P.close(inverse_cayley(K, rate))
    assert is_stable(loop)
    assert 0.9 * norm <= swept_gain(loop) <= norm * (1 + 1e-6)


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=seeds, **sizes, direct=st.booleans())
def test_regular_plants_are_solved_to_the_last_digits(seed, n, nu, ny, direct):
    P = random_plant(seed, n, ny + 1, nu, nu + 1, ny, direct=direct, deficient="none")
    c = precondition(P)
    optimum, norm, K = first_verified(c, P)
    assert norm <= 1.0011 * optimum
    assert is_stable(P.close(K))
    assert optimum >= parrott(P) * (1 - 1e-9)


@pytest.mark.slow
@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=seeds, **sizes, direct=st.booleans(), square=st.booleans(),
    deficient=st.sampled_from(["none", "D12", "D21", "both"]),
)  # fmt: skip
def test_irregular_plants_give_verified_controllers(seed, n, nu, ny, direct, square, deficient):
    extra = 0 if square else 1
    P = random_plant(seed, n, ny + extra, nu, nu + extra, ny, direct=direct, deficient=deficient)
    c = precondition(P)
    _, norm, K = first_verified(c, P)
    assert swept_gain(P.close(K), 300) <= norm * (1 + 1e-6)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=seeds, **sizes, above=st.sampled_from([1e-4, 1e-2, 1.0, 1e4]))
def test_every_level_above_the_optimum_has_a_central_controller_that_keeps_it(seed, n, nu, ny, above):
    P = precondition(random_plant(seed, n, ny + 1, nu, nu + 1, ny, direct=True, deficient="none")).plant
    route = RiccatiRoute.of(P)
    level = route.minimise()[0] * (1 + above)
    loop = P.close(next(route.controllers(level)))
    assert is_stable(loop)
    assert hinfnorm(loop)[0] <= level


def test_no_controller_is_offered_below_the_optimum():
    P = precondition(cubesat_pecorilla2024()).plant
    route = RiccatiRoute.of(P)
    optimum, _ = route.minimise()
    assert list(route.controllers(optimum * (1 - 1e-3))) == []


def test_game_solutions_grow_as_the_level_falls_and_end_at_the_regulator():
    P = precondition(mass_spring_chain(8)).plant
    X = [control_riccati(P, g).X for g in (1e6, 10.0, 3.0, 2.0)]
    regulator = sla.solve_discrete_are(P.A, P.B2, P.C1.T @ P.C1, P.D12.T @ P.D12, s=P.C1.T @ P.D12)
    assert np.linalg.norm(X[0] - regulator) <= 1e-6 * np.linalg.norm(regulator)
    for larger, smaller in zip(X[1:], X[:-1], strict=True):
        assert np.linalg.eigvalsh(larger - smaller)[0] >= -1e-10
    assert control_riccati(P, 1e-3) is None


def test_estimation_is_control_of_the_transposed_plant():
    P = precondition(random_plant(3, 4, 3, 2, 3, 2, direct=True, deficient="none")).plant
    G = P.system
    dual = GeneralizedPlant.partition(StateSpace(G.A.T, G.C.T, G.B.T, G.D.T, G.dt), P.sizes[2], P.sizes[4])
    assert np.allclose(estimation_riccati(P, 5.0).X, control_riccati(dual, 5.0).X, rtol=1e-12)


def test_optimum_without_dynamics_in_the_way_is_the_parrott_bound():
    # u and y act on z and w at once, the states are decoupled and stable: only the unreachable corner of D11 is left
    rng = np.random.default_rng(2)
    D11 = rng.normal(size=(3, 3))
    P = GeneralizedPlant(
        A=0.5 * np.eye(2), B1=np.zeros((2, 3)), B2=np.ones((2, 1)), C1=np.zeros((3, 2)), D11=D11,
        D12=np.eye(3)[:, :1], C2=np.ones((1, 2)), D21=np.eye(3)[:1], D22=[[0.0]], dt=1.0,
    )  # fmt: skip
    want = max(np.linalg.norm(D11[1:], 2), np.linalg.norm(D11[:, 1:], 2))
    assert parrott(P) == pytest.approx(want, rel=1e-12)
    optimum, norm, _ = first_verified(precondition(P), P)
    assert optimum == pytest.approx(want, rel=1e-6)
    assert norm == pytest.approx(want, rel=1e-4)


def test_regularised_plant_bounds_the_plant_from_above():
    P = precondition(random_plant(11, 4, 2, 2, 2, 2, direct=True, deficient="both")).plant
    route = RiccatiRoute.of(P)
    levels = [search(regularised(P, e), route.X, route.Y).high.gamma for e in (1e-1, 1e-2, 1e-3)]
    assert levels[0] >= levels[1] >= levels[2]
    R = regularised(P, 1e-2)
    solutions = solve_level(R, 1.01 * levels[1], route.X, route.Y)
    K = central_controller(R, solutions)
    assert hinfnorm(P.close(K))[0] <= hinfnorm(R.close(K))[0] * (1 + 1e-9) <= 1.01 * levels[1] * (1 + 1e-6)


def slicot_norm(slycot, P: GeneralizedPlant, level: float) -> float:
    """Norm of the loop closed by SLICOT's controller for a level, infinite when it refuses or the loop is unstable."""
    n, nw, nu, nz, ny = P.sizes
    G = P.system
    try:
        out = slycot.sb10dd(n, nw + nu, nz + ny, nu, ny, level, G.A, G.B, G.C, G.D)
    except slycot.exceptions.SlycotArithmeticError:
        return np.inf
    Ak, Bk, Ck, Dk = out[1:5] if np.ndim(out[0]) == 0 else out[:4]
    return hinfnorm(P.close(StateSpace(Ak, Bk, Ck, Dk, P.dt)))[0]


def test_agrees_with_slicot_where_its_controller_verifies():
    slycot = pytest.importorskip("slycot", reason="slycot (SLICOT) is the oracle of this test")
    reached = 0
    for seed in range(10):
        P = random_plant(seed, 4, 3, 2, 3, 2, direct=False, deficient="none")
        optimum = RiccatiRoute.of((c := precondition(P)).plant).minimise()[0] * c.scale
        reached += slicot_norm(slycot, P, 1.01 * optimum) <= 1.01 * optimum
        assert slicot_norm(slycot, P, 0.99 * optimum) > 0.99 * optimum
    assert reached >= 8


def test_failure_of_every_regularisation_says_so():
    P = precondition(cubesat_pecorilla2024()).plant
    hopeless = RiccatiRoute(P, np.full((6, 6), np.nan), np.full((6, 6), np.nan))
    with pytest.raises(NumericalError) as caught:
        hopeless.minimise()
    assert "regularisation 0.001" in caught.value.statuses
