"""Flexible appendages: what is conserved, free and clamped frequencies, decay, panels and tanks, mistakes."""

from dataclasses import replace
from datetime import datetime
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from uncertain import flexible_satellite

from plants import spacecraft
from plants.dynamics.appendages import Appendage, flexible_model
from plants.dynamics.satellite import Satellite
from plants.errors import ScenarioError
from plants.geometry import attitude
from plants.hardware.wheels import Wheel
from plants.simulation.flight import rk4
from plants.simulation.linearize import linearize
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings import orbit
from plants.surroundings.environment import FreeSpace
from synth import UncertainSystem, series, system, ureal

DATA = Path(__file__).parents[2] / "data"
REST = np.array([1.0, 0, 0, 0])
INERTIA = np.array([[500.0, 12, -7], [12, 620, 5], [-7, 5, 450]])  # kg m^2
JS = 0.05  # kg m^2, of a wheel
W, Z = np.array([1.2, 5.0, 7.5]), 0.005
D = np.array([[14.0, 6.0, 0.5], [2.0, -1.0, 8.0], [-1.5, 3.0, 0.2]])  # sqrt(kg) m
PANEL = Appendage.create(W, couplings=D, damping=Z)
MOTION = {"modes": np.array([0.5, -0.2, 0.1]), "mode_rates": np.array([0.3, 0.4, -0.5])}


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


class Nothing:
    """No torque."""

    dt = 0.02

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, jnp.zeros(3)


def satellite(appendages=(PANEL,), inertia=INERTIA, **sheet):
    wheels = [Wheel.create(e, max_torque=1.0, inertia=JS, max_speed=600.0, **sheet) for e in np.eye(3)]
    return Satellite.create(inertia, wheels=wheels, appendages=appendages)


def at(plant, w=(0.0, 0, 0), **parts):
    return plant.state(REST, np.asarray(w, float), FreeSpace(), **parts)


@partial(jax.jit, static_argnames="steps")
def moved(plant, x, u, h, steps):
    """The state after Runge-Kutta steps of h s."""
    envs = [FreeSpace().at(0.0)] * 3
    return jax.lax.fori_loop(0, steps, lambda _, x: rk4(plant, x, u, envs, h), x)


def energy(plant, x):
    """Kinetic and potential, () J."""
    flexible, wheels, w = plant.appendages, plant.body.wheel_inertia, jnp.asarray(x.w)
    spin = plant.body.wheel_axes.T @ w + x.wheels
    whole = plant.body.inertia - (plant.body.wheel_axes * wheels) @ plant.body.wheel_axes.T
    eta, rate = jnp.asarray(x.modes), jnp.asarray(x.mode_rates)
    moved = w @ whole @ w + wheels @ spin**2 + 2 * w @ flexible.momentum(rate) + rate @ rate
    return (moved + eta @ (flexible.frequencies**2 * eta)) / 2


def test_energy_and_inertial_momentum_are_kept_over_a_long_flight():
    """10 000 steps with wheels that spin, a body that tumbles and three modes that swing."""
    plant = satellite([replace(PANEL, damping=np.zeros(3))])
    x = at(plant, [0.05, -0.03, 0.04], wheels=[100.0, -50, 20], **MOTION)
    scenario = Scenario(initial=x, dt=Nothing.dt, periods=2500, samples=4, environment=FreeSpace())
    run = simulate(Loop(plant=plant, controller=Nothing()), scenario)
    assert run.ok
    turned = jax.vmap(lambda x: attitude.rotate(attitude.conjugate(x.q), plant.momentum(x)))
    kept, stored = np.asarray(turned(run.states)), np.asarray(jax.vmap(lambda x: energy(plant, x))(run.states))
    assert np.abs(run.states.modes).max(axis=0).min() > 0.05
    assert np.linalg.norm(kept - kept[0], axis=1).max() < 1e-9 * np.linalg.norm(kept[0])
    assert np.abs(stored / stored[0] - 1).max() < 1e-9


