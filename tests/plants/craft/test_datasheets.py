"""A spacecraft as a TOML file: what Python makes of the same numbers, and every mistake told with its place."""

import copy
import importlib.resources
import inspect
import os
import re
import tomllib
from datetime import UTC, datetime

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tampering import ATOMS, places
from tomltext import toml

import plants
from plants import ARCSEC, DEG_PER_H, DEG_PER_SQRT_H, ScenarioError
from plants.craft import datasheets, kinds, tables
from plants.craft.datasheets import read_spacecraft

DEG = np.pi / 180
EPOCH = datetime(2026, 3, 20)
LEAST = {
    "inertia": [0.12, 0.11, 0.05], "epoch": EPOCH, "dt": 1.0, "requirements": {"pointing_deg": 0.1, "bandwidth": 0.1},
    "flight": {"duration": 100}, "orbit": {"kind": "circular", "altitude_km": 500, "inclination_deg": 97.4},
    "wheels": [
        {"axis": axis, "max_torque_mNm": 3, "max_momentum_mNms": 15, "max_speed_rpm": 6000}
        for axis in np.eye(3).tolist()
    ],
}  # fmt: skip
THRUSTERS = [
    {"position": [x, y, 0.0], "direction": [0.0, 0.0, s], "force_mN": 20.0}
    for x, y in ((0.1, 0.1), (-0.1, 0.1), (0.1, -0.1), (-0.1, -0.1))
    for s in (1.0, -1.0)
] + [
    {"position": [0.0, s * 0.1, 0.0], "direction": [d * s, 0.0, 0.0], "force": 0.02}
    for d in (1.0, -1.0)
    for s in (1.0, -1.0)
]  # fmt: skip
FULL = LEAST | {
    "name": "Full", "samples": 2, "minimax": True, "null_rate": 0.1, "wanted_speeds_rpm": [600, -600, 600, -600],
    "wheels": [
        {
            "axis": (np.array(a) / np.sqrt(3)).tolist(), "max_torque_mNm": 3, "max_momentum_mNms": 15,
            "max_speed_rpm": 6000, "coulomb_mNm": 0.01, "position_mm": [10, 0, 0], "static_imbalance_g_cm": 1e-6,
        }
        for a in ([1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1])
    ],
    "sensors": [
        {"kind": "star tracker", "cross_noise_arcsec": 20, "boresight": [0.0, 0.8, -0.6], "calibrate_arcsec": 60},
        {"kind": "gyro", "random_walk_deg_per_sqrt_h": 0.1, "bias_instability_deg_per_h": 1.0},
        {"kind": "fine sun sensor", "noise_deg": 0.1}, {"kind": "coarse sun sensors", "noise": 0.01, "albedo": 0.3},
        {"kind": "magnetometer", "noise_nT": 50, "bias_nT": [1, 2, 3]}, {"kind": "horizon sensor", "noise_deg": 0.1},
        {"kind": "gps", "position_noise": 5, "velocity_noise": 0.1}, {"kind": "tachometers"},
    ],
    "disturbances": [
        {"kind": "residual dipole", "moment": [0.05, 0.02, 0.05]}, {"kind": "constant torque", "vector": [1e-7, 0, 0]},
        {"kind": "drag", "size_cm": [34, 20, 10], "mass_centre_cm": [1, 0, 0], "coefficient": 2.2},
        {"kind": "solar pressure", "size": [0.3, 0.2, 0.1], "mass_centre": [0.01, 0, 0], "coefficient": 1.5},
    ],
    "magnetorquers": [{"axis": a, "max_dipole": 0.2} for a in ([1, 0, 0], [0, 1, 0], [0, 0, 1])],
    "dumping": {"gain": 1e-3, "limit": 0.2}, "thrusters": THRUSTERS, "propulsion": {"kind": "pwm", "shortest": 0.02},
    "navigation": {"deviation_deg": 5}, "dispersion": {"angles_deg": 5, "inertia_percent": 5},
    "atmosphere": {"kind": "layered", "factor": 2}, "forces": [{"kind": "earth shape"}, {"kind": "moon"}],
}  # fmt: skip


