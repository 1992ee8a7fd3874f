"""A study flown from its command line, with what it measured."""

from pathlib import Path
from typing import Any, NamedTuple

import pytest

from plants.outcome.report import Claim
from plants.outcome.study import judged


class Flown(NamedTuple):
    """What came of a study's command line."""

    study: Any
    claims: dict[str, Claim]  # by their text
    out: Path


def run(module: Any, arguments: list[str], out: Path) -> Flown:
    """`module.main` to its end with exit code 0, the study that its `fly` filled, and its claims."""
    kept, original = [], module.fly

    def fly(study: Any, *rest: Any) -> None:
        kept.append(study)
        original(study, *rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "fly", fly)
        assert module.main([*arguments, "--out", str(out)]) == 0
    return Flown(kept[0], {claim.text: claim for claim in judged(module.statements(kept[0]))}, out)
