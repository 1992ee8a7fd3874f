"""Linear models: equation 12 of Pecorilla and Stesina (2024), wheels, and a plant of another kind."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.missions import cubesat3u
from plants.simulation.linearize import linearize
from plants.surroundings import orbit
from plants.surroundings.disturbances import GravityGradient
from plants.surroundings.environment import CircularEnvironment, FreeSpace

ORBIT = orbit.circular(470e3, np.deg2rad(51.6), 2.0, 0.4)
NADIR = CircularEnvironment.along(ORBIT)
RATE = np.sqrt(orbit.MU / (orbit.EARTH_RADIUS + 470e3) ** 3)
INERTIA = np.array([0.05, 0.06, 0.02])  # three different moments
SPIN = 1.7e-5


def equation_12(total, rest=None):
    """A and B as printed; `rest` is the inertia that resists a torque, where it is not the total."""
    (x, y, z), (rx, ry, rz), w = total, total if rest is None else rest, RATE
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3) / 2
    A[3, 0], A[4, 1], A[5, 2] = -8 * w**2 * (y - z) / rx, -6 * w**2 * (x - z) / ry, -2 * w**2 * (y - x) / rz
    A[3, 5], A[5, 3] = w * (z + rx - y) / rx, -w * (rz + x - y) / rz
    return A, np.vstack([np.zeros((3, 3)), np.diag(1 / np.array([rx, ry, rz]))])


def body(**changes):
    return RigidBody.create(np.diag(INERTIA), disturbances=(GravityGradient(),), **changes)


def nadir(t=0.0, wheels=(), environment=NADIR):
    with jax.enable_x64(True):
        x = state_from(np.array([1.0, 0, 0, 0]), np.zeros(3), np.array(wheels, float), environment.at(t))
        return jax.tree.map(np.asarray, x)


@pytest.mark.parametrize("t", [0.0, 2345.0])
def test_equation_12(t):
    A, B = equation_12(INERTIA)
    model = linearize(body(), nadir(t), np.zeros(3), NADIR, t=t)
    np.testing.assert_allclose(model.A, A, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.B, B, rtol=1e-14, atol=1e-14)
    np.testing.assert_array_equal(model.C, np.eye(6))
    np.testing.assert_array_equal(model.D, np.zeros((6, 3)))


def test_equation_12_is_the_design_model_of_the_study():
    x, y, z = cubesat3u.INERTIA
    model = cubesat3u.continuous_model()
    A, B = equation_12([x, y, z])
    np.testing.assert_allclose(model.A, A, rtol=0, atol=1e-14)
    np.testing.assert_allclose(model.B, B, rtol=1e-14, atol=1e-14)


def test_wheels_at_rest_take_their_spin_inertia_from_the_body():
    """Euler's equation in full: I w on the right, I - Js on the left; the input acts on the wheels."""
    wheels = {"wheel_axes": np.eye(3), "wheel_inertia": np.full(3, SPIN)}
    model = linearize(body(**wheels), nadir(wheels=[0, 0, 0]), np.zeros(3), NADIR, hold=("wheels",))
    rest = INERTIA - SPIN
    np.testing.assert_allclose(model.B[3:], -np.diag(1 / rest), rtol=1e-14, atol=1e-13)
    A, _ = equation_12(INERTIA)
    np.testing.assert_allclose(model.A, A, rtol=0, atol=2 * RATE * SPIN / INERTIA.min())
    # drift of w_OB at attitude q by hand: w = w_OB + A(q) w_O with A = I - 2[q x] to first order
    x, y, z = INERTIA
    assert model.A[3, 0] == pytest.approx(-8 * RATE**2 * (y - z) / rest[0], rel=1e-9)
    assert model.A[4, 1] == pytest.approx(-6 * RATE**2 * (x - z) / rest[1], rel=1e-9)
    assert model.A[3, 5] == pytest.approx(RATE * (1 + (z - y) / rest[0]), rel=1e-9)
    assert model.A[5, 3] == pytest.approx(-RATE * (1 + (x - y) / rest[2]), rel=1e-9)


