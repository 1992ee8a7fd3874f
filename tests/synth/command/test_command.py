"""The `synth` command as a stranger meets it."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from literature import GAMMA_PECORILLA2024, compleib, cubesat_pecorilla2024

from synth.__main__ import main
from synth.command.specification import read_study
from synth.delivery.formats import export
from synth.delivery.modelfiles import Model, read, save_system
from synth.files import sealed_by_parts
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

STUDY = Path(__file__).parents[3] / "examples" / "cubesat3u" / "cubesat3u.toml"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A folder with the CubeSat design, a slower one, a loop-shaping one, and plants."""
    folder = tmp_path_factory.mktemp("designs")
    cubesat = cubesat_pecorilla2024()
    design = hinfsyn(cubesat, method="riccati")
    design.save(folder / "cubesat.json")
    hinfsyn(cubesat, method="riccati", gamma=2 * design.gamma).save(folder / "relaxed.json")
    hinfsyn(compleib()["ac2"][0], method="riccati").save(folder / "continuous.json")
    g = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]), 0.1)
    shaped = ncfsyn(StateSpace(g.A, g.B, -g.C, g.D, 0.1), method="riccati")
    shaped.save(folder / "shaped.json")
    save_system(folder / "plant.json", Model(g, ("force",), ("position",), {"force": "N"}))
    save_system(folder / "controller.json", shaped.controller)
    save_system(folder / "generalised.json", cubesat)
    return folder


