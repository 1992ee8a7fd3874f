"""The one simulator: plant, sensors, navigator, controller and actuator around one clock.

A loop is made of blocks, frozen dataclasses of numbers; what flows through it is NamedTuples of arrays. The
clock runs at three rates: the controller every `dt`, the sensors `samples` times in between, Runge-Kutta
`steps` times per sample, so that integration steps end exactly where commands change.

    measure at t0, then for every period: { command, samples x ( act, move, measure ) }

`advance` is one control period. It is scanned under `jit` and `vmap` when the controller can be compiled, and
called from a Python loop when it cannot (a quadratic program solved by a C library); the numbers are the same.

Runs are described by data alone: the noise of sample i is a function of (seed, run, i), whatever the batch.
All arithmetic is float64; the caller's JAX configuration is left as it was.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from plants.errors import ScenarioError
from plants.simulation import blocks, programs
from plants.simulation.loop import Actuator as Actuator
from plants.simulation.loop import Controller as Controller
from plants.simulation.loop import Environment as Environment
from plants.simulation.loop import Loop as Loop
from plants.simulation.loop import Navigator as Navigator
from plants.simulation.loop import Plant as Plant
from plants.simulation.loop import Run as Run
from plants.simulation.loop import Scenario as Scenario
from plants.simulation.loop import Sensors as Sensors
from plants.simulation.loop import check, check_numbers, env_at, output_shape, reference_at

CULPRITS = ("", "controller", "plant", "navigator")


class Flight(NamedTuple):
    """What one control period hands to the next."""

    x: Any  # plant state
    u: Any  # plant input that acted last
    sensors: Any
    navigator: Any
    estimate: Any  # (ny,)
    actuator: Any
    pending: Any  # (delay, nu) commands under way
    culprit: Any  # () index into CULPRITS
    failed: Any  # () period of the failure


class Row(NamedTuple):
    """One recorded sample."""

    state: Any
    output: Any
    estimate: Any
    command: Any
    input: Any
    extra: Any


Record = Callable[[Any, Any, Any, Any], Any]


def simulate(loop: Loop, scenario: Scenario, *, compiled: bool | None = None, record: Record | None = None) -> Run:
    """Fly one loop through one scenario.

    Parameters
    ----------
    loop : Loop
        Blocks are frozen dataclasses; their classes are registered with JAX as needed.
    scenario : Scenario
    compiled : bool, optional
        True compiles the controller with the loop, False steps it from Python; by default it is compiled if it
        can be traced.
    record : callable, optional
        ``record(x, env, sensors, navigator) -> arrays``, evaluated at every sample and returned as `Run.extra`.
        Pass a module-level function: a new lambda in every call compiles anew.

    Returns
    -------
    Run
        NumPy arrays. A run that diverges, or meets a NaN, ends with ``ok`` False, its time and the culprit.

    Raises
    ------
    ScenarioError
        If a number of the scenario or of a block is unusable; the message names it.
    """
    return simulate_many([(loop, scenario)], compiled=compiled, record=record)[0]


def simulate_many(
    cases: Sequence[tuple[Loop, Scenario]],
    *,
    compiled: bool | None = None,
    record: Record | None = None,
    varying: Collection[str] = (),
    progress: bool = True,
) -> list[Run]:
    """Fly a batch of cases of the same structure at once: `jit(vmap(scan))`, one lane for each.

    Numbers that are equal in all cases are shared by the lanes. A lane that fails does not disturb the others.

    Parameters
    ----------
    cases : sequence of (Loop, Scenario)
        Same classes, array shapes and counts throughout; all held in memory, with all their rows.
    varying : collection of str
        Paths of numbers to treat as different between lanes even if they are not, so that batches of a campaign
        share one compilation; see `blocks.differing`.
    compiled, record
        As in `simulate`.
    progress : bool
        Show a bar when stepping from Python takes more than two seconds.
    """
    if not cases:
        raise ScenarioError("cases: got none; give at least one (loop, scenario)")
    loop, scenario = cases[0]
    check(loop, scenario)
    for case in cases[1:]:
        check_numbers(*case)
    programs.make_room(_fly, _launch, _advance)
    with jax.enable_x64(True):
        if compiled is None:
            compiled = can_compile(loop, scenario)
        if compiled:
            blocks.register(loop.controller)
        flown = [pair if compiled else (dataclasses.replace(pair[0], controller=None), pair[1]) for pair in cases]
        batch = blocks.stack(flown, varying)
        if compiled:
            end, memory, rows = jax.tree.map(np.asarray, _fly(*batch, record))
            memories = [jax.tree.map(lambda a, lane=lane: a[lane], memory) for lane in range(len(cases))]
        else:
            end, memories, rows = _step_through(cases, batch, record, progress)
            end = jax.tree.map(np.asarray, end)
        return [_run(case[1], end, rows, lane, memories[lane], compiled) for lane, case in enumerate(cases)]


def can_compile(loop: Loop, scenario: Scenario) -> bool:
    """Whether the controller can be traced by JAX.

    Any failure means no: stepped from Python, a genuine mistake in the controller shows itself again.
    """
    try:
        blocks.register(loop.controller)
        with jax.enable_x64(True):
            jax.eval_shape(lambda c, y: c.step(c.init(), y, y), loop.controller, output_shape(loop, scenario))
    except Exception:
        return False
    return True


def advance(loop: Loop, scn: Scenario, record: Record | None, w: Flight, command: Any, k: Any) -> Any:
    """One control period from t = k dt: the new `Flight` and `samples` rows."""
    queue = jnp.concatenate([w.pending, command[None]])  # the oldest command acts, the newest waits
    step = scn.h / scn.steps

    def sample(now: Flight, turn: Any) -> tuple[Flight, Row]:
        envs, noise = turn
        stages = [jax.tree.map(lambda a, m=m: a[m], envs) for m in range(2 * scn.steps + 1)]
        actuator, u = now.actuator, queue[0]
        if loop.actuator is not None:
            actuator, u = loop.actuator.apply(actuator, queue[0], now.x)
        extra = None if record is None else record(now.x, stages[0], now.sensors, now.navigator)
        row = Row(now.x, loop.plant.output(now.x, stages[0]), now.estimate, command, u, extra)
        x = now.x
        for s in range(0, 2 * scn.steps, 2):
            x = loop.plant.project(rk4(loop.plant, x, u, stages[s : s + 3], step))
        # the barriers keep XLA from computing the plant again in every consumer
        moved = jax.lax.optimization_barrier(now._replace(x=x, u=u, actuator=actuator))
        return observe(loop, moved, stages[-1], noise, scn.h), row

    first = k * scn.samples + 1
    new, rows = jax.lax.scan(sample, w, (_surroundings(scn, k), _noise(loop, scn, first)), scn.samples)
    return _judge(scn, w, new._replace(pending=queue[1:]), command, k), rows


def observe(loop: Loop, w: Flight, env: Any, noise: Any, h: Any) -> Flight:
    """Measure and navigate, `h` s after the last time."""
    if loop.sensors is None or loop.navigator is None:
        return w._replace(estimate=loop.plant.output(w.x, env))
    sensors, y = jax.lax.optimization_barrier(loop.sensors.measure(w.sensors, w.x, env, noise, h))
    navigator, estimate = loop.navigator.update(w.navigator, y, w.u, env, h)
    return w._replace(sensors=sensors, navigator=navigator, estimate=estimate)


def rk4(plant: Plant, x: Any, u: Any, envs: Sequence[Any], h: Any) -> Any:
    """One classical Runge-Kutta step of h s with u held; surroundings at its start, middle and end."""

    def along(slope: Any, a: Any) -> Any:
        return jax.tree.map(lambda p, v: p + a * v, x, slope)

    start, middle, end = envs
    k1 = plant.derivative(x, u, start)
    k2 = plant.derivative(along(k1, h / 2), u, middle)
    k3 = plant.derivative(along(k2, h / 2), u, middle)
    k4 = plant.derivative(along(k3, h), u, end)
    return jax.tree.map(lambda p, a, b, c, d: p + h / 6 * (a + 2 * b + 2 * c + d), x, k1, k2, k3, k4)


def fly(loop: Loop, scn: Scenario, record: Record | None) -> Any:
    """The whole run, traceable: the last `Flight`, the controller's last state, rows of (kept, samples, ...)."""
    controller, r0 = loop.controller, reference_at(loop, scn, 0)
    shapes = jax.eval_shape(lambda: controller.step(controller.init(), r0, r0))
    memory = jax.tree.map(lambda a, s: jnp.asarray(a, s.dtype), controller.init(), shapes[0])

    def period(carry: Any, k: Any) -> Any:
        w, memory = carry
        new, command = controller.step(memory, w.estimate, reference_at(loop, scn, k))
        new = jax.tree.map(lambda a, b: jnp.where(w.culprit == 0, a, b), new, memory)
        w, rows = advance(loop, scn, record, w, jnp.asarray(command, float), k)
        return (w, new), rows

    def group(carry: Any, ks: Any) -> Any:
        carry, rows = jax.lax.scan(period, carry, ks)
        return carry, jax.tree.map(lambda a: a[0, : scn.rows], rows)

    w, ks = launch(loop, scn, shapes[1].shape), jnp.arange(scn.periods).reshape(-1, scn.keep_every)
    (w, memory), rows = jax.lax.scan(group, (w, memory), ks)
    return w, memory, rows


