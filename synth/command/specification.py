"""A design as a TOML file: plant, weights, method and what is asked of the result.

    [plant]           matrices A, B, C, D (or A, B1, ..., D22), or num and den, or zeros, poles and gain; and dt; or
                      file = "plant.json" (or .mat) beside it. sample = 0.5 discretises a continuous plant, hold = "zoh"
                      (default) or "tustin"; delay = 1.0 in s, of the inputs, in whole samples; u, y, units
    [synthesis]       problem = "tracking", "generalized", "loopshaping" or "mixedsensitivity"; method, gamma, tol;
                      for mixed sensitivity also shift; for loop shaping no tol, but gamma_factor, and
                      feedback = "negative" for a controller that acts on r - y
    [weights]         tracking: Wproc, Wdist, Werr, Wact, Wr; loop shaping: W1, W2, mixed sensitivity: W1, W2, W3
                      (matrices or tables A, B, C, D; num, den; zeros, poles, gain)
    [specifications]  max_norm; the fields of `Requirements` (a margin of 0 asks nothing); umin, umax, overload;
                      antiwindup = true for the conditioned controller of a loop-shaping design; dt at which a
                      continuous design is to run

A matrix is a list of rows, {diag = [...]}, or a number, which stands for that multiple of the identity. Polynomials are
lists of coefficients, highest power first; a complex zero or pole is a text, "-1+2j". The file is checked as a whole:
all mistakes are told at once, each with its path.
"""

from __future__ import annotations

import os
import re
import tomllib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from synth.analysis.coprime import gang_of_four
from synth.checks import as_path
from synth.command import studyschemas
from synth.command.tables import Table
from synth.delivery.acceptance import Acceptance, Requirements, accept, sampled
from synth.delivery.modelfiles import FRACTIONS, NINE, Model, read
from synth.errors import ModelError, SpecificationError, SynthError
from synth.files import DEEPEST, is_device, parsed
from synth.mistakes import Record
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.synthesis.mixedsensitivity import augw, mixsyn
from synth.systems.connect import input_delay
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace, as_system

LARGEST = 8 * 2**20  # bytes of a study; plants of order 200 and more belong into a file of their own
SYSTEM = {*"ABCD", "num", "den", "zeros", "poles", "gain"}  # keys of a weight that is a system
PROBLEMS = ("tracking", "generalized", "loopshaping", "mixedsensitivity")
TRACKING = {"Wproc": "u", "Wdist": "y", "Werr": "y", "Wact": "u", "Wr": "y"}  # weight -> signals of the plant


@dataclass(frozen=True, eq=False)
class Study:
    """A checked study file."""

    problem: str  # one of `PROBLEMS`
    plant: GeneralizedPlant | StateSpace  # what is designed for; the plain plant (with the sign of loop shaping)
    options: dict[str, Any]  # of `hinfsyn`, `ncfsyn` or `mixsyn`
    requirements: Requirements = field(default_factory=Requirements)
    gate: dict[str, Any] = field(default_factory=dict)  # of `accept`
    max_norm: float | None = None
    signals: dict[str, Any] = field(default_factory=dict)  # names and units that the synthesis does not know

    def design(self) -> Design:
        """Design and verify; raises what `hinfsyn`, `ncfsyn` or `mixsyn` do."""
        synthesis = {"loopshaping": ncfsyn, "mixedsensitivity": mixsyn}.get(self.problem, hinfsyn)
        design = synthesis(self.plant, **self.options)
        return replace(design, plant=replace(design.plant, **self.signals)) if self.signals else design

    def accept(self, design: Design) -> Acceptance | None:
        """The acceptance gate; None for a continuous design without a sampling time to run at."""
        if design.plant.dt == 0 and "dt" not in self.gate:
            return None
        limited = "umin" in self.gate or "umax" in self.gate
        plant = gang_of_four(self.plant) if self.problem == "loopshaping" and limited else None
        gate = dict(self.gate)
        if gate.pop("antiwindup", False):
            gate["antiwindup"] = AntiWindup.of(design, gate.get("umin", -np.inf), gate.get("umax", np.inf)).L
        return accept(design, plant, requirements=self.requirements, **gate)

    def missed(self, design: Design, accepted: Acceptance | None) -> list[str]:
        """What the design does not meet, in words."""
        texts = []
        if self.max_norm is not None and design.verified_norm > self.max_norm:
            texts.append(f"the verified norm is {design.verified_norm:.7g}, above max_norm = {self.max_norm:.7g}")
        if accepted:
            texts += [f"{c.name}: {c.note or 'failed'}" for c in accepted.failed]
        return texts


