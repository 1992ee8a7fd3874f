"""The one simulator: plant, sensors, navigator, controller and actuator around one clock.

A loop is made of blocks, frozen dataclasses of numbers; what flows through it is NamedTuples of arrays. The
clock runs at three rates: the controller every `dt`, the sensors `samples` times in between, Runge-Kutta
`steps` times per sample, so that integration steps end exactly where commands change.

    measure at t0, then for every period: { command, samples x ( act, move, measure ) }

`advance` is one control period. It is scanned under `jit` and `vmap` when the controller can be compiled, and
called from a Python loop when it cannot (a quadratic program solved by a C library); the numbers are the same. Other
blocks that cannot be compiled (ordinary classes, NumPy, plants from outside) fly through `stepped`.

Runs are described by data alone: the noise of sample i is a function of (seed, run, i), whatever the batch.
All arithmetic is float64; the caller's JAX configuration is left as it was.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from plants.errors import OpaqueError, ScenarioError
from plants.simulation import blocks, commands, programs, stepped
from plants.simulation.fits import check, check_numbers
from plants.simulation.flight import CULPRITS as CULPRITS
from plants.simulation.flight import Flight, Row, advance, fly_each, launch
from plants.simulation.flight import Record as Record
from plants.simulation.flight import fly as fly
from plants.simulation.flight import rk4 as rk4
from plants.simulation.loop import Actuator as Actuator
from plants.simulation.loop import Controller as Controller
from plants.simulation.loop import Environment as Environment
from plants.simulation.loop import Loop as Loop
from plants.simulation.loop import Navigator as Navigator
from plants.simulation.loop import Plant as Plant
from plants.simulation.loop import Run as Run
from plants.simulation.loop import Scenario as Scenario
from plants.simulation.loop import Sensors as Sensors
from plants.simulation.loop import output_shape, seen


def simulate(loop: Loop, scenario: Scenario, *, compiled: bool | None = None, record: Record | None = None) -> Run:
    """Fly one loop through one scenario.

    Parameters
    ----------
    loop : Loop
        Blocks are frozen dataclasses; their classes are registered with JAX as needed. Others, and what JAX cannot
        trace, fly stepped, run after run; see `stepped`.
    scenario : Scenario
    compiled : bool, optional
        True compiles the controller with the loop, False steps it from Python; by default it is compiled if it
        can be traced. With True a block that JAX cannot trace raises `OpaqueError`.
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
    lanes: int | None = None,
    progress: bool = True,
    on_compile: Callable[[], None] | None = None,
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
    lanes : int, optional
        Fly in so many lanes, the last case in those that are left over, so that batches of a campaign share one
        compilation; by default, and at least, one for each case.
    compiled, record
        As in `simulate`.
    progress : bool
        Show a bar when stepping from Python takes more than two seconds.
    on_compile : callable, optional
        Called without arguments before a program is compiled, or fetched from the disk: that takes seconds, and
        nothing flies meanwhile.
    """
    if not cases:
        raise ScenarioError("cases: got none; give at least one (loop, scenario)")
    try:
        return _fly_together(cases, compiled, record, varying, lanes or 0, progress, on_compile)
    except OpaqueError:
        if compiled:
            raise
    return [_run(case[1], *_alone(case, record)) for case in cases]


def _alone(case: tuple[Loop, Scenario], record: Record | None) -> tuple[Flight, Row, int, Any, bool]:
    """One flight through `stepped`, as `_run` takes it."""
    end, rows, memory = stepped.fly(*case, record)
    return end, rows, 0, memory, False


def _fly_together(
    cases: Sequence[tuple[Loop, Scenario]],
    compiled: bool | None,
    record: Record | None,
    varying: Collection[str],
    lanes: int,
    progress: bool,
    on_compile: Callable[[], None] | None,
) -> list[Run]:
    """`simulate_many` of what JAX can trace; OpaqueError before anything flies if it cannot."""
    loop, scenario = cases[0]
    check(loop, scenario)
    for case in cases[1:]:
        check_numbers(*case)
    programs.make_room(_fly, _launch, _advance, _see)
    with jax.enable_x64(True):
        if compiled is None:
            compiled = _traces(loop, scenario)
        if compiled:
            blocks.register(loop.controller)
            commands.shape(loop, scenario, compiled=True)
        flown = [pair if compiled else (dataclasses.replace(pair[0], controller=None), pair[1]) for pair in cases]
        batch = blocks.stack([*flown, *flown[-1:] * (lanes - len(flown))], varying)
        if compiled:
            end, memory, rows = jax.tree.map(np.asarray, _fly(*batch, record, on_compile=on_compile))
            memories = [jax.tree.map(lambda a, lane=lane: a[lane], memory) for lane in range(len(cases))]
        else:
            end, memories, rows = _step_through(cases, batch, record, progress, on_compile)
            end = jax.tree.map(np.asarray, end)
        return [_run(case[1], end, rows, lane, memories[lane], compiled) for lane, case in enumerate(cases)]


def can_compile(loop: Loop, scenario: Scenario) -> bool:
    """Whether the loop can be traced by JAX, controller and all.

    Any failure means no: stepped from Python, a genuine mistake shows itself again.
    """
    try:
        check(loop, scenario)
        blocks.register(loop.controller)
        with jax.enable_x64(True):
            commands.shape(loop, scenario, compiled=True)
    except Exception:
        return False
    return True


def _traces(loop: Loop, scenario: Scenario) -> bool:
    """Whether the controller can be traced by JAX, in a loop that has been checked."""
    try:
        blocks.register(loop.controller)
        commands.traced(loop, scenario)
    except Exception:
        return False
    return True


def row_bytes(loop: Loop, scenario: Scenario, record: Record | None = None) -> int:
    """Memory that the rows of one run take, bytes."""
    try:
        check(loop, scenario)
        with jax.enable_x64(True):
            nu = commands.shape(loop, scenario, _traces(loop, scenario))
    except OpaqueError:
        return stepped.row_bytes(loop, scenario, record)
    with jax.enable_x64(True):
        period = _row((dataclasses.replace(loop, controller=None), scenario), nu, record)
    return period * scenario.rows * scenario.periods // (scenario.samples * scenario.keep_every)


@blocks.remembered
def _row(case: tuple[Loop, Scenario], nu: tuple[int, ...], record: Record | None) -> int:
    """Memory that the rows of one period take, bytes."""

    def one(loop: Loop, scn: Scenario) -> Any:
        return advance(loop, scn, record, launch(loop, scn, nu), jnp.zeros(nu), 0)[1]

    return sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(jax.eval_shape(one, *case)))


def _fly_each(leaves: Any, form: blocks.Form, record: Record | None) -> Any:
    """`fly` for every lane."""
    scenario = jax.tree.unflatten(form.structure, leaves)[1]
    w, memory, rows = fly_each(lambda part, *own: form.each(part, leaves, *own), scenario, record)
    return w, memory, jax.tree.map(lambda a: jnp.moveaxis(a, 1, 0), rows)


def _launch_each(leaves: Any, form: blocks.Form, nu: tuple[int, ...]) -> Any:
    """`launch` for every lane."""
    return form.each(lambda case: launch(case[0], case[1], nu), leaves)


def _advance_each(leaves: Any, form: blocks.Form, record: Record | None, w: Any, command: Any, k: Any) -> Any:
    """`advance` for every lane."""

    def one(case: Any, w: Flight, command: Any) -> Any:
        return advance(case[0], case[1], record, w, command, k)

    return form.each(one, leaves, w, command)


def _see_each(leaves: Any, form: blocks.Form, estimates: Any, references: Any) -> Any:
    """`seen` for every lane."""
    return form.each(lambda case, y, r: seen(case[0], case[1], y, r), leaves, estimates, references)


_fly = programs.Program(_fly_each, ("form", "record"))
_launch = programs.Program(_launch_each, ("form", "nu"))
_advance = programs.Program(_advance_each, ("form", "record"))
_see = programs.Program(_see_each, ("form",))


def _step_through(
    cases: Sequence[tuple[Loop, Scenario]],
    batch: blocks.Stack,
    record: Record | None,
    progress: bool,
    on_compile: Callable[[], None] | None,
) -> Any:
    """The Python loop: the controllers in turn, then one compiled period for all lanes."""
    (loop, scenario), count = cases[0], len(cases)
    nu = commands.shape(loop, scenario, compiled=False)
    leaves = jax.device_put(batch.leaves)
    w = _launch(leaves, batch.form, nu)
    controllers = [loop.controller for loop, _ in cases]
    tell = _teller(cases, leaves, batch.form)
    memory = [commands.begin(controller) for controller in controllers]
    issued, rows = np.zeros((batch.form.lanes, *nu)), []
    w, _ = _advance(leaves, batch.form, record, w, issued, np.int64(-1), on_compile=on_compile)
    advance_all = _advance.jitted
    for k in tqdm(range(scenario.periods), "periods", delay=2.0, disable=not progress, leave=False):
        sound = np.asarray(w.culprit)[:count] == 0
        if not sound.any():
            break
        estimates, references = tell(np.asarray(w.estimate), k)
        for i, controller in enumerate(controllers):
            if sound[i]:
                told = estimates[i], references[i]
                memory[i], issued[i] = commands.step(controller, memory[i], *told, nu, k * scenario.dt)
        issued[count:] = issued[count - 1]
        w, row = advance_all(leaves, batch.form, record, w, issued, np.int64(k))
        if k % scenario.keep_every == 0:
            rows.append(jax.tree.map(lambda a: np.asarray(a)[:, : scenario.rows], row))
    if not rows:  # all failed before the first command
        rows = [jax.tree.map(np.asarray, _advance(leaves, batch.form, record, w, issued, np.int64(0))[1])]
    return w, memory, jax.tree.map(lambda *parts: np.stack(parts, axis=1), *rows)


def _teller(
    cases: Sequence[tuple[Loop, Scenario]], leaves: Any, form: blocks.Form
) -> Callable[[np.ndarray, int], tuple[Any, Any]]:
    """What turns the estimates of all lanes in period k into what `seen` says, estimates and references."""
    loop, scenario = cases[0]
    ny = output_shape(loop, scenario).shape[0]
    tables = [np.zeros(ny) if scn.reference is None else np.asarray(scn.reference, float) for _, scn in cases]
    tables += tables[-1:] * (form.lanes - len(cases))
    plain = scenario.reference is None or getattr(loop.plant, "error", None) is None

    def tell(estimates: np.ndarray, k: int) -> tuple[Any, Any]:
        r = np.stack([table if table.ndim == 1 else table[k] for table in tables])
        if plain:
            return estimates, r
        y, r = (_see if k == 0 else _see.jitted)(leaves, form, estimates, r)
        return np.asarray(y), np.asarray(r)

    return tell


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
        actuator=jax.tree.map(lambda a: np.asarray(a[lane]).copy(), end.actuator),
    )
