"""Every example of CAREX, by `lqr` and by `care`, judged in ball arithmetic (`riccati_oracle`)."""

from functools import cache

import numpy as np
import pytest
from carex import EXAMPLES, hinfinity, scaled_integrators
from riccati_oracle import (
    EPS,
    FACTOR,
    Truth,
    check_claims,
    check_regulator,
    check_solution,
    error,
    in_other_coordinates,
    in_other_units,
    options,
    truth,
)

from synth import care, lqr
from synth.errors import AssumptionError, NumericalError

LONG = ("2.9 regulator", "2.9 filter", "3.2, n = 64", "4.2, n = 100", "4.3, masses = 30", "4.4")
UNSOLVABLE = "2.5, e = 0"
SOLVABLE = [name for name in EXAMPLES if name != UNSOLVABLE]
ALL = [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in SOLVABLE]
SMALL = [name for name in SOLVABLE if name not in LONG and len(EXAMPLES[name]().A) <= 10]


@cache
def known(name: str) -> Truth:
    return truth(EXAMPLES[name](), discrete=False)


def test_the_collection_is_complete():
    """1.1 to 1.6, 2.1 to 2.9, 3.1, 3.2, 4.1 to 4.4: the 20 of the first edition and the Boeing 767."""
    groups = {name.split(",")[0].split()[0] for name in EXAMPLES}
    assert groups == {f"{g}.{i + 1}" for g, count in ((1, 6), (2, 9), (3, 2), (4, 4)) for i in range(count)}


@pytest.mark.parametrize("name", [n for n in SOLVABLE if n not in LONG and EXAMPLES[n]().X is not None])
def test_the_oracle_finds_the_printed_solutions(name):
    true, X = known(name), EXAMPLES[name]().X
    assert X is not None
    assert error(X, true) <= FACTOR * len(X) * EPS


@pytest.mark.parametrize("name", ALL)
def test_lqr(name):
    e = EXAMPLES[name]()
    K, S, poles = lqr(e.A, e.B, e.Q, e.R, **options(e))
    check_regulator(e, K, S, poles, known(name), discrete=False)


@pytest.mark.parametrize("name", ALL)
def test_care(name):
    e = EXAMPLES[name]()
    X, ok = care(e.A, e.B, e.Q, e.R, **options(e))
    assert ok
    check_solution(e, np.asarray(X), known(name), discrete=False)


@pytest.mark.parametrize("name", [name for name in SOLVABLE if name not in LONG])
def test_lqr_says_how_good_it_is(name):
    e = EXAMPLES[name]()
    check_claims(lqr(e.A, e.B, e.Q, e.R, **options(e)), known(name))


def test_modes_that_must_stay_on_the_axis_are_named():
    """2.5 at e = 0: the Hamiltonian's eigenvalues are +-i, twice, so that no solution stabilises."""
    e = EXAMPLES[UNSOLVABLE]()
    with pytest.raises((AssumptionError, NumericalError)):
        lqr(e.A, e.B, e.Q, e.R)
    assert not care(e.A, e.B, e.Q, e.R).ok


@pytest.mark.parametrize("change", ["units", "coordinates"])
@pytest.mark.parametrize("name", SMALL)
def test_lqr_in_other(name, change):
    for seed in range(3):
        e = EXAMPLES[name]()
        e = in_other_units(e, seed, discrete=False) if change == "units" else in_other_coordinates(e, seed)
        K, S, poles = lqr(e.A, e.B, e.Q, e.R, **options(e))
        check_regulator(e, K, S, poles, truth(e, discrete=False), discrete=False)


@pytest.mark.parametrize(("n", "q", "r"), [(4, 1.0, 1.0), (12, 3.0, 5.0), (21, 1.0, 1.0), (21, 100.0, 100.0)])
def test_corner_of_the_chain_of_integrators(n, q, r):
    """4.1: X[0, -1] = sqrt(q r). Laub (1979)."""
    Q = np.zeros((n, n))
    Q[0, 0] = q
    S = lqr(np.eye(n, k=1), np.eye(n)[:, -1:], Q, [[r]])[1]
    assert S[0, -1] == pytest.approx(np.sqrt(q * r), rel=1e-12)


@pytest.mark.slow  # compiles
@pytest.mark.parametrize(
    ("make", "values"), [(hinfinity, (1.0, 0.1, 1e-4, 0.0)), (scaled_integrators, (1.0, 1e3, 1e6, 1e-6))]
)
def test_care_of_a_batch(make, values):
    """The lanes are judged one by one; the unsolvable one fails alone."""
    examples = [make(value) for value in values]
    A, B, Q, R = (np.array([getattr(e, part) for e in examples]) for part in "ABQR")
    X, ok = care(A, B, Q, R)
    for e, x, well in zip(examples, np.asarray(X), np.asarray(ok), strict=True):
        assert well == e.solvable
        if e.solvable:
            check_solution(e, x, truth(e, discrete=False), discrete=False)
