"""Linear models of a plant whose numbers are uncertain: polynomials in them, by automatic differentiation.

    E(d) d(dy)/dt = A(d) dy + B(d) du,        d the deviations of the parameters from their nominal values

E is the plant's own `mass`, the matrix that its rates are multiplied by in its equations of motion, so that an inertia
stays on the left and 1/J occurs nowhere. E, A and B are expanded to first or second order in d. Those of a rigid body
are of first order in every entry of its inertia, and the expansion is the model itself; for what has another structure,
or no `mass`, it is a Taylor polynomial. Which of both it is, is measured at the corners of the box.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import positive, real
from plants.errors import ScenarioError
from plants.simulation import blocks
from plants.simulation.linearize import checked_point, jacobians, linearize
from plants.simulation.loop import Environment, Plant
from plants.simulation.programs import Program

ROUNDING = 1e-12  # () of the largest entry of its row; what is smaller has no meaning
EXACT = 1e-10  # () relative error at the corners, from which on a model is an expansion
MOST = 8  # parameters


class UncertainModel(NamedTuple):
    """E(d) d(dy)/dt = A(d) dy + B(d) du of deviations from a point, in k monomials of n parameters; C = I, D = 0."""

    names: tuple[str, ...]  # (n,)
    nominal: np.ndarray  # (n,)
    low: np.ndarray  # (n,) least values
    high: np.ndarray  # (n,) largest values
    powers: np.ndarray  # (k, n) of the deviations from the nominal values, whole numbers
    E: np.ndarray  # (k, ny, ny) coefficients
    A: np.ndarray  # (k, ny, ny)
    B: np.ndarray  # (k, ny, nu)
    error: float = math.nan  # largest relative error of E^-1 A and E^-1 B at the corners of the box

    @property
    def exact(self) -> bool:
        """Whether the error is that of rounding: the model is the plant's own, not an expansion."""
        return self.error < EXACT

    def over(self, symbol: Callable[..., Any], within: float | None = None) -> tuple[Any, Any, Any, Any, Any]:
        """`at` symbols made by `symbol(name, nominal, range=(low, high))`, such as `synth.ureal`.

        `within` is another relative deviation than that of the model.
        """
        half = (self.high - self.low) / 2 if within is None else within * np.abs(self.nominal)
        ends = zip(self.names, self.nominal, (self.nominal - half), (self.nominal + half), strict=True)
        return self.at({name: symbol(name, float(x), range=(float(a), float(b))) for name, x, a, b in ends})

    def at(self, values: Mapping[str, Any]) -> tuple[Any, Any, Any, np.ndarray, np.ndarray]:
        """(E, A, B, C, D) at values by name that can be added and multiplied: numbers, or symbols of any kind.

        Of `ureal` parameters it gives the arguments of an `UncertainSystem`. What is not named has its nominal value.

        Raises
        ------
        ScenarioError
            A name of no parameter.
        """
        unknown = [name for name in values if name not in self.names]
        if unknown:
            raise ScenarioError(f"values names {unknown}, but the parameters are {list(self.names)}")
        named = zip(self.names, self.nominal.tolist(), strict=True)
        d = [values[name] - nominal if name in values else 0.0 for name, nominal in named]
        factors = [
            math.prod((x**k for x, k in zip(d, row, strict=True) if k), start=1.0) for row in self.powers.tolist()
        ]
        E, A, B = (sum((c * f for c, f in zip(M, factors, strict=True)), start=0.0) for M in (self.E, self.A, self.B))
        ny, nu = self.B.shape[1:]
        return E, A, B, np.eye(ny), np.zeros((ny, nu))