def read(folder, data):
    file = folder / "spacecraft.toml"
    file.write_text(data if isinstance(data, str) else toml(data))
    return read_spacecraft(file)


def refused(folder, data):
    with pytest.raises(ScenarioError) as caught:
        read(folder, data)
    return str(caught.value)


def same(a, b):
    """Two spacecraft, to the last bit."""
    assert jax.tree.structure((a.plant, a.actuator, a.sensors, a.navigator)) == jax.tree.structure(
        (b.plant, b.actuator, b.sensors, b.navigator)
    )
    for p, q in zip(*(jax.tree.leaves((c.plant, c.actuator, c.sensors, c.navigator)) for c in (a, b)), strict=True):
        np.testing.assert_array_equal(p, q)
    np.testing.assert_array_equal(a.orbit, b.orbit)
    assert (a.name, a.epoch, a.dt, a.samples) == (b.name, b.epoch, b.dt, b.samples)


def test_every_part_is_that_of_python(tmp_path):
    a = np.array([[1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]]) / np.sqrt(3)
    craft = plants.spacecraft(
        name="Full", inertia=[0.12, 0.11, 0.05], epoch=EPOCH, dt=1.0, samples=2, minimax=True, null_rate=0.1,
        wanted_speeds=np.array([600, -600, 600, -600]) * (np.pi / 30), orbit=plants.circular(500e3, 97.4 * DEG),
        wheels=[
            plants.Wheel.create(
                axis, max_torque=3e-3, max_momentum=15e-3, max_speed_rpm=6000, coulomb=1e-5, position=[1e-2, 0, 0],
                static_imbalance_g_cm=1e-6,
            )
            for axis in a
        ],
        sensors=[
            plants.StarTracker.create(cross_noise=20 * ARCSEC, boresight=[0.0, 0.8, -0.6]),
            plants.IntegratingGyro.create(random_walk=0.1 * DEG_PER_SQRT_H, bias_instability=DEG_PER_H),
            plants.FineSunSensor.create(noise=0.1 * DEG), plants.CoarseSunSensors.create(noise=0.01, albedo=0.3),
            plants.ThreeAxisMagnetometer.create(noise=50 * 1e-9, bias=np.array([1, 2, 3]) * 1e-9),
            plants.HorizonSensor.create(noise=0.1 * DEG),
            plants.GpsReceiver.create(position_noise=5, velocity_noise=0.1), plants.Tachometers.create(),
        ],
        disturbances=[
            plants.ResidualDipole.create([0.05, 0.02, 0.05]), plants.ConstantTorque.create([1e-7, 0, 0]),
            plants.Drag.create(np.array([34, 20, 10]) * 1e-2, np.array([1, 0, 0]) * 1e-2, 2.2),
            plants.SolarPressure.create([0.3, 0.2, 0.1], [0.01, 0, 0], 1.5),
        ],
        magnetorquers=plants.Magnetorquers.create(max_dipole=[0.2] * 3),
        thrusters=plants.AttitudeThrusters.create(
            np.array([t["position"] for t in THRUSTERS]).T, np.array([t["direction"] for t in THRUSTERS]).T,
            force=[0.02] * len(THRUSTERS), modulator=plants.Pwm.create(shortest=0.02),
        ),
        navigation={"deviation": 5 * DEG, "calibrate": {0: 60 * ARCSEC}},
    )  # fmt: skip
    sheet = read(tmp_path, FULL)
    same(sheet.craft, craft)
    assert sheet.wanted == {"pointing": 0.1 * DEG, "bandwidth": 0.1, "integral": True}
    assert sheet.spread == plants.Dispersion(angles=5 * DEG, inertia=0.05)
    assert sheet.surroundings["atmosphere"].factor == 2
    assert len(sheet.surroundings["forces"]) == 2
    assert sheet.dumping is not None
    assert sheet.duration == 100


