"""The worst flight in a box: known worsts, replay, never below what was flown, any case and controller, bad input."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flown import Linear, Opaque, Pendulum, Swing, cubesat, pd
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.errors import ScenarioError
from plants.missions import cubesat3u
from plants.simulation import worstflights
from plants.simulation.sensitivity import Box, Response
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.simulation.worstflights import worst_flights


class Pair(NamedTuple):
    a: Any
    b: Any


@dataclass(frozen=True)
class Still:
    """What stays where it is."""

    def derivative(self, x, u, env):
        return Pair(0.0 * x.a, 0.0 * x.b)

    def output(self, x, env):
        return jnp.stack([x.a, x.b])

    def project(self, x):
        return x


def still(d, shared):
    return Loop(plant=Still(), controller=pd(1.0, 0.0)), Scenario(initial=Pair(d.a, d.b), dt=0.05, periods=2)


def swinging(d, controller):
    """A case in plain Python, which no tracer passes: `float` of a dispersion, a branch on it, NumPy."""
    length = float(d.a) if float(d.a) > 0 else float(np.abs(d.a))
    loop = Loop(plant=Pendulum(length), controller=controller or pd(1.0, 0.2))
    return loop, Scenario(initial=Swing(float(d.b), 0.0), dt=0.05, periods=30, samples=2)


def slanted(run):
    return run.outputs[-1, 0] - 2 * run.outputs[-1, 1]


def hill(run):
    """Highest, 5, at a = 0.3 and b = -0.1."""
    return 5 - (run.outputs[-1, 0] - 0.3) ** 2 - 2 * (run.outputs[-1, 1] + 0.1) ** 2


def ditch(run):
    """Two hills; the lower one is wide."""
    a, b = run.outputs[-1]
    return 0.5 * jnp.exp(-(a**2 + b**2)) + jnp.exp(-20 * ((a - 0.6) ** 2 + (b - 0.7) ** 2))


def stairs(run):
    return jnp.floor(6 * run.outputs[-1, 0]) + jnp.floor(6 * run.outputs[-1, 1])


def turned(run):
    """Angle at the end, from rest."""
    return jnp.abs(run.outputs[-1, 0])


def turned_in_numpy(run):
    return float(np.linalg.norm(run.outputs[-1, :1]))


SQUARE = (Pair(-1.0, -1.0), Pair(1.0, 1.0))
SWINGS = (Pair(0.5, -1.0), Pair(2.0, 1.0))
QUICK = {"flights": 16, "rounds": 3, "progress": False}


def test_worst_corner_is_found_and_met_exactly():
    found = worst_flights(still, SQUARE, slanted, progress=False)
    assert found.worst == Pair(1.0, -1.0)
    assert found.value == 3.0
    assert str(found.parameters[".a"]) == "1 (upper bound)"
    assert found.slopes == "forward mode"
    assert found.complete


@pytest.mark.parametrize("forward", [True, False])
def test_worst_inside_is_found(forward):
    found = worst_flights(still, SQUARE, hill, progress=False, forward=forward)
    np.testing.assert_allclose(found.worst, (0.3, -0.1), atol=0.02)
    assert found.value > 5 - 1e-3


def test_the_higher_of_two_hills_is_found():
    found = worst_flights(still, SQUARE, ditch, progress=False)
    np.testing.assert_allclose(found.worst, (0.6, 0.7), atol=0.03)


def test_slopes_that_are_zero_do_not_stop_the_search():
    found = worst_flights(still, SQUARE, stairs, progress=False)
    assert found.value == 12.0


@pytest.mark.parametrize("controller", [None, Opaque(1.0)])
@pytest.mark.parametrize("objective", [turned, turned_in_numpy])
def test_every_case_controller_and_objective_is_searched_and_the_flight_is_anybodys(controller, objective):
    found = worst_flights(swinging, SWINGS, objective, controller, **QUICK)
    again = simulate(*swinging(found.worst, controller))
    for name in ("time", "outputs", "commands", "inputs", "estimates"):
        np.testing.assert_array_equal(getattr(found.run, name), getattr(again, name))
    np.testing.assert_array_equal(found.run.states, again.states)
    assert found.run.compiled == again.compiled == (controller is None)
    with jax.enable_x64(True):
        assert found.value == float(objective(again))
    traced = controller is None and objective is turned
    assert found.slopes.startswith("forward mode" if traced else "differences of flights (")
    draws = np.random.default_rng(0).uniform(*map(np.array, SWINGS), (50, 2))
    assert found.value > max(turned_in_numpy(simulate(*swinging(Pair(*d), controller))) for d in draws[:10])


def test_slopes_of_forward_mode_are_those_of_differences():
    response = Response.of(
        swinging, None, Box.between(SWINGS), turned, record=None, compiled=None, forward=True, memory=1 << 28
    )
    points = np.random.default_rng(3).uniform(0.1, 0.9, (11, 2))  # more than a batch
    values = response.values(points)
    step, differences = 1e-5, np.zeros((11, 2))
    for j in range(2):
        shift = step * np.eye(2)[j]
        differences[:, j] = (response.values(points + shift) - response.values(points - shift)) / (2 * step)
    np.testing.assert_allclose(response.slopes(points, values), differences, rtol=1e-4, atol=1e-6)


def everything(run):
    """All that an objective may look at."""
    late = run.time >= run.duration / 3
    rows = [run.outputs, run.estimates, run.references, run.commands, run.inputs, run.extra[:, None], run.time[:, None]]
    return sum(jnp.sin(k + a[late]).sum() for k, a in enumerate(rows)) + run.states.angle.max() + run.memory.sum()


def angle(x, env, sensors, navigator):
    return 3 * x.angle


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"samples": 1},
        {"keep_every": 5},
        {"reference": np.array([0.1, 0.0])},
        {"reference": np.linspace([0.0, 0.0], [0.3, 0.1], 30), "samples": 3},
        {"reference": np.linspace([0.0, 0.0], [0.3, 0.1], 30), "keep_every": 3},
    ],
)
def test_the_search_sees_the_flight_that_is_flown_alone(changes):
    def case(d, shared):
        loop, scenario = swinging(d, Linear(np.array([[0.5]]), np.ones((1, 2)), np.ones((1, 1)), np.ones((1, 2)), 0.05))
        return replace(loop, delay=1), replace(scenario, **changes)

    response = Response.of(
        case, None, Box.between(SWINGS), everything, record=angle, compiled=None, forward=True, memory=1 << 28
    )
    points = np.array([[0.2, 0.7], [0.9, 0.1]])
    np.testing.assert_allclose(response.values(points), [response.fly(z)[1] for z in points], rtol=1e-11)


@pytest.mark.slow
def test_noise_sensors_and_filter_stay_the_same_in_all_flights(surroundings):
    def case(d, shared):
        loop, scenario = cubesat(surroundings, seed=4, run=7)
        initial = cubesat3u.initial_state(surroundings, d, cubesat3u.RATES)
        return replace(loop, plant=cubesat3u.body(cubesat3u.INERTIA * (1 + d[0]))), replace(scenario, initial=initial)

    found = worst_flights(case, (np.full(3, -0.2), np.full(3, 0.2)), pointing, **QUICK)
    again = simulate(*case(found.worst, None))
    np.testing.assert_array_equal(found.run.estimates, again.estimates)
    assert found.slopes == "forward mode"
    assert found.value > pointing(simulate(*case(np.zeros(3), None)))
    assert np.abs(again.estimates - again.outputs).max() > 0


def pointing(run):
    return jnp.abs(run.outputs[:, :3]).sum()


@jax.custom_vjp
def backward_only(e):
    return jnp.tanh(e)


backward_only.defvjp(lambda e: (jnp.tanh(e), e), lambda e, g: (g * (1 - jnp.tanh(e) ** 2),))


@dataclass(frozen=True)
class Backward:
    """A controller that JAX compiles and cannot differentiate forward."""

    dt: float = 0.05

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, backward_only(r - y)[:1]


def test_what_jax_cannot_differentiate_is_told_with_the_remedy():
    with pytest.raises(ScenarioError, match=r"JAX cannot differentiate the flight .*; give forward = False"):
        worst_flights(swinging, SWINGS, turned, Backward(), **QUICK)
    found = worst_flights(swinging, SWINGS, turned, Backward(), forward=False, **QUICK)
    assert found.slopes == "differences of flights"


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flights=st.integers(1, 40), rounds=st.integers(0, 3))
def test_nothing_worse_was_flown_than_what_is_found(seed, flights, rounds):
    flown = []
    original = Response.values

    def values(self, points):
        found = original(self, points)
        flown.extend(found)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Response, "values", values)
        found = worst_flights(still, SQUARE, ditch, seed=seed, flights=flights, rounds=rounds, progress=False)
    assert found.value >= max(flown) - 1e-12
    assert found.flights == len(flown) + 1
    assert found.value == pytest.approx(found.values[0], rel=1e-12)
    assert list(found.values) == sorted(found.values, reverse=True)
    assert np.shape(found.ends.a) == found.values.shape
    for name, p in found.parameters.items():
        assert p.lower <= p.value <= p.upper, name


def test_the_seed_is_all_that_chance_has_a_part_in():
    first, again, other = (worst_flights(swinging, SWINGS, turned, seed=s, **QUICK) for s in (1, 1, 2))
    assert first.worst == again.worst
    assert first.value == again.value
    np.testing.assert_array_equal(first.values, again.values)
    assert not np.array_equal(first.values, other.values)


def test_a_little_memory_changes_batches_only():
    found = worst_flights(still, SQUARE, slanted, memory=200, progress=False)
    assert found.worst == Pair(1.0, -1.0)


def test_a_flight_that_fails_is_the_worst():
    def bounded(d, controller):
        loop, scenario = swinging(d, controller)
        return loop, Scenario(initial=scenario.initial, dt=0.05, periods=30, samples=2, bound=2.5)

    found = worst_flights(bounded, SWINGS, turned, **QUICK)
    assert found.value == np.inf
    assert not found.run.ok
    assert found.run.culprit == "plant"
    assert "fails at" in str(found)
    assert "in the plant" in str(found)
    again = simulate(*bounded(found.worst, None))
    assert again.failed_at == found.run.failed_at


def test_the_monte_carlo_beside_it():
    drawn = Pair(np.linspace(-0.5, 0.5, 70), np.linspace(0.5, -0.5, 70))
    found = worst_flights(still, SQUARE, slanted, beside=drawn, **QUICK)
    np.testing.assert_allclose(found.beside, drawn.a - 2 * drawn.b, rtol=1e-12)
    assert found.beside_run is not None
    assert found.beside_run.outputs[0].tolist() == [0.5, -0.5]
    assert "70 flights beside it: 1.5" in str(found)


def test_numbers_without_width_stay_as_they_are():
    class Counted(NamedTuple):
        pair: Pair
        count: Any
        limit: Any

    def counted(d, shared):
        assert isinstance(d.count, np.integer)
        assert d.limit == np.inf
        return still(d.pair, shared)

    low, high = (Counted(Pair(-1.0, b), 3, np.inf) for b in (0.25, 0.5))
    found = worst_flights(counted, (low, high), slanted, **QUICK)
    assert list(found.parameters) == [".pair.b"]
    assert found.worst == Counted(Pair(-1.0, 0.25), 3, np.inf)


@pytest.mark.parametrize(
    ("box", "message"),
    [
        (SQUARE[::-1], r"box\.a: lower 1\.0 is above upper -1\.0"),
        ((Pair(-1.0, np.nan), SQUARE[1]), r"box\[0\]\.b = nan"),
        ((SQUARE[0], Pair(1.0, np.inf)), r"box\.b = -1\.0 to inf is not finite"),
        ((SQUARE[0], SQUARE[0]), "leave at least one free"),
        ((SQUARE[0], (1.0, 1.0)), "the same fields"),
        ((Pair(-1.0, np.zeros(2)), SQUARE[1]), "give both the same"),
        ((Pair(0, 0.0), Pair(1, 0.0)), r"box\.a = 0 to 1: whole numbers"),
        (SQUARE[:1], "give two dispersions"),
        (1.0, "give two dispersions"),
        ((Pair("x", 0.0), SQUARE[1]), "give real numbers"),
        (({}, {}), "leave at least one free"),
    ],
)
def test_what_is_no_box_is_named(box, message):
    with pytest.raises(ScenarioError, match=message):
        worst_flights(still, box, slanted, **QUICK)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"flights": 0}, "flights = 0"),
        ({"rounds": -1}, "rounds = -1"),
        ({"rounds": 2.5}, r"rounds = 2\.5"),
        ({"memory": 0}, "memory = 0"),
        ({"forward": True, "shared": Opaque(1.0)}, "stepped from Python; leave it out"),
        ({"objective": turned_in_numpy, "forward": True}, r"cannot trace the objective \(\w+\); leave it out"),
        ({"objective": lambda run: run.outputs[-1]}, "return one real number"),
        ({"objective": lambda run: np.nan}, r"objective = nan at Pair\(a="),
        ({"objective": lambda run: "far"}, "return one real number"),
        ({"box": (Pair(-1.0, 0.0), Pair(1.0, 0.0))}, r"at Pair\(a=.*0\.0.*length"),
    ],
)
def test_what_cannot_be_searched_is_named(options, message):
    def case(d, controller):
        if d.a == 0:
            raise ScenarioError("length = 0")
        return swinging(d, controller)

    arguments = {"box": SWINGS, "objective": turned, "shared": None, **QUICK, **options}
    with pytest.raises(ScenarioError, match=message):
        worst_flights(case, **arguments)


def test_a_box_that_does_not_reach_the_loop_is_refused():
    with pytest.raises(ScenarioError, match="no number of loop or scenario varies"):
        worst_flights(lambda d, shared: still(Pair(0.0, 0.0), shared), SQUARE, slanted, **QUICK)


def test_an_interruption_leaves_what_was_found(monkeypatch):
    calls = []
    original = worstflights.Response.slopes

    def slopes(self, points, values):
        calls.append(len(points))
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(self, points, values)

    monkeypatch.setattr(worstflights.Response, "slopes", slopes)
    found = worst_flights(still, SQUARE, hill, progress=False)
    assert not found.complete
    assert "INTERRUPTED" in str(found)
    assert found.value > 4.9
