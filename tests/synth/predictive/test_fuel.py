"""Least fuel: the bound against closed forms, predictive control against the bound and against CVXPY."""

import pickle

import cvxpy as cp
import numpy as np
import pytest

from synth import ModelError, NumericalError, StateSpace
from synth.predictive.fuel import free_motion, fuel_mpc, minimum_fuel, pose, primer_peak, response
from synth.predictive.parametriclp import canonicalise
from synth.predictive.parametricqp import CLARABEL_SETTINGS
from synth.systems.sampled import c2d

N = 7.2921159e-5  # rad/s, of the geostationary orbit
OFFSET = np.r_[100.0, 100, 100, 0, 0, 0]  # m, m/s: chapter 6 of the thesis of the geostationary study
SETTLE = 6000.0  # s, from when on 10 cm are asked for


def integrators(outputs=("position",)):
    """Force per mass to position, and velocity if asked for."""
    C = np.eye(2)[: len(outputs)]
    return StateSpace(np.eye(2, k=1), np.eye(2)[:, 1:], C, np.zeros((len(outputs), 1)))


def clohessy_wiltshire():
    """Relative motion in the rotating frame, x radial, y along the track, z normal to the orbit."""
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * N**2, 2 * N, -2 * N, -(N**2)
    return StateSpace(A, np.eye(6)[:, 3:], np.eye(6)[:3], np.zeros((3, 3)))


def fly(controller, x, samples, *, disturbance=0.0):
    """States at the samples (samples + 1, n) and commands (samples, m)."""
    A, B, state = controller.model.A, controller.model.B, controller.init()
    xs, us = [x], []
    for _ in range(samples):
        state, u = controller.step(state, xs[-1], np.zeros(controller.model.ny))
        xs.append(A @ xs[-1] + B @ u + disturbance)
        us.append(u)
    return np.array(xs), np.array(us)


def test_bound_of_reaching():
    """From rest at d into |y| <= b at time T: one impulse (d - b) / T."""
    found = minimum_fuel(integrators(), np.full((11, 1), 5.0), 0.5, dt=2.0, settle=10)
    assert found.lower == pytest.approx(4.5 / 20, rel=1e-9)
    assert found.upper == pytest.approx(found.lower, rel=1e-9)
    np.testing.assert_allclose(found.impulses[1:], 0, atol=1e-12)


def test_bound_of_coming_to_rest():
    """Rest to rest over d in T: 2 d / T."""
    G = integrators(("position", "velocity"))
    free = free_motion(G, [5.0, 0.0], dt=2.0, samples=10)
    found = minimum_fuel(G, free, [1e-9, 1e-9], dt=2.0, settle=10)
    # the last impulse is given at the last sample but one
    assert found.upper == pytest.approx(2 * 5 / 18, rel=1e-6)
    assert found.lower <= 2 * 5 / 20 * (1 + 1e-6)
    assert found.peak > 1


def test_peak_of_the_primer_is_never_missed():
    """p = sin(t) / 1 between the samples of an oscillator that is sampled too coarsely to see it."""
    G = StateSpace([[0, 1], [-1, 0]], [[0], [1]], [[1, 0]], [[0]])
    for h in (0.3, 0.1, 0.03):
        found = primer_peak(G, np.array([[1.0]]), h, 1)
        top = np.sin(np.linspace(0, 20 * h, 20001)).max()
        assert top <= found <= top + h**2


def test_bound_under_a_known_push():
    """Against a constant acceleration a over a long time T in a narrow box: about a T, whatever the control."""
    free = free_motion(integrators(), [0.0, 0.0], dt=2.0, samples=50, held=np.full((50, 1), 1e-3))
    np.testing.assert_allclose(free[:, 0], 5e-4 * (2.0 * np.arange(51)) ** 2)
    found = minimum_fuel(integrators(), free, 1e-3, dt=2.0, settle=1)
    assert found.lower == pytest.approx(0.1, rel=0.05)
    assert found.lower <= found.upper


