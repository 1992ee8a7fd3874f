"""Certificates: both bounds of an H-infinity design, proved.

A design is verified when two floating-point methods agree on its norm, and "optimal" is what a solver says. Here both
are proved in ball arithmetic (`balls`), the plant's and the controller's data taken as the exact doubles they are:

    upper   the controller stabilises the plant and the norm is below this
    lower   no controller of any order reaches a norm below this

Witnesses are found in floating-point arithmetic (`witnesses`), which needs no rigour. The certificate holds them to
the last bit, so that both bounds can be proved again by ball products alone, without a solver.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from synth.checks import as_number, as_path
from synth.errors import ModelError, VerificationError
from synth.files import write_atomically
from synth.proof import balls
from synth.proof.balls import Coupling, Impulse, LowerWitness, Step, UpperWitness
from synth.proof.witnesses import find_lower, find_upper
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

FORMAT = "convex-synth certificate"
FORMAT_VERSION = 1
BITS = 128
MAX_BITS = 4096  # accepted from a file
MARGINS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # of the upper bound above the verified norm


class Designed(Protocol):
    """What is proved something about: a `Design`."""

    @property
    def plant(self) -> GeneralizedPlant:
        """What the controller closes."""
        ...

    @property
    def gamma(self) -> float:
        """The verified norm of the loop."""
        ...

    @property
    def closing(self) -> StateSpace:
        """The controller that closes the plant."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Certificate:
    """What was proved about one plant and one controller, with the witnesses to prove it again."""

    lower: float  # no controller of any order reaches a norm below this; 0 when nothing was proved
    upper: float  # the controller stabilises, and the closed loop's norm is below this
    bits: int  # precision of the ball arithmetic
    plant_sha256: str
    controller_sha256: str
    seconds: float  # wall time from call to proofs
    note: str  # why there is no lower bound; empty when there is one
    upper_witness: UpperWitness
    lower_witness: LowerWitness | None

    @property
    def gap(self) -> float:
        """Relative distance of the bounds, upper / lower - 1; infinite without a lower bound."""
        return self.upper / self.lower - 1 if self.lower > 0 else np.inf

    @property
    def statement(self) -> str:
        """What was proved, in words."""
        lower = f"no controller of any order reaches a norm below {self.lower!r}"
        return (
            f"Proved in {self.bits}-bit ball arithmetic, all data taken as exact doubles: the controller "
            f"stabilises the plant with an H-infinity norm below {self.upper!r}; "
            + (lower if self.lower_witness else f"no lower bound proved ({self.note})")
        )

    def check(self, plant: GeneralizedPlant, controller: StateSpace) -> None:
        """Prove both bounds again, from the witnesses alone.

        Raises
        ------
        VerificationError : the certificate is of another plant or controller, or a proof does not hold.
        """
        for name, system, digest in (
            ("plant", plant.system, self.plant_sha256),
            ("controller", controller, self.controller_sha256),
        ):
            if system.digest() != digest:
                raise VerificationError(f"the certificate is of another {name}: the sha256 differs")
        if not balls.proves_upper(plant, controller, self.upper_witness, self.upper, self.bits):
            raise VerificationError(f"the witness does not prove that the norm is below {self.upper!r}")
        if self.lower_witness is None:
            if self.lower != 0:
                raise VerificationError(f"the certificate claims a lower bound of {self.lower!r} without a witness")
        elif not balls.proves_lower(plant, self.lower_witness, self.lower, self.bits):
            raise VerificationError(f"the witness does not prove that no controller reaches {self.lower!r}")

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write to `path`, a ``.json`` file with every bit of the witnesses.

        Raises
        ------
        ModelError : the file name ends otherwise.
        """
        path = as_path("path", path)
        if path.suffix != ".json":
            raise ModelError(f"path ends with {path.suffix!r}; a certificate is saved as .json")
        data = {"format": FORMAT, "format_version": FORMAT_VERSION, "statement": self.statement, **asdict(self)}
        return write_atomically(path, json.dumps(data, allow_nan=False, default=np.ndarray.tolist).encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read what `save` wrote. Nothing is proved by reading: call `check`.

        Raises
        ------
        ModelError : the file is no certificate or is incomplete.
        """
        path = as_path("path", path)
        try:
            data = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ModelError(
                f"path {path.name!r} cannot be read ({error.strerror}); pass a file of Certificate.save"
            ) from None
        except (UnicodeDecodeError, json.JSONDecodeError) as error:
            raise ModelError(f"{path.name} is not JSON ({error}); pass what Certificate.save wrote") from None
        return from_dict(data)


