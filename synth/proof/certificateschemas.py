"""What the files of certificates hold, as `synth.schemas` says of the others.

Importing this takes a tenth of a second: readers do it when they read.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from synth.mistakes import Record
from synth.schemas import Bits, Matrix, NotNegative, Plant, Positive, Row, TimedSystem


def _end(value: Any) -> str:
    keys = value if isinstance(value, dict) else ()
    return "<coupling>" if "shift" in keys else "<fall>" if "v" in keys else "<impulse>"


class UpperWitness(Record):
    """See `synth.proof.balls`."""

    T: Matrix
    U: Matrix
    rest: Matrix = []  # not in version 1, as below
    factor: Matrix
    rate: float


class Step(Record):
    """See `synth.proof.balls`."""

    F: Matrix
    X: Matrix
    rest: Matrix = []
    before: Matrix
    after: Matrix


class Coupling(Record):
    """See `synth.proof.balls`."""

    v: Row
    shift: float
    factor: Matrix


class Fall(Record):
    """See `synth.proof.balls`."""

    v: Row
    dual: bool


class Impulse(Record):
    """See `synth.proof.balls`."""

    w: Row
    dual: bool
    factor: Matrix


class LowerWitness(Record):
    """See `synth.proof.balls`."""

    T: Matrix
    w: float
    z: float
    rate: float
    control: Annotated[list[Step], Field(fail_fast=True)]
    estimation: Annotated[list[Step], Field(fail_fast=True)]
    end: Annotated[
        Annotated[Coupling, Tag("<coupling>")] | Annotated[Fall, Tag("<fall>")] | Annotated[Impulse, Tag("<impulse>")],
        Discriminator(_end),
    ]
    doubled: Annotated[list[Annotated[int, Field(ge=0, le=64)]], Field(min_length=2, max_length=2)] = [0, 0]


class Certificate(Record):
    """`synth.proof.certify`, format version 1."""

    format: Literal["convex-synth certificate"]
    format_version: int
    statement: str = ""
    lower: float
    upper: float
    bits: Bits
    plant_sha256: str
    controller_sha256: str
    seconds: float
    note: str
    upper_witness: UpperWitness
    lower_witness: LowerWitness | None


class Intersample(UpperWitness):
    """See `synth.proof.intersample`."""

    upper: Positive
    delay: NotNegative
    samples: Annotated[int, Field(ge=0, le=5000)]
    held: Annotated[list[Annotated[int, Field(ge=0, le=10**6)]], Field(fail_fast=True)]
    bits: Bits
    states: Matrix
    constants: Row
    plant: Plant


class SealedCertificate(Certificate):
    """Format versions 2 and 3, which can be proved from their file alone."""

    plant: Plant
    controller: TimedSystem
    intersample: Intersample | None = None  # not in version 2
    sha256: str
