"""Whether the blocks of a loop fit together and the scenario fits them, told before the flight in the user's own words.

Blocks are written by anybody. What is wrong with one is told with its field, its class and the remedy; the language of
the compiler stays inside.
"""

import dataclasses
import traceback
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from plants.errors import OpaqueError, PlantError, ScenarioError
from plants.simulation import blocks
from plants.simulation.loop import (
    MEMORY,
    Loop,
    Scenario,
    act,
    actuator_channels,
    env_at,
    first_estimate,
    output_shape,
)

METHODS = {
    "plant": ("derivative", "output", "project"),
    "controller": ("init", "step"),
    "sensors": ("init", "measure"),
    "navigator": ("init", "update"),
    "actuator": ("init", "apply"),
    "scenario.environment": ("at",),
}
UNTRACEABLE = (
    jax.errors.TracerArrayConversionError,
    jax.errors.TracerBoolConversionError,
    jax.errors.TracerIntegerConversionError,
    jax.errors.ConcretizationTypeError,
)


def check(loop: Loop, scenario: Scenario) -> None:
    """Raise `ScenarioError` naming the first thing of a case that cannot be used, and register its blocks with JAX."""
    for name in ("periods", "samples", "steps", "keep_every"):
        count = getattr(scenario, name)
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise ScenarioError(f"{name} = {count!r}: give a whole number of at least 1")
    if scenario.periods % scenario.keep_every:
        raise ScenarioError(f"keep_every = {scenario.keep_every} does not divide periods = {scenario.periods}")
    for name in ("dt", "bound"):
        value = getattr(scenario, name)
        real = np.ndim(value) == 0 and np.asarray(value).dtype.kind in "fiu"
        if not (real and np.isfinite(value) and value > 0):
            raise ScenarioError(f"{name} = {value!r}: give a positive finite number")
    if not isinstance(loop.delay, int) or loop.delay < 0:
        raise ScenarioError(f"delay = {loop.delay!r}: give a whole number of control periods, at least 0")
    _check_methods("controller", loop.controller)
    _check_period(loop, scenario)
    if (loop.navigator is None) != (loop.sensors is None):
        given, missing = ("sensors", "navigator") if loop.navigator is None else ("navigator", "sensors")
        raise ScenarioError(
            f"{missing} = None: without it the {given} would go unheard, and the controller get the true output; "
            "give both or neither"
        )
    for name, block in blocks_of(loop, scenario).items():
        opaque = foreign(name, block)
        if opaque is not None:
            raise opaque
    check_rest(loop, scenario)
    with jax.enable_x64(True):
        _check_shapes(loop, scenario)


def check_rest(loop: Loop, scenario: Scenario) -> None:
    """The part of `check` that looks at numbers, methods and the size of a flight, whether blocks are opaque or not."""
    check_numbers(loop, scenario)
    for name, block in blocks_of(loop, scenario).items():
        _check_methods(name, block)
    _check_size(scenario)


def blocks_of(loop: Loop, scenario: Scenario) -> dict[str, Any]:
    """What is checked and called, by the name that messages have for it; without the controller."""
    own = {name: getattr(loop, name) for name in ("plant", "sensors", "navigator", "actuator")}
    return {**own, "scenario.environment": scenario.environment}


def foreign(name: str, block: Any) -> ScenarioError | None:
    """Why a block is none that JAX knows, or None: OpaqueError if it can be stepped, else ScenarioError."""
    if block is None or isinstance(block, type):
        return None
    kind = type(block).__name__
    missing = _missing(name, block)
    try:
        blocks.register(block)
        if _is_opaque(block):
            blocks.check_numbers(block, name if "." in name else f"loop.{name}")
    except ScenarioError as error:
        return ScenarioError(str(error)) if missing else OpaqueError(str(error))
    if name != "plant" or missing:
        return None
    if not hasattr(block, "derivative"):
        return OpaqueError(f"plant = {kind} has advance and no derivative: it flies stepped, not compiled")
    if not hasattr(block, "project"):
        return OpaqueError(f"plant = {kind} has no project; give one that has, or fly it stepped")
    return None


