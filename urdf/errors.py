"""Errors of the package `urdf`, all subclasses of `UrdfError`."""

from __future__ import annotations

from newton_euler.errors import NewtonEulerError

MODEL_PACKAGE, MODELS_IN_MEMORY = "pinocchio", "a pinocchio.Model, alone or paired with its constraints"
"""Package of models in memory that can be read as URDF files are, and their classes in words."""


IN_MEMORY = "Pinocchio"
"""Name of the format of models in memory."""


class UrdfError(NewtonEulerError):
    """Base of all errors of URDF models and files. The message is one line.

    Examples:
        >>> try:
        ...     urdf.read("nowhere.urdf")
        ... except urdf.UrdfError as error:
        ...     print(error)
        nowhere.urdf: cannot be read: No such file or directory
    """


class NameClashError(UrdfError):
    """Scene whose URDF would have two links or two joints of the same name."""

    def __init__(self, what: str, name: str) -> None:
        """Make the error for `what`, "link" or "joint", and the name that two of them would have."""
        self.what = what
        self.name = name
        super().__init__(f"two URDF {what}s would be named {name!r}; rename a body or a joint")


class LoopFileError(UrdfError):
    """Loop file with a missing or invalid entry; the message names file and key.

    A loop file is a YAML file with what a URDF cannot describe: closed loops and ball joints.
    """

    def __init__(self, source: str, key: str, problem: str) -> None:
        """Make the error for a key of the loop file `source`."""
        self.source = source
        self.key = key
        self.problem = problem
        super().__init__(f"{source}: {key}: {problem}")
