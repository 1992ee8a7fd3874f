"""Linear models of a whole loop along a flight, by automatic differentiation of the very period that is simulated.

With z the coordinates of plant, sensors, navigator and controller at the beginning of a control period, w the noise
and e the errors during it, a small deviation from a flight without noise obeys

    dz(k+1) = A dz(k) + B w(k),   de(k) = C dz(k) + D w(k)

What the coordinates leave out is held at its value on that flight: gains of a filter that hang on its covariance are
frozen, which is right to first order, because they meet an innovation of zero.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from plants.errors import ScenarioError
from plants.simulation import blocks, programs
from plants.simulation.fits import check
from plants.simulation.flight import Flight, advance, launch
from plants.simulation.loop import (
    Loop,
    Scenario,
    actuator_channels,
    env_at,
    first_estimate,
    reference_at,
    seen,
)
from plants.simulation.simulate import can_compile

RANK_TOLERANCE = 1e-9  # () relative, of coordinates in rows of unit length

Errors = Callable[[Any, Any, Any], Any]
Coordinates = Callable[[Flight, Any, Any], tuple[Any, Any]]
Push = Callable[[Scenario, Any, Any], Scenario]


class LoopModel(NamedTuple):
    """Models at k periods; the inputs are h held coordinates, d pushes, then c channels of noise of every sample."""

    A: np.ndarray  # (k, n, n)
    B: np.ndarray  # (k, n, h + d + samples c)
    C: np.ndarray  # (k, samples p, n)
    D: np.ndarray  # (k, samples p, h + d + samples c)
    mean: np.ndarray  # (k, samples p) the errors of the flight without noise, those of the first sample first
    time: np.ndarray  # (k,) s, beginning of the period


class _Dealt(NamedTuple):
    """State of `_Dealer`."""

    sensors: Any
    noise: Any  # (samples, channels) of the next samples


@dataclass(frozen=True, kw_only=True)
class _Dealer:
    """Sensors whose noise stands in their state."""

    sensors: Any
    samples: int
    channels: int = 0

    def init(self) -> _Dealt:
        """No noise."""
        return _Dealt(self.sensors.init(), jnp.zeros((self.samples, self.sensors.channels)))

    def measure(self, s: _Dealt, x: Any, env: Any, noise: Any, h: Any) -> tuple[_Dealt, Any]:
        """Measure with the noise that is next."""
        del noise
        sensors, y = self.sensors.measure(s.sensors, x, env, s.noise[0], h)
        return _Dealt(sensors, jnp.roll(s.noise, -1, axis=0)), y


@dataclass(frozen=True, kw_only=True)
class _Quiet:
    """An actuator without its noise."""

    actuator: Any
    h: float  # () s

    def init(self) -> Any:
        """State before the first command."""
        return self.actuator.init()

    def apply(self, s: Any, command: Any, x: Any) -> tuple[Any, Any]:
        """New state and input, with zeros for the noise."""
        return self.actuator.apply(s, command, x, jnp.zeros(self.actuator.channels), self.h)


def linear_loop(
    loop: Loop,
    scenario: Scenario,
    periods: Sequence[int],
    *,
    errors: Errors,
    coordinates: Coordinates,
    push: Push | None = None,
    pushes: int = 0,
) -> LoopModel:
    """Models of a loop at the given periods of its flight without noise.

    Parameters
    ----------
    loop : with sensors, and a controller that can be compiled
    scenario : its flight; the noise of sensors and actuator is left out, other disturbances act
    periods : k indices of control periods, each below `scenario.periods`
    errors : ``errors(output, estimate, reference) -> (p,)`` at one sample
    coordinates : ``coordinates(flight, memory, env) -> (z (n,), held (h,))`` of the plant's state `flight.x`, the
        states `flight.sensors` and `flight.navigator`, `flight.estimate`, and the controller's `memory`. What is
        `held` is an input, not a state: numbers that wander or stay for good, which would make A unstable
    push : ``push(scenario, v (pushes,), k) -> scenario`` with a disturbance v that acts during period k
    pushes : number d of inputs of `push`

    Raises
    ------
    ScenarioError
        A case that cannot be simulated or compiled, periods beyond the flight, coordinates that depend on each other,
        slopes that are not finite.

    Notes
    -----
    Pass module-level functions: a new lambda in every call compiles anew. The model is that of linear covariance
    analysis (Geller 2006, doi 10.2514/1.20177).
    """
    check(loop, scenario)
    if loop.sensors is None or loop.navigator is None:
        raise ScenarioError("sensors or navigator = None: without both there is no noise to be modelled")
    if not can_compile(loop, scenario):
        raise ScenarioError("controller cannot be traced by JAX: it has no slopes; model it by a `LinearController`")
    at = np.asarray(periods)
    if at.ndim != 1 or at.dtype.kind not in "iu" or not at.size or at.min() < 0 or at.max() >= scenario.periods:
        raise ScenarioError(f"periods = {periods!r}: give whole numbers from 0 to {scenario.periods - 1}")
    dealt = Loop(
        plant=loop.plant,
        controller=loop.controller,
        sensors=_Dealer(sensors=loop.sensors, samples=scenario.samples),
        navigator=loop.navigator,
        actuator=_Quiet(actuator=loop.actuator, h=scenario.h) if actuator_channels(loop) else loop.actuator,
        delay=loop.delay,
    )
    for block in (dealt.sensors, dealt.actuator, loop.controller):
        blocks.register(block)
    with jax.enable_x64(True):
        starts = jax.tree.map(lambda a: a[at], _carries(dealt, scenario))
        parts = _slopes(dealt, scenario, starts, jnp.asarray(at), (errors, coordinates, push, pushes))
        moved, told, T, mean = (np.asarray(a) for a in parts)
    n, held = moved.shape[-2], T.shape[-2] - moved.shape[-2]
    J = np.concatenate([moved, told], axis=-2)
    if not (np.isfinite(J).all() and np.isfinite(T).all()):
        raise ScenarioError("the loop has no finite slope on this flight: look at its blocks there")
    length = np.linalg.norm(T, axis=-1, keepdims=True)
    unit = T / np.where(length > 0, length, 1.0)
    if (np.linalg.svd(unit, compute_uv=False)[..., -1] < RANK_TOLERANCE).any():
        raise ScenarioError(f"coordinates: the {n} and the {held} held depend on each other; leave some out")
    lift = np.linalg.pinv(unit) / length[..., None, :, 0]
    state, inputs = np.split(J, [T.shape[-1]], axis=-1)
    J = np.concatenate([state @ lift, inputs], axis=-1)
    return LoopModel(J[:, :n, :n], J[:, :n, n:], J[:, n:, :n], J[:, n:, n:], mean, at * float(scenario.dt))


def _period(loop: Loop, scn: Scenario, carry: Any, k: Any) -> Any:
    """One control period: the new (flight, memory), and its rows."""
    w, memory = carry
    new, command = loop.controller.step(memory, *seen(loop, scn, w.estimate, reference_at(loop, scn, k)))
    w = w._replace(culprit=jnp.zeros((), int), failed=jnp.zeros((), int))
    w, rows = advance(loop, scn, None, w, jnp.asarray(command, float), k)
    return (w._replace(culprit=None, failed=None), new), rows


def _carries_of(loop: Loop, scn: Scenario) -> Any:
    """(flight, memory) at the beginning of every period."""
    seen0 = seen(loop, scn, first_estimate(loop, scn), reference_at(loop, scn, 0))
    shapes = jax.eval_shape(lambda: loop.controller.step(loop.controller.init(), *seen0))
    memory = jax.tree.map(lambda a, s: jnp.asarray(a, s.dtype), loop.controller.init(), shapes[0])
    w = launch(loop, scn, shapes[1].shape)
    w, _ = advance(loop, scn, None, w, jnp.zeros(shapes[1].shape), -1)  # the first measurement
    w = w._replace(culprit=None, failed=None)

    def step(carry: Any, k: Any) -> Any:
        return _period(loop, scn, carry, k)[0], carry

    return jax.lax.scan(step, (w, memory), jnp.arange(scn.periods))[1]


def _slopes_of(loop: Loop, scn: Scenario, carries: Any, at: Any, functions: Any) -> Any:
    """For each period the slopes of coordinates and errors in (carry, push, noise), of all coordinates, the errors."""
    errors, coordinates, push, pushes = functions
    shape = (scn.samples, loop.sensors.sensors.channels)  # pyright: ignore[reportAttributeAccessIssue, reportOptionalMemberAccess]

    def all_coordinates(carry: Any, k: Any) -> Any:
        w, memory = carry
        w = w._replace(x=loop.plant.project(w.x), sensors=w.sensors.sensors)
        return coordinates(w, memory, env_at(scn, k * scn.dt))

    def one(carry: Any, k: Any) -> Any:
        flat, whole = ravel_pytree(carry)

        def ahead(inputs: Any) -> Any:
            w, memory = whole(inputs[: flat.size])
            v, noise = inputs[flat.size : flat.size + pushes], inputs[flat.size + pushes :].reshape(shape)
            pushed = scn if push is None else push(scn, v, k)
            w = w._replace(sensors=_Dealt(w.sensors.sensors, noise))
            new, rows = _period(loop, pushed, (w, memory), k)
            told = jax.vmap(errors, (0, 0, None))(rows.output, rows.estimate, reference_at(loop, scn, k))
            return (all_coordinates(new, k + 1)[0], told.ravel()), told.ravel()

        slopes, mean = jax.jacfwd(ahead, has_aux=True)(jnp.concatenate([flat, jnp.zeros(pushes + shape[0] * shape[1])]))
        T = jax.jacfwd(lambda flat: jnp.concatenate(all_coordinates(whole(flat), k)))(flat)
        return (*slopes, T, mean)

    return jax.vmap(one)(carries, at)


_carries = programs.Program(_carries_of, once=True)
_slopes = programs.Program(_slopes_of, ("functions",), once=True)
