"""A controller as a co-simulation unit, FMI 2.0 or 3.0: the exported C, a wrapper, a binary for this machine, XML.

The unit samples by itself: sample k is taken at the start time + k dt with the inputs set before the step, and its
outputs are seen after the step. With steps of dt the rows of outputs therefore lag those of the inputs by one dt, as
they do behind any sampled controller, and no output depends on an input of the same instant.

The same design gives the same file, bit for bit, with the same compiler; the instantiation token is a hash of the
sources and of the description.

Reference: Functional Mock-up Interface specification, versions 2.0.4 and 3.0.2, https://fmi-standard.org
"""

from __future__ import annotations

import hashlib
import io
import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import metadata, resources
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from synth.delivery.c import HELD, c_files
from synth.delivery.origin import Origin
from synth.errors import ExportError
from synth.regulators.sequential import SequentialController

PACKAGE = resources.files("synth.delivery") / "fmi"
PLATFORMS = {  # system and machine -> ending of the binary, its folder in each version of the standard
    ("Linux", "x86_64"): (".so", {2: "linux64", 3: "x86_64-linux"}),
    ("Linux", "aarch64"): (".so", {3: "aarch64-linux"}),
    ("Darwin", "x86_64"): (".dylib", {2: "darwin64", 3: "x86_64-darwin"}),
    ("Darwin", "arm64"): (".dylib", {3: "aarch64-darwin"}),
    ("Windows", "AMD64"): (".dll", {2: "win64", 3: "x86_64-windows"}),
}
LAG = "as a co-simulation unit: outputs are seen one sampling time, {dt!r} s, after the inputs they answer to; {then}"
JUDGED = "synth verify --as fmu judges the loop with this lag"
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-shared")
EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive, so that the same content gives the same bytes


@dataclass(frozen=True, kw_only=True)
class Code:
    """A controller's C, and what its wrapper, its description and its page say of it."""

    files: Mapping[str, bytes]  # name.h and name.c
    about: str  # in a line
    held: str  # what happens where a number is not finite
    dt: float  # s
    dtype: str  # of the inputs and outputs
    umin: np.ndarray  # (m,)
    umax: np.ndarray  # (m,)
    joined: str  # lines of model.h: MODEL_INPUTS, MODEL_STEP(state, y, u), MODEL_COMMAND(state), MODEL_HELD

    @classmethod
    def of(cls, controller: SequentialController, origin: Origin, name: str) -> Code:
        """Of a linear controller."""
        return cls(
            files=c_files(controller, origin, name, self_test=False),
            about=f"linear controller, {controller.dtype} precision, sample time {controller.dt!r} s",
            held=HELD,
            dt=controller.dt,
            dtype=controller.dtype,
            umin=controller.umin,
            umax=controller.umax,
            joined=f"""\
#define MODEL_INPUTS {name.upper()}_INPUTS
#define MODEL_STEP {name}_step
#define MODEL_COMMAND(state) (state).u
#define MODEL_HELD "an input, a sum or a state of the controller is not finite: the last command is held"
""",
        )


def lagging(origin: Origin, dt: float, then: str = JUDGED) -> Origin:
    """The origin of a unit, which says that it lags, and what then."""
    return replace(origin, facts={**origin.facts, "lag": LAG.format(dt=dt, then=then)})


def fmu_bytes(controller: Code, origin: Origin, name: str, *, version: int) -> bytes:
    """The content of ``name.fmu``; version is 2 or 3, and the origin is `lagging`.

    Raises
    ------
    ExportError : there is no C compiler, this machine has no name in the standard, or two signals have one name.
    """
    _check_signals(origin)
    folder, ending = _platform(version)
    files = sources(controller, name, version=version)
    token = _token(files, description(controller, origin, name, "", version=version))
    files["model.h"] = _model_header(controller, name, token)
    content = {f"sources/{file}": text for file, text in files.items()}
    content[f"binaries/{folder}/{name}{ending}"] = _compile(files, name, version)
    content["modelDescription.xml"] = description(controller, origin, name, token, version=version)
    content["documentation/index.html"] = documentation(controller, origin, name)
    content["documentation/licenses/license.txt"] = _license()
    return _archive(content)


def _license() -> bytes:
    """The licence of the sources, which is that of this package."""
    text = metadata.distribution("convex-synth").read_text("licenses/LICENSE")
    return (text or "BSD-3-Clause, as convex-synth").encode()


