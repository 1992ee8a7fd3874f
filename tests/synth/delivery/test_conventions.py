"""Every exported file says in the same words what the controller reads, when it acts and within which limits."""

import json
import re
import shutil
import zipfile

import numpy as np
import pytest
import scipy.io
from literature import cubesat_pecorilla2024

import synth
from synth.delivery.acceptance import lagging
from synth.delivery.formats import export
from synth.delivery.modelfiles import read
from synth.errors import ModelError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.controller import LinearController
from synth.synthesis.convention import ERROR, MEASURED, UNTOLD
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.statespace import StateSpace

G = synth.c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]], y=("angle",), u=("torque",)), 0.5)
K = StateSpace([[0.5]], [[1.0]], [[0.3]], [[0.1]], 0.5)
LIMITS = {"umin": -0.5, "umax": 0.25}


def measured() -> Design:
    """A generalised plant that measures y itself, not an error."""
    P = synth.GeneralizedPlant.four_block(G, Wdist=1, Wnoise=1, Wout=1, Wact=1)
    turned = synth.GeneralizedPlant(**{**vars(P), "C2": -P.C2, "D21": -P.D21, "y": ("angle",)})
    return hinfsyn(turned)


SOURCES = {
    "four blocks": (lambda: hinfsyn(synth.GeneralizedPlant.four_block(G, Wdist=1, Wnoise=1, Wout=1, Wact=1)), ERROR),
    "tracking": (lambda: hinfsyn(cubesat_pecorilla2024()), ERROR),
    "measured": (measured, MEASURED),
    "loop shaping": (lambda: synth.ncfsyn(G, 1.0), MEASURED),
    "LinearController": (lambda: LinearController.of(K), ERROR),
    "StateSpace": (lambda: K, UNTOLD),
}


@pytest.fixture(scope="module", params=SOURCES)
def source(request):
    make, told = SOURCES[request.param]
    return make(), told


def flat(text: str) -> str:
    """A wrapped comment in one line."""
    return re.sub(r"[\s*]+", " ", text)


def texts(source, folder, **limits) -> dict[str, str]:
    """What the files of all formats say, as one text for each."""
    formats = ["json", "mat", "c", *(["fmu2", "fmu3"] if shutil.which("gcc") else [])]
    written = {f: export(source, f, folder / f, allow_unstable=True, **limits)[0] for f in formats}
    found = {"json": written["json"].read_text(), "c": written["c"].read_text()}
    contents = scipy.io.loadmat(written["mat"], simplify_cells=True)
    data = contents["design"] if "design" in contents else contents["controller"]
    found["mat"] = "\n".join(f"{key}: {value}" for key, value in data.items() if key != "json")
    for unit in formats[3:]:
        with zipfile.ZipFile(written[unit]) as archive:
            for name in ("modelDescription.xml", "documentation/index.html"):
                found[f"{unit} {name}"] = archive.read(name).decode().replace("&gt;", ">")
    return {key: flat(text) for key, text in found.items()}


def test_all_formats_say_the_same_of_sign_and_sampling(source, tmp_path):
    source, told = source
    for form, text in texts(source, tmp_path).items():
        assert told in text, form
        assert "sample k is read at k times 0.5 s" in text or "times 4" in text or "times 1" in text, form
        assert all(other not in text for other in {ERROR, MEASURED, UNTOLD} - {told}), form
        if form.startswith("fmu"):
            assert "outputs are seen one sampling time" in text


def test_all_formats_hold_the_limits_and_what_happens_there(source, tmp_path):
    source, told = source
    wide = {
        name: [value] * synth.system(source.controller if isinstance(source, Design) else source).ny
        for name, value in LIMITS.items()
    }
    for form, text in texts(source, tmp_path, **wide).items():
        assert told in text, form
        assert "u = min(max(v, umin), umax)" in text, form
        assert "0.25" in text, form
        assert "the states go on as if nothing had been cut off" in text, form


@pytest.mark.parametrize("form", ["json", "mat"])
def test_limits_are_read_back_with_the_sign(tmp_path, form):
    for make, told in SOURCES.values():
        source = make()
        if synth.system(source.controller if isinstance(source, Design) else source).ny > 1:
            continue
        found = read(export(source, form, tmp_path, **LIMITS, force=True)[0])
        assert found.convention == told
        np.testing.assert_array_equal([found.limited.umin, found.limited.umax], [[-0.5], [0.25]])


def test_a_gain_of_antiwindup_travels(tmp_path):
    design = synth.ncfsyn(G, 1.0)
    kept = AntiWindup.of(design, -0.5, 0.25)
    for form in ("json", "mat"):
        found = read(export(design, form, tmp_path, **LIMITS, antiwindup=kept.L)[0])
        np.testing.assert_array_equal(found.limited.L, kept.L)
        assert "the states learn of what was cut off" in export_text(tmp_path / f"controller.{form}")


def export_text(path) -> str:
    if path.suffix == ".json":
        return path.read_text()
    return str(scipy.io.loadmat(path, simplify_cells=True)["controller"]["limits"])