def test_gyroscopes_and_other_orbits(tmp_path):
    axes = [([1, 0, 0], [0, 1, 0]), ([0, 1, 0], [0, 0, 1]), ([0, 0, 1], [1, 0, 0])]
    data = LEAST | {
        "wheels": [],
        "cmgs": [{"gimbal_axis": g, "spin_axis": s, "momentum": 1.5} for g, s in axes],
        "steering": {"max_rate_deg_per_s": 30},
        "orbit": {"kind": "keplerian", "semi_major_axis_km": 7200, "eccentricity": 0.01, "inclination_deg": 50},
    }
    g, s = (np.array([pair[k] for pair in axes], float).T for k in (0, 1))
    steering = plants.CmgSteering.create(plants.Cmgs.create(g, s, momentum=[1.5] * 3), max_rate=30 * DEG)
    craft = plants.spacecraft(
        inertia=LEAST["inertia"], epoch=EPOCH, dt=1.0, cmgs=steering, orbit=plants.keplerian(7200e3, 0.01, 50 * DEG)
    )
    same(read(tmp_path, data).craft, craft)


def test_appendages_of_all_kinds(tmp_path):
    data = LEAST | {
        "samples": 20,
        "appendages": [
            {"kind": "modes", "frequencies_Hz": [0.5], "damping_percent": 0.5, "couplings": [[0.1], [0.0], [0.02]]},
            {
                "kind": "hinged panel", "axis": [0, 1, 0], "position_cm": [0, 20, 0], "mass": 0.3,
                "centre_cm": [10, 0, 0], "inertia": [1e-3, 1e-3, 2e-3], "stiffness": 0.01,
            },
            {"kind": "tank", "mass": 0.1, "length_cm": 5, "hinge_cm": [0, 0, 10], "acceleration": [0, 0, 0.05]},
        ],
    }  # fmt: skip
    parts = [
        plants.Appendage.create(np.array([0.5]) * (2 * np.pi), couplings=[[0.1], [0.0], [0.02]], damping=0.5e-2),
        plants.Appendage.hinged(
            [0, 1, 0], position=np.array([0, 20, 0]) * 1e-2, mass=0.3, centre=np.array([10, 0, 0]) * 1e-2,
            inertia=[1e-3, 1e-3, 2e-3], stiffness=0.01,
        ),
        plants.Appendage.pendulum(
            0.1, length=5 * 1e-2, hinge=np.array([0, 0, 10]) * 1e-2, acceleration=[0, 0, 0.05]
        ),
    ]  # fmt: skip
    craft = read(tmp_path, data).craft
    joined = plants.Appendage.joined(parts)
    for name in ("frequencies", "damping", "couplings"):
        np.testing.assert_array_equal(getattr(craft.plant.appendages, name), getattr(joined, name))


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"kind": "mode"}, "appendages[0].kind = 'mode'; did you mean 'modes'?"),
        ({"kind": "modes", "frequencies_Hz": [0.5]}, "appendages[0].couplings: missing"),
        ({"kind": "modes", "frequencies": [0.5], "couplings": [[9.0], [0], [0]]}, "appendages carry"),
        (
            {"kind": "tank", "mass": 1, "length": -1, "hinge": [0, 0, 0], "acceleration": [0, 0, 1]},
            "appendages[0].length = -1",
        ),
    ],
)  # fmt: skip
def test_wrong_appendages_are_told(tmp_path, wrong, told):
    assert told in refused(tmp_path, LEAST | {"appendages": [wrong]})


NUMBER = st.floats(0.01, 100)


