"""Errors of MuJoCo's side, all under `MjcfError`, and MuJoCo's own warnings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import StoppedError


class MjcfError(NewtonEulerError):
    """Base of the errors of models, files and runs of MuJoCo; reads as one line.

    Examples:
        >>> try:
        ...     mjcf.read("nowhere.xml")
        ... except mjcf.MjcfError as error:
        ...     print(error)
        nowhere.xml: cannot be read: No such file or directory
    """


class ModelError(MjcfError):
    """A mechanism that MuJoCo cannot be given: MuJoCo's own reason, or the name that is taken."""

    def __init__(self, scene: str, reason: str) -> None:
        self.scene = scene
        self.reason = reason
        super().__init__(f"scene {scene!r} makes no MuJoCo model: {reason}")


class DivergenceError(MjcfError, StoppedError):
    """A run that MuJoCo could not carry on: the time it had reached, and MuJoCo's warning."""

    def __init__(self, time: float, reason: str) -> None:
        super().__init__(time, reason, f"MuJoCo diverged at t = {time:.6g} s: {reason}")


@contextmanager
def heard_warnings(data: Any = None) -> Iterator[dict[str, float]]:
    """Collect MuJoCo's warnings, not in its log file or terminal, with `data.time` at the first of each."""
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
