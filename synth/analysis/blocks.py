"""The structure of an uncertainty: Delta = diag(Delta_1, Delta_2, ...), in MATLAB's notation of pairs.

    (-r, 0)   a real number, repeated r times       (-1, 0) or (-1, 1): a real parameter
    (r, 0)    a complex number, repeated r times
    (r, c)    a full complex block with r rows and c columns

Delta takes the outputs of M to its inputs: the rows of all blocks are the inputs of M, their columns its outputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.checks import shown
from synth.errors import ModelError

WANTED = (
    "pass a pair for every block: (r, c) full with r rows and c columns, (r, 0) a complex number repeated r times, "
    "(-r, 0) a real number repeated r times"
)
MOST = 1000  # rows or columns of a block


@dataclass(frozen=True)
class Block:
    """One block of Delta, and where it stands."""

    kind: str  # "real", "complex" (both repeated) or "full"
    rows: slice  # of Delta: inputs of M
    columns: slice  # of Delta: outputs of M

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start

    @property
    def repeated(self) -> bool:
        """A number times the identity; of a block of one entry only a real one is called so."""
        return self.kind != "full"


@dataclass(frozen=True)
class Structure:
    """All blocks of Delta."""

    blocks: tuple[Block, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of Delta."""
        last = self.blocks[-1]
        return last.rows.stop, last.columns.stop

    @property
    def is_complex(self) -> bool:
        """There is no real block."""
        return all(block.kind != "real" for block in self.blocks)

    @property
    def is_diagonal(self) -> bool:
        """Every block is one complex number."""
        return all(block.kind == "full" and block.size == (1, 1) for block in self.blocks)

    @property
    def complexified(self) -> Structure:
        """The same with real numbers taken for complex ones."""
        sizes = [(block.size[0], 0) if block.repeated else block.size for block in self.blocks]
        return structure(sizes)

    @property
    def loosened(self) -> Structure:
        """The same with every repeated number as that many complex numbers, each on its own: a larger set."""
        pairs = [[(1, 1)] * block.size[0] if block.repeated else [block.size] for block in self.blocks]
        return structure([pair for some in pairs for pair in some])

    def norms(self, M: np.ndarray) -> np.ndarray:
        """Norms of the parts of M that the blocks see, (k, k)."""
        return np.array([[np.linalg.norm(M[i.columns, j.rows]) for j in self.blocks] for i in self.blocks])

    def spread(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A number for every block on the outputs and on the inputs of M."""
        rows, columns = zip(*(block.size for block in self.blocks), strict=True)
        return np.repeat(d, columns), np.repeat(d, rows)

    def scaled(self, M: np.ndarray, d: np.ndarray) -> np.ndarray:
        """D M D^-1 with a number d for every block."""
        outputs, inputs = self.spread(d)
        return M * outputs[:, None] / inputs

    def misfit(self, Delta: np.ndarray) -> float:
        """How far a matrix is from having this structure: the largest entry that should not be."""
        rest = np.array(Delta, complex)
        for block in self.blocks:
            part = rest[block.rows, block.columns]
            if block.repeated:
                number = np.trace(part) / len(part)
                part = part - (number.real if block.kind == "real" else number) * np.eye(len(part))
            else:
                part = 0 * part
            rest[block.rows, block.columns] = part
        return float(np.abs(rest).max(initial=0.0))


def structure(pairs: list[tuple[int, int]]) -> Structure:
    """The structure of pairs that were checked."""
    blocks, row, column = [], 0, 0
    for r, c in pairs:
        kind = "real" if r < 0 else "complex" if c == 0 and r > 1 else "full"
        rows, columns = abs(r), abs(r) if kind != "full" or c == 0 else c
        blocks.append(Block(kind, slice(row, row + rows), slice(column, column + columns)))
        row, column = row + rows, column + columns
    return Structure(tuple(blocks))


def as_structure(name: str, value: Any, outputs: int, inputs: int, of: str = "M") -> Structure:
    """The structure of an uncertainty for a matrix with so many outputs and inputs.

    Raises
    ------
    ModelError : no pairs of whole numbers, a pair that means nothing, or sizes that do not fit.
    """
    try:
        given = np.asarray(value)
        found = given.astype(float) if given.dtype.kind in "iuf" else np.zeros(0)
    except Exception:  # ragged lists and foreign objects
        found = np.zeros(0)
    if isinstance(value, np.ma.MaskedArray) or found.ndim != 2 or found.shape[1:] != (2,) or not len(found):
        raise ModelError(f"{name} is {shown(value)}; {WANTED}")
    pairs: list[tuple[float, float]] = [(float(r), float(c)) for r, c in zip(*found.T, strict=True)]
    for i, (r, c) in enumerate(pairs):
        whole = np.isfinite([r, c]).all() and r == int(r) and c == int(c)
        if not whole or r == 0 or c < 0 or max(abs(r), c) > MOST or (r < 0 and (r, c) not in ((-1, 1), (r, 0))):
            raise ModelError(f"{name}[{i}] is ({r:g}, {c:g}); {WANTED}")
    made = structure([(int(r), int(c)) for r, c in pairs])
    if made.shape != (inputs, outputs):
        raise ModelError(
            f"{name} have {made.shape[0]} rows and {made.shape[1]} columns; {of} has {inputs} inputs and {outputs} "
            "outputs: the rows of the blocks are its inputs, the columns its outputs"
        )
    return made
