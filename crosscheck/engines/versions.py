"""Versions of the packages that results depend on, for storage beside the results."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import version

from crosscheck.engines.engine import Engine
from newton_euler.errors import DISTRIBUTION

PACKAGES = ("numpy", "scipy", "llvmlite")
"""Packages whose version can change results of all engines, by their names on PyPI."""


def versions(engines: Iterable[Engine], packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Return the versions of Python, of some packages and of crosscheck, by name.

    Args:
        engines: engines that ran, whose packages are among these.
        packages: names of further packages on PyPI.
    """
    names = dict.fromkeys([*packages, *(engine.package for engine in engines)])
    found = {package: version(package) for package in names if package != DISTRIBUTION}
    return {"python": platform.python_version(), **found, "crosscheck": version(DISTRIBUTION)}
