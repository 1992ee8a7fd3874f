"""Predictive control: a step depends on its arguments alone, a solver that fails is replaced, bad input is named."""

import copy
import dataclasses
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from table3 import MODEL, REST, TABLE_3, TORQUE, random_case

from synth.errors import ModelError, NumericalError
from synth.predictive.horizon import MpcState, mpc
from synth.predictive.parametricqp import ParametricQp, canonicalise
from synth.systems.statespace import StateSpace


def test_result_depends_on_the_arguments_alone(controllers):
    controller, rng = controllers["velocity", 1], np.random.default_rng(7)
    cases = [random_case(controller, rng, size) for size in (0.01, 0.1, 1.0) for _ in range(5)]
    first = [controller.step(state, x, REST) for x, state in cases]
    others = (controller, copy.deepcopy(controller), pickle.loads(pickle.dumps(controller)))
    for other in others:
        for i in rng.permutation(len(cases)):
            x, state = cases[i]
            for a, b in zip(other.step(state, x, REST), first[i], strict=True):
                for p, q in zip(a, b, strict=True):
                    np.testing.assert_array_equal(p, q)


def test_a_warm_start_changes_the_work_not_the_result(controllers):
    controller = controllers["position", 0]
    x, state = random_case(controller, np.random.default_rng(8), 0.3)
    phi = controller.parameters(state, x, REST)
    cold = controller.qp.solve(phi, controller.qp.cold_start())
    warm = controller.qp.solve(phi, cold.active)
    np.testing.assert_allclose(warm.v, cold.v, rtol=0, atol=1e-12)
    assert np.count_nonzero(cold.active) > 5


def test_state_is_plain_data(controllers):
    state = controllers["velocity", 1].init()
    assert isinstance(state, MpcState)
    after, _ = controllers["velocity", 1].step(state, np.full(6, 0.01), REST)
    assert after.inputs.shape == state.inputs.shape == (1, 3)
    assert after.active.dtype == state.active.dtype
    np.testing.assert_array_equal(state.inputs, np.zeros((1, 3)))


def test_one_controller_serves_several_threads(controllers):
    """The same flights in one thread and in four at once, to the last bit."""
    controller = controllers["velocity", 0]

    def flight(seed: int) -> np.ndarray:
        x, state, commands = np.random.default_rng(seed).normal(scale=0.1, size=6), controller.init(), []
        for _ in range(60):
            state, u = controller.step(state, x, np.zeros(6))
            x = MODEL.A @ x + MODEL.B @ u
            commands.append(u)
        return np.array(commands)

    alone = [flight(seed) for seed in range(8)]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(flight, range(8)))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a, b)


def test_clarabel_answers_when_daqp_gives_up_and_is_counted(controllers):
    controller = controllers["position", 0]
    hasty = copy.deepcopy(controller)
    hasty.qp.scratch.daqp.settings = {"iter_limit": 2}
    x, state = random_case(controller, np.random.default_rng(10), 0.3)
    after, u = hasty.step(state, x, REST)
    expected = controller.step(state, x, REST)
    assert (after.fallbacks, expected[0].fallbacks) == (1, 0)
    np.testing.assert_allclose(u, expected[1], rtol=0, atol=1e-6 * TORQUE)
    assert not after.active.any()


def test_failure_of_both_solvers_is_an_error_that_names_the_state(controllers):
    controller = controllers["position", 0]
    qp = controller.qp
    rows, offset = np.vstack([qp.A, np.eye(1, 27), -np.eye(1, 27)]), np.concatenate([qp.offset, [-5.0, -5.0]])
    contradictory = ParametricQp(
        P=qp.P,
        A=rows,  # v1 <= -5 and v1 >= 5
        lower=np.concatenate([qp.lower, [-np.inf] * 2]),
        offset=offset,
        slope=np.vstack([qp.slope, np.zeros((2, qp.slope.shape[1]))]),
    )
    broken = dataclasses.replace(controller, qp=contradictory)
    with pytest.raises(NumericalError, match=r"'x': \[0\.25,") as caught:
        broken.step(broken.init(), np.array([0.25, 0, 0, 0, 0, 0]), REST)
    assert set(caught.value.statuses) == {"daqp", "clarabel"}


def test_a_program_that_is_not_affine_in_its_parameter_is_refused():
    import cvxpy as cp

    v, phi = cp.Variable(2), cp.Parameter(2)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(v)), [phi @ v >= -1])
    with pytest.raises(NumericalError, match="not affine"):
        canonicalise(problem, phi, [v])


@pytest.mark.parametrize(
    ("y", "r", "message"),
    [
        (np.full(6, np.nan), REST, "every entry must be finite"),
        (REST, np.array([0, 0, np.inf, 0, 0, 0]), "every entry must be finite"),
        (np.zeros(5), REST, r"y has shape \(5,\)"),
        (REST, np.zeros(9), r"r has shape \(9,\)"),
    ],
)
def test_bad_measurements_are_refused(controllers, y, r, message):
    controller = controllers["position", 0]
    with pytest.raises(ModelError, match=message):
        controller.step(controller.init(), y, r)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"Nc": 11}, "Nc is 11, beyond Np = 10"),
        ({"Nc": 0}, "Nc is 0"),
        ({"Np": 10.0}, r"Np is 10\.0"),
        ({"delay": -1}, "delay is -1"),
        ({"umin": 1e-3}, r"umin\[0\] = 0.001 is not below umax"),
        ({"umax": np.inf}, "umax is"),
        ({"umax": [1.0, 2.0]}, "umax is"),
        ({"ymin": 1.0, "ymax": -1.0}, r"ymin\[0\] = 1.0 is not below ymax"),
        ({"ymax": np.nan}, "ymax is"),
        ({"ymax": -np.inf}, "ymax is"),
        ({"hmax": -1.0}, "hmax is"),
        ({"hmax": 0.0}, "hmax is"),
        ({"form": "incremental"}, "form is 'incremental'"),
        ({"penalty": 0.0}, "penalty is 0.0"),
        ({"Q": np.eye(5)}, "Q is 5 x 5 where 6 x 6 is needed"),
        ({"Q": np.eye(6) + np.eye(6, k=1)}, "Q is not symmetric"),
        ({"Q": -np.eye(6)}, "Q has the eigenvalue -1.0"),
        ({"R": np.zeros((3, 3))}, "R has the eigenvalue 0.0"),
        ({"terminal": -np.eye(6)}, "terminal has the eigenvalue -1.0"),
        ({"model": StateSpace(np.eye(6), MODEL.B, np.eye(6), MODEL.D)}, "model has dt = 0.0"),
        ({"model": StateSpace(MODEL.A, MODEL.B, MODEL.C[:3], MODEL.D[:3], 0.5)}, "outputs other than its state"),
    ],
)
def test_bad_arguments_are_named(change, message):
    arguments = {"model": MODEL} | TABLE_3 | change
    with pytest.raises(ModelError, match=message):
        mpc(arguments.pop("model"), **arguments)
