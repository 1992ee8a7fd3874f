"""The programs in the README run as printed."""

import re
from pathlib import Path

import pytest

README = Path(__file__).parent.parent / "README.md"


PROGRAMS = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def run(program: str) -> dict:
    names: dict = {}
    exec(compile(program, "README.md", "exec"), names)
    return names


def test_five_line_program(capsys):
    program = PROGRAMS[0]
    assert sum(bool(line.strip()) for line in program.splitlines()) <= 5
    names = run(program)
    assert "verified norm" in capsys.readouterr().out
    # Skogestad and Postlethwaite (2005), example 2.11: gamma = 1.37
    assert names["design"].verified_norm == pytest.approx(1.37, abs=0.01)


def test_twelve_line_program(tmp_path, monkeypatch, capsys):
    program = PROGRAMS[1]
    assert sum(bool(line.strip()) for line in program.splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    names = run(program)
    assert "verified norm" in capsys.readouterr().out
    assert (tmp_path / "controller.json").exists()
    assert names["design"].verified_norm <= 1.01 * names["gamma"]


def test_readme_opens_with_both_commands():
    head = README.read_text().splitlines()[:8]
    assert any("make demo" in line for line in head)
    assert any("make test" in line for line in head)
