"""Predictive control of unstable plants over long horizons: the optimum, against long arithmetic that shares no code.

The plants of the reports (`data/mpc_reports.json`): cvxpy #580, whose condensed Hessian has a condition number of
5e12 over 50 samples, and an inverted pendulum over 5 s, 2e18. In the commands themselves DAQP called answers optimal
that were 30 % off and cost 44 % more.
"""

import copy
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from exactmpc import Reference, random_program
from scipy.linalg import solve_discrete_are

from synth.errors import NumericalError
from synth.predictive.horizon import mpc, pose
from synth.predictive.parametricqp import canonicalise
from synth.predictive.prestabilised import LongArithmetic, prestabilise
from synth.systems.statespace import StateSpace

REPORTS = json.loads((Path(__file__).parents[2] / "data" / "mpc_reports.json").read_text())
WEIGHTS = ("Q", "R", "Np", "Nc", "umin", "umax", "form")


def plant(A, B, dt=1.0):
    A, B = np.atleast_2d(A).astype(float), np.atleast_2d(B).astype(float)
    return StateSpace(A, B, np.eye(len(A)), np.zeros(B.shape), dt)


def reported(name, **changes):
    """(controller, x0) of a report."""
    case = next(c for c in REPORTS if c["name"] == name)
    return mpc(plant(case["A"], case["B"]), **({key: case[key] for key in WEIGHTS} | changes)), np.array(case["x0"])


def random_step(seed, **sizes):
    """(controller, state, x, r) of a random program."""
    model, options, x, r, past, d = random_program(np.random.default_rng(seed), **sizes)
    controller = mpc(model, **options)
    prediction = x - d if controller.problem.form == "velocity" else None
    return controller, controller.init()._replace(prediction=prediction, inputs=past), x, r


def exact(controller, state, x, r):
    p, phi = controller.problem, controller.parameters(state, x, r)
    near = None
    if p.Nc * p.model.nu > 10:  # far faster, and proved as well
        near = LongArithmetic(p, commands=True)(phi, controller.qp.likely(phi))
    try:
        return Reference(p, phi).solve(near)
    except ArithmeticError:
        return Reference(p, phi, bits=1200).solve(near)


@pytest.mark.parametrize("case", REPORTS, ids=lambda case: case["name"])
def test_reported_commands(case):
    controller, x = reported(case["name"])
    after, u = controller.step(controller.init(), x, 0 * x)
    np.testing.assert_allclose(u, case["expected"]["u0"], rtol=1e-10)
    assert after.fallbacks == 0


@pytest.mark.slow
@pytest.mark.parametrize("case", REPORTS, ids=lambda case: case["name"])
def test_reported_commands_are_exact(case):
    controller, x = reported(case["name"])
    np.testing.assert_allclose(exact(controller, controller.init(), x, 0 * x), case["expected"]["u0"], rtol=1e-12)


@pytest.mark.parametrize("form", ["position", "velocity"])
@pytest.mark.parametrize("Nc", [7, *(pytest.param(N, marks=pytest.mark.slow) for N in (1, 50, 100))])
def test_cvxpy_580_over_100_samples(form, Nc):
    controller, x = reported("cvxpy580 Np=50", Np=100, Nc=Nc, form=form)
    state = controller.init()
    np.testing.assert_allclose(controller.step(state, x, 0 * x)[1], exact(controller, state, x, 0 * x), rtol=1e-8)


@pytest.mark.parametrize("x0", [0.3, 0.7, 1.0, 3.0])
def test_a_plant_that_doubles_in_every_sample(x0):
    """Beyond |x| = 1 no command holds it, and 2^50 of it is to be weighed."""
    controller = mpc(plant(2, 1), Q=1, R=1, Np=50, Nc=50, umin=-1, umax=1, form="position")
    x = np.array([x0])
    u = controller.step(controller.init(), x, 0 * x)[1]
    np.testing.assert_allclose(u, exact(controller, controller.init(), x, 0 * x), rtol=1e-8)


def within(seed, **sizes):
    """Whether the command of a random program is optimal; one that is not is to be reported."""
    controller, state, x, r = random_step(seed, **sizes)
    try:
        u = controller.step(state, x, r)[1]
    except NumericalError:
        return False
    unit = controller.problem.unit
    np.testing.assert_allclose(u / unit, exact(controller, state, x, r) / unit, rtol=0, atol=1e-8, err_msg=str(seed))
    return True