def read_study(path: str | os.PathLike[str]) -> Study:
    """Read and check a TOML file.

    Raises
    ------
    SpecificationError : the file is missing, is no TOML, or says what cannot be; names all mistakes with their paths.
    """
    path = as_path("path", path)
    try:
        data = parsed(path, _toml, "TOML", largest=LARGEST)
    except ModelError as error:
        raise SpecificationError(path.name, [f"the file cannot be read: {error}"]) from None
    problems: list[str] = []
    study = _study(Table(data, "", problems, studyschemas.File), path.parent)
    if problems or study is None:
        raise SpecificationError(path.name, problems)
    return study


def _toml(text: str) -> dict[str, Any]:
    """The tables; keys of very many parts are refused before, because `tomllib` takes the square of their number."""
    parts = (part for part in re.split(r"[=,{}\[\]\n]", text) if not part.lstrip().startswith("#"))
    if any(len(re.findall(r"\.\s*[\w\"'-]", part)) > DEEPEST for part in parts):
        raise ModelError(f"it is nested deeper than {DEEPEST} levels, by a key with so many parts")
    return tomllib.loads(text)


def _study(root: Table, folder: Path) -> Study | None:
    """The whole file; None if something in it is wrong."""
    plant_data, synthesis_data, weights_data = (root.get(key, {}) for key in ("plant", "synthesis", "weights"))
    described = Table(plant_data, "plant", root.problems, _plant_kind(plant_data) if root.given("plant") else None)
    plant, about = _plant(described, folder)
    problem = synthesis_data.get("problem")
    problem = problem if isinstance(problem, str) and problem in PROBLEMS else None
    kind = studyschemas.SYNTHESIS.get(problem or "", studyschemas.AnySynthesis)
    synthesis = Table(synthesis_data, "synthesis", root.problems, kind if root.given("synthesis") else None)
    weights = Table(weights_data, "weights", root.problems, studyschemas.WEIGHTS.get(problem or ""))
    options = _options(synthesis)
    negative = problem == "loopshaping" and synthesis.get("feedback") == "negative"
    target = _weighed(problem, plant, about, weights, options, negative)
    signals = _errors(about) if problem == "mixedsensitivity" else {}
    if problem == "loopshaping":
        for key in described.given("u", "y", "units"):
            described.wrong(key, "loop shaping has no use for names: its plant is the shaped one; leave this away")
    m = None if plant is None else plant.sizes[2] if isinstance(plant, GeneralizedPlant) else plant.nu
    asked = Table(root.get("specifications", {}), "specifications", root.problems, studyschemas.Specifications)
    requirements, gate, max_norm = _specifications(asked, m)
    if plant is not None and plant.dt == 0 and "dt" not in gate and (gate or requirements != Requirements()):
        asked.wrong("dt", "missing; the gate measures a sampled controller: at which period, in s, is it to run?")
    if root.problems or problem is None or target is None:
        return None
    return Study(problem, target, options, requirements, gate, max_norm, signals)


def _plant(table: Table, folder: Path) -> tuple[GeneralizedPlant | StateSpace | None, dict[str, Any]]:
    """The plant, sampled if that is asked for, and the names and units of its signals."""
    about: dict[str, Any] = {key: tuple(table.get(key, ())) for key in ("u", "y")}
    about["units"] = dict(table.get("units", {}))
    sample, hold = table.get("sample"), table.get("hold", "zoh")
    before = len(table.problems)
    try:
        plant = _from_file(table, folder, about) if "file" in table.data else _from_matrices(table)
        if sample is not None and plant is not None:
            plant = _sampled(plant, sample, hold)
        if "delay" in table.data and plant is not None:
            if isinstance(plant, GeneralizedPlant):
                raise ModelError(
                    "delay is for a plant with inputs u alone; put it into A, B1, ... of a generalised one"
                )
            plant = input_delay(plant, table.data["delay"])
    except SynthError as error:
        if len(table.problems) == before:
            table.problems.append(f"{table.path}: {error}")
        plant = None
    if isinstance(plant, StateSpace):
        for key, size in (("u", plant.nu), ("y", plant.ny)):
            if about[key] and len({*about[key]}) != size:
                table.wrong(key, f"expected {size} different names, found {len({*about[key]})}")
                about[key] = ()
    return plant, about


