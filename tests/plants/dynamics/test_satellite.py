"""The satellite with its effectors: the rigid body's equations, friction, imbalance, coils, gyroscopes, mistakes."""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants.dynamics.cmgs import Cmgs
from plants.dynamics.rigidbody import BodyState, RigidBody, state_from
from plants.dynamics.satellite import Satellite, SatelliteState
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.effectors import equip
from plants.hardware.wheels import Wheel
from plants.simulation.flight import rk4
from plants.simulation.linearize import linearize
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings import orbit
from plants.surroundings.disturbances import ConstantTorque
from plants.surroundings.environment import CircularEnvironment, FreeSpace

FULL = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]]) / 1e3  # kg m^2, no symmetry
PYRAMID = np.array([[1, -1, 0, 0], [0, 0, 1, -1], [1, 1, 1, 1]]) / np.sqrt(2)
JS, VISCOUS, COULOMB = 2e-4, 4e-7, 5e-5  # kg m^2, N m s, N m
REST = np.array([1.0, 0, 0, 0])
DATA = Path(__file__).parents[2] / "data"


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


@dataclass(frozen=True, kw_only=True)
class Held:
    """A controller that always asks for the same."""

    dt: float
    command: np.ndarray

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, self.command


def wheels(axes=PYRAMID, **sheet):
    return [Wheel.create(axis, **{"max_torque": 1e-2, "inertia": JS, "max_speed": 600.0} | sheet) for axis in axes.T]


def fly(plant, x, u, *, h, periods, steps=1, environment=None):
    loop = Loop(plant=plant, controller=Held(dt=h, command=np.asarray(u, float)))
    scenario = Scenario(initial=x, dt=h, periods=periods, steps=steps, environment=environment or FreeSpace())
    run = simulate(loop, scenario)
    assert run.ok
    return run


def at(plant, w=(0.0, 0, 0), **parts):
    return plant.state(REST, np.asarray(w, float), FreeSpace(), **parts)


def momentum(plant, states):
    """In frame N, (N, 3)."""
    return np.asarray(jax.vmap(lambda x: attitude.rotate(attitude.conjugate(x.q), plant.momentum(x)))(states))


