"""Optima, margins, distances and norms in closed form; each docstring says where the form comes from.

`info.optimum` is compared with the form; `gamma`, the verified norm of what is returned, may lie 1.1e-3 above it.
"""

import numpy as np
import pytest
from scipy.linalg import block_diag, eigh

from synth.analysis.coprime import gang_of_four, ncfmargin
from synth.analysis.gap import gapmetric
from synth.analysis.norms import h2norm, hinfnorm
from synth.regulators.regulator import dlqr, lqr
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.synthesis.mixedsensitivity import mixsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, system

REACHED = 1.1e-3  # relative, of the verified norm above the optimum
EXACT = 1e-6  # relative, of the optimum; 5e-6 where the infimum is approached and not attained
METHODS = ("riccati", "lmi")
FULL = [*METHODS, *(pytest.param(m, marks=pytest.mark.slow) for m in ("standard", "extended"))]
GOLDEN = (1 + np.sqrt(5)) / 2


def tf(*num_den) -> StateSpace:
    """A scalar transfer function."""
    return system(num_den)


def gain(k) -> StateSpace:
    """A scalar without states."""
    return StateSpace.gain([[float(k)]], 0.0)


def lag(a, k=1.0, dt=0.0) -> StateSpace:
    """k / (s + a); sampled, k / (z - a)."""
    return StateSpace([[a if dt else -a]], [[k]], [[1.0]], [[0.0]], dt)


def turned(*systems: StateSpace) -> StateSpace:
    """Systems side by side, their states, inputs and outputs mixed by orthogonal matrices."""
    A, B, C, D = (block_diag(*(getattr(G, k) for G in systems)) for k in "ABCD")
    rng = np.random.default_rng(5)
    T, U, V = (np.linalg.qr(rng.normal(size=(n, n)))[0] for n in (len(A), D.shape[1], len(D)))
    return StateSpace(T.T @ A @ T, T.T @ B @ U, V @ C @ T, V @ D @ U, systems[0].dt)


def check(design, expected, within=EXACT) -> None:
    """The optimum is the closed form, and a controller that was measured comes to it."""
    assert design.info.optimum == pytest.approx(expected, rel=within)
    assert expected * (1 - 1e-6) <= design.gamma <= expected * (1 + REACHED)


def cases(table, methods=METHODS):
    """Every row with every method; the row's first entry is its name."""
    return [
        pytest.param(*row[1:], getattr(m, "values", (m,))[0], id=f"{row[0]}-{getattr(m, 'values', (m,))[0]}",
                     marks=getattr(m, "marks", ()))
        for row in table for m in methods
    ]  # fmt: skip


# ---------------------------------------------------------------------------------------------------- ncfsyn

COPRIME = [
    # k/(s + a) has X = (r - a)/k^2 and Z = r - a with r^2 = a^2 + k^2: optimum 1/cos(angle/2), tan(angle) = k/a
    ("1/(s+1)", lag(1), np.sqrt(4 - 2 * np.sqrt(2))),
    ("1/(s-1)", lag(-1), np.sqrt(4 + 2 * np.sqrt(2))),
    ("4/(s+3)", lag(3, 4), np.sqrt(5) / 2),
    ("3/(s+4)", lag(4, 3), np.sqrt(10) / 3),
    ("12/(s+5)", lag(5, 12), np.sqrt(13) / 3),
    ("4/(s-3)", lag(-3, 4), np.sqrt(5)),
    ("3/(s-4)", lag(-4, 3), np.sqrt(10)),
    ("12/(s-5)", lag(-5, 12), np.sqrt(13) / 2),
    ("100/s", lag(0, 100), np.sqrt(2)),
    # 1/(s^2 + c): h^2 = 1 + c^2, b = h - c, optimum^2 = 1 + (b + sqrt(2 b h))^2
    ("1/(s^2+1)", tf([1], [1, 0, 1]), np.sqrt(1 + (np.sqrt(2) - 1 + np.sqrt(4 - 2 * np.sqrt(2))) ** 2)),
    ("1/(s^2-1)", tf([1], [1, 0, -1]), np.sqrt(1 + (np.sqrt(2) + 1 + np.sqrt(4 + 2 * np.sqrt(2))) ** 2)),
    ("1/(s^2+3/4)", tf([1], [1, 0, 0.75]), np.sqrt(1 + GOLDEN**2)),
    ("1/(s^2-3/4)", tf([1], [1, 0, -0.75]), np.sqrt(1 + GOLDEN**6)),
    ("1/(s^2+4/3)", tf([1], [1, 0, 4 / 3]), np.sqrt(1 + ((1 + np.sqrt(10)) / 3) ** 2)),
    # k/(z - p): Z = k^2 X with k^2 X^2 + (1 - p^2 - k^2) X = 1
    ("1/(z-1)", lag(1, 1, 1.0), np.sqrt(1 + GOLDEN**2)),
    ("1/(z-2)", lag(2, 1, 0.1), np.sqrt(1 + GOLDEN**6)),
    ("1/z", lag(0, 1, 0.5), np.sqrt(2)),
    ("3/(z-3)", lag(3, 3, 1.0), np.sqrt(1 + ((17 + np.sqrt(325)) / 6) ** 2)),
    # independent axes: the worst of them
    ("4/(s-3) and 3/(s+4)", turned(lag(-3, 4), lag(4, 3)), np.sqrt(5)),
    ("three of 1/s^2", turned(*[tf([1], [1, 0, 0])] * 3), np.sqrt(4 + 2 * np.sqrt(2))),
]


