"""The Kalman filter against its textbook form, and the estimates without a filter."""

from math import factorial

import jax
import numpy as np
import pytest
import scipy.linalg as sla

from plants.errors import ScenarioError, SingularityError
from plants.estimation.kalman import kalman
from plants.hardware.sensors import AngleRate, AngleRateSuite
from plants.missions import airbearing
from plants.simulation.loop import Loop
from synth.regulators.controller import state_feedback

BODY, SENSORS = airbearing.BODY, airbearing.SENSORS
H = 0.1


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@pytest.mark.parametrize("rates", [True, False])
def test_filter_is_that_of_the_textbook(rates):
    """Equations 16 and 17 with all matrices, along random measurements and torques."""
    rng, n = np.random.default_rng(4), 6 if rates else 3
    nav = airbearing.filtered(rates=rates)
    C, V = np.eye(6)[:n], np.diag([airbearing.ANGLE_NOISE**2] * 3 + [airbearing.RATE_NOISE**2] * 3)
    step = jax.jit(nav.update)
    s, x, P = nav.init(), np.zeros(6), V
    wheels = np.array([50.0, -20, 30])
    for k in range(20):
        u, before, h = rng.normal(0, 0.05, 3), wheels, 0.0 if k == 0 else H
        wheels = before + u * h / airbearing.WHEEL_INERTIA
        y = rng.normal(0, 0.02, 6)
        A, B = map(np.asarray, BODY.pseudolinear(x[:3], x[3:], before))
        F = sla.expm(A * h)
        G = sum(np.linalg.matrix_power(A, j) * h ** (j + 1) / factorial(j + 1) for j in range(12)) @ B if h else 0 * B
        x, P = F @ x - G @ u, F @ P @ F.T + airbearing.TORQUE_NOISE**2 * G @ G.T
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + V[:n, :n])
        x, P = x + K @ (y[:n] - C @ x), (np.eye(6) - K @ C) @ P
        s, estimate = step(s, AngleRate(y[:3], y[3:], wheels), u, None, h)
        np.testing.assert_allclose(estimate[:6], x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(s.P, P, rtol=1e-7, atol=1e-16)
        np.testing.assert_allclose(estimate[6:], airbearing.WHEEL_INERTIA * wheels, rtol=1e-12)


def test_backward_difference_and_no_rate():
    angles, rate, wheels = np.radians([10, 20, 30]), np.array([0.01, 0.02, -0.03]), np.array([1.0, 2, 3])
    for weights, expected in (((0, 1), rate), ((1, 0), 7 * rate), ((0, 0), 0 * rate), ((1, 1), 8 * rate)):
        nav = airbearing.raw(measured=weights[0], differenced=weights[1])
        E = np.asarray(jax.jit(lambda a: BODY.pseudolinear(a, rate, wheels)[0][:3, 3:])(angles))
        s, first = nav.update(nav.init(), AngleRate(angles - H * E @ rate, 7 * rate, wheels), None, None, 0.0)
        np.testing.assert_allclose(first[3:6], weights[0] * 7 * rate, atol=1e-15)
        _, second = nav.update(s, AngleRate(angles, 7 * rate, wheels), None, None, H)
        np.testing.assert_allclose(second[:3], angles, rtol=1e-14)
        np.testing.assert_allclose(second[3:6], expected, rtol=0, atol=1e-14)


def test_what_is_refused():
    with pytest.raises(ScenarioError, match="Kalman filter needs both positive"):
        kalman(BODY, AngleRateSuite(angle_noise=0.0, rate_noise=1e-3), torque_noise=1e-4)
    with pytest.raises(ScenarioError, match="torque_noise must be at least 0"):
        kalman(BODY, SENSORS, torque_noise=-1.0)
    controller = state_feedback(np.zeros((3, 9)), 0.1)
    with pytest.raises(SingularityError, match="target has the pitch 95 deg"):
        airbearing.manoeuvre(airbearing.case(np.radians([0, 95, 0])), controller, airbearing.raw(), duration=1.0)
    with pytest.raises(ScenarioError, match="whole number of control periods"):
        airbearing.manoeuvre(airbearing.case(), controller, airbearing.raw(), duration=0.25)
    loop, scenario = airbearing.manoeuvre(airbearing.case(), controller, airbearing.raw(), duration=1.0)
    assert isinstance(loop, Loop)
    assert scenario.periods == 10
