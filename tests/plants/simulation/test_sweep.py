"""Sweeps of functions over grids: order, errors, store, engines, bad grids."""

import numpy as np
import pytest

from plants.errors import ScenarioError, StoreError
from plants.simulation.store import Store
from plants.simulation.sweep import sweep

GRID = {"weight": [1.0, 10.0, 100.0], "order": [1, 2], "method": ["lmi", "riccati"]}


def design(weight, order, method):
    if order == 2 and weight == 10.0:
        raise ValueError("no design for this one")
    return {"gamma": weight / order, "margins": np.array([weight, order]), "slow": method == "lmi"}


@pytest.fixture(scope="module")
def reference():
    return sweep(design, GRID, processes=False, progress=False)


def test_all_points_in_order(reference):
    assert reference.shape == (3, 2, 2)
    assert reference.complete
    np.testing.assert_array_equal(reference.points["weight"], [1, 1, 1, 1, 10, 10, 100, 100, 100, 100])
    np.testing.assert_array_equal(reference.results["gamma"], reference.points["weight"] / reference.points["order"])
    np.testing.assert_array_equal(reference.results["slow"], reference.points["method"] == "lmi")
    assert list(reference.errors) == [6, 7]
    grid = reference.on_grid(reference.results["gamma"])
    assert grid.shape == (3, 2, 2)
    assert np.isnan(grid[1, 1]).all()
    np.testing.assert_array_equal(grid[2], [[100, 100], [50, 50]])
    assert "10 points of 3 x 2 x 2 (complete)\npoint 6 ended in ValueError: no design for this one" in str(reference)


@pytest.mark.parametrize("options", [{"processes": False, "workers": 3}, {"workers": 2}])
def test_engines_and_stores_give_the_same(reference, tmp_path, options):
    first = sweep(design, GRID, store=tmp_path, progress=False, **options)
    again = sweep(design, GRID, store=tmp_path, resume=True, progress=False, **options)
    for found in (first, again):
        np.testing.assert_array_equal(found.index, reference.index)
        np.testing.assert_array_equal(found.results["margins"], reference.results["margins"])
        assert list(found.errors) == [6, 7]
    table = Store(tmp_path).table().to_pandas()
    assert table["dispersed.method"].tolist()[:2] == ["lmi", "riccati"]
    with pytest.raises(StoreError, match="another grid"):
        sweep(design, {**GRID, "weight": [1.0, 10.0, 99.0]}, store=tmp_path, resume=True, progress=False)


@pytest.mark.parametrize(
    ("message", "grid"),
    [
        ("give names and their values", {}),
        ("give names and their values", [1, 2]),
        (r"grid\['a'\] = \[\]: give a list of at least one", {"a": []}),
        (r"grid\['a'\] = 3: give a list", {"a": 3}),
        (r"grid\['a'\] = \[nan\]: give finite numbers", {"a": [np.nan]}),
        (r"grid\['a'\] = .* give a list of at least one number", {"a": [1j]}),
    ],
)
def test_bad_grids_are_named(message, grid):
    with pytest.raises(ScenarioError, match=message):
        sweep(design, grid, progress=False)


def test_a_mistake_at_every_point_is_raised_at_once():
    with pytest.raises(ScenarioError, match=r"(?s)every one of the first 2 runs.*missing 2 required"):
        sweep(design, {"weight": [1.0, 2.0]}, processes=False, progress=False)
