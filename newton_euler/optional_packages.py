"""Import packages that are not installed with the base distribution, and check their versions.

The distribution has extras, groups of optional packages. An import of such a package goes through
`optional_package`, so that a missing one is reported in one line with the command that installs the group.
`version_of` checks the version of a package before its import.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import Any

from newton_euler.errors import MissingPackageError, UnusablePackageError


def optional_package(module: str, extra: str) -> Any:
    """Import a module of an optional package.

    Args:
        module: dotted name, such as "SALib.analyze.sobol".
        extra: name of the group of optional packages to which the package belongs, such as "sweep".

    Returns:
        The imported module.

    Raises:
        MissingPackageError: if the package, or another package that it imports, is not installed.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingPackageError(str(error.name or module).split(".")[0], extra) from error


def version_of(requirement: str) -> str:
    """Return the installed version of a package, which fulfills a requirement.

    Args:
        requirement: package and versions, such as "numpy>=2.0".

    Raises:
        PackageNotFoundError: if the package is not installed.
        UnusablePackageError: for an installed version that does not fulfill the requirement.
    """
    from packaging.requirements import Requirement

    needed = Requirement(requirement)
    found = version(needed.name)
    if not needed.specifier.contains(found, prereleases=True):
        raise UnusablePackageError(f"package {needed.name}", f"has version {found}", requirement)
    return found