def _plant_kind(data: dict[str, Any]) -> type[Record]:
    """What a table of a plant holds, by the keys that it has."""
    if "file" in data:
        return studyschemas.FilePlant
    if any(key in data for keys in FRACTIONS for key in keys):
        return studyschemas.FractionPlant
    nine = any(name in data for name in NINE[1:])
    return studyschemas.GeneralizedPlant if nine else studyschemas.MatrixPlant


def _sampled(plant: GeneralizedPlant | StateSpace, dt: float, hold: str) -> GeneralizedPlant | StateSpace:
    """The discrete plant."""
    if isinstance(plant, StateSpace):
        return c2d(plant, dt, hold)
    if hold != "zoh":
        raise ModelError("hold is 'tustin'; a generalised plant is sampled with 'zoh'")
    return sampled(plant, dt)


def _from_file(table: Table, folder: Path, about: dict[str, Any]) -> GeneralizedPlant | StateSpace | None:
    """The plant in a file beside the study."""
    name = table.get("file")
    if name is None:
        return None
    if trouble := _stray(name):
        table.wrong("file", f"{name}: {trouble}")
        return None
    try:
        found = read(folder / name)
    except SynthError as error:
        table.wrong("file", f"{name}: {error}")
        return None
    if isinstance(found, Design):
        found = found.plant
    if isinstance(found, Model):
        for key in ("u", "y", "units"):
            about[key] = about[key] or getattr(found, key)
        return found.system
    return found


def _stray(name: str) -> str:
    """What is wrong with where a file is said to be; empty if nothing is."""
    path = Path(name)
    if any(is_device(part) for part in path.parts):
        return "Windows takes this name for a device; give the file another"
    if not path.is_absolute() and (path.drive or os.path.normpath(name).startswith(os.pardir)):
        return "it is outside the folder of the study; put the file beside the study, or write its whole path"
    return ""


def _from_matrices(table: Table) -> GeneralizedPlant | StateSpace | None:
    """The plant from its matrices; shapes follow A and D, or A, D11 and D22."""
    dt = table.get("dt")
    if given := _fraction(table):
        return None if dt is None else as_system(table.path, given | {"dt": dt})
    nine = any(name in table.data for name in NINE[1:])
    names = NINE if nine else tuple("ABCD")
    rows: dict[str, Any] = {}
    n = len(table.data["A"]) if isinstance(table.data.get("A"), list) else None
    for name in ("A", *(("D11", "D22") if nine else ())):
        rows[name] = table.matrix(name, (n, n) if name == "A" else (None, None))
    rest = [name for name in names if name not in rows]
    for name in rest:
        rows[name] = table.matrix(name, _expected(name, rows, n))
    if dt is None or any(M is None for M in rows.values()):
        return None
    return GeneralizedPlant(**rows, dt=dt) if nine else StateSpace(**rows, dt=dt)


def _fraction(table: Table) -> dict[str, Any]:
    """Polynomials, or zeros, poles and gain, if the table has them."""
    return table.given(*(key for keys in FRACTIONS for key in keys))


def _expected(name: str, rows: dict[str, Any], n: int | None) -> tuple[int | None, int | None]:
    """The shape of a matrix of the plant, as far as others have told it."""

    def size(key: str, axis: int) -> int | None:
        return None if rows.get(key) is None else rows[key].shape[axis]

    shapes = {
        "B": (n, None), "C": (None, n), "D": (size("C", 0), size("B", 1)),
        "B1": (n, size("D11", 1)), "B2": (n, size("D22", 1)), "C1": (size("D11", 0), n), "C2": (size("D22", 0), n),
        "D12": (size("D11", 0), size("D22", 1)), "D21": (size("D22", 0), size("D11", 1)),
    }  # fmt: skip
    return shapes[name]


