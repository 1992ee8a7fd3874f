"""Gap and nu-gap against closed forms, the literature, another definition, and another algorithm."""

import numpy as np
import pytest
from scipy.signal import tf2ss

from synth.analysis.coprime import ncfmargin, right_factors
from synth.analysis.gap import gapmetric, nugap
from synth.errors import AssumptionError, ModelError
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.parameters import ureal
from synth.systems.sampled import c2d, on_circle
from synth.systems.statespace import StateSpace
from synth.systems.uncertain import UncertainSystem


def tf(num, den) -> StateSpace:
    return StateSpace(*tf2ss(num, den))


def random_system(seed: int, spread: float = 1.0) -> StateSpace:
    """Continuous, 2 inputs and 2 outputs, 1 to 4 states."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    A, B, C = (spread * rng.normal(size=s) for s in ((n, n), (n, 2), (2, n)))
    return StateSpace(A - 0.3 * np.eye(n), B, C, spread * rng.normal(size=(2, 2)))


def perturbed(G: StateSpace, seed: int, size: float) -> StateSpace:
    rng = np.random.default_rng(seed)
    return StateSpace(*(getattr(G, k) + size * rng.normal(size=getattr(G, k).shape) for k in "ABCD"), G.dt)


A, B, C = tf([100], [2, 1]), tf([100], [2, -1]), tf([100], [1, 2, 1])


def test_vinnicombe_examples():
    """100/(2s+1), 100/(2s-1), 100/(s+1)^2: stability is no distance (Zhou and Doyle 1998, section 17.2)."""
    assert gapmetric(A, B).nugap == pytest.approx(200 / 10001, rel=1e-6)  # chordal distance at rest
    assert gapmetric(A, C).nugap == pytest.approx(0.8988, abs=5e-5)
    assert gapmetric(A, B).gap == pytest.approx(0.0200, abs=5e-5)
    assert gapmetric(A, C).gap == pytest.approx(0.8988, abs=5e-5)
    assert gapmetric(B, C) == pytest.approx((0.8941, 0.8941), abs=5e-5)


def test_matlabs_documentation():
    """Robust Control Toolbox, reference page of gapmetric; its gap is an upper bound within 1e-3."""
    gap, nugap = gapmetric(tf([1, 2], [1, 5, 10]), tf([1, 1], [1, 3, 10]))
    assert nugap == pytest.approx(0.1390, abs=1e-4)
    assert 0.1391 - 1e-3 <= gap <= 0.1391
    gap, nugap = gapmetric(tf([1], [1, -0.001]), tf([1], [1, 0.001]))
    assert nugap == pytest.approx(0.0020, abs=5e-5)
    assert 0.0021 - 1e-3 <= gap <= 0.0021


def test_constants_lie_on_the_sphere():
    zero = np.zeros
    plants = [StateSpace(zero((0, 0)), zero((0, 1)), zero((1, 0)), [[k]]) for k in (1.0, 2.0, -1.0)]
    assert gapmetric(plants[0], plants[1]) == pytest.approx((1 / np.sqrt(10),) * 2)
    assert gapmetric(plants[0], plants[2]) == pytest.approx((1, 1))  # antipodes


def test_integrators_of_opposite_sign_are_as_far_as_can_be():
    assert gapmetric(tf([1], [1, 0]), tf([-1], [1, 0])) == (1, 1)
    assert gapmetric(tf([1], [1, 0.1, 1]), tf([1], [1, -1, 0, 0, 0])) == (1, 1)


def as_defined(P1: StateSpace, P2: StateSpace) -> float:
    """Vinnicombe's definition on a dense grid, without factors.

    1 unless wno det(I + P2~ P1) = unstable poles of P1 - those of P2; else the largest chordal distance.
    """
    values, distances = [], []
    for omega in np.geomspace(1e-5, 1e6, 6000):
        Y, U = P1.frequency_response(omega), P2.frequency_response(omega)
        values.append(np.linalg.det(np.eye(2) + U.conj().T @ Y))
        left = np.linalg.inv(np.linalg.cholesky(np.eye(2) + U @ U.conj().T))
        right = np.linalg.inv(np.linalg.cholesky(np.eye(2) + Y.conj().T @ Y))
        distances.append(np.linalg.norm(left @ (Y - U) @ right.conj().T, 2))
    angle = np.unwrap(np.angle([*np.conj(values[::-1]), *values]))  # from -infinity to infinity
    turns = round((angle[-1] - angle[0]) / (2 * np.pi))
    unstable = [int((P.poles().real > 0).sum()) for P in (P1, P2)]
    return max(distances) if turns == unstable[0] - unstable[1] else 1.0


@pytest.mark.slow
def test_nu_gap_as_defined():
    """Both sides of the winding condition occur."""
    found = []
    for seed in range(24):
        P1 = random_system(seed)
        P2 = random_system(seed + 1000) if seed % 2 else perturbed(P1, seed, 0.3)
        found.append(gapmetric(P1, P2).nugap)
        assert found[-1] == pytest.approx(as_defined(P1, P2), rel=1e-5)
    assert 4 < found.count(1.0) < 20


def toeplitz_gap(R1: StateSpace, R2: StateSpace, inputs: int) -> float:
    """Distance of the graph of R1, for that many input samples, from the graph of R2; rises to the directed gap.

    The projection of R1 f on the graph of R2 has the norm of the causal part of R2~ R1 f, a Toeplitz operator.
    """
    length = inputs + 300

    def impulse(R):
        h, x = [R.D], R.B
        for _ in range(2 * length):
            h.append(R.C @ x)
            x = R.A @ x
        return np.array(h)

    h1, h2 = impulse(R1), impulse(R2)
    lag = {
        k: sum(h2[j].T @ h1[j + k] for j in range(max(0, -k), min(len(h1), len(h1) - k)))
        for k in range(-inputs, length)
    }
    T = np.block([[lag[i - j] for j in range(inputs)] for i in range(length)])
    return float(np.sqrt(1 - np.linalg.svd(T, compute_uv=False)[-1] ** 2))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2, 5])
def test_gap_is_the_distance_of_the_graphs(seed):
    """Both directed gaps as norms of a truncated operator, which here has converged to rounding."""
    P1 = random_system(seed)
    P2 = perturbed(P1, seed, 0.2)
    gap, nugap = gapmetric(P1, P2)
    assert gap > 1.05 * nugap
    R1, R2 = map(right_factors, on_circle(3.0, P1, P2))
    assert toeplitz_gap(R1, R2, 100) == pytest.approx(gap, abs=1e-7)
    assert toeplitz_gap(R2, R1, 100) == pytest.approx(gap, abs=1e-7)


def test_metric_properties():
    """Symmetric, zero on the diagonal, triangle inequality of the arcsines, nu-gap below gap."""
    base = random_system(3)
    plants = [base, *(perturbed(base, k, 0.15 * k) for k in range(1, 5)), random_system(40)]
    n = len(plants)
    table = {(i, j): gapmetric(plants[i], plants[j]) for i in range(n) for j in range(n)}
    for i in range(n):
        assert table[i, i].nugap < 1e-12
        assert table[i, i].gap < 5e-6
        for j in range(n):
            assert table[i, j] == pytest.approx(table[j, i], abs=1e-7)
            assert 0 <= table[i, j].nugap <= table[i, j].gap <= 1
            for k in range(n):
                for name in ("gap", "nugap"):
                    a, b, c = (np.arcsin(getattr(table[p], name)) for p in ((i, j), (j, k), (i, k)))
                    assert c <= a + b + 1e-6


def test_discrete_plants_and_the_tustin_map():
    """The bilinear map moves frequencies only, so that both metrics stay."""
    P1 = random_system(7)
    P2 = perturbed(P1, 1, 0.2)
    continuous = gapmetric(P1, P2)
    assert gapmetric(c2d(P1, 0.05, "tustin"), c2d(P2, 0.05, "tustin")) == pytest.approx(continuous, abs=1e-6)
    assert gapmetric(c2d(A, 0.01), c2d(B, 0.01)) == pytest.approx(gapmetric(A, B), abs=1e-3)


def test_a_margin_above_the_gap_survives():
    """arcsin b(P2, K) >= arcsin b(P1, K) - arcsin nugap(P1, P2)."""
    P1 = random_system(12)
    K = ncfsyn(P1).controller
    b1 = ncfmargin(P1, K, 1)
    kept = 0
    for seed in range(20):
        P2 = perturbed(P1, seed, 0.03)
        distance = gapmetric(P1, P2).nugap
        if distance < b1:
            kept += 1
            assert np.arcsin(ncfmargin(P2, K, 1)) >= np.arcsin(b1) - np.arcsin(distance) - 1e-6
    assert kept > 5


def test_bad_input_is_named():
    with pytest.raises(ModelError, match="G1 is 1 x 1, G2 is 2 x 2"):
        gapmetric(A, random_system(1))
    with pytest.raises(ModelError, match="timebases"):
        gapmetric(A, c2d(A, 0.1))
    hidden = StateSpace(np.diag([1.0, -2.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    with pytest.raises(AssumptionError, match="eigenvalue 1 "):
        gapmetric(hidden, A)


def test_the_member_that_covers_a_set_best():
    """RobustAndOptimalControl.jl, issue 80: of a set the plant whose farthest neighbour is nearest."""
    models = [tf([k], [1, 1]) for k in (1.0, 2.0, 3.0, 6.0)]
    found = nugap(models)
    table = np.array([[gapmetric(F, G).nugap for G in models] for F in models])
    assert found.index == table.max(axis=1).argmin()
    assert found.radius == pytest.approx(table.max(axis=1).min(), abs=1e-6)
    assert nugap(models, models[0]).radius == pytest.approx(table[0].max(), abs=1e-6)
    assert nugap(models, models[0]).index is None
    K = ncfsyn(found.nominal).controller
    assert ncfmargin(found.nominal, K, 1) > found.radius
    assert min(ncfmargin(G, K, 1) for G in models) > 0
    with pytest.raises(ModelError, match="models"):
        nugap([])


def test_the_models_of_a_box():
    a = ureal("a", 1.0, percentage=30)
    G = UncertainSystem(A=-a, B=1, C=1)
    found = nugap(G)
    assert 0 < found.radius < 0.3
    assert found.radius >= nugap([found.nominal, *(H for _, H in G.gridded(2))], found.nominal).radius - 1e-7


def chordal(G1: StateSpace, G2: StateSpace, T: float, w: np.ndarray) -> np.ndarray:
    """The distance of the responses of G1 and G2 e^(-s T) at frequencies."""

    def root(M: np.ndarray) -> np.ndarray:
        e, V = np.linalg.eigh(M)
        return (V / np.sqrt(1 + e)) @ V.conj().T

    found = []
    for p, q, turn in zip(G1.frequency_response(w), G2.frequency_response(w), np.exp(-1j * w * T), strict=True):
        found.append(np.linalg.norm(root(q @ q.conj().T) @ (p - q * turn) @ root(p.conj().T @ p), 2))
    return np.array(found)


@pytest.mark.parametrize("T", [1e-6, 1e-3, 0.1, 0.5, -0.2])
@pytest.mark.parametrize("seed", range(4))
def test_plants_of_which_one_acts_later(seed, T):
    """Their nu-gap is the largest distance of the responses, the gap no less."""
    rng = np.random.default_rng(seed)
    m, p, n = 1 + seed % 2, 1 + seed // 2 % 2, 3
    A = rng.normal(size=(n, n)) - 1.5 * np.eye(n)
    G1 = StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), np.zeros((p, m)))
    G2 = StateSpace(A * (1 + 0.2 * (seed > 1)), G1.B, G1.C, G1.D)
    found = gapmetric(G1, G2, delay=T)
    w = np.concatenate([[0.0], np.geomspace(1e-3, 1e8, 40_001)])
    assert found.nugap == pytest.approx(chordal(G1, G2, T, w).max(), rel=1e-5, abs=2e-9)
    assert found.gap >= found.nugap * (1 - 1e-6)
    assert gapmetric(G2, G1, delay=-T).nugap == pytest.approx(found.nugap, rel=1e-6)


def test_delays_of_plants_that_are_sampled_and_of_sets():
    G, h = StateSpace([[-1.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], [[1.0, 0.0]], 0), 0.1
    H = c2d(G, h)
    assert gapmetric(H, H, delay=0.2).nugap == pytest.approx(gapmetric(H, c2d(G, h, delay=0.2)).nugap, rel=1e-9)
    fine = 1e-3
    assert gapmetric(c2d(G, fine), c2d(G, fine, delay=0.25)).nugap == pytest.approx(
        gapmetric(G, G, delay=0.25).nugap, rel=1e-3
    )
    found = nugap([G, G, G], delays=[0.0, 0.1, 0.3])
    assert found.index == 1
    assert found.radius == pytest.approx(gapmetric(G, G, delay=0.2).nugap, rel=1e-9)
    assert nugap([G, G], G, delays=[0.3, 0.1]).radius == pytest.approx(gapmetric(G, G, delay=0.3).nugap, rel=1e-9)
    with pytest.raises(ModelError, match="for each of the 2 models"):
        nugap([G, G], delays=[0.1])
    with pytest.raises(ModelError, match="ever higher frequencies"):
        gapmetric(G, StateSpace(G.A, G.B, G.C, [[1.0]]), delay=0.1)
    with pytest.raises(ModelError, match="pass whole samples"):
        gapmetric(H, H, delay=0.25)
