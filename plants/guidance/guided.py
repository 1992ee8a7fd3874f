"""Guidance that is known before the flight: a commanded frame, or several after each other, in place of frame O.

What a plant regulates and what a navigator estimates is relative to the frame that the environment names. So in a
guided environment every controller gets the error quaternion and the error of the rate, at any angle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, positive
from plants.errors import ScenarioError
from plants.guidance.frames import Guidance
from plants.guidance.slews import Path, commanded, path_from
from plants.simulation import blocks


@partial(blocks.node, data_fields=["environment", "guidance"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Guided:
    """An environment whose frame O is the commanded one; everything else in it is as it was."""

    environment: Any  # such as `plants.Environment`
    guidance: Guidance

    @property
    def duration(self) -> float:
        """() s, for which there is an environment."""
        return getattr(self.environment, "duration", np.inf)

    def at(self, t: ArrayLike) -> Any:
        """Surroundings at t () s, with q_RN and w_R in place of q_ON and w_ON."""
        env = self.environment.at(t)
        q, w = self.guidance.frame(t, env)
        return env._replace(q_ON=q, w_ON=w)


@partial(blocks.node, data_fields=["starts", "guidances", "paths"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Guidances after each other, with slews in between; build it with `Schedule.create`."""

    starts: Numbers  # (n,) s
    guidances: tuple[Guidance, ...]
    paths: tuple[Path, ...]  # of every guidance but the first, whose command is the frame from the beginning

    @classmethod
    def create(
        cls,
        environment: Any,
        entries: Sequence[tuple[float, Guidance]],
        *,
        max_rate: float,
        max_acceleration: float,
    ) -> "Schedule":
        """A timeline of guidances, such as ``[(0, Nadir()), (600, Pointing.create(...)), (900, Nadir())]``.

        Parameters
        ----------
        environment : that in which it will be flown
        entries : (start () s, guidance), in the order of time, the first at 0
        max_rate, max_acceleration : () rad/s, () rad/s^2 of the slews

        Raises
        ------
        ScenarioError
            No entry, times not in order, limits that are not positive, a guidance that is not defined where its slew
            begins (NaN: two directions that are parallel, a table that has ended).
        """
        limits = positive("max_rate", max_rate), positive("max_acceleration", max_acceleration)
        starts = np.array([start for start, _ in entries], float)
        if not len(starts) or starts[0] != 0 or not (np.diff(starts) > 0).all():
            raise ScenarioError(f"entries start at {starts.tolist()} s: give rising times, the first 0")
        guidances = tuple(guidance for _, guidance in entries)
        blocks.register(guidances)
        paths: list[Path] = []
        with jax.enable_x64(True):
            for k in range(1, len(starts)):
                env, t = environment.at(starts[k]), starts[k]
                before = _frame(t, env, starts[:k], guidances[:k], paths)
                path = path_from(*before, guidances[k].frame(t, env), *limits)
                paths.append(Path(*(np.asarray(part) for part in path)))
                if not all(np.isfinite(part).all() for part in paths[-1]):
                    raise ScenarioError(
                        f"entries[{k}] = {type(guidances[k]).__name__} has no attitude at {t:g} s: "
                        "look at its directions and at how long the environment lasts"
                    )
        return cls(starts=starts, guidances=guidances, paths=tuple(paths))

    def frame(self, t: ArrayLike, env: Any) -> tuple[Array, Array]:
        """q_RN (4,) and w_R (3,) rad/s."""
        return _frame(jnp.asarray(t), env, jnp.asarray(self.starts), self.guidances, self.paths)


def _frame(t: Any, env: Any, starts: Any, guidances: Sequence[Guidance], paths: Sequence[Path]) -> tuple[Array, Array]:
    """The frame of the last guidance that has started, on its way there."""
    frames = [guidance.frame(t, env) for guidance in guidances]
    for k, path in enumerate(paths, 1):
        frames[k] = commanded(path, t - starts[k], frames[k])
    last = jnp.sum(jnp.asarray(starts) <= t) - 1
    return tuple(jnp.stack(parts)[last] for parts in zip(*frames, strict=True))  # pyright: ignore[reportReturnType]
