"""State-dependent Riccati control of a rigid body with wheels, flown in a simulation of its own."""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg as sla

from synth.analysis.coprime import ncfmargin, solutions
from synth.errors import AssumptionError, ModelError
from synth.regulators import sdre
from synth.regulators.controller import LinearController
from synth.regulators.quaternion import QuaternionPid, quaternion_lqr, quaternion_pd, quaternion_pid
from synth.regulators.sdc import MrpModel, QuaternionModel
from synth.regulators.sdre import Sdre, SdreHinf, SdreHinfPaperLiteral, SdreHinfStatic
from synth.systems.statespace import StateSpace

INERTIA = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]])  # kg m^2, Romero and Souza, table 1
ROTORS = 0.01911 * np.eye(3)  # kg m^2
TORQUE = 0.075  # N m
MOMENTUM = 0.01911 * 6000 * 2 * np.pi / 60  # N m s of a wheel at its speed limit
DT = 0.5  # s
IB = INERTIA - ROTORS
MODELS = {"mrp": MrpModel.create(IB), "quaternion": QuaternionModel.create(IB)}

for kind in (MrpModel, QuaternionModel, Sdre, SdreHinf, SdreHinfStatic, SdreHinfPaperLiteral, LinearController):
    jax.tree_util.register_dataclass(kind)
jax.tree_util.register_dataclass(QuaternionPid)


def rotation(axis, angle):
    axis = np.asarray(axis, float)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis / np.linalg.norm(axis)])


def measurement(q, w=(0, 0, 0), wheels=(0, 0, 0)):
    return np.concatenate([q, w, wheels]).astype(float)


