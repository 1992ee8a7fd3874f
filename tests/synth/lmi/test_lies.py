"""Solvers that lie: what leaves is a controller that was measured and is called what it is, or an error of ours."""

import clarabel
import cvxpy as cp
import numpy as np
import pytest

from synth import (
    Design,
    GeneralizedPlant,
    NumericalError,
    StateSpace,
    c2d,
    fuel_mpc,
    hinfsyn,
    minimum_fuel,
    mixsyn,
    mpc,
    ncfsyn,
    verify,
)

INTEGRATORS = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], np.eye(2), np.zeros((2, 1))), 0.1)
PLANT = GeneralizedPlant.tracking(
    INTEGRATORS, Wproc=[[0.1]], Wdist=0.01 * np.eye(2), Werr=np.diag([1, 0.1]), Wact=[[0.5]], Wr=0.1 * np.eye(2)
)
OPTIMUM = 0.1622382  # of PLANT, as the Riccati equations and the LMIs say alike
HONEST = cp.Problem.solve


class Panic(BaseException):
    """What Clarabel's Rust throws is no `Exception`."""


def lie_values(change):
    """A solver that returns other numbers than it found."""

    def solve(self, *args, **settings):
        HONEST(self, *args, **settings)
        for unknown in self.variables():
            if unknown.value is not None:
                unknown._value = change(np.asarray(unknown.value))

    return solve


def lie_status(status, keep=True):
    """A solver that says what is not so."""

    def solve(self, *args, **settings):
        HONEST(self, *args, **settings)
        self._status = status
        for unknown in () if keep else self.variables():
            unknown._value = None

    return solve


def breaks(error):
    """A solver that does not come back."""

    def solve(self, *args, **settings):
        raise error

    return solve


def random(value):
    return np.random.default_rng(value.size).standard_normal(value.shape)


LIES = {
    "raises SolverError": breaks(cp.SolverError("injected")),
    "raises ValueError": breaks(ValueError("Problem data contains NaN or Inf.")),
    "raises MemoryError": breaks(MemoryError("out of memory")),
    "panics": breaks(Panic("called `Result::unwrap()` on an `Err` value")),
    "NaN": lie_values(lambda value: np.full(value.shape, np.nan)),
    "infinity": lie_values(lambda value: np.full(value.shape, np.inf)),
    "noise": lie_values(random),
    "zeros": lie_values(np.zeros_like),
    "1 % more": lie_values(lambda value: 1.01 * value),
    "10 % less": lie_values(lambda value: 0.9 * value),
    "1e200 times": lie_values(lambda value: 1e200 * value),
    "1e-200 times": lie_values(lambda value: 1e-200 * value),
    "negative": lie_values(lambda value: -value),
    "complex": lie_values(lambda value: value * (1 + 1j)),
    "text": lie_values(lambda value: np.full(value.shape, "optimal")),
    "another shape": lie_values(lambda value: np.zeros(7)),
    "infeasible": lie_status("infeasible"),
    "unbounded": lie_status("unbounded"),
    "inaccurate": lie_status("optimal_inaccurate"),
    "out of time": lie_status("user_limit", keep=False),
    "optimal, without values": lie_status("optimal", keep=False),
}


def outcome(function):
    """What a function returns, or its typed error."""
    try:
        return function()
    except NumericalError as error:
        return error


def judged(design: Design, optimum: float, tol: float = 1e-3) -> None:
    """The design is stable, has the norm it says, and tells where that is not the optimum."""
    assert design.gamma == pytest.approx(verify(design.closed_loop).norm, rel=1e-6)  # which raises if it is unstable
    assert design.gamma <= (1 + 2 * tol) * optimum or design.info.warnings


@pytest.mark.parametrize("method", ["auto", "lmi", "standard", "extended"])
@pytest.mark.parametrize("lie", LIES)
def test_no_lie_leaves(monkeypatch, lie, method):
    """Wrong statuses, wrong numbers, none, and every way of not coming back."""
    monkeypatch.setattr(cp.Problem, "solve", LIES[lie])
    found = outcome(lambda: hinfsyn(PLANT, method=method))
    if isinstance(found, Design):
        judged(found, OPTIMUM)
    else:
        assert found.statuses
        assert method != "auto"  # which has the Riccati equations


@pytest.mark.parametrize("lie", LIES)
def test_no_lie_leaves_through_another_door(monkeypatch, lie):
    """Mixed sensitivity (continuous, by the Cayley map) and loop shaping."""
    G = StateSpace([[-1, 2], [0, -3]], [[0], [1]], [[1, 0]], [[0]])
    shaped = ncfsyn(G)
    mixed = mixsyn(G, W1=1, W2=0.5)
    monkeypatch.setattr(cp.Problem, "solve", LIES[lie])
    for design, again in ((shaped, lambda: ncfsyn(G)), (mixed, lambda: mixsyn(G, W1=1, W2=0.5))):
        found = outcome(again)
        if isinstance(found, Design):
            judged(found, design.gamma)


