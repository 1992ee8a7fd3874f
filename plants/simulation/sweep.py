"""A function of every point of a grid, such as a design for every weight: engines, store and errors as of campaigns."""

import itertools
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks, engines, identity
from plants.simulation.batch import Batch, alike
from plants.simulation.conduct import chained, conduct
from plants.simulation.progress import Bar

SHARE = 16  # parts at least, so that a worker that is fast does more of them


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What came of the points of a grid; the arrays have one row per finished point."""

    index: np.ndarray  # (n,) of the finished points, the last name of the grid changing fastest
    points: dict[str, np.ndarray]  # (n,) values by name
    results: Any  # what the function returned, leaves (n, ...); None if nothing did
    errors: dict[int, str]  # tracebacks of the points that ended in an exception, by index
    complete: bool  # False if interrupted
    shape: tuple[int, ...]  # of the grid

    def __str__(self) -> str:
        """How many points, what went wrong."""
        state = "complete" if self.complete else "INTERRUPTED"
        lines = [f"{len(self.index)} points of {' x '.join(map(str, self.shape))} ({state})"]
        for index, text in [*self.errors.items()][:3]:
            lines.append(f"point {index} ended in {text.strip().splitlines()[-1]}")
        return "\n".join(lines)

    def on_grid(self, leaf: np.ndarray) -> np.ndarray:
        """A leaf of the results (n, ...) in the shape of the grid, NaN where there is no result."""
        whole = np.full((int(np.prod(self.shape)), *np.shape(leaf)[1:]), np.nan)
        whole[self.index] = leaf
        return whole.reshape(*self.shape, *np.shape(leaf)[1:])


@dataclass(frozen=True)
class _Points:
    """The work of a sweep; picklable if its function is."""

    function: Callable[..., Any]
    points: Mapping[str, np.ndarray]

    def __call__(self, chunk: Sequence[int]) -> Batch:
        results, errors = {}, {}
        for index in chunk:
            try:
                point = {name: values[index].item() for name, values in self.points.items()}
                results[index] = alike(self.function(**point), results)
            except Exception:
                errors[index] = traceback.format_exc()
        return Batch(
            index=np.array([*results], int),
            ok=np.ones(len(results), bool),
            failed_at=np.full(len(results), np.nan),
            culprit=np.full(len(results), ""),
            results=blocks.join([*results.values()]) if results else None,
            applied=None,
            varied=frozenset(),
            kept={},
            errors=errors,
        )


def sweep(
    function: Callable[..., Any],
    grid: Mapping[str, Sequence[Any]],
    *,
    store: Path | str | None = None,
    resume: bool = False,
    workers: int | None = None,
    processes: bool = True,
    scheduler: str | None = None,
    progress: bool = True,
) -> Sweep:
    """Call ``function(**point)`` for every point of a grid.

    Parameters
    ----------
    function : returns a pytree of numbers, such as the level and the margins of a design. What it raises is the
        failure of its point.
    grid : name -> values (numbers or texts); the points are all combinations, the last name changing fastest
    store, resume, workers, processes, scheduler, progress : as of `campaign.campaign`; processes by default, because
        designs keep the interpreter busy

    Returns
    -------
    Sweep
        After Ctrl-C or SIGTERM what had finished, with ``complete`` False.

    Raises
    ------
    ScenarioError
        An empty grid, values that are neither numbers nor texts, a function that raises at every point of the first
        part.
    StoreError, EngineError
        As `campaign.campaign`.
    """
    points, shape = _points(grid)
    count = int(np.prod(shape))
    hands = engines.check(workers, processes and scheduler is None, scheduler)
    batch = max(1, count // (SHARE * hands))

    def what() -> dict[str, Any]:
        return {
            "what": "sweep",
            "study": f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', function)}",
            "runs": count,
            "seed": 0,
            "hashes": {"grid": identity.digest(points), "function": identity.digest(function)},
            "code": {"function": identity.source(function)},
        }

    with Bar(count, "points", shown=progress, compiling="first point") as bar:
        conducted = conduct(
            _Points(function, points), count, points,
            batch=batch, workers=hands, processes=processes and scheduler is None, scheduler=scheduler,
            store=store, resume=resume, what=what, bar=bar,
        )  # fmt: skip
    index, results = chained(conducted.batches, "index"), chained(conducted.batches, "results")
    return Sweep(
        index=index,
        points={name: values[index] for name, values in points.items()},
        results=results,
        errors={i: text for part in conducted.batches for i, text in sorted(part.errors.items())},
        complete=conducted.complete,
        shape=shape,
    )


def _points(grid: Mapping[str, Sequence[Any]]) -> tuple[dict[str, np.ndarray], tuple[int, ...]]:
    """Values of all points by name, (count,) each, and the shape of the grid."""
    if not isinstance(grid, Mapping) or not grid:
        raise ScenarioError(f"grid = {grid!r}: give names and their values, such as dict(weight=[1, 10, 100])")
    axes = {}
    for name, values in grid.items():
        axis = np.asarray(values)
        if axis.ndim != 1 or not len(axis) or axis.dtype.kind not in "fiubU":
            raise ScenarioError(f"grid[{name!r}] = {values!r}: give a list of at least one number or text")
        if axis.dtype.kind == "f" and not np.isfinite(axis).all():
            raise ScenarioError(f"grid[{name!r}] = {values!r}: give finite numbers")
        axes[name] = axis
    every = np.array([*itertools.product(*(range(len(axis)) for axis in axes.values()))])
    points = {name: axis[every[:, k]] for k, (name, axis) in enumerate(axes.items())}
    return points, tuple(len(axis) for axis in axes.values())