@pytest.fixture
def synth(folder, monkeypatch, capsys):
    """Run the command in the folder: (exit code, what it printed, its errors)."""
    monkeypatch.chdir(folder)

    def run(*arguments: str):
        try:
            code = main(list(arguments))
        except SystemExit as stop:
            code = stop.code
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_help_imports_nothing_heavy():
    code = (
        "import sys\nfrom synth.__main__ import main\n"
        "try: main(['--help'])\nexcept SystemExit: pass\n"
        "print({'numpy', 'scipy', 'jax', 'cvxpy', 'control', 'matplotlib', 'importlib.metadata'} & {*sys.modules})"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.endswith("set()\n")
    assert "exit codes:" in found.stdout
    module = subprocess.run([sys.executable, "-m", "synth", "info", "no.json"], capture_output=True, text=True)
    assert (module.returncode, module.stderr) == (2, "synth info: no.json: there is no such file\n")


def test_version(synth):
    code, out, _ = synth("--version")
    assert code == 0
    assert out.startswith("synth 0.")


def test_info(synth):
    code, out, _ = synth("info", "cubesat.json", "plant.json", "generalised.json", "shaped.json")
    assert code == 0
    assert "optimum            4.157925" in out
    assert "gamma              4.157962" in out
    assert "force [N]" in out
    found = json.loads(synth("info", "cubesat.json", "--json")[1])[0]
    design = Design.load("cubesat.json")
    assert found["gamma"] == found["verified_norm"] == design.gamma
    assert found["plant_sha256"] == design.plant.system.digest()
    assert found["versions"] == design.info.versions
    assert found["controls"] == list(design.plant.u)


def test_verify(synth):
    code, out, err = synth("verify", "cubesat.json", "--umin=-1e-3", "--umax", "1e-3")
    assert (code, err) == (0, "")
    assert "accepted; ratios to the level" in out
    assert "NOT accepted" not in out
    code, out, _ = synth("verify", "cubesat.json", "--phase-margin-deg", "80")
    assert code == 1
    assert "required 80" in out
    assert "required 0.34" in out
    code, out, _ = synth("verify", "cubesat.json", "--disk-margin", "0", "--json")
    assert [c["verdict"] for c in json.loads(out)[0]["conditions"] if c["name"] == "disk margin"] == ["-"]
    code, out, _ = synth("verify", "cubesat.json", "--json")
    found = json.loads(out)[0]
    assert found["passed"]
    assert {c["verdict"] for c in found["conditions"]} == {"pass", "-"}
    assert len(found["margins"]["input"]) == 3


@pytest.mark.slow
def test_verify_on_another_plant(synth):
    code, out, _ = synth("verify", "controller.json", "--plant", "plant.json", "--negative")
    assert code == 0
    own = json.loads(synth("verify", "shaped.json", "--json")[1])[0]
    other = json.loads(synth("verify", "controller.json", "--plant", "plant.json", "--negative", "--json")[1])[0]
    assert other["conditions"][0]["norm"] == pytest.approx(own["conditions"][0]["norm"], rel=1e-6)
    code, out, _ = synth("verify", "controller.json", "--plant", "plant.json")
    assert code == 1
    assert "unstable" in out
    options = ("--plant", "plant.json", "--negative", "--umin=-1", "--umax=1", "--antiwindup")
    assert synth("verify", "shaped.json", *options)[0] == 0
    assert synth("verify", "continuous.json", "--dt", "0.01")[0] == 1


def test_export(synth, tmp_path):
    code, out, _ = synth(
        "export", "cubesat.json", "--format", "c", "-o", str(tmp_path), "--name", "attitude", "--float"
    )
    assert code == 0
    assert {Path(line).name for line in out.split()} == {"attitude.h", "attitude.c"}
    assert "float precision" in (tmp_path / "attitude.h").read_text()
    again = ("export", "cubesat.json", "--format", "c", "-o", str(tmp_path), "--name", "attitude")
    code, _, err = synth(*again)
    assert code == 2
    assert "exists; pass --force to replace it" in err
    assert synth(*again, "--force", "--umin=-1,-1,-2", "--umax=2", "--json")[0] == 0
    assert "in [-2" in (tmp_path / "attitude.h").read_text()
    assert synth("export", "shaped.json", "--format", "json", "-o", str(tmp_path), "--name", "copy")[0] == 0
    assert Design.load(tmp_path / "copy.json").gamma == Design.load("shaped.json").gamma
    assert synth("export", "controller.json", "--format", "json", "-o", str(tmp_path), "--name", "plain")[0] == 0
    assert read(tmp_path / "plain.json").system.digest() == read("controller.json").system.digest()


def test_a_controller_file_keeps_its_limits_and_its_anti_windup(synth, folder, tmp_path):
    own = AntiWindup.of(Design.load(folder / "shaped.json"), [-1.0], [np.inf])
    export(own, "json", tmp_path, name="limited")
    export(own, "c", tmp_path, name="direct")
    file = str(tmp_path / "limited.json")
    assert synth("export", file, "--format", "c", "-o", str(tmp_path), "--name", "read")[0] == 0
    assert (tmp_path / "read.c").read_text().replace("read", "direct").replace("READ", "DIRECT") == (
        tmp_path / "direct.c"
    ).read_text()
    facts = json.loads(synth("info", file, "--json")[1])[0]
    assert (facts["umin"], facts["umax"]) == ([-1.0], [None])
    options = ("--plant", "plant.json", "--negative")
    conditions = json.loads(synth("verify", file, *options, "--json")[1])[0]["conditions"]
    assert [c["passed"] for c in conditions if c["name"] == "saturation"] == [True]
    code, _, err = synth("verify", file, *options, "--umax=1")
    assert code == 2
    assert "an AntiWindup has its own" in err
    damaged = json.loads((tmp_path / "limited.json").read_text()) | {"umin": None}
    for sealing, message in ((dict, "umin was changed"), (sealed_by_parts, "no list umin")):
        (tmp_path / "damaged.json").write_text(json.dumps(sealing(damaged)))
        code, _, err = synth("info", str(tmp_path / "damaged.json"))
        assert code == 2
        assert message in err


@pytest.mark.slow
def test_compare(synth, tmp_path):
    arguments = ("compare", "cubesat.json", "relaxed.json", "shaped.json", "--plot", str(tmp_path / "a.svg"))
    code, out, _ = synth(*arguments)
    assert code == 0
    assert "nu-gap, controllers" in out
    first = (tmp_path / "a.svg").read_bytes()
    code, out, _ = synth(*arguments, "--json")
    assert first == (tmp_path / "a.svg").read_bytes()
    a, b, c = json.loads(out)
    assert a["gamma"] < b["gamma"] <= 2 * a["gamma"]
    assert b["optimum"] is None
    assert a["nugap_controller"] == pytest.approx(0, abs=1e-5)
    assert 0 < b["nugap_controller"] <= 1
    assert b["nugap_plant"] == pytest.approx(0, abs=1e-5)
    assert c["nugap_controller"] is None
    assert a["ncf_margin"] == a["ncf_margin_reference"]
    code, _, err = synth("compare", "cubesat.json", "--plot", "a.pdf")
    assert (code, "saved as .svg or .png" in err) == (2, True)


@pytest.mark.slow
def test_the_study_of_the_cubesat(synth, tmp_path):
    target = str(tmp_path / "hinf.json")
    code, out, err = synth("design", str(STUDY), "-o", target)
    assert (code, err) == (0, "")
    assert "accepted" in out
    found, plant = Design.load(target), cubesat_pecorilla2024()
    assert found.gamma == pytest.approx(GAMMA_PECORILLA2024, rel=1e-5)
    np.testing.assert_allclose(found.plant.system.A, plant.A, atol=1e-14)
    np.testing.assert_allclose(found.plant.D21, plant.D21, atol=1e-16)
    code, _, err = synth("design", str(STUDY), "-o", target)
    assert (code, "--force" in err) == (2, True)


@pytest.mark.slow
def test_the_study_of_the_cubesat_is_the_design_of_its_example():
    """Names, units and matrices of examples/cubesat3u/cubesat3u.py, from the TOML file beside it."""
    from cubesat3u import design_controllers

    plant, example = read_study(STUDY).plant, design_controllers()[0].plant
    assert (plant.u, plant.y, plant.units) == (example.u, example.y, example.units)
    for name in ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22"):
        np.testing.assert_allclose(getattr(plant, name), getattr(example, name), atol=1e-14)


INTEGRATOR = """
plant = { dt = 1, A = [[1]], B = [[1]], C = [[1]], D = [[0]] }
synthesis = { problem = "loopshaping", gamma_factor = 1.2, method = "riccati" }
"""


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        ({}, 0, ""),
        ({"gamma_factor = 1.2": "gamma = 1.01"}, 3, "is not above the optimal level"),
        ({"B = [[1]]": "B = [[0]]"}, 3, "no controller can stabilise"),
        ({"B = [[1]]": "B = [[inf]]"}, 2, "plant.B[0][0]: inf is not finite"),
        ({"dt = 1,": "dx = 1,"}, 2, "did you mean"),
        ({"\nsynthesis": "\nspecifications.ncf_margin = 0.9\nsynthesis"}, 1, "missed: ncf margin"),
    ],
)
def test_exit_codes_of_a_design(synth, tmp_path, change, code, message):
    text = INTEGRATOR
    for old, new in change.items():
        text = text.replace(old, new)
    (tmp_path / "study.toml").write_text(text)
    found, _, err = synth("design", str(tmp_path / "study.toml"))
    assert found == code
    assert message in err
    assert (tmp_path / "study.json").exists() == (code in (0, 1))


