"""H2 synthesis: published values, closed forms, SLICOT; no controller near is better; units, D11, D22, errors."""

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from synth import (
    AssumptionError,
    Design,
    GeneralizedPlant,
    ModelError,
    NumericalError,
    StateSpace,
    dlqr,
    h2norm,
    h2syn,
    lqg,
    lqr,
    system,
)

# SLICOT, documentation of SB10HD and SB10ED (SLICOT-Reference, BSD): data and results of the example programs
SB10HD = {
    "A": "-1 0 4 5 -3 -2; -2 4 -7 -2 0 3; -6 9 -5 0 2 -1; -8 4 7 -1 -3 0; 2 5 8 -9 1 -4; 3 -5 8 0 2 -6",
    "B": "-3 -4 -2 1 0; 2 0 1 -5 2; -5 -7 0 7 -2; 4 -6 1 1 -2; -3 9 -8 0 5; 1 -2 3 -6 -2",
    "C": "1 -1 2 -4 0 -3; -3 0 5 -1 1 1; -7 5 0 -8 2 -2; 9 -3 4 0 3 7; 0 1 -2 1 -6 -2",
    "D": "0 0 0 -4 -1; 0 0 0 1 0; 0 0 0 0 1; 3 1 0 1 -3; -2 0 1 7 1",
    "AK": "88.0015 -145.7298 -46.2424 82.2168 -45.2996 -31.1407; 25.7489 -31.4642 -12.4198 9.4625 -3.5182 2.7056;"
    "54.3008 -102.4013 -41.4968 50.8412 -20.1286 -26.7191; 108.1006 -198.0785 -45.4333 70.3962 -25.8591 -37.2741;"
    "-115.8900 226.1843 47.2549 -47.8435 -12.5004 34.7474; 59.0362 -101.8471 -20.1052 36.7834 -16.1063 -26.4309",
    "BK": "3.7345 3.4758; -.3020 .6530; 3.4735 4.0499; 4.3198 7.2755; -3.9424 -10.5942; 2.1784 2.5048",
    "CK": "-2.3346 3.2556 .7150 -.9724 .6962 .4074; 7.6899 -8.4558 -2.9642 7.0365 -4.2844 .1390",
    "DK": "0 0; 0 0",
}
SB10ED = {
    "A": "-.7 0 .3 0 -.5 -.1; -.6 .2 -.4 -.3 0 0; -.5 .7 -.1 0 0 -.8; -.7 0 0 -.5 -1 0; 0 .3 .6 -.9 .1 -.4;"
    ".5 -.8 0 0 .2 -.9",
    "B": "-1 -2 -2 1 0; 1 0 1 -2 1; -3 -4 0 2 -2; 1 -2 1 0 -1; 0 1 -2 0 3; 1 0 3 -1 -2",
    "C": "1 -1 2 -2 0 -3; -3 0 1 -1 1 0; 0 2 0 -4 0 -2; 1 -3 0 0 3 1; 0 1 -2 1 0 -2",
    "D": "1 -1 -2 0 0; 0 1 0 1 0; 2 -1 -3 0 1; 0 1 0 1 -1; 0 0 1 2 1",
    "AK": "-.0551 -2.1891 -.6607 -.2532 .6674 -1.0044; -1.0379 2.3804 .5031 .3960 -.6605 1.2673;"
    "-.0876 -2.1320 -.4701 -1.1461 1.2927 -1.5116; -.1358 -2.1237 -.9560 -.7144 .6673 -.7957;"
    ".4900 .0895 .2634 -.2354 .1623 -.2663; .1672 -.4163 .2871 -.1983 .4944 -.6967",
    "BK": "-.5985 -.5464; .5285 .6087; -.7600 -.4472; -.7288 -.6090; .0532 .0658; -.0663 .0059",
    "CK": ".2500 -1.0200 -.3371 -.2733 .2747 -.4444; .0654 .2095 .0632 .2089 -.1895 .1834",
    "DK": "-.2181 -.2070; .1094 .1159",
}


def parsed(data: dict[str, str]) -> dict[str, np.ndarray]:
    return {k: np.array([row.split() for row in text.split(";")], float) for k, text in data.items()}


