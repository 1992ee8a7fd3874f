"""What comes from files and goes to the screen: names and texts come from others and must not steer a terminal."""

from __future__ import annotations

import json
import sys
from typing import Any, TextIO

import numpy as np

from synth.checks import printable
from synth.delivery.modelfiles import Model, read
from synth.errors import SynthError
from synth.synthesis.design import Design
from synth.systems.generalized import GeneralizedPlant

DONE, MISSED, BAD_INPUT, NO_CONTROLLER, NUMERICAL = range(5)  # exit codes


def say(text: object, stream: TextIO | None = None) -> None:
    """Print text with its control characters, and what the screen's encoding has no sign for, as escapes."""
    stream = sys.stdout if stream is None else stream
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(printable(str(text)).encode(encoding, "backslashreplace").decode(encoding), file=stream)


def load(file: str) -> Design | GeneralizedPlant | Model:
    """`read` with the file's name in front of what is wrong."""
    try:
        return read(file)
    except SynthError as error:
        error.args = (f"{file}: {error}",)
        raise


def print_json(value: Any) -> None:
    """JSON without infinite numbers, which become null."""
    print(json.dumps(finite(value), indent=1, allow_nan=False))


def finite(value: Any) -> Any:
    """The value with null in the place of what JSON cannot say."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value
