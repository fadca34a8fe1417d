"""The errors of this package."""

from __future__ import annotations

from collections.abc import Sequence


class MjcfError(Exception):
    """Base of every error that `mjcf` raises on purpose; reads as one line."""


class ModelError(MjcfError):
    """A mechanism that MuJoCo cannot be given: MuJoCo's own reason, or the name that is taken."""

    def __init__(self, scene: str, reason: str) -> None:
        self.scene = scene
        self.reason = reason
        super().__init__(f"scene {scene!r} makes no MuJoCo model: {reason}")


class OptionError(MjcfError):
    """An option with a value that it cannot take."""

    def __init__(self, option: str, value: object, valid: str | Sequence[str]) -> None:
        self.option = option
        self.value = value
        self.valid = valid
        needed = valid if isinstance(valid, str) else f"one of {', '.join(valid)}"
        super().__init__(f"{option} is {value!r}; needed: {needed}")


class DivergenceError(MjcfError):
    """A run that MuJoCo could not carry on: the time it had reached, and MuJoCo's warning."""

    def __init__(self, time: float, reason: str) -> None:
        self.time = time
        self.reason = reason
        super().__init__(f"MuJoCo diverged at t = {time:.6g} s: {reason}")
