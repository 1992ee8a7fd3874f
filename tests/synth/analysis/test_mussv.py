"""Structured singular values from both sides: textbooks, matrices of known value, what changes nothing, replays."""

import itertools

import numpy as np
import pytest
import scipy.linalg as sla
from distillation import BLOCKS, distillation
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import ModelError, StateSpace, VerificationError, c2d, hinfnorm, lft, mussv, system

COMPLEX = [(1, 1), (2, 0), (2, 1), (1, 3), (2, 2)]
MIXED = [*COMPLEX, (-1, 0), (-2, 0)]
structures = st.lists(st.sampled_from(MIXED), min_size=1, max_size=3)


def sizes(blocks) -> tuple[int, int]:
    """Outputs and inputs of M."""
    return sum(abs(r) if c == 0 or r < 0 else c for r, c in blocks), sum(abs(r) for r, _ in blocks)


def matrix(seed: int, blocks, *, real: bool = False) -> np.ndarray:
    rng = np.random.default_rng([seed, len(blocks)])
    shape = sizes(blocks)
    return rng.normal(size=shape) + (0 if real else 1j) * rng.normal(size=shape)


def parts(blocks):
    """Block, its rows and its columns of Delta."""
    row = column = 0
    for r, c in blocks:
        rows, columns = abs(r), abs(r) if c == 0 or r < 0 else c
        yield (r, c), slice(row, row + rows), slice(column, column + columns)
        row, column = row + rows, column + columns


def drawn(rng, blocks) -> np.ndarray:
    """A random Delta of size one."""
    p, m = sizes(blocks)
    Delta = np.zeros((m, p), complex)
    for (r, c), rows, columns in parts(blocks):
        if r < 0:
            part = rng.uniform(-1, 1) * np.eye(-r)
        elif c == 0:
            part = np.exp(2j * np.pi * rng.random()) * np.eye(r)
        else:
            part = rng.normal(size=(r, c)) + 1j * rng.normal(size=(r, c))
            part /= np.linalg.norm(part, 2)
        Delta[rows, columns] = part
    return Delta


def replay(M: np.ndarray, blocks, found) -> None:
    """The perturbation has its structure and its size, and makes I - M Delta singular."""
    if found.lower == 0:
        assert not found.perturbation.any()
        return
    Delta, rest = found.perturbation, found.perturbation.copy()
    for (r, c), rows, columns in parts(blocks):
        part = Delta[rows, columns]
        if r < 0 or c == 0:
            np.testing.assert_allclose(part, part[0, 0] * np.eye(len(part)), atol=1e-12 * abs(part[0, 0]))
        assert r > 0 or abs(part[0, 0].imag) <= 1e-12 * abs(part[0, 0])
        rest[rows, columns] = 0
    assert not rest.any()
    assert np.linalg.norm(Delta, 2) == pytest.approx(1 / found.lower, rel=1e-12)
    values = np.linalg.eigvals(M @ Delta)
    assert np.abs(values - 1).min() < 1e-6
    assert np.linalg.svd(np.eye(len(M)) - M @ Delta, compute_uv=False)[-1] <= 1e-8 * (1 + np.linalg.norm(M @ Delta, 2))


def test_textbook_examples_of_matrices():
    """Skogestad and Postlethwaite (2005), example 8.5: full 3.162, diagonal 3.000."""
    M = [[2, 2], [-1, -1]]
    for blocks, expected in (([(2, 2)], np.sqrt(10)), ([(1, 1), (1, 1)], 3.0)):
        found = mussv(M, blocks)
        assert [found.upper, found.lower] == pytest.approx([expected, expected], rel=1e-6)


def test_mixed_example_of_slicot():
    """The example of SLICOT's AB13MD (bound 41.74753408), two real parameters, a full block and two complex numbers."""
    half = [
        [-1 + 6j, 2 - 3j, 3 + 8j, 3 + 8j, -5 - 9j, -6 + 2j],
        [4 + 2j, -2 + 5j, -6 - 7j, -4 + 11j, 8 - 7j, 12 - 1j],
        [5 - 4j, -4 - 8j, 1 - 3j, -6 + 14j, 2 - 5j, 4 + 16j],
    ]
    M, blocks = np.array(half + half), [(-1, 0), (-1, 0), (2, 2), (1, 1), (1, 1)]
    found = mussv(M, blocks)
    assert found.upper == pytest.approx(41.74753408, rel=1e-6)
    assert found.lower > 0.99 * found.upper
    replay(M, blocks, found)


