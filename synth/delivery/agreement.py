"""How far a state-dependent Riccati law in C may be from the one in Python: measured by flying it in other orders.

C and Python take the same steps, but XLA adds in an order of its own and fuses products with sums: their bits differ.
How much that can do depends on the equations. A law whose states and commands are put in another order, with other
signs, is the same law; its arithmetic rounds otherwise. The recorded samples are flown so `ORDERS` times:

    |u_C - u_Python| <= (2 ACCURACY + FACTOR r) | |K| |x| |,      r the largest of |u_order - u| / | |K| |x| |

The norms are 2-norms, |K| and |x| hold moduli: units of the states do not count.
ACCURACY is the relative error at which a solution is accepted (`synth.equations.riccati`), by either side. r is
measured, not proved; FACTOR is for what was not tried.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from synth.equations.riccati import ACCURACY, closed_loop_rate
from synth.errors import ExportError

SAMPLES = 96  # recorded: the first half a slew, the other half far apart
ORDERS = 8
FACTOR = 16
FEWEST = 16  # samples with a solution, of those tried
WORST = 1e-3  # beyond that the command is made of rounding
NO_SOLUTION = 1e100  # times the usual rate: A is then so large that no Riccati equation is solved
TURNED = {"Q": "xx", "X": "xx", "injection": "xx", "R": "uu", "R_inverse": "uu", "gain": "ux"}  # axes of fields


class Flight(NamedTuple):
    """What a law did in every sample."""

    u: np.ndarray  # (samples, m) N m
    scale: np.ndarray  # (samples,) N m, 2-norm of |K| |x|
    failures: np.ndarray  # (samples,) so far


class Record(NamedTuple):
    """Samples to be flown again elsewhere."""

    y: np.ndarray  # (samples, p), the last one without a solution
    u: np.ndarray  # (samples, m) N m, as Python commands
    bound: float  # of |u_C - u_Python| relative to |K| |x|
    rounding: float  # r
    largest: float  # N m, the largest bound of these samples
    rate: float  # rad/s, largest rate about an axis
    momentum: float  # N m s, largest momentum of the wheels about an axis


@dataclass(frozen=True)
class Turned:
    """A model with its states and commands in another order and with other signs; exact."""

    model: Any
    x: np.ndarray  # (n, n) signed permutation
    u: np.ndarray  # (m, m) signed permutation

    def side(self, y: Any) -> Any:
        """That of the model."""
        return self.model.side(y)

    def factorise(self, y: Any, side: Any) -> tuple[Any, Any, Any]:
        """State, A and B of the model in the other order."""
        return _factorised(type(self.model), vars(self.model), y, side, self.x, self.u)


def recorded(controller: Any) -> Record:
    """Samples all round, what Python commands there, and the bound.

    Raises
    ------
    ExportError : few of the samples have a solution, or the commands are made of rounding.
    """
    y, rate, momentum = _samples(controller)
    rng = np.random.default_rng(0)
    sizes = (len(controller.Q), len(controller.gain))
    orders = [(), *(tuple(_signed(rng, size) for size in sizes) for _ in range(ORDERS))]
    flights = [flown(controller, y, *order) for order in orders]
    failed: np.ndarray = np.diff([flight.failures for flight in flights], prepend=0) > 0
    solved = np.logical_not(failed.any(axis=0))
    if not failed[:, -1].all() or solved.sum() < FEWEST:
        raise ExportError(
            f"the law has a solution at {solved[:-1].sum()} of {len(y) - 1} samples with rates to {rate:.3g} rad/s, "
            f"and {'none' if failed[:, -1].all() else 'one'} at {NO_SOLUTION:g} times that; there is "
            "nothing to compare C with: change Q and R, or the model"
        )
    if not solved[:-1].all():
        y = y[np.append(solved[:-1], True)]
        flights = [flown(controller, y, *order) for order in orders]
    first, *others = flights
    r = max((np.linalg.norm(other.u - first.u, axis=1) / first.scale).max() for other in others)
    bound = 2 * ACCURACY + FACTOR * float(r)
    if not bound <= WORST:
        raise ExportError(
            f"the law's commands move by {r:.2g} of |K| |x| when its states are put in another order: they are made "
            "of rounding; bring the entries of Q and R nearer to each other"
        )
    return Record(y, first.u, bound, float(r), bound * float(first.scale[:-1].max()), rate, momentum)


def flown(controller: Any, y: np.ndarray, x: np.ndarray | None = None, u: np.ndarray | None = None) -> Flight:
    """The law from its first state through samples (samples, p), with states and commands turned by `x` and `u`."""
    n, m = len(controller.Q), len(controller.gain)
    T = {"x": np.eye(n) if x is None else x, "u": np.eye(m) if u is None else u}
    fields = {key: (T[a] @ vars(controller)[key] @ T[b].T) for key, (a, b) in TURNED.items() if key in vars(controller)}
    law = replace(controller, model=Turned(controller.model, T["x"], T["u"]), **fields)
    state, rows = law.init(), []
    with jax.enable_x64(True):
        for now in np.asarray(y, float):
            state, command = law.step(state, now, np.zeros_like(now))
            size = np.abs(state.gain) @ np.abs(law.model.factorise(now, law.model.side(now))[0])
            rows.append((np.asarray(command) @ T["u"], np.linalg.norm(size), int(state.failures)))
    return Flight(*map(np.array, zip(*rows, strict=True)))


@partial(jax.jit, static_argnums=0)  # compiled once for a kind of model
def _factorised(kind: type, fields: dict[str, Any], y: Any, side: Any, x: Any, u: Any) -> tuple[Any, Any, Any]:
    state, A, B = kind(**fields).factorise(y, side)
    return x @ state, x @ A @ x.T, x @ B @ u.T


def _signed(rng: np.random.Generator, n: int) -> np.ndarray:
    return np.eye(n)[rng.permutation(n)] * rng.choice([-1.0, 1.0], n)


def _samples(controller: Any) -> tuple[np.ndarray, float, float]:
    """(y, largest rate, largest momentum): a slew, states all round, at rates that the closed loop has; no solution."""
    model = controller.model
    target = np.asarray(model.target(), float)
    with jax.enable_x64(True):
        _, A, B = (np.asarray(part) for part in model.factorise(jnp.asarray(target), 1.0))
    R_inverse = controller.R_inverse if hasattr(controller, "R_inverse") else np.linalg.inv(controller.R)
    rate = 2 * min(float(closed_loop_rate(A, B @ R_inverse @ B.T, controller.Q)), 1 / controller.dt)
    momentum = rate * float(np.linalg.norm(model.inertia, 2))
    half = SAMPLES // 2
    t = np.linspace(1, 0.02, half)[:, None]
    k = np.arange(1, half + 1)[:, None]
    far = 2 * np.modf(k * np.sqrt([2, 3, 5, 7, 11, 13, 17, 19, 23, 29]))[0] - 1  # all over the cube
    near = np.sin(np.array([3, 5, 4, 6, 7, 2]) * t + [0, 1, 2, 3, 4, 5]) * t
    body = np.vstack([near, far[:, 4:]]) * np.repeat([rate, momentum], 3)
    if len(target) == 9:  # angles
        way = np.array([2.0, 1.2, -2.5]) * t
        attitude = np.vstack([(1 - t) * target[:3] + way, far[:, :3] * [np.pi, 1.5, np.pi]])
    else:
        axis = np.hstack([np.ones_like(t), np.sin(2 * t), np.cos(3 * t)])
        slew = np.hstack([np.cos(t * np.pi / 2), np.sin(t * np.pi / 2) * axis / np.linalg.norm(axis, axis=1)[:, None]])
        far[:4, 0] = [0, 1e-9, -1e-6, 1e-3]  # half a turn
        attitude = np.vstack([slew, far[:, :4] / np.linalg.norm(far[:, :4], axis=1)[:, None]])
    y = np.hstack([attitude, body])
    last = y[-1].copy()
    last[-6:-3] = NO_SOLUTION * rate
    return np.vstack([y, last]), rate, momentum
