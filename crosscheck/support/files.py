"""Files that are written after long work: checked before it, whole or not at all after it."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from itertools import product
from pathlib import Path

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import tidied_up
from newton_euler.errors import quoted
from newton_euler.folders import make_folder
from newton_euler.model.source_file import is_path
from newton_euler.model.written_file import atomic_file, is_special

ABANDONED = 60.0
"""s after which an unfinished file is that of a process that was killed: files are made in memory first,
and writing them takes no longer."""


def path_of(given: str | os.PathLike[str]) -> Path:
    """Return a path; raises `CrosscheckError` for text that no file system takes."""
    if not is_path(text := os.fspath(given)):
        raise CrosscheckError(f"{quoted(text)} is no path")
    return Path(text)


def check_writable(*paths: Path) -> None:
    """Raise `CrosscheckError` before a run whose files could not be written after it.

    What earlier runs that were killed left unfinished of these files is removed.
    """
    for path in paths:
        try:
            if path.is_dir():
                raise CrosscheckError(f"cannot write {path}: it is a directory")
            if is_special(path):
                raise CrosscheckError(f"cannot write {path}: not a regular file")
            make_folder(path.parent)
            with tempfile.TemporaryFile(dir=path.parent):
                pass
        except OSError as error:
            raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
        unfinished = re.compile(rf"\.+{re.escape(path.stem)}(-[0-9a-f]{{8}})+{re.escape(path.suffix)}")
        remove_abandoned(each for each in path.parent.iterdir() if unfinished.fullmatch(each.name))


def remove_abandoned(unfinished: Iterable[Path]) -> None:
    """Remove files and folders that were never ended and that nobody writes any more."""
    for path in unfinished:
        with suppress(OSError):  # another process may have been quicker
            if time.time() - path.stat().st_mtime > ABANDONED:
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def write_files(files: Mapping[Path, bytes], stale: Iterable[Path] = ()) -> None:
    """Write files, all of them or none; the first is in its place last.

    Nothing is removed before everything is written beside its place.

    Args:
        files: contents.
        stale: files of earlier results that are removed.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    path = Path()
    try:
        with tidied_up(), ExitStack() as stack:  # which is left from its top
            for path, content in files.items():
                stack.enter_context(atomic_file(path)).write_bytes(content)
            for path in stale:
                path.unlink(missing_ok=True)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error


def check_no_source(targets: Iterable[Path], sources: Iterable[str | Path]) -> None:
    """Raise `CrosscheckError` if a file to be written is one of those that are read."""
    for target, source in product(targets, list(sources)):
        if os.path.exists(target) and os.path.exists(source) and os.path.samefile(target, source):
            raise CrosscheckError(f"would overwrite {source}, which it reads; name another file")
