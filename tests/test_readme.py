"""The program in the README runs as printed."""

import re
from pathlib import Path

README = Path(__file__).parent.parent / "README.md"


def test_twelve_line_program(tmp_path, monkeypatch, capsys):
    program = re.search(r"```python\n(.*?)```", README.read_text(), re.DOTALL).group(1)
    assert sum(bool(line.strip()) for line in program.splitlines()) <= 12
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(program, "README.md", "exec"), names)
    assert "verified norm" in capsys.readouterr().out
    assert (tmp_path / "controller.json").exists()
    assert names["design"].verified_norm <= 1.01 * names["gamma"]


def test_readme_opens_with_both_commands():
    head = README.read_text().splitlines()[:8]
    assert any("make demo" in line for line in head)
    assert any("make test" in line for line in head)
