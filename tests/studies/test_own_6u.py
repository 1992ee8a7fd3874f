"""The newcomer's examples as a user runs them: sixty lines to a report and C, and a mission in modes."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples" / "own_6u"
DEG = np.pi / 180


def ran(name, out, *options):
    done = subprocess.run(
        [sys.executable, EXAMPLES / name, "--out", out, *options], capture_output=True, text=True, check=False,
        env={**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": str(EXAMPLES.parents[1])},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_sixty_lines():
    assert len((EXAMPLES / "own_6u.py").read_text().splitlines()) <= 60


@pytest.mark.slow
def test_thirty_flights_a_report_and_code(tmp_path):
    told = ran("own_6u.py", tmp_path)
    assert told.count("%, met") == 2
    page = (tmp_path / "report.html").read_text()
    assert "MPC: error in 95% of 30 flights" in page
    assert "0 of 30" in page
    assert [path.suffix for path in sorted((tmp_path / "code").iterdir())].count(".c") >= 1


@pytest.mark.slow
def test_detumbling_nadir_target_and_dumping_over_three_orbits(tmp_path):
    """Must show of the mission: one run, every mode reached, pointing kept, momentum within bounds."""
    told = ran("mission.py", tmp_path)
    assert [line.split("s  ")[1] for line in told.splitlines()[:4]] == ["detumbling", "nadir", "target", "nadir again"]
    table = pq.read_table(tmp_path / "mission.parquet")
    assert table.num_rows == 17031
    error = np.column_stack([table[f"extra.error.{i}"] for i in range(3)])
    mode = np.asarray(table["extra.mode"])
    angle = 2 * np.linalg.norm(error, axis=1)
    for index, settling in ((1, 1200), (3, 1200)):
        inside = np.flatnonzero(mode == index)[settling:]
        assert np.quantile(angle[inside], 0.95) < 0.1 * DEG
    on_target = np.flatnonzero(mode == 2)
    assert angle[on_target[-60:]].max() < 0.2 * DEG
    speeds = np.column_stack([table[name] for name in table.column_names if name.startswith("wheel")])
    assert np.abs(speeds).max() < 100  # rad/s, of 628


def test_examples_import_nothing_but_what_is_public():
    for path in EXAMPLES.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                assert node.module.split(".")[0] not in ("plants", "synth") or "." not in node.module
