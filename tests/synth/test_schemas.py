"""What files hold is declared once, tells all mistakes at once with their places, and costs nothing until needed."""

import json
import subprocess
import sys
from dataclasses import fields
from typing import get_args

import pytest
from literature import cubesat_pecorilla2024

from synth import mistakes, schemas
from synth.command import studyschemas
from synth.command.specification import PROBLEMS
from synth.delivery.acceptance import Requirements
from synth.delivery.modelfiles import read
from synth.errors import MOST, ModelError
from synth.files import sealed_by_parts
from synth.proof import certificateschemas
from synth.synthesis.design import Design, to_dict
from synth.synthesis.hinfinity import METHODS, hinfsyn
from synth.synthesis.info import Info
from synth.synthesis.loopshaping import METHODS as SHAPING_METHODS
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

DECLARED = [*vars(schemas).values(), *vars(certificateschemas).values()]
KINDS = [*dict.fromkeys(k for k in DECLARED if isinstance(k, type) and issubclass(k, mistakes.Record))]


@pytest.fixture(scope="module")
def design():
    return to_dict(hinfsyn(cubesat_pecorilla2024(), method="riccati"))


def test_the_fields_are_those_of_the_classes():
    for declared, built in ((schemas.Info, Info), (schemas.NamedPlant, GeneralizedPlant)):
        assert [*declared.model_fields] == [f.name for f in fields(built)]
    assert [*schemas.TimedSystem.model_fields] == [f.name for f in fields(StateSpace)][:5]
    assert {f.name for f in fields(Design)} - {"closed_loop"} <= {*schemas.Design.model_fields}


def test_the_choices_of_a_study_are_those_of_the_functions():
    def choices(kind, field):
        return get_args(kind.model_fields[field].annotation)

    assert choices(studyschemas.Synthesis, "method") == METHODS
    assert choices(studyschemas.ShapingSynthesis, "method") == SHAPING_METHODS
    assert choices(studyschemas.Synthesis, "problem") == PROBLEMS == (*studyschemas.SYNTHESIS,)
    assert {f.name for f in fields(Requirements)} <= {*studyschemas.Specifications.model_fields}


def test_all_mistakes_are_told_at_once_on_one_line(design, tmp_path):
    damaged = json.loads(json.dumps(design))
    damaged["controller"]["A"][1][0] = "x"
    damaged["plant"]["dt"] = -0.5
    damaged["plant"]["units"] = {"u0": 1}
    damaged["info"]["failurs"] = damaged["info"].pop("failures")
    damaged["gamma"] = None
    (tmp_path / "x.json").write_text(json.dumps(sealed_by_parts(damaged)))
    for reader in (read, Design.load):
        with pytest.raises(ModelError) as caught:
            reader(tmp_path / "x.json")
        told = str(caught.value)
        assert "\n" not in told
        for text in (
            "controller.A[1][0] is 'x'; a number belongs there",
            "plant.dt is -0.5; a number at least 0 belongs there",
            "plant.units.u0 is 1; text belongs there",
            "info.failures: missing",
            "info.failurs: unknown; did you mean 'failures'?",
            "gamma is None; a number belongs there",
        ):
            assert text in told


def test_very_many_mistakes_are_told_shortly(design, tmp_path):
    damaged = design | {f"key{i}": i for i in range(3 * MOST)}
    (tmp_path / "x.json").write_text(json.dumps(sealed_by_parts(damaged)))
    with pytest.raises(ModelError, match=f"and {2 * MOST} more mistakes$"):
        Design.load(tmp_path / "x.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delya": 0.5}, "delya: unknown; did you mean 'delay'"),
        ({"u": "force"}, "u is 'force'; a list belongs there"),
        ({"u": [7]}, r"u\[0\] is 7; text belongs there"),
        ({"dt": False}, "dt is False; a number belongs there"),
        ({"A": [[1, [2]]], "B": 1}, r"A\[0\]\[1\] is \[2\]; a number belongs there; B is 1; a list belongs there"),
    ],
)
def test_a_system_with_what_belongs_to_none(tmp_path, change, message):
    data = {"format": "convex-synth system", "format_version": 1, "dt": 1}
    data |= {"A": [[0]], "B": [[1]], "C": [[1]], "D": [[0]]}
    (tmp_path / "x.json").write_text(json.dumps(data))
    assert read(tmp_path / "x.json").system.n == 1
    (tmp_path / "x.json").write_text(json.dumps(data | change))
    with pytest.raises(ModelError, match=message):
        read(tmp_path / "x.json")


@pytest.mark.parametrize("place", ["controller", "plant"])
@pytest.mark.parametrize("value", ["x", 1, [], {}, [[[1.0]]], [[1.0], [1.0, 2.0]]])
def test_matrices_that_are_none(design, tmp_path, place, value):
    """Once each of these ended in an IndexError."""
    (tmp_path / "x.json").write_text(json.dumps(sealed_by_parts(design | {place: design[place] | {"A": value}})))
    with pytest.raises(ModelError, match=f"incomplete or damaged: {place}"):
        Design.load(tmp_path / "x.json")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("data", [None, 1, "x", [], [[]], {}, {"a": 1}, True, {"A": {}}, {"end": {"v": 1}}, 1e308])
def test_whatever_is_no_such_table_has_its_mistakes(kind, data):
    found = mistakes.mistakes(kind, data, "top")
    assert found or not any(field.is_required() for field in kind.model_fields.values())
    assert all(str(mistake).startswith("top") for mistake in found)


def test_the_validator_is_imported_late():
    code = "import sys\nfrom synth import hinfsyn, Design, export, system\n"
    code += "print({'pydantic', 'cryptography'} & {*sys.modules})"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "set()\n"
