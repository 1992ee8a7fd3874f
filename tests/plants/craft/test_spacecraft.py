"""A spacecraft of data sheets: loop, linear model and flights; what does not go together is told."""

from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
import pytest

import plants
import synth
from plants import ARCSEC, DEG_PER_SQRT_H

DEG = np.pi / 180
EPOCH = datetime(2026, 3, 20)
WANTED = {"pointing": 0.1 * DEG, "bandwidth": 0.1}


def wheels(n=3):
    axes = np.eye(3) if n == 3 else np.array([[1, 1, -1, -1], [1, -1, -1, 1], [1, 1, 1, 1]]).T[:n] / np.sqrt(3)
    return [plants.Wheel.create(axis, max_torque=3e-3, max_momentum=15e-3, max_speed_rpm=6000) for axis in axes]


def instruments():
    return [
        plants.StarTracker.create(cross_noise=20 * ARCSEC, boresight=[0.0, 0.8, -0.6], period=1.0),
        plants.IntegratingGyro.create(random_walk=0.1 * DEG_PER_SQRT_H, turn_on_bias=0.01 * DEG),
    ]


def magnetic():
    return [*instruments(), plants.ThreeAxisMagnetometer.create(noise=1e-8), plants.Tachometers.create()]


def made(**more):
    given = {
        "inertia": [0.12, 0.11, 0.05], "wheels": wheels(), "sensors": instruments(), "epoch": EPOCH, "dt": 1.0,
        "orbit": plants.circular(500e3, 97.4 * DEG, raan=1.0), **more,
    }  # fmt: skip
    return plants.spacecraft(**given)


def designed(craft):
    G = synth.c2d(craft.linear(), craft.dt)
    return synth.hinfsyn(synth.GeneralizedPlant.four_block(G, **craft.weights(**WANTED)))


@pytest.fixture(scope="module")
def design():
    return designed(made())


@dataclass(frozen=True)
class Idle:
    dt: float = 1.0

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, np.zeros(3)


