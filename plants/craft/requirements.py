"""First weights of a design from what is required of a spacecraft: how well it points, and how fast it answers.

A body of inertia J whose attitude answers with the bandwidth b (rad/s) turns back an error p (rad) with the torque
J b^2 p. So p, p b and J b^2 p are the units in which the plant from torque to [half angle; rate] is of size one at its
bandwidth. In these units the four-block problem asks for the smallest of the gang of four together, which is the
robust stabilisation of the normalised coprime factors of the scaled plant: McFarlane and Glover (1992), IEEE TAC 37,
759. For integral action the unit of the torque rises below a tenth of the bandwidth: the disturbance there is larger,
and effort costs less.
"""

from typing import Any

import numpy as np

from plants.checks import positive
from plants.errors import ScenarioError

INTEGRAL = 0.1  # () of the bandwidth, below which the unit of the torque rises
FASTEST = 0.5  # () bandwidth times sampling time
FLAT = 1e-3  # () of that, below which it is flat again: no pole on the boundary


def weights(
    inertia: np.ndarray, dt: float, torque: float, pointing: float, bandwidth: float, integral: bool
) -> dict[str, Any]:
    """Weights of a four-block problem in discrete time.

    Parameters
    ----------
    inertia : (3, 3) kg m^2
    dt : () s
    torque : () N m, that can be given about every axis
    pointing : () rad, error that is allowed
    bandwidth : () rad/s, of the attitude
    integral : whether a constant torque is to leave no error

    Returns
    -------
    dict : Wdist, Wnoise (6,), Wout (6,), Wact, for `GeneralizedPlant.four_block`; the first and the last are matrices
        (3, 3), or with integral action systems (A, B, C, D, dt)

    Raises
    ------
    ScenarioError
        Numbers that are not positive; a bandwidth that the sampling or the torque does not allow.
    """
    effort, errors = _units(inertia, torque, pointing, bandwidth)
    if bandwidth * dt > FASTEST:
        raise ScenarioError(
            f"bandwidth = {bandwidth:g} rad/s is too fast for dt = {dt:g} s: stay below {FASTEST / dt:.3g} rad/s, or "
            "sample faster"
        )
    corner = INTEGRAL * bandwidth
    direct = (1 + corner * dt / 2) / (1 + FLAT * corner * dt / 2)
    pole, zero, undo = _mapped(FLAT * corner, dt), _mapped(corner, dt), np.linalg.inv(effort)
    return {
        "Wdist": _first_order(effort, direct, pole, zero, dt) if integral else effort,
        "Wnoise": errors.tolist(),
        "Wout": (1 / errors).tolist(),
        "Wact": _first_order(undo, 1 / direct, zero, pole, dt) if integral else undo,
    }


def costs(inertia: np.ndarray, torque: float, pointing: float, bandwidth: float) -> dict[str, Any]:
    """Weights and limits of a predictive controller in the same units: Q (6, 6), R (3, 3), umin, umax () N m.

    Raises
    ------
    ScenarioError
        As `weights`.
    """
    effort, errors = _units(inertia, torque, pointing, bandwidth)
    scaled = np.linalg.inv(effort)
    limits = {"umin": -torque, "umax": torque} if np.isfinite(torque) else {}
    return {"Q": np.diag(errors**-2.0), "R": scaled.T @ scaled, **limits}


def _units(inertia: np.ndarray, torque: float, pointing: float, bandwidth: float) -> tuple[np.ndarray, np.ndarray]:
    """Torques (3, 3) N m and outputs (6,) of size one."""
    p, b = float(positive("pointing", pointing)), float(positive("bandwidth", bandwidth))
    if p > np.pi:
        raise ScenarioError(f"pointing = {p:g} rad is more than half a turn: give radians")
    effort = p * b**2 * np.asarray(inertia, float)
    needed = float(np.linalg.eigvalsh(effort)[-1])
    if needed > torque:
        raise ScenarioError(
            f"bandwidth = {b:g} rad/s takes {needed:.3g} N m for an error of {p:g} rad, and there are {torque:.3g} "
            f"N m: stay below {b * np.sqrt(torque / needed):.3g} rad/s"
        )
    return effort, np.repeat([p / 2, p * b], 3)


def _mapped(corner: float, dt: float) -> float:
    """The pole or zero at -corner () rad/s by the bilinear transform."""
    return (2 - corner * dt) / (2 + corner * dt)


def _first_order(gain: np.ndarray, direct: float, pole: float, zero: float, dt: float) -> tuple[Any, ...]:
    """Gain (3, 3) times direct (z - zero) / (z - pole) in every channel: (A, B, C, D, dt)."""
    return pole * np.eye(3), np.eye(3), (pole - zero) * direct * gain, direct * gain, dt
