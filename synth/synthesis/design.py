"""A design: the verified controller, the loop it closes, and how it came about; saved and loaded with provenance.

The JSON file is the master format. Matrices are written with every bit (the shortest decimal that reads back
exactly); the plant is in the file, so that reading it can close the loop and measure the norm again.
"""

from __future__ import annotations

import html
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from synth.analysis.norms import judge
from synth.analysis.sampleddata import SampledNorm, intersample
from synth.analysis.stabilitymargins import Margins, margins
from synth.checks import as_path, printable, timebase_told
from synth.errors import ModelError, SynthError, VerificationError
from synth.files import PARTS, SEAL, check_seal, read_json, sealed_by_parts, write_atomically
from synth.synthesis import info as infos
from synth.synthesis import plantdata
from synth.synthesis.convention import ERROR, sampling, sign
from synth.synthesis.info import SAMPLED, Info
from synth.synthesis.remarks import between, floored, poor, words
from synth.systems.connect import series
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

if TYPE_CHECKING:
    import control

    from synth.proof.certify import Certificate
    from synth.regulators.controller import LinearController

FORMAT = "convex-synth design"
FORMAT_VERSION = 3
SHAPING = ("W1", "W2", "Ks")  # systems in a file of a loop-shaping design
ROUNDING = 1e-12  # relative agreement of a controller in a file with the product of its parts
INFINITE = 1e6  # a continuous peak so many times faster than every pole is one of the direct term
REMEASURE = 1e-5  # relative agreement of the norm in a file with the norm measured when it is read
POLES = 1e-3  # likewise of the spectral radius, to the largest pole: fivefold poles move so far between two machines
UNKNOWN = "not known: the plant remembers none that was sampled; build it in continuous time, then c2d(P, h)"
UNSEALED = "read from a file of format version {}, which has no sha256 of all of it; the norm was measured again"


@dataclass(frozen=True, eq=False)
class Shaping:
    """The parts of a loop-shaping controller W1 Ks W2 for G: Ks is the controller of the shaped plant W2 G W1."""

    W1: StateSpace
    W2: StateSpace
    Ks: StateSpace

    @property
    def controller(self) -> StateSpace:
        """W1 Ks W2, with the states of W2, Ks and W1 in this order."""
        return series(series(self.W2, self.Ks), self.W1)