def test_four_complex_numbers_for_which_the_bound_is_not_mu():
    """Packard and Doyle (1993), section 9.2: the scalings prove 1 and nothing better, mu is near 0.8723."""
    a, b = 3 + np.sqrt(3), np.sqrt(3) - 1
    e, f, g, h = np.sqrt(2 / a), 1 / np.sqrt(a), -np.sqrt(b / a), (1 + 1j) * np.sqrt(1 / (a * b))
    U = np.array([[e, 0], [f, f], [f, 1j * f], [g, h]])
    V = np.array([[0, e], [f, -f], [f, -1j * f], [-1j * h, -g]])
    found = mussv(U @ V.conj().T, [(1, 1)] * 4)
    assert found.upper == pytest.approx(1.0, rel=1e-6)
    assert found.lower == pytest.approx(0.8723, rel=1e-3)
    assert "between the bounds" in found.note


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.sampled_from(COMPLEX), min_size=1, max_size=4))
def test_matrices_of_rank_one(seed, blocks):
    """det(I - u v* Delta) = 1 - v* Delta u: mu is the sum of |u_i| |v_i|, of |v_i* u_i| for repeated numbers."""
    rng, (p, m) = np.random.default_rng(seed), sizes(blocks)
    u, v = rng.normal(size=p) + 1j * rng.normal(size=p), rng.normal(size=m) + 1j * rng.normal(size=m)
    expected = sum(
        abs(np.vdot(v[rows], u[columns])) if c == 0 else np.linalg.norm(u[columns]) * np.linalg.norm(v[rows])
        for (_, c), rows, columns in parts(blocks)
    )
    found = mussv(np.outer(u, v.conj()), blocks)
    assert [found.upper, found.lower] == pytest.approx([expected, expected], rel=1e-4)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 5))
def test_real_parameters_of_matrices_of_rank_one(seed, k):
    """Real matrices of rank one with real parameters: mu is the sum of |u_i v_i|."""
    rng = np.random.default_rng(seed)
    u, v = rng.normal(size=k), rng.normal(size=k)
    found = mussv(np.outer(u, v), [(-1, 0)] * k)
    assert [found.upper, found.lower] == pytest.approx([abs(u * v).sum()] * 2, rel=1e-4)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), structures)
def test_every_perturbation_is_replayed_and_no_other_contradicts(seed, blocks):
    M, rng = matrix(seed, blocks), np.random.default_rng(seed)
    found = mussv(M, blocks)
    assert found.lower <= found.upper
    assert found.residual < 1e-9 or found.lower == 0
    replay(M, blocks, found)
    for _ in range(50):
        values = np.linalg.eigvals(M @ drawn(rng, blocks))
        if all(r > 0 for r, _ in blocks):
            assert np.abs(values).max() <= found.upper
        real = values[np.abs(values.imag) <= 1e-9 * np.abs(values).max()].real
        assert real.max(initial=0.0) <= found.upper * (1 + 1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), structures, st.floats(-6, 6))
