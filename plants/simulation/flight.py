"""One flight as JAX sees it: a control period, and the scan over all of them. Traceable; nothing here compiles.

    measure at t = 0, then for every period: { command, samples x ( act, move, measure ) }

The first measurement is a period of its own, number -1, that does nothing else: so a program holds sensors and
navigator once, which is half of what a compiler has to do.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from plants.simulation.loop import Loop, Plant, Scenario, act, actuator_channels, first_estimate, reference_at, seen

ACTUATOR = 2**32 - 1  # names the noise of the actuator, where the sensors' has the index of a sample
CULPRITS = ("", "controller", "plant", "navigator", "sensors")

Record = Callable[[Any, Any, Any, Any], Any]


class Flight(NamedTuple):
    """What one control period hands to the next."""

    x: Any  # plant state
    u: Any  # plant input that acted last
    sensors: Any
    measured: Any  # () whether all measurements of this period were made of numbers
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


def advance(loop: Loop, scn: Scenario, record: Record | None, w: Flight, command: Any, k: Any) -> Any:
    """One control period from t = k dt: the new `Flight` and `samples` rows. Period -1 measures at t = 0 only."""
    queue = jnp.concatenate([w.pending, command[None]])  # the oldest command acts, the newest waits
    indices = k * scn.samples + 1 + jnp.arange(scn.samples)  # of the measurements that end the samples

    def sample(now: Flight, turn: Any) -> tuple[Flight, Row]:
        envs, noise, torque_noise, index = turn
        h = jnp.where(index > 0, scn.h, 0.0)
        stages = [jax.tree.map(lambda a, m=m: a[m], envs) for m in range(2 * scn.steps + 1)]
        actuator, u = act(loop, now.actuator, queue[0], now.x, torque_noise, scn.h)
        extra = None if record is None else record(now.x, stages[0], now.sensors, now.navigator)
        output = loop.plant.output(now.x, stages[0])
        row = Row(now.x, output, now.estimate[: output.shape[0]], command, u, extra)
        x = now.x
        for s in range(0, 2 * scn.steps, 2):
            x = loop.plant.project(rk4(loop.plant, x, u, stages[s : s + 3], h / scn.steps))
        moved = _either(index > 0, now._replace(x=x, u=u, actuator=actuator), now)
        # the barriers keep XLA from computing the plant again in every consumer
        moved = jax.lax.optimization_barrier(moved)
        return _either(index >= 0, observe(loop, moved, stages[-1], noise, h), moved), row

    new, rows = jax.lax.scan(sample, w, (_surroundings(scn, k), *_noise(loop, scn, indices), indices))
    return _judge(scn, w, new._replace(pending=queue[1:]), command, k), rows


def observe(loop: Loop, w: Flight, env: Any, noise: Any, h: Any) -> Flight:
    """Measure and navigate, `h` s after the last time."""
    if loop.sensors is None or loop.navigator is None:
        return w._replace(estimate=loop.plant.output(w.x, env))
    sensors, y = jax.lax.optimization_barrier(loop.sensors.measure(w.sensors, w.x, env, noise, h))
    navigator, estimate = loop.navigator.update(w.navigator, y, w.u, env, h)
    measured = w.measured & jnp.all(jnp.array([jnp.isfinite(leaf).all() for leaf in jax.tree.leaves(y)]))
    return w._replace(sensors=sensors, measured=measured, navigator=navigator, estimate=estimate)


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
    return fly_each(lambda part, *own: part((loop, scn), *own), scn, record)


def fly_each(each: Callable[..., Any], scn: Scenario, record: Record | None) -> Any:
    """`fly` for all lanes; the rows are (kept, lanes, samples, ...).

    Parameters
    ----------
    each : ``each(part, *own)`` is ``part((loop, scenario), *own)`` for all lanes. The loops over time are outside of
        it, because JAX traces a loop that it has to batch several times over.
    scn : any of the scenarios, for what is equal in all
    record : as in `simulate.simulate`
    """

    def start(case: tuple[Loop, Scenario]) -> Any:
        controller, seen0 = case[0].controller, seen(*case, first_estimate(*case), reference_at(*case, 0))
        shapes = jax.eval_shape(lambda: controller.step(controller.init(), *seen0))
        memory = jax.tree.map(lambda a, s: jnp.asarray(a, s.dtype), controller.init(), shapes[0])
        return launch(*case, shapes[1].shape), memory

    def period(carry: Any, k: Any) -> Any:
        def one(case: tuple[Loop, Scenario], w: Flight, memory: Any) -> Any:
            loop, scn = case
            y, r = seen(loop, scn, w.estimate, reference_at(loop, scn, jnp.maximum(k, 0)))
            new, command = loop.controller.step(memory, y, r)
            new = _either((w.culprit == 0) & (k >= 0), new, memory)
            command = jnp.where(k >= 0, jnp.asarray(command, float), 0.0)
            w, rows = advance(loop, scn, record, w, command, k)
            return (w, new), jax.tree.map(lambda a: a[: scn.rows], rows)

        return each(one, *carry)

    def group(carry: Any, ks: Any) -> Any:
        carry, rows = jax.lax.scan(period, carry, ks)
        return carry, jax.tree.map(lambda a: a[0], rows)

    ks = jnp.arange(-scn.keep_every, scn.periods).reshape(-1, scn.keep_every)
    (w, memory), rows = jax.lax.scan(group, each(start), ks)
    return w, memory, jax.tree.map(lambda a: a[1:], rows)


def launch(loop: Loop, scn: Scenario, nu: tuple[int, ...]) -> Flight:
    """The `Flight` before the first measurement, made by period -1."""
    command = jnp.zeros(nu)
    actuator = None if loop.actuator is None else loop.actuator.init()
    noise = jnp.zeros(actuator_channels(loop))
    u = jnp.zeros(jax.eval_shape(lambda x: act(loop, actuator, command, x, noise, scn.h)[1], scn.initial).shape)
    w = Flight(
        x=scn.initial,
        u=u,
        sensors=None if loop.sensors is None else loop.sensors.init(),
        measured=jnp.ones((), bool),
        navigator=None if loop.navigator is None else loop.navigator.init(),
        estimate=first_estimate(loop, scn),
        actuator=actuator,
        pending=jnp.zeros((loop.delay, *nu)),
        culprit=jnp.zeros((), int),
        failed=jnp.zeros((), int),
    )
    whole = jax.tree.map(jnp.asarray, w)
    return whole._replace(x=jax.tree.map(lambda a: a.astype(float) if a.dtype.kind in "iu" else a, whole.x))


def _surroundings(scn: Scenario, k: Any) -> Any:
    """The environment at all Runge-Kutta stages of period k, (samples, 2 steps + 1, ...); or None.

    All at once, because one look-up of many times costs hardly more than one of a single time.
    """
    if scn.environment is None:
        return None
    stages = 2 * scn.steps
    instants = jnp.maximum(k * scn.samples * stages + np.arange(scn.samples * stages + 1), 0)
    envs = jax.vmap(scn.environment.at)(instants * (scn.h / stages))
    turns = stages * np.arange(scn.samples)[:, None] + np.arange(stages + 1)
    return jax.tree.map(lambda a: a[turns], envs)


def _noise(loop: Loop, scn: Scenario, indices: Any) -> tuple[Any, Any]:
    """Standard normal numbers of the samples (n,) for sensors and actuator, each (n, channels) or None."""
    key = jax.random.fold_in(jax.random.key(scn.seed, impl="threefry2x32"), scn.run)
    at = jnp.maximum(indices, 0)

    def draw(key: Any, channels: int) -> Any:
        return jax.vmap(lambda i: jax.random.normal(jax.random.fold_in(key, i), (channels,)))(at)

    channels = actuator_channels(loop)
    return (
        None if loop.sensors is None else draw(key, loop.sensors.channels),
        draw(jax.random.fold_in(key, ACTUATOR), channels) if channels else None,
    )


def _judge(scn: Scenario, w: Flight, new: Flight, command: Any, k: Any) -> Flight:
    """The new `Flight` if all of it is sound; else the old one, standing still, with the culprit and the period."""
    blame = _lost(scn, new)
    blame = jnp.where(_sound(scn, new.x), blame, CULPRITS.index("plant"))
    blame = jnp.where(jnp.isfinite(command).all(), blame, CULPRITS.index("controller"))
    stands = w.culprit != 0
    blame = jnp.where(stands, w.culprit, blame)
    kept = _either(blame == 0, new, w)
    failed = jnp.where(stands | (blame == 0), w.failed, jnp.maximum(k, 0))
    return kept._replace(measured=jnp.ones((), bool), culprit=blame, failed=failed)


def _lost(scn: Scenario, w: Flight) -> Any:
    """Index of the culprit where nothing is known of the plant: the sensors, if they measured no numbers; else 0."""
    blame = jnp.where(w.measured, CULPRITS.index("navigator"), CULPRITS.index("sensors"))
    return jnp.where(_sound(scn, (w.estimate, w.navigator)), 0, blame)


def _either(condition: Any, a: Any, b: Any) -> Any:
    """All of `a` or all of `b`."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), a, b)


def _sound(scn: Scenario, values: Any) -> Any:
    """Whether every number is within the bound; a NaN is not."""
    tests = [jnp.all(jnp.abs(leaf) <= scn.bound) for leaf in jax.tree.leaves(values)]
    return jnp.all(jnp.array(tests))
