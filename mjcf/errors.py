"""Errors of MuJoCo's side, all under `MjcfError`, and MuJoCo's own warnings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from newton_euler.errors import NewtonEulerError
from newton_euler.model.trajectory import StoppedError


class MjcfError(NewtonEulerError):
    """Base of the errors of models, files and runs of MuJoCo; reads as one line."""


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
def heard_warnings() -> Iterator[list[str]]:
    """Collect the warnings that MuJoCo gives meanwhile, each once, in place of its log file and terminal."""
    import mujoco

    heard: list[str] = []

    def hear(message: str) -> None:
        line = " ".join(message.split())
        if line not in heard:
            heard.append(line)

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(hear)
    try:
        yield heard
    finally:
        mujoco.set_mju_user_warning(before)
