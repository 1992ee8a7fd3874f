"""An objective of a flight as a function of what is dispersed: its values in batches of lanes, and its slopes.

A case is plain Python, so that nothing can be asked of it but (loop, scenario) for one dispersion. That is enough: the
numbers of loop and scenario are differentiated by differences of cases, which cost no flight and are exact where a
number is proportional to what is dispersed, and their slopes are carried through the compiled flight in forward mode,
n tangents beside one flight. Where the controller or the objective cannot be traced by JAX, flights themselves are
differenced.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from plants.errors import ScenarioError
from plants.simulation import blocks, programs, simulate
from plants.simulation.batch import Case
from plants.simulation.campaign import count
from plants.simulation.fits import check, check_numbers
from plants.simulation.flight import fly
from plants.simulation.loop import Loop, Run, Scenario

Objective = Callable[[Run], Any]

SAMPLE = 5  # cases looked at beside middle and two corners, to see which numbers vary
LANES, CLIMBS = 64, 8  # of a batch of values, of slopes; more gain little
NEAR = 1e-6  # of the box: between two cases whose numbers are differenced
STEP = 1e-4  # of the box: between two flights that are differenced


@dataclass(frozen=True)
class Box:
    """Dispersions between two bounds, in coordinates z (n,) that run from 0 to 1 in each number that is free."""

    structure: Any  # of a dispersion
    sides: Sequence[tuple[np.ndarray, np.ndarray]]  # lower and upper leaves
    names: tuple[str, ...]  # (n,) of the free numbers, such as ".inertia[0]"
    low: np.ndarray  # (n,)
    high: np.ndarray  # (n,)

    @classmethod
    def between(cls, bounds: Any) -> Box:
        """From the pair (lower, upper) of equal pytrees of numbers; `ScenarioError` names what is wrong with it."""
        if not isinstance(bounds, tuple | list) or len(bounds) != 2:
            raise ScenarioError(f"box = {bounds!r}: give two dispersions, (lower, upper)")
        lower, upper = bounds
        for side in bounds:
            blocks.register(side)
        (named, structure), (others, other) = map(jax.tree_util.tree_flatten_with_path, (lower, upper))
        if structure != other:
            raise ScenarioError(f"box: lower is {structure}, upper is {other}: give both the same fields")
        for side, name in ((lower, "box[0]"), (upper, "box[1]")):
            blocks.check_numbers(side, name)
        sides, names, ends = [], [], []
        for (path, low), (_, high) in zip(named, others, strict=True):
            field = jax.tree_util.keystr(path)
            low, high = np.asarray(low), np.asarray(high)
            if low.shape != high.shape:
                raise ScenarioError(f"box{field}: lower has shape {low.shape}, upper {high.shape}: give both the same")
            for index in np.ndindex(low.shape):
                a, b = low[index], high[index]
                if a == b:
                    continue
                name = field + (str(list(map(int, index))) if index else "")
                if not a < b:
                    raise ScenarioError(f"box{name}: lower {a} is above upper {b}: exchange them")
                if low.dtype.kind != "f" and high.dtype.kind != "f":
                    raise ScenarioError(f"box{name} = {a} to {b}: whole numbers cannot vary; fix it, or give floats")
                if not np.isfinite([a, b]).all():
                    raise ScenarioError(f"box{name} = {a} to {b} is not finite: give finite bounds")
                names.append(name)
                ends.append((a, b))
            sides.append((low, high))
        if not names:
            raise ScenarioError("box: lower equals upper in every number; leave at least one free")
        return cls(structure, sides, tuple(names), *np.array(ends, float).T)

    def numbers(self, z: np.ndarray) -> np.ndarray:
        """The free numbers at z, (n,); bounds are met exactly."""
        return np.clip((1 - z) * self.low + z * self.high, self.low, self.high)

    def at(self, z: np.ndarray) -> Any:
        """The dispersion at z."""
        leaves, rest = [], self.numbers(z)
        for low, high in self.sides:
            free = low != high
            value = low.astype(float) if free.any() else low
            value[free], rest = rest[: free.sum()], rest[free.sum() :]
            leaves.append(value[()])
        return jax.tree.unflatten(self.structure, leaves)


@dataclass(frozen=True, kw_only=True)
class Response:
    """An objective over a box: `values` and `slopes` at rows of coordinates (m, n)."""

    case: Case
    shared: Any
    box: Box
    objective: Objective
    record: simulate.Record | None
    compiled: bool  # the controller, with the loop
    varied: frozenset[str]  # paths of the numbers of (loop, scenario) that differ in the box
    dt: float | None  # s, control period, None if it varies
    obstacle: str  # why JAX cannot trace the objective of a flight, "" if it can
    forward: bool  # slopes in forward mode, else by differences of flights
    lanes: int  # of a batch of values
    climbs: int  # of a batch of slopes

    @classmethod
    def of(
        cls,
        case: Case,
        shared: Any,
        box: Box,
        objective: Objective,
        *,
        record: simulate.Record | None,
        compiled: bool | None,
        forward: bool | None,
        memory: int,
    ) -> Response:
        """Looks at a few cases and at what JAX can trace; parameters as in `worstflights.worst_flights`."""
        n = len(box.names)
        drawn = np.random.default_rng(0).uniform(size=(SAMPLE, n))
        cases = [_built(case, shared, box.at(z)) for z in [np.full(n, 0.5), np.zeros(n), np.ones(n), *drawn]]
        first = cases[0]
        check(*first)
        if compiled is None:
            compiled = simulate.can_compile(*first)
        varied = blocks.differing([_seen(pair, compiled) for pair in cases])
        if compiled and not varied:
            raise ScenarioError("box: no number of loop or scenario varies with it; use d in case(d, shared)")
        dt = None if "[1].dt" in varied else float(first[1].dt)
        obstacle = _obstacle(first, record, objective, dt) if compiled else "the controller is stepped from Python"
        if forward and obstacle:
            raise ScenarioError(f"forward = True: {obstacle}; leave it out, and flights are differenced")
        rows = simulate.row_bytes(*first, record)
        lanes = int(np.clip(memory // rows, 1, LANES))
        return cls(
            case=case,
            shared=shared,
            box=box,
            objective=objective,
            record=record,
            compiled=compiled,
            varied=frozenset(varied),
            dt=dt,
            obstacle=obstacle,
            forward=forward is not False and not obstacle,
            lanes=lanes,
            climbs=int(np.clip(memory // ((n + 1) * rows), 1, min(CLIMBS, lanes))),
        )

    def fly(self, z: np.ndarray) -> tuple[Run, float]:
        """The flight at z by the ordinary simulator, and its value."""
        run = simulate.simulate(*self._case(z), compiled=self.compiled, record=self.record)
        return run, _number(np.array([self._measured(run)]), [self.box.at(z)])[0]

    def values(self, points: np.ndarray) -> np.ndarray:
        """The objective at each row of points (m, n): (m,), infinite where the flight failed."""
        return _number(self._flown([self._case(z) for z in points]), [self.box.at(z) for z in points])

    def beside(self, dispersed: Any) -> tuple[np.ndarray, Run]:
        """The objective of dispersions, leaves (m, ...): (m,), and the worst of their flights."""
        drawn = [jax.tree.map(lambda leaf, i=i: leaf[i], dispersed) for i in range(count(dispersed))]
        cases = [_built(self.case, self.shared, d) for d in drawn]
        values = _number(self._flown(cases), drawn)
        return values, simulate.simulate(*cases[values.argmax()], compiled=self.compiled, record=self.record)

    def slopes(self, points: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Derivatives of the objective along the coordinates at points (m, n) of these values (m,); 0 for NaN."""
        if self.forward:
            parts = [self._tangents(points[a : a + self.climbs]) for a in range(0, len(points), self.climbs)]
            found = np.concatenate(parts)
        else:
            near = [_inward(z, j, STEP) for z in points for j in range(len(z))]
            there, steps = self.values(np.array([z for z, _ in near])), np.array([step for _, step in near])
            with np.errstate(invalid="ignore"):
                found = (there.reshape(points.shape) - values[:, None]) / steps.reshape(points.shape)
        return np.nan_to_num(found)

    def _case(self, z: np.ndarray) -> tuple[Loop, Scenario]:
        return _built(self.case, self.shared, self.box.at(z))

    def _measured(self, run: Run) -> float:
        """The objective of a run, infinite if it failed."""
        if not run.ok:
            return np.inf
        with jax.enable_x64(True):
            value = np.asarray(self.objective(run))
        if value.shape != () or value.dtype.kind not in "fiub":
            raise ScenarioError(f"objective returned {value!r}: return one real number")
        return float(value)

    def _flown(self, cases: Sequence[tuple[Loop, Scenario]]) -> np.ndarray:
        """The objective of cases (m,), in batches of one width, so that one program serves them all."""
        found = []
        for a in range(0, len(cases), self.lanes):
            batch = list(cases[a : a + self.lanes])
            lanes = batch + batch[-1:] * ((self.lanes - len(batch)) if self.compiled else 0)
            if self.obstacle:
                flown = simulate.simulate_many(
                    lanes, compiled=self.compiled, record=self.record, varying=self.varied, progress=False
                )
                found += [self._measured(run) for run in flown[: len(batch)]]
                continue
            stack = self._stack(lanes)
            programs.make_room(_values)
            with jax.enable_x64(True):
                values = np.asarray(_values(stack.leaves, stack.form, self.record, self.objective, self.dt))
            found += values[: len(batch)].tolist()
        return np.array(found)

    def _tangents(self, points: np.ndarray) -> np.ndarray:
        """Slopes in forward mode: differences of cases, tangents of flights."""
        m, points = len(points), points[np.minimum(np.arange(self.climbs), len(points) - 1)]
        cases = [self._case(z) for z in points]
        stack = self._stack(cases)
        moving = tuple(
            i for i, axis in enumerate(stack.form.axes) if axis is not None and stack.leaves[i].dtype.kind == "f"
        )
        pushes = [np.zeros((len(points), len(self.box.names), *stack.leaves[i].shape[1:])) for i in moving]
        for lane, z in enumerate(points):
            here = jax.tree.leaves(cases[lane])
            for j in range(len(z)):
                near, step = _inward(z, j, NEAR)
                there = jax.tree.leaves(self._case(near))
                for push, i in zip(pushes, moving, strict=True):
                    with np.errstate(invalid="ignore"):
                        slope = (np.asarray(there[i], float) - np.asarray(here[i], float)) / step
                    push[lane, j] = np.where(np.isnan(slope), 0.0, slope)  # of no limit, infinity minus infinity
        programs.make_room(_slopes)
        with jax.enable_x64(True):
            try:
                found = _slopes(stack.leaves, pushes, stack.form, moving, self.record, self.objective, self.dt)
            except (NotImplementedError, TypeError, ValueError) as error:
                raise ScenarioError(
                    f"forward = {self.forward}: JAX cannot differentiate the flight ({error}); give forward = False"
                ) from error
        return np.asarray(found)[:m]

    def _stack(self, cases: Sequence[tuple[Loop, Scenario]]) -> blocks.Stack:
        """Cases as one, with a lane for each of what varies anywhere in the box."""
        return blocks.stack([_seen(pair, self.compiled) for pair in cases], self.varied)


