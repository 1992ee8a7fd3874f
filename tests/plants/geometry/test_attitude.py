"""The attitude algebra against scipy's Rotation, whose matrix is the transpose of A(q)."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from plants.geometry import attitude

TIGHT = dict(rtol=0, atol=5e-15)  # a handful of roundings of numbers of size one


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def unit(n):
    numbers = arrays(float, n, elements=st.floats(-1, 1, allow_subnormal=False))
    return numbers.filter(lambda v: np.linalg.norm(v) > 1e-2).map(lambda v: v / np.linalg.norm(v))


quaternions, vectors = unit(4), arrays(float, 3, elements=st.floats(-3, 3, allow_subnormal=False))
fast = settings(max_examples=60, deadline=None)


def scipy_matrix(q):
    return Rotation.from_quat(q, scalar_first=True).as_matrix().T


@fast
@given(quaternions, vectors)
def test_dcm_and_rotate_are_the_transpose_of_scipys_matrix(q, v):
    np.testing.assert_allclose(attitude.dcm(q), scipy_matrix(q), **TIGHT)
    np.testing.assert_allclose(attitude.rotate(q, v), scipy_matrix(q) @ v, rtol=0, atol=3e-14)


@fast
@given(quaternions, quaternions)
def test_compose_multiplies_the_matrices_in_the_written_order(b, a):
    np.testing.assert_allclose(attitude.dcm(attitude.compose(b, a)), scipy_matrix(b) @ scipy_matrix(a), **TIGHT)
    back = attitude.compose(attitude.conjugate(b), attitude.compose(b, a))
    np.testing.assert_allclose(back, a, **TIGHT)


@fast
@given(quaternions)
def test_from_dcm_returns_the_quaternion_with_positive_scalar(q):
    got = np.asarray(attitude.from_dcm(scipy_matrix(q)))
    assert got[0] >= 0
    np.testing.assert_allclose(got * np.sign(got @ q), q, **TIGHT)


@pytest.mark.parametrize("q", np.vstack([np.eye(4), -np.eye(4)]))
def test_from_dcm_at_half_turns(q):
    got = np.asarray(attitude.from_dcm(scipy_matrix(q)))
    np.testing.assert_allclose(np.abs(got), np.abs(q), **TIGHT)


@fast
@given(arrays(float, 3, elements=st.floats(-1.5, 1.5, allow_subnormal=False)))
def test_euler_angles_are_scipys_intrinsic_zyx(angles):
    q = attitude.from_euler(angles)
    expected = Rotation.from_euler("ZYX", angles[::-1]).as_matrix().T
    np.testing.assert_allclose(attitude.dcm(q), expected, **TIGHT)
    np.testing.assert_allclose(attitude.to_euler(q), angles, rtol=0, atol=1e-13)


def test_euler_angles_at_gimbal_lock_are_finite_and_describe_the_attitude():
    q = attitude.from_euler([0.3, np.pi / 2, -0.2])
    angles = attitude.to_euler(q)
    assert np.isfinite(angles).all()
    np.testing.assert_allclose(attitude.dcm(attitude.from_euler(angles)), attitude.dcm(q), **TIGHT)


@fast
@given(quaternions)
def test_angle_is_the_magnitude_of_the_rotation_vector(q):
    expected = Rotation.from_quat(q, scalar_first=True).magnitude()
    np.testing.assert_allclose(attitude.angle(q), expected, rtol=0, atol=2e-15)
    np.testing.assert_array_equal(attitude.angle(-q), attitude.angle(q))


def test_angle_keeps_small_angles():
    q = attitude.from_euler([1e-9, 0, 0])
    np.testing.assert_allclose(attitude.angle(q), 1e-9, rtol=1e-14)


@fast
@given(quaternions, vectors)
def test_kinematics_obey_the_derivative_of_the_matrix(q, w):
    """dA/dt = -[w x] A: the frame turns at w, so fixed vectors turn at -w in its axes."""
    _, rate = jax.jvp(attitude.dcm, (q,), (attitude.kinematics(q, w),))
    np.testing.assert_allclose(rate, -attitude.cross_matrix(w) @ attitude.dcm(q), rtol=0, atol=2e-14)


@fast
@given(vectors, vectors)
def test_cross_and_its_matrix(a, b):
    np.testing.assert_allclose(attitude.cross(a, b), np.cross(a, b), **TIGHT)
    np.testing.assert_allclose(attitude.cross_matrix(a) @ b, np.cross(a, b), **TIGHT)


def test_batches_equal_single_calls_and_vmap():
    rng = np.random.default_rng(1)
    q, p = (x / np.linalg.norm(x, axis=-1, keepdims=True) for x in rng.normal(size=(2, 2, 5, 4)))
    v = rng.normal(size=(2, 5, 3))
    table = [
        (attitude.rotate, (q, v)), (attitude.compose, (q, p)), (attitude.kinematics, (q, v)),
        (attitude.dcm, (q,)), (attitude.to_euler, (q,)), (attitude.from_euler, (v,)), (attitude.angle, (q,)),
        (lambda x: attitude.from_dcm(attitude.dcm(x)), (q,)), (attitude.positive, (q,)),
    ]  # fmt: skip
    for function, arguments in table:
        batched = function(*arguments)
        mapped = jax.vmap(jax.vmap(function))(*arguments)
        single = function(*(a[1, 3] for a in arguments))
        np.testing.assert_allclose(batched, mapped, **TIGHT)
        np.testing.assert_allclose(batched[1, 3], single, **TIGHT)


def test_normalise():
    np.testing.assert_allclose(attitude.normalise([0.0, 3.0, 0.0, 4.0]), [0, 0.6, 0, 0.8], **TIGHT)
