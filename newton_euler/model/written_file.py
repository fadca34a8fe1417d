"""Atomic writing of files: a file appears complete or not at all.

`atomic_file` gives a temporary path to write to and moves the finished file to its final path. Every module
that writes a result (trajectory, report, table) uses it.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from newton_euler.folders import make_folder
from newton_euler.model.source_file import is_path


def is_special(path: Path) -> bool:
    """Return True for an existing path that is neither a file nor a folder, such as a device or a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path, and move the file written there to `path` if the `with` block succeeds.

    The temporary file is in the folder of `path`. The folder is made if it does not exist. If an error or an
    interrupt ends the block, the temporary file is removed and the previous content of `path` stays.

    Args:
        path: final path of the file.

    Raises:
        OSError: for a path that cannot be written, and for text that cannot be a path, such as text with a
            null character. Also for a device or a pipe, which the move would replace by a regular file.
    """
    if not is_path(text := os.fspath(path)):
        raise OSError(errno.EINVAL, os.strerror(errno.EINVAL), text)
    if is_special(target := Path(path)):
        raise OSError(errno.EINVAL, "not a regular file", text)
    make_folder(target.parent)
    temporary = target.parent / f".{target.stem}-{os.urandom(4).hex()}{target.suffix}"
    try:
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
