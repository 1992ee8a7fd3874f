"""What a controller hands over, looked at: whatever is wrong with it is told with its class and the time.

The controller is the one block that is written elsewhere, by anybody. A number that is none is a failure of the flight
(`Run.culprit`); what is not even a vector of real numbers is a mistake in the program, and raises `ScenarioError`.
"""

import dataclasses
from typing import Any

import jax
import numpy as np

from plants.errors import PlantError, ScenarioError
from plants.simulation.fits import check_flow, told
from plants.simulation.loop import (
    Controller,
    Loop,
    Scenario,
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
        raise ScenarioError(f"{_name(controller)}.init raised {told(error)}") from error


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
        raise ScenarioError(f"{_name(controller)}.step raised {told(error)} at t = {t:.9g} s") from error
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
                f"{_name(loop.controller)} cannot be compiled: {told(error)}; pass compiled=False to step it"
            ) from error
    else:
        known = dataclasses.replace(loop, controller=None)  # pyright: ignore[reportArgumentType]
        y, r = map(np.asarray, _first_told(known, scn))
        nu = np.shape(step(loop.controller, begin(loop.controller), y, r, (), 0.0)[1])
    check_flow(loop, scn, nu)
    return nu


@jax.jit
def _first_told(loop: Loop, scn: Scenario) -> tuple[Any, Any]:
    """What a controller is told at first."""
    return seen(loop, scn, first_estimate(loop, scn), reference_at(loop, scn, 0))


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
        raise ScenarioError(f"{_name(controller)} commands no array {when}: {told(error)}") from error
    if np.ma.is_masked(command) or u.dtype.kind not in "fiub" or u.ndim != 1 or (nu and u.shape != nu):
        shown = " ".join(repr(command).split())
        shown = shown if len(shown) <= 60 else shown[:57] + "..."
        wanted = f"{nu[0]} real numbers" if nu else "a vector of real numbers"
        raise ScenarioError(f"{_name(controller)} commands {shown} {when}: return {wanted}")
    return u.astype(float)


def _name(block: Any) -> str:
    return type(block).__name__