def uncertain_model(
    plant: Callable[[Any], Plant],
    parameters: Mapping[str, float],
    x: Any,
    u: ArrayLike,
    environment: Environment,
    *,
    within: float | Mapping[str, float] = 0.1,
    order: Literal[1, 2] = 1,
    t: float = 0.0,
    hold: tuple[str, ...] = (),
) -> UncertainModel:
    """Linear model of the output of a plant as a polynomial in its uncertain numbers, over a box of them.

    Parameters
    ----------
    plant : plant(p) of the parameters p (n,), which JAX traces, such as `RigidBody.create` of three moments
    parameters : name -> nominal value, in the order of p
    x, u, environment, t, hold : as of `linearize`
    within : relative deviation of the parameters, one for all or by name
    order : of the polynomials

    Returns
    -------
    UncertainModel : `exact` says whether it is the model of the plant on the whole box, to rounding. If it is not, it
        is an expansion with the `error` found at the corners, and what is proved of it is not proved of the plant.

    Raises
    ------
    ScenarioError
        As `linearize`; no parameters, a nominal value of zero, a deviation that is not positive, an output that
        depends on the parameters itself.

    Notes
    -----
    Entries below 1e-12 of the largest in their row are rounding and left out: they would put every parameter into
    every row, and raise the degrees of what is proved. A `plant.mass()`, (ny, ny), multiplies the rates of the output.

    Examples
    --------
    >>> import numpy as np
    >>> from plants import BodyState, FreeSpace, RigidBody, uncertain_model
    >>> rest = BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(0))
    >>> moments = {"Ix": 2.0, "Iy": 2.5, "Iz": 3.0}
    >>> model = uncertain_model(RigidBody.create, moments, rest, np.zeros(3), FreeSpace())
    >>> E, A, B, C, D = model.at({"Iz": 3.3})
    >>> model.exact, round(E[5, 5], 9), round(B[5, 2], 9)
    (True, 3.3, 1.0)
    """
    names, nominal, half = _box(parameters, within)
    if order not in (1, 2):
        raise ScenarioError(f"order = {order!r}: give 1 or 2")
    powers = np.array([np.bincount(chosen, minlength=len(names)) for chosen in _monomials(len(names), order)])
    linearize(made := _made(plant, nominal), x, u, environment, t=t, hold=hold)  # checks the point
    x, u, moving = checked_point(made, x, u, environment, hold)
    with jax.enable_x64(True):
        found = _expanded(nominal, environment, x, u, np.asarray(t, float), plant, order)
        output, *taylor = (_gathered(part, powers) for part in zip(*jax.tree.map(np.asarray, found), strict=True))
    H = output[0][:, moving]
    if np.abs(output[1:][..., moving] * _sizes(half, powers)[1:]).max() > ROUNDING * np.abs(H).max():
        raise ScenarioError("the output depends on the parameters itself: return one in fixed units from plant.output")
    E, A, B = taylor
    A = A[..., moving] @ np.linalg.pinv(H)
    E, A, B = (_rounded(M, _sizes(half, powers)) for M in (E, A, B))
    model = UncertainModel(names, nominal, nominal - half, nominal + half, powers, E, A, B)
    error = 0.0
    for corner in itertools.product((-1.0, 1.0), repeat=len(names)):
        p = nominal + half * corner
        true = linearize(_made(plant, p), x, u, environment, t=t, hold=hold)
        E, A, B, *_ = model.at(dict(zip(names, p.tolist(), strict=True)))
        error = max(error, *(_apart(np.linalg.solve(E, ours), M) for ours, M in ((A, true.A), (B, true.B))))
    return model._replace(error=error)


