"""Study: Amazonia-1, a satellite with three reaction wheels, brought to rest at an inertial attitude.

A. G. Romero, L. C. G. de Souza, "Investigating satellite attitude and orbit control system performance of the SDRE
technique regarding parametric uncertainty", CILAMCE 2022 [1]: table 1, section 5. The same authors, "An approach to
evaluate the region of attraction of satellites controlled by SDRE", WSEAS Transactions on Systems 21, 2022,
pp. 75-85, doi 10.37394/23202.2022.21.9 [2]: section 5.

Readings. The desired attitude is the inertial frame itself; the paper's Sun direction alone would leave the turn
about it free. Wheels start at rest. Table 1's inertia has the wheels in it (eq. 22 takes them out). The inertia that
is dispersed is the satellite's; controllers keep the nominal one. The test of convergence of [2], its eq. 15, is
missing from the text we have; `SLOW` over the last `TAIL` of a run is our reading of it.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from plants.checks import positive, real, whole
from plants.dynamics.rigidbody import BodyState, RigidBody
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.actuators import ReactionWheels
from plants.outcome.indices import settling_time
from plants.simulation import blocks, uncertain
from plants.simulation.campaign import draw
from plants.simulation.linearize import LinearModel, linearize
from plants.simulation.loop import Controller, Loop, Run, Scenario
from plants.simulation.uncertain import UncertainModel
from plants.surroundings.disturbances import ConstantTorque
from plants.surroundings.environment import FreeSpace, OrbitEnv

DEG = np.pi / 180
RPM = 2 * np.pi / 60

INERTIA = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]])  # (3, 3) kg m^2, [1] table 1
MOMENTS = ("Ix", "Iy", "Iz")  # names of its diagonal as uncertain parameters
WHEEL_AXES = np.eye(3)  # (3, 3) [1] section 3.2: along the axes of the body
WHEEL_INERTIA = np.full(3, 0.01911)  # (3,) kg m^2, [1] table 1
WHEEL_TORQUE = 0.075  # () N m, [1] table 1
WHEEL_SPEED = 6000 * RPM  # () rad/s, [1] table 1
MOMENTUM = 0.01911 * WHEEL_SPEED  # () N m s, what one wheel can hold: 12.007

PERIOD = 0.05  # () s, [1] section 5: fixed step of simulation and control
DURATION = 1800.0  # () s, [1] section 5
MONTE_CARLO_RATE = 0.01  # () rad/s per axis, [1] section 5
INERTIA_SPREAD = 0.2  # () of each diagonal element, [1] section 5
REGION_RATE = 0.0385  # () rad/s per axis, [2] section 5
REGION_RATE_NORM = 0.0556  # () rad/s, [2]: expected limit of |w0| in any region of attraction

SETTLED_ANGLE, SETTLED_RATE = 1 * DEG, 1e-3  # () rad, () rad/s, ours: a run has settled below both
POINTED = 0.1 * DEG  # () rad, ours: attitude of the honest test of convergence
SLOW = 1e-4  # () rad/s, ours: rate of both tests of convergence
TAIL = 0.05  # () of the run, its end: where both tests look


@partial(blocks.node, data_fields=["body"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Satellite:
    """A rigid body seen with ideal sensors: attitude, rate and the momentum of its wheels."""

    body: RigidBody

    def derivative(self, x: BodyState, u: ArrayLike, env: OrbitEnv) -> BodyState:
        """Time derivative of the state, see `RigidBody`."""
        return self.body.derivative(x, u, env)

    def output(self, x: BodyState, env: OrbitEnv) -> Array:
        """(10,): attitude q (4,) relative to the desired frame, rate w (3,) rad/s, wheel momentum (3,) N m s.

        Rate and momentum are in body axes; the momentum of a wheel is absolute, Js (a'w + Om), as in [1], eq. 21.
        """
        G, w = jnp.asarray(self.body.wheel_axes), jnp.asarray(x.w)
        momentum = G @ (self.body.wheel_inertia * (G.T @ w + jnp.asarray(x.wheels)))
        return jnp.concatenate([attitude.compose(x.q, attitude.conjugate(env.q_ON)), w, momentum])

    def project(self, x: BodyState) -> BodyState:
        """The state with a unit quaternion."""
        return self.body.project(x)


class Dispersion(NamedTuple):
    """One draw, or many with a leading axis."""

    moments: np.ndarray  # (..., 3) kg m^2, diagonal of the inertia
    angles: np.ndarray  # (..., 3) rad, roll, pitch, yaw (3-2-1)
    rates: np.ndarray  # (..., 3) rad/s


class Start(NamedTuple):
    """From where a run starts, or many with a leading axis: a `Dispersion` as the simulator takes it."""

    moments: np.ndarray  # (..., 3) kg m^2, diagonal of the inertia
    q: np.ndarray  # (..., 4) attitude relative to the desired frame
    rates: np.ndarray  # (..., 3) rad/s
    torque: np.ndarray  # (..., 3) N m, constant, on the body; zero in the papers


class Outcome(NamedTuple):
    """What a campaign keeps of a run; infinite where the run failed."""

    settling_time: Any  # () s, from which angle and rate stay below `SETTLED_ANGLE`, `SETTLED_RATE`
    angle: Any  # () rad, largest over the last `TAIL` of the run
    rate: Any  # () rad/s, likewise
    path: Any  # () rad, integral of |w|: how far the body has turned
    asked: Any  # () N m, mean |torque| that the controller asked for
    given: Any  # () N m, mean |torque| that the wheels gave
    wheel_speed: Any  # () rad/s, largest of any wheel

    @property
    def settled(self) -> Any:
        """Below 1 deg and 1e-3 rad/s from some time to the end."""
        return np.isfinite(self.settling_time)

    @property
    def slow(self) -> Any:
        """The rate-only test of convergence."""
        return self.rate <= SLOW

    @property
    def converged(self) -> Any:
        """The honest test: slow, and at the desired attitude."""
        return self.slow & (self.angle <= POINTED)


def satellite(moments: ArrayLike | None = None, *, torque: ArrayLike | None = None) -> Satellite:
    """The satellite.

    Parameters
    ----------
    moments : (3,) kg m^2, diagonal of the inertia; table 1 by default, with its products in any case
    torque : (3,) N m, a constant disturbance in body axes; none by default

    Raises
    ------
    ScenarioError
        Wrong shapes, NaN, moments that leave the inertia indefinite.
    """
    inertia = INERTIA.copy()
    if moments is not None:
        np.fill_diagonal(inertia, real("moments", moments, (3,)))
    push = ConstantTorque.create(np.zeros(3) if torque is None else real("torque", torque, (3,)))
    body = RigidBody.create(
        inertia, wheel_axes=WHEEL_AXES, wheel_inertia=WHEEL_INERTIA, disturbances=(push,), physical=False
    )
    return Satellite(body=body)


def wheeled_model(moments: ArrayLike) -> LinearModel:
    """Linear model of `satellite` at rest at the target, wheels at rest: the input is the motors' torque (3,) N m.

    Its output is [vector part of the quaternion; rad/s].
    """
    body = _body(real("moments", moments, (3,)))
    return linearize(body, _AT_REST, np.zeros(3), FreeSpace(), hold=("wheels",))


def uncertain_model(within: float = INERTIA_SPREAD) -> UncertainModel:
    """`wheeled_model` over the diagonal of the inertia, the parameters `MOMENTS`, within that part of each; exact."""
    moments: dict[str, float] = dict(zip(MOMENTS, np.diag(INERTIA).tolist(), strict=True))
    return uncertain.uncertain_model(
        _body, moments, _AT_REST, np.zeros(3), FreeSpace(), within=within, hold=("wheels",)
    )


def _body(moments: Any) -> RigidBody:
    """The satellite without a disturbance, also of traced moments."""
    inertia = np.eye(3) * moments + (INERTIA - np.diag(np.diag(INERTIA)))
    return RigidBody.create(inertia, wheel_axes=WHEEL_AXES, wheel_inertia=WHEEL_INERTIA, physical=False)


_AT_REST = BodyState(q=np.array([1.0, 0, 0, 0]), w=np.zeros(3), wheels=np.zeros(3))


def wheels() -> ReactionWheels:
    """The three wheels with their limits."""
    return ReactionWheels.create(WHEEL_AXES, torque_limit=WHEEL_TORQUE, speed_limit=WHEEL_SPEED)


def manoeuvre(
    start: Start,
    controller: Controller,
    *,
    duration: float = DURATION,
    period: float = PERIOD,
    keep_every: int = 1,
) -> tuple[Loop, Scenario]:
    """Bring the satellite from `start` to rest at the desired attitude, wheels at rest at first.

    Parameters
    ----------
    start : one, not many
    controller : y is `Satellite.output`, its command the torque on the body (3,) N m
    duration : () s, a whole number of control periods
    period : () s, of control and integration, the controller's `dt`; a wheel passes its speed limit by what the motor
        adds in one of them, 0.03 % of its momentum at the paper's period
    keep_every : as in `Scenario`

    Raises
    ------
    ScenarioError
        Unusable numbers; the message names them.
    """
    periods = whole("duration", duration, positive("period", period), "control periods")
    q, w = real("q", start.q, (4,)), real("rates", start.rates, (3,))
    if not np.isclose(np.linalg.norm(q), 1, rtol=0, atol=1e-9):
        raise ScenarioError(f"q = {q.tolist()} has length {np.linalg.norm(q)}: give a unit quaternion")
    loop = Loop(plant=satellite(start.moments, torque=start.torque), controller=controller, actuator=wheels())
    return loop, Scenario(
        initial=BodyState(q=q, w=w, wheels=np.zeros(3)),
        dt=period,
        periods=periods,
        environment=FreeSpace(),
        keep_every=keep_every,
    )


def applied(loop: Loop, scenario: Scenario) -> Start:
    """The dispersion read back from what flies."""
    plant: Any = loop.plant
    torque = plant.body.disturbances[0].vector
    return Start(np.diag(plant.body.inertia), scenario.initial.q, scenario.initial.w, torque)


def disperse(seed: int, index: int) -> Dispersion:
    """Run `index` of the Monte Carlo of [1], section 5; a stream of its own for every run."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Dispersion(
        moments=np.diag(INERTIA) * rng.uniform(1 - INERTIA_SPREAD, 1 + INERTIA_SPREAD, 3),
        angles=rng.uniform(-180, 180, 3) * DEG,
        rates=rng.uniform(-MONTE_CARLO_RATE, MONTE_CARLO_RATE, 3),
    )


