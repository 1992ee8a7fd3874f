"""Modes of a mission in one flight.

`sequence` gives two blocks of a loop that belong together. Its navigator runs the navigators of all modes, so that a
filter is warm when its mode begins, decides which mode it is, and tells the controller what is known on board
(`Known`): the estimate of the plant's output first, then the error against the commanded frame of the mode. Its
controller runs the law of the mode.

No bump when modes change: a mode with limits of a slew begins at the attitude and the rate that are estimated, and what
the command jumps by is added to the new law's command and fades away.
"""

from collections.abc import Callable
from collections.abc import Sequence as Several
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.guidance.conditions import Condition
from plants.guidance.frames import Guidance
from plants.guidance.modes import NY, Known, Law, Mode
from plants.guidance.slews import Path, commanded, path_from
from plants.simulation import blocks


@partial(blocks.node, data_fields=["guidance", "until", "limits"], meta_fields=["then", "navigator"])
@dataclass(frozen=True, kw_only=True)
class Phase:
    """What `SequenceNavigator` has to know of a mode."""

    guidance: Guidance
    until: Condition | None
    limits: tuple[Any, Any] | None  # () rad/s, () rad/s^2
    then: int  # index of the mode that follows
    navigator: int  # index


class Progress(NamedTuple):
    """State of `SequenceNavigator`."""

    mode: Array  # () index, -1 before the first measurement
    t: Array  # () s since the first measurement
    entered: Array  # () s, when the mode began
    ready: Array  # () whether what ends it is met
    held: Array  # () s, for how long it has been
    path: Path  # of the slew with which it began
    q: Array  # (4,) q_RN, commanded attitude
    w: Array  # (3,) rad/s, commanded inertial rate, in the axes of R
    navigators: tuple[Any, ...]


@partial(blocks.node, data_fields=["modes", "navigators", "wheel_momentum"], meta_fields=["field", "wheels", "ny"])
@dataclass(frozen=True, kw_only=True)
class SequenceNavigator:
    """What is known on board, and which mode it is; see `sequence`."""

    modes: tuple[Phase, ...]
    navigators: tuple[Any, ...]
    field: Callable[[Any], Any]  # (3,) T from a measurement
    wheels: Callable[[Any], Any]  # (n,) rad/s from a measurement
    wheel_momentum: Numbers  # (3, n) kg m^2
    ny: int = NY

    def init(self) -> Progress:
        """Before the first mode."""
        zero = jnp.zeros(())
        path = Path(jnp.zeros(3), jnp.zeros(3), jnp.ones(()), jnp.ones(()))
        q = jnp.array([1.0, 0.0, 0.0, 0.0])
        navigators = tuple(navigator.init() for navigator in self.navigators)
        no = jnp.zeros((), bool)
        return Progress(jnp.full((), -1), zero, zero, no, zero, path, q, jnp.zeros(3), navigators)

    def update(self, s: Progress, y: Any, u: Any, env: Any, h: Any) -> tuple[Progress, Array]:
        """New state, and `Known` as one vector (19,)."""
        told = [n.update(state, y, u, env, h) for n, state in zip(self.navigators, s.navigators, strict=True)]
        s = s._replace(t=s.t + h, navigators=tuple(state for state, _ in told))
        outputs = jnp.stack([estimate[:6] for _, estimate in told])
        frames = [m.guidance.frame(s.t, env) for m in self.modes]
        s = self._switched(s, outputs, frames, env, h)
        output = outputs[self._trusted()[s.mode]]
        error = _relative(*_inertial(output, env), s.q, s.w)
        momentum = jnp.asarray(self.wheel_momentum) @ jnp.asarray(self.wheels(y))
        known = [output, error, jnp.asarray(self.field(y)), momentum, s.mode[None].astype(float)]
        return s, jnp.concatenate(known)

    def _switched(self, s: Progress, outputs: Array, frames: list[Any], env: Any, h: Any) -> Progress:
        """The mode, and its commanded frame now."""
        now = jnp.maximum(s.mode, 0)
        q, w = _inertial(outputs[self._trusted()[now]], env)
        ready = self._met(s, _relative(q, w, *self._commanded(s, now, frames)), w)[now]
        held = jnp.where(ready & s.ready, s.held + h, 0.0)
        holds = jnp.stack([jnp.asarray(0.0 if m.until is None else m.until.hold) for m in self.modes])
        leave = ready & (held >= holds[now] * (1 - 1e-12))
        new = jnp.where(s.mode < 0, 0, jnp.where(leave, self._next()[now], now))
        entered = (s.mode < 0) | leave
        q, w = _inertial(outputs[self._trusted()[new]], env)
        target = tuple(jnp.stack(parts)[new] for parts in zip(*frames, strict=True))
        begun = path_from(q, w, target, *self._limits(new))  # pyright: ignore[reportArgumentType]
        s = s._replace(
            mode=new,
            entered=jnp.where(entered, s.t, s.entered),
            ready=ready & ~entered,
            held=jnp.where(entered, 0.0, held),
            path=jax.tree.map(lambda a, b: jnp.where(entered, a, b), begun, s.path),
        )
        q, w = self._commanded(s, new, frames)
        return s._replace(q=q, w=w)

    def _commanded(self, s: Progress, index: Array, frames: list[Any]) -> tuple[Array, Array]:
        """Commanded attitude and rate of a mode, on its slew if it has one."""
        target = tuple(jnp.stack(parts)[index] for parts in zip(*frames, strict=True))
        on_the_way = commanded(s.path, s.t - s.entered, target)  # pyright: ignore[reportArgumentType]
        slews = jnp.array([m.limits is not None for m in self.modes])[index]
        return tuple(jnp.where(slews, a, b) for a, b in zip(on_the_way, target, strict=True))  # pyright: ignore[reportReturnType]

    def _met(self, s: Progress, error: Array, rate: Array) -> Array:
        """Which modes have done their work, (modes,)."""
        elapsed = s.t - s.entered
        never = jnp.zeros((), bool)
        return jnp.stack([never if m.until is None else m.until.met(error, rate, elapsed) for m in self.modes])

    def _limits(self, index: Array) -> tuple[Array, Array]:
        """Rate and acceleration of the slew of a mode; one where there is none."""
        limits = [jnp.ones(2) if m.limits is None else jnp.stack([*map(jnp.asarray, m.limits)]) for m in self.modes]
        chosen = jnp.stack(limits)[index]
        return chosen[0], chosen[1]

    def _trusted(self) -> Array:
        return jnp.array([m.navigator for m in self.modes])

    def _next(self) -> Array:
        return jnp.array([m.then for m in self.modes])


