"""Uncertain linear models: exact where the structure is polynomial, named an expansion where it is not."""

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants import EulerBody, FreeSpace, ScenarioError, blocks, linearize, uncertain_model
from plants.dynamics.eulerbody import EulerState, RandomTorque
from plants.dynamics.rigidbody import RigidBody, state_from
from plants.surroundings import orbit
from plants.surroundings.disturbances import GravityGradient
from plants.surroundings.environment import CircularEnvironment
from synth import UncertainSystem, ureal

NADIR = CircularEnvironment.along(orbit.circular(470e3, np.deg2rad(51.6), 2.0, 0.4))
SPIN = 1.7e-5  # kg m^2, of a rotor
INERTIA = np.array([[0.05, 0.002, -0.001], [0.002, 0.06, 0.003], [-0.001, 0.003, 0.02]])
UPPER = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
ENTRIES = {f"I{'xyz'[i]}{'xyz'[j]}": INERTIA[i, j] for i, j in UPPER}


def nadir(wheels=()):
    with jax.enable_x64(True):
        x = state_from(np.array([1.0, 0, 0, 0]), np.zeros(3), np.array(wheels, float), NADIR.at(0.0))
        return jax.tree.map(np.asarray, x)


def symmetric(p):
    rows = [[None] * 3 for _ in range(3)]
    for value, (i, j) in zip(p, UPPER, strict=True):
        rows[i][j] = rows[j][i] = value
    return jnp.stack([jnp.stack(row) for row in rows]) if not isinstance(p, np.ndarray) else np.array(rows, float)


def wheeled(p):
    wheels = {"wheel_axes": np.eye(3), "wheel_inertia": np.full(3, SPIN)}
    return RigidBody.create(symmetric(p), disturbances=(GravityGradient(),), physical=False, **wheels)


SPINNING = nadir(wheels=[40.0, -25.0, 60.0])
ABOUT: dict[str, Any] = {"x": SPINNING, "u": np.zeros(3), "environment": NADIR, "hold": ("wheels",)}


@pytest.fixture(scope="module")
def six():
    return uncertain_model(wheeled, ENTRIES, **ABOUT, within=0.3)