@dataclass(frozen=True, eq=False)
class Design:
    """A verified controller. Unpacks as ``K, CL, gamma, info`` with `control.StateSpace` objects."""

    plant: GeneralizedPlant
    controller: StateSpace  # u = K y, positive feedback
    closed_loop: StateSpace  # w -> z
    gamma: float  # H-infinity norm of the closed loop, by two independent methods; of `sdhinfsyn` between samples too
    info: Info
    shaping: Shaping | None = None  # of a loop-shaping design, whose Ks (not `controller`) closes `plant`

    @property
    def verified_norm(self) -> float:
        """`gamma` by the name that says how it came about."""
        return self.gamma

    @property
    def closing(self) -> StateSpace:
        """The controller that closes `plant`, u = K y: `controller`, or Ks of a loop-shaping design."""
        return self.shaping.Ks if self.shaping else self.controller

    @property
    def convention(self) -> str:
        """What `controller` reads, and with which sign: an error "e = r - y, u = K e", or the measured output."""
        return sign(self.plant.y, shaped=self.shaping is not None)

    @property
    def K(self) -> control.StateSpace:
        """The controller as a `control.StateSpace`, with the plant's y and u as signal names."""
        K = self.controller.to_control()
        if self.shaping is None:  # else y and u are those of the shaped plant
            K.input_labels, K.output_labels = list(self.plant.y), list(self.plant.u)
        return K

    @property
    def CL(self) -> control.StateSpace:
        """The closed loop as a `control.StateSpace`, with the plant's w and z as signal names."""
        CL = self.closed_loop.to_control()
        CL.input_labels, CL.output_labels = list(self.plant.w), list(self.plant.z)
        return CL

    def __iter__(self) -> Iterator[Any]:
        """K, CL, gamma, info."""
        return iter((self.K, self.CL, self.gamma, self.info))

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Any:
        """K, CL, gamma, info by their number."""
        return tuple(self)[i]

    def __repr__(self) -> str:
        n, nu, ny = self.plant.sizes[0], self.controller.ny, self.controller.nu
        dt = timebase_told(self.plant.dt)
        return printable(
            f"Design(order {self.controller.n} controller, {ny} measurements, {nu} controls, {dt}; plant order {n}\n"
            f"       gamma {self.gamma:.7g}, the verified norm{self._where}, at {self.info.frequency:.4g} rad/s"
            f"{self._claim}, method {self.info.method!r}, {self.info.seconds:.2f} s"
            + (f"\n       between the samples: {self._between.upper:.7g}" if self._between else "")
            + (f"\n       margins: {words(self.margins)}" if self.margins else "")
            + "".join(f"\n       warning: {text}" for text in self.warnings)
            + ")"
        )

    @property
    def _where(self) -> str:
        return " between the samples too" if self.info.method == SAMPLED else ""

    @property
    def _between(self) -> SampledNorm | None:
        """The norm between the samples, where it is known and another than `gamma`."""
        return None if self._where else self.intersample

    @cached_property
    def intersample(self) -> SampledNorm | None:
        """Bounds of the norm between the samples too, of a plant that `c2d` sampled; a w that reaches y is held.

        None where the plant remembers no continuous one, and where doubles cannot tell.
        """
        return intersample(self.plant, self.closing)

    @property
    def _claim(self) -> str:
        return "" if self.info.optimum is None else f" (optimum {self.info.optimum:.7g} by the solver)"

    @cached_property
    def margins(self) -> Margins | None:
        """Margins of the loop of controller and plant, u = K y; None where double precision cannot tell them."""
        G, (_, nw, _, nz, _) = self.plant.system, self.plant.sizes
        G = StateSpace(G.A, G.B[:, nw:], G.C[nz:], G.D[nz:, nw:], G.dt)
        try:
            return margins(G, self.closing, sign=1)
        except (SynthError, np.linalg.LinAlgError):
            return None

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What must be known before this controller is used: of the search, of the margins, of the weights."""
        floor = () if self.shaping else floored(self.plant, self.gamma)
        return (*self.info.warnings, *poor(self.margins), *between(self._between, self.gamma), *floor)

    @property
    def facts(self) -> dict[str, str]:
        """The design at a glance, in words: what a card or a table shows of it."""
        facts = {"order": f"{self.controller.n} (plant {self.plant.sizes[0]})"}
        facts |= {"sampling time": timebase_told(self.plant.dt).removeprefix("dt = ")}
        if self.plant.delay:
            facts |= {"delay of the hold": f"{self.plant.delay:.6g} s"}
        facts |= {f"verified norm{self._where}": f"{self.gamma:.7g}"}
        if self._between:
            facts |= {"norm between the samples": f"{self._between.upper:.7g}"}
        elif self.plant.dt and self.intersample is None:
            facts |= {"norm between the samples": UNKNOWN}
        if self.info.optimum is not None:
            facts |= {"optimum claimed": f"{self.info.optimum:.7g}"}
        beyond = not self.plant.dt and self.info.frequency > INFINITE * np.abs(self.closed_loop.poles()).max(initial=0)
        facts |= {"peak at": "infinity" if beyond else f"{self.info.frequency:.4g} rad/s", "method": self.info.method}
        if self.info.shifted_norm is not None:
            facts |= {
                "shift of the axis": f"{self.info.shift:g} rad/s",
                "shifted norm": f"{self.info.shifted_norm:.7g}",
            }
        if self.margins is not None:
            facts |= {"margins": words(self.margins)}
        if np.isfinite(self.info.slowest):  # else unknown, or there are no poles
            facts |= {"slowest pole": f"{self.info.slowest:.4g} rad/s"}
        if self.warnings:
            facts |= {"warnings": "; ".join(self.warnings)}
        return facts | {"plant sha256": self.plant.system.digest()[:16]}

    def _repr_html_(self) -> str:
        """For notebooks."""
        facts = {html.escape(key): html.escape(printable(value)) for key, value in self.facts.items()}
        rows = "".join(f"<tr><th>{key}</th><td>{value}</td></tr>" for key, value in facts.items())
        return f"<table>{rows}</table>"

    def plot(self, ax: Any = None, **style: Any) -> Any:
        """Singular values of closed loop and controller against frequency; see `synth.delivery.plots.design_plot`."""
        from synth.delivery.plots import design_plot

        return design_plot(self, ax, **style)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write to `path`: ``.json`` (master format, read back by `load`) or ``.mat`` (MATLAB and Octave).

        The file appears whole or not at all.

        Raises
        ------
        ModelError : the file name ends otherwise.
        """
        path = as_path("path", path)
        if path.suffix == ".json":
            return write_atomically(path, json_bytes(self))
        if path.suffix == ".mat":
            from synth.delivery.matlab import mat_bytes

            return write_atomically(path, mat_bytes(self))
        raise ModelError(f"path ends with {path.suffix!r}; a design is saved as .json or .mat")

    def as_controller(self) -> LinearController:
        """What a simulated loop steps, u = K (r - y) of the plant's output y: the design as it closes the loop.

        A loop-shaping design has u = K y, so its controller is negated; one whose measurements are named as errors, by
        `GeneralizedPlant.tracking` or `mixsyn`, is taken as it is.

        Raises
        ------
        ModelError : a continuous controller; another design, which does not say whether it measures an error.
        """
        from synth.regulators.controller import LinearController

        if self.shaping is not None:
            K = self.controller
            return LinearController.of(StateSpace(K.A, K.B, -K.C, -K.D, K.dt))
        if self.convention != ERROR:
            raise ModelError(
                f"the design measures {', '.join(self.plant.y)}, and whether that is r - y or y only you know: give "
                "the loop LinearController.of(K), which steps u = K (r - y), with the sign that closes it"
            )
        return LinearController.of(self.controller)

    def certify(
        self,
        *,
        lower: float | None = None,
        upper: float | None = None,
        intersample: float | None = None,
        delay: float | None = None,
    ) -> Certificate:
        """Prove the bounds of the norm in ball arithmetic; see `synth.proof.certify.certify`."""
        from synth.proof.certify import certify

        return certify(self, lower=lower, upper=upper, intersample=intersample, delay=delay)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Design:
        """Read a ``.json`` file, close the loop again and measure it.

        Raises
        ------
        ModelError : the file is no design, is incomplete, or was changed since it was written; the fields are named.
        VerificationError : the loop is unstable, or its norm or spectral radius is not the one in the file.
        """
        path = as_path("path", path)
        try:
            data = read_json(path)
        except ModelError as error:
            raise ModelError(f"path {path.name!r}: {error}; pass a file written by Design.save") from None
        return from_dict(data)