def _is_opaque(block: Any) -> bool:
    """Whether JAX takes a block, or a part of it, for a single thing that is no number."""
    known = np.ndarray | np.generic | jax.Array | complex | float | int | str
    return any(not isinstance(leaf, known) for leaf in jax.tree.leaves(block))


def check_numbers(loop: Loop, scenario: Scenario) -> None:
    """The part of `check` that may differ between cases of the same structure; opaque blocks may hold anything."""
    opaque = {
        name: None for name in ("plant", "sensors", "navigator", "actuator") if foreign(name, getattr(loop, name))
    }
    known = dataclasses.replace(loop, **{**opaque, "controller": None})  # pyright: ignore[reportArgumentType]
    if foreign("scenario.environment", scenario.environment) is None:
        blocks.register(scenario)
        blocks.check_numbers(scenario, "scenario")
    blocks.register(known)
    blocks.register(scenario.initial)
    blocks.check_numbers(known, "loop")
    blocks.check_numbers(scenario.initial, "scenario.initial", finite=True)
    lasts = getattr(scenario.environment, "duration", np.inf)
    if scenario.periods * scenario.dt > lasts * (1 + 1e-9):
        raise ScenarioError(
            f"environment lasts {lasts:g} s, the flight {scenario.periods * scenario.dt:g} s: "
            "build the environment for a longer `duration`, or fly fewer periods"
        )
    step, longest = scenario.h / scenario.steps, getattr(loop.plant, "longest_step", np.inf)
    if step > longest * (1 + 1e-9):
        raise ScenarioError(
            f"the plant is integrated in steps of {step:.4g} s, but its `longest_step` is {longest:.4g} s: raise "
            "`samples` or `steps`, or leave out what is fast (modes of appendages, imbalance of wheels, dry "
            "friction over a small `creep`)"
        )
    judge = getattr(loop.plant, "check", None)
    if judge is not None:
        _check_kind(loop, scenario.initial)
        judge(scenario.initial)


def untraceable(error: BaseException | None) -> bool:
    """Whether code failed because it was given no numbers but the arrays of a compiler."""
    if error is None:
        return False
    text = str(error)
    alien = isinstance(error, TypeError | AttributeError) and ("Tracer" in text or "JAX arrays are immutable" in text)
    return isinstance(error, UNTRACEABLE) or alien or untraceable(error.__cause__ or error.__context__)


def told(error: Exception) -> str:
    """An error in one line of its own words; that something cannot be compiled in the user's, with the line of code."""
    if isinstance(error, UNTRACEABLE):
        return (
            f"{_place(error)}needs plain numbers (NumPy, float() or `if`), and in a compiled flight there are none: "
            "write it with jax.numpy, a choice with jnp.where"
        )
    text = str(error).partition("\n")[0]
    for word in ("DynamicJaxprTracer", "BatchTracer", "JVPTracer", "ShapeDtypeStruct"):
        text = text.replace(f"'{word}' object", "an array").replace(word, "array")
    text = text.replace("got incompatible shapes for broadcasting:", "of arrays whose shapes do not go together:")
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def _place(error: Exception) -> str:
    """Where the code stands that is not this package's nor a library's."""
    here = Path(__file__).parents[1]
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        path = Path(frame.filename)
        if not path.is_relative_to(here) and "site-packages" not in path.parts and path.suffix == ".py":
            return f"line {frame.lineno} of {path.name} "
    return ""


def _check_methods(name: str, block: Any) -> None:
    """Raise `ScenarioError` if what stands for a block is none."""
    if block is None and name not in ("plant", "controller"):
        return
    if isinstance(block, type):
        raise ScenarioError(f"{name} = {block.__name__} is a class: give an object of it")
    missing = _missing(name, block)
    if missing:
        remedy = "; give one, such as synth.LinearController.of(K)" if name == "controller" else "; give one that has"
        raise ScenarioError(f"{name} = {type(block).__name__} has no {' and no '.join(missing)}{remedy}")


def _missing(name: str, block: Any) -> list[str]:
    """Methods that a block should have and has not; a plant that is stepped may do with less."""
    needed = METHODS[name]
    if name == "plant":
        outside = hasattr(block, "advance") and not hasattr(block, "derivative")
        needed = ("advance" if outside else "derivative", "output")  # `project` if there is one
    return [method for method in needed if not callable(getattr(block, method, None))]


