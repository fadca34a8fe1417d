"""Import packages that are not installed with the base distribution.

The distribution has extras, groups of optional packages. Every import of such a package goes through
`optional_package`, so that a missing one is reported in one line with the command that installs the group.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from newton_euler.errors import MissingPackageError


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
