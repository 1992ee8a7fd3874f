"""Attitude algebra: quaternions, direction cosines, Euler angles; JAX functions on the last axis.

A quaternion q = [q0, q1, q2, q3] (scalar first) of frame B relative to frame O stands for the matrix that
takes the components of a vector in O to its components in B,

    A(q) = (q0^2 - q'q) I + 2 q q' - 2 q0 [q x]                       Markley and Crassidis (2014), eq. 2.125

so A(q) is the transpose of the active rotation matrix that SciPy's `Rotation` returns.
Every function takes leading batch axes and works under `jit`, `vmap` and `grad`.
"""

import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike


def cross(a: ArrayLike, b: ArrayLike) -> Array:
    """Cross product a x b, (..., 3): written out, which compiles to less than `jnp.cross`."""
    a, b = jnp.asarray(a), jnp.asarray(b)
    a1, a2, a3 = a[..., 0], a[..., 1], a[..., 2]
    b1, b2, b3 = b[..., 0], b[..., 1], b[..., 2]
    return jnp.stack([a2 * b3 - a3 * b2, a3 * b1 - a1 * b3, a1 * b2 - a2 * b1], axis=-1)


def dot(a: ArrayLike, b: ArrayLike) -> Array:
    """Inner product a . b along the last axis: (..., n), (..., n) -> (...)."""
    return jnp.sum(jnp.asarray(a) * jnp.asarray(b), axis=-1)


