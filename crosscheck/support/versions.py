"""Versions of what results depend on."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version

from newton_euler.errors import DISTRIBUTION

PACKAGES = ("numpy", "scipy", "llvmlite", "mujoco", "pin")
"""Packages on which results depend."""


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Return the versions of Python, of packages that results depend on, and of crosscheck."""
    found = {package: version(package) for package in packages}
    return {"python": platform.python_version(), **found, "crosscheck": version(DISTRIBUTION)}
