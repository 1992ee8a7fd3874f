"""Designs side by side: what each one reaches, what its loop bears, and how far apart they are."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from synth.analysis.coprime import ncfmargin
from synth.analysis.gap import gapmetric
from synth.analysis.norms import balance
from synth.analysis.stabilitymargins import margins
from synth.delivery.acceptance import inner
from synth.delivery.curves import frequencies, singular_values
from synth.delivery.frequencyplots import sigma
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.files import write_atomically
from synth.synthesis.design import Design
from synth.systems.connect import series
from synth.systems.statespace import StateSpace

MEASURES: dict[str, tuple[str, str]] = {  # key -> (text, what it is)
    "order": ("controller order", "states of the controller"),
    "dt": ("sampling time, s", "0 for continuous time"),
    "gamma": ("gamma, verified", "H-infinity norm from w to z of its own plant, measured by two methods"),
    "optimum": ("optimum, claimed", "what the solver says is possible; no proof"),
    "gain_margin_db": ("gain margin, dB", "smallest, one loop at a time, plant input and output"),
    "phase_margin_deg": ("phase margin, deg", "smallest, one loop at a time"),
    "delay_margin": ("delay margin, s", "smallest, one loop at a time"),
    "disk_margin": ("disk margin", "alpha, all inputs or all outputs at once"),
    "ncf_margin": ("ncf margin", "of its own loop"),
    "ncf_margin_reference": ("ncf margin, first plant", "with the plant of the first design"),
    "nugap_controller": ("nu-gap, controllers", "to the controller of the first design"),
    "nugap_plant": ("nu-gap, plants", "to the plant, from u to y, of the first design"),
    "nugap_loop": ("nu-gap, loops", "to the loop of the first design, cut at the plant's input"),
    "conditioning": ("conditioning", "condition number of the eigenvectors of the balanced controller"),
}


def compare(designs: Mapping[str, Design]) -> dict[str, dict[str, float | None]]:
    """The figures of `MEASURES` for every design; None where two designs cannot be compared.

    Controllers of loop-shaping designs are those of the shaped plants, Ks.

    Raises
    ------
    ModelError : there is no design.
    """
    if not designs:
        raise ModelError("there is no design to compare; pass at least one")
    first = next(iter(designs.values()))
    return {name: _figures(design, first) for name, design in designs.items()}


def _parts(design: Design) -> tuple[StateSpace, StateSpace]:
    """The plant from u to y and the controller that closes it, u = K y."""
    return inner(design.plant), design.closing


def _figures(design: Design, first: Design) -> dict[str, float | None]:
    (G, K), (G1, K1) = _parts(design), _parts(first)
    kept = margins(G, K, sign=1)
    return {
        "order": design.controller.n,
        "dt": design.plant.dt,
        "gamma": design.gamma,
        "optimum": design.info.optimum,
        "gain_margin_db": kept.gain_db,
        "phase_margin_deg": kept.phase_deg,
        "delay_margin": kept.delay,
        "disk_margin": kept.disk,
        "ncf_margin": kept.ncf,
        "ncf_margin_reference": _where_possible(lambda: ncfmargin(G1, K, sign=1)),
        "nugap_controller": _where_possible(lambda: gapmetric(K1, K).nugap),
        "nugap_plant": _where_possible(lambda: gapmetric(G1, G).nugap),
        "nugap_loop": _where_possible(lambda: gapmetric(series(G1, K1), series(G, K)).nugap),
        "conditioning": _conditioning(K),
    }


def _where_possible(measure: Callable[[], float]) -> float | None:
    """A distance, or None between systems of other sizes and timebases or with hidden unstable modes."""
    try:
        return measure()
    except (ModelError, AssumptionError, NumericalError):
        return None


def _conditioning(K: StateSpace) -> float:
    """How much rounding of the coefficients can move the poles (Bauer and Fike 1960, Numer. Math. 2, 137)."""
    return float(np.linalg.cond(np.linalg.eig(balance(K).A)[1])) if K.n else 1.0


def plot(designs: Mapping[str, Design], path: str | os.PathLike[str]) -> Path:
    """Singular values of closed loops (over gamma) and controllers, overlaid, as .svg or .png.

    Raises
    ------
    ModelError : the file name ends otherwise.
    """
    path = Path(path)
    if path.suffix not in (".svg", ".png"):
        raise ModelError(f"{path.name} ends with {path.suffix!r}; a plot is saved as .svg or .png")
    import io

    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({"svg.hashsalt": "convex-synth", "font.size": 9}):
        figure = Figure(figsize=(9, 3.6), layout="constrained")
        loops, controllers = figure.subplots(1, 2)
        for i, (name, design) in enumerate(designs.items()):
            closed, K = design.closed_loop, _parts(design)[1]
            omega = frequencies(closed, K)
            style: dict[str, Any] = {"color": f"C{i}", "lw": 1.2, "ls": ("-", "--", "-.", ":")[i % 4]}
            loops.loglog(omega, singular_values(closed, omega)[:, 0] / design.gamma, label=Path(name).stem, **style)
            sigma(K, controllers, omega=omega, **style)
        loops.axhline(1.0, color="0.6", lw=0.8)
        loops.set(xlabel="frequency, rad/s", title="closed loop w to z, largest / gamma")
        controllers.set(ylabel="", title="controller, singular values")
        for text in loops.legend(frameon=False).get_texts():
            text.set_parse_math(False)  # names of files
        for axes in (loops, controllers):
            axes.grid(True, which="major", lw=0.3)
        buffer = io.BytesIO()
        metadata: Any = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(buffer, format=path.suffix[1:], metadata=metadata, dpi=150)
    return write_atomically(path, buffer.getvalue())