def _options(table: Table) -> dict[str, Any]:
    """Options of the synthesis function; those left out keep its defaults."""
    found = table.given("method", "gamma", "gamma_factor", "tol", "shift")
    return {key: value if key == "method" else float(value) for key, value in found.items()}


def _weighed(
    problem: str | None, plant: Any, about: dict[str, Any], weights: Table, options: dict[str, Any], negative: bool
) -> GeneralizedPlant | StateSpace | None:
    """The plant that is designed for; weights of loop shaping and of mixed sensitivity go into the options."""
    if problem is None:
        return None
    if plant is not None and isinstance(plant, GeneralizedPlant) != (problem == "generalized"):
        needed = "A, B1, B2, ..., D22" if problem == "generalized" else "A, B, C, D"
        weights.problems.append(f"plant: the problem {problem!r} needs a plant with {needed}")
        plant = None
    if problem == "generalized":
        try:
            return plant and replace(plant, **{key: value for key, value in about.items() if value})
        except ModelError as error:
            weights.problems.append(f"plant: {error}")
            return None
    m, q = (None, None) if plant is None else (plant.nu, plant.ny)
    if problem == "loopshaping":
        for key, size in (("W1", m), ("W2", q)):
            if key in weights.data:
                options[key] = _shaping_weight(weights, key, size, plant)
        return -plant if plant is not None and negative else plant
    if problem == "mixedsensitivity":
        sizes = {"W1": q, "W2": m, "W3": q}
        chosen = {key: _shaping_weight(weights, key, size, plant) for key, size in sizes.items() if key in weights.data}
        options |= chosen
        if plant is None or any(W is None for W in chosen.values()):
            return None
        try:
            augw(plant, **chosen)
        except ModelError as error:
            weights.problems.append(f"weights: {error}")
            return None
        return plant
    size = {"u": m, "y": q}
    found: dict[str, Any] = {
        key: _shaping_weight(weights, key, size[signals], plant) for key, signals in TRACKING.items()
    }
    if plant is None or any(W is None for W in found.values()):
        return None
    try:
        return GeneralizedPlant.tracking(plant, **found, **about)
    except ModelError as error:
        weights.problems.append(f"plant: {error}")
        return None


def _errors(about: dict[str, Any]) -> dict[str, Any]:
    """Names and units for a controller that sees the errors of the outputs; what is not given keeps its default."""
    named = {s: f"error {s}" for s in about["y"]}
    units = {named.get(s, s): unit for s, unit in about["units"].items()}
    found = {"u": tuple(about["u"]), "y": tuple(named.values()), "units": units}
    return {key: value for key, value in found.items() if value}


def _shaping_weight(weights: Table, key: str, size: int | None, plant: StateSpace | None) -> Any:
    """A matrix, or a system with the timebase of the plant."""
    given = weights.get(key)
    if not isinstance(given, dict) or not SYSTEM & given.keys():
        return weights.matrix(key, (size, size))
    table = Table(given, weights.at(key), weights.problems)
    if given := _fraction(table):
        try:
            return None if plant is None else as_system(key, given | {"dt": plant.dt})
        except ModelError as error:
            weights.wrong(key, str(error))
            return None
    n = len(table.data["A"]) if isinstance(table.data.get("A"), list) else None
    shape = {"A": (n, n), "B": (n, None), "C": (None, n), "D": (None, None)}
    rows = {name: table.matrix(name, shape[name]) for name in "ABCD"}
    if plant is None or any(M is None for M in rows.values()):
        return None
    try:
        return StateSpace(**rows, dt=plant.dt)
    except ModelError as error:
        weights.wrong(key, str(error))
        return None


def _specifications(table: Table, m: int | None) -> tuple[Requirements, dict[str, Any], float | None]:
    """What is asked of the design."""
    gate = table.given("dt", "overload")
    gate |= {key: limits for key in ("umin", "umax") if (limits := table.vector(key, m)) is not None}
    if table.get("antiwindup"):
        gate["antiwindup"] = True
        if not {"umin", "umax"} & table.data.keys():
            table.wrong("antiwindup", "there are no limits; give umin and umax")
    requirements = Requirements(**table.given(*(f.name for f in fields(Requirements))))
    return requirements, gate, table.get("max_norm")