def test_with_ideal_wheels_it_is_the_rigid_body():
    body = RigidBody.create(FULL, wheel_axes=PYRAMID, wheel_inertia=np.full(4, JS))
    plant, u, env = Satellite.create(FULL, wheels=wheels()), np.array([1e-3, -2e-4, 3e-5, 1e-3]), FreeSpace().at(0.0)
    x = SatelliteState(REST, np.array([0.01, -0.02, 0.03]), np.array([50.0, -100, 20, 3]), np.zeros(0), np.zeros(0))
    bare = BodyState(*x[:3])
    expected, got = body.derivative(bare, u, env), plant.derivative(x, u, env)
    for a, b in zip(expected, got[:3], strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(plant.output(x, env), body.output(bare, env))


@pytest.mark.parametrize(("viscous", "coulomb"), [(VISCOUS, 0.0), (0.0, COULOMB), (VISCOUS, COULOMB)])
def test_spin_down_is_the_closed_form(viscous, coulomb):
    """A wheel on a principal axis of a free body: dOm = -(b Om + c) (1/Js + 1/(I - Js)) far above the creep speed."""
    plant = Satellite.create([0.3, 0.4, 0.5], wheels=wheels(np.eye(3)[:, 2:], viscous=viscous, coulomb=coulomb))
    run = fly(plant, at(plant, wheels=[500.0]), [0.0], h=2.0, periods=200)
    rate, t = 1 / JS + 1 / (0.5 - JS), run.time
    level = coulomb / viscous if viscous else 0.0
    expected = (500 + level) * np.exp(-viscous * rate * t) - level if viscous else 500 - coulomb * rate * t
    assert run.states.wheels[-1, 0] < 480
    np.testing.assert_allclose(run.states.wheels[:, 0], expected, rtol=1e-9)
    np.testing.assert_allclose(run.states.w[:, 2], JS / 0.5 * (500 - expected), rtol=0, atol=1e-12)


def test_momentum_is_kept_through_friction_and_zero_crossings_and_energy_is_lost():
    sheet = {"viscous": VISCOUS, "coulomb": COULOMB, "static": 2 * COULOMB}
    plant = Satellite.create(FULL, wheels=wheels(**sheet))
    x = at(plant, [0.02, -0.03, 0.01], wheels=[30.0, -20, 10, -5])
    run = fly(plant, x, np.zeros(4), h=0.5, periods=600)
    kept = momentum(plant, run.states)
    assert np.linalg.norm(kept - kept[0], axis=1).max() < 1e-9 * np.linalg.norm(kept[0])
    w, spin = run.states.w, run.states.wheels
    energy = 0.5 * np.einsum("ki,ij,kj->k", w, FULL, w) + JS * np.einsum("ki,ij,kj->k", w, PYRAMID, spin)
    energy += 0.5 * JS * (spin**2).sum(axis=1)
    assert (np.sign(spin[-1]) != np.sign(spin[0])).any() or np.abs(spin[-1]).max() < 1.0
    assert (np.diff(energy) < 1e-13 * energy[0]).all()
    assert energy[-1] < 0.9 * energy[0]


def test_power_of_friction_is_its_torque_times_speed():
    """With motors: dT/dt = (u + f) Om, whatever the body does."""
    plant = Satellite.create(FULL, wheels=wheels(viscous=VISCOUS, coulomb=COULOMB, static=3 * COULOMB, creep=2.0))
    u, x = np.array([3e-4, -2e-4, 1e-4, 2e-4]), at(plant, [0.02, -0.03, 0.01], wheels=[100.0, -50, 0.7, 3])

    def energy(x):
        spin = JS * jnp.asarray(x.wheels)
        return 0.5 * x.w @ FULL @ x.w + x.w @ PYRAMID @ spin + 0.5 * x.wheels @ spin

    _, power = jax.jvp(energy, (x,), (plant.derivative(x, u, FreeSpace().at(0.0)),))
    friction = plant.friction.torque(x.wheels)
    assert (np.asarray(friction) * x.wheels < 0).all()
    assert power == pytest.approx(float((u + friction) @ x.wheels), rel=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.floats(0, 1e-5), st.floats(1e-6, 1e-3), st.floats(1, 4), st.floats(0.1, 5))
def test_friction_is_odd_brakes_and_breaks_away(viscous, coulomb, ratio, creep):
    sheet = {"viscous": viscous, "coulomb": coulomb, "static": ratio * coulomb, "creep": creep}
    with jax.enable_x64(True):
        plant = Satellite.create(FULL, wheels=wheels(**sheet))
        speeds = np.array([0.0, 20 * creep, -20 * creep, 1e3 * creep])
        f = np.asarray(plant.friction.torque(speeds))
    assert f[0] == 0
    assert f[1] == -f[2]
    far = -(viscous * speeds[3] + coulomb)  # static friction has given way
    assert f[3] == pytest.approx(far, rel=1e-12)
    slowest = np.linspace(0, 10 * creep, 1001)[:, None] * np.ones(4)
    with jax.enable_x64(True):
        peak = -np.asarray(jax.vmap(plant.friction.torque)(slowest))[:, 0]
    assert (peak >= 0).all()
    assert peak.max() <= viscous * 10 * creep + ratio * coulomb * (1 + 1e-12)


def test_a_rotor_at_rest_holds_against_less_than_static_friction_and_not_against_more():
    plant = Satellite.create([3.0, 4.0, 5.0], wheels=wheels(np.eye(3), coulomb=COULOMB, static=2 * COULOMB, creep=0.5))
    run = fly(plant, at(plant), np.array([1.5, 2.5, -1.5]) * COULOMB, h=0.5, periods=200)
    end = run.states.wheels[-1]
    np.testing.assert_allclose(np.abs(end[[0, 2]]), 0.5 * np.arctanh(1.5 / 2), rtol=0.05)  # creeps
    assert end[1] > 30  # breaks away: (2.5 - 1) c / Js, 37 rad/s in 100 s, less the start


def test_longest_step_is_where_a_rotor_comes_to_rest_without_ringing():
    """Beyond it the simulator refuses; a plant without that check rings there."""
    plant = Satellite.create([3.0, 4.0, 5.0], wheels=wheels(np.eye(3), coulomb=50 * COULOMB))
    h = plant.longest_step
    assert h == pytest.approx(2.78 * JS / (50 * COULOMB), rel=1e-12)
    run = fly(plant, at(plant, wheels=[0.3, 0, 0]), np.zeros(3), h=0.9 * h, periods=60)
    assert np.abs(run.states.wheels[-1, 0]) < 0.1
    x, env = at(plant, wheels=[0.3, 0, 0]), FreeSpace().at(0.0)
    step = jax.jit(lambda x: rk4(plant, x, np.zeros(3), [env] * 3, 1.3 * h))
    for _ in range(60):
        x = step(x)
    assert np.abs(x.wheels[0]) > 0.1
    with pytest.raises(ScenarioError, match="its `longest_step` is"):
        fly(plant, at(plant), np.zeros(3), h=1.3 * h, periods=1)
    shaky = Satellite.create(FULL, wheels=wheels(dynamic_imbalance_g_cm2=1.0))
    assert shaky.longest_step == pytest.approx(2 * np.pi / 600 / 20)
    with pytest.raises(ScenarioError, match="imbalance"):
        fly(shaky, at(shaky), np.zeros(4), h=0.1, periods=1)


def test_wheels_as_sold_fly_as_in_basilisk():
    """Friction, static and dynamic imbalance on four wheels, 4 s in steps of 0.5 ms."""
    told = np.load(DATA / "basilisk_wheels_as_sold.npz")
    sheet = {"static_imbalance_g_cm": 1e5 * told["Us"], "dynamic_imbalance_g_cm2": 1e7 * told["Ud"]}
    sold = [
        Wheel.create(
            axis, max_torque=1.0, inertia=told["Js"], max_speed=600.0, position=position,
            viscous=told["viscous"], coulomb=told["coulomb"], **sheet,
        )
        for axis, position in zip(told["axes"].T, told["position"].T, strict=True)
    ]  # fmt: skip
    plant = Satellite.create(told["inertia"], wheels=sold)
    begin = np.arctan2(
        *((told["heavy"] * part).sum(axis=0) for part in (plant.imbalance.along, plant.imbalance.across))
    )
    x = at(plant, told["w"][0], wheels=told["Om"][0])._replace(phase=np.mod(begin, 2 * np.pi))
    loop = Loop(plant=plant, controller=Held(dt=0.1, command=told["us"]))
    run = simulate(loop, Scenario(initial=x, dt=0.1, periods=40, samples=200, environment=FreeSpace()))
    w, Om, phase, q = (a[::200] for a in (run.states.w, run.states.wheels, run.states.phase, run.states.q))
    np.testing.assert_allclose(w, told["w"][:40], rtol=0, atol=1e-14)
    np.testing.assert_allclose(Om, told["Om"][:40], rtol=1e-13)
    np.testing.assert_allclose(np.cos(phase - begin), np.cos(told["theta"][:40]), rtol=0, atol=1e-10)
    mrp = q[:, 1:] / (1 + q[:, :1])
    np.testing.assert_allclose(mrp, told["s"][:40], rtol=0, atol=1e-12)
    still = Satellite.create(told["inertia"], wheels=wheels(told["axes"]))
    quiet = fly(still, at(still, told["w"][0], wheels=told["Om"][0]), told["us"], h=0.1, periods=40)
    assert np.abs(quiet.states.w - told["w"][:40]).max() > 5e-4  # what is compared is not negligible


@pytest.fixture(scope="module")
def shaken():
    """2 s of a wheel with dynamic imbalance at constant speed on a body of equal moments."""
    with jax.enable_x64(True):
        sheet = wheels(np.eye(3)[:, 2:], dynamic_imbalance_g_cm2=20.0)
        plant = Satellite.create([0.5, 0.5, 0.5], wheels=sheet)
        x = plant.state(REST, np.zeros(3), FreeSpace(), wheels=[300.0])
        return plant, fly(plant, x, [0.0], h=5e-4, periods=4000)


def test_dynamic_imbalance_shakes_as_its_closed_form(shaken):
    """J dw = Ud Om^2 e^(i Om t) + i H w across the axis, H the momentum along it: a sum of two rotations."""
    plant, run = shaken
    J, Ud, Om, t = 0.5, 20e-7, 300.0, run.time
    np.testing.assert_allclose(run.states.wheels, Om, rtol=1e-12)
    np.testing.assert_allclose(np.cos(run.states.phase[:, 0]), np.cos(Om * t), rtol=0, atol=1e-8)
    nu = JS * Om / J
    expected = Ud * Om**2 / J * (np.exp(1j * Om * t) - np.exp(1j * nu * t)) / (1j * (Om - nu))
    axes = np.stack([plant.imbalance.across[:, 0], plant.imbalance.along[:, 0]])
    got = run.states.w @ axes.T @ np.array([1, 1j])
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    assert np.abs(run.states.w[:, 2]).max() < 1e-15


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 50), st.floats(-700, 700), st.floats(-10, 10))
def test_imbalance_is_a_force_at_a_lever_and_a_torque_across_the_axis(seed, grams, Om, phase):
    rng = np.random.default_rng(seed)
    axis, lever = rng.normal(size=3), rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    with jax.enable_x64(True):
        one = {"max_torque": 1.0, "inertia": JS, "max_speed": 800.0, "position": lever}
        static = Satellite.create(FULL, wheels=[Wheel.create(axis, static_imbalance_g_cm=grams, **one)])
        dynamic = Satellite.create(FULL, wheels=[Wheel.create(axis, dynamic_imbalance_g_cm2=grams, **one)])
        s, d = (np.asarray(p.imbalance.torque([Om], [phase])) for p in (static, dynamic))
        quarter = np.asarray(dynamic.imbalance.torque([Om], [phase + np.pi / 2]))
    size = 1e-7 * grams * Om**2
    assert np.linalg.norm(d) == pytest.approx(size, rel=1e-12)
    assert abs(d @ axis) <= 1e-12 * size
    np.testing.assert_allclose(quarter, np.cross(axis, d), rtol=0, atol=1e-12 * size)  # turns with the rotor
    np.testing.assert_allclose(s, np.cross(lever, 100 * d), rtol=0, atol=1e-10 * size * np.linalg.norm(lever))


