"""The CubeSat's predictive controllers of table 3: model, weights and limits, and a linear loop to fly them in."""

import numpy as np
from literature import cubesat_model

TORQUE, MOMENTUM, RATE = 1e-3, 10.8e-3, np.radians(2)  # N m, N m s, rad/s
FORMS = ("position", "velocity")
MODEL = cubesat_model()
FREE = [np.inf] * 3
TABLE_3 = {"Q": 1000 * np.eye(6), "R": 1000 * np.eye(3), "Np": 10, "Nc": 7, "umin": -TORQUE, "umax": TORQUE}
SOFT = {"ymin": [-np.inf] * 3 + [-RATE] * 3, "ymax": FREE + [RATE] * 3, "hmax": MOMENTUM}
REST = np.zeros(6)


def random_case(controller, rng, size):
    """A measurement about `size` rad from rest, with a history that violates the soft limits when `size` is large."""
    x = size * rng.uniform(-1, 1, 6) * [1, 1, 1, 0.4, 0.4, 0.4]
    state = controller.init()
    return x, state._replace(
        prediction=x + 1e-3 * size * rng.standard_normal(6) if controller.problem.form == "velocity" else None,
        inputs=rng.uniform(-TORQUE, TORQUE, state.inputs.shape),
        momentum=1.2 * MOMENTUM * min(1, 3 * size) * rng.uniform(-1, 1, 3),
    )


def fly(controller, x, periods, disturbance=0.0):
    """The linear loop from x: states (periods + 1, 6), commands (periods, 3) and the last controller state."""
    state, X, U = controller.init(), [np.asarray(x, dtype=float)], []
    for _ in range(periods):
        state, u = controller.step(state, X[-1], REST)
        X.append(MODEL.A @ X[-1] + MODEL.B @ (u + disturbance))
        U.append(u)
    return np.array(X), np.array(U), state
