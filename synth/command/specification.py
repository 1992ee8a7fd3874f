"""A design as a TOML file: plant, weights, method and what is asked of the result.

    [plant]           matrices A, B, C, D (or A, B1, ..., D22), or num and den, or zeros, poles and gain; and dt; or
                      file = "plant.json" (or .mat) beside it. sample = 0.5 discretises a continuous plant, hold = "zoh"
                      (default) or "tustin"; delay = 1.0 in s, of the inputs u, any with `sample` and "zoh", else whole
                      samples; u, y, units; or
                      spacecraft = "spacecraft.toml", whose linear plant has its control period
    [synthesis]       problem = "tracking", "fourblock", "generalized", "loopshaping" or "mixedsensitivity"; method,
                      gamma, tol; for mixed sensitivity also shift; for loop shaping no tol, but gamma_factor, and
                      feedback = "negative" for a controller that acts on r - y
    [weights]         tracking: Wproc, Wdist, Werr, Wact, Wr; fourblock: Wdist, Wnoise, Wout, Wact, each by default
                      what the requirements of the spacecraft ask for, if the plant is that of one; loop shaping: W1,
                      W2, mixed sensitivity: W1, W2, W3 (matrices or tables A, B, C, D; num, den; zeros, poles, gain)
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
from synth.command.studyplants import fraction, plant_kind, read_plant
from synth.command.tables import Table
from synth.delivery.acceptance import Acceptance, Requirements, accept
from synth.errors import ModelError, SpecificationError
from synth.files import DEEPEST, parsed
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.synthesis.mixedsensitivity import augw, mixsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace, as_system

LARGEST = 8 * 2**20  # bytes of a study; plants of order 200 and more belong into a file of their own
SYSTEM = {*"ABCD", "num", "den", "zeros", "poles", "gain"}  # keys of a weight that is a system
PROBLEMS = ("tracking", "generalized", "loopshaping", "mixedsensitivity", "fourblock")
BLOCKS = {  # weight -> signals of the plant
    "tracking": {"Wproc": "u", "Wdist": "y", "Werr": "y", "Wact": "u", "Wr": "y"},
    "fourblock": {"Wdist": "u", "Wnoise": "y", "Wout": "y", "Wact": "u"},
}


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
    described = Table(plant_data, "plant", root.problems, plant_kind(plant_data) if root.given("plant") else None)
    plant, about = read_plant(described, folder)
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
            return plant and replace(plant, **{key: about[key] for key in ("u", "y", "units") if about[key]})
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
    size, usual = {"u": m, "y": q}, {}
    if problem == "fourblock" and "craft" in about and not BLOCKS[problem].keys() <= weights.data.keys():
        try:
            usual = about["craft"].weights()
        except ModelError as error:
            weights.problems.append(f"weights: those of the requirements cannot be had: {error}")
            return None
    found: dict[str, Any] = {
        key: usual[key]
        if key in usual and key not in weights.data
        else _shaping_weight(weights, key, size[signals], plant)
        for key, signals in BLOCKS[problem].items()
    }
    if plant is None or any(W is None for W in found.values()):
        return None
    named = {key: about[key] for key in ("u", "y", "units") if about[key]}
    try:
        if problem == "fourblock":
            return GeneralizedPlant.four_block(replace(plant, **named), **found)
        return GeneralizedPlant.tracking(plant, **found, **named)
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
    if given := fraction(table):
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