@pytest.mark.parametrize("lie", LIES)
def test_no_lie_becomes_a_bound_of_fuel(monkeypatch, lie):
    """`minimum_fuel` says numbers or why there are none."""
    G = StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]])
    free = np.full((11, 1), 5.0)
    true = minimum_fuel(G, free, 0.5, dt=2.0, settle=10)
    monkeypatch.setattr(cp.Problem, "solve", LIES[lie])
    found = outcome(lambda: minimum_fuel(G, free, 0.5, dt=2.0, settle=10))
    if not isinstance(found, NumericalError):
        assert found.lower <= true.lower * (1 + 1e-9)  # by weak duality whatever the multipliers are
        assert np.isfinite(found.upper)


def lying(value, status="Solved"):
    """Clarabel, as `solve_clarabel` calls it, with the same number everywhere."""

    class Solver:
        def __init__(self, P, q, A, b, cones, settings):
            self.x, self.z, self.status = np.full(q.size, value), np.full(b.size, value), status

        def solve(self):
            if status == "panics":
                raise Panic("called `Result::unwrap()` on an `Err` value")
            return self

    return Solver


class Fake:
    """DAQP, or HiGHS, that calls optimal what it is told to."""

    def __init__(self, v, prices):
        self.v, self.prices = v, prices

    def update(self, **data):
        return 0

    def solve(self):
        return self.v, 0.0, 1, {"lam": self.prices}


@pytest.mark.parametrize("status", ["Solved", "AlmostSolved", "MaxTime", "panics"])
@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e-3, -1e200])
def test_no_lie_becomes_a_command(monkeypatch, value, status):
    """DAQP and Clarabel lie alike: long arithmetic answers, or nobody does."""
    controller = mpc(INTEGRATORS, Q=np.eye(2), R=[[1.0]], Np=5, Nc=3, umin=-1.0, umax=1.0)
    y, r = np.array([0.3, -0.2]), np.zeros(2)
    _, u = controller.step(controller.init(), y, r)
    size = controller.qp.lower.size
    controller.qp.scratch.daqp = Fake(np.full(len(controller.qp.P), value), np.full(size, value))
    monkeypatch.setattr(clarabel, "DefaultSolver", lying(value, status))
    found = outcome(lambda: controller.step(controller.init(), y, r))
    if isinstance(found, NumericalError):
        assert {"daqp", "clarabel"} <= set(found.statuses)
    else:
        np.testing.assert_allclose(found[1], u, rtol=0, atol=1e-7)
        assert found[0].fallbacks == 1


@pytest.mark.parametrize("change", [lambda v: v * np.nan, lambda v: v + np.inf, lambda v: 0 * v, lambda v: 1.01 * v])
def test_no_lie_becomes_a_burn(monkeypatch, change):
    """HiGHS calls optimal what is none: infeasible, dearer than its own multipliers say, or no number."""
    controller = fuel_mpc(INTEGRATORS, box=[0.1, 0.5], umax=1.0, horizon=20)
    y, r = np.array([2.0, 0.0]), np.zeros(2)
    controller.step(controller.init(), y, r)
    honest = controller.lp.scratch.highs

    class Highs:
        def __getattr__(self, name):
            return getattr(honest, name)

        def getSolution(self):
            solution = honest.getSolution()
            solution.col_value = change(np.array(solution.col_value))
            return solution

    controller.lp.scratch.highs = Highs()
    with pytest.raises(NumericalError, match="off by"):
        controller.step(controller.init(), y, r)


@pytest.mark.parametrize("change", [lambda v: v * np.nan, lambda v: 1.01 * v])
def test_a_start_that_loses_digits_is_left(change):
    """From the basis of the sample before HiGHS ends 1e-6 off, on a program it solves to 1e-13 from none."""
    controller = fuel_mpc(INTEGRATORS, box=[0.1, 0.5], umax=1.0, horizon=20)
    lp, room = controller.lp, controller.room(0, np.array([2.0, 0.0]), np.zeros(2))
    cold = lp.solve(room)
    honest, started = lp.scratch.highs, []

    class Highs:
        def __getattr__(self, name):
            return getattr(honest, name)

        def clearSolver(self):
            started.append("none")
            return honest.clearSolver()

        def setBasis(self, basis):
            started[-1] = "basis"
            return honest.setBasis(basis)

        def getSolution(self):
            solution = honest.getSolution()
            if started[-1] == "basis":
                solution.col_value = change(np.array(solution.col_value))
            return solution

    lp.scratch.highs = Highs()
    np.testing.assert_array_equal(lp.solve(room, cold.basis).v, cold.v)
    assert started == ["basis", "none"]
