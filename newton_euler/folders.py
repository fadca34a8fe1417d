"""Create folders for output files, with a limit on their depth."""

from __future__ import annotations

import errno
from pathlib import Path

MAX_DEPTH = 200
"""Largest number of parts in the path of a new folder. `Path.mkdir` calls itself once for each missing
parent, and Python allows about 1000 nested calls."""


def make_folder(folder: Path, mode: int = 0o777) -> None:
    """Create a folder and its missing parents; an existing folder stays unchanged.

    Args:
        folder: path of the folder.
        mode: permissions of the new folder, not of its parents.

    Raises:
        OSError: for a folder that cannot be created, and for a new folder whose path has more than
            `MAX_DEPTH` parts.
    """
    if len(folder.parts) > MAX_DEPTH and not folder.is_dir():
        problem = f"{len(folder.parts)} folders inside of each other, at most {MAX_DEPTH}"
        raise OSError(errno.ENAMETOOLONG, problem, str(folder))
    folder.mkdir(mode, parents=True, exist_ok=True)