def test_what_changes_nothing(seed, blocks, power):
    """Units of the blocks' signals, unitary factors of full blocks, transposes; a factor multiplies."""
    M, rng = matrix(seed, blocks), np.random.default_rng(seed)
    expected = mussv(M, blocks).upper
    outputs, inputs, left, right = [], [], [], []
    for (r, c), rows, columns in parts(blocks):
        m, p = rows.stop - rows.start, columns.stop - columns.start
        scale = 10 ** rng.uniform(-4, 4)
        outputs += [scale] * p
        inputs += [scale] * m
        unitary = [np.linalg.qr(rng.normal(size=(k, k)) + 1j * rng.normal(size=(k, k)))[0] for k in (p, m)]
        left.append(unitary[0] if r > 0 and c else np.eye(p))
        right.append(unitary[1] if r > 0 and c else np.eye(m))
    small = 1e-6 * np.linalg.norm(M, 2)
    cases = {
        "units": (M * np.array(outputs)[:, None] / np.array(inputs), blocks, 1.0),
        "unitary": (sla.block_diag(*left) @ M @ sla.block_diag(*right), blocks, 1.0),
        "transposed": (M.T, [(r, c) if r < 0 or c == 0 else (c, r) for r, c in blocks], 1.0),
        "factor": (M * 10**power, blocks, 10**power),
    }
    for name, (N, of, factor) in cases.items():
        assert mussv(N, of).upper == pytest.approx(factor * expected, rel=2e-4, abs=factor * small), name


@pytest.mark.parametrize("k", [2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
def test_real_matrices_with_real_parameters_against_all_corners(seed, k):
    """det(I - M Delta) is affine in each parameter: the smallest ones are corners."""
    M = matrix(seed, [(-1, 0)] * k, real=True)
    found = mussv(M, [(-1, 0)] * k)
    corners = (np.linalg.eigvals(M * np.array(q)) for q in itertools.product((-1, 1), repeat=k))
    largest = max(values[np.abs(values.imag) < 1e-9].real.max(initial=0.0) for values in corners)
    assert found.lower == pytest.approx(largest, rel=1e-9)
    assert found.upper >= largest


@pytest.mark.parametrize("seed", range(6))
def test_two_real_parameters_of_complex_matrices_against_a_grid(seed):
    """Where no pair in the square of 1 / upper comes near, and the pair that was found is on the edge of its square."""
    M = matrix(seed, [(-1, 0)] * 2)
    found = mussv(M, [(-1, 0)] * 2)
    size = 0.999 / found.upper if found.upper else 1e3
    d = np.linspace(-size, size, 201)
    a, b = np.meshgrid(d, d)
    determinant = 1 - M[0, 0] * a - M[1, 1] * b + np.linalg.det(M) * a * b
    assert np.abs(determinant).min() > 1e-4
    replay(M, [(-1, 0)] * 2, found)


def test_real_parameters_that_do_no_harm():
    """1 - j delta is never zero."""
    found = mussv([[1j]], [(-1, 0)])
    assert (found.upper, found.lower, found.gap) == (0.0, 0.0, 0.0)
    assert mussv(np.zeros((2, 2)), [(1, 1), (-1, 0)]).upper == 0


def test_matrices_over_frequency():
    """As each of them alone."""
    M = np.array([matrix(seed, [(1, 1), (-1, 0)]) for seed in range(3)])
    found = mussv(M, [(1, 1), (-1, 0)])
    for i, X in enumerate(M):
        one = mussv(X, [(1, 1), (-1, 0)])
        assert (found.upper[i], found.lower[i]) == (one.upper, one.lower)
        np.testing.assert_array_equal(found.perturbation[i], one.perturbation)
    assert found.gap.shape == (3,)
    assert "3 matrices" in repr(found)


def at(G: StateSpace, w: float) -> np.ndarray:
    return G.frequency_response(w) if np.isfinite(w) else G.D.astype(complex)


def test_distillation_with_an_inverse():
    """Skogestad and Postlethwaite (2005), section 8.11.3: RP 5.77, RS 0.53, NP 0.5 with K = 0.7/s G^-1."""
    P, K = distillation()
    N = lft(P, K)
    found = mussv(N, BLOCKS)
    assert [found.upper, found.lower] == pytest.approx([5.78, 5.78], rel=2e-3)
    assert mussv(N[:2, :2], BLOCKS[:2]).upper == pytest.approx(0.53, rel=1e-2)
    assert hinfnorm(N[2:, 2:])[0] == pytest.approx(0.5, rel=1e-2)
    replay(at(N, found.frequency), BLOCKS, found)


def test_de_gaston_and_safonov():
    """De Gaston and Safonov (1988): three real parameters, unstable from 3.41739 times the box on."""
    # 800 (1 + .1 a)(s + 2) / (s (s + 4 + .2 b)(s + 6 + .3 c)(s + 10)) with unity feedback, the integrator last
    A = np.array([[-4.0, 0, -800, 1600], [1, -6, 0, 0], [0, 1, -10, 0], [0, 0, -1, 0]])
    B = np.array([[800.0, 1, 0], [0, 0, 1], [0, 0, 0], [0, 0, 0]])
    C = np.array([[0, 0, -0.1, 0.2], [-0.2, 0, 0, 0], [0, -0.3, 0, 0]])
    found = mussv(StateSpace(A, B, C, np.zeros((3, 3))), [(-1, 0)] * 3)
    assert 1 / found.lower == pytest.approx(3.417392, rel=1e-5)
    assert found.upper >= found.lower
    perturbed = A + B @ found.perturbation.real @ C
    assert np.linalg.eigvals(perturbed).real.max() == pytest.approx(0, abs=1e-6)


def random_system(seed: int, blocks, n: int, damping: float) -> StateSpace:
    rng, (p, m) = np.random.default_rng([seed, n]), sizes(blocks)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + damping) * np.eye(n)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), rng.normal(size=(p, m)))


