"""Multiplicative extended Kalman filter for attitude and gyro bias, over any set of instruments.

The gyro replaces the dynamics: the attitude is turned by the angle that it counted, less the bias, exactly. All other
instruments correct, each through its own `innovation` (`plants.hardware.instruments`): star trackers, Sun sensors,
magnetometers, horizon sensors, or a user's own. The error state is [small rotation about body axes (rad); gyro bias
(rad/s); own parameters of instruments to be calibrated; rotations at exposures whose fix is under way], true attitude =
compose(from_vector(error), estimate). References: Lefferts, Markley and Shuster (1982), Kalman filtering for spacecraft
attitude estimation; Markley and Crassidis (2014), section 6.2; Farrenkopf (1978) for the noise of the gyro; Roumeliotis
and Burdick (2002), Stochastic cloning, for fixes that come late: a fix corrects the attitude that was exposed, whose
error the filter carries along with its correlation until the fix has come.

Without a first guess the filter waits for a star tracker's fix or two directions that are not parallel (Wahba's
problem). Until then, and again after a gyro has saturated, the estimate of the attitude error is zero.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from numpy.typing import ArrayLike as Given

from plants.checks import Numbers, positive, real
from plants.errors import ScenarioError
from plants.estimation.updates import tested_updates
from plants.estimation.wahba import direction, wahba_pair
from plants.geometry import attitude
from plants.hardware.instruments import Pair, SensorSuite, unit
from plants.hardware.ratesensors import FLICKER, GyroState, IntegratingGyro, Turn
from plants.simulation import blocks

LOST = np.pi  # () rad per axis, 1 sigma of an attitude that is not known
SURE = 0.5  # () rad, 1 sigma about the worst axis above which readings fix no attitude


class MekfState(NamedTuple):
    """State of `Mekf`, with d exposures under way and k instruments that are calibrated."""

    q: Array  # (4,) attitude of the body relative to frame N
    bias: Array  # (3,) rad/s, of the gyro
    own: Array  # (k, 3) parameters of the instruments
    past: Array  # (d, 4) attitudes at the exposures, newest first for each tracker
    ages: Array  # (d,) s since then
    P: Array  # (n, n) covariance of the error state, n = 6 + 3 k + 3 d
    known: Array  # () 1 once there is an attitude
    nis: Array  # () normalised innovation squared of this sample, chi-square with `rows` degrees of freedom
    rows: Array  # () scalars that have corrected in this sample


@partial(
    blocks.node,
    data_fields=["instruments", "q", "bias", "deviation", "own_deviation", "known"],
    meta_fields=["calibrated"],
)
@dataclass(frozen=True, kw_only=True)
class Mekf:
    """The filter; build it with `mekf`, which checks."""

    instruments: tuple[Any, ...]  # what the filter believes of them, in the order of the readings
    q: Numbers  # (4,) first guess of the attitude relative to frame N
    bias: Numbers  # (3,) rad/s, first guess
    deviation: Numbers  # (6,) rad and rad/s, 1 sigma of the first guess
    own_deviation: Numbers  # (k,) 1 sigma of the instruments' parameters, whose guess is zero
    known: Numbers  # () 1 if the guess of the attitude is one, 0 if it is to be found
    calibrated: tuple[int, ...]  # places of the instruments whose parameters are estimated

    @property
    def gyro(self) -> int:
        """Place of the gyro among the instruments."""
        return next(i for i, known in enumerate(self.instruments) if isinstance(known, IntegratingGyro))

    @property
    def exposures(self) -> dict[int, slice]:
        """Places of the exposures of each instrument whose fixes come late."""
        ends = np.cumsum([0] + [getattr(known, "depth", 0) for known in self.instruments])
        return {i: slice(a, b) for i, (a, b) in enumerate(pairwise(ends)) if b > a}

    def init(self) -> MekfState:
        """The first guess."""
        late = sum(getattr(known, "depth", 0) for known in self.instruments)
        spread = jnp.concatenate(
            [jnp.asarray(self.deviation), jnp.repeat(jnp.asarray(self.own_deviation), 3), jnp.zeros(3 * late)]
        )
        q = jnp.asarray(self.q)
        return MekfState(
            q=q,
            bias=jnp.asarray(self.bias),
            own=jnp.zeros((len(self.calibrated), 3)),
            past=jnp.tile(q, (late, 1)),
            ages=jnp.zeros(late),
            P=jnp.diag(spread**2),
            known=jnp.asarray(self.known),
            nis=jnp.zeros(()),
            rows=jnp.zeros(()),
        )

    def update(self, s: MekfState, y: tuple[Any, ...], u: Any, env: Any, h: Any) -> tuple[MekfState, Array]:
        """Turn by what the gyro has counted in h s, correct by all other readings: new state, estimate (6,).

        The estimate is [vector part of the attitude relative to frame O of the environment, scalar part >= 0; rate
        relative to O in body axes (rad/s)], as `RigidBody.output`. What acted does not matter.
        """
        del u
        turn = y[self.gyro]
        s = self.predict(s, turn, h)
        s = self.find(s, y, env)
        for i, known in enumerate(self.instruments):
            if hasattr(known, "innovation"):
                # the barrier keeps XLA from predicting again in every one of the scalar updates
                s = self.correct(jax.lax.optimization_barrier(s), i, y[i], env)
        for i, places in self.exposures.items():
            s = self.expose(s, places, y[i].exposed)
        q = attitude.compose(s.q, attitude.conjugate(env.q_ON))
        rate = turn.rate - s.bias
        error = jnp.concatenate([attitude.positive(q)[1:], rate - attitude.rotate(q, env.w_ON)])
        return s, jnp.where(s.known > 0, error, jnp.concatenate([jnp.zeros(3), rate]))

    def predict(self, s: MekfState, turn: Turn, h: Any) -> MekfState:
        """State and covariance h s later, by the rotation that was counted. Farrenkopf's noise."""
        gyro = self.instruments[self.gyro]
        angle = turn.turn - h * s.bias
        step = attitude.from_vector(angle)
        F = jnp.eye(s.P.shape[0]).at[:3, :3].set(attitude.dcm(step)).at[:3, 3:6].set(-h * _slope(angle))
        flicker = 2 * (gyro.instability / FLICKER) ** 2 / gyro.correlation_time  # begins as a walk of this density
        u = jnp.asarray(gyro.rate_random_walk) ** 2 + flicker
        v = jnp.asarray(gyro.random_walk) ** 2 * h + jnp.asarray(gyro.quantum) ** 2 / 6
        I = jnp.eye(3)
        Q = jnp.block([[(v + u * h**3 / 3) * I, -u * h**2 / 2 * I], [-u * h**2 / 2 * I, u * h * I]])
        return s._replace(
            q=attitude.normalise(attitude.compose(step, s.q)),
            ages=s.ages + h,
            P=(F @ s.P @ F.T).at[:6, :6].add(Q),
            known=s.known * turn.valid,
            nis=jnp.zeros(()),
            rows=jnp.zeros(()),
        )

    def find(self, s: MekfState, y: tuple[Any, ...], env: Any) -> MekfState:
        """An attitude, where there is none yet and the readings give one: by a star fix, else by the best two vectors.

        The readings correct it afterwards, as all others do: what is believed of it before is a thousand times worse.
        """
        pairs = [known.pair(y[i], env) for i, known in enumerate(self.instruments) if hasattr(known, "pair")]
        found = [_attitude_of(a, b) for a, b in combinations(pairs, 2)]
        found = [(attitude.compose(attitude.conjugate(s.q), q), worst) for q, worst in found]
        found += [self._fix(s, i, y[i]) for i, known in enumerate(self.instruments) if hasattr(known, "body_attitude")]
        turn, least = jnp.array([1.0, 0.0, 0.0, 0.0]), jnp.asarray(jnp.inf)
        for relative, worst in found:
            turn, least = jnp.where(worst < least, relative, turn), jnp.minimum(worst, least)
        take = (s.known == 0) & (least <= SURE)
        q, past = (attitude.normalise(attitude.compose(a, turn)) for a in (s.q, s.past))
        spread = jnp.minimum(1e3 * jnp.where(take, least, 1.0), LOST)
        return s._replace(
            q=jnp.where(take, q, s.q),
            past=jnp.where(take, past, s.past),
            P=jnp.where(take, self._unknown(s._replace(q=q, past=past), spread), s.P),
            known=jnp.where(take, 1.0, s.known),
        )

    def correct(self, s: MekfState, i: int, reading: Any, env: Any) -> MekfState:
        """State and covariance after the reading of instrument i."""
        place = self.calibrated.index(i) if i in self.calibrated else None
        own = jnp.zeros(0) if place is None else s.own[place]
        n, first = s.P.shape[0], 6 + s.own.size
        q, chosen = self._exposed(s, i, reading)
        told = self.instruments[i].innovation(reading, q, own, env)
        H = jnp.zeros((told.z.shape[0], n))
        if chosen is None:
            H = H.at[:, :3].set(told.attitude)
        else:
            late = chosen[None, :, None] * told.attitude[:, None, :]
            H = H.at[:, first:].set(late.reshape(H.shape[0], -1))
        if place is not None:
            H = H.at[:, 6 + 3 * place : 9 + 3 * place].set(told.own)
        valid = told.valid * s.known
        e, P, nis = tested_updates(s.P, told.z, H, told.variance, valid)
        return s._replace(
            q=_corrected(s.q, e[:3]),
            bias=s.bias + e[3:6],
            own=s.own + e[6:first].reshape(s.own.shape),
            past=_corrected(s.past, e[first:].reshape(-1, 3)),
            P=P,
            nis=s.nis + nis,
            rows=s.rows + jnp.sum(valid),
        )

    def expose(self, s: MekfState, places: slice, exposed: Array) -> MekfState:
        """The attitude of now among the exposures of one tracker, where it has made one; the oldest goes."""
        n, first = s.P.shape[0], 6 + s.own.size
        order = np.arange(n)
        a, b = first + 3 * places.start, first + 3 * places.stop
        order[a:b] = np.concatenate([np.arange(3), np.arange(a, b - 3)])
        past = s.past.at[places].set(jnp.concatenate([s.q[None], s.past[places][:-1]]))
        ages = s.ages.at[places].set(jnp.concatenate([jnp.zeros(1), s.ages[places][:-1]]))
        return s._replace(
            past=jnp.where(exposed > 0, past, s.past),
            ages=jnp.where(exposed > 0, ages, s.ages),
            P=jnp.where(exposed > 0, s.P[order][:, order], s.P),
        )

    def _exposed(self, s: MekfState, i: int, reading: Any) -> tuple[Array, Array | None]:
        """The estimate (4,) of the attitude that a reading is of, and which exposure it was, (d,) of 1 and 0."""
        if i not in self.exposures:
            return s.q, None
        places = self.exposures[i]
        nearest = jnp.argmin(jnp.abs(s.ages[places] - reading.age)) + places.start
        chosen = (jnp.arange(s.ages.shape[0]) == nearest).astype(float)
        return chosen @ s.past, chosen

    def _fix(self, s: MekfState, i: int, reading: Any) -> tuple[Array, Array]:
        """Rotation (4,) of frame N by which the estimate misses a star fix, and 1 sigma of its worst axis () rad."""
        estimate, _ = self._exposed(s, i, reading)
        known = self.instruments[i]
        relative = attitude.compose(attitude.conjugate(estimate), known.body_attitude(reading))
        good = reading.valid > 0
        return jnp.where(good, relative, jnp.array([1.0, 0, 0, 0])), jnp.where(good, jnp.max(known.deviation), jnp.inf)

    def _unknown(self, s: MekfState, spread: Array) -> Array:
        """P for an attitude known to `spread` rad per axis only, where what happened since the exposures is known."""
        gyro = self.instruments[self.gyro]
        first = 6 + s.own.size
        since = jnp.max(s.ages, initial=0.0)
        G = (
            jnp.zeros((s.P.shape[0], 3))
            .at[:3]
            .set(attitude.dcm(s.q))
            .at[first:]
            .set(attitude.dcm(s.past).reshape(-1, 3))
        )
        kept = s.P.at[:3].set(0.0).at[:, :3].set(0.0).at[first:].set(0.0).at[:, first:].set(0.0)
        drift = jnp.asarray(gyro.random_walk) ** 2 * since + s.P[3, 3] * since**2
        return (kept + spread**2 * (G @ G.T)).at[:3, :3].add(drift * jnp.eye(3))


