"""The rigid body: Basilisk's trajectory, conserved quantities, outputs, and what is refused."""

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings import orbit
from plants.surroundings.disturbances import ConstantTorque, GravityGradient
from plants.surroundings.environment import CircularEnvironment, Environment, FreeSpace

DATA = Path(__file__).parents[2] / "data"
FULL = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]]) / 1e3  # kg m^2, no symmetry
PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)  # four wheels


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


def fly(plant, x, u, seconds, *, environment=None, steps=10):
    """States every second under constant motor torques."""
    loop = Loop(plant=plant, controller=Held(dt=1.0, command=np.asarray(u)))
    scenario = Scenario(initial=x, dt=1.0, periods=seconds, steps=steps, environment=environment or FreeSpace())
    run = simulate(loop, scenario)
    assert run.ok
    return run.states


def with_wheels(axes=PYRAMID, spin=2e-4, disturbances=()):
    return RigidBody.create(
        FULL, wheel_axes=axes, wheel_inertia=np.full(axes.shape[1], spin), disturbances=disturbances
    )


def test_trajectory_of_basilisk():
    start, flown = (np.load(DATA / f"basilisk_{n}.npz") for n in ("initial_conditions", "rigid_body_wheels"))
    body = RigidBody.create(
        start["I"],
        wheel_axes=np.eye(3),
        wheel_inertia=np.full(3, start["Jw"]),
        disturbances=(GravityGradient(), ConstantTorque.create(start["Text"])),
    )
    environment = Environment.along(orbit.Orbit(start["r"], start["v"]), datetime(2024, 3, 20, 9), 1001.0)
    q = np.asarray(attitude.from_dcm(start["A"]))
    states = fly(body, BodyState(q, start["w"], start["Om"]), start["us"], 1001, environment=environment)
    expected = Rotation.from_mrp(flown["s"]).as_quat(scalar_first=True)
    error = attitude.angle(attitude.compose(states.q, attitude.conjugate(expected)))
    assert error.shape == (1001,)
    assert error.max() < 1e-9  # rad
    np.testing.assert_allclose(states.w, flown["w"], rtol=0, atol=1e-10)  # rad/s
    np.testing.assert_allclose(states.wheels, flown["Om"], rtol=1e-12)


def test_angular_momentum_is_conserved_while_wheels_spin_up():
    """No external torque; momentum in frame N. RK4 at 0.1 s, rates of table 5 of the CubeSat study."""
    body, x = with_wheels(), BodyState(np.array([1.0, 0, 0, 0]), np.array([5e-3, -4e-3, 3e-3]), np.full(4, 50.0))
    idle = np.array([1, 1, -1, -1])  # speeds the wheels up against each other
    states = fly(body, x, 5e-5 * idle + np.array([2e-6, -1e-6, 1e-6, 2e-6]), 600)
    assert np.ptp(states.wheels, axis=0).min() > 100  # rad/s: they did spin up
    assert np.ptp(states.w, axis=0).max() > 1e-3  # and the body was turned
    momenta = jax.vmap(lambda x: attitude.rotate(attitude.conjugate(x.q), body.momentum(x)))(states)
    error = np.linalg.norm(momenta - momenta[0], axis=1) / np.linalg.norm(momenta[0])
    assert error.max() < 1e-12


def test_kinetic_energy_is_the_work_of_the_motors():
    """T = 1/2 w I w + w G Js Om + 1/2 Om Js Om, and a motor's power is u times its speed relative to the body."""
    body = with_wheels()
    u = np.array([3e-4, -2e-4, 1e-4, 2e-4])
    x = BodyState(np.array([1.0, 0, 0, 0]), np.array([0.02, -0.03, 0.01]), np.array([100.0, -50, 30, 80]))

    def energy(x):
        spin = body.wheel_inertia * x.wheels
        return 0.5 * x.w @ FULL @ x.w + x.w @ PYRAMID @ spin + 0.5 * x.wheels @ spin

    _, power = jax.jvp(energy, (x,), (body.derivative(x, u, FreeSpace().at(0.0)),))
    assert power == pytest.approx(u @ x.wheels, rel=1e-12)


