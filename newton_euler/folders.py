"""Folders that are made for files."""

from __future__ import annotations

import errno
from pathlib import Path

MAX_DEPTH = 200
"""Parts of the path of a new folder. `Path.mkdir` calls itself for each, and Python allows 1000 calls."""


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """Make a folder and those around it, if there is none.

    Args:
        mode: permissions of the folder, not of those around it.

    Raises:
        OSError: for a folder that cannot be made, or that is new and more than `MAX_DEPTH` deep.
    """
    if len(folder.parts) > MAX_DEPTH and not folder.is_dir():
        problem = f"{len(folder.parts)} folders inside of each other, at most {MAX_DEPTH}"
        raise OSError(errno.ENAMETOOLONG, problem, str(folder))
    folder.mkdir(mode, parents=True, exist_ok=True)