def test_no_control_beats_the_bound():
    """Held inputs, impulses and any mixture, from random programs that keep the box."""
    G, rng = clohessy_wiltshire(), np.random.default_rng(0)
    free = free_motion(G, OFFSET, dt=300, samples=40)
    found = minimum_fuel(G, free, 0.1, dt=300, settle=20)
    assert 0 < found.lower <= found.upper * (1 + 1e-9)
    assert np.abs(found.motion[20:]).max() <= 0.1 * (1 + 1e-6)
    fine = c2d(G, 75.0)
    for _ in range(3):
        price = rng.uniform(1, 1.2, 160 * 3)
        u = cp.Variable(160 * 3)
        y = free_motion(G, OFFSET, dt=75, samples=160)[1:].ravel() + response(fine, 160) @ u
        cp.Problem(cp.Minimize(cp.norm1(cp.multiply(price, u))), [y[237:] <= 0.1, y[237:] >= -0.1]).solve(
            solver="HIGHS"
        )
        assert u.value is not None
        assert 75 * np.abs(u.value).sum() >= found.lower * (1 - 1e-6)


@pytest.mark.parametrize("dt", [60.0, 120.0])
def test_predictive_control_is_within_ten_per_cent_of_the_bound(dt):
    """The task of chapter 6: within 10 cm after 100 minutes from 100 m in each axis."""
    G, settle = clohessy_wiltshire(), int(SETTLE / dt)
    bound = minimum_fuel(G, free_motion(G, OFFSET, dt=dt, samples=settle + 25), 0.1, dt=dt, settle=settle)
    assert bound.lower == pytest.approx(0.098, rel=0.01)  # as a linear program of an independent study has it
    controller = fuel_mpc(c2d(G, dt), box=0.1, umax=0.1, horizon=settle + 25, settle=settle)
    xs, us = fly(controller, OFFSET, settle + 25)
    assert np.abs(xs[settle:, :3]).max() <= 0.1 * (1 + 1e-6)
    assert bound.lower <= dt * np.abs(us).sum() <= 1.1 * bound.lower


def test_steps_are_those_of_cvxpy():
    """The fast path against the program as CVXPY solves it, with warm starts along the way."""
    model, box, umax, horizon = c2d(clohessy_wiltshire(), 300.0), np.full(3, 0.1), np.full(3, 0.1), 25
    controller = fuel_mpc(model, box=0.1, umax=0.1, horizon=horizon, settle=20)
    problem, room, variables = pose(model, box, umax, horizon, 100.0)
    rng, state = np.random.default_rng(1), controller.init()
    x = OFFSET
    for _ in range(10):
        sides = np.minimum(controller.room(state.sample, x, np.zeros(3)), 1e4)
        room.value = sides
        problem.solve(solver="CLARABEL", **CLARABEL_SETTINGS)
        solution = controller.lp.solve(controller.room(state.sample, x, np.zeros(3)), state.basis)
        assert solution.objective == pytest.approx(problem.value, rel=1e-6, abs=1e-9)
        state, u = controller.step(state, x, np.zeros(3))
        x = model.A @ x + model.B @ u + np.r_[np.zeros(3), 1e-5 * rng.standard_normal(3)]
    assert solution.v.size == sum(v.size for v in variables)


def test_a_warm_start_saves_pivots_and_the_step_is_pure():
    controller = fuel_mpc(c2d(clohessy_wiltshire(), 120.0), box=0.1, umax=0.1, horizon=60, settle=50)
    state, u = controller.step(controller.init(), OFFSET, np.zeros(3))
    x = controller.model.A @ OFFSET + controller.model.B @ u
    room = controller.room(state.sample, x, np.zeros(3))
    warm, cold = controller.lp.solve(room, state.basis), controller.lp.solve(room)
    assert warm.iterations < cold.iterations / 2
    first = controller.step(state, x, np.zeros(3))[1]
    controller.step(controller.init(), 3 * OFFSET, np.zeros(3))  # something else in between
    np.testing.assert_array_equal(controller.step(state, x, np.zeros(3))[1], first)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(controller)).step(state, x, np.zeros(3))[1], first)


