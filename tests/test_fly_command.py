"""`synth init`, studies of spacecraft and `synth fly`: what a newcomer types, and what is told when it does not fit."""

import json
import shlex
import tomllib
from datetime import datetime
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from tomltext import toml

import plants
import synth
from plants.craft import fly as flies
from synth.__main__ import main
from synth.command import door
from synth.command.specification import read_study
from synth.delivery.modelfiles import save_system
from synth.delivery.qp import load_mpc, restored, save_mpc
from synth.errors import ModelError, SpecificationError

DECLARED = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]["entry-points"]
SMALL = {  # without sensors: compiled soon
    "name": "Small & <b>bold</b>", "inertia": [0.12, 0.11, 0.05], "epoch": datetime(2026, 3, 20), "dt": 1.0,
    "requirements": {"pointing_deg": 1.0, "bandwidth": 0.1}, "flight": {"duration": 120, "after": 80},
    "orbit": {"kind": "circular", "altitude_km": 500, "inclination_deg": 97.4},
    "wheels": [
        {"axis": axis, "max_torque_mNm": 3, "max_momentum_mNms": 15, "max_speed_rpm": 6000}
        for axis in np.eye(3).tolist()
    ],
}  # fmt: skip
STUDY = '[plant]\nspacecraft = "spacecraft.toml"\n[synthesis]\nproblem = "fourblock"\n'


