"""What the files of this package hold, a class for each format: kinds, bounds and names, not what they mean together.

Importing this takes a tenth of a second: readers do it when they read, and check with `synth.mistakes`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag

from synth.mistakes import Record


def _is_flag(value: Any) -> str:
    return "<flag>" if value is True else "<number>"


def _is_word(value: Any) -> str:
    return "<word>" if isinstance(value, str) else "<number>"


NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Bits = Annotated[int, Field(ge=53, le=4096)]
Row = Annotated[list[float], Field(fail_fast=True)]
Matrix = Annotated[list[Row], Field(fail_fast=True)]
Entries = Annotated[list[Annotated[list[Any], Field(fail_fast=True)]], Field(fail_fast=True)]
Names = Annotated[list[str], Field(fail_fast=True)]
Limits = Annotated[list[float | None], Field(fail_fast=True)]
Flag = Annotated[Literal[True], Tag("<flag>")]  # tags are what no key of a file is
Word = Annotated[Literal["inf", "-inf", "nan"], Tag("<word>")]  # numbers that JSON has no word for
Timebase = Annotated[Flag | Annotated[NotNegative, Tag("<number>")], Discriminator(_is_flag)]
Measured = Annotated[Word | Annotated[float, Tag("<number>")], Discriminator(_is_word)]
Size = Annotated[Word | Annotated[NotNegative, Tag("<number>")], Discriminator(_is_word)]


class System(Record):
    """Matrices of a system."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


class TimedSystem(System):
    """A system that says its timebase."""

    dt: Timebase


class Plant(Record):
    """Matrices of a generalised plant."""

    A: Matrix
    B1: Matrix
    B2: Matrix
    C1: Matrix
    D11: Matrix
    D12: Matrix
    C2: Matrix
    D21: Matrix
    D22: Matrix
    dt: Timebase


class NamedPlant(Plant):
    """The same with the names and units of its channels."""

    w: Names = []
    u: Names = []
    z: Names = []
    y: Names = []
    units: dict[str, str] = {}
    continuous: NamedPlant | None = None  # that it was sampled from
    delay: NotNegative = 0.0
    held: Names = []


class Info(Record):
    """How a design came about; see `synth.synthesis.info.Info`."""

    method: str
    status: str
    level: Size
    optimum: Size | None
    spectral_radius: Measured
    slowest: Measured
    frequency: Size
    seconds: Size
    solver: str
    tolerance: Size
    failures: dict[str, str]
    versions: dict[str, str]
    date: str
    warnings: Names = []
    shift: Size = 0.0
    shifted_norm: Size | None = None


class Shaping(Record):
    """Parts of a loop-shaping controller."""

    W1: System
    W2: System
    Ks: System


class Design(Record):
    """`synth.synthesis.design`, format version 2; version 1 is brought to it first."""

    format: Literal["convex-synth design"]
    format_version: int
    convention: str = ""
    controller: System
    dt: Timebase
    gamma: float
    verified_norm: float
    plant: NamedPlant
    plant_sha256: str
    info: Info
    shaping: Shaping | None = None
    certificate: str = ""


class SealedDesign(Design):
    """Format version 3."""

    sha256: str
    parts_sha256: dict[str, str]


class _Signals(Record):
    """The head of the files of systems, and what their signals are called."""

    format: str
    format_version: float
    u: Names = []
    y: Names = []
    units: dict[str, str] = {}
    description: str = ""
    delay: Any = 0.0  # s, a number or one for each input, which `input_delay` checks


class SystemFile(TimedSystem, _Signals):
    """A plant or controller in matrices."""


class PolynomialFile(_Signals):
    """A transfer matrix, whose nesting `synth.system` checks."""

    dt: Timebase
    num: Any
    den: Any


class RootsFile(_Signals):
    """Zeros, poles and gain of one channel, complex ones as texts."""

    dt: Timebase
    zeros: Any
    poles: Any
    gain: float


class PlantFile(NamedPlant):
    """A generalised plant."""

    format: str
    format_version: float
    description: str = ""


class ControllerFile(SystemFile):
    """A controller as `export` writes it, with limits or without; facts about it are texts."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, str]
    sha256: str = ""  # both not in version 1
    parts_sha256: dict[str, str] = {}
    L: Matrix | None = None
    umin: Limits | None = None
    umax: Limits | None = None


class Parameter(Record):
    """See `synth.systems.parameters`."""

    name: str
    nominal: float
    low: float
    high: float


class Remainder(Record):
    """What an entry of a hold equivalent is off its polynomial at most."""

    name: str
    at: Annotated[list[Annotated[int, Field(ge=0, le=1000)]], Field(min_length=2, max_length=2)]
    size: Positive


class Hold(Record):
    """A plant whose hold equivalent stands in a sampled system; see `synth.systems.polynomialholds`."""

    name: str
    E: Entries
    A: Entries
    dt: Positive
    tol: Positive
    parameters: Annotated[list[Parameter], Field(max_length=20)]
    remainders: list[Remainder]


class UncertainSystem(Record):
    """See `synth.systems.uncertain`; entries are numbers, or lists of coefficients with powers of parameters."""

    parameters: Annotated[list[Parameter], Field(max_length=20)]
    E: Entries
    A: Entries
    B: Entries
    C: Entries
    D: Entries
    dt: Timebase
    u: Names
    y: Names
    holds: Annotated[list[Hold], Field(max_length=20)] = []


class BoxCertificate(Record):
    """`synth.proof.boxcertificate`, format version 1."""

    format: Literal["convex-synth box certificate"]
    format_version: Literal[1]
    statement: str
    quantity: Literal["gain", "stability"]
    level: Positive
    reached: float | None
    point: dict[str, float]
    w: NotNegative
    bits: Bits
    system: UncertainSystem
    edges: Annotated[list[Positive], Field(min_length=2, max_length=1000, fail_fast=True)]
    script: Annotated[list[str], Field(fail_fast=True)]
    degrees: Annotated[list[Annotated[int, Field(ge=1, le=40)]], Field(max_length=20)] = []
    sha256: str


class MpcSettings(Record):
    """Weights, horizons and limits of a predictive controller; null where there is no limit."""

    Q: Matrix
    R: Matrix
    terminal: Matrix
    umin: Limits
    umax: Limits
    ymin: Limits
    ymax: Limits
    hmax: Limits
    Np: Positive
    Nc: Positive
    delay: NotNegative
    penalty: NotNegative


class Program(Record):
    """A quadratic program in parameters."""

    P: Matrix
    A: Matrix
    lower: Limits
    offset: Limits
    slope: Matrix


class MpcFile(Record):
    """`synth.delivery.qp`, format version 1."""

    format: Literal["convex-synth mpc"]
    format_version: float
    form: Literal["velocity", "position"]
    convention: str = ""  # these six not in files of older releases
    sampling: str = ""
    limits: str = ""
    y: Names = []
    u: Names = []
    units: dict[str, str] = {}
    dt: Positive
    model: System
    model_sha256: str
    settings: MpcSettings
    unit: Row
    parameters: dict[str, Row]
    qp: Program
    versions: str
    date: str


class SealedMpcFile(MpcFile):
    """Format version 2."""

    sha256: str
    parts_sha256: dict[str, str]


class Signature(Record):
    """`synth.delivery.signatures`: of the file beside it."""

    format: Literal["convex-synth signature"]
    format_version: Literal[1]
    sha256: str  # of the signed file
    key: str  # fingerprint of the public key
    signature: str  # base64
