"""Where an exported controller comes from: what was designed, for which plant, what was measured, and its signals.

The facts travel in every file that leaves. They hold no path and no user name, and texts that would break a file's
syntax are refused, because a design that was read from a file may hold anything.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import metadata
from typing import Any, NamedTuple

from synth.analysis.norms import verify
from synth.errors import ExportError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.controller import LinearController
from synth.regulators.sequential import SequentialController, controller_of
from synth.synthesis import convention
from synth.synthesis.design import Design

FORBIDDEN = ("*/", "/*", "\\", "??")  # ends or opens a comment in C, continues a line, begins a trigraph


class Signal(NamedTuple):
    """One input or output of the controller."""

    name: str
    unit: str  # empty where the plant does not say

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Origin:
    """Facts about a controller, in reading order, and its signals."""

    facts: dict[str, str]
    inputs: tuple[Signal, ...]  # (p,)
    outputs: tuple[Signal, ...]  # (m,)


def origin_of(
    source: Any, exported: SequentialController | AntiWindup | None = None, accepted: str = "", arithmetic: str = "",
    certificate: str = "",
) -> Origin:  # fmt: skip
    """The origin of a Design, or of a controller that comes without a plant.

    Where the exported controller is in single precision, the loop is closed with its rounded matrices and measured.
    `accepted`, `arithmetic` and `certificate` are what the gate and `rounding` found and what was proved, in words.

    Raises
    ------
    ExportError : a name, unit or fact has characters that would break an exported file.
    VerificationError : the rounded controller does not stabilise the design's plant.
    """
    K = controller_of(source)
    inputs = tuple(Signal(f"y{i}", "") for i in range(K.nu))
    outputs = tuple(Signal(f"u{i}", "") for i in range(K.ny))
    facts = conventions(source, exported)
    if isinstance(source, Design):
        facts |= _facts(source)
        if isinstance(exported, SequentialController) and exported.dtype == "float":
            facts["rounded"] = _rounded(source, exported)
        if source.shaping is None:  # else y and u of the plant are those of the shaped plant
            P = source.plant
            inputs = tuple(Signal(name, P.units.get(name, "")) for name in P.y)
            outputs = tuple(Signal(name, P.units.get(name, "")) for name in P.u)
    else:
        facts |= {
            "plant": "none; the controller was exported without a plant, nothing was verified in a loop",
            "controller": f"sha256 {K.digest()}",
        }
        if isinstance(source, LinearController | AntiWindup):
            facts["input"] = "the error e = r - y"
    facts |= {"arithmetic": arithmetic} if arithmetic else {}
    facts |= {"certificate": certificate} if certificate else {}
    facts |= {"acceptance": accepted} if accepted else {}
    facts["exported by"] = f"convex-synth {metadata.version('convex-synth')}"
    return checked(Origin(facts, inputs, outputs))


def checked(origin: Origin) -> Origin:
    """The origin, if none of its texts breaks the syntax of a file.

    Raises
    ------
    ExportError : one does.
    """
    signals = ((f"signal {s.name!r}", str(s)) for s in (*origin.inputs, *origin.outputs))
    for where, text in [*origin.facts.items(), *signals]:
        if not text.isprintable() or any(part in text for part in FORBIDDEN):
            raise ExportError(f"{where} is {text!r}; use printable characters without {' '.join(FORBIDDEN)}")
    return origin


def conventions(source: Any, exported: SequentialController | AntiWindup | None = None) -> dict[str, str]:
    """What a controller reads, when, and within which limits: the same words in every format."""
    if isinstance(source, Design):
        told = source.convention
    else:
        told = convention.ERROR if isinstance(source, LinearController | AntiWindup) else convention.UNTOLD
    own = exported if exported is not None else source if isinstance(source, AntiWindup) else None
    kept = "none" if own is None else convention.limits(own.umin, own.umax, bool(own.L.any()))
    return {"convention": told, "sampling": convention.sampling(controller_of(source).dt), "limits": kept}


def _facts(design: Design) -> dict[str, str]:
    """What was designed, for which plant, with which result."""
    info, plant = design.info, design.plant
    n, nw, nu, nz, ny = plant.sizes
    sizes = f"order {n}, {nw} + {nu} inputs, {nz} + {ny} outputs"
    loop = "the shaped plant W2 G W1" if design.shaping else "the plant with its weights"
    facts = {
        "plant": f"{sizes}, sha256 {plant.system.digest()}",
        "controller": f"order {design.controller.n}, sha256 {design.controller.digest()}",
        "method": f"{info.method}, solver {info.solver}, relative tolerance {info.tolerance:g}, status {info.status}",
        "gamma": f"{design.gamma!r}, the verified norm; the controller was designed for {info.level!r}",
        "optimum": "not looked for" if info.optimum is None else f"{info.optimum!r}, which is the solver's claim",
        "verified": f"H-infinity norm {design.verified_norm!r} at {info.frequency:.6g} rad/s, closed with {loop}",
        "closed loop": f"spectral radius {info.spectral_radius!r}",
        "date": info.date,
        "versions": ", ".join(f"{name} {version}" for name, version in info.versions.items()),
    }
    if design.intersample is not None:
        facts["between the samples"] = f"H-infinity norm {design.intersample.upper!r} with the continuous plant"
    if design.shaping is not None:
        facts["weights"] = f"W1 sha256 {design.shaping.W1.digest()}, W2 sha256 {design.shaping.W2.digest()}"
    return facts


def _rounded(design: Design, exported: SequentialController) -> str:
    """The loop measured again with the controller's matrices rounded to float; its arithmetic rounds on top."""
    if design.shaping is not None:
        return "to float; not measured again, because the design holds only its shaped plant"
    measured = verify(design.plant.close(exported.system))
    return f"to float; H-infinity norm {measured.norm!r}, spectral radius {measured.spectral_radius!r}"