def sources(controller: Code, name: str, *, version: int) -> dict[str, bytes]:
    """The controller's C, the wrapper and its interface; model.h, which joins them, is still missing."""
    files = dict(controller.files)
    files |= {file: (PACKAGE / file).read_bytes() for file in (f"fmi{version}.c", "instance.h", f"fmi{version}.h")}
    if version == 3:
        root = Element("fmiBuildDescription", fmiVersion="3.0")
        build = SubElement(
            SubElement(root, "BuildConfiguration", modelIdentifier=name), "SourceFileSet", language="C99"
        )
        for file in (f"{name}.c", "fmi3.c"):
            SubElement(build, "SourceFile", name=file)
        files["buildDescription.xml"] = _xml(root)
    return files


def description(controller: Code, origin: Origin, name: str, token: str, *, version: int) -> bytes:
    """The file modelDescription.xml: interface, signals, and the origin of the controller as an annotation."""
    step = repr(controller.dt)
    head = {
        "modelName": name,
        "description": f"{controller.about}; {origin.facts['convention']}",
        "generationTool": f"convex-synth {metadata.version('convex-synth')}",
    }
    simulation = {"modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true"}
    if version == 2:
        root = Element("fmiModelDescription", head, fmiVersion="2.0", guid=token)
        files = SubElement(SubElement(root, "CoSimulation", simulation), "SourceFiles")
        for file in (f"{name}.c", "fmi2.c"):
            SubElement(files, "File", name=file)
    else:
        root = Element("fmiModelDescription", head, fmiVersion="3.0", instantiationToken=token)
        SubElement(root, "CoSimulation", simulation, fixedInternalStepSize=step)
    units = sorted({signal.unit for signal in (*origin.inputs, *origin.outputs)} - {""} | {"s"})
    definitions = SubElement(root, "UnitDefinitions")
    for unit in units:
        SubElement(definitions, "Unit", name=unit)
    categories = SubElement(root, "LogCategories")
    SubElement(categories, "Category", name="logStatusWarning", description="a command was held: something not finite")
    SubElement(categories, "Category", name="logStatusError", description="what is wrong, when a call fails")
    (_variables2 if version == 2 else _variables3)(root, controller, origin, step)
    return _xml(root)


def documentation(controller: Code, origin: Origin, name: str) -> bytes:
    """The page documentation/index.html: what the unit computes, its signals with units and limits, its origin."""
    rows = [("name", "variable", "unit", "least", "largest")]
    rows += [(s.name, f"y[{i}], input", s.unit, "", "") for i, s in enumerate(origin.inputs)]
    low, high = ([str(v) if np.isfinite(v) else "" for v in M] for M in (controller.umin, controller.umax))
    rows += [(s.name, f"u[{i}], output", s.unit, low[i], high[i]) for i, s in enumerate(origin.outputs)]
    root = Element("html", lang="en")
    head, body = SubElement(root, "head"), SubElement(root, "body")
    SubElement(head, "meta", charset="utf-8")
    SubElement(head, "title").text = name
    SubElement(head, "style").text = (
        "body { font: 16px/1.5 sans-serif; max-width: 60em; margin: 2em auto; padding: 0 1em } "
        "table { border-collapse: collapse } "
        "td, th { text-align: left; vertical-align: top; padding: .2em 1em .2em 0 } "
        "td { overflow-wrap: anywhere } td:first-child { white-space: nowrap; overflow-wrap: normal }"
    )
    SubElement(body, "h1").text = name
    SubElement(body, "p").text = f"{controller.about}. {controller.held}"
    for title, lines in (("Signals", rows), ("What it is and where it comes from", list(origin.facts.items()))):
        SubElement(body, "h2").text = title
        table = SubElement(body, "table")
        for k, line in enumerate(lines):
            row = SubElement(table, "tr")
            for text in line:
                SubElement(row, "th" if title == "Signals" and k == 0 else "td").text = text
    ElementTree.indent(root)
    return b"<!DOCTYPE html>\n" + ElementTree.tostring(root, encoding="UTF-8", method="html") + b"\n"


def _limits(controller: Code, i: int) -> dict[str, str]:
    """The limits of command i as attributes of its variable."""
    limits = {"min": controller.umin[i], "max": controller.umax[i]}
    return {name: str(float(value)) for name, value in limits.items() if np.isfinite(value)}


def _variables2(root: Element, controller: Code, origin: Origin, step: str) -> None:
    """Version 2: experiment, origin, variables in the order of their references, structure with indices from 1."""
    SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=step)
    tool = SubElement(SubElement(root, "VendorAnnotations"), "Tool", name="convex-synth")
    tool.append(_facts(origin))
    variables, structure = SubElement(root, "ModelVariables"), Element("ModelStructure")
    outputs, unknowns = SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns")
    for i, signal in enumerate((*origin.inputs, *origin.outputs)):
        is_input = i < len(origin.inputs)
        scalar = SubElement(
            variables, "ScalarVariable", name=signal.name, valueReference=str(i), variability="discrete"
        )
        scalar.set("causality", "input" if is_input else "output")
        if not is_input:
            scalar.set("initial", "calculated")
        kept = {"start": "0.0"} if is_input else _limits(controller, i - len(origin.inputs))
        SubElement(scalar, "Real", {"unit": signal.unit} if signal.unit else {}, **kept)
        if not is_input:
            for parent in (outputs, unknowns):
                SubElement(parent, "Unknown", index=str(i + 1), dependencies="")
    root.append(structure)


