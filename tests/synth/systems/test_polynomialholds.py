"""Hold equivalents that are no polynomials in the parameters: polynomials with remainders that are proved and stay."""

from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, UncertainSystem, ureal


def oscillator(percentage: float = 20) -> UncertainSystem:
    J, w = ureal("J", 5.0, percentage=percentage), ureal("w", 2.0, percentage=percentage)
    return UncertainSystem([[1, 0], [0, J]], [[0, 1], [-5 * w * w, -0.2 * w]], [[0, 0], [1, 1]], [[1, 0], [1, 0]])


def random_plant(seed: int) -> UncertainSystem:
    """One to three parameters in E and A; stable, unstable, or with a double integrator; any units."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 4)), int(rng.choice([1, 1, 2, 2, 3]))
    A, E = rng.normal(size=(n, n)), np.eye(n).astype(object)
    if kind := seed % 3:
        A = A + (kind - 1.5) * 2 * np.eye(n)
    else:
        A[:, 0], A[0] = 0.0, np.eye(n)[1]
        A[1:, 1:] *= np.arange(1, n) > 1  # two integrators
    A = A.astype(object)
    for k in range(p):
        d = ureal(f"p{k}", float(rng.normal()), plusminus=float(rng.uniform(0.02, 0.3)))
        i, j = rng.integers(n, size=2)
        A[i, j] = A[i, j] + d * float(rng.normal()) + 0.3 * d * d
        if rng.random() < 0.4:
            i = int(rng.integers(n))
            E[i, i] = E[i, i] + (d - d.nominal) / 2
    s = 10.0 ** rng.uniform(-3, 3, size=n)
    E, A = (s[:, None] * M / s for M in (E, A))
    return UncertainSystem(E, A, s * rng.normal(size=n), rng.normal(size=(1, n)) / s)


def off(G: UncertainSystem, H: UncertainSystem, values: dict, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """|Phi - polynomial| at a point, and what remainders say."""
    n, at = G.n, G.at(values)
    exact = sla.expm(dt * np.block([[at.A, np.eye(n)], [np.zeros((n, 2 * n))]]))[:n, n:]
    point = {name: Fraction(values.get(name, p.nominal)) for name, p in H.parameters.items()}
    point |= dict.fromkeys(H.remainders, Fraction(0))
    Phi = np.array([[float(x.exactly(point)) for x in row] for row in H.A[:n, n:]])
    size = {p.at: p.high for p in H.remainders.values()}
    return np.abs(exact - Phi), np.array([[size[i, j] for j in range(n)] for i in range(n)])


@settings(max_examples=6, deadline=None, phases=[Phase.generate])
@given(st.integers(0, 10**6), st.sampled_from([0.05, 0.3]), st.sampled_from([1e-3, 1e-6]))
def test_the_remainder_holds_everywhere(seed, dt, tol):
    G = random_plant(seed)
    H = synth.c2d(G, dt, tol=tol)
    if not H.remainders:  # the series ends
        return
    assert H.parameters == G.parameters
    for values in [v for v, _ in G.sample(20, seed)] + [v for v, _ in G.gridded(2)]:
        found, claimed = off(G, H, values, dt)
        assert (found <= claimed * (1 + 1e-9) + 1e-13 * np.abs(G.at(values).A).max()).all()
        sampled, exact = H.at(values), synth.c2d(G.at(values), dt)
        assert np.sort(np.abs(sampled.poles())) == pytest.approx(np.sort(np.abs(exact.poles())), rel=tol * 1e3)


def test_the_remainder_is_about_as_large_as_it_was_allowed_and_no_larger_than_need_be():
    G = oscillator()
    for tol in (1e-3, 1e-6, 1e-9):
        H = synth.c2d(G, 0.5, tol=tol)
        claimed = off(G, H, {}, 0.5)[1]
        assert claimed.max() < 3 * tol
        worst = np.max([off(G, H, v, 0.5)[0] for v, _ in G.gridded(11)], axis=0)
        assert (worst > claimed / 30).any()


def test_time_unit_and_units_of_the_states_do_not_matter():
    G = oscillator()
    s, unit = np.array([1e-3, 1e4]), 64.0
    E, A = s[:, None] * G.E / s, s[:, None] * G.A / s * unit
    moved = UncertainSystem(E, A, s[:, None] * G.B * unit, G.C / s, G.D)
    H, K = synth.c2d(G, 0.5, tol=1e-6), synth.c2d(moved, 0.5 / unit, tol=1e-6)
    ours, theirs = off(G, H, {}, 0.5)[1], off(moved, K, {}, 0.5 / unit)[1]
    assert theirs * unit * s / s[:, None] == pytest.approx(ours, rel=5.0)


def test_connections_keep_remainders():
    H = synth.c2d(oscillator(), 0.5)
    K = synth.system([0.1], [1, -0.3], dt=0.5)
    inner = UncertainSystem(H.E, H.A, H.B[:, 1:], H.C[1:], H.D[1:, 1:], H.dt)
    for L in (
        H.close(K), synth.series(inner, K), synth.series(K, inner), synth.feedback(inner, K), synth.feedback(K, inner),
        inner.feedback(inner), H.with_ranges([p for p in oscillator(10).parameters.values()]),
    ):  # fmt: skip
        assert L.remainders == H.remainders
    assert len(H.at({}).A) == 2


def test_what_is_outside_of_the_box_is_refused():
    H = synth.c2d(oscillator(), 0.5)
    with pytest.raises(ModelError, match="before c2d"):
        H.at({"w": 2.5}, within=False)
    with pytest.raises(ModelError, match="before c2d"):
        H.with_ranges(list(oscillator(21).parameters.values()))


@pytest.mark.parametrize(
    ("G", "dt", "options", "message"),
    [
        (oscillator(), 40.0, {}, "split the box"),
        (oscillator(95), 0.5, {}, "split the box"),
        (oscillator(), 0.5, {"tol": 0.5}, "tol is 0.5"),
        (oscillator(), 0.5, {"tol": 0.0}, "tol"),
    ],
)
def test_what_cannot_be_had_says_what_would_help(G, dt, options, message):
    with pytest.raises(ModelError, match=message):
        synth.c2d(G, dt, **options)