def launch(loop: Loop, scn: Scenario, nu: tuple[int, ...]) -> Flight:
    """The first `Flight`: initial states, and the first measurement at t = 0."""
    command = jnp.zeros(nu)
    u, actuator = command, None
    if loop.actuator is not None:
        actuator = loop.actuator.init()
        shape = jax.eval_shape(loop.actuator.apply, actuator, command, scn.initial)[1]
        u = jnp.zeros(shape.shape)
    w = Flight(
        x=scn.initial,
        u=u,
        sensors=None if loop.sensors is None else loop.sensors.init(),
        navigator=None if loop.navigator is None else loop.navigator.init(),
        estimate=reference_at(loop, scn, 0),
        actuator=actuator,
        pending=jnp.zeros((loop.delay, *nu)),
        culprit=jnp.zeros((), int),
        failed=jnp.zeros((), int),
    )
    noise = None if loop.sensors is None else _noise(loop, scn, 0)[0]
    w = observe(loop, jax.tree.map(jnp.asarray, w), env_at(scn, 0.0), noise, jnp.zeros(()))
    sound = _sound(scn, (w.estimate, w.navigator))
    return w._replace(culprit=jnp.where(sound, 0, CULPRITS.index("navigator")))


def row_bytes(loop: Loop, scenario: Scenario, record: Record | None = None) -> int:
    """Memory that the rows of one run take, bytes."""
    check(loop, scenario)
    with jax.enable_x64(True):
        nu = _command_shape(loop, scenario, can_compile(loop, scenario))

        def one(loop: Loop, scn: Scenario) -> Any:
            return advance(loop, scn, record, launch(loop, scn, nu), jnp.zeros(nu), 0)[1]

        rows = jax.eval_shape(one, dataclasses.replace(loop, controller=None), scenario)
    period = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(rows))
    return period * scenario.rows * scenario.periods // (scenario.samples * scenario.keep_every)


