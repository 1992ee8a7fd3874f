"""Wheels as sold: the data sheet, sharing, limits, null space, rounding, noise, and a flight with all of it."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from plants.dynamics.rigidbody import BodyState
from plants.errors import ScenarioError
from plants.hardware.actuators import ReactionWheels
from plants.hardware.effectors import equip
from plants.hardware.wheels import Wheel, WheelArray
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings.environment import FreeSpace

PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)
NULL = np.array([1.0, 1, -1, -1])  # momenta along it cancel
SHEET = {"max_torque": 2e-3, "max_momentum": 15e-3, "max_speed_rpm": 6000.0}


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@dataclass(frozen=True, kw_only=True)
class Held:
    """A controller that always asks for the same."""

    dt: float
    command: np.ndarray

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, self.command


def sheets(axes=PYRAMID, **changes):
    return [Wheel.create(axis, **SHEET | changes) for axis in axes.T]


def at(speeds):
    return BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), np.asarray(speeds, float))


def random_axes(seed, n):
    axes = np.random.default_rng(seed).normal(size=(3, n))
    return axes / np.linalg.norm(axes, axis=0)


def test_the_third_number_of_a_data_sheet_follows():
    speed = 6000 * 2 * np.pi / 60
    a = Wheel.create([1, 0, 0], max_torque=1, max_momentum=0.015, max_speed_rpm=6000)
    b = Wheel.create([1, 0, 0], max_torque=1, max_momentum=0.015, inertia=0.015 / speed)
    c = Wheel.create([1, 0, 0], max_torque=1, max_speed=speed, inertia=0.015 / speed)
    for wheel in (a, b, c):
        np.testing.assert_allclose([wheel.max_speed, wheel.inertia, wheel.max_momentum], [speed, 0.015 / speed, 0.015])
    d = Wheel.create([1, 0, 0], static_imbalance_g_cm=0.5, dynamic_imbalance_g_cm2=20, position=[0, 0, 0.1], **SHEET)
    np.testing.assert_allclose([d.static_imbalance, d.dynamic_imbalance], [5e-6, 2e-6])  # kg m, kg m^2


@settings(max_examples=12, deadline=None)
@given(st.integers(3, 5), st.integers(0, 2**32 - 1), st.sampled_from([1e-6, 1.0, 1e4]), st.booleans())
def test_within_limits_the_body_feels_the_command(n, seed, unit, minimax):
    axes, rng = random_axes(seed, n), np.random.default_rng(seed)
    if np.linalg.cond(axes) > 30:
        return
    limits = unit * rng.uniform(50, 100, n)
    wheels = [
        Wheel.create(a, max_torque=t, inertia=unit, max_speed=np.inf) for a, t in zip(axes.T, limits, strict=True)
    ]
    command = unit * rng.normal(size=3)
    with jax.enable_x64(True):
        array = WheelArray.create(wheels, minimax=minimax)
        u = np.asarray(array.torques(command, at(np.zeros(n)), 1.0))
    np.testing.assert_allclose(-axes @ u, command, rtol=0, atol=1e-9 * np.linalg.norm(command))
    if minimax:  # against a solver of linear programs: the least part t of the limits
        bounds = np.hstack([np.vstack([np.eye(n), -np.eye(n)]), np.tile(-limits, 2)[:, None]])
        best = linprog(
            np.eye(n + 1)[n], A_ub=bounds, b_ub=np.zeros(2 * n), bounds=(None, None),
            A_eq=np.hstack([axes, np.zeros((3, 1))]), b_eq=-command,
        )  # fmt: skip
        assert np.max(np.abs(u) / limits) == pytest.approx(best.x[n], rel=1e-6)
    else:
        np.testing.assert_allclose(u, -np.linalg.pinv(axes) @ command, rtol=1e-9, atol=1e-12 * unit)


def test_every_wheel_has_its_own_limits_also_without_a_data_sheet():
    limits, speeds = [1e-3, 2e-3, 3e-3], [100.0, 200, 300]
    plain = ReactionWheels.create(np.eye(3), torque_limit=limits, speed_limit=speeds)
    rows = zip(np.eye(3), limits, speeds, strict=True)
    sold = WheelArray.create([Wheel.create(a, max_torque=t, inertia=1e-5, max_speed=v) for a, t, v in rows])
    ask = -np.ones(3)
    np.testing.assert_allclose(plain.apply((), ask, at(np.zeros(3)))[1], limits)
    np.testing.assert_allclose(sold.apply((), ask, at(np.zeros(3)), np.zeros(3), 0.01)[1], limits)
    fast = at([100.0, 150, -300])
    np.testing.assert_allclose(plain.apply((), ask, fast)[1], [0, 2e-3, 3e-3])
    np.testing.assert_allclose(sold.apply((), ask, fast, np.zeros(3), 0.01)[1], [0, 2e-3, 3e-3])


@settings(max_examples=12, deadline=None)
@given(st.integers(4, 6), st.integers(0, 2**32 - 1), st.floats(1e-3, 1.0), st.floats(1e-3, 1e2))
def test_null_space_torque_leaves_the_body_alone(n, seed, rate, size):
    """Also where it takes all that the motors have left, and whatever the wheels are."""
    axes, rng = random_axes(seed, n), np.random.default_rng(seed)
    if np.linalg.cond(axes) > 30:
        return
    kinds = [Wheel.create(a, max_torque=1.0, inertia=10 ** rng.uniform(-3, 0), max_speed=1e4) for a in axes.T]
    command = rng.uniform(-0.1, 0.1, 3)
    with jax.enable_x64(True):
        plain = WheelArray.create(kinds)
        turning = WheelArray.create(kinds, wanted_speeds=size * rng.normal(size=n), null_rate=rate)
        x = at(rng.uniform(-100, 100, n))
        u, v = (np.asarray(array.torques(command, x, 0.1)) for array in (plain, turning))
    if (np.abs(u) < 1).all():
        np.testing.assert_allclose(axes @ v, axes @ u, rtol=0, atol=1e-12)
    assert (np.abs(v) <= 1).all()
    assert not np.allclose(u, v, rtol=0, atol=1e-15)


@pytest.fixture(scope="module")
def flown():
    """Ten minutes at rest: the wheels are driven apart, with a little friction."""
    with jax.enable_x64(True):
        wheels = sheets(viscous=1e-9)
        plant, actuator = equip([0.1, 0.12, 0.05], wheels=wheels, wanted_speeds=200 * NULL, null_rate=0.02)
        loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=1.0, command=np.array([0, 0, 1e-7])))
        start = plant.state([1, 0, 0, 0], np.zeros(3), FreeSpace(), wheels=np.array([10.0, -3, 5, 2]))
        return simulate(loop, Scenario(initial=start, dt=1.0, periods=600, environment=FreeSpace()))


def test_null_space_drives_the_speeds_to_where_they_are_wanted_and_away_from_zero(flown):
    along = flown.states.wheels @ NULL / 4
    start = np.array([10.0, -3, 5, 2]) @ NULL / 4
    expected = 200 + (start - 200) * (1 - 0.02) ** np.arange(600)  # a torque held for a second
    np.testing.assert_allclose(along, expected, rtol=0, atol=0.5)
    assert np.abs(flown.states.wheels[-1]).min() > 150
    assert np.abs(flown.states.w).max() < 2e-3  # what the command of 1e-7 N m and friction leave


def test_a_wheel_comes_to_its_speed_limit_and_stays():
    plant, actuator = equip([1e3, 1e3, 1e3], wheels=sheets(np.eye(3)))
    limit = SHEET["max_speed_rpm"] * 2 * np.pi / 60
    loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=1.0, command=np.array([-2e-3, 2e-3, 0])))
    start = plant.state([1, 0, 0, 0], np.zeros(3), FreeSpace())
    run = simulate(loop, Scenario(initial=start, dt=1.0, periods=20, environment=FreeSpace()))
    np.testing.assert_allclose(run.states.wheels[-1], [limit, -limit, 0], rtol=1e-7)
    assert np.abs(run.states.wheels).max() < limit * (1 + 1e-7)  # but for the turn of the body
    np.testing.assert_allclose(np.abs(run.inputs[:7, :2]), 2e-3, rtol=1e-12)


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e-3))
def test_torques_are_whole_steps_within_the_limit(seed, step):
    wheels = sheets(torque_step=step)
    command = np.random.default_rng(seed).uniform(-6e-3, 6e-3, 3)
    with jax.enable_x64(True):
        u = np.asarray(WheelArray.create(wheels).torques(command, at(np.zeros(4)), 1.0))
    np.testing.assert_allclose(u / step, np.round(u / step), rtol=0, atol=1e-8)
    asked = np.clip(-np.linalg.pinv(PYRAMID) @ command, -2e-3, 2e-3)
    assert (np.abs(u - asked) <= step * (1 + 1e-9)).all()
    inside = np.abs(asked) < 2e-3 - step
    assert (np.abs(u - asked)[inside] <= step / 2 * (1 + 1e-9)).all()
    assert (np.abs(u) <= 2e-3 * (1 + 1e-12)).all()


def test_rounding_has_the_variance_of_theory():
    """step^2 / 12, Widrow's quantisation noise."""
    array = WheelArray.create(sheets(np.eye(3), torque_step=1e-5))
    commands = np.random.default_rng(0).uniform(-1e-3, 1e-3, (4000, 3))
    u = np.asarray(jax.vmap(lambda c: array.torques(c, at(np.zeros(3)), 1.0))(commands))
    assert (u + commands).std() == pytest.approx(1e-5 / np.sqrt(12), rel=0.03)
    assert abs((u + commands).mean()) < 4 * 1e-5 / np.sqrt(12 * u.size)