def _check_period(loop: Loop, scn: Scenario) -> None:
    """Raise `ScenarioError` if the controller is called at another period than its own."""
    dt = getattr(loop.controller, "dt", None)
    try:
        same = np.isclose(float(dt), scn.dt, rtol=1e-9, atol=0)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        raise ScenarioError(f"controller.dt = {dt!r}: a controller says its period in s") from None
    if not same:
        raise ScenarioError(
            f"controller.dt = {dt} differs from scenario.dt = {scn.dt}: design the "
            "controller for the period at which it is called"
        )


def _check_kind(loop: Loop, initial: Any) -> None:
    """Raise `ScenarioError` if the state is not of the class that the plant's annotations name."""
    try:
        kind = typing.get_type_hints(type(loop.plant).output)["x"]
    except (AttributeError, KeyError, NameError, TypeError):
        return
    fields = getattr(kind, "_fields", None)
    if fields and not isinstance(initial, kind):
        raise ScenarioError(
            f"initial is a {type(initial).__name__}: {type(loop.plant).__name__} has a state "
            f"{kind.__name__}({', '.join(fields)})"
        )


def _check_size(scn: Scenario) -> None:
    """Raise `ScenarioError` if the rows of one run, or what one period takes, are more than this machine can hold."""
    state = sum(np.size(leaf) for leaf in jax.tree.leaves(scn.initial))
    rows = scn.periods // scn.keep_every * scn.rows * state
    if 8 * max(rows, scn.samples * (2 * scn.steps + 1)) > MEMORY:
        raise ScenarioError(
            f"periods = {scn.periods}, samples = {scn.samples}, steps = {scn.steps}, keep_every = {scn.keep_every} "
            f"take more than the {MEMORY / 2**30:.3g} GiB of this machine: fly less, or raise keep_every"
        )


def _check_shapes(loop: Loop, scn: Scenario) -> None:
    """Raise `ScenarioError` if environment, output, reference, measurement or estimate do not fit."""
    env = _tried("environment", scn.environment, "at", lambda e: None if e is None else e.at(0.0), scn.environment)
    shape = _output(loop, scn, env).shape
    check_reference(scn, shape)
    if loop.sensors is not None:
        _check_measurement(loop, scn)


def check_reference(scn: Scenario, shape: tuple[int, ...]) -> None:
    """Raise `ScenarioError` if the output is no vector or the reference is none of its kind."""
    if len(shape) != 1:
        raise ScenarioError(f"plant.output has shape {shape}: return a vector")
    if scn.reference is not None and np.shape(scn.reference) not in (shape, (scn.periods, *shape)):
        raise ScenarioError(
            f"reference has shape {np.shape(scn.reference)}: give {shape} or {(scn.periods, *shape)}, "
            "as many columns as the plant has outputs"
        )


def _output(loop: Loop, scn: Scenario, env: Any) -> Any:
    """Shape of the plant's output."""
    try:
        return output_shape(loop, scn)
    except PlantError:
        raise
    except Exception as error:
        name = type(loop.plant).__name__
        if untraceable(error):
            raise OpaqueError(f"plant: {name}.output {told(error)}") from error
        if scn.environment is None and scn.initial is not None and "NoneType" in str(error):
            raise ScenarioError(
                f"environment = None: {name} needs surroundings; give an `Environment`, or `FreeSpace()` for none"
            ) from error
        raise ScenarioError(
            f"scenario.initial or scenario.environment does not fit the plant: {name}.output raised {told(error)}"
        ) from error


def check_flow(loop: Loop, scn: Scenario, nu: tuple[int, ...]) -> None:
    """Raise `ScenarioError` if actuator, plant or navigator do not take what comes of a command of shape `nu`."""
    known = dataclasses.replace(loop, controller=None)  # pyright: ignore[reportArgumentType]
    _check_flow((known, scn), nu)


