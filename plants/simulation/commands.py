"""What a controller hands over, looked at: whatever is wrong with it is told with its class and the time.

The controller is the one block that is written elsewhere, by anybody. A number that is none is a failure of the flight
(`Run.culprit`); what is not even a vector of real numbers is a mistake in the program, and raises `ScenarioError`.
"""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from plants.errors import PlantError, ScenarioError
from plants.simulation.loop import (
    Controller,
    Loop,
    Scenario,
    act,
    actuator_channels,
    env_at,
    first_estimate,
    reference_at,
    seen,
)


def begin(controller: Controller) -> Any:
    """The controller's first state.

    Raises
    ------
    ScenarioError
        If `init` raises.
    """
    try:
        return controller.init()
    except PlantError:
        raise
    except Exception as error:
        raise ScenarioError(f"{_name(controller)}.init raised {_told(error)}") from error


def step(controller: Controller, memory: Any, y: np.ndarray, r: np.ndarray, nu: tuple[int, ...], t: float) -> Any:
    """(new state, command) at time t, s.

    Raises
    ------
    ScenarioError
        If `step` raises, or returns anything but a state and a command of shape `nu` in real numbers.
    """
    try:
        result = controller.step(memory, y, r)
    except PlantError:
        raise
    except Exception as error:
        raise ScenarioError(f"{_name(controller)}.step raised {_told(error)} at t = {t:.9g} s") from error
    new, command = _pair(controller, result)
    return new, _vector(controller, command, nu, f"at t = {t:.9g} s")


def traced(loop: Loop, scn: Scenario) -> tuple[Any, Any]:
    """Shapes of the controller's state and of its command (nu,) where JAX can trace it.

    Raises
    ------
    ScenarioError
        If it can be traced, but what comes of it is no command or a state of another form.
    Exception
        Any other, if it cannot be traced.
    """
    controller = loop.controller
    memory = jax.eval_shape(lambda c: c.init(), controller)
    told = jax.eval_shape(lambda: seen(loop, scn, first_estimate(loop, scn), reference_at(loop, scn, 0)))
    new, command = _pair(controller, jax.eval_shape(lambda c, s, told: c.step(s, *told), controller, memory, told))
    forms = [(jax.tree.structure(s), [leaf.shape for leaf in jax.tree.leaves(s)]) for s in (memory, new)]
    if forms[0] != forms[1]:
        raise ScenarioError(f"{_name(controller)}.step returns a state of another form than it was given")
    if not isinstance(command, jax.ShapeDtypeStruct) or command.dtype.kind not in "fiub" or command.ndim != 1:
        raise ScenarioError(f"{_name(controller)}.step returns the command {command}: return a vector of real numbers")
    return new, command


def shape(loop: Loop, scn: Scenario, compiled: bool) -> tuple[int, ...]:
    """Shape of a command: traced if the controller can be, else asked for once; actuator and plant take it.

    Raises
    ------
    ScenarioError
        If the controller cannot be asked, or the actuator or the plant does not take such a command.
    """
    if compiled:
        try:
            nu = traced(loop, scn)[1].shape
        except ScenarioError:
            raise
        except Exception as error:
            raise ScenarioError(
                f"{_name(loop.controller)} cannot be compiled: {_told(error)}; pass compiled=False to step it"
            ) from error
    else:
        y, r = map(np.asarray, seen(loop, scn, first_estimate(loop, scn), reference_at(loop, scn, 0)))
        nu = np.shape(step(loop.controller, begin(loop.controller), y, r, (), 0.0)[1])
    _taken(dataclasses.replace(loop, controller=None), scn, nu)  # pyright: ignore[reportArgumentType]
    return nu


def _taken(loop: Loop, scn: Scenario, nu: tuple[int, ...]) -> None:
    """Raise `ScenarioError` if actuator and plant do not take a command of that shape."""

    def put(loop: Loop, scn: Scenario) -> Any:
        s = None if loop.actuator is None else loop.actuator.init()
        return act(loop, s, jnp.zeros(nu), scn.initial, jnp.zeros(actuator_channels(loop)), scn.h)[1]

    def move(loop: Loop, scn: Scenario) -> Any:
        return loop.plant.derivative(jax.tree.map(jnp.asarray, scn.initial), put(loop, scn), env_at(scn, 0.0))

    for taker, tried in ((loop.actuator, put), (loop.plant, move)):
        try:
            jax.eval_shape(tried, loop, scn)
        except PlantError:
            raise
        except (TypeError, ValueError, IndexError) as error:  # what wrong shapes raise; other mistakes are its own
            raise ScenarioError(f"{_name(taker)} does not take a command of shape {nu}: {_told(error)}") from error


def _pair(controller: Controller, result: Any) -> tuple[Any, Any]:
    if not isinstance(result, tuple) or len(result) != 2:
        what = f"{len(result)} values" if isinstance(result, tuple) else f"a {type(result).__name__}"
        raise ScenarioError(f"{_name(controller)}.step returns {what}: return (state, command)")
    return result


def _vector(controller: Controller, command: Any, nu: tuple[int, ...], when: str) -> np.ndarray:
    """The command as a vector of floats; of any size where `nu` is ()."""
    try:
        u = np.asarray(command)
    except Exception as error:
        raise ScenarioError(f"{_name(controller)} commands no array {when}: {_told(error)}") from error
    if np.ma.is_masked(command) or u.dtype.kind not in "fiub" or u.ndim != 1 or (nu and u.shape != nu):
        shown = " ".join(repr(command).split())
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        wanted = f"{nu[0]} real numbers" if nu else "a vector of real numbers"
        raise ScenarioError(f"{_name(controller)} commands {shown} {when}: return {wanted}")
    return u.astype(float)


def _name(block: Any) -> str:
    return type(block).__name__


def _told(error: Exception) -> str:
    """An error in one line."""
    text = str(error).partition("\n")[0]
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
