"""Errors of the package `mjcf`, all subclasses of `MjcfError`, and a collector of MuJoCo's warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import StoppedError

MODEL_PACKAGE, MODELS_IN_MEMORY = "mujoco", "a mujoco.MjSpec or mujoco.MjModel"
"""Package of models in memory that can be read as MJCF files are, and their classes in words."""


class MjcfError(NewtonEulerError):
    """Base of all errors of MuJoCo models, MJCF files and runs. The message is one line.

    Examples:
        >>> try:
        ...     mjcf.read("nowhere.xml")
        ... except mjcf.MjcfError as error:
        ...     print(error)
        nowhere.xml: cannot be read: No such file or directory
    """


class ModelError(MjcfError):
    """Scene (a mechanism with its forces, control and start) that MuJoCo cannot compile.

    Attributes:
        scene: name of the scene.
        reason: MuJoCo's message, or the element that MuJoCo refuses.
    """

    def __init__(self, scene: str, reason: str) -> None:
        self.scene = scene
        self.reason = reason
        super().__init__(f"scene {scene!r} cannot be compiled by MuJoCo: {reason}")


class DivergenceError(MjcfError, StoppedError):
    """Run that diverged in MuJoCo."""

    def __init__(self, time: float, reason: str) -> None:
        """Make the error from the time reached, s, and MuJoCo's warning."""
        super().__init__(time, reason, f"MuJoCo diverged at t = {time:.6g} s: {reason}")


@contextmanager
def collected_warnings(data: Any = None) -> Iterator[dict[str, float]]:
    """Return a context that collects MuJoCo's warnings, which are otherwise written to a log file.

    The context yields a dictionary that fills during the context: the time, s, at which each warning first
    occurred, by message. The time is `data.time` of the `MjData` of a run, or NaN without `data`.
    """
    import mujoco

    time_of_warning: dict[str, float] = {}

    def collect(message: str) -> None:
        time_of_warning.setdefault(" ".join(message.split()), math.nan if data is None else data.time)

    previous_handler = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(collect)
    try:
        yield time_of_warning
    finally:
        mujoco.set_mju_user_warning(previous_handler)
