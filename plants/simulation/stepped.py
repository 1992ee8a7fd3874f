"""A flight one step after the other, for blocks that JAX cannot trace: ordinary classes, NumPy, software from outside.

    measure at t0, then for every period: { command, samples x ( act, move, measure ) }

The clock, the noise and the culprits are those of `flight`; what JAX can trace is compiled block by block, what it
cannot is called with NumPy arrays of its own, which it may write to. `simulate` comes here by itself.

A plant from outside may have ``advance(x, u, t, h) -> x``, h s on from time t with u held, in place of `derivative`;
it is called `steps` times per sample. What keeps its state in itself (an FMU, another simulator) has besides

    begin(x) -> x    called before the flight: back to the beginning; returns the state at t = 0
    end()            called after it, whatever came of it

Likewise a sensor, navigator or actuator that keeps its state in itself must go back to the beginning in `init`. Before
the flight every block is called once to see what it returns, and then begins anew.
"""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import jax
import numpy as np

from plants.errors import PlantError, ScenarioError
from plants.simulation import commands
from plants.simulation.fits import check_reference, check_rest, foreign, told
from plants.simulation.flight import CULPRITS, Flight, Record, Row, _noise, rk4
from plants.simulation.loop import Loop, Scenario, actuator_channels
from plants.simulation.programs import Program


def fly(loop: Loop, scn: Scenario, record: Record | None) -> tuple[Flight, Row, Any]:
    """The last `Flight`, rows of (1, kept, samples, ...) and the controller's memory, as `simulate` has of one lane.

    Raises
    ------
    ScenarioError
        A block does not fit, or raises; the message names it and the time.
    """
    check_rest(loop, scn)
    with jax.enable_x64(True):
        clock = _Clock(loop, scn, record)
        try:
            return clock.run()
        finally:
            clock.close()


def row_bytes(loop: Loop, scn: Scenario, record: Record | None) -> int:
    """Memory that the rows of one run take, bytes."""
    check_rest(loop, scn)
    with jax.enable_x64(True):
        clock = _Clock(loop, scn, record)
        try:
            row = clock.probe()[1]
        finally:
            clock.close()
    return sum(np.asarray(leaf).nbytes for leaf in jax.tree.leaves(row)) * scn.rows * scn.periods // scn.keep_every


def _ask(block: Any, method: str, args: Any) -> Any:
    """What a method returns."""
    return getattr(block, method)(*args)


def _move(block: Any, args: Any, steps: int) -> Any:
    """The state after one sample."""
    x, u, envs, h = args
    for s in range(steps):
        stages = [jax.tree.map(lambda a, m=m: a[m], envs) for m in (2 * s, 2 * s + 1, 2 * s + 2)]
        x = block.project(rk4(block, x, u, stages, h / steps))
    return x


def _draw(seed: Any, run: Any, indices: Any, channels: tuple[int | None, int]) -> Any:
    """The noise of some samples."""
    sensors = None if channels[0] is None else SimpleNamespace(channels=channels[0])
    loop: Any = SimpleNamespace(sensors=sensors, actuator=SimpleNamespace(channels=channels[1]))
    scn: Any = SimpleNamespace(seed=seed, run=run)
    return _noise(loop, scn, indices)


_asked = Program(_ask, ("method",))
_moved = Program(_move, ("steps",))
_drawn = Program(_draw, ("channels",))


