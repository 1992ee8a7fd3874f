"""First weights from requirements: a good design for every body and unit, and refusals that say what would do."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import synth
from plants.craft.requirements import FASTEST, costs, weights
from plants.errors import ScenarioError

POINTING = np.radians(0.1)


def double_integrator(inertia, dt):
    """From a torque to [half angle; rate], with the gravity gradient of a low orbit as a stiffness of either sign."""
    A = np.block([[np.zeros((3, 3)), np.eye(3) / 2], [np.diag([-2e-6, 1e-6, -5e-7]), np.zeros((3, 3))]])
    B = np.vstack([np.zeros((3, 3)), np.linalg.inv(inertia)])
    return synth.c2d((A, B, np.eye(6), np.zeros((6, 3))), dt)


@settings(deadline=None, max_examples=12)
@given(
    st.floats(-3, 4), st.floats(0.5, 1.0), st.floats(0.3, 1.0), st.floats(-1, 1), st.floats(0.02, 0.2),
    st.booleans(), st.floats(-4, -1),
)  # fmt: skip
def test_designs_have_margins_whatever_the_body(size, two, three, skew, speed, integral, pointing):
    """Micro- to heavy satellites: what counts is the bandwidth times the sampling time."""
    inertia = 10.0**size * (np.diag([1.0, two, three]) + 0.1 * skew * np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]))
    dt = 1.0
    G = double_integrator(inertia, dt)
    given_weights = weights(inertia, dt, np.inf, 10.0**pointing, speed, integral)
    design = synth.hinfsyn(synth.GeneralizedPlant.four_block(G, **given_weights))
    assert design.gamma < 3
    assert design.margins.gain_db > 10


def test_integral_action_takes_a_constant_torque_away():
    inertia, dt, speed = np.diag([0.12, 0.11, 0.05]), 1.0, 0.1
    G = double_integrator(inertia, dt)
    torque = np.array([1e-6, -1e-6, 5e-7])
    errors = []
    for integral in (False, True):
        K = synth.hinfsyn(
            synth.GeneralizedPlant.four_block(G, **weights(inertia, dt, 1.0, POINTING, speed, integral))
        ).as_controller()
        x, s = np.zeros(6), K.init()
        for _ in range(3000):
            s, u = K.step(s, G.C @ x, np.zeros(6))
            x = G.A @ x + G.B @ (u + torque)
        errors.append(2 * np.linalg.norm((G.C @ x)[:3]))
    assert errors[0] > 1e-4
    assert errors[1] < 1e-2 * errors[0]


def test_the_costs_of_mpc_have_the_same_units():
    inertia = np.diag([0.12, 0.11, 0.05])
    told = costs(inertia, 3e-3, POINTING, 0.1)
    unit = POINTING * 0.1**2 * inertia @ np.ones(3)
    assert unit @ told["R"] @ unit == pytest.approx(3)
    y = np.repeat([POINTING / 2, POINTING * 0.1], 3)
    assert y @ told["Q"] @ y == pytest.approx(6)
    assert told["umax"] == -told["umin"] == 3e-3
    assert "umax" not in costs(inertia, np.inf, POINTING, 0.1)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"bandwidth": 1.0}, "too fast for dt = 1 s: stay below 0.5"),
        ({"bandwidth": -0.1}, "bandwidth must be positive"),
        ({"pointing": 0.0}, "pointing must be positive"),
        ({"pointing": 10.0}, "give radians"),
        ({"torque": 1e-9}, "takes 2.09e-06 N m .* and there are 1e-09 N m: stay below 0.00219 rad/s"),
    ],
)
def test_what_cannot_be_is_refused_with_what_can(changes, told):
    asked = {"torque": 3e-3, "pointing": POINTING, "bandwidth": 0.1, **changes}
    with pytest.raises(ScenarioError, match=told):
        weights(np.diag([0.12, 0.11, 0.05]), 1.0, integral=True, **asked)
    assert FASTEST == 0.5