def test_linear_model_is_that_of_the_moments():
    craft = made()
    A, B, C, _ = craft.linear()
    np.testing.assert_allclose(B[3:] @ craft.inertia, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(C, np.eye(6))
    n = np.sqrt(3.986004418e14 / 6878137.0**3)
    pitch = -3 * n**2 * (0.12 - 0.05) / 0.11 * 2  # gravity gradient about y, on half angles
    assert A[4, 1] == pytest.approx(pitch, rel=1e-3)


def test_linear_model_of_an_eccentric_orbit_is_that_of_its_energy():
    ellipse = plants.keplerian(7.2e6, 0.04, 1.0, 0.3, 0.2, 1.3)
    A = made(orbit=ellipse).linear().A
    n = np.sqrt(3.986004418e14 / 7.2e6**3)
    assert A[4, 1] == pytest.approx(-6 * n**2 * (0.12 - 0.05) / 0.11, rel=1e-9)


@pytest.fixture
def panels():
    return plants.Appendage.create([0.6, 1.5], couplings=[[0.15, 0], [0, 0.1], [0.02, 0.05]], damping=0.003)


def test_linear_model_of_a_flexible_spacecraft_has_its_modes(panels):
    craft = made(appendages=[panels])
    A, B, C, D = craft.linear()
    assert (A.shape, B.shape, C.shape, D.shape) == ((10, 10), (10, 3), (6, 10), (6, 3))
    swinging = np.sort(np.linalg.eigvals(A).imag)[-2:]
    np.testing.assert_allclose(swinging, panels.free(craft.inertia), rtol=1e-4)  # and the orbit's rate, and damping
    E = plants.flexible_model(craft.inertia, [0.6, 1.5], couplings=panels.couplings, damping=0.003).E
    accelerations = np.linalg.inv(E)[5:, 5:8]  # of hub and modes, per torque
    np.testing.assert_allclose(B[[3, 4, 5, 8, 9]], accelerations, atol=1e-12)


def test_design_knows_the_modes_that_it_meets(panels, design):
    soft = replace(panels, frequencies=panels.frequencies / 6, couplings=panels.couplings * 2)
    craft = made(appendages=[soft])
    P = synth.GeneralizedPlant.four_block(synth.c2d(craft.linear(), craft.dt), **craft.weights(**WANTED))
    assert designed(craft).gamma < 0.95 * synth.hinfnorm(P.close(design.K))[0]


def test_dispersed_moments_keep_what_the_appendages_carry(panels):
    """Inertia and couplings move together: no draw makes a hub of negative inertia."""
    heavy = replace(panels, couplings=panels.couplings * 2)
    plant = made(appendages=[heavy]).plant
    factors = np.array([0.7, 1.2, 0.9])
    moved = plant.scaled(factors)
    hub = moved.body.inertia - moved.appendages.couplings @ moved.appendages.couplings.T
    G, Jw = plant.body.wheel_axes, plant.body.wheel_inertia
    np.testing.assert_allclose(np.linalg.inv(moved.body.inverse), hub - (G * Jw) @ G.T, atol=1e-14)
    shares = [
        np.linalg.eigvals(np.linalg.solve(p.body.inertia, p.appendages.couplings @ p.appendages.couplings.T))
        for p in (plant, moved)
    ]
    np.testing.assert_allclose(*(np.sort(s.real) for s in shares), atol=1e-12)
    assert made().plant.scaled(factors).appendages is None


def test_flexible_spacecraft_are_compared(panels):
    craft = made(appendages=[panels], samples=8)
    found = plants.compare_flights(craft, {"K": designed(craft)}, duration=400, pointing=0.5 * DEG, runs=3)
    assert found.campaigns["K"].results.pointing.max() < 0.5 * DEG


def test_it_points_with_star_tracker_and_filter(design):
    craft = made(samples=5)
    run = plants.simulate(craft.loop(design), craft.scenario(400.0, angles=[8 * DEG, -5 * DEG, 6 * DEG]))
    assert run.ok
    late = run.time > 300
    assert (2 * np.linalg.norm(run.outputs[late, :3], axis=1)).max() < 0.1 * DEG


def test_torque_of_a_pyramid_is_what_every_axis_can_have():
    four = made(wheels=wheels(4)).torque
    assert made().torque == pytest.approx(3e-3)
    craft = made(wheels=wheels(4))
    for axis in np.eye(3):
        shares = np.linalg.pinv(np.asarray(craft.actuator.wheels.axes)) @ axis
        assert np.abs(shares).max() * four <= 3e-3 * (1 + 1e-12)


def test_dumping_takes_momentum_out_of_the_wheels(design):
    craft = made(sensors=magnetic(), magnetorquers=plants.Magnetorquers.create(max_dipole=0.4))
    start = {"speeds": np.full(3, 200.0)}
    runs = {}
    for name, dumping in (("rest", None), ("dump", plants.CrossProductDumping.create(1e-3, limit=0.4))):
        runs[name] = plants.simulate(craft.loop(design, dumping=dumping), craft.scenario(1500.0, **start))
        assert runs[name].ok
    momentum = {name: np.linalg.norm(run.states.wheels[-1]) for name, run in runs.items()}
    assert momentum["dump"] < 0.6 * momentum["rest"]
    assert 2 * np.linalg.norm(runs["dump"].outputs[-1, :3]) < 0.2 * DEG


def test_guidance_turns_the_flight(design):
    craft = made(sensors=())
    tilted = plants.Offset.create([np.cos(0.4), 0.0, np.sin(0.4), 0.0], plants.Nadir())
    run = plants.simulate(craft.loop(design), craft.scenario(300.0, guidance=tilted))
    assert 2 * np.linalg.norm(run.outputs[-1, :3]) < 0.1 * DEG


def test_controllers_are_compared_on_the_same_flights(design, tmp_path):
    craft = made()
    found = plants.compare_flights(
        craft, {"H-infinity": design, "nothing": Idle()}, duration=400, pointing=0.5 * DEG, runs=4, out=tmp_path
    )  # fmt: skip
    first, second = found.campaigns.values()
    for a, b in zip(first.dispersed, second.dispersed, strict=True):
        np.testing.assert_array_equal(a, b)
    assert [r.met for r in found.requirements] == [True, False]
    assert "H-infinity: error in 95% of 4 flights" in str(found)
    page = found.report.read_text()
    assert page.count("<svg") == 4  # errors, first flights, wheels of each controller
    for told in ("StarTracker", "nothing", "wheels, rpm"):
        assert told in page


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: made(inertia=[1.0, 0.1, 0.1]), "inertia"),
        (lambda: made(wheels=()), "nothing turns the satellite"),
        (lambda: made(samples=0), "samples = 0"),
        (lambda: made(dt=-1.0), "dt must be positive"),
        (lambda: made(orbit=(7e6, 0, 0)), r"orbit = .*circular\("),
        (lambda: made(epoch="today"), "epoch = 'today'.*datetime"),
        (lambda: made(sensors=instruments()[:1]), "suite has 0 gyros"),
        (lambda: made(sensors=instruments()[1:]), "nothing that corrects the gyro"),
        (lambda: made(sensors=[object()]), r"instruments\[0\]"),
        (lambda: made(sensors=(), magnetorquers=plants.Magnetorquers.create(max_dipole=1.0)), "sensors: magnetorquers"),
        (lambda: made().loop(Idle(), dumping=plants.CrossProductDumping.create(1e-3)), "the spacecraft has none"),
        (
            lambda: made(magnetorquers=plants.Magnetorquers.create(max_dipole=1.0)).loop(Idle()),
            "sensors has no ThreeAxisMagnetometer",
        ),
        (lambda: made().scenario(10.5), "duration = 10.5 s: give a whole number of control periods"),
        (lambda: made().scenario(10.0, angles=[0, 0]), "angles must have shape"),
        (lambda: made().scenario(10.0, speeds=np.zeros(4)), "wheels|speeds"),
        (lambda: plants.compare_flights(made(), {}, duration=10, pointing=0.1), "controllers is empty"),
        (lambda: plants.compare_flights(made(), {"a": Idle()}, duration=10, pointing=0.1, after=20), "after = 20 s"),
    ],
)
def test_what_does_not_go_together_is_told(make, told):
    with pytest.raises(plants.ScenarioError, match=told):
        make()