@partial(blocks.node, data_fields=["plant", "gains"], meta_fields=["outputs"])
@dataclass(frozen=True, kw_only=True)
class Driven:
    """A plant whose inputs have other gains than the model's, such as thrusters; and the first of its outputs."""

    plant: Any
    gains: Any  # (nu,) what each input is multiplied by
    outputs: int  # how many are looked at

    def derivative(self, x: Any, u: ArrayLike, env: Any) -> Any:
        """That of the plant."""
        return self.plant.derivative(x, jnp.asarray(self.gains) * jnp.asarray(u), env)

    def output(self, x: Any, env: Any) -> Array:
        """(outputs,), in the units of the plant."""
        return self.plant.output(x, env)[: self.outputs]

    def project(self, x: Any) -> Any:
        """That of the plant."""
        return self.plant.project(x)

    def mass(self) -> Array:
        """(outputs, outputs), that of the plant."""
        whole = self.plant.mass() if hasattr(self.plant, "mass") else jnp.eye(self.outputs)
        return whole[: self.outputs, : self.outputs]


def _made(plant: Callable[[Any], Plant], p: np.ndarray) -> Plant:
    """The plant of concrete parameters, in double precision."""
    with jax.enable_x64(True):
        made = plant(p)
        blocks.register(made)
        return jax.tree.map(np.asarray, made)


def _box(parameters: Mapping[str, float], within: Any) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """Names, nominal values (n,), half widths (n,)."""
    names = tuple(parameters)
    if not 0 < len(names) <= MOST:
        raise ScenarioError(f"parameters names {len(names)} numbers: give 1 to {MOST}")
    nominal = np.array([float(real(f"parameters[{name!r}]", parameters[name])) for name in names])
    if not nominal.all():
        raise ScenarioError(f"parameters[{names[int((nominal == 0).argmax())]!r}] = 0: nothing is relative to zero")
    wide = within if isinstance(within, Mapping) else dict.fromkeys(names, within)
    if set(wide) != set(names):
        raise ScenarioError(f"within names {sorted(wide)}, but the parameters are {sorted(names)}")
    half = np.array([float(positive(f"within of {name}", wide[name])) for name in names])
    return names, nominal, half * np.abs(nominal)


def _monomials(n: int, order: int) -> list[tuple[int, ...]]:
    """Which parameters are multiplied, the constant first."""
    return [c for k in range(order + 1) for c in itertools.combinations_with_replacement(range(n), k)]


def _sizes(half: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Largest values of the monomials on the box, (k, 1, 1)."""
    return np.prod(half**powers, axis=1)[:, None, None]


def _gathered(taylor: tuple[np.ndarray, ...], powers: np.ndarray) -> np.ndarray:
    """Coefficients (k, ...) from value and derivatives, (...), (..., n), (..., n, n)."""
    found = []
    for row in powers:
        at = tuple(np.repeat(np.arange(len(row)), row))
        found.append(taylor[len(at)][(..., *at)] / (2 if len(at) == 2 and at[0] == at[1] else 1))
    return np.array(found)


def _rounded(M: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Coefficients (k, rows, columns) without what is rounding of the largest entry of a row on the box."""
    size = np.abs(M) * sizes
    return np.where(size > ROUNDING * size.max(axis=(0, 2), keepdims=True), M, 0.0)


def _apart(ours: np.ndarray, true: np.ndarray) -> float:
    """Largest error of an entry, relative to it or to a hundredth of the largest of its row."""
    floor = np.maximum(np.abs(true), 1e-2 * np.abs(true).max(axis=1, keepdims=True))
    return float(np.divide(np.abs(ours - true), floor, out=np.zeros_like(true), where=floor > 0).max(initial=0.0))


def _taylor(p: Array, environment: Any, x: Any, u: Array, t: Array, plant: Any, order: int) -> Any:
    """(H, E, E F, E G) and their derivatives in p."""

    def parts(p: Array) -> tuple[Array, Array, Array, Array]:
        made = plant(p)
        H, _, F, G = jacobians(made, environment, x, u, t)
        E = made.mass() if hasattr(made, "mass") else jnp.eye(len(H))
        return H, E, E @ F, E @ G

    found = [parts]
    for _ in range(order):
        found.append(jax.jacfwd(found[-1]))
    return [f(p) for f in found]


_expanded = Program(_taylor, ("plant", "order"), once=True)
