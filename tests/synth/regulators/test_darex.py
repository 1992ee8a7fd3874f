"""Every example of DAREX, by `dlqr` and by `dare`, judged in ball arithmetic (`riccati_oracle`)."""

from functools import cache

import numpy as np
import pytest
from darex import EXAMPLES, laub_2, scaled_delays
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

from synth import dare, dlqr
from synth.errors import AssumptionError, ModelError, NumericalError

LONG = ("4.1, n = 100",)
ALL = [pytest.param(name, marks=pytest.mark.slow) if name in LONG else name for name in EXAMPLES]
SHORT = [name for name in EXAMPLES if name not in LONG]


@cache
def known(name: str) -> Truth:
    return truth(EXAMPLES[name](), discrete=True)


def regulator(e):
    """`dlqr`, which may say that a cost without minimum has none; None then."""
    try:
        return dlqr(e.A, e.B, e.Q, e.R, **options(e))
    except (AssumptionError, ModelError, NumericalError):
        if e.bounded:
            raise
        return None


def test_the_collection_is_complete():
    """1.1 to 1.13, 2.1 to 2.5, 4.1 (group 3 is empty)."""
    groups = {name.split(",")[0] for name in EXAMPLES}
    assert groups == {f"{g}.{i + 1}" for g, count in ((1, 13), (2, 5), (4, 1)) for i in range(count)}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_are_bounded_or_not_as_they_say(name):
    e = EXAMPLES[name]()
    assert (np.linalg.eigvalsh(e.R + e.B.T @ known(name).X @ e.B)[0] > 0) == e.bounded


@pytest.mark.parametrize("name", [name for name in SHORT if EXAMPLES[name]().X is not None])
def test_the_oracle_finds_the_printed_solutions(name):
    true, X = known(name), EXAMPLES[name]().X
    assert X is not None
    assert error(X, true) <= FACTOR * len(X) * EPS


@pytest.mark.parametrize("name", ALL)
def test_dlqr(name):
    e = EXAMPLES[name]()
    if found := regulator(e):
        check_regulator(e, *found, known(name), discrete=True)


@pytest.mark.parametrize("name", ALL)
def test_dare(name):
    e = EXAMPLES[name]()
    X, ok = dare(e.A, e.B, e.Q, e.R, **options(e))
    assert ok
    check_solution(e, np.asarray(X), known(name), discrete=True)


@pytest.mark.parametrize("name", SHORT)
def test_dlqr_says_how_good_it_is(name):
    if found := regulator(EXAMPLES[name]()):
        check_claims(found, known(name))


@pytest.mark.parametrize("change", ["units", "coordinates"])
@pytest.mark.parametrize("name", [name for name in SHORT if len(EXAMPLES[name]().A) <= 13])
def test_dlqr_in_other(name, change):
    for seed in range(3):
        e = EXAMPLES[name]()
        e = in_other_units(e, seed, discrete=True) if change == "units" else in_other_coordinates(e, seed)
        if found := regulator(e):
            check_regulator(e, *found, truth(e, discrete=True), discrete=True)


@pytest.mark.parametrize("name", ["1.1", "1.5", "1.8", "1.9", "1.13", "2.3, e = 1e+06", "4.1, n = 10"])
def test_dlqr_of_a_descriptor(name):
    """E x+ = A x + B u: the rows of an example mixed by E; X becomes E^-T X E^-1, K stays."""
    e = EXAMPLES[name]()
    n = len(e.A)
    E = np.eye(n) + np.tril(np.ones((n, n)), -1) / n
    d = e._replace(A=E @ e.A, B=E @ e.B, E=E, X=None)
    K, S, poles = dlqr(d.A, d.B, d.Q, d.R, **options(d))
    check_regulator(d, K, S, poles, truth(d, discrete=True), discrete=True)


@pytest.mark.slow  # compiles
@pytest.mark.parametrize(("make", "values"), [(laub_2, (1.0, 1e3, 1e6)), (scaled_delays, (1.0, 1e3, 1e6))])
def test_dare_of_a_batch(make, values):
    examples = [make(value) for value in values]
    A, B, Q, R = (np.array([getattr(e, part) for e in examples]) for part in "ABQR")
    X, ok = dare(A, B, Q, R)
    for e, x, well in zip(examples, np.asarray(X), np.asarray(ok), strict=True):
        assert well
        check_solution(e, x, truth(e, discrete=True), discrete=True)