@settings(max_examples=25, deadline=None)
@given(
    moments=st.lists(st.floats(0.5, 1.0), min_size=3, max_size=3), torque=NUMBER, momentum=NUMBER,
    rpm=st.floats(1e3, 1e4), noise=NUMBER, walk=NUMBER, altitude=st.floats(200, 900),
    inclination=st.floats(0, 180), samples=st.integers(1, 20),
)  # fmt: skip
def test_numbers_with_units_are_those_in_si(
    tmp_path_factory, moments, torque, momentum, rpm, noise, walk, altitude, inclination, samples
):
    file = {
        "inertia": moments, "samples": samples,
        "orbit": {"kind": "circular", "altitude_km": altitude, "inclination_deg": inclination},
        "wheels": [
            {"axis": axis, "max_torque_mNm": torque, "max_momentum_mNms": momentum, "max_speed_rpm": rpm}
            for axis in np.eye(3).tolist()
        ],
        "sensors": [
            {"kind": "star tracker", "cross_noise_arcsec": noise},
            {"kind": "gyro", "random_walk_deg_per_sqrt_h": walk},
        ],
    }  # fmt: skip
    wheels = [
        plants.Wheel.create(axis, max_torque=torque * 1e-3, max_momentum=momentum * 1e-3, max_speed_rpm=rpm)
        for axis in np.eye(3)
    ]
    sensors = [
        plants.StarTracker.create(cross_noise=noise * ARCSEC),
        plants.IntegratingGyro.create(random_walk=walk * DEG_PER_SQRT_H),
    ]
    orbit = plants.circular(altitude * 1e3, inclination * DEG)
    craft = plants.spacecraft(
        inertia=moments, wheels=wheels, sensors=sensors, orbit=orbit, epoch=EPOCH, dt=1.0, samples=samples
    )
    same(read(tmp_path_factory.mktemp("x"), LEAST | file).craft, craft)


def test_the_template_is_a_spacecraft():
    template = importlib.resources.files("plants.craft") / "spacecraft.toml"
    with importlib.resources.as_file(template) as file:
        sheet = read_spacecraft(file)
    assert sheet.craft.torque == pytest.approx(3e-3)
    assert {"Wdist", "Wnoise", "Wout", "Wact"} == sheet.weights().keys()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"foo": 1}, "foo: there is no such field; there is inertia"),
        ({"inertai": 1}, "inertai: there is no such field; did you mean 'inertia'"),
        ({"wheel": []}, "wheel: there is no such field; did you mean 'wheels'"),
        ({"dt": "1"}, "dt = '1': give a number"),
        ({"dt": True}, "dt = True: give a number"),
        ({"dt": -1.0}, r"dt = -1.0: dt must be positive"),
        ({"samples": 2.5}, "samples = 2.5: give a whole number"),
        ({"samples": True}, "samples = True: give a whole number"),
        ({"epoch": "2026-03-20"}, "epoch = '2026-03-20': give a date with a time, such as"),
        ({"name": 5}, "name = 5: give text"),
        ({"inertia": [1.0, 1.0, 5.0]}, r"inertia = \[1.0, 1.0, 5.0\]: inertia"),
        ({"inertia": [1.0, 1.0]}, r"inertia = \[1.0, 1.0\]: inertia must have shape"),
        ({"inertia": [[1.0], [1.0, 2.0]]}, "its rows are of different lengths"),
        ({"inertia": 10**400}, "no double holds such a number"),
        ({"orbit": {"altitude_km": 500}}, "orbit.kind: missing; there is circular, keplerian"),
        ({"orbit": {"kind": "circualr"}}, "orbit.kind = 'circualr'; did you mean 'circular'"),
        ({"orbit": LEAST["orbit"] | {"inclination_deg": [97.4]}}, r"orbit.inclination_deg = \[97.4\]: give one number"),
        ({"orbit": LEAST["orbit"] | {"inclination": 1.7}}, "inclination: inclination_deg says the same"),
        ({"orbit": LEAST["orbit"] | {"altitude_deg": 1.7}}, "altitude_deg: there is no such field; did you mean 'alti"),
        ({"orbit": {"kind": "circular", "altitude_km": 500, "inclination": 97.4}}, "for degrees write inclination_deg"),
        ({"orbit": {"kind": "circular", "altitude_km": 500}}, "orbit.inclination: missing; .* or inclination_deg"),
        ({"orbit": LEAST["orbit"] | {"altitude_km": 0.5}}, "orbit.altitude_km = 0.5: altitude must be above 50000 m"),
        ({"orbit": 3}, r"orbit: give a table, below a line \[orbit\]"),
        ({"wheels": 3}, r"wheels: give a table for each wheel, below a line \[\[wheels\]\]"),
        ({"wheels": [{"axis": [1, 0, 0]}] * 101}, "wheels: 101 tables, where 100 are the most"),
        ({"wheels": [{"axis": [1, 0, 0]}]}, r"wheels\[0\].max_torque: missing; .*max_torque_mNm"),
        ({"wheels": [{"axis": [1, 1, 0], "max_torque": 1, "max_momentum": 1, "max_speed_rpm": 1}]},
         r"wheels\[0\].axis = \[1, 1, 0\]: axis must be a unit vector"),
        ({"sensors": [{"kind": "star tracker", "cross_noise_arcsec": -3}]},
         r"sensors\[0\].cross_noise_arcsec = -3: cross_noise must be at least 0"),
        ({"sensors": [{"kind": "star tracker", "cross_noise_arcsec": 3}]}, "gyro"),
        ({"sensors": [{"kind": "star tracker", "cross_noise_arcsec": 3, "calibrate_nT": 3}]}, "calibrate_nT: there"),
        ({"magnetorquers": [{"axis": [1, 0, 0], "max_dipole": 1}]}, "magnetorquers work by the measured field"),
        ({"dumping": {"gain": 1e-3}}, "dumping: dumping works by magnetorquers, and the spacecraft has none"),
        ({"thrusters": THRUSTERS}, r"propulsion: missing; add a table \[propulsion\]"),
        ({"propulsion": {"kind": "pwm", "shortest": 0.1}}, r"thrusters: missing; add a table \[\[thrusters\]\]"),
        ({"thrusters": THRUSTERS[:3], "propulsion": {"kind": "pwm", "shortest": 0.1}}, "thrusters: .*do not add up"),
        ({"requirements": {"pointing": 5.0, "bandwidth": 0.1}}, "requirements.pointing = 5.0: .*pointing_deg"),
        ({"requirements": {"pointing_deg": 0.1}}, "requirements.bandwidth: missing"),
        ({"flight": {"duration": 100, "after": 100}}, "flight.after = 100: after must be below duration = 100 s"),
        ({"dispersion": {"inertia": 10}}, "dispersion.inertia = 10: inertia must be below 1"),
        ({"atmosphere": {"kind": "msis"}}, "atmosphere.kind = 'msis'; there is layered, exponential, none"),
        ({"wheels": [], "minimax": True}, "wanted_speeds, null_rate and minimax are of wheels"),
    ],
)  # fmt: skip
def test_mistakes_name_place_value_and_remedy(tmp_path, change, message):
    told = refused(tmp_path, LEAST | change)
    assert re.search(message, told), told