def test_power_is_that_of_the_motors_less_what_damping_takes():
    """d energy = u . Om - eta' 2 z W eta', whatever the motion."""
    plant, u = satellite(), np.array([0.3, -0.2, 0.5])
    x = at(plant, [0.05, -0.03, 0.04], wheels=[100.0, -50, 20], **MOTION)
    _, power = jax.jvp(lambda x: energy(plant, x), (x,), (plant.derivative(x, u, FreeSpace().at(0.0)),))
    lost = MOTION["mode_rates"] @ (2 * Z * W * MOTION["mode_rates"])
    assert power == pytest.approx(float(u @ x.wheels - lost), rel=1e-12)


def test_a_free_single_mode_swings_faster_than_a_clamped_one():
    """w_f = W / sqrt(1 - d^2 / J), and the body swings against it: J w = -d eta'."""
    J, d, wheel = 500.0, 14.0, 1.0
    panel = Appendage.create([1.2], couplings=[[d], [0], [0]])
    free = 1.2 / np.sqrt(1 - d**2 / J)
    assert panel.free([J, 600, 600])[0] == pytest.approx(free, rel=1e-14)
    plant = satellite([panel], np.diag([J + JS, 600.0, 600.0]))
    x, h = at(plant, modes=[wheel]), 2 * np.pi / free / 400
    x = moved(plant, x, np.zeros(3), h, 400)
    assert float(x.modes[0]) == pytest.approx(wheel, rel=1e-8)
    assert float(x.mode_rates[0]) == pytest.approx(0.0, abs=1e-7)
    x = moved(plant, x, np.zeros(3), h, 100)
    assert float(x.w[0]) == pytest.approx(-d * float(x.mode_rates[0]) / J, rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 6))
def test_free_frequencies_are_those_of_the_mass_matrix_and_interlace(seed, m):
    rng = np.random.default_rng(seed)
    w = rng.uniform(0.5, 20, m)
    d = rng.normal(size=(3, m))
    J = d @ d.T + np.diag(rng.uniform(0.2, 3, 3))
    panel = Appendage.create(w, couplings=d)
    M = np.block([[J, d], [d.T, np.eye(m)]])
    found = np.sort(np.linalg.eigvals(np.linalg.solve(M, np.diag([0.0, 0, 0, *w**2]))).real)
    free = panel.free(J)
    np.testing.assert_allclose(free, np.sqrt(found[3:]), rtol=1e-7)
    assert (free >= np.sort(w) * (1 - 1e-12)).all()
    model = flexible_model(J, w, couplings=d, damping=0.0)
    poles = np.linalg.eigvals(np.linalg.solve(model.E, model.A))
    assert np.abs(poles.imag).max() == pytest.approx(free[-1], rel=1e-7)


def test_modes_of_a_held_hub_decay_with_their_damping():
    """A hub far heavier than what swings on it: exp(-z W t) of the amplitude."""
    plant = satellite([Appendage.create([2.0], couplings=np.full((3, 1), 1e-4), damping=[0.03])])
    x, h = at(plant, modes=[1.0]), 2 * np.pi / 2 / np.sqrt(1 - 0.03**2) / 200
    x = moved(plant, x, np.zeros(3), h, 1000)
    assert float(x.modes[0]) == pytest.approx(np.exp(-0.03 * 2 * 1000 * h), rel=1e-7)


@pytest.mark.parametrize("appendages", [(), (Appendage.create([1.0, 3.0], couplings=np.zeros((3, 2))),)])
def test_without_coupling_it_is_the_rigid_satellite(appendages):
    rigid, plant, u = satellite(()), satellite(appendages), np.array([0.1, 0.2, -0.3])
    kept = {k: v[: 2 * len(appendages)] for k, v in MOTION.items()}
    x, y = (
        at(rigid, [0.05, -0.03, 0.04], wheels=[9.0, 8, 7]),
        at(plant, [0.05, -0.03, 0.04], wheels=[9.0, 8, 7], **kept),
    )
    x, y = moved(rigid, x, u, 0.05, 50), moved(plant, y, u, 0.05, 50)
    for a, b in zip(x[:5], y[:5], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=0)


