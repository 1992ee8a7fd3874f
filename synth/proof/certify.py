"""Certificates: both bounds of an H-infinity design, proved.

A design is verified when two floating-point methods agree on its norm, and "optimal" is what a solver says. Here both
are proved in ball arithmetic (`balls`), the plant's and the controller's data taken as the exact doubles they are:

    upper   the controller stabilises the plant and the norm is below this
    lower   no controller of any order reaches a norm below this

and of a sampled plant that remembers the continuous one a third (`intersample`): the norm between the samples too.

Witnesses are found in floating-point arithmetic (`upper`, `lower`), which needs no rigour. The certificate holds them
to the last bit, and the plant and the controller too, so that both bounds can be proved again from its file alone, in
ball arithmetic and without a solver. The file is taken only as it was written, byte for byte of its data.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from synth.analysis.norms import judge
from synth.analysis.sampleddata import remembered
from synth.checks import as_number, as_path, as_whole, shown
from synth.errors import ModelError, VerificationError
from synth.files import SEAL, read_json, sealed, write_atomically
from synth.proof import balls
from synth.proof.balls import Coupling, Fall, Impulse, LowerWitness, Step, UpperWitness
from synth.proof.intersample import MARGINS, Intersample, prove
from synth.proof.lower import find_lower
from synth.proof.upper import find_upper
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

FORMAT = "convex-synth certificate"
FORMAT_VERSION = 3  # 2 where nothing is said of what is between samples
BITS = 128
MORE = 4  # times as many where that is not enough
MAX_BITS = 4096  # accepted from a file
TEN = (*balls.NINE, "dt")
FOUR = ("A", "B", "C", "D", "dt")
FACTORS = ("before", "after")  # of a step
TIGHT = 1e-4  # gap from which on no more bits are tried


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
    plant: GeneralizedPlant | None = None  # None in files of version 1
    controller: StateSpace | None = None  # likewise; that which closes the plant, u = K y
    intersample: Intersample | None = None  # of a sampled plant that remembers the continuous one

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
            + (f"; {self.intersample.statement}" if self.intersample else "")
        )

    @property
    def sha256(self) -> str:
        """Of all that its file holds, as the file itself says it."""
        return to_dict(self)[SEAL]

    def check(self, plant: GeneralizedPlant | None = None, controller: StateSpace | None = None) -> None:
        """Prove all bounds again, from the witnesses alone.

        Parameters
        ----------
        plant, controller : those that the certificate must be of; its own when left out

        Raises
        ------
        ModelError : there is none to check with, as in files of version 1.
        VerificationError : the certificate is of another plant or controller, or a proof does not hold.
        """
        plant, controller = plant or self.plant, controller or self.controller
        if plant is None or controller is None:
            raise ModelError("the certificate holds no plant and controller (version 1); pass those of the design")
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
        if self.intersample is None:
            return
        origin = plant.continuous
        if origin is not None and origin.system.digest() != self.intersample.plant.system.digest():
            raise VerificationError("the certificate is of another continuous plant between the samples")
        if controller.dt != plant.dt or not self.intersample.is_proved(controller):
            raise VerificationError(
                f"the witness does not prove that the norm between the samples is below {self.intersample.upper!r}"
            )

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write to `path`, a ``.json`` file with every bit of the witnesses.

        Raises
        ------
        ModelError : the file name ends otherwise.
        """
        path = as_path("path", path)
        if path.suffix != ".json":
            raise ModelError(f"path ends with {path.suffix!r}; a certificate is saved as .json")
        if self.plant is None or self.controller is None:
            raise ModelError("the certificate holds no plant and controller (version 1); certify the design again")
        return write_atomically(path, _text(to_dict(self)).encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Certificate:
        """Read what `save` wrote. Nothing is proved by reading: call `check`.

        Raises
        ------
        ModelError : the file is no certificate or is incomplete.
        """
        return from_dict(_read(as_path("path", path)))


def to_dict(certificate: Certificate) -> dict[str, Any]:
    """The certificate as plain data, complete and exact, with a sha256 of all of it."""
    data = asdict(replace(certificate, plant=None, controller=None, intersample=None))
    P, K, between = certificate.plant, certificate.controller, certificate.intersample
    del data["intersample"]
    data |= {"plant": {name: getattr(P, name) for name in TEN} if P else None}
    data |= {"controller": {name: getattr(K, name) for name in FOUR} if K else None}
    if between:
        own = {name: value for name, value in vars(between).items() if name != "witness"} | vars(between.witness)
        data |= {"intersample": own | {"plant": {name: getattr(between.plant, name) for name in TEN}}}
    head = {"format": FORMAT, "format_version": FORMAT_VERSION if between else 2, "statement": certificate.statement}
    return sealed(json.loads(_text({**head, **data})))


def _text(data: dict[str, Any]) -> str:
    return json.dumps(data, allow_nan=False, default=np.ndarray.tolist)


def from_dict(data: Any) -> Certificate:
    """The certificate in a file.

    Raises
    ------
    ModelError : the data is no certificate, is incomplete, or is not what `to_dict` made.
    """
    from synth import mistakes
    from synth.proof import certificateschemas as schemas

    version = data.get("format_version") if isinstance(data, dict) and data.get("format") == FORMAT else None
    if type(version) is not int or not 1 <= version <= FORMAT_VERSION:
        raise ModelError(
            f"the data is no certificate of format 1 to {FORMAT_VERSION}; pass what Certificate.save wrote"
        )
    kind = schemas.Certificate if version == 1 else schemas.SealedCertificate
    mistakes.check(kind, data, "the certificate is incomplete or damaged")
    try:
        certificate = Certificate(
            lower=float(data["lower"]),
            upper=float(data["upper"]),
            bits=data["bits"],
            plant_sha256=data["plant_sha256"],
            controller_sha256=data["controller_sha256"],
            seconds=float(data["seconds"]),
            note=data["note"],
            upper_witness=_upper_from_dict(data["upper_witness"]),
            lower_witness=_lower_from_dict(data["lower_witness"]) if data["lower_witness"] else None,
            plant=None if version == 1 else GeneralizedPlant(**data["plant"]),
            controller=None if version == 1 else StateSpace(**data["controller"]),
            intersample=_intersample_from_dict(data["intersample"]) if data.get("intersample") else None,
        )
    except ValueError as error:  # rows of different length
        raise ModelError(f"the certificate is incomplete or damaged: {error}") from None
    if version != 1 and _text(to_dict(certificate)) != _text(data):
        raise ModelError("the certificate is not as Certificate.save wrote it: something in it was changed")
    return certificate


def _upper_from_dict(data: Any) -> UpperWitness:
    T, U, factor = (as_doubles(data, key) for key in ("T", "U", "factor"))
    return UpperWitness(T, U, as_doubles(data, "rest", like=T), factor, float(data["rate"]))


def _lower_from_dict(data: Any) -> LowerWitness:
    end = data["end"]
    if "shift" in end:
        last = Coupling(as_doubles(end, "v", 1), float(end["shift"]), as_doubles(end, "factor"))
    elif "v" in end:
        last = Fall(as_doubles(end, "v", 1), end["dual"])
    else:
        last = Impulse(as_doubles(end, "w", 1), end["dual"], as_doubles(end, "factor"))
    return LowerWitness(
        T=as_doubles(data, "T"),
        w=float(data["w"]),
        z=float(data["z"]),
        rate=float(data["rate"]),
        control=tuple(_step_from_dict(step) for step in data["control"]),
        estimation=tuple(_step_from_dict(step) for step in data["estimation"]),
        end=last,
        doubled=tuple(data.get("doubled", (0, 0))),
    )


def _step_from_dict(data: Any) -> Step:
    X = as_doubles(data, "X")
    return Step(as_doubles(data, "F"), X, as_doubles(data, "rest", like=X), *(as_doubles(data, k) for k in FACTORS))


def _intersample_from_dict(data: Any) -> Intersample:
    return Intersample(
        upper=float(data["upper"]),
        delay=float(data["delay"]),
        samples=data["samples"],
        held=tuple(data["held"]),
        bits=data["bits"],
        states=as_doubles(data, "states"),
        constants=as_doubles(data, "constants", 1),
        witness=_upper_from_dict(data),
        plant=GeneralizedPlant(**data["plant"]),
    )


def as_doubles(data: Any, key: str, ndim: int = 2, like: np.ndarray | None = None) -> np.ndarray:
    """A vector or matrix of doubles from a file; zeros `like` another one where version 1 has none."""
    if like is not None and key not in data:
        return np.zeros_like(like)
    M = np.array(data[key], float)
    M = np.zeros((0,) * ndim) if M.size == 0 else M
    if M.ndim != ndim:
        raise ValueError(f"{key} has {M.ndim} dimensions where {ndim} are needed")
    return M


def _read(path: Path) -> Any:
    try:
        return read_json(path)
    except ModelError as error:
        raise ModelError(f"path {path.name!r}: {error}; pass what Certificate.save wrote") from None


def certify(
    design: Designed,
    *,
    lower: float | None = None,
    upper: float | None = None,
    intersample: float | None = None,
    delay: float | None = None,
    bits: int = BITS,
) -> Certificate:
    """Prove the bounds of an H-infinity design in ball arithmetic.

    Parameters
    ----------
    design : of a discrete or continuous plant; of a loop-shaping design the shaped plant and Ks are certified
    lower, upper : levels to prove; when left out the tightest of a few near the optimum and the verified norm
    intersample : likewise of the norm between the samples, of a plant that `c2d` sampled and that remembers the
        continuous one; a w that reaches a sampler is held
    delay : s from the sample to the new value of the hold, which `intersample` takes in; that of the plant when left
        out
    bits : precision of the ball arithmetic, which is made four times as much where that is not enough

    Returns
    -------
    Certificate : with `lower` 0, and what is known of the reason in `note`, where no lower bound was proved: the
        optimum is zero, or the plant has a zero on the stability boundary, or simply none was found.

    Raises
    ------
    ModelError : `design` is none, a level is no positive number, `bits` is not between 53 and 4096, or the plant has no
        states; `intersample` or `delay` of a plant that remembers no continuous one.
    VerificationError : an upper bound, or a lower bound that was asked for, was not proved.

    References
    ----------
    Rump (2006), BIT 46, 433; Lanzon, Feng, Anderson and Rotkowitz (2008), IEEE TAC 53, 2280; the proofs are in
    `synth.proof.balls` and `synth.proof.intersample`.
    """
    started = time.perf_counter()
    if not all(hasattr(design, name) for name in ("plant", "gamma", "closing")):
        raise ModelError(f"design is {shown(design)}; pass what hinfsyn or another synthesis returned")
    if lower is not None:
        lower = as_number("lower", lower, "a positive level to prove that nothing reaches it", above=0)
    if upper is not None:
        upper = as_number("upper", upper, "a positive level to prove the controller below", above=0)
    if intersample is not None:
        intersample = as_number("intersample", intersample, "a positive level to prove between the samples", above=0)
    bits = as_whole("bits", bits, f"a precision from 53 to {MAX_BITS}", least=53, most=MAX_BITS)
    precisions = (bits, min(MORE * bits, MAX_BITS))
    P, K = design.plant, design.closing
    if not len(P.A):
        raise ModelError("the plant has no states, and its optimum is in closed form; certify proves levels of loops")
    between = _between(P, K, intersample, delay, precisions)
    norm = design.gamma if between is None else judge(P, K)[1].norm  # of `sdhinfsyn` gamma is that between the samples
    levels = [upper] if upper is not None else [norm * (1 + m) for m in MARGINS]
    attempts = ((g, b, find_upper(P, K, g, b)) for g in levels for b in precisions)
    above = next(((g, b, found) for g, b, found in attempts if found), None)
    if above is None:
        raise VerificationError(f"it was not proved that the norm is below {levels[-1]:.9g}")
    below, note, used = None, "", bits
    for more in precisions:
        found, reason = find_lower(P, above[0], lower, more)
        if found is not None and (below is None or found[0] > below[0]):
            below, note, used = found, "", more
        elif below is None:
            note = reason
        if below is not None and (lower is not None or above[0] < (1 + TIGHT) * below[0]):
            break
    if below is None and lower is not None:
        raise VerificationError(f"it was not proved that no controller reaches {lower:.9g}: {note}")
    certificate = Certificate(
        lower=below[0] if below else 0.0,
        upper=above[0],
        bits=max(above[1], used) if below else above[1],
        plant_sha256=P.system.digest(),
        controller_sha256=K.digest(),
        seconds=time.perf_counter() - started,
        note=note,
        upper_witness=above[2],
        lower_witness=below[1] if below else None,
        plant=P,
        controller=K,
        intersample=between,
    )
    if below and above[1] != used:  # one of them was proved with fewer bits
        certificate.check()
    return certificate


def _between(
    P: GeneralizedPlant, K: StateSpace, level: float | None, delay: float | None, precisions: tuple[int, ...]
) -> Intersample | None:
    """What is proved between the samples, None where nothing is known of them."""
    if delay is not None:
        delay = as_number("delay", delay, "a time in s from the sample to the new value of the hold, or None", least=0)
    found = remembered(P, P.delay if delay is None else delay)
    if found is not None:
        return prove(found[0], K, [] if level is None else [level], precisions, found[1])
    if level is not None or delay:
        raise ModelError(
            "intersample and delay are about a plant that remembers what c2d sampled, and this one does not: design "
            "for c2d(P, h) of the continuous GeneralizedPlant P"
        )
    return None
