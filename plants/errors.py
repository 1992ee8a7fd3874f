"""The errors of this package, all below one root.

PlantError
 ├─ ScenarioError  a number of a plant, sensor, scenario or campaign is not usable; names field, value, remedy
 │   ├─ SingularityError  an attitude at which the coordinates have no rate
 │   └─ OpaqueError       a block that JAX cannot trace: it flies stepped, not compiled
 ├─ StoreError     a file or folder of flown runs is damaged, another study's, in use, or cannot be written
 └─ EngineError    the processes or the cluster that should do the work cannot
"""


class PlantError(Exception):
    """Root of all errors raised by `plants`."""


class ScenarioError(PlantError, ValueError):
    """A field of a plant or scenario is not usable; the message names the field, the value and the remedy."""


class SingularityError(ScenarioError):
    """An attitude at which the coordinates of a plant have no rate, such as 3-2-1 Euler angles at pitch +-90 deg."""


class OpaqueError(ScenarioError):
    """A block that JAX cannot trace, such as NumPy or an ordinary class: it flies stepped, not compiled."""


class StoreError(PlantError, ValueError):
    """A file or folder of flown runs is not usable; the message names the file, what is wrong and the remedy."""


class EngineError(PlantError, RuntimeError):
    """The processes or the cluster that should do the work cannot; the message says why and what to do."""