def random_plant(rng, dt: float) -> GeneralizedPlant:
    """Rectangular weights, cross terms, D22, and in discrete time D11; poles anywhere; no rank is lost."""
    n, nu, ny = rng.integers(1, 7), rng.integers(1, 4), rng.integers(1, 4)
    nw, nz = ny + rng.integers(1, 4), nu + rng.integers(1, 4)
    N = rng.standard_normal
    D11, D22 = N((nz, nw)) * (dt > 0), 0.1 * N((ny, nu))
    return GeneralizedPlant(
        N((n, n)), N((n, nw)), N((n, nu)), N((nz, n)), D11, N((nz, nu)), N((ny, n)), N((ny, nw)), D22, dt=dt
    )


def has_digits(P: GeneralizedPlant) -> bool:
    """Whether both Riccati equations have a condition that leaves the tests below their digits."""
    regulator = dlqr if P.dt else lqr
    sides = ((P.A, P.B2, P.C1, P.D12), (P.A.T, P.C2.T, P.B1.T, P.D21.T))
    try:
        return all(regulator(A, B, C.T @ C, D.T @ D, C.T @ D).condition < 1e8 for A, B, C, D in sides)
    except NumericalError:
        return False


TIMES = pytest.mark.parametrize("dt", [0.0, 0.5])
seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize(("data", "dt"), [(SB10HD, 0.0), (SB10ED, 1.0)])
def test_published_controllers_of_slicot(data, dt):
    """To the last digit printed; that of SB10ED has a direct term, and D11."""
    M = parsed(data)
    K = h2syn(system(M["A"], M["B"], M["C"], M["D"], dt), 2, 2).controller
    for name in "ABCD":
        np.testing.assert_allclose(getattr(K, name), M[f"{name}K"], atol=5.1e-5)


def test_example_of_octave_and_python_control():
    """Its robust_test, found there with Octave: the optimum is zero."""
    design = h2syn(system([[-1]], [[1, 1]], [[1], [1]], [[0, 1], [1, 0]], 0.0), 1, 1)
    np.testing.assert_allclose(np.ravel([getattr(design.controller, k) for k in "ABCD"]), [-3, 1, -1, 0], atol=1e-14)
    assert design.gamma < 1e-14
    assert not design.info.warnings


@TIMES
def test_scalar_closed_forms(dt):
    """Of dx = u + w1, z = (x, u), y = x + w2: X = Y = 1, or 1/2 + sqrt(5)/2, the golden ratio."""
    integrator = GeneralizedPlant(dt > 0, [1, 0], 1, [[1], [0]], np.zeros((2, 2)), [[0], [1]], 1, [0, 1], 0, dt=dt)
    design, proper = h2syn(integrator), h2syn(integrator, strictly_proper=True)
    golden = (1 + 5**0.5) / 2
    X = golden if dt else 1.0
    assert design.X == pytest.approx(X, rel=1e-12) == design.Y
    # X + R F^2 Y with R = 1 + X, F = X / R; the present measurement saves R M^2 Ry, M = F Y / Ry, Ry = 1 + Y
    assert proper.gamma**2 == pytest.approx(X + X**3 / (1 + X) if dt else 2.0, rel=1e-12)
    assert proper.gamma**2 - design.gamma**2 == pytest.approx((X * X / (1 + X)) ** 2 if dt else 0.0, abs=1e-12)
    assert not proper.controller.D.any()


@TIMES
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_measured_is_claimed_and_no_controller_near_is_better(dt, seed):
    rng = np.random.default_rng(seed)
    P = random_plant(rng, dt)
    assume(has_digits(P))
    for proper in (False, True):
        design = h2syn(P, strictly_proper=proper)
        K, best = design.controller, design.gamma
        assert best == pytest.approx(design.optimum, rel=1e-6)
        assert not (K.D.any() and (proper or not dt))
        for _ in range(4):  # numbers of K that move a little
            A, B, C, D = (M + 1e-4 * np.abs(M).max(initial=0) * rng.standard_normal(M.shape) for M in K.matrices)
            near = h2norm(P.close(StateSpace(A, B, C, 0 * D if proper else D, P.dt)))
            assert near >= best * (1 - 1e-9)
    if dt:
        assert h2syn(P).gamma <= design.gamma * (1 + 1e-9)


