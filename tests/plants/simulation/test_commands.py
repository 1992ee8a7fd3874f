"""Whatever a block does wrong, the flight ends with a culprit and a time, or with an error that names both."""

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from flown import Pendulum, Swing, pd, scenario

from plants.errors import ScenarioError
from plants.simulation.simulate import Loop, can_compile, simulate

RIGHT = np.zeros(1)
TEN = scenario(periods=10)


@dataclass(frozen=True)
class Faulty:
    """Does what it is told to from the fourth call on, before that nothing."""

    act: Any
    first: int = 3
    dt: float = 0.05

    def init(self):
        return 0

    def step(self, s, y, r):
        return (s + 1, self.act()) if s >= self.first else (s + 1, RIGHT)


def raises(error):
    def act():
        raise error

    return act


WRONG = {
    "raised RuntimeError: boom": raises(RuntimeError("boom\nand a second line")),
    "raised MemoryError": raises(MemoryError()),
    "raised KeyError: 'u'": raises(KeyError("u")),
    r"commands array\(\[0\., 0\.\]\)": lambda: np.zeros(2),
    r"commands array\(\[\[0\.\]\]\)": lambda: np.zeros((1, 1)),
    r"commands array\(\[\]": lambda: np.zeros(0),
    r"commands 0\.0": lambda: 0.0,
    r"commands 'abc'": lambda: "abc",
    r"commands \['1\.0'\]": lambda: ["1.0"],
    r"commands array\(\[1\.\+2\.j\]\)": lambda: np.array([1 + 2j]),
    r"commands array\(\[1\.\+0\.j\]\)": lambda: np.array([1 + 0j]),
    "commands None": lambda: None,
    r"commands \[None\]": lambda: [None],
    "commands {'u': 0}": lambda: {"u": 0},
    r"commands array\(\[<object": lambda: np.array([object()]),
    r"commands array\(\['2020": lambda: np.array(["2020-01-01"], "datetime64[s]"),
    r"commands masked_array": lambda: np.ma.masked_array([1.0], [True]),
    r"commands \[\[0\.0\], \[0\.0, 0\.0\]\]|commands no array": lambda: [[0.0], [0.0, 0.0]],
}


@pytest.mark.parametrize("message", WRONG)
def test_a_controller_at_fault_is_named_with_the_time(message):
    with pytest.raises(ScenarioError, match=rf"Faulty.*(?:{message}).* at t = 0\.15 s"):
        simulate(Loop(plant=Pendulum(), controller=Faulty(WRONG[message])), TEN)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("compiled", [True, False])
def test_a_command_that_is_no_number_is_a_failure_of_the_flight(compiled, value):
    @dataclass(frozen=True)
    class Late:
        dt: float = 0.05

        def init(self):
            return jnp.zeros(())

        def step(self, s, y, r):
            return s + 1, jnp.where(s >= 3, value, 0.0)[None]

    run = simulate(Loop(plant=Pendulum(), controller=Late()), TEN, compiled=compiled)
    assert (run.ok, run.culprit, run.failed_at) == (False, "controller", pytest.approx(0.15))
    assert len(run.time) == 6


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (lambda s, y, r: np.zeros(1), "returns a ndarray: return"),
        (lambda s, y, r: (s, y[:1], 1), "returns 3 values"),
        (lambda s, y, r: (s, y[0]), "return a vector"),
        (lambda s, y, r: (s, y[:1] * 1j), "return a vector of real"),
        (lambda s, y, r: (s, y[:0]), r"Pendulum does not take a command of shape \(0,\)"),
    ],
)
def test_what_can_be_traced_is_looked_at_too(controller, message):
    @dataclass(frozen=True)
    class Traced:
        dt: float = 0.05

        def init(self):
            return jnp.zeros(2)

        def step(self, s, y, r):
            return controller(s, y, r)

    for compiled in (None, True, False):
        with pytest.raises(ScenarioError, match=message if compiled is None else "Traced|Pendulum"):
            simulate(Loop(plant=Pendulum(), controller=Traced()), TEN, compiled=compiled)


def test_a_state_that_changes_its_form_is_stepped_not_compiled():
    @dataclass(frozen=True)
    class Growing:
        dt: float = 0.05

        def init(self):
            return ()

        def step(self, s, y, r):
            return (*s, y), 0.0 * y[:1]

    loop = Loop(plant=Pendulum(), controller=Growing())
    assert not can_compile(loop, TEN)
    assert len(simulate(loop, TEN).memory) == 10
    with pytest.raises(ScenarioError, match="state of another form"):
        simulate(loop, TEN, compiled=True)


