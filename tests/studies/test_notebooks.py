"""Notebooks are percent scripts: each is a notebook, and runs from its first cell to its last."""

import ast
from pathlib import Path

import jupytext
import matplotlib as mpl
import matplotlib.pyplot as plt
import nbformat
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "examples").glob("*/notebook.py"))
NAMES = [path.parent.name for path in NOTEBOOKS]


def run(source: str, names: dict) -> object:
    """Run a cell; what the notebook shows, the value of its last line."""
    tree, last = ast.parse(source), None
    if tree.body and isinstance(tree.body[-1], ast.Expr):
        last = ast.Expression(tree.body.pop().value)
    exec(compile(tree, "cell", "exec"), names)
    return None if last is None else eval(compile(last, "cell", "eval"), names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=NAMES)
def test_percent_script_is_a_notebook(path):
    notebook = jupytext.read(path, fmt="py:percent")
    again = nbformat.reads(jupytext.writes(notebook, fmt="ipynb"), as_version=4)
    nbformat.validate(again)
    kinds = [cell.cell_type for cell in again.cells]
    assert kinds[0] == "markdown"
    assert again.cells[0].source.startswith("# ")
    assert kinds.count("markdown") >= 5
    assert [cell.source for cell in again.cells] == [cell.source for cell in notebook.cells]
    back = jupytext.reads(jupytext.writes(again, fmt="py:percent"), fmt="py:percent")
    assert [(c.cell_type, c.source) for c in back.cells] == [(c.cell_type, c.source) for c in notebook.cells]
    for name in ("plants", "synth"):
        assert any(f"from {name}" in cell.source for cell in again.cells)


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=NAMES)
def test_every_cell_runs(path, capsys):
    mpl.use("Agg")
    names, pictures = {"__name__": "__main__"}, 0
    for cell in jupytext.read(path, fmt="py:percent").cells:
        if cell.cell_type != "code":
            continue
        shown = run(cell.source, names)
        readable = shown is None or (not isinstance(shown, tuple | list) and " object at 0x" not in repr(shown))
        assert readable, f"{shown!r} is nothing to look at: assign it to _"
        pictures += sum(bool(ax.lines) for number in plt.get_fignums() for ax in plt.figure(number).axes)
        plt.close("all")
    assert pictures >= 5
    assert len(capsys.readouterr().out.splitlines()) >= 10  # tables


def test_notebooks_are_there():
    assert {"airbearing", "amazonia1", "cubesat3u"} <= set(NAMES)