def _built(case: Case, shared: Any, d: Any) -> tuple[Loop, Scenario]:
    """The case for d; an error names it."""
    try:
        return case(d, shared)
    except ScenarioError as error:
        raise ScenarioError(f"at {d}: {error}") from error


def _number(values: np.ndarray, dispersions: Sequence[Any]) -> np.ndarray:
    """The values, none of which may be NaN."""
    if np.isnan(values).any():
        at = dispersions[int(np.isnan(values).argmax())]
        raise ScenarioError(f"objective = nan at {at}, for a sound flight: return a number for every one")
    return values


def _seen(pair: tuple[Loop, Scenario], compiled: bool) -> tuple[Loop, Scenario]:
    """The part of a case that JAX sees, checked."""
    loop, scenario = pair
    check_numbers(loop, scenario)
    if compiled:
        blocks.register(loop.controller)
        return pair
    return dataclasses.replace(loop, controller=None), scenario


def _obstacle(pair: tuple[Loop, Scenario], record: Any, objective: Objective, dt: float | None) -> str:
    """Why the objective cannot be traced, "" if it can; a genuine mistake in it shows itself again in `measure`."""
    try:
        with jax.enable_x64(True):
            score = jax.eval_shape(lambda pair: _score(pair, record, objective, dt), pair)
        return "" if score.shape == () and score.dtype.kind == "f" else "the objective is not one real number"
    except Exception as error:
        return f"JAX cannot trace the objective ({type(error).__name__})"