def cross_matrix(v: ArrayLike) -> Array:
    """Matrix [v x] with [v x] a = v x a: (..., 3) -> (..., 3, 3)."""
    v = jnp.asarray(v)
    v1, v2, v3 = v[..., 0], v[..., 1], v[..., 2]
    zero = jnp.zeros_like(v1)
    rows = [[zero, -v3, v2], [v3, zero, -v1], [-v2, v1, zero]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def dcm(q: ArrayLike) -> Array:
    """Direction cosine matrix A(q) of a unit quaternion: (..., 4) -> (..., 3, 3)."""
    q0, qv = _split(q)
    q0, square = q0[..., None], dot(qv, qv)[..., None, None]
    outer = qv[..., :, None] * qv[..., None, :]
    return (q0**2 - square) * jnp.eye(3) + 2 * outer - 2 * q0 * cross_matrix(qv)


def rotate(q: ArrayLike, v: ArrayLike) -> Array:
    """A(q) v without forming A, for a unit quaternion: (..., 4), (..., 3) -> (..., 3)."""
    q0, qv = _split(q)
    v = jnp.asarray(v)
    return v + 2 * cross(qv, cross(qv, v) - q0 * v)


def compose(b: ArrayLike, a: ArrayLike) -> Array:
    """Quaternion of the rotation a followed by b: dcm(compose(b, a)) = dcm(b) @ dcm(a), (..., 4).

    Read the frames as in matrix products: q_CA = compose(q_CB, q_BA).
    This is the Hamilton product in the opposite order, the product of Markley and Crassidis (2014), eq. 2.82.
    """
    b0, bv = _split(b)
    a0, av = _split(a)
    vector = b0 * av + a0 * bv - cross(bv, av)
    return jnp.concatenate([b0 * a0 - dot(bv, av)[..., None], vector], axis=-1)


def conjugate(q: ArrayLike) -> Array:
    """Quaternion of the opposite rotation, A(conjugate(q)) = A(q)': (..., 4) -> (..., 4)."""
    q0, qv = _split(q)
    return jnp.concatenate([q0, -qv], axis=-1)


def normalise(q: ArrayLike) -> Array:
    """Quaternion (or vector) scaled to unit length; a zero gives NaN: (..., n) -> (..., n)."""
    q = jnp.asarray(q)
    return q / jnp.sqrt(dot(q, q))[..., None]


def positive(q: ArrayLike) -> Array:
    """The same attitude with scalar part >= 0: (..., 4) -> (..., 4)."""
    q = jnp.asarray(q)
    return jnp.where(q[..., :1] < 0, -q, q)


def kinematics(q: ArrayLike, w: ArrayLike) -> Array:
    """dq/dt of the attitude q of B relative to O, when B turns at w relative to O: (..., 4), (..., 3) -> (..., 4).

    dq0 = -1/2 w.q and dq = 1/2 (q0 w + q x w), with w (rad/s) in the axes of B.
    Markley and Crassidis (2014), eq. 3.20.
    """
    q0, qv = _split(q)
    w = jnp.asarray(w)
    return 0.5 * jnp.concatenate([-dot(w, qv)[..., None], q0 * w + cross(qv, w)], axis=-1)


def angle(q: ArrayLike) -> Array:
    """Rotation angle in [0, pi] rad, of q and -q alike: (..., 4) -> (...)."""
    q0, qv = _split(q)
    return 2 * jnp.arctan2(jnp.sqrt(dot(qv, qv)), jnp.abs(q0[..., 0]))


def from_dcm(A: ArrayLike) -> Array:
    """Quaternion with scalar part >= 0 of a direction cosine matrix: (..., 3, 3) -> (..., 4).

    Each row below is 4 qi q; the one with the largest qi is the accurate one (Shepperd 1978).
    """
    A = jnp.asarray(A)
    a11, a22, a33 = A[..., 0, 0], A[..., 1, 1], A[..., 2, 2]
    s12, s13, s23 = A[..., 0, 1] + A[..., 1, 0], A[..., 0, 2] + A[..., 2, 0], A[..., 1, 2] + A[..., 2, 1]
    d1, d2, d3 = A[..., 1, 2] - A[..., 2, 1], A[..., 2, 0] - A[..., 0, 2], A[..., 0, 1] - A[..., 1, 0]
    rows = [
        [1 + a11 + a22 + a33, d1, d2, d3],
        [d1, 1 + a11 - a22 - a33, s12, s13],
        [d2, s12, 1 - a11 + a22 - a33, s23],
        [d3, s13, s23, 1 - a11 - a22 + a33],
    ]
    table = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    best = jnp.argmax(jnp.diagonal(table, axis1=-2, axis2=-1), axis=-1)
    return positive(normalise(jnp.take_along_axis(table, best[..., None, None], axis=-2)[..., 0, :]))


def from_vector(turn: ArrayLike) -> Array:
    """Quaternion of a turn by |turn| rad about the axis turn / |turn|: (..., 3) -> (..., 4), differentiable at zero.

    A body that turns at w rad/s, constant in its own axes, has after h s the attitude compose(from_vector(w h), q).
    """
    turn = jnp.asarray(turn)
    square = dot(turn, turn)
    small = square < 1e-4
    length = jnp.sqrt(jnp.where(small, 1.0, square))
    scalar = jnp.where(small, 1 - square / 8 + square**2 / 384, jnp.cos(length / 2))
    factor = jnp.where(small, 0.5 - square / 48 + square**2 / 3840, jnp.sin(length / 2) / length)
    return jnp.concatenate([scalar[..., None], factor[..., None] * turn], axis=-1)


def to_vector(q: ArrayLike) -> Array:
    """Turn of a unit quaternion the short way, of at most pi rad: (..., 4) -> (..., 3), differentiable at none."""
    q0, qv = _split(positive(q))
    q0, square = q0[..., 0], dot(qv, qv)
    small = square < 1e-8
    length = jnp.sqrt(jnp.where(small, 1.0, square))
    slope = square / jnp.where(small, q0, 1.0) ** 2
    factor = jnp.where(small, 2 / jnp.where(small, q0, 1.0) * (1 - slope / 3), 2 * jnp.arctan2(length, q0) / length)
    return factor[..., None] * qv


def from_euler(angles: ArrayLike) -> Array:
    """Quaternion of 3-2-1 Euler angles: (..., 3) roll, pitch, yaw in rad -> (..., 4).

    A = A1(roll) A2(pitch) A3(yaw): yaw about z first, then pitch about the new y, then roll about the new x.
    """
    half = 0.5 * jnp.asarray(angles)
    c1, c2, c3 = (jnp.cos(half[..., i]) for i in range(3))
    s1, s2, s3 = (jnp.sin(half[..., i]) for i in range(3))
    return jnp.stack(
        [
            c1 * c2 * c3 + s1 * s2 * s3,
            s1 * c2 * c3 - c1 * s2 * s3,
            c1 * s2 * c3 + s1 * c2 * s3,
            c1 * c2 * s3 - s1 * s2 * c3,
        ],
        axis=-1,
    )


def from_vector_part(v: ArrayLike) -> Array:
    """Quaternion with the vector part v and scalar part >= 0: (..., 3) -> (..., 4); 0 where v is longer than 1."""
    v = jnp.asarray(v)
    square = dot(v, v)[..., None]
    return jnp.concatenate([jnp.sqrt(jnp.where(square < 1, 1 - square, 0.0)), v], axis=-1)


def to_euler(q: ArrayLike) -> Array:
    """3-2-1 Euler angles of a unit quaternion: (..., 4) -> (..., 3) roll, pitch, yaw in rad.

    Pitch lies in [-pi/2, pi/2]; at its ends roll and yaw are not unique, and any roll serves, because yaw is
    read from A after roll has been undone.
    """
    A = dcm(q)
    roll = jnp.arctan2(A[..., 1, 2], A[..., 2, 2])
    pitch = jnp.arctan2(-A[..., 0, 2], jnp.hypot(A[..., 1, 2], A[..., 2, 2]))
    c, s = jnp.cos(roll), jnp.sin(roll)
    yaw = jnp.arctan2(s * A[..., 2, 0] - c * A[..., 1, 0], c * A[..., 1, 1] - s * A[..., 2, 1])
    return jnp.stack([roll, pitch, yaw], axis=-1)


def _split(q: ArrayLike) -> tuple[Array, Array]:
    """Scalar part (..., 1) and vector part (..., 3)."""
    q = jnp.asarray(q)
    return q[..., :1], q[..., 1:]