@pytest.mark.parametrize("h", [0.01, 0.25, 4.0])
def test_noise_is_a_density(h):
    """Momentum walks by torque_noise sqrt(t), whatever the samples."""
    array, density = WheelArray.create(sheets(torque_noise=1e-6)), 1e-6
    noise = np.random.default_rng(1).normal(size=(20_000, array.channels))
    u = np.asarray(jax.vmap(lambda n: array.apply((), np.zeros(3), at(np.zeros(4)), n, h)[1])(noise))
    np.testing.assert_allclose(u.std(axis=0), density / np.sqrt(h), rtol=4 / np.sqrt(2 * 20_000))
    np.testing.assert_allclose(np.corrcoef(u.T), np.eye(4), atol=4 / np.sqrt(20_000))


def test_noise_in_a_flight_does_not_depend_on_the_number_of_samples():
    """Variance of the momentum after 100 s, four wheels: 3 sigma of a chi-square with 4 * runs degrees of freedom."""
    for samples in (1, 5):
        plant, actuator = equip([1e6, 1e6, 1e6], wheels=sheets(torque_noise=1e-6))
        loop = Loop(plant=plant, actuator=actuator, controller=Held(dt=1.0, command=np.zeros(3)))
        start = plant.state([1, 0, 0, 0], np.zeros(3), FreeSpace())
        run = simulate(
            loop, Scenario(initial=start, dt=1.0, periods=1000, samples=samples, environment=FreeSpace(), seed=3)
        )
        momenta = float(sheets()[0].inertia) * run.states.wheels[::samples]
        steps = np.diff(momenta, axis=0)
        assert steps.var() == pytest.approx(1e-12, rel=3 * np.sqrt(2 / steps.size))
        assert run.ok