@pytest.mark.parametrize(("G", "expected", "method"), cases(COPRIME))
def test_ncfsyn(G, expected, method):
    """sqrt(1 + rho(XZ)) of Glover and McFarlane (1989), X and Z solved by hand; and the margin of the controller."""
    design = ncfsyn(G, method=method)
    assert design.info.optimum == pytest.approx(expected, rel=EXACT)
    assert design.gamma <= design.info.level == pytest.approx(1.1 * expected, rel=EXACT)
    assert ncfmargin(G, design.controller, 1) == pytest.approx(1 / design.gamma, rel=1e-5)


FOUR_BLOCK = [
    row for row in COPRIME if row[0] in ("4/(s+3)", "3/(s-4)", "1/(s^2+3/4)", "1/(z-1)", "4/(s-3) and 3/(s+4)")
]


@pytest.mark.parametrize(("G", "expected", "method"), cases(FOUR_BLOCK, FULL))
def test_hinfsyn_of_the_four_blocks(G, expected, method):
    """The same optima as those of a general problem, [I; K](I - GK)^-1 [I, G]."""
    check(hinfsyn(gang_of_four(G), method=method), expected)


@pytest.mark.parametrize("c", [0.5, 0.75, 1, 4 / 3, 10])
def test_ncfmargin_of_an_integrator(c):
    """1/s with the gain c: the norm^2 is (1 + c^2)(w^2 + 1)/(w^2 + c^2), largest at rest or at infinity."""
    assert ncfmargin(lag(0), gain(c)) == pytest.approx(min(c, 1) / np.hypot(1, c), rel=EXACT)


# ---------------------------------------------------------------------------------------------------- hinfsyn


def regulator(a, q) -> GeneralizedPlant:
    """dx = a x + q w1 + u, z = (q x, u), y = x + w2."""
    O = np.zeros
    return GeneralizedPlant([[a]], [[q, 0]], [[1.0]], [[q], [0]], O((2, 2)), [[0], [1]], [[1.0]], [[0, 1]], [[0.0]])


def estimator(a) -> GeneralizedPlant:
    """dx = a x + w1, z = x - u, y = x + w2."""
    return GeneralizedPlant([[a]], [[1, 0]], [[0.0]], [[1.0]], [[0, 0]], [[-1.0]], [[1.0]], [[0, 1]], [[0.0]])


def parrott(a, b, c, d) -> GeneralizedPlant:
    """[a b; c d + K], beside a state that nothing reaches."""
    a, b, c, d = (np.atleast_2d(np.asarray(x, dtype=float)) for x in (a, b, c, d))
    O, (r1, c1), r2, c2 = np.zeros, a.shape, len(c), b.shape[1]
    return GeneralizedPlant(
        [[-1.0]], O((1, c1 + c2)), O((1, r2)), O((r1 + r2, 1)), np.block([[a, b], [c, d]]),
        np.eye(r1 + r2)[:, r1:], O((c2, 1)), np.eye(c1 + c2)[c1:], O((c2, r2)),
    )  # fmt: skip