def test_all_mistakes_are_told_at_once(tmp_path):
    wrong = copy.deepcopy(FULL)
    wrong["wheels"][1]["max_torqe_mNm"] = wrong["wheels"][1].pop("max_torque_mNm")
    wrong["sensors"][0]["boresight"] = [0.0, 1.0, 1.0]
    wrong["inertia"] = [1.0, 1.0, 5.0]
    wrong["orbit"]["inclination_deg"] = "x"
    wrong["flight"] = {}
    told = refused(tmp_path, wrong)
    for place in ("wheels[1].max_torqe_mNm", "sensors[0].boresight", "inertia = ", "orbit.incl", "flight.duration"):
        assert place in told
    assert "wrong in 5 places" in told


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\xff", "this is no TOML"), (b"a = " + b"[" * 10_000 + b"]" * 10_000, "no TOML"),
        (b"a" + b".a" * 20_000 + b" = 1", "more than 20 parts"), (b"a = 1" + b"0" * 5000, "no TOML"),
        (b"dt = 1\ndt = 2", "no TOML"), (b"#" * 70_000, "larger than 64 KiB"), (b"", "inertia: missing"),
    ],
)  # fmt: skip
def test_files_that_are_none(tmp_path, content, message):
    (tmp_path / "x.toml").write_bytes(content)
    with pytest.raises(ScenarioError, match=message):
        read_spacecraft(tmp_path / "x.toml")


