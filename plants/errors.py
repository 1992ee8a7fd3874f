"""The errors of this package, all below one root.

PlantError
 └─ ScenarioError  a number of a plant, sensor, scenario or campaign is not usable; names field, value, remedy
     └─ SingularityError  an attitude at which the coordinates have no rate
"""


class PlantError(Exception):
    """Root of all errors raised by `plants`."""


class ScenarioError(PlantError, ValueError):
    """A field of a plant or scenario is not usable; the message names the field, the value and the remedy."""


class SingularityError(ScenarioError):
    """An attitude at which the coordinates of a plant have no rate, such as 3-2-1 Euler angles at pitch +-90 deg."""