def sampled(P: GeneralizedPlant, dt) -> GeneralizedPlant:
    """Through the bilinear map, which keeps norms."""
    _, _, nu, _, ny = P.sizes
    return GeneralizedPlant.partition(c2d(P.system, dt, "tustin"), ny, nu)


REGULATORS = [  # a, q: a + sqrt(a^2 + 2 q^2)
    ("a=0", 0, 1, np.sqrt(2)), ("a=1/2", 0.5, 1, 2.0), ("a=1", 1, 1, 1 + np.sqrt(3)), ("a=1 q=2", 1, 2, 4.0),
    ("a=-1", -1, 1, np.sqrt(3) - 1), ("a=-1 q=2", -1, 2, 2.0), ("a=2 q=4", 2, 4, 8.0),
    ("a=10", 10, 1, 10 + np.sqrt(102)),
]  # fmt: skip


@pytest.mark.parametrize(("a", "q", "expected", "method"), cases(REGULATORS, FULL))
def test_hinfsyn_of_a_scalar_regulator(a, q, expected, method):
    """Doyle, Glover, Khargonekar and Francis (1989): X = Y, and X = gamma in 2aX + (q^2/gamma^2 - 1)X^2 + q^2 = 0."""
    check(hinfsyn(regulator(a, q), method=method), expected)


@pytest.mark.parametrize(("a", "q", "expected", "method"), cases(REGULATORS[2:5]))
def test_hinfsyn_of_a_sampled_scalar_regulator(a, q, expected, method):
    """The same optima after the bilinear map, in steps of 0.1 s."""
    check(hinfsyn(sampled(regulator(a, q), 0.1), method=method), expected)


ESTIMATORS = [("a=-1", -1, np.sqrt(0.5)), ("a=-3/4", -0.75, 0.8), ("a=-4/3", -4 / 3, 0.6)]


@pytest.mark.parametrize(
    ("a", "expected", "method"), cases(ESTIMATORS, ["lmi", pytest.param("riccati", marks=pytest.mark.slow)])
)
def test_hinfsyn_of_a_scalar_estimator(a, expected, method):
    """2aY + (1/gamma^2 - 1)Y^2 + 1 = 0 has real solutions down to gamma = 1/sqrt(1 + a^2), the smoother's error."""
    check(hinfsyn(estimator(a), method=method), expected, 5e-6)


PARROTT = [
    ("row", 1, 2, 2, 0, np.sqrt(5)), ("row wins", 3, 4, 0, 7, 5.0), ("d large", 0.5, 0.5, 0.1, 0.5, np.sqrt(0.5)),
    ("column", 1, 0, 2, 9, np.sqrt(5)),
    ("2 x 1 beside", [[3, 0], [0, 1]], [[4], [0]], [[0, 1]], [[5]], 5.0),
]  # fmt: skip


@pytest.mark.parametrize(("a", "b", "c", "d", "expected", "method"), cases(PARROTT, FULL))
def test_hinfsyn_of_parrotts_problem(a, b, c, d, expected, method):
    """Parrott (1978); Zhou, Doyle and Glover (1996), section 2.11: max(|[a b]|, |[a; c]|), whatever d is."""
    check(hinfsyn(parrott(a, b, c, d), method=method), expected)


# ---------------------------------------------------------------------------------------------------- mixsyn


def pick(points, values) -> float:
    """Least norm of a stable function with these values there: Nevanlinna and Pick."""
    points, values = np.array(points, dtype=complex), np.array(values)
    sums = points[:, None] + points.conj()
    return np.sqrt(eigh(np.outer(values, values.conj()) / sums, 1 / sums, eigvals_only=True).max())


