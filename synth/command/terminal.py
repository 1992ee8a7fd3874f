"""What goes to the screen: names and texts of files come from others and must not steer a terminal."""

from __future__ import annotations

import sys
from typing import TextIO

from synth.checks import printable


def say(text: object, stream: TextIO | None = None) -> None:
    """Print text with its control characters, and what the screen's encoding has no sign for, as escapes."""
    stream = sys.stdout if stream is None else stream
    encoding = getattr(stream, "encoding", None) or "utf-8"
    print(printable(str(text)).encode(encoding, "backslashreplace").decode(encoding), file=stream)