def test_an_init_that_raises_and_a_controller_that_cannot_be_compiled_are_named():
    @dataclass(frozen=True)
    class Stillborn(Faulty):
        def init(self):
            return 1 // 0

    with pytest.raises(ScenarioError, match=r"Stillborn\.init raised ZeroDivisionError"):
        simulate(Loop(plant=Pendulum(), controller=Stillborn(None)), TEN)
    with pytest.raises(ScenarioError, match=r"Faulty cannot be compiled: .*; pass compiled=False"):
        simulate(Loop(plant=Pendulum(), controller=Faulty(None)), TEN, compiled=True)


def test_interruptions_pass():
    with pytest.raises(KeyboardInterrupt):
        simulate(Loop(plant=Pendulum(), controller=Faulty(raises(KeyboardInterrupt()))), TEN)


@dataclass(frozen=True)
class Sensor:
    """Measures the swing; something else from a time on, s."""

    until: float
    value: str = "nan"
    channels: int = 1

    def init(self):
        return jnp.zeros(())

    def measure(self, s, x, env, noise, h):
        return s + h, jnp.where(s + h > self.until, float(self.value), jnp.stack([x.angle, x.rate]))


@dataclass(frozen=True)
class Believer:
    """Takes a measurement for the truth; `deaf` keeps to what it knows where that is no number."""

    deaf: bool = False
    until: float = np.inf

    def init(self):
        return jnp.zeros(3)

    def update(self, s, y, u, env, h):
        if self.deaf:
            y = jnp.where(jnp.isfinite(y), y, s[:2])
        y = jnp.where(s[2] + h > self.until, jnp.nan, y)
        return jnp.append(y, s[2] + h), y


@dataclass(frozen=True)
class Melting(Pendulum):
    """Whose length vanishes when it swings back, with the square root of something negative."""

    def derivative(self, x, u, env):
        return Swing(x.rate, -9.81 * jnp.sin(x.angle) + 0 * jnp.sqrt(x.angle - 0.5))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize(
    ("blocks", "culprit"),
    [
        ({"sensors": Sensor(0.16), "navigator": Believer()}, "sensors"),
        ({"sensors": Sensor(0.16, "inf"), "navigator": Believer()}, "sensors"),
        ({"sensors": Sensor(0.16), "navigator": Believer(deaf=True)}, ""),
        ({"sensors": Sensor(0.16, "1e12"), "navigator": Believer()}, "navigator"),  # a number, beyond the bound
        ({"sensors": Sensor(9.0), "navigator": Believer(until=0.16)}, "navigator"),
        ({"sensors": Sensor(0.06), "navigator": Believer(deaf=True, until=0.16)}, "sensors"),  # both
        ({"plant": Melting()}, "plant"),
        ({"plant": Melting(), "sensors": Sensor(9.0), "navigator": Believer()}, "plant"),  # which measures NaN
    ],
)
def test_who_was_at_fault_and_when(blocks, culprit, compiled):
    loop = replace(Loop(plant=Pendulum(), controller=pd(0.0, 0.0)), **blocks)
    run = simulate(loop, scenario(periods=20), compiled=compiled)
    assert (run.ok, run.culprit) == (not culprit, culprit)
    if culprit and "plant" not in blocks:
        assert run.failed_at == pytest.approx(0.15)
    assert np.isfinite(run.outputs).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"samples": 10**12}, "this machine"),
        ({"periods": 10**30}, "this machine"),
        ({"periods": True}, "periods = True"),
        ({"bound": "x"}, "bound = 'x'"),
        ({"dt": None}, "dt = None"),
        ({"dt": 1 + 1j}, "dt = "),
        ({"initial": None}, r"does not fit the plant: Pendulum\.output"),
        ({"initial": Swing(np.zeros(2), 0.0)}, "does not fit the plant"),
        ({"environment": 3}, "scenario.environment"),
    ],
)
def test_what_cannot_be_flown_is_told_before_the_flight(changes, message):
    with pytest.raises(ScenarioError, match=message):
        simulate(Loop(plant=Pendulum(), controller=pd(1.0, 1.0)), scenario(**changes))
