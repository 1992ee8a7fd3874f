"""Every public controller class in every format: it leaves, or a typed error says why not and what to do instead."""

import importlib
import inspect
import pkgutil
import shutil
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import plants
import synth
from plants.guidance.sequences import SequenceController
from plants.missions.geo import Coast
from synth.__main__ import main
from synth.delivery.formats import FORMATS, export
from synth.delivery.leaving import ALL, OWN, TABLE, row_of
from synth.delivery.modelfiles import save_system
from synth.errors import ExportError
from synth.regulators.fixed import FixedController
from synth.regulators.quaternion import QuaternionPid

DT = 0.5
J = np.diag([2.0, 3.0, 4.0])
K = synth.StateSpace([[0.5]], [[1.0]], [[0.3]], [[0.1]], DT)
LINEAR = synth.LinearController.of(K)
HELD = synth.StateSpace([[0.9]], [[0.1]], [[1.0]], [[0.0]], DT)


def sdre(kind: Any) -> Any:
    return kind.create(synth.MrpModel.create(J), DT)


EXAMPLES = {
    synth.LinearController: lambda: LINEAR,
    synth.AntiWindup: lambda: synth.AntiWindup(*K.matrices, *map(np.array, ([[0.5]], [-1.0], [1.0])), DT),
    synth.SequentialController: lambda: synth.SequentialController.of(K),
    FixedController: lambda: FixedController.of(K, "q15", np.ones(1)),
    QuaternionPid: lambda: synth.quaternion_pd(J, 0.1, 0.7, DT),
    synth.Sdre: lambda: sdre(synth.Sdre),
    synth.SdreSampled: lambda: sdre(synth.SdreSampled),
    synth.SdreHinf: lambda: sdre(synth.SdreHinf),
    synth.SdreHinfStatic: lambda: sdre(synth.SdreHinfStatic),
    synth.SdreHinfPaperLiteral: lambda: sdre(synth.SdreHinfPaperLiteral),
    synth.Mpc: lambda: synth.mpc(HELD, Q=1.0, R=1.0, Np=4, Nc=2, umin=-1.0, umax=1.0),
    synth.FuelMpc: lambda: bare(synth.FuelMpc),
    Coast: lambda: Coast(dt=DT),
    plants.AttitudeControl: lambda: plants.AttitudeControl(controller=LINEAR),
    plants.Detumbling: lambda: plants.Detumbling.create(1e-3, limit=0.1),
    SequenceController: lambda: SequenceController(laws=(), dt=DT, blend=1.0, nu=3),
}


def bare(kind: Any) -> Any:
    """An object of a class whose program need not be posed for this."""
    return object.__new__(kind)


def controller_classes() -> set[type]:
    """All classes of both packages with a step and a first state that are no protocol and not private."""
    found = set()
    for package in (synth, plants):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.rpartition(".")[2] == "__main__":
                continue
            for name, kind in vars(importlib.import_module(module.name)).items():
                own = inspect.isclass(kind) and kind.__module__ == module.name and not name.startswith("_")
                steps = own and all(callable(getattr(kind, step, None)) for step in ("init", "step"))
                if steps and not getattr(kind, "_is_protocol", False):
                    found.add(kind)
    return found


def test_the_table_and_the_examples_hold_every_controller_class():
    found = controller_classes()
    assert {f"{kind.__module__}.{kind.__qualname__}" for kind in found} == set(TABLE)
    assert found == set(EXAMPLES)
    assert ALL == FORMATS


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("kind", EXAMPLES, ids=lambda kind: kind.__name__)
def test_every_class_in_every_format(kind, format, tmp_path):
    """What leaves leaves files; what does not is told with its class, the format, the reason and the remedy."""
    controller = EXAMPLES[kind]()
    row = row_of(controller)
    assert row is not None
    assert type(controller) is kind
    if format in row.formats:
        if format.startswith("fmu") and shutil.which("gcc") is None:
            pytest.skip("an FMU holds a binary: gcc is not installed")
        if kind.__module__ == synth.Sdre.__module__:
            pytest.skip("compiling its solver takes long; test_export_sdre.py does it")
        assert all(path.stat().st_size for path in export(controller, format, tmp_path))
        return
    with pytest.raises(ExportError) as caught:
        export(controller, format, tmp_path)
    told = str(caught.value)
    assert told == f"{kind.__name__} does not leave as {format}: {row.why}; {row.remedy}"
    assert row.why
    assert row.remedy
    assert not list(tmp_path.iterdir())


