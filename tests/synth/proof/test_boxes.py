"""What proofs over boxes are made of: Routh's test, degrees of pencils, Bernstein boxes and their rounding."""

import itertools
from fractions import Fraction

import numpy as np
from flint import fmpq, fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st
from uncertain import two_masses

from synth import UncertainSystem, ureal
from synth.proof.boxes import Boxes, explored, follows
from synth.proof.pencils import Pencil, is_hurwitz
from synth.proof.robust import excludes_zero, is_positive, negative_corner


@given(st.lists(st.integers(-4, 1), min_size=1, max_size=6), st.integers(0, 3))
def test_routh_is_exact(real, pairs):
    polynomial = fmpq_poly([1])
    for x in real:
        polynomial *= fmpq_poly([-fmpq(x, 3), 1])
    for k in range(pairs):
        polynomial *= fmpq_poly([k + 1, fmpq(1, 7), 2])
    assert is_hurwitz(polynomial.coeffs()[::-1]) == (max(real) < 0)


def test_degrees_are_bounded_by_ranks():
    """An inertia in every entry of a mass matrix counts once; a frequency squared in one row twice."""
    J, w = ureal("J", 1.0, percentage=10), ureal("w", 2.0, percentage=10)
    v = np.array([[1.0, 2.0, -1.0]])
    M = np.eye(3) + (J - 1) * 0.1 * (v.T @ v)
    K = np.diag([0, 0, 1.0]).astype(object) * w * w + np.eye(3)
    E = np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), M]])
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-K, -0.1 * np.eye(3) * w * np.diag([0, 0, 1]) - 0.2 * np.eye(3)]])
    G = UncertainSystem(E, A, np.eye(6, 1, -3), np.eye(1, 6))
    pencil = Pencil.of(G, list(G.parameters.values()))
    assert pencil.degrees(bordered=True) == (1, 2)
    assert pencil.order == 6
    assert Pencil.of(two_masses(), list(two_masses().parameters.values())).degrees(bordered=False) == (1, 1, 1)


def box_of(function, degree: int) -> Boxes:
    """A polynomial in two variables on the unit square, by its Bernstein coefficients."""
    t = np.linspace(0, 1, degree + 1)
    W = np.linalg.inv(np.array([[synth_binomial(degree, j) * x**j * (1 - x) ** (degree - j) for j in range(degree + 1)]
                                for x in t]))  # fmt: skip
    V = W @ function(t[:, None], t[None, :]) @ W.T
    return Boxes(V[None, None], np.full((1, 1), 1e-12), np.zeros((1, 2)), np.ones((1, 2)), np.zeros(1, int))


def synth_binomial(n: int, k: int) -> float:
    return float(np.prod([(n - i) / (i + 1) for i in range(k)]))


def test_boxes_are_halved_until_all_is_told():
    def valley(x, y):
        return (x - 0.3) ** 2 + (y - 0.6) ** 2 - (x - 0.3) * (y - 0.6)

    above = explored(box_of(lambda x, y: valley(x, y) + 1e-4, 2), is_positive, 1000, negative_corner)
    assert above.proved
    start = box_of(lambda x, y: valley(x, y) + 1e-4, 2)
    assert follows(start, is_positive, above.script)
    assert not follows(start, is_positive, above.script[:-1])
    assert not follows(start, is_positive, ["."])
    below = explored(box_of(lambda x, y: valley(x, y) - 1e-3, 2), is_positive, 1000, negative_corner)
    assert not below.proved
    assert below.refuted is not None
    assert valley(*below.refuted[1]) < 1e-3
    touching = explored(box_of(valley, 2), is_positive, 1000, negative_corner)
    assert (touching.proved, touching.refuted) == (False, None)
    assert touching.left is not None


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 200))
def test_rounding_of_halves_is_bounded(seed):
    """Against exact fractions."""
    rng = np.random.default_rng(seed)
    m = int(rng.integers(1, 20))
    V = rng.normal(size=m + 1) * 10.0 ** rng.integers(-12, 1, size=m + 1)
    start = Boxes(V[None, None], np.full((1, 1), 1e-20), np.zeros((1, 1)), np.ones((1, 1)), np.zeros(1, int))
    seen: list[Boxes] = []

    def holds(boxes: Boxes) -> np.ndarray:
        seen.append(boxes)
        return boxes.width[:, 0] < 0.1

    explored(start, holds, 10_000, lambda _: None)
    for boxes in seen:
        for k in range(len(boxes.low)):
            exact = [Fraction(x) for x in V]
            low, width = Fraction(boxes.low[k, 0]), Fraction(boxes.width[k, 0])
            exact = cut(cut(exact, low + width)[0], low / (low + width))[1]
            errors = [abs(Fraction(x) - y) for x, y in zip(boxes.coefficients[k, 0], exact, strict=True)]
            assert max(errors) <= Fraction(boxes.errors[k, 0])


def cut(c: list[Fraction], t: Fraction) -> tuple[list[Fraction], list[Fraction]]:
    """De Casteljau's scheme: coefficients on [0, t] and on [t, 1]."""
    first, last = [c[0]], [c[-1]]
    while len(c) > 1:
        c = [(1 - t) * a + t * b for a, b in itertools.pairwise(c)]
        first.append(c[0])
        last.append(c[-1])
    return first, last[::-1]


def test_zero_is_excluded_only_where_it_is():
    def pair(a, b):
        V = np.array([a, b], float)[None]
        return Boxes(V, np.full((1, 2), 1e-9), np.zeros((1, 1)), np.ones((1, 1)), np.zeros(1, int))

    assert excludes_zero(pair([1, 2], [-3, 3])).all()
    assert excludes_zero(pair([-1, 0.1], [1, 0.1])).all()
    assert excludes_zero(pair([-1, 1], [-1, -1])).all()
    assert not excludes_zero(pair([-1, 1], [1, -1])).any()
    assert not excludes_zero(pair([-1, 1], [1e-10, 1e-10])).any()
    assert not excludes_zero(pair([0, 0], [0, 0])).any()
