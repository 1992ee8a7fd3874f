"""Polynomials nested in every way end in a system or in a typed error."""

import itertools

import numpy as np
import pytest

from synth import system
from synth.errors import SynthError

FORMS = [
    1.0, [1.0], [1.0, 2.0], [[1.0]], [[1.0, 2.0], [3.0]], [[[1.0, 2.0]], 5.0], [[[1.0]], [[2.0]]], [[[1.0, 2.0], 3.0]],
    [3.0, [1.0]], [[1.0], 3.0], [], [[]], [[[]]], None, "a", [None], [["a"]], [[[1.0, 2.0]], [5.0]], {}, [{}], True,
    [[[1.0], [1.0]], [[1.0]]], [True], np.array(1.0), [np.array(1.0), [1.0]], [[np.array(1.0)], [1.0]], [1e400],
    np.zeros((2, 2, 2, 2)), [[[[1.0]]]], float("nan"),
]  # fmt: skip


@pytest.mark.parametrize("num", FORMS, ids=str)
def test_numerators_and_denominators(num):
    told = []
    for den, given in itertools.product(FORMS, (lambda n, d: (n, d, 0.1), lambda n, d: {"num": n, "den": d, "dt": 0})):
        try:
            assert system(given(num, den)).ny > 0
        except SynthError as error:
            told.append(str(error))
    assert all(len(text) > 20 for text in told), told