def test_remedies_name_what_there_is():
    """Every capitalised name and every dotted path in a remedy is a name of a package or a field of the class."""
    for path, row in {**TABLE, "own": OWN}.items():
        for word in row.remedy.replace(",", " ").replace(";", " ").replace("(", " ").split():
            if word.startswith("synth."):
                module, _, name = word.rpartition(".")
                assert hasattr(importlib.import_module(module), name), (path, word)
            elif word[0].isupper() and word[1:].islower() and any(letter.isupper() for letter in word[1:]):
                assert hasattr(synth, word) or hasattr(plants, word), (path, word)
    for word in ("quaternion_lqr", "minimum_fuel", "state_feedback", "StateSpace", "SdreHinfStatic", "ncfsyn"):
        assert hasattr(synth, word)
    assert hasattr(plants, "CrossProductDumping")
    assert {"Kp", "Ki", "Kd", "zone", "dt"} == set(QuaternionPid.__dataclass_fields__)


@dataclass(frozen=True)
class Mine:
    """A controller as anybody writes one."""

    dt: float = DT

    def init(self) -> tuple[()]:
        return ()

    def step(self, state: Any, y: Any, r: Any) -> Any:
        return state, r - y


class Bent(synth.LinearController):
    """One that leaves, with a step of its own."""

    def step(self, state: Any, y: Any, r: Any) -> Any:
        state, u = super().step(state, y, r)
        return state, np.sign(u)


class Renamed(synth.LinearController):
    """One that leaves, under another name."""


@pytest.mark.parametrize("format", FORMATS)
def test_own_controllers_are_told_apart(format, tmp_path):
    """A class of one's own does not leave, nor does a step put over one that does; another name does not matter."""
    with pytest.raises(ExportError, match=rf"^Mine does not leave as {format}: it is a controller of your own.*write"):
        export(Mine(), format, tmp_path)
    bent = Bent(K.A, K.B, K.C, K.D, DT)
    with pytest.raises(ExportError, match=rf"^Bent does not leave as {format}: its class has a step of its own"):
        export(bent, format, tmp_path)
    assert not list(tmp_path.iterdir())
    if not format.startswith("fmu"):
        assert export(Renamed(K.A, K.B, K.C, K.D, DT), format, tmp_path)


def test_a_system_file_and_the_command_line_say_it_too(tmp_path, capsys):
    """`save_system` of what is no system, and `synth export` of a program."""
    with pytest.raises(ExportError, match="Mine does not leave as json"):
        save_system(tmp_path / "mine.json", Mine())  # pyright: ignore[reportArgumentType]
    with pytest.raises(ExportError, match="QuaternionPid does not leave as json"):
        save_system(tmp_path / "pid.json", synth.quaternion_pd(J, 0.1, 0.7, DT))  # pyright: ignore[reportArgumentType]
    (tmp_path / "law.py").write_text("import synth\n")
    assert main(["export", str(tmp_path / "law.py"), "--format", "c", "-o", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert "Sdre, leaves from there: synth.export(controller, 'c', folder)" in " ".join(told.split())
    assert [path.name for path in tmp_path.iterdir()] == ["law.py"]


def test_what_is_no_controller_goes_its_way(tmp_path):
    """Systems, tuples and objects with matrices are read as linear systems, as before."""
    for source in (K, K.to_control(), (K.A, K.B, K.C, K.D, DT)):
        assert row_of(source) is None
        assert export(source, "c", tmp_path, force=True)
