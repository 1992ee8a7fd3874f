"""A generalised plant as plain data, with the continuous one that it was sampled from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from synth.analysis.sampleddata import is_sample
from synth.errors import ModelError
from synth.systems.generalized import GeneralizedPlant

BETWEEN = ("continuous", "delay", "held")  # of a plant, about what is between its samples


def to_dict(P: GeneralizedPlant) -> dict[str, Any]:
    """Matrices, timebase, names and units; the continuous plant if it is still the one that was sampled."""
    values = {f.name: getattr(P, f.name) for f in fields(P) if f.name not in BETWEEN}
    data = {key: value.tolist() if isinstance(value, np.ndarray) else _plain(value) for key, value in values.items()}
    if P.continuous is None or not is_sample(P, P.continuous):
        return data
    own = {"delay": P.delay} if P.delay else {}
    return data | {"continuous": to_dict(P.continuous)} | own | ({"held": list(P.held)} if P.held else {})


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def of_samples(data: Mapping[str, Any]) -> GeneralizedPlant:
    """The plant without what is between its samples."""
    return GeneralizedPlant(**{key: value for key, value in data.items() if key not in BETWEEN})


def from_dict(data: Mapping[str, Any]) -> GeneralizedPlant:
    """The inverse of `to_dict`.

    Raises
    ------
    ModelError : it is no plant, or not the continuous one sampled.
    """
    if data.get("continuous") is None:
        return GeneralizedPlant(**data)
    origin = from_dict(data["continuous"])
    plant = GeneralizedPlant(**{**data, "continuous": origin})
    if not is_sample(plant, origin):
        raise ModelError("it is not its continuous plant, sampled: one of them was changed")
    return plant