@pytest.fixture(autouse=True)
def declared(monkeypatch):
    """What pyproject.toml declares, however old the installed metadata is."""
    entries = [EntryPoint(name, value, door.GROUP) for name, value in DECLARED[door.GROUP].items()]
    monkeypatch.setattr(door.metadata, "entry_points", lambda *, group: entries if group == door.GROUP else [])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a spacecraft, a study, and controllers that fit and that do not."""
    folder = tmp_path_factory.mktemp("fly")
    (folder / "spacecraft.toml").write_text(toml(SMALL))
    (folder / "design.toml").write_text(STUDY)
    sheet = plants.read_spacecraft(folder / "spacecraft.toml")
    G = synth.c2d(sheet.craft.linear(), 1.0)
    design = synth.hinfsyn(synth.GeneralizedPlant.four_block(G, **sheet.weights()))
    design.save(folder / "controller.json")
    K = design.controller
    save_system(folder / "plain.json", K)
    save_system(folder / "positive.json", -K)
    save_system(folder / "slow.json", synth.StateSpace(K.A, K.B, K.C, K.D, 2.0))
    save_system(folder / "continuous.json", synth.StateSpace(K.A - np.eye(K.n) * 2, K.B, K.C, K.D, 0.0))
    save_system(folder / "timeless.json", synth.StateSpace(K.A, K.B, K.C, K.D, True))
    save_system(folder / "narrow.json", synth.StateSpace.gain(np.ones((3, 3)), 1.0))
    save_system(folder / "nothing.json", synth.StateSpace.gain(np.zeros((3, 6)), 1.0))
    save_system(folder / "plant.json", design.plant)
    costs = sheet.craft.costs(pointing=np.radians(1.0), bandwidth=0.1)
    save_mpc(synth.mpc(G, **costs, Np=8, Nc=3), folder / "mpc.json")
    save_mpc(synth.mpc(synth.StateSpace(*G.matrices, 0.5), **costs, Np=8, Nc=3), folder / "fast_mpc.json")
    (folder / "broken.json").write_text("{")
    return folder


@pytest.fixture
def command(folder, monkeypatch, capsys):
    """Run `synth` in the folder: (exit code, what it printed, its errors)."""
    monkeypatch.chdir(folder)

    def run(*arguments):
        code = main([str(a) for a in arguments])
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_the_declared_entry_point_loads():
    assert list(DECLARED) == [door.GROUP]
    assert door.find() is flies
    for name in ("REFUSALS", "template", "read", "model", "weights", "fly"):
        assert hasattr(flies, name)


@pytest.mark.slow
def test_what_init_prints_works_as_printed(tmp_path, command):
    new = tmp_path / "my satellite"
    code, out, _ = command("init", new)
    assert code == 0
    design, fly = (shlex.split(line) for line in out.splitlines()[1:])
    assert design[:2] == ["synth", "design"]
    assert command(*design[1:])[0] == 0
    code, out, _ = command(*fly[1:], "--fast", "--duration", 800)
    assert code == 0, out
    assert "met" in out
    assert "A 6U CubeSat" in (new / "out" / "report.html").read_text()


def test_init_replaces_nothing_unasked(tmp_path, command):
    code, out, _ = command("init", tmp_path, "--json")
    files = json.loads(out)["files"]
    assert code == 0
    assert [Path(file).name for file in files] == ["spacecraft.toml", "design.toml"]
    (tmp_path / "design.toml").write_text("mine")
    (tmp_path / "spacecraft.toml").unlink()
    code, _, err = command("init", tmp_path)
    assert code == 2
    assert "design.toml exists; pass --force to replace it" in err
    assert (tmp_path / "design.toml").read_text() == "mine"
    assert not (tmp_path / "spacecraft.toml").exists()
    assert command("init", tmp_path, "--force")[0] == 0
    assert tomllib.loads((tmp_path / "design.toml").read_text())["synthesis"]["problem"] == "fourblock"


def test_a_study_takes_its_plant_and_weights_from_a_spacecraft(folder, command):
    code, _, _ = command("design", "design.toml", "-o", "made.json", "--force")
    assert code == 0
    made, direct = synth.Design.load(folder / "made.json"), synth.Design.load(folder / "controller.json")
    assert made.gamma == pytest.approx(direct.gamma, rel=1e-4)
    for mine, other in zip(made.plant.system.matrices, direct.plant.system.matrices, strict=True):
        np.testing.assert_allclose(mine, other, rtol=1e-12, atol=1e-15)
    assert made.plant.u == flies.CONTROLS
    assert made.plant.units["torque x"] == "N m"


def test_weights_that_are_given_take_the_place_of_the_spacecrafts(tmp_path, folder):
    (tmp_path / "spacecraft.toml").write_text(toml(SMALL))
    (tmp_path / "x.toml").write_text(STUDY + "[weights]\nWnoise = 0.5\n")
    sheet = plants.read_spacecraft(tmp_path / "spacecraft.toml")
    G = synth.c2d(sheet.craft.linear(), 1.0)
    wanted = synth.GeneralizedPlant.four_block(G, **sheet.weights() | {"Wnoise": 0.5})
    found = read_study(tmp_path / "x.toml").plant
    np.testing.assert_allclose(found.D21, wanted.D21, rtol=1e-14)
    assert read_study(folder / "design.toml").problem == "fourblock"


def test_the_four_block_problem_of_any_plant(tmp_path):
    text = (
        "[plant]\ndt = 0.5\nnum = [1]\nden = [1, -0.5]\n[synthesis]\nproblem = 'fourblock'\n"
        "[weights]\nWdist = 2\nWnoise = 0.1\nWout = {num = [1, 0], den = [1, -0.9]}\nWact = 0.3\n"
    )
    (tmp_path / "x.toml").write_text(text)
    W = synth.system(([1, 0], [1, -0.9], 0.5))
    G = synth.system(([1], [1, -0.5], 0.5))
    wanted = synth.hinfsyn(synth.GeneralizedPlant.four_block(G, Wdist=2, Wnoise=0.1, Wout=W, Wact=0.3))
    assert read_study(tmp_path / "x.toml").design().gamma == pytest.approx(wanted.gamma, rel=1e-9)
    (tmp_path / "x.toml").write_text(text.replace("Wact = 0.3\n", "").replace("Wdist = 2", "Wdst = 2"))
    with pytest.raises(SpecificationError) as caught:
        read_study(tmp_path / "x.toml")
    assert "weights.Wact: missing; expected shape 1 x 1" in caught.value.problems
    assert any("Wdst: unknown; did you mean 'Wdist'?" in text for text in caught.value.problems)


@pytest.mark.parametrize(
    ("craft", "study", "message"),
    [
        ({"dt": -1}, STUDY, r"plant.spacecraft: spacecraft.toml:\n  dt = -1: dt must be positive"),
        ({}, STUDY.replace("spacecraft.toml", "none.toml"), "plant.spacecraft: .*none.toml: no such file"),
        ({}, STUDY.replace("spacecraft.toml", "../none.toml"), "it is outside the folder of the study"),
        ({}, STUDY.replace("spacecraft =", "sample = 1\nspacecraft ="), "plant.sample: unknown"),
        ({"requirements": {"pointing_deg": 0.5, "bandwidth": 5}}, STUDY, "weights: those of .* 5 rad/s"),
    ],
)  # fmt: skip
def test_studies_of_spacecraft_tell_their_mistakes(tmp_path, monkeypatch, craft, study, message):
    monkeypatch.chdir(tmp_path)
    Path("spacecraft.toml").write_text(toml(SMALL | craft))
    Path("x.toml").write_text(study)
    with pytest.raises(SpecificationError, match=message):
        read_study("x.toml")


@pytest.fixture(scope="module")
def flown(folder):
    """A design, the same without its plant, and predictive control, flown once."""
    import contextlib
    import io

    names = [str(folder / f"{name}.json") for name in ("controller", "plain", "mpc")]
    printed, page = io.StringIO(), folder / "out"
    with contextlib.redirect_stdout(printed), pytest.MonkeyPatch.context() as patch:
        patch.setattr(door, "find", lambda: flies)
        code = main(["fly", str(folder / "spacecraft.toml"), *names, "--report", str(page), "--runs", "2", "--json"])
    return code, json.loads(printed.getvalue()), (page / "report.html").read_text()


def test_controllers_fly_and_are_reported(flown):
    code, data, page = flown
    assert code == (0 if data["met"] else 1)
    assert [*data["controllers"]] == ["controller", "plain", "mpc"]
    for figures in data["controllers"].values():
        assert (figures["runs"], figures["failed"]) == (2, 0)
        assert 0 < figures["pointing"] < np.radians(1.0)
    assert data["met"]
    assert "Small &amp; &lt;b&gt;bold&lt;/b&gt;" in page
    for title in ("Requirements", "Controllers", "Budget", "Pointing error", "Wheel speeds", "Spacecraft"):
        assert title in page


def test_a_design_and_its_bare_controller_fly_alike(flown):
    _, data, _ = flown
    assert data["controllers"]["controller"] == data["controllers"]["plain"]


def test_a_missed_requirement_is_an_exit_code(command, tmp_path):
    (tmp_path / "spacecraft.toml").write_text(toml(SMALL | {"requirements": {"pointing_deg": 1e-6, "bandwidth": 0.1}}))
    code, out, _ = command("fly", tmp_path / "spacecraft.toml", "controller.json", "--runs", 2)
    assert code == 1
    assert "NOT MET" in out
    assert "report" not in out


def test_the_other_sign_flies_when_it_is_said(command):
    code, out, _ = command("fly", "spacecraft.toml", "positive.json", "--positive", "--runs", 2)
    assert code == 0
    assert "positive" in out


def test_an_unstable_loop_is_told_and_flown(command):
    code, _, err = command("fly", "spacecraft.toml", "nothing.json", "--runs", 2)
    assert code == 1
    assert "the linear loop of nothing is unstable" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["slow.json"], "slow.json: its sampling time is 2 s, and spacecraft.toml has the control period dt = 1 s"),
        (["fast_mpc.json"], "fast_mpc.json: its sampling time is 0.5 s, and spacecraft.toml has the control period"),
        (["continuous.json"], "continuous.json: it is continuous, and spacecraft.toml has the control period dt = 1 s"),
        (["timeless.json"], "sampled at a time that it does not say"),
        (["narrow.json"], "narrow.json: it has 3 inputs and 3 outputs; that of spacecraft.toml takes the error of q x"),
        (["design.toml"], "design.toml: this is no controller; `synth design` makes one of a study"),
        (["plant.json"], "plant.json: this is a plant; pass a design or a controller"),
        (["broken.json"], "broken.json: it is no JSON"),
        (["none.json"], "none.json: there is no such file"),
        (
            ["positive.json"],
            "positive.json: the loop that it closes is unstable, and stable with the other sign; --pos",
        ),
        (
            ["plain.json", "--positive"],
            "unstable, and stable with the other sign; leave out --positive",
        ),
        (["controller.json", "./controller.json"], "one file is given twice"),
        (["controller.json", "--runs", "0"], "--runs is 0"),
        (["controller.json", "--seed=-1"], "--seed -1"),
        (["controller.json", "--fast", "--runs", "2"], "--fast and --runs both say how many flights"),
        (["controller.json", "--duration", "-5"], "duration must be positive"),
        (["controller.json", "--duration", "1.5"], "duration = 1.5 s: give a whole number of control periods"),
        (["controller.json", "--duration", "nan"], "duration must be finite"),
        (["controller.json", "--report", "plain.json"], "plain.json: File exists"),
    ],
)
def test_what_does_not_fit_is_told(command, arguments, message):
    code, out, err = command("fly", "spacecraft.toml", *arguments)
    assert code == 2
    assert out == ""
    assert message in err, err


def test_files_the_wrong_way_round_are_told(command):
    code, _, err = command("fly", "controller.json", "spacecraft.toml")
    assert code == 2
    assert "controller.json: this is no spacecraft; its TOML file comes first" in err


def test_a_spacecraft_with_mistakes_is_told(command, tmp_path):
    (tmp_path / "x.toml").write_text(toml(SMALL | {"dt": 0, "wheel": []}))
    code, _, err = command("fly", tmp_path / "x.toml", "controller.json")
    assert code == 2
    assert "wrong in 2 places" in err
    assert "did you mean 'wheels'?" in err


def test_where_nothing_flies_the_remedy_is_told(command, monkeypatch):
    monkeypatch.setattr(door.metadata, "entry_points", lambda *, group: [])
    for arguments in (["fly", "spacecraft.toml", "controller.json"], ["init", "new"]):
        code, _, err = command(*arguments)
        assert code == 2
        assert "no installed package flies spacecraft" in err
        assert "pip install" in err
    entry = EntryPoint("x", "no_such_package.fly", door.GROUP)
    monkeypatch.setattr(door.metadata, "entry_points", lambda *, group: [entry])
    with pytest.raises(ModelError, match=r"no_such_package\.fly, cannot be imported"):
        door.find()


def test_a_stored_predictive_controller_commands_the_same(folder):
    sheet = plants.read_spacecraft(folder / "spacecraft.toml")
    given = synth.mpc(
        synth.c2d(sheet.craft.linear(), 1.0), **sheet.craft.costs(pointing=0.01, bandwidth=0.1), Np=6, Nc=2, delay=1,
        hmax=[0.01, np.inf, 0.02], ymax=[np.inf] * 3 + [0.01] * 3,
    )  # fmt: skip
    save_mpc(given, folder / "other.json")
    again = restored(load_mpc(folder / "other.json"))
    states = given.init(), again.init()
    rng = np.random.default_rng(0)
    for y in 0.01 * rng.standard_normal((6, 6)):
        pairs = [K.step(state, y, np.zeros(6)) for K, state in zip((given, again), states, strict=True)]
        states = [state for state, _ in pairs]
        np.testing.assert_array_equal(pairs[0][1], pairs[1][1])