def test_what_is_no_file(tmp_path):
    with pytest.raises(ScenarioError, match="no such file"):
        read_spacecraft(tmp_path / "none.toml")
    with pytest.raises(ScenarioError, match="a folder, a device or a pipe"):
        read_spacecraft(tmp_path)
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.toml")
        with pytest.raises(ScenarioError, match="a folder, a device or a pipe"):
            read_spacecraft(tmp_path / "pipe.toml")


def damaged(rng):
    """The full file with one to three changes of a value, a name or a structure."""
    data = copy.deepcopy(FULL)
    for _ in range(rng.integers(1, 4)):
        path = [*places(data)][rng.integers(len([*places(data)]))]
        inner = data
        for key in path[:-1]:
            inner = inner[key]
        if rng.random() < 0.2 and isinstance(inner, dict):
            inner[str(path[-1])[:-1] + "x"] = inner.pop(path[-1])
        else:
            inner[path[-1]] = copy.deepcopy(ATOMS[rng.integers(len(ATOMS))])
    return data


def told_of(file):
    """What is said of a file that may be wrong, empty if nothing is."""
    try:
        read_spacecraft(file)
    except ScenarioError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("count", [120, pytest.param(1500, marks=pytest.mark.slow)])
def test_damaged_files_never_end_bare(tmp_path, count):
    rng, file, sound = np.random.default_rng(count), tmp_path / "x.toml", 0
    for _ in range(count):
        file.write_text(toml(damaged(rng)))
        told = told_of(file)
        sound += not told
        assert told == "" or told.startswith(str(file))
        assert len(told) < 12_000
        assert "\x1b" not in told
    assert sound < count / 2


def test_damaged_bytes_never_end_bare(tmp_path):
    text, rng, file = toml(FULL).encode(), np.random.default_rng(0), tmp_path / "x.toml"
    for _ in range(100):
        raw = bytearray(text)
        for _ in range(rng.integers(1, 4)):
            raw[rng.integers(len(raw))] = rng.integers(256)
        file.write_bytes(raw)
        told = told_of(file)
        assert told == "" or told.startswith(str(file))


def test_an_epoch_with_a_time_zone_is_that_moment(tmp_path):
    sheet = read(tmp_path, LEAST | {"epoch": datetime(2026, 3, 20, 1, tzinfo=UTC)})
    assert sheet.craft.epoch == datetime(2026, 3, 20, 1, tzinfo=UTC)


def test_the_example_of_the_docstring_reads(tmp_path):
    lines = [line[4:] for line in datasheets.__doc__.splitlines() if line.startswith("    ")]
    gyro = '\n[[sensors]]\nkind = "gyro"\nrandom_walk_deg_per_sqrt_h = 0.1\n'
    tomllib.loads("\n".join(lines))
    more = "\n[[wheels]]\naxis = {}\nmax_torque = 1\nmax_momentum = 1e-3\nmax_speed_rpm = 6000"
    rest = "".join(more.format(axis) for axis in ([0, 1, 0], [0, 0, 1]))
    assert read(tmp_path, "\n".join(lines) + gyro + rest).craft.name == "A 6U CubeSat"


def test_units_are_of_arguments_that_there_are():
    every = [value for value in vars(kinds).values() if isinstance(value, tables.Kind)]
    every += [kind for value in vars(kinds).values() if isinstance(value, dict) for kind in value.values()]
    every = [kind for kind in every if isinstance(kind, tables.Kind)]
    assert len(every) > 25
    for kind in every:
        assert set(kind.about) <= set(inspect.signature(kind.make).parameters)


def test_air_that_is_not_known_is_told_in_the_words_of_the_file(tmp_path):
    high = LEAST | {"orbit": LEAST["orbit"] | {"altitude_km": 2000}}
    with pytest.raises(ScenarioError, match=r'\[atmosphere\] with kind = "none"'):
        read(tmp_path, high).compare({"nothing": None}, runs=1)
    for air in ({"kind": "none"}, {"kind": "layered", "highest": float("inf")}):
        sheet = read(tmp_path, high | {"atmosphere": air})
        sheet.craft.environment(100.0, **sheet.surroundings)