@pytest.mark.parametrize("seed", range(40))
def test_random_programs(seed):
    assert within(seed, largest=20)


@pytest.mark.slow
@pytest.mark.parametrize("start", range(1000, 1120, 20))
def test_random_programs_over_long_horizons(start):
    """Modes to 1.5 a sample, horizons to 100, both forms, delays, soft limits: optimal, and few are given up.

    A thousand of them: `benchmarks/mpc_programs.py`.
    """
    assert sum(within(seed) for seed in range(start, start + 20)) >= 19


@pytest.mark.parametrize("seed", range(12))
def test_the_prestabilised_program_is_the_one_that_is_posed(seed):
    """Where doubles carry both: the same optimum, slacks included."""
    controller, state, x, r = random_step(seed, largest=8, growth=1.1)
    posed, phi = pose(controller.problem), controller.parameters(state, x, r)
    one = canonicalise(posed.problem, posed.phi, posed.variables)
    other = prestabilise(controller.problem)
    a, b = (qp.solve(phi, qp.cold_start()).v for qp in (one, other))
    N, m = controller.problem.Nc * controller.problem.model.nu, controller.problem.model.nu
    np.testing.assert_allclose(a[:m], b[:m], rtol=0, atol=1e-8)
    np.testing.assert_allclose(a[N:], b[N:], rtol=1e-7, atol=1e-7)
    long = LongArithmetic(controller.problem, commands=True)(phi)
    np.testing.assert_allclose(long[:N], a[:N], rtol=0, atol=1e-7)
    np.testing.assert_allclose(long[N:], a[N:], rtol=1e-7, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", [case["name"] for case in REPORTS])
def test_the_condition_of_the_program_does_not_grow_with_the_horizon(name):
    conditions = [np.linalg.cond(reported(name, Np=N, Nc=N)[0].qp.P) for N in (40, 70, 100)]
    assert max(conditions) < 10
    np.testing.assert_allclose(conditions, conditions[0], rtol=1e-2)


@pytest.mark.parametrize("Np", [5, 30, pytest.param(100, marks=pytest.mark.slow)])
def test_far_from_its_limits_it_is_the_regulator(Np):
    """With the Riccati solution as terminal weight over any horizon; over a long one with any."""
    case = REPORTS[0]
    A, B = np.array(case["A"]), np.array(case["B"])
    P = solve_discrete_are(A, B, np.eye(8), np.eye(2))
    K = np.linalg.solve(np.eye(2) + B.T @ P @ B, B.T @ P @ A)
    x = np.random.default_rng(0).standard_normal(8)
    for terminal in (P, np.eye(8)) if Np == 100 else (P,):
        controller, _ = reported(case["name"], Np=Np, Nc=Np, umin=-100, umax=100, terminal=terminal)
        np.testing.assert_allclose(controller.step(controller.init(), x, 0 * x)[1], -K @ x, rtol=1e-9)


@pytest.mark.parametrize("form", ["position", "velocity"])
@pytest.mark.parametrize("name", ["cvxpy580 Np=50", "pendulum dt=.05 Np=100"])
def test_a_loop_that_a_short_horizon_holds_is_held_by_a_long_one(name, form):
    for N in (40, 100):
        controller, x = reported(name, Np=N, Nc=N, form=form)
        model, state, x = controller.problem.model, controller.init(), 0.3 * x
        for _ in range(150):
            state, u = controller.step(state, x, 0 * x)
            x = model.A @ x + model.B @ u
        assert np.abs(x).max() < 1e-4, N
        assert state.fallbacks == 0


@pytest.mark.slow
def test_units_and_coordinates_of_the_state_do_not_matter():
    case, rng = REPORTS[0], np.random.default_rng(1)
    A, B, x = np.array(case["A"]), np.array(case["B"]), np.array(case["x0"])
    reference = reported(case["name"])[0]
    expected = reference.step(reference.init(), x, 0 * x)[1]
    for T in (np.diag(10.0 ** rng.uniform(-3, 3, 8)), np.linalg.qr(rng.standard_normal((8, 8)))[0]):
        inverse = np.linalg.inv(T)
        Q = inverse.T @ inverse
        moved = plant(T @ A @ inverse, T @ B)
        controller = mpc(moved, **({key: case[key] for key in WEIGHTS} | {"Q": (Q + Q.T) / 2}))
        np.testing.assert_allclose(controller.step(controller.init(), T @ x, 0 * x)[1], expected, rtol=1e-8)


@pytest.mark.parametrize(("x", "kept"), [([0.2, 0.3], True), ([0.5, 0.3], False)])
def test_a_soft_limit_weighs_what_it_says_over_a_long_horizon(x, kept):
    """Full command over 60 samples costs 1e18: what can be kept is kept, beside what cannot all else pales."""
    options = {"Q": 1, "R": 1, "Np": 60, "Nc": 60, "umin": -1, "umax": 1, "form": "position"}
    controller = mpc(plant([[1.4, 0.3], [0, 0.9]], [[0], [1]]), **options, ymax=[1.0, 0.6], ymin=[-1.0, -0.6])
    x, state = np.array(x), controller.init()
    after, u = controller.step(state, x, 0 * x)
    np.testing.assert_allclose(u, exact(controller, state, x, 0 * x), rtol=1e-8)
    slacks = controller.qp.solve(controller.parameters(state, x, 0 * x), state.active).v[-2:]
    assert (slacks.max() <= 1e-12) == kept
    assert after.fallbacks == (not kept)


def test_a_prestabilised_program_survives_copies():
    controller, x = reported("cvxpy580 Np=40")
    u = controller.step(controller.init(), x, 0 * x)[1]
    for other in (copy.deepcopy(controller), pickle.loads(pickle.dumps(controller))):
        np.testing.assert_array_equal(other.step(other.init(), x, 0 * x)[1], u)


def test_growth_beyond_doubles_is_refused():
    with pytest.raises(NumericalError, match="shorten the horizon"):
        mpc(plant(10, 1), Q=1, R=1, Np=400, Nc=400, umin=-1, umax=1, form="position")


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_what_passes_the_check_is_the_optimum(scale):
    """A right answer passes; a wrong one, whatever is wrong with it, does not, in any scale of the objective."""
    rng = np.random.default_rng(3)
    controller, state, x, r = random_step(9, largest=8, growth=1.1)
    qp = controller.qp
    phi = controller.parameters(state, 30 * x, r)
    v, y, active, _ = qp.solve(phi, qp.cold_start())
    f, upper = qp.vectors(phi)
    check = type(qp.scratch.optimality)(scale * qp.P, qp.A, qp.lower, len(qp.P))
    assert np.count_nonzero(active) > 5
    assert check.error(v, scale * y, scale * f, upper)[0] <= 1e-8
    assert check.rounding(v, scale * y, scale * f, upper) <= 1e-8
    for size in (1e-7, 1e-4, 1.0):
        off = size * rng.standard_normal(v.size)
        for bound in (
            check.error(v + off, scale * y, scale * f, upper)[0],
            check.rounding(v + off, scale * y, scale * f, upper),
        ):
            assert bound >= 0.1 * np.abs(off).max() / max(1, np.abs(v).max())
    assert not check.error(v * np.nan, scale * y, scale * f, upper)[0] <= 1e-8
    assert check.rounding(v * np.nan, scale * y, scale * f, upper) == np.inf


def test_a_step_that_fails_its_check_is_answered_otherwise_and_counted(monkeypatch):
    """DAQP's answers disturbed by 1e-6: Clarabel's active rows lead to the right one."""
    controller, x = reported("cvxpy580 Np=40")
    expected = controller.step(controller.init(), x, 0 * x)[1]
    qp = controller.qp

    class Careless:
        def update(self, **changed):
            return 0

        def solve(self):
            v, y, *_ = expected_solution
            return v + 1e-6, None, 1, {"lam": y}

    expected_solution = qp.solve(controller.parameters(controller.init(), x, 0 * x), qp.cold_start())
    monkeypatch.setattr(qp.scratch, "daqp", Careless())
    after, u = controller.step(controller.init(), x, 0 * x)
    np.testing.assert_allclose(u, expected, rtol=1e-8)
    assert after.fallbacks == 1