def _inward(z: np.ndarray, j: int, step: float) -> tuple[np.ndarray, float]:
    """A point beside z in coordinate j, inside the box, and how far it is."""
    near = z.copy()
    near[j] += step if z[j] <= 0.5 else -step
    return near, near[j] - z[j]


def _score(pair: tuple[Loop, Scenario], record: Any, objective: Objective, dt: float | None) -> Any:
    """The objective of a flight, traceable; infinite if it fails."""
    loop, scn = pair
    w, memory, rows = fly(loop, scn, record)
    row = jax.tree.map(lambda a: a.reshape(a.shape[0] * a.shape[1], *a.shape[2:]), rows)
    period = scn.dt if dt is None else dt
    time = np.arange(scn.periods // scn.keep_every * scn.rows) * (scn.keep_every * period / scn.rows)
    reference: Any = jnp.zeros(()) if scn.reference is None else jnp.asarray(scn.reference, float)
    if reference.ndim == 2:
        reference = jnp.repeat(reference[:: scn.keep_every], scn.rows, axis=0)
    run: Any = Run(
        duration=scn.periods * period,
        time=time,
        states=row.state,
        outputs=row.output,
        estimates=row.estimate,
        references=reference + jnp.zeros(row.output.shape),
        commands=row.command,
        inputs=row.input,
        extra=row.extra,
        ok=True,
        failed_at=None,
        culprit="",
        compiled=True,
        memory=memory,
    )
    return jnp.where(w.culprit == 0, objective(run), jnp.inf)


def _values_each(leaves: Any, form: blocks.Form, record: Any, objective: Objective, dt: float | None) -> Any:
    """`_score` of every lane."""
    return form.each(lambda pair: _score(pair, record, objective, dt), leaves)


def _slopes_each(
    leaves: Any, pushes: Any, form: blocks.Form, moving: tuple[int, ...], record: Any, objective: Objective,
    dt: float | None,
) -> Any:  # fmt: skip
    """Derivatives of `_score` in every lane as the leaves `moving` go along each of the `pushes`: (lanes, n)."""

    def one(pair: Any, pushes: Any) -> Any:
        numbers, structure = jax.tree.flatten(pair)

        def along(*moved: Any) -> Any:
            new = dict(zip(moving, moved, strict=True))
            filled = [new.get(i, number) for i, number in enumerate(numbers)]
            return _score(jax.tree.unflatten(structure, filled), record, objective, dt)

        here = tuple(numbers[i] for i in moving)
        return jax.vmap(lambda push: jax.jvp(along, here, push)[1])(tuple(pushes))

    return form.each(one, leaves, pushes)


_values = programs.Program(_values_each, ("form", "record", "objective", "dt"))
_slopes = programs.Program(_slopes_each, ("form", "moving", "record", "objective", "dt"))
