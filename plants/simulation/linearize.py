"""Linear models of a plant by automatic differentiation, in the coordinates of its output.

The output y = h(x, t) of a nadir-pointing body are six numbers that determine attitude and rate. With the Jacobians
F of the dynamics and H of the output, and T the smallest change of state that changes the output by one,

    A = (d/dx of dy/dt) T,   B = d/du of dy/dt,   dy/dt = H f(x, u, t) + dh/dt

dh/dt is there because the orbital frame turns.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike

from plants.checks import real
from plants.errors import ScenarioError
from plants.simulation import blocks
from plants.simulation.loop import Environment, Plant
from plants.simulation.programs import Program

RANK_TOLERANCE = 1e-9  # ()  relative to the largest singular value


class LinearModel(NamedTuple):
    """Continuous model d(dy)/dt = A dy + B du of deviations from a point; C = I, D = 0."""

    A: np.ndarray  # (ny, ny) 1/s, for y in the units of the output
    B: np.ndarray  # (ny, nu)
    C: np.ndarray  # (ny, ny)
    D: np.ndarray  # (ny, nu)


def linearize(
    plant: Plant, x: Any, u: ArrayLike, environment: Environment, *, t: float = 0.0, hold: tuple[str, ...] = ()
) -> LinearModel:
    """Linear model of the output of a plant around a state, an input and a time.

    Parameters
    ----------
    plant : anything with `derivative`, `output`, `project`
    x : state, a NamedTuple of arrays
    u : (nu,) input
    environment : its surroundings, `at(t)`
    t : () s
    hold : fields of the state that are kept as they are, such as ("wheels",)

    Returns
    -------
    LinearModel, NumPy, (A, B, C, D); its state is the deviation of the output (ny,)

    Raises
    ------
    ScenarioError
        The output does not determine the state (without the held fields), a held field does not exist, NaN.

    Notes
    -----
    The point need not be an equilibrium; the drift at the point is then left out of the model.
    """
    x, u, moving = checked_point(plant, x, u, environment, hold)
    with jax.enable_x64(True):
        H, P, F, B = (np.asarray(J) for J in _jacobians(plant, environment, x, u, np.asarray(t, float)))
    for name, matrix in (("output", H), ("derivative", F), ("derivative", B)):
        if not np.isfinite(matrix).all():
            raise ScenarioError(f"plant.{name} has no finite slope at {x}: look at this point and the environment")
    H, F = H[:, moving], F[:, moving]
    freedom = np.linalg.matrix_rank(P[np.ix_(moving, moving)], tol=RANK_TOLERANCE)
    size = H.shape[0]
    if not np.linalg.matrix_rank(H, tol=RANK_TOLERANCE * np.linalg.norm(H, 2)) == freedom == size:
        raise ScenarioError(
            f"the {size} outputs must determine the state's {freedom} degrees of freedom one to one: "
            "return the missing ones from plant.output, or name the fields to be kept constant in `hold`"
        )
    return LinearModel(F @ np.linalg.pinv(H), B, np.eye(size), np.zeros((size, B.shape[1])))


def checked_point(
    plant: Plant, x: Any, u: ArrayLike, environment: Environment, hold: tuple[str, ...]
) -> tuple[Any, np.ndarray, np.ndarray]:
    """State and input of a point as float64, and which numbers of the state are not held, (n,) bool.

    Raises
    ------
    ScenarioError
        A held field does not exist, NaN.
    """
    u = real("u", u, np.shape(u))
    missing = [name for name in hold if name not in x._fields]
    if missing:
        raise ScenarioError(f"hold names {missing}, but the state has the fields {list(x._fields)}")
    blocks.register(plant)
    blocks.register(environment)
    x = type(x)(*(np.asarray(real(name, part, np.shape(part))) for name, part in x._asdict().items()))
    moving = [np.full(np.size(part), name not in hold) for name, part in x._asdict().items()]
    return x, np.asarray(u), np.concatenate(moving)


def jacobians(plant: Any, environment: Any, x: Any, u: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Slopes of the output and of the projection in x, and of the output's rate in x and u."""
    flat, shape = ravel_pytree(x)

    def projection(z):
        return ravel_pytree(plant.project(shape(z)))[0]

    def output(z, t):
        return plant.output(shape(projection(z)), environment.at(t))

    def output_rate(z, u, t):
        drift, _ = ravel_pytree(plant.derivative(shape(z), u, environment.at(t)))
        return jax.jvp(output, (z, t), (drift, jnp.ones_like(t)))[1]

    F, B = jax.jacfwd(output_rate, (0, 1))(flat, u, t)
    return jax.jacfwd(output)(flat, t), jax.jacfwd(projection)(flat), F, B


_jacobians = Program(jacobians)