@blocks.remembered
def _check_flow(case: tuple[Loop, Scenario], nu: tuple[int, ...]) -> None:
    """`check_flow` of a loop without its controller."""

    def put(loop: Loop, scn: Scenario) -> Any:
        s = None if loop.actuator is None else loop.actuator.init()
        return act(loop, s, jnp.zeros(nu), scn.initial, jnp.zeros(actuator_channels(loop)), scn.h)

    def move(loop: Loop, scn: Scenario) -> Any:
        return loop.plant.derivative(start(scn), put(loop, scn)[1], env_at(scn, 0.0))

    def know(loop: Loop, scn: Scenario) -> Any:
        sensors, navigator = loop.sensors, loop.navigator
        assert sensors is not None
        assert navigator is not None
        x, env = start(scn), env_at(scn, 0.0)
        y = sensors.measure(sensors.init(), x, env, jnp.zeros(sensors.channels), scn.h)[1]
        return navigator.update(navigator.init(), y, put(loop, scn)[1], env, scn.h)

    def start(scn: Scenario) -> Any:
        return jax.tree.map(jnp.asarray, scn.initial)

    known, scn = case
    what = f"command of shape {nu}"
    _flows(known.actuator, "apply", what, put, case)
    rates = _flows(known.plant, "derivative", what, move, case)
    name, x = type(known.plant).__name__, jax.eval_shape(start, scn)
    shapes = [[leaf.shape for leaf in jax.tree.leaves(tree)] for tree in (rates, x)]
    if jax.tree.structure(rates) != jax.tree.structure(x) or shapes[0] != shapes[1]:
        raise ScenarioError(
            f"initial does not fit the plant: {name}.derivative returns {jax.tree.structure(rates)} of shapes "
            f"{shapes[0]}, initial is {jax.tree.structure(x)} of {shapes[1]}"
        )
    if known.navigator is not None:
        result = _flows(known.navigator, "update", "measurement of these sensors", know, case)
        estimate, wanted = result[1], jax.eval_shape(first_estimate, known, scn).shape
        if getattr(estimate, "shape", None) != wanted:
            raise ScenarioError(
                f"navigator: {type(known.navigator).__name__}.update returns an estimate of shape "
                f"{getattr(estimate, 'shape', None)}: {name} has outputs of shape {wanted}"
            )


def _flows(block: Any, method: str, what: str, function: Callable[..., Any], case: tuple[Loop, Scenario]) -> Any:
    """Shapes of function(loop, scenario); ScenarioError if a block does not take what it is given."""
    try:
        return jax.eval_shape(function, *case)
    except PlantError:
        raise
    except (*UNTRACEABLE, TypeError, ValueError, IndexError, AttributeError) as error:  # what wrong shapes raise
        if untraceable(error):
            raise OpaqueError(f"{type(block).__name__}.{method}: {told(error)}") from error
        raise ScenarioError(f"{type(block).__name__} does not take a {what}: {told(error)}") from error


def _check_measurement(loop: Loop, scn: Scenario) -> None:
    """Raise `ScenarioError` if the sensors do not fit the plant and its surroundings."""
    channels = getattr(loop.sensors, "channels", None)
    if not isinstance(channels, int | np.integer) or isinstance(channels, bool) or channels < 0:
        raise ScenarioError(f"sensors.channels = {channels!r}: give the number of normal numbers that a sample takes")

    def first(sensors: Any, scn: Scenario) -> Any:
        x = jax.tree.map(jnp.asarray, scn.initial)
        return _both(sensors.measure(sensors.init(), x, env_at(scn, 0.0), jnp.zeros(channels), scn.h))

    _tried("sensors", loop.sensors, "measure", first, loop.sensors, scn)


def _both(result: Any) -> Any:
    if not isinstance(result, tuple) or len(result) != 2:
        raise TypeError(f"it returned a {type(result).__name__}; return (state, what comes of it)")
    return result


def _tried(name: str, block: Any, method: str, function: Callable[..., Any], *own: Any) -> Any:
    """Shapes of function(block); ScenarioError that names the block if it cannot be traced."""
    try:
        return jax.eval_shape(function, *(own or (block,)))
    except PlantError:
        raise
    except Exception as error:
        kind = OpaqueError if untraceable(error) else ScenarioError
        raise kind(f"{name}: {type(block).__name__}.{method} {told(error)}") from error