class Acting(NamedTuple):
    """State of `SequenceController`."""

    mode: Any  # () index, -1 before the first step
    laws: tuple[Any, ...]
    command: Any  # (nu,) the last one
    bump: Any  # (nu,) what is still added to the command of the law


@partial(blocks.node, data_fields=["laws", "dt", "blend"], meta_fields=["nu"])
@dataclass(frozen=True, kw_only=True)
class SequenceController:
    """The law of the mode that `SequenceNavigator` tells; see `sequence`."""

    laws: tuple[Law, ...]
    dt: Any  # () s
    blend: Any  # () s, time constant with which a jump of the command fades
    nu: int  # 6, or 3: torques only

    def init(self) -> Acting:
        """No mode yet."""
        still = np.zeros(self.nu)
        return Acting(np.full((), -1), tuple(law.init() for law in self.laws), still, still)

    def step(self, s: Acting, y: Any, r: Any) -> tuple[Acting, Any]:
        """New state and command: torque (3,) N m and, with magnetorquers, dipole moment (3,) A m^2."""
        del r
        known = Known.of(y)
        stepped = isinstance(y, np.ndarray)  # from Python: a law may be one that cannot be compiled
        act = self._python if stepped else self._compiled
        index = int(known.mode) if stepped else known.mode.astype(int)
        laws, u = act(s, index, known)
        u = u[: self.nu]
        numbers: Any = np if stepped else jnp
        fade = numbers.exp(-self.dt / self.blend)
        jump = numbers.where(s.mode < 0, 0.0 * u, s.command - u)
        bump = numbers.where(s.mode == index, s.bump * fade, jump)
        return Acting(index + 0 * s.mode, laws, u + bump, bump), u + bump

    def _python(self, s: Acting, index: Any, known: Known) -> tuple[tuple[Any, ...], Any]:
        memories = [law.init() for law in self.laws]
        memory = s.laws[index] if s.mode == index else memories[index]
        memories[index], u = self.laws[index].step(memory, known, self.dt)
        return tuple(memories), np.asarray(u)

    def _compiled(self, s: Acting, index: Any, known: Known) -> tuple[tuple[Any, ...], Any]:
        memories, commands = [], []
        for i, law in enumerate(self.laws):
            fresh = law.init()
            memory = jax.tree.map(lambda a, b: jnp.where(s.mode == index, a, b), s.laws[i], fresh)
            new, u = law.step(memory, known, self.dt)
            memories.append(jax.tree.map(lambda a, b, i=i: jnp.where(index == i, a, b), new, fresh))
            commands.append(jnp.asarray(u))
        return tuple(memories), jnp.stack(commands)[index]