class _Hand:
    """A block as the clock calls it: compiled where JAX can trace it, else with arrays that it may keep."""

    def __init__(self, name: str, block: Any) -> None:
        self.name, self.block = name, block
        self._opaque = foreign(name, block) is not None
        self._traced: dict[str, bool] = {}

    def __call__(self, method: str, t: float, *args: Any) -> Any:
        """What the method returns, in NumPy; ScenarioError that names block and time if it raises."""
        if self.traces(method, lambda b, a: _ask(b, method, a), args):
            return owned(_asked.jitted(self.block, method, args))
        return self.tried(method, t, lambda: getattr(self.block, method)(*owned(args)))

    def traces(self, what: str, function: Callable[..., Any], args: Any) -> bool:
        """Whether function(block, args) can be traced; any failure means no, a mistake shows itself again."""
        if what not in self._traced:
            try:
                jax.eval_shape(function, *(() if self._opaque else (self.block, args)))
                self._traced[what] = True
            except Exception:
                self._traced[what] = False
        return self._traced[what]

    def tried(self, method: str, t: float, call: Callable[[], Any]) -> Any:
        """What `call` returns."""
        try:
            return call()
        except PlantError:
            raise
        except Exception as error:
            raise self.wrong(method, f"raised {told(error)}", t) from error

    def wrong(self, method: str, what: str, t: float) -> ScenarioError:
        """The error that says what a method did."""
        return ScenarioError(f"{self.name}: {type(self.block).__name__}.{method} {what} at t = {t:.9g} s")

    def pair(self, method: str, t: float, *args: Any) -> tuple[Any, Any]:
        """(new state, what comes of it)."""
        result = self(method, t, *args)
        if not isinstance(result, tuple) or len(result) != 2:
            raise self.wrong(method, f"returned a {type(result).__name__}: return (state, what comes of it)", t)
        return result

    def vector(self, method: str, value: Any, t: float, length: int | None = None) -> np.ndarray:
        """A copy of what must be a vector of real numbers."""
        try:
            vector = np.array(value)
        except Exception as error:
            raise self.wrong(method, f"returned no array: {told(error)}", t) from error
        if vector.dtype.kind not in "fiub" or vector.ndim != 1 or length not in (None, vector.size):
            found = f"{vector.dtype} of shape {vector.shape}"
            raise self.wrong(method, f"returned {found}: return {length or 'a vector of'} real numbers", t)
        return vector.astype(float)


