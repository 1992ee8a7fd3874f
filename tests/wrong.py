"""Values that are wrong for nearly every parameter."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import control
import numpy as np


class Unshowable:
    """An object that raises whatever is asked of it."""

    def __repr__(self) -> str:
        raise RuntimeError("no")

    def __float__(self) -> float:
        raise RuntimeError("no")

    def __array__(self, *arguments: Any, **options: Any) -> np.ndarray:
        raise RuntimeError("no")

    def __len__(self) -> int:
        raise RuntimeError("no")


WRONG: dict[str, Any] = {
    "None": None,
    "text": "G(s)",
    "number in text": "1.5",
    "empty text": "",
    "bytes": b"1",
    "True": True,
    "nan": np.nan,
    "inf": np.inf,
    "-inf": -np.inf,
    "zero": 0,
    "negative": -3.0,
    "huge integer": 10**400,
    "complex": 1 + 2j,
    "fraction": Fraction(1, 3),
    "empty list": [],
    "empty tuple": (),
    "empty dict": {},
    "set": {1, 2},
    "ragged rows": [[1, 2], [3]],
    "rows of text": [["a", "b"]],
    "rows of None": [[None, 1.0]],
    "three dimensions": np.ones((2, 2, 2)),
    "7 x 5": np.ones((7, 5)),
    "vector of eleven": np.arange(11.0),
    "matrix with nan": np.array([[1.0, np.nan], [0.0, 1.0]]),
    "complex matrix": np.array([[1j, 0], [0, 1]]),
    "masked": np.ma.masked_array([1.0, 2.0], mask=[True, False]),
    "dates": np.array(["2026-01-01"], dtype="datetime64[D]"),
    "objects": np.array([object()]),
    "object": object(),
    "unshowable": Unshowable(),
    "type": int,
    "function": len,
    "generator": (i for i in range(3)),
    "six entries": (1, 2, 3, 4, 5, 6),
    "measured response": control.frd([1.0, 2.0, 3.0], [0.1, 0.2, 0.3]),
    "improper": control.tf([1, 0, 0], [1, 1]),
    "no timebase": control.ss([[0.5]], [[1]], [[1]], [[0]], None),
    "SLICOT's five": (np.eye(2), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), np.ones(4)),
    "unknown key": {"numerator": [1], "den": [1, 1]},
    "zero denominator": ([1.0], [0.0]),
}