W, STRICT = tf([1, 2], [2, 1]), tf([1, 1], [0.1, 2])
w, strict = (lambda s: (s + 2) / (2 * s + 1)), (lambda s: (s + 1) / (0.1 * s + 2))
SENSITIVITY = [  # plant, W1, W3, expected. S is 1 at zeros and 0 at poles to the right, T the other way round
    ("W S, zero 1", tf([1, -1], [1, 3]), W, None, 1.0),
    ("W S, zero 2", tf([1, -2], [1, 3]), W, None, 0.8),
    ("W S, zero 1/2", tf([1, -0.5], [1, 3]), W, None, 1.25),
    ("S, zero 2 and pole 1", tf([1, -2], [1, -1]), 1.0, None, 3.0),
    ("T, zero 2 and pole 1", tf([1, -2], [1, -1]), None, 1.0, 3.0),
    ("W S, zero 2 and pole 1", tf([1, -2], [1, -1]), W, None, 2.4),
    ("S, zero 1 and pole 2", tf([1, -1], [1, -2]), 1.0, None, 3.0),
    ("T, zero 4 and pole 1", tf([1, -4], [1, -1]), None, 1.0, 5 / 3),
    ("W S, zero 4 and pole 1", tf([1, -4], [1, -1]), W, None, 10 / 9),
    ("S, zero 1 and pole 3", tf([1, -1], [1, -3]), 1.0, None, 2.0),
    ("S, zeros 1 and 2, pole 5", tf([1, -3, 2], [1, -2, -15]), 1.0, None, 3.5),
    ("V T, pole 1", tf([1, 2], [1, -1]), None, STRICT, 2 / 2.1),
    ("V T, pole 3", tf([1, 2], [1, -3]), None, STRICT, 4 / 2.3),
    ("V T, poles 1 and 3", tf([1, 4, 4], [1, -4, 3]), None, STRICT, pick([1, 3], [strict(1), strict(3)])),
    ("W S, zeros 1 + i", tf([1, -2, 2], [1, 6, 9]), W, None, pick([1 + 1j, 1 - 1j], [w(1 + 1j), w(1 - 1j)])),
    ("W S, zeros 1 and 2 of two axes", turned(tf([1, -1], [1, 3]), tf([1, -2], [1, 3])), W, None, 1.0),
]


@pytest.mark.parametrize(("G", "W1", "W3", "expected", "method"), cases(SENSITIVITY))
def test_mixsyn_of_one_block(G, W1, W3, expected, method):
    """Doyle, Francis and Tannenbaum (1992), 6.2: |W(z)| |z + p|/|z - p|; Nevanlinna and Pick for more conditions."""
    check(mixsyn(G, W1, None, W3, method=method), expected, 5e-6)


def test_mixsyn_of_one_block_with_two_zeros():
    """Zeros 1 and 2, W = 1 and 0.8 there: Pick's determinant g^2 - 1.96 g + 0.64 is zero for g = gamma^2."""
    expected = np.sqrt(0.98 + np.sqrt(0.98**2 - 0.64))
    assert pick([1, 2], [w(1), w(2)]) == pytest.approx(expected, rel=1e-12)
    check(mixsyn(tf([1, -3, 2], [1, 6, 9]), W), expected, 5e-6)


STABILISE = [  # the least |K S| is 1/(smallest Hankel singular value of the antistable part)
    ("1/(s-1)", tf([1], [1, -1]), 2.0),
    ("2/(s-3)", tf([2], [1, -3]), 3.0),
    ("4/(s-1/2)", tf([4], [1, -0.5]), 0.25),
    ("1/(s-1) + 1/(s+1)", tf([2, 0], [1, 0, -1]), 2.0),
    ("2/(s-3) + 5/(s+1)", tf([7, -13], [1, -2, -3]), 3.0),
    ("1/((s-1)(s-2))", tf([1], [1, -3, 2]), 3 * (np.sqrt(17) + 3)),
    ("1/((s-1)^2+1)", tf([1], [1, -2, 2]), 4 * (np.sqrt(3) + 1)),
    ("1/(s-1), 2/(s-3), 1/(s+1)", turned(lag(-1), lag(-3, 2), lag(1)), 3.0),
]


@pytest.mark.parametrize(("G", "expected", "method"), cases(STABILISE))
def test_mixsyn_of_the_effort(G, expected, method):
    """Glover (1986), Int. J. Control 43, 741; Skogestad and Postlethwaite (2005), section 5.3: input to stabilise."""
    check(mixsyn(G, None, 1.0, method=method), expected)


# ---------------------------------------------------------------------------------------------------- distances, norms