def mekf(
    suite: SensorSuite,
    *,
    q: Given | None = None,
    deviation: float = 0.1,
    bias: Given | None = None,
    bias_deviation: float | None = None,
    calibrate: Mapping[int, float] | None = None,
) -> Mekf:
    """The filter for a suite of instruments, with the noise of their data sheets.

    Parameters
    ----------
    suite : with one `IntegratingGyro` and at least one instrument that has an `innovation`, all of which are used
    q : (4,) first guess of the attitude relative to frame N; found by itself if absent
    deviation : () rad per axis, 1 sigma of that guess
    bias : (3,) rad/s, first guess; the gyro's mean if absent
    bias_deviation : () rad/s per axis, 1 sigma of it; from the gyro's turn-on bias and instability if absent
    calibrate : for the place of an instrument in the suite, 1 sigma of its own parameters, which are then estimated
        too: misalignment (rad) of a star tracker, Sun or horizon sensor, bias (T) of a magnetometer

    Raises
    ------
    ScenarioError
        No gyro, or two; nothing that corrects; wrong shapes, NaN, negative deviations, a quaternion that is not of
        length one; an instrument without noise, of which no filter can be sure enough; one to be calibrated that has
        no parameters.
    """
    if not isinstance(suite, SensorSuite):
        raise ScenarioError(f"suite is a {type(suite).__name__}: give a SensorSuite.create([...])")
    instruments = suite.instruments
    gyros = [known for known in instruments if isinstance(known, IntegratingGyro)]
    if len(gyros) != 1:
        raise ScenarioError(f"suite has {len(gyros)} gyros: give exactly one IntegratingGyro, which moves the attitude")
    correcting = [i for i, known in enumerate(instruments) if hasattr(known, "innovation")]
    if not correcting:
        raise ScenarioError(
            "suite has nothing that corrects the gyro: add a star tracker, or two sensors of directions"
        )
    for i in correcting:
        sheet = instruments[i].deviation
        if not isinstance(sheet, Tracer) and not np.all(np.asarray(sheet) > 0):
            raise ScenarioError(f"instruments[{i}], a {type(instruments[i]).__name__}, has no noise: give it some")
    own = dict(calibrate or {})
    for i in own:
        if i not in correcting or not getattr(instruments[i], "parameters", ""):
            able = {j: instruments[j].parameters for j in correcting if getattr(instruments[j], "parameters", "")}
            raise ScenarioError(f"calibrate = {own}: instruments[{i}] has nothing to estimate; these have: {able}")
    gyro = gyros[0]
    start = (gyro.turn_on**2 + (gyro.instability / FLICKER) ** 2) ** 0.5
    guess = np.array([1.0, 0.0, 0.0, 0.0]) if q is None else unit("q", q, 4)
    sigma = LOST if q is None else positive("deviation", deviation)
    drift = start if bias_deviation is None else real("bias_deviation", bias_deviation, low=0)
    return Mekf(
        instruments=instruments,
        q=guess,
        bias=gyro.bias if bias is None else real("bias", bias, (3,)),
        deviation=sigma * np.eye(2)[0].repeat(3) + drift * np.eye(2)[1].repeat(3),
        own_deviation=positive("calibrate", [own[i] for i in sorted(own)], (len(own),)),
        known=np.asarray(float(q is not None)),
        calibrated=tuple(sorted(own)),
    )


