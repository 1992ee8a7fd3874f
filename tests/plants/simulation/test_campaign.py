"""Campaigns: independent of batches and workers, applied dispersions, bounded batches, interruption, bad input."""

from dataclasses import replace

import numpy as np
import pytest
from dispersed import Damper, Draw, HostDamper, case, fly, last, read, sample
from flown import Pendulum

from plants.errors import ScenarioError
from plants.simulation import campaign, simulate

ROUNDING = 1e-12  # a run alone, or stepped from Python, may be added up in another order


@pytest.fixture(scope="module")
def reference():
    return fly(batch=23, workers=1)


@pytest.mark.parametrize("options", [{"batch": 1}, {"batch": 5}, {"batch": 7, "workers": 3}, {"batch": 200}, {}])
def test_not_a_bit_depends_on_batches_and_workers(reference, options):
    result = fly(**options)
    np.testing.assert_array_equal(result.index, np.arange(23))
    np.testing.assert_array_equal(result.results["last"], reference.results["last"])
    assert result.varied == reference.varied == ("[0].plant.length", "[1].initial.angle")


def test_run_does_not_depend_on_the_number_of_runs_and_can_be_flown_again(reference):
    few = fly(campaign.draw(sample, 4, 5))
    np.testing.assert_array_equal(few.results["last"], reference.results["last"][:4])
    replayed = campaign.replay(case, reference.dispersed, 17, Damper(1.0))
    np.testing.assert_array_equal(replayed.estimates[-1], reference.results["last"][17])
    again = simulate.simulate(*campaign.replay_case(case, reference.dispersed, 17, Damper(1.0)))
    np.testing.assert_allclose(again.estimates[-1], reference.results["last"][17], rtol=0, atol=ROUNDING)
    other = fly(campaign.draw(sample, 4, 5), seed=1)
    assert np.abs(other.results["last"] - few.results["last"]).max() > 1e-3


def test_noise_differs_between_runs_that_are_otherwise_equal():
    same = Draw(length=np.array([1.0, 1.0]), angle=np.array([0.5, 0.5]))
    result = fly(same)
    assert np.abs(np.diff(result.results["last"], axis=0)).max() > 1e-3
    assert result.varied == ()


def test_batches_of_one_campaign_compile_once():
    simulate._fly.clear_cache()
    fly(batch=6)
    assert simulate._fly._cache_size() == 1


def test_campaigns_share_a_program_that_gives_every_number_a_lane(reference):
    """Runs that are all alike fly the program of those that are not, and do not count as varied."""
    simulate._fly.clear_cache()
    fly()
    same = Draw(length=np.full(23, 1.1), angle=np.full(23, 0.5))
    shared = fly(same, varying=reference.varied)
    assert simulate._fly._cache_size() == 1
    assert shared.varied == ()
    np.testing.assert_allclose(shared.results["last"], fly(same).results["last"], rtol=0, atol=ROUNDING)
    replayed = campaign.replay(case, same, 17, Damper(1.0), varying=reference.varied)
    np.testing.assert_array_equal(replayed.estimates[-1], shared.results["last"][17])
    with pytest.raises(ScenarioError, match=r"varying: no number '\[0\].plant.mass' .* such as '\[0\]"):
        fly(same, varying=["[0].plant.mass"])


def test_a_stepped_controller_is_asked_for_flights_that_count_only():
    """Lanes that fill up a batch take the last command."""
    asked = []

    class Counted(HostDamper):
        def step(self, state, y, r):
            asked.append(1)
            return super().step(state, y, r)

    result = fly(campaign.draw(sample, 3, 5), controller=Counted(1.0))
    steps = len(asked)
    fly(campaign.draw(sample, 3, 5), controller=Counted(1.0), compiled=False)
    assert len(asked) - steps <= 3 * 80 + 8  # and a few while shapes are found out
    np.testing.assert_array_equal(result.index, np.arange(3))


def test_stepped_controllers_give_the_same(reference):
    result = fly(controller=HostDamper(1.0), batch=12)
    np.testing.assert_allclose(result.results["last"], reference.results["last"], rtol=0, atol=ROUNDING)


def test_dispersions_are_read_back_from_what_flew():
    result = fly(read=read)
    np.testing.assert_array_equal(result.applied.length, result.dispersed.length)
    np.testing.assert_array_equal(result.applied.angle, result.dispersed.angle)


