"""The table of faults in docs/faults.md: every row names tests that exist; and the rows that are about surroundings."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TABLE = (ROOT / "docs" / "faults.md").read_text()
ROWS = [line.split("|")[1:-1] for line in TABLE.splitlines() if line.startswith("|")]
WORK = """
import numpy as np
from synth import GeneralizedPlant, StateSpace, hinfsyn
plant = GeneralizedPlant.four_block(StateSpace([[-1.0]], [[1]], [[1]], [[0]]), Wdist=1, Wnoise=1, Wout=1, Wact=1)
design = hinfsyn(plant)
"""
OLD = '{"old": 1}'


def run(code, folder, *, without=(), **environment):
    """(exit code, what it said) of a Python process that does the work and then `code`, in a folder."""
    known = {name: value for name, value in os.environ.items() if name not in without}
    known |= {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])} | environment
    done = subprocess.run(
        [sys.executable, "-c", WORK + code], cwd=folder, env=known, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout + done.stderr


def test_every_row_has_tests_that_exist():
    """Named as file::function; and each row says what happens and what is seen."""
    assert len(ROWS) > 20
    for row in ROWS[2:]:
        assert len(row) == 4, row
        assert all(cell.strip() for cell in row), row
        named = re.findall(r"`([\w/]+\.py)::(\w+)`", row[3])
        assert named, f"no test: {row}"
        for file, function in named:
            tree = ast.parse((ROOT / "tests" / file).read_text())
            assert function in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (file, function)


@pytest.mark.skipif(os.name != "posix", reason="signals and limits of POSIX")
@pytest.mark.parametrize(
    ("fault", "code", "message"),
    [
        ("killed before the rename", "os.replace = lambda *_: os.kill(os.getpid(), 9)", ""),
        (
            "an exception at the rename",
            "def os_replace(*_): raise OSError(5, 'I/O error')\nos.replace = os_replace",
            "I/O",
        ),
        (
            "a full disk",
            "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
            "resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))",
            "File too large",
        ),
    ],
)
def test_a_write_that_is_interrupted_leaves_the_old_file(tmp_path, fault, code, message):
    (tmp_path / "d.json").write_text(OLD)
    returned, said = run(f"import os\n{code}\ndesign.save('d.json')", tmp_path)
    assert returned != 0
    assert message in said
    assert (tmp_path / "d.json").read_text() == OLD
    left = [path.name for path in tmp_path.iterdir()]
    assert left == ["d.json"] or "killed" in fault, "only a process that is killed cannot clean up"


def test_neither_home_nor_temporary_folder_nor_compiler_is_needed(tmp_path):
    nowhere = str(tmp_path / "nowhere")
    code = (
        "from synth import LinearController, c2d, export\n"
        "design.save('d.json')\n"
        "print(export(LinearController.of(c2d(-design.controller, 0.1)), 'c', 'out', name='k'))"
    )
    returned, said = run(code, tmp_path, without=("HOME", "TMPDIR", "XDG_CACHE_HOME"), PATH=nowhere, HOME=nowhere)
    assert returned == 0, said
    assert (tmp_path / "out" / "k.c").is_file()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_is_read_only_is_named(tmp_path):
    (tmp_path / "closed").mkdir(mode=0o500)
    returned, said = run("design.save('closed/d.json')", tmp_path)
    assert returned != 0
    assert "closed" in said


def test_a_folder_that_is_none_is_named(tmp_path):
    (tmp_path / "file").write_text(OLD)
    returned, said = run("design.save('file/d.json')", tmp_path)
    assert returned != 0
    assert "file" in said.splitlines()[-1]


def test_a_screen_of_ascii_shows_every_design(tmp_path):
    code = (
        "import dataclasses, sys\n"
        "plant = dataclasses.replace(plant, units={'u0': '\\u00b5N'})\n"
        "hinfsyn(plant).save('d.json')\n"
        "from synth.__main__ import main\n"
        "sys.exit(main(['info', 'd.json']))"
    )
    returned, said = run(code, tmp_path, PYTHONIOENCODING="ascii", LC_ALL="C", PYTHONUTF8="0")
    assert returned == 0, said


@pytest.mark.parametrize("missing", ["cvxpy", "clarabel"])
def test_without_a_solver_the_equations_answer(tmp_path, missing):
    """And the methods that need it say so by their error."""
    code = (
        f"import sys; sys.modules[{missing!r}] = None\n"
        "assert hinfsyn(plant).info.method == 'riccati'\n"
        "from synth import NumericalError\n"
        "try:\n    hinfsyn(plant, method='lmi')\n"
        "except NumericalError as error:\n    print(error)\nelse:\n    sys.exit('no error')"
    )
    returned, said = run(code, tmp_path)
    assert returned == 0, said
    assert missing in said.lower()


@pytest.mark.parametrize(("missing", "door"), [("daqp", "mpc"), ("highspy", "fuel_mpc")])
def test_a_solver_that_is_not_installed_is_named(tmp_path, missing, door):
    returned, said = run(f"import sys; sys.modules[{missing!r}] = None\nfrom synth import {door}", tmp_path)
    assert returned == 1
    assert re.search(rf"(ImportError|ModuleNotFoundError).*{missing}", said)