@TIMES
@given(seed=seeds)
@example(seed=89)  # where the loop of Dk and D22 is singular in the units given only
@settings(max_examples=10, deadline=None)
def test_units_and_coordinates_change_nothing(dt, seed):
    rng = np.random.default_rng(seed)
    P = random_plant(rng, dt)
    assume(has_digits(P))
    n, _, nu, _, ny = P.sizes
    x, u, y = (10.0 ** rng.uniform(-4, 4, k) for k in (n, nu, ny))
    w, z = 10.0 ** rng.uniform(-6, 6, 2)
    moved = GeneralizedPlant(
        P.A * x / x[:, None], P.B1 * w / x[:, None], P.B2 * u / x[:, None], z * P.C1 * x, z * w * P.D11,
        z * P.D12 * u, P.C2 * x * y[:, None], w * P.D21 * y[:, None], P.D22 * u * y[:, None], dt=dt,
    )  # fmt: skip
    design, other = h2syn(P), h2syn(moved)
    assert other.gamma == pytest.approx(w * z * design.gamma, rel=1e-7)
    for X, back in ((design.X, other.X / x / x[:, None] / z**2), (design.Y, other.Y * x * x[:, None] / w**2)):
        np.testing.assert_allclose(back, X, rtol=1e-5, atol=1e-7 * np.abs(X).max())


@TIMES
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_strictly_proper_is_lqg(dt, seed):
    """The controller of `lqg`, whose weights are the products of those here."""
    P = random_plant(np.random.default_rng(seed), dt)
    assume(has_digits(P))
    G = StateSpace(P.A, P.B2, P.C2, P.D22, dt)
    W, V = np.hstack([P.C1, P.D12]), np.vstack([P.B1, P.D21])
    K, L = h2syn(P, strictly_proper=True), lqg(G, W.T @ W, V @ V.T)
    assert h2norm(P.close(L)) == pytest.approx(K.gamma, rel=1e-6)
    for s in (0.3j, 2j):
        z = np.exp(s * dt) if dt else s
        F, H = (G.C @ np.linalg.solve(z * np.eye(G.n) - G.A, G.B) for G in (K.controller, L))
        np.testing.assert_allclose(F, H, rtol=1e-5, atol=1e-5 * np.abs(H).max())


def test_slicot():
    """In continuous time: slycot has no SB10ED."""
    slycot = pytest.importorskip("slycot", reason="the oracle is not installed")
    rng = np.random.default_rng(7)
    for _ in range(10):
        P = random_plant(rng, 0.0)
        n, nw, nu, nz, ny = P.sizes
        found = slycot.sb10hd(n, nw + nu, nz + ny, nu, ny, *P.system.matrices)
        K = h2syn(P).controller
        for ours, theirs in zip(K.matrices, found[:4], strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6 * max(np.abs(theirs).max(initial=0), 1e-3))


def test_a_direct_term_cancels_d11_in_continuous_time():
    rng = np.random.default_rng(3)
    for _ in range(10):
        P = random_plant(rng, 0.0)
        _, _, nu, _, ny = P.sizes
        D11 = P.D12 @ rng.standard_normal((nu, ny)) @ P.D21
        P = GeneralizedPlant(P.A, P.B1, P.B2, P.C1, D11, P.D12, P.C2, P.D21, P.D22)
        design = h2syn(P)
        assert design.gamma == pytest.approx(design.optimum, rel=1e-6)
        assert design.controller.D.any()
        with pytest.raises(AssumptionError, match="strictly_proper=False"):
            h2syn(P, strictly_proper=True)


