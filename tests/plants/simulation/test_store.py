"""Campaigns that survive: the store, its refusals, exceptions of single runs, processes, replay."""

import json
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import filelock
import numpy as np
import pytest
from dispersed import Damper, HostDamper, case, fly, last, read, sample

from plants.errors import EngineError, ScenarioError, StoreError
from plants.simulation import campaign, engines, simulate
from plants.simulation.store import Store

RUNS = 23


def same(one, other):
    """Two campaigns to the last bit."""
    for name in ("index", "ok", "failed_at", "culprit"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("last", "rows"):
        np.testing.assert_array_equal(one.results[name], other.results[name])
    np.testing.assert_array_equal(one.dispersed.length, other.dispersed.length)
    assert one.errors == other.errors
    assert one.kept.keys() == other.kept.keys()
    for index in one.kept:
        for name in ("time", "outputs", "estimates", "commands", "inputs", "references"):
            np.testing.assert_array_equal(getattr(one.kept[index], name), getattr(other.kept[index], name))
        np.testing.assert_array_equal(one.kept[index].states.angle, other.kept[index].states.angle)
        assert one.kept[index].failed_at == other.kept[index].failed_at


def interrupted(folder, after, **options):
    """A campaign that ends after so many runs."""

    def press(done):
        if done >= after:
            raise KeyboardInterrupt

    return fly(store=folder, batch=4, workers=1, on_batch=press, **options)


@pytest.fixture(scope="module")
def reference():
    return fly(keep=(3, 20), read=read)


def test_a_store_holds_every_bit_and_is_a_table(reference, tmp_path):
    same(fly(store=tmp_path / "s", keep=(3, 20), read=read), reference)
    store = Store(tmp_path / "s")
    table = store.table().to_pandas()
    np.testing.assert_array_equal(table["dispersed.length"], reference.dispersed.length)
    np.testing.assert_array_equal(np.stack(table["results.last"]), reference.results["last"])
    np.testing.assert_array_equal(store.columns(["results.last"])["results.last"], reference.results["last"])
    assert store.kept == [3, 20]
    trajectory = store.trajectory(20).to_pandas()
    np.testing.assert_array_equal(trajectory["states.angle"], reference.kept[20].states.angle)
    assert "23 of 23" in repr(store)
    assert store.manifest["code"]["measure"].startswith("def last(run):")
    with pytest.raises(StoreError, match="no trajectory of run 4 is kept"):
        store.trajectory(4)


@pytest.mark.parametrize("again", [{}, {"batch": 5}, {"batch": 7, "workers": 3}])
def test_resumed_is_the_same_as_flown_at_once(reference, tmp_path, again):
    first = interrupted(tmp_path, 8, keep=(3, 20), read=read)
    assert not first.complete
    assert Store(tmp_path).index.tolist() == list(range(8))
    counted = []
    result = fly(store=tmp_path, resume=True, keep=(3, 20), read=read, on_batch=counted.append, **again)
    same(result, reference)
    assert counted[-1] == RUNS
    files = sorted(tmp_path.glob("chunks/*"))
    same(fly(store=tmp_path, resume=True, keep=(3, 20), read=read), reference)
    assert sorted(tmp_path.glob("chunks/*")) == files


def test_trajectories_asked_for_later_are_flown_again(reference, tmp_path):
    fly(store=tmp_path, read=read)
    same(fly(store=tmp_path, resume=True, keep=(3, 20), read=read), reference)


def test_a_store_is_not_continued_by_chance(tmp_path):
    interrupted(tmp_path, 8)
    with pytest.raises(StoreError, match=r"holds 8 of 23 runs of this study; resume=True"):
        fly(store=tmp_path)


def slower(run):
    return last(run)


@pytest.mark.parametrize(
    ("message", "changed"),
    [
        ("another controller ", {"controller": Damper(1.1)}),
        ("another seed ", {"seed": 3}),
        ("another measure ", {"measure": slower}),
        ("another read ", {"read": read}),
        ("another number of runs .*another dispersions", {"dispersed": campaign.draw(sample, 12, 5)}),
        ("another plant and scenario .*another dispersions", {"dispersed": campaign.draw(sample, 23, 6)}),
    ],
)
def test_a_store_of_another_study_is_refused(tmp_path, message, changed):
    interrupted(tmp_path, 8)
    with pytest.raises(StoreError, match=message):
        fly(store=tmp_path, resume=True, **changed)
    assert len(Store(tmp_path).index) == 8


def test_a_store_of_another_version_is_refused(tmp_path, monkeypatch):
    interrupted(tmp_path, 8)
    from plants.simulation import versions

    monkeypatch.setattr(versions, "of_packages", lambda: {"convex-synth": "0.0.1"})
    with pytest.raises(StoreError, match="another version of convex-synth"):
        fly(store=tmp_path, resume=True)


FACTOR = 1.0


def indirect(run):
    return {"last": FACTOR * run.estimates[-1], "rows": len(run.time)}


def test_what_no_hash_sees_is_seen_by_flying_a_run_again(tmp_path, monkeypatch):
    interrupted(tmp_path, 8, measure=indirect)
    monkeypatch.setitem(globals(), "FACTOR", 1.001)
    with pytest.raises(StoreError, match=r"run 0 comes out otherwise now \(results.last"):
        fly(store=tmp_path, resume=True, measure=indirect)


def ninth(run):
    if abs(run.states.angle[0] - ANGLE) < 1e-12:
        raise RuntimeError("this run went wrong")
    return last(run)


ANGLE = float(campaign.draw(sample, RUNS, 5).angle[9])


@pytest.mark.parametrize("options", [{}, {"batch": 1}, {"processes": True, "workers": 2, "batch": 8}])
def test_an_exception_is_the_failure_of_its_run(reference, tmp_path, options):
    result = fly(measure=ninth, store=tmp_path, **options)
    assert result.complete
    assert list(result.errors) == [9]
    assert "RuntimeError: this run went wrong" in result.errors[9]
    assert "in ninth" in result.errors[9]
    assert result.index.tolist() == [i for i in range(RUNS) if i != 9]
    np.testing.assert_array_equal(result.results["last"], np.delete(reference.results["last"], 9, axis=0))
    assert "ended in an exception: 1, the first run 9: RuntimeError: this run went wrong" in str(result)
    row = Store(tmp_path).table().to_pandas().iloc[9]
    assert row["culprit"] == "exception"
    assert row["results.last"] is None or np.isnan(row["results.last"]).all()
    assert row["error"].endswith("RuntimeError: this run went wrong\n")
    again = fly(measure=ninth, store=tmp_path, resume=True)
    assert again.errors == result.errors
    np.testing.assert_array_equal(again.results["last"], result.results["last"])


class Wild(HostDamper):
    """Raises in the flights that begin at one angle."""

    def step(self, s, y, r):
        if abs(float(y[0])) > 0.8:
            raise ArithmeticError(f"{float(y[0]):.2f} rad is too far")
        return super().step(s, y, r)


def test_an_exception_of_a_controller_or_case_is_the_failure_of_its_run():
    dispersed = campaign.draw(sample, RUNS, 5)

    def late(d, controller):
        if d.angle == dispersed.angle[17]:
            raise ValueError("no such case")
        return case(d, controller)

    plain = fly(controller=HostDamper(1.0))
    result = campaign.campaign(late, dispersed, Wild(1.0), measure=last, progress=False, batch=8)
    assert 17 in result.errors
    assert 1 < len(result.errors) < 12
    assert all("too far" in text or "no such case" in text for text in result.errors.values())
    rest = np.delete(np.arange(RUNS), [*result.errors])
    np.testing.assert_array_equal(result.index, rest)
    np.testing.assert_array_equal(result.results["last"], plain.results["last"][rest])


def changing(run):
    return {"last": np.zeros(2 if run.states.angle[0] > 0 else 3), "rows": 0}


def test_results_of_another_form_are_failures_of_their_runs():
    for options in ({"batch": 23}, {"batch": 1}):
        result = fly(measure=changing, **options)
        assert 0 < len(result.errors) < RUNS
        assert all("return one form" in text for text in result.errors.values())


def test_a_mistake_in_every_run_ends_the_campaign_at_once():
    with pytest.raises(ScenarioError, match=r"(?s)every one of the first \d+ runs .*; run 0:.*KeyError: 'absent'"):
        fly(measure=lambda run: {}["absent"])
    with pytest.raises(ScenarioError, match="measure returned NoneType"):
        fly(measure=lambda run: None)


def test_processes_fly_the_same(reference, tmp_path):
    factor = 1.0  # a closure, and a class of a test file, which no worker can import
    same(
        fly(
            processes=True, workers=2, batch=8, keep=(3, 20), read=read, measure=lambda run: last(run) if factor else 0
        ),
        reference,
    )


def killing(run):
    """Ends its process the first times that it is called."""
    marker = Path(os.environ["MARKER"])
    count = int(marker.read_text() or 0)
    if count < int(os.environ["KILLS"]):
        marker.write_text(str(count + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return last(run)


def test_a_killed_process_loses_nothing(reference, tmp_path, monkeypatch):
    marker = tmp_path / "marker"
    marker.write_text("")
    monkeypatch.setenv("MARKER", str(marker))
    monkeypatch.setenv("KILLS", "3")
    same(fly(processes=True, workers=2, batch=6, measure=killing, keep=(3, 20)), reference)
    assert marker.read_text() == "3"


def suicidal(run):
    if abs(run.states.angle[0] - ANGLE) < 1e-12:
        os.kill(os.getpid(), signal.SIGKILL)
    return last(run)


def test_a_run_that_ends_every_process_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(engines, "TRIES", 2)
    result = fly(processes=True, workers=2, batch=1, measure=suicidal, store=tmp_path)
    assert list(result.errors) == [9]
    assert "2 worker processes ended" in result.errors[9]
    assert 9 not in Store(tmp_path).index  # it is tried again by a resumed campaign


def test_damaged_chunks_are_set_aside_and_flown_again(reference, tmp_path):
    fly(store=tmp_path, batch=8, keep=(3, 20), read=read)
    chunks = sorted(tmp_path.glob("chunks/*.parquet"))
    chunks[1].write_bytes(chunks[1].read_bytes()[:-20])
    with pytest.raises(StoreError, match=r"damaged or changed .* resume: its runs are then flown again"):
        Store(tmp_path).table()
    same(fly(store=tmp_path, resume=True, keep=(3, 20), read=read), reference)
    assert len(list(tmp_path.glob("chunks/*.damaged"))) == 1


def test_nothing_is_counted_twice(tmp_path):
    fly(store=tmp_path, batch=8)
    first = sorted(tmp_path.glob("chunks/*.parquet"))[0]
    first.with_name(first.name.replace("000000000-", "000000001-")).write_bytes(first.read_bytes())
    with pytest.raises(StoreError, match="run 0 is in two chunks"):
        Store(tmp_path).table()
    with pytest.raises(StoreError, match="run 0 is in two chunks"):
        fly(store=tmp_path, resume=True)


def test_two_writers_are_one_too_many(tmp_path):
    interrupted(tmp_path, 8)
    with filelock.FileLock(tmp_path / "lock"), pytest.raises(StoreError, match="another process is flying into it"):
        fly(store=tmp_path, resume=True)
    fly(store=tmp_path, resume=True)


def test_chunks_of_another_store_are_refused(tmp_path):
    fly(store=tmp_path / "a", batch=8)
    fly(store=tmp_path / "b", batch=8, seed=1)
    stray = sorted((tmp_path / "b" / "chunks").glob("*.parquet"))[0]
    (tmp_path / "a" / "chunks" / stray.name).write_bytes(stray.read_bytes())
    with pytest.raises(StoreError, match="belongs to another store; remove it"):
        Store(tmp_path / "a").table()


def test_a_manifest_is_as_it_was_written_or_refused(tmp_path):
    fly(store=tmp_path)
    path = tmp_path / "manifest.json"
    whole = json.loads(path.read_text())
    for key, value in (("runs", 24), ("seed", 1), ("study", "other"), ("format", 2), ("hashes", {})):
        path.write_text(json.dumps({**whole, key: value}))
        with pytest.raises(StoreError, match="damaged or changed"):
            Store(tmp_path)
    for text in ("", "[]", "{", "[" * 100_000, "null", '{"sha256": 1}'):
        path.write_text(text)
        with pytest.raises(StoreError, match=r"damaged|cannot be read"):
            fly(store=tmp_path, resume=True)
    path.unlink()
    with pytest.raises(StoreError, match=r"chunks but no manifest\.json"):
        fly(store=tmp_path, resume=True)
    with pytest.raises(StoreError, match="is no manifest"):
        Store(tmp_path / "absent")


def test_a_place_that_cannot_be_written_is_told_before_flying(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="cannot be written"):
        fly(store=tmp_path / "file")
    with pytest.raises(StoreError, match="cannot be written"):
        fly(store="/proc/store")


def test_sigterm_leaves_what_was_flown(tmp_path):
    def end(done):
        if done == 8:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.1)

    before = signal.getsignal(signal.SIGTERM)
    result = fly(store=tmp_path, batch=4, workers=1, on_batch=end)
    assert not result.complete
    assert result.index.tolist() == list(range(8))
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_trajectory_with_the_memory_of_its_controller(tmp_path):
    """A failed run, one row per period and records of the sensors come back from the disk too."""

    def wild(d, controller):
        loop, scenario = case(d, Damper(-1e3 if d.angle > 0.5 else 1.0))
        return loop, replace(scenario, keep_every=4)

    dispersed = campaign.draw(sample, RUNS, 5)
    options = {"measure": lambda run: len(run.time), "record": recorded, "keep": range(RUNS), "progress": False}
    flown = campaign.campaign(wild, dispersed, store=tmp_path, **options)
    stored = campaign.campaign(wild, dispersed, store=tmp_path, resume=True, **options)
    assert (flown.culprit == "plant").any()
    for index, run in flown.kept.items():
        other = stored.kept[index]
        np.testing.assert_array_equal(run.extra["energy"], other.extra["energy"])
        np.testing.assert_array_equal(run.time, other.time)
        assert (run.ok, run.failed_at, run.culprit, run.compiled) == (
            other.ok,
            other.failed_at,
            other.culprit,
            other.compiled,
        )
        assert run.memory == other.memory == ()


def recorded(x, env, sensors, navigator):
    return {"energy": x.rate**2 / 2}


def test_a_cluster_that_does_not_answer_is_named(monkeypatch):
    pytest.importorskip("distributed", reason="Dask is not installed")
    monkeypatch.setattr(engines, "PATIENCE", 1.0)
    with pytest.raises(EngineError, match="does not answer: start one with `dask scheduler`"):
        fly(scheduler="tcp://127.0.0.1:1")
    with pytest.raises(ScenarioError, match="give one of them"):
        fly(scheduler="tcp://127.0.0.1:1", processes=True)
    with pytest.raises(ScenarioError, match=r"workers = 1\.5"):
        fly(workers=1.5)


def test_simulate_alone_is_equal_to_rounding(reference):
    alone = simulate.simulate(*campaign.replay_case(case, reference.dispersed, 20, Damper(1.0)))
    beside = campaign.replay(case, reference.dispersed, 20, Damper(1.0))
    np.testing.assert_allclose(alone.outputs, beside.outputs, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(beside.outputs, reference.kept[20].outputs)
    with pytest.raises(ScenarioError, match="index = 23"):
        campaign.replay(case, reference.dispersed, 23, Damper(1.0))
