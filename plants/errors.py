"""The errors of this package, all below one root.

PlantError
 └─ ScenarioError  a number of a plant, sensor, scenario or campaign is not usable; names field, value, remedy
"""


class PlantError(Exception):
    """Root of all errors raised by `plants`."""


class ScenarioError(PlantError, ValueError):
    """A field of a plant or scenario is not usable; the message names the field, the value and the remedy."""
