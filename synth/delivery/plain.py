"""A controller that comes without a plant, as a JSON or .mat file: its matrices and an honest word about them.

A `Design` has richer files of its own (`Design.save`), which can be read back and measured again.
"""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np
import scipy.io

from synth.delivery.matlab import cell, matlab_timebase
from synth.delivery.modelfiles import CONTROLLER, CONTROLLER_VERSION
from synth.delivery.origin import origin_of
from synth.files import sealed_by_parts
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.sequential import controller_of


def json_bytes(source: Any, limited: AntiWindup | None = None, accepted: str = "", certificate: str = "") -> bytes:
    """The content of the .json file, with a sha256 of all of it; limits that are not there are null.

    `limited` is the controller of `source` with the limits that it gets on its way out.
    """
    data = {key: _json(value) for key, value in _document(source, limited, accepted, certificate).items()}
    return json.dumps(sealed_by_parts(data), indent=1).encode()


def mat_bytes(source: Any, limited: AntiWindup | None = None, accepted: str = "", certificate: str = "") -> bytes:
    """The content of the .mat file, one struct ``controller``; ``ss(A, B, C, D, dt)`` rebuilds the system."""
    buffer = io.BytesIO()
    content = _document(source, limited, accepted, certificate)
    content |= {"dt": matlab_timebase(content["dt"]), "units": [content["units"].get(s, "") for s in content["u"]]}
    content |= {key: cell(content[key]) for key in ("y", "u", "units")}
    content["json"] = json_bytes(source, limited, accepted, certificate).decode()
    scipy.io.savemat(buffer, {"controller": content}, oned_as="column", long_field_names=True)
    return buffer.getvalue()


def _document(source: Any, limited: AntiWindup | None, accepted: str, certificate: str) -> dict[str, Any]:
    """Arrays, numbers and texts."""
    K = controller_of(source)
    limited = source if isinstance(source, AntiWindup) else limited
    origin = origin_of(source, limited, accepted, certificate=certificate)
    data: dict[str, Any] = {"format": CONTROLLER, "format_version": float(CONTROLLER_VERSION)}
    data |= {"A": K.A, "B": K.B, "C": K.C, "D": K.D, "dt": K.dt}
    if limited is not None:
        data |= {"L": limited.L, "umin": limited.umin, "umax": limited.umax}
    data |= {"y": [s.name for s in origin.inputs], "u": [s.name for s in origin.outputs]}
    data["units"] = {s.name: s.unit for s in (*origin.inputs, *origin.outputs) if s.unit}
    return data | {key.replace(" ", "_"): fact for key, fact in origin.facts.items()}


def _json(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_json(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