def disperse_region(seed: int, index: int) -> Dispersion:
    """Initial condition `index` of the region of attraction of [2], section 5, with the nominal inertia."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Dispersion(
        moments=np.diag(INERTIA),
        angles=rng.uniform(-1, 1, 3) * np.array([180, 90, 180]) * DEG,
        rates=rng.uniform(-REGION_RATE, REGION_RATE, 3),
    )


def starts(drawn: Dispersion) -> Start:
    """Dispersions with their Euler angles as quaternions."""
    with jax.enable_x64(True):
        q = np.asarray(attitude.from_euler(drawn.angles))
    return Start(drawn.moments, q, drawn.rates, np.zeros_like(drawn.rates))


def monte_carlo(runs: int = 100, seed: int = 0) -> Start:
    """Where the runs of the Monte Carlo of [1] start, leaves (runs, ...). Zero runs raise `ScenarioError`."""
    return starts(draw(disperse, runs, seed))


def region(runs: int = 400, seed: int = 0) -> Dispersion:
    """Initial conditions of the region of attraction of [2], leaves (runs, ...). Zero runs raise `ScenarioError`."""
    return draw(disperse_region, runs, seed)


def momentum_load(start: Start) -> np.ndarray:
    """Largest share of a wheel's momentum that rest at the desired attitude would take, (...).

    No torque acts from outside, so the momentum A' J w0 (inertial axes) is all in the wheels once the body is at
    rest, and at the desired attitude their axes are the inertial ones: above 1 no controller whatever gets there,
    as |(A' J w0)_k| <= Js w_max must hold for every axis k.
    """
    inertia = np.broadcast_to(INERTIA, (*np.shape(start.moments)[:-1], 3, 3)).copy()
    inertia[..., range(3), range(3)] = start.moments
    with jax.enable_x64(True):
        A = np.asarray(attitude.dcm(start.q))
    momentum = np.einsum("...ji,...jk,...k->...i", A, inertia, start.rates)
    return np.abs(momentum).max(axis=-1) / MOMENTUM


def outcome(run: Run) -> Outcome:
    """What became of a run of this study, on the grid of its rows."""
    if not run.ok:
        return Outcome(*(np.inf,) * len(Outcome._fields))
    angle, rate = angles(run), np.linalg.norm(run.outputs[:, 4:7], axis=1)
    late = run.time >= min((1 - TAIL) * run.duration, run.time[-1])
    return Outcome(
        settling_time=settling_time(run.time, np.maximum(angle / SETTLED_ANGLE, rate / SETTLED_RATE), 1.0),
        angle=angle[late].max(),
        rate=rate[late].max(),
        path=rate.mean() * run.duration,
        asked=np.linalg.norm(run.commands, axis=1).mean(),
        given=np.linalg.norm(run.inputs @ WHEEL_AXES.T, axis=1).mean(),
        wheel_speed=np.abs(run.states.wheels).max(),
    )


def angles(run: Run) -> np.ndarray:
    """Angle between true and desired attitude over time, (N,) rad in [0, pi]."""
    q = run.outputs[:, :4]
    return 2 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), np.abs(q[:, 0]))