def test_a_dispersion_that_is_not_applied_is_an_error():
    def forgets(d, controller):
        loop, scenario = case(d, controller)
        return replace(loop, plant=Pendulum(1.0)), scenario

    def ignores(d, controller):
        return case(Draw(1.0, 0.5), controller)

    dispersed = campaign.draw(sample, 5, 0)
    with pytest.raises(ScenarioError, match=r"dispersed\.length was not applied in run 0"):
        campaign.campaign(forgets, dispersed, Damper(1.0), measure=last, read=read, progress=False, workers=1)
    with pytest.raises(ScenarioError, match="no number of loop or scenario varies"):
        campaign.campaign(ignores, dispersed, Damper(1.0), measure=last, progress=False)


def test_interruption_keeps_what_is_done(reference):
    def press(done):
        if done >= 10:
            raise KeyboardInterrupt

    result = fly(batch=5, workers=1, on_batch=press)
    assert not result.complete
    np.testing.assert_array_equal(result.index, np.arange(10))
    np.testing.assert_array_equal(result.results["last"], reference.results["last"][:10])
    np.testing.assert_array_equal(result.dispersed.length, reference.dispersed.length[:10])
    assert "INTERRUPTED" in str(result)
    assert reference.complete


def test_failed_runs_are_marked_and_the_others_go_on(reference):
    dispersed = campaign.draw(sample, 23, 5)

    def wild(d, controller):
        return case(d, Damper(-1e3 if d.angle > 0.5 else 1.0))

    result = campaign.campaign(wild, dispersed, measure=last, progress=False)
    bad = dispersed.angle > 0.5
    assert 0 < bad.sum() < 23
    np.testing.assert_array_equal(result.ok, ~bad)
    np.testing.assert_array_equal(result.culprit == "plant", bad)
    assert (result.failed_at[bad] < 2).all()
    assert np.isnan(result.failed_at[~bad]).all()
    np.testing.assert_allclose(result.results["last"][~bad], reference.results["last"][~bad], rtol=0, atol=ROUNDING)
    assert f"plant {bad.sum()}" in str(result)


def test_trajectories_are_kept_on_request_only(reference):
    assert reference.kept == {}
    result = fly(keep=(3, 20))
    assert sorted(result.kept) == [3, 20]
    np.testing.assert_array_equal(result.kept[20].estimates[-1], result.results["last"][20])
    assert result.kept[3].outputs.base is None


def test_memory_bounds_the_batch(monkeypatch):
    """Two workers, their rows in four copies: so much holds sixteen runs of 5 kB each; the least is eight of one."""
    widths = []
    fly_many = simulate.simulate_many

    def watched(cases, **options):
        widths.append(options["lanes"])
        return fly_many(cases, **options)

    monkeypatch.setattr(simulate, "simulate_many", watched)
    dispersed = campaign.draw(sample, 23, 5)
    loop, scenario = campaign.replay_case(case, dispersed, 0, Damper(1.0))
    per_run = simulate.row_bytes(loop, scenario)
    assert per_run == 80 * 8 * (2 + 2 + 2 + 1 + 1)  # state, output, estimate, command, input
    fly(dispersed, memory=2 * 16 * 4 * per_run, workers=2)
    assert set(widths) == {16}
    widths.clear()
    fly(dispersed, memory=8 * 4 * per_run, workers=2)
    assert set(widths) == {8}
    with pytest.raises(ScenarioError, match=r"memory = \d+: 8 runs of 5120 bytes .* keep fewer rows"):
        fly(dispersed, memory=8 * 4 * per_run - 1)


@pytest.mark.parametrize(
    ("message", "dispersed", "options"),
    [
        ("leading lengths", Draw(np.zeros(0), np.zeros(0)), {}),
        ("leading lengths", Draw(np.ones(3), np.ones(4)), {}),
        ("leading lengths", Draw(1.0, 0.5), {}),
        ("dispersed.length", Draw(np.array([1.0, np.nan]), np.ones(2)), {}),
        ("batch = 0", None, {"batch": 0}),
        ("workers = 0", None, {"workers": 0}),
        ("memory = 0.5", None, {"memory": 0.5}),
    ],
)
def test_bad_input_is_named(message, dispersed, options):
    with pytest.raises(ScenarioError, match=message):
        fly(dispersed, **options)


def test_bad_case_names_the_run():
    def refuses(d, controller):
        if d.angle > 0.5:
            raise ScenarioError("angle is too large")
        return case(d, controller)

    with pytest.raises(ScenarioError, match=r"run \d+: angle is too large"):
        campaign.campaign(refuses, campaign.draw(sample, 23, 5), Damper(1.0), measure=last, progress=False)


@pytest.mark.parametrize("runs", [0, -1, 2.5])
def test_draw_needs_runs(runs):
    with pytest.raises(ScenarioError, match="runs ="):
        campaign.draw(sample, runs, 0)