def test_every_entry_of_an_inertia_is_exact(six):
    assert six.exact
    assert six.error < 1e-10
    assert len(six.powers) == 7
    rng = np.random.default_rng(0)
    for _ in range(5):
        p = six.nominal * (1 + rng.uniform(-0.5, 0.5, 6))
        E, A, B, C, D = six.at(dict(zip(six.names, p, strict=True)))
        true = linearize(wheeled(p), **ABOUT)
        np.testing.assert_allclose(np.linalg.solve(E, A), true.A, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(np.linalg.solve(E, B), true.B, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(C, np.eye(6))
        np.testing.assert_array_equal(D, np.zeros((6, 3)))


def test_symbols_give_an_uncertain_system_with_the_inertia_on_the_left(six):
    p = {name: ureal(name, float(x), percentage=30) for name, x in zip(six.names, six.nominal, strict=True)}
    G = UncertainSystem(*six.at(p))
    assert set(G.parameters) == set(ENTRIES)
    assert {name for entry in G.E.flat for name in entry.parameters} == set(ENTRIES)
    assert not any(entry.parameters for entry in G.B.flat)  # a torque acts as it is, whatever the inertia
    for values, H in G.sample(3):
        true = linearize(wheeled(np.array([values[name] for name in six.names])), **ABOUT)
        np.testing.assert_allclose(H.A, true.A, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(H.B, true.B, rtol=1e-9, atol=1e-12)


def test_a_body_with_euler_angles():
    at = EulerState(np.array([0.3, -0.2, 0.5]), np.array([0.02, -0.01, 0.03]), np.array([5.0, -8.0, 3.0]))
    push = RandomTorque.create(0.0, period=1.0, duration=2.0, seed=0)
    make = partial(EulerBody.create, wheel_inertia=np.full(3, 0.0018), physical=False)
    model = uncertain_model(lambda p: make(jnp.diag(p)), {"Ix": 1.2, "Iy": 1.1, "Iz": 0.9}, at, np.zeros(3), push)
    assert model.exact
    true = linearize(make(np.diag([1.3, 1.0, 0.8])), at, np.zeros(3), push)
    E, A, *_ = model.at({"Ix": 1.3, "Iy": 1.0, "Iz": 0.8})
    np.testing.assert_allclose(np.linalg.solve(E, A), true.A, rtol=1e-9, atol=1e-12)


class Swing(NamedTuple):
    angle: Any
    rate: Any


@partial(blocks.node, data_fields=["length"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Pendulum:
    """As a user would write it."""

    length: Any

    def derivative(self, x, u, env):
        return Swing(x.rate, (-9.81 * jnp.sin(x.angle) + u[0]) / self.length)

    def output(self, x, env):
        return jnp.stack([jnp.asarray(x.angle), jnp.asarray(x.rate)])

    def project(self, x):
        return x


@partial(blocks.node, data_fields=["length"], meta_fields=[])
@dataclass(frozen=True, kw_only=True)
class Told(Pendulum):
    """It knows that its length multiplies the rate."""

    def mass(self):
        return jnp.diag(jnp.stack([jnp.ones(()), jnp.asarray(self.length)]))


def pendulum(kind, order=1, within=0.1):
    rest = Swing(np.array(0.4), np.array(0.0))
    return uncertain_model(
        lambda p: kind(length=p[0]), {"l": 2.0}, rest, [0.0], FreeSpace(), order=order, within=within
    )


def test_what_is_no_polynomial_is_called_an_expansion():
    told, first, second = pendulum(Told), pendulum(Pendulum), pendulum(Pendulum, order=2)
    assert told.exact
    assert not first.exact
    assert not second.exact
    assert first.error == pytest.approx(0.1**2, rel=0.2)  # 1/(1 + d) - (1 - d), relative
    assert second.error == pytest.approx(0.1**3, rel=0.2)


@settings(max_examples=10, deadline=None)
@given(st.floats(0.01, 0.4))
def test_the_error_is_that_at_the_corners(within):
    model = pendulum(Pendulum, within=within)
    ends = [2.0 * (1 - within), 2.0 * (1 + within)]
    assert (model.low[0], model.high[0]) == pytest.approx(tuple(ends))
    true = [-9.81 * np.cos(0.4) / end for end in ends]
    ours = [model.at({"l": end})[1][1, 0] for end in ends]
    assert model.error == pytest.approx(max(abs(a / b - 1) for a, b in zip(ours, true, strict=True)), rel=1e-6)


@dataclass(frozen=True, kw_only=True)
class InUnits(Pendulum):
    """An output that is measured with the pendulum itself."""

    def output(self, x, env):
        return jnp.stack([x.angle * self.length, jnp.asarray(x.rate)])


blocks.node(InUnits, data_fields=["length"], meta_fields=[])


def test_bad_arguments_are_refused():
    for change, told in (
        ({"parameters": {}}, "names 0 numbers"),
        ({"parameters": {"Ix": 0.0, "Iy": 1.0, "Iz": 1.0}}, r"parameters\['Ix'\] = 0"),
        ({"parameters": {"Ix": np.nan, "Iy": 1.0, "Iz": 1.0}}, "must be finite"),
        ({"within": {"Ix": 0.1}}, r"within names \['Ix'\]"),
        ({"within": -0.1}, "within of Ix must be positive"),
        ({"order": 3}, "order = 3: give 1 or 2"),
        ({"hold": ("gimbals",)}, "hold names"),
    ):
        moments = {"Ix": 0.05, "Iy": 0.06, "Iz": 0.02}
        given = {"parameters": moments, "x": nadir(), "u": np.zeros(3), "environment": FreeSpace(), **change}
        with pytest.raises(ScenarioError, match=told):
            uncertain_model(RigidBody.create, **given)
    with pytest.raises(ScenarioError, match="depends on the parameters"):
        pendulum(InUnits)
    with pytest.raises(ScenarioError, match="the parameters are"):
        pendulum(Told).at({"length": 1.0})
