"""Co-simulation units: valid by fmpy's judgement, and stepped bit for bit like the Python that verified them."""

import io
import shutil
import subprocess
import tempfile
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import STRICT, closed_loop_inputs, gcc, plain_loop, plain_loop_with_faults
from exportedunit import Unit
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from literature import cubesat_pecorilla2024

from synth.delivery import fmu
from synth.delivery.formats import export
from synth.errors import ExportError
from synth.regulators.sequential import SequentialController
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.statespace import StateSpace

LIMITS = {"umin": -3e-4, "umax": 3e-4}  # N m
WRAPPER = ("-Wno-unused-parameter",)  # the standard fixes the signatures


@pytest.fixture(scope="module")
def fmpy():
    """The oracle: an importer of FMUs."""
    return pytest.importorskip("fmpy", reason="fmpy is the oracle of this test and is not installed")


@pytest.fixture(scope="module")
def design() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


@pytest.fixture(autouse=True)
def compiler():
    if shutil.which("gcc") is None:
        pytest.skip("an FMU holds a binary: gcc is not installed")


def validate(path: Path) -> list[str]:
    """What fmpy finds wrong with the description, its names, its structure and its units."""
    from fmpy.validation import validate_fmu

    return validate_fmu(str(path))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("dtype", ["double", "float"])
def test_cubesat_closed_loop_is_stepped_bit_for_bit(fmpy, design, tmp_path, version, dtype):
    """2000 samples: u of sample k is seen after the step from k dt to (k + 1) dt; once more after a reset."""
    (path,) = export(design, f"fmu{version}", tmp_path, name="attitude", dtype=dtype, **LIMITS)
    assert validate(path) == []
    controller = SequentialController.of(design, dtype=dtype, **LIMITS)
    inputs = closed_loop_inputs(controller, 2000)
    expected = plain_loop(controller, inputs).astype(float)
    unit = Unit(fmpy, path, tmp_path / "unzipped")
    for run in (inputs, inputs[:50]):
        unit.start()
        assert unit.get() == [0.0, 0.0, 0.0]
        found = []
        for k, y in enumerate(run):
            unit.set(y)
            unit.step(k * 0.5, 0.5)
            found.append(unit.get())
        assert np.array(found).tobytes() == expected[: len(run)].tobytes()
        unit.fmu.reset()
    unit.close()


@pytest.mark.parametrize("version", [2, 3])
def test_rows_of_a_simulation_lag_by_one_sample(fmpy, design, tmp_path, version):
    """fmpy's own master: the first row holds the outputs before the first sample."""
    (path,) = export(design, f"fmu{version}", tmp_path, name="attitude")
    controller, rng = SequentialController.of(design), np.random.default_rng(1)
    inputs = rng.normal(size=(40, 6))
    names = [*design.plant.y]
    signal = np.zeros(40, dtype=[("time", float), *((name, float) for name in names)])
    signal["time"] = 0.5 * np.arange(40)
    for name, column in zip(names, inputs.T, strict=True):
        signal[name] = column
    rows = fmpy.simulate_fmu(str(path), stop_time=19.5, step_size=0.5, output_interval=0.5, input=signal)
    found = np.array([[row[name] for name in design.plant.u] for row in rows])
    assert not found[0].any()
    np.testing.assert_array_equal(found[1:], plain_loop(controller, inputs)[:-1])


@pytest.mark.parametrize("version", [2, 3])
def test_it_samples_by_itself_whatever_the_communication_step(fmpy, design, tmp_path, version):
    """Ten steps of 0.05 s or one of 1 s: a sample every 0.5 s, with the inputs set before the step that holds it."""
    (path,) = export(design, f"fmu{version}", tmp_path, name="attitude")
    controller = SequentialController.of(design)
    inputs = np.random.default_rng(2).normal(size=(20, 6))
    expected = plain_loop(controller, inputs)
    unit = Unit(fmpy, path, tmp_path / "unzipped")
    unit.start(time=3.0)
    for k, y in enumerate(inputs):
        for i in range(10):
            unit.set(y if i == 0 else np.full(6, 1e3))  # not sampled
            unit.step(3 + k * 0.5 + i * 0.05, 0.05)
            assert unit.get() == expected[k].tolist()
    unit.set(inputs[0])
    unit.step(13.0, 1.0)
    twice = np.vstack([inputs, inputs[0], inputs[0]])
    assert unit.get() == plain_loop(controller, twice)[-1].tolist()
    unit.close()


