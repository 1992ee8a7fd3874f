"""The body in Euler angles: kinematics against quaternions, conserved momentum, linear models, the singularity."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plants.dynamics.eulerbody import EulerBody, EulerState, RandomTorque, TorqueEnv, check_pitch, kinematics
from plants.errors import ScenarioError, SingularityError
from plants.geometry import attitude
from plants.simulation.linearize import linearize
from plants.simulation.simulate import Loop, Scenario, simulate_many

INERTIA = np.array([[1.17, 0.02, -0.01], [0.02, 1.3, 0.03], [-0.01, 0.03, 0.9]])  # kg m^2, no symmetry
WHEELS = np.array([0.0018, 0.002, 0.0015])  # kg m^2
BODY = EulerBody.create(INERTIA, wheel_inertia=WHEELS)
CALM = RandomTorque.create(0.0, period=1.0, duration=10.0, seed=0)
STILL = TorqueEnv(np.zeros(3))


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@dataclass(frozen=True, kw_only=True)
class Held:
    """Always the same torque."""

    dt: float
    command: np.ndarray

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, self.command


def random_states(count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        angles = rng.uniform(-1, 1, 3) * [3.0, 1.4, 3.0]
        yield EulerState(angles, rng.uniform(-1, 1, 3), rng.uniform(-300, 300, 3)), rng.uniform(-1, 1, 3)


def test_kinematics_are_those_of_the_quaternion():
    for x, _ in random_states(20):
        _, dq = jax.jvp(attitude.from_euler, (x.angles,), (kinematics(x.angles) @ x.w,))
        expected = attitude.kinematics(attitude.from_euler(x.angles), x.w)
        np.testing.assert_allclose(dq, expected, rtol=0, atol=1e-13)


def test_pseudolinear_form_is_the_dynamics():
    for x, u in random_states(20):
        A, B = BODY.pseudolinear(x.angles, x.w, x.wheels)
        push = TorqueEnv(u[::-1])
        d = BODY.derivative(x, u, push)
        expected = A @ np.concatenate([x.angles, x.w]) + B @ (push.torque - u)
        np.testing.assert_allclose(np.concatenate([d.angles, d.w]), expected, rtol=0, atol=1e-12)


def test_linear_model_at_rest_is_the_printed_one():
    """A = [[0, E], [0, I^-1 [h x]]], B = [0; -I^-1] for the torque on the wheels."""
    angles, speeds = np.radians([50, 20, -30]), np.array([100.0, -50, 200])
    model = linearize(BODY, EulerState(angles, np.zeros(3), speeds), np.zeros(3), CALM)
    h, I = WHEELS * speeds, np.linalg.inv(INERTIA)
    (s1, s2, _), (c1, c2, _) = np.sin(angles), np.cos(angles)
    E = np.array([[1, s1 * s2 / c2, c1 * s2 / c2], [0, c1, -s1], [0, s1 / c2, c1 / c2]])
    np.testing.assert_allclose(model.A[:3, 3:6], E, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.A[3:6, 3:6], I @ np.cross(h, np.eye(3)).T, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.A[:, :3], 0, atol=1e-14)
    np.testing.assert_allclose(model.B, np.vstack([np.zeros((3, 3)), -I, np.eye(3)]), rtol=0, atol=1e-14)


@pytest.fixture(scope="module")
def flown():
    """Twenty seconds of tumbling while the wheels spin up, and a pitch that goes on."""
    loop = Loop(plant=BODY, controller=Held(dt=0.1, command=np.array([0.01, -0.02, 0.015])))
    starts = (
        EulerState(np.array([0.3, -0.2, 1.0]), np.array([0.05, -0.04, 0.08]), np.array([100.0, -50, 200])),
        EulerState(np.array([0.0, 1.4, 0.0]), np.array([0.0, 0.3, 0.0]), np.zeros(3)),
    )
    return simulate_many([(loop, Scenario(initial=x, dt=0.1, periods=200, steps=4, environment=CALM)) for x in starts])


def test_momentum_is_conserved(flown):
    x = flown[0].states
    body = x.w @ INERTIA.T + WHEELS * x.wheels
    inertial = Rotation.from_euler("ZYX", x.angles[:, ::-1]).apply(body)
    assert np.ptp(x.wheels[:, 0]) > 100
    np.testing.assert_allclose(inertial, np.broadcast_to(inertial[0], inertial.shape), rtol=0, atol=1e-9)


def test_the_singularity_ends_a_run(flown):
    run = flown[1]
    assert not run.ok
    assert run.culprit == "plant"
    assert run.failed_at == pytest.approx(run.time[-1] + 0.1)
    assert 86 < np.degrees(run.outputs[-1, 1]) < 90
    assert np.isfinite(run.outputs).all()


@pytest.mark.parametrize("pitch", [89.6, 90.0, -90.0, 120.0])
def test_the_singularity_is_an_error_outside_of_loops(pitch):
    angles = np.radians([10.0, pitch, 20.0])
    x = EulerState(angles, np.zeros(3), np.zeros(3))
    for refused in (
        lambda: kinematics(angles),
        lambda: BODY.derivative(x, np.zeros(3), STILL),
        lambda: check_pitch("angles", angles),
    ):
        with pytest.raises(SingularityError, match=f"angles has the pitch {pitch:g} deg.*quaternion"):
            refused()
    assert np.isnan(jax.jit(kinematics)(angles)).any()


def test_random_torque():
    push = RandomTorque.create(2.0, period=0.1, duration=500.0, seed=3)
    assert push.torque.shape == (5001, 3)
    np.testing.assert_allclose(push.torque.std(axis=0), 2.0, rtol=0.05)
    np.testing.assert_allclose(push.at(0.25).torque, (push.torque[2] + push.torque[3]) / 2, rtol=1e-9)
    np.testing.assert_array_equal(push.at(1e4).torque, push.torque[-1])
    np.testing.assert_array_equal(push.torque, RandomTorque.create(2.0, period=0.1, duration=500.0, seed=3).torque)


def test_what_is_refused():
    with pytest.raises(ScenarioError, match="symmetric positive definite"):
        EulerBody.create(np.diag([1.0, -1, 1]), wheel_inertia=WHEELS)
    with pytest.raises(ScenarioError, match="which no body has"):
        EulerBody.create([1.0, 0.1, 0.1], wheel_inertia=WHEELS)
    with pytest.raises(ScenarioError, match="wheel_inertia must be positive"):
        EulerBody.create(INERTIA, wheel_inertia=np.zeros(3))
    with pytest.raises(ScenarioError, match="period = 0"):
        RandomTorque.create(1.0, period=0.0, duration=1.0, seed=0)