def test_the_order_of_appendages_and_of_modes_does_not_matter():
    parts = [Appendage.create(W[[k]], couplings=D[:, [k]], damping=Z) for k in (2, 0, 1)]
    one, other, order = satellite(), satellite(parts), [2, 0, 1]
    x = at(one, [0.05, -0.03, 0.04], wheels=[9.0, 8, 7], **MOTION)
    y = at(other, [0.05, -0.03, 0.04], wheels=[9.0, 8, 7], **{name: v[order] for name, v in MOTION.items()})
    u, env = np.array([0.1, 0.2, -0.3]), FreeSpace().at(0.0)
    a, b = one.derivative(x, u, env), other.derivative(y, u, env)
    np.testing.assert_allclose(a.w, b.w, rtol=1e-13)
    np.testing.assert_allclose(np.asarray(a.mode_rates)[order], b.mode_rates, rtol=1e-12)


def test_a_hinged_panel_is_a_panel_on_a_hinge():
    """Rigid hub at the origin and panel about parallel z axes, from the energies of two bodies."""
    m, r, c, k, Ip = 20.0, 1.1, 0.8, 5.0, 3.0
    panel = Appendage.hinged(
        [0, 0, 1], position=[r, 0.3, 0], mass=m, centre=[c, 0, 0], inertia=[0.2, 0.5, Ip], stiffness=k, damping=0.01
    )
    about = Ip + m * c**2
    assert panel.frequencies[0] == pytest.approx(np.sqrt(k / about))
    momentum = about + m * c * r  # per unit of angle rate, about the centre of mass
    np.testing.assert_allclose(panel.couplings[:, 0], [0, 0, momentum / np.sqrt(about)], atol=1e-12)
    point = Appendage.hinged([0, 1, 0], position=[0, 0, 1.0], mass=m, centre=[0, 0, -0.4], inertia=np.zeros(3),
                             stiffness=m * 0.02 * 0.4)  # fmt: skip
    tank = Appendage.pendulum(m, length=0.4, hinge=[0, 0, 1.0], acceleration=[0, 0, 0.02])
    assert tank.frequencies == pytest.approx(np.sqrt(0.02 / 0.4) * np.ones(2))
    assert point.frequencies[0] == pytest.approx(tank.frequencies[0])
    np.testing.assert_allclose(tank.couplings @ tank.couplings.T, m * 0.6**2 * np.diag([1.0, 1, 0]), atol=1e-12)
    np.testing.assert_allclose(point.couplings @ point.couplings.T, m * 0.6**2 * np.diag([0.0, 1, 0]), atol=1e-12)


def test_hinged_panels_swing_as_in_basilisk():
    """Two different panels for 60 s. What is left is what the model leaves out: products of the motion with itself, so
    the relative error of a motion that is a hundred times as large is a hundred times as large."""
    told, parts, errors = np.load(DATA / "basilisk_hinged_panels.npz"), [], []
    inertia, about = told["hub"].copy(), told["inertia"][:, 1, 1] + told["mass"] * told["lever"] ** 2
    damping = told["friction"] / (2 * np.sqrt(told["stiffness"] * about))
    for k, (h1, h2, h3) in enumerate(told["frame"]):
        r, c, m = told["hinge"][k], -told["lever"][k] * h1, told["mass"][k]
        own = np.stack([h1, h2, h3], axis=1) @ told["inertia"][k] @ np.stack([h1, h2, h3])
        inertia += own + m * ((r + c) @ (r + c) * np.eye(3) - np.outer(r + c, r + c))
        parts.append(Appendage.hinged(h2, position=r, mass=m, centre=c, inertia=own, stiffness=told["stiffness"][k],
                                      damping=damping[k]))  # fmt: skip
    plant, scale = Satellite.create(inertia, thrusters=True, appendages=parts), np.sqrt(about)
    for w, angle, rate in zip(told["rate"], told["angle"], told["angle_rate"], strict=True):
        x = at(plant, w[0], modes=scale * angle[0], mode_rates=scale * rate[0])
        rows = [x := moved(plant, x, np.zeros(3), 0.01, 50) for _ in told["time"][1:]]
        off = (np.array([x.w for x in rows]) - w[1:], np.array([x.modes for x in rows]) / scale - angle[1:])
        errors.append(max(np.abs(off[0]).max() / np.abs(w).max(), np.abs(off[1]).max() / np.abs(angle).max()))
    assert errors[0] < 1e-5
    assert errors[1] == pytest.approx(100 * errors[0], rel=0.1)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_a_pendulum_turns_with_the_axes(seed):
    rng = np.random.default_rng(seed)
    R, hinge, pull = np.linalg.qr(rng.normal(size=(3, 3)))[0], rng.normal(size=3), rng.normal(size=3)
    one = Appendage.pendulum(3.0, length=0.5, hinge=hinge, acceleration=pull)
    other = Appendage.pendulum(3.0, length=0.5, hinge=R @ hinge, acceleration=R @ pull)
    scale = np.abs(one.couplings).max() ** 2
    turned = np.linalg.det(R) ** 2 * R @ one.couplings @ one.couplings.T @ R.T
    np.testing.assert_allclose(other.couplings @ other.couplings.T, turned, atol=1e-12 * scale)


