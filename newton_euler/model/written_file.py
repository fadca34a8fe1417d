"""Files that appear whole or not at all, in folders that are made if need be."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from newton_euler.folders import make_folder
from newton_euler.model.source_file import is_path


def is_special(path: Path) -> bool:
    """True for what exists and is neither a file nor a folder, such as a device or a pipe."""
    return path.exists() and not path.is_file() and not path.is_dir()


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path`, in a folder made if need be, that becomes `path` on success only.

    Whatever ends the block otherwise, an error or an interrupt, leaves what was at `path` before.

    Raises:
        OSError: for a path that cannot be written, for a device or a pipe, which a file would take the place
            of, and for text that is no path.
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