def from_dict(data: Any) -> Certificate:
    """The certificate in a file."""
    if not isinstance(data, dict) or (data.get("format"), data.get("format_version")) != (FORMAT, FORMAT_VERSION):
        raise ModelError(f"the data is no certificate of format {FORMAT_VERSION}; pass what Certificate.save wrote")
    try:
        certificate = Certificate(
            lower=float(data["lower"]),
            upper=float(data["upper"]),
            bits=int(data["bits"]),
            plant_sha256=str(data["plant_sha256"]),
            controller_sha256=str(data["controller_sha256"]),
            seconds=float(data["seconds"]),
            note=str(data["note"]),
            upper_witness=_upper_from_dict(data["upper_witness"]),
            lower_witness=_lower_from_dict(data["lower_witness"]) if data["lower_witness"] else None,
        )
    except (KeyError, TypeError, ValueError) as error:
        raise ModelError(f"the certificate is incomplete or damaged: {error}") from None
    if not 53 <= certificate.bits <= MAX_BITS:
        raise ModelError(f"bits is {certificate.bits}; a certificate has 53 to {MAX_BITS}")
    return certificate


def _upper_from_dict(data: Any) -> UpperWitness:
    return UpperWitness(as_array(data, "T"), as_array(data, "U"), as_array(data, "factor"), float(data["rate"]))


def _lower_from_dict(data: Any) -> LowerWitness:
    end = data["end"]
    if "dual" in end:
        last = Impulse(as_array(end, "w", 1), bool(end["dual"]), as_array(end, "factor"))
    else:
        last = Coupling(as_array(end, "v", 1), float(end["shift"]), as_array(end, "factor"))
    return LowerWitness(
        T=as_array(data, "T"),
        w=float(data["w"]),
        z=float(data["z"]),
        rate=float(data["rate"]),
        control=tuple(_step_from_dict(step) for step in data["control"]),
        estimation=tuple(_step_from_dict(step) for step in data["estimation"]),
        end=last,
    )


def _step_from_dict(data: Any) -> Step:
    return Step(**{key: as_array(data, key) for key in ("F", "X", "before", "after")})


def as_array(data: Any, key: str, ndim: int = 2) -> np.ndarray:
    """A vector or matrix of doubles from a file."""
    M = np.array(data[key], float)
    M = np.zeros((0,) * ndim) if M.size == 0 else M
    if M.ndim != ndim:
        raise ValueError(f"{key} has {M.ndim} dimensions where {ndim} are needed")
    return M


def certify(
    design: Designed, *, lower: float | None = None, upper: float | None = None, bits: int = BITS
) -> Certificate:
    """Prove both bounds of an H-infinity design in ball arithmetic.

    Parameters
    ----------
    design : of a discrete or continuous plant; of a loop-shaping design the shaped plant and Ks are certified
    lower, upper : levels to prove; when left out the tightest of a few near the optimum and the verified norm
    bits : precision of the ball arithmetic

    Returns
    -------
    Certificate : with `lower` 0, and the reason in `note`, where the method proves no lower bound: the optimum is zero,
        or the plant has a zero on the stability boundary (in continuous time also D12 or D21 of deficient rank).

    Raises
    ------
    ModelError : a level that is no positive number, or a plant without states.
    VerificationError : the upper bound, or a lower bound that was asked for, was not proved.

    References
    ----------
    Rump (2006), BIT 46, 433; Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280; the proofs are in
    `synth.proof.balls`.
    """
    started = time.perf_counter()
    if lower is not None:
        lower = as_number("lower", lower, "a positive level to prove that nothing reaches it", above=0)
    if upper is not None:
        upper = as_number("upper", upper, "a positive level to prove the controller below", above=0)
    P, K = design.plant, design.closing
    if not len(P.A):
        raise ModelError("the plant has no states, and its optimum is in closed form; certify proves levels of loops")
    levels = [upper] if upper is not None else [design.gamma * (1 + m) for m in MARGINS]
    above = next(((g, found) for g in levels if (found := find_upper(P, K, g, bits))), None)
    if above is None:
        raise VerificationError(f"it was not proved that the norm is below {levels[-1]:.9g}")
    below, note = find_lower(P, above[0], lower, bits)
    if below is None and lower is not None:
        raise VerificationError(f"it was not proved that no controller reaches {lower:.9g}: {note}")
    return Certificate(
        lower=below[0] if below else 0.0,
        upper=above[0],
        bits=bits,
        plant_sha256=P.system.digest(),
        controller_sha256=K.digest(),
        seconds=time.perf_counter() - started,
        note=note,
        upper_witness=above[1],
        lower_witness=below[1] if below else None,
    )