@pytest.mark.parametrize("version", [2, 3])
def test_wrong_calls_fail_and_say_why(fmpy, design, tmp_path, version, capfd):
    from fmpy.fmi1 import FMICallException

    (path,) = export(design, f"fmu{version}", tmp_path, name="attitude")
    unit = Unit(fmpy, path, tmp_path / "unzipped")
    unit.start()
    error = FMICallException
    with pytest.raises(error):
        unit.set([np.nan] * 6)
    with pytest.raises(error):
        unit.step(0.0, -0.5)
    inputs, unit.inputs = unit.inputs, unit.outputs
    with pytest.raises(error):
        unit.set([1.0, 2.0, 3.0])
    unit.inputs, unit.outputs = inputs, [99]
    with pytest.raises(error):
        unit.get()
    unit.close()
    with pytest.raises(Exception, match="instantiate"):
        Unit(fmpy, path, tmp_path / "again", token="{another}")


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("dtype", ["double", "float"])
def test_a_unit_holds_its_last_command_and_warns(fmpy, tmp_path, version, dtype):
    """Finite inputs that overflow inside: the outputs stay, the master is warned, the next sample goes on."""
    K = StateSpace([[0.5, 0.1], [0, 0.3]], [[1e3, 0], [1, -1]], [[1, 2], [0, 1]], np.zeros((2, 2)), 0.1)
    (path,) = export(K, f"fmu{version}", tmp_path, dtype=dtype, umin=0.25, umax=5)
    controller = SequentialController.of(K, dtype=dtype, umin=0.25, umax=5)
    inputs = np.array([[1e308, 0], [1, 2], [1.5e308, 0], [0, 0.5], [-1e307, 0], [1, 1], [1, 1]])
    expected, faults = plain_loop_with_faults(controller, inputs)
    assert faults.tolist() == [True, False, True, False, True, False, False]
    unit, answers = Unit(fmpy, path, tmp_path / "unzipped"), []
    function = "fmi2DoStep" if version == 2 else "fmi3DoStep"
    call = getattr(unit.fmu, function)
    setattr(unit.fmu, function, lambda *arguments: answers.append(call(*arguments)) or answers[-1])
    unit.start()
    found = []
    for k, y in enumerate(inputs):
        unit.set(y)
        unit.step(k * 0.1, 0.1)
        found.append(unit.get())
    unit.close()
    assert np.array(found).tobytes() == expected.astype(float).tobytes()
    assert answers == faults.astype(int).tolist()  # OK is 0, a warning 1


@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    n=st.integers(0, 6), p=st.integers(1, 3), m=st.integers(1, 3), seed=st.integers(0, 999), version=st.integers(2, 3)
)
def test_random_controllers(fmpy, tmp_path_factory, n, p, m, seed, version):
    """Any shape, also without states: valid and equal."""
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("fmu")
    A = rng.normal(size=(n, n))
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(initial=0), 0.9)
    K = StateSpace(A, rng.normal(size=(n, p)), rng.normal(size=(m, n)), rng.normal(size=(m, p)), 0.1)
    (path,) = export(K, f"fmu{version}", folder, umin=0.5, umax=2)
    assert validate(path) == []
    controller, inputs = SequentialController.of(K, umin=0.5, umax=2), rng.normal(size=(30, p))
    unit = Unit(fmpy, path, folder / "unzipped")
    unit.start()
    assert unit.get() == [0.5] * m  # zero would be outside the limits
    found = []
    for k, y in enumerate(inputs):
        unit.set(y)
        unit.step(k * 0.1, 0.1)
        found.append(unit.get())
    unit.close()
    assert np.array(found).tobytes() == plain_loop(controller, inputs).tobytes()


@pytest.mark.parametrize("version", [2, 3])
def test_the_same_design_gives_the_same_file(design, tmp_path, version):
    """Every byte, token included; another limit is another token."""
    first, second = (export(design, f"fmu{version}", tmp_path / str(i), **LIMITS)[0] for i in range(2))
    (other,) = export(design, f"fmu{version}", tmp_path / "other", umin=-4e-4, umax=4e-4)
    assert first.read_bytes() == second.read_bytes()
    texts = [zipfile.ZipFile(p).read("modelDescription.xml").decode() for p in (first, other)]
    assert texts[0] != texts[1]


@pytest.mark.parametrize("version", [2, 3])
def test_sources_are_complete_clean_and_licensed(design, tmp_path, version):
    """What the archive holds compiles alone, with every warning an error, and says where it comes from."""
    (path,) = export(design, f"fmu{version}", tmp_path, name="attitude", **LIMITS)
    content = path.read_bytes()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        archive.extractall(tmp_path / "unit")
        everything = b"".join(archive.read(name) for name in archive.namelist())
    sources = tmp_path / "unit" / "sources"
    for file in ("attitude.c", f"fmi{version}.c"):
        gcc(*STRICT, *(WRAPPER if file.startswith("fmi") else ()), "-c", sources / file, "-o", tmp_path / "x.o")
    description = (tmp_path / "unit" / "modelDescription.xml").read_text()
    assert design.plant.system.digest() in description
    assert repr(design.verified_norm) in description
    assert "BSD" in (tmp_path / "unit" / "documentation" / "licenses" / "license.txt").read_text()
    for private in (str(tmp_path), str(Path.home()), tempfile.gettempdir()):
        assert private.encode() not in everything


def test_refusals(design, tmp_path, monkeypatch):
    names = replace(design.plant, u=("a", "b", "error y0"))
    with pytest.raises(ExportError, match="error y0: an FMU has one variable per name"):
        export(replace(design, plant=names), "fmu2", tmp_path)
    monkeypatch.setattr(fmu.platform, "machine", lambda: "m68k")
    with pytest.raises(ExportError, match="FMI 3 has no name for Linux on m68k"):
        export(design, "fmu3", tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(fmu.shutil, "which", lambda _: None)
    with pytest.raises(ExportError, match=r"there is no C compiler.*install gcc"):
        export(design, "fmu2", tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(fmu.subprocess, "run", lambda *_, **__: subprocess.CompletedProcess([], 1, "", "cc1: broken"))
    with pytest.raises(ExportError, match="refused the FMU's sources: cc1: broken"):
        export(design, "fmu2", tmp_path)
    assert not list(tmp_path.iterdir())