@partial(jax.jit, static_argnames=("form", "record"))
def _fly(leaves: Any, form: blocks.Form, record: Record | None) -> Any:
    """`fly` for every lane."""
    return form.each(lambda case: fly(case[0], case[1], record), leaves)


@partial(jax.jit, static_argnames=("form", "nu"))
def _launch(leaves: Any, form: blocks.Form, nu: tuple[int, ...]) -> Any:
    """`launch` for every lane."""
    return form.each(lambda case: launch(case[0], case[1], nu), leaves)


@partial(jax.jit, static_argnames=("form", "record"))
def _advance(leaves: Any, form: blocks.Form, record: Record | None, w: Any, command: Any, k: Any) -> Any:
    """`advance` for every lane."""

    def one(case: Any, w: Flight, command: Any) -> Any:
        return advance(case[0], case[1], record, w, command, k)

    return form.each(one, leaves, w, command)


def _step_through(
    cases: Sequence[tuple[Loop, Scenario]], batch: blocks.Stack, record: Record | None, progress: bool
) -> Any:
    """The Python loop: the controllers in turn, then one compiled period for all lanes."""
    loop, scenario = cases[0]
    nu = _command_shape(loop, scenario, compiled=False)
    leaves = jax.device_put(batch.leaves)
    w = _launch(leaves, batch.form, nu)
    controllers = [loop.controller for loop, _ in cases]
    references = [np.asarray(reference_at(loop, scn)) for loop, scn in cases]
    memory = [controller.init() for controller in controllers]
    commands, rows = np.zeros((len(cases), *nu)), []
    for k in tqdm(range(scenario.periods), "periods", delay=2.0, disable=not progress, leave=False):
        estimates, sound = np.asarray(w.estimate), np.asarray(w.culprit) == 0
        if not sound.any():
            break
        for i, controller in enumerate(controllers):
            if sound[i]:
                r = references[i] if references[i].ndim == 1 else references[i][k]
                memory[i], commands[i] = controller.step(memory[i], estimates[i], r)
        w, row = _advance(leaves, batch.form, record, w, commands, k)
        if k % scenario.keep_every == 0:
            rows.append(jax.tree.map(lambda a: np.asarray(a[:, : scenario.rows]), row))
    if not rows:  # all failed before the first command
        rows = [jax.tree.map(np.asarray, _advance(leaves, batch.form, record, w, commands, 0)[1])]
    return w, memory, jax.tree.map(lambda *parts: np.stack(parts, axis=1), *rows)


