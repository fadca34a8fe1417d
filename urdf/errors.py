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
    """Scene whose URDF would have two links or two joints of the same name.

    Attributes:
        what: "link" or "joint".
        name: the name that two of them would have.
    """

    def __init__(self, what: str, name: str) -> None:
        self.what = what
        self.name = name
        super().__init__(f"two URDF {what}s would be named {name!r}; rename a body or a joint")


class LoopFileError(UrdfError):
    """Loop file with a missing or invalid entry; the message names file and key.

    A loop file is a YAML file with what a URDF cannot describe: closed loops and ball joints.

    Attributes:
        source: path of the loop file.
        key: the key with the invalid entry.
        problem: what is wrong.
    """

    def __init__(self, source: str, key: str, problem: str) -> None:
        self.source = source
        self.key = key
        self.problem = problem
        super().__init__(f"{source}: {key}: {problem}")