def to_dict(design: Design, certificate: str = "") -> dict[str, Any]:
    """The design as plain data, complete and exact, with a sha256 of all of it and of its parts.

    `certificate` is what was proved of it, in words, for whoever reads the file.
    """
    data = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "convention": f"{design.convention}; x+ = A x + B y, u = C x + D y (dt > 0) or its continuous counterpart; "
        f"{sampling(design.plant.dt)}",
        "controller": _system_to_dict(design.controller),
        "dt": design.plant.dt,
        "gamma": design.gamma,
        "verified_norm": design.verified_norm,
        "plant": plantdata.to_dict(design.plant),
        "plant_sha256": design.plant.system.digest(),
        "info": infos.to_dict(design.info),
    }
    if design.shaping is not None:
        data["shaping"] = {name: _system_to_dict(getattr(design.shaping, name)) for name in SHAPING}
    if certificate:
        data["certificate"] = certificate
    return sealed_by_parts(data)


def json_bytes(design: Design, certificate: str = "") -> bytes:
    """The content of the .json file."""
    return json.dumps(to_dict(design, certificate), indent=1, allow_nan=False).encode()


def _system_to_dict(G: StateSpace) -> dict[str, Any]:
    return {name: getattr(G, name).tolist() for name in "ABCD"}


def _system_from_dict(name: str, data: Any, dt: Any) -> StateSpace:
    try:
        return StateSpace(**data, dt=dt)
    except ModelError as error:
        raise ModelError(f"the design is incomplete or damaged: {name}: {error}") from None