def damaged(folder: Path, name: str, change) -> str:
    data = json.loads((folder / "cubesat.json").read_text())
    change(data)
    (folder / name).write_text(json.dumps(sealed_by_parts(data)))  # as by one who knows how
    return name


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        (lambda d: d.update(format="other"), 2, "the format is 'other'"),
        (lambda d: d.update(format_version=7), 2, "format_version is 7"),
        (lambda d: d.pop("controller"), 2, "incomplete or damaged"),
        (lambda d: d["controller"]["A"][0].__setitem__(0, float("nan")), 2, "it holds NaN, which is no number"),
        (lambda d: d["controller"]["D"][0].__setitem__(0, -1e3), 1, "unstable"),
        (lambda d: d.update(verified_norm=1e-6), 1, "the file claims a norm"),
    ],
)
def test_damaged_designs(synth, folder, change, code, message):
    for command in (("info",), ("verify",), ("compare",)):
        found, out, err = synth(*command, damaged(folder, "damaged.json", change))
        assert (found, out) == (code, "")
        assert err.startswith(f"synth {command[0]}: damaged.json: ")
        assert message in err
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("info", "no.json"), "no.json: there is no such file"),
        (("info", "."), ".: this is a folder"),
        (("info", "text.json"), "text.json: it is no JSON"),
        (("info", "binary.json"), "binary.json: it is no JSON"),
        (("info", "list.json"), "list.json: the format is None"),
        (("info", "broken.mat"), "broken.mat: it is no .mat file"),
        (("info", "lacking.json"), "lacking.json: the system has no D, dt"),
        (("info", "ragged.json"), "ragged.json: A is not a real matrix"),
        (("info", "names.json"), "names.json: u is ['a', 'b']; give 1 different names"),
        (("verify", "controller.json"), "controller.json: the controller comes without a plant; pass --plant"),
        (("verify", "generalised.json"), "generalised.json: this is a plant"),
        (("verify", "continuous.json"), "continuous.json: the design is continuous; pass dt"),
        (("verify", "shaped.json", "--umin=-1"), "shaped plant W2 G W1 only"),
        (("verify", "shaped.json", "--antiwindup"), "--antiwindup needs a loop-shaping design, and --umin and --umax"),
        (("verify", "cubesat.json", "--negative"), "--negative is about a plain --plant"),
        (("verify", "cubesat.json", "--ratio", "nan"), "ratio is nan"),
        (("verify", "cubesat.json", "--umin", "x"), "'x' is not a number"),
        (("export", "cubesat.json", "--format", "c", "-o", "text.json"), "text.json is no folder"),
        (("export", "continuous.json", "--format", "c", "-o", "out"), "the controller is continuous"),
        (("export", "generalised.json", "--format", "c", "-o", "out"), "this is a plant"),
        (("export", "cubesat.json", "--format", "exe", "-o", "out"), "invalid choice: 'exe'"),
        (("compare", "plant.json"), "plant.json: this is no design"),
        (("compare", "cubesat.json", "--plot", "no/a.svg"), "no/"),
        (("design", "no.toml"), "no.toml: the file cannot be read"),
        (("design", "no.toml", "-o", "no/d.json"), "no/d.json: its folder does not exist"),
        (("design", "no.toml", "-o", "d.txt"), "d.txt: a design is saved as .json or .mat"),
        ((), "required: COMMAND"),
        (("inform",), "invalid choice: 'inform'"),
    ],
)
def test_bad_input_is_one_line_and_code_2(synth, folder, arguments, message):
    (folder / "text.json").write_text("{")
    (folder / "binary.json").write_bytes(b"\xff\xfe\x00")
    (folder / "list.json").write_text("[1]")
    (folder / "broken.mat").write_bytes(b"no matrices here")
    head = {"format": "convex-synth system", "format_version": 1}
    (folder / "lacking.json").write_text(json.dumps({**head, "A": [[1]], "B": [[1]], "C": [[1]]}))
    static = {**head, "A": [], "B": [], "C": [], "D": [[1]], "dt": 1}
    (folder / "ragged.json").write_text(json.dumps({**static, "A": [[1, 2], [3]], "B": [[1], [1]], "C": [[1, 1]]}))
    (folder / "names.json").write_text(json.dumps({**static, "u": ["a", "b"]}))
    code, out, err = synth(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("synth")
    assert message in err
    assert err.count("\n") == 1


def test_debug_shows_where_an_error_came_from(synth):
    code, _, err = synth("info", "no.json", "--debug")
    assert code == 2
    assert "Traceback" in err
    assert err.endswith("synth info: no.json: there is no such file\n")


def test_systems_from_mat_files(synth, folder):
    g = read("plant.json").system
    scipy.io.savemat("plant.mat", {"A": g.A, "B": g.B, "C": g.C, "D": g.D, "dt": g.dt})
    assert read("plant.mat").system.digest() == g.digest()
    P = read("generalised.json")
    names = ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22", "dt")
    scipy.io.savemat("generalised.mat", {name: getattr(P, name) for name in names})
    assert read("generalised.mat").system.digest() == P.system.digest()
    scipy.io.savemat("complex.mat", {"A": g.A * 1j, "B": g.B, "C": g.C, "D": g.D, "dt": g.dt})
    code, _, err = synth("info", "complex.mat")
    assert (code, "A is no real matrix" in err) == (2, True)


def test_systems_keep_every_bit_names_and_units(folder):
    again = read(folder / "generalised.json")
    plant = cubesat_pecorilla2024()
    assert again.system.digest() == plant.system.digest()
    assert (again.w, again.u, again.z, again.y, again.units) == (plant.w, plant.u, plant.z, plant.y, plant.units)
    model = read(folder / "plant.json")
    assert (model.u, model.y, model.units) == (("force",), ("position",), {"force": "N"})


def test_an_interrupted_command_ends_with_130(synth, monkeypatch):
    def interrupted(options):
        raise KeyboardInterrupt

    monkeypatch.setattr("synth.command.commands.run", interrupted)
    assert synth("info", "plant.json") == (130, "", "synth: interrupted\n")
