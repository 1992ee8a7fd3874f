"""Campaigns with results and dispersions of every kind, stored, interrupted, resumed: as if nothing had been."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest
from dispersed import Damper, Draw, case

from plants.errors import ScenarioError
from plants.simulation import campaign
from plants.simulation.store import Store

RUNS = 12


@dataclass(frozen=True)
class Bent:
    """A dispersion with parts, tables and numbers that nobody uses."""

    draw: Draw
    table: np.ndarray  # (2, 3)
    more: tuple


@dataclass(frozen=True)
class Found:
    """What was measured."""

    angle: float
    table: np.ndarray


def sample(seed, index):
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    return Bent(Draw(rng.uniform(0.5, 2), rng.uniform(-1, 1)), rng.normal(size=(2, 3)), (rng.normal(), 0.0))


def built(d, controller):
    return case(d.draw, controller)


def all_kinds(run):
    angle = float(run.states.angle[-1])
    return {
        "found": Found(angle, run.outputs[-3:]),
        "integer": int(angle * 1e9),
        "sometimes": 0 if run.states.angle[0] > 0 else angle,  # whole numbers in some chunks
        "truth": angle > 0,
        "truths": np.array([angle > 0, True]),
        "small": np.int8(3),
        "text": "left" if angle < 0 else "to the right",
        "texts": np.array(["a", "bc"]),
        "complex": angle * 1j,
        "roots": np.array([[angle, 1j]]),
        "empty": np.zeros((0, 3)),
        "nothing": np.array([np.nan, np.inf, -np.inf, -0.0]),
    }


def fly(**options):
    drawn = campaign.draw(sample, RUNS, 5)
    return campaign.campaign(built, drawn, Damper(1.0), measure=all_kinds, progress=False, **options)


def alike(one, other):
    assert jax.tree.structure(one.results) == jax.tree.structure(other.results)
    for a, b in zip(jax.tree.leaves(one.results), jax.tree.leaves(other.results), strict=True):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert a.tobytes() == b.tobytes()
    for a, b in zip(jax.tree.leaves(one.dispersed), jax.tree.leaves(other.dispersed), strict=True):
        assert a.tobytes() == b.tobytes()


def test_whatever_measure_returns_is_kept(tmp_path):
    def press(done):
        if done >= 4:
            raise KeyboardInterrupt

    assert not fly(store=tmp_path, batch=1, workers=1, on_batch=press).complete
    flown = fly()
    alike(fly(store=tmp_path, resume=True, batch=3), flown)
    alike(fly(store=tmp_path, resume=True), flown)
    columns = Store(tmp_path).columns()
    np.testing.assert_array_equal(columns["results.roots"], flown.results["roots"])
    np.testing.assert_array_equal(columns["dispersed.table"], flown.dispersed.table)
    np.testing.assert_array_equal(columns["dispersed.draw.length"], flown.dispersed.draw.length)


def test_a_campaign_of_one_run(tmp_path):
    drawn = campaign.draw(sample, 1, 5)
    options = {"measure": lambda run: run.outputs[-1, 0], "store": tmp_path, "progress": False}
    one = campaign.campaign(built, drawn, Damper(1.0), **options)
    again = campaign.campaign(built, drawn, Damper(1.0), resume=True, **options)
    assert one.results.tobytes() == again.results.tobytes()
    assert one.results.shape == (1,)


@pytest.mark.parametrize("odd", [b"bytes", np.datetime64("2026-01-01"), {}, object()])
def test_what_is_no_number_is_the_failure_of_its_runs(odd):
    with pytest.raises(ScenarioError, match="measure returned"):
        campaign.campaign(built, campaign.draw(sample, RUNS, 5), Damper(1.0), measure=lambda run: odd, progress=False)


def test_text_in_some_runs_and_numbers_in_others_is_no_result():
    flown = campaign.campaign(
        built, campaign.draw(sample, RUNS, 5), Damper(1.0), progress=False,
        measure=lambda run: "no" if run.states.angle[0] > 0 else 1.0,
    )  # fmt: skip
    assert 0 < len(flown.errors) < RUNS
    assert all("return one form" in text for text in flown.errors.values())
