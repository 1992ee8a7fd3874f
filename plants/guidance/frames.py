"""Commanded frames R: the attitude and the rate that a body is asked to have, as functions of time.

`frame(t, env)` gives q_RN (4,), the attitude of R relative to frame N, and w_R (3,) rad/s, its inertial rate in its own
axes; t () s counts from the epoch of the environment. No rate is typed: it is the derivative of the attitude along the
derivatives of the directions that the attitude is made of.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from scipy.interpolate import CubicSpline

from plants.checks import Numbers, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.guidance.directions import Direction
from plants.simulation import blocks
from plants.surroundings.table import piece

PARALLEL = 1e-3  # () rad, between two axes of a body that are to be told apart


class Guidance(Protocol):
    """A commanded frame."""

    def frame(self, t: ArrayLike, env: Any, /) -> tuple[Array, Array]: ...  # noqa: D102


@partial(blocks.node, data_fields=[], meta_fields=[])
@dataclass(frozen=True)
class Nadir:
    """Frame O of the environment: z to the Earth, y against the orbit normal."""

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_ON (4,) and w_ON (3,) rad/s."""
        del t
        return env.q_ON, env.w_ON


@partial(blocks.node, data_fields=["q"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Inertial:
    """An attitude at rest among the stars; build it with `Inertial.create`."""

    q: Numbers  # (4,) q_RN

    @classmethod
    def create(cls, q: ArrayLike) -> "Inertial":
        """Attitude q_RN (4,), scalar first; ScenarioError if it is not of length one."""
        return cls(q=unit("q", q, (4,)))

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_RN (4,) and no rate."""
        del t, env
        return jnp.asarray(self.q), jnp.zeros(3)


@partial(blocks.node, data_fields=["axis", "to", "second_axis", "second_to"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Pointing:
    """One axis of the body along a direction, a second one as near to another as that leaves; see `Pointing.create`.

    Where the two directions are parallel, the second is not defined, and the attitude is NaN.
    """

    axis: Numbers  # (3,) unit vector, body
    to: Direction
    second_axis: Numbers  # (3,) unit vector, body
    second_to: Direction

    @classmethod
    def create(cls, axis: ArrayLike, to: Direction, *, second_axis: ArrayLike, second_to: Direction) -> "Pointing":
        """A payload, an antenna or a panel that looks somewhere.

        Parameters
        ----------
        axis : (3,) unit vector in body axes, that points exactly
        to : where to, such as `ToTarget`, `ToSun`, `ToEarth`
        second_axis : (3,) unit vector in body axes, not parallel to `axis`
        second_to : where the second axis points as well as it can

        Raises
        ------
        ScenarioError
            Axes that are not of length one, or parallel.
        """
        one, two = unit("axis", axis), unit("second_axis", second_axis)
        if np.linalg.norm(np.cross(one, two)) < PARALLEL:
            raise ScenarioError(f"second_axis = {two.tolist()} is parallel to axis: give one across it")
        return cls(axis=one, to=to, second_axis=two, second_to=second_to)

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_RN (4,) and w_R (3,) rad/s."""
        here = (self.to.at(t, env), self.second_to.at(t, env))
        vectors, changes = zip(*here, strict=True)
        return moving(lambda a, b: attitude.from_dcm(_triad(self.axis, self.second_axis).T @ _triad(a, b)), *zip(
            vectors, changes, strict=True
        ))  # fmt: skip


@partial(blocks.node, data_fields=["splines"], meta_fields=["step", "duration"])
@dataclass(frozen=True, kw_only=True)
class Profile:
    """An attitude from a table; build it with `Profile.create`."""

    splines: Numbers  # (n, 4, 4) cubics of the quaternion in every interval, lowest power first
    step: float  # () s
    duration: float  # () s

    @classmethod
    def create(cls, attitudes: ArrayLike, *, step: float) -> "Profile":
        """A tracking profile through equally spaced attitudes, by a cubic spline of the quaternion.

        Parameters
        ----------
        attitudes : (n, 4) q_RN, scalar first, of either sign, n >= 4
        step : () s between two of them; between neighbours at most a quarter of a turn. The interpolation is good to
            about (angle between neighbours)^4 / 400 rad

        Raises
        ------
        ScenarioError
            Fewer than four attitudes, quaternions not of length one, neighbours more than 90 deg apart.
        """
        q = real("attitudes", attitudes, (None, 4))
        if len(q) < 4:
            raise ScenarioError(f"attitudes: got {len(q)}; give four at least")
        unit("attitudes", q, q.shape)
        near = np.sum(q[1:] * q[:-1], axis=1)
        if (np.abs(near) < np.cos(np.pi / 4)).any():
            k = int(np.argmin(np.abs(near)))
            raise ScenarioError(f"attitudes {k} and {k + 1} are more than 90 deg apart: give them at a smaller step")
        signs = np.concatenate([[1.0], np.cumprod(np.sign(near))])
        powers = CubicSpline(np.arange(len(q)), signs[:, None] * q).c[::-1]
        return cls(
            splines=np.moveaxis(powers, (0, 1), (1, 0)),
            step=float(real("step", step, low=1e-9)),
            duration=(len(q) - 1) * float(step),
        )

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_RN (4,) and w_R (3,) rad/s; NaN after the end of the table."""
        del env
        s, c = piece(self.splines, self.step, self.duration, t)
        q, change = c[0] + s * (c[1] + s * (c[2] + s * c[3])), (c[1] + s * (2 * c[2] + 3 * s * c[3])) / self.step
        return moving(attitude.normalise, (q, change))


@partial(blocks.node, data_fields=["turn", "base"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Offset:
    """An attitude that is turned for good against another guidance; build it with `Offset.create`."""

    turn: Numbers  # (4,) attitude relative to the frame of `base`
    base: Guidance

    @classmethod
    def create(cls, turn: ArrayLike, base: Guidance) -> "Offset":
        """Attitude `turn` (4,) relative to the frame of `base`; ScenarioError if it is not of length one."""
        return cls(turn=unit("turn", turn, (4,)), base=base)

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_RN (4,) and w_R (3,) rad/s."""
        q, w = self.base.frame(t, env)
        return attitude.compose(self.turn, q), attitude.rotate(self.turn, w)


def moving(f: Any, *pairs: tuple[Array, Array]) -> tuple[Array, Array]:
    """Attitude f(a, b, ...) and its inertial rate in its own axes, from arguments and their derivatives in time.

    From dq/dt = 1/2 (0, w) q (in the order of `attitude.compose`) it is w = 2 dq/dt q*.
    """
    values, changes = zip(*pairs, strict=True)
    q, change = jax.jvp(f, values, changes)
    return q, 2 * attitude.compose(change, attitude.conjugate(q))[1:]


def unit(name: str, value: ArrayLike, shape: tuple[int | None, ...] = (3,)) -> Any:
    """Vectors or quaternions of length one to 1e-6, scaled to it exactly; ScenarioError otherwise."""
    v = real(name, value, shape)
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    if (np.abs(length - 1) > 1e-6).any():
        raise ScenarioError(
            f"{name} = {v.tolist()} has length {float(length.flat[np.argmax(np.abs(length - 1))]):.6g}: "
            "divide it by its length"
        )
    return v / length


def _triad(first: ArrayLike, second: ArrayLike) -> Array:
    """Rows: the first direction, the one across both, the third of a right-handed frame; (3, 3)."""
    a = attitude.normalise(first)
    across = attitude.normalise(attitude.cross(a, second))
    return jnp.stack([a, across, attitude.cross(a, across)])
