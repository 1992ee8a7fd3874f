"""The front door of `plants`: complete, and cheap to open."""

import importlib
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import plants


@pytest.mark.parametrize("name", plants.__all__)
def test_every_public_name_is_what_its_module_defines(name):
    home = importlib.import_module(f"plants.{plants._HOME[name]}")
    value = getattr(plants, name)
    assert value is (home if isinstance(value, ModuleType) else getattr(home, name))


def test_type_checkers_see_the_same_names():
    declared = {
        line.split(" as ")[1]
        for line in Path(plants.__file__).with_suffix(".pyi").read_text().splitlines()
        if " as " in line
    }
    assert declared == set(plants.__all__)


def test_no_module_hides_a_name():
    for name in plants.__all__:
        with pytest.raises(ModuleNotFoundError):
            importlib.import_module(f"plants.{name}")


def test_unknown_names_are_attribute_errors():
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        plants.simulat  # noqa: B018
    assert "simulate" in dir(plants)
    assert "simulate" in plants.__doc__


def test_import_is_lazy():
    code = "import plants, sys; print([m for m in ('jax', 'numpy', 'matplotlib') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
