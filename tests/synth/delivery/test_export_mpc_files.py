"""What the files of a predictive controller say, in every format; that units and commands run the same controller."""

import re
import shutil
import subprocess
import zipfile

import numpy as np
import pytest
import scipy.io
from exportedmpc import flight
from exportedunit import Unit
from table3 import MODEL, SOFT, TABLE_3, TORQUE

from synth.__main__ import main
from synth.delivery.formats import export
from synth.delivery.qp import load_mpc, restored, save_mpc
from synth.errors import ExportError
from synth.predictive.horizon import mpc
from synth.synthesis.convention import PREDICTIVE
from synth.systems.statespace import StateSpace

SIGNALS = {"u": ("Tx", "Ty", "Tz"), "y": ("q1", "q2", "q3", "wx", "wy", "wz")}
UNITS = dict.fromkeys(SIGNALS["u"], "N m") | dict.fromkeys(SIGNALS["y"][3:], "rad/s")
NAMED = StateSpace(*MODEL.matrices, MODEL.dt, **SIGNALS, units=UNITS)
FORMATS = ("json", "mat", "c", "fmu2", "fmu3")


def controller(**options):
    return mpc(NAMED, **({"form": "velocity"} | TABLE_3 | SOFT | options))


def flat(text: str) -> str:
    """A wrapped comment in one line."""
    return re.sub(r"[\s*]+", " ", text)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The first file of each format."""
    if shutil.which("gcc") is None:
        pytest.skip("an FMU holds a binary: gcc is not installed")
    folder = tmp_path_factory.mktemp("written")
    return {f: export(controller(delay=1), f, folder / f, name="attitude")[0] for f in FORMATS}


def test_all_formats_say_the_same_in_the_same_words(written):
    found = {"json": written["json"].read_text(), "c": written["c"].read_text()}
    data = scipy.io.loadmat(written["mat"], simplify_cells=True)["mpc"]
    found["mat"] = "\n".join(f"{key}: {value}" for key, value in data.items())
    for unit in ("fmu2", "fmu3"):
        with zipfile.ZipFile(written[unit]) as archive:
            for name in ("modelDescription.xml", "documentation/index.html"):
                text = archive.read(name).decode().replace("&gt;", ">").replace("&lt;", "<")
                found[f"{unit} {name}"] = text
                assert re.search("outputs are seen one sampling time.*it is the sampling time of delay that", text)
    for form, text in found.items():
        text = flat(text)
        assert PREDICTIVE in text, form
        assert "its command acts one sampling time later, which is planned for" in text, form
        assert "umin <= u <= umax, which the plan knows and no command exceeds" in text, form
        assert "ymin <= y <= ymax, |momentum| <= hmax" in text, form
        for name in (*SIGNALS["u"], *SIGNALS["y"], "N m", "rad/s"):
            assert name in text, (form, name)
        if form not in ("json", "mat"):
            assert "the last command again, within its limits" in text, form
            assert "within 1e-8 of the optimum" in text, form


def test_the_header_names_limits_and_the_bound_of_the_iterations(written):
    text = flat(written["c"].read_text())
    assert "u[0] Tx [N m] in [-0.001, 0.001] |momentum| soft within 0.0108" in text
    assert "y[3], r[3] wx [rad/s] soft in [-0.03490658503988659, 0.03490658503988659]" in text
    assert re.search(r"#define ATTITUDE_ITERATIONS \d+ /", text)
    assert re.search(r"at most \d+ exchanges of rows a sample, no allocation", text)


def test_a_penalty_that_drowns_the_rest_is_told_in_the_header(tmp_path, written):
    """Full command over 60 samples costs 1e18: what cannot be kept is solved in long arithmetic, which stays here."""
    model = StateSpace([[1.4, 0.3], [0, 0.9]], [[0], [1]], np.eye(2), np.zeros((2, 1)), 1.0)
    stiff = mpc(model, Q=1, R=1, Np=60, Nc=60, umin=-1, umax=1, ymax=[1.0, 0.6], ymin=[-1.0, -0.6])
    text = flat(export(stiff, "c", tmp_path, self_test=False)[0].read_text())
    assert re.search(r"penalty is \de\+1\d times the weight of a command: where one cannot be kept", text)
    assert "long arithmetic" not in flat(written["c"].read_text())


def test_the_data_is_read_back_with_its_names(written):
    again = restored(load_mpc(written["json"]))
    assert (again.problem.model.u, again.problem.model.y) == (SIGNALS["u"], SIGNALS["y"])
    assert again.problem.model.units == UNITS
    x, r = np.array([0.1, -0.1, 0.05, 0, 0, 0]), np.zeros(6)
    np.testing.assert_array_equal(flight(again)(x, r), flight(controller(delay=1))(x, r))


def test_the_header_is_one_of_cpp_too(written):
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    command = ["g++", "-x", "c++", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only", str(written["c"])]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("version", [2, 3])
def test_a_unit_flies_the_cubesat_as_the_controller_does(version, written, tmp_path):
    """2000 samples, each with a plant of its own; u of sample k is seen after the step from k dt to (k + 1) dt."""
    fmpy = pytest.importorskip("fmpy", reason="fmpy is the oracle of this test and is not installed")
    from fmpy.validation import validate_fmu

    path = written[f"fmu{version}"]
    assert validate_fmu(str(path)) == []
    unit, own, rng = Unit(fmpy, path, tmp_path / "unzipped"), flight(controller(delay=1)), np.random.default_rng(5)
    noise = 1e-3 * rng.standard_normal((2000, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    unit.start()
    assert unit.get() == [0.0, 0.0, 0.0]
    x, z, before, after, off = np.full(6, 0.1), np.full(6, 0.1), np.zeros(3), np.zeros(3), 0.0
    for k in range(2000):
        r = np.array([0.2, -0.1, 0.3, 0, 0, 0]) * (k // 100 % 2)
        unit.set([*(z + noise[k]), *r])
        unit.step(k * 0.5, 0.5)
        found, u = np.array(unit.get()), own(x + noise[k], r)
        off = max(off, np.abs(found - u).max())
        x, z = MODEL.A @ x + MODEL.B @ before, MODEL.A @ z + MODEL.B @ after
        before, after = u, found
    unit.close()
    assert off <= 1e-9 * TORQUE


def test_the_command_exports_what_the_function_does(tmp_path, capsys):
    saved = save_mpc(controller(), tmp_path / "mpc.json")
    for form in ("c", "json"):
        assert main(["export", str(saved), "--format", form, "-o", str(tmp_path / "out"), "--name", "attitude"]) == 0
        export(controller(), form, tmp_path / "own", name="attitude", force=True)
    for file in ("attitude.c", "attitude.h"):
        assert (tmp_path / "out" / file).read_bytes() == (tmp_path / "own" / file).read_bytes()
    asked = ["export", str(saved), "--format", "c", "-o", str(tmp_path / "out"), "--force", "--float"]
    capsys.readouterr()
    assert main(asked) != 0
    assert "in other numbers than doubles" in capsys.readouterr().err


def test_names_that_would_break_a_file_are_refused(tmp_path):
    model = StateSpace(*MODEL.matrices, MODEL.dt, u=("a*/b", "c", "d"))
    with pytest.raises(ExportError, match=r"signal 'a\*/b'"):
        export(mpc(model, **TABLE_3), "c", tmp_path)
