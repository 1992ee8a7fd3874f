"""Versions of what computes a flight."""

import platform
from importlib import metadata

PACKAGES = ("convex-synth", "jax", "jaxlib", "numpy")


def of_packages() -> dict[str, str]:
    """Names and versions, of Python too."""
    return {name: metadata.version(name) for name in PACKAGES} | {"python": platform.python_version()}