class MekfRecord(NamedTuple):
    """What `mekf_record` keeps of a sample, for `nees` and `nis`."""

    error: Array  # (6,) true less estimated: small rotation about body axes (rad), gyro bias (rad/s)
    covariance: Array  # (6, 6)
    known: Array  # () 1 once the filter has an attitude
    nis: Array  # ()
    rows: Array  # ()


def mekf_record(x: Any, env: Any, sensors: tuple[Any, ...], navigator: MekfState) -> MekfRecord:
    """For ``simulate(..., record=mekf_record)``: error and covariance of a `Mekf`, with its normalised innovation."""
    del env
    gyro = next(state for state in sensors if isinstance(state, GyroState))
    turn = attitude.to_vector(attitude.compose(x.q, attitude.conjugate(navigator.q)))
    error = jnp.concatenate([turn, gyro.bias + gyro.flicker - navigator.bias])
    return MekfRecord(error, navigator.P[:6, :6], navigator.known, navigator.nis, navigator.rows)


def _attitude_of(a: Pair, b: Pair) -> tuple[Array, Array]:
    """Attitude (4,) from two vectors, and 1 sigma of its worst axis () rad, infinite if they give none."""
    deviations = jnp.stack([jnp.asarray(a.deviation), jnp.asarray(b.deviation)])
    seen, true = jnp.stack([a.body, b.body]), jnp.stack([a.reference, b.reference])
    A, determined = wahba_pair(seen, true, 1 / deviations**2)
    good = determined & (a.valid > 0) & (b.valid > 0)
    sine = jnp.linalg.norm(attitude.cross(*direction(jnp.where(good, true, jnp.eye(2, 3)))))
    worst = jnp.where(good, jnp.sqrt(jnp.sum(deviations**2)) / sine, jnp.inf)
    return attitude.from_dcm(jnp.where(good, A, jnp.eye(3))), worst


def _corrected(q: Array, e: Array) -> Array:
    """Attitudes (..., 4) turned by small rotations (..., 3) about body axes."""
    return attitude.normalise(attitude.compose(attitude.from_vector(e), q))


def _slope(angle: Array) -> Array:
    """J (3, 3) with from_vector(angle + d) = compose(from_vector(J d), from_vector(angle)) to first order in d."""
    square = attitude.dot(angle, angle)
    small = square < 1e-4
    safe = jnp.where(small, 1.0, square)
    length = jnp.sqrt(safe)
    once = jnp.where(small, 0.5 - square / 24, (1 - jnp.cos(length)) / safe)
    twice = jnp.where(small, 1 / 6 - square / 120, (length - jnp.sin(length)) / (safe * length))
    cross = attitude.cross_matrix(angle)
    return jnp.eye(3) - once * cross + twice * (cross @ cross)
