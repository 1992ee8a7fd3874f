"""docs/colleague.md: every block on the page runs, and all of a controller give the same commands."""

import contextlib
import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

PAGE = (Path(__file__).parents[3] / "docs" / "colleague.md").read_text()


def blocks(language: str) -> list[str]:
    """The code of one language on the page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def printed(program: str) -> str:
    """What a block in Python prints."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        exec(program, {})
    return out.getvalue()


def numbers(text: str) -> np.ndarray:
    """All numbers of a print of an array."""
    return np.array([float(n) for n in re.findall(r"-?\d+\.?\d*(?:e[+-]?\d+)?", text)])


@pytest.fixture(scope="module")
def handed(tmp_path_factory):
    """The files, and the commands that the first block in Python finds."""
    if shutil.which("gcc") is None:
        pytest.skip("an FMU holds a binary: gcc is not installed")
    folder = tmp_path_factory.mktemp("colleague")
    with contextlib.chdir(folder):
        printed(blocks("python")[0])
        convention, _, rest = printed(blocks("python")[1]).partition("\n")
    assert convention.startswith("e = r - y, u = K e")
    commands = numbers(rest)
    assert commands.shape == (5,)
    return folder, commands


def test_octave_finds_the_same_commands(handed):
    folder, commands = handed
    program = shutil.which("octave-cli")
    if program is None:
        pytest.skip("Octave is the oracle of this test and is not installed")
    command = [program, "--quiet", "--no-init-file", "--eval", blocks("octave")[0]]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if "package control" in done.stderr or "'control'" in done.stderr:
        pytest.skip("Octave's control package is the oracle of this test and is not installed")
    assert done.returncode == 0, done.stderr
    convention, *values = done.stdout.split("\n")
    assert convention.startswith("e = r - y, u = K e")
    np.testing.assert_allclose([float(v) for v in values if v], commands, rtol=1e-7)


def compiled(number: int, folder: Path) -> np.ndarray:
    """What a block in C prints, compiled as the page says: the commands, none of them a fault."""
    (folder / "main.c").write_text(blocks("c")[number])
    line = re.findall(r"`cc (.*?)`", PAGE)[number]
    subprocess.run(["gcc", *line.split(), "-o", "main"], cwd=folder, check=True)
    rows = subprocess.run([folder / "main"], capture_output=True, text=True, check=True).stdout.split()
    assert rows[1::2] == ["0"] * 5
    return np.array(rows[::2], float)


def test_c_finds_the_same_commands_within_the_limits(handed):
    folder, commands = handed
    assert np.abs(commands).max() > 0.01  # so that the limits act
    np.testing.assert_allclose(compiled(0, folder), commands.clip(-0.01, 0.01), rtol=1e-7)


def test_a_predictive_controller_has_the_same_commands_in_c(handed):
    folder, _ = handed
    with contextlib.chdir(folder):
        commands = numbers(printed(blocks("python")[3]))
    assert commands.shape == (5,)
    assert np.abs(commands).max() > 0.01 * (1 - 1e-9) > 0.0099 > np.abs(commands).min()  # limited, and not
    np.testing.assert_allclose(compiled(1, folder), commands, rtol=0, atol=1e-9 * 0.01)


def test_the_unit_finds_the_same_commands_within_the_limits(handed):
    pytest.importorskip("fmpy", reason="fmpy is the oracle of this test and is not installed")
    folder, commands = handed
    with contextlib.chdir(folder):
        found = numbers(printed(blocks("python")[2]))
    np.testing.assert_allclose(found, commands.clip(-0.01, 0.01), rtol=1e-6)
