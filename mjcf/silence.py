"""MuJoCo's warnings, kept from the terminal and from the file of its own that it leaves in the folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def heard_warnings() -> Iterator[list[str]]:
    """The warnings that MuJoCo gives meanwhile, each once."""
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