@pytest.mark.parametrize("name", ["four blocks", "loop shaping"])
def test_a_design_in_a_mat_file_is_the_whole_design(tmp_path, name):
    design = SOURCES[name][0]()
    for path in (export(design, "mat", tmp_path)[0], design.save(tmp_path / "saved.mat")):
        again = read(path)
        assert isinstance(again, Design)
        assert again.controller.digest() == design.controller.digest()
        assert again.plant.system.digest() == design.plant.system.digest()
        assert (again.gamma, again.convention) == (design.gamma, design.convention)


def test_a_mat_file_that_was_changed_is_refused(tmp_path):
    design = SOURCES["four blocks"][0]()
    path = export(design, "mat", tmp_path)[0]
    content = scipy.io.loadmat(path)
    content["design"]["K"][0, 0]["A"][0, 0][0, 0] *= 1.001
    scipy.io.savemat(path, {"design": content["design"]})
    with pytest.raises(ModelError, match=r"design\.K\.A is not the one in design\.json"):
        read(path)
    content = scipy.io.loadmat(export(design, "mat", tmp_path, force=True)[0])
    content["design"]["json"][0, 0] = np.array([str(content["design"]["json"][0, 0][0]).replace("gamma", "gamna", 1)])
    scipy.io.savemat(path, {"design": content["design"]})
    with pytest.raises(ModelError):
        read(path)
    scipy.io.savemat(path, {"controller": {"A": 1.0, "json": "nonsense"}})
    with pytest.raises(ModelError, match="it is no JSON"):
        read(path)


@pytest.mark.parametrize("keys", [("A", "B", "C", "D", "dt"), ("a", "b", "c", "d", "Ts")])
def test_a_struct_with_the_fields_of_ss_is_a_system(tmp_path, keys):
    path = tmp_path / "x.mat"
    fields = dict(zip(keys, (*K.matrices, K.dt), strict=True))
    scipy.io.savemat(path, {"G": {**fields, "StateName": "x"}})
    assert read(path).system.digest() == K.digest()
    scipy.io.savemat(path, {"G": {**fields, "E": np.eye(1)}})
    assert read(path).system.digest() == K.digest()
    scipy.io.savemat(path, {"G": {**fields, "e": 2 * np.eye(1)}})
    with pytest.raises(ModelError, match="descriptor matrix E"):
        read(path)
    scipy.io.savemat(path, {"G": fields, "H": fields})
    with pytest.raises(ModelError, match="several systems, G, H"):
        read(path)
    scipy.io.savemat(path, {"G": {**fields, keys[0]: "text"}})
    with pytest.raises(ModelError, match="A is no real matrix"):
        read(path)


def told(capsys, *arguments: str) -> tuple[int, str]:
    from synth.__main__ import main

    code = main(list(arguments))
    out, err = capsys.readouterr()
    return code, out + err


def test_commands_take_mat_files(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    design = SOURCES["four blocks"][0]()
    design.save("a.mat"), design.save("a.json")
    code, text = told(capsys, "info", "a.mat")
    assert (code, f"convention         {ERROR}" in text) == (0, True)
    assert told(capsys, "verify", "a.mat") == (0, told(capsys, "verify", "a.json")[1].replace("a.json", "a.mat"))
    assert told(capsys, "compare", "a.mat", "a.json")[0] == 0
    assert told(capsys, "export", "a.mat", "--format", "c", "-o", "out")[0] == 0
    assert (tmp_path / "out" / "controller.h").exists()
    assert told(capsys, "export", "a.mat", "--format", "json", "-o", "out", "--umin=-1", "--umax=1")[0] == 0
    assert json.loads((tmp_path / "out" / "controller.json").read_text())["convention"] == ERROR
    code, text = told(capsys, "info", "out/controller.json")
    assert (code, "measurements       error angle" in text, "umin               -1.0" in text) == (0, True, True)


def test_a_unit_is_judged_with_its_lag(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    design = SOURCES["four blocks"][0]()
    found = synth.accept(design, form="fmu")
    lag = next(c for c in found.conditions if c.name == "co-simulation unit")
    assert lag.norm == pytest.approx(synth.hinfnorm(lagging(design.plant).close(design.controller))[0], rel=1e-6)
    assert lag.norm == pytest.approx(
        next(c for c in synth.accept(design).conditions if "delay" in c.name).norm, rel=1e-6
    )
    late, now = (synth.accept(design, form=form).margins for form in ("fmu", "controller"))
    assert late.delay == pytest.approx(now.delay - design.plant.dt, rel=1e-6)
    design.save("a.json")
    assert "co-simulation unit" in told(capsys, "verify", "a.json", "--as", "fmu")[1]
    with pytest.raises(ModelError, match="form is 'dll'"):
        synth.accept(design, form="dll")


def test_a_loop_that_bears_no_lag_fails_as_a_unit():
    """x+ = x + u, u = -1.9 x is stable; a sample later it is not."""
    P = synth.gang_of_four(StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    gain = StateSpace.gain([[-1.9]], 0.1)
    loose = synth.Requirements(disk_margin=None, delay_margin_samples=None)
    named = {c.name: c for c in synth.accept(gain, P, form="fmu", requirements=loose).conditions}
    assert named["designed"].stable
    assert named["co-simulation unit"].stable is False
    assert "co-simulation unit" in synth.accept(gain, P, form="fmu", requirements=loose).verdict