def random_measurements(count, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.standard_normal((count, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    return np.hstack([q, rng.uniform(-0.04, 0.04, (count, 3)), rng.uniform(-12, 12, (count, 3))])


def motion(y, u, J):
    """dy/dt, written out from equations 14 and 23."""
    q0, q, w, wheels = y[0], y[1:4], y[4:7], y[7:10]
    dw = jnp.linalg.solve(J, u - jnp.cross(w, J @ w + wheels))
    return jnp.concatenate([-0.5 * jnp.dot(w, q)[None], 0.5 * (q0 * w + jnp.cross(q, w)), dw, -u])


@partial(jax.jit, static_argnames="seconds")
def fly(controller, starts, inertias, seconds):
    """Measurements (lanes, periods, 10) and the controllers' last states."""

    def one(y, J):
        def period(carry, _):
            y, state = carry
            new, u = controller.step(state, y, jnp.zeros(10))
            u = jnp.clip(u, -TORQUE, TORQUE)
            u = jnp.where((jnp.abs(y[7:]) >= MOMENTUM) & (u * y[7:] < 0), 0.0, u)
            k1 = motion(y, u, J)
            k2 = motion(y + DT / 2 * k1, u, J)
            k3 = motion(y + DT / 2 * k2, u, J)
            k4 = motion(y + DT * k3, u, J)
            y = y + DT / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            y = y.at[:4].divide(jnp.linalg.norm(y[:4]))
            return (y, jax.tree.map(lambda a, b: jnp.asarray(a, b.dtype), new, state)), y

        state = jax.tree.map(jnp.asarray, controller.init())
        (_, state), history = jax.lax.scan(period, (y, state), None, length=round(seconds / DT))
        return history, state

    return jax.vmap(one)(starts, inertias)


def flown(controller, starts, inertias=None, seconds=1800.0):
    starts = np.atleast_2d(starts)
    with jax.enable_x64(True):
        inertias = np.repeat(IB[None], len(starts), 0) if inertias is None else inertias
        return jax.tree.map(np.asarray, fly(controller, starts, inertias, seconds))


def angle(history):
    """Rotation angle, rad, (lanes, periods)."""
    return 2 * np.arctan2(np.linalg.norm(history[..., 1:4], axis=-1), np.abs(history[..., 0]))


def settling(history):
    """Seconds from which every lane stays below 1 deg and 1e-3 rad/s; infinite if never."""
    off = (angle(history) > np.deg2rad(1)) | (np.linalg.norm(history[..., 4:7], axis=-1) > 1e-3)
    last = off.shape[1] - np.argmax(off[:, ::-1], axis=1)
    return np.where(off.any(axis=1), np.where(last < off.shape[1], last * DT, np.inf), 0.0)


def path(history):
    """Angle turned in all, rad."""
    return DT * np.linalg.norm(history[..., 4:7], axis=-1).sum(axis=1)


def dispersed(runs, seed=0):
    """Any attitude, rates up to 0.01 rad/s, moments of inertia off by up to 20 per cent."""
    rng = np.random.default_rng(seed)
    starts = random_measurements(runs, seed)
    starts[:, 4:7], starts[:, 7:] = rng.uniform(-0.01, 0.01, (runs, 3)), 0
    inertias = np.repeat(IB[None], runs, 0)
    inertias[:, range(3), range(3)] *= rng.uniform(0.8, 1.2, (runs, 3))
    return starts, inertias


def step(controller, y, state=None):
    with jax.enable_x64(True):
        state = controller.init() if state is None else state
        return jax.tree.map(np.asarray, controller.step(state, jnp.asarray(y), jnp.zeros(10)))


@pytest.mark.parametrize("name", MODELS)
def test_factorisation_is_the_dynamics(name):
    model, u, h = MODELS[name], np.array([0.03, -0.05, 0.02]), 1e-4
    with jax.enable_x64(True):
        for y in jnp.asarray(random_measurements(20)):
            if name == "quaternion" and abs(y[0]) < model.floor:
                continue
            side = model.side(y)
            x, A, B = model.factorise(y, side)
            rate = motion(y, jnp.asarray(u), jnp.asarray(IB))
            ahead, behind = (model.factorise(y + s * h * rate, side)[0] for s in (1, -1))
            np.testing.assert_allclose(A @ x + B @ u, (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-9)


@pytest.mark.slow  # compiles
def test_command_does_not_depend_on_the_sign_of_the_quaternion():
    y = random_measurements(1, seed=3)[0]
    mirrored = y * np.concatenate([-np.ones(4), np.ones(6)])
    for name in MODELS:
        for controller in (Sdre.create(MODELS[name], DT), SdreHinfStatic.create(MODELS[name], DT)):
            np.testing.assert_allclose(step(controller, y)[1], step(controller, mirrored)[1], rtol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_gain_is_that_of_scipy(name):
    Q, R = np.diag([1.0, 2, 3, 100, 200, 300]), np.diag([1.0, 2.0, 5.0])
    controller = Sdre.create(MODELS[name], DT, Q=Q, R=R)
    y = random_measurements(1, seed=5)[0]
    with jax.enable_x64(True):
        x, A, B = map(np.asarray, MODELS[name].factorise(jnp.asarray(y), MODELS[name].side(y)))
    expected = np.linalg.solve(R, B.T @ sla.solve_continuous_are(A, B, Q, R))
    state, u = step(controller, y)
    np.testing.assert_allclose(state.gain, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(u, -expected @ x, rtol=1e-9)
    assert state.failures == 0


def test_robust_gain_is_that_of_loop_shaping():
    """X, Z and the level agree with `ncfsyn`'s, and observer and gain keep the margin 1 / gamma (positive feedback)."""
    with jax.enable_x64(True):
        y = jnp.asarray(MODELS["mrp"].target())
        _, A, B = MODELS["mrp"].factorise(y, 1.0)
        rate = sdre.Sdre.create(MODELS["mrp"], DT).shift
        K, Z, ok = sdre.robust_gain(A, B, np.eye(6), np.eye(3), rate, 1.1)
    A, B, K, Z = map(np.asarray, (A, B, K, Z))
    G = StateSpace(A, B, np.eye(6), np.zeros((6, 3)))
    reference = solutions(G)
    np.testing.assert_allclose(Z, reference.Z, atol=1e-9 * np.abs(reference.Z).max())
    gamma_min = np.sqrt(1 + reference.coupling)
    g2 = (1.1 * gamma_min) ** 2
    Xg = np.linalg.solve((1 - 1 / g2) * np.eye(6) - reference.X @ reference.Z / g2, reference.X)
    np.testing.assert_allclose(K, B.T @ Xg, atol=1e-7 * np.abs(K).max())
    observer = StateSpace(A - B @ K - Z, Z, -K, np.zeros((3, 6)))
    assert ok
    assert ncfmargin(G, observer, sign=1) >= (1 - 1e-6) / (1.1 * gamma_min)


@pytest.mark.slow  # compiles
def test_published_law_is_its_three_equations():
    """gamma = gamma_min and L = gamma^2 I + X Z, then the regulator of the controller; SciPy solves all three."""
    y = random_measurements(1, seed=8)[0]
    model = MODELS["quaternion"]
    with jax.enable_x64(True):
        x, A, B = map(np.asarray, model.factorise(jnp.asarray(y), model.side(y)))
    X = sla.solve_continuous_are(A, B, np.eye(6), np.eye(3))
    Z = sla.solve_continuous_are(A.T, np.eye(6), B @ B.T, np.eye(6))
    g2 = 1 + np.linalg.eigvals(X @ Z).real.max()
    BK = g2 * np.linalg.inv((g2 * np.eye(6) + X @ Z).T) @ Z
    P = sla.solve_continuous_are(A - B @ B.T @ X + BK, BK, np.eye(6), np.eye(6))
    _, u = step(SdreHinfPaperLiteral.create(model, DT), y)
    np.testing.assert_allclose(u, -B.T @ P @ x, rtol=1e-4)


@dataclass(frozen=True, kw_only=True)
class Breakable:
    """A model that cannot be stabilised while the first wheel holds more than 1 N m s."""

    inner: Any

    def target(self):
        return self.inner.target()

    def side(self, y):
        return self.inner.side(y)

    def factorise(self, y, side):
        x, A, B = self.inner.factorise(y, side)
        return x, A, jnp.where(y[7] > 1.0, 0.0, B)


@pytest.mark.parametrize("kind", [Sdre, SdreHinf, SdreHinfStatic, SdreHinfPaperLiteral])
def test_a_failed_equation_is_flown_with_the_last_gain_and_counted(kind):
    controller = kind.create(Breakable(inner=MODELS["mrp"]), DT)
    good, other = (measurement(rotation([1, 2, 3], a), [0.002, 0, 0.001]) for a in (1.0, 2.0))
    bad = measurement(rotation([1, 2, 3], 1.2), [0.002, 0, 0.001], [2.0, 0, 0])
    first, _ = step(controller, bad)
    np.testing.assert_array_equal(first.gain, controller.gain)  # at the target, before any solution
    assert first.failures == 1
    state, _ = step(controller, good)
    held, u = step(controller, bad, state)
    np.testing.assert_array_equal(held.gain, state.gain)
    assert held.failures == 1
    assert np.isfinite(u).all()
    resumed, _ = step(controller, other, held)
    assert resumed.failures == 1
    assert np.abs(resumed.gain - held.gain).max() > 1e-3
    fresh, _ = step(controller, other)
    if kind is not SdreHinf:  # whose estimate has a history
        np.testing.assert_allclose(resumed.gain, fresh.gain, rtol=1e-8, atol=1e-8)


@dataclass(frozen=True, kw_only=True)
class SevenStates:
    """Equation 26 as printed, with q4 for a seventh state."""

    inner: Any

    def target(self):
        return self.inner.target()

    def side(self, y):
        return jnp.ones(())

    def factorise(self, y, side):
        x, A, B = self.inner.factorise(y, side)
        A = jnp.insert(jnp.insert(A, 3, 0.0, axis=0), 3, 0.0, axis=1)
        A = A.at[3].set(jnp.concatenate([-y[4:7] / 2, jnp.zeros(4)]))
        return jnp.insert(x, 3, y[0]), A, jnp.insert(B, 3, 0.0, axis=0)


@pytest.mark.parametrize("kind", [Sdre, SdreHinf, SdreHinfStatic, SdreHinfPaperLiteral])
def test_the_seven_states_of_equation_26_cannot_be_stabilised_at_rest(kind):
    with pytest.raises(AssumptionError, match="eigenvalue 0 ") as error:
        kind.create(SevenStates(inner=MODELS["quaternion"]), DT)
    assert error.value.assumption == "(A, B) stabilisable"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: MrpModel.create(np.diag([1.0, 1.0, -1.0])), "inertia is"),
        (lambda: MrpModel.create(IB + np.triu(np.ones((3, 3)), 1)), "inertia is"),
        (lambda: QuaternionModel.create(IB, floor=0.0), "floor is 0.0"),
        (lambda: Sdre.create(MODELS["mrp"], 0.0), "dt is 0"),
        (lambda: Sdre.create(MODELS["mrp"], DT, Q=-np.eye(6)), "Q has the eigenvalue -1"),
        (lambda: Sdre.create(MODELS["mrp"], DT, R=np.eye(2)), "R is 2 x 2"),
        (lambda: SdreHinf.create(MODELS["mrp"], DT, gamma_factor=1.0), "gamma_factor is 1.0"),
        (lambda: SdreHinf.create(MODELS["mrp"], DT, torque_limit=-0.1), "torque_limit is -0.1"),
        (lambda: quaternion_pd(IB, 0.0, 0.8, DT), "wn is 0.0"),
        (lambda: quaternion_pid(IB, 0.04, 0.8, DT, integral_time=1.0), "integral_time is 1.0"),
    ],
)
def test_bad_values_are_named(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_constant_gains_run_on_plain_arrays():
    y = measurement(rotation([0, 0, 1], -0.1), [0, 0, 1e-3])
    y[:4] *= -1
    u = quaternion_pd(IB, 0.04, 0.8, DT).step(np.zeros(3), y, None)[1]
    expected = -IB @ (2 * 0.04**2 * np.array([0, 0, -np.sin(0.05)]) + 2 * 0.8 * 0.04 * y[4:7])
    np.testing.assert_allclose(u, expected, rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_short_way_is_the_same_gain_on_either_sign(seed):
    """Of the quaternion, also with weights that couple the axes."""
    rng = np.random.default_rng(seed)
    q, w, root = rng.standard_normal(4), 0.01 * rng.standard_normal(3), rng.standard_normal((6, 6))
    y = measurement(q / np.linalg.norm(q) * np.sign(q[0]), w)
    Q, R = root @ root.T, np.diag(rng.uniform(0.1, 10, 3))
    long, short = quaternion_lqr(IB, DT, Q=Q, R=R), quaternion_lqr(IB, DT, Q=Q, R=R, short_way=True)
    expected = long.step(long.init(), y, np.zeros(10))[1]
    turned = y * np.r_[-np.ones(4), np.ones(6)]
    for measured in (y, turned):
        np.testing.assert_allclose(short.step(short.init(), measured, None)[1], expected, rtol=1e-12)
    assert not np.allclose(long.step(long.init(), turned, np.zeros(10))[1], expected)
    with pytest.raises(ModelError, match="short_way is 1; pass True or False"):
        quaternion_lqr(IB, DT, short_way=1)  # pyright: ignore[reportCallIssue, reportArgumentType]


@pytest.mark.slow  # compiles
def test_sdre_settles_from_anywhere():
    """Modified Rodrigues parameters, inertia off by 20 per cent."""
    history, state = flown(Sdre.create(MODELS["mrp"], DT), *dispersed(12))
    assert settling(history).max() < 700
    assert (state.failures == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    "make",
    [
        lambda: Sdre.create(MODELS["quaternion"], DT),
        lambda: SdreHinf.create(MODELS["mrp"], DT),
        lambda: SdreHinf.create(MODELS["mrp"], DT, torque_limit=TORQUE),
        lambda: SdreHinf.create(MODELS["quaternion"], DT),
        lambda: SdreHinfStatic.create(MODELS["mrp"], DT),
        lambda: quaternion_lqr(IB, DT),
        lambda: quaternion_pd(IB, 0.04, 0.8, DT),
        lambda: quaternion_pid(IB, 0.04, 0.8, DT, integral_time=100.0),
    ],
)
def test_the_others_settle_too(make):
    history, state = flown(make(), *dispersed(12))
    assert settling(history).max() < 900
    assert np.all(getattr(state, "failures", 0) == 0)


@pytest.mark.slow
def test_the_published_law_is_slow():
    starts, inertias = dispersed(12)
    published = settling(flown(SdreHinfPaperLiteral.create(MODELS["quaternion"], DT), starts, inertias)[0])
    plain = settling(flown(Sdre.create(MODELS["quaternion"], DT), starts, inertias)[0])
    assert np.isfinite(published).all()
    assert np.median(published) > 2 * np.median(plain)


@pytest.mark.slow
def test_sdre_takes_the_short_way_and_the_constant_gain_the_long_one():
    start = measurement(-rotation([1, 1, 1], np.deg2rad(18)))
    for name in MODELS:
        history, _ = flown(Sdre.create(MODELS[name], DT), start)
        assert path(history)[0] < np.deg2rad(25)
        assert settling(history)[0] < 300
    assert path(flown(quaternion_lqr(IB, DT), start)[0])[0] > np.deg2rad(342)
    history, _ = flown(quaternion_lqr(IB, DT, short_way=True), start)
    assert path(history)[0] < np.deg2rad(25)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_half_a_turn_away_exactly(name):
    """q0 = 0, where equation 26 has no gain: the floor gives one."""
    starts = np.array([measurement(np.concatenate([[0.0], np.eye(3)[k]])) for k in range(3)])
    history, state = flown(Sdre.create(MODELS[name], DT), starts)
    assert settling(history).max() < 700
    assert (state.failures == 0).all()


@pytest.mark.slow
def test_an_integral_takes_out_a_constant_torque():
    """The wheels carry a bearing torque that the controller does not know: 1 mN m, as an error of the command."""

    pid = quaternion_pid(IB, 0.04, 0.8, DT, integral_time=100.0)
    pd = quaternion_pd(IB, 0.04, 0.8, DT)
    ends = []
    for controller in (pid, pd):
        y, state = measurement(rotation([1, 0, 0], 0.01)), controller.init()
        A = np.linalg.inv(IB)
        for _ in range(4000):
            state, u = controller.step(state, y, None)
            w = y[4:7] + DT * A @ (u + 1e-3)
            q = np.asarray(y[:4]) + DT / 2 * np.concatenate([[-w @ y[1:4]], y[0] * w + np.cross(y[1:4], w)])
            y = measurement(q / np.linalg.norm(q), w)
        ends.append(np.abs(y[1:4]).max())
    assert ends[0] < 1e-8 < 1e-4 < ends[1]