def test_the_torque_of_coils_is_m_cross_b_and_thrusters_push_the_body():
    plant = Satellite.create(FULL, magnetorquers=True, thrusters=True)
    env = FreeSpace().at(0.0)._replace(B=jnp.array([2e-5, -1e-5, 3e-5]))
    q = np.asarray(attitude.from_euler([0.3, -0.2, 1.0]))
    x = plant.state(q, np.zeros(3), FreeSpace())
    m, torque = np.array([3.0, -1.0, 2.0]), np.array([1e-3, 2e-3, -3e-3])
    dw = plant.derivative(x, np.concatenate([m, torque]), env).w
    B = np.asarray(attitude.dcm(q)) @ env.B
    np.testing.assert_allclose(FULL @ dw, np.cross(m, B) + torque, rtol=0, atol=1e-17)


def test_gyroscopes_conserve_momentum_and_give_their_torque():
    cluster = Cmgs.pyramid(momentum=2.0)
    plant = Satellite.create(10 * FULL, cmgs=cluster)
    x = at(plant, [0.01, 0.02, -0.01], gimbals=[0.3, -0.2, 0.5, 0.1])
    run = fly(plant, x, [0.02, -0.03, 0.01, 0.04], h=0.1, periods=600, steps=4)
    kept = momentum(plant, run.states)
    assert np.linalg.norm(kept - kept[0], axis=1).max() < 1e-9 * np.linalg.norm(kept[0])
    assert np.ptp(run.states.w, axis=0).min() > 0.05
    rates = np.array([0.02, -0.03, 0.01, 0.04])
    _, slope = jax.jvp(cluster.momentum, (run.states.gimbals[7],), (rates,))
    np.testing.assert_allclose(cluster.jacobian(run.states.gimbals[7]) @ rates, slope, rtol=0, atol=1e-15)