def test_motor_torques_react_on_the_body():
    """At rest, dw = -(I - G Js G')^-1 G u, and the wheels feel the body turning away under them."""
    body, u = with_wheels(), np.array([1e-3, 0, 0, 2e-3])
    x = BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(4))
    rate = body.derivative(x, u, FreeSpace().at(0.0))
    rest = FULL - PYRAMID @ np.diag(np.full(4, 2e-4)) @ PYRAMID.T
    dw = -np.linalg.solve(rest, PYRAMID @ u)
    np.testing.assert_allclose(rate.w, dw, rtol=1e-12)
    np.testing.assert_allclose(rate.wheels, u / 2e-4 - PYRAMID.T @ dw, rtol=1e-12)


def test_without_wheels_the_input_is_a_torque_on_the_body():
    body, w, torque = RigidBody.create(FULL), np.array([0.3, -0.2, 0.1]), np.array([1e-3, 2e-3, -1e-3])
    x = BodyState(np.array([1.0, 0, 0, 0]), w, np.zeros(0))
    rate = body.derivative(x, torque, FreeSpace().at(0.0))
    np.testing.assert_allclose(FULL @ rate.w + np.cross(w, FULL @ w), torque, rtol=0, atol=1e-15)
    assert rate.wheels.shape == (0,)


def test_steady_spin_about_a_principal_axis_is_the_closed_form():
    body = RigidBody.create(np.diag([1.0, 2.0, 3.0]))
    states = fly(body, BodyState(np.array([1.0, 0, 0, 0]), np.array([0, 0, 0.2]), np.zeros(0)), np.zeros(3), 60)
    half = 0.1 * np.arange(60)
    expected = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=1)
    truncation = 600 * (0.1 * 0.1) ** 5 / 120  # of RK4: 600 steps of 0.1 s at half the rate
    np.testing.assert_allclose(states.q, expected, rtol=0, atol=truncation)


def test_output_is_attitude_and_rate_relative_to_the_orbital_frame():
    env = CircularEnvironment.along(orbit.circular(470e3, 0.9, 2.0, 0.4)).at(321.0)
    q, w, wheels = attitude.from_euler([0.3, -0.4, 2.9]), np.array([0.01, 0.02, -0.03]), np.arange(4.0)
    x = state_from(q, w, wheels, env)
    body = with_wheels()
    y = body.output(x, env)
    np.testing.assert_allclose(y[:3], attitude.positive(q)[1:], rtol=0, atol=1e-15)
    np.testing.assert_allclose(y[3:], w, rtol=0, atol=1e-17)
    np.testing.assert_array_equal(x.wheels, wheels)
    A_BO = attitude.dcm(x.q) @ attitude.dcm(env.q_ON).T
    np.testing.assert_allclose(attitude.dcm(q), A_BO, rtol=0, atol=1e-15)
    np.testing.assert_allclose(x.w, w + A_BO @ env.w_ON, rtol=0, atol=1e-17)  # Equation 4
    np.testing.assert_allclose(body.output(x._replace(q=-x.q), env), y, rtol=0, atol=1e-15)


def test_a_body_at_rest_in_the_orbital_frame_stays_there():
    """Nadir attitude on principal axes is an equilibrium on a circular orbit, gravity gradient included."""
    environment = CircularEnvironment.along(orbit.circular(470e3, 0.9, 2.0, 0.4))
    body = RigidBody.create(np.diag([0.0546, 0.0546, 0.0074]), disturbances=(GravityGradient(),))
    x = state_from(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(0), environment.at(0.0))
    states = fly(body, jax.tree.map(np.asarray, x), np.zeros(3), 1000, environment=environment)
    y = jax.vmap(lambda x, t: body.output(x, environment.at(t)))(states, np.arange(1000.0))
    assert np.abs(y).max() < 1e-11


def test_project_restores_the_quaternion_only():
    x = with_wheels().project(BodyState(np.array([2.0, 0, 0, 0]), np.ones(3), np.ones(4)))
    np.testing.assert_array_equal(x.q, [1, 0, 0, 0])
    np.testing.assert_array_equal(x.w, np.ones(3))


