"""Attitude control by constant gains on the quaternion: what nonlinear controllers are compared with.

    y = [q0 q1 q2 q3  wx wy wz ...]    quaternion (scalar first) of the body relative to the target frame at rest, and
                                       its rate in rad/s in body axes; what follows is not used

The command u is the torque on the body, N m. `QuaternionPid` does not use r, because y is the error already. The steps
run on NumPy arrays and inside a JAX transformation.

Reference: Markley and Crassidis (2014), Fundamentals of Spacecraft Attitude Determination and Control, section 7.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np

from synth.checks import as_flag, as_number, as_period
from synth.errors import ModelError
from synth.regulators.controller import LinearController, as_inertia, state_feedback
from synth.regulators.regulator import lqr


@dataclass(frozen=True, kw_only=True)
class QuaternionPid:
    """u = -(Kp s qv + Ki z + Kd w), dz = s qv near the target: textbook attitude control, s the sign of q0.

    Without the integral this is the regulator of Markley and Crassidis (2014), equation 7.14, which takes the short
    way round. The integral stands still while the error exceeds `zone`, so that slews do not wind it up.
    """

    Kp: np.ndarray  # (3, 3) N m
    Ki: np.ndarray  # (3, 3) N m/s
    Kd: np.ndarray  # (3, 3) N m s/rad
    zone: float  # of |qv|, the sine of half the angle
    dt: float  # s

    def init(self) -> np.ndarray:
        """The integral, (3,) s."""
        return np.zeros(3)

    def step(self, state: Any, y: Any, r: Any) -> tuple[Any, Any]:
        """(state, y, r) -> (state, u), u (3,) N m."""
        error = (1 - 2 * (y[0] < 0)) * y[1:4]
        u = -(self.Kp @ error + self.Ki @ state + self.Kd @ y[4:7])
        return state + self.dt * (error @ error <= self.zone**2) * error, u


def quaternion_pd(inertia: Any, wn: float, zeta: float, dt: float) -> QuaternionPid:
    """U = -J (2 wn^2 s qv + 2 zeta wn w): th'' + 2 zeta wn th' + wn^2 th = 0 on every axis for small angles.

    Parameters
    ----------
    inertia : (3, 3) matrix or (3,) principal moments, kg m^2
    wn : natural frequency in rad/s, positive
    zeta : damping ratio, positive
    dt : sampling time in s, positive

    Raises
    ------
    ModelError : a value is not positive, or the inertia is not symmetric positive definite.
    """
    J = as_inertia(inertia)
    wn, zeta = (as_number(name, v, "a positive number", above=0) for name, v in (("wn", wn), ("zeta", zeta)))
    return QuaternionPid(Kp=2 * wn**2 * J, Ki=np.zeros((3, 3)), Kd=2 * zeta * wn * J, zone=0.0, dt=as_period(dt))


def quaternion_pid(
    inertia: Any, wn: float, zeta: float, dt: float, *, integral_time: float, zone_deg: float = 5.0
) -> QuaternionPid:
    """`quaternion_pd` with an integral of the attitude error, gain Ki = Kp / integral_time.

    Parameters
    ----------
    inertia, wn, zeta, dt : as in `quaternion_pd`
    integral_time : s, above 1 / (2 zeta wn): up to there the loop is unstable
    zone_deg : attitude error in degrees up to which the integral runs

    Raises
    ------
    ModelError : also for an integral time that is too short.
    """
    pd = quaternion_pd(inertia, wn, zeta, dt)
    integral_time = as_number("integral_time", integral_time, "a positive time in s", above=0)
    zone_deg = as_number("zone_deg", zone_deg, "a positive angle in degrees", above=0)
    if integral_time <= 1 / (2 * zeta * wn):
        raise ModelError(
            f"integral_time is {integral_time} s; pass more than 1 / (2 zeta wn) = {1 / (2 * zeta * wn):.6g} s, "
            "which the loop needs to be stable"
        )
    return QuaternionPid(
        Kp=pd.Kp, Ki=pd.Kp / integral_time, Kd=pd.Kd, zone=float(np.sin(np.deg2rad(zone_deg) / 2)), dt=pd.dt
    )  # fmt: skip


@overload
def quaternion_lqr(
    inertia: Any, dt: float, *, Q: Any = None, R: Any = None, short_way: Literal[False] = False
) -> LinearController: ...
@overload
def quaternion_lqr(
    inertia: Any, dt: float, *, Q: Any = None, R: Any = None, short_way: Literal[True]
) -> QuaternionPid: ...
def quaternion_lqr(
    inertia: Any, dt: float, *, Q: Any = None, R: Any = None, short_way: bool = False
) -> LinearController | QuaternionPid:
    """The constant gain u = -K [qv; w] of the model linearised at the target; from q0 < 0 it goes the long way round.

    Parameters
    ----------
    inertia : (3, 3) matrix or (3,) principal moments, kg m^2
    dt : sampling time in s, positive
    Q : (6, 6) weight of [qv; w], symmetric positive semidefinite; identity when left out
    R : (3, 3) weight of u, symmetric positive definite; identity when left out
    short_way : the same gain on [s qv; w] with s the sign of q0: never round the long way, and no longer linear

    Returns
    -------
    LinearController, or with `short_way` QuaternionPid without an integral : on the measurement of
        `synth.regulators.sdc`, y and r (10,), with r zero

    Raises
    ------
    ModelError : an inertia, weight or period that is none.
    AssumptionError : Q does not see the attitude.
    """
    O = np.zeros((3, 3))
    A, B = np.block([[O, np.eye(3) / 2], [O, O]]), np.vstack([O, np.linalg.inv(as_inertia(inertia))])
    K, _, _ = lqr(A, B, np.eye(6) if Q is None else Q, np.eye(3) if R is None else R)
    if as_flag("short_way", short_way):
        return QuaternionPid(Kp=K[:, :3], Ki=O, Kd=K[:, 3:], zone=0.0, dt=as_period(dt))
    return state_feedback(np.hstack([np.zeros((3, 1)), K, O]), as_period(dt))