@settings(max_examples=5, deadline=None)
@given(
    st.integers(0, 10_000),
    st.lists(st.sampled_from(MIXED), min_size=1, max_size=2),
    st.integers(2, 6),
    st.sampled_from([0.02, 0.3, 1.0]),
    st.booleans(),
)
def test_systems_are_bounded_at_all_frequencies(seed, blocks, n, damping, discrete):
    """No frequency of a fine grid is above, the perturbation is replayed at its frequency."""
    G = random_system(seed, blocks, n, damping)
    G = c2d(G, 0.3, "tustin") if discrete else G
    found = mussv(G, blocks, tol=1e-3)
    assert found.lower <= found.upper
    replay(at(G, found.frequency), blocks, found)
    grid = np.concatenate([np.geomspace(1e-2, 10 if discrete else 1e3, 15), found.peak * np.linspace(0.97, 1.03, 5)])
    for w in grid[grid < (np.pi / 0.3 if discrete else np.inf)]:
        assert mussv(at(G, w), blocks).upper <= found.upper
    continuous = any(r >= 0 for r, _ in blocks)  # with real blocks alone the bound may jump beside its peak
    if continuous and found.upper > 1.1e-6 * hinfnorm(G)[0]:  # below, mu is told from zero no more
        assert mussv(at(G, found.peak), blocks).upper >= found.upper / (1 + 1.1e-3)


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([[(1, 1), (2, 2)], [(-1, 0), (2, 1)], [(-2, 0), (1, 1)]]))
def test_units_of_time_and_states_change_nothing(seed, blocks):
    G = random_system(seed, blocks, 4, 0.1)
    expected = mussv(G, blocks)
    rng = np.random.default_rng(seed)
    slower = StateSpace(G.A * 1e-4, G.B * 1e-4, G.C, G.D)
    turned = G.transform(np.linalg.qr(rng.normal(size=(4, 4)))[0] * 10 ** rng.uniform(-3, 3, 4))
    for H, rate in ((slower, 1e-4), (turned, 1.0)):
        found = mussv(H, blocks)
        assert found.upper == pytest.approx(expected.upper, rel=3e-4)
        assert found.peak in (0, np.inf) or abs(np.log(found.peak / (rate * expected.peak))) < 0.1


@pytest.mark.parametrize(
    "blocks",
    [
        [(1, 1)],
        [(0, 2), (2, 2)],
        [(-2, 1), (1, 1)],
        [(1.5, 1), (1, 1)],
        "full",
        None,
        [],
        [(2, 2, 2)],
        [(np.nan, 1)],
        3,
    ],
)
def test_wrong_blocks_are_named(blocks):
    with pytest.raises(ModelError, match="blocks"):
        mussv(np.ones((3, 3)), blocks)


def test_unstable_systems_are_refused():
    with pytest.raises(VerificationError, match="not stable"):
        mussv(system([1], [1, -1]), [(1, 1)])