def _surroundings(scn: Scenario, k: Any) -> Any:
    """The environment at all Runge-Kutta stages of period k, (samples, 2 steps + 1, ...); or None.

    All at once, because one look-up of many times costs hardly more than one of a single time.
    """
    if scn.environment is None:
        return None
    stages = 2 * scn.steps
    instants = k * scn.samples * stages + np.arange(scn.samples * stages + 1)
    envs = jax.vmap(scn.environment.at)(instants * (scn.h / stages))
    turns = stages * np.arange(scn.samples)[:, None] + np.arange(stages + 1)
    return jax.tree.map(lambda a: a[turns], envs)


def _noise(loop: Loop, scn: Scenario, first: Any) -> Any:
    """Standard normal numbers of `samples` samples from index `first`, (samples, channels); or None."""
    if loop.sensors is None:
        return None
    channels = loop.sensors.channels
    key = jax.random.fold_in(jax.random.key(scn.seed, impl="threefry2x32"), scn.run)

    def draw(i: Any) -> Any:
        return jax.random.normal(jax.random.fold_in(key, i), (channels,))

    return jax.vmap(draw)(first + jnp.arange(scn.samples))


def _judge(scn: Scenario, w: Flight, new: Flight, command: Any, k: Any) -> Flight:
    """The new `Flight` if all of it is sound; else the old one, standing still, with the culprit and the period."""
    blame = jnp.where(_sound(scn, (new.estimate, new.navigator)), 0, CULPRITS.index("navigator"))
    blame = jnp.where(_sound(scn, new.x), blame, CULPRITS.index("plant"))
    blame = jnp.where(jnp.isfinite(command).all(), blame, CULPRITS.index("controller"))
    stands = w.culprit != 0
    blame = jnp.where(stands, w.culprit, blame)
    kept = jax.tree.map(lambda a, b: jnp.where(blame == 0, a, b), new, w)
    return kept._replace(culprit=blame, failed=jnp.where(stands | (blame == 0), w.failed, k))


def _sound(scn: Scenario, values: Any) -> Any:
    """Whether every number is within the bound; a NaN is not."""
    tests = [jnp.all(jnp.abs(leaf) <= scn.bound) for leaf in jax.tree.leaves(values)]
    return jnp.all(jnp.array(tests))


def _command_shape(loop: Loop, scn: Scenario, compiled: bool) -> tuple[int, ...]:
    """Shape of a command: traced if the controller can be, else asked for once."""
    controller = loop.controller
    if compiled:
        r = reference_at(loop, scn, 0)
        return jax.eval_shape(lambda c: c.step(c.init(), r, r)[1], controller).shape
    r = np.asarray(reference_at(loop, scn, 0))
    return np.shape(controller.step(controller.init(), r, r)[1])


def _run(scn: Scenario, end: Flight, rows: Row, lane: int, memory: Any, compiled: bool) -> Run:
    """One lane as a `Run`, cut before its failure."""
    culprit = CULPRITS[int(end.culprit[lane])]
    periods = scn.periods if not culprit else int(end.failed[lane])
    length = -(-periods // scn.keep_every) * scn.rows

    def cut(a: np.ndarray) -> np.ndarray:
        return a[lane].reshape(a.shape[1] * a.shape[2], *a.shape[3:])[:length]

    row = jax.tree.map(cut, rows)
    reference = np.zeros(()) if scn.reference is None else np.asarray(scn.reference, float)
    if reference.ndim == 2:
        reference = np.repeat(reference[:: scn.keep_every], scn.rows, axis=0)[:length]
    return Run(
        duration=scn.periods * scn.dt,
        time=np.arange(length) * (scn.keep_every * scn.dt / scn.rows),
        states=row.state,
        outputs=row.output,
        estimates=row.estimate,
        references=np.broadcast_to(reference, row.output.shape).copy(),
        commands=row.command,
        inputs=row.input,
        extra=row.extra,
        ok=not culprit,
        failed_at=periods * scn.dt if culprit else None,
        culprit=culprit,
        compiled=compiled,
        memory=memory,
    )
