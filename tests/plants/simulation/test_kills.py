"""Processes, disks and clocks that end, fill and turn back: nothing lost, nothing doubled, a message that helps."""

import datetime
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from dispersed import fly, last
from flying import RUNS, fly_all
from processes import PATIENCE, lives, started, until, workers

from plants.errors import StoreError
from plants.simulation import conduct, store
from plants.simulation.store import Store

linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are found in /proc")
FLYING = Path(__file__).parents[2] / "flying.py"
BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "kills.py"


def chunks(folder, unfinished=False):
    return list(folder.glob("chunks/.*.partial" if unfinished else "chunks/*.parquet"))


def equal(one, other):
    for name in ("index", "ok", "failed_at", "culprit"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in one.results:
        np.testing.assert_array_equal(one.results[name], other.results[name])
    assert one.complete
    assert one.errors == other.errors
    for index, run in one.kept.items():
        np.testing.assert_array_equal(run.outputs, other.kept[index].outputs)


@linux
@pytest.mark.slow
def test_a_campaign_of_processes_survives_its_workers_and_itself(tmp_path):
    with started(FLYING, tmp_path, 0.05, "processes", stdout=subprocess.PIPE, text=True) as first:
        until(lambda: len(chunks(tmp_path)) >= 2, "a chunk")
        with pytest.raises(StoreError, match="another process is flying into it; wait for its end or give another"):
            fly_all(store=tmp_path, resume=True)
        hand = until(lambda: workers(first.pid), "a worker")[0]
        os.kill(hand, signal.SIGKILL)
        seen = len(chunks(tmp_path))
        until(lambda: len(chunks(tmp_path)) >= seen + 3, "a chunk after the kill")
        assert first.poll() is None
        hands = workers(first.pid)
        first.terminate()
        told, _ = first.communicate(timeout=PATIENCE)
        assert first.returncode == 143
        assert "interrupted: the finished runs are in" in told
        assert f"{len(Store(tmp_path).index)} flown" in told
        until(lambda: not any(map(lives, hands)), "the end of the workers")
    stored = set(Store(tmp_path).index)
    with started(FLYING, tmp_path, 0.02, "processes") as second:
        until(lambda: len(Store(tmp_path).index) > len(stored) and workers(second.pid), "another chunk")
        hands = workers(second.pid)
        second.kill()
        second.wait()
        until(lambda: not any(map(lives, hands)), "the end of orphans")
    now = Store(tmp_path)
    assert stored < set(now.index)
    assert len(now.index) < RUNS
    files = set(chunks(tmp_path))
    equal(fly_all(store=tmp_path, resume=True), fly_all())
    assert files <= set(chunks(tmp_path))


@linux
@pytest.mark.slow
def test_a_process_killed_while_it_writes(tmp_path):
    with started(FLYING, tmp_path, 0.0) as process:
        until(lambda: chunks(tmp_path) and chunks(tmp_path, unfinished=True), "a chunk being written")
        process.kill()
        process.wait()
    (tmp_path / "chunks" / ".old.0123.partial").write_bytes(b"what another killed writer left")
    equal(fly_all(store=tmp_path, resume=True), fly_all())
    assert not chunks(tmp_path, unfinished=True)


@linux
@pytest.mark.slow
def test_ten_kills_of_a_campaign():
    with started(BENCHMARK, "--kills", 10, "--runs", 800, stdout=subprocess.PIPE, text=True) as process:
        told, _ = process.communicate(timeout=4 * PATIENCE)
    assert process.returncode == 0, told
    assert "10 kills, 0 lost, 0 doubled" in told
    assert "0 runs otherwise than undisturbed, 0 chunks damaged" in told


@pytest.fixture
def disk(tmp_path):
    """A disk of its own, by the size in KiB, which can be remounted."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options):
        done = shutil.which("mount") and subprocess.run(
            ["mount", "-t", "tmpfs", "-o", options, "none", str(place)], capture_output=True
        )
        if not done or done.returncode:
            pytest.skip("only root may mount a small disk")
        return place

    yield mount
    if place.is_mount():
        subprocess.run(["umount", str(place)], check=True)


def large(run):
    """Noise of 16 kB, which cannot be compressed."""
    rng = np.random.default_rng(int(abs(run.states.angle[0]) * 1e9))
    return {**last(run), "noise": rng.normal(size=2000)}


def test_a_full_disk_keeps_what_is_on_it(disk):
    place = disk("size=256k")
    with pytest.raises(StoreError, match=r"cannot be written \(No space left on device\).*make room or give another"):
        fly(measure=large, store=place / "s", batch=4, workers=1)
    stored = Store(place / "s").index
    assert 0 < len(stored) < 23
    assert not chunks(place / "s", unfinished=True)
    subprocess.run(["mount", "-o", "remount,size=8m", str(place)], check=True)
    counted = []
    equal(fly(measure=large, store=place / "s", resume=True, batch=4, on_batch=counted.append), fly(measure=large))
    assert counted[0] > len(stored)


@pytest.fixture
def bound(tmp_path):
    """A folder of somebody who is bound by permissions, which root is not; nothing is imported meanwhile."""
    fly(store=tmp_path / "before", batch=4, workers=1)
    root = os.geteuid() == 0
    if root:
        os.seteuid(65534)
    place = Path(tempfile.mkdtemp())
    yield place
    if root:
        os.seteuid(0)
    shutil.rmtree(place)


@pytest.mark.skipif(not hasattr(os, "seteuid"), reason="permissions of POSIX")
def test_a_store_that_becomes_read_only(bound):
    def close(done):
        if done == 8:
            (bound / "chunks").chmod(0o555)

    with pytest.raises(StoreError, match=r"cannot be written \(Permission denied\).*then resume"):
        fly(store=bound, batch=4, workers=1, on_batch=close)
    assert Store(bound).index.tolist() == list(range(8))
    damaged = chunks(bound)[0]
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:100])
    with pytest.raises(StoreError, match=r"cannot be written \(Permission denied\)"):  # nor set aside
        fly(store=bound, resume=True)
    (bound / "chunks").chmod(0o755)
    equal(fly(store=bound, resume=True, batch=4), fly())


def test_nothing_depends_on_the_clock(tmp_path, monkeypatch):
    class Past(datetime.datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(1971, 1, 1, tzinfo=tz)

    def press(done):
        if done >= 8:
            raise KeyboardInterrupt

    fly(store=tmp_path, batch=4, workers=1, on_batch=press)
    for path in tmp_path.rglob("*"):
        os.utime(path, (4e9, 4e9))
    began = time.time()
    monkeypatch.setattr(store, "datetime", Past)
    monkeypatch.setattr(time, "time", lambda: began - 1e9)
    equal(fly(store=tmp_path, resume=True, batch=4), fly(store=tmp_path / "again", batch=4))
    assert Store(tmp_path / "again").manifest["made"].startswith("1971")


def test_a_signal_waits_for_the_batch_that_is_written(tmp_path, monkeypatch):
    """SIGTERM between the file and the list of finished runs: both have the batch."""
    write = Store.write

    def signalled(self, *arguments, **options):
        write(self, *arguments, **options)
        if len(chunks(tmp_path)) == 2:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGTERM)  # batch systems repeat themselves
            time.sleep(0.05)

    monkeypatch.setattr(Store, "write", signalled)
    flown = fly(store=tmp_path, batch=4, workers=1)
    assert not flown.complete
    assert flown.index.tolist() == Store(tmp_path).index.tolist() == list(range(8))


def test_a_signal_that_is_swallowed_is_told_again():
    """Python ignores exceptions of finalizers, also those that a signal raised there."""
    with conduct.terminable() as signals:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.05)
        except conduct.Terminated:
            pass
        with pytest.raises(conduct.Terminated), signals.later():
            pass


def test_one_run_that_fails_first_is_no_mistake_of_all():
    def first(run):
        if run.states.angle[0] == flown.dispersed.angle[0]:
            raise ValueError("the first")
        return last(run)

    flown = fly()
    result = fly(measure=first, batch=1, workers=1)
    assert list(result.errors) == [0]
    assert result.index.tolist() == list(range(1, 23))


def test_a_pipe_in_the_place_of_a_chunk_is_no_chunk(tmp_path):
    fly(store=tmp_path, batch=8)
    os.mkfifo(tmp_path / "chunks" / "000000000-000000001-0.parquet")
    with pytest.raises(StoreError, match=r"cannot be read \(it is no file\)"):
        fly(store=tmp_path, resume=True)
