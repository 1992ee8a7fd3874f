"""Some runs of a campaign: built, flown side by side, measured; whatever goes wrong in one of them stays with it.

Runs are flown in lanes, always a multiple of `LANE` of them, the last one repeated: then the vector units of the
processor treat every lane alike, and on one machine a run comes out the same to the last bit whatever flies beside it.
"""

import dataclasses
import traceback
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks, simulate
from plants.simulation.fits import check_numbers
from plants.simulation.loop import Loop, Run, Scenario

LANE = 8  # doubles in the widest vector unit
NEAR = 128  # runs
RUN_INDEX = "[1].run"  # path of the run's index in (loop, scenario)
ARRAYS = ("time", "states", "outputs", "estimates", "references", "commands", "inputs", "extra")  # of a Run, by row

Case = Callable[[Any, Any], tuple[Loop, Scenario]]
Read = Callable[[Loop, Scenario], Any]


class Batch(NamedTuple):
    """What came of some runs; the arrays have a row for each that was flown and measured, in the order of `index`."""

    index: np.ndarray  # (n,)
    ok: np.ndarray  # (n,) bool
    failed_at: np.ndarray  # (n,) s, NaN if ok
    culprit: np.ndarray  # (n,) str, "" if ok
    results: Any  # what `measure` returned, leaves (n, ...); None if n = 0
    applied: Any  # what `read` returned, leaves (n, ...); None without it or if n = 0
    varied: frozenset[str]  # paths of the numbers that differed
    kept: dict[int, Run]  # trajectories asked for
    errors: dict[int, str]  # tracebacks of those that ended in an exception


@dataclass(frozen=True, kw_only=True)
class Flights:
    """A campaign as a function of indices; picklable if its functions and blocks are."""

    case: Case
    dispersed: Any  # leaves (runs, ...)
    shared: Any
    measure: Callable[[Run], Any]
    read: Read | None
    record: simulate.Record | None
    seed: int
    keep: frozenset[int]
    compiled: bool
    varying: frozenset[str]  # paths of numbers that get a lane each, because they differ
    apart: frozenset[str]  # and those that do so in any case
    lanes: int  # at most
    progress: bool = field(default=False, compare=False)

    def __call__(self, chunk: Sequence[int]) -> Batch:
        """Fly the runs of these indices, at most `lanes` of them."""
        blocks.register(self.dispersed)
        built, errors = {}, {}
        for index in chunk:
            try:
                pair = replay_case(self.case, self.dispersed, index, self.shared, self.seed)
                check_numbers(*pair)
                built[index] = pair
            except Exception:
                errors[index] = traceback.format_exc()
        own = varied([*built.values()], self.compiled)
        flown = self._flown(built, own, errors)
        applied, results = {}, {}
        for index, run in flown.items():
            try:
                if self.read is not None:
                    applied[index] = confirmed(self.read(*built[index]), self.dispersed, index)
                results[index] = alike(self.measure(run), results)
            except Exception:
                errors[index] = traceback.format_exc()
        sound = {index: flown[index] for index in chunk if index in results}
        return Batch(
            index=np.array([*sound], int),
            ok=np.array([run.ok for run in sound.values()], bool),
            failed_at=np.array([np.nan if run.ok else run.failed_at for run in sound.values()], float),
            culprit=np.array([run.culprit for run in sound.values()], str),
            results=blocks.join([results[index] for index in sound]) if sound else None,
            applied=blocks.join([applied[index] for index in sound]) if applied and sound else None,
            varied=frozenset(self.varying | own),
            kept={index: copied(run) for index, run in sound.items() if index in self.keep},
            errors=errors,
        )

    def one(self, index: int) -> Run:
        """One run with all its rows, bit for bit as it flies beside others."""
        pair = replay_case(self.case, self.dispersed, index, self.shared, self.seed)
        return self._beside([pair], varied([pair], self.compiled))[0]

    def _flown(self, built: dict[int, Any], own: Collection[str], errors: dict[int, str]) -> dict[int, Run]:
        """Runs by index; where flying raises, by halves, until it is known with which run."""
        if not built:
            return {}
        try:
            return dict(zip(built, self._beside([*built.values()], own), strict=True))
        except Exception:
            if len(built) == 1:
                errors[next(iter(built))] = traceback.format_exc()
                return {}
        both, half = list(built.items()), len(built) // 2
        return self._flown(dict(both[:half]), own, errors) | self._flown(dict(both[half:]), own, errors)

    def _beside(self, cases: list[Any], own: Collection[str]) -> list[Run]:
        """Runs of these cases."""
        return simulate.simulate_many(
            cases,
            compiled=self.compiled,
            record=self.record,
            varying=self.varying | self.apart | {*own, RUN_INDEX},
            lanes=self.lanes,
            progress=self.progress,
        )