def test_a_box_out_of_reach_is_approached_with_full_thrust():
    """1 km and 1 mm/s^2: never infeasible, bounded, and in the end in the box."""
    controller = fuel_mpc(c2d(clohessy_wiltshire(), 300.0), box=1.0, umax=1e-3, horizon=20)
    xs, us = fly(controller, 10 * OFFSET, 40)
    assert np.abs(us).max() <= 1e-3 * (1 + 1e-9)
    assert np.abs(us[0]).max() == pytest.approx(1e-3)
    assert np.abs(xs[:, :3]).max() < 1100
    assert np.abs(xs[25:, :3]).max() <= 1 + 1e-6


def test_a_known_disturbance_is_used():
    """A forecast lets the box be kept exactly, for the fuel that the disturbance costs."""
    model = c2d(integrators(), 10.0)
    d = model.B[:, 0] * 1e-3
    knowing = fuel_mpc(model, box=1.0, umax=0.01, horizon=20, forecast=np.tile(d, (60, 1)))
    xs, us = fly(knowing, np.zeros(2), 60, disturbance=d)
    assert np.abs(xs[:, 0]).max() <= 1 + 1e-9
    assert 10 * np.abs(us).sum() == pytest.approx(0.6, rel=0.15)  # 1 mm/s^2 over 600 s; the box can be used
    ignorant = fuel_mpc(model, box=1.0, umax=0.01, horizon=20)
    assert 1 + 1e-6 < np.abs(fly(ignorant, np.zeros(2), 60, disturbance=d)[0][:, 0]).max() < 1.2


def test_bad_arguments_are_named():
    model = c2d(integrators(), 10.0)
    good = {"box": 1.0, "umax": 0.1, "horizon": 5}
    for change, message in (
        ({"box": 0.0}, "box is"),
        ({"umax": -1.0}, "umax is"),
        ({"horizon": 0}, "horizon is 0"),
        ({"settle": -1}, "settle is -1"),
        ({"penalty": 0.0}, "penalty is 0"),
        ({"forecast": np.zeros((3, 5))}, "forecast"),
    ):
        with pytest.raises(ModelError, match=message):
            fuel_mpc(model, **(good | change))
    with pytest.raises(ModelError, match="c2d"):
        fuel_mpc(integrators(), **good)
    controller = fuel_mpc(model, **good)
    for y, r in (([1.0], [0.0]), ([1.0, 0.0], [0.0, 0.0, 0.0]), ([np.nan, 0.0], [0.0])):
        with pytest.raises(ModelError, match="y"):
            controller.step(controller.init(), y, r)
    with pytest.raises(ModelError, match="continuous"):
        minimum_fuel(model, np.zeros((5, 1)), 1.0, dt=1.0, settle=1)
    with pytest.raises(ModelError, match="never counts"):
        minimum_fuel(integrators(), np.zeros((5, 1)), 1.0, dt=1.0, settle=5)
    with pytest.raises(ModelError, match="dt is 0"):
        minimum_fuel(integrators(), np.zeros((5, 1)), 1.0, dt=0.0)


def test_an_impossible_task_is_an_error():
    """No force can move what it does not act on."""
    G = StateSpace(-np.eye(2), np.eye(2)[:, :1], np.eye(2), np.zeros((2, 1)))
    with pytest.raises(NumericalError, match="infeasible"):
        minimum_fuel(G, np.full((5, 2), 3.0), 1.0, dt=1.0, settle=2)


def test_programs_of_another_form_are_refused():
    x, y, p = cp.Variable(2), cp.Variable(1), cp.Parameter(2)
    for constraints, message in (
        ([x >= 0, x[0] + x[1] <= 1, x <= p], "limits 2 variables"),
        ([x >= 0, x <= p, x[0] == y], "equations"),
        ([x >= 0, x <= 2 * p], "exactly one row"),
    ):
        with pytest.raises(NumericalError, match=message):
            canonicalise(cp.Problem(cp.Minimize(cp.sum(x)), constraints), p, [x])
