"""A Dask cluster of this machine, started by the commands of docs/campaigns.md: workers and scheduler are killed."""

import json
import sys
from contextlib import ExitStack

import pytest
from dispersed import fly, sample
from processes import started, until

from plants.errors import EngineError
from plants.simulation import campaign, engines, versions

pytest.importorskip("distributed", reason="Dask is not installed")

RUNS = 96


def fly_all(**options):
    return fly(campaign.draw(sample, RUNS, 5), batch=8, **options)


def equal(one, other):
    assert one.complete
    assert one.index.tolist() == list(range(RUNS))
    assert one.errors == other.errors == {}
    for name in ("last", "rows"):
        assert one.results[name].tobytes() == other.results[name].tobytes()
    assert one.ok.tobytes() == other.ok.tobytes()


@pytest.fixture
def cluster(tmp_path):
    """Starts a scheduler and workers; gives the address, the scheduler and a function that starts a worker."""
    file = tmp_path / "scheduler.json"
    options = ("--no-dashboard", "--host", "127.0.0.1")
    with ExitStack() as stack:
        command = ("-m", "dask", "scheduler", "--port", "0", "--scheduler-file", file, *options)
        scheduler = stack.enter_context(started(*command))
        until(lambda: file.exists() and file.stat().st_size, "the scheduler")
        address = json.loads(file.read_text())["address"]

        def worker(threads=1):
            command = ("-m", "dask", "worker", address, "--no-nanny", "--nthreads", threads, *options)
            return stack.enter_context(started(*command, cwd=tmp_path))

        yield address, scheduler, worker


@pytest.mark.slow
def test_a_cluster_flies_the_same_whoever_of_its_workers_is_killed(cluster):
    address, _, worker = cluster
    workers = [worker(), worker(2)]

    def kill(done):
        if len(workers) == 2:
            workers.pop().kill()  # while it flies
        elif len(workers) == 1 and done > 40:
            workers.pop().kill()  # the last
            worker(2)
            worker()

    equal(fly_all(scheduler=address, on_batch=kill), fly_all())
    assert not workers


@pytest.mark.slow
def test_a_scheduler_that_goes_away_leaves_what_was_flown(cluster, tmp_path, monkeypatch):
    address, scheduler, worker = cluster
    monkeypatch.setattr(engines, "PATIENCE", 60.0)
    worker()

    def kill(done):
        if done >= 24:
            scheduler.kill()

    with pytest.raises(EngineError, match=r"was lost: what was flown by then is in the store; start .* and resume"):
        fly_all(scheduler=address, store=tmp_path / "s", on_batch=kill)
    counted = []
    equal(fly_all(store=tmp_path / "s", resume=True, on_batch=counted.append), fly_all())
    assert counted[0] > 24


@pytest.mark.slow
def test_clusters_that_cannot_do_it_are_told(cluster, monkeypatch):
    address, _, worker = cluster
    monkeypatch.setattr(engines, "PATIENCE", 2.0)
    with pytest.raises(EngineError, match=f"has no worker after 2 s: start one with `dask worker {address}`"):
        fly_all(scheduler=address)
    monkeypatch.setattr(engines, "PATIENCE", 120.0)
    worker()
    ours = versions.of_packages()
    monkeypatch.setattr(versions, "of_packages", lambda: {**ours, "jax": "0.0.1"})
    with pytest.raises(EngineError, match=r"has jax .*, this machine 0\.0\.1: results would differ; install the same"):
        fly_all(scheduler=address)


def test_the_package_may_be_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(EngineError, match=r"needs Dask: pip install 'convex-synth\[dask\]'"):
        fly_all(scheduler="tcp://127.0.0.1:1")