class Sequence(NamedTuple):
    """Two blocks of a loop that belong together, and the names of the modes by their index."""

    navigator: SequenceNavigator
    controller: SequenceController
    names: tuple[str, ...]


def sequence(
    modes: Several[Mode],
    *,
    dt: float,
    navigators: Several[Any],
    wheel_axes: ArrayLike,
    wheel_inertia: ArrayLike,
    field: Callable[[Any], Any] | None = None,
    wheels: Callable[[Any], Any] | None = None,
    magnetorquers: bool = True,
    blend: float | None = None,
) -> Sequence:
    """A mission in modes, as the navigator and the controller of one loop.

    Parameters
    ----------
    modes : in the order in which they follow each other; after the last comes the first, if the last ever ends
    dt : () s, control period
    navigators : those that the modes refer to by index; all of them are always running
    wheel_axes, wheel_inertia : (3, n) unit columns, (n,) kg m^2, for the momentum in the wheels
    field, wheels : functions of a measurement: magnetic field (3,) T in body axes, wheel speeds (n,) rad/s; by default
        its fields of these names. Module-level functions: a new lambda in every call compiles anew
    magnetorquers : whether the commands have a dipole moment after the torque
    blend : () s, time constant with which a jump of the command between two modes fades; ten control periods by default

    Raises
    ------
    ScenarioError
        No mode, two of one name, a `then` or a navigator that there is not, a law of another period, numbers that
        cannot be.
    """
    names = tuple(m.name for m in modes)
    if not names or len(set(names)) < len(names):
        raise ScenarioError(f"modes = {list(names)}: give at least one, each with a name of its own")
    for m in modes:
        if m.then is not None and m.then not in names:
            raise ScenarioError(f"then = {m.then!r} of mode {m.name!r} is no mode: take one of {list(names)}")
        if not 0 <= m.navigator < len(navigators):
            raise ScenarioError(f"navigator = {m.navigator} of mode {m.name!r}: there are {len(navigators)}, from 0")
    G = real("wheel_axes", wheel_axes, (3, None))
    Js = positive("wheel_inertia", wheel_inertia, (G.shape[1],))
    period = float(positive("dt", dt))
    for m in modes:
        own = getattr(m.law, "dt", period)
        if not np.isclose(float(own), period, rtol=1e-9, atol=0):
            raise ScenarioError(
                f"law of mode {m.name!r} has dt = {own}, the sequence {period}: design it for that period"
            )
    phases = tuple(
        Phase(
            guidance=m.guidance,
            until=m.until,
            limits=m.limits,
            then=(i + 1) % len(names) if m.then is None else names.index(m.then),
            navigator=m.navigator,
        )
        for i, m in enumerate(modes)
    )
    return Sequence(
        SequenceNavigator(
            modes=phases,
            navigators=tuple(navigators),
            field=_field if field is None else field,
            wheels=_wheels if wheels is None else wheels,
            wheel_momentum=G * Js,
        ),
        SequenceController(
            laws=tuple(m.law for m in modes),
            dt=period,
            blend=10 * period if blend is None else float(positive("blend", blend)),
            nu=6 if magnetorquers else 3,
        ),
        names,
    )


class Commanded(NamedTuple):
    """What `commanded_record` records: the mode, and how far the body truly is from its commanded frame."""

    mode: Any  # () index
    q: Any  # (4,) commanded attitude q_RN
    w: Any  # (3,) rad/s, commanded inertial rate
    error: Any  # (6,) [vector part of the error quaternion; rad/s]


def commanded_record(x: Any, env: Any, sensors: Any, navigator: Progress) -> Commanded:
    """`record` of a flight with a sequence: see `simulate`."""
    del env, sensors
    return Commanded(navigator.mode, navigator.q, navigator.w, _relative(x.q, x.w, navigator.q, navigator.w))


def _inertial(output: Array, env: Any) -> tuple[Array, Array]:
    """Attitude q_BN (4,) and inertial rate (3,) rad/s from an output (6,) relative to frame O."""
    q = attitude.from_vector_part(output[:3])
    return attitude.compose(q, env.q_ON), output[3:] + attitude.rotate(q, env.w_ON)


def _relative(q: Any, w: Any, frame: Any, rate: Any) -> Array:
    """Error (6,) of attitude q_BN and inertial rate w against a frame and its rate."""
    off = attitude.positive(attitude.compose(q, attitude.conjugate(frame)))
    return jnp.concatenate([off[1:], w - attitude.rotate(off, rate)])


def _field(y: Any) -> Any:
    return y.field


def _wheels(y: Any) -> Any:
    return y.wheels