class _Clock:
    """One flight under way."""

    def __init__(self, loop: Loop, scn: Scenario, record: Record | None) -> None:
        self.loop, self.scn, self.record = loop, scn, record
        self.plant = _Hand("plant", loop.plant)
        self.sensors, self.navigator = _Hand("sensors", loop.sensors), _Hand("navigator", loop.navigator)
        self.actuator, self.world = _Hand("actuator", loop.actuator), _Hand("scenario.environment", scn.environment)
        self.channels = None if loop.sensors is None else int(loop.sensors.channels), actuator_channels(loop)
        self.table = None if scn.reference is None else np.asarray(scn.reference, float)

    def close(self) -> None:
        """Let a plant from outside go."""
        end = getattr(self.loop.plant, "end", None)
        if callable(end):
            end()

    def run(self) -> tuple[Flight, Row, Any]:
        """All periods."""
        scn = self.scn
        nu, blank = self.probe()
        w = self._launch(nu, blank.input.size)
        memory, rows = commands.begin(self.loop.controller), []
        w, _ = self._advance(w, np.zeros(nu), -1)
        for k in range(scn.periods if not w.culprit else 0):
            y, r = self._seen(w.estimate, self._reference(k), k * scn.dt)
            memory, command = commands.step(self.loop.controller, memory, y, r, (nu,), k * scn.dt)
            w, row = self._advance(w, command, k)
            if k % scn.keep_every == 0 and len(row) == scn.samples:
                rows.append(_joined(row[: scn.rows]))
            if w.culprit:
                break
        rows = rows or [_joined([blank] * scn.rows)]
        lane = jax.tree.map(lambda *parts: np.stack(parts)[None], *rows)
        actuator = jax.tree.map(lambda a: np.asarray(a)[None], w.actuator)
        return w._replace(culprit=np.array([w.culprit]), failed=np.array([w.failed]), actuator=actuator), lane, memory

    def probe(self) -> tuple[int, Row]:
        """Length of the command, and a row of what everything returns when it is called once."""
        scn, loop = self.scn, self.loop
        x, env = self._begin(), self._environment(0.0)
        y = self._output(x, env, 0.0)
        check_reference(scn, y.shape)
        self.ny = y.size
        sensors = navigator = None
        if loop.sensors is not None:
            sensors, navigator = self.sensors("init", 0.0), self.navigator("init", 0.0)
        estimate = self._first()
        told = self._seen(estimate, self._reference(0), 0.0)
        command = commands.step(loop.controller, commands.begin(loop.controller), *told, (), 0.0)[1]
        s = None if loop.actuator is None else self.actuator("init", 0.0)
        u = self._act(s, command, x, np.zeros(self.channels[1]), 0.0)[1]
        extra = self._extra(x, env, sensors, navigator, 0.0)
        return command.size, Row(x, y, estimate[: self.ny], command, u, extra)

    def _launch(self, nu: int, m: int) -> Flight:
        """The `Flight` before the first measurement."""
        loop = self.loop
        self.m = m
        return Flight(
            x=self._begin(),
            u=np.zeros(m),
            sensors=None if loop.sensors is None else self.sensors("init", 0.0),
            measured=True,
            navigator=None if loop.navigator is None else self.navigator("init", 0.0),
            estimate=self._first(),
            actuator=None if loop.actuator is None else self.actuator("init", 0.0),
            pending=np.zeros((loop.delay, nu)),
            culprit=0,
            failed=0,
        )

    def _advance(self, w: Flight, command: np.ndarray, k: int) -> tuple[Flight, list[Row]]:
        """One control period from t = k dt, and its rows; fewer if something was no number before its end."""
        scn, rows = self.scn, []
        if not np.isfinite(command).all():
            return self._failed(w, "controller", k), rows
        first = k * scn.samples + 1
        indices = np.arange(first, first + scn.samples)
        noise, torque_noise = jax.tree.map(np.asarray, _drawn.jitted(scn.seed, scn.run, indices, self.channels))
        queue = np.concatenate([w.pending, command[None]])
        new = w._replace(pending=queue[1:])
        for i, index in enumerate(indices if k >= 0 else indices[-1:]):
            t, drawn = max(index - 1, 0) * scn.h, None if noise is None else noise[i if k >= 0 else -1]
            if index > 0:
                env = self._environment(t)
                output = self._output(new.x, env, t)
                extra = self._extra(new.x, env, new.sensors, new.navigator, t)
                own = None if torque_noise is None else torque_noise[i]
                actuator, u = self._act(new.actuator, queue[0], new.x, own, t)
                rows.append(Row(owned(new.x), output, new.estimate[: self.ny].copy(), command, u, extra))
                if not np.isfinite(u).all():
                    return self._failed(w, "plant", k), rows[:-1]
                new = new._replace(x=self._moved(new.x, u, t), u=u, actuator=actuator)
                if not _within(new.x, np.inf):
                    return self._failed(w, "plant", k), rows[:-1]
            new = self._observe(new, index * scn.h, drawn, scn.h if index > 0 else 0.0)
            if not (new.measured and _within((new.estimate, new.navigator), np.inf)):
                break
        if not _within(new.x, scn.bound):
            return self._failed(w, "plant", k), rows
        if not _within((new.estimate, new.navigator), scn.bound):
            return self._failed(w, "navigator" if new.measured else "sensors", k), rows
        return new._replace(measured=True), rows

    def _failed(self, w: Flight, culprit: str, k: int) -> Flight:
        return w._replace(culprit=CULPRITS.index(culprit), failed=max(k, 0))

    def _begin(self) -> Any:
        """The state at t = 0."""
        x = jax.tree.map(lambda a: np.array(a, float) if np.asarray(a).dtype.kind in "iu" else a, self.scn.initial)
        begin = getattr(self.loop.plant, "begin", None)
        return owned(x) if begin is None else owned(self.plant.tried("begin", 0.0, lambda: begin(owned(x))))

    def _environment(self, t: float) -> Any:
        return None if self.scn.environment is None else owned(self.world("at", t, np.float64(t)))

    def _output(self, x: Any, env: Any, t: float) -> np.ndarray:
        return self.plant.vector("output", self.plant("output", t, x, env), t, getattr(self, "ny", None))

    def _act(self, s: Any, command: np.ndarray, x: Any, noise: Any, t: float) -> tuple[Any, np.ndarray]:
        """New state of the actuator and the plant's input."""
        if self.loop.actuator is None:
            return s, command.copy()
        more = (noise, self.scn.h) if self.channels[1] else ()
        s, u = self.actuator.pair("apply", t, s, command, x, *more)
        return s, self.actuator.vector("apply", u, t, getattr(self, "m", None))

    def _moved(self, x: Any, u: np.ndarray, t: float) -> Any:
        """The plant's state after a sample."""
        scn, plant = self.scn, self.loop.plant
        h = scn.h / scn.steps
        if not hasattr(plant, "derivative"):
            for s in range(scn.steps):
                x = self._like(x, self.plant("advance", t, x, u, t + s * h, h), "advance", t)
                x = self._projected(x, t)
            return x
        envs = [self._environment(t + s * h / 2) for s in range(2 * scn.steps + 1)]
        if hasattr(plant, "project"):
            args = x, u, jax.tree.map(lambda *parts: np.stack(parts), *envs), np.float64(scn.h)
            if self.plant.traces("derivative", lambda b, a: _move(b, a, scn.steps), args):
                return owned(_moved.jitted(plant, args, scn.steps))
        slope: Any = SimpleNamespace(derivative=lambda x, u, env: self._slope(x, u, env, t))
        for s in range(scn.steps):
            x = self._projected(rk4(slope, x, u, envs[2 * s : 2 * s + 3], h), t)
        return x

    def _slope(self, x: Any, u: np.ndarray, env: Any, t: float) -> Any:
        args = owned((x, u, env))
        return self._like(
            x, self.plant.tried("derivative", t, lambda: self.loop.plant.derivative(*args)), "derivative", t
        )

    def _projected(self, x: Any, t: float) -> Any:
        return self._like(x, self.plant("project", t, x), "project", t) if hasattr(self.loop.plant, "project") else x

    def _like(self, x: Any, new: Any, method: str, t: float) -> Any:
        """A copy of `new`, which must have the form of the state x."""
        forms = [(jax.tree.structure(a), [np.shape(leaf) for leaf in jax.tree.leaves(a)]) for a in (x, new)]
        if forms[0] != forms[1]:
            found, wanted = (
                f"{type(a).__name__} of shapes {form[1]}" for a, form in zip((new, x), forms[::-1], strict=True)
            )
            raise self.plant.wrong(method, f"returned {found}; the state is {wanted}", t)
        return owned(new)

    def _observe(self, w: Flight, t: float, noise: Any, h: float) -> Flight:
        """Measure and navigate, `h` s after the last time."""
        env = self._environment(t)
        if self.loop.sensors is None:
            return w._replace(estimate=self._output(w.x, env, t))
        sensors, y = self.sensors.pair("measure", t, w.sensors, w.x, env, noise, np.float64(h))
        measured = w.measured and _within(y, np.finfo(float).max)
        navigator, estimate = self.navigator.pair("update", t, w.navigator, y, w.u, env, np.float64(h))
        estimate = self.navigator.vector("update", estimate, t, w.estimate.size)
        return w._replace(sensors=sensors, measured=measured, navigator=navigator, estimate=estimate)

    def _reference(self, k: int) -> np.ndarray:
        if self.table is None:
            return np.zeros(self.ny)
        return self.table.copy() if self.table.ndim == 1 else self.table[k].copy()

    def _first(self) -> np.ndarray:
        """What stands for the estimate before there is one; see `loop.first_estimate`."""
        more = getattr(self.loop.navigator, "ny", self.ny) - self.ny
        return np.concatenate([self._reference(0), np.zeros(more)])

    def _seen(self, estimate: np.ndarray, r: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
        """What the controller gets; see `loop.seen`."""
        if self.table is None or not hasattr(self.loop.plant, "error"):
            return estimate.copy(), r
        error = self.plant.vector("error", self.plant("error", t, estimate[: self.ny], r), t, self.ny)
        return np.concatenate([error, estimate[self.ny :]]), np.zeros(self.ny)

    def _extra(self, x: Any, env: Any, sensors: Any, navigator: Any, t: float) -> Any:
        if self.record is None:
            return None
        try:
            return owned(self.record(owned(x), owned(env), sensors, navigator))
        except Exception as error:
            raise ScenarioError(f"record raised {told(error)} at t = {t:.9g} s") from error


def owned(tree: Any) -> Any:
    """A copy of all arrays of numbers, in NumPy; what else there is stays what it is."""
    numbers = np.ndarray | np.generic | jax.Array | float | int
    return jax.tree.map(lambda a: np.array(a) if isinstance(a, numbers) else a, tree)


def _within(values: Any, bound: float) -> bool:
    """Whether all numbers are finite and within the bound; what is no number does not count."""
    arrays = [np.asarray(leaf) for leaf in jax.tree.leaves(values)]
    numbers = [a for a in arrays if a.dtype.kind in "fiub"]
    return all(bool(np.isfinite(a).all() and (np.abs(a) <= bound).all()) for a in numbers)


def _joined(rows: list[Row]) -> Row:
    """Rows of one period as arrays."""
    return jax.tree.map(lambda *parts: np.stack(parts), *rows)