def test_state_is_the_one_of_the_rigid_body_and_its_phase_stays_in_a_turn(shaken):
    environment = CircularEnvironment.along(orbit.circular(470e3, 0.9, 2.0, 0.4))
    plant = Satellite.create(FULL, wheels=wheels())
    q, w = np.asarray(attitude.from_euler([0.3, -0.4, 2.9])), np.array([0.01, 0.02, -0.03])
    x = plant.state(q, w, environment, t=321.0, wheels=np.arange(4.0))
    expected = state_from(q, w, np.arange(4.0), environment.at(321.0))
    np.testing.assert_allclose(np.concatenate(x[:3]), np.concatenate(expected), rtol=0, atol=1e-16)
    assert {np.asarray(part).dtype for part in x} == {np.dtype(float)}
    assert (shaken[1].states.phase >= 0).all()
    assert (shaken[1].states.phase < 2 * np.pi).all()


def test_linear_model_is_the_one_of_the_rigid_body():
    environment = CircularEnvironment.along(orbit.circular(470e3, 0.9, 2.0, 0.4))
    plant = Satellite.create(FULL, wheels=wheels(dynamic_imbalance_g_cm2=1.0))
    x = plant.state(REST, np.zeros(3), environment)
    ours = linearize(plant, x, np.zeros(4), environment, hold=("wheels", "phase"))
    theirs = linearize(plant.body, BodyState(*x[:3]), np.zeros(4), environment, hold=("wheels",))
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-15 * max(1, np.abs(b).max()))