def replay_case(case: Case, dispersed: Any, index: int, shared: Any = None, seed: int = 0) -> tuple[Loop, Scenario]:
    """Loop and scenario of run `index` of a campaign, noise included: `simulate.simulate` flies it again.

    Raises
    ------
    ScenarioError
        The case cannot be built; the message names the run.
    """
    try:
        loop, scenario = case(at(dispersed, index), shared)
    except ScenarioError as error:
        raise ScenarioError(f"run {index}: {error}") from error
    return loop, dataclasses.replace(scenario, seed=seed, run=index)


def at(dispersed: Any, index: int) -> Any:
    """The dispersion of one run."""
    return jax.tree.map(lambda leaf: leaf[index], dispersed)


def varied(cases: Sequence[tuple[Loop, Scenario]], compiled: bool) -> frozenset[str]:
    """Paths of the numbers that differ between cases, apart from the run's index."""
    if not cases:
        return frozenset()
    for loop, scenario in cases:
        check_numbers(loop, scenario)
    if not compiled:
        cases = [(dataclasses.replace(loop, controller=None), scenario) for loop, scenario in cases]
    return frozenset(blocks.differing(cases) - {RUN_INDEX})


def confirmed(applied: Any, dispersed: Any, index: int) -> Any:
    """The dispersion read back from what flies, equal to the one asked for; ScenarioError otherwise."""
    if jax.tree.structure(applied) != jax.tree.structure(dispersed):
        raise ScenarioError("read must return the structure of one dispersion, one number for each asked for")
    named = jax.tree_util.tree_flatten_with_path(applied)[0]
    for (path, flown), drawn in zip(named, jax.tree.leaves(dispersed), strict=True):
        wanted = drawn[index]
        # zero is as exact as the largest draw of the neighbourhood
        size = np.abs(drawn[max(0, index - NEAR) : index + NEAR]).max(initial=0)
        if np.shape(flown) != np.shape(wanted) or not np.allclose(flown, wanted, rtol=1e-9, atol=1e-12 * size):
            raise ScenarioError(
                f"dispersed{jax.tree_util.keystr(path)} was not applied in run {index}: asked for {wanted}, "
                f"flown with {flown}"
            )
    return applied


def form(result: Any) -> Any:
    """Structure of a pytree of numbers, the shapes of its leaves, and which of them are texts."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(result)]
    return jax.tree.structure(result), [leaf.shape for leaf in arrays], [leaf.dtype.kind == "U" for leaf in arrays]


def alike(result: Any, others: dict[int, Any]) -> Any:
    """A result of the form that those of other runs have; ScenarioError otherwise."""
    blocks.register(result)
    if not jax.tree.leaves(result) or any(
        np.asarray(leaf).dtype.kind not in "fiubcU" for leaf in jax.tree.leaves(result)
    ):
        raise ScenarioError(f"measure returned {type(result).__name__}: return numbers, in a NamedTuple for example")
    if others:
        first = next(iter(others))
        if form(result) != form(others[first]):
            raise ScenarioError(
                f"measure returned shapes {form(result)[1]}, for run {first} {form(others[first])[1]}: return one form"
            )
    return result


def copied(run: Run) -> Run:
    """A run that does not keep the memory of its batch."""
    return dataclasses.replace(run, **{name: jax.tree.map(np.copy, getattr(run, name)) for name in ARRAYS})