def test_a_plant_without_states():
    D = np.array([[3.0, 1.0, 1.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    design = h2syn(StateSpace.gain(D, 1.0), 1, 1)
    assert design.controller.D == pytest.approx(-1.0)  # takes the second w off the first z
    assert design.gamma == pytest.approx(np.sqrt(13.0))
    with pytest.raises(AssumptionError, match="finite H2 norm"):
        h2syn(StateSpace.gain(D, 0.0), 1, 1)


ONE = {"A": -1, "B1": [1, 0], "B2": 1, "C1": [[1], [0]], "D11": np.zeros((2, 2)), "D12": [[0], [1]], "C2": 1,
       "D21": [0, 1], "D22": 0}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "dt", "assumption"),
    [
        ({"A": 1, "B2": 0}, 0.0, "(A, B2) stabilisable"),
        ({"A": 1, "C2": 0}, 0.5, "(C2, A) detectable"),
        ({"D12": [[0], [0]]}, 0.0, "D12 of full column rank"),
        ({"D21": [0, 0]}, 0.0, "D21 of full row rank"),
        ({"D11": [[0, 0], [1, 0]]}, 0.0, "D11 = 0 in continuous time, or cancelled by a direct term of the controller"),
        ({"A": 0, "C1": [[0], [0]]}, 0.0, "no zero from u to z on the stability boundary"),
        ({"A": 0, "B1": [0, 0]}, 0.0, "no zero from w to y on the stability boundary"),
        ({"A": 1, "C1": [[0], [0]]}, 0.5, "no zero from u to z on the stability boundary"),
        ({"A": 0.5, "C1": [[0], [0]], "D12": [[0], [0]]}, 0.5, "full rank from u to z"),
        ({"A": 0.5, "B1": [0, 0], "D21": [0, 0]}, 0.5, "full rank from w to y"),
    ],
)
def test_assumptions_are_named(change, dt, assumption):
    with pytest.raises(AssumptionError) as error:
        h2syn(GeneralizedPlant(**{**ONE, **change}, dt=dt))
    assert error.value.assumption == assumption


def test_cheap_control_and_perfect_measurement_in_discrete_time():
    """D12 = 0 and D21 = 0: the state is known and taken off within a sample."""
    design = h2syn(GeneralizedPlant(1, 1, 1, 1, 0, 0, 1, 0, 0, dt=1.0))
    assert design.gamma == pytest.approx(1.0)
    assert design.controller.D == pytest.approx(-1.0)


@pytest.mark.parametrize("weight", [1e-5, 1e-6, 1e-8])
def test_nearly_free_controls_in_discrete_time(weight):
    """The least norm comes down to that without weight and noise."""
    rng = np.random.default_rng(16)
    N = rng.standard_normal
    for _ in range(5):
        A, B1, b2, C1, c2 = (N(shape) for shape in ((4, 4), (4, 3), (4, 1), (3, 4), (1, 4)))
        D11, d12, d21 = N((3, 3)), N((3, 1)), N((1, 3))
        cheap, free = (
            h2syn(GeneralizedPlant(A, B1, b2, C1, D11, k * d12, c2, k * d21, 0, dt=1.0)) for k in (weight, 0.0)
        )
        assert cheap.gamma == pytest.approx(cheap.optimum, rel=1e-6)
        assert cheap.gamma == pytest.approx(free.optimum, rel=1e3 * weight)


@TIMES
def test_twenty_states_most_of_them_unstable(dt):
    rng = np.random.default_rng(17)
    N, n = rng.standard_normal, 20
    O = np.zeros((4, 4))
    P = GeneralizedPlant(
        N((n, n)), N((n, 4)), N((n, 2)), N((4, n)), O, N((4, 2)), N((2, n)), N((2, 4)), O[:2, :2], dt=dt
    )
    design = h2syn(P)
    assert np.abs(design.closed_loop.poles()).max() < 1 if dt else design.closed_loop.poles().real.max() < 0
    assert design.gamma == pytest.approx(design.optimum, rel=1e-5)


def test_wrong_arguments():
    with pytest.raises(ModelError, match="strictly_proper"):
        h2syn(GeneralizedPlant(**ONE), strictly_proper=1)
    with pytest.raises(ModelError, match="nmeas"):
        h2syn(GeneralizedPlant(**ONE).system)


def test_what_it_returns(tmp_path):
    design = h2syn(GeneralizedPlant(**ONE), 1, 1)
    K, CL, gamma, info = design
    assert (K.nstates, CL.noutputs, gamma, info.method) == (1, 2, design.gamma, "h2")
    assert f"{gamma:.7g}" in repr(design)
    again = Design.load(design.design.save(tmp_path / "design.json"))
    assert h2norm(again.closed_loop) == gamma
    assert again.gamma == design.design.gamma  # the H-infinity norm