def _variables3(root: Element, controller: Code, origin: Origin, step: str) -> None:
    """Version 3: experiment, origin, variables with time as the last one, structure with value references."""
    SubElement(root, "DefaultExperiment", startTime="0.0", stepSize=step)
    variables, structure = SubElement(root, "ModelVariables"), Element("ModelStructure")
    for i, signal in enumerate((*origin.inputs, *origin.outputs)):
        unit = {"unit": signal.unit} if signal.unit else {}
        common = {"name": signal.name, "valueReference": str(i), "variability": "discrete", **unit}
        if i < len(origin.inputs):
            SubElement(variables, "Float64", common, causality="input", start="0.0")
        else:
            kept = _limits(controller, i - len(origin.inputs))
            SubElement(variables, "Float64", common, causality="output", initial="calculated", **kept)
            SubElement(structure, "Output", valueReference=str(i), dependencies="")
    for i in range(len(origin.inputs), len(origin.inputs) + len(origin.outputs)):
        SubElement(structure, "InitialUnknown", valueReference=str(i), dependencies="")
    time = {"name": "time", "valueReference": str(len(origin.inputs) + len(origin.outputs)), "unit": "s"}
    SubElement(variables, "Float64", time, causality="independent", variability="continuous")
    root.append(structure)
    SubElement(SubElement(root, "Annotations"), "Annotation", type="convex-synth").append(_facts(origin))


def _facts(origin: Origin) -> Element:
    """The facts about the controller as an element <origin> with elements <fact name="..">..</fact>."""
    parent = Element("origin")
    for key, text in origin.facts.items():
        SubElement(parent, "fact", name=key).text = text
    return parent


def _xml(root: Element) -> bytes:
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _token(files: dict[str, bytes], blank: bytes) -> str:
    """The hash of the sources and of the description without its token, written as a GUID."""
    content = b"".join(file.encode() + b"\0" + files[file] + b"\0" for file in sorted(files))
    h = hashlib.sha256(content + blank).hexdigest()
    return f"{{{h[:8]}-{h[8:12]}-{h[12:16]}-{h[16:20]}-{h[20:32]}}}"


def _model_header(controller: Code, name: str, token: str) -> bytes:
    """The header model.h: what the wrapper has to know about this controller."""
    N = name.upper()
    return f"""\
/* Joins the controller and the wrapper. */
#include "{name}.h"

typedef {controller.dtype} model_real;

#define MODEL_TOKEN "{token}"
#define MODEL_SAMPLE_TIME {controller.dt!r} /* s */
#define MODEL_OUTPUTS {N}_OUTPUTS
#define MODEL_STATE {name}_state
#define MODEL_RESET {name}_reset
{controller.joined}""".encode()


def _compile(files: dict[str, bytes], name: str, version: int) -> bytes:
    """The shared library."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise ExportError("there is no C compiler for the binary of the FMU; install gcc, or export the C itself")
    with tempfile.TemporaryDirectory() as folder:
        for file, text in files.items():
            (Path(folder) / file).write_bytes(text)
        command = [compiler, *FLAGS, "-o", "library", f"{name}.c", f"fmi{version}.c"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode:
            raise ExportError(f"the C compiler refused the FMU's sources: {done.stderr.strip()}")
        return (Path(folder) / "library").read_bytes()


def _platform(version: int) -> tuple[str, str]:
    """The folder and the ending of the binary on this machine."""
    system, machine = platform.system(), platform.machine()
    ending, folders = PLATFORMS.get((system, machine), ("", {}))
    if version not in folders:
        known = ", ".join(f"{s} {m}" for (s, m), (_, names) in PLATFORMS.items() if version in names)
        raise ExportError(f"FMI {version} has no name for {system} on {machine}; export on one of {known}")
    return folders[version], ending


def _check_signals(origin: Origin) -> None:
    """Variables of an FMU have different names."""
    names = [signal.name for signal in (*origin.inputs, *origin.outputs)] + ["time"]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ExportError(
            f"{', '.join(sorted(twice))}: an FMU has one variable per name (one is time); rename channels"
        )


def _archive(content: dict[str, bytes]) -> bytes:
    """A ZIP file without dates, in alphabetical order."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for path in sorted(content):
            entry = zipfile.ZipInfo(path, EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content[path])
    return buffer.getvalue()
