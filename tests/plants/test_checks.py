"""What may enter a plant, and what may not."""

import jax
import numpy as np
import pytest

from plants.checks import positive, real, whole
from plants.errors import ScenarioError


def test_numbers_come_back_as_float64_arrays():
    for value in (2, 2.0, np.float32(2), [2], np.array([True])):
        got = real("size", value, np.shape(value))
        assert isinstance(got, np.ndarray)
        assert got.dtype == np.float64
    limit = real("limit", np.inf, infinite=True)
    assert limit == np.inf


def test_tracers_pass_if_they_are_of_the_right_shape_and_precision():
    with jax.enable_x64(True):
        assert jax.jit(lambda v: real("v", v, (3,), low=0))(-np.ones(3)).sum() == -3  # values cannot be checked
        with pytest.raises(ScenarioError, match="v must have shape"):
            jax.jit(lambda v: real("v", v, (2,)))(np.ones(3))
        with pytest.raises(ScenarioError, match="v is traced as float32"):
            jax.jit(lambda v: real("v", v, (3,)))(np.ones(3, np.float32))


@pytest.mark.parametrize(
    ("value", "options", "message"),
    [
        ("north", {}, "gain must be real numbers"),
        (None, {}, "gain must be real numbers"),
        (1j, {}, "gain must be real numbers"),
        ([[1.0], [1.0, 2.0]], {"shape": (2, None)}, "gain must be real numbers"),
        ([1.0, 2.0], {}, r"gain must have shape \(\), got \(2,\)"),
        ([1.0, 2.0], {"shape": (None, 3)}, "gain must have shape"),
        (np.nan, {}, "gain must be finite"),
        (np.nan, {"infinite": True}, "gain must be finite"),
        (np.inf, {}, "gain must be finite"),
        (-np.inf, {"infinite": True}, "gain must be finite"),
        (-1.0, {"low": 0}, "gain must be at least 0"),
    ],
)
def test_the_rest_is_refused_by_name(value, options, message):
    with pytest.raises(ScenarioError, match=message):
        real("gain", value, **options)


def test_positive_numbers():
    assert positive("mass", 2) == 2
    assert positive("limit", np.inf, infinite=True) == np.inf
    for value in (0.0, -1.0):
        with pytest.raises(ScenarioError, match=f"mass must be positive, got {value}"):
            positive("mass", value)
    with pytest.raises(ScenarioError, match=r"noise must be positive, got \[1.0, 0.0\]"):
        positive("noise", [1.0, 0.0], (2,))
    with pytest.raises(ScenarioError, match="mass must be finite"):
        positive("mass", np.nan)


def test_parts_that_fit_are_counted():
    assert whole("duration", 1800.0, 0.05, "periods") == 36000
    assert whole("duration", 0.3, 0.1, "periods") == 3


@pytest.mark.parametrize("value", [0.12, 0.04, 0.0, -0.05, np.nan])
def test_parts_that_do_not_fit_are_refused(value):
    with pytest.raises(ScenarioError, match="duration"):
        whole("duration", value, 0.05, "periods")