def test_the_linear_model_is_the_jacobian_of_the_simulator():
    """About rest with spinning wheels; the angle is twice the quaternion's vector part."""
    plant, speeds = satellite(), np.array([100.0, -50, 20])
    x, env = at(plant, wheels=speeds), FreeSpace().at(0.0)

    def derivative(angles, modes, w, rates, u):
        q = jnp.concatenate([jnp.ones(1), angles / 2])
        held = speeds - w  # what keeps the momentum of wheels that no motor turns
        now = x._replace(q=q, modes=modes, w=w, mode_rates=rates, wheels=held)
        d = plant.derivative(now, -u, env)
        return jnp.concatenate([2 * jnp.asarray(d.q)[1:], d.modes, d.w, d.mode_rates])

    parts = [np.zeros(3)] * 5
    jacobian = jax.jit(jax.jacfwd(derivative, argnums=(0, 1, 2, 3, 4)))(*parts)
    hub = INERTIA - JS * np.eye(3)
    model = flexible_model(hub, W, couplings=D, damping=Z, momentum=JS * speeds)
    A, B = np.hstack(jacobian[:4]), np.asarray(jacobian[4])
    np.testing.assert_allclose(model.A, model.E @ A, rtol=0, atol=1e-12 * np.abs(model.A).max())
    np.testing.assert_allclose(model.B, model.E @ B, rtol=0, atol=1e-12)


def test_the_uncertain_model_is_that_of_the_literature():
    """One axis with PD control: the reference plant of the proofs, in other coordinates of the controller."""
    J = ureal("J", 500.0, percentage=20)
    w = [ureal(f"w{k}", value, percentage=20) for k, value in ((1, 1.2), (2, 5.0))]
    model = flexible_model(J, w, couplings=[14.0, 6.0], damping=0.005)
    plant = UncertainSystem(model.E, model.A, model.B, model.C[:1], model.D[:1])
    PD = system([2 * 0.7 * 500 * 0.1 * 100, 500 * 0.01 * 100], [1, 14.0, 100])
    loop = series(plant, PD).feedback(1)
    known = flexible_satellite(20)
    for values in ({"J": 500.0, "w1": 1.2, "w2": 5.0}, {"J": 410.0, "w1": 1.4, "w2": 4.2}):
        poles = loop.at(values).poles()
        np.testing.assert_allclose(np.sort_complex(poles), np.sort_complex(known.at(values).poles()), rtol=1e-8)


