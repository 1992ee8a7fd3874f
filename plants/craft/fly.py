"""What the command `synth` asks of this package, through the entry point of the group `convex_synth.fly`.

`synth/command/door.py` says what is asked for. Paths, controllers and plain data cross it; `synth` and `plants` know
nothing else of each other.
"""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from plants.craft.comparison import HEADERS
from plants.craft.datasheets import DataSheet, read_spacecraft
from plants.errors import PlantError
from plants.outcome.report import text_table

REFUSALS = (PlantError,)  # errors that name a mistake of the user and its remedy
CONTROLS = ("torque x", "torque y", "torque z")  # N m on the body
MEASUREMENTS = ("q x", "q y", "q z", "rate x", "rate y", "rate z")  # vector part of the error quaternion; rad/s


def template() -> str:
    """A file of a spacecraft that flies, with a comment on every line that a user changes."""
    return (resources.files("plants.craft") / "spacecraft.toml").read_text(encoding="utf-8")


def read(path: Path) -> DataSheet:
    """The spacecraft in a file; one of `REFUSALS` if something in it is wrong."""
    return read_spacecraft(path)


def model(sheet: DataSheet) -> dict[str, Any]:
    """The linear plant: A, B, C, D in continuous time, the control period dt () s, names u, y and units of signals."""
    A, B, C, D = sheet.craft.linear()
    units = {**dict.fromkeys(CONTROLS, "N m"), **dict.fromkeys(MEASUREMENTS[3:], "rad/s")}
    return {"A": A, "B": B, "C": C, "D": D, "dt": sheet.craft.dt, "u": CONTROLS, "y": MEASUREMENTS, "units": units}


def weights(sheet: DataSheet) -> dict[str, Any]:
    """Weights of the four-block problem by what is required; one of `REFUSALS` if that cannot be had."""
    return sheet.weights()


def fly(
    sheet: DataSheet,
    controllers: Mapping[str, Any],
    *,
    runs: int,
    seed: int,
    duration: float | None,
    out: Path | None,
) -> dict[str, Any]:
    """Fly all controllers through the same dispersed flights.

    Returns
    -------
    dict : `text`, tables for a terminal; `met`, whether all requirements are; `controllers`, name -> figures that 95 %
        of the flights keep, in SI, with `failed` flights of `runs`; `report`, the page or None

    Raises
    ------
    ScenarioError, OSError
        What `compare_flights` refuses; a folder `out` that cannot be written.
    """
    found = sheet.compare(controllers, runs=runs, seed=seed, duration=duration, out=out)
    rows = [[name, *row] for name, row in found.rows().items()]
    figures = {
        name: levels | {"failed": int((~found.campaigns[name].ok).sum()), "runs": runs}
        for name, levels in found.levels().items()
    }
    return {
        "text": f"{text_table(HEADERS, rows)}\n\n{found}",
        "met": all(requirement.met for requirement in found.requirements),
        "controllers": figures,
        "report": found.report,
    }
