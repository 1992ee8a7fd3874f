"""Studies that are killed: what was flown is in --out, --resume flies the rest, and nothing else changes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import airbearing
import amazonia1
import amazonia1_region as region
import cubesat3u
import geo
import numpy as np
import pytest

from plants.errors import StoreError
from plants.simulation.store import Store, move_aside

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "amazonia1" / "amazonia1_region.py"
ARGUMENTS = ["--fast", "--runs", "8", "--period", "0.5"]


def start(out, *more):
    """The study in a process of its own; it keeps its programs for the next."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "CONVEX_SYNTH_CACHE": str(out.parent / "programs")}
    return subprocess.Popen(
        [sys.executable, str(SCRIPT), *ARGUMENTS, "--out", str(out), *more], env=environment, cwd=out.parent,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def struck(out, number):
    """What the study tells that gets a signal when one of its campaigns has been flown, and its exit code."""
    process, end = start(out), time.monotonic() + 240
    while not [*out.glob("runs/lqr/chunks/*.parquet")]:
        assert time.monotonic() < end, "nothing was flown in time"
        time.sleep(0.05)
    process.send_signal(number)
    told, _ = process.communicate(timeout=240)
    assert Store(out / "runs" / "lqr").index.tolist() == list(range(8))
    return told, process.returncode


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_study_that_is_told_to_end_reports_what_was_flown(tmp_path, number):
    if signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip("whoever started these tests has this signal ignored")
    told, code = struck(tmp_path / "out", number)
    assert code == 130
    assert "interrupted: the report holds what was flown" in told
    assert "INTERRUPTED" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.slow
def test_a_study_that_was_killed_is_resumed(tmp_path):
    out, fresh = tmp_path / "out", tmp_path / "fresh"
    assert struck(out, signal.SIGKILL)[1] == -signal.SIGKILL
    before = [*out.glob("runs/lqr/chunks/*.parquet")]
    told, _ = (resumed := start(out, "--resume")).communicate(timeout=480)
    assert resumed.returncode == 0, told
    assert [*out.glob("runs/lqr/chunks/*.parquet")] == before
    undisturbed = start(fresh)
    told, _ = undisturbed.communicate(timeout=480)
    assert undisturbed.returncode == 0, told
    with np.load(out / "region.npz") as one, np.load(fresh / "region.npz") as other:
        for name in other.files:
            np.testing.assert_array_equal(one[name], other[name])


def test_runs_of_an_earlier_start_are_moved_aside_not_removed(tmp_path):
    runs = tmp_path / "runs"
    assert move_aside(runs) is None
    with Store.writing(runs / "lqr", {"study": "s", "runs": 1, "seed": 0, "hashes": {}}, resume=False):
        with pytest.raises(StoreError, match="another process is flying into it"):
            move_aside(runs)
    assert move_aside(runs) == tmp_path / "runs.previous"
    assert Store(tmp_path / "runs.previous" / "lqr").manifest["study"] == "s"
    assert not runs.exists()


def test_options_of_the_command_line_reach_the_campaigns(tmp_path, capsys, monkeypatch):
    flown = []

    def fly(found, *_):
        flown.append(dict(found.flying))
        raise KeyboardInterrupt

    monkeypatch.setattr(region, "fly", fly)
    out = str(tmp_path)
    assert region.main([*ARGUMENTS, "--out", out, "--workers", "3"]) == 130
    assert flown[-1] == {"store": tmp_path / "runs", "workers": 3}
    (tmp_path / "runs").mkdir()
    assert region.main([*ARGUMENTS, "--out", out, "--scheduler", "tcp://127.0.0.1:8786"]) == 130
    assert flown[-1]["scheduler"] == "tcp://127.0.0.1:8786"
    assert "runs of an earlier start are in" in capsys.readouterr().out

    def refuse(found, *_):
        raise StoreError("store there: another process is flying into it")

    monkeypatch.setattr(region, "fly", refuse)
    with pytest.raises(SystemExit) as end:
        region.main([*ARGUMENTS, "--out", out, "--resume"])
    assert end.value.code == 2
    assert "error: store there" in capsys.readouterr().err


@pytest.mark.parametrize("module", [airbearing, amazonia1, region, cubesat3u, geo])
def test_a_study_that_is_stopped_before_its_first_flight_has_a_report(module, tmp_path, monkeypatch):
    def fly(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "fly", fly)
    assert module.main(["--fast", "--out", str(tmp_path)]) == 130
    assert "INTERRUPTED" in (tmp_path / "report.html").read_text()
