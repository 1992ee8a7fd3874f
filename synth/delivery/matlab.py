"""A design as a MATLAB level-5 file: one struct `design`, read by MATLAB and Octave with ``load``.

``K = ss(design.K.A, design.K.B, design.K.C, design.K.D, design.dt)`` rebuilds the controller; ``design.convention``
says what it reads. ``design.json`` is the text of the JSON file, which `synth.read` takes: nothing is lost.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy.io

if TYPE_CHECKING:
    from synth.synthesis.design import Design


def mat_bytes(design: Design, accepted: str = "", certificate: str = "") -> bytes:
    """The content of the .mat file."""
    from synth.synthesis.convention import sampling
    from synth.synthesis.design import to_dict

    data = to_dict(design, certificate)
    plant = {name: np.asarray(value, dtype=float) for name, value in data["plant"].items() if name[0] in "ABCD"}
    names = {channel: cell(data["plant"][channel]) for channel in "wuzy"}
    info = data["info"]
    content = {
        "K": {name: np.asarray(data["controller"][name], dtype=float) for name in "ABCD"},
        "P": plant,
        "dt": matlab_timebase(data["dt"]),
        "gamma": float(data["gamma"]),
        "verified_norm": float(data["verified_norm"]),
        "optimum": float("nan") if info["optimum"] is None else float(info["optimum"]),
        "names": names,
        "units": {channel: cell([design.plant.units.get(s, "") for s in data["plant"][channel]]) for channel in "uy"},
        "plant_sha256": data["plant_sha256"],
        "method": info["method"],
        "solver": info["solver"],
        "tolerance": float(info["tolerance"]),
        "acceptance": accepted,
        "certificate": certificate or "none",
        "convention": design.convention,
        "sampling": sampling(design.plant.dt),
        "limits": "none",
        "json": json.dumps(data, indent=1, allow_nan=False),
        "date": info["date"],
        "versions": cell([f"{name} {version}" for name, version in info["versions"].items()]),
    }
    if info["shifted_norm"] is not None:  # mixed sensitivity with a shifted axis: the optimum belongs to that problem
        content |= {"shift": float(info["shift"]), "shifted_norm": float(info["shifted_norm"])}
    for name, parts in data.get("shaping", {}).items():  # K = W1 Ks W2; Ks closes P
        content[name] = {key: np.asarray(value, dtype=float) for key, value in parts.items()}
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {"design": content}, oned_as="column", long_field_names=True)
    return buffer.getvalue()


def matlab_timebase(dt: float) -> float:
    """MATLAB's sampling time: -1 stands for an unspecified one."""
    return -1.0 if dt is True else float(dt)


def cell(texts: Sequence[str]) -> np.ndarray:
    """A cell array of strings; a plain list would become one padded character matrix."""
    cell = np.empty((len(texts), 1), dtype=object)
    cell[:, 0] = list(texts)
    return cell
