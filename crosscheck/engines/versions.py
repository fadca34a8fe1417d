"""Versions of the packages that results depend on, for storage beside the results."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version

from crosscheck.engines.registry import ENGINES
from newton_euler.errors import DISTRIBUTION

PACKAGES = ("numpy", "scipy", "llvmlite")
"""Packages whose version can change results of all engines, by their names on PyPI."""


def versions(packages: Iterable[str] | None = None) -> dict[str, str]:
    """Return the versions of Python, of some packages and of crosscheck, by name.

    Args:
        packages: names of packages on PyPI; `PACKAGES` and those of the default engines if None.
    """
    if packages is None:
        packages = [*PACKAGES, *(engine.package for engine in ENGINES.values())]
    found = {package: version(package) for package in packages if package != DISTRIBUTION}
    return {"python": platform.python_version(), **found, "crosscheck": version(DISTRIBUTION)}
