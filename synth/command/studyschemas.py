"""What the tables of a study file hold, a class for each; see `synth.command.specification` for what they mean."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Discriminator, Field, Tag

from synth.mistakes import Record
from synth.schemas import Matrix, Names, NotNegative, Positive


def _is_list(value: Any) -> str:
    return "<list>" if isinstance(value, list) else "<number>"


def _shape(value: Any) -> str:
    """A table, a number, or rows."""
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return "<table>" if isinstance(value, dict) else "<number>" if number else "<rows>"


def _weight(value: Any) -> str:
    keys = {*value} if isinstance(value, dict) else set()
    if keys & {*"ABCD"}:
        return "<system>"
    return "<fraction>" if keys & {"num", "den", "zeros", "poles", "gain"} else "<matrix>"


Finite = Annotated[float, Tag("<number>")]
Limit = Annotated[float, Field(allow_inf_nan=True)]
Limits = Annotated[Annotated[list[Limit], Tag("<list>")] | Annotated[Limit, Tag("<number>")], Discriminator(_is_list)]


class Diagonal(Record):
    """A diagonal matrix."""

    diag: Annotated[Annotated[list[float], Tag("<list>")] | Finite, Discriminator(_is_list)]


Grid = Annotated[
    Annotated[Diagonal, Tag("<table>")] | Finite | Annotated[Matrix, Tag("<rows>")], Discriminator(_shape)
]  # a matrix


class SystemWeight(Record):
    """A weight in matrices; those that are missing have a shape, which `specification` tells."""

    A: Grid | None = None
    B: Grid | None = None
    C: Grid | None = None
    D: Grid | None = None


class FractionWeight(Record):
    """A weight in polynomials, or in zeros, poles and gain; `synth.system` checks them."""

    num: Any = None
    den: Any = None
    zeros: Any = None
    poles: Any = None
    gain: Any = None


Weight = Annotated[
    Annotated[SystemWeight, Tag("<system>")]
    | Annotated[FractionWeight, Tag("<fraction>")]
    | Annotated[Grid, Tag("<matrix>")],
    Discriminator(_weight),
]


class File(Record):
    """The tables."""

    plant: dict[str, Any]
    synthesis: dict[str, Any]
    weights: dict[str, Any] = {}
    specifications: dict[str, Any] = {}


class _Plant(Record):
    """What every plant may have."""

    sample: Positive | None = None
    hold: Literal["zoh", "tustin"] = "zoh"
    delay: Any = None
    u: Names = []
    y: Names = []
    units: dict[str, str] = {}


class FilePlant(_Plant):
    """A plant in a file of its own."""

    file: str


class SpacecraftPlant(Record):
    """The linear plant of a spacecraft, at its control period."""

    spacecraft: str
    delay: Any = None


class _TimedPlant(_Plant):
    dt: NotNegative = Field(description="0 for continuous time, or the sampling time in s")


class FractionPlant(FractionWeight, _TimedPlant):
    """A plant in polynomials, or in zeros, poles and gain."""


class MatrixPlant(SystemWeight, _TimedPlant):
    """A plain plant."""


class GeneralizedPlant(_TimedPlant):
    """A generalised one."""

    A: Grid | None = None
    B1: Grid | None = None
    B2: Grid | None = None
    C1: Grid | None = None
    D11: Grid | None = None
    D12: Grid | None = None
    C2: Grid | None = None
    D21: Grid | None = None
    D22: Grid | None = None


Problem = Literal["tracking", "generalized", "loopshaping", "mixedsensitivity", "fourblock"]


class _Synthesis(Record):
    problem: Problem = Field(description="one of tracking, generalized, loopshaping, mixedsensitivity, fourblock")
    gamma: Positive | None = None


class AnySynthesis(_Synthesis):
    """That of an unknown problem."""

    model_config = ConfigDict(extra="ignore")


class Synthesis(_Synthesis):
    """That of `hinfsyn`."""

    method: Literal["auto", "riccati", "lmi", "standard", "extended"] = "auto"
    tol: Positive | None = None


class MixedSynthesis(Synthesis):
    """That of `mixsyn`."""

    shift: NotNegative = 0.0


class ShapingSynthesis(_Synthesis):
    """That of `ncfsyn`."""

    method: Literal["riccati", "lmi"] = "riccati"
    gamma_factor: Annotated[float, Field(gt=1)] | None = None
    feedback: Literal["negative", "positive"] = "positive"


class TrackingWeights(Record):
    """Of the problem tracking."""

    Wproc: Weight | None = None
    Wdist: Weight | None = None
    Werr: Weight | None = None
    Wact: Weight | None = None
    Wr: Weight | None = None


class FourBlockWeights(Record):
    """Of the four-block problem."""

    Wdist: Weight | None = None
    Wnoise: Weight | None = None
    Wout: Weight | None = None
    Wact: Weight | None = None


class NoWeights(Record):
    """Of a generalised plant, which has its weights inside."""


class ShapingWeights(Record):
    """Of loop shaping."""

    W1: Weight | None = None
    W2: Weight | None = None


class MixedWeights(ShapingWeights):
    """Of mixed sensitivity."""

    W3: Weight | None = None


class Specifications(Record):
    """What is asked of the design."""

    ratio: Positive | None = None
    delay_ratio: Positive | None = None
    intersample_ratio: Positive | None = None
    gain_margin_db: NotNegative | None = None
    phase_margin_deg: NotNegative | None = None
    delay_margin_samples: NotNegative | None = None
    disk_margin: NotNegative | None = None
    ncf_margin: NotNegative | None = None
    rounding_ratio: Positive | None = None
    box_margin: NotNegative | None = None
    box_gain_ratio: Positive | None = None
    dt: Positive | None = None
    overload: Annotated[float, Field(gt=1)] | None = None
    umin: Limits | None = None
    umax: Limits | None = None
    antiwindup: bool = False
    max_norm: Positive | None = None


SYNTHESIS: dict[str, type[Record]] = {
    "tracking": Synthesis, "generalized": Synthesis, "loopshaping": ShapingSynthesis,
    "mixedsensitivity": MixedSynthesis, "fourblock": Synthesis,
}  # fmt: skip
WEIGHTS: dict[str, type[Record]] = {
    "tracking": TrackingWeights, "fourblock": FourBlockWeights, "generalized": NoWeights,
    "loopshaping": ShapingWeights,
    "mixedsensitivity": MixedWeights,
}  # fmt: skip