def test_factories_work_on_traced_numbers():
    """Inside vmap the inertia is a tracer: same numbers as outside, and no checks of values."""
    env, x = FreeSpace().at(0.0), BodyState(np.array([1.0, 0, 0, 0]), np.array([0.3, -0.2, 0.1]), np.ones(4))

    def rate(inertia):
        body = RigidBody.create(inertia, wheel_axes=PYRAMID, wheel_inertia=np.full(4, 2e-4))
        return body.derivative(x, np.ones(4) * 1e-3, env).w

    stack = np.stack([FULL, 1.1 * FULL])
    got = jax.jit(jax.vmap(rate))(stack)
    np.testing.assert_allclose(got, [rate(FULL), rate(1.1 * FULL)], rtol=1e-13)
    with pytest.raises(ScenarioError, match="float32"):
        jax.jit(rate)(jax.numpy.asarray(FULL, np.float32))


def test_numbers_are_float64_whatever_the_flag_says():
    with jax.enable_x64(False):
        body = with_wheels()
    assert {leaf.dtype for leaf in jax.tree.leaves(body)} == {np.dtype(np.float64)}


def test_three_moments_are_the_diagonal():
    moments = np.array([0.3, 0.4, 0.5])
    np.testing.assert_array_equal(RigidBody.create(moments).inertia, np.diag(moments))
    got = jax.jit(lambda m: RigidBody.create(m).inverse)(moments)
    np.testing.assert_allclose(got, np.diag(1 / moments), rtol=1e-14)


def test_moments_of_no_body_fly_when_they_are_meant():
    """A flat plate is the border; tables of dispersed moments may go beyond it."""
    RigidBody.create([0.1, 0.2, 0.3])
    with pytest.raises(ScenarioError, match="physical=False"):
        RigidBody.create([0.1, 0.2, 0.3001])
    assert RigidBody.create([1.0, 0.1, 0.1], physical=False).inertia[0, 0] == 1


@pytest.mark.parametrize("wheels", [np.zeros(3), np.zeros(0)])
def test_wrong_numbers_of_wheels_are_named(wheels):
    x = BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), wheels)
    with pytest.raises(ScenarioError, match=r"wheels of the state has shape \(.*give \(4,\)"):
        with_wheels().derivative(x, np.zeros(4), FreeSpace().at(0.0))
    with pytest.raises(ScenarioError, match=r"motor torques has shape \(3,\): give \(4,\)"):
        with_wheels().derivative(x._replace(wheels=np.zeros(4)), np.zeros(3), FreeSpace().at(0.0))


SKEW, NEGATIVE = FULL + 0.1 * np.eye(3, k=1), np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"inertia": SKEW}, "inertia must be symmetric"),
        ({"inertia": NEGATIVE}, "inertia without the rotors must be positive definite"),
        ({"inertia": np.diag([1e-4, 1.0, 1.0])}, "inertia without the rotors must be positive definite"),
        ({"inertia": np.ones(2)}, r"inertia must have shape \(3, 3\)"),
        ({"inertia": np.diag([1.0, 0.1, 0.1])}, "inertia has the principal moments 0.1, 0.1, 1 .* no body has"),
        ({"inertia": FULL * np.nan}, "inertia must be finite"),
        ({"inertia": FULL + 0j}, "inertia must be real numbers"),
        ({"wheel_axes": 2 * PYRAMID}, "wheel_axes must be unit columns"),
        ({"wheel_axes": PYRAMID.T}, "wheel_axes must have shape"),
        ({"wheel_inertia": np.full(3, 2e-4)}, "wheel_inertia must have shape"),
        ({"wheel_inertia": np.full(4, -2e-4)}, "wheel_inertia must be positive"),
        ({"wheel_inertia": None}, "come together"),
    ],
)
def test_bodies_that_cannot_exist_are_refused(change, message):
    arguments = {"inertia": FULL, "wheel_axes": PYRAMID, "wheel_inertia": np.full(4, 2e-4)} | change
    with pytest.raises(ScenarioError, match=message):
        RigidBody.create(arguments.pop("inertia"), **arguments)
