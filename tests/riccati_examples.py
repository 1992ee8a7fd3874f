"""A Riccati equation as the benchmark collections pose it; `carex` and `darex` fill it."""

import json
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from literature import DATA

STORED = json.loads((DATA / "riccati_examples.json").read_text())


class Example(NamedTuple):
    """E dx = A x + B u (x+ for dx), cost x'Q x + u'R u + 2 x'N u; X solves, with K = (R [+ B'X B])^-1 (...)',

    continuous   A'X E + E'X A + Q - (E'X B + N) R^-1 (E'X B + N)' = 0
    discrete     A'X A - E'X E + Q - (A'X B + N) (R + B'X B)^-1 (A'X B + N)' = 0
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    Q: np.ndarray  # (n, n) symmetric, of any signature
    R: np.ndarray  # (m, m) symmetric
    N: np.ndarray | None = None  # (n, m)
    E: np.ndarray | None = None  # (n, n) invertible
    X: np.ndarray | None = None  # (n, n) the stabilising solution in closed form
    parameters: dict[str, float] = {}  # noqa: RUF012, never changed
    solvable: bool = True  # it has a stabilising solution
    bounded: bool = True  # the cost has a minimum: discrete, R + B'X B is positive definite


Examples = dict[str, Callable[[], Example]]


def stored(name: str) -> dict[str, np.ndarray]:
    """Matrices of riccati_examples.json."""
    return {key: np.array(value, dtype=float) for key, value in STORED[name].items()}


def symmetric(n: int, **entries: float) -> np.ndarray:
    """A symmetric matrix by its lower entries, `q41` for row 4, column 1."""
    M = np.zeros((n, n))
    for name, value in entries.items():
        i, j = int(name[1]) - 1, int(name[2]) - 1
        M[i, j] = M[j, i] = value
    return M


def quadratic(C: np.ndarray, W: np.ndarray | None = None) -> np.ndarray:
    """C'W C, symmetric to the last bit; W = I when left out."""
    M = C.T @ (C if W is None else W @ C)
    return (M + M.T) / 2


def reflected(diagonal) -> np.ndarray:
    """V diag V with the reflection V = I - (2/3) e e', e = (1, 1, 1): Petkov, Christov and Konstantinov's scheme."""
    V = np.eye(3) - 2 / 3
    M = V * np.asarray(diagonal, dtype=float) @ V
    return (M + M.T) / 2


def family(title: str, make: Callable[[float], Example], name: str, values: tuple[float, ...]) -> Examples:
    """One example for every value of its parameter, by name."""
    return {f"{title}, {name} = {value:g}": partial(make, value) for value in values}