def test_a_spacecraft_takes_panels_and_its_step_is_bounded_by_the_fastest_mode():
    wheels = [Wheel.create(e, max_torque=1.0, inertia=JS, max_speed=600.0) for e in np.eye(3)]
    craft = spacecraft(
        inertia=INERTIA, wheels=wheels, appendages=[PANEL], orbit=orbit.circular(500e3, 1.7), dt=0.5, samples=25,
        epoch=datetime(2026, 3, 20),
    )  # fmt: skip
    assert craft.plant.longest_step == pytest.approx(2 * np.pi / PANEL.free(INERTIA - JS * np.eye(3))[-1] / 20)
    held = ("wheels", "modes", "mode_rates")
    rigid = linearize(satellite(), at(satellite()), np.zeros(3), FreeSpace(), hold=held)
    np.testing.assert_allclose(rigid.B[3:], -np.linalg.inv(INERTIA - JS * np.eye(3) - D @ D.T), rtol=1e-9)


def test_numbers_may_be_traced():
    """The slope of the acceleration in all numbers at once is that of finite differences."""
    env, u, far = FreeSpace().at(0.0), np.array([0.1, 0.2, -0.3]), 1e-6
    motion = {name: np.append(part, [0.01, -0.02]) for name, part in MOTION.items()}

    def fleet(scale):
        panel = Appendage.create(W * scale, couplings=D * scale, damping=Z * scale)
        tank = Appendage.pendulum(3.0 * scale, length=0.5 * scale, hinge=np.ones(3), acceleration=scale * np.ones(3))
        return satellite([panel, tank], INERTIA * scale)

    x = at(fleet(1.0), [0.05, -0.03, 0.04], wheels=[9.0, 8, 7], **motion)

    def turned(scale):
        return jnp.asarray(fleet(scale).derivative(x, u, env).w)[0]

    compiled, slope = jax.jit(turned), jax.jit(jax.grad(turned))(1.0)
    assert slope == pytest.approx(float(compiled(1 + far) - compiled(1 - far)) / (2 * far), rel=1e-6)
    assert compiled(1.0) == pytest.approx(float(turned(1.0)), rel=1e-12)


def test_mistakes_are_named():
    with pytest.raises(ScenarioError, match="frequencies must be positive"):
        Appendage.create([1.0, 0.0], couplings=np.zeros((3, 2)))
    with pytest.raises(ScenarioError, match=r"couplings must have shape \(3, 2\)"):
        Appendage.create([1.0, 2.0], couplings=np.zeros((2, 3)))
    with pytest.raises(ScenarioError, match="damping must be at least 0"):
        Appendage.create([1.0], couplings=np.zeros((3, 1)), damping=-0.1)
    with pytest.raises(ScenarioError, match="acceleration must be positive"):
        Appendage.pendulum(3.0, length=0.5, hinge=np.ones(3), acceleration=np.zeros(3))
    with pytest.raises(ScenarioError, match="frequencies is empty"):
        Appendage.create([], couplings=np.zeros((3, 0)))
    with pytest.raises(ScenarioError, match="give a list of"):
        satellite(PANEL)
    with pytest.raises(ScenarioError, match="give a list of"):
        satellite([W])
    with pytest.raises(ScenarioError, match="frequencies must be finite"):
        flexible_model(500.0, [np.nan], couplings=[14.0], damping=0.0)
    with pytest.raises(ScenarioError, match="inertia must be real numbers"):
        flexible_model("500", [1.0], couplings=[14.0], damping=0.0)
    with pytest.raises(ScenarioError, match="what the appendages carry must be positive definite"):
        satellite([PANEL, PANEL, PANEL])
    plant = satellite()
    with pytest.raises(ScenarioError, match=r"initial.modes has shape \(2,\)"):
        plant.check(at(plant)._replace(modes=np.zeros(2)))
    with pytest.raises(ScenarioError, match=r"modes must have shape \(3,\)"):
        at(plant, modes=np.zeros(2))
    with pytest.raises(ScenarioError, match=r"couplings has shape \(1, 2\): give \(1, 1\)"):
        flexible_model(500.0, [1.2], couplings=[14.0, 6.0], damping=0.0)
    with pytest.raises(ScenarioError, match="momentum couples three axes"):
        flexible_model(500.0, [1.2], couplings=[14.0], damping=0.0, momentum=np.ones(3))
