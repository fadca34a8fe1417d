"""Errors of the package, all subclasses of `MjcfError`, and a collector of MuJoCo's warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import StoppedError


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
    """Scene that MuJoCo cannot compile, with MuJoCo's reason or the element at fault."""

    def __init__(self, scene: str, reason: str) -> None:
        self.scene = scene
        self.reason = reason
        super().__init__(f"scene {scene!r} cannot be compiled by MuJoCo: {reason}")


class DivergenceError(MjcfError, StoppedError):
    """Run that diverged in MuJoCo, with the time reached and MuJoCo's warning."""

    def __init__(self, time: float, reason: str) -> None:
        super().__init__(time, reason, f"MuJoCo diverged at t = {time:.6g} s: {reason}")


@contextmanager
def collected_warnings(data: Any = None) -> Iterator[dict[str, float]]:
    """Collect MuJoCo's warnings instead of logging them, each with the first `data.time` of the warning."""
    import mujoco

    heard: dict[str, float] = {}

    def hear(message: str) -> None:
        heard.setdefault(" ".join(message.split()), math.nan if data is None else data.time)

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(hear)
    try:
        yield heard
    finally:
        mujoco.set_mju_user_warning(before)