def from_dict(data: Any) -> Design:
    """The inverse of `to_dict`, checked."""
    from synth import mistakes, schemas

    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ModelError(f"the data is no design: its format is not {FORMAT!r}; pass what Design.save wrote")
    version = data.get("format_version")
    if type(version) is not int or not 1 <= version <= FORMAT_VERSION:
        raise ModelError(
            f"format_version is {version!r}, this release reads 1 to {FORMAT_VERSION}; "
            "read the file with the release that wrote it"
        )
    if version == FORMAT_VERSION:
        check_seal(data)
    elif seals := sorted({SEAL, PARTS} & data.keys()):
        raise ModelError(f"the design has {', '.join(seals)}, which no design of format version {version} has")
    if version == 1:
        data = _of_version_1(data)
    kind = schemas.SealedDesign if version == FORMAT_VERSION else schemas.Design
    mistakes.check(kind, data, "the design is incomplete or damaged")
    try:
        if plantdata.of_samples(data["plant"]).system.digest() != data["plant_sha256"]:
            raise ModelError("its sha256 is not the plant_sha256 in the file: one of them was changed")
        plant = plantdata.from_dict(data["plant"])
    except ModelError as error:
        raise ModelError(f"the design is incomplete or damaged: plant: {error}") from None
    controller = _system_from_dict("controller", data["controller"], data["dt"])
    info = infos.from_dict(data["info"])
    parts, dt = data.get("shaping"), data["dt"]
    shaping = None if parts is None else Shaping(*(_system_from_dict(k, parts[k], dt) for k in SHAPING))
    gamma, norm = data["gamma"], data["verified_norm"]
    if shaping and not _equal(shaping.controller, controller):
        raise ModelError("controller is not the W1 Ks W2 of the shaping in the file: one of them was changed")
    closed_loop, measured = judge(plant, shaping.Ks if shaping else controller)
    found = measured.norm
    if info.method == SAMPLED:
        if (between_samples := intersample(plant, controller)) is None:
            raise ModelError("the design is incomplete or damaged: it has no continuous plant, of which its norm is")
        found = between_samples.upper
    for name, claimed in (("gamma", gamma), ("verified_norm", norm)):
        if not abs(found - claimed) <= REMEASURE * claimed + measured.rounding:
            raise VerificationError(f"the file claims a norm of {claimed:.9g} ({name}), measured is {found:.9g}")
    radius = measured.spectral_radius
    if radius != info.spectral_radius and not (
        abs(radius - info.spectral_radius) <= POLES * np.abs(measured.poles).max(initial=0.0)
    ):
        raise VerificationError(f"info.spectral_radius is {info.spectral_radius:.9g}, measured is {radius:.9g}")
    if version != FORMAT_VERSION:
        info = replace(info, warnings=(*info.warnings, UNSEALED.format(version)))
    return Design(plant, controller, closed_loop, gamma, info, shaping)


def _of_version_1(data: Mapping[str, Any]) -> dict[str, Any]:
    """A file of version 1, in which `gamma` was the solver's claim, or the level that was asked for."""
    info = data.get("info")
    if not isinstance(info, dict) or not {"gamma", "verified_norm"} <= data.keys():
        return dict(data)  # whose mistakes are told together
    own = {key: value for key, value in info.items() if key != "gamma_min"}
    optimum = info.get("gamma_min") if data.get("shaping") is not None else data["gamma"]
    return {**data, "gamma": data["verified_norm"], "info": own | {"optimum": optimum, "slowest": "nan"}}


def _equal(G: StateSpace, H: StateSpace) -> bool:
    """Equal up to the rounding of a matrix product on another machine."""

    def close(M: np.ndarray, N: np.ndarray) -> bool:
        with np.errstate(over="ignore"):  # huge entries of a forged file
            return M.shape == N.shape and bool(np.abs(M - N).max(initial=0.0) <= ROUNDING * np.abs(N).max(initial=0.0))

    return all(close(getattr(G, name), getattr(H, name)) for name in "ABCD")