def test_data_sheets_take_traced_numbers():
    """Friction dispersed inside jit: the same as outside."""
    x, env = at(Satellite.create(FULL, wheels=wheels()), wheels=[10.0, -20, 30, 5]), FreeSpace().at(0.0)

    def rate(coulomb, imbalance):
        sheet = wheels(coulomb=coulomb, dynamic_imbalance_g_cm2=imbalance)
        plant, actuator = equip(FULL, wheels=sheet, wanted_speeds=[1.0, 1, -1, -1], null_rate=0.1)
        start = x._replace(phase=np.zeros(4))
        return plant.derivative(start, actuator.apply(actuator.init(), np.ones(3), x, np.zeros(4), 1.0)[1], env).wheels

    np.testing.assert_allclose(jax.jit(rate)(COULOMB, 2.0), rate(COULOMB, 2.0), rtol=1e-12)


def test_disturbances_act():
    plant = Satellite.create(FULL, wheels=wheels(), disturbances=(ConstantTorque.create([0, 0, 1e-3]),))
    dw = plant.derivative(at(plant), np.zeros(4), FreeSpace().at(0.0)).w
    np.testing.assert_allclose(plant.body.inverse @ [0, 0, 1e-3], dw, rtol=1e-14)


BOTH = {"wheels": wheels(), "magnetorquers": True}


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: Satellite.create(FULL), "nothing turns the satellite"),
        (lambda: Satellite.create([1.0, 0.1, 0.1], wheels=wheels()), "which no body has"),
        (
            lambda: Satellite.create(FULL, **BOTH).split(np.zeros(4)),
            r"shape \(4,\): give 4 motor.*3 of a dipole",
        ),
        (lambda: at(Satellite.create(FULL, **BOTH), wheels=[1.0]), "wheels must have shape"),
        (lambda: at(Satellite.create(FULL, **BOTH), gimbals=[1.0]), "gimbals must have shape"),
        (
            lambda: Satellite.create(FULL, **BOTH).state(2 * REST, np.zeros(3), FreeSpace()),
            "q_OB must be a unit",
        ),
        (lambda: Cmgs.create(np.eye(3), np.eye(3), momentum=1.0), "spin_axes must be perpendicular"),
        (lambda: Cmgs.create(2 * np.eye(3), np.eye(3), momentum=1.0), "gimbal_axes must be unit columns"),
        (lambda: Cmgs.pyramid(momentum=[1.0, 1, 1]), "momentum must have shape"),
        (lambda: Cmgs.pyramid(momentum=1.0, skew=90.0), "skew = 90"),
    ],
)
def test_mistakes_are_named(act, message):
    with pytest.raises(ScenarioError, match=message):
        act()


def test_a_state_of_another_satellite_is_refused():
    plant = Satellite.create(FULL, wheels=wheels(dynamic_imbalance_g_cm2=1.0))
    x = at(plant)
    for part, value in (("phase", np.zeros(0)), ("gimbals", np.zeros(2)), ("wheels", np.zeros(3))):
        with pytest.raises(ScenarioError, match=f"{part}.* has shape"):
            plant.derivative(x._replace(**{part: value}), np.zeros(4), FreeSpace().at(0.0))
        with pytest.raises(ScenarioError, match=f"initial.{part} has shape"):
            plant.check(x._replace(**{part: value}))
    with pytest.raises(ScenarioError, match=r"initial.q has length 2"):
        plant.check(x._replace(q=2 * REST))
    plant.check(x)
