"""A controller that comes without a plant, as a JSON or .mat file: its matrices and an honest word about them.

A `Design` has richer files of its own (`Design.save`), which can be read back and measured again.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import scipy.io

from synth.delivery.matlab import matlab_timebase
from synth.delivery.modelfiles import CONTROLLER, CONTROLLER_VERSION
from synth.delivery.origin import origin_of
from synth.files import sealed_by_parts
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.sequential import controller_of


def json_bytes(source: Any) -> bytes:
    """The content of the .json file, with a sha256 of all of it; limits that are not there are null."""
    data = {key: _json(value) for key, value in _document(source).items()}
    return json.dumps(sealed_by_parts(data), indent=1).encode()


def mat_bytes(source: Any) -> bytes:
    """The content of the .mat file, one struct ``controller``; ``ss(A, B, C, D, dt)`` rebuilds the system."""
    buffer = io.BytesIO()
    content = _document(source)
    content["dt"] = matlab_timebase(content["dt"])
    scipy.io.savemat(buffer, {"controller": content}, oned_as="column", long_field_names=True)
    return buffer.getvalue()


def _document(source: Any) -> dict[str, Any]:
    """Arrays, numbers and texts."""
    K = controller_of(source)
    data: dict[str, Any] = {"format": CONTROLLER, "format_version": float(CONTROLLER_VERSION)}
    data |= {"A": K.A, "B": K.B, "C": K.C, "D": K.D, "dt": K.dt}
    if isinstance(source, AntiWindup):
        data |= {"L": source.L, "umin": source.umin, "umax": source.umax}
    return data | {key.replace(" ", "_"): fact for key, fact in origin_of(source).facts.items()}


def _json(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_json(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