GAPS = [
    ("0 and 1", gain(0), gain(1), np.sqrt(0.5)), ("0 and 3/4", gain(0), gain(0.75), 0.6),
    ("1/2 and -1/2", gain(0.5), gain(-0.5), 0.8), ("1 and 7", gain(1), gain(7), 0.6),
    ("4/3 and -3/4", gain(4 / 3), gain(-0.75), 1.0),
    # k/(s + 1): the distance is largest where |s + 1|^2 = k1 k2, or at rest; of k/s and of k/s^2 (k2 - k1)/(k2 + k1)
    ("1/(s+1) and 2/(s+1)", lag(1), lag(1, 2), 1 / 3), ("1/(s+1) and 4/(s+1)", lag(1), lag(1, 4), 0.6),
    ("1/2/(s+1) and 1/(s+1)", lag(1, 0.5), lag(1), np.sqrt(0.1)),
    ("1/s and 2/s", lag(0), lag(0, 2), 1 / 3), ("2/s and 18/s", lag(0, 2), lag(0, 18), 0.8),
    ("1/s^2 and 9/s^2", tf([1], [1, 0, 0]), tf([9], [1, 0, 0]), 0.8),
    # 1/(s + a) and 1/(s - a): 2a/(1 + a^2), at rest
    ("1/(s+1/2) and 1/(s-1/2)", lag(0.5), lag(-0.5), 0.8), ("1/(s+1/3) and 1/(s-1/3)", lag(1 / 3), lag(-1 / 3), 0.6),
]  # fmt: skip


@pytest.mark.parametrize(("G1", "G2", "expected"), [row[1:] for row in GAPS], ids=[row[0] for row in GAPS])
def test_gapmetric(G1, G2, expected):
    """Vinnicombe's chordal distance |g1 - g2|/(sqrt(1 + |g1|^2) sqrt(1 + |g2|^2)); Zhou and Doyle (1998), 17.2."""
    gap, nugap = gapmetric(G1, G2)
    assert nugap == pytest.approx(expected, rel=EXACT)
    assert nugap <= gap * (1 + EXACT)


@pytest.mark.parametrize("zeta", [0.5, 0.1, 1e-2, 1e-4])
def test_norms_of_a_resonance(zeta):
    """1/(s^2 + 2 zeta s + 1): 1/(2 zeta sqrt(1 - zeta^2)), and the energy 1/(4 zeta)."""
    G = tf([1], [1, 2 * zeta, 1])
    assert hinfnorm(G)[0] == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-9)
    assert h2norm(G) == pytest.approx(1 / np.sqrt(4 * zeta), rel=1e-9)


@pytest.mark.parametrize("p", [0.0, 0.6, -0.8])
def test_norms_of_a_sampled_lag(p):
    """1/(z - p): 1/(1 - |p|), and the energy 1/(1 - p^2)."""
    G = lag(p, 1, 1.0)
    assert hinfnorm(G)[0] == pytest.approx(1 / (1 - abs(p)), rel=1e-9)
    assert h2norm(G) == pytest.approx(1 / np.sqrt(1 - p**2), rel=1e-12)


@pytest.mark.parametrize(("a", "q", "r"), [(1, 3, 1), (-1, 3, 1), (2, 5, 1), (0, 9, 4)])
def test_scalar_regulator(a, q, r):
    """S = r(a + sqrt(a^2 + q/r)): 3, 1, 5, 6."""
    assert lqr([[a]], [[1]], [[q]], [[r]])[1].item() == pytest.approx(r * (a + np.sqrt(a * a + q / r)), rel=1e-12)


@pytest.mark.parametrize("e", [1.0, 1e-2])
def test_regulators_of_the_benchmark_collection(e):
    """CAREX (Benner, Laub and Mehrmann 1995), examples 7 and 9: weakly controlled mode, scaled double integrator."""
    root = np.sqrt(1 + e * e)
    off = 1 / (2 + root)
    expected = [[(1 + root) / e**2, off], [off, (1 - (e * off) ** 2) / 4]]
    np.testing.assert_allclose(lqr(np.diag([1, -2]), [[e], [0]], [[1, 1], [1, 1]], 1)[1], expected, rtol=1e-8)
    root = np.sqrt(1 + 2 * e)
    np.testing.assert_allclose(
        lqr([[0, e], [0, 0]], [[0], [1]], np.eye(2), 1)[1], [[root / e, 1], [1, root]], rtol=1e-9
    )


@pytest.mark.parametrize(("p", "expected"), [(1, GOLDEN), (2, 2 + np.sqrt(5)), (0, 1.0)])
def test_sampled_scalar_regulator(p, expected):
    """S^2 - p^2 S = 1 for q = r = b = 1."""
    assert dlqr([[p]], [[1]], [[1]], [[1]])[1].item() == pytest.approx(expected, rel=1e-12)
