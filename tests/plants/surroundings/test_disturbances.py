"""Disturbance torques against first principles: masses that fall, plates that are hit."""

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.surroundings.disturbances import (
    EARTH_RATE,
    SOLAR_PRESSURE,
    ConstantTorque,
    Drag,
    GravityGradient,
    ResidualDipole,
    Seen,
    SolarPressure,
    seen_from,
)
from plants.surroundings.environment import OrbitEnv
from plants.surroundings.orbit import MU

SIZE, OFFSET = np.array([0.1, 0.2, 0.34]), np.array([0.005, -0.004, 0.02])
RANDOM = np.random.default_rng(3)


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def unit(v):
    return v / np.linalg.norm(v)


def surroundings(**known):
    """Seen with NaN where a torque should not look."""
    empty = Seen(*(np.full(n, np.nan) for n in (3, 3, 3, 3)), sunlit=np.nan, density=np.nan)
    return empty._replace(**known)


def on_plates(direction):
    """Sum over the six faces of (projected area that is hit) x (centre from the centre of mass) x direction."""
    torque = np.zeros(3)
    for axis in range(3):
        for sign in (1.0, -1.0):
            face = sign * np.eye(3)[axis]
            area = np.prod(SIZE) / SIZE[axis] * max(face @ direction, 0.0)
            torque += area * np.cross(face * SIZE[axis] / 2 - OFFSET, -direction)
    return torque


@pytest.mark.parametrize("direction", [unit(v) for v in RANDOM.normal(size=(4, 3))])
def test_drag_and_solar_pressure_are_sums_over_plates(direction):
    drag = Drag.create(SIZE, OFFSET, 2.2)
    got = drag.torque(surroundings(wind=7600.0 * direction, density=1e-12), None)
    np.testing.assert_allclose(got, 0.5 * 1e-12 * 2.2 * 7600.0**2 * on_plates(direction), rtol=1e-12)
    pressure = SolarPressure.create(SIZE, OFFSET, 1.3)
    got = pressure.torque(surroundings(sun=direction, sunlit=0.25), None)
    np.testing.assert_allclose(got, 0.25 * SOLAR_PRESSURE * 1.3 * on_plates(direction), rtol=1e-12)
    np.testing.assert_array_equal(pressure.torque(surroundings(sun=direction, sunlit=0.0), None), np.zeros(3))


def test_gravity_gradient_is_the_torque_on_falling_masses():
    """Six point masses, Newton's law on each; the formula is the first order in size over distance."""
    turn = Rotation.random(rng=4).as_matrix()
    arms = np.vstack([np.diag([0.9, 0.5, 0.2]), -np.diag([0.9, 0.5, 0.2])]) @ turn.T
    r = 6.9e6 * unit(RANDOM.normal(size=3))
    inertia, torque = np.zeros((3, 3)), np.zeros(3)
    for arm in arms:
        inertia += 2.0 * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        relative = 1 + 2 * r @ arm / (r @ r) + arm @ arm / (r @ r)
        shortfall = np.expm1(-1.5 * np.log1p(relative - 1))  # of |r + arm|^-3, without cancellation
        torque += 2.0 * np.cross(arm, -MU / np.linalg.norm(r) ** 3 * shortfall * r)
    got = GravityGradient().torque(surroundings(r=r), inertia)
    assert np.linalg.norm(got) > 1e-7
    np.testing.assert_allclose(got, torque, rtol=0, atol=1e-6 * np.linalg.norm(got))


def test_dipole_turns_towards_the_field():
    got = ResidualDipole.create([1e-2, 0, 0]).torque(surroundings(B=np.array([0, 3e-5, 0])), None)
    np.testing.assert_allclose(got, [0, 0, 3e-7], rtol=1e-15)


def test_constant_torque():
    vector = np.array([1e-7, -2e-7, 0])
    np.testing.assert_array_equal(ConstantTorque.create(vector).torque(surroundings(), None), vector)


def test_surroundings_are_seen_in_body_axes_and_the_air_turns_with_the_earth():
    q = Rotation.random(rng=5)
    A = q.as_matrix().T
    vectors = RANDOM.normal(size=(4, 3))
    env = OrbitEnv(*vectors, sunlit=0.5, density=2e-12, q_ON=np.full(4, np.nan), w_ON=np.full(3, np.nan))
    seen = seen_from(q.as_quat(scalar_first=True), env)
    for got, expected in zip((seen.r, seen.B, seen.sun), vectors[[0, 2, 3]], strict=True):
        np.testing.assert_allclose(got, A @ expected, rtol=0, atol=1e-14)
    wind = vectors[1] - np.cross([0, 0, EARTH_RATE], vectors[0])
    np.testing.assert_allclose(seen.wind, A @ wind, rtol=0, atol=1e-14)
    assert (seen.sunlit, seen.density) == (0.5, 2e-12)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: ResidualDipole.create([1.0, 2.0]), r"moment must have shape \(3,\)"),
        (lambda: ResidualDipole.create([1.0, 2.0, np.nan]), "moment must be finite"),
        (lambda: Drag.create([0.1, 0.1, -0.3], OFFSET, 2.2), "size must be at least 0"),
        (lambda: Drag.create(SIZE, OFFSET, -1.0), "coefficient must be at least 0"),
        (lambda: SolarPressure.create(SIZE, "here", 1.3), "mass_centre must be real numbers"),
        (lambda: ConstantTorque.create(1.0), "vector must have shape"),
    ],
)
def test_bad_numbers_are_refused(build, message):
    with pytest.raises(ScenarioError, match=message):
        build()
