"""The package's front door: complete, and cheap to open."""

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import synth


@pytest.mark.parametrize("name", synth.__all__)
def test_every_public_name_is_what_its_module_defines(name):
    home = importlib.import_module(f"synth.{synth._HOME[name]}")
    assert getattr(synth, name) is getattr(home, name)
    assert getattr(synth, name).__doc__


def test_type_checkers_see_the_same_names():
    declared = {line.split(" as ")[1] for line in Path(synth.__file__).read_text().splitlines() if " as " in line}
    assert declared == set(synth.__all__)


def test_no_module_hides_a_function_of_its_own_name():
    for name in synth.__all__:
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(f"synth.{name}")


def test_examples_in_docstrings_are_true():
    finder = doctest.DocTestFinder(recurse=False)
    tests = [test for name in synth.__all__ for test in finder.find(getattr(synth, name), name) if test.examples]
    assert len(tests) >= 2
    for test in tests:
        assert doctest.DocTestRunner().run(test).failed == 0, test.name


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'hinfsin'"):
        synth.hinfsin  # noqa: B018
    assert "hinfsyn" in dir(synth)


def test_import_is_lazy():
    code = "import synth, sys; print([m for m in ('jax', 'cvxpy', 'control', 'matplotlib') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
    code = "from synth import StateSpace, c2d, hinfnorm, hinfsyn; import sys; print({'jax', 'cvxpy'} & {*sys.modules})"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "set()"