def test_wheel_momentum_adds_its_gyroscopic_torque():
    """dw += (I - Js)^-1 [hw x] (w + Wq q), Wq(1,3) = -2 w0, Wq(3,1) = 2 w0."""
    hw = np.array([0.3e-3, -0.2e-3, 0.5e-3])  # N m s
    plant = body(wheel_axes=np.eye(3), wheel_inertia=np.full(3, SPIN))
    still, spinning = (
        linearize(plant, nadir(wheels=speeds), np.zeros(3), NADIR, hold=("wheels",)).A
        for speeds in (np.zeros(3), hw / SPIN)
    )
    Wq = np.zeros((3, 3))
    Wq[0, 2], Wq[2, 0] = -2 * RATE, 2 * RATE
    gyroscopic = np.diag(1 / (INERTIA - SPIN)) @ np.cross(hw, np.eye(3)).T
    np.testing.assert_allclose(spinning - still, np.vstack([np.zeros((3, 6)), gyroscopic @ np.hstack([Wq, np.eye(3)])]),
                               rtol=0, atol=1e-15)  # fmt: skip


def test_against_differences_of_the_output_off_nadir():
    """A by central differences of d/dt of the output, at an attitude and a rate far from nadir."""
    plant = body()
    with jax.enable_x64(True):
        q, w = attitude.from_euler([0.4, -0.3, 0.7]), np.array([0.01, -0.02, 0.005])

        @jax.jit
        def rate(y):
            scalar = jnp.sqrt(1 - y[:3] @ y[:3])
            x = state_from(jnp.concatenate([scalar[None], y[:3]]), y[3:], jnp.zeros(0), NADIR.at(50.0))
            slope = plant.derivative(x, np.zeros(3), NADIR.at(50.0))
            return jax.jvp(lambda x, t: plant.output(x, NADIR.at(t)), (x, 50.0), (slope, 1.0))[1]

        y = np.concatenate([q[1:], w])
        step = 1e-6
        A = np.stack([(rate(y + step * e) - rate(y - step * e)) / (2 * step) for e in np.eye(6)], axis=1)
        x = jax.tree.map(np.asarray, state_from(q, w, np.zeros(0), NADIR.at(50.0)))
    model = linearize(plant, x, np.zeros(3), NADIR, t=50.0)
    np.testing.assert_allclose(model.A, A, rtol=0, atol=1e-9)


class Swing(NamedTuple):
    angle: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True)
class Pendulum:
    """A plant as a user would write it."""

    length: float = 2.0
    complete: bool = True

    def derivative(self, x, u, env):
        return Swing(x.rate, -9.81 / self.length * jnp.sin(x.angle) + u[0])

    def output(self, x, env):
        return jnp.stack([x.angle, x.rate] if self.complete else [x.angle])

    def project(self, x):
        return x


def test_a_pendulum_hanging_and_inverted():
    for angle, sign in ((0.0, -1), (np.pi, 1)):
        model = linearize(Pendulum(), Swing(angle, 0.0), [0.0], FreeSpace())
        np.testing.assert_allclose(model.A, [[0, 1], [sign * 9.81 / 2, 0]], atol=1e-15)
        np.testing.assert_allclose(model.B, [[0], [1]], atol=1e-15)


def test_outputs_that_do_not_determine_the_state_are_refused():
    with pytest.raises(ScenarioError, match="must determine the state's 2 degrees of freedom"):
        linearize(Pendulum(complete=False), Swing(0.0, 0.0), [0.0], FreeSpace())
    plant = body(wheel_axes=np.eye(3), wheel_inertia=np.full(3, SPIN))
    with pytest.raises(ScenarioError, match="9 degrees of freedom"):
        linearize(plant, nadir(wheels=[0, 0, 0]), np.zeros(3), NADIR)


def test_bad_arguments_are_refused():
    with pytest.raises(ScenarioError, match="hold names"):
        linearize(body(), nadir(), np.zeros(3), NADIR, hold=("gimbals",))
    with pytest.raises(ScenarioError, match="w must be finite"):
        linearize(body(), nadir()._replace(w=np.full(3, np.nan)), np.zeros(3), NADIR)
    with pytest.raises(ScenarioError, match="no finite slope"):  # gravity gradient without an orbit
        linearize(body(), BodyState(np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(0)), np.zeros(3), FreeSpace())


def test_the_precision_flag_of_the_user_stays():
    with jax.enable_x64(False):
        model = linearize(body(), nadir(), np.zeros(3), NADIR)
        assert jnp.zeros(1).dtype == np.float32
    assert {type(M) for M in model} == {np.ndarray}
    assert {M.dtype for M in model} == {np.dtype(np.float64)}
