"""What flies spacecraft is another package, or none: it is found by its entry point in the group `convex_synth.fly`.

The entry point is a module, or any object, with

    REFUSALS                    the errors that name a mistake of the user
    template()                  text of a file of a spacecraft that flies
    read(path)                  what is in such a file, which all below are handed
    model(sheet)                A, B, C, D in continuous time, the control period dt () s, names u, y, and units
    weights(sheet)              Wdist, Wnoise, Wout, Wact of a four-block problem in discrete time
    fly(sheet, controllers, *, runs, seed, duration, out)
                                controllers by name, each with dt, init and step; returns text, met, controllers, report
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

from synth.errors import ModelError
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

GROUP = "convex_synth.fly"


class Craft(NamedTuple):
    """A spacecraft that was read."""

    door: Any
    sheet: Any

    def plant(self) -> StateSpace:
        """The linear plant from torque to error, with a hold at the control period, and the names of its signals."""
        with refusals(self.door):
            found = self.door.model(self.sheet)
        names = {key: found[key] for key in ("u", "y", "units")}
        continuous = StateSpace(*(found[name] for name in "ABCD"), **names)
        return c2d(continuous, float(found["dt"]))

    def weights(self) -> dict[str, Any]:
        """Weights of its four-block problem."""
        with refusals(self.door):
            return self.door.weights(self.sheet)


def find() -> Any:
    """What flies spacecraft.

    Raises
    ------
    ModelError : nothing does, or it cannot be imported.
    """
    found = sorted(metadata.entry_points(group=GROUP), key=lambda entry: entry.name)
    if not found:
        raise ModelError(
            f"no installed package flies spacecraft (entry points {GROUP!r}); install convex-synth again, with "
            "`pip install convex-synth`, or `pip install -e .` in its folder"
        )
    try:
        return found[0].load()
    except (ImportError, AttributeError) as error:
        raise ModelError(
            f"what flies spacecraft, {found[0].value}, cannot be imported ({error}); install it again"
        ) from error


def read(path: Path) -> Craft:
    """The spacecraft in a file.

    Raises
    ------
    ModelError : as `find`, or the file says what cannot be.
    """
    door = find()
    with refusals(door):
        return Craft(door, door.read(path))


@contextmanager
def refusals(door: Any) -> Iterator[None]:
    """What names a mistake of the user becomes an error of ours."""
    try:
        yield
    except tuple(door.REFUSALS) as error:
        raise ModelError(str(error)) from error
