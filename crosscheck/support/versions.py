"""Versions of the packages that results depend on, for storage beside the results."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version

from newton_euler.errors import DISTRIBUTION

PACKAGES = ("numpy", "scipy", "llvmlite", "mujoco", "pin")
"""Packages whose version can change results, by their names on PyPI; `pin` is Pinocchio."""


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Return the versions of Python, of some packages and of crosscheck, by name."""
    found = {package: version(package) for package in packages}
    return {"python": platform.python_version(), **found, "crosscheck": version(DISTRIBUTION)}