def test_one_momentum_wheel_makes_the_torque_along_its_axis():
    one = [Wheel.create([0, 1.0, 0], **SHEET)]
    with pytest.raises(ScenarioError, match="spanning=False"):
        WheelArray.create(one)
    array = WheelArray.create(one, spanning=False)
    np.testing.assert_allclose(array.torques(np.array([1e-4, 2e-4, 3e-4]), at([100.0]), 1.0), [-2e-4], rtol=1e-12)
    with pytest.raises(ScenarioError, match="axes of the wheels must span space"):
        WheelArray.create(one, spanning=False, minimax=True)


ONE = {"axis": [1.0, 0, 0], **SHEET}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"axis": [1.0, 1, 0]}, "axis must be a unit vector, got length 1.41"),
        ({"axis": np.eye(3)}, "axis must have shape"),
        ({"max_torque": 0.0}, "max_torque must be positive"),
        ({"max_momentum": None}, "max_speed given: give two, the third follows"),
        ({"inertia": 1e-5}, "max_momentum and max_speed and inertia given: give two"),
        ({"max_speed": 600.0}, "max_speed and max_speed_rpm are both given"),
        ({"max_speed_rpm": -1.0}, "max_speed_rpm must be positive"),
        ({"max_momentum": np.nan}, "max_momentum must be finite"),
        ({"max_speed_rpm": np.inf}, "max_speed must be finite"),
        ({"viscous": -1e-6}, "viscous must be at least 0"),
        ({"coulomb": 2e-5, "static": 1e-5}, "static = 1e-05 N m is below coulomb"),
        ({"creep": 0.0}, "creep must be positive"),
        ({"stribeck": -1.0}, "stribeck must be positive"),
        ({"torque_noise": -1e-6}, "torque_noise must be at least 0"),
        ({"torque_step": -1e-6}, "torque_step must be at least 0"),
        ({"static_imbalance_g_cm": 1.0}, "position is missing"),
        ({"dynamic_imbalance_g_cm2": -1.0}, "dynamic_imbalance_g_cm2 must be at least 0"),
    ],
)
def test_mistakes_of_a_data_sheet_are_named(change, message):
    arguments = ONE | change
    with pytest.raises(ScenarioError, match=message):
        Wheel.create(arguments.pop("axis"), **arguments)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: WheelArray.create([]), "wheels = "),
        (lambda: WheelArray.create(sheets(PYRAMID[:, :2])), "axes of the wheels must span space"),
        (lambda: WheelArray.create(sheets(), wanted_speeds=100 * NULL), "come together"),
        (lambda: WheelArray.create(sheets(), wanted_speeds=NULL[:3], null_rate=0.1), "wanted_speeds must have shape"),
        (lambda: WheelArray.create(sheets(), wanted_speeds=1e4 * NULL, null_rate=0.1), "exceed max_speed"),
        (lambda: WheelArray.create(sheets(), wanted_speeds=np.ones(4), null_rate=0.1), "null space of the axes"),
        (lambda: WheelArray.create(sheets(np.eye(3)), wanted_speeds=[1, 2, 3], null_rate=0.1), "null space"),
        (lambda: WheelArray.create(sheets(max_torque=np.inf), minimax=True), "give every wheel a max_torque"),
        (lambda: WheelArray.create(sheets(random_axes(0, 12)), minimax=True), "12 devices share a torque in"),
        (lambda: ReactionWheels.create(np.eye(3), torque_limit=[1e-3, 2e-3]), "torque_limit must have shape"),
        (lambda: ReactionWheels.create(2 * np.eye(3)), "axes must be unit columns"),
    ],
)
def test_mistakes_of_an_array_are_named(act, message):
    with pytest.raises(ScenarioError, match=message):
        act()
